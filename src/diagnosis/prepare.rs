//! A stream as it is to be read: its units, its rotations, and which of the rotations that a sample may
//! mean it does mean.

use super::arm::{FOLLOWS, SEARCH_SAMPLES};
use super::joints::Read;
use super::latency::{ArmSpeeds, Peak};
use super::layout::{Layout, Written, layouts, matrix_of};
use super::model::{Blind, StreamState, Sweep, ToolPart, Witness};
use super::placing::{ON_ARM, spread};
use super::reading::{After, Fit, Logged, Samples, fit_known, nearest_truth, read};
use super::{AxesSlip, PoseStream, Reading, ReadingEstimate, Seen, UnitSlip, Unseen};
use crate::geometry::{
    Axes, Convention, LengthScale, Pose, QuaternionSlip, Rotation, Vec3, angle_between,
};
use crate::robot::Chain;
use crate::stream::{DeclaredUnits, JointTrack, Orientations, PoseTrack};
use nalgebra::Matrix3;
use std::borrow::Cow;

/// Samples that readings are tried on.
const READING_SAMPLES: usize = 72;
/// Rotations are read rightly that leave no more than this, rad: joints may be off by some degrees.
const FITS_RAD: f64 = 0.05;
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

/// How a stream's positions are written, as far as they tell by themselves.
pub(super) struct Placement {
    /// What takes them to metres, whatever else is wrong.
    pub metres: Seen<f64>,
    /// How they are written, the likeliest first; empty where they tell nothing.
    layouts: Vec<Layout>,
    /// Which coordinates never change though FK's do.
    pub constant: [bool; 3],
    /// The lags at which the stream follows the arm.
    peaks: Vec<Peak>,
    /// Speed of the arm's tip at its fastest, m/s.
    pub top_speed_m_s: f64,
}

impl Placement {
    /// How the positions of `stream` are written against FK of `joints`.
    pub fn of(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Self {
        /// Positions that leave this share of the motion's extent are settled.
        const SETTLED: f64 = 0.02;
        let PoseStream { track, chain, columns, reference_known, .. } = *stream;
        let arm = ArmSpeeds::of(joints, chain, columns);
        let mut peaks = stream_peaks(&arm, stream, most_lag_s);
        peaks.retain(|peak| peak.correlation > FOLLOWS);
        let read_as_m = in_metres(track);
        let reach_m = chain.max_reach_m();
        let mut placement = Self {
            metres: Err(Unseen::NoOverlap),
            layouts: Vec::new(),
            constant: [false; 3],
            peaks,
            top_speed_m_s: arm.top_m_s(),
        };
        let near = if lies_as_logged(joints, stream) { 0 } else { 2 };
        let lags = placement.peaks.iter().take(near).map(|peak| peak.lag_s).chain([0.0]);
        let mut least_m = f64::INFINITY;
        for lag_s in lags.collect::<Vec<f64>>() {
            let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, lag_s);
            if rows.len() < 2 {
                continue;
            }
            let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row]).collect();
            let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
            let sized = by_size(&at, &xyz, reach_m, read_as_m, reference_known);
            if let Ok(metres) = sized
                && metres != 1.0
                && lies_there(&xyz, metres, &at, SETTLED)
            {
                // In that unit they are where FK is, and no frame is needed to say otherwise.
                placement.metres = Ok(metres);
                (placement.layouts, placement.constant) = (Vec::new(), [false; 3]);
                return placement;
            }
            let constant = constant(&track.xyz, &at);
            let left_out = match constant {
                [false, false, false] => Some(None),
                [true, false, false] => Some(Some(0)),
                [false, true, false] => Some(Some(1)),
                [false, false, true] => Some(Some(2)),
                _ => None,
            };
            let layouts = left_out.map_or_else(Vec::new, |constant| {
                let written = Written { xyz: &xyz, constant, read_as_m, reference_known };
                layouts(&fk, reach_m, &written)
            });
            let left_m = layouts.first().map_or(f64::MAX, |layout| layout.left_m);
            if left_m < least_m {
                least_m = left_m;
                placement.metres = sized;
                (placement.layouts, placement.constant) = (layouts, constant);
            }
            if least_m < SETTLED * spread(&at) {
                break;
            }
        }
        if let Some(metres) = placement.told().map(|layout| layout.metres) {
            placement.metres = Ok(metres);
        }
        placement
    }

    /// What takes the positions to metres; 1 where nothing tells.
    pub fn metres(&self) -> f64 {
        *self.metres.as_ref().unwrap_or(&1.0)
    }

    /// The likeliest layout where it leaves little.
    fn told(&self) -> Option<&Layout> {
        self.layouts.first().filter(|layout| layout.is_explained)
    }

    /// Whether the positions lie on the arm.
    fn is_on_arm(&self) -> bool {
        self.told().is_some()
    }

    /// Whether the positions lie on the arm once they are read otherwise than as logged.
    pub fn explains(&self) -> bool {
        let is_constant = self.constant.contains(&true);
        self.told().is_some_and(|layout| is_constant || layout.inverted || layout.is_mirrored())
    }
}

/// Which coordinates of a stream never change but for noise, where others do and those of FK all do.
fn constant(xyz: &[Vec3], fk: &[Vec3]) -> [bool; 3] {
    /// A coordinate is constant that spreads by less than this share of the widest …
    const STAYS: f64 = 0.01;
    /// … where FK's spread by this share of their widest at least, and by this, m.
    const MOVES: f64 = 0.05;
    const MOVES_M: f64 = 5e-3;
    /// Positions that spread by less than this share of their size are one: the rest is rounding.
    const ROUNDING: f64 = 1e-9;
    let spreads = |points: &[Vec3]| -> [f64; 3] {
        [0, 1, 2].map(|axis| {
            let along: Vec<Vec3> = points.iter().map(|p| Vec3::x() * p[axis]).collect();
            spread(&along)
        })
    };
    let widest = |spreads: [f64; 3]| spreads.into_iter().fold(0.0, f64::max);
    let (logged, expected) = (spreads(xyz), spreads(fk));
    let least = MOVES_M.max(MOVES * widest(expected));
    let all_move = expected.into_iter().all(|spread| spread > least);
    let size = xyz.iter().map(Vec3::amax).fold(0.0, f64::max);
    let some_move = widest(logged) > ROUNDING * size;
    logged.map(|spread| all_move && some_move && spread <= STAYS * widest(logged))
}

/// What takes positions to metres by their size alone: the extent of motion against FK's, or at rest the
/// distance from a known base.
pub(super) fn by_size(
    fk: &[Vec3],
    xyz: &[Vec3],
    reach_m: f64,
    read_as_m: f64,
    reference_known: bool,
) -> Seen<f64> {
    /// Sizes within this factor of a unit's are its own.
    const ALIKE: f64 = 1.5;
    let (moved, extent) = (spread(fk), spread(xyz));
    let rests = moved <= 0.01 * reach_m;
    let ratio = if !rests {
        extent / moved
    } else if reference_known {
        let norm =
            |points: &[Vec3]| points.iter().map(Vec3::norm).sum::<f64>() / points.len() as f64;
        norm(xyz) / norm(fk).max(0.05 * reach_m)
    } else {
        return Err(Unseen::AtRest);
    };
    let off = |factor: f64| (ratio * factor).ln().abs();
    let usual = LengthScale::usual().map(|unit| unit.in_m() / read_as_m);
    let near = usual.filter(|factor| off(*factor) < ALIKE.ln());
    let nearest = near.min_by(|a, b| off(*a).total_cmp(&off(*b)));
    // Within an arm's own reach nothing is told by size.
    Ok(if (0.2..5.0).contains(&ratio) { 1.0 } else { nearest.unwrap_or(1.0) })
}

/// What takes a stream's positions to metres by their size alone; 1 where nothing tells.
pub(super) fn metres_by_size(joints: &JointTrack, stream: &PoseStream) -> f64 {
    let PoseStream { track, chain, columns, reference_known, .. } = *stream;
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, 0.0);
    let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row]).collect();
    let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
    if at.len() < 2 {
        return 1.0;
    }
    let read_as_m = in_metres(track);
    by_size(&at, &xyz, chain.max_reach_m(), read_as_m, reference_known).unwrap_or(1.0)
}

/// The usual unit in which the positions' extent is most like the arm's reach, as a factor to metres,
/// whatever the joint states say.
pub(super) fn metres_by_reach(stream: &PoseStream) -> f64 {
    /// An arm's tip spreads by about so much of its reach.
    const SHARE: f64 = 0.3;
    let track = stream.track;
    let extent = spread(&track.xyz).max(f64::MIN_POSITIVE);
    let off = |factor: f64| (extent * factor / (SHARE * stream.chain.max_reach_m())).ln().abs();
    let usual = LengthScale::usual().map(|unit| unit.in_m() / in_metres(track));
    usual.chain([1.0]).min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(1.0)
}

/// How many metres a number of a stream is as it was read.
fn in_metres(track: &PoseTrack) -> f64 {
    match &track.declared {
        Some(declared) if declared.millimetres => 1e-3,
        _ => 1.0,
    }
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

/// One way to take a stream's poses to the base, before the rotations' numbers are read.
struct Way {
    metres: f64,
    axes: AxesSlip,
    inverted: bool,
    /// How the reference frame is turned, where positions tell.
    reference: Option<Rotation>,
}

impl Way {
    /// The ways to understand a layout; what it leaves is not much of the motion's `extent_m`.
    fn of(layout: &Layout, extent_m: f64) -> Vec<Self> {
        let standard = AxesSlip { positions: Axes::STANDARD, rotations: Axes::STANDARD };
        let way = |axes, reference| {
            let Layout { metres, inverted, .. } = *layout;
            // Positions of inverse poses are in the tool's frame: they do not tell how the base's is turned.
            Way { metres, axes, inverted, reference: if inverted { None } else { reference } }
        };
        if layout.left_m > ON_ARM * extent_m {
            return vec![way(standard, None)];
        }
        let both = |axes| AxesSlip { positions: axes, rotations: axes };
        let positions = |axes| AxesSlip { positions: axes, ..standard };
        match (layout.axes, layout.is_mirrored()) {
            (Some(axes), true) => {
                vec![
                    way(both(axes), Some(Rotation::identity())),
                    way(positions(axes), Some(Rotation::identity())),
                ]
            }
            (None, true) => {
                // In a world that is turned at will all mirrors are one: the most usual is named.
                let back = matrix_of(Axes::UNITY).transpose();
                let turn = rotation_of(&(back * layout.turn));
                vec![way(both(Axes::UNITY), Some(turn)), way(positions(Axes::UNITY), None)]
            }
            (Some(axes), false) if axes.are_exchanged() && !layout.inverted => vec![
                way(standard, Some(rotation_of(&layout.turn))),
                way(both(axes), Some(Rotation::identity())),
                way(positions(axes), Some(Rotation::identity())),
            ],
            (_, false) => vec![way(standard, Some(rotation_of(&layout.turn)))],
        }
    }

    /// Another one in which rotations alone are in axes of their own.
    fn with_rotations_in(&self, rotations: Axes) -> Self {
        Way { axes: AxesSlip { rotations, ..self.axes }, ..*self }
    }

    fn after(&self) -> After {
        let axes = self.axes.rotations;
        let conjugator = (axes != Axes::STANDARD).then(|| axes.conjugator());
        After { conjugator, inverted: self.inverted }
    }

    /// Positions of poses that are not yet turned round, m.
    fn positions(&self, xyz: &[Vec3]) -> Vec<Vec3> {
        xyz.iter().map(|p| self.axes.positions.standard(*p) * self.metres).collect()
    }
}

fn rotation_of(matrix: &Matrix3<f64>) -> Rotation {
    Rotation::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(*matrix))
}

/// Orientations at some samples, and FK there.
struct Turning<'a> {
    logged: Logged<'a>,
    fk: &'a [Rotation],
    reference_known: bool,
    are_quaternions: bool,
}

impl Turning<'_> {
    /// What the rotations are read as on one way, with the turned reference in the fit.
    fn read(&self, way: &Way) -> Seen<(ReadingEstimate, Fit)> {
        let turned = self.turned(way);
        let (mut reading, mut fit) = read(&self.samples(way, &turned))?;
        fit.reference *= way.reference.unwrap_or_default();
        if way.axes != AxesSlip::NONE {
            reading.as_logged_rad = self.as_logged_rad();
        }
        Ok((reading, fit))
    }

    /// What the simplest readings leave on one way, rad.
    fn plain_rad(&self, way: &Way) -> f64 {
        let turned = self.turned(way);
        let samples = self.samples(way, &turned);
        let simple = [Reading::AsLogged, Reading::Transposed]
            .into_iter()
            .chain(QuaternionSlip::BOTH.map(Reading::QuaternionOrder));
        let numbers = || Convention::all().iter().map(|&one| Reading::Numbers(one));
        let readings: Vec<Reading> = match self.logged {
            Logged::Rotations(_) => simple.collect(),
            Logged::Numbers(_) => numbers().collect(),
        };
        let fits = readings.into_iter().filter_map(|reading| fit_known(&samples, reading));
        fits.map(|fit| fit.residual_rad).fold(f64::INFINITY, f64::min)
    }

    fn turned(&self, way: &Way) -> Vec<Rotation> {
        let reference = way.reference.unwrap_or_default();
        self.fk.iter().map(|fk| reference * fk).collect()
    }

    fn samples<'s>(&'s self, way: &Way, turned: &'s [Rotation]) -> Samples<'s> {
        Samples {
            logged: self.logged,
            fk: turned,
            reference_free: way.reference.is_none(),
            reference_known: self.reference_known || way.reference.is_some(),
            are_quaternions: self.are_quaternions,
            after: way.after(),
        }
    }

    /// Angle to FK of rotations as logged, rms rad.
    fn as_logged_rad(&self) -> Option<f64> {
        let Logged::Rotations(logged) = self.logged else { return None };
        let squares = logged.iter().zip(self.fk).map(|(a, b)| angle_between(a, b).powi(2));
        Some((squares.sum::<f64>() / logged.len().max(1) as f64).sqrt())
    }

    /// The way on which rotations can be read best, with their reading.
    fn best(&self, ways: Vec<Way>) -> Seen<(Way, ReadingEstimate, Fit)> {
        /// Rotations alone are in other axes only where that leaves so many times less.
        const BETTER: f64 = 5.0;
        let mut best: Option<(Way, ReadingEstimate, Fit)> = None;
        let mut why = Unseen::NoOrientation;
        // Where positions tell the frame and are in its axes, rotations may still be in others.
        let is_told = |way: &&Way| way.reference.is_some() && way.axes == AxesSlip::NONE;
        let told = ways.iter().find(is_told).map(|way| Way { ..*way });
        for way in ways {
            let (reading, fit) = match self.read(&way) {
                Ok(found) => found,
                Err(unseen) => {
                    why = unseen;
                    continue;
                }
            };
            // Reversed joints may mirror positions, but not so that rotations fit.
            if way.axes != AxesSlip::NONE && fit.residual_rad > FITS_RAD {
                continue;
            }
            let order = |fit: &Fit| match fit.residual_rad <= FITS_RAD {
                true => (0, f64::from(fit.frames.count())),
                false => (1, fit.residual_rad),
            };
            let is_done = order(&fit) == (0, 0.0);
            if best.as_ref().is_none_or(|(_, _, known)| order(&fit) < order(known)) {
                best = Some((way, reading, fit));
            }
            if is_done {
                break;
            }
        }
        let left = best.as_ref().map_or(f64::INFINITY, |(_, _, fit)| fit.residual_rad);
        let Some(told) = told.filter(|_| left > FITS_RAD) else { return best.ok_or(why) };
        let right_handed = Axes::all().iter().filter(|axes| !axes.are_left_handed());
        let turned = right_handed.map(|&axes| told.with_rotations_in(axes));
        let turned = turned.map(|way| (self.plain_rad(&way), way));
        let turned = turned.min_by(|a, b| a.0.total_cmp(&b.0));
        let better = turned.filter(|(rad, _)| *rad <= FITS_RAD && rad * BETTER < left);
        match better.and_then(|(_, way)| Some((self.read(&way).ok()?, way))) {
            Some(((reading, fit), way)) => Ok((way, reading, fit)),
            None => best.ok_or(why),
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

/// Whether positions of so many metres a number are where FK is, but for this share of its extent, rms.
fn lies_there(xyz: &[Vec3], metres: f64, fk: &[Vec3], share: f64) -> bool {
    let squares = xyz.iter().zip(fk).map(|(xyz, fk)| (xyz * metres - fk).norm_squared());
    let rms_m = (squares.sum::<f64>() / fk.len().max(1) as f64).sqrt();
    rms_m < share * spread(fk)
}

/// Whether a stream lies on the arm as it is and when it says so: then no lag that its speeds feign in a
/// short or even motion calls for another reading.
fn lies_as_logged(joints: &JointTrack, stream: &PoseStream) -> bool {
    /// It lies on the arm within this share of FK's extent.
    const LIES: f64 = 0.02;
    let PoseStream { track, chain, columns, .. } = *stream;
    let Some(rotations) = as_rotations(&track.orientation) else { return false };
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, 0.0);
    let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
    let most_m = LIES * spread(&at);
    let is_there = |(&row, fk): (&usize, &Pose)| {
        (track.xyz[row] - fk.translation.vector).norm() <= most_m
            && angle_between(&rotations[row], &fk.rotation) <= FITS_RAD
    };
    !rows.is_empty() && rows.iter().zip(&fk).all(is_there)
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
            if bends.is_empty() {
                return f64::INFINITY;
            }
            let middle = bends.len() / 2;
            let median = *bends.select_nth_unstable_by(middle, f64::total_cmp).1;
            (5.0 * 1.4826 * median / 6f64.sqrt()).max(2e-4)
        })
        .collect()
}
