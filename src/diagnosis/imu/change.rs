//! What an IMU's parameters do over time beside being constant: whether some of them are other ones from a
//! moment on (sup-F over that moment: Andrews 1993), settle exponentially, or hang on something else.
//!
//! All is asked of one linearised model, by what it would leave with more columns: those of the parameters
//! in question, weighted sample by sample.

use super::super::linear::{Linear, Normal, Triangle};
use super::super::noise::Noise;
use super::super::robust::robust_sigma;
use nalgebra::{DMatrix, DVector};

/// Pieces of a run over which a course is sought before it is refined.
const COARSE: usize = 240;
/// Moments that are tried, coarsely and near the best.
const MOMENTS: usize = 60;
/// A change leaves this much on either side of it, as a share of the run.
const SIDE: f64 = 0.06;
/// By how much a change must make the sum of squares smaller, in variances of independent noise: what
/// noise of the same memory does not do at any of the moments tried.
const SURE: f64 = 45.0;
/// Residuals beyond this many standard deviations are strays.
const STRAY: f64 = 8.0;

/// A linearised model, and what is asked of it.
pub(super) struct Asked<'a> {
    linear: &'a Linear,
    /// Time of each sample, s.
    t_s: Vec<f64>,
    /// Parameters that are free.
    base: Vec<usize>,
    /// How much each sample counts.
    counts: Vec<f64>,
    floor: f64,
    /// Sum of squares without more.
    pub squares: f64,
}

/// What explains more.
#[derive(Clone, Debug)]
pub(super) struct Better {
    /// The moment or the time constant, s; 0 where there is none.
    pub at_s: f64,
    /// Its 95 % interval.
    pub interval_s: [f64; 2],
    /// Sum of squares that is left.
    pub squares: f64,
    /// By how much it is smaller, in variances of independent noise.
    gain: f64,
}

impl Better {
    /// Whether noise does not do that.
    pub fn is_sure(&self) -> bool {
        self.gain > SURE
    }
}

impl<'a> Asked<'a> {
    /// Of `linear`, whose samples are at `t_s`, with the parameters `base` free; nothing below `floor`
    /// is statistics.
    pub fn of(linear: &'a Linear, t_s: Vec<f64>, base: &[usize], floor: f64) -> Self {
        let residual = &linear.residual[0];
        let limit = STRAY * robust_sigma(residual).max(floor) * 3f64.sqrt();
        let norm = |r: &[f64; 3]| r.iter().map(|c| c * c).sum::<f64>().sqrt();
        let counts = residual.iter().map(|r| (limit / norm(r)).min(1.0)).collect();
        let base = base.to_vec();
        let mut asked = Self { linear, t_s, base, counts, floor, squares: 0.0 };
        asked.squares = asked.left(&[], &[]).0;
        asked
    }

    fn len(&self) -> usize {
        self.t_s.len()
    }

    fn span(&self) -> Option<(f64, f64)> {
        let (first, last) = (*self.t_s.first()?, *self.t_s.last()?);
        (last > first).then_some((first, last))
    }

    /// Whether the parameters `columns` are other ones from some moment on.
    pub fn step(&self, columns: &[usize]) -> Option<Better> {
        let (first, last) = self.span()?;
        let side_s = SIDE * (last - first);
        let course = Course::of(self, columns);
        let at = |at_s: f64| course.left_by_step(self.t_s.partition_point(|t_s| *t_s <= at_s));
        let (from_s, to_s) = (first + side_s, last - side_s);
        let moment = |k: usize, from_s: f64, to_s: f64| {
            from_s + (to_s - from_s) * k as f64 / (MOMENTS - 1) as f64
        };
        let mut best_s = least((0..MOMENTS).map(|k| moment(k, from_s, to_s)), at)?;
        let mut around_s = 1.5 * (to_s - from_s) / MOMENTS as f64;
        for _ in 0..2 {
            let near = (0..MOMENTS).map(|k| moment(k, best_s - around_s, best_s + around_s));
            best_s = least(near, at)?;
            around_s *= 4.0 / MOMENTS as f64;
        }
        // Any moment between two samples is as good.
        let next = self.t_s.partition_point(|t_s| *t_s <= best_s);
        if let Some(before) = next.checked_sub(1).filter(|_| next < self.len()) {
            best_s = 0.5 * (self.t_s[before] + self.t_s[next]);
        }
        let weight = self.t_s.iter().map(|t_s| f64::from(u8::from(*t_s > best_s))).collect();
        let mut better = self.better(columns, &[weight])?;
        // Moments that are as good but for chance.
        let as_good = better.squares + 3.84 * self.variance(&better);
        let end = |sign: f64| {
            let mut step_s = 1.5 * (last - first) / self.len() as f64;
            let mut end_s = best_s;
            while at(end_s + sign * step_s) < as_good && step_s < last - first {
                end_s += sign * step_s;
                step_s *= 1.5;
            }
            end_s + sign * step_s
        };
        (better.at_s, better.interval_s) = (best_s, [end(-1.0), end(1.0)]);
        Some(better)
    }

    /// Whether the parameters `columns` settle exponentially from the beginning on: `at_s` is the time
    /// constant.
    pub fn decay(&self, columns: &[usize]) -> Option<Better> {
        let (first, last) = self.span()?;
        let span_s = last - first;
        let course = Course::of(self, columns);
        let left = |tau_s: f64, pieces: usize| {
            course.left_by(pieces, |t_s| (-(t_s - first) / tau_s).exp())
        };
        let taus = (0..MOMENTS).map(|k| span_s * 0.03 * 33f64.powf(k as f64 / MOMENTS as f64));
        let tau_s = least(taus, |tau_s| left(tau_s, COARSE))?;
        let finer = (-4..=4).map(|k| tau_s * 1.015f64.powi(k));
        let tau_s = least(finer, |tau_s| left(tau_s, self.len()))?;
        let weight = self.t_s.iter().map(|t_s| (-(t_s - first) / tau_s).exp()).collect();
        let better = self.better(columns, &[weight])?;
        Some(Better { at_s: tau_s, interval_s: [tau_s; 2], ..better })
    }

    /// What is better with the parameters `columns` beside, by each of `weights` sample by sample.
    pub fn better(&self, columns: &[usize], weights: &[Vec<f64>]) -> Option<Better> {
        let (squares, parameters) = self.left(columns, weights);
        let mut better = Better { at_s: 0.0, interval_s: [0.0; 2], squares, gain: 0.0 };
        let residual = self.residual(columns, weights, &parameters);
        let noise = Noise::of(&residual, &self.counts, self.floor);
        let dof = (3 * self.len()) as f64 - parameters.len() as f64;
        let least = self.floor.powi(2);
        let variance = (squares / dof).max(least) * noise.inflation().max(1.0);
        better.gain = (self.squares - squares) / variance;
        better.gain.is_finite().then_some(better)
    }

    /// The variance of independent noise that a gain is counted in.
    fn variance(&self, better: &Better) -> f64 {
        (self.squares - better.squares) / better.gain.max(f64::MIN_POSITIVE)
    }

    /// The sum of squares that is left, and the parameters: the base, then `columns` by the first weights,
    /// and so on.
    fn left(&self, columns: &[usize], weights: &[Vec<f64>]) -> (f64, DVector<f64>) {
        let width = self.base.len() + columns.len() * weights.len();
        let mut sums = Triangle::zeros(width + 1);
        let mut rows = [0, 1, 2].map(|_| vec![0.0; width + 1]);
        for sample in 0..self.len() {
            for (axis, row) in rows.iter_mut().enumerate() {
                self.fill(row, sample, axis, columns, weights);
            }
            sums.add_squares([&rows[0], &rows[1], &rows[2]], self.counts[sample]);
        }
        solved(width, |i, j| sums.at(i, j))
    }

    /// The derivatives of one row, and its residual behind them, into `row`.
    fn fill(
        &self,
        row: &mut [f64],
        sample: usize,
        axis: usize,
        columns: &[usize],
        weights: &[Vec<f64>],
    ) {
        let own = self.linear.row(sample, axis);
        let (base, beside) = row.split_at_mut(self.base.len());
        base.iter_mut().zip(&self.base).for_each(|(value, &column)| *value = own[column]);
        let by_weight = weights
            .iter()
            .flat_map(|weight| columns.iter().map(|&column| weight[sample] * own[column]));
        let residual = self.linear.residual[0][sample][axis];
        let all = by_weight.chain([residual]);
        beside.iter_mut().zip(all).for_each(|(value, derivative)| *value = derivative);
    }

    fn residual(
        &self,
        columns: &[usize],
        weights: &[Vec<f64>],
        parameters: &DVector<f64>,
    ) -> Vec<[f64; 3]> {
        let mut row = vec![0.0; parameters.len() + 1];
        let mut one = |sample: usize, axis: usize| {
            self.fill(&mut row, sample, axis, columns, weights);
            let explained: f64 = row.iter().zip(parameters.iter()).map(|(a, b)| a * b).sum();
            row[parameters.len()] - explained
        };
        (0..self.len()).map(|sample| [one(sample, 0), one(sample, 1), one(sample, 2)]).collect()
    }
}

/// What is asked over the course of a run of some parameters beside the base: the products, two by two, of the
/// derivatives by the base's parameters, of those by the others and of the residual, summed up to each sample.
/// Whatever the others' course, what it leaves is told from these sums.
struct Course<'a> {
    asked: &'a Asked<'a>,
    /// How many the others are.
    others: usize,
    before: Vec<Triangle>,
}

impl<'a> Course<'a> {
    fn of(asked: &'a Asked<'a>, columns: &[usize]) -> Self {
        let width = asked.base.len() + columns.len();
        let always = [vec![1.0; asked.len()]];
        let mut rows = [0, 1, 2].map(|_| vec![0.0; width + 1]);
        let mut sums = Triangle::zeros(width + 1);
        let mut before = vec![sums.clone()];
        for sample in 0..asked.len() {
            for (axis, row) in rows.iter_mut().enumerate() {
                asked.fill(row, sample, axis, columns, &always);
            }
            sums.add_squares([&rows[0], &rows[1], &rows[2]], asked.counts[sample]);
            before.push(sums.clone());
        }
        Self { asked, others: columns.len(), before }
    }

    /// What is left where the others count from a sample on.
    fn left_by_step(&self, from: usize) -> f64 {
        let mut after = self.before[self.asked.len()].clone();
        after.add_scaled(&self.before[from], -1.0);
        self.left(&after, &after)
    }

    /// What is left where the others count by a course over time, s, taken as constant over each of so many
    /// pieces of the run.
    fn left_by(&self, pieces: usize, course: impl Fn(f64) -> f64) -> f64 {
        let samples = self.asked.len();
        let mut once = Triangle::zeros(self.asked.base.len() + self.others + 1);
        let mut twice = once.clone();
        let pieces = pieces.min(samples);
        for piece in 0..pieces {
            let (from, to) = (piece * samples / pieces, (piece + 1) * samples / pieces);
            let weight = course(self.asked.t_s[(from + to) / 2]);
            for (sums, by) in [(&mut once, weight), (&mut twice, weight * weight)] {
                sums.add_scaled(&self.before[to], by);
                sums.add_scaled(&self.before[from], -by);
            }
        }
        self.left(&once, &twice)
    }

    /// What is left by the sums of all, of those that one of the others has a part in, and of those between two
    /// of the others.
    fn left(&self, once: &Triangle, twice: &Triangle) -> f64 {
        let base = self.asked.base.len();
        let width = base + self.others;
        let is_other = |i: usize| (base..width).contains(&i);
        solved(width, |i, j| match (is_other(i), is_other(j)) {
            (false, false) => self.before[self.asked.len()].at(i, j),
            (true, true) => twice.at(i, j),
            _ => once.at(i, j),
        })
        .0
    }
}

/// The sum of squares that is left, and the `width` parameters that leave it, by sums of products of the
/// derivatives and, behind them, the residual.
fn solved(width: usize, sums: impl Fn(usize, usize) -> f64) -> (f64, DVector<f64>) {
    let normal = Normal {
        matrix: DMatrix::from_fn(width, width, &sums),
        right: DVector::from_fn(width, |i, _| sums(width, i)),
        ..Normal::zeros(0)
    };
    let all: Vec<usize> = (0..width).collect();
    let parameters = normal.step(&DVector::zeros(width), &all);
    ((sums(width, width) - normal.right.dot(&parameters)).max(0.0), parameters)
}

/// The one of `candidates` that leaves least.
fn least(candidates: impl Iterator<Item = f64>, left: impl Fn(f64) -> f64) -> Option<f64> {
    let all = candidates.map(|candidate| (candidate, left(candidate)));
    all.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(candidate, _)| candidate)
}
