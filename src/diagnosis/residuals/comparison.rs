//! Compares residuals of a run under two diagnoses, and with its noise.

use super::residual_check::{ErrorSeries, ErrorSize, PartError, align_with_fk};
use super::trajectory_error::nearest_stamps;
use crate::model::measurement::{FLOOR_M, FLOOR_RAD};
use crate::solver::noise::{Noise, rms};
use crate::{ArmDiagnosis, NotObservable, PoseDiagnosis, PoseStream, StreamResidual};
use ground::geometry::{Vec3, mean_vector};
use ground::stream::{JointTrack, Orientations};

/// Of a segment of the run.
pub(crate) const MIN_SEGMENT_SAMPLES: usize = 20;
/// Of a residual beyond the noise.
const MIN_NOISE_RATIO: f64 = 2.0;
/// Upper bound for a healthy stream.
const HEALTHY_RESIDUAL_M_RAD: [f64; 2] = [0.3e-3, 0.5e-3];

/// Whether a stream's residual exceeds its noise in some segment.
pub(crate) fn has_large_residual(diagnosis: &PoseDiagnosis) -> bool {
    let aligned = &diagnosis.aligned;
    let does_not_follow = matches!(diagnosis.encoding, Err(NotObservable::DoesNotFollow(_)));
    if does_not_follow || aligned.t_s.len() < MIN_SEGMENT_SAMPLES {
        return does_not_follow;
    }
    let [length, angle] = residual_vectors(diagnosis);
    let angle = diagnosis.encoding.is_ok().then_some(angle);
    let series = ErrorSeries::new(&aligned.t_s, &aligned.fk_at_truth, length, angle);
    let error = series.error(&Vec::from_iter(0..aligned.t_s.len()));
    let is_much = |(size, min_size): (&ErrorSize, f64)| {
        size.parts.iter().any(|PartError { magnitude, .. }| {
            let noise = magnitude.noise.map_or(0.0, |noise| noise.rms);
            magnitude.rms > min_size.max(MIN_NOISE_RATIO * noise)
        })
    };
    std::iter::once(&error.length).chain(&error.angle).zip(HEALTHY_RESIDUAL_M_RAD).any(is_much)
}

/// Angles are weighted by 0.3 m. An undecoded stream counts as 1 m.
pub(crate) fn residual_m(diagnosis: &ArmDiagnosis) -> f64 {
    diagnosis.streams.iter().map(stream_residual_m).sum()
}

/// The same if only these shares of the streams have been compared with FK. The rest counts as 1 m, in a geometric mean.
pub(crate) fn residual_of_shares_m(diagnosis: &ArmDiagnosis, shares: &[f64]) -> f64 {
    let of_stream = |(found, share): (&PoseDiagnosis, &f64)| stream_residual_m(found).powf(*share);
    diagnosis.streams.iter().zip(shares).map(of_stream).sum()
}

fn stream_residual_m(diagnosis: &PoseDiagnosis) -> f64 {
    diagnosis.followed_residual().map_or(1.0, StreamResidual::combined_m)
}

/// Whether the residual exceeds the noise, or its mean in some segment does.
pub(crate) fn has_slow_residual(diagnosis: &PoseDiagnosis) -> bool {
    has_large_residual(diagnosis) || has_slow_means(residual_vectors(diagnosis))
}

/// Whether residuals, m and rad, are larger than a healthy stream's and than their sample-to-sample noise.
pub(crate) fn exceeds_noise(residuals: &[Vec<Vec3>]) -> bool {
    let exceeds = |(residuals, healthy): (&Vec<Vec3>, f64)| {
        let steps: Vec<Vec3> = residuals.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let noise = 0.5_f64.sqrt() * rms(&steps);
        rms(residuals) > healthy.max(MIN_NOISE_RATIO * noise)
    };
    residuals.iter().zip(HEALTHY_RESIDUAL_M_RAD).any(exceeds)
}

/// Whether the mean of residuals, m and rad, exceeds the noise in some segment.
pub(crate) fn has_slow_means(residuals: impl IntoIterator<Item = Vec<Vec3>>) -> bool {
    /// For a significant mean.
    const MIN_STD_ERRORS: f64 = 6.0;
    let is_slow = |(residuals, (floor, small)): (Vec<Vec3>, (f64, f64))| {
        let beside = minus_segment_means(&residuals);
        let noise = Noise::unweighted(&beside, floor);
        segments(&residuals).any(|part| {
            let variance = 3.0 * noise.sigma.powi(2) * noise.inflation() / part.len() as f64;
            mean_vector(part).norm() > f64::max(small, MIN_STD_ERRORS * variance.sqrt())
        })
    };
    let floors = [(FLOOR_M, HEALTHY_RESIDUAL_M_RAD[0]), (FLOOR_RAD, HEALTHY_RESIDUAL_M_RAD[1])];
    residuals.into_iter().zip(floors).any(is_slow)
}

fn segments(residuals: &[Vec3]) -> impl Iterator<Item = &[Vec3]> {
    const SEGMENTS: usize = 10;
    residuals.chunks(residuals.len().div_ceil(SEGMENTS).max(MIN_SEGMENT_SAMPLES))
}

/// Residuals minus their means in segments of the run.
pub(crate) fn minus_segment_means(residuals: &[Vec3]) -> Vec<Vec3> {
    let minus_mean = |part: &[Vec3]| -> Vec<Vec3> {
        let mean = mean_vector(part);
        part.iter().map(|residual| residual - mean).collect()
    };
    segments(residuals).flat_map(minus_mean).collect()
}

/// Position, m, and rotation, rad, at the measured point.
pub(crate) fn residual_vectors(diagnosis: &PoseDiagnosis) -> [Vec<Vec3>; 2] {
    diagnosis.aligned.residuals(diagnosis.frame_correction.tool.translation.vector)
}

/// Restores recorded poses, and FK of recorded joint states, in a corrected stream's samples, for reports.
pub(crate) fn restore_recorded(
    joints: &JointTrack,
    stream: &PoseStream,
    after: &mut PoseDiagnosis,
) {
    let recorded = align_with_fk(joints, stream);
    let aligned = &mut after.aligned;
    for (row, at) in nearest_stamps(&aligned.t_s, &recorded.t_s, f64::INFINITY) {
        aligned.fk[row] = recorded.fk[at];
        aligned.logged[row].translation = recorded.logged[at].translation;
        if matches!(stream.track.orientation, Orientations::Rotations(_)) {
            aligned.logged[row].rotation = recorded.logged[at].rotation;
        }
    }
}
