//! Checks whether recorded velocities are the derivatives of the recorded positions, and classifies the
//! error if not.
//!
//! Velocities are integrated and compared with the change of position over the same window. Nothing is
//! differentiated, so encoder noise enters only twice per window and velocity noise averages out.

use super::latency::median_period_s;
use super::response::{ResponseChanges, TimeSeries, slopes};
use super::sampling::row_blocks;
use super::{NotObservable, Response};
use ground::stats::Measured;
use ground::stream::sample_noise;

/// Samples of one joint.
#[derive(Clone, Copy, Debug)]
pub struct VelocitySamples<'a> {
    /// Sample times, s, strictly increasing.
    pub t_s: &'a [f64],
    /// Recorded positions, rad or m.
    pub position: &'a [f64],
    /// Recorded velocities, rad/s or m/s; NaN if missing.
    pub velocity: &'a [f64],
    /// Times of known position jumps, s. No window contains one.
    pub breaks: &'a [f64],
}

/// Comparison of a joint's velocities with the derivatives of its positions.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocityDiagnosis {
    /// Relative error: rms of velocity minus position rate, over rms rate, in the band of the motion.
    /// Noise, encoder quantisation and stamp jitter are subtracted.
    pub error: Measured,
    /// Relative error expected from those three alone.
    pub noise: f64,
    /// Rms rate of the positions, rad/s or m/s.
    pub rate: f64,
    /// Window length, s.
    pub window_s: f64,
    /// Classification of the velocities.
    pub shape: VelocityShape,
}

/// Relation of velocities to positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum VelocityShape {
    /// Derivatives of the positions, within the uncertainty.
    Rates,
    /// Zero or nearly zero.
    Zero,
    /// Derivatives times a factor.
    Scaled(f64),
    /// Derivatives of the joint at this index, times a factor.
    OfJoint(usize, f64),
    /// Derivatives with a delay, a low-pass or both, times a gain.
    Filtered(Response),
    /// None of these.
    Unrelated,
}

/// Relative error below which no cause is sought, and below which a half-sample shift is attributed to a
/// finite difference.
const MIN_RELATIVE_ERROR: f64 = 0.02;
/// Minimum length of a gap, in median intervals.
const MIN_GAP_INTERVALS: f64 = 5.0;
/// Half-width of the interval in standard errors.
const INTERVAL_STD_ERRORS: f64 = 1.9;
/// Maximum delay, s.
const MAX_LAG_S: f64 = 0.5;

/// Compares the velocities of joint `index` with the derivatives of its positions. `joints` are all joints
/// of the arm, whose velocities may be permuted.
///
/// # Errors
/// Returns an error if the joint barely moves, or has too few velocities.
pub fn diagnose_velocity(
    joints: &[VelocitySamples<'_>],
    index: usize,
) -> Result<VelocityDiagnosis, NotObservable> {
    let own = joints.get(index).ok_or(NotObservable::AtRest)?;
    let windows = VelocityWindows::from_samples(own)?;
    let VelocityWindows { noise, ref changes, ref moved, .. } = windows;
    let (compared, rate_square) = (moved.len() as f64, mean_square(moved) - 2.0 * noise.position);
    let by_noise = noise.window_variance(windows.window_s, mean_square(moved)) / rate_square;
    let error_of = |moved: &[f64]| {
        let errors: Vec<f64> = changes.changes.iter().zip(moved).map(|(by, q)| by[0] - q).collect();
        mean_square(&errors) / rate_square
    };
    let as_recorded = error_of(moved);
    let half_s = 0.5 * median_period_s(own.t_s);
    let curve = TimeSeries::new(own.t_s.to_vec(), vec![own.position.to_vec()]);
    // A difference of two samples is the rate midway between them.
    let of_difference = [-half_s, half_s]
        .map(|delay_s| changes.references(&curve, delay_s))
        .map(|shifted| shifted.iter().map(|at| at.map_or(f64::NAN, |at| at[0])).collect::<Vec<_>>())
        .map(|shifted| error_of(&shifted));
    let square = match of_difference.into_iter().fold(f64::INFINITY, f64::min) {
        shifted if shifted - by_noise < MIN_RELATIVE_ERROR * MIN_RELATIVE_ERROR => {
            shifted.min(as_recorded)
        }
        _ => as_recorded,
    };
    let square = (square - by_noise).max(0.0);
    let value = square.sqrt();
    // The noise variance is known to ±50 %. Overlapping windows count once.
    let count = (0.5 * compared).max(1.0);
    let variance = 4.0 * square * by_noise / count + (0.5 * by_noise).powi(2);
    let [most, least] =
        [1.0, -1.0].map(|sign| (square + sign * 2.0 * variance.sqrt()).max(0.0).sqrt());
    // If the square may be zero, so may the root.
    let std_error = (most - value).max(value - least) / INTERVAL_STD_ERRORS;
    let shape = match value < MIN_RELATIVE_ERROR {
        true => VelocityShape::Rates,
        false => shape(joints, index, &windows, &curve, by_noise * rate_square),
    };
    Ok(VelocityDiagnosis {
        error: Measured { value, std_error, dof: count },
        noise: by_noise.sqrt(),
        rate: rate_square.sqrt() / windows.window_s,
        window_s: windows.window_s,
        shape,
    })
}

fn mean_square(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    sum / f64::max(count, 1.0)
}

/// Variances of the noise.
#[derive(Clone, Copy, Debug)]
struct Noise {
    /// Position, rad² or m².
    position: f64,
    /// Velocity times the sample interval, i.e. variance of the integral per second, rad²/s or m²/s.
    velocity: f64,
    /// Stamp, s².
    stamp: f64,
    /// Interpolation between samples, in the unit of a squared change.
    between: f64,
}

impl Noise {
    /// Variance of the difference between integral and change of position over a window; `moved` is the
    /// mean squared change.
    fn window_variance(&self, window_s: f64, moved: f64) -> f64 {
        let by_stamps = 2.0 * self.stamp * moved / (window_s * window_s);
        2.0 * self.position + self.velocity * window_s + by_stamps + self.between
    }
}

/// Compared quantities of a joint.
#[derive(Debug)]
struct VelocityWindows {
    window_s: f64,
    /// Integrals of the velocity.
    changes: ResponseChanges,
    /// Changes of position over the same windows, rad or m.
    moved: Vec<f64>,
    noise: Noise,
}

impl VelocityWindows {
    fn from_samples(joint: &VelocitySamples<'_>) -> Result<Self, NotObservable> {
        /// Minimum travel of a moving joint, rad or m.
        const MIN_TRAVEL: f64 = 5e-3;
        /// Minimum number of windows.
        const MIN_WINDOWS: usize = 20;
        /// Shortest and longest window, s, growth factor, and the noise-to-change ratio at which the growth
        /// stops.
        const WINDOW_LENGTH_LIMITS_S: (f64, f64) = (0.1, 0.5);
        const WINDOW_GROWTH: f64 = 1.5;
        const MAX_NOISE_RATIO: f64 = 0.01;
        let known: Vec<usize> = (0..joint.t_s.len().min(joint.velocity.len()))
            .filter(|&row| joint.velocity[row].is_finite() && joint.position[row].is_finite())
            .collect();
        if known.len() < MIN_WINDOWS {
            return Err(NotObservable::TooFewSamples { have: known.len(), need: MIN_WINDOWS });
        }
        let of = |values: &[f64]| known.iter().map(|&row| values[row]).collect::<Vec<f64>>();
        let (t_s, q, v) = (of(joint.t_s), of(joint.position), of(joint.velocity));
        let (least, most) =
            q.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &q| (a.min(q), b.max(q)));
        let integral = Integral::new(&t_s, &v);
        let mut noise = noise(&t_s, &q, &v);
        if most - least < MIN_TRAVEL.max(8.0 * noise.position.sqrt()) {
            return Err(NotObservable::AtRest);
        }
        let mut window_s = WINDOW_LENGTH_LIMITS_S.0.max(4.0 * median_period_s(&t_s));
        loop {
            let (changes, moved, between) = integral.windows(&t_s, &q, joint.breaks, window_s);
            noise.between = between;
            let square = mean_square(&moved);
            let is_clear = noise.window_variance(window_s, square)
                <= MAX_NOISE_RATIO * MAX_NOISE_RATIO * square;
            if is_clear || window_s >= WINDOW_LENGTH_LIMITS_S.1 {
                let is_enough = moved.len() >= MIN_WINDOWS && square > 4.0 * noise.position;
                let found = Self { window_s, changes, moved, noise };
                return if is_enough { Ok(found) } else { Err(NotObservable::AtRest) };
            }
            window_s = (WINDOW_GROWTH * window_s).min(WINDOW_LENGTH_LIMITS_S.1.max(window_s));
        }
    }
}

/// Variances of the noise in a joint's samples.
fn noise(t_s: &[f64], q: &[f64], v: &[f64]) -> Noise {
    let period_s = median_period_s(t_s);
    let jitter: Vec<f64> = t_s
        .windows(2)
        .map(|pair| (pair[1] - pair[0] - period_s).clamp(-period_s, period_s))
        .collect();
    let bends: Vec<f64> = v.windows(3).map(|at| at[0] - 2.0 * at[1] + at[2]).collect();
    let quantum = quantisation_step(q);
    Noise {
        position: sample_noise(q).powi(2).max(quantum * quantum / 12.0),
        velocity: mean_square(&bends) / 6.0 * period_s,
        stamp: 0.5 * mean_square(&jitter),
        between: 0.0,
    }
}

/// Quantisation step of an encoder: the 2 % quantile of nonzero changes. Almost zero if there is no
/// quantisation.
fn quantisation_step(q: &[f64]) -> f64 {
    const QUANTILE_DIVISOR: usize = 50;
    const ROUNDING_TOLERANCE: f64 = 1e-9;
    let steps = q.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mut steps: Vec<f64> = steps.filter(|&step| step > ROUNDING_TOLERANCE).collect();
    let at = steps.len() / QUANTILE_DIVISOR;
    if steps.is_empty() { 0.0 } else { *steps.select_nth_unstable_by(at, f64::total_cmp).1 }
}

/// Quantisation step of an encoder, if all positions are multiples of it; otherwise 0. Long series are
/// sampled in stretches, if most positions in them change.
pub fn encoder_step(q: &[f64]) -> f64 {
    const MAX_SAMPLES: usize = 24_000;
    let some: Vec<f64> =
        row_blocks(q.len(), MAX_SAMPLES).flat_map(|rows| q[rows].iter().copied()).collect();
    let changes = some.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if some.len() < q.len() && 2 * changes > some.len() { step_of(&some) } else { step_of(q) }
}

fn step_of(q: &[f64]) -> f64 {
    /// Tolerance of a multiple, and minimum share of changes that are multiples.
    const MULTIPLE_TOLERANCE: f64 = 0.02;
    const MIN_MULTIPLE_SHARE: f64 = 0.95;
    let step = quantisation_step(q);
    let changes = q.windows(2).map(|pair| (pair[1] - pair[0]) / step).filter(|by| *by != 0.0);
    let (mut whole, mut all) = (0_usize, 0_usize);
    for by in changes {
        all += 1;
        whole += usize::from((by - by.round()).abs() < MULTIPLE_TOLERANCE);
    }
    if step > 0.0 && whole as f64 > MIN_MULTIPLE_SHARE * all as f64 { step } else { 0.0 }
}

/// Integral of the velocities from the first sample.
struct Integral {
    /// With cubic and with linear interpolation.
    at: Vec<[f64; 2]>,
}

impl Integral {
    fn new(t_s: &[f64], v: &[f64]) -> Self {
        let slopes = slopes(t_s, v);
        let mut at = vec![[0.0; 2]];
        for row in 1..t_s.len() {
            let length_s = t_s[row] - t_s[row - 1];
            let straight = 0.5 * length_s * (v[row] + v[row - 1]);
            let bend = length_s * length_s / 12.0 * (slopes[row] - slopes[row - 1]);
            let [cubic_before, straight_before] = at[row - 1];
            at.push([cubic_before + straight - bend, straight_before + straight]);
        }
        Self { at }
    }

    /// Changes of the integral and of the position over windows, and the variance due to interpolation.
    fn windows(
        &self,
        t_s: &[f64],
        q: &[f64],
        breaks: &[f64],
        window_s: f64,
    ) -> (ResponseChanges, Vec<f64>, f64) {
        let [cubic, straight] =
            [0, 1].map(|kind| self.at.iter().map(|at| at[kind]).collect::<Vec<f64>>());
        let span = (t_s.first().copied().unwrap_or(0.0), t_s.last().copied().unwrap_or(0.0));
        let all =
            ResponseChanges::from_windows(t_s, &[cubic, straight, q.to_vec()], span, window_s);
        let gap_s = MIN_GAP_INTERVALS * median_period_s(t_s);
        // Velocity in a gap and position across a break are unknown.
        let is_gap = |pair: &&[f64]| {
            pair[1] - pair[0] > gap_s || breaks.iter().any(|at| (pair[0]..=pair[1]).contains(at))
        };
        let gaps: Vec<f64> = t_s.windows(2).filter(is_gap).map(|pair| pair[0]).collect();
        let is_whole = |window: &(f64, f64)| {
            let next = gaps.partition_point(|gap_s| *gap_s < window.0);
            gaps.get(next).is_none_or(|gap_s| *gap_s >= window.1)
        };
        let mut changes = ResponseChanges { width: 1, ..ResponseChanges::default() };
        let (mut moved, mut square) = (Vec::new(), 0.0);
        for (&window, by) in
            all.windows.iter().zip(&all.changes).filter(|(window, _)| is_whole(window))
        {
            changes.windows.push(window);
            changes.changes.push([by[0], 0.0, 0.0, 0.0, 0.0, 0.0]);
            moved.push(by[2]);
            square += (0.5 * (by[0] - by[1])).powi(2);
        }
        let between = square / moved.len().max(1) as f64;
        (changes, moved, between)
    }
}

/// Classifies velocities that are not the derivatives.
fn shape(
    joints: &[VelocitySamples<'_>],
    index: usize,
    windows: &VelocityWindows,
    curve: &TimeSeries,
    by_noise: f64,
) -> VelocityShape {
    /// Maximum rms relative to the derivatives for zero velocities.
    const MAX_ZERO_VELOCITY_RATIO: f64 = 0.02;
    /// Maximum share of the squared error that remains after a cause.
    const MAX_REMAINING_SHARE: f64 = 0.2;
    let VelocityWindows { changes, moved, .. } = windows;
    let by: Vec<f64> = changes.changes.iter().map(|by| by[0]).collect();
    let (own, rates) = (mean_square(&by), mean_square(moved));
    if own <= MAX_ZERO_VELOCITY_RATIO * MAX_ZERO_VELOCITY_RATIO * rates {
        return VelocityShape::Zero;
    }
    let errors: Vec<f64> = by.iter().zip(moved).map(|(by, moved)| by - moved).collect();
    // As a share of the response's energy, like the residual of a fit.
    let allowed = (MAX_REMAINING_SHARE * mean_square(&errors) + by_noise).min(0.5 * own) / own;
    let signed = |sign: f64| {
        let by = changes.changes.iter().map(|by| by.map(|by| sign * by)).collect();
        ResponseChanges { changes: by, ..changes.clone() }
    };
    let along: f64 = by.iter().zip(moved).map(|(by, moved)| by * moved).sum();
    let sign = if along < 0.0 { -1.0 } else { 1.0 };
    let gain_of = |curve: &TimeSeries| {
        let fits = [1.0, -1.0].map(|sign| (sign, signed(sign).gain(curve)));
        let [(sign, (gain, left)), _] = match fits[0].1.1 <= fits[1].1.1 {
            true => fits,
            false => [fits[1], fits[0]],
        };
        (sign * gain, left)
    };
    let (gain, left) = gain_of(curve);
    if left <= allowed {
        return VelocityShape::Scaled(gain);
    }
    let of_others = joints.iter().enumerate().filter(|(other, _)| *other != index);
    let of_others = of_others.filter(|(_, joint)| joint.t_s.len() > 1).map(|(other, joint)| {
        let (gain, left) =
            gain_of(&TimeSeries::new(joint.t_s.to_vec(), vec![joint.position.to_vec()]));
        (left, other, gain)
    });
    let other = of_others.min_by(|a, b| a.0.total_cmp(&b.0));
    let response = signed(sign)
        .estimate_response(curve, MAX_LAG_S)
        .ok()
        .map(|response| Response { gain: sign * response.gain, ..response });
    let left = response.map_or(1.0, |response| 1.0 - response.explained);
    match other {
        Some((left_by_other, other, gain)) if left_by_other <= allowed.min(0.2 * left) => {
            VelocityShape::OfJoint(other, gain)
        }
        _ => match response.filter(|_| left <= allowed) {
            Some(response) => VelocityShape::Filtered(response),
            None => VelocityShape::Unrelated,
        },
    }
}

#[cfg(test)]
mod tests;
