//! How well a model of one half of the run predicts the other half, with and without each cause.

use super::model_selection::{CandidateCauses, Cause, SelectedModel};
use crate::model::measurement::{PoseObservations, State};
use crate::priors::LEVER_M;
use crate::samples::sampling::rows_of_half;
use crate::solver::linear::{Linear, Normal};
use crate::solver::noise::mean_square;

/// Residual in each half of the run of the fit to the other half, rms m and rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutResidual {
    /// Without the cause, everything else fitted.
    pub without: [f64; 2],
    /// With the cause.
    pub with: [f64; 2],
}

impl HeldOutResidual {
    /// Whether the cause reduces the error on held-out samples. Angles are weighted by 0.3 m.
    pub fn is_lower(&self) -> bool {
        let combined_m = |[m, rad]: [f64; 2]| m.hypot(LEVER_M * rad);
        combined_m(self.with) < combined_m(self.without)
    }
}

/// One per cause of a stream that the model contains.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StreamHeldOut {
    /// Latency.
    pub latency: Option<HeldOutResidual>,
    /// Clock skew.
    pub skew: Option<HeldOutResidual>,
    /// Radial scale.
    pub radial_scale: Option<HeldOutResidual>,
    /// Reference frame.
    pub reference: Option<HeldOutResidual>,
    /// Tool frame.
    pub tool: Option<HeldOutResidual>,
}

/// Per half and stream.
const MAX_SAMPLES: usize = 500;

/// Mean squares of position and rotation residuals.
type Squares = [f64; 2];

pub(crate) struct HeldOut<'a> {
    observations: &'a [&'a PoseObservations<'a>],
    model: &'a SelectedModel,
    chosen: Vec<Cause>,
    /// Normal equations of one half, and samples of the other.
    halves: [(Normal, Vec<Linear>); 2],
    with: Vec<Squares>,
}

impl<'a> HeldOut<'a> {
    pub fn new(
        observations: &'a [&'a PoseObservations<'a>],
        model: &'a SelectedModel,
        candidates: &CandidateCauses,
    ) -> Self {
        let half = |half: usize| {
            let part = |which: usize| -> Vec<Vec<usize>> {
                let streams = model.linear.streams();
                streams.map(|stream| rows_of_half(stream.len(), which, MAX_SAMPLES)).collect()
            };
            let (training, test) = (part(half), part(1 - half));
            let normal = model.linear.normal_of(&training);
            let streams = model.linear.streams().zip(&test);
            (normal, streams.map(|(stream, rows)| stream.subset(rows)).collect())
        };
        let chosen = candidates.free(&model.causes);
        let mut held_out =
            Self { observations, model, chosen, halves: [half(0), half(1)], with: Vec::new() };
        held_out.with = held_out.squares(&held_out.chosen);
        held_out
    }

    /// `None` if the model does not contain `cause`.
    pub fn of(&self, cause: Cause) -> Option<HeldOutResidual> {
        let streams: Vec<usize> = match cause {
            Cause::Latency(s) | Cause::Skew(s) | Cause::RadialScale(s) => vec![s],
            Cause::Reference(s) | Cause::Tool(s) => vec![s],
            Cause::Zero(_) | Cause::JointScale(_) => (0..self.observations.len()).collect(),
        };
        if !self.chosen.contains(&cause) {
            return None;
        }
        let others: Vec<Cause> =
            self.chosen.iter().copied().filter(|other| *other != cause).collect();
        let state = self.model.state.clone().without(&[cause]);
        // Other causes may absorb a small one; a large one is beyond the linearisation.
        let both = [self.squares(&others), self.squares_at(&state)];
        let combined = |squares: &[Squares]| -> f64 {
            streams.iter().map(|&s| self.combined(s, squares[s])).sum()
        };
        let without = both.into_iter().min_by(|a, b| combined(a).total_cmp(&combined(b)))?;
        let rms = |squares: &[Squares]| -> [f64; 2] {
            let mean = |kind: usize| streams.iter().map(|&s| squares[s][kind]).sum::<f64>();
            [0, 1].map(|kind| (mean(kind) / streams.len().max(1) as f64).sqrt())
        };
        Some(HeldOutResidual { without: rms(&without), with: rms(&self.with) })
    }

    pub fn of_stream(&self, s: usize) -> StreamHeldOut {
        StreamHeldOut {
            latency: self.of(Cause::Latency(s)),
            skew: self.of(Cause::Skew(s)),
            radial_scale: self.of(Cause::RadialScale(s)),
            reference: self.of(Cause::Reference(s)),
            tool: self.of(Cause::Tool(s)),
        }
    }

    /// In variances of the noise.
    fn combined(&self, stream: usize, squares: Squares) -> f64 {
        let noise = self.model.linear.noise_of(stream);
        (0..2).map(|kind| squares[kind] / noise[kind].sigma.powi(2)).sum()
    }

    /// With `causes` free.
    fn squares(&self, causes: &[Cause]) -> Vec<Squares> {
        let mut squares = vec![[0.0; 2]; self.observations.len()];
        for (normal, test) in &self.halves {
            let steps = self.model.linear.stream_steps(normal, causes, &self.model.state);
            for ((squares, stream), step) in squares.iter_mut().zip(test).zip(&steps) {
                let residuals = stream.residuals_after(step);
                (0..2).for_each(|kind| squares[kind] += 0.5 * mean_square(&residuals[kind]));
            }
        }
        squares
    }

    /// At a state, on both halves.
    fn squares_at(&self, state: &State) -> Vec<Squares> {
        let of_stream = |(s, observations): (usize, &&PoseObservations)| {
            let linear = observations.in_state(state, s).linearize(2 * MAX_SAMPLES);
            [0, 1].map(|kind| mean_square(&linear.residual[kind]))
        };
        self.observations.iter().enumerate().map(of_stream).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::diagnose_arm;
    use crate::test_motion::{arm, pose_track, tip_stream};
    use ground::geometry::Vec3;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn a_zero_and_a_latency_predict_samples_that_were_not_fitted() {
        const NOISE_M: f64 = 1e-4;
        let (joints, chain) = arm();
        let mut random = rand_pcg::Pcg64::seed_from_u64(11);
        let (mut poses, mut t_s) = (Vec::new(), Vec::new());
        let mut sequence = joints.sequence();
        for row in 100..1800 {
            let stamp = f64::from(row) * 0.01 + 0.003;
            let mut q = sequence.at(stamp - 0.02).expect("joint states").0.to_vec();
            q[2] += 0.01;
            let pose = chain.forward(&q);
            let mut noise = || random.random_range(-NOISE_M..NOISE_M);
            t_s.push(stamp);
            let position = pose.translation.vector + Vec3::new(noise(), noise(), noise());
            poses.push((position, pose.rotation));
        }
        let track = pose_track(&t_s, poses);
        let stream = tip_stream(&track, &chain);
        let found = diagnose_arm(&joints, &[stream], 5.0);
        let zeros: Vec<bool> =
            found.joints.offsets.iter().map(|offset| offset.held_out.is_some()).collect();
        assert_eq!(zeros, [false, false, true, false, false, false]);
        let zero = found.joints.offsets[2].held_out.expect("the zero is a cause");
        let latency = found.streams[0].held_out.latency.expect("the latency is free");
        for residual in [zero, latency] {
            // Three components, each uniform with a variance of a third.
            assert!((residual.with[0] / NOISE_M - 1.0).abs() < 0.1, "{residual:?}");
            assert!(residual.without[0] > 10.0 * residual.with[0], "{residual:?}");
            assert!(residual.is_lower());
        }
        assert_eq!(found.streams[0].held_out.tool, None);
    }
}
