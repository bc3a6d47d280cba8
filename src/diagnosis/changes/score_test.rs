//! Score test for a change of a frame, the latency, the radial scale or a joint zero. Constant causes and link deviations
//! are free parameters.
//!
//! The gain of a step at each sample comes from one linearisation (sup-F test: Andrews, *Tests for parameter
//! instability and structural change with unknown change point*, 1993), as do those of ramps and of changes that settle. A
//! change must pay for its parameters, and for the times and the time constant of its profile.

use super::change::Change;
use super::jumps::Jump;
use super::profile::Profile;
use crate::priors::price;
use crate::residuals::cause_columns::{CauseColumns, Frame, LATENCY, ZEROS};
use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::solver::linear::{Linear, Weight, ridged};
use ground::stats::highest;
use nalgebra::{DMatrix, DVector};
use std::cell::OnceCell;
use std::ops::Range;

/// Variable columns that may change together: a frame's translation, its rotation, or both, the latency, the radial
/// scale, and a joint zero. The reference turns about the middle of the motion, so its rotation does not change alone.
fn causes(columns: &CauseColumns) -> Vec<Range<usize>> {
    let (reference, tool) = (Frame::Reference, Frame::Tool);
    let frames = [
        reference.translation(),
        reference.columns(),
        tool.translation(),
        tool.rotation(),
        tool.columns(),
    ];
    let others = (LATENCY..columns.zeros().end).map(|column| column..column + 1);
    frames.into_iter().chain(others).collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Causes {
    Any,
    Frames,
    Zeros,
}

impl Causes {
    /// The last joint's zero competes with those of other joints, not with the tool, which it equals.
    fn contains(self, cause: &Range<usize>, columns: &CauseColumns) -> bool {
        match self {
            Self::Any => cause.start != columns.last_zero(),
            Self::Frames => Frame::of(cause).is_some(),
            Self::Zeros => cause.start >= ZEROS,
        }
    }
}

/// Changes that a search considers.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChangeKind {
    pub causes: Causes,
    /// Whether also gradual changes, not only steps.
    pub with_drifts: bool,
}

impl ChangeKind {
    /// One at a time, steps of several joints look like a frame, a frame that returns looks like a joint, and several steps
    /// look like a ramp.
    pub const ALL: [Self; 5] = [
        Self { causes: Causes::Any, with_drifts: false },
        Self { causes: Causes::Frames, with_drifts: false },
        Self { causes: Causes::Zeros, with_drifts: false },
        Self { causes: Causes::Any, with_drifts: true },
        Self { causes: Causes::Zeros, with_drifts: true },
    ];
}

/// A change of these columns with its score: the reduction of the cost beyond constant causes, minus the price of the
/// change.
pub(super) type Scored = (Profile, Range<usize>, f64);

/// Samples in which a gradual profile is nearly constant.
const BLOCK: usize = 16;

/// Samples between the steps tested first.
const STRIDE: usize = 16;

/// A sample, with the gain of a step of each cause there.
type TestedStep = (usize, Vec<f64>);

pub(super) struct ScoreTest<'a> {
    columns: &'a CauseColumns<'a>,
    causes: Vec<Range<usize>>,
    linear: &'a Linear,
    weights: &'a [Weight],
    t_s: Vec<f64>,
    /// Each [`BLOCK`] samples, with their sums.
    blocks: Vec<(Range<usize>, Sums)>,
    /// Sums over each block and those after it; zero at the end.
    later: Vec<Sums>,
    /// Inverse of the constant causes' normal matrix.
    inverse: DMatrix<f64>,
    /// Their step.
    constant: DVector<f64>,
    price: f64,
    /// Steps at every [`STRIDE`]th sample.
    steps: OnceCell<Vec<TestedStep>>,
}

/// Sums over samples of the variable columns with a factor: products with the constant columns, with each other, and
/// with the residual.
#[derive(Clone)]
struct Sums {
    constant: DMatrix<f64>,
    square: DMatrix<f64>,
    right: DVector<f64>,
}

impl Sums {
    /// Adds these, whose factor is 1, with another factor.
    fn add(&mut self, factor: f64, other: &Self) {
        self.constant.zip_apply(&other.constant, |sum, other| *sum += factor * other);
        self.square.zip_apply(&other.square, |sum, other| *sum += factor * factor * other);
        self.right.zip_apply(&other.right, |sum, other| *sum += factor * other);
    }
}

impl<'a> ScoreTest<'a> {
    pub fn new(
        columns: &'a CauseColumns,
        linear: &'a Linear,
        weights: &'a [Weight],
    ) -> Option<Self> {
        let mut normal = linear.normal(weights);
        columns.add_prior(&mut normal);
        let inverse = ridged(normal.matrix).cholesky()?.inverse();
        let constant = &inverse * normal.right;
        let (causes, price) = (causes(columns), price(normal.independent));
        let t_s = columns.samples().map(|row| columns.aligned.t_s[row]).collect();
        let (blocks, later, steps) = (Vec::new(), Vec::new(), OnceCell::new());
        let mut test = Self {
            columns,
            causes,
            linear,
            weights,
            t_s,
            blocks,
            later,
            inverse,
            constant,
            price,
            steps,
        };
        let starts = (0..linear.len()).step_by(BLOCK);
        let block = |start: usize| {
            let samples = start..(start + BLOCK).min(linear.len());
            let mut sums = test.empty();
            samples.clone().for_each(|sample| test.add(sample, &mut sums));
            (samples, sums)
        };
        test.blocks = starts.map(block).collect();
        let mut later = vec![test.empty()];
        for (_, own) in test.blocks.iter().rev() {
            let mut sums = later[later.len() - 1].clone();
            sums.add(1.0, own);
            later.push(sums);
        }
        later.reverse();
        Some(Self { later, ..test })
    }

    fn empty(&self) -> Sums {
        let variable = self.columns.last_zero() + 1;
        Sums {
            constant: DMatrix::zeros(variable, self.linear.width),
            square: DMatrix::zeros(variable, variable),
            right: DVector::zeros(variable),
        }
    }

    fn add(&self, sample: usize, sums: &mut Sums) {
        for row in 0..6 {
            let derivatives = DVector::from_column_slice(self.linear.row(sample, row));
            let variable = self.columns.variable_row(self.linear.row(sample, row));
            let weight = self.weights[row / 3].component(sample);
            sums.constant.ger(weight, &variable, &derivatives, 1.0);
            sums.square.ger(weight, &variable, &variable, 1.0);
            sums.right.axpy(weight * self.linear.residual(sample, row), &variable, 1.0);
        }
    }

    /// Reduction of the cost by each cause.
    fn gains(&self, Sums { constant, square, right }: &Sums) -> Vec<f64> {
        // The share that constant causes do not explain.
        let matrix = square - constant * &self.inverse * constant.transpose();
        let right = right - constant * &self.constant;
        let gain = |cause: &Range<usize>| {
            let own = matrix.view((cause.start, cause.start), (cause.len(), cause.len()));
            let right = right.rows(cause.start, cause.len()).into_owned();
            let solved = ridged(own.into_owned()).cholesky().map(|own| own.solve(&right));
            solved.map_or(0.0, |solved| right.dot(&solved))
        };
        self.causes.iter().map(gain).collect()
    }

    /// Of a step of each cause at this sample.
    fn gains_of_step(&self, from: usize) -> Vec<f64> {
        let block = from.div_ceil(BLOCK);
        let mut sums = self.later[block].clone();
        (from..(block * BLOCK).min(self.t_s.len())).for_each(|it| self.add(it, &mut sums));
        self.gains(&sums)
    }

    /// Of a change of each cause, with a factor of each time that is nearly constant in a block.
    fn gains_of_profile(&self, factor: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut sums = self.empty();
        for (samples, own) in &self.blocks {
            let middle_s = 0.5 * (self.t_s[samples.start] + self.t_s[samples.end - 1]);
            sums.add(factor(middle_s), own);
        }
        self.gains(&sums)
    }

    fn score(&self, of: usize, gain: f64, profile_parameters: usize) -> f64 {
        gain - self.price * (self.causes[of].len() + profile_parameters) as f64
    }

    /// Cause among `tested` with the highest score.
    fn likeliest(
        &self,
        tested: &[usize],
        gains: &[f64],
        profile_parameters: usize,
    ) -> Option<(usize, f64)> {
        let score = |&of: &usize| (of, self.score(of, gains[of], profile_parameters));
        highest(tested.iter().map(score), |it| it.1)
    }

    fn scored(&self, tested: &[usize], profile: Profile) -> Option<Scored> {
        let gains = self.gains_of_profile(|t_s| profile.factor(t_s));
        let (of, score) = self.likeliest(tested, &gains, profile.parameters())?;
        Some((profile, self.causes[of].clone(), score))
    }

    /// The likeliest gradual change of a cause among `tested`.
    fn likeliest_drift(&self, tested: &[usize]) -> Option<Scored> {
        /// Of the distance between coarse profiles; the fit of the amounts refines the rest.
        const SMALLEST_PART: f64 = 0.2;
        let run_s = [*self.t_s.first()?, *self.t_s.last()?];
        let likelier = |a: &Scored, b: &Scored| a.2.total_cmp(&b.2);
        let coarse = Profile::coarse(run_s).filter_map(|it| self.scored(tested, it));
        let mut best = coarse.max_by(likelier)?;
        let mut part = 0.5;
        while part > SMALLEST_PART {
            let near = best.0.neighbours(part).filter_map(|it| self.scored(tested, it));
            match near.max_by(likelier).filter(|near| likelier(near, &best).is_gt()) {
                Some(near) => best = near,
                None => part *= 0.5,
            }
        }
        let throughout = self.scored(tested, Profile::Ramp { run_s, from: 0.0, to: 1.0 });
        throughout.into_iter().chain([best]).max_by(likelier)
    }

    /// The likeliest step of a cause among `tested`, apart from those found. Its strength is relative to the price of its
    /// parameters.
    fn likeliest_step(&self, tested: &[usize], found: &[Change]) -> Option<Scored> {
        /// In the log-likelihood, of the 95 % interval of its time.
        const TIME_TOLERANCE: f64 = 1.92;
        let t_s = &self.t_s;
        let inner = MIN_SEGMENT_SAMPLES..t_s.len().checked_sub(MIN_SEGMENT_SAMPLES)?;
        let at = |it: &Change| {
            let at_s = it.profile.step()?.at_s;
            Some((t_s.iter().position(|t_s| *t_s >= at_s)?, it.columns.clone()))
        };
        let found: Vec<(usize, Range<usize>)> = found.iter().filter_map(at).collect();
        let is_free = |of: usize, sample: usize| {
            let cause = &self.causes[of];
            let overlaps = |it: &Range<usize>| it.start < cause.end && cause.start < it.end;
            !found
                .iter()
                .any(|(at, columns)| at.abs_diff(sample) < MIN_SEGMENT_SAMPLES && overlaps(columns))
        };
        let test = |samples: &mut dyn Iterator<Item = usize>| -> Vec<TestedStep> {
            samples.map(|sample| (sample, self.gains_of_step(sample))).collect()
        };
        let likeliest = |steps: &[TestedStep]| {
            let scored = steps.iter().flat_map(|(sample, gains)| {
                let free = tested.iter().filter(|of| is_free(**of, *sample));
                // The time is a parameter, too.
                free.map(|&of| (*sample, of, gains[of], self.score(of, gains[of], 1)))
            });
            highest(scored, |it| it.3)
        };
        let coarse = self.steps.get_or_init(|| test(&mut inner.clone().step_by(STRIDE)));
        let (near, ..) = likeliest(coarse)?;
        let around = near.saturating_sub(STRIDE)..=near + STRIDE;
        let fine = test(&mut around.filter(|sample| inner.contains(sample)));
        let (sample, of, gain, score) = likeliest(&fine)?;
        let is_likely = |it: &&TestedStep| it.1[of] > gain - 2.0 * TIME_TOLERANCE;
        let likely = || coarse.iter().chain(&fine).filter(is_likely).map(|it| it.0);
        let (first, last) = (likely().min()?, likely().max()?);
        let columns = self.causes[of].clone();
        let profile = Profile::Step(Jump {
            at_s: 0.5 * (t_s[sample - 1] + t_s[sample]),
            within_s: 0.5 * (t_s[last] - t_s[first - 1]),
            strength: gain / (self.price * (columns.len() + 1) as f64),
        });
        Some((profile, columns, score))
    }

    /// The likeliest change of this kind, in addition to those found and in the linearisation, if the likelihood justifies
    /// one.
    pub fn likeliest_change(&self, found: &[Change], kind: ChangeKind) -> Option<Scored> {
        let is_tested = |of: &usize| kind.causes.contains(&self.causes[*of], self.columns);
        let tested: Vec<usize> = (0..self.causes.len()).filter(is_tested).collect();
        let drift = kind.with_drifts.then(|| self.likeliest_drift(&tested)).flatten();
        let all = drift.into_iter().chain(self.likeliest_step(&tested, found));
        all.filter(|(.., score)| *score > 0.0).max_by(|a, b| a.2.total_cmp(&b.2))
    }
}

/// Whether a constant joint zero is likelier than the link deviations that imitate it.
pub(super) fn has_unusual_zero(columns: &CauseColumns) -> bool {
    let (linear, fit) = columns.constant_fit();
    let zero = ScoreTest::new(columns, &linear, &fit.weights).and_then(|test| {
        let is_zero = |of: &usize| (ZEROS..columns.last_zero()).contains(&test.causes[*of].start);
        let zeros: Vec<usize> = (0..test.causes.len()).filter(is_zero).collect();
        test.likeliest(&zeros, &test.gains_of_profile(|_| 1.0), 0)
    });
    zero.is_some_and(|(_, score)| score > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::diagnose_arm;
    use crate::test_motion;
    use crate::test_random::Lcg;
    use ground::geometry::Vec3;

    /// Likeliest step of 20 s of poses with 5 mm of noise, whose latency and tool depend on time.
    fn likeliest_step_of(
        latency_s: impl Fn(f64) -> f64,
        tool_m: impl Fn(f64) -> f64,
    ) -> Option<Jump> {
        let (joints, chain) = test_motion::arm();
        let mut random = Lcg::new();
        let mut sequence = joints.sequence();
        let (mut t_s, mut poses) = (Vec::new(), Vec::new());
        for at_s in (10..980).map(|row| f64::from(row) * 0.02) {
            let (q, _) = sequence.at(at_s - latency_s(at_s)).expect("joint states");
            let pose = chain.forward(q);
            let tip = pose * nalgebra::Point3::new(0.0, tool_m(at_s), 0.0);
            t_s.push(at_s);
            poses.push((tip.coords + Vec3::from(random.triple(5e-3)), pose.rotation));
        }
        let track = test_motion::pose_track(&t_s, poses);
        let stream = test_motion::tip_stream(&track, &chain);
        let diagnosis = diagnose_arm(&joints, &[stream], 1.0);
        let columns = CauseColumns::new(&diagnosis.streams[0], &stream);
        let linear = columns.linearize(&[]);
        let weights = columns.local_weights(&linear);
        let test = ScoreTest::new(&columns, &linear, &weights)?;
        test.likeliest_change(&[], ChangeKind::ALL[0])?.0.step()
    }

    #[test]
    fn a_step_within_the_noise_is_dated() {
        let after = |t_s: f64, size: f64| if t_s > 12.0 { size } else { 0.0 };
        for step in [
            likeliest_step_of(|t_s| after(t_s, 0.02), |_| 0.0),
            likeliest_step_of(|_| 0.0, |t_s| after(t_s, 4e-3)),
        ] {
            let step = step.expect("a step");
            assert!((step.at_s - 12.0).abs() < 0.5, "{step:?}");
        }
        assert_eq!(likeliest_step_of(|_| 0.01, |_| 2e-3), None);
    }
}
