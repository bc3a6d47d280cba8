//! Fits competing models to the positions of a stream, without a search over causes.

use crate::PoseStream;
use crate::frames::position_fit::PositionFit;
use crate::samples::sampling::{as_rotations, slow_samples};
use ground::geometry::{Pose, Vec3};
use ground::stream::JointTrack;

pub(super) const MIN_SAMPLES: usize = 12;

/// Rms distance of `stream` from FK after fitting a tool offset and a reference frame, m. `None` if the
/// joint states cover too few samples.
///
/// `scale` converts positions to m. `latency_s` may be approximate, because only slow samples are used.
/// Inverse poses are tried as well.
pub fn position_misfit_m(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    latency_s: f64,
) -> Option<f64> {
    let (as_logged, inverted) = misfits_m(joints, stream, scale, latency_s)?;
    Some(as_logged.min(inverted))
}

/// Whether the positions fit better as a fixed object seen from the tool than as the tool.
pub fn is_seen_from_tool(joints: &JointTrack, stream: &PoseStream, latency_s: f64) -> bool {
    let misfits = misfits_m(joints, stream, 1.0, latency_s);
    misfits.is_some_and(|(as_logged, inverted)| inverted < as_logged)
}

/// Misfit of positions as logged and of inverse poses, rms m. The second is infinite without rotations.
fn misfits_m(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    latency_s: f64,
) -> Option<(f64, f64)> {
    let SlowPositions { xyz, inverse_xyz, fk, .. } =
        SlowPositions::new(joints, stream, scale, latency_s)?;
    let misfit = |xyz: Vec<Vec3>| PositionFit { fk: &fk, xyz: &xyz }.misfit();
    Some((misfit(xyz), inverse_xyz.map_or(f64::INFINITY, misfit)))
}

/// Positions of a stream while the arm moves slowly, with FK.
#[derive(Clone)]
pub(super) struct SlowPositions {
    pub t_s: Vec<f64>,
    /// In m.
    pub xyz: Vec<Vec3>,
    /// Positions of the inverse poses. `None` without rotations.
    pub inverse_xyz: Option<Vec<Vec3>>,
    pub fk: Vec<Pose>,
}

impl SlowPositions {
    /// `None` if the joint states cover too few samples.
    pub fn new(
        joints: &JointTrack,
        stream: &PoseStream,
        scale: f64,
        latency_s: f64,
    ) -> Option<Self> {
        let track = stream.track;
        let (rows, fk) = slow_samples(joints, stream, latency_s);
        let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row] * scale).collect();
        let inverse_xyz = as_rotations(&track.orientation).map(|all| {
            let inverse = rows.iter().zip(&xyz).map(|(&row, p)| -(all[row].inverse() * p));
            inverse.collect()
        });
        let t_s = rows.iter().map(|&row| track.t_s[row]).collect();
        (rows.len() >= MIN_SAMPLES).then_some(Self { t_s, xyz, inverse_xyz, fk })
    }
}
