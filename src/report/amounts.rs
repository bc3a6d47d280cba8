use crate::finding::{Estimate, Unit};

/// In everyday units with the 95 % interval. An encoding shows the actual and the assumed one.
pub(crate) fn format_estimate(estimate: &Estimate) -> String {
    match estimate {
        Estimate::Scalar { name, value, unit, ci95, .. } => {
            format_amount(unit, name, *value, *ci95)
        }
        Estimate::Frame { name, value, unit, ci95, rotation, .. } => {
            let length = format_amount(unit, name, *value, *ci95);
            let angle = format_amount(Unit::Radian.symbol(), name, rotation.value, rotation.ci95);
            format!("{length}; {angle}")
        }
        Estimate::Convention { is, read_as, .. } => format_interpretation(is, read_as),
        Estimate::Misinterpretation { is, read_as, .. } => format_interpretation(is, read_as),
        Estimate::Order { is, read_as, .. } => {
            format_interpretation(&is.join(", "), &read_as.join(", "))
        }
    }
}

pub(crate) fn format_interpretation(is: &str, read_as: &str) -> String {
    format!("{is} read as {read_as}")
}

/// `15.0 ± 0.2 ms`. Symbols without a [`Unit`] are appended as they are.
pub(crate) fn format_amount(
    symbol: &str,
    name: &str,
    value: f64,
    ci95: Option<[f64; 2]>,
) -> String {
    match (Unit::from_symbol(symbol, name), ci95) {
        // The lower end of a length is clipped at zero.
        (Some(unit), Some([_, high])) => unit.show_interval(value, high - value, false),
        (Some(unit), None) => unit.show(value),
        (None, _) => format!("{value:.3} {symbol}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_have_everyday_units_and_half_widths() {
        assert_eq!(format_amount("s", "latency", 0.015, Some([0.014, 0.016])), "15 ± 1 ms");
        assert_eq!(format_amount("rad/s", "gyro bias", 1f64.to_radians(), None), "1 °/s");
        assert_eq!(format_amount("rad/s", "yaw drift", 1f64.to_radians() / 60.0, None), "1 °/min");
        assert_eq!(format_amount("Hz", "rate", 20.0, None), "20.000 Hz");
    }
}
