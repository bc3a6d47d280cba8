//! Limit violations and abrupt speed changes of a joint.

#[cfg(test)]
mod tests;

use ground::stats::thin::thinned;
use ground::stats::{highest, mean, quantile};
use std::borrow::Cow;
use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

use ground::robot::Limits;

/// Violation of a joint limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitViolation {
    /// In rad or m, or per second.
    pub limit: f64,
    /// Most extreme value.
    pub value: f64,
    /// Time of that value, s.
    pub at_s: f64,
    /// Total time beyond the limit, s.
    pub seconds: f64,
}

impl LimitViolation {
    /// Excess over the limit.
    pub fn excess(&self) -> f64 {
        (self.value - self.limit).abs()
    }
}

/// Position limit (lower or upper) that is exceeded most. Ignores values that are not finite.
pub fn position_violation(t_s: &[f64], q: &[f64], limits: &Limits) -> Option<LimitViolation> {
    let above = limits.upper.and_then(|upper| first_violation(t_s, q.iter().copied(), upper));
    let below = limits.lower.and_then(|lower| {
        let found = first_violation(t_s, q.iter().map(|q| -q), -lower)?;
        Some(LimitViolation { limit: lower, value: -found.value, ..found })
    });
    highest([above, below].into_iter().flatten(), LimitViolation::excess)
}

/// Speed limit violation. Two consecutive samples must exceed the limit, and the smaller counts: one sample
/// is an outlier.
pub fn speed_violation(t_s: &[f64], qd: &[f64], limits: &Limits) -> Option<LimitViolation> {
    let sustained = qd.windows(2).map(|pair| pair[0].abs().min(pair[1].abs()));
    first_violation(t_s, sustained, limits.velocity?)
}

/// Same from positions alone, with quantisation `step` (0 if none).
///
/// The window makes noise, including jittered stamps, small compared with the limit, which must be exceeded
/// by more than the noise. The smaller of the rates over logged stamps and over evenly spaced times counts:
/// a late stamp is not a speed.
pub fn speed_violation_from_positions(
    t_s: &[f64],
    q: &[f64],
    limits: &Limits,
    step: f64,
) -> Option<LimitViolation> {
    /// For noise and quantisation.
    const NOISE_SHARE_OF_LIMIT: f64 = 0.02;
    /// Rarely exceeded by noise.
    const NOISE_SIGMAS: f64 = 4.0;
    /// Share of normal deviations.
    const ONE_SIGMA_SHARE: f64 = 0.68;
    /// Stamp jitter remaining after a median of 17: 1.25 / √17.
    const JITTER_SHARE: f64 = 0.3;
    /// Motion changes over longer times.
    const MAX_WINDOW_S: f64 = 0.15;
    let limit = limits.velocity.filter(|limit| *limit > 0.0)?;
    if q.len() < MIN_SERIES_SAMPLES || t_s.len() != q.len() {
        return None;
    }
    let period_s = (t_s[t_s.len() - 1] - t_s[0]) / (t_s.len() - 1) as f64;
    let even_s = even_times(t_s);
    let jitter = t_s.iter().zip(&even_s).map(|(stamped, even)| (stamped - even).abs());
    let jitter_s = quantile_of(jitter, ONE_SIGMA_SHARE).unwrap_or(0.0);
    let by_stamps = JITTER_SHARE * jitter_s * limit;
    let noise = noise_of(q, JointSampleKind::Positions).all.hypot(by_stamps);
    let noise = NOISE_SIGMAS * std::f64::consts::SQRT_2 * noise;
    let by_noise_s = (noise / (NOISE_SHARE_OF_LIMIT * limit)).min(MAX_WINDOW_S);
    let window_s = by_noise_s.max(step / (NOISE_SHARE_OF_LIMIT * limit)).max(2.0 * period_s);
    let stamped = rates(t_s, q, window_s);
    let even = rates(&even_s, q, window_s);
    let lesser = stamped.iter().zip(even).map(|(a, b)| if b.abs() < a.abs() { b } else { *a });
    let lesser: Vec<f64> = lesser.collect();
    let raised = Limits { velocity: Some(limit + noise / window_s), ..*limits };
    speed_violation(t_s, &lesser, &raised).map(|excess| LimitViolation { limit, ..excess })
}

/// Evenly spaced times: medians of the times that neighbours predict at the median interval, except across
/// gaps.
fn even_times(t_s: &[f64]) -> Vec<f64> {
    const NEIGHBOURS: usize = 8;
    /// In intervals.
    const MIN_GAP_PERIODS: f64 = 4.0;
    let intervals = t_s.windows(2).map(|pair| pair[1] - pair[0]);
    let Some(period_s) = quantile_of(intervals, 0.5) else { return t_s.to_vec() };
    let mut even_s: Vec<f64> = Vec::with_capacity(t_s.len());
    for segment_s in t_s.chunk_by(|a, b| b - a <= MIN_GAP_PERIODS * period_s) {
        for (row, logged_s) in segment_s.iter().enumerate() {
            let beside = row.min(segment_s.len() - 1 - row).min(NEIGHBOURS);
            let predicted = (row - beside..=row + beside)
                .map(|other| segment_s[other] + (row as f64 - other as f64) * period_s);
            let at_s = quantile_of(predicted, 0.5).unwrap_or(*logged_s);
            // Keep the times increasing.
            let last_s = even_s.last().copied().unwrap_or(f64::NEG_INFINITY);
            even_s.push(if at_s > last_s { at_s } else { last_s + 1e-3 * period_s });
        }
    }
    even_s
}

/// Rates over at least `window_s` about each sample.
pub fn rates(t_s: &[f64], q: &[f64], window_s: f64) -> Vec<f64> {
    let rate = |row: usize| {
        let half_s = 0.5 * window_s;
        let first =
            t_s.partition_point(|at_s| *at_s < t_s[row] - half_s).min(row.saturating_sub(1));
        let last = t_s.partition_point(|at_s| *at_s <= t_s[row] + half_s).max(row + 2) - 1;
        let last = last.min(t_s.len() - 1);
        (q[last] - q[first]) / (t_s[last] - t_s[first])
    };
    (0..t_s.len().min(q.len())).map(rate).collect()
}

/// Each value lasts until the next sample, at most 1 s.
fn first_violation(
    t_s: &[f64],
    values: impl Iterator<Item = f64>,
    limit: f64,
) -> Option<LimitViolation> {
    const MAX_SAMPLE_S: f64 = 1.0;
    let mut found: Option<LimitViolation> = None;
    for (row, (&at_s, value)) in t_s.iter().zip(values).enumerate() {
        // NaN compares false.
        if value > limit {
            let seconds =
                t_s.get(row + 1).map_or(0.0, |next| (next - at_s).clamp(0.0, MAX_SAMPLE_S));
            let first = LimitViolation { limit, value, at_s, seconds: 0.0 };
            let excess = found.get_or_insert(first);
            excess.seconds += seconds;
            if value > excess.value {
                (excess.value, excess.at_s) = (value, at_s);
            }
        }
    }
    found
}

/// Kind of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointSampleKind {
    /// Acceleration is the second derivative.
    Positions,
    /// Acceleration is the first derivative.
    Velocities,
}

/// Largest acceleration of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeakAcceleration {
    /// Value with the greatest lower bound, rad/s².
    pub acceleration: f64,
    /// Bound on noise, rad/s²: `MAX_NOISE_SIGMAS` standard deviations.
    pub noise: f64,
    /// Fit window, s.
    pub window_s: f64,
    /// Time of the acceleration, s.
    pub at_s: f64,
    /// Acceleration change over half the window, rad/s³.
    pub jerk: f64,
    /// Smallest acceleration of a stop within `MAX_STOP_S` that exceeds noise, rad/s². Infinite if samples
    /// are too sparse.
    pub resolved: f64,
}

/// Not reached by noise in a million windows.
const MAX_NOISE_SIGMAS: f64 = 6.0;
/// Duration of an abrupt stop.
const MAX_STOP_S: f64 = 0.1;
/// As a share of window length times fitted acceleration. A speed step amid a window gives 0.53, because
/// the fitted parabola's second derivative is 15/8 of step over length; a step near its ends gives less.
const MIN_SPEED_CHANGE: f64 = 0.4;
/// In samples.
const HALF_WINDOWS: [usize; 5] = [1, 2, 4, 8, 16];
const MIN_SERIES_SAMPLES: usize = 9;
/// For the noise estimate, evenly spread.
const MAX_WINDOWS: usize = 50_000;

/// Largest acceleration of a joint by least squares over 3 to 33 samples (Savitzky and Golay 1964): slope
/// of velocities or curvature of positions. The result is the acceleration that exceeds its window's noise
/// bound most. Skips windows with gaps or uneven stamps. `None` if too few samples are evenly spaced.
///
/// `step` is the quantisation of positions, 0 if none; errors reach half of it.
pub fn peak_acceleration(
    t_s: &[f64],
    values: &[f64],
    series: JointSampleKind,
    step: f64,
) -> Option<PeakAcceleration> {
    let (t_s, values) = without_repeats(t_s, values);
    let (t_s, values) = (t_s.as_ref(), values.as_ref());
    let rows = values.len();
    let intervals = thinned(0..rows.saturating_sub(1), MAX_WINDOWS);
    let intervals = intervals.map(|row| t_s[row + 1] - t_s[row]);
    let period_s = quantile_of(intervals, 0.5)?;
    if rows < MIN_SERIES_SAMPLES || period_s.is_nan() || period_s <= 0.0 {
        return None;
    }
    // Cumulative number of uneven intervals.
    let mut uneven = vec![0_u32; rows];
    for row in 1..rows {
        let interval = (t_s[row] - t_s[row - 1]) / period_s;
        let is_even = (0.5..1.5).contains(&interval) && values[row].is_finite();
        uneven[row] = uneven[row - 1] + u32::from(!is_even);
    }
    let noise = noise_of(values, series);
    let mut surest: Option<PeakAcceleration> = None;
    let mut resolved = f64::INFINITY;
    for half in HALF_WINDOWS {
        let fit = Fit::new(half, period_s, series);
        let by_steps = 0.5 * step * fit.most();
        let floor_of = |noise: f64| (MAX_NOISE_SIGMAS * noise * fit.gain()).max(by_steps);
        let least_floor = floor_of(noise.all);
        let window_s = 2.0 * half as f64 * period_s;
        if window_s <= MAX_STOP_S {
            resolved = resolved.min(least_floor);
        }
        for (row, here) in fit.along(values) {
            let acceleration = here.abs();
            let is_surer = |acceleration: f64, floor: f64| {
                let surer =
                    |best: PeakAcceleration| acceleration - floor > best.acceleration - best.noise;
                acceleration.is_finite() && surest.is_none_or(surer)
            };
            let is_even = uneven[row + half] == uneven[row - half];
            if !is_even || !is_surer(acceleration, least_floor) {
                continue;
            }
            // The noise near the row is looked up only for the few large accelerations.
            let floor = floor_of(noise.at(row));
            if !is_surer(acceleration, floor) {
                continue;
            }
            // Stamps or samples may jitter; a real acceleration appears in both fits.
            let acceleration = acceleration.min(fit.as_stamped(t_s, values, row).abs());
            // A real acceleration changes the speed, a stray value does not.
            let change = speed_change(t_s, values, series, (row - half, row + half));
            let acceleration = acceleration.min(change / (MIN_SPEED_CHANGE * window_s));
            if is_surer(acceleration, floor) {
                // Over half a window on both sides.
                let beside = [row - half, row + half];
                let beside = beside.into_iter().filter_map(|row| fit.at(values, row));
                let change = beside.map(|other| (other - here).abs()).fold(0.0, f64::max);
                surest = Some(PeakAcceleration {
                    acceleration,
                    noise: floor,
                    window_s,
                    at_s: t_s[row],
                    jerk: change / (half as f64 * period_s),
                    resolved: f64::INFINITY,
                });
            }
        }
    }
    surest.map(|surest| PeakAcceleration { resolved, ..surest })
}

/// Speed at `to` by the samples after it, minus that at `from` by those before. Both are extrapolated, so a smooth
/// acceleration counts only between the two. 0 with too few samples, and for a ripple of the speed.
fn speed_change(
    t_s: &[f64],
    values: &[f64],
    series: JointSampleKind,
    (from, to): (usize, usize),
) -> f64 {
    const MIN_ROWS: usize = 4;
    /// Of the larger speed. A Kinova Gen3 at 1 kHz ripples by 15 % within 10 ms in a public log; not calibrated further.
    const MIN_CHANGED_SHARE: f64 = 0.2;
    let is_within_stop = |at: usize, other: usize| (t_s[other] - t_s[at]).abs() <= MAX_STOP_S;
    let first = (0..=from).rev().take_while(|row| is_within_stop(from, *row)).last();
    let last = (to..values.len()).take_while(|row| is_within_stop(to, *row)).last();
    // Mean time and speed.
    let mean_speed = |rows: Range<usize>| {
        let (t_s, values) = (&t_s[rows.clone()], &values[rows]);
        let [mean_s, mean_value] = [t_s, values].map(|of| mean(of.iter().copied()));
        let speed = match series {
            JointSampleKind::Velocities => mean_value,
            JointSampleKind::Positions => {
                let along = t_s.iter().zip(values);
                let along: f64 = along.map(|(t, q)| (t - mean_s) * (q - mean_value)).sum();
                along / t_s.iter().map(|t| (t - mean_s).powi(2)).sum::<f64>()
            }
        };
        (mean_s, speed)
    };
    let speed_at = |edge: usize, rows: Range<usize>| match rows.len() {
        ..MIN_ROWS => None,
        count if count < 2 * MIN_ROWS => Some(mean_speed(rows).1),
        count => {
            let middle = rows.start + count / 2;
            let (first_s, first) = mean_speed(rows.start..middle);
            let (second_s, second) = mean_speed(middle..rows.end);
            let acceleration = (second - first) / (second_s - first_s);
            let change = acceleration * (t_s[edge] - second_s);
            Some(if change.is_finite() { second + change } else { second })
        }
    };
    let before = first.and_then(|first| speed_at(from, first..from + 1));
    let after = last.and_then(|last| speed_at(to, to..last + 1));
    before.zip(after).map_or(0.0, |(before, after)| {
        let change = (after - before).abs();
        match change >= MIN_CHANGED_SHARE * before.abs().max(after.abs()) {
            true => change,
            // Also with values that are not finite.
            false => 0.0,
        }
    })
}

/// Drops repeats if there are many while the joint moves: the publisher is faster than the driver.
fn without_repeats<'a>(t_s: &'a [f64], values: &'a [f64]) -> (Cow<'a, [f64]>, Cow<'a, [f64]>) {
    /// Above this share, the publisher causes repeats.
    const MAX_REPEATED_SHARE: f64 = 0.3;
    /// Between changes.
    const MIN_REST_SAMPLES: usize = 20;
    let is_change = |row: &usize| *row == 0 || values[*row] != values[*row - 1];
    let changes: Vec<usize> = (0..values.len()).filter(is_change).collect();
    let gaps = changes.windows(2).map(|pair| pair[1] - pair[0]);
    let gaps = gaps.filter(|gap| *gap < MIN_REST_SAMPLES);
    let repeated = gaps.clone().filter(|gap| *gap > 1).count();
    if repeated as f64 <= MAX_REPEATED_SHARE * gaps.count() as f64 {
        return (t_s.into(), values.into());
    }
    let (t_s, values): (Vec<f64>, Vec<f64>) =
        changes.into_iter().map(|row| (t_s[row], values[row])).unzip();
    (t_s.into(), values.into())
}

/// Standard deviation of single samples, from differences that remove smooth motion: second of velocities,
/// fourth of positions.
struct Noise {
    /// All samples or the fastest quarter, whichever is larger: noise of uneven stamps grows with speed.
    all: f64,
    /// One per `length` samples.
    blocks: Vec<f64>,
    length: usize,
}

impl Noise {
    /// The largest of the overall noise and that of nearby blocks.
    fn at(&self, row: usize) -> f64 {
        let block = row / self.length;
        let near = block.saturating_sub(1)..(block + 2).min(self.blocks.len());
        let near = self.blocks.get(near).unwrap_or_default();
        near.iter().fold(self.all, |max_noise, noise| max_noise.max(*noise))
    }
}

fn noise_of(values: &[f64], series: JointSampleKind) -> Noise {
    /// Excludes stops but not quantisation steps.
    const KEPT_SHARE: f64 = 0.95;
    /// In a block, stops take a larger share.
    const KEPT_SHARE_OF_BLOCK: f64 = 0.75;
    const WINDOWS_PER_BLOCK: usize = 128;
    let (difference, weight): (fn(&[f64]) -> f64, f64) = match series {
        JointSampleKind::Velocities => (|w| w[1] - 2.0 * w[2] + w[3], 6.0),
        JointSampleKind::Positions => {
            (|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4], 70.0)
        }
    };
    let speed = |w: &[f64]| match series {
        JointSampleKind::Velocities => w[2].abs(),
        JointSampleKind::Positions => (w[3] - w[1]).abs(),
    };
    let count = values.len().saturating_sub(4);
    let windows = || thinned(0..count, MAX_WINDOWS).map(|first| &values[first..first + 5]);
    let fast = quantile_of(windows().map(speed), 0.75).unwrap_or(0.0);
    let moving = windows().filter(|w| speed(w) >= fast);
    let all = trimmed_rms(windows().map(difference), KEPT_SHARE);
    let all = all.max(trimmed_rms(moving.map(difference), KEPT_SHARE)) / weight.sqrt();
    let length = count.div_ceil(MAX_WINDOWS).max(1) * WINDOWS_PER_BLOCK;
    let of_block = |first: usize| {
        let rows = (first..(first + length).min(count)).step_by(length / WINDOWS_PER_BLOCK);
        let differences = rows.map(|row| difference(&values[row..row + 5]));
        trimmed_rms(differences, KEPT_SHARE_OF_BLOCK) / weight.sqrt()
    };
    Noise { all, blocks: (0..count).step_by(length).map(of_block).collect(), length }
}

/// Rms of the smallest `retained_share`, scaled to the full normal distribution. Within `z` standard
/// deviations the variance is 1 − 2zφ(z)/`retained_share`.
fn trimmed_rms(values: impl Iterator<Item = f64>, retained_share: f64) -> f64 {
    let normal = Normal::standard();
    let z = normal.inverse_cdf(0.5 * (1.0 + retained_share));
    let variance = 1.0 - 2.0 * z * normal.pdf(z) / retained_share;
    let mut squares: Vec<f64> = values.map(|value| value * value).collect();
    squares.retain(|square| square.is_finite());
    let count = (squares.len() as f64 * retained_share) as usize;
    if count == 0 {
        return 0.0;
    }
    squares.select_nth_unstable_by(count - 1, f64::total_cmp);
    (squares[..count].iter().sum::<f64>() / (count as f64 * variance)).sqrt()
}

fn quantile_of(values: impl Iterator<Item = f64>, part: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    quantile(&mut values, part)
}

/// Least-squares acceleration over even samples: the derivative of this order.
struct Fit {
    half: usize,
    order: i32,
    weights: Vec<f64>,
}

impl Fit {
    fn new(half: usize, period_s: f64, series: JointSampleKind) -> Self {
        let order = match series {
            JointSampleKind::Positions => 2,
            JointSampleKind::Velocities => 1,
        };
        let power = |at: usize| (at as f64 - half as f64).powi(order);
        let mean = mean((0..=2 * half).map(power));
        let shape = |at: usize| power(at) - mean;
        let squares: f64 = (0..=2 * half).map(|at| shape(at).powi(2)).sum();
        let scale = f64::from(order) / (squares * period_s.powi(order));
        Self { half, order, weights: (0..=2 * half).map(|at| scale * shape(at)).collect() }
    }

    /// Output for white noise of unit standard deviation.
    fn gain(&self) -> f64 {
        self.weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt()
    }

    /// Output for errors of at most 1.
    fn most(&self) -> f64 {
        self.weights.iter().map(|weight| weight.abs()).sum()
    }

    /// Same at one row over logged stamps. NaN if these are singular.
    fn as_stamped(&self, t_s: &[f64], values: &[f64], row: usize) -> f64 {
        let Self { half, order, .. } = *self;
        let first = row - half;
        let scale = (t_s[row + half] - t_s[first]).max(f64::MIN_POSITIVE);
        let (rows, width) = (2 * half + 1, order as usize + 1);
        let power =
            |at: usize, power: usize| ((t_s[first + at] - t_s[row]) / scale).powi(power as i32);
        let powers = DMatrix::from_fn(rows, width, power);
        let values = DVector::from_fn(rows, |at, _| values[first + at] - values[row]);
        let fit = powers.tr_mul(&powers).lu().solve(&powers.tr_mul(&values));
        fit.map_or(f64::NAN, |fit| f64::from(order) * fit[width - 1] / scale.powi(order))
    }

    /// All rows but `half` at either end, with their accelerations.
    fn along(&self, values: &[f64]) -> impl Iterator<Item = (usize, f64)> {
        /// Stay in the cache while all weights are applied.
        const BLOCK_ROWS: usize = 1024;
        let margins = 2 * self.half;
        let count = values.len().saturating_sub(margins);
        (0..count).step_by(BLOCK_ROWS).flat_map(move |start| {
            let end = count.min(start + BLOCK_ROWS);
            (start + self.half..).zip(self.of_block(&values[start..end + margins]))
        })
    }

    fn of_block(&self, values: &[f64]) -> Vec<f64> {
        let mut accelerations = vec![0.0; values.len() - 2 * self.half];
        for (place, weight) in self.weights.iter().enumerate() {
            let shifted = accelerations.iter_mut().zip(&values[place..]);
            shifted.for_each(|(sum, value)| *sum += weight * value);
        }
        accelerations
    }

    /// Acceleration at a row. `None` near either end.
    fn at(&self, values: &[f64], row: usize) -> Option<f64> {
        let own = values.get(row.checked_sub(self.half)?..=row + self.half)?;
        self.of_block(own).first().copied()
    }
}
