//! Compares the stamps of joint states with their positions and velocities: an even grid, as of generated stamps, pauses
//! of the recorder that such stamps hide, and resampled values with new stamps.

use std::borrow::Cow;
use std::sync::Arc;

use super::joints::velocities;
use crate::diagnosis::{EstimateResult, Measured, VelocityDiagnosis, VelocityShape, encoder_step};
use crate::run::JointSamples;
use crate::stats::{mean, median};
use crate::stream::sample_noise;

/// Properties of the stamps, found by positions and velocities.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointStamps {
    /// Rate of stamps that are an even grid, Hz.
    pub even_rate_hz: Option<f64>,
    /// Pauses without a gap in the stamps.
    pub pauses: Option<HiddenPauses>,
    /// Rows whose stamps are not the times of their values.
    pub resampling: Option<Resampling>,
}

/// Pauses of a recorder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HiddenPauses {
    /// Their number.
    pub count: usize,
    /// Median length beyond the stamps' step, s.
    pub typical_s: f64,
}

/// Resampled values with new stamps: between two rows, all joints move for another time than the stamps step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Resampling {
    /// Rows in motion.
    pub rows: usize,
    /// Those that repeat the positions and velocities of the previous row.
    pub repeated: usize,
    /// Rate of the rows, Hz.
    pub rows_hz: f64,
    /// Rate of the rows that do not repeat, Hz.
    pub values_hz: f64,
    /// Rms difference between the steps of the values and of the stamps, s.
    pub step_error_s: f64,
    /// Errors of the joints' velocities at the stamps, relative to their rates.
    pub velocity_errors: Vec<Measured>,
}

/// Smallest speed of a moving joint, or of all joints together, relative to its rms.
const MIN_SPEED_SHARE: f64 = 0.2;

/// Stamps of the joint states, and their velocities compared with the positions at the times that the stamps hide, if there
/// are any. Positions change at `change_points`.
pub(super) fn stamps_and_velocities(
    samples: &[JointSamples<'_>],
    change_points: &[Vec<f64>],
) -> (JointStamps, Vec<Option<EstimateResult<VelocityDiagnosis>>>) {
    let (stamps, at_true_times) = joint_stamps(samples);
    let found = velocities(at_true_times.as_deref().unwrap_or(samples), change_points);
    let measured = || found.iter().flatten().flatten();
    if at_true_times.is_some() || !measured().any(|it| it.shape == VelocityShape::Unrelated) {
        return (stamps, found);
    }
    match resampling(samples) {
        Some((resampling, at_true_times)) => {
            let velocity_errors = measured().map(|it| it.error).collect();
            let resampling = Some(Resampling { velocity_errors, ..resampling });
            (JointStamps { resampling, ..stamps }, velocities(&at_true_times, change_points))
        }
        None => (stamps, found),
    }
}

/// Also returns the samples at the times that the pauses give, if there are any.
fn joint_stamps<'a>(samples: &[JointSamples<'a>]) -> (JointStamps, Option<Vec<JointSamples<'a>>>) {
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
        return (JointStamps { even_rate_hz, ..JointStamps::default() }, None);
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
    (JointStamps { even_rate_hz, pauses, resampling: None }, Some(at_times.collect()))
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
    /// Smallest motion of a pause, relative to the motion in one step.
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

/// Motion of a joint between successive rows.
struct RowMotion<'a> {
    joint: &'a JointSamples<'a>,
    /// Changes of position, rad or m.
    moved: Vec<f64>,
    /// Mean velocities, scaled to the positions; 0 across gaps.
    rate: Vec<f64>,
}

impl<'a> RowMotion<'a> {
    /// `None` without velocities in all rows, or if they are zero.
    fn new(joint: &'a JointSamples<'a>, stamped_s: &[f64]) -> Option<Self> {
        /// Steps of a gap; velocities in it are unknown.
        const MIN_GAP_STEPS: f64 = 5.0;
        let longest_s = MIN_GAP_STEPS * median(&mut stamped_s.to_vec())?;
        let moved = joint.position.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let average = |(pair, step_s): (&[f64], &f64)| match *step_s > longest_s {
            true => 0.0,
            false => 0.5 * (pair[0] + pair[1]),
        };
        let rate: Vec<f64> = joint.velocity.windows(2).zip(stamped_s).map(average).collect();
        let is_known = rate.len() == stamped_s.len() && rate.iter().all(|rate| rate.is_finite());
        (is_known && rate.iter().any(|rate| *rate != 0.0)).then_some(Self { joint, moved, rate })
    }

    /// Motion times rate, and squared rate.
    fn products(&self) -> impl Iterator<Item = [f64; 2]> {
        self.moved.iter().zip(&self.rate).map(|(moved, rate)| [moved * rate, rate * rate])
    }

    /// Scales the rates to the motion in `steps_s`, so that a wrong unit or sign does not look like a wrong time.
    fn scale_to(&mut self, steps_s: &[f64]) {
        let mut sums = [0.0; 2];
        for ([along, square], step_s) in self.products().zip(steps_s) {
            sums[0] += along * step_s;
            sums[1] += square * step_s * step_s;
        }
        if sums[1] > 0.0 {
            self.rate.iter_mut().for_each(|rate| *rate *= sums[0] / sums[1]);
        }
    }

    fn squared_error(&self, row: usize, step_s: f64) -> f64 {
        (self.moved[row] - self.rate[row] * step_s).powi(2)
    }

    fn repeats(&self, row: usize) -> bool {
        let JointSamples { position, velocity, .. } = self.joint;
        position[row] == position[row + 1] && velocity[row] == velocity[row + 1]
    }
}

/// Sums over joints that give the time steps of rows by least squares.
struct StepSums {
    /// [`RowMotion::products`] of each row.
    sums: Vec<[f64; 2]>,
    min_square: f64,
}

impl StepSums {
    fn new(motions: &[RowMotion<'_>], rows: usize) -> Self {
        let mut sums = vec![[0.0; 2]; rows];
        for motion in motions {
            for (sum, own) in sums.iter_mut().zip(motion.products()) {
                *sum = [sum[0] + own[0], sum[1] + own[1]];
            }
        }
        let min_square = MIN_SPEED_SHARE.powi(2) * mean(sums.iter().map(|sum| sum[1]));
        Self { sums, min_square }
    }

    /// `None` near rest.
    fn step_s(&self, [along, square]: [f64; 2]) -> Option<f64> {
        (square > self.min_square).then(|| along / square)
    }

    /// Steps of the rows in motion, scaled to the sum of their stamped steps: a common factor is an error of the
    /// velocities. Other rows keep their stamped steps.
    fn steps_s(&self, stamped_s: &[f64]) -> Vec<f64> {
        let own_s: Vec<Option<f64>> = self.sums.iter().map(|sum| self.step_s(*sum)).collect();
        let moving = own_s.iter().zip(stamped_s).filter(|(own_s, _)| own_s.is_some());
        let stamped_sum_s: f64 = moving.map(|(_, stamped_s)| stamped_s).sum();
        let factor = stamped_sum_s / own_s.iter().flatten().sum::<f64>();
        let steps = own_s.iter().zip(stamped_s);
        steps.map(|(own_s, stamped_s)| own_s.map_or(*stamped_s, |own_s| factor * own_s)).collect()
    }
}

/// Estimates one time step for each row from the motion and velocities of all joints, and returns the samples at these times,
/// without repeats. `None` if the steps from the other joints do not explain most of a joint's error at the stamps.
fn resampling<'a>(joints: &[JointSamples<'a>]) -> Option<(Resampling, Vec<JointSamples<'a>>)> {
    /// Scales of velocities and steps depend on each other little.
    const ROUNDS: usize = 3;
    /// Share of the squared error that the steps may leave.
    const MAX_RESIDUAL_RATIO: f64 = 0.2;
    /// Between successive deviations from the stamps. If the joints move in proportion, steps also explain velocities that
    /// lag or are filtered, but these steps vary smoothly; the steps of resampled values do not.
    const MAX_CORRELATION: f64 = 0.5;
    /// Of a usual step; in less, a row has no new value.
    const MIN_STEP_SHARE: f64 = 0.1;
    let t_s = JointSamples::common_times(joints)?;
    let stamped_s: Vec<f64> = t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let usual_s = median(&mut stamped_s.clone())?;
    let mut motions: Vec<RowMotion<'_>> =
        joints.iter().filter_map(|joint| RowMotion::new(joint, &stamped_s)).collect();
    let mut steps_s = stamped_s.clone();
    for _ in 0..ROUNDS {
        motions.iter_mut().for_each(|motion| motion.scale_to(&steps_s));
        steps_s = StepSums::new(&motions, stamped_s.len()).steps_s(&stamped_s);
    }
    motions.iter_mut().for_each(|motion| motion.scale_to(&steps_s));
    let of_all = StepSums::new(&motions, stamped_s.len());
    let is_moving = |row: &usize| of_all.step_s(of_all.sums[*row]).is_some();
    let moving: Vec<usize> = (0..stamped_s.len()).filter(is_moving).collect();
    let (mut left, mut at_stamps) = (0.0, 0.0);
    for motion in &motions {
        let own: Vec<[f64; 2]> = motion.products().collect();
        for &row in &moving {
            let ([along, square], own) = (of_all.sums[row], own[row]);
            let by_others_s = of_all.step_s([along - own[0], square - own[1]]);
            left += motion.squared_error(row, by_others_s.unwrap_or(stamped_s[row]));
            at_stamps += motion.squared_error(row, stamped_s[row]);
        }
    }
    let mut error_s = vec![0.0; stamped_s.len()];
    moving.iter().for_each(|&row| error_s[row] = steps_s[row] - stamped_s[row]);
    let square_s2: f64 = error_s.iter().map(|error_s| error_s * error_s).sum();
    let successive_s2: f64 = error_s.windows(2).map(|pair| pair[0] * pair[1]).sum();
    let explains =
        left < MAX_RESIDUAL_RATIO * at_stamps && successive_s2 < MAX_CORRELATION * square_s2;
    if !explains {
        return None;
    }
    let repeats = |row: &&usize| motions.iter().all(|motion| motion.repeats(**row));
    let (rows, repeated) = (moving.len(), moving.iter().filter(repeats).count());
    let seconds: f64 = moving.iter().map(|&row| stamped_s[row]).sum();
    let resampling = Resampling {
        rows,
        repeated,
        rows_hz: rows as f64 / seconds,
        values_hz: (rows - repeated) as f64 / seconds,
        step_error_s: (square_s2 / rows as f64).sqrt(),
        velocity_errors: Vec::new(),
    };
    // A new stamp is at most one value late. Longer steps are jumps of the positions, as of another unit.
    if resampling.step_error_s * resampling.values_hz > 1.0 {
        return None;
    }
    let (mut kept, mut kept_s, mut now_s) = (vec![0], vec![t_s[0]], t_s[0]);
    for (row, step_s) in (1..).zip(&steps_s) {
        now_s += step_s;
        if now_s - kept_s[kept_s.len() - 1] > MIN_STEP_SHARE * usual_s {
            kept.push(row);
            kept_s.push(now_s);
        }
    }
    let t_s: Arc<[f64]> = kept_s.into();
    let at_times = joints.iter().map(|joint| {
        let of_kept = |values: &[f64]| -> Cow<'a, [f64]> {
            kept.iter().filter_map(|&row: &usize| values.get(row).copied()).collect()
        };
        JointSamples {
            t_s: Arc::clone(&t_s),
            position: of_kept(&joint.position),
            velocity: of_kept(&joint.velocity),
        }
    });
    Some((resampling, at_times.collect()))
}

#[cfg(test)]
mod tests {
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

    /// Four joints that swing at `rates`, or in proportion at the first one, read from a source of `source_hz` into rows of
    /// 30 Hz, with velocities that are `late_s` late and multiplied by `gains`.
    fn read(
        source_hz: f64,
        is_proportional: bool,
        late_s: f64,
        gains: [f64; 4],
    ) -> Vec<JointSamples<'static>> {
        let rates = if is_proportional { [1.1; 4] } else { [0.9, 1.4, 0.6, 1.1] };
        let t_s: Arc<[f64]> = (0..600).map(|row| row as f64 / 30.0).collect();
        let read_s = |t_s: &f64| (t_s * source_hz + 0.3).floor() / source_hz;
        let joint = |(rate, gain): (f64, f64)| {
            let velocity = |t_s: f64| gain * rate * (rate * (t_s - late_s)).cos();
            JointSamples {
                t_s: Arc::clone(&t_s),
                position: t_s.iter().map(|t_s| (rate * read_s(t_s)).sin()).collect(),
                velocity: t_s.iter().map(|t_s| velocity(read_s(t_s))).collect(),
            }
        };
        rates.into_iter().zip(gains).map(joint).collect()
    }

    fn judge(samples: &[JointSamples<'_>]) -> (Option<Resampling>, Vec<VelocityDiagnosis>) {
        let (stamps, velocities) = stamps_and_velocities(samples, &vec![Vec::new(); samples.len()]);
        let velocities = velocities.into_iter().map(|found| found.expect("some").expect("motion"));
        (stamps.resampling, velocities.collect())
    }

    #[test]
    fn values_sampled_anew_are_compared_at_their_own_times() {
        for (source_hz, repeated, values_hz) in [(29.3, 14, 29.3), (31.1, 0, 30.0)] {
            let (found, velocities) = judge(&read(source_hz, false, 0.0, [1.0; 4]));
            let found = found.expect("a resampling");
            assert_eq!(found.repeated, repeated, "{found:?}");
            assert!((found.values_hz - values_hz).abs() < 0.05, "{found:?}");
            assert!((found.rows_hz - 30.0).abs() < 0.01, "{found:?}");
            assert!((0.004..0.007).contains(&found.step_error_s), "{found:?}");
            assert!(found.velocity_errors.iter().any(|error| error.value > 0.05), "{found:?}");
            for velocity in velocities {
                assert_eq!(velocity.shape, VelocityShape::Rates, "{velocity:?}");
            }
        }
    }

    #[test]
    fn a_wrong_scale_is_found_beside_values_sampled_anew() {
        let (found, velocities) = judge(&read(29.3, false, 0.0, [1.0, 1.1, -1.0, 1.0]));
        assert!(found.is_some());
        let gains = velocities.iter().map(|found| match found.shape {
            VelocityShape::Rates => 1.0,
            VelocityShape::Scaled(gain) => gain,
            other => panic!("{other:?}"),
        });
        for (gain, expected) in gains.zip([1.0, 1.1, -1.0, 1.0]) {
            assert!((gain - expected).abs() < 0.01, "{gain} {expected}");
        }
    }

    #[test]
    fn late_or_scaled_velocities_are_no_wrong_stamps() {
        for late_s in [0.02, 0.06, 0.2] {
            for is_proportional in [false, true] {
                let samples = read(30.0, is_proportional, late_s, [1.0; 4]);
                assert!(resampling(&samples).is_none(), "{late_s} {is_proportional}");
            }
        }
        for gains in [[57.3; 4], [1.0, 1.1, 1.0, 1.0]] {
            assert!(resampling(&read(30.0, false, 0.0, gains)).is_none(), "{gains:?}");
        }
    }
}
