//! A pose stream in the place of joint states: the path of a floating joint.

use std::sync::Arc;

use super::Run;
use super::arm::{Arm, TfUnavailable};
use super::model::FrameNames;
use super::namespace::Namespace;
use super::sources::{ImuSource, PoseSource};
use super::streams::Stream;
use super::velocities::{SmoothedJoint, smooth};
use crate::geometry::{Rotation, Vec3, xyzw_from_rotation};
use crate::robot::{FLOATING_COORDINATES, Robot};
use crate::stream::{Columns, JointTrack, Orientations, PoseTrack};

/// A pose stream with which others are compared.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// Index of the stream.
    pub stream: usize,
    /// Its poses.
    pub track: PoseTrack,
    /// Streams compared with it.
    pub others: Vec<usize>,
    /// Why it is the reference.
    pub why: String,
}

/// Whether the caller or the log states that two pose streams are of one body: both name the same child frame, or each is the
/// only pose stream of its file.
///
/// Motion cannot decide this, because a stream with a large error and one of another body both move otherwise. Topics of one
/// log do not decide it either: a tracking system publishes one topic per body, with common prefix, type and rate. But their
/// child frames name the bodies, and a caller selects files one by one, to compare them.
pub(crate) fn are_of_one_body(streams: &[Stream], pair: [usize; 2]) -> bool {
    let [first, second] = pair.map(|index| &streams[index]);
    let bodies = [first, second].map(|stream| stream.child_frame_id.as_str());
    if !bodies.contains(&"") {
        return bodies[0] == bodies[1];
    }
    let is_alone = |stream: &Stream| {
        let is_of_file = |other: &&Stream| {
            other.file == stream.file
                && matches!(other.columns, Some(Columns::Poses(_) | Columns::Array(_)))
        };
        stream.file.is_some() && streams.iter().filter(is_of_file).count() == 1
    };
    is_alone(first) && is_alone(second)
}

impl Arm {
    /// A body that moves like `stream`, in its frame. Both are named by the stream's frames.
    pub(super) fn from_trajectory(stream: &Stream, trajectory: Trajectory) -> Self {
        let unnamed = |kind: &str| format!("{kind} of {}", stream.topic);
        let frame = match stream.frame_id.as_str() {
            "" => unnamed("frame"),
            frame => frame.to_owned(),
        };
        let named = Some(&stream.child_frame_id).filter(|child| !child.is_empty());
        let bodies = [named.cloned(), Some(unnamed("body"))].into_iter().flatten();
        let body = bodies.into_iter().find(|body| *body != frame);
        let body = body.unwrap_or_else(|| format!("{frame}, the body"));
        let robot = Robot::floating_body(&stream.topic, &frame, &body);
        let [base, tip] = [&frame, &body].map(|name| robot.link(name).expect("its link"));
        let chain = robot.chain(base, tip).expect("a floating joint is a chain");
        Self {
            name: stream.topic.clone(),
            identified_by: format!("the poses on '{}'", stream.topic),
            competing: None,
            indistinguishable: Vec::new(),
            columns: (0..chain.dof()).collect(),
            joint_names: chain.joint_names().to_vec(),
            chain,
            tip_named: false,
            joints: Arc::new(floating_track(&trajectory.track)),
            joint_sources: Vec::new(),
            recorded_joints: None,
            joint_correction: None,
            poses: Vec::new(),
            tf: Err(TfUnavailable::NoTransforms),
            from_model: Vec::new(),
            imus: Vec::new(),
            trajectory: Some(trajectory),
            base,
            tip,
            unnamed_base: base,
            frames: FrameNames::default(),
            joint_stamps: Arc::default(),
            namespace: Namespace::default(),
            tree: Arc::default(),
            robot,
        }
    }
}

impl Run {
    /// Replaces an arm by one with another reference.
    pub(crate) fn exchange_reference(&mut self, index: usize, arm: Arm) {
        if let Some(new) = &arm.trajectory {
            self.streams[new.stream].reason = new.why.clone();
            let explained = format!("compared with '{}'", arm.name);
            for source in &arm.poses {
                self.streams[source.stream].reason.clone_from(&explained);
            }
        }
        self.arms[index] = arm;
    }

    /// The arm with the poses of `arm.poses[source]` as the reference, and the former reference compared with it.
    /// `None` if they have no rotations, or the arm has joint states.
    pub(crate) fn with_other_reference(&self, arm: &Arm, source: usize) -> Option<Arm> {
        let former = arm.trajectory.as_ref()?;
        let new = &arm.poses[source];
        if !matches!(new.track.orientation, Orientations::Rotations(_)) {
            return None;
        }
        let others = former.others.iter().copied().filter(|&stream| stream != new.stream);
        let trajectory = Trajectory {
            stream: new.stream,
            track: new.track.clone(),
            others: others.chain([former.stream]).collect(),
            why: format!(
                "the reference of the other poses, as the log has no joint states for them; errors of '{}', which has \
                 less noise, explain the difference",
                arm.name
            ),
        };
        let exchanged = Arm {
            tree: Arc::clone(&arm.tree),
            ..Arm::from_trajectory(&self.streams[new.stream], trajectory)
        };
        let compared = |source: &PoseSource| PoseSource {
            chain: exchanged.chain.clone(),
            reference_known: source.reference_known && new.reference_known,
            tip_named: source.tip_named && new.tip_named,
            ..source.clone()
        };
        let reference =
            PoseSource { stream: former.stream, track: former.track.clone(), ..new.clone() };
        let kept = arm.poses.iter().filter(|other| other.stream != new.stream);
        let poses = kept.map(compared).chain([compared(&reference)]).collect();
        let imu = |imu: &ImuSource| ImuSource { chain: exchanged.chain.clone(), ..imu.clone() };
        let imus = arm.imus.iter().map(imu).collect();
        Some(Arm { poses, imus, ..exchanged })
    }
}

/// Poses as the coordinates of a floating joint, with velocities from the positions.
fn floating_track(track: &PoseTrack) -> JointTrack {
    let Orientations::Rotations(rotations) = &track.orientation else {
        return JointTrack::default();
    };
    let dof = FLOATING_COORDINATES.len();
    let quaternions = continuous_quaternions(rotations);
    let coordinate = |at: usize| -> Vec<f64> {
        match at.checked_sub(3) {
            None => track.xyz.iter().map(|xyz: &Vec3| xyz[at]).collect(),
            Some(component) => quaternions.iter().map(|q| q[component]).collect(),
        }
    };
    let smoothed: Vec<SmoothedJoint> =
        (0..dof).map(|at| smooth(&track.t_s, &coordinate(at))).collect();
    let rows = |of: fn(&SmoothedJoint) -> &Vec<f64>| {
        let row = |row: usize| smoothed.iter().map(move |joint| of(joint)[row]);
        (0..track.t_s.len()).flat_map(row).collect()
    };
    JointTrack {
        t_s: track.t_s.clone(),
        dof,
        q: rows(|joint| &joint.q),
        qd: rows(|joint| &joint.qd),
        noise: smoothed.iter().map(|joint| joint.noise).collect(),
    }
}

/// Components x, y, z, w, of the sign nearest to the sample before.
pub(super) fn continuous_quaternions(rotations: &[Rotation]) -> Vec<[f64; 4]> {
    let mut before = [0.0; 4];
    let continued = |rotation: &Rotation| {
        let q = xyzw_from_rotation(rotation);
        let dot: f64 = q.iter().zip(before).map(|(a, b)| a * b).sum();
        before = if dot < 0.0 { q.map(|part| -part) } else { q };
        before
    };
    rotations.iter().map(continued).collect()
}
