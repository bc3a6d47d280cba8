//! Whether joint states carry the names and units that they claim.
//!
//! Positions of a pose stream depend on no rotation convention, so they judge the joint states
//! before anything else is known: each unit and each pairing of names is held against them, leaving
//! a constant tool offset or a turned reference frame free.

use super::latency::{joint_activity, linear_speed, peaks};
use super::reading::wahba;
use super::{JointReading, PoseStream, Seen, UnitSlip, Unseen};
use crate::geometry::{Rotation, Vec3};
use crate::robot::{Chain, JointKind};
use crate::stream::JointTrack;
use nalgebra::Matrix3;

/// Samples that the pairings are tried on.
const SAMPLES: usize = 40;
/// Most joints whose pairings are all tried (7! = 5040).
const MOST_JOINTS: usize = 7;
/// Another reading must be better than the one as logged by this factor.
const BETTER: f64 = 5.0;
/// Residual below which the joint states are not questioned, as a share of the motion's extent.
const FINE: f64 = 0.05;
/// Residual below which positions lie on the arm, as a share of their extent.
const ON_ARM: f64 = 0.3;

/// Positions of a stream and the joint rows at the same moments.
struct Moments {
    xyz: Vec<Vec3>,
    /// Row-major, in the chain's order.
    q: Vec<f64>,
}

/// Judges names and units of the joint states by the stream with the most samples.
///
/// # Errors
/// There is no stream that shares a time span with the joints.
pub(super) fn read_joints(
    joints: &JointTrack,
    streams: &[PoseStream],
    scales: &[f64],
    most_lag_s: f64,
) -> Seen<JointReading> {
    let (stream, scale) = streams
        .iter()
        .zip(scales)
        .max_by_key(|(stream, _)| (stream.columns.len(), stream.track.t_s.len()))
        .ok_or(Unseen::NoOverlap)?;
    let moments = moments(joints, stream, *scale, most_lag_s);
    let have = moments.xyz.len();
    if have < 6 {
        return Err(Unseen::TooFewSamples { have, need: 6 });
    }
    let chain = stream.chain;
    let extent = spread(&moments.xyz);
    let as_logged = misfit(chain, &moments);
    let named = JointReading { degrees: None, permutation: None, runner_up_m: None };
    if as_logged <= FINE * extent.max(0.01) {
        return Ok(named);
    }
    let degrees = in_radians(chain, &moments);
    let corrected = misfit(chain, &degrees);
    if corrected * BETTER < as_logged && corrected < 0.5 * extent.max(0.1) {
        let slip = UnitSlip { as_logged, corrected };
        return Ok(JointReading { degrees: Some(slip), ..named });
    }
    if chain.dof() > MOST_JOINTS || extent < 0.01 {
        return Ok(named);
    }
    let (order, corrected, runner_up) = best_pairing(chain, &moments);
    if corrected * BETTER < as_logged && corrected * 2.0 < runner_up {
        let mut permutation: Vec<usize> = (0..joints.dof).collect();
        for (own, &really) in order.iter().enumerate() {
            permutation[stream.columns[own]] = stream.columns[really];
        }
        let slip = UnitSlip { as_logged, corrected };
        return Ok(JointReading {
            permutation: Some((permutation, slip)),
            runner_up_m: Some(runner_up),
            ..named
        });
    }
    Ok(named)
}

/// The joint track as it should have been recorded.
pub(super) fn corrected(
    joints: &JointTrack,
    reading: &JointReading,
    prismatic: &[bool],
) -> JointTrack {
    let mut track = joints.clone();
    if reading.degrees.is_some() {
        let dof = track.dof;
        for values in [&mut track.q, &mut track.qd] {
            for (i, value) in values.iter_mut().enumerate() {
                if !prismatic[i % dof] {
                    *value = value.to_radians();
                }
            }
        }
    }
    if let Some((permutation, _)) = &reading.permutation {
        for (to, from) in [(&mut track.q, &joints.q), (&mut track.qd, &joints.qd)] {
            for (row, source) in to.chunks_exact_mut(joints.dof).zip(from.chunks_exact(joints.dof))
            {
                for (named, &really) in permutation.iter().enumerate() {
                    row[really] = source[named];
                }
            }
        }
    }
    track
}

/// Whether a stream's positions lie on the arm at latency `lag_s`, up to a tool offset or a turned
/// reference frame.
pub(super) fn lies_on_arm(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    lag_s: f64,
) -> bool {
    let moments = slow_moments(joints, stream, scale, lag_s);
    moments.xyz.len() >= 6 && misfit(stream.chain, &moments) < ON_ARM * spread(&moments.xyz)
}

/// Slow moments spread over the run, so that what is left of the latency hardly matters.
fn moments(joints: &JointTrack, stream: &PoseStream, scale: f64, most_lag_s: f64) -> Moments {
    let track = stream.track;
    let activity = joint_activity(joints);
    let lag_s = peaks(&activity, &linear_speed(&track.t_s, &track.xyz), most_lag_s)
        .first()
        .filter(|peak| peak.correlation > 0.5)
        .map_or(0.0, |peak| peak.lag_s);
    slow_moments(joints, stream, scale, lag_s)
}

/// Slow moments at a latency, spread over the run.
fn slow_moments(joints: &JointTrack, stream: &PoseStream, scale: f64, lag_s: f64) -> Moments {
    let track = stream.track;
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let mut covered: Vec<(usize, f64, Vec<f64>)> = Vec::new();
    for (k, t_s) in track.t_s.iter().enumerate() {
        if joints.at(t_s - lag_s, &mut cursor, &mut q, &mut qd) {
            let speed = qd.iter().map(|v| v * v).sum();
            covered.push((k, speed, stream.columns.iter().map(|&c| q[c]).collect()));
        }
    }
    let mut by_speed: Vec<usize> = (0..covered.len()).collect();
    by_speed.sort_by(|&a, &b| covered[a].1.total_cmp(&covered[b].1));
    by_speed.truncate(covered.len().div_ceil(2));
    by_speed.sort_unstable();
    let step = by_speed.len().div_ceil(SAMPLES).max(1);
    let mut moments = Moments { xyz: Vec::new(), q: Vec::new() };
    for &i in by_speed.iter().step_by(step) {
        moments.xyz.push(track.xyz[covered[i].0] * scale);
        moments.q.extend_from_slice(&covered[i].2);
    }
    moments
}

fn in_radians(chain: &Chain, moments: &Moments) -> Moments {
    let kinds = chain.joint_kinds();
    let convert = |(i, q): (usize, &f64)| {
        if kinds[i % kinds.len()] == JointKind::Prismatic { *q } else { q.to_radians() }
    };
    Moments { xyz: moments.xyz.clone(), q: moments.q.iter().enumerate().map(convert).collect() }
}

/// Root mean square distance of points from their mean.
pub(super) fn spread(points: &[Vec3]) -> f64 {
    let mean = points.iter().sum::<Vec3>() / points.len().max(1) as f64;
    let squares: f64 = points.iter().map(|p| (p - mean).norm_squared()).sum();
    (squares / points.len().max(1) as f64).sqrt()
}

/// What is left of the positions, rms m, with the better of a constant tool offset and a turned and
/// shifted reference frame taken off.
fn misfit(chain: &Chain, moments: &Moments) -> f64 {
    let poses: Vec<_> = moments.q.chunks_exact(chain.dof()).map(|q| chain.forward(q)).collect();
    let fk: Vec<Vec3> = poses.iter().map(|pose| pose.translation.vector).collect();
    let rotation: Vec<Rotation> = poses.iter().map(|pose| pose.rotation).collect();
    tool_misfit(&moments.xyz, &fk, &rotation).min(reference_misfit(&moments.xyz, &fk))
}

/// Rms of `xyz − fk − R·t` at the best constant `t`.
pub(super) fn tool_misfit(xyz: &[Vec3], fk: &[Vec3], rotation: &[Rotation]) -> f64 {
    let n = xyz.len().max(1) as f64;
    let in_tool = |i: usize| rotation[i].inverse() * (xyz[i] - fk[i]);
    let tool = (0..xyz.len()).map(in_tool).sum::<Vec3>() / n;
    let squares: f64 = (0..xyz.len()).map(|i| (in_tool(i) - tool).norm_squared()).sum();
    (squares / n).sqrt()
}

/// Rms of `xyz − B·fk` at the best rigid `B` (Kabsch 1976).
fn reference_misfit(xyz: &[Vec3], fk: &[Vec3]) -> f64 {
    let n = xyz.len().max(1) as f64;
    let (centre, fk_centre) = (xyz.iter().sum::<Vec3>() / n, fk.iter().sum::<Vec3>() / n);
    let mut correlation = Matrix3::zeros();
    for (p, f) in xyz.iter().zip(fk) {
        correlation += (p - centre) * (f - fk_centre).transpose();
    }
    let turn = wahba(&correlation);
    let left = |(p, f): (&Vec3, &Vec3)| (p - centre - turn * (f - fk_centre)).norm_squared();
    (xyz.iter().zip(fk).map(left).sum::<f64>() / n).sqrt()
}

/// The pairing of names and positions with the least misfit, and the least of all others.
fn best_pairing(chain: &Chain, moments: &Moments) -> (Vec<usize>, f64, f64) {
    let n = chain.dof();
    let (mut best, mut runner_up): ((Vec<usize>, f64), f64) =
        ((Vec::new(), f64::INFINITY), f64::INFINITY);
    let mut paired = Moments { xyz: moments.xyz.clone(), q: moments.q.clone() };
    let mut order: Vec<usize> = (0..n).collect();
    permutations(&mut order, 0, &mut |order| {
        for (row, source) in paired.q.chunks_exact_mut(n).zip(moments.q.chunks_exact(n)) {
            for (named, &really) in order.iter().enumerate() {
                row[really] = source[named];
            }
        }
        let misfit = misfit(chain, &paired);
        if misfit < best.1 {
            runner_up = best.1;
            best = (order.to_vec(), misfit);
        } else {
            runner_up = runner_up.min(misfit);
        }
    });
    (best.0, best.1, runner_up)
}

fn permutations(order: &mut [usize], from: usize, visit: &mut dyn FnMut(&[usize])) {
    if from == order.len() {
        return visit(order);
    }
    for i in from..order.len() {
        order.swap(from, i);
        permutations(order, from + 1, visit);
        order.swap(from, i);
    }
}
