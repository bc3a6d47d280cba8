//! Formats quantities with their units and significant digits.

use std::f64::consts::PI;

use crate::stats::Measured;

/// Unit of a quantity: SI when stored, everyday units when shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Metres; shown in mm.
    Metre,
    /// Radians; shown in degrees.
    Radian,
    /// Seconds; shown in ms.
    Second,
    /// Radians per second of a drift; shown in degrees per minute.
    RadianPerSecond,
    /// Radians per second of a gyro; shown in degrees per second.
    GyroRate,
    /// Seconds per second; shown in parts per million.
    SecondPerSecond,
    /// Metres per metre; shown in millimetres per metre.
    MetrePerMetre,
    /// Radians per second squared.
    RadianPerSecondSquared,
    /// Metres per second squared.
    MetrePerSecondSquared,
    /// Dimensionless.
    One,
}

impl Unit {
    /// SI symbol, as in the JSON report.
    pub const fn symbol(self) -> &'static str {
        match self {
            Unit::Metre => "m",
            Unit::Radian => "rad",
            Unit::Second => "s",
            Unit::RadianPerSecond | Unit::GyroRate => "rad/s",
            Unit::SecondPerSecond => "s/s",
            Unit::MetrePerMetre => "m/m",
            Unit::RadianPerSecondSquared => "rad/s²",
            Unit::MetrePerSecondSquared => "m/s²",
            Unit::One => "1",
        }
    }

    /// Unit of a report's estimate `name` with this symbol; `None` for an unknown symbol.
    pub fn from_symbol(symbol: &str, name: &str) -> Option<Self> {
        match (symbol, name) {
            ("m", _) => Some(Unit::Metre),
            ("rad", _) => Some(Unit::Radian),
            ("s", _) => Some(Unit::Second),
            ("rad/s", "gyro bias" | "gyro saturation") => Some(Unit::GyroRate),
            ("rad/s", _) => Some(Unit::RadianPerSecond),
            ("s/s", _) => Some(Unit::SecondPerSecond),
            ("m/m", _) => Some(Unit::MetrePerMetre),
            ("rad/s²" | "rad/s^2", _) => Some(Unit::RadianPerSecondSquared),
            ("m/s²" | "m/s^2", _) => Some(Unit::MetrePerSecondSquared),
            ("1", _) => Some(Unit::One),
            _ => None,
        }
    }

    /// Values smaller than this are treated as zero.
    pub const fn noise_floor(self) -> f64 {
        match self {
            Unit::Metre | Unit::Radian | Unit::Second => 1e-6,
            Unit::RadianPerSecond | Unit::GyroRate => 0.0,
            Unit::SecondPerSecond | Unit::MetrePerMetre | Unit::One => 0.0,
            Unit::RadianPerSecondSquared | Unit::MetrePerSecondSquared => 0.0,
        }
    }

    /// 95 % interval of `measured`, never narrower than the noise floor; `None` if it is unbounded.
    pub fn interval95(self, measured: &Measured) -> Option<[f64; 2]> {
        let half = self.half_width(measured, 0.95);
        let interval = [measured.value - half, measured.value + half];
        interval.iter().all(|end| end.is_finite()).then_some(interval)
    }

    /// Half-width of the interval at `confidence`, never below the noise floor. Infinite if it exceeds the
    /// largest meaningful width.
    pub fn half_width(self, measured: &Measured, confidence: f64) -> f64 {
        let half = measured.half_width(confidence).max(self.noise_floor());
        if half <= self.max_half_width() { half } else { f64::INFINITY }
    }

    /// Largest meaningful half-width: half a turn, or more than any arm, run or clock has.
    const fn max_half_width(self) -> f64 {
        match self {
            Unit::Radian => PI,
            Unit::Metre | Unit::GyroRate => 1e3,
            Unit::Second => 1e5,
            Unit::RadianPerSecond | Unit::SecondPerSecond | Unit::MetrePerMetre => 1.0,
            Unit::RadianPerSecondSquared | Unit::MetrePerSecondSquared | Unit::One => 1e6,
        }
    }

    /// Formats a value: `22.03 ms`, `0.5°`.
    pub fn show(self, value: f64) -> String {
        let (factor, suffix) = self.everyday(value.abs());
        let shown = value * factor;
        if shown.abs() >= MIN_SCIENTIFIC {
            return format!("{shown:.1e}{suffix}");
        }
        format!("{}{suffix}", trimmed(shown, significant_decimals(shown.abs(), 3).min(4)))
    }

    /// Formats a value with the half-width of its 95 % interval: `22.03 ± 0.02 ms`.
    pub fn show_measured(self, measured: &Measured) -> String {
        self.show_interval(measured.value, self.half_width(measured, 0.95), false)
    }

    /// As [`Unit::show_measured`], always with a sign: `+0.500 ± 0.001°`.
    pub fn show_signed(self, measured: &Measured) -> String {
        self.show_interval(measured.value, self.half_width(measured, 0.95), true)
    }

    /// Formats the value of an [`Estimate`](super::Estimate) with the wider half of its interval, if any.
    pub fn show_within(self, value: f64, interval: Option<[f64; 2]>) -> String {
        match interval {
            Some([low, high]) => self.show_interval(value, (high - value).max(value - low), false),
            None => self.show(value),
        }
    }

    /// As [`Unit::show_within`], always with a sign.
    pub fn show_signed_within(self, value: f64, interval: Option<[f64; 2]>) -> String {
        match interval {
            Some([low, high]) => self.show_interval(value, (high - value).max(value - low), true),
            None if value > 0.0 => format!("+{}", self.show(value)),
            None => self.show(value),
        }
    }

    /// Formats a value with the half-width of its interval.
    pub fn show_interval(self, value: f64, half: f64, signed: bool) -> String {
        if !half.is_finite() {
            return format!("{} ± ?", self.show(value));
        }
        let (factor, suffix) = self.everyday(value.abs().max(half));
        let (value, half) = (value * factor, half * factor);
        let decimals = significant_decimals(half, 1).min(3);
        // Round up so that the shown interval covers the actual one.
        let ulp = 10f64.powi(-(decimals as i32));
        let half = ((half / ulp - 1e-9).ceil() * ulp).max(ulp);
        match signed {
            true => unsigned_zero(format!("{value:+.decimals$} ± {half:.decimals$}{suffix}")),
            false => unsigned_zero(format!("{value:.decimals$} ± {half:.decimals$}{suffix}")),
        }
    }

    /// Factor and suffix of the everyday unit for a value of this size.
    fn everyday(self, size: f64) -> (f64, &'static str) {
        match self {
            Unit::Metre if size >= 1.0 => (1.0, " m"),
            Unit::Metre if size >= 1e-4 => (1e3, " mm"),
            Unit::Metre => (1e6, " µm"),
            Unit::Radian => (1f64.to_degrees(), "°"),
            Unit::Second if size >= 1.0 => (1.0, " s"),
            Unit::Second if size >= 1e-4 => (1e3, " ms"),
            Unit::Second => (1e6, " µs"),
            Unit::RadianPerSecond => (60.0 * 1f64.to_degrees(), " °/min"),
            Unit::GyroRate => (1f64.to_degrees(), " °/s"),
            Unit::SecondPerSecond => (1e6, " ppm"),
            Unit::MetrePerMetre => (1e3, " mm/m"),
            Unit::RadianPerSecondSquared => (1.0, " rad/s²"),
            Unit::MetrePerSecondSquared => (1.0, " m/s²"),
            Unit::One => (1.0, ""),
        }
    }
}

/// Numbers from this on are shown in scientific notation.
const MIN_SCIENTIFIC: f64 = 1e7;

/// Number of decimals that show `digits` significant digits of `size`.
fn significant_decimals(size: f64, digits: i32) -> usize {
    if size <= 0.0 || !size.is_finite() {
        return 0;
    }
    let leading = size.log10().floor() as i32;
    (digits - 1 - leading).clamp(0, 12) as usize
}

/// Removes the minus sign of a number that was rounded to zero.
fn unsigned_zero(text: String) -> String {
    let digits = |c: &char| c.is_ascii_digit() || *c == '.';
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().take_while(digits).all(|c| "0.".contains(c)) => rest.to_owned(),
        _ => text,
    }
}

/// Formats a number with this many decimals, without −0.
pub fn rounded(number: f64, decimals: usize) -> String {
    unsigned_zero(format!("{number:.decimals$}"))
}

/// Formats a number with at most `decimals` decimals, without trailing zeros.
fn trimmed(value: f64, decimals: usize) -> String {
    let text = rounded(value, decimals);
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(value: f64, std_error: f64) -> Measured {
        Measured { value, std_error, dof: 1e6 }
    }

    #[test]
    fn amounts_read_as_people_say_them() {
        assert_eq!(Unit::Second.show(0.0231), "23.1 ms");
        assert_eq!(Unit::Second.show(2.5e-5), "25 µs");
        assert_eq!(Unit::Metre.show(0.002), "2 mm");
        assert_eq!(Unit::Metre.show(0.8512), "851 mm");
        assert_eq!(Unit::Radian.show(0.1f64.to_radians()), "0.1°");
        assert_eq!(Unit::RadianPerSecond.show(0.2f64.to_radians() / 60.0), "0.2 °/min");
    }

    #[test]
    fn an_interval_gives_the_digits_and_is_rounded_up() {
        assert_eq!(Unit::Second.show_measured(&measured(0.02203, 1.05e-5)), "22.03 ± 0.03 ms");
        assert_eq!(
            Unit::Radian.show_signed(&measured(0.5f64.to_radians(), 1e-9)),
            "+0.500 ± 0.001°"
        );
        assert_eq!(Unit::Metre.show_measured(&measured(0.002, f64::NAN)), "2 mm ± ?");
        assert_eq!(Unit::Radian.show_signed(&measured(-1e-9, 1e-9)), "0.000 ± 0.001°");
    }

    #[test]
    fn an_interval_is_never_narrower_than_the_noise_floor() {
        assert_eq!(Unit::Metre.interval95(&measured(0.0, 0.0)), Some([-1e-6, 1e-6]));
        assert_eq!(Unit::Metre.interval95(&measured(0.0, f64::INFINITY)), None);
    }
}
