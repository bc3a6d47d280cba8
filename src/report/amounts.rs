use crate::finding::{Amount, Estimate};

/// In everyday units with the 95 % interval. An encoding shows the actual and the assumed one.
pub(crate) fn format_estimate(estimate: &Estimate) -> String {
    match estimate.interpretation() {
        Some([is, read_as]) => format!("{is} read as {read_as}"),
        None => estimate.amounts().iter().map(format_amount).collect::<Vec<_>>().join("; "),
    }
}

/// `15.0 ± 0.2 ms`. Unknown symbols are appended as they are.
pub(crate) fn format_amount(amount: &Amount) -> String {
    let Amount { symbol, value, ci95, .. } = *amount;
    match (amount.unit(), ci95) {
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
        let shown =
            |symbol, name, value, ci95| format_amount(&Amount { name, symbol, value, ci95 });
        assert_eq!(shown("s", "latency", 0.015, Some([0.014, 0.016])), "15 ± 1 ms");
        assert_eq!(shown("rad/s", "gyro bias", 1f64.to_radians(), None), "1 °/s");
        assert_eq!(shown("rad/s", "yaw drift", 1f64.to_radians() / 60.0, None), "1 °/min");
        assert_eq!(shown("Hz", "rate", 20.0, None), "20.000 Hz");
    }
}
