use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::Offset;

use crate::time::NANOS_PER_SECOND;

pub const DAY_NS: i64 = 86_400 * NANOS_PER_SECOND;

/// First calendar stamp, 2000-01-01. Earlier stamps are times of a controller or a simulation.
pub const FIRST_CALENDAR_NS: i64 = 946_684_800 * NANOS_PER_SECOND;

/// UTC day, such as `2026-05-28`.
pub fn format_day(stamp_ns: i64) -> String {
    // Within jiff's range.
    let time = Timestamp::from_nanosecond(stamp_ns.into()).unwrap_or_default();
    Offset::UTC.to_datetime(time).date().to_string()
}

/// In UTC, with the least precision that distinguishes the stamps: days, minutes or seconds.
pub fn format_distinct(from_ns: i64, to_ns: i64) -> [String; 2] {
    let at = |stamp_ns: i64| {
        let time = Timestamp::from_nanosecond(stamp_ns.into()).unwrap_or_default();
        Offset::UTC.to_datetime(time)
    };
    let both = [at(from_ns), at(to_ns)];
    let shown = |form: &str| both.map(|time| time.strftime(form).to_string());
    let shortest = ["%Y-%m-%d", "%Y-%m-%d %H:%M UTC"].into_iter().map(shown);
    let told = shortest.into_iter().find(|[from, to]| from != to);
    told.unwrap_or_else(|| shown("%Y-%m-%d %H:%M:%S UTC"))
}

/// Gregorian day, UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Day {
    start_ns: i64,
}

impl Day {
    /// Start, ns since 1970.
    pub fn start_ns(self) -> i64 {
        self.start_ns
    }
}

impl std::str::FromStr for Day {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let date = Date::strptime("%Y-%m-%d", text).ok();
        let date = date.filter(|date| (1970..=2200).contains(&date.year()) && text.len() == 10);
        let start = date.and_then(|date| Offset::UTC.to_timestamp(date.at(0, 0, 0, 0)).ok());
        let start_ns = start.and_then(|start| i64::try_from(start.as_nanosecond()).ok());
        let start_ns = start_ns.ok_or("expected a day such as 2026-05-28")?;
        Ok(Self { start_ns })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_match_the_calendar_and_parse_back() {
        for (seconds, text) in [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (1_780_000_000, "2026-05-28"),
            (1_798_761_599, "2026-12-31"),
            (4_107_542_400, "2100-03-01"),
        ] {
            assert_eq!(format_day(seconds * NANOS_PER_SECOND), text);
            let start_ns = text.parse::<Day>().expect("a day").start_ns();
            assert_eq!(start_ns, (seconds * NANOS_PER_SECOND).div_euclid(DAY_NS) * DAY_NS);
        }
        let start_ns = 1_780_000_000 * NANOS_PER_SECOND;
        for (later_s, [from, to]) in [
            (86_400, ["2026-05-28", "2026-05-29"]),
            (3_600, ["2026-05-28 20:26 UTC", "2026-05-28 21:26 UTC"]),
            (5, ["2026-05-28 20:26:40 UTC", "2026-05-28 20:26:45 UTC"]),
        ] {
            assert_eq!(
                format_distinct(start_ns, start_ns + later_s * NANOS_PER_SECOND),
                [from, to]
            );
        }
        for text in ["2026-02-29", "2026-13-01", "28.5.2026", "2026-5-1", "0-0-0"] {
            assert!(text.parse::<Day>().is_err(), "{text}");
        }
    }
}
