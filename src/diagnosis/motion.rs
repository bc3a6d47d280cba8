//! What a joint's motion comes to, from its samples alone: how far it is beyond its limits, and how
//! abruptly it changes its speed.

#[cfg(test)]
mod tests;

use ground::stats::quantile;
use std::borrow::Cow;

use nalgebra::{Matrix3, Vector3};
use statrs::distribution::{Continuous, ContinuousCDF, Normal};

use ground::robot::Limits;

/// How far a joint is beyond a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Excess {
    /// The limit, rad or m, or a second of it.
    pub limit: f64,
    /// The value farthest beyond it.
    pub value: f64,
    /// When that was, s.
    pub at_s: f64,
    /// How long the limit was exceeded altogether, s.
    pub seconds: f64,
}

impl Excess {
    /// By how much the limit is exceeded.
    pub fn over(&self) -> f64 {
        (self.value - self.limit).abs()
    }
}

/// The positions of a joint beyond its limits; the lower limit or the upper, whichever is exceeded by
/// more. Values that are not finite are passed over.
pub fn beyond_positions(t_s: &[f64], q: &[f64], limits: &Limits) -> Option<Excess> {
    let above = limits.upper.and_then(|upper| beyond(t_s, q.iter().copied(), upper));
    let below = limits.lower.and_then(|lower| {
        let found = beyond(t_s, q.iter().map(|q| -q), -lower)?;
        Some(Excess { limit: lower, value: -found.value, ..found })
    });
    [above, below].into_iter().flatten().max_by(|a, b| a.over().total_cmp(&b.over()))
}

/// The speeds of a joint beyond its limit. Two neighbouring samples must be beyond it, and the less of
/// them counts: one alone is a reading gone wrong.
pub fn beyond_speed(t_s: &[f64], qd: &[f64], limits: &Limits) -> Option<Excess> {
    let held = qd.windows(2).map(|pair| pair[0].abs().min(pair[1].abs()));
    beyond(t_s, held, limits.velocity?)
}

/// The speeds of a joint beyond its limit by its positions alone: rates over as long a time as makes their noise,
/// which includes what uneven stamps feign, small beside the limit, and beyond the limit by more than that noise.
/// Each rate is taken over the stamps and over even times, and the less of both counts: a single row stamped late
/// is no speed. `step` is what positions are whole numbers of, 0 if they are not.
pub fn beyond_speed_of_positions(
    t_s: &[f64],
    q: &[f64],
    limits: &Limits,
    step: f64,
) -> Option<Excess> {
    /// Share of the limit that noise and a step of the encoder may make.
    const SHARE: f64 = 0.02;
    /// Standard deviations that noise hardly reaches.
    const SIGMAS: f64 = 4.0;
    /// Share of deviations within one standard deviation.
    const ONE_SIGMA: f64 = 0.68;
    /// Share of the stamps' jitter that a median of 17 leaves: 1.25 / √17.
    const LEFT: f64 = 0.3;
    /// Motion changes within longer times, s.
    const LONGEST_S: f64 = 0.15;
    let limit = limits.velocity.filter(|limit| *limit > 0.0)?;
    if q.len() < ENOUGH || t_s.len() != q.len() {
        return None;
    }
    let period_s = (t_s[t_s.len() - 1] - t_s[0]) / (t_s.len() - 1) as f64;
    let even_s = even_times(t_s);
    let off = t_s.iter().zip(&even_s).map(|(stamped, even)| (stamped - even).abs());
    let jitter_s = quantile_of(off, ONE_SIGMA).unwrap_or(0.0);
    let by_stamps = LEFT * jitter_s * limit;
    let noise = noise_of(q, Series::Positions).all.hypot(by_stamps);
    let noise = SIGMAS * std::f64::consts::SQRT_2 * noise;
    let by_noise_s = (noise / (SHARE * limit)).min(LONGEST_S);
    let window_s = by_noise_s.max(step / (SHARE * limit)).max(2.0 * period_s);
    let stamped = rates(t_s, q, window_s);
    let even = rates(&even_s, q, window_s);
    let lesser = stamped.iter().zip(even).map(|(a, b)| if b.abs() < a.abs() { b } else { *a });
    let lesser: Vec<f64> = lesser.collect();
    let sure = Limits { velocity: Some(limit + noise / window_s), ..*limits };
    beyond_speed(t_s, &lesser, &sure).map(|excess| Excess { limit, ..excess })
}

/// When rows would be if they came evenly: for each the median of what the rows around it say, at the usual
/// interval. Rows across a gap say nothing.
fn even_times(t_s: &[f64]) -> Vec<f64> {
    const AROUND: usize = 8;
    /// A gap is longer than so many intervals.
    const GAP: f64 = 4.0;
    let intervals = t_s.windows(2).map(|pair| pair[1] - pair[0]);
    let Some(period_s) = median_of(intervals) else { return t_s.to_vec() };
    let gap_s = GAP * period_s;
    let mut after_gap = vec![0; t_s.len()];
    for row in 1..t_s.len() {
        let is_gap = t_s[row] - t_s[row - 1] > gap_s;
        after_gap[row] = if is_gap { row } else { after_gap[row - 1] };
    }
    let mut even_s: Vec<f64> = Vec::with_capacity(t_s.len());
    for row in 0..t_s.len() {
        let before = (row - after_gap[row]).min(AROUND);
        let same_piece = |other: &usize| after_gap[*other] == after_gap[row];
        let after = (row + 1..t_s.len()).take(before).take_while(same_piece).count();
        let mut said = [0.0; 2 * AROUND + 1];
        let said = &mut said[..2 * after + 1];
        for (at, other) in (row - after..=row + after).enumerate() {
            said[at] = t_s[other] + (row as f64 - other as f64) * period_s;
        }
        let middle = said.len() / 2;
        let at_s = *said.select_nth_unstable_by(middle, f64::total_cmp).1;
        // The usual interval is not that of each row: times never stand still.
        let last_s = even_s.last().copied().unwrap_or(f64::NEG_INFINITY);
        even_s.push(if at_s > last_s { at_s } else { last_s + 1e-3 * period_s });
    }
    even_s
}

/// The rates of positions, each over at least `window_s` about its sample.
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

/// Values above a limit, each of which holds until the next sample, but no longer than a second.
fn beyond(t_s: &[f64], values: impl Iterator<Item = f64>, limit: f64) -> Option<Excess> {
    const LONGEST_S: f64 = 1.0;
    let mut found: Option<Excess> = None;
    for (row, (&at_s, value)) in t_s.iter().zip(values).enumerate() {
        // A NaN is not above anything.
        if value > limit {
            let seconds = t_s.get(row + 1).map_or(0.0, |next| (next - at_s).clamp(0.0, LONGEST_S));
            let first = Excess { limit, value, at_s, seconds: 0.0 };
            let excess = found.get_or_insert(first);
            excess.seconds += seconds;
            if value > excess.value {
                (excess.value, excess.at_s) = (value, at_s);
            }
        }
    }
    found
}

/// What the samples of a joint are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Series {
    /// Positions, of which acceleration is the second derivative.
    Positions,
    /// Velocities, of which it is the first.
    Velocities,
}

/// How abruptly a joint changes its speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Abruptness {
    /// The acceleration that most surely is the largest: the one with the greatest lower bound, rad/s².
    pub acceleration: f64,
    /// What noise alone could hardly make of it, rad/s²: `SIGMAS` standard deviations.
    pub noise: f64,
    /// The time over which it was fitted, s.
    pub window_s: f64,
    /// When it was, s.
    pub at_s: f64,
    /// The change of the acceleration there over half that time, rad/s³.
    pub jerk: f64,
    /// The least acceleration that a stop within `BRIEF_S` would show through the noise, rad/s²;
    /// infinite where samples are too far apart.
    pub resolved: f64,
}

/// Standard deviations that noise does not reach in a million windows.
const SIGMAS: f64 = 6.0;
/// A stop is abrupt within this time, s.
const BRIEF_S: f64 = 0.1;
/// A window with an acceleration in it changes the speed by this share of its length times the fit, at least: a
/// step of the speed in the middle of a window by 0.53, as the bend of a parabola through it is 15/8 of step over
/// length, and one nearer to its ends by less.
const LEAST_CHANGE: f64 = 0.4;
/// Half-widths of the windows, in samples.
const HALVES: [usize; 5] = [1, 2, 4, 8, 16];
/// Fewer samples than this tell nothing.
const ENOUGH: usize = 9;
/// Windows that noise is told from, of as many parts of the samples, where there are more.
const MOST_WINDOWS: usize = 50_000;
/// Rows whose fits are made at once.
const BLOCK: usize = 512;

/// The largest acceleration of a joint, by the slope of velocities, or the bend of positions, that
/// fits best over windows from 3 to 33 samples; each window says how much noise makes of it, and the
/// one counts that is the surest beyond noise (Savitzky and Golay 1964). Windows with gaps, or over
/// stamps that do not come evenly, are left out. `None` of too few even samples.
///
/// `step` is what positions are whole numbers of, 0 where they are not: each is off by up to half of it.
pub fn abruptness(t_s: &[f64], values: &[f64], series: Series, step: f64) -> Option<Abruptness> {
    let (t_s, values) = without_repeats(t_s, values);
    let (t_s, values) = (t_s.as_ref(), values.as_ref());
    let rows = values.len();
    let period_s = median_of(strided(rows.saturating_sub(1)).map(|row| t_s[row + 1] - t_s[row]))?;
    if rows < ENOUGH || period_s.is_nan() || period_s <= 0.0 {
        return None;
    }
    // How many uneven intervals there are up to each sample.
    let mut uneven = vec![0_u32; rows];
    for row in 1..rows {
        let interval = (t_s[row] - t_s[row - 1]) / period_s;
        let is_even = (0.5..1.5).contains(&interval) && values[row].is_finite();
        uneven[row] = uneven[row - 1] + u32::from(!is_even);
    }
    let noise = noise_of(values, series);
    let mut surest: Option<Abruptness> = None;
    let mut resolved = f64::INFINITY;
    for half in HALVES {
        let fit = Fit::new(half, period_s, series);
        let by_steps = 0.5 * step * fit.most();
        let floor_of = |noise: f64| (SIGMAS * noise * fit.gain()).max(by_steps);
        let floor = floor_of(noise.all);
        let window_s = 2.0 * half as f64 * period_s;
        if window_s <= BRIEF_S {
            resolved = resolved.min(floor);
        }
        let last = rows.saturating_sub(half);
        for first in (half..last).step_by(BLOCK) {
            let mut accelerations = [0.0; BLOCK];
            let accelerations = &mut accelerations[..BLOCK.min(last - first)];
            fit.along(values, first, accelerations);
            // A NaN is larger than nothing.
            let largest = accelerations
                .iter()
                .fold(0.0, |most, a| if a.abs() > most { a.abs() } else { most });
            let excess = |best: &Abruptness| best.acceleration - best.noise;
            if surest.as_ref().is_some_and(|best| largest - floor <= excess(best)) {
                continue;
            }
            for (row, acceleration) in (first..).zip(accelerations.iter().map(|a| a.abs())) {
                let is_even = uneven[row + half] == uneven[row - half];
                let floor = floor_of(noise.at(row));
                let is_surer = |acceleration: f64| {
                    let surer = |best: &Abruptness| acceleration - floor > excess(best);
                    acceleration.is_finite() && surest.as_ref().is_none_or(surer)
                };
                if !is_even || !is_surer(acceleration) {
                    continue;
                }
                // Stamps may jitter, or samples may: what is there shows either way.
                let acceleration = acceleration.min(fit.as_stamped(t_s, values, row).abs());
                // An acceleration leaves another speed. A value that is early, late or off does not.
                let change = speed_change(t_s, values, series, (row - half, row + half));
                let acceleration = acceleration.min(change / (LEAST_CHANGE * window_s));
                if is_surer(acceleration) {
                    surest = Some(Abruptness {
                        acceleration,
                        noise: floor,
                        window_s,
                        at_s: t_s[row],
                        jerk: fit.jerk(values, row, period_s),
                        resolved: f64::INFINITY,
                    });
                }
            }
        }
    }
    surest.map(|surest| Abruptness { resolved, ..surest })
}

/// By how much the speed differs after the rows `from..=to` from before, by the samples beside them; 0 where there
/// are too few.
fn speed_change(t_s: &[f64], values: &[f64], series: Series, (from, to): (usize, usize)) -> f64 {
    const LEAST_ROWS: usize = 4;
    const MOST_ROWS: usize = 16;
    let near = |at: usize, other: usize| (t_s[other] - t_s[at]).abs() <= BRIEF_S;
    let first = (from.saturating_sub(MOST_ROWS - 1)..=from).find(|row| near(from, *row));
    let last = (to..values.len().min(to + MOST_ROWS)).rev().find(|row| near(to, *row));
    let speed = |rows: std::ops::RangeInclusive<usize>| {
        let (t_s, values) = (&t_s[rows.clone()], &values[rows]);
        if values.len() < LEAST_ROWS {
            return None;
        }
        let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
        let (mean_s, mean_value) = (mean(t_s), mean(values));
        match series {
            Series::Velocities => Some(mean_value),
            Series::Positions => {
                let along = t_s.iter().zip(values);
                let along: f64 = along.map(|(t, q)| (t - mean_s) * (q - mean_value)).sum();
                Some(along / t_s.iter().map(|t| (t - mean_s).powi(2)).sum::<f64>())
            }
        }
    };
    let before = first.and_then(|first| speed(first..=from));
    let after = last.and_then(|last| speed(to..=last));
    before.zip(after).map_or(0.0, |(before, after)| (after - before).abs())
}

/// Every one of `count`, or as many evenly spread over them as noise is told from.
fn strided(count: usize) -> impl Iterator<Item = usize> + Clone {
    (0..count).step_by(count.div_ceil(MOST_WINDOWS).max(1))
}

/// The samples without those that only repeat the one before, where many do while the joint moves: a
/// driver's reading that is published more often than it is taken.
fn without_repeats<'a>(t_s: &'a [f64], values: &'a [f64]) -> (Cow<'a, [f64]>, Cow<'a, [f64]>) {
    /// From this share of the intervals between changes on, repeats are of the publisher's making.
    const SHARE: f64 = 0.3;
    /// Changes farther apart than this many samples have a rest between them.
    const REST: usize = 20;
    let is_change = |row: &usize| *row == 0 || values[*row] != values[*row - 1];
    let (mut last, mut all, mut repeated) = (0, 0_u32, 0_u32);
    for row in (0..values.len()).filter(is_change).skip(1) {
        let gap = row - last;
        last = row;
        if gap < REST {
            all += 1;
            repeated += u32::from(gap > 1);
        }
    }
    if f64::from(repeated) <= SHARE * f64::from(all) {
        return (t_s.into(), values.into());
    }
    let changes = (0..values.len()).filter(is_change);
    let (t_s, values): (Vec<f64>, Vec<f64>) = changes.map(|row| (t_s[row], values[row])).unzip();
    (t_s.into(), values.into())
}

/// Standard deviation of the noise of single samples, by differences that smooth motion hardly has
/// (second of velocities, fourth of positions).
struct Noise {
    /// Of all samples or of the quarter that moves fastest, whichever is more, as uneven stamps feign
    /// noise that grows with speed.
    all: f64,
    /// Of blocks of `length` samples, one after another.
    blocks: Vec<f64>,
    length: usize,
}

impl Noise {
    /// Around a sample: of all, of its block or of those beside it, whichever is most.
    fn at(&self, row: usize) -> f64 {
        let block = row / self.length;
        let near = block.saturating_sub(1)..(block + 2).min(self.blocks.len());
        self.blocks
            .get(near)
            .unwrap_or_default()
            .iter()
            .fold(self.all, |most, noise| most.max(*noise))
    }
}

fn noise_of(values: &[f64], series: Series) -> Noise {
    /// What is left of the samples when stops are left out, which numbers that come in steps are not.
    const KEPT: f64 = 0.95;
    /// The same of a block, of which a stop is a larger part.
    const KEPT_OF_BLOCK: f64 = 0.75;
    /// Windows of a block.
    const WINDOWS: usize = 128;
    let (difference, weight): (fn(&[f64]) -> f64, f64) = match series {
        Series::Velocities => (|w| w[1] - 2.0 * w[2] + w[3], 6.0),
        Series::Positions => (|w| w[0] - 4.0 * w[1] + 6.0 * w[2] - 4.0 * w[3] + w[4], 70.0),
    };
    let speed = |w: &[f64]| match series {
        Series::Velocities => w[2].abs(),
        Series::Positions => (w[3] - w[1]).abs(),
    };
    let count = values.len().saturating_sub(4);
    let windows = || strided(count).map(|first| &values[first..first + 5]);
    let fast = quantile_of(windows().map(speed), 0.75).unwrap_or(0.0);
    let moving = windows().filter(|w| speed(w) >= fast);
    let all = trimmed_rms(windows().map(difference), KEPT);
    let all = all.max(trimmed_rms(moving.map(difference), KEPT)) / weight.sqrt();
    let length = count.div_ceil(MOST_WINDOWS).max(1) * WINDOWS;
    let of_block = |first: usize| {
        let rows = (first..(first + length).min(count)).step_by(length / WINDOWS);
        let differences = rows.map(|row| difference(&values[row..row + 5]));
        trimmed_rms(differences, KEPT_OF_BLOCK) / weight.sqrt()
    };
    Noise { all, blocks: (0..count).step_by(length).map(of_block).collect(), length }
}

/// Root mean square of the share `kept` of values that are smallest, as normal noise has it with the
/// rest: of what lies within `z` deviations the variance is 1 − 2zφ(z)/kept.
fn trimmed_rms(values: impl Iterator<Item = f64>, kept: f64) -> f64 {
    let normal = Normal::standard();
    let z = normal.inverse_cdf(0.5 * (1.0 + kept));
    let variance = 1.0 - 2.0 * z * normal.pdf(z) / kept;
    let mut squares: Vec<f64> = values.map(|value| value * value).collect();
    squares.retain(|square| square.is_finite());
    let count = (squares.len() as f64 * kept) as usize;
    if count == 0 {
        return 0.0;
    }
    squares.select_nth_unstable_by(count - 1, f64::total_cmp);
    (squares[..count].iter().sum::<f64>() / (count as f64 * variance)).sqrt()
}

fn median_of(values: impl Iterator<Item = f64>) -> Option<f64> {
    quantile_of(values, 0.5)
}

fn quantile_of(values: impl Iterator<Item = f64>, part: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    quantile(&mut values, part)
}

/// Acceleration by least squares over evenly spaced samples.
struct Fit {
    half: usize,
    series: Series,
    /// What each sample of the window counts.
    weights: Vec<f64>,
}

impl Fit {
    fn new(half: usize, period_s: f64, series: Series) -> Self {
        let offsets = || (0..=2 * half).map(|at| at as f64 - half as f64);
        let weights: Vec<f64> = match series {
            Series::Velocities => {
                let squares: f64 = offsets().map(|k| k * k).sum();
                offsets().map(|k| k / (squares * period_s)).collect()
            }
            Series::Positions => {
                let mean = offsets().map(|k| k * k).sum::<f64>() / (2 * half + 1) as f64;
                let squares: f64 = offsets().map(|k| (k * k - mean).powi(2)).sum();
                let scale = 2.0 / (squares * period_s * period_s);
                offsets().map(|k| scale * (k * k - mean)).collect()
            }
        };
        Self { half, series, weights }
    }

    /// What it makes of noise of unit deviation.
    fn gain(&self) -> f64 {
        self.weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt()
    }

    /// The most that it makes of errors of 1 at most.
    fn most(&self) -> f64 {
        self.weights.iter().map(|weight| weight.abs()).sum()
    }

    /// The acceleration at `row`, which lies no nearer to an end than half a window.
    fn at(&self, values: &[f64], row: usize) -> f64 {
        let window = &values[row - self.half..=row + self.half];
        window.iter().zip(&self.weights).map(|(value, weight)| value * weight).sum()
    }

    /// The acceleration at `row` by least squares over the samples at their stamps; NaN where these tell
    /// none.
    fn as_stamped(&self, t_s: &[f64], values: &[f64], row: usize) -> f64 {
        let window = row - self.half..=row + self.half;
        let scale = (t_s[row + self.half] - t_s[row - self.half]).max(f64::MIN_POSITIVE);
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (t, value) in t_s[window.clone()].iter().zip(&values[window]) {
            let x = (t - t_s[row]) / scale;
            // A line needs no bend, and three samples have none to spare.
            let bend = if self.series == Series::Positions { x * x } else { 0.0 };
            let powers = Vector3::new(1.0, x, bend);
            normal += powers * powers.transpose();
            right += powers * (value - values[row]);
        }
        if self.series == Series::Velocities {
            normal[(2, 2)] = 1.0;
        }
        let fit = normal.lu().solve(&right);
        fit.map_or(f64::NAN, |fit| match self.series {
            Series::Positions => 2.0 * fit[2] / (scale * scale),
            Series::Velocities => fit[1] / scale,
        })
    }

    /// The accelerations at the rows from `first` on, as many as there is room for.
    fn along(&self, values: &[f64], first: usize, accelerations: &mut [f64]) {
        let count = accelerations.len();
        let beside = |place: usize| &values[first - self.half + place..][..count];
        let middle = self.weights[self.half];
        for (sum, value) in accelerations.iter_mut().zip(beside(self.half)) {
            *sum = middle * value;
        }
        // What lies as far before the middle as another after it counts as much, up to its sign.
        for place in 0..self.half {
            let mirrored = self.weights.len() - 1 - place;
            let (weight, sign) = (self.weights[mirrored], self.weights[place].signum());
            let sign = sign * weight.signum();
            let pairs = beside(place).iter().zip(beside(mirrored));
            for (sum, (before, after)) in accelerations.iter_mut().zip(pairs) {
                *sum += weight * (after + sign * before);
            }
        }
    }

    /// The largest change of acceleration from `row` over half a window before or after it.
    fn jerk(&self, values: &[f64], row: usize, period_s: f64) -> f64 {
        let here = self.at(values, row);
        let beside = [row.checked_sub(self.half), Some(row + self.half)].into_iter().flatten();
        let inside = beside.filter(|at| *at >= self.half && at + self.half < values.len());
        let change = inside.map(|at| (self.at(values, at) - here).abs()).fold(0.0, f64::max);
        change / (self.half as f64 * period_s)
    }
}
