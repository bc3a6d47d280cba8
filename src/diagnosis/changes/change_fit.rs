//! Fit of several changes to the residuals of all streams.
//!
//! Their amounts and the parameters of their profiles are estimated together with the constant causes and the link deviations
//! of each stream. The fit is repeated on the streams without the changes so far, because poses depend on them nonlinearly.

use super::change::{Change, Subject};
use super::changing_stream::Stream;
use super::jumps::Jump;
use crate::priors::price;
use crate::residuals::cause_columns::{Frame, shared_equations};
use crate::solver::linear::{Normal, SharedEquations, StreamEquations, Weight};
use ground::stats::lowest;
use nalgebra::{DVector, Vector6};
use std::ops::Range;

/// Of each kind of residuals of each stream.
pub(super) type Weights = Vec<Vec<Weight>>;

/// Equations of several changes and the constant causes of all streams.
pub(super) struct Equations {
    pub shared: SharedEquations,
    pub normal: Normal,
    /// Parameters of each change: of its amount, then of its profile.
    pub changes: Vec<Range<usize>>,
}

impl Equations {
    /// `streams` are without the changes so far. `noise` gives the weights of each stream's samples; without it, they are
    /// from the residuals.
    pub fn new(streams: &[Stream], changes: &[Change], noise: Option<&Weights>) -> Self {
        let mut width = 0;
        let parameters = |change: &Change| {
            width += change.width();
            width - change.width()..width
        };
        let of_changes: Vec<Range<usize>> = changes.iter().map(parameters).collect();
        let columns = streams.iter().map(|stream| {
            let all = changes.iter().zip(&of_changes);
            let variable = all.flat_map(|(change, own)| stream.columns_of(change, own.start));
            (&stream.columns, variable.collect())
        });
        let mut shared = shared_equations(width, columns);
        for (index, equations) in shared.streams.iter_mut().enumerate() {
            let StreamEquations { linear, weights, .. } = equations;
            *weights = match noise {
                Some(noise) => noise[index].clone(),
                None => streams[index].columns.fit(linear, 1).weights,
            };
        }
        Self { normal: shared.normal(), shared, changes: of_changes }
    }

    /// The change whose removal adds the least cost.
    fn least_needed(&self, changes: &[Change]) -> Option<usize> {
        let cost_without = |&at: &usize| {
            let own = &self.changes[at];
            let mut values = DVector::zeros(self.normal.right.len());
            let half = &changes[at].half;
            values.rows_mut(own.start, half.len()).copy_from(half);
            let others: Vec<usize> = (0..values.len()).filter(|it| !own.contains(it)).collect();
            self.normal.cost_after(&self.normal.step(&values, &others))
        };
        lowest(0..changes.len(), cost_without)
    }

    /// Twice the log likelihood, minus the price of the changes.
    pub fn score(&self, changes: &[Change]) -> f64 {
        let parameters = |change: &Change| change.columns.len() + change.profile.parameters();
        let count = changes.iter().map(parameters).sum::<usize>();
        let of_prior = changes.iter().map(Change::prior_cost).sum::<f64>();
        let cost = self.normal.cost_after(&self.normal.full_step());
        -cost - price(self.normal.independent) * count as f64 - of_prior
    }
}

/// Several changes with their amounts. Unobservable directions stay zero.
#[derive(Clone)]
pub(super) struct Candidate {
    pub changes: Vec<Change>,
    /// Constant changes of the reference and tool of each stream: twists.
    frames: Vec<[Vector6<f64>; 2]>,
}

impl Candidate {
    pub fn new(changes: Vec<Change>, streams: &[Stream]) -> Self {
        Self { changes, frames: vec![[Vector6::zeros(); 2]; streams.len()] }
    }

    /// The streams without the changes.
    pub fn steady<'a>(&self, streams: &[Stream<'a>]) -> Vec<Stream<'a>> {
        let pairs = streams.iter().zip(&self.frames);
        pairs.map(|(stream, frames)| stream.without(&self.changes, frames)).collect()
    }

    /// Whatever their amounts.
    pub fn has_changes_of(&self, other: &Self) -> bool {
        let key = |it: &Change| (it.subject, it.columns.clone(), it.profile);
        self.changes.iter().map(key).eq(other.changes.iter().map(key))
    }

    pub fn fitted(mut self, streams: &[Stream]) -> Self {
        const MAX_STEPS: usize = 8;
        for _ in 0..MAX_STEPS {
            if self.step(&self.steady(streams)) {
                break;
            }
        }
        self
    }

    /// A step of the fit to the streams without the changes so far. Whether it is small.
    pub fn step(&mut self, steady: &[Stream]) -> bool {
        /// Of a profile, in parts of the run, and of an amount, relative to it.
        const MIN_PROFILE_STEP: f64 = 2e-3;
        const MIN_RELATIVE_STEP: f64 = 1e-3;
        let equations = Equations::new(steady, &self.changes, None);
        let step = equations.normal.full_step();
        for (frames, stream) in self.frames.iter_mut().zip(&equations.shared.streams) {
            let constant = stream.own_part(&step);
            for (twist, frame) in frames.iter_mut().zip(Frame::BOTH) {
                *twist += Vector6::from_column_slice(&constant[frame.columns()]);
            }
        }
        let mut is_small = true;
        for (change, own) in self.changes.iter_mut().zip(equations.changes) {
            let own = step.rows(own.start, own.len());
            let (half, profile) = own.as_slice().split_at(change.half.len());
            let half = DVector::from_column_slice(half);
            change.half += &half;
            change.profile = change.profile.stepped(profile);
            is_small &= half.norm() <= MIN_RELATIVE_STEP * change.half.norm()
                && profile.iter().all(|by| by.abs() < MIN_PROFILE_STEP);
        }
        is_small
    }

    /// With changes of tools in the place of those of references, which are rarer. `None` without such changes, or if a tool
    /// changes as well.
    pub fn with_tools(&self, streams: &[Stream]) -> Option<Self> {
        let mut other = self.clone();
        for Change { subject, columns, half, .. } in &mut other.changes {
            match subject {
                Subject::Frame { frame: Frame::Tool, .. } => return None,
                Subject::Frame { frame, .. } => *frame = Frame::Tool,
                _ => continue,
            }
            let first = columns.start + Frame::Tool.columns().start;
            *columns = first..first + columns.len();
            half.fill(0.0);
        }
        (!other.has_changes_of(self)).then(|| other.fitted(streams))
    }

    /// Weights of the residuals. Samples at a step do not count: their part of it is unknown.
    pub fn weights(&self, steady: &[Stream], equations: Equations) -> Weights {
        let of_stream = |(stream, equations): (&Stream, StreamEquations)| {
            let mut weights = equations.weights;
            let seen = stream.all_seen(&self.changes);
            let steps: Vec<Jump> = seen.iter().filter_map(|change| change.profile.step()).collect();
            for (sample, row) in stream.columns.samples().enumerate() {
                let t_s = stream.columns.aligned.t_s[row];
                if steps.iter().any(|step| (t_s - step.at_s).abs() <= step.within_s) {
                    weights.iter_mut().for_each(|weight| weight.leave_out(sample));
                }
            }
            weights
        };
        steady.iter().zip(equations.shared.streams).map(of_stream).collect()
    }

    pub fn score(&self, streams: &[Stream], noise: &Weights) -> f64 {
        Equations::new(&self.steady(streams), &self.changes, Some(noise)).score(&self.changes)
    }

    /// Without the change that is needed least, if that is likelier: later ones can explain the residual of an earlier one.
    pub fn reduced(&self, streams: &[Stream], noise: &Weights) -> Option<Self> {
        if self.changes.len() < 2 {
            return None;
        }
        let equations = Equations::new(&self.steady(streams), &self.changes, Some(noise));
        let mut fewer = self.clone();
        fewer.changes.remove(equations.least_needed(&self.changes)?);
        let fewer = fewer.fitted(streams);
        (fewer.score(streams, noise) > equations.score(&self.changes)).then_some(fewer)
    }
}
