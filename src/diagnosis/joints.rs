//! Whether joint states carry the names and units that they claim.
//!
//! Positions of a pose stream depend on no rotation convention, so they judge the joint states
//! before anything else is known: each unit and each pairing of names is held against them, leaving
//! a constant tool offset or a turned reference frame free.

use super::latency::{joint_activity, linear_speed, peaks};
use super::placing::{Expected, spread};
use super::{JointReading, PoseStream, Seen, UnitSlip, Unseen};
use crate::geometry::{Pose, Vec3};
use crate::robot::{Chain, JointKind};
use crate::stream::{JointTrack, Orientations};

/// Samples that the pairings are tried on.
const SAMPLES: usize = 40;
/// Most joints whose pairings are all tried (7! = 5040).
const MOST_JOINTS: usize = 7;
/// Another reading must be better than the one as logged by this factor.
const BETTER: f64 = 5.0;
/// Residual below which the joint states are not questioned, as a share of the motion's extent.
const FINE: f64 = 0.05;
/// The same where the reference frame had to be turned: an arm whose joints are read from tip to
/// base moves much like the inverse of one whose frames are turned.
const FINE_TURNED: f64 = 0.005;
/// Residual below which positions lie on the arm, as a share of their extent.
pub(super) const ON_ARM: f64 = 0.3;

/// A tip whose positions spread by less rests, m.
const AT_REST_M: f64 = 2e-3;
/// A resting tip is where the joint states say, up to this share of the arm's reach.
const THERE: f64 = 0.03;

/// Positions of a stream and the joint rows at the same moments.
#[derive(Clone)]
struct Moments {
    xyz: Vec<Vec3>,
    /// Positions of the inverse poses, where the stream has rotations.
    inverse_xyz: Option<Vec<Vec3>>,
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
    let chain = stream.chain;
    let mut best = Candidate::default();
    for lag_s in lags(joints, stream, most_lag_s) {
        let moments = slow_moments(joints, stream, *scale, lag_s);
        let have = moments.xyz.len();
        if have < 6 {
            return Err(Unseen::TooFewSamples { have, need: 6 });
        }
        if rests(chain, &moments) {
            return read_at_rest(chain, &moments, stream.reference_known);
        }
        if spread(&moments.xyz) < AT_REST_M {
            // The joints move and the stream does not: it tells nothing of their names and units.
            return Err(Unseen::NotExcited);
        }
        let extent = spread(&moments.xyz).max(0.01);
        let as_logged = misfit(chain, &moments);
        if as_logged <= FINE_TURNED * extent || unturned_misfit(chain, &moments) <= FINE * extent {
            return Ok(JointReading { degrees: None, permutation: None, runner_up_m: None });
        }
        best.consider(chain, &moments, as_logged);
    }
    let as_logged = best.as_logged;
    let slip = UnitSlip { as_logged, corrected: best.corrected };
    let certain = slip.corrected * BETTER < as_logged;
    let degrees = (certain && best.degrees).then_some(slip);
    let permutation =
        best.order.filter(|_| certain && slip.corrected * 2.0 < best.runner_up).map(|order| {
            let mut permutation: Vec<usize> = (0..joints.dof).collect();
            for (own, &really) in order.iter().enumerate() {
                permutation[stream.columns[own]] = stream.columns[really];
            }
            (permutation, slip)
        });
    if degrees.is_none() && permutation.is_none() && as_logged > ON_ARM * best.extent {
        // Not as logged, and no one other reading stands out.
        return Err(Unseen::NotExcited);
    }
    let runner_up_m = permutation.as_ref().map(|_| best.runner_up);
    Ok(JointReading { degrees, permutation, runner_up_m })
}

/// Whether neither the stream nor FK moves the tip, whatever unit the joints are in.
fn rests(chain: &Chain, moments: &Moments) -> bool {
    let radians = in_radians(chain, moments);
    let fk = |moments: &Moments| -> Vec<Vec3> {
        let rows = moments.q.chunks_exact(chain.dof());
        rows.map(|q| chain.forward(q).translation.vector).collect()
    };
    [&moments.xyz, &fk(moments), &fk(&radians)].into_iter().all(|xyz| spread(xyz) < AT_REST_M)
}

/// Judges names and units at rest: a tip that is where the joint states put it speaks for them, as no
/// frame needs to be anything but what its name says. One that is elsewhere tells nothing.
fn read_at_rest(chain: &Chain, moments: &Moments, reference_known: bool) -> Seen<JointReading> {
    let off = |moments: &Moments| -> f64 {
        let rows = moments.q.chunks_exact(chain.dof()).zip(&moments.xyz);
        let squares =
            rows.map(|(q, xyz)| (chain.forward(q).translation.vector - xyz).norm_squared());
        (squares.sum::<f64>() / moments.xyz.len().max(1) as f64).sqrt()
    };
    let (as_logged, corrected) = (off(moments), off(&in_radians(chain, moments)));
    let is_there = |off: f64, other: f64| off < THERE * chain.max_reach_m() && off * BETTER < other;
    let degrees = match reference_known {
        true if is_there(as_logged, corrected) => None,
        true if is_there(corrected, as_logged) => Some(UnitSlip { as_logged, corrected }),
        _ => return Err(Unseen::AtRest),
    };
    Ok(JointReading { degrees, permutation: None, runner_up_m: None })
}

/// The best reading of the joint states so far.
struct Candidate {
    as_logged: f64,
    corrected: f64,
    degrees: bool,
    /// The order of the positions, where it is not that of the names.
    order: Option<Vec<usize>>,
    /// Least misfit of any other order.
    runner_up: f64,
    /// Spread of the positions, m.
    extent: f64,
}

impl Default for Candidate {
    fn default() -> Self {
        let worst = f64::INFINITY;
        Self {
            as_logged: worst,
            corrected: worst,
            degrees: false,
            order: None,
            runner_up: worst,
            extent: worst,
        }
    }
}

impl Candidate {
    /// Tries both units, and where neither will do every order of the names, at some moments.
    fn consider(&mut self, chain: &Chain, moments: &Moments, as_logged: f64) {
        self.as_logged = self.as_logged.min(as_logged);
        let extent = spread(&moments.xyz).max(0.01);
        self.extent = self.extent.min(extent);
        let radians = in_radians(chain, moments);
        let corrected = misfit(chain, &radians);
        if corrected < self.corrected {
            let runner_up = f64::INFINITY;
            *self = Self { corrected, degrees: true, order: None, runner_up, ..*self };
        }
        if corrected <= FINE * extent || chain.dof() > MOST_JOINTS {
            return;
        }
        for (degrees, moments) in [(false, moments), (true, &radians)] {
            let (order, corrected, runner_up) = best_pairing(chain, moments);
            if corrected < self.corrected {
                let named = order.iter().enumerate().all(|(named, &really)| named == really);
                let order = (!named).then_some(order);
                *self = Self { corrected, degrees, order, runner_up, ..*self };
            }
        }
    }
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
        let named = track.clone();
        for (to, from) in [(&mut track.q, &named.q), (&mut track.qd, &named.qd)] {
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

/// Latencies at which the stream moves as the joints do, and none: what is left of the latency
/// hardly matters at slow moments, but a wrong one does.
fn lags(joints: &JointTrack, stream: &PoseStream, most_lag_s: f64) -> Vec<f64> {
    let track = stream.track;
    let activity = joint_activity(joints);
    let peaks = peaks(&activity, &linear_speed(&track.t_s, &track.xyz), most_lag_s);
    let near = peaks.iter().filter(|peak| peak.correlation > 0.4).take(2).map(|peak| peak.lag_s);
    std::iter::once(0.0).chain(near.filter(|lag_s| lag_s.abs() > 0.01)).collect()
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
    let rotations = match &track.orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) | Orientations::Unset(_) => None,
    };
    let inverse_xyz = rotations.map(|_| Vec::new());
    let mut moments = Moments { xyz: Vec::new(), inverse_xyz, q: Vec::new() };
    for &i in by_speed.iter().step_by(step) {
        let k = covered[i].0;
        let xyz = track.xyz[k] * scale;
        moments.xyz.push(xyz);
        if let (Some(inverse_xyz), Some(rotations)) = (&mut moments.inverse_xyz, rotations) {
            inverse_xyz.push(-(rotations[k].inverse() * xyz));
        }
        moments.q.extend_from_slice(&covered[i].2);
    }
    moments
}

fn in_radians(chain: &Chain, moments: &Moments) -> Moments {
    let kinds = chain.joint_kinds();
    let convert = |(i, q): (usize, &f64)| {
        if kinds[i % kinds.len()] == JointKind::Prismatic { *q } else { q.to_radians() }
    };
    Moments { q: moments.q.iter().enumerate().map(convert).collect(), ..moments.clone() }
}

/// What is left of the positions, rms m, when a constant tool offset is taken off.
fn unturned_misfit(chain: &Chain, moments: &Moments) -> f64 {
    let poses: Vec<Pose> = moments.q.chunks_exact(chain.dof()).map(|q| chain.forward(q)).collect();
    let expected = Expected::of(&poses);
    let plain = expected.tool_misfit(&moments.xyz);
    moments.inverse_xyz.as_ref().map_or(plain, |xyz| plain.min(expected.tool_misfit(xyz)))
}

/// What is left of the positions, rms m, when constant frames are taken off.
fn misfit(chain: &Chain, moments: &Moments) -> f64 {
    let poses: Vec<Pose> = moments.q.chunks_exact(chain.dof()).map(|q| chain.forward(q)).collect();
    let expected = Expected::of(&poses);
    let plain = expected.misfit(&moments.xyz);
    // An inverted stream's positions lie on the arm once they are inverted.
    moments.inverse_xyz.as_ref().map_or(plain, |inverse| plain.min(expected.misfit(inverse)))
}

/// The pairing of names and positions with the least misfit, and the least of all others.
fn best_pairing(chain: &Chain, moments: &Moments) -> (Vec<usize>, f64, f64) {
    let n = chain.dof();
    let (mut best, mut runner_up): ((Vec<usize>, f64), f64) =
        ((Vec::new(), f64::INFINITY), f64::INFINITY);
    let mut paired = moments.clone();
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
