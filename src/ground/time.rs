//! Time as logs store it: integer nanoseconds and their clock.
//!
//! An `f64` resolves epoch stamps only to 0.25 µs, so stamps are `i64` and only differences become seconds.

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Nanoseconds per second.
pub const NANOS_PER_SECOND: i64 = 1_000_000_000;

/// Nanoseconds since the epoch of the clock that wrote them.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Default)]
pub struct Stamp(i64);

impl Stamp {
    /// From nanoseconds since the epoch.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Nanoseconds since the epoch.
    pub const fn nanos(self) -> i64 {
        self.0
    }

    /// Seconds from `origin`, exact to 1 ns over 100 days.
    pub fn seconds_since(self, origin: Stamp) -> f64 {
        seconds(self.0.saturating_sub(origin.0))
    }

    /// This stamp plus `offset_s`.
    pub fn shifted(self, offset_s: f64) -> Self {
        Self(self.0.saturating_add(nanos(offset_s)))
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// A decimal string, because JSON numbers are not exact.
impl Serialize for Stamp {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Stamp {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        text.parse().map(Self).map_err(|_| D::Error::custom("expected nanoseconds as a string"))
    }
}

/// Converts a difference to seconds.
pub fn seconds(nanos: i64) -> f64 {
    nanos as f64 / NANOS_PER_SECOND as f64
}

/// Converts to the nearest nanosecond; saturates.
pub fn nanos(seconds: f64) -> i64 {
    (seconds * NANOS_PER_SECOND as f64).round() as i64
}

/// Time of a message that the audit uses.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Clock {
    /// Header stamp: when the sample was valid.
    #[default]
    Header,
    /// When it was recorded.
    Log,
    /// When it was sent.
    Publish,
}

impl Clock {
    /// Name in options and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Clock::Header => "header",
            Clock::Log => "log",
            Clock::Publish => "publish",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_of_epoch_stamps_keeps_every_nanosecond() {
        let origin = Stamp::from_nanos(1_780_000_000_123_456_789);
        let later = Stamp::from_nanos(1_780_000_000_123_456_790);
        assert_eq!(later.seconds_since(origin), 1e-9);
        assert_eq!(origin.shifted(1e-9), later);
    }

    #[test]
    fn hostile_stamps_saturate_instead_of_overflowing() {
        let (low, high) = (Stamp::from_nanos(i64::MIN), Stamp::from_nanos(i64::MAX));
        assert!(high.seconds_since(low) > 0.0);
        assert_eq!(high.shifted(1e300), high);
    }
}
