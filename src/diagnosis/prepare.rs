//! A stream as it is to be read: its units, its rotations, and which of the rotations that a sample may
//! mean it does mean.

use super::arm::{FOLLOWS, SEARCH_SAMPLES};
use super::joints::Read;
use super::latency::{ArmSpeeds, Peak};
use super::model::{Blind, StreamState, Sweep, ToolPart, Witness};
use super::placement::{Placement, lies_as_logged};
use super::placing::spread;
use super::reading::{After, Fit, Logged, Samples, nearest_truth, read};
use super::turning::{FITS_RAD, Turning, Way};
use super::{AxesSlip, PoseStream, ReadingEstimate, Seen, UnitSlip, Unseen};
use crate::geometry::{Pose, Rotation, Vec3, angle_between};
use crate::robot::Chain;
use crate::stats::{NORMAL, median};
use crate::stream::{DeclaredUnits, JointTrack, Orientations, PoseTrack};
use std::borrow::Cow;

/// Samples that readings are tried on.
const READING_SAMPLES: usize = 72;
/// Moving samples without which a latency is not sought.
const MOVING_SAMPLES: usize = 10;

pub(super) fn as_rotations(orientation: &Orientations) -> Option<&[Rotation]> {
    match orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) | Orientations::Unset(_) => None,
    }
}

/// The lags at which a stream may follow the arm by its speeds, the likeliest first.
pub(super) fn stream_peaks(arm: &ArmSpeeds, stream: &PoseStream, most_lag_s: f64) -> Vec<Peak> {
    let PoseTrack { t_s, xyz, orientation, .. } = stream.track;
    arm.peaks_of(t_s, xyz, as_rotations(orientation), most_lag_s)
}

/// The lag at which a stream follows the arm best by its speeds, s; 0 where none does.
pub(super) fn stream_lag_s(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> f64 {
    let arm = ArmSpeeds::of(joints, stream.chain, stream.columns);
    let peaks = stream_peaks(&arm, stream, most_lag_s);
    let best = peaks.first().filter(|peak| peak.correlation > FOLLOWS);
    best.map_or(0.0, |peak| peak.lag_s)
}

/// A stream whose reading is settled, with what settled it.
pub(super) struct Prepared<'a> {
    pub witness: Witness<'a>,
    /// How the rotations are read, where they are any.
    pub reading: Seen<ReadingEstimate>,
    pub degrees: Option<UnitSlip>,
    pub metres: f64,
    /// The axes that positions and rotations are in, where they are not the standard ones.
    pub axes: Option<AxesSlip>,
    /// Whether the poses are inverted as a whole.
    pub inverted: bool,
    /// Which coordinates never change.
    pub constant: [bool; 3],
    /// How many frames must be turned for the rotations to be so.
    frames: u8,
    pub peaks: Vec<Peak>,
    pub moves: bool,
}

impl Prepared<'_> {
    /// Whether rotations confirm that the poses are written otherwise than they should be, so that no
    /// fault of the joint states need be sought. Where rotations say nothing no joint feigns an inverse.
    pub fn is_confirmed(&self) -> bool {
        let is_constant = self.constant.contains(&true);
        match &self.reading {
            Ok(reading) if reading.best_rad <= FITS_RAD => {
                // An arm that is read from its tip to its base moves much as an inverse between turned
                // frames does.
                self.axes.is_some() || (self.inverted && self.frames < 2) || is_constant
            }
            Ok(_) => false,
            Err(_) => self.inverted,
        }
    }
}

/// Settles reading and units of a stream and chooses the branch of each sample.
pub(super) fn prepare<'a>(
    read_as: &'a Read,
    stream: &PoseStream<'a>,
    placement: &Placement,
) -> Seen<Prepared<'a>> {
    let joints = read_as.near();
    let PoseStream { track, chain, columns, reference_known, .. } = *stream;
    let peaks = placement.peaks.clone();
    let peak_s = peaks.first().map_or(0.0, |peak| peak.lag_s);
    let lag_s = if lies_as_logged(joints, stream) { 0.0 } else { peak_s };
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, lag_s);
    if rows.is_empty() {
        return Err(Unseen::NoOverlap);
    }
    let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
    let turning: Vec<Rotation> = fk.iter().map(|pose| pose.rotation).collect();
    let metres = placement.metres();
    let mut ways: Vec<Way> =
        placement.layouts.iter().flat_map(|layout| Way::of(layout, spread(&at))).collect();
    if ways.is_empty() {
        ways.push(Way { metres, axes: AxesSlip::NONE, inverted: false, reference: None });
    }
    let first = Way { ..ways[0] };
    if first.axes != AxesSlip::NONE {
        let axes = AxesSlip::NONE;
        ways.push(Way { metres, axes, inverted: first.inverted, reference: None });
    }
    let (orientation, degrees) =
        in_right_angles(track, &rows, &turning, reference_known, first.after());
    let there = at_rows(&orientation, &rows);
    let turning = Turning {
        logged: Logged::of(&there),
        fk: &turning,
        reference_known,
        are_quaternions: are_quaternions(track),
    };
    let (way, reading, fit) = match is_set(&there, turning.fk) {
        true => match turning.best(ways) {
            Ok((way, reading, fit)) => (way, Ok(reading), Some(fit)),
            // Positions that lie on the arm say what there is to say.
            Err(why) if first.axes == AxesSlip::NONE && placement.is_on_arm() => {
                (first, Err(why), None)
            }
            Err(why) => return Err(why),
        },
        false => (first, Err(Unseen::OrientationNotSet), None),
    };
    let constant_axes = {
        let mut blind = [false; 3];
        for axis in (0..3).filter(|&axis| placement.constant[axis]) {
            blind[way.axes.positions.standard(Vec3::ith(axis, 1.0)).iamax()] = true;
        }
        blind
    };
    let mut witness = Witness {
        joints: &read_as.track,
        chain,
        columns,
        gained: &read_as.gained,
        reference_known,
        still: &read_as.still,
        t_s: track.t_s.clone(),
        xyz: way.positions(&track.xyz),
        rotation: Vec::new(),
        blind: Blind { position: constant_axes, rotation: fit.is_none() },
        tool_part: match fit {
            None => ToolPart::Point,
            Some(_) if !reference_known && !turns(turning.fk) => ToolPart::Turn,
            Some(_) => ToolPart::Whole,
        },
        middle_s: 0.5 * (track.t_s[0] + track.t_s[track.t_s.len() - 1]),
    };
    let logged = Logged::of(&orientation);
    choose_branches(&mut witness, &logged, &way, fit.as_ref(), lag_s, &read_as.offsets);
    if witness.len() < 3 {
        return Err(Unseen::TooFewSamples { have: witness.len(), need: 3 });
    }
    let moves = witness.moving(lag_s, SEARCH_SAMPLES) >= MOVING_SAMPLES && !peaks.is_empty();
    let axes = Some(way.axes).filter(|axes| *axes != AxesSlip::NONE);
    let Way { metres, inverted, .. } = way;
    let constant = placement.constant;
    let frames = fit.map_or(0, |fit| fit.frames.count());
    Ok(Prepared {
        witness,
        reading,
        degrees,
        metres,
        axes,
        inverted,
        constant,
        frames,
        peaks,
        moves,
    })
}

/// Whether orientations are any: not where they stay as they are while FK's turn.
fn is_set(logged: &Orientations, fk: &[Rotation]) -> bool {
    /// Orientations that stay within this are one, rad.
    const STAYS_RAD: f64 = 1e-3;
    let stays = match logged {
        Orientations::Rotations(all) => farthest(all) < STAYS_RAD,
        Orientations::Numbers(all) => all.windows(2).all(|pair| pair[0] == pair[1]),
        Orientations::Unset(_) => return false,
    };
    !stays || !turns(fk)
}

/// Whether rotations turn by more than joints that are a little off may feign.
fn turns(rotations: &[Rotation]) -> bool {
    const TURNS_RAD: f64 = 0.2;
    farthest(rotations) > TURNS_RAD
}

/// The largest angle to the first of some rotations, rad.
fn farthest(rotations: &[Rotation]) -> f64 {
    let from = rotations.first().copied().unwrap_or_default();
    rotations.iter().map(|one| angle_between(&from, one)).fold(0.0, f64::max)
}

/// A stream's orientations with their angles in the unit that follows the arm, and the slip where
/// that is not the one logged or declared.
fn in_right_angles<'a>(
    track: &'a PoseTrack,
    rows: &[usize],
    fk: &[Rotation],
    reference_known: bool,
    after: After,
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
            Samples { logged, fk, reference_free: true, reference_known, are_quaternions, after };
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
        Orientations::Unset(_) => Orientations::Unset(rows.len()),
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
/// the joints do not cover are dropped. Without a reading, rotations are what FK expects.
fn choose_branches(
    witness: &mut Witness,
    logged: &Logged,
    way: &Way,
    fit: Option<&Fit>,
    lag_s: f64,
    offsets: &[f64],
) {
    let (mut kept_t, mut kept_xyz, mut kept_rotation) = (Vec::new(), Vec::new(), Vec::new());
    let mut sweep = Sweep::new(witness);
    let mut buffer = Vec::new();
    let state = StreamState::at_latency(lag_s);
    let after = way.after();
    for k in 0..witness.len() {
        let Some(fk) = witness.pose_at(k, &state, offsets, &mut sweep) else {
            continue;
        };
        let rotation = match fit {
            Some(Fit { reading, reference, tool, .. }) => {
                let expected = reference * fk.rotation * tool;
                nearest_truth(reading, &after, logged, k, &expected, &mut buffer)
            }
            None => Some(way.reference.unwrap_or_default() * fk.rotation),
        };
        let Some(rotation) = rotation else { continue };
        kept_t.push(witness.t_s[k]);
        kept_xyz.push(match way.inverted {
            true => -(rotation * witness.xyz[k]),
            false => witness.xyz[k],
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
            let Some(median) = median(&mut bends) else { return f64::INFINITY };
            (5.0 * NORMAL * median / 6f64.sqrt()).max(2e-4)
        })
        .collect()
}
