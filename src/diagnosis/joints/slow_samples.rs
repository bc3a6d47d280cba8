//! Slow samples used to determine the encoding of the joints.

use crate::PoseStream;
use ground::geometry::{Rotation, Vec3};
use ground::robot::{Chain, JointKind};
use ground::stream::{JointTrack, Orientations};

pub(super) const JOINT_ENCODING_SAMPLES: usize = 60;

#[derive(Clone)]
pub(super) struct SimultaneousSamples {
    pub xyz: Vec<Vec3>,
    /// Rotations, if decoded.
    pub rotation: Option<Vec<Rotation>>,
    /// Positions of the inverse poses, if there are rotations.
    pub inverse_xyz: Option<Vec<Vec3>>,
    /// Row-major, in chain order.
    pub q: Vec<f64>,
}

/// Divides each joint's velocity by its rms.
pub(super) fn normalize_velocities(joints: &JointTrack) -> JointTrack {
    let mut evened = joints.clone();
    let rms = rms_speeds(joints);
    for row in evened.qd.chunks_exact_mut(joints.dof.max(1)) {
        row.iter_mut().zip(&rms).for_each(|(speed, rms)| *speed /= rms);
    }
    evened
}

/// Bounded below to allow division.
pub(super) fn rms_speeds(joints: &JointTrack) -> Vec<f64> {
    let square = |joint: usize| {
        joints.qd.iter().skip(joint).step_by(joints.dof).map(|speed| speed * speed).sum::<f64>()
    };
    let rms = |joint: usize| (square(joint) / joints.len().max(1) as f64).sqrt().max(1e-4);
    (0..joints.dof).map(rms).collect()
}

/// Spread over the run: half by time and half by path, so that an arm that dwells in one place is seen elsewhere,
/// too. From each stretch the slowest sample, and of these the slower half.
pub(super) fn slow_simultaneous_samples(
    joints: &JointTrack,
    stream: &PoseStream,
    scale: f64,
    lag_s: f64,
) -> SimultaneousSamples {
    let track = stream.track;
    let (mut cursor, mut q, mut qd) = (0, vec![0.0; joints.dof], vec![0.0; joints.dof]);
    let rms = rms_speeds(joints);
    let mut covered: Vec<(usize, f64, Vec<f64>)> = Vec::new();
    for (k, t_s) in track.t_s.iter().enumerate() {
        if joints.at(t_s - lag_s, &mut cursor, &mut q, &mut qd) {
            let speed =
                qd.iter().zip(&rms).map(|(speed, rms)| (speed / rms).powi(2)).sum::<f64>().sqrt();
            covered.push((k, speed, stream.columns.iter().map(|&c| q[c]).collect()));
        }
    }
    let mean_speed = (covered.iter().map(|(_, speed, _)| speed).sum::<f64>()
        / covered.len().max(1) as f64)
        .max(f64::MIN_POSITIVE);
    let mut distance = 0.0;
    let distances: Vec<f64> = covered
        .iter()
        .map(|(_, speed, _)| {
            distance += speed + mean_speed;
            distance
        })
        .collect();
    let stretches = (2 * JOINT_ENCODING_SAMPLES) as f64;
    let stretch = |i: &usize| (stretches * distances[*i] / distance) as usize;
    let by_index: Vec<usize> = (0..covered.len()).collect();
    let speed = |i: &usize| covered[*i].1;
    let slower = |a: &usize, b: &usize| speed(a).total_cmp(&speed(b));
    let slowest = by_index.chunk_by(|a, b| stretch(a) == stretch(b));
    let mut slow: Vec<usize> =
        slowest.filter_map(|stretch| stretch.iter().copied().min_by(slower)).collect();
    slow.sort_by(slower);
    slow.truncate(slow.len().div_ceil(2));
    slow.sort_unstable();
    let rotations = match &track.orientation {
        Orientations::Rotations(rotations) => Some(rotations),
        Orientations::Numbers(_) | Orientations::Unset(_) => None,
    };
    let mut samples = SimultaneousSamples {
        xyz: Vec::new(),
        rotation: rotations.map(|_| Vec::new()),
        inverse_xyz: rotations.map(|_| Vec::new()),
        q: Vec::new(),
    };
    for i in slow {
        let k = covered[i].0;
        let xyz = track.xyz[k] * scale;
        samples.xyz.push(xyz);
        if let (Some(inverse_xyz), Some(rotations)) = (&mut samples.inverse_xyz, rotations) {
            inverse_xyz.push(-(rotations[k].inverse() * xyz));
        }
        if let (Some(rotation), Some(rotations)) = (&mut samples.rotation, rotations) {
            rotation.push(rotations[k]);
        }
        samples.q.extend_from_slice(&covered[i].2);
    }
    samples
}

pub(super) fn converted_to_radians(
    chain: &Chain,
    samples: &SimultaneousSamples,
) -> SimultaneousSamples {
    let kinds = chain.joint_kinds();
    let convert = |(i, q): (usize, &f64)| {
        if kinds[i % kinds.len()] == JointKind::Prismatic { *q } else { q.to_radians() }
    };
    SimultaneousSamples {
        q: samples.q.iter().enumerate().map(convert).collect(),
        ..samples.clone()
    }
}
