//! How well another model would do, told from positions alone and without any search.

use super::PoseStream;
use super::placing::Expected;
use super::sampling::slow_samples;
use ground::geometry::Vec3;
use ground::stream::{JointTrack, Orientations};

/// How far the positions of `stream` are from where its chain puts them, rms m, with a constant tool
/// offset and a moved reference frame taken off; `None` where the joints cover too few samples.
///
/// `scale` takes positions to m, `latency_s` is the stream's; only slow samples count, so that it
/// need not be exact. A pose that was logged the wrong way round counts the right way.
pub fn position_misfit_m(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    latency_s: f64,
) -> Option<f64> {
    let (as_logged, inverted) = misfits_m(joints, stream, scale, latency_s)?;
    Some(as_logged.min(inverted))
}

/// Whether the positions of `stream` are rather of what stands still and is seen from the tool than of
/// the tool.
pub fn is_seen_from_tool(joints: &JointTrack, stream: &PoseStream, latency_s: f64) -> bool {
    let misfits = misfits_m(joints, stream, 1.0, latency_s);
    misfits.is_some_and(|(as_logged, inverted)| inverted < as_logged)
}

/// The misfit of a stream's positions, rms m, and that of the inverse poses'; infinite without rotations.
fn misfits_m(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    latency_s: f64,
) -> Option<(f64, f64)> {
    const ENOUGH: usize = 12;
    let PoseStream { track, chain, columns, .. } = *stream;
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, latency_s);
    if rows.len() < ENOUGH {
        return None;
    }
    let expected = Expected::of(&fk);
    let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row] * scale).collect();
    let as_logged = expected.misfit(&xyz);
    let Orientations::Rotations(rotations) = &track.orientation else {
        return Some((as_logged, f64::INFINITY));
    };
    let inverted = rows.iter().zip(&xyz).map(|(&row, p)| -(rotations[row].inverse() * p));
    Some((as_logged, expected.misfit(&inverted.collect::<Vec<_>>())))
}
