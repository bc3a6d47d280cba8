//! Shapes of a latency over time. Each is linear in its levels, given a few times.

use super::windows::{BIN_S, Bin, Terms, Window, effective_count};
use crate::priors::price_of_cause;
use ground::stats::highest;
use ground::stats::thin::thinned;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector6};

/// Levels of a latency over time.
pub(super) enum Basis {
    /// Constant between these times.
    Steps(Vec<f64>),
    /// A constant, and skew about this time.
    Line(f64),
    /// Linear between these two times, constant outside.
    Ramp(Vec<f64>),
    /// A cubic spline between these times.
    Spline(Vec<f64>),
    /// A constant, a multiple of this load of each bin, and skew about this time.
    Load(Vec<f64>, f64),
}

impl Basis {
    fn len(&self) -> usize {
        match self {
            Self::Steps(times_s) => times_s.len() + 1,
            Self::Line(_) | Self::Ramp(_) => 2,
            Self::Spline(times_s) => times_s.len(),
            Self::Load(..) => 3,
        }
    }

    /// Number of parameters beyond a line.
    pub fn parameters(&self) -> usize {
        match self {
            // Time and size of each.
            Self::Steps(times_s) => 2 * times_s.len(),
            Self::Line(_) => 0,
            // Start, end and size.
            Self::Ramp(_) => 3,
            // Their distance and the levels.
            Self::Spline(times_s) => times_s.len(),
            // Kind of load and slope.
            Self::Load(..) => 2,
        }
    }

    /// Price of the causes beyond a line. The score of steps and knots is at most minus this: their residual is at least
    /// that with a constant latency per window.
    fn price(&self, windows: f64) -> f64 {
        match self {
            Self::Line(_) => 0.0,
            Self::Steps(times_s) => times_s.len() as f64 * price_of_cause(2, windows),
            other => price_of_cause(other.parameters(), windows),
        }
    }

    fn terms(&self, bin: usize, t_s: f64) -> Terms {
        match self {
            Self::Steps(times_s) => only([(times_s.partition_point(|at_s| *at_s <= t_s), 1.0)]),
            Self::Line(middle_s) => only([(0, 1.0), (1, t_s - middle_s)]),
            Self::Ramp(times_s) => {
                let part = ((t_s - times_s[0]) / (times_s[1] - times_s[0])).clamp(0.0, 1.0);
                only([(0, 1.0 - part), (1, part)])
            }
            Self::Spline(times_s) => spline_terms(times_s, t_s),
            Self::Load(load, middle_s) => only([(0, 1.0), (1, load[bin]), (2, t_s - middle_s)]),
        }
    }

    pub fn latency_s(&self, levels_s: &DVector<f64>, bin: usize, t_s: f64) -> f64 {
        self.terms(bin, t_s).into_iter().map(|(level, factor)| factor * levels_s[level]).sum()
    }
}

fn only<const N: usize>(terms: [(usize, f64); N]) -> Terms {
    std::array::from_fn(|at| terms.get(at).copied().unwrap_or((0, 0.0)))
}

/// Terms of a cubic spline through levels at these times, which are about evenly spaced (Catmull and Rom 1974, *A Class of
/// Local Interpolating Splines*). It ends straight.
fn spline_terms(times_s: &[f64], t_s: f64) -> Terms {
    let last = times_s.len() - 1;
    let after = times_s.partition_point(|at_s| *at_s <= t_s).clamp(1, last);
    let before = after - 1;
    let u = ((t_s - times_s[before]) / (times_s[after] - times_s[before])).clamp(0.0, 1.0);
    let outer = [u * (-0.5 + u * (1.0 - 0.5 * u)), u * u * (0.5 * u - 0.5)];
    let mut inner = [1.0 + u * u * (1.5 * u - 2.5), u * (0.5 + u * (2.0 - 1.5 * u))];
    // Beyond its ends, the spline is extrapolated.
    let mut terms = [(0, 0.0); 4];
    match before.checked_sub(1) {
        Some(earlier) => terms[0] = (earlier, outer[0]),
        None => (inner[0], inner[1]) = (inner[0] + 2.0 * outer[0], inner[1] - outer[0]),
    }
    match after + 1 {
        later if later <= last => terms[3] = (later, outer[1]),
        _ => (inner[0], inner[1]) = (inner[0] - outer[1], inner[1] + 2.0 * outer[1]),
    }
    (terms[1], terms[2]) = ((before, inner[0]), (after, inner[1]));
    terms
}

/// A fitted latency.
pub(super) struct Fit {
    pub basis: Basis,
    pub levels_s: DVector<f64>,
    information: Cholesky<f64, Dyn>,
    /// Scatter of the windows, relative to their standard errors (Birge 1932).
    scatter: f64,
    /// Square sum of the residuals, beyond that with a constant latency per window.
    square: f64,
    /// Twice the log-likelihood, minus the prices of its parameters.
    pub score: f64,
}

impl Fit {
    pub fn new(windows: &[Window], basis: Basis) -> Option<Self> {
        /// Ties adjacent levels, as a share of the mean information about a level. A level without data, as at rest,
        /// is close to its neighbours'.
        const TIE: f64 = 1e-5;
        let n = basis.len();
        let (mut matrix, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        let mut velocities = vec![Vector6::<f64>::zeros(); n];
        let mut first = 0;
        for window in windows {
            let terms = |bin: usize, t_s: f64| basis.terms(first + bin, t_s);
            window.accumulate(terms, &mut matrix, &mut right, &mut velocities);
            first += window.bins.len();
        }
        let tie = TIE * matrix.trace() / n as f64;
        if matches!(basis, Basis::Steps(_) | Basis::Ramp(_) | Basis::Spline(_)) {
            for level in 1..n {
                let mut pair = matrix.fixed_view_mut::<2, 2>(level - 1, level - 1);
                pair += tie * Matrix2::new(1.0, -1.0, -1.0, 1.0);
            }
        }
        let information = matrix.cholesky()?;
        let levels_s = information.solve(&right);
        let mut bin_index = 0..;
        let excess = |window: &Window| {
            let latencies_s = window.bins.iter().zip(&mut bin_index);
            window.excess(latencies_s.map(|(bin, at)| basis.latency_s(&levels_s, at, bin.t_s)))
        };
        let excess: Vec<f64> = windows.iter().map(excess).collect();
        let square = excess.iter().sum();
        // Other latencies vary little within a window.
        let excess: f64 = match basis {
            Basis::Line(_) | Basis::Load(..) => square,
            _ => excess.into_iter().map(|excess| excess.max(0.0)).sum(),
        };
        let count = effective_count(windows);
        let scatter = (excess / count).max(1.0);
        let score = -count * scatter.ln() - excess / scatter - basis.price(count);
        Some(Self { basis, levels_s, information, scatter, square, score })
    }

    pub fn covariance(&self) -> DMatrix<f64> {
        self.information.inverse() * self.scatter
    }

    /// The better one.
    fn or(self, other: Self) -> Self {
        if other.score > self.score { other } else { self }
    }
}

/// The likeliest latency. A line is a skew.
pub(super) fn likeliest_shape(windows: &[Window]) -> Option<Fit> {
    let line = Fit::new(windows, Basis::Line(middle_s(windows)))?;
    let shapes = [fit_steps, fit_ramp, fit_wander, fit_load];
    Some(shapes.into_iter().fold(line, |best, fit| match fit(windows, best.score) {
        Some(other) => best.or(other),
        None => best,
    }))
}

/// The likeliest latency with up to four steps. Skips those whose score cannot exceed `min_score`.
fn fit_steps(windows: &[Window], min_score: f64) -> Option<Fit> {
    const MAX_STEPS: usize = 4;
    let between = windows.windows(2).map(|pair| 0.5 * (pair[0].t_s + pair[1].t_s));
    let between: Vec<f64> = between.collect();
    let count = effective_count(windows);
    let (mut times_s, mut best) = (Vec::new(), None::<Fit>);
    for steps in 1..=MAX_STEPS {
        let min_score = best.as_ref().map_or(min_score, |best| best.score.max(min_score));
        if -Basis::Steps(vec![0.0; steps]).price(count) <= min_score {
            break;
        }
        let with = |at_s: &f64| {
            let mut with: Vec<f64> = times_s.iter().copied().chain([*at_s]).collect();
            with.sort_by(f64::total_cmp);
            with
        };
        let tried = between.iter().filter(|at_s| !times_s.contains(at_s)).map(with);
        let Some(likeliest) = likeliest_times(windows, tried, Basis::Steps) else { break };
        let refined = refined_times(windows, likeliest.clone(), Basis::Steps);
        best = best.into_iter().chain(refined).reduce(Fit::or);
        times_s = likeliest;
    }
    best
}

/// The likeliest ramp between two constant levels, if its score may exceed `min_score`.
fn fit_ramp(windows: &[Window], min_score: f64) -> Option<Fit> {
    const MAX_TRIAL_TIMES: usize = 40;
    if -Basis::Ramp(Vec::new()).price(effective_count(windows)) <= min_score {
        return None;
    }
    let times_s: Vec<f64> = thinned(windows, MAX_TRIAL_TIMES).map(|window| window.t_s).collect();
    let pairs = times_s.iter().enumerate();
    let pairs = pairs.flat_map(|(at, a)| times_s[at + 1..].iter().map(move |b| vec![*a, *b]));
    let likeliest = likeliest_times(windows, pairs, Basis::Ramp)?;
    refined_times(windows, likeliest, Basis::Ramp)
}

/// The times that fit best if the latency is constant in each window.
fn likeliest_times(
    windows: &[Window],
    tried: impl Iterator<Item = Vec<f64>>,
    basis: fn(Vec<f64>) -> Basis,
) -> Option<Vec<f64>> {
    let coarse: Vec<Window> = windows.iter().map(Window::as_one_bin).collect();
    let score =
        |times_s: Vec<f64>| Some((Fit::new(&coarse, basis(times_s.clone()))?.score, times_s));
    Some(highest(tried.filter_map(score), |it| it.0)?.1)
}

/// The likeliest spline between the ends of the run and evenly chosen windows whose score may exceed `min_score`.
fn fit_wander(windows: &[Window], min_score: f64) -> Option<Fit> {
    const MIN_KNOTS: usize = 4;
    /// From the end of the run: a level needs motion on both sides.
    const MIN_KNOT_DISTANCE_S: f64 = 0.5;
    let bins = || windows.iter().flat_map(|window| &window.bins);
    let (first_s, last_s) = (bins().next()?.t_s, bins().next_back()?.t_s);
    let strides = std::iter::successors(Some(1), |stride| Some(2 * stride));
    let knots = strides.map(|stride| -> Vec<f64> {
        let inner = windows.iter().step_by(stride).skip(1).map(|window| window.t_s);
        let inner = inner.filter(|t_s| last_s - t_s > MIN_KNOT_DISTANCE_S);
        std::iter::once(first_s).chain(inner).chain([last_s]).collect()
    });
    let knots = knots.take_while(|knots| knots.len() >= MIN_KNOTS);
    let count = effective_count(windows);
    let knots = knots.map(Basis::Spline).filter(|basis| -basis.price(count) > min_score);
    let fits = knots.filter_map(|basis| Fit::new(windows, basis));
    highest(fits, |fit| fit.score)
}

/// The likeliest latency that grows with the joint or tool speed, possibly low-pass filtered.
fn fit_load(windows: &[Window], _: f64) -> Option<Fit> {
    const FILTER_TIMES_S: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.4];
    let middle_s = middle_s(windows);
    let tried = [0, 1].into_iter().flat_map(|kind| FILTER_TIMES_S.map(|slow_s| (kind, slow_s)));
    let fits = tried.filter_map(|(kind, slow_s)| {
        let load = filtered_load(windows, kind, slow_s);
        let varies = load.iter().any(|one| *one != load[0]);
        varies.then(|| Fit::new(windows, Basis::Load(load, middle_s)))?
    });
    highest(fits, |fit| fit.score)
}

pub(super) fn middle_s(windows: &[Window]) -> f64 {
    windows.first().zip(windows.last()).map_or(0.0, |(first, last)| 0.5 * (first.t_s + last.t_s))
}

/// First-order low-pass.
fn filtered_load(windows: &[Window], kind: usize, slow_s: f64) -> Vec<f64> {
    let bins = windows.iter().flat_map(|window| &window.bins);
    let mut before = None;
    let next = |bin: &Bin| {
        let load = bin.loads[kind];
        let (before_s, state) = before.unwrap_or((bin.t_s, load));
        let share = if slow_s > 0.0 { 1.0 - (-(bin.t_s - before_s) / slow_s).exp() } else { 1.0 };
        let filtered = state + share * (load - state);
        before = Some((bin.t_s, filtered));
        filtered
    };
    bins.map(next).collect()
}

/// Shifts the times by decreasing steps while that reduces the residual.
fn refined_times(
    windows: &[Window],
    mut times_s: Vec<f64>,
    basis: fn(Vec<f64>) -> Basis,
) -> Option<Fit> {
    const SHIFTS_S: [f64; 5] = [0.8, 0.4, 0.2, 0.1, BIN_S];
    let mut best = Fit::new(windows, basis(times_s.clone()))?;
    for by_s in SHIFTS_S.into_iter().flat_map(|by_s| [by_s, by_s]) {
        for at in 0..times_s.len() {
            for by_s in [by_s, -by_s] {
                let mut shifted = times_s.clone();
                shifted[at] += by_s;
                let is_in_order = shifted.windows(2).all(|pair| pair[1] - pair[0] >= BIN_S);
                let fit = is_in_order.then(|| Fit::new(windows, basis(shifted.clone()))).flatten();
                if let Some(fit) = fit.filter(|fit| fit.square < best.square) {
                    (best, times_s) = (fit, shifted);
                }
            }
        }
    }
    Some(best)
}
