//! Squared differences between the speeds of arm and stream at a latency.

use super::correlation::SpeedSeries;

pub(crate) const MAX_PROFILE_SAMPLES: usize = 4000;
/// After compensation, as a fraction of the speeds' variation.
pub(crate) const MAX_SPEED_RESIDUAL_SHARE: f64 = 0.15;

pub(crate) fn squared_residual(
    arm: &SpeedSeries,
    stream: &SpeedSeries,
    lag_s: &dyn Fn(f64) -> f64,
) -> f64 {
    differences(arm, stream, &fit_rows(stream), lag_s).iter().sum()
}

pub(crate) fn fit_rows(stream: &SpeedSeries) -> Vec<usize> {
    (0..stream.t_s.len()).step_by(stream.t_s.len().div_ceil(MAX_PROFILE_SAMPLES).max(1)).collect()
}

pub(crate) fn squared_deviation(speed: &SpeedSeries, rows: &[usize]) -> f64 {
    let values = || rows.iter().map(|&row| speed.value[row]);
    let mean = values().sum::<f64>() / rows.len().max(1) as f64;
    values().map(|value| (value - mean).powi(2)).sum()
}

/// Squared differences of the two speeds at a lag. 0 if the arm's speed is unknown.
pub(crate) fn differences(
    arm: &SpeedSeries,
    stream: &SpeedSeries,
    rows: &[usize],
    lag_s: impl Fn(f64) -> f64,
) -> Vec<f64> {
    /// For interpolation, s.
    const MAX_GAP_S: f64 = 0.5;
    let mut after = 0;
    let arm_at = |t_s: f64, after: &mut usize| {
        while arm.t_s.get(*after).is_some_and(|own| *own < t_s) {
            *after += 1;
        }
        while *after > 0 && arm.t_s[*after - 1] >= t_s {
            *after -= 1;
        }
        let before = after.checked_sub(1)?;
        let (a_s, b_s) = (arm.t_s[before], *arm.t_s.get(*after)?);
        let part = (t_s - a_s) / (b_s - a_s);
        (b_s - a_s < MAX_GAP_S)
            .then(|| arm.value[before] + part * (arm.value[*after] - arm.value[before]))
    };
    let pairs: Vec<Option<(f64, f64)>> = rows
        .iter()
        .map(|&row| {
            Some((arm_at(stream.t_s[row] - lag_s(stream.t_s[row]), &mut after)?, stream.value[row]))
        })
        .collect();
    let square = |of: fn(&(f64, f64)) -> f64| pairs.iter().flatten().map(of).sum::<f64>();
    // The stream may use another length unit.
    let scale = (square(|pair| pair.0 * pair.0) / square(|pair| pair.1 * pair.1)).sqrt();
    let scale = if (0.5..2.0).contains(&scale) || !scale.is_finite() { 1.0 } else { scale };
    pairs
        .into_iter()
        .map(|pair| pair.map_or(0.0, |(arm, stream)| (stream - arm / scale).powi(2)))
        .collect()
}
