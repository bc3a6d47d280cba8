//! Levenberg–Marquardt refinement of a map and frames (Levenberg 1944).

use super::interpreted_poses::{ConstantFrames, FreeFrames, InterpretedPoses, ResidualSize};
use super::map::{Coupling, JointMap};
use crate::model::jacobian::{Derivative, PoseJacobian};
use crate::model::measurement::pose_of_twist;
use crate::solver::linear::{Linear, Normal};
use crate::solver::minimize::{LeastSquares, Limits, minimize};

#[derive(Clone, Debug)]
pub(super) struct JointProposal {
    pub map: JointMap,
    /// Joints with free zero.
    pub zeros: Vec<usize>,
    /// Joints with free factor.
    pub factors: Vec<usize>,
    /// Whether the coupling's factor is free.
    pub fits_coupling: bool,
    /// Number of causes.
    pub price: f64,
}

#[derive(Clone, Debug)]
pub(super) struct RefinedProposal {
    pub map: JointMap,
    pub residual: ResidualSize,
    /// The residual as one length.
    pub total_m: f64,
    /// Number of causes, including a rotated tool and joints beyond the model's limits.
    pub price: f64,
}

/// For a tool rotation that counts as a cause.
const MIN_TOOL_ROTATION_RAD: f64 = 0.1;
const TOOL_ROTATION_PRICE: f64 = 1.0;
/// Per joint.
const BEYOND_LIMIT_PRICE: f64 = 0.25;

impl JointProposal {
    /// All of `map` is fixed.
    pub fn new(map: JointMap, price: f64) -> Self {
        Self { map, zeros: Vec::new(), factors: Vec::new(), fits_coupling: false, price }
    }

    /// With another factor of a joint, and another zero if any, at this additional price. The zero is free.
    pub fn with_joint(&self, joint: usize, factor: f64, zero: Option<f64>, price: f64) -> Self {
        let zeros = self.zeros.iter().copied().chain(zero.map(|_| joint)).collect();
        let map = self.map.with(joint, factor, zero.unwrap_or(0.0));
        Self { map, zeros, price: self.price + price, ..self.clone() }
    }

    /// Minimises the residual in at most `steps` steps.
    pub fn refine(
        &self,
        view: &InterpretedPoses,
        freedom: FreeFrames,
        steps: usize,
    ) -> RefinedProposal {
        /// Of the cost, which is a square.
        const MIN_GAIN: f64 = 2e-4;
        let frames = view.fit_frames(&view.fk(&self.map), freedom);
        let start = (self.map.clone(), frames);
        let tool_parameters = if view.rotation.is_some() { 6 } else { 3 };
        let reference_parameters = if freedom == FreeFrames::Both { 6 } else { 0 };
        let fit = ProposalFit { proposal: self, view, tool_parameters, reference_parameters };
        let (mut map, frames) =
            match minimize(&fit, start.clone(), Limits { steps, min_gain: MIN_GAIN }) {
                Some((_, found)) => found,
                None => start,
            };
        map.remove_whole_turns(view.chain, &view.spans);
        let residual = view.residual_against(&view.fk(&map), &frames);
        let has_rotated_tool =
            view.rotation.is_some() && frames.tool.rotation.angle() > MIN_TOOL_ROTATION_RAD;
        let beyond_limits = map.beyond_limits(view.chain, &view.spans) as f64;
        let price = self.price
            + if has_rotated_tool { TOOL_ROTATION_PRICE } else { 0.0 }
            + BEYOND_LIMIT_PRICE * beyond_limits;
        let total_m = residual.combined_m(view.lever_m);
        RefinedProposal { map, residual, total_m, price }
    }
}

/// Parameters: zeros, relative factors, coupling factor, tool, reference.
struct ProposalFit<'a> {
    proposal: &'a JointProposal,
    view: &'a InterpretedPoses<'a>,
    tool_parameters: usize,
    reference_parameters: usize,
}

impl LeastSquares for ProposalFit<'_> {
    type State = (JointMap, ConstantFrames);

    fn linearize(&self, (map, frames): &Self::State) -> Option<Normal> {
        let Self { proposal, view, tool_parameters, reference_parameters } = *self;
        let dof = view.chain.dof();
        let (mut q, mut columns) = (vec![0.0; dof], vec![[0.0; 6]; dof]);
        let lever_m = if view.rotation.is_some() { view.lever_m } else { 0.0 };
        let in_m = |[position, turn]: Derivative| [position, lever_m * turn];
        let width = proposal.zeros.len()
            + proposal.factors.len()
            + usize::from(proposal.fits_coupling)
            + tool_parameters
            + reference_parameters;
        let mut linear = Linear::new(width, &[0.0; 2]);
        for (k, row) in view.q.chunks_exact(dof).enumerate() {
            map.apply(row, &mut q);
            let link = view.chain.forward_with_jacobian(&q, &mut columns);
            let jacobian = PoseJacobian::new(&columns, &frames.reference, &link, &frames.tool);
            let scaled = |joint: usize, by: f64| jacobian.joint(joint).map(|part| by * part);
            let by_zero = |&joint: &usize| jacobian.joint(joint);
            let by_factor =
                |&joint: &usize| scaled(joint, map.factor[joint] * row[map.from[joint]]);
            let coupling = map.coupling.filter(|_| proposal.fits_coupling);
            let by_coupling = coupling.map(|Coupling { joint, by, .. }| scaled(joint, q[by]));
            let derivatives = (proposal.zeros.iter().map(by_zero))
                .chain(proposal.factors.iter().map(by_factor))
                .chain(by_coupling)
                .chain((0..tool_parameters).map(|axis| jacobian.tool(axis)))
                .chain((0..reference_parameters).map(|axis| jacobian.reference(axis)));
            let mut rows = linear.push(&in_m(view.residual(k, &jacobian.pose)));
            derivatives.enumerate().for_each(|(column, own)| rows.set_all(column, in_m(own)));
        }
        Some(linear.normal(&linear.even_weights()))
    }

    fn moved(&self, (map, frames): &Self::State, step: &[f64]) -> Self::State {
        /// The linearisation is not valid beyond these.
        const MAX_STEP_RAD: f64 = 0.5;
        const MAX_RELATIVE_STEP: f64 = 0.2;
        let relative = |step: f64| step.clamp(-MAX_RELATIVE_STEP, MAX_RELATIVE_STEP);
        let (mut map, mut frames, mut steps) = (map.clone(), *frames, step.iter().copied());
        for (&joint, step) in self.proposal.zeros.iter().zip(&mut steps) {
            let slides = self.view.chain.slides(joint);
            let most = if slides { f64::INFINITY } else { MAX_STEP_RAD };
            map.zero[joint] += step.clamp(-most, most);
        }
        for (&joint, step) in self.proposal.factors.iter().zip(&mut steps) {
            map.factor[joint] *= 1.0 + relative(step);
        }
        if let Some(coupling) = map.coupling.as_mut().filter(|_| self.proposal.fits_coupling) {
            coupling.factor += relative(steps.next().unwrap_or(0.0));
        }
        let mut frame = |parameters: usize| {
            let mut twist = [0.0; 6];
            twist.iter_mut().zip(steps.by_ref().take(parameters)).for_each(|(to, step)| *to = step);
            let angle = twist[3..].iter().map(|part| part * part).sum::<f64>().sqrt();
            twist[3..].iter_mut().for_each(|part| *part *= MAX_STEP_RAD / angle.max(MAX_STEP_RAD));
            pose_of_twist(&twist)
        };
        frames.tool *= frame(self.tool_parameters);
        frames.reference = frame(self.reference_parameters) * frames.reference;
        (map, frames)
    }
}
