//! Days, as people write them.

use crate::time::NANOS_PER_SECOND;

/// Nanoseconds of a day.
pub const DAY_NS: i64 = 86_400 * NANOS_PER_SECOND;

/// Stamps before 2000-01-01 are of no calendar: of a controller's or a simulation's clock.
pub const FIRST_NS: i64 = 946_684_800 * NANOS_PER_SECOND;

/// A day of the Gregorian calendar, in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Day {
    year: i64,
    month: i64,
    day: i64,
}

/// Days of 400 years.
const ERA_DAYS: i64 = 146_097;
/// From 0000-03-01 to 1970-01-01.
const EPOCH_DAYS: i64 = 719_468;

/// The day of a stamp, `2026-05-28`.
pub fn day(stamp_ns: i64) -> String {
    let Day { year, month, day } = Day::of(stamp_ns);
    format!("{year:04}-{month:02}-{day:02}")
}

impl Day {
    /// The day of a stamp.
    ///
    /// Years are counted from March, so that the day that is not always there comes last: Howard
    /// Hinnant, *chrono-Compatible Low-Level Date Algorithms*, `civil_from_days`.
    fn of(stamp_ns: i64) -> Self {
        let days = stamp_ns.div_euclid(DAY_NS) + EPOCH_DAYS;
        let (era, of_era) = (days.div_euclid(ERA_DAYS), days.rem_euclid(ERA_DAYS));
        let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / (ERA_DAYS - 1)) / 365;
        let of_year = of_era - (365 * year + year / 4 - year / 100);
        let month = (5 * of_year + 2) / 153;
        let day = of_year - (153 * month + 2) / 5 + 1;
        let month = if month < 10 { month + 3 } else { month - 9 };
        Self { year: year + era * 400 + i64::from(month <= 2), month, day }
    }

    /// When it begins, ns since 1970.
    pub fn start_ns(self) -> i64 {
        let year = self.year - i64::from(self.month <= 2);
        let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
        let month = (self.month + 9) % 12;
        let of_year = (153 * month + 2) / 5 + self.day - 1;
        let days = era * ERA_DAYS + of_era * 365 + of_era / 4 - of_era / 100 + of_year;
        (days - EPOCH_DAYS).saturating_mul(DAY_NS)
    }
}

impl std::str::FromStr for Day {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts: Vec<i64> = text.split('-').filter_map(|part| part.parse().ok()).collect();
        let parsed = match parts.as_slice() {
            [year @ 1970..=2200, month @ 1..=12, day @ 1..=31] => {
                Some(Self { year: *year, month: *month, day: *day })
            }
            _ => None,
        };
        // What no month has becomes a day of the next.
        parsed
            .filter(|parsed| Self::of(parsed.start_ns()) == *parsed && text.len() == 10)
            .ok_or_else(|| "expected a day such as 2026-05-28".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar_and_come_back() {
        for (seconds, text) in [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (1_780_000_000, "2026-05-28"),
            (1_798_761_599, "2026-12-31"),
            (4_107_542_400, "2100-03-01"),
        ] {
            assert_eq!(day(seconds * NANOS_PER_SECOND), text);
            let start_ns = text.parse::<Day>().expect("a day").start_ns();
            assert_eq!(start_ns, (seconds * NANOS_PER_SECOND).div_euclid(DAY_NS) * DAY_NS);
        }
        for text in ["2026-02-29", "2026-13-01", "28.5.2026", "2026-5-1", "0-0-0"] {
            assert!(text.parse::<Day>().is_err(), "{text}");
        }
    }
}
