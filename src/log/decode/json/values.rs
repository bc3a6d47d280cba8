//! Reads JSON values into slots of a row.

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

use super::super::row::{Row, Slot};
use ground::time::NANOS_PER_SECOND;

pub(super) struct SlotVisitor<'v> {
    pub(super) slot: Slot,
    pub(super) path: &'static str,
    pub(super) row: &'v mut Row,
}

impl SlotVisitor<'_> {
    fn mismatch<E: Error>(&self, found: &str) -> E {
        E::custom(format_args!(
            "expected {} in field `{}`, found {found}",
            self.slot.expected(),
            self.path
        ))
    }

    fn number<E: Error>(self, value: f64) -> Result<(), E> {
        match self.slot {
            Slot::Number(index) => self.row.numbers[index] = value,
            _ => return Err(self.mismatch("a number")),
        }
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for SlotVisitor<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for SlotVisitor<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} in field `{}`", self.slot.expected(), self.path)
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        match self.slot {
            // JSON writes NaN and infinity as null.
            Slot::Number(_) => self.number(f64::NAN),
            Slot::List(_) => Ok(()),
            slot => {
                self.row.reset(slot);
                Ok(())
            }
        }
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        self.number(value)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.number(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.number(value as f64)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        match self.slot {
            Slot::Text(index) => self.row.set_text(index, text.as_bytes()),
            Slot::Stamp => match timestamp(text) {
                Some(stamp) => (self.row.seconds, self.row.nanoseconds) = stamp,
                None => return Err(self.mismatch("a string that is not an RFC 3339 time")),
            },
            Slot::Number(_) => match number(text) {
                Some(value) => return self.number(value),
                None => return Err(self.mismatch("a text")),
            },
            _ => return Err(self.mismatch("a text")),
        }
        Ok(())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        if self.slot != Slot::Stamp {
            return Err(self.mismatch("an object"));
        }
        while let Some(part) = map.next_key_seed(StampKey)? {
            match part {
                Some(StampPart::Seconds) => self.row.seconds = map.next_value_seed(Integer)?,
                Some(StampPart::Nanoseconds) => {
                    self.row.nanoseconds = map.next_value_seed(Integer)?;
                }
                None => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        // A name of another version of the type usually has an empty list. It must not replace a list with
        // values.
        match self.slot {
            Slot::List(index) => {
                let mut next = list.next_element_seed(Number)?;
                if next.is_some() {
                    self.row.reset(self.slot);
                }
                while let Some(value) = next {
                    self.row.push(index, value);
                    next = list.next_element_seed(Number)?;
                }
                self.row.cap_list(index);
            }
            Slot::Names => {
                self.row.names.clear();
                while list.next_element_seed(Name(&mut *self.row))?.is_some() {}
            }
            _ => return Err(self.mismatch("an array")),
        }
        Ok(())
    }
}

struct Number;

impl<'de> DeserializeSeed<'de> for Number {
    type Value = f64;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<f64, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl Visitor<'_> for Number {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_unit<E: Error>(self) -> Result<f64, E> {
        Ok(f64::NAN)
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<f64, E> {
        Ok(value)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<f64, E> {
        Ok(value as f64)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<f64, E> {
        number(text).ok_or_else(|| E::custom("expected a number, found a string"))
    }
}

/// Protocol buffers write 64-bit integers as strings.
struct Integer;

impl<'de> DeserializeSeed<'de> for Integer {
    type Value = i64;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<i64, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl Visitor<'_> for Integer {
    type Value = i64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an integer in a time")
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<i64, E> {
        Ok(value)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<i64, E> {
        Ok(i64::try_from(value).unwrap_or(i64::MAX))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<i64, E> {
        text.parse().map_err(|_| E::custom("expected an integer in a time, found a string"))
    }
}

struct Name<'r>(&'r mut Row);

impl<'de> DeserializeSeed<'de> for Name<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for Name<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<(), E> {
        self.0.names.push(name.as_bytes());
        Ok(())
    }
}

/// Parts of a time by their names in ROS 1, ROS 2 and protocol buffers.
struct StampKey;

enum StampPart {
    Seconds,
    Nanoseconds,
}

impl<'de> DeserializeSeed<'de> for StampKey {
    type Value = Option<StampPart>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for StampKey {
    type Value = Option<StampPart>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<Self::Value, E> {
        Ok(match key {
            "sec" | "secs" | "seconds" => Some(StampPart::Seconds),
            "nsec" | "nsecs" | "nanosec" | "nanos" => Some(StampPart::Nanoseconds),
            _ => None,
        })
    }
}

/// As protocol buffers write values that JSON lacks.
fn number(text: &str) -> Option<f64> {
    match text {
        "NaN" => Some(f64::NAN),
        "Infinity" => Some(f64::INFINITY),
        "-Infinity" => Some(f64::NEG_INFINITY),
        _ => text.parse().ok(),
    }
}

/// Seconds since 1970 and nanoseconds of an RFC 3339 time such as `2024-05-06T07:08:09.5Z`. Truncates
/// smaller digits.
fn timestamp(text: &str) -> Option<(i64, i64)> {
    let text = text.trim();
    let (whole, places) = text.split_once('.').unwrap_or((text, ""));
    let zone_at = places.find(|c: char| !c.is_ascii_digit()).unwrap_or(places.len());
    let time: jiff::Timestamp = match zone_at > NANOSECOND_PLACES {
        true => format!("{whole}.{}{}", &places[..NANOSECOND_PLACES], &places[zone_at..]).parse(),
        false => text.parse(),
    }
    .ok()?;
    let (second, nanosecond) = (time.as_second(), i64::from(time.subsec_nanosecond()));
    // Both are negative before 1970.
    let borrow = i64::from(nanosecond < 0);
    Some((second - borrow, nanosecond + borrow * NANOS_PER_SECOND))
}

const NANOSECOND_PLACES: usize = 9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rfc_3339_timestamps_are_parsed() {
        // Expected values from `date -u -d … +%s`.
        for (text, expected) in [
            ("1970-01-01T00:00:00Z", Some((0, 0))),
            ("2024-02-29T23:59:59.5Z", Some((1_709_251_199, 500_000_000))),
            ("2023-11-14T22:13:20.123456789Z", Some((1_700_000_000, 123_456_789))),
            ("2023-11-15T00:13:20.1234567899+02:00", Some((1_700_000_000, 123_456_789))),
            ("2023-11-14 17:43:20-04:30", Some((1_700_000_000, 0))),
            ("1969-12-31T23:59:59.25Z", Some((-1, 250_000_000))),
            ("2000-03-01T00:00:00Z", Some((951_868_800, 0))),
            ("2023-13-14T22:13:20Z", None),
            ("2023-11-14T22:13:20", None),
            ("2023-11-14T22:13:20.Z", None),
            ("2023-11-14", None),
            ("é", None),
            ("12T+", None),
        ] {
            assert_eq!(timestamp(text), expected, "{text}");
        }
    }
}
