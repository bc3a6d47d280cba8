//! How well another model would do, told from positions alone and without any search.

use super::PoseStream;
use super::placing::Expected;
use super::prepare::slow_samples;
use crate::geometry::Vec3;
use crate::stream::{JointTrack, Orientations};

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
    const ENOUGH: usize = 12;
    let PoseStream { track, chain, columns, .. } = *stream;
    let (rows, fk) = slow_samples(joints, chain, columns, &track.t_s, latency_s);
    if rows.len() < ENOUGH {
        return None;
    }
    let expected = Expected::of(&fk);
    let xyz: Vec<Vec3> = rows.iter().map(|&row| track.xyz[row] * scale).collect();
    let as_logged = expected.misfit(&xyz);
    let Orientations::Rotations(rotations) = &track.orientation else { return Some(as_logged) };
    let inverted = rows.iter().zip(&xyz).map(|(&row, p)| -(rotations[row].inverse() * p));
    Some(as_logged.min(expected.misfit(&inverted.collect::<Vec<_>>())))
}
