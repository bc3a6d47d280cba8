//! Latency profiles without steps: load-dependent and piecewise linear.

use super::{
    LatencyProfile, LatencyShape, LatencyWindow, MIN_CHI2_GAIN, NormalizedSample, WINDOW_S,
};
use ground::stats::Measured;
use nalgebra::{DMatrix, DVector};

/// Residual in units of the noise, after compensating `beyond_s`. Each window has a free constant, because
/// model error depends on configuration.
pub(super) fn residual_after(
    samples: &[NormalizedSample],
    mut beyond_s: impl FnMut(usize) -> f64,
) -> f64 {
    let mut row = 0;
    by_window(samples)
        .map(|window| {
            let (mut sum, mut square) = ([0.0; 6], 0.0);
            for sample in window {
                let delta_s = beyond_s(row);
                row += 1;
                let residual: [f64; 6] =
                    std::array::from_fn(|i| sample.residual[i] + delta_s * sample.velocity[i]);
                for (sum, residual) in sum.iter_mut().zip(residual) {
                    *sum += residual;
                    square += residual * residual;
                }
            }
            square - sum.iter().map(|sum| sum * sum).sum::<f64>() / window.len() as f64
        })
        .sum()
}

fn by_window(samples: &[NormalizedSample]) -> impl Iterator<Item = &[NormalizedSample]> {
    let mut rest = samples;
    std::iter::from_fn(move || {
        let first = rest.first()?;
        let length = rest.partition_point(|sample| sample.t_s < first.t_s + WINDOW_S);
        let (own, after) = rest.split_at(length.max(1));
        rest = after;
        Some(own)
    })
}

/// Least squares of `residual = c − (a + b·load)·velocity` with a constant c per window: products of
/// velocity and velocity times load, and theirs with the residual.
#[derive(Clone, Copy, Default)]
struct LoadSums {
    matrix: [f64; 3],
    right: [f64; 2],
}

impl LoadSums {
    fn from_window(window: &[NormalizedSample], load: &[f64]) -> Self {
        let n = window.len() as f64;
        let mut mean = [[0.0; 6]; 3];
        let row = |sample: &NormalizedSample, load: f64| -> [[f64; 6]; 3] {
            [sample.velocity, sample.velocity.map(|v| v * load), sample.residual]
        };
        for (sample, load) in window.iter().zip(load) {
            for (mean, own) in mean.iter_mut().flatten().zip(row(sample, *load).iter().flatten()) {
                *mean += own / n;
            }
        }
        let mut sums = Self::default();
        for (sample, load) in window.iter().zip(load) {
            let mut own = row(sample, *load);
            for (own, mean) in own.iter_mut().flatten().zip(mean.iter().flatten()) {
                *own -= mean;
            }
            let dot =
                |a: usize, b: usize| own[a].iter().zip(&own[b]).map(|(a, b)| a * b).sum::<f64>();
            let products = [dot(0, 0), dot(0, 1), dot(1, 1)];
            sums.matrix.iter_mut().zip(products).for_each(|(sum, own)| *sum += own);
            sums.right.iter_mut().zip([-dot(0, 2), -dot(1, 2)]).for_each(|(sum, own)| *sum += own);
        }
        sums
    }

    fn combined_with(mut self, other: &Self, sign: f64) -> Self {
        self.matrix.iter_mut().zip(other.matrix).for_each(|(sum, own)| *sum += sign * own);
        self.right.iter_mut().zip(other.right).for_each(|(sum, own)| *sum += sign * own);
        self
    }

    /// Constant and slope.
    fn solve(&self) -> Option<[f64; 2]> {
        let ([aa, ab, bb], [a, b]) = (self.matrix, self.right);
        let determinant = aa * bb - ab * ab;
        (determinant > 1e-9 * aa * bb)
            .then(|| [(a * bb - b * ab) / determinant, (aa * b - ab * a) / determinant])
    }
}

/// Load is the joint or tool speed, possibly low-pass filtered. `None` if the latency does not depend on
/// it.
pub(super) fn fit_load_dependence(samples: &[NormalizedSample]) -> Option<LatencyProfile> {
    const FILTER_TIMES_S: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.4];
    /// Share of the excess residual with a constant latency.
    const MAX_RESIDUAL_RATIO: f64 = 0.5;
    let constant = residual_after(samples, {
        let zero = vec![0.0; samples.len()];
        let sums = load_windows(samples, &zero)
            .fold(LoadSums::default(), |sum, addend| sum.combined_with(&addend, 1.0));
        let level_s = sums.right[0] / sums.matrix[0].max(f64::MIN_POSITIVE);
        move |_| level_s
    });
    let noise = 3.0 * samples.len() as f64;
    let fit = |kind: usize, slow_s: f64| {
        let load = filtered(samples, kind, slow_s);
        let windows: Vec<LoadSums> = load_windows(samples, &load).collect();
        let all =
            windows.iter().fold(LoadSums::default(), |sum, addend| sum.combined_with(addend, 1.0));
        let [level_s, slope] = all.solve()?;
        let residual = residual_after(samples, |row| level_s + slope * load[row]);
        Some((residual, load, windows, all, [level_s, slope]))
    };
    let tried = [0, 1].into_iter().flat_map(|kind| FILTER_TIMES_S.map(|slow_s| (kind, slow_s)));
    let fits = tried.filter_map(|(kind, slow_s)| fit(kind, slow_s));
    let (residual, load, windows, all, [level_s, slope]) =
        fits.min_by(|a, b| a.0.total_cmp(&b.0))?;
    if residual - noise > MAX_RESIDUAL_RATIO * (constant - noise) {
        return None;
    }
    let size = windows.len().div_ceil(JACKKNIFE_BLOCKS).max(1);
    let without = windows.chunks(size).filter_map(|block| {
        let rest = block.iter().fold(all, |sum, addend| sum.combined_with(addend, -1.0));
        Some(rest.solve()?[1])
    });
    let without: Vec<f64> = without.collect();
    let parts = without.len() as f64;
    let spread: f64 = without.iter().map(|one| (one - slope).powi(2)).sum();
    let std_error = ((parts - 1.0).max(1.0) / parts * spread).sqrt();
    let (min_load, max_load) =
        load.iter().fold((f64::MAX, f64::MIN), |(min_load, max_load), load| {
            (min_load.min(*load), max_load.max(*load))
        });
    let range = max_load - min_load;
    let swing_s = Measured { value: slope * range, std_error: std_error * range, dof: parts };
    let is_certain = parts >= 4.0 && slope.abs() > MIN_STD_ERRORS * std_error;
    is_certain.then(|| LatencyProfile {
        swing_s,
        is_unsteady: true,
        shape: LatencyShape::WithLoad,
        steps: Vec::new(),
        levels: samples
            .iter()
            .zip(&load)
            .map(|(sample, load)| (sample.t_s, level_s + slope * load))
            .collect(),
        windows: Vec::new(),
    })
}

fn load_windows<'a>(
    samples: &'a [NormalizedSample],
    load: &'a [f64],
) -> impl Iterator<Item = LoadSums> + 'a {
    let mut from = 0;
    by_window(samples).map(move |own| {
        let to = from + own.len();
        let sums = LoadSums::from_window(own, &load[from..to]);
        from = to;
        sums
    })
}

/// First-order low-pass.
fn filtered(samples: &[NormalizedSample], kind: usize, slow_s: f64) -> Vec<f64> {
    let mut state = samples.first().map_or(0.0, |sample| sample.loads[kind]);
    let mut before_s = samples.first().map_or(0.0, |sample| sample.t_s);
    samples
        .iter()
        .map(|sample| {
            let step_s = sample.t_s - before_s;
            before_s = sample.t_s;
            let share = if slow_s > 0.0 { 1.0 - (-step_s / slow_s).exp() } else { 1.0 };
            state += share * (sample.loads[kind] - state);
            state
        })
        .collect()
}

/// Selects knots on `windows` and fits levels to `samples`; a ramp if one segment is not level. `None` if
/// no fit with few segments is significant.
pub(super) fn fit_piecewise_linear(
    windows: &[LatencyWindow],
    samples: &[NormalizedSample],
) -> Option<LatencyProfile> {
    /// Inner knots.
    const MAX_KNOTS: usize = 16;
    /// To fit the levels.
    const MAX_SAMPLES: usize = 6000;
    let (first, last) = (windows.first()?, windows.last()?);
    let mut knots = vec![first.t_s, last.t_s];
    let of_windows = |knots: &[f64]| Some(solve_levels(knots, window_sums(windows, knots))?.1);
    let mut min_chi2 = of_windows(&knots)?;
    // One knot barely improves the fit of a ramp within the run, so try two.
    if let Some((chi2, two)) = two_knots(windows, &knots, &of_windows)
        && min_chi2 - chi2 > MIN_CHI2_GAIN * (chi2 / windows.len() as f64).max(1.0)
    {
        (min_chi2, knots) = (chi2, two);
    }
    while knots.len() < (windows.len() / 2).min(MAX_KNOTS + 2) {
        let tried = windows.iter().map(|window| window.t_s).filter(|t_s| !knots.contains(t_s));
        let with = tried.filter_map(|t_s| {
            let mut with = knots.clone();
            with.push(t_s);
            with.sort_by(f64::total_cmp);
            Some((of_windows(&with)?, with))
        });
        let Some((_, mut with)) = with.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
        let shifted_chi2 = shift_knots(&mut with, &[1.0, 0.5], &of_windows)?;
        let free = (windows.len() as f64 - 2.0 * with.len() as f64).max(1.0);
        if min_chi2 - shifted_chi2 < MIN_CHI2_GAIN * (shifted_chi2 / free).max(1.0) {
            break;
        }
        (min_chi2, knots) = (shifted_chi2, with);
    }
    let stride = samples.len().div_ceil(MAX_SAMPLES).max(1);
    let thinned: Vec<NormalizedSample> = samples.iter().step_by(stride).copied().collect();
    let of_samples =
        |knots: &[f64]| Some(solve_levels(knots, total(&sample_sums(&thinned, knots)))?.1);
    let mut min_chi2 = shift_knots(&mut knots, &[0.5, 0.25, 0.1], &of_samples)?;
    // A later knot can make one redundant.
    loop {
        let fewer_knots = (1..knots.len() - 1).filter_map(|at| {
            let mut fewer_knots = knots.clone();
            fewer_knots.remove(at);
            Some((shift_knots(&mut fewer_knots, &[0.5, 0.25, 0.1], &of_samples)?, fewer_knots))
        });
        let Some((chi2, fewer_knots)) = fewer_knots.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            break;
        };
        if chi2 - min_chi2 > MIN_KNOT_GAIN * min_chi2.max(3.0 * thinned.len() as f64) {
            break;
        }
        (min_chi2, knots) = (chi2, fewer_knots);
    }
    let min_chi2 = shift_knots(&mut knots, &[0.25, 0.1, 0.05], &of_samples);
    let sums = sample_sums(&thinned, &knots);
    let (level_s, _) = solve_levels(&knots, total(&sums)).filter(|_| min_chi2.is_some())?;
    let at = |knot: usize| level_s[knot];
    let order = |a: &usize, b: &usize| at(*a).total_cmp(&at(*b));
    let all = || 0..knots.len();
    let (low, high) = (all().min_by(order)?, all().max_by(order)?);
    let std_error = jackknife(&sums, |sums| {
        let (level_s, _) = solve_levels(&knots, sums)?;
        Some(level_s[high] - level_s[low])
    });
    let (swing, from, to) = (at(high) - at(low), low.min(high), low.max(high));
    let is_same_level =
        |knot: usize, other: usize| (at(knot) - at(other)).abs() < MAX_LEVEL_DIFFERENCE * swing;
    let (mut begin, mut end) = (from, to);
    while begin + 1 < to && is_same_level(begin + 1, from) {
        begin += 1;
    }
    while end > begin + 1 && is_same_level(end - 1, to) {
        end -= 1;
    }
    let is_level = (0..begin).all(|knot| is_same_level(knot, from))
        && (end..knots.len()).all(|knot| is_same_level(knot, to));
    let (shape, value) = match is_level && end == begin + 1 {
        true => (LatencyShape::Ramp { from_s: knots[begin], to_s: knots[end] }, at(to) - at(from)),
        false => (LatencyShape::Wander, swing),
    };
    let swing_s = Measured { value, std_error, dof: JACKKNIFE_BLOCKS as f64 };
    (value.abs() > 0.5 * MIN_STD_ERRORS * std_error).then(|| LatencyProfile {
        swing_s,
        is_unsteady: true,
        shape,
        steps: Vec::new(),
        levels: knots.iter().copied().zip(level_s.iter().copied()).collect(),
        windows: Vec::new(),
    })
}

/// Levels and inner knots.
pub(super) const THREE_SEGMENT_PARAMETERS: f64 = 6.0;

pub(super) fn piecewise_chi2(windows: &[LatencyWindow]) -> Option<f64> {
    let ends = [windows.first()?.t_s, windows.last()?.t_s];
    let chi2_of = |knots: &[f64]| Some(solve_levels(knots, window_sums(windows, knots))?.1);
    Some(two_knots(windows, &ends, &chi2_of)?.0)
}

/// Inner knots with the smallest residual; returns it and all knots.
fn two_knots(
    windows: &[LatencyWindow],
    ends: &[f64],
    chi2_of: &impl Fn(&[f64]) -> Option<f64>,
) -> Option<(f64, Vec<f64>)> {
    const MAX_TRIAL_TIMES: usize = 40;
    let inner = windows.get(1..windows.len().saturating_sub(1))?;
    let times: Vec<f64> = inner
        .iter()
        .step_by(inner.len().div_ceil(MAX_TRIAL_TIMES).max(1))
        .map(|one| one.t_s)
        .collect();
    let pairs =
        times.iter().enumerate().flat_map(|(at, a)| times[at + 1..].iter().map(move |b| (*a, *b)));
    let with = pairs.filter_map(|(a, b)| {
        let knots = vec![ends[0], a, b, ends[1]];
        Some((chi2_of(&knots)?, knots))
    });
    with.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// `None` if not all levels are determined.
pub(super) fn levels_at(knots: &[f64], windows: &[(f64, Measured)]) -> Option<Vec<f64>> {
    let windows: Vec<LatencyWindow> = windows
        .iter()
        .map(|(t_s, found)| LatencyWindow {
            t_s: *t_s,
            delta_s: found.value,
            std_error_s: found.std_error,
        })
        .collect();
    let is_enough = knots.len() > 1 && windows.len() >= knots.len();
    is_enough
        .then(|| solve_levels(knots, window_sums(&windows, knots)))?
        .map(|(level_s, _)| level_s)
}

/// Share of the swing, for knots on one level.
const MAX_LEVEL_DIFFERENCE: f64 = 0.12;
/// Share of the residual, by removing the knot.
const MIN_KNOT_GAIN: f64 = 0.01;
/// Quenouille 1956.
const JACKKNIFE_BLOCKS: usize = 20;
const MIN_STD_ERRORS: f64 = 8.0;

#[derive(Clone)]
struct KnotEquations {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    square: f64,
}

impl KnotEquations {
    fn zeros(n: usize) -> Self {
        Self { matrix: DMatrix::zeros(n, n), right: DVector::zeros(n), square: 0.0 }
    }

    fn add(&mut self, other: &Self, sign: f64) {
        self.matrix += sign * &other.matrix;
        self.right += sign * &other.right;
        self.square += sign * other.square;
    }
}

/// Adjacent knots and their interpolation weights.
fn hats(knots: &[f64], t_s: f64) -> [(usize, f64); 2] {
    let after = knots.partition_point(|knot| *knot <= t_s).clamp(1, knots.len() - 1);
    let part = ((t_s - knots[after - 1]) / (knots[after] - knots[after - 1])).clamp(0.0, 1.0);
    [(after - 1, 1.0 - part), (after, part)]
}

/// Levels and residual. A level without data, as at rest, is close to its neighbours'.
fn solve_levels(knots: &[f64], sums: KnotEquations) -> Option<(Vec<f64>, f64)> {
    /// Ties adjacent levels, as a share of the mean information about a level.
    const LEVEL_TIE_WEIGHT: f64 = 1e-5;
    let KnotEquations { mut matrix, right, square } = sums;
    debug_assert_eq!(right.len(), knots.len());
    let unregularized = matrix.clone();
    let tie = LEVEL_TIE_WEIGHT * matrix.trace() / knots.len() as f64;
    for knot in 1..knots.len() {
        matrix[(knot - 1, knot - 1)] += tie;
        matrix[(knot, knot)] += tie;
        matrix[(knot - 1, knot)] -= tie;
        matrix[(knot, knot - 1)] -= tie;
    }
    let level = matrix.cholesky()?.solve(&right);
    let chi2 = square - 2.0 * level.dot(&right) + level.dot(&(unregularized * &level));
    Some((level.iter().copied().collect(), chi2))
}

fn window_sums(windows: &[LatencyWindow], knots: &[f64]) -> KnotEquations {
    let mut sums = KnotEquations::zeros(knots.len());
    for window in windows {
        sums.square += window.weight() * window.delta_s.powi(2);
        for (row, a) in hats(knots, window.t_s) {
            sums.right[row] += window.weight() * a * window.delta_s;
            for (column, b) in hats(knots, window.t_s) {
                sums.matrix[(row, column)] += window.weight() * a * b;
            }
        }
    }
    sums
}

/// Least squares of `residual = c − level·velocity` with a constant c per window.
fn sample_sums(samples: &[NormalizedSample], knots: &[f64]) -> Vec<KnotEquations> {
    let n = knots.len();
    let of_window = |window: &[NormalizedSample]| {
        let mut sums = KnotEquations::zeros(n);
        let (mut moved, mut residual) = (vec![[0.0; 6]; n], [0.0; 6]);
        let mut touched: Vec<usize> = Vec::new();
        for sample in window {
            let hats = hats(knots, sample.t_s);
            let dot = |a: &[f64; 6], b: &[f64; 6]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let (vv, vr) =
                (dot(&sample.velocity, &sample.velocity), dot(&sample.velocity, &sample.residual));
            sums.square += dot(&sample.residual, &sample.residual);
            residual.iter_mut().zip(sample.residual).for_each(|(sum, window)| *sum += window);
            for (row, a) in hats {
                if !touched.contains(&row) {
                    touched.push(row);
                }
                moved[row]
                    .iter_mut()
                    .zip(sample.velocity)
                    .for_each(|(sum, window)| *sum += a * window);
                sums.right[row] -= a * vr;
                for (column, b) in hats {
                    sums.matrix[(row, column)] += a * b * vv;
                }
            }
        }
        let count = window.len().max(1) as f64;
        let dot =
            |a: &[f64; 6], b: &[f64; 6]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / count;
        sums.square -= dot(&residual, &residual);
        for &row in &touched {
            sums.right[row] += dot(&moved[row], &residual);
            for &column in &touched {
                sums.matrix[(row, column)] -= dot(&moved[row], &moved[column]);
            }
        }
        sums
    };
    by_window(samples).map(of_window).collect()
}

fn total(sums: &[KnotEquations]) -> KnotEquations {
    let mut all = KnotEquations::zeros(sums.first().map_or(0, |sums| sums.right.len()));
    sums.iter().for_each(|own| all.add(own, 1.0));
    all
}

/// Standard error from the windows' sums.
fn jackknife(sums: &[KnotEquations], statistic: impl Fn(KnotEquations) -> Option<f64>) -> f64 {
    let all = total(sums);
    let parts = sums.chunks(sums.len().div_ceil(JACKKNIFE_BLOCKS).max(1));
    let without: Vec<f64> = parts
        .filter_map(|part| {
            let mut rest = all.clone();
            part.iter().for_each(|own| rest.add(own, -1.0));
            statistic(rest)
        })
        .collect();
    let n = without.len() as f64;
    if n < 4.0 {
        return f64::INFINITY;
    }
    let mean = without.iter().sum::<f64>() / n;
    let spread: f64 = without.iter().map(|one| (one - mean).powi(2)).sum();
    ((n - 1.0) / n * spread).sqrt()
}

/// Decreasing steps; returns the residual.
fn shift_knots(
    knots: &mut [f64],
    steps_s: &[f64],
    chi2_of: &impl Fn(&[f64]) -> Option<f64>,
) -> Option<f64> {
    const MIN_KNOT_SEPARATION_S: f64 = 0.2;
    let mut best = chi2_of(knots)?;
    for &step_s in steps_s {
        for knot in 1..knots.len().saturating_sub(1) {
            for by_s in [step_s, -step_s] {
                loop {
                    let before = knots[knot];
                    knots[knot] += by_s;
                    let is_between = knots[knot] > knots[knot - 1] + MIN_KNOT_SEPARATION_S
                        && knots[knot] < knots[knot + 1] - MIN_KNOT_SEPARATION_S;
                    let tried = is_between.then(|| chi2_of(knots)).flatten();
                    match tried.filter(|tried| *tried < best) {
                        Some(better) => best = better,
                        None => {
                            knots[knot] = before;
                            break;
                        }
                    }
                }
            }
        }
    }
    Some(best)
}
