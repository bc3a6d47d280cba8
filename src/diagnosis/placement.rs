//! How a stream's positions are written, as far as they tell by themselves: unit, axes, what is constant, and
//! at which lags they follow the arm.

use super::frames::misfit_of_frames;
use super::latency::{ArmSpeeds, Peak};
use super::layout::{Layout, Written, layouts, may_spread_so};
use super::placing::spread;
use super::sampling::{FOLLOWS, as_rotations, slow_samples, stream_peaks};
use super::turning::FITS_RAD;
use super::{PoseStream, Seen, Unseen};
use ground::geometry::{LengthScale, Pose, Vec3, angle_between};
use ground::stream::{JointTrack, PoseTrack};

/// How a stream's positions are written, as far as they tell by themselves.
pub(super) struct Placement {
    /// What takes them to metres, whatever else is wrong.
    pub metres: Seen<f64>,
    /// How they are written, the likeliest first; empty where they tell nothing.
    pub layouts: Vec<Layout>,
    /// Which coordinates never change though FK's do.
    pub constant: [bool; 3],
    /// The lags at which the stream follows the arm.
    pub peaks: Vec<Peak>,
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
        let read_as_m = in_metres_of(track);
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
            let by_poses = match reference_known {
                true => None,
                false => unit_by_poses(track, &rows, &fk),
            };
            if let Some(metres) = by_poses.filter(|metres| *metres != 1.0) {
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
            let mut layouts = left_out.map_or_else(Vec::new, |constant| {
                let written = Written { xyz: &xyz, constant, read_as_m, reference_known };
                layouts(&fk, reach_m, &written)
            });
            if by_poses.is_some() {
                layouts.retain(|layout| layout.metres == 1.0);
            }
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

    /// The same without a mirror, an inverse or another unit.
    pub fn sound(&self) -> Self {
        let layouts = self.layouts.iter().filter(|layout| layout.is_sound()).cloned().collect();
        Self {
            metres: Ok(1.0),
            layouts,
            constant: self.constant,
            peaks: self.peaks.clone(),
            top_speed_m_s: self.top_speed_m_s,
        }
    }

    /// Whether the positions lie on the arm.
    pub fn is_on_arm(&self) -> bool {
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
    let read_as_m = in_metres_of(track);
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
    let usual = LengthScale::usual().map(|unit| unit.in_m() / in_metres_of(track));
    usual.chain([1.0]).min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(1.0)
}

/// The usual unit in which a constant world and marker explain the poses at `rows`: metres, or one that does
/// so clearly better. Rotations tell how the world is turned where positions alone do not.
fn unit_by_poses(track: &PoseTrack, rows: &[usize], fk: &[Pose]) -> Option<f64> {
    /// The unit leaves this share of the positions' own spread or less, and so many times less than metres.
    const EXPLAINS: f64 = 0.1;
    const BETTER: f64 = 5.0;
    let rotations = as_rotations(&track.orientation)?;
    let extent = spread(&track.xyz);
    let share_left = |metres: f64| {
        let scaled =
            |&row: &usize| Pose::from_parts((track.xyz[row] * metres).into(), rotations[row]);
        let logged: Vec<Pose> = rows.iter().map(scaled).collect();
        misfit_of_frames(fk, &logged)[0] / (metres * extent)
    };
    let in_metres = share_left(1.0);
    if in_metres <= EXPLAINS {
        return Some(1.0);
    }
    let at: Vec<Vec3> = fk.iter().map(|pose| pose.translation.vector).collect();
    if may_spread_so(extent, spread(&at)) {
        return None;
    }
    let usual = LengthScale::usual().map(|unit| unit.in_m() / in_metres_of(track));
    let shares = usual.map(|metres| (share_left(metres), metres));
    let (least, metres) = shares.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (metres != 1.0 && least <= EXPLAINS && BETTER * least <= in_metres).then_some(metres)
}

/// How many metres a number of a stream is as it was read.
fn in_metres_of(track: &PoseTrack) -> f64 {
    track.declared.as_ref().map_or(1.0, |declared| declared.length.in_m())
}

/// Whether positions of so many metres a number are where FK is, but for this share of its extent, rms.
fn lies_there(xyz: &[Vec3], metres: f64, fk: &[Vec3], share: f64) -> bool {
    let squares = xyz.iter().zip(fk).map(|(xyz, fk)| (xyz * metres - fk).norm_squared());
    let rms_m = (squares.sum::<f64>() / fk.len().max(1) as f64).sqrt();
    rms_m < share * spread(fk)
}

/// Whether a stream lies on the arm as it is and when it says so: then no lag that its speeds feign in a
/// short or even motion calls for another reading.
pub(super) fn lies_as_logged(joints: &JointTrack, stream: &PoseStream) -> bool {
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
