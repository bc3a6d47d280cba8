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
    /// rad/s of a drift; shown in degrees per minute.
    RadianPerSecond,
    /// rad/s of a gyro; shown in degrees per second.
    GyroRate,
    /// s/s; shown in ppm.
    SecondPerSecond,
    /// m/m; shown in mm/m.
    MetrePerMetre,
    /// rad/s².
    RadianPerSecondSquared,
    /// m/s².
    MetrePerSecondSquared,
    /// Dimensionless.
    One,
}

impl Unit {
    /// SI symbol in the JSON report.
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

    /// Unit of the estimate `name` with this symbol, if known.
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

    /// Smaller values are zero.
    pub const fn noise_floor(self) -> f64 {
        match self {
            Unit::Metre | Unit::Radian | Unit::Second => 1e-6,
            Unit::RadianPerSecond | Unit::GyroRate => 0.0,
            Unit::SecondPerSecond | Unit::MetrePerMetre | Unit::One => 0.0,
            Unit::RadianPerSecondSquared | Unit::MetrePerSecondSquared => 0.0,
        }
    }

    /// 95 % interval, never below the noise floor; `None` if unbounded.
    pub fn interval95(self, measured: &Measured) -> Option<[f64; 2]> {
        let half = self.half_width(measured, 0.95);
        let interval = [measured.value - half, measured.value + half];
        interval.iter().all(|end| end.is_finite()).then_some(interval)
    }

    /// Half-width at `confidence`, never below the noise floor. Infinite above the largest meaningful
    /// width.
    pub fn half_width(self, measured: &Measured, confidence: f64) -> f64 {
        let half = measured.half_width(confidence).max(self.noise_floor());
        if half <= self.max_half_width() { half } else { f64::INFINITY }
    }

    /// Half a turn, or more than any arm, run or clock has.
    const fn max_half_width(self) -> f64 {
        match self {
            Unit::Radian => PI,
            Unit::Metre | Unit::GyroRate => 1e3,
            Unit::Second => 1e5,
            Unit::RadianPerSecond | Unit::SecondPerSecond | Unit::MetrePerMetre => 1.0,
            Unit::RadianPerSecondSquared | Unit::MetrePerSecondSquared | Unit::One => 1e6,
        }
    }

    /// Number and unit, as in `22.03 ms`, `0.5°`.
    pub fn show(self, value: f64) -> String {
        let (factor, suffix) = self.everyday(value.abs());
        let shown = value * factor;
        if shown.abs() >= MIN_SCIENTIFIC {
            return format!("{shown:.1e}{suffix}");
        }
        format!("{}{suffix}", trimmed(shown, significant_decimals(shown.abs(), 3).min(4)))
    }

    /// With its 95 % interval: `22.03 ± 0.02 ms`.
    pub fn show_measured(self, measured: &Measured) -> String {
        self.show_interval(measured.value, self.half_width(measured, 0.95), false)
    }

    /// Always with a sign: `+0.500 ± 0.001°`.
    pub fn show_signed(self, measured: &Measured) -> String {
        self.show_interval(measured.value, self.half_width(measured, 0.95), true)
    }

    /// An [`Estimate`](super::Estimate) with the wider half of its interval.
    pub fn show_within(self, value: f64, interval: Option<[f64; 2]>) -> String {
        match interval {
            Some([low, high]) => self.show_interval(value, (high - value).max(value - low), false),
            None => self.show(value),
        }
    }

    /// Value that always has a sign.
    pub fn show_signed_within(self, value: f64, interval: Option<[f64; 2]>) -> String {
        match interval {
            Some([low, high]) => self.show_interval(value, (high - value).max(value - low), true),
            None if value > 0.0 => format!("+{}", self.show(value)),
            None => self.show(value),
        }
    }

    /// Value with the half-width of its interval.
    pub fn show_interval(self, value: f64, half: f64, signed: bool) -> String {
        if !half.is_finite() {
            return format!("{} ± ?", self.show(value));
        }
        let (factor, suffix) = self.everyday(value.abs().max(half));
        let (value, half) = (value * factor, half * factor);
        let decimals = significant_decimals(half, 1).min(3);
        // The shown interval must cover the actual one.
        let ulp = 10f64.powi(-(decimals as i32));
        let half = ((half / ulp - 1e-9).ceil() * ulp).max(ulp);
        match signed {
            true => unsigned_zero(format!("{value:+.decimals$} ± {half:.decimals$}{suffix}")),
            false => unsigned_zero(format!("{value:.decimals$} ± {half:.decimals$}{suffix}")),
        }
    }

    /// Factor and suffix for a value of this size.
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

/// Limit for decimal notation.
const MIN_SCIENTIFIC: f64 = 1e7;

/// Decimals that show `digits` significant digits of `size`.
fn significant_decimals(size: f64, digits: i32) -> usize {
    if size <= 0.0 || !size.is_finite() {
        return 0;
    }
    let leading = size.log10().floor() as i32;
    (digits - 1 - leading).clamp(0, 12) as usize
}

/// Removes the minus sign of a number rounded to zero.
fn unsigned_zero(text: String) -> String {
    let digits = |c: &char| c.is_ascii_digit() || *c == '.';
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().take_while(digits).all(|c| "0.".contains(c)) => rest.to_owned(),
        _ => text,
    }
}

/// Number with this many decimals, without −0.
pub fn rounded(number: f64, decimals: usize) -> String {
    unsigned_zero(format!("{number:.decimals$}"))
}

/// At most `decimals` decimals, without trailing zeros and −0.
pub(crate) fn trimmed(value: f64, decimals: usize) -> String {
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
    fn amounts_are_shown_in_everyday_units() {
        assert_eq!(Unit::Second.show(0.0231), "23.1 ms");
        assert_eq!(Unit::Second.show(2.5e-5), "25 µs");
        assert_eq!(Unit::Metre.show(0.002), "2 mm");
        assert_eq!(Unit::Metre.show(0.8512), "851 mm");
        assert_eq!(Unit::Radian.show(0.1f64.to_radians()), "0.1°");
        assert_eq!(Unit::RadianPerSecond.show(0.2f64.to_radians() / 60.0), "0.2 °/min");
    }

    #[test]
    fn the_interval_sets_the_digits_and_is_rounded_up() {
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
