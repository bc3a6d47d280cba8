//! Encoding of positions, from positions alone: unit, axes, constant coordinates. Also the lags where
//! the stream follows the arm.

use super::axis_convention::{
    PositionEncoding, StreamPositions, candidate_encodings, is_plausible_extent,
};
use super::orientation_samples::MAX_ENCODING_RESIDUAL_RAD;
use crate::frames::constant_frames::misfit_of_frames;
use crate::frames::position_fit::spread;
use crate::latency::correlation::{ArmSpeeds, LagPeak, MIN_SPEED_CORRELATION, stream_peaks};
use crate::samples::sampling::{as_rotations, slow_samples};
use crate::{EstimateResult, NotObservable, PoseStream};
use ground::geometry::{LengthScale, Pose, Vec3, angle_between, mean_vector};
use ground::stats::mean;
use ground::stream::{JointTrack, PoseTrack};
use nalgebra::Matrix3;

/// As far as positions alone determine it.
#[derive(Clone)]
pub(crate) struct PositionEncodingEstimate {
    /// Factor to metres.
    pub metres: EstimateResult<f64>,
    /// Most likely first. Empty if undetermined.
    pub candidates: Vec<PositionEncoding>,
    /// Coordinates constant while FK's change.
    pub constant: [bool; 3],
    /// Candidate lags.
    pub peaks: Vec<LagPeak>,
    /// Maximum tip speed, m/s.
    pub top_speed_m_s: f64,
    /// Whether rotations are decoded as logged only.
    pub rotations_as_logged: bool,
}

impl PositionEncodingEstimate {
    /// Encoding of `stream`'s positions against FK.
    pub fn estimate(joints: &JointTrack, stream: &PoseStream, max_lag_s: f64) -> Self {
        let arm = ArmSpeeds::from_joints(joints, stream.chain, stream.columns);
        let peaks = stream_peaks(&arm, stream, max_lag_s);
        Self::from_speeds(joints, stream, &arm, peaks)
    }

    /// Same with the arm's speeds and the candidate lags of the stream.
    pub fn from_speeds(
        joints: &JointTrack,
        stream: &PoseStream,
        arm: &ArmSpeeds,
        mut peaks: Vec<LagPeak>,
    ) -> Self {
        /// Relative to the extent; below it, no further lag is tried.
        const MAX_FINAL_RESIDUAL_SHARE: f64 = 0.02;
        let PoseStream { track, chain, reference_known, .. } = *stream;
        peaks.retain(|peak| peak.correlation > MIN_SPEED_CORRELATION);
        let read_as_m = metres_per_unit(track);
        let reach_m = chain.max_reach_m();
        let mut placement = Self {
            metres: Err(NotObservable::NoOverlap),
            candidates: Vec::new(),
            constant: [false; 3],
            peaks,
            top_speed_m_s: arm.top_m_s(),
            rotations_as_logged: false,
        };
        let lag_count = if follows_as_logged(joints, stream) { 0 } else { 2 };
        let lags = placement.peaks.iter().take(lag_count).map(|peak| peak.lag_s).chain([0.0]);
        let mut min_residual_m = f64::INFINITY;
        for lag_s in lags.collect::<Vec<f64>>() {
            let (rows, fk) = slow_samples(joints, stream, lag_s);
            if rows.len() < 2 {
                continue;
            }
            let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row]).collect();
            let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
            let sized = metres_from_size(&at, &xyz, stream);
            // Positions match FK in that unit.
            let by_size = sized.as_ref().ok().copied().filter(|&metres| {
                metres != 1.0 && matches_fk(&xyz, metres, &at, MAX_FINAL_RESIDUAL_SHARE)
            });
            let by_poses = if reference_known { None } else { unit_by_poses(track, &rows, &fk) };
            if let Some(metres) = by_size.or(by_poses.filter(|metres| *metres != 1.0)) {
                let (metres, candidates, constant) = (Ok(metres), Vec::new(), [false; 3]);
                return Self { metres, candidates, constant, ..placement };
            }
            let constant = constant_coordinates(&track.xyz, &at, reference_known);
            let left_out = constant.iter().position(|is| *is);
            let written =
                StreamPositions { xyz: &xyz, constant: left_out, read_as_m, reference_known };
            let mut layouts = match constant.iter().filter(|is| **is).count() {
                0 | 1 => candidate_encodings(&fk, reach_m, &written),
                _ => Vec::new(),
            };
            layouts.retain(|layout| by_poses.is_none() || layout.metres == 1.0);
            let residual_m = layouts.first().map_or(f64::MAX, |layout| layout.residual_m);
            if residual_m < min_residual_m {
                min_residual_m = residual_m;
                placement.metres = sized;
                (placement.candidates, placement.constant) = (layouts, constant);
            }
            if min_residual_m < MAX_FINAL_RESIDUAL_SHARE * spread(&at) {
                break;
            }
        }
        if let Some(metres) = placement.most_likely().map(|layout| layout.metres) {
            placement.metres = Ok(metres);
        }
        placement
    }

    /// Factor to metres; 1 if undetermined.
    pub fn metres(&self) -> f64 {
        *self.metres.as_ref().unwrap_or(&1.0)
    }

    /// Most likely encoding, if it explains the positions.
    pub fn most_likely(&self) -> Option<&PositionEncoding> {
        self.candidates.first().filter(|layout| layout.is_explained)
    }

    /// Copy without mirrored, inverted or rescaled candidates, and with rotations as logged.
    pub fn standard_only(&self) -> Self {
        let candidates =
            self.candidates.iter().filter(|layout| layout.is_standard()).cloned().collect();
        Self { metres: Ok(1.0), candidates, rotations_as_logged: true, ..self.clone() }
    }

    /// Whether positions match FK only when corrected.
    pub fn needs_correction(&self) -> bool {
        let is_constant = self.constant.contains(&true);
        self.most_likely()
            .is_some_and(|layout| is_constant || layout.is_inverted || layout.is_mirrored())
    }
}

/// Constant up to noise, while the others and all of FK's change.
fn constant_coordinates(xyz: &[Vec3], fk: &[Vec3], reference_known: bool) -> [bool; 3] {
    /// Relative to the widest coordinate.
    const MAX_CONSTANT_SPREAD_SHARE: f64 = 0.01;
    /// Spread of FK, relative to the widest coordinate and in m.
    const MIN_MOVING_SPREAD_SHARE: f64 = 0.05;
    const MIN_MOVING_SPREAD_M: f64 = 5e-3;
    /// Relative to the magnitude; less is rounding.
    const ROUNDING_SHARE: f64 = 1e-9;
    let spreads = |variances: Vec3| variances.map(|variance| variance.max(0.0).sqrt());
    // In a world of unknown axes, a motion in any plane may have a constant coordinate.
    let expected = spreads(match reference_known {
        true => covariance(fk).diagonal(),
        false => covariance(fk).symmetric_eigenvalues(),
    });
    let logged = spreads(covariance(xyz).diagonal());
    let all_move =
        expected.min() > MIN_MOVING_SPREAD_M.max(MIN_MOVING_SPREAD_SHARE * expected.max());
    let size = xyz.iter().map(Vec3::amax).fold(0.0, f64::max);
    let some_move = logged.max() > ROUNDING_SHARE * size;
    let most = MAX_CONSTANT_SPREAD_SHARE * logged.max();
    logged.map(|spread| all_move && some_move && spread <= most).into()
}

fn covariance(points: &[Vec3]) -> Matrix3<f64> {
    let mean = mean_vector(points);
    let square = |point: &Vec3| (point - mean) * (point - mean).transpose();
    points.iter().map(square).sum::<Matrix3<f64>>() / points.len().max(1) as f64
}

/// Factor to metres from the extent relative to FK's or, at rest, the distance from a known base.
fn metres_from_size(fk: &[Vec3], xyz: &[Vec3], stream: &PoseStream) -> EstimateResult<f64> {
    const MAX_SIZE_RATIO: f64 = 1.5;
    let reach_m = stream.chain.max_reach_m();
    let (moved, extent) = (spread(fk), spread(xyz));
    let rests = moved <= 0.01 * reach_m;
    let ratio = if !rests {
        extent / moved
    } else if stream.reference_known {
        let norm = |points: &[Vec3]| mean(points.iter().map(Vec3::norm));
        norm(xyz) / norm(fk).max(0.05 * reach_m)
    } else {
        return Err(NotObservable::AtRest);
    };
    let deviation = |factor: f64| (ratio * factor).ln().abs();
    let near =
        usual_factors(stream.track).filter(|factor| deviation(*factor) < MAX_SIZE_RATIO.ln());
    let nearest = near.min_by(|a, b| deviation(*a).total_cmp(&deviation(*b)));
    // Ratios within an arm's reach determine no unit.
    Ok(if (0.2..5.0).contains(&ratio) { 1.0 } else { nearest.unwrap_or(1.0) })
}

/// Factor to metres by size alone; 1 if undetermined.
pub(crate) fn metres_by_size(joints: &JointTrack, stream: &PoseStream) -> f64 {
    let (rows, fk) = slow_samples(joints, stream, 0.0);
    let xyz: Vec<Vec3> = rows.iter().map(|&row| stream.track.xyz[row]).collect();
    let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
    if at.len() < 2 {
        return 1.0;
    }
    metres_from_size(&at, &xyz, stream).unwrap_or(1.0)
}

/// Factor to metres of the usual unit whose extent is closest to the arm's reach, without joint states.
pub(crate) fn metres_by_reach(stream: &PoseStream) -> f64 {
    /// Typical, for an arm's tip.
    const SPREAD_PER_REACH: f64 = 0.3;
    let extent = spread(&stream.track.xyz).max(f64::MIN_POSITIVE);
    let deviation = |factor: f64| {
        (extent * factor / (SPREAD_PER_REACH * stream.chain.max_reach_m())).ln().abs()
    };
    let factors = usual_factors(stream.track).chain([1.0]);
    factors.min_by(|a, b| deviation(*a).total_cmp(&deviation(*b))).unwrap_or(1.0)
}

/// Factor to metres of the usual unit in which constant world and marker frames explain the poses at
/// `rows`. Prefers metres unless another is clearly better. Rotations fix the world's orientation if
/// positions do not.
fn unit_by_poses(track: &PoseTrack, rows: &[usize], fk: &[Pose]) -> Option<f64> {
    /// Relative to the spread, and metres' residual relative to this unit's.
    const MAX_RESIDUAL_SHARE: f64 = 0.1;
    const MIN_RESIDUAL_RATIO: f64 = 5.0;
    let rotations = as_rotations(&track.orientation)?;
    let extent = spread(&track.xyz);
    let residual_share = |metres: f64| {
        let scaled =
            |&row: &usize| Pose::from_parts((track.xyz[row] * metres).into(), rotations[row]);
        let logged: Vec<Pose> = rows.iter().map(scaled).collect();
        misfit_of_frames(fk, &logged)[0] / (metres * extent)
    };
    let in_metres = residual_share(1.0);
    if in_metres <= MAX_RESIDUAL_SHARE {
        return Some(1.0);
    }
    if is_plausible_extent(extent, spread(fk.iter().map(|pose| pose.translation.vector))) {
        return None;
    }
    let shares = usual_factors(track).map(|metres| (residual_share(metres), metres));
    let (min_share, metres) = shares.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (metres != 1.0
        && min_share <= MAX_RESIDUAL_SHARE
        && MIN_RESIDUAL_RATIO * min_share <= in_metres)
        .then_some(metres)
}

/// Factors to metres of the usual units.
fn usual_factors(track: &PoseTrack) -> impl Iterator<Item = f64> {
    let read_as_m = metres_per_unit(track);
    LengthScale::common().map(move |unit| unit.in_m() / read_as_m)
}

fn metres_per_unit(track: &PoseTrack) -> f64 {
    track.declared.as_ref().map_or(1.0, |declared| declared.length.in_m())
}

/// Whether positions match FK to this share of its extent, rms.
fn matches_fk(xyz: &[Vec3], metres: f64, fk: &[Vec3], share: f64) -> bool {
    let squares = xyz.iter().zip(fk).map(|(xyz, fk)| (xyz * metres - fk).norm_squared());
    mean(squares).sqrt() < share * spread(fk)
}

/// Whether a stream matches FK as logged at zero lag. If so, spurious lags of short or uniform motion are
/// ignored.
pub(crate) fn follows_as_logged(joints: &JointTrack, stream: &PoseStream) -> bool {
    /// Relative to FK's extent.
    const MAX_POSITION_ERROR_SHARE: f64 = 0.02;
    let track = stream.track;
    let Some(rotations) = as_rotations(&track.orientation) else { return false };
    let (rows, fk) = slow_samples(joints, stream, 0.0);
    let most_m = MAX_POSITION_ERROR_SHARE * spread(fk.iter().map(|pose| pose.translation.vector));
    let is_there = |(&row, fk): (&usize, &Pose)| {
        (track.xyz[row] - fk.translation.vector).norm() <= most_m
            && angle_between(&rotations[row], &fk.rotation) <= MAX_ENCODING_RESIDUAL_RAD
    };
    !rows.is_empty() && rows.iter().zip(&fk).all(is_there)
}
