//! Residual of a pose stream at slow samples for a mapping of the joint states.

use super::map::{JointMap, scaled};
use crate::frames::constant_frames::{initial_frames, tool_frame};
use crate::frames::position_fit::PositionFit;
use ground::geometry::{Pose, Rotation, Vec3, angle_between, pose, rotvec_from_rotation};
use ground::robot::Chain;
use ground::stats::mean;

/// For a thinned and for a full view.
const THINNED_FRAME_ITERATIONS: usize = 5;
const FRAME_ITERATIONS: usize = 30;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FreeFrames {
    /// An active TCP.
    Tool,
    Both,
}

/// In `logged = reference · FK · tool`.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ConstantFrames {
    pub reference: Pose,
    pub tool: Pose,
}

/// Rms; no angle if only positions are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ResidualSize {
    pub m: f64,
    pub rad: Option<f64>,
}

impl ResidualSize {
    /// One length, with the angle at `lever_m`.
    pub fn combined_m(self, lever_m: f64) -> f64 {
        self.m.hypot(lever_m * self.rad.unwrap_or(0.0))
    }
}

#[derive(Clone)]
pub(super) struct InterpretedPoses<'a> {
    pub chain: &'a Chain,
    pub xyz: Vec<Vec3>,
    /// Rotations, if used.
    pub rotation: Option<Vec<Rotation>>,
    /// Row-major, in chain order.
    pub q: Vec<f64>,
    /// Minimum and maximum logged value per joint.
    pub spans: Vec<[f64; 2]>,
    /// Converts angles to lengths.
    pub lever_m: f64,
    /// Iterations of the frame search.
    pub turns: usize,
}

impl<'a> InterpretedPoses<'a> {
    /// All samples, with a lever by the arm's reach.
    pub fn new(
        chain: &'a Chain,
        xyz: Vec<Vec3>,
        rotation: Option<Vec<Rotation>>,
        q: Vec<f64>,
        spans: Vec<[f64; 2]>,
    ) -> Self {
        let lever_m = (0.25 * chain.max_reach_m()).max(0.05);
        Self { chain, xyz, rotation, q, spans, lever_m, turns: FRAME_ITERATIONS }
    }

    pub fn as_logged(&self) -> JointMap {
        JointMap::as_logged(self.chain.dof())
    }

    /// Poses as logged, inverted, and positions only.
    pub fn views(&self) -> Vec<Self> {
        let positions = Self { rotation: None, ..self.clone() };
        let inverted = self.inverted().map(|inverted| [self.clone(), inverted]);
        inverted.into_iter().flatten().chain([positions]).collect()
    }

    /// `None` without rotations.
    fn inverted(&self) -> Option<Self> {
        let rotation: Vec<Rotation> =
            self.rotation.as_ref()?.iter().map(Rotation::inverse).collect();
        let xyz = rotation.iter().zip(&self.xyz).map(|(inverse, xyz)| -(inverse * xyz)).collect();
        Some(Self { xyz, rotation: Some(rotation), ..self.clone() })
    }

    pub fn len(&self) -> usize {
        self.xyz.len()
    }

    /// Keeps at most `most` samples, evenly spaced.
    pub fn thinned(&self, most: usize) -> Self {
        let step = self.len().div_ceil(most).max(1);
        let thinned = self.at_rows((0..self.len()).step_by(step));
        Self { turns: THINNED_FRAME_ITERATIONS, ..thinned }
    }

    pub fn at_rows(&self, rows: impl Iterator<Item = usize> + Clone) -> Self {
        let some = |all: &Vec<Rotation>| rows.clone().map(|row| all[row]).collect();
        let dof = self.chain.dof();
        Self {
            xyz: rows.clone().map(|row| self.xyz[row]).collect(),
            rotation: self.rotation.as_ref().map(some),
            q: rows.clone().flat_map(|row| &self.q[row * dof..(row + 1) * dof]).copied().collect(),
            spans: self.spans.clone(),
            ..*self
        }
    }

    /// Mirrors the positions and drops the rotations.
    pub fn mirrored(&self) -> Self {
        let mirror = |xyz: &Vec3| Vec3::new(-xyz.x, xyz.y, xyz.z);
        Self { rotation: None, xyz: self.xyz.iter().map(mirror).collect(), ..self.clone() }
    }

    pub fn fk(&self, map: &JointMap) -> Vec<Pose> {
        let dof = self.chain.dof();
        let mut q = vec![0.0; self.q.len()];
        let rows = self.q.chunks_exact(dof).zip(q.chunks_exact_mut(dof));
        rows.for_each(|(row, q)| map.apply(row, q));
        let mut poses = Vec::new();
        self.chain.forward_batch(&q, &mut poses);
        poses
    }

    /// Positions by FK with revolute joints in `unit`, rad.
    pub fn fk_positions(&self, unit: f64) -> Vec<Vec3> {
        let fk = self.fk(&scaled(self.chain, unit, 1.0));
        fk.iter().map(|pose| pose.translation.vector).collect()
    }

    /// The smaller position residual of the poses and of their inverses against FK as logged, rms m.
    pub fn least_misfit(&self, freedom: FreeFrames) -> f64 {
        let fk = &self.fk(&self.as_logged());
        let of = |poses: &Self| {
            let fit = PositionFit { fk, xyz: &poses.xyz };
            if freedom == FreeFrames::Both { fit.misfit() } else { fit.tool_misfit() }
        };
        of(self).min(self.inverted().map_or(f64::INFINITY, |inverted| of(&inverted)))
    }

    /// Poses as logged; without rotations, their rotations are the identity.
    pub fn logged(&self) -> Vec<Pose> {
        let rotation =
            |k: usize| self.rotation.as_ref().map_or_else(Rotation::identity, |all| all[k]);
        self.xyz.iter().enumerate().map(|(k, xyz)| pose((*xyz).into(), rotation(k))).collect()
    }

    /// Frames under `map` from which a search starts.
    pub fn first_frames(&self, map: &JointMap, freedom: FreeFrames) -> ConstantFrames {
        match freedom {
            FreeFrames::Tool => ConstantFrames::default(),
            FreeFrames::Both => self.fit_frames(&self.fk(map), freedom),
        }
    }

    /// Frames with the smallest residual.
    pub fn fit_frames(&self, fk: &[Pose], freedom: FreeFrames) -> ConstantFrames {
        let by_positions = |turns: usize| {
            let (reference, tool) = PositionFit { fk, xyz: &self.xyz }.frames(turns);
            ConstantFrames { reference, tool: pose(tool.into(), Rotation::identity()) }
        };
        if self.rotation.is_none() {
            return by_positions(if freedom == FreeFrames::Both { self.turns } else { 0 });
        }
        let logged = self.logged();
        let tool = ConstantFrames { reference: Pose::identity(), tool: tool_frame(fk, &logged) };
        if freedom == FreeFrames::Tool {
            return tool;
        }
        let (reference, turned_tool) = initial_frames(fk, &logged);
        let placed = by_positions(self.turns).reference;
        let seen: Vec<Pose> = logged.iter().map(|pose| placed.inverse() * pose).collect();
        let placed = ConstantFrames { reference: placed, tool: tool_frame(fk, &seen) };
        let both = [ConstantFrames { reference, tool: turned_tool }, placed, tool];
        let left =
            |frames: &ConstantFrames| self.residual_against(fk, frames).combined_m(self.lever_m);
        both.into_iter().min_by(|a, b| left(a).total_cmp(&left(b))).unwrap_or(tool)
    }

    pub fn residual_against(&self, fk: &[Pose], frames: &ConstantFrames) -> ResidualSize {
        let (mut metres, mut radians) = (0.0, 0.0);
        for (k, fk) in fk.iter().enumerate() {
            let [position, rotation] = self.residual(k, &(frames.reference * fk * frames.tool));
            metres += position.norm_squared();
            radians += rotation.norm_squared();
        }
        let n = self.len().max(1) as f64;
        let rad = self.rotation.as_ref().map(|_| (radians / n).sqrt());
        ResidualSize { m: (metres / n).sqrt(), rad }
    }

    /// Logged minus predicted, m and rad.
    pub fn residual(&self, k: usize, predicted: &Pose) -> [Vec3; 2] {
        let turn =
            |all: &Vec<Rotation>| rotvec_from_rotation(&(all[k] * predicted.rotation.inverse()));
        let rotation = self.rotation.as_ref().map_or_else(Vec3::zeros, turn);
        [self.xyz[k] - predicted.translation.vector, rotation]
    }

    /// Frame-independent residual: distances and angles between samples, rms m. A tool offset changes them
    /// slightly. `logged` are those of the logged poses.
    pub fn strain(&self, map: &JointMap, logged: &[[f64; 2]]) -> f64 {
        let lever_m = if self.rotation.is_some() { self.lever_m } else { 0.0 };
        let distances = self.distances(&self.fk(map));
        let squares = distances.iter().zip(logged).map(|(fk, logged)| {
            (fk[0] - logged[0]).powi(2) + (lever_m * (fk[1] - logged[1])).powi(2)
        });
        mean(squares).sqrt()
    }

    /// Distances, m, and angles, rad, between some poses. Angles are 0 if only positions are compared.
    pub fn distances(&self, poses: &[Pose]) -> Vec<[f64; 2]> {
        let n = poses.len();
        let pairs =
            (0..n).flat_map(|k| [1, n / 3 + 1].map(|step| (poses[k], poses[(k + step) % n])));
        let distance = |(a, b): (Pose, Pose)| {
            let distance_m = (a.translation.vector - b.translation.vector).norm();
            let angle = self.rotation.as_ref().map(|_| angle_between(&a.rotation, &b.rotation));
            [distance_m, angle.unwrap_or(0.0)]
        };
        pairs.map(distance).collect()
    }

    /// Residual with the best frames.
    pub fn fitted_residual(&self, map: &JointMap, freedom: FreeFrames) -> ResidualSize {
        let fk = self.fk(map);
        self.residual_against(&fk, &self.fit_frames(&fk, freedom))
    }

    /// Same, as one length.
    pub fn misfit(&self, map: &JointMap, freedom: FreeFrames) -> f64 {
        self.fitted_residual(map, freedom).combined_m(self.lever_m)
    }
}
