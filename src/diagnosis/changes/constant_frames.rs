//! Residual of a run after fitting a constant tool frame and a constant reference frame.

use crate::model::jacobian::link_derivatives;
use crate::model::measurement::{ExcludedComponents, FLOOR_M, FLOOR_RAD};
use crate::priors::LEVER_M;
use crate::residuals::comparison::MIN_SEGMENT_SAMPLES;
use crate::solver::linear::Linear;
use crate::solver::noise::rms;
use crate::{AlignedSamples, ArmDiagnosis, NotObservable, PoseDiagnosis};
use ground::geometry::{Pose, Vec3};

/// 1 mm and 0.1°: consistent with link deviations and calibration error.
const MAX_RESIDUAL_M_RAD: [f64; 2] = [1e-3, 0.1 * std::f64::consts::PI / 180.0];
const SEGMENTS: usize = 20;

/// Whether constant tool and reference frames explain the run: every stream's residual must be below 1 mm
/// and 0.1° rms in every segment, and its rotations must follow the arm.
pub(crate) fn constant_frames_suffice(diagnosis: &ArmDiagnosis) -> bool {
    let is_small = |aligned: &AlignedSamples, has_rotation: bool| {
        let residuals = constant_frame_residuals(aligned, has_rotation);
        let samples = aligned.fk_at_truth.len();
        let size = samples.div_ceil(SEGMENTS).max(MIN_SEGMENT_SAMPLES);
        let is_below = |(residuals, max): (&Vec<Vec3>, f64)| {
            residuals.chunks(size).all(|part| rms(part) < max)
        };
        samples > 0 && residuals.iter().zip(MAX_RESIDUAL_M_RAD).all(is_below)
    };
    let is_explained = |stream: &PoseDiagnosis| {
        !matches!(stream.encoding, Err(NotObservable::DoesNotFollow(_)))
            && is_small(&stream.aligned, stream.encoding.is_ok())
    };
    !diagnosis.streams.is_empty() && diagnosis.streams.iter().all(is_explained)
}

/// Residuals, m and rad, after a least-squares fit of small changes of tool and reference.
fn constant_frame_residuals(aligned: &AlignedSamples, has_rotation: bool) -> Vec<Vec<Vec3>> {
    let mut linear = Linear::new(12, &[FLOOR_M, FLOOR_RAD]);
    let excluded = ExcludedComponents { rotation: !has_rotation, ..Default::default() };
    for (row, fk) in aligned.fk_at_truth.iter().take(aligned.corrected.len()).enumerate() {
        let mut rows = linear.push(&excluded.mask(aligned.residual(row, fk)));
        let of_frame = |frame: Pose| link_derivatives(&frame, &fk.translation.vector);
        let derivatives = [Pose::identity(), *fk].into_iter().flat_map(of_frame);
        derivatives.enumerate().for_each(|(column, own)| rows.set_all(column, excluded.mask(own)));
    }
    let mut weights = linear.even_weights();
    weights[1].noise.sigma = 1.0 / LEVER_M;
    let step = linear.normal(&weights).full_step();
    linear.residuals_after(step.as_slice())
}

#[cfg(test)]
mod tests {
    use super::*;
    use ground::geometry::{pose, rotation_from_rotvec};

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

    fn largest(residuals: &[Vec<Vec3>]) -> f64 {
        residuals[0].iter().map(Vec3::norm).fold(0.0, f64::max)
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
