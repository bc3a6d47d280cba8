//! Estimates with standard errors, and robust statistics.

mod measured;
pub mod thin;

pub use measured::joint_p_value;
pub use measured::{Measured, MeasuredLength};

/// Standard deviation per median magnitude of normal noise: 1/Φ⁻¹(3/4).
pub const STD_DEV_PER_MEDIAN: f64 = 1.4826;

/// Quantile at `part` (0 to 1); `None` without values. Reorders `values`.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let at = ((values.len() as f64 * share) as usize).min(values.len().checked_sub(1)?);
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// 0 without values.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let add = |(sum, count): (f64, f64), value: f64| (sum + value, count + 1.0);
    let (sum, count) = values.into_iter().fold((0.0, 0.0), add);
    sum / count.max(1.0)
}

/// The upper one of two middle values.
pub fn median(values: &mut [f64]) -> Option<f64> {
    quantile(values, 0.5)
}

/// [`median`] of any values.
pub fn median_of(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    median(&mut Vec::from_iter(values))
}

/// Item with the lowest value; the first of equal ones.
pub fn lowest<T>(
    items: impl IntoIterator<Item = T>,
    mut value: impl FnMut(&T) -> f64,
) -> Option<T> {
    let valued = items.into_iter().map(|item| (value(&item), item));
    Some(valued.min_by(|a, b| a.0.total_cmp(&b.0))?.1)
}

/// Item with the highest value; the last of equal ones.
pub fn highest<T>(
    items: impl IntoIterator<Item = T>,
    mut value: impl FnMut(&T) -> f64,
) -> Option<T> {
    let valued = items.into_iter().map(|item| (value(&item), item));
    Some(valued.max_by(|a, b| a.0.total_cmp(&b.0))?.1)
}

/// Minimum of the parabola through three evenly spaced values, in intervals from the middle one. 0 without a minimum.
pub fn parabola_minimum([before, at, after]: [f64; 3]) -> f64 {
    let curvature = before - 2.0 * at + after;
    if curvature > 0.0 { 0.5 * (before - after) / curvature } else { 0.0 }
}

/// Sums of the values before each one, and of all: one entry more than values.
pub fn cumulative(values: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let mut sum = 0.0;
    let sums = values.into_iter().map(|value| {
        sum += value;
        sum
    });
    std::iter::once(0.0).chain(sums).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_quantile_has_its_share_of_values_below(
            mut values in prop::collection::vec(-1e9..1e9_f64, 1..60),
            part in 0.0..=1.0_f64,
        ) {
            let found = quantile(&mut values, part).expect("some");
            let below = values.iter().filter(|value| **value < found).count();
            let above = values.iter().filter(|value| **value > found).count();
            let rank = values.len() as f64 * part;
            prop_assert!(below as f64 <= rank && (values.len() - above) as f64 >= rank.floor());
        }
    }

    #[test]
    fn an_empty_series_has_no_median() {
        assert_eq!(median(&mut []), None);
        assert_eq!(median(&mut [3.0, 1.0, 2.0, 9.0]), Some(3.0));
    }
}
