//! How a change of a cause depends on time.

use super::jumps::Jump;
use super::{ChangePoint, Course};

/// Parts of the run between the ends of coarse ramps, and of the range of time constants.
const COARSE_PARTS: u32 = 10;

/// How a change of a cause depends on time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Profile {
    /// At once: a slipped tool, a moved base.
    Step(Jump),
    /// Gradually, in a run between two times, s from the run's origin.
    Drift { run_s: [f64; 2], shape: Shape },
}

/// Shape of a gradual change. Times are parts of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// At a constant rate between two times.
    Ramp { from: f64, to: f64 },
    /// As `1 − exp(−t/τ)` from the start, such as a warm-up or creep; the parameter is `ln τ`.
    Settling { ln_time_constant: f64 },
}

impl Shape {
    /// At a constant rate over the run.
    pub const THROUGHOUT: Self = Self::Ramp { from: 0.0, to: 1.0 };
    /// Shorter ramps are steps.
    const MIN_RAMP: f64 = 0.02;
    /// Faster changes are steps, slower ones ramps.
    const LN_TIME_CONSTANTS: [f64; 2] = [-3.5, 0.5];

    /// Coarse grid of ramps within the run and of settling changes. [`Self::neighbours`] refines it.
    pub fn coarse() -> impl Iterator<Item = Self> {
        let part = |at: u32| f64::from(at) / f64::from(COARSE_PARTS);
        let ends =
            (1..COARSE_PARTS).flat_map(|from| (from + 1..COARSE_PARTS).map(move |to| (from, to)));
        let ramps = ends.map(move |(from, to)| Self::Ramp { from: part(from), to: part(to) });
        let [fastest, slowest] = Self::LN_TIME_CONSTANTS;
        let settling = (0..=COARSE_PARTS).map(move |at| {
            let ln_time_constant = fastest + part(at) * (slowest - fastest);
            Self::Settling { ln_time_constant }
        });
        ramps.chain(settling)
    }

    /// With each parameter changed by this part of the distance between coarse shapes.
    pub fn neighbours(mut self, part: f64) -> impl Iterator<Item = Self> {
        let [fastest, slowest] = Self::LN_TIME_CONSTANTS;
        let spacing = match self {
            Self::Ramp { .. } => 1.0,
            Self::Settling { .. } => slowest - fastest,
        } / f64::from(COARSE_PARTS);
        let parameters = self.parameters().len();
        (0..parameters).flat_map(move |at| {
            [-part, part].map(|by| {
                let mut step = vec![0.0; parameters];
                step[at] = by * spacing;
                self.stepped(&step)
            })
        })
    }

    /// From 0 to 1, at a part of the run.
    fn at(self, part: f64) -> f64 {
        match self {
            Self::Ramp { from, to } => ((part - from) / (to - from)).clamp(0.0, 1.0),
            Self::Settling { ln_time_constant } => {
                let settled = |part: f64| -(-part / ln_time_constant.exp()).exp_m1();
                settled(part.clamp(0.0, 1.0)) / settled(1.0)
            }
        }
    }

    /// Free parameters. An end of a ramp at an end of the run is fixed, because only the rate is observable there.
    fn parameters(&mut self) -> Vec<&mut f64> {
        match self {
            Self::Ramp { from, to } => {
                let from = (*from > 0.0).then_some(from);
                from.into_iter().chain((*to < 1.0).then_some(to)).collect()
            }
            Self::Settling { ln_time_constant } => vec![ln_time_constant],
        }
    }

    fn stepped(mut self, by: &[f64]) -> Self {
        /// Limit of one step of the linearised fit.
        const MAX_STEP: f64 = 0.1;
        let before = self;
        for (parameter, by) in self.parameters().into_iter().zip(by) {
            *parameter += by.clamp(-MAX_STEP, MAX_STEP);
        }
        match &mut self {
            Self::Ramp { from, to } => {
                (*from, *to) = (from.max(0.0), to.min(1.0));
                if *to - *from < Self::MIN_RAMP {
                    return before;
                }
            }
            Self::Settling { ln_time_constant } => {
                let [fastest, slowest] = Self::LN_TIME_CONSTANTS;
                *ln_time_constant = ln_time_constant.clamp(fastest, slowest);
            }
        }
        self
    }
}

impl Profile {
    /// From −1 before the change to 1 after it.
    pub fn factor(&self, t_s: f64) -> f64 {
        match *self {
            Self::Step(step) if t_s < step.at_s => -1.0,
            Self::Step(_) => 1.0,
            Self::Drift { run_s: [start_s, end_s], shape } => {
                2.0 * shape.at((t_s - start_s) / (end_s - start_s)) - 1.0
            }
        }
    }

    /// Number of parameters: times and time constants.
    pub fn parameters(&self) -> usize {
        match *self {
            Self::Step(_) => 1,
            Self::Drift { mut shape, .. } => shape.parameters().len(),
        }
    }

    /// Derivative of the factor by each parameter of a gradual change.
    pub fn derivatives(&self, t_s: f64) -> Vec<f64> {
        const DIFFERENCE: f64 = 1e-4;
        let Self::Drift { run_s, shape } = *self else { return Vec::new() };
        let derivative = |at: usize| {
            let [before, after] = [-DIFFERENCE, DIFFERENCE].map(|by| {
                let mut shape = shape;
                *shape.parameters()[at] += by;
                Self::Drift { run_s, shape }.factor(t_s)
            });
            (after - before) / (2.0 * DIFFERENCE)
        };
        (0..self.parameters()).map(derivative).collect()
    }

    /// With its parameters changed by a least-squares step.
    pub fn stepped(self, by: &[f64]) -> Self {
        match self {
            Self::Step(_) => self,
            Self::Drift { run_s, shape } => Self::Drift { run_s, shape: shape.stepped(by) },
        }
    }

    /// The step of a step profile.
    pub fn step(&self) -> Option<Jump> {
        match self {
            Self::Step(step) => Some(*step),
            Self::Drift { .. } => None,
        }
    }

    /// Middle and half-width of the time interval of the change.
    pub fn interval_s(&self) -> (f64, f64) {
        match *self {
            Self::Step(Jump { at_s, within_s, .. }) => (at_s, within_s),
            Self::Drift { run_s: [start_s, end_s], shape } => {
                let (from, to) = match shape {
                    Shape::Ramp { from, to } => (from, to),
                    Shape::Settling { .. } => (0.0, 1.0),
                };
                let span_s = end_s - start_s;
                (start_s + 0.5 * (from + to) * span_s, 0.5 * (to - from) * span_s)
            }
        }
    }

    pub fn course(&self) -> Course {
        let Self::Drift { run_s: [start_s, end_s], shape } = *self else { return Course::Step };
        match shape {
            Shape::Ramp { .. } => Course::Ramp,
            Shape::Settling { ln_time_constant: ln } => {
                Course::Settling(ln.exp() * (end_s - start_s))
            }
        }
    }

    /// Change point of a value.
    pub fn change_point<V, S>(&self, from: V, to: V, size: S) -> ChangePoint<V, S> {
        let (at_s, within_s) = self.interval_s();
        ChangePoint { at_s, within_s, course: self.course(), from, to, size }
    }

    pub fn later(self, by_s: f64) -> Self {
        match self {
            Self::Step(step) => Self::Step(Jump { at_s: step.at_s + by_s, ..step }),
            Self::Drift { run_s, shape } => {
                Self::Drift { run_s: run_s.map(|at_s| at_s + by_s), shape }
            }
        }
    }

    /// Times between which it is constant or nearly linear.
    pub fn knots_s(&self) -> Vec<f64> {
        /// A chord of a 32nd of the interval deviates by 0.8 % if the time constant is an eighth of it.
        const CHORDS: u32 = 32;
        let (at_s, within_s) = self.interval_s();
        match self.course() {
            Course::Step => vec![at_s],
            Course::Ramp => vec![at_s - within_s, at_s + within_s],
            Course::Settling(_) => {
                let part = |chord: u32| f64::from(chord) / f64::from(CHORDS);
                (0..=CHORDS).map(|chord| at_s + (2.0 * part(chord) - 1.0) * within_s).collect()
            }
        }
    }
}
