//! Checks whether velocities are the derivatives of the positions, and classifies the error. Integrated
//! velocities are compared with position changes over windows, so encoder noise enters only twice per
//! window and velocity noise averages out.

use super::response::{ResponseChanges, TimeSeries, slopes};
use crate::latency::correlation::median_period_s;
use crate::samples::sampling::{check_sample_count, row_blocks, value_range};
use crate::{NotObservable, Response};
use ground::stats::{Measured, cumulative, lowest, mean, quantile};
use ground::stream::sample_noise;
use nalgebra::Vector6;

/// Samples of one joint.
#[derive(Clone, Copy, Debug)]
pub struct VelocitySamples<'a> {
    /// s, strictly increasing.
    pub t_s: &'a [f64],
    /// rad or m.
    pub position: &'a [f64],
    /// rad/s or m/s; NaN if missing.
    pub velocity: &'a [f64],
    /// Known position jumps, s. Windows exclude them.
    pub breaks: &'a [f64],
}

impl VelocitySamples<'_> {
    /// Positions over time.
    fn curve(&self) -> TimeSeries {
        TimeSeries::new(self.t_s.to_vec(), vec![self.position.to_vec()])
    }
}

/// Comparison of velocities with position derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocityDiagnosis {
    /// Rms of velocity minus position rate, over rms rate, in the band of the motion. Without noise,
    /// quantisation and stamp jitter.
    pub error: Measured,
    /// Error expected from those three.
    pub noise: f64,
    /// Rms position rate, rad/s or m/s.
    pub rate: f64,
    /// Window length, s.
    pub window_s: f64,
    /// Classification.
    pub shape: VelocityShape,
}

/// Relation of velocities to positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VelocityShape {
    /// Derivatives, within the uncertainty.
    Rates,
    /// Zero or nearly zero.
    Zero,
    /// One value throughout, not zero, rad/s or m/s.
    Constant(f64),
    /// Derivatives times a factor.
    Scaled(f64),
    /// Derivatives of another joint, times a factor.
    OfJoint(usize, f64),
    /// Derivatives with delay, low-pass and gain.
    Filtered(Response),
    /// None of these.
    Unrelated,
}

/// Smaller errors need no cause, or may be a finite difference.
const MIN_RELATIVE_ERROR: f64 = 0.02;
const MIN_GAP_INTERVALS: f64 = 5.0;
/// Half-width of the interval.
const INTERVAL_STD_ERRORS: f64 = 1.9;
const MAX_LAG_S: f64 = 0.5;

/// Compares velocities of joint `index` with its positions. `joints` are all joints, whose velocities may
/// be permuted.
///
/// # Errors
/// If the joint barely moves or has too few velocities.
pub fn diagnose_velocity(
    joints: &[VelocitySamples<'_>],
    index: usize,
) -> Result<VelocityDiagnosis, NotObservable> {
    let own = joints.get(index).ok_or(NotObservable::AtRest)?;
    let windows = VelocityWindows::from_samples(own)?;
    let VelocityWindows { window_s, noise, ref changes, ref moved } = windows;
    let moved_square = mean_square(moved.iter().copied());
    let rate_square = moved_square - 2.0 * noise.position;
    let by_noise = noise.window_variance(window_s, moved_square) / rate_square;
    let error_of = |moved: &mut dyn Iterator<Item = f64>| {
        mean_square(changes.changes.iter().zip(moved).map(|(by, q)| by[0] - q)) / rate_square
    };
    let as_recorded = error_of(&mut moved.iter().copied());
    let half_s = 0.5 * median_period_s(own.t_s);
    let curve = own.curve();
    // A difference of samples is the rate midway.
    let of_difference = [-half_s, half_s].map(|delay_s| {
        let shifted = changes.references(&curve, delay_s).into_iter();
        error_of(&mut shifted.map(|at| at.map_or(f64::NAN, |at| at[0])))
    });
    let shifted = of_difference.into_iter().fold(f64::INFINITY, f64::min);
    let is_difference = shifted - by_noise < MIN_RELATIVE_ERROR * MIN_RELATIVE_ERROR;
    let square = if is_difference { shifted.min(as_recorded) } else { as_recorded };
    let square = (square - by_noise).max(0.0);
    let value = square.sqrt();
    // Noise variance is known to ±50 %. Overlapping windows count once.
    let count = (0.5 * moved.len() as f64).max(1.0);
    let variance = 4.0 * square * by_noise / count + (0.5 * by_noise).powi(2);
    let [highest, lowest] =
        [1.0, -1.0].map(|sign| (square + sign * 2.0 * variance.sqrt()).max(0.0).sqrt());
    // The root may be zero as well.
    let std_error = (highest - value).max(value - lowest) / INTERVAL_STD_ERRORS;
    let shape = match value < MIN_RELATIVE_ERROR {
        true => VelocityShape::Rates,
        false => shape(joints, index, &windows, &curve, by_noise * rate_square),
    };
    Ok(VelocityDiagnosis {
        error: Measured { value, std_error, dof: count },
        noise: by_noise.sqrt(),
        rate: rate_square.sqrt() / window_s,
        window_s,
        shape,
    })
}

/// Of finite values.
fn mean_square(values: impl IntoIterator<Item = f64>) -> f64 {
    let finite = values.into_iter().filter(|value| value.is_finite());
    mean(finite.map(|value| value * value))
}

#[derive(Clone, Copy, Debug)]
struct Noise {
    /// rad² or m².
    position: f64,
    /// Variance of the integral per second, rad²/s or m²/s.
    velocity: f64,
    /// s².
    stamp: f64,
    /// Interpolation, as a squared change.
    between: f64,
}

impl Noise {
    /// Variance of integral minus position change; `moved` is the mean squared change.
    fn window_variance(&self, window_s: f64, moved: f64) -> f64 {
        let by_stamps = 2.0 * self.stamp * moved / (window_s * window_s);
        2.0 * self.position + self.velocity * window_s + by_stamps + self.between
    }
}

#[derive(Debug)]
struct VelocityWindows {
    window_s: f64,
    /// Integrals of velocity.
    changes: ResponseChanges,
    /// Position changes, rad or m.
    moved: Vec<f64>,
    noise: Noise,
}

impl VelocityWindows {
    fn from_samples(joint: &VelocitySamples<'_>) -> Result<Self, NotObservable> {
        /// Travel of a moving joint, rad or m.
        const MIN_TRAVEL: f64 = 5e-3;
        const MIN_WINDOWS: usize = 20;
        /// Windows grow until this noise-to-change ratio.
        const WINDOW_LENGTH_LIMITS_S: (f64, f64) = (0.1, 0.5);
        const WINDOW_GROWTH: f64 = 1.5;
        const MAX_NOISE_RATIO: f64 = 0.01;
        let known: Vec<usize> = (0..joint.t_s.len().min(joint.velocity.len()))
            .filter(|&row| joint.velocity[row].is_finite() && joint.position[row].is_finite())
            .collect();
        check_sample_count(known.len(), MIN_WINDOWS)?;
        let of = |values: &[f64]| known.iter().map(|&row| values[row]).collect::<Vec<f64>>();
        let (t_s, q, v) = (of(joint.t_s), of(joint.position), of(joint.velocity));
        let noise = noise(&t_s, &q, &v);
        if value_range(q.iter().copied()) < MIN_TRAVEL.max(8.0 * noise.position.sqrt()) {
            return Err(NotObservable::AtRest);
        }
        let gap_s = MIN_GAP_INTERVALS * median_period_s(&t_s);
        // Unknown velocity in a gap, unknown position across a break.
        let is_gap = |pair: &&[f64]| {
            let mut breaks = joint.breaks.iter();
            pair[1] - pair[0] > gap_s || breaks.any(|at| (pair[0]..=pair[1]).contains(at))
        };
        let gaps: Vec<f64> = t_s.windows(2).filter(is_gap).map(|pair| pair[0]).collect();
        let is_whole = |(window, _): &((f64, f64), Vector6<f64>)| {
            let next = gaps.partition_point(|gap_s| *gap_s < window.0);
            gaps.get(next).is_none_or(|gap_s| *gap_s >= window.1)
        };
        let span_s = (t_s[0], t_s[t_s.len() - 1]);
        let [cubic, linear] = integrals(&t_s, &v);
        let columns = [cubic, linear, q];
        let with_length = |window_s: f64| {
            let all = ResponseChanges::from_windows(&t_s, &columns, span_s, window_s);
            let whole = all.windows.into_iter().zip(all.changes).filter(is_whole);
            let (windows, by): (Vec<_>, Vec<Vector6<f64>>) = whole.unzip();
            let changes = by.iter().map(|by| Vector6::ith(0, by[0])).collect();
            // The variance due to interpolation.
            let between = mean(by.iter().map(|by| (0.5 * (by[0] - by[1])).powi(2)));
            Self {
                window_s,
                changes: ResponseChanges { windows, changes, width: 1 },
                moved: by.iter().map(|by| by[2]).collect(),
                noise: Noise { between, ..noise },
            }
        };
        let mut window_s = WINDOW_LENGTH_LIMITS_S.0.max(4.0 * median_period_s(&t_s));
        loop {
            let found = with_length(window_s);
            let square = mean_square(found.moved.iter().copied());
            let is_clear = found.noise.window_variance(window_s, square)
                <= MAX_NOISE_RATIO * MAX_NOISE_RATIO * square;
            if is_clear || window_s >= WINDOW_LENGTH_LIMITS_S.1 {
                let is_enough = found.moved.len() >= MIN_WINDOWS && square > 4.0 * noise.position;
                return if is_enough { Ok(found) } else { Err(NotObservable::AtRest) };
            }
            window_s = (WINDOW_GROWTH * window_s).min(WINDOW_LENGTH_LIMITS_S.1.max(window_s));
        }
    }
}

fn noise(t_s: &[f64], q: &[f64], v: &[f64]) -> Noise {
    let period_s = median_period_s(t_s);
    let jitter = t_s.windows(2).map(|pair| pair[1] - pair[0] - period_s);
    let jitter = jitter.map(|late_s| late_s.clamp(-period_s, period_s));
    let second_differences = v.windows(3).map(|at| at[0] - 2.0 * at[1] + at[2]);
    let quantum = quantisation_step(q);
    Noise {
        position: sample_noise(q).powi(2).max(quantum * quantum / 12.0),
        velocity: mean_square(second_differences) / 6.0 * period_s,
        stamp: 0.5 * mean_square(jitter),
        between: 0.0,
    }
}

/// 2 % quantile of nonzero changes. Almost zero without quantisation.
fn quantisation_step(q: &[f64]) -> f64 {
    const ROUNDING_TOLERANCE: f64 = 1e-9;
    let steps = q.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mut steps: Vec<f64> = steps.filter(|&step| step > ROUNDING_TOLERANCE).collect();
    quantile(&mut steps, 0.02).unwrap_or(0.0)
}

/// Encoder step if all positions are multiples of it; otherwise 0. Long series are sampled in stretches if
/// most positions in them change.
pub fn encoder_step(q: &[f64]) -> f64 {
    const MAX_SAMPLES: usize = 24_000;
    let some: Vec<f64> =
        row_blocks(q.len(), MAX_SAMPLES).flat_map(|rows| q[rows].iter().copied()).collect();
    let changes = some.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if some.len() < q.len() && 2 * changes > some.len() { step_of(&some) } else { step_of(q) }
}

fn step_of(q: &[f64]) -> f64 {
    /// For multiples, and share of changes that are.
    const MULTIPLE_TOLERANCE: f64 = 0.02;
    const MIN_MULTIPLE_SHARE: f64 = 0.95;
    let step = quantisation_step(q);
    let changes = q.windows(2).map(|pair| (pair[1] - pair[0]) / step).filter(|by| *by != 0.0);
    let is_whole = |by: &f64| (by - by.round()).abs() < MULTIPLE_TOLERANCE;
    let (whole, all) = (changes.clone().filter(is_whole).count(), changes.count());
    if step > 0.0 && whole as f64 > MIN_MULTIPLE_SHARE * all as f64 { step } else { 0.0 }
}

/// Integrals of a velocity, by cubic and by linear interpolation.
fn integrals(t_s: &[f64], v: &[f64]) -> [Vec<f64>; 2] {
    let slopes = slopes(t_s, v);
    let length_s = |row: usize| t_s[row] - t_s[row - 1];
    let trapezoid = |row: usize| 0.5 * length_s(row) * (v[row] + v[row - 1]);
    let correction = |row: usize| length_s(row).powi(2) / 12.0 * (slopes[row] - slopes[row - 1]);
    let rows = 1..t_s.len();
    let cubic = cumulative(rows.clone().map(|row| trapezoid(row) - correction(row)));
    [cubic, cumulative(rows.map(trapezoid))]
}

fn shape(
    joints: &[VelocitySamples<'_>],
    index: usize,
    windows: &VelocityWindows,
    curve: &TimeSeries,
    by_noise: f64,
) -> VelocityShape {
    /// Rms relative to the derivatives.
    const MAX_ZERO_VELOCITY_RATIO: f64 = 0.02;
    /// Share of the squared error after a cause, and, with noise, of the squared velocities: as much as a delay or a
    /// low-pass must explain.
    const MAX_RESIDUAL_RATIO: f64 = 0.2;
    let VelocityWindows { changes, moved, .. } = windows;
    let by: Vec<f64> = changes.changes.iter().map(|by| by[0]).collect();
    let [square, rates] = [&by, moved].map(|values| mean_square(values.iter().copied()));
    if square <= by_noise {
        return VelocityShape::Zero;
    }
    let errors = by.iter().zip(moved).map(|(by, moved)| by - moved);
    // As a share of the response's energy.
    let allowed = (MAX_RESIDUAL_RATIO * mean_square(errors) + by_noise) / square;
    let allowed = allowed.min(MAX_RESIDUAL_RATIO);
    let (gain, residual) = changes.gain(curve);
    if residual <= allowed {
        return VelocityShape::Scaled(gain);
    }
    let mut recorded = joints[index].velocity.iter().copied().filter(|own| own.is_finite());
    if let Some(first) = recorded.next()
        && recorded.all(|own| own == first)
    {
        return VelocityShape::Constant(first);
    }
    if square <= MAX_ZERO_VELOCITY_RATIO * MAX_ZERO_VELOCITY_RATIO * rates {
        return VelocityShape::Zero;
    }
    let is_other =
        |(other, joint): &(usize, &VelocitySamples)| *other != index && joint.t_s.len() > 1;
    let other_joints = joints.iter().enumerate().filter(is_other).map(|(other, joint)| {
        let (gain, residual) = changes.gain(&joint.curve());
        (residual, other, gain)
    });
    let other = lowest(other_joints, |it| it.0);
    let along: f64 = by.iter().zip(moved).map(|(by, moved)| by * moved).sum();
    let sign = if along < 0.0 { -1.0 } else { 1.0 };
    let signed = changes.changes.iter().map(|by| sign * by).collect();
    let signed = ResponseChanges { changes: signed, ..changes.clone() };
    let response = signed.estimate_response(curve, MAX_LAG_S).ok();
    let response = response.map(|found| Response { gain: sign * found.gain, ..found });
    let residual = response.map_or(1.0, |response| 1.0 - response.explained);
    if let Some((_, other, gain)) = other.filter(|it| it.0 <= allowed.min(0.2 * residual)) {
        return VelocityShape::OfJoint(other, gain);
    }
    let response = response.filter(|_| residual <= allowed);
    response.map_or(VelocityShape::Unrelated, VelocityShape::Filtered)
}

#[cfg(test)]
mod tests;
