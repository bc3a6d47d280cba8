//! Times of rows.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use crate::time::Clock;

use super::column::Column;

/// Times of every row, ns, one entry per row in each column.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Times {
    /// Header stamp (for /tf: of that transform); 0 if unset.
    pub header: Vec<i64>,
    /// When it was recorded.
    pub log: Vec<i64>,
    /// When it was sent. Empty if equal to the receive times, as most recorders write.
    publish: Vec<i64>,
    /// Sequence number; empty or 0 if the sender does not count.
    pub sequence: Column<u32>,
    /// The type has no stamp, so `header` is 0.
    pub unstamped: bool,
}

impl Times {
    /// Appends one row.
    pub fn push(&mut self, header: i64, log: i64, publish: i64) {
        if publish != log || !self.publish.is_empty() {
            self.publish.extend_from_slice(&self.log[self.publish.len()..]);
            self.publish.push(publish);
        }
        self.header.push(header);
        self.log.push(log);
    }

    /// Appends all rows of `later`.
    pub fn append(&mut self, later: &Self) {
        if !(self.publish.is_empty() && later.publish.is_empty()) {
            self.publish.extend_from_slice(&self.log[self.publish.len()..]);
            self.publish.extend_from_slice(later.nanos_on(Clock::Publish));
        }
        self.header.extend_from_slice(&later.header);
        self.log.extend_from_slice(&later.log);
        self.sequence.extend_from(&later.sequence);
    }

    /// Appends one row of `later`.
    pub fn append_row(&mut self, later: &Self, row: usize) {
        self.push(later.header[row], later.log[row], later.nanos_on(Clock::Publish)[row]);
        if let Some(sequence) = later.sequence.get(row) {
            self.sequence.push(*sequence);
        }
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.log.len()
    }

    /// Whether it is empty.
    pub fn is_empty(&self) -> bool {
        self.log.is_empty()
    }

    /// Column of `clock`, ns.
    pub fn nanos_on(&self, clock: Clock) -> &[i64] {
        match clock {
            Clock::Header => &self.header,
            Clock::Log => &self.log,
            Clock::Publish if self.publish.is_empty() => &self.log,
            Clock::Publish => &self.publish,
        }
    }

    /// Subtracts `lateness` (ns), a function of the nanoseconds since the first time on the same clock.
    /// Unset headers stay unset.
    pub fn shift_back(&mut self, lateness: impl Fn(i64) -> i64) {
        for column in [&mut self.header, &mut self.log, &mut self.publish] {
            let first = column.iter().copied().filter(|nanos| *nanos != 0).min().unwrap_or(0);
            for nanos in column.iter_mut().filter(|nanos| **nanos != 0) {
                *nanos = nanos.saturating_sub(lateness(nanos.saturating_sub(first)));
            }
        }
    }

    /// Replaces the times on `clock`. Receive times at a constant delay, as in tables, move too.
    pub fn restamp(&mut self, clock: Clock, nanos: Vec<i64>) {
        let delay = self
            .log
            .first()
            .zip(self.header.first())
            .map_or(0, |(log, own)| log.saturating_sub(*own));
        let is_constant = self
            .log
            .iter()
            .zip(&self.header)
            .all(|(log, own)| log.checked_sub(*own) == Some(delay));
        match clock {
            Clock::Log => self.log = nanos,
            Clock::Publish => self.publish = nanos,
            Clock::Header => {
                if is_constant {
                    self.log = nanos.iter().map(|nanos| nanos.saturating_add(delay)).collect();
                }
                self.header = nanos;
            }
        }
    }

    pub(super) fn permute(&mut self, order: &[usize]) {
        permute(&mut self.header, order);
        permute(&mut self.log, order);
        if !self.publish.is_empty() {
            permute(&mut self.publish, order);
        }
        if !self.sequence.is_empty() {
            self.sequence.select(order);
        }
    }
}

/// Times that the transforms of a topic share while they have the same stamps. A change copies them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SharedTimes(Arc<Times>);

impl SharedTimes {
    /// Whether both share the same times.
    pub fn is_shared_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl From<Times> for SharedTimes {
    fn from(times: Times) -> Self {
        Self(Arc::new(times))
    }
}

impl Deref for SharedTimes {
    type Target = Times;

    fn deref(&self) -> &Times {
        &self.0
    }
}

impl DerefMut for SharedTimes {
    fn deref_mut(&mut self) -> &mut Times {
        Arc::make_mut(&mut self.0)
    }
}

pub(super) fn permute<T: Copy>(column: &mut Vec<T>, order: &[usize]) {
    *column = order.iter().map(|&row| column[row]).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn publish_times_are_stored_from_the_first_difference_on() {
        let mut times = Times::default();
        for (log, publish) in [(10, 10), (20, 20), (30, 29), (40, 40)] {
            times.push(0, log, publish);
        }
        assert_eq!(times.nanos_on(Clock::Publish), [10, 20, 29, 40]);
        times.permute(&[3, 2]);
        assert_eq!(times.nanos_on(Clock::Publish), [40, 29]);
        let mut same = Times::default();
        same.push(0, 10, 10);
        assert_eq!(same.nanos_on(Clock::Publish), [10]);
    }

    #[test]
    fn shifting_back_moves_every_clock_by_its_own_time() {
        let mut times = Times::default();
        for (header, log) in [(0, 50), (1_000, 60), (3_000, 80)] {
            times.push(header, log, log + 1);
        }
        times.shift_back(|since_first| 10 + since_first / 100);
        assert_eq!(times.header, [0, 990, 2_970]);
        assert_eq!(times.log, [40, 50, 70]);
        assert_eq!(times.nanos_on(Clock::Publish), [41, 51, 71]);
    }
}
