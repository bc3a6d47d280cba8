//! Quantities with units: `2 ms`, `0.1°`, `50 ppm`.

use serde::Deserialize;

use crate::finding::Unit;

/// A value with its unit, or a bare number; the reader knows the quantity.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(untagged, expecting = "expected a value with its unit, as in \"2 ms\"")]
pub(super) enum Quantity {
    /// A number without a unit.
    Number(f64),
    /// A number with its unit.
    Text(String),
}

/// With SI factors.
fn spellings(unit: Unit) -> &'static [(&'static str, f64)] {
    use std::f64::consts::PI;
    const DEGREE: f64 = PI / 180.0;
    match unit {
        Unit::Metre => &[("mm", 1e-3), ("m", 1.0), ("µm", 1e-6), ("um", 1e-6)],
        Unit::Radian => &[("°", DEGREE), ("deg", DEGREE), ("rad", 1.0), ("mrad", 1e-3)],
        Unit::Second => &[("ms", 1e-3), ("s", 1.0), ("µs", 1e-6), ("us", 1e-6)],
        Unit::RadianPerSecond | Unit::GyroRate => &[
            ("°/s", DEGREE),
            ("deg/s", DEGREE),
            ("°/min", DEGREE / 60.0),
            ("deg/min", DEGREE / 60.0),
            ("rad/s", 1.0),
        ],
        Unit::SecondPerSecond => &[("ppm", 1e-6), ("s/s", 1.0)],
        Unit::MetrePerMetre => &[("mm/m", 1e-3), ("m/m", 1.0)],
        Unit::RadianPerSecondSquared => {
            &[("rad/s²", 1.0), ("rad/s^2", 1.0), ("°/s²", DEGREE), ("deg/s^2", DEGREE)]
        }
        Unit::MetrePerSecondSquared => &[("m/s²", 1.0), ("m/s^2", 1.0)],
        Unit::One => &[("", 1.0), ("%", 1e-2)],
    }
}

impl Quantity {
    /// SI value, if its unit matches and it is above zero.
    ///
    /// # Errors
    /// What to write instead.
    pub fn amount(&self, unit: Unit) -> Result<f64, String> {
        let known = spellings(unit);
        let names: Vec<&str> =
            known.iter().map(|(name, _)| *name).filter(|it| !it.is_empty()).collect();
        let (number, factor, shown) = match self {
            Self::Number(number) if unit == Unit::One => (*number, 1.0, number.to_string()),
            Self::Number(number) => {
                return Err(format!(
                    "{number} has no unit: write it in {}, as in \"{number} {}\"",
                    list_alternatives(&names),
                    names[0]
                ));
            }
            Self::Text(text) => {
                let text = text.trim();
                let end =
                    text.find(|c: char| !matches!(c, '0'..='9' | '.' | '-' | '+' | 'e' | 'E'));
                let (number, suffix) = text.split_at(end.unwrap_or(text.len()));
                let suffix = suffix.trim();
                let number: f64 = number.parse().map_err(|_| format!("`{text}` is not a value"))?;
                let factor = known.iter().find(|(name, _)| *name == suffix);
                let Some((_, factor)) = factor else {
                    let what = if suffix.is_empty() { "no unit" } else { "the wrong unit" };
                    return Err(format!(
                        "`{text}` has {what}: write it in {}",
                        list_alternatives(&names)
                    ));
                };
                (number, *factor, text.to_owned())
            }
        };
        let amount = number * factor;
        match amount.is_finite() && amount > 0.0 {
            true => Ok(amount),
            false => Err(format!("`{shown}` is out of range: it must be above 0")),
        }
    }

    /// First matching unit, with the SI value.
    ///
    /// # Errors
    /// What to write instead.
    pub fn one_of(&self, units: &[Unit]) -> Result<(Unit, f64), String> {
        let mut refused = Vec::new();
        for &unit in units {
            match self.amount(unit) {
                Ok(amount) => return Ok((unit, amount)),
                Err(why) => refused.push(why),
            }
        }
        let is_of_range = |why: &&String| why.contains("out of range");
        if let Some(why) = refused.iter().find(is_of_range) {
            return Err(why.clone());
        }
        let names = units.iter().filter_map(|unit| Some(spellings(*unit).first()?.0));
        match (self, refused.as_slice()) {
            (_, [only]) => Err(only.clone()),
            (Self::Number(number), _) => Err(format!(
                "{number} has no unit: write {}",
                list_alternatives(&names.collect::<Vec<_>>())
            )),
            (Self::Text(text), _) => Err(format!(
                "`{}` has the wrong unit: write it in {}",
                text.trim(),
                list_alternatives(&names.collect::<Vec<_>>())
            )),
        }
    }
}

/// As in `a, b or c`.
fn list_alternatives(names: &[&str]) -> String {
    match names {
        [] => "no unit".to_owned(),
        [one] => (*one).to_owned(),
        [most @ .., last] => format!("{} or {last}", most.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::registry;

    fn text(text: &str) -> Quantity {
        Quantity::Text(text.to_owned())
    }

    #[test]
    fn quantities_in_report_notation_are_parsed() {
        for rule in registry() {
            let thresholds = rule.grade.thresholds().iter();
            let thresholds = thresholds.flat_map(|it| [(it.unit, it.warning), (it.unit, it.error)]);
            let limits = rule.limits.iter().map(|limit| (limit.unit, limit.value));
            for (unit, amount) in thresholds.chain(limits) {
                let shown = unit.show(amount);
                let read = text(&shown).amount(unit);
                assert!(
                    read.as_ref().is_ok_and(|read| (read / amount - 1.0).abs() < 1e-9),
                    "{} {shown}: {read:?}",
                    rule.code
                );
            }
        }
    }

    #[test]
    fn wrong_units_and_ranges_are_rejected() {
        assert_eq!(text("500ms").amount(Unit::Second), Ok(0.5));
        assert_eq!(text("1e-3 m").amount(Unit::Metre), Ok(1e-3));
        assert_eq!(text("5 %").amount(Unit::One), Ok(0.05));
        for (quantity, unit, part) in [
            (text("2 mm"), Unit::Second, "`2 mm` has the wrong unit: write it in ms, s"),
            (text("2"), Unit::Second, "has no unit"),
            (Quantity::Number(2.0), Unit::Second, "as in \"2 ms\""),
            (text("-2 ms"), Unit::Second, "above 0"),
            (text("0 ms"), Unit::Second, "above 0"),
            (text("inf ms"), Unit::Second, "is not a value"),
            (text("ms"), Unit::Second, "is not a value"),
        ] {
            let why = quantity.amount(unit).expect_err("no such amount");
            assert!(why.contains(part), "{why}");
        }
        let both = [Unit::Metre, Unit::Radian];
        assert_eq!(text("2 mm").one_of(&both), Ok((Unit::Metre, 2e-3)));
        assert!(text("2 s").one_of(&both).is_err_and(|why| why.contains("mm or °")));
        assert!(text("-2 mm").one_of(&both).is_err_and(|why| why.contains("above 0")));
    }
}
