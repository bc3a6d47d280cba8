//! Decodes a stream: position unit, rotation encoding, and the branch of each ambiguous rotation.

use std::borrow::Cow;

use super::axis_convention::PositionEncoding;
use super::orientation_samples::{MAX_ENCODING_RESIDUAL_RAD, PositionInterpretation};
use super::position::{PositionEncodingEstimate, follows_as_logged};
use super::rotation::{
    EncodingFit, LoggedRotations, MAX_RESIDUAL_DIFFERENCE_RAD, RotationSamples, estimate_encoding,
};
use crate::distinct::distinct;
use crate::frames::position_fit::spread;
use crate::joints::CorrectedJoints;
use crate::latency::correlation::LagPeak;
use crate::model::measurement::{ExcludedComponents, PoseObservations, StreamState};
use crate::samples::sampling::{MAX_SEARCH_SAMPLES, check_sample_count, slow_samples};
use crate::{
    AxesError, EncodingEstimate, EstimateResult, LastTurn, NotObservable, PoseStream, UnitResiduals,
};
use ground::geometry::{Rotation, Vec3, angle_between};
use ground::stream::{DeclaredUnits, Orientations, PoseTrack};

/// Smaller turns may be due to small joint errors.
pub(crate) const MIN_TURN_RAD: f64 = 0.2;
/// For a latency estimate.
const MIN_MOVING_SAMPLES: usize = 10;

/// Decoded stream with the evidence for its encoding.
pub(crate) struct DecodedStream<'a> {
    pub observations: PoseObservations<'a>,
    /// Estimated if the stream has orientations.
    pub encoding: EstimateResult<EncodingEstimate>,
    pub degrees: Option<UnitResiduals>,
    pub metres: f64,
    /// Position and rotation axes, if not standard.
    pub axes: Option<AxesError>,
    /// Whether whole poses are inverted.
    pub is_inverted: bool,
    /// Constant coordinates.
    pub constant: [bool; 3],
    /// Frames that must be rotated to match the rotations.
    rotated_frames: u8,
    pub peaks: Vec<LagPeak>,
    pub moves: bool,
    /// Whether it has the stamps of the joint states, so that its clock cannot have a skew against theirs.
    pub shares_clock: bool,
    pub last_turn: LastTurn,
}

impl DecodedStream<'_> {
    /// Whether rotations confirm the encoding fault, so joint faults need no test. Without rotations, no
    /// joint fault resembles an inverse.
    pub fn is_confirmed(&self) -> bool {
        let is_constant = self.constant.contains(&true);
        match &self.encoding {
            Ok(reading) if reading.best_rad <= MAX_ENCODING_RESIDUAL_RAD => {
                // An arm read from tip to base resembles an inverse between rotated frames.
                self.axes.is_some() || (self.is_inverted && self.rotated_frames < 2) || is_constant
            }
            Ok(_) => false,
            Err(_) => self.is_inverted,
        }
    }
}

pub(crate) fn decode_stream<'a>(
    read_as: &'a CorrectedJoints,
    stream: &PoseStream<'a>,
    placement: &PositionEncodingEstimate,
) -> EstimateResult<DecodedStream<'a>> {
    let joints = read_as.approximate_track();
    let PoseStream { track, chain, columns, reference_known, .. } = *stream;
    let peaks = placement.peaks.clone();
    let peak_s = peaks.first().map_or(0.0, |peak| peak.lag_s);
    let lag_s = if follows_as_logged(joints, stream) { 0.0 } else { peak_s };
    let (rows, fk) = slow_samples(joints, stream, lag_s);
    if rows.is_empty() {
        return Err(NotObservable::NoOverlap);
    }
    let spread_m = spread(fk.iter().map(|pose| pose.translation.vector));
    let turning: Vec<Rotation> = fk.iter().map(|pose| pose.rotation).collect();
    let interpretations = interpretations(placement, spread_m, reference_known);
    let first = interpretations[0];
    let (other, degrees) =
        in_other_angle_unit(track, &rows, &turning, reference_known, &first).unzip();
    let orientation = other.map_or(Cow::Borrowed(&track.orientation), Cow::Owned);
    let there = orientation.at_rows(&rows);
    let logged = LoggedRotations::from_orientations(&there);
    let turning = RotationSamples {
        are_quaternions: are_quaternions(track),
        only_as_logged: placement.rotations_as_logged,
        ..RotationSamples::new(logged, &turning, reference_known)
    };
    let unanchored = PositionInterpretation::unanchored(placement.metres());
    let (interpretation, encoding, fit) = match is_set(&there, turning.fk) {
        true => match turning.best_of(interpretations, unanchored) {
            Ok((interpretation, encoding, fit)) => (interpretation, Ok(encoding), Some(fit)),
            // Positions that match FK are used even without rotations.
            Err(why) if first.axes == AxesError::NONE && placement.most_likely().is_some() => {
                (first, Err(why), None)
            }
            Err(why) => return Err(why),
        },
        false => (first, Err(NotObservable::OrientationNotSet), None),
    };
    let mut observations = PoseObservations {
        gains: &read_as.gains,
        reference_known,
        xyz: interpretation.positions(&track.xyz),
        excluded: ExcludedComponents {
            position: standard_axes(placement.constant, &interpretation.axes),
            rotation: fit.is_none(),
        },
        moving_frame: stream.moving_frame,
        ..PoseObservations::new(
            &read_as.track,
            chain,
            columns,
            &read_as.rest_speeds,
            &track.t_s,
            &[],
        )
    };
    let logged = interpretation.rotations(LoggedRotations::from_orientations(&orientation));
    let fitted = fit.as_ref().map(|fit| (fit, logged));
    choose_branches(&mut observations, fitted, &interpretation, lag_s, &read_as.offsets);
    check_sample_count(observations.len(), 3)?;
    let moves = observations.moving_samples(lag_s, MAX_SEARCH_SAMPLES) >= MIN_MOVING_SAMPLES
        && !peaks.is_empty();
    let axes = Some(interpretation.axes).filter(|axes| *axes != AxesError::NONE);
    Ok(DecodedStream {
        last_turn: stream.last_turn,
        observations,
        encoding,
        degrees,
        metres: interpretation.metres,
        axes,
        is_inverted: interpretation.is_inverted,
        constant: placement.constant,
        rotated_frames: fit.map_or(0, |fit| fit.frames.frame_count()),
        peaks,
        moves,
        shares_clock: share_stamps(&joints.t_s, &track.t_s),
    })
}

/// Interpretations of the positions that match FK within the spread of its positions, or under which rotations are
/// tested. Never empty.
fn interpretations(
    placement: &PositionEncodingEstimate,
    spread_m: f64,
    reference_known: bool,
) -> Vec<PositionInterpretation> {
    let unanchored = PositionInterpretation::unanchored(placement.metres());
    let by_positions = placement.candidates.iter();
    let by_positions =
        by_positions.flat_map(|it| PositionInterpretation::from_encoding(it, spread_m));
    // Joint zeros can turn the frame that fits the positions of a small motion.
    let first = placement.candidates.first().filter(|_| reference_known);
    let declared = first.map(|&PositionEncoding { metres, .. }| PositionInterpretation {
        metres,
        reference: Some(Rotation::identity()),
        ..unanchored
    });
    // Several candidates may leave the reference free.
    let mut interpretations =
        distinct(by_positions.chain(declared), PositionInterpretation::has_rotations_of);
    match interpretations.first() {
        None => interpretations.push(unanchored),
        Some(first) if first.axes != AxesError::NONE => {
            let is_inverted = first.is_inverted;
            interpretations.push(PositionInterpretation { is_inverted, ..unanchored });
        }
        Some(_) => {}
    }
    interpretations
}

/// Axes in the standard convention that correspond to these logged ones.
fn standard_axes(logged: [bool; 3], axes: &AxesError) -> [bool; 3] {
    let mut standard = [false; 3];
    for axis in (0..3).filter(|&axis| logged[axis]) {
        standard[axes.positions.to_standard(Vec3::ith(axis, 1.0)).iamax()] = true;
    }
    standard
}

/// Whether nearly all stamps of the stream are stamps of the joint states.
fn share_stamps(joints_s: &[f64], stream_s: &[f64]) -> bool {
    const MIN_SHARE: f64 = 0.9;
    let is_common = |t_s: &&f64| {
        let at = joints_s.partition_point(|own| own < *t_s);
        joints_s.get(at) == Some(*t_s)
    };
    stream_s.iter().filter(is_common).count() as f64 > MIN_SHARE * stream_s.len() as f64
}

/// Whether orientations are set: they change, if only by noise, or FK's do not.
fn is_set(logged: &Orientations, fk: &[Rotation]) -> bool {
    /// Rounding.
    const MAX_CONSTANT_CHANGE_RAD: f64 = 1e-6;
    let is_logged = !matches!(logged, Orientations::Unset(_));
    is_logged && (turn_rad(logged) >= MAX_CONSTANT_CHANGE_RAD || max_angle(fk) <= MIN_TURN_RAD)
}

/// Largest turn from the first rotation, rad; of numbers, the largest change of one.
fn turn_rad(orientation: &Orientations) -> f64 {
    match orientation {
        Orientations::Rotations(all) => max_angle(all),
        Orientations::Numbers(all) => {
            let changes = all.iter().flat_map(|one| (0..3).map(|at| (one[at] - all[0][at]).abs()));
            changes.fold(0.0, f64::max)
        }
        Orientations::Unset(_) => 0.0,
    }
}

/// rad, from the first rotation.
pub(crate) fn max_angle(rotations: &[Rotation]) -> f64 {
    let from = rotations.first().copied().unwrap_or_default();
    rotations.iter().map(|one| angle_between(&from, one)).fold(0.0, f64::max)
}

/// Orientations in the other angle unit than the logged or declared one, if they match FK only then, with the residuals
/// in both.
fn in_other_angle_unit(
    track: &PoseTrack,
    rows: &[usize],
    fk: &[Rotation],
    reference_known: bool,
    interpretation: &PositionInterpretation,
) -> Option<(Orientations, UnitResiduals)> {
    let other = match (&track.orientation, &track.declared) {
        (Orientations::Numbers(numbers), _) => {
            Orientations::Numbers(numbers.iter().map(|n| n.map(f64::to_radians)).collect())
        }
        (_, Some(DeclaredUnits { in_other_angles: Some(rotations), .. })) => {
            Orientations::Rotations(rotations.clone())
        }
        _ => return None,
    };
    // A constant rotation is constant in any unit.
    let turns = |orientation: &Orientations| turn_rad(&orientation.at_rows(rows)) > MIN_TURN_RAD;
    if !turns(&track.orientation) && !turns(&other) {
        return None;
    }
    let residual = |orientation: &Orientations| {
        let there = orientation.at_rows(rows);
        let logged = interpretation.rotations(LoggedRotations::from_orientations(&there));
        let samples = RotationSamples {
            are_quaternions: are_quaternions(track),
            ..RotationSamples::new(logged, fk, reference_known)
        };
        estimate_encoding(&samples).map_or(std::f64::consts::PI, |(_, fit)| fit.residual_rad)
    };
    let as_logged = residual(&track.orientation);
    // No unit explains more.
    if as_logged <= MAX_RESIDUAL_DIFFERENCE_RAD {
        return None;
    }
    let corrected = residual(&other);
    (corrected * 3.0 < as_logged).then_some((other, UnitResiduals { as_logged, corrected }))
}

/// Whether the log has quaternions rather than three declared numbers.
fn are_quaternions(track: &PoseTrack) -> bool {
    track.declared.as_ref().is_none_or(|declared| declared.in_other_angles.is_none())
}

/// Chooses for each sample the branch nearest to FK. Drops samples without joint states. Without an
/// encoding, uses FK's rotations.
fn choose_branches(
    observations: &mut PoseObservations,
    fitted: Option<(&EncodingFit, LoggedRotations)>,
    interpretation: &PositionInterpretation,
    lag_s: f64,
    offsets: &[f64],
) {
    let state = StreamState::at_latency(lag_s);
    let mut predictor = observations.at(&state, offsets).predictor();
    let decode = |k: usize| {
        let fk = predictor.pose_at(k)?.rotation;
        let rotation = match &fitted {
            Some((fit, logged)) => {
                logged.nearest(fit.encoding, k, &(fit.reference * fk * fit.tool))?
            }
            None => interpretation.reference.unwrap_or_default() * fk,
        };
        Some((k, rotation))
    };
    let decoded: Vec<(usize, Rotation)> = (0..observations.len()).filter_map(decode).collect();
    let position = |&(k, rotation): &(usize, Rotation)| match interpretation.is_inverted {
        true => -(rotation * observations.xyz[k]),
        false => observations.xyz[k],
    };
    observations.xyz = decoded.iter().map(position).collect();
    observations.t_s = decoded.iter().map(|(k, _)| observations.t_s[*k]).collect();
    observations.rotation = decoded.into_iter().map(|(_, rotation)| rotation).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_shared_by_columns_of_one_table_only() {
        let joints_s: Vec<f64> = (0..100).map(|row| 0.008 * f64::from(row)).collect();
        let every_second: Vec<f64> = joints_s.iter().copied().step_by(2).collect();
        let other_clock: Vec<f64> = joints_s.iter().map(|t_s| 1.0001 * t_s + 0.003).collect();
        assert!(share_stamps(&joints_s, &joints_s));
        assert!(share_stamps(&joints_s, &every_second));
        assert!(!share_stamps(&every_second, &joints_s));
        assert!(!share_stamps(&joints_s, &other_clock));
    }
}
