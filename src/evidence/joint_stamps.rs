//! Compares the stamps of joint states with their positions and velocities: an even grid, as of generated stamps, and pauses
//! of the recorder that such stamps hide.

use std::sync::Arc;

use crate::diagnosis::encoder_step;
use crate::run::JointSamples;
use crate::stats::{mean, median};
use crate::stream::sample_noise;

/// Properties of the stamps, found by positions and velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointStamps {
    /// Rate of stamps that are an even grid, Hz.
    pub even_rate_hz: Option<f64>,
    /// Pauses without a gap in the stamps.
    pub pauses: Option<HiddenPauses>,
}

/// Pauses of a recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenPauses {
    /// Their number.
    pub count: usize,
    /// Median length beyond the stamps' step, s.
    pub typical_s: f64,
}

/// Also returns the samples at the times that the pauses give, if there are any.
pub(super) fn joint_stamps<'a>(
    samples: &[JointSamples<'a>],
) -> (JointStamps, Option<Vec<JointSamples<'a>>>) {
    /// Share of the rows. Rows of positions that are read more rarely than velocities all look like pauses.
    const MAX_PAUSED_PERCENT: usize = 10;
    /// Fewer may be other jumps of the positions.
    const MIN_PAUSES: usize = 5;
    let Some(t_s) = JointSamples::common_times(samples) else {
        return (JointStamps::default(), None);
    };
    let even_rate_hz = even_rate_hz(t_s);
    let pauses = pauses(samples);
    if pauses.len() < MIN_PAUSES || 100 * pauses.len() > MAX_PAUSED_PERCENT * t_s.len() {
        return (JointStamps { even_rate_hz, pauses: None }, None);
    }
    let mut lengths_s: Vec<f64> = pauses.iter().map(|(_, length_s)| *length_s).collect();
    let typical_s = median(&mut lengths_s).unwrap_or(0.0);
    let (mut next, mut late_s) = (pauses.iter().peekable(), 0.0);
    let with_pauses = t_s.iter().enumerate().map(|(row, t_s)| {
        if let Some((_, length_s)) = next.next_if(|(at, _)| *at == row) {
            late_s += length_s;
        }
        t_s + late_s
    });
    let t_s: Arc<[f64]> = with_pauses.collect();
    let at_times = samples.iter().map(|it| JointSamples { t_s: Arc::clone(&t_s), ..it.clone() });
    let pauses = Some(HiddenPauses { count: pauses.len(), typical_s });
    (JointStamps { even_rate_hz, pauses }, Some(at_times.collect()))
}

fn even_rate_hz(t_s: &[f64]) -> Option<f64> {
    /// Share of a step; stamps in ns are rounded.
    const MAX_DEVIATION: f64 = 2e-3;
    let steps = || t_s.windows(2).map(|pair| pair[1] - pair[0]);
    let step_s = median(&mut steps().collect::<Vec<f64>>())?;
    let is_even = steps().all(|own| (own - step_s).abs() <= MAX_DEVIATION * step_s);
    (is_even && step_s > 0.0).then_some(1.0 / step_s)
}

/// Rows before which all moving joints advance as far as their velocities take them in many rows, while they follow their
/// velocities in the rows around. With the time that is missing, s.
fn pauses(joints: &[JointSamples<'_>]) -> Vec<(usize, f64)> {
    /// Smallest speed of a moving joint, relative to its rms speed.
    const MIN_SPEED_SHARE: f64 = 0.2;
    /// Smallest motion of a pause, relative to that of one step.
    const MIN_STEPS: f64 = 5.0;
    /// Smallest jump of positions, relative to their resolution and noise.
    const MIN_ENCODER_STEPS: f64 = 4.0;
    const MIN_NOISE_SIGMAS: f64 = 10.0;
    /// Rows on each side, and the allowed ratio of their motion to their velocities.
    const AROUND: usize = 4;
    const USUAL_RATIO: std::ops::RangeInclusive<f64> = 0.5..=1.5;
    let rows = joints.first().map_or(0, |joint| joint.t_s.len());
    let moving: Vec<(&JointSamples<'_>, f64, f64)> = joints
        .iter()
        .filter(|joint| joint.velocity.len() == rows)
        .filter_map(|joint| {
            let known = joint.velocity.iter().filter(|v| v.is_finite());
            let square = mean(known.map(|v| v * v));
            let min_jump = (MIN_ENCODER_STEPS * encoder_step(&joint.position))
                .max(MIN_NOISE_SIGMAS * sample_noise(&joint.position));
            (square > 0.0).then(|| (joint, MIN_SPEED_SHARE * square.sqrt(), min_jump))
        })
        .collect();
    let step_s = |joint: &JointSamples<'_>, row: usize| joint.t_s[row] - joint.t_s[row - 1];
    let by_velocity = |joint: &JointSamples<'_>, row: usize| {
        0.5 * (joint.velocity[row] + joint.velocity[row - 1]) * step_s(joint, row)
    };
    let moved =
        |joint: &JointSamples<'_>, row: usize| joint.position[row] - joint.position[row - 1];
    let ratio = |joint: &JointSamples<'_>, rows: &mut dyn Iterator<Item = usize>| {
        let (own, by) = rows.fold((0.0, 0.0), |(own, by), row| {
            (own + moved(joint, row), by + by_velocity(joint, row))
        });
        own / by
    };
    let is_pause = |row: usize| -> Option<(usize, f64)> {
        let mut ratios = Vec::new();
        for &(joint, min_speed, min_jump) in &moving {
            if by_velocity(joint, row).abs() < min_speed * step_s(joint, row) {
                continue;
            }
            let own = ratio(joint, &mut std::iter::once(row));
            let mut around = (row - AROUND..row).chain(row + 1..=row + AROUND);
            let is_jump = own > MIN_STEPS
                && moved(joint, row).abs() > min_jump
                && USUAL_RATIO.contains(&ratio(joint, &mut around));
            if !is_jump {
                return None;
            }
            ratios.push(own);
        }
        let joint = moving.first()?.0;
        Some((row, (median(&mut ratios)? - 1.0) * step_s(joint, row)))
    };
    (AROUND + 1..rows.saturating_sub(AROUND)).filter_map(is_pause).collect()
}

#[cfg(test)]
mod tests {
    use std::borrow::Cow;

    use super::*;

    /// Two swinging joints, with pauses of 40 ms after each `every` rows that the stamps do not show.
    fn samples(every: usize, in_rad: f64) -> Vec<JointSamples<'static>> {
        let t_s: Arc<[f64]> = (0..2000).map(|row| 0.002 * row as f64).collect();
        let joint = |rate: f64| {
            let true_s = |row: usize| 0.002 * row as f64 + 0.04 * (row / every) as f64;
            let position = (0..2000).map(|row| (rate * true_s(row)).sin());
            let rounded: Vec<f64> = position.map(|q| (q / in_rad).round() * in_rad).collect();
            let velocity: Vec<f64> =
                (0..2000).map(|row| rate * (rate * true_s(row)).cos()).collect();
            JointSamples {
                t_s: Arc::clone(&t_s),
                position: Cow::Owned(rounded),
                velocity: Cow::Owned(velocity),
            }
        };
        vec![joint(0.9), joint(1.4)]
    }

    #[test]
    fn pauses_without_gaps_are_found_and_give_the_true_times() {
        let (found, at_times) = joint_stamps(&samples(50, 1e-6));
        let pauses = found.pauses.expect("pauses");
        assert!((30..40).contains(&pauses.count), "{pauses:?}");
        assert!((pauses.typical_s - 0.04).abs() < 1e-3, "{pauses:?}");
        assert!((found.even_rate_hz.expect("even") - 500.0).abs() < 1e-6);
        let last_s = at_times.expect("true times")[0].t_s[1999];
        assert!((last_s - (3.998 + 0.04 * pauses.count as f64)).abs() < 0.02, "{last_s}");
    }

    #[test]
    fn a_coarse_encoder_or_a_few_jumps_are_no_pauses() {
        for samples in [samples(2000, 1e-3), samples(2000, 1e-6), samples(600, 1e-6)] {
            let (found, at_times) = joint_stamps(&samples);
            assert!(found.pauses.is_none() && at_times.is_none(), "{found:?}");
        }
    }
}
