//! A stream as it is to be read: its units, its rotations, and which of the rotations that a sample may
//! mean it does mean.

use super::arm::{FOLLOWS, SEARCH_SAMPLES};
use super::latency::{Peak, pose_peaks};
use super::model::{StreamState, Sweep, Witness};
use super::placing::{Expected, spread};
use super::reading::{Fit, Logged, Samples, nearest_truth, read};
use super::{PoseStream, Reading, ReadingEstimate, Seen, UnitSlip, Unseen};
use crate::geometry::{Pose, Rotation, Vec3};
use crate::robot::Chain;
use crate::stream::{DeclaredUnits, JointTrack, Orientations, PoseTrack};
use std::borrow::Cow;

/// Samples that readings are tried on.
const READING_SAMPLES: usize = 72;
/// Positions fit where they leave this share of the arm's extent.
const FITS: f64 = 0.01;
/// Moving samples without which a latency is not sought.
const MOVING_SAMPLES: usize = 10;

pub(super) fn as_rotations(orientation: &Orientations) -> Option<&[Rotation]> {
    match orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) => None,
    }
}

pub(super) fn stream_peaks(
    joints: &JointTrack,
    stream: &PoseStream,
    rotation: Option<&[Rotation]>,
    most_lag_s: f64,
) -> Vec<Peak> {
    let PoseStream { track, chain, columns, .. } = stream;
    pose_peaks(joints, chain, columns, &track.t_s, &track.xyz, rotation, most_lag_s)
}

/// The lag at which a stream follows the arm best by its speeds, s; 0 where none does.
pub(super) fn stream_lag_s(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> f64 {
    let rotation = as_rotations(&stream.track.orientation);
    let peaks = stream_peaks(joints, stream, rotation, most_lag_s);
    let best = peaks.first().filter(|peak| peak.correlation > FOLLOWS);
    best.map_or(0.0, |peak| peak.lag_s)
}

/// Factor that takes a stream's positions to metres: 1, or 0.001 where they are millimetres, or 1000
/// where the caller declared metres to be millimetres.
///
/// Extent of motion against the arm's tells, or at rest the distance from a known base.
pub(super) fn position_scale(joints: &JointTrack, stream: &PoseStream) -> Seen<f64> {
    let reach = stream.chain.max_reach_m();
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let track = stream.track;
    let step = track.t_s.len().div_ceil(500).max(1);
    let mut fk = Vec::new();
    let mut xyz = Vec::new();
    for k in (0..track.t_s.len()).step_by(step) {
        if joints.at(track.t_s[k], &mut cursor, &mut q, &mut qd) {
            let own: Vec<f64> = stream.columns.iter().map(|&c| q[c]).collect();
            fk.push(stream.chain.forward(&own).translation.vector);
            xyz.push(track.xyz[k]);
        }
    }
    if fk.len() < 2 {
        return Err(Unseen::NoOverlap);
    }
    let (moved, extent) = (spread(&fk), spread(&xyz));
    let ratio = if moved > 0.01 * reach {
        extent / moved
    } else {
        let norm =
            |points: &[Vec3]| points.iter().map(Vec3::norm).sum::<f64>() / points.len() as f64;
        if !stream.reference_known {
            return Err(Unseen::AtRest);
        }
        norm(&xyz) / norm(&fk).max(0.05 * reach)
    };
    let declared = track.declared.as_ref().is_some_and(|declared| declared.millimetres);
    let thousand = 80.0..12_500.0;
    Ok(match ratio {
        _ if thousand.contains(&ratio) => 1e-3,
        _ if declared && thousand.contains(&ratio.recip()) => 1e3,
        _ => 1.0,
    })
}

/// A stream whose reading is settled, with what settled it.
pub(super) struct Prepared<'a> {
    pub witness: Witness<'a>,
    pub reading: ReadingEstimate,
    pub degrees: Option<UnitSlip>,
    pub peaks: Vec<Peak>,
    pub moves: bool,
}

/// Settles reading and units of a stream and chooses the branch of each sample.
pub(super) fn prepare<'a>(
    joints: &'a JointTrack,
    stream: &PoseStream<'a>,
    scale: f64,
    still: &'a [f64],
    most_lag_s: f64,
) -> Seen<Prepared<'a>> {
    let PoseStream { track, chain, columns, reference_known, .. } = *stream;
    let xyz: Vec<Vec3> = track.xyz.iter().map(|p| p * scale).collect();
    let peaks: Vec<Peak> =
        stream_peaks(joints, stream, as_rotations(&track.orientation), most_lag_s)
            .into_iter()
            .filter(|peak| peak.correlation > FOLLOWS)
            .collect();
    let lag_s = peaks.first().map_or(0.0, |peak| peak.lag_s);
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, lag_s);
    if rows.is_empty() {
        return Err(Unseen::NoOverlap);
    }
    let expected = Expected::of(&fk);
    let xyz_there: Vec<Vec3> = rows.iter().map(|&k| xyz[k]).collect();
    let (orientation, degrees) = in_right_angles(track, &rows, &expected.rotation, reference_known);
    let logged_all = Logged::of(&orientation);
    let there = at_rows(&orientation, &rows);
    let logged = Logged::of(&there);
    let inverted_xyz: Option<Vec<Vec3>> = match &logged {
        Logged::Rotations(all) => {
            Some(all.iter().zip(&xyz_there).map(|(r, p)| -(r.inverse() * p)).collect())
        }
        Logged::Numbers(_) => None,
    };
    // Positions tell the reference frame whatever the rotations are read as.
    let plain = expected.misfit(&xyz_there);
    let inverted = inverted_xyz.as_ref().map_or(f64::INFINITY, |xyz| expected.misfit(xyz));
    // A pose that turns about one axis lies on the arm both ways: what fits as it is stays.
    let fits = plain < FITS * spread(&expected.xyz);
    let is_inverted = !fits && inverted < plain;
    let lies = if is_inverted { inverted_xyz.as_ref() } else { Some(&xyz_there) };
    let reference = lies.and_then(|xyz| expected.reference(xyz)).map(|pose| pose.rotation);
    let turned: Vec<Rotation> = match reference {
        Some(reference) => expected.rotation.iter().map(|fk| reference * fk).collect(),
        None => expected.rotation.clone(),
    };
    let samples = Samples {
        logged,
        fk: &turned,
        reference_free: reference.is_none(),
        reference_known: reference_known || reference.is_some(),
        are_quaternions: are_quaternions(track),
    };
    let (mut reading, mut fit) = read(&samples)?;
    fit.reference *= reference.unwrap_or_default();
    if matches!(fit.reading, Reading::Transposed) && is_inverted && inverted * 2.0 < plain {
        fit.reading = Reading::Inverted;
        reading.best = Reading::Inverted;
    }

    let mut witness = Witness {
        joints,
        chain,
        columns,
        reference_known,
        still,
        t_s: track.t_s.clone(),
        xyz,
        rotation: Vec::new(),
        middle_s: 0.5 * (track.t_s[0] + track.t_s[track.t_s.len() - 1]),
    };
    choose_branches(&mut witness, &logged_all, &fit, lag_s);
    if witness.len() < 3 {
        return Err(Unseen::TooFewSamples { have: witness.len(), need: 3 });
    }
    let moves = witness.moving(lag_s, SEARCH_SAMPLES) >= MOVING_SAMPLES && !peaks.is_empty();
    Ok(Prepared { witness, reading, degrees, peaks, moves })
}

/// A stream's orientations with their angles in the unit that follows the arm, and the slip where
/// that is not the one logged or declared.
fn in_right_angles<'a>(
    track: &'a PoseTrack,
    rows: &[usize],
    fk: &[Rotation],
    reference_known: bool,
) -> (Cow<'a, Orientations>, Option<UnitSlip>) {
    let other = match (&track.orientation, &track.declared) {
        (Orientations::Numbers(numbers), _) => {
            Orientations::Numbers(numbers.iter().map(|n| n.map(f64::to_radians)).collect())
        }
        (_, Some(DeclaredUnits { in_other_angles: Some(rotations), .. })) => {
            Orientations::Rotations(rotations.clone())
        }
        _ => return (Cow::Borrowed(&track.orientation), None),
    };
    let residual = |orientation: &Orientations| {
        let there = at_rows(orientation, rows);
        let logged = Logged::of(&there);
        let are_quaternions = are_quaternions(track);
        let samples =
            Samples { logged, fk, reference_free: true, reference_known, are_quaternions };
        read(&samples).map_or(std::f64::consts::PI, |(_, fit)| fit.residual_rad)
    };
    let (as_logged, corrected) = (residual(&track.orientation), residual(&other));
    if corrected * 3.0 < as_logged {
        (Cow::Owned(other), Some(UnitSlip { as_logged, corrected }))
    } else {
        (Cow::Borrowed(&track.orientation), None)
    }
}

/// Whether the log has quaternions, and not three numbers that were declared to be a rotation.
fn are_quaternions(track: &PoseTrack) -> bool {
    track.declared.as_ref().is_none_or(|declared| declared.in_other_angles.is_none())
}

fn at_rows(orientation: &Orientations, rows: &[usize]) -> Orientations {
    match orientation {
        Orientations::Rotations(all) => {
            Orientations::Rotations(rows.iter().map(|&k| all[k]).collect())
        }
        Orientations::Numbers(all) => Orientations::Numbers(rows.iter().map(|&k| all[k]).collect()),
    }
}

/// Slow samples spread over the run, and FK at the moments that they speak of.
pub(super) fn slow_samples(
    joints: &JointTrack,
    chain: &Chain,
    columns: &[usize],
    t_s: &[f64],
    lag_s: f64,
) -> (Vec<usize>, Vec<Pose>) {
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let mut covered: Vec<(usize, f64)> = Vec::new();
    for (k, t) in t_s.iter().enumerate() {
        if joints.at(t - lag_s, &mut cursor, &mut q, &mut qd) {
            covered.push((k, qd.iter().map(|v| v * v).sum()));
        }
    }
    let mut slowest = covered;
    let kept = slowest.len().div_ceil(2);
    slowest.sort_by(|a, b| a.1.total_cmp(&b.1));
    slowest.truncate(kept);
    let mut rows: Vec<usize> = slowest.iter().map(|(k, _)| *k).collect();
    rows.sort_unstable();
    let step = rows.len().div_ceil(READING_SAMPLES).max(1);
    let rows: Vec<usize> = rows.into_iter().step_by(step).collect();
    cursor = 0;
    let fk = rows
        .iter()
        .map(|&k| {
            joints.at(t_s[k] - lag_s, &mut cursor, &mut q, &mut qd);
            let own: Vec<f64> = columns.iter().map(|&c| q[c]).collect();
            chain.forward(&own)
        })
        .collect();
    (rows, fk)
}

/// Applies the reading to every sample, taking the branch nearest to what FK expects; samples that
/// the joints do not cover are dropped.
fn choose_branches(witness: &mut Witness, logged: &Logged, fit: &Fit, lag_s: f64) {
    let (mut kept_t, mut kept_xyz, mut kept_rotation) = (Vec::new(), Vec::new(), Vec::new());
    let mut sweep = Sweep::new(witness);
    let mut buffer = Vec::new();
    let offsets = vec![0.0; witness.joints.dof];
    let state = StreamState::at_latency(lag_s);
    for k in 0..witness.len() {
        let Some(fk) = witness.pose_at(k, &state, &offsets, &mut sweep) else {
            continue;
        };
        let expected = fit.reference * fk.rotation * fit.tool;
        let Some(rotation) = nearest_truth(&fit.reading, logged, k, &expected, &mut buffer) else {
            continue;
        };
        kept_t.push(witness.t_s[k]);
        kept_xyz.push(match fit.reading {
            Reading::Inverted => -(rotation * witness.xyz[k]),
            _ => witness.xyz[k],
        });
        kept_rotation.push(rotation);
    }
    (witness.t_s, witness.xyz, witness.rotation) = (kept_t, kept_xyz, kept_rotation);
}

/// Joint speeds that are no motion: five times the noise of the velocities, at least 0.2 mrad/s.
///
/// Noise by the median magnitude of second differences, which smooth motion hardly has.
pub(super) fn still_speeds(joints: &JointTrack) -> Vec<f64> {
    /// A median of more is no better.
    const ENOUGH: usize = 20_000;
    let stride = joints.len().div_ceil(ENOUGH).max(1);
    let speed = |row: usize, joint: usize| joints.qd[row * joints.dof + joint];
    (0..joints.dof)
        .map(|j| {
            let middles = (1..joints.len().saturating_sub(1)).step_by(stride);
            let mut bends: Vec<f64> = middles
                .map(|k| (speed(k - 1, j) - 2.0 * speed(k, j) + speed(k + 1, j)).abs())
                .collect();
            if bends.is_empty() {
                return f64::INFINITY;
            }
            let middle = bends.len() / 2;
            let median = *bends.select_nth_unstable_by(middle, f64::total_cmp).1;
            (5.0 * 1.4826 * median / 6f64.sqrt()).max(2e-4)
        })
        .collect()
}
