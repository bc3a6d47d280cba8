//! How a change of a cause depends on time.

use super::jumps::Jump;
use super::{ChangePoint, Course};

/// Parts of the run between the ends of coarse ramps, and of the range of time constants.
const COARSE_PARTS: u32 = 10;

/// How a change of a cause depends on time. A gradual one is in a run between two times, s from the run's origin; other
/// times are parts of the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Profile {
    /// At once: a slipped tool, a moved base.
    Step(Jump),
    /// At a constant rate between two times.
    Ramp { run_s: [f64; 2], from: f64, to: f64 },
    /// As `1 − exp(−t/τ)` from the start, such as a warm-up or creep; the parameter is `ln τ`.
    Settling { run_s: [f64; 2], ln_time_constant: f64 },
}

/// Faster changes are steps, slower ones ramps.
const LN_TIME_CONSTANTS: [f64; 2] = [-3.5, 0.5];

impl Profile {
    /// Coarse grid of ramps within the run and of settling changes. [`Self::neighbours`] refines it.
    pub fn coarse(run_s: [f64; 2]) -> impl Iterator<Item = Self> {
        let part = |at: u32| f64::from(at) / f64::from(COARSE_PARTS);
        let ends =
            (1..COARSE_PARTS).flat_map(|from| (from + 1..COARSE_PARTS).map(move |to| (from, to)));
        let ramp = move |(from, to)| Self::Ramp { run_s, from: part(from), to: part(to) };
        let [fastest, slowest] = LN_TIME_CONSTANTS;
        let settling = (0..=COARSE_PARTS).map(move |at| {
            let ln_time_constant = fastest + part(at) * (slowest - fastest);
            Self::Settling { run_s, ln_time_constant }
        });
        ends.map(ramp).chain(settling)
    }

    /// With each parameter changed by this part of the distance between coarse ones.
    pub fn neighbours(self, part: f64) -> impl Iterator<Item = Self> {
        let [fastest, slowest] = LN_TIME_CONSTANTS;
        let range = if let Self::Settling { .. } = self { slowest - fastest } else { 1.0 };
        let by = part * range / f64::from(COARSE_PARTS);
        let parameters = self.parameters();
        let steps = (0..parameters).flat_map(move |at| [(at, -by), (at, by)]);
        steps.map(move |(at, by)| {
            let mut step = vec![0.0; parameters];
            step[at] = by;
            self.stepped(&step)
        })
    }

    /// From −1 before the change to 1 after it.
    pub fn factor(&self, t_s: f64) -> f64 {
        let part = |[start_s, end_s]: [f64; 2]| (t_s - start_s) / (end_s - start_s);
        match *self {
            Self::Step(step) if t_s < step.at_s => -1.0,
            Self::Step(_) => 1.0,
            Self::Ramp { run_s, from, to } => {
                2.0 * ((part(run_s) - from) / (to - from)).clamp(0.0, 1.0) - 1.0
            }
            Self::Settling { run_s, ln_time_constant } => {
                let settled = |part: f64| -(-part / ln_time_constant.exp()).exp_m1();
                2.0 * (settled(part(run_s).clamp(0.0, 1.0)) / settled(1.0)) - 1.0
            }
        }
    }

    /// Number of parameters: times and time constants.
    pub fn parameters(mut self) -> usize {
        if let Self::Step(_) = self { 1 } else { self.of_gradual().len() }
    }

    /// Parameters of a gradual change. An end of a ramp at an end of the run is fixed, because only the rate is observable
    /// there.
    fn of_gradual(&mut self) -> Vec<&mut f64> {
        match self {
            Self::Step(_) => Vec::new(),
            Self::Ramp { from, to, .. } => {
                let from = (*from > 0.0).then_some(from);
                from.into_iter().chain((*to < 1.0).then_some(to)).collect()
            }
            Self::Settling { ln_time_constant, .. } => vec![ln_time_constant],
        }
    }

    /// Derivative of the factor by each parameter of a gradual change.
    pub fn derivatives(mut self, t_s: f64) -> Vec<f64> {
        const DIFFERENCE: f64 = 1e-4;
        let count = self.of_gradual().len();
        let derivative = |at: usize| {
            let [before, after] = [-DIFFERENCE, DIFFERENCE].map(|by| {
                let mut changed = self;
                *changed.of_gradual()[at] += by;
                changed.factor(t_s)
            });
            (after - before) / (2.0 * DIFFERENCE)
        };
        (0..count).map(derivative).collect()
    }

    /// With its parameters changed by a least-squares step.
    pub fn stepped(mut self, by: &[f64]) -> Self {
        /// Limit of one step of the linearised fit.
        const MAX_STEP: f64 = 0.1;
        /// Shorter ramps are steps.
        const MIN_RAMP: f64 = 0.02;
        let before = self;
        for (parameter, by) in self.of_gradual().into_iter().zip(by) {
            *parameter += by.clamp(-MAX_STEP, MAX_STEP);
        }
        match &mut self {
            Self::Step(_) => {}
            Self::Ramp { from, to, .. } => {
                (*from, *to) = (from.max(0.0), to.min(1.0));
                if *to - *from < MIN_RAMP {
                    return before;
                }
            }
            Self::Settling { ln_time_constant, .. } => {
                let [fastest, slowest] = LN_TIME_CONSTANTS;
                *ln_time_constant = ln_time_constant.clamp(fastest, slowest);
            }
        }
        self
    }

    /// The step of a step profile.
    pub fn step(&self) -> Option<Jump> {
        if let Self::Step(step) = self { Some(*step) } else { None }
    }

    /// Middle and half-width of the time interval of the change.
    pub fn interval_s(&self) -> (f64, f64) {
        let ([start_s, end_s], from, to) = match *self {
            Self::Step(Jump { at_s, within_s, .. }) => return (at_s, within_s),
            Self::Ramp { run_s, from, to } => (run_s, from, to),
            Self::Settling { run_s, .. } => (run_s, 0.0, 1.0),
        };
        let span_s = end_s - start_s;
        (start_s + 0.5 * (from + to) * span_s, 0.5 * (to - from) * span_s)
    }

    pub fn course(&self) -> Course {
        match self {
            Self::Step(_) => Course::Step,
            Self::Ramp { .. } => Course::Ramp,
            Self::Settling { run_s, ln_time_constant: ln } => {
                Course::Settling(ln.exp() * (run_s[1] - run_s[0]))
            }
        }
    }

    /// Change point of a value.
    pub fn change_point<V, S>(&self, from: V, to: V, size: S) -> ChangePoint<V, S> {
        let (at_s, within_s) = self.interval_s();
        ChangePoint { at_s, within_s, course: self.course(), from, to, size }
    }

    pub fn later(mut self, by_s: f64) -> Self {
        match &mut self {
            Self::Step(step) => step.at_s += by_s,
            Self::Ramp { run_s, .. } | Self::Settling { run_s, .. } => {
                run_s.iter_mut().for_each(|at_s| *at_s += by_s);
            }
        }
        self
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
