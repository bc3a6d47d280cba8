//! Levenberg–Marquardt refinement of a map and frames (Levenberg 1944).

use super::interpreted_poses::{ConstantFrames, FreeFrames, InterpretedPoses, ResidualSize};
use super::map::{Coupling, JointMap};
use ground::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use ground::robot::JointKind;
use nalgebra::{DMatrix, DVector};

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
    /// Number of causes, including a rotated tool.
    pub price: f64,
}

/// For a tool rotation that counts as a cause.
const MIN_TOOL_ROTATION_RAD: f64 = 0.1;
const TOOL_ROTATION_PRICE: f64 = 1.0;

impl JointProposal {
    /// Minimises the residual in at most `steps` steps.
    pub fn refine(
        &self,
        view: &InterpretedPoses,
        freedom: FreeFrames,
        steps: usize,
    ) -> RefinedProposal {
        let mut map = self.map.clone();
        let mut frames = view.fit_frames(&view.fk(&map), freedom);
        let cost = |map: &JointMap, frames: &ConstantFrames| {
            view.residual_against(&view.fk(map), frames).combined_m(view.lever_m)
        };
        let mut best = cost(&map, &frames);
        let mut damping = 1e-3;
        for _ in 0..steps {
            let (normal, right) = self.normal_equations(view, freedom, &map, &frames);
            let step = |damping: f64| {
                let mut damped = normal.clone();
                for i in 0..damped.nrows() {
                    damped[(i, i)] += damping * damped[(i, i)] + 1e-9;
                }
                damped.cholesky().map(|cholesky| cholesky.solve(&right))
            };
            let Some(step) = step(damping) else { break };
            let (next_map, next_frames) = self.stepped(freedom, view, &map, &frames, &step);
            let next = cost(&next_map, &next_frames);
            if next < best {
                let gained = best - next;
                (map, frames, best) = (next_map, next_frames, next);
                damping = (damping * 0.2).max(1e-9);
                if gained < 1e-4 * best {
                    break;
                }
            } else {
                damping *= 10.0;
                if damping > 1e3 {
                    break;
                }
            }
        }
        map.remove_whole_turns(view.chain, &view.spans);
        let residual = view.residual_against(&view.fk(&map), &frames);
        let has_rotated_tool =
            view.rotation.is_some() && frames.tool.rotation.angle() > MIN_TOOL_ROTATION_RAD;
        let price = self.price + if has_rotated_tool { TOOL_ROTATION_PRICE } else { 0.0 };
        RefinedProposal { map, residual, price }
    }

    /// Zeros, relative factors, coupling factor, tool, reference.
    fn width(&self, freedom: FreeFrames, view: &InterpretedPoses) -> usize {
        let tool = if view.rotation.is_some() { 6 } else { 3 };
        let reference = if freedom == FreeFrames::Both { 6 } else { 0 };
        let coupling = usize::from(self.fits_coupling);
        self.zeros.len() + self.factors.len() + coupling + tool + reference
    }

    fn normal_equations(
        &self,
        view: &InterpretedPoses,
        freedom: FreeFrames,
        map: &JointMap,
        frames: &ConstantFrames,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (dof, width) = (view.chain.dof(), self.width(freedom, view));
        let with_rotation = view.rotation.is_some();
        let rows = if with_rotation { 6 } else { 3 };
        let mut design = DMatrix::zeros(view.len() * rows, width);
        let mut residuals = DVector::zeros(view.len() * rows);
        let (mut q, mut jacobian) = (vec![0.0; dof], vec![[0.0; 6]; dof]);
        let turn = frames.reference.rotation;
        for (k, row) in view.q.chunks_exact(dof).enumerate() {
            map.apply(row, &mut q);
            let fk = view.chain.forward_with_jacobian(&q, &mut jacobian);
            let in_base = fk * frames.tool;
            let predicted = frames.reference * in_base;
            let [position, rotation] = view.residual(k, &predicted);
            let lever = fk.rotation * frames.tool.translation.vector;
            let first = k * rows;
            let mut set = |column: usize, linear: Vec3, angular: Vec3| {
                for axis in 0..3 {
                    design[(first + axis, column)] = linear[axis];
                    if with_rotation {
                        design[(first + 3 + axis, column)] = view.lever_m * angular[axis];
                    }
                }
            };
            let by_joint = |joint: usize| {
                let [x, y, z, a, b, c] = jacobian[joint];
                let angular = Vec3::new(a, b, c);
                (turn * (Vec3::new(x, y, z) + angular.cross(&lever)), turn * angular)
            };
            let mut column = 0;
            for &joint in &self.zeros {
                let (linear, angular) = by_joint(joint);
                set(column, linear, angular);
                column += 1;
            }
            for &joint in &self.factors {
                let (linear, angular) = by_joint(joint);
                let moved = map.factor[joint] * row[map.from[joint]];
                set(column, moved * linear, moved * angular);
                column += 1;
            }
            if let Some(Coupling { joint, by, .. }) = map.coupling.filter(|_| self.fits_coupling) {
                let (linear, angular) = by_joint(joint);
                set(column, q[by] * linear, q[by] * angular);
                column += 1;
            }
            for axis in 0..3 {
                let along = predicted.rotation * Vec3::ith(axis, 1.0);
                set(column + axis, along, Vec3::zeros());
                if with_rotation {
                    set(column + 3 + axis, Vec3::zeros(), along);
                }
            }
            column += if with_rotation { 6 } else { 3 };
            if freedom == FreeFrames::Both {
                for axis in 0..3 {
                    let unit = Vec3::ith(axis, 1.0);
                    set(column + axis, unit, Vec3::zeros());
                    set(column + 3 + axis, unit.cross(&predicted.translation.vector), unit);
                }
            }
            for axis in 0..3 {
                residuals[first + axis] = position[axis];
                if with_rotation {
                    residuals[first + 3 + axis] = view.lever_m * rotation[axis];
                }
            }
        }
        (design.tr_mul(&design), design.tr_mul(&residuals))
    }

    fn stepped(
        &self,
        freedom: FreeFrames,
        view: &InterpretedPoses,
        map: &JointMap,
        frames: &ConstantFrames,
        step: &DVector<f64>,
    ) -> (JointMap, ConstantFrames) {
        /// The linearisation is not valid beyond it.
        const MAX_STEP_RAD: f64 = 0.5;
        let (mut map, mut frames, mut at) = (map.clone(), *frames, 0);
        let kinds = view.chain.joint_kinds();
        for &joint in &self.zeros {
            let most =
                if kinds[joint] == JointKind::Prismatic { f64::INFINITY } else { MAX_STEP_RAD };
            map.zero[joint] += step[at].clamp(-most, most);
            at += 1;
        }
        for &joint in &self.factors {
            map.factor[joint] *= 1.0 + step[at].clamp(-0.2, 0.2);
            at += 1;
        }
        if let Some(coupling) = map.coupling.as_mut().filter(|_| self.fits_coupling) {
            coupling.factor += step[at].clamp(-0.2, 0.2);
            at += 1;
        }
        let three = |first: usize| Vec3::new(step[first], step[first + 1], step[first + 2]);
        let small = |turn: Vec3| {
            rotation_from_rotvec(turn * (MAX_STEP_RAD / turn.norm().max(MAX_STEP_RAD)))
        };
        let shift = |first: usize, with_turn: bool| -> Pose {
            let turn = if with_turn { small(three(first + 3)) } else { Default::default() };
            pose(three(first).into(), turn)
        };
        let with_rotation = view.rotation.is_some();
        frames.tool *= shift(at, with_rotation);
        at += if with_rotation { 6 } else { 3 };
        if freedom == FreeFrames::Both {
            frames.reference = shift(at, true) * frames.reference;
        }
        (map, frames)
    }
}
