//! Joint estimate of camera pose, constant and time offset by Gauss–Newton with robust weights. The
//! residual is in the camera frame, where the noise is the detector's own: `camera_from_target = (carrier ·
//! X)⁻¹ · Y`.

use super::series::{HandEyeSetting, PoseSeries};
use super::start::{MEDIAN_NORMAL_LENGTH, combined_rad, median_of};
use super::{CameraMount, CameraPose, MIN_POSES};
use crate::model::jacobian::pose_change;
use crate::solver::linear::{Linear, Weight};
use crate::solver::robust::sandwich;
use ground::geometry::{Pose, Vec3, pose, rotation_from_rotvec, rotvec_from_rotation};
use ground::stats::{Measured, mean};
use nalgebra::DMatrix;

/// Translation and rotation of `X` in camera axes, those of `Y` in its parent's axes, and the time offset.
pub(crate) const WIDTH: usize = 13;
const OFFSET_COLUMN: usize = 12;
const NOISE_FLOOR_M_RAD: [f64; 2] = [1e-6, 1e-6];
const MAX_ROUNDS: usize = 25;
/// Standard deviations of the remaining poses.
const OUTLIER_SIGMAS: f64 = 6.0;
/// Beyond it, outliers cannot be separated from data.
const MAX_OUTLIER_SHARE: f64 = 0.35;

pub(super) struct HandEyeFit<'a> {
    pub state: HandEyeState,
    pub offset_s: Measured,
    /// Position and rotation noise per component, m and rad.
    pub sigma: [f64; 2],
    covariance: DMatrix<f64>,
    /// Poses without outliers.
    pub setting: HandEyeSetting<'a>,
}

/// Scale factors of the target's positions.
#[derive(Clone, Copy, Debug)]
pub struct TargetScale {
    /// Factor of all coordinates; not 1 if the configured target size is wrong.
    pub size: Measured,
    /// Factor of the depth; not 1 if the focal length is wrong.
    pub depth: Measured,
    /// Depth coordinate: 0 to 2.
    pub along: usize,
    /// Mean distance to the target.
    pub distance_m: f64,
}

impl HandEyeFit<'_> {
    /// Scale of the target's positions to first order; `along` is the depth axis.
    pub fn scale(&self, along: usize) -> TargetScale {
        let Self { state, setting, .. } = self;
        let predicted = setting.targets.iter().filter_map(|it| state.predict_at(setting, it.0));
        let distance_m = mean(predicted.map(|pose| pose.translation.vector.norm()));
        let factor = |stretched: &dyn Fn(Vec3) -> Vec3| {
            let linear = state.linear(setting, Some(stretched));
            let step = linear.normal(&linear.weights()).full_step();
            let weights = linear.weights_after(step.as_slice());
            let variance = covariance_of(&linear, &weights)[(WIDTH, WIDTH)];
            let independent = weights[0].noise.independent(linear.len());
            let dof = (independent - linear.width as f64).max(3.0);
            Measured { value: 1.0 + step[WIDTH], std_error: variance.max(0.0).sqrt(), dof }
        };
        let deep = |xyz: Vec3| Vec3::ith(along, xyz[along]);
        TargetScale { size: factor(&|xyz| xyz), depth: factor(&deep), along, distance_m }
    }

    /// Combined residual, rad.
    pub fn misfit(&self) -> f64 {
        combined_rad(self.sigma[0], self.sigma[1])
    }

    /// Pose with standard errors.
    pub fn camera(&self) -> CameraPose {
        let dof = self.offset_s.dof;
        let variance = |at: usize| self.covariance[(at, at)];
        let error = |first: usize| [0, 1, 2].map(|axis| variance(first + axis).max(0.0).sqrt());
        // Along the vector, or the largest component of a zero vector.
        let along = |vector: Vec3, first: usize| {
            let block = self.covariance.fixed_view::<3, 3>(first, first);
            let variance = match vector.try_normalize(1e-9) {
                Some(u) if block.iter().all(|entry| entry.is_finite()) => u.dot(&(block * u)),
                _ => block.diagonal().max().max(0.0),
            };
            Measured { value: vector.norm(), std_error: variance.max(0.0).sqrt(), dof }
        };
        let camera = self.state.camera;
        let shift = camera.rotation.inverse() * camera.translation.vector;
        CameraPose {
            pose: camera,
            translation_error_m: error(0),
            rotation_error_rad: error(3),
            distance_m: along(shift, 0),
            angle_rad: along(rotvec_from_rotation(&camera.rotation), 3),
        }
    }

    /// Deviation of a target's pose from the prediction, m and rad in camera axes. `None` if the carrier's pose is
    /// unknown.
    pub fn residual(&self, setting: &HandEyeSetting, t_s: f64, target: &Pose) -> Option<[Vec3; 2]> {
        Some(pose_change(&self.state.predict_at(setting, t_s)?, target))
    }

    /// Whether these residuals are an outlier's.
    pub fn is_outlier(&self, residual: &[Vec3; 2]) -> bool {
        (0..2).any(|kind| {
            residual[kind].norm() > OUTLIER_SIGMAS * self.sigma[kind].max(NOISE_FLOOR_M_RAD[kind])
        })
    }
}

impl TargetScale {
    /// Depth error at the mean distance by the more significant factor.
    pub fn effect_m(&self) -> Measured {
        let deviation = |of: &Measured| Measured { value: of.value - 1.0, ..*of };
        let surely = |of: &Measured| (of.value / of.std_error).abs();
        let (size, depth) = (deviation(&self.size), deviation(&self.depth));
        let surer = if surely(&size) > surely(&depth) { size } else { depth };
        surer.scaled(self.distance_m)
    }
}

#[derive(Clone, Copy)]
pub(super) struct HandEyeState {
    pub camera: Pose,
    pub constant: Pose,
    pub offset_s: f64,
}

impl HandEyeState {
    fn predict(&self, carrier_pose: &Pose) -> Pose {
        (carrier_pose * self.camera).inverse() * self.constant
    }

    fn predict_at(&self, setting: &HandEyeSetting, t_s: f64) -> Option<Pose> {
        Some(self.predict(&setting.carrier_at(t_s - self.offset_s)?))
    }

    fn stepped(&self, step: &[f64]) -> Self {
        let xyz = |first: usize| Vec3::new(step[first], step[first + 1], step[first + 2]);
        let Self { camera, constant, offset_s } = *self;
        let turned = rotation_from_rotvec(xyz(9)) * constant.rotation;
        Self {
            camera: camera * pose(xyz(0).into(), rotation_from_rotvec(xyz(3))),
            constant: pose((constant.translation.vector + xyz(6)).into(), turned),
            offset_s: offset_s + step[OFFSET_COLUMN],
        }
    }

    /// A last column contains the component of the target's position that `stretched` selects, if any.
    fn linear(&self, setting: &HandEyeSetting, stretched: Option<&dyn Fn(Vec3) -> Vec3>) -> Linear {
        /// For the hand's velocity.
        const STEP_S: f64 = 0.01;
        let mut linear = Linear::new(WIDTH + usize::from(stretched.is_some()), &NOISE_FLOOR_M_RAD);
        for &(t_s, target) in &setting.targets {
            let at = |shift_s: f64| setting.carrier_at(t_s - self.offset_s - shift_s);
            let Some(carrier_pose) = at(0.0) else { continue };
            let predicted = self.predict(&carrier_pose);
            let mut rows = linear.push(&pose_change(&predicted, &target));
            let observed = predicted.translation.vector;
            let turned = (carrier_pose * self.camera).rotation.inverse();
            for axis in 0..3 {
                let unit = Vec3::ith(axis, 1.0);
                rows.set(0, axis, -unit);
                rows.set_all(3 + axis, [observed.cross(&unit), -unit]);
                rows.set(0, 6 + axis, turned * unit);
                rows.set(1, 9 + axis, turned * unit);
            }
            if let (Some(before), Some(after)) = (at(STEP_S), at(-STEP_S)) {
                let change = pose_change(&self.predict(&after), &self.predict(&before));
                rows.set_all(OFFSET_COLUMN, change.map(|part| part / (2.0 * STEP_S)));
            }
            if let Some(stretched) = stretched {
                rows.set(0, WIDTH, stretched(observed));
            }
        }
        linear
    }
}

/// Derivatives of the observed target pose for a camera in the hand, with the hand at `hands` at times
/// `t_s`. The target is first at `ahead` in the camera, m.
pub(crate) fn design(t_s: &[f64], hands: Vec<Pose>, camera: Pose, ahead: Vec3) -> Linear {
    let target = pose(ahead.into(), Default::default());
    let constant = hands.first().copied().unwrap_or_default() * camera * target;
    let series = PoseSeries { t_s: t_s.to_vec(), poses: hands };
    // Observed poses affect only the residuals.
    let targets = t_s.iter().map(|&t_s| (t_s, target));
    let setting = HandEyeSetting::new(&series, targets, CameraMount::InHand);
    let state = HandEyeState { camera, constant, offset_s: 0.0 };
    state.linear(&setting, None)
}

/// Fits the closed-form solution's camera and constant again without outliers, if these are few. `None` if fewer than
/// [`MIN_POSES`] poses remain.
pub(super) fn fit<'a>(
    setting: HandEyeSetting<'a>,
    [camera, constant]: [Pose; 2],
    lag_s: f64,
) -> Option<HandEyeFit<'a>> {
    let found = refine(HandEyeState { camera, constant, offset_s: lag_s }, setting)?;
    let setting = &found.setting;
    let is_inlier = |(t_s, target): &&(f64, Pose)| {
        let residual = found.residual(setting, *t_s, target);
        residual.is_some_and(|residual| !found.is_outlier(&residual))
    };
    let targets: Vec<(f64, Pose)> = setting.targets.iter().filter(is_inlier).copied().collect();
    if (targets.len() as f64) < (1.0 - MAX_OUTLIER_SHARE) * setting.targets.len() as f64 {
        return Some(found);
    }
    refine(found.state, HandEyeSetting { targets, ..*setting })
}

/// Halves each step until the cost decreases under the previous weights.
fn refine(mut state: HandEyeState, setting: HandEyeSetting<'_>) -> Option<HandEyeFit<'_>> {
    const MAX_HALVINGS: usize = 6;
    let mut linear = state.linear(&setting, None);
    let mut weights = linear.first_weights();
    for _ in 0..MAX_ROUNDS {
        if linear.len() < MIN_POSES {
            return None;
        }
        let normal = linear.normal(&weights);
        let steps = std::iter::successors(Some(normal.full_step()), |step| Some(0.5 * step));
        let next = steps.take(MAX_HALVINGS).find_map(|step| {
            let moved = state.stepped(step.as_slice());
            let there = moved.linear(&setting, None);
            // The offset may add or remove poses at the ends.
            let is_same = there.len() == linear.len();
            let is_better = !is_same || there.normal(&weights).cost <= normal.cost;
            is_better.then_some((step, moved, there))
        });
        let Some((step, moved, there)) = next else { break };
        (state, linear) = (moved, there);
        weights = linear.weights();
        let is_small = step.rows(0, 3).norm() < 1e-8 && step.rows(3, 3).norm() < 1e-8;
        if is_small && step[OFFSET_COLUMN].abs() < 1e-8 {
            break;
        }
    }
    if linear.len() < MIN_POSES {
        return None;
    }
    let weights = linear.weights();
    let covariance = covariance_of(&linear, &weights);
    let dof = linear.normal(&weights).dof(WIDTH);
    let sigma = [0, 1]
        .map(|kind| median_of(linear.residual[kind].iter().map(Vec3::norm)) / MEDIAN_NORMAL_LENGTH);
    let std_error = covariance[(OFFSET_COLUMN, OFFSET_COLUMN)].max(0.0).sqrt();
    let offset_s = Measured { value: state.offset_s, std_error, dof };
    Some(HandEyeFit { state, offset_s, sigma, covariance, setting })
}

/// Covariance of all parameters. A variance is infinite if the poses do not determine its parameter.
fn covariance_of(linear: &Linear, weights: &[Weight]) -> DMatrix<f64> {
    let [information, scores] = linear.covariance_parts(weights);
    sandwich(&information, &scores)
}
