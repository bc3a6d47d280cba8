//! Residual of a run after fitting a constant tool frame and a constant reference frame.

use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::{AlignedSamples, ArmDiagnosis, NotObservable, PoseDiagnosis};
use ground::geometry::{Vec3, rotvec_from_rotation};
use nalgebra::{Matrix3, SMatrix, SVector};

/// 1 mm and 0.1°: consistent with link deviations and calibration error.
const MAX_RESIDUAL_M_RAD: [f64; 2] = [1e-3, 0.1 * std::f64::consts::PI / 180.0];
/// Weights rotations relative to positions.
const LEVER_M: f64 = 0.3;
const SEGMENTS: usize = 20;

/// Whether constant tool and reference frames explain the run: every stream's residual must be below 1 mm
/// and 0.1° rms in every segment, and its rotations must follow the arm.
pub(crate) fn constant_frames_suffice(diagnosis: &ArmDiagnosis) -> bool {
    let is_small = |aligned: &AlignedSamples, has_rotation: bool| {
        let residuals = constant_frame_residuals(aligned, has_rotation);
        let size = residuals.len().div_ceil(SEGMENTS).max(MIN_SEGMENT_SAMPLES);
        !residuals.is_empty()
            && residuals.chunks(size).all(|part| {
                let rms = |kind: usize| {
                    let squares: f64 = part.iter().map(|both| both[kind].norm_squared()).sum();
                    (squares / part.len() as f64).sqrt()
                };
                (0..2).all(|kind| rms(kind) < MAX_RESIDUAL_M_RAD[kind])
            })
    };
    let is_explained = |stream: &PoseDiagnosis| {
        !matches!(stream.encoding, Err(NotObservable::DoesNotFollow(_)))
            && is_small(&stream.aligned, stream.encoding.is_ok())
    };
    !diagnosis.streams.is_empty() && diagnosis.streams.iter().all(is_explained)
}

/// Residuals, m and rad, after a least-squares fit of small changes of tool and reference.
fn constant_frame_residuals(aligned: &AlignedSamples, has_rotation: bool) -> Vec<[Vec3; 2]> {
    let pairs = || aligned.corrected.iter().zip(&aligned.fk_at_truth);
    let mut residuals: Vec<[Vec3; 2]> = pairs()
        .map(|(is, fk)| {
            let turn = rotvec_from_rotation(&(is.rotation * fk.rotation.inverse()));
            let turn = if has_rotation { turn } else { Vec3::zeros() };
            [is.translation.vector - fk.translation.vector, turn]
        })
        .collect();
    // Columns: translation and rotation of the reference, then of the tool.
    let design: Vec<SMatrix<f64, 6, 12>> = pairs()
        .map(|(_, fk)| {
            let mut rows = SMatrix::<f64, 6, 12>::zeros();
            let turn = *fk.rotation.to_rotation_matrix().matrix();
            rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            let lever = -fk.translation.vector.cross_matrix();
            rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&lever);
            rows.fixed_view_mut::<3, 3>(0, 6).copy_from(&turn);
            if has_rotation {
                rows.fixed_view_mut::<3, 3>(3, 3)
                    .copy_from(&(LEVER_M * Matrix3::<f64>::identity()));
                rows.fixed_view_mut::<3, 3>(3, 9).copy_from(&(LEVER_M * turn));
            }
            rows
        })
        .collect();
    let mut normal = SMatrix::<f64, 12, 12>::identity() * (1e-9 * residuals.len() as f64);
    let mut right = SVector::<f64, 12>::zeros();
    for (rows, [length, turn]) in design.iter().zip(&residuals) {
        let mut target = SVector::<f64, 6>::zeros();
        target.fixed_rows_mut::<3>(0).copy_from(length);
        target.fixed_rows_mut::<3>(3).copy_from(&(LEVER_M * turn));
        normal += rows.transpose() * rows;
        right += rows.transpose() * target;
    }
    let step = normal.cholesky().map_or_else(SVector::zeros, |cholesky| cholesky.solve(&right));
    for (rows, [length, turn]) in design.iter().zip(&mut residuals) {
        let explained = rows * step;
        *length -= explained.fixed_rows::<3>(0);
        *turn -= explained.fixed_rows::<3>(3) / LEVER_M;
    }
    residuals
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{Pose, pose, rotation_from_rotvec};

    /// Moving tip whose poses differ from FK by `off`.
    fn aligned(off: impl Fn(usize, &Pose) -> Pose) -> AlignedSamples {
        let at = |k: usize| {
            let s = k as f64 * 0.05;
            let turn =
                rotation_from_rotvec(Vec3::new(0.6 * s.sin(), 0.4 * (1.3 * s).cos(), 0.5 * s));
            pose([0.5 + 0.2 * s.cos(), 0.2 * (0.7 * s).sin(), 0.3], turn)
        };
        let fk_at_truth: Vec<Pose> = (0..400).map(at).collect();
        let corrected = fk_at_truth.iter().enumerate().map(|(k, fk)| off(k, fk)).collect();
        AlignedSamples { corrected, fk_at_truth, ..AlignedSamples::default() }
    }

    fn largest(left: &[[Vec3; 2]]) -> f64 {
        left.iter().map(|[length, _]| length.norm()).fold(0.0, f64::max)
    }

    #[test]
    fn constant_frames_are_removed_and_a_tool_slip_is_not() {
        let tool = pose([2e-3, -1e-3, 4e-3], rotation_from_rotvec(Vec3::new(1e-3, 0.0, 2e-3)));
        let base = pose([1e-3, 3e-3, 0.0], rotation_from_rotvec(Vec3::new(0.0, 2e-3, -1e-3)));
        let constant = constant_frame_residuals(&aligned(|_, fk| base * fk * tool), true);
        assert!(largest(&constant) < 5e-5, "{}", largest(&constant));
        let slip = pose([0.0, 0.0, 5e-3], ground::geometry::Rotation::identity());
        let slipped = |k: usize, fk: &Pose| if k < 200 { *fk } else { fk * slip };
        let slipped = constant_frame_residuals(&aligned(slipped), true);
        assert!(largest(&slipped) > 1.5e-3, "{}", largest(&slipped));
    }
}
