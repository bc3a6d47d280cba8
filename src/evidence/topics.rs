//! Topics and frames: what is not there, not read or not audited, and why.

use super::{Of, of};
use crate::diagnosis::{ArmDiagnosis, Unseen};
use crate::finding::Subject;
use crate::log::Repeat;
use crate::robot::RobotError;

use crate::run::{Arm, Flaw, Role, Run, Stream, TopicSettings, Unaudited, WhyNot, Witness};
use crate::stream::{Columns, JointColumn};

/// The frames of a log.
#[derive(Clone, Debug, Default)]
pub struct FrameEvidence {
    /// The topics of transforms, static ones too.
    pub topics: Vec<String>,
    /// What keeps them from being a tree.
    pub flaws: Vec<Flaw>,
}

/// A topic that says nothing.
#[derive(Clone, Debug)]
pub struct EmptyEvidence {
    /// The topic.
    pub subject: Subject,
    /// Its messages, none of which holds finite numbers.
    pub messages: u64,
}

/// Columns of a table that hold what others hold in every row, or one value.
#[derive(Clone, Debug)]
pub struct RepeatEvidence {
    /// The columns.
    pub repeat: Repeat,
    /// What it is to the audit that they repeat.
    pub kind: RepeatKind,
}

/// What it is to the audit that columns repeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RepeatKind {
    /// Commands are states, or the other way round.
    CommandIsState,
    /// An outside witness says what is not from outside.
    WitnessIsOther,
    /// A joint is another one.
    JointIsJoint,
    /// A joint never moves while others do.
    JointRests,
    /// A topic never changes while the arm moves.
    Still,
    /// Two topics are one.
    Same,
}

/// A topic that could not be decoded.
#[derive(Clone, Debug)]
pub struct UndecodableTopic {
    /// Its name.
    pub topic: String,
    /// What could not: its type, as the log spells it, or a robot description.
    pub what: Undecodable,
    /// How many of its messages could not be decoded.
    pub messages: u64,
    /// Why the first of them could not.
    pub why: String,
}

/// What of a topic could not be decoded.
#[derive(Clone, Debug)]
pub enum Undecodable {
    /// Messages of this type.
    Messages(String),
    /// The robot description in them.
    Description,
}

/// What could not be decoded: messages, and robot descriptions.
pub(super) fn undecodable(run: &Run, messages: &[UndecodableTopic]) -> Vec<UndecodableTopic> {
    let description = |(topic, error): &(String, RobotError)| UndecodableTopic {
        topic: topic.clone(),
        what: Undecodable::Description,
        messages: 1,
        why: error.to_string(),
    };
    messages.iter().cloned().chain(run.unreadable.iter().map(description)).collect()
}

/// The topics of transforms, and what is wrong with their frames.
pub(super) fn frames(run: &Run) -> FrameEvidence {
    let is_tf = |stream: &&Stream| matches!(stream.columns, Some(Columns::Transforms(_)));
    FrameEvidence {
        topics: run.streams.iter().filter(is_tf).map(|stream| stream.topic.clone()).collect(),
        flaws: run.flaws.iter().cloned().chain(run.pieces()).collect(),
    }
}

/// The streams of an arm whose orientations were never set.
pub(super) fn unset(run: &Run, arm: &Arm, found: &ArmDiagnosis) -> Vec<Unaudited> {
    let streams = arm.poses.iter().zip(&found.streams);
    let unset = streams.filter(|(source, found)| {
        matches!(found.reading, Err(Unseen::OrientationNotSet))
            && !run.streams[source.stream].holds_no_rotation()
    });
    let why = WhyNot::NoOrientation;
    unset.map(|(source, _)| Unaudited { stream: source.stream, why: why.clone() }).collect()
}

/// The streams of poses of the same on the same topic, whatever frames they are in, with their indices.
fn beside<'a>(run: &'a Run, own: &'a Stream) -> impl Iterator<Item = (usize, &'a Stream)> {
    run.streams.iter().enumerate().filter(|(_, other)| {
        other.topic == own.topic
            && other.child_frame_id == own.child_frame_id
            && matches!(other.columns, Some(Columns::Poses(_)))
    })
}

/// The topics of which the arm is held against some poses, and others are in frames that nothing ties to it.
pub(super) fn in_other_frames(run: &Run) -> Vec<Unaudited> {
    let sources = run.arms.iter().flat_map(|arm| &arm.poses);
    let tied: Vec<usize> =
        sources.filter(|source| source.reference_known).map(|source| source.stream).collect();
    let of = |index: usize| {
        let all = || beside(run, &run.streams[index]);
        let others: Vec<&Stream> =
            all().filter(|(index, _)| !tied.contains(index)).map(|(_, other)| other).collect();
        let is_first =
            all().find(|(index, _)| tied.contains(index)).is_some_and(|it| it.0 == index);
        if others.is_empty() || !is_first {
            return None;
        }
        let why = WhyNot::OtherFrames {
            frames: others.iter().map(|other| other.frame_id.clone()).collect(),
            samples: others.iter().map(|other| other.count).sum(),
            of: all().map(|(_, stream)| stream.count).sum(),
        };
        Some(Unaudited { stream: index, why })
    };
    tied.iter().filter_map(|&index| of(index)).collect()
}

/// The streams that are audited or would be, each with why it is not, or not as what it says it is.
pub(super) fn unaudited(run: &Run, unset: &[Unaudited]) -> Vec<Of<Vec<WhyNot>>> {
    if run.arms.is_empty() {
        return Vec::new();
    }
    let why_not = |(index, stream): (usize, &Stream)| {
        let known = run.unaudited.iter().chain(unset).filter(|found| found.stream == index);
        let why: Vec<WhyNot> = known.map(|found| found.why.clone()).collect();
        let is_asked = matches!(stream.role, Role::Joints | Role::Pose) || !why.is_empty();
        is_asked.then(|| of(run, index, why))
    };
    run.streams.iter().enumerate().filter_map(why_not).collect()
}

/// What repeats in tables, of which other rules say nothing.
pub(super) fn repeats(run: &Run, found: Option<&[Repeat]>) -> Option<Vec<RepeatEvidence>> {
    let stream = |topic: &str| run.streams.iter().find(|stream| stream.topic == topic);
    let is_command = |stream: &Stream| stream.role == Role::Reference;
    let is_outside = |stream: &Stream| stream.witness == Some(Witness::External);
    let of = |repeat: &Repeat| {
        let own = stream(&repeat.topic)?;
        let kind = match (&repeat.number, &repeat.of) {
            (Some(_), Some(_)) => RepeatKind::JointIsJoint,
            (Some(_), None) if is_command(own) => return None,
            (Some(_), None) => RepeatKind::JointRests,
            // That of a pose is FRM007, and a goal may stay where it is.
            (None, None) if own.role != Role::Unassigned => return None,
            (None, None) => RepeatKind::Still,
            (None, Some(of)) => {
                let other = stream(of)?;
                match () {
                    () if is_command(own) != is_command(other) => RepeatKind::CommandIsState,
                    () if is_outside(own) != is_outside(other) => RepeatKind::WitnessIsOther,
                    () => RepeatKind::Same,
                }
            }
        };
        Some(RepeatEvidence { repeat: repeat.clone(), kind })
    };
    found.map(|found| found.iter().filter_map(of).collect())
}

/// The topics that hold nothing and would be audited; of joint states and transforms only where no
/// other topic has any.
pub(super) fn empty(run: &Run) -> Vec<EmptyEvidence> {
    let holds =
        |role: Role| run.streams.iter().any(|stream| stream.role == role && !stream.is_empty);
    let is_missed = |stream: &&Stream| match &stream.columns {
        _ if !stream.is_empty => false,
        Some(Columns::Joints(_)) => !holds(Role::Joints),
        Some(_) => true,
        None => !stream.type_name.contains("TFMessage") || !holds(Role::Tf),
    };
    let of = |stream: &Stream, joint: Option<String>| EmptyEvidence {
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

/// The joints of an arm that a topic of joint states names and never says the position of, and that no
/// other topic says.
fn joints_without_positions(run: &Run, stream: &Stream) -> Vec<String> {
    let Some(Columns::Joints(columns)) = &stream.columns else { return Vec::new() };
    if stream.role != Role::Joints {
        return Vec::new();
    }
    let is_read = |name: &str| {
        run.arms.iter().any(|arm| arm.joint_facts.iter().any(|joint| joint.name == name))
    };
    let is_of_an_arm = |name: &str| run.arms.iter().any(|arm| arm.robot.joint(name).is_some());
    let is_silent = |joint: &&JointColumn| {
        joint.position.iter().all(|position| position.is_nan())
            && is_of_an_arm(&joint.name)
            && !is_read(&joint.name)
    };
    columns.joints.iter().filter(is_silent).map(|joint| joint.name.clone()).collect()
}

/// The topics that the caller expects and the log does not have.
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
