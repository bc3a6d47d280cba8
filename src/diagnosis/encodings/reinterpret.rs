//! Decodes streams with a declared encoding; FK resolves ambiguous rotations.

use super::rotation::{LoggedRotations, RotationSamples, fit_known};
use crate::latency::correlation::stream_lag_s;
use crate::samples::sampling::FkSequence;
use crate::{AxesError, PoseEncoding, PoseStream};
use ground::geometry::Rotation;
use ground::stats::thin::thinned;
use ground::stream::{JointTrack, Orientations, PoseTrack};

/// For the constant frames.
const MAX_FIT_SAMPLES: usize = 150;

/// Intended encoding of a stream.
#[derive(Clone, Copy, Debug)]
pub struct IntendedEncoding {
    /// Rotation encoding.
    pub encoding: PoseEncoding,
    /// Position and rotation axes.
    pub axes: AxesError,
    /// Whether whole poses are inverted.
    pub is_inverted: bool,
}

/// Decodes a stream as `intended`, each sample on the branch nearest to FK of `joints` after fitting constant
/// frames on top of `known`, `[stream_from_reference, tip_from_stream]`. `None` for bare numbers, or
/// without overlap in time.
pub fn reinterpret_poses(
    joints: &JointTrack,
    stream: &PoseStream,
    intended: IntendedEncoding,
    known: [Rotation; 2],
    max_lag_s: f64,
) -> Option<PoseTrack> {
    let PoseStream { track, chain, columns, reference_known, .. } = *stream;
    let Orientations::Rotations(logged) = &track.orientation else { return None };
    let lag_s = stream_lag_s(joints, stream, max_lag_s);
    let fk = FkSequence::new(joints, chain, columns);
    let truth_s = track.t_s.iter().map(|stamp_s| stamp_s - lag_s);
    let candidates = decode_rotations(logged, &intended, fk, truth_s, known, reference_known)?;
    let is_inverted = intended.is_inverted || matches!(intended.encoding, PoseEncoding::Inverted);
    let xyz = candidates.iter().zip(&track.xyz).map(|(rotation, xyz)| {
        let xyz = intended.axes.positions.to_standard(*xyz);
        if is_inverted { -(rotation * xyz) } else { xyz }
    });
    let xyz = xyz.collect();
    Some(PoseTrack { xyz, orientation: Orientations::Rotations(candidates), ..track.clone() })
}

/// Decodes `logged` as `intended`, nearest to `fk` at these times up to constant frames on top of `known`. Samples without
/// FK follow the previous one.
pub(crate) fn decode_rotations(
    logged: &[Rotation],
    intended: &IntendedEncoding,
    mut fk: FkSequence,
    truth_s: impl Iterator<Item = f64>,
    [reference, tool]: [Rotation; 2],
    reference_known: bool,
) -> Option<Vec<Rotation>> {
    let expected = truth_s.map(|truth_s| Some(reference * fk.at(truth_s)?.rotation * tool));
    let expected: Vec<Option<Rotation>> = expected.collect();
    let known = expected.iter().enumerate().filter_map(|(row, fk)| Some((row, (*fk)?)));
    let known: Vec<(usize, Rotation)> = known.collect();
    let (rows, fk): (Vec<usize>, Vec<Rotation>) = thinned(known, MAX_FIT_SAMPLES).unzip();
    let there: Vec<Rotation> = rows.iter().map(|&row| logged[row]).collect();
    if there.is_empty() {
        return None;
    }
    let [there, logged] = [&there, logged].map(|rotations| {
        LoggedRotations::new(rotations).with_axes(intended.axes.rotations, intended.is_inverted)
    });
    let samples = RotationSamples::new(there, &fk, reference_known);
    let fit = fit_known(&samples, intended.encoding)?;
    let mut last = fit.reference * fk[0] * fit.tool;
    let decode = |(row, fk): (usize, &Option<Rotation>)| {
        let expected = fk.map_or(last, |fk| fit.reference * fk * fit.tool);
        last = logged.nearest(intended.encoding, row, &expected)?;
        Some(last)
    };
    expected.iter().enumerate().map(decode).collect()
}
