//! Units of poses.

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// Unit of a position, in metres per unit.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub struct LengthScale(f64);

const COMMON_LENGTH_UNITS: [(f64, &str, &str); 10] = [
    (1.0, "m", "metres"),
    (1e-3, "mm", "millimetres"),
    (1e-2, "cm", "centimetres"),
    (1e-1, "dm", "decimetres"),
    (1e-4, "0.1 mm", "tenths of a millimetre"),
    (1e-6, "µm", "micrometres"),
    (1e3, "km", "kilometres"),
    (0.0254, "in", "inches"),
    (0.3048, "ft", "feet"),
    (2.54e-5, "mil", "thousandths of an inch"),
];

impl LengthScale {
    /// Metres.
    pub const METRE: Self = Self(1.0);
    /// Millimetres.
    pub const MILLIMETRE: Self = Self(1e-3);

    /// From its length in metres.
    pub fn from_m(metres: f64) -> Self {
        Self(metres)
    }

    /// Metres per unit.
    pub fn in_m(self) -> f64 {
        self.0
    }

    /// Units in common use.
    pub fn common() -> impl Iterator<Item = Self> {
        COMMON_LENGTH_UNITS.iter().map(|(metres, ..)| Self(*metres))
    }

    fn entry(self) -> Option<&'static (f64, &'static str, &'static str)> {
        COMMON_LENGTH_UNITS.iter().find(|(metres, ..)| (self.0 / metres - 1.0).abs() < 1e-9)
    }

    /// Name, such as `centimetres`, or its length in metres.
    pub fn plural_name(self) -> String {
        self.entry()
            .map_or_else(|| format!("numbers of {self} each"), |(.., name)| (*name).to_owned())
    }
}

impl Default for LengthScale {
    fn default() -> Self {
        Self::METRE
    }
}

impl fmt::Display for LengthScale {
    /// Symbol, such as `cm`, or the length, such as `0.0043 m`.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.entry() {
            Some((_, symbol, _)) => out.write_str(symbol),
            None => {
                let digits = (3 - self.0.abs().log10().floor() as i32).clamp(0, 9) as usize;
                write!(out, "{:.digits$} m", self.0)
            }
        }
    }
}

impl FromStr for LengthScale {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let usual = COMMON_LENGTH_UNITS
            .iter()
            .find(|(_, symbol, _)| *symbol == text)
            .map(|(metres, ..)| *metres);
        let metres = || text.strip_suffix(" m")?.parse().ok();
        let found: Option<f64> = usual.or_else(metres);
        found.filter(|metres| metres.is_finite() && *metres > 0.0).map(Self).ok_or_else(|| {
            let symbols: Vec<&str> =
                COMMON_LENGTH_UNITS.iter().map(|(_, symbol, _)| *symbol).collect();
            format!("`{text}` is not a unit of length: use {}, or `0.0043 m`", symbols.join(", "))
        })
    }
}

impl Serialize for LengthScale {
    fn serialize<S: Serializer>(&self, out: S) -> Result<S::Ok, S::Error> {
        out.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for LengthScale {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        String::deserialize(from)?.parse().map_err(serde::de::Error::custom)
    }
}

/// Unit of an angle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum AngleUnit {
    /// Radians.
    #[default]
    #[serde(rename = "rad")]
    Radian,
    /// Degrees.
    #[serde(rename = "deg")]
    Degree,
    /// Thousandths of a degree, as integers.
    #[serde(rename = "0.001 deg")]
    Millidegree,
    /// Ten-thousandths of a degree, as integers.
    #[serde(rename = "0.0001 deg")]
    TenthMillidegree,
}

impl AngleUnit {
    const ALL: [Self; 4] = [Self::Radian, Self::Degree, Self::Millidegree, Self::TenthMillidegree];

    /// Radians per unit.
    pub fn in_rad(self) -> f64 {
        match self {
            Self::Radian => 1.0,
            Self::Degree => 1_f64.to_radians(),
            Self::Millidegree => 1e-3_f64.to_radians(),
            Self::TenthMillidegree => 1e-4_f64.to_radians(),
        }
    }

    /// Unit it is confused with: degrees for radians, else radians.
    pub fn other(self) -> Self {
        match self {
            Self::Radian => Self::Degree,
            _ => Self::Radian,
        }
    }

    /// Symbol.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Radian => "rad",
            Self::Degree => "deg",
            Self::Millidegree => "0.001 deg",
            Self::TenthMillidegree => "0.0001 deg",
        }
    }

    /// Plural name.
    pub fn plural_name(self) -> &'static str {
        match self {
            Self::Radian => "radians",
            Self::Degree => "degrees",
            Self::Millidegree => "thousandths of a degree",
            Self::TenthMillidegree => "ten-thousandths of a degree",
        }
    }
}

/// True and wrong interpretation of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misread<T> {
    /// True interpretation.
    pub is: T,
    /// Interpretation that was used.
    pub read_as: T,
}

impl Misread<AngleUnit> {
    /// Factor that corrects the angles.
    pub fn factor(self) -> f64 {
        self.is.in_rad() / self.read_as.in_rad()
    }
}

impl Misread<LengthScale> {
    /// Factor that corrects the lengths.
    pub fn factor(self) -> f64 {
        self.is.in_m() / self.read_as.in_m()
    }
}

/// Units, such as `mm, deg`; `None` if not declared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(try_from = "String")]
pub struct Units {
    /// Length unit.
    pub length: Option<LengthScale>,
    /// Angle unit.
    pub angle: Option<AngleUnit>,
}

/// Error of [`Units::set_symbol`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnitError {
    /// No unit of length or angle.
    Unknown,
    /// Another unit was declared before.
    Contradiction,
}

impl Units {
    /// Adds a unit.
    ///
    /// # Errors
    /// If the symbol is unknown or contradicts an earlier one.
    pub fn set_symbol(&mut self, symbol: &str) -> Result<(), UnitError> {
        let angle = AngleUnit::ALL.into_iter().find(|unit| unit.symbol() == symbol);
        let is_known = match (angle, symbol.parse()) {
            (Some(angle), _) => is_or_becomes(&mut self.angle, angle),
            (None, Ok(length)) => is_or_becomes(&mut self.length, length),
            (None, Err(_)) => return Err(UnitError::Unknown),
        };
        is_known.then_some(()).ok_or(UnitError::Contradiction)
    }

    /// Completes these units from `others`.
    pub fn or(self, others: Self) -> Self {
        Self { length: self.length.or(others.length), angle: self.angle.or(others.angle) }
    }
}

fn is_or_becomes<T: Copy + PartialEq>(known: &mut Option<T>, unit: T) -> bool {
    *known.get_or_insert(unit) == unit
}

impl TryFrom<String> for Units {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let mut units = Self::default();
        for symbol in text.split(", ") {
            units.set_symbol(symbol).map_err(|error| format!("unit `{symbol}`: {error:?}"))?;
        }
        Ok(units)
    }
}

impl fmt::Display for Units {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.length, self.angle) {
            (Some(length), Some(angle)) => write!(f, "{length}, {}", angle.symbol()),
            (Some(length), None) => length.fmt(f),
            (None, angle) => f.write_str(angle.map_or("", AngleUnit::symbol)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_have_symbols_and_lengths_their_metres() {
        for (metres, symbol, plural_name) in [
            (1e-2, "cm", "centimetres"),
            (1e-4, "0.1 mm", "tenths of a millimetre"),
            (0.0254, "in", "inches"),
            (0.004_321, "0.004321 m", "numbers of 0.004321 m each"),
            (12.5, "12.50 m", "numbers of 12.50 m each"),
        ] {
            let scale = LengthScale::from_m(metres);
            assert_eq!(
                (scale.to_string().as_str(), scale.plural_name().as_str()),
                (symbol, plural_name)
            );
            assert_eq!(symbol.parse(), Ok(scale));
        }
        assert!(
            "furlong".parse::<LengthScale>().is_err() && "-1 m".parse::<LengthScale>().is_err()
        );
    }
}
