//! Latency between several topics of joint states of one arm.

use std::collections::BTreeSet;

use super::estimate::{ArmStreamsDiagnosis, position_factor};
use crate::diagnosis::{LateJoints, Measured, with_earlier_joints};
use crate::run::{Arm, Run};

/// A topic of joint states that is late against the arm's other joint states.
#[derive(Clone, Copy, Debug)]
pub struct JointTopicLatency {
    /// Its stream.
    pub stream: usize,
    /// Stream of other joints.
    pub other: usize,
    /// Negative if it is early.
    pub latency_s: Measured,
}

/// The arm with corrected stamps of the late topic. `None` without one.
pub(super) fn with_corrected_topic(
    run: &Run,
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
) -> Option<(Arm, JointTopicLatency)> {
    let streams: Vec<usize> = arm.joint_sources.iter().map(|source| source.stream).collect();
    let topics: Vec<usize> = BTreeSet::from_iter(streams.iter().copied()).into_iter().collect();
    if topics.len() < 2 || arm.trajectory.is_some() {
        return None;
    }
    let poses = arm.poses.iter().zip(&found.arm.streams);
    let late =
        poses.filter_map(|(source, found)| Some((source, found, found.latency_s.as_ref().ok()?)));
    let (source, diagnosis, latency) = late.max_by_key(|(source, ..)| source.track.t_s.len())?;
    let columns_of = |topic: &usize| -> Vec<usize> {
        (0..streams.len()).filter(|&column| streams[column] == *topic).collect()
    };
    let groups: Vec<Vec<usize>> = topics.iter().map(columns_of).collect();
    let start = (position_factor(diagnosis), latency.value);
    let LateJoints { group, latency_s } =
        LateJoints::find(&arm.joints, &run.pose_stream(source), start, &groups)?;
    let joints = with_earlier_joints(&arm.joints, &groups[group], latency_s.value);
    let mut corrected = arm.clone();
    corrected.replace_joints(joints);
    let other = topics.iter().copied().find(|other| *other != topics[group])?;
    Some((corrected, JointTopicLatency { stream: topics[group], other, latency_s }))
}
