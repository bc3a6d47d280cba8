use std::collections::{HashMap, HashSet};

use super::{StreamEvidence, stream_evidence};
use crate::diagnosis::{ArmDiagnosis, NotObservable};
use crate::finding::Subject;
use crate::log::Repeat;
use crate::robot::RobotError;

use crate::run::{
    Arm, JointSource, NotAudited, NotAuditedReason, PoseSourceKind, Role, Run, Stream, TfProblem,
    TopicSettings,
};
use crate::stream::{Columns, JointColumn};

/// Frames of a log.
#[derive(Clone, Debug, Default)]
pub struct TfEvidence {
    /// Topics with transforms, including static ones.
    pub topics: Vec<String>,
    /// Problems of their tree.
    pub problems: Vec<TfProblem>,
}

/// Topic without usable content.
#[derive(Clone, Debug)]
pub struct EmptyStreamEvidence {
    /// The topic.
    pub subject: Subject,
    /// Messages, none with finite numbers.
    pub messages: u64,
}

/// Duplicate or constant columns of a table.
#[derive(Clone, Debug)]
pub struct RepeatedColumnEvidence {
    /// The columns.
    pub repeat: Repeat,
    /// Consequence for the audit.
    pub kind: RepeatedColumnKind,
}

/// Consequence of duplicate or constant columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RepeatedColumnKind {
    /// Commands duplicate states, or vice versa.
    CommandEqualsState,
    /// External reference duplicates the robot's data.
    ReferenceEqualsRobot,
    /// Joint duplicates another joint.
    IdenticalJoints,
    /// Joint never moves while others do.
    ConstantJoint,
    /// Topic is constant while the arm moves.
    ConstantTopic,
    /// Two topics are identical.
    IdenticalTopics,
}

/// Topic that could not be decoded.
#[derive(Clone, Debug)]
pub struct UndecodableTopic {
    /// Topic name.
    pub topic: String,
    /// Undecodable content.
    pub what: UndecodableContent,
    /// Undecodable messages.
    pub messages: u64,
    /// First error.
    pub why: String,
}

/// Undecodable content of a topic.
#[derive(Clone, Debug)]
pub enum UndecodableContent {
    /// Messages of this type, as logged.
    Messages(String),
    /// Their robot description.
    Description,
}

pub(super) fn undecodable(run: &Run, messages: &[UndecodableTopic]) -> Vec<UndecodableTopic> {
    let description = |(topic, error): &(String, RobotError)| UndecodableTopic {
        topic: topic.clone(),
        what: UndecodableContent::Description,
        messages: 1,
        why: error.to_string(),
    };
    messages.iter().cloned().chain(run.unreadable.iter().map(description)).collect()
}

pub(super) fn tf(run: &Run) -> TfEvidence {
    let is_tf = |stream: &&Stream| matches!(stream.columns, Some(Columns::Transforms(_)));
    TfEvidence {
        topics: run.streams.iter().filter(is_tf).map(|stream| stream.topic.clone()).collect(),
        problems: run.tf_problems.iter().cloned().chain(run.disconnected_frames()).collect(),
    }
}

pub(super) fn unset(run: &Run, arm: &Arm, found: &ArmDiagnosis) -> Vec<NotAudited> {
    let streams = arm.poses.iter().zip(&found.streams);
    let unset = streams.filter(|(source, found)| {
        matches!(found.encoding, Err(NotObservable::OrientationNotSet))
            && !run.streams[source.stream].lacks_rotation()
    });
    let why = NotAuditedReason::NoOrientation;
    unset.map(|(source, _)| NotAudited { stream: source.stream, reason: why.clone() }).collect()
}

/// Joint states of arms in which every position is exactly 0, as no encoder measures.
pub(super) fn joints_never_set(run: &Run) -> Vec<NotAudited> {
    let never_set = |arm: &Arm| {
        let first = arm.joint_sources.first()?;
        let positions = |source: &JointSource| match &run.streams[source.stream].columns {
            Some(Columns::Joints(columns)) => {
                let own = columns.joints.iter().find(|joint| joint.name == source.name);
                own.map(|joint| joint.position.as_slice())
            }
            _ => None,
        };
        let is_zero = |source: &JointSource| {
            positions(source).is_some_and(|own| own.iter().all(|position| *position == 0.0))
        };
        let samples = positions(first)?.len();
        let excludes_zero = |name: &&String| {
            let limits = arm.robot.joint(name).map(|joint| joint.limits).unwrap_or_default();
            limits.lower.is_some_and(|lower| lower > 0.0)
                || limits.upper.is_some_and(|upper| upper < 0.0)
        };
        let impossible = arm.joint_names.iter().find(excludes_zero).cloned();
        (samples > 0 && arm.joint_sources.iter().all(is_zero)).then_some(NotAudited {
            stream: first.stream,
            reason: NotAuditedReason::NeverSet { samples, impossible },
        })
    };
    run.arms.iter().filter(|arm| arm.trajectory.is_none()).filter_map(never_set).collect()
}

/// Topics with further poses in frames not connected to the arm.
pub(super) fn in_other_frames(run: &Run) -> Vec<NotAudited> {
    let sources = run.arms.iter().flat_map(|arm| &arm.poses);
    let tied: Vec<usize> =
        sources.filter(|source| source.reference_known).map(|source| source.stream).collect();
    let is_tied: HashSet<usize> = tied.iter().copied().collect();
    // Key: topic and child frame; any reference frame.
    let mut groups: HashMap<(&str, &str), Vec<usize>> = HashMap::new();
    for (index, stream) in run.streams.iter().enumerate() {
        if matches!(stream.columns, Some(Columns::Poses(_))) {
            groups.entry((&stream.topic, &stream.child_frame_id)).or_default().push(index);
        }
    }
    let of = |index: usize| {
        let own = run.streams.get(index)?;
        let all = groups.get(&(own.topic.as_str(), own.child_frame_id.as_str()))?;
        let (connected, others): (Vec<usize>, Vec<usize>) =
            all.iter().partition(|&index| is_tied.contains(index));
        if connected.first() != Some(&index) || others.is_empty() {
            return None;
        }
        let others = || others.iter().map(|&other| &run.streams[other]);
        let why = NotAuditedReason::OtherFrames {
            frames: others().map(|other| other.frame_id.clone()).collect(),
            samples: others().map(|other| other.count).sum(),
            of: all.iter().map(|&index| run.streams[index].count).sum(),
        };
        Some(NotAudited { stream: index, reason: why })
    };
    tied.iter().copied().filter_map(of).collect()
}

/// Streams not audited, or not used as declared, with reasons.
pub(super) fn not_audited(
    run: &Run,
    unset: &[NotAudited],
) -> Vec<StreamEvidence<Vec<NotAuditedReason>>> {
    if run.arms.is_empty() {
        return Vec::new();
    }
    let mut reasons: HashMap<usize, Vec<NotAuditedReason>> = HashMap::new();
    for found in run.not_audited.iter().chain(unset) {
        reasons.entry(found.stream).or_default().push(found.reason.clone());
    }
    let why_not = |(index, stream): (usize, &Stream)| {
        let why = reasons.remove(&index).unwrap_or_default();
        let is_asked = matches!(stream.role, Role::Joints | Role::Pose) || !why.is_empty();
        is_asked.then(|| stream_evidence(run, index, why))
    };
    run.streams.iter().enumerate().filter_map(why_not).collect()
}

/// Columns that no other rule covers.
pub(super) fn repeated_columns(
    run: &Run,
    found: Option<&[Repeat]>,
) -> Option<Vec<RepeatedColumnEvidence>> {
    let stream = |topic: &str| run.streams.iter().find(|stream| stream.topic == topic);
    let is_command = |stream: &Stream| stream.role == Role::Reference;
    let is_outside = |stream: &Stream| stream.source_kind == Some(PoseSourceKind::External);
    let of = |repeat: &Repeat| {
        let own = stream(&repeat.topic)?;
        let kind = match (&repeat.number, &repeat.of) {
            (Some(_), Some(_)) => RepeatedColumnKind::IdenticalJoints,
            (Some(_), None) if is_command(own) => return None,
            (Some(_), None) => RepeatedColumnKind::ConstantJoint,
            // A constant pose is FRM007; a goal may be constant.
            (None, None) if own.role != Role::Unassigned => return None,
            (None, None) => RepeatedColumnKind::ConstantTopic,
            (None, Some(of)) => {
                let other = stream(of)?;
                match () {
                    () if is_command(own) != is_command(other) => {
                        RepeatedColumnKind::CommandEqualsState
                    }
                    () if is_outside(own) != is_outside(other) => {
                        RepeatedColumnKind::ReferenceEqualsRobot
                    }
                    () => RepeatedColumnKind::IdenticalTopics,
                }
            }
        };
        Some(RepeatedColumnEvidence { repeat: repeat.clone(), kind })
    };
    found.map(|found| found.iter().filter_map(of).collect())
}

/// Lists joint states and transforms only if no other topic provides them.
pub(super) fn empty_streams(run: &Run) -> Vec<EmptyStreamEvidence> {
    let holds =
        |role: Role| run.streams.iter().any(|stream| stream.role == role && !stream.is_empty);
    let is_missed = |stream: &&Stream| match &stream.columns {
        _ if !stream.is_empty => false,
        Some(Columns::Joints(_)) => !holds(Role::Joints),
        Some(_) => true,
        None => !stream.type_name.contains("TFMessage") || !holds(Role::Tf),
    };
    let of = |stream: &Stream, joint: Option<String>| EmptyStreamEvidence {
        subject: Subject { topic: Some(stream.topic.clone()), joint, ..Subject::default() },
        messages: stream.count,
    };
    let missed = run.streams.iter().filter(is_missed).map(|stream| of(stream, None));
    let joints = run.streams.iter().flat_map(|stream| {
        let joints = joints_without_positions(run, stream).into_iter();
        joints.map(move |joint| of(stream, Some(joint)))
    });
    missed.chain(joints).collect()
}

/// Joints without positions, if no other topic provides them.
fn joints_without_positions(run: &Run, stream: &Stream) -> Vec<String> {
    let Some(Columns::Joints(columns)) = &stream.columns else { return Vec::new() };
    if stream.role != Role::Joints {
        return Vec::new();
    }
    let is_read = |name: &str| {
        run.arms.iter().any(|arm| arm.joint_sources.iter().any(|joint| joint.name == name))
    };
    let is_of_an_arm = |name: &str| run.arms.iter().any(|arm| arm.robot.joint(name).is_some());
    let is_silent = |joint: &&JointColumn| {
        joint.position.iter().all(|position| position.is_nan())
            && is_of_an_arm(&joint.name)
            && !is_read(&joint.name)
    };
    columns.joints.iter().filter(is_silent).map(|joint| joint.name.clone()).collect()
}

pub(super) fn missing(run: &Run, topics: &[TopicSettings]) -> Vec<(Subject, String)> {
    let is_there = |said: &TopicSettings| {
        run.streams
            .iter()
            .any(|stream| said.is_of(&stream.topic) && (stream.count > 0 || stream.is_empty))
    };
    let missing = topics.iter().filter(|said| said.is_expected() && !is_there(said));
    let subject = |topic: &str| Subject { topic: Some(topic.to_owned()), ..Subject::default() };
    missing.map(|said| (subject(&said.topic), said.place.clone())).collect()
}
