//! What the rules judge of a run's streams.

use super::arms::{arm_facts, span_of};
use super::estimate::Diagnosis;
use super::{Options, Read};
use crate::checks::{
    Due, EmptyFacts, Facts, FrameFacts, HeldFacts, Of, RhythmFacts, StampFacts, StrayFacts,
    Undecodable, UndecodableTopic, UnusableFacts,
};
use crate::diagnosis::{ArmDiagnosis, Unseen};
use crate::finding::Subject;
use crate::robot::{JointKind, RobotError};
use crate::run::{
    Arm, Frozen, Norms, PoseSource, Role, Run, Stream, TopicSettings, Unaudited, WhyNot,
};
use crate::stream::{Columns, JointColumn, PoseColumns};
use crate::time::Clock;

/// The facts for the rules.
pub(super) fn facts(run: &Run, diagnoses: Vec<Diagnosis>, read: &Read, options: &Options) -> Facts {
    let unset = run.arms.iter().zip(&diagnoses).flat_map(|(arm, found)| unset(arm, &found.arm));
    let unset: Vec<Unaudited> = unset.chain(in_other_frames(run)).collect();
    let arms = run.arms.iter().zip(diagnoses);
    let robots = arms.map(|(arm, diagnosis)| arm_facts(run, arm, diagnosis, options));
    let stamps = run.clocks.iter().filter_map(|clock| {
        let stream = run.streams.get(clock.stream)?;
        let mut of =
            of(run, clock.stream, StampFacts { due: due(run, stream)?, clock: clock.clone() });
        of.subject.frame = clock.frame.clone().or(of.subject.frame);
        Some(of)
    });
    Facts {
        robots: robots.collect(),
        no_robot: run.no_arm.as_ref().map(|error| error.what()),
        hand_eyes: Vec::new(),
        stamps: stamps.collect(),
        unusable: unusable(run),
        rhythms: rhythms(run, &unset),
        frames: frames(run),
        norms: norms(run),
        strays: strays(run),
        frozen: frozen(run),
        held: held(run),
        unaudited: unaudited(run, &unset),
        empty: empty(run),
        missing: missing(run, &options.run.topics),
        figures: options.policy.rules.figures.clone(),
        start: run.span.map(|(start, _)| start),
        origin: run.origin,
        simulated: run.has_clock_topic,
        losses: read.losses.clone(),
        undecodable: undecodable(run, read),
    }
}

/// What could not be decoded: messages, and robot descriptions.
fn undecodable(run: &Run, read: &Read) -> Vec<UndecodableTopic> {
    let description = |(topic, error): &(String, RobotError)| UndecodableTopic {
        topic: topic.clone(),
        what: Undecodable::Description,
        messages: 1,
        why: error.to_string(),
    };
    read.undecodable.iter().cloned().chain(run.unreadable.iter().map(description)).collect()
}

/// When the samples of a stream are due; `None` where the rules about stamps are not asked about it.
fn due(run: &Run, stream: &Stream) -> Option<Due> {
    match stream.role {
        Role::Joints | Role::Imu => Some(Due::Always),
        // Without an arm, nothing says which of the transforms must be there.
        Role::Tf if run.arms.is_empty() => Some(Due::Untold),
        Role::Pose | Role::Tf => Some(Due::InMotion),
        Role::Candidate { .. } | Role::Unassigned => Some(Due::Untold),
        Role::Reference | Role::Target => Some(Due::OnOccasion),
        Role::TfStatic | Role::Description | Role::Ignored => None,
    }
}

/// The frame whose poses a stream holds, where its topic is that of other streams, too.
pub(super) fn frame_of_several(run: &Run, stream: &Stream) -> Option<String> {
    let of_topic = run.streams.iter().filter(|other| other.topic == stream.topic);
    let is_one_of_several = of_topic.count() > 1 && !stream.child_frame_id.is_empty();
    is_one_of_several.then(|| stream.child_frame_id.clone())
}

fn rhythms(run: &Run, others: &[Unaudited]) -> Vec<Of<RhythmFacts>> {
    let rhythms = run.rhythms.iter().filter_map(|rhythm| {
        let stream = run.streams.get(rhythm.stream)?;
        let found = RhythmFacts {
            due: due(run, stream)?,
            rate_hz: stream.rate_hz,
            said_hz: stream.said_hz,
            unstamped: run
                .clocks
                .iter()
                .filter(|clock| clock.stream == rhythm.stream && clock.clock == Clock::Header)
                .map(|clock| clock.zero)
                .sum(),
            elsewhere: others
                .iter()
                .filter(|found| found.stream == rhythm.stream)
                .map(|found| match found.why {
                    WhyNot::OtherFrames { samples, .. } => samples,
                    _ => 0,
                })
                .sum(),
            // Of joint states no row is left out.
            unusable: if stream.role == Role::Joints { 0 } else { stream.unusable() },
            parts: rhythm.parts.clone(),
            extent: rhythm.extent,
        };
        Some(of(run, rhythm.stream, found))
    });
    rhythms.filter(|rhythm| !rhythm.parts.is_empty()).collect()
}

/// The topics of transforms, and what is wrong with their frames.
fn frames(run: &Run) -> FrameFacts {
    let is_tf = |stream: &&Stream| matches!(stream.columns, Some(Columns::Transforms(_)));
    FrameFacts {
        topics: run.streams.iter().filter(is_tf).map(|stream| stream.topic.clone()).collect(),
        flaws: run.flaws.iter().cloned().chain(run.pieces()).collect(),
    }
}

/// The norms of the streams that log rotations, each with all its transforms.
fn norms(run: &Run) -> Vec<Of<Vec<Norms>>> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let mut streams: Vec<Of<Vec<Norms>>> = Vec::new();
    let mut last = None;
    for norms in &run.norms {
        let Some(stream) = run.streams.get(norms.stream) else { continue };
        let is_rotations = match &stream.columns {
            // Four of a bare array's numbers are a quaternion only where it is a pose.
            Some(Columns::Array(_)) => stream.role == Role::Pose,
            // What a transform says is judged on its own topic.
            Some(Columns::Poses(_)) => stream.role != Role::Ignored && !is_tf(&stream.topic),
            _ => true,
        };
        if !is_rotations {
            continue;
        }
        match streams.last_mut().filter(|_| last == Some(norms.stream)) {
            Some(known) => known.found.push(norms.clone()),
            None => streams.push(of(run, norms.stream, vec![norms.clone()])),
        }
        last = Some(norms.stream);
    }
    streams
}

/// The streams that are audited, each with its samples that hold no usable numbers.
fn unusable(run: &Run) -> Vec<Of<UnusableFacts>> {
    /// A quaternion of smaller parts is none.
    const NEXT_TO_NOTHING: f64 = 1e-6;
    let is_asked =
        |stream: &Stream| matches!(stream.role, Role::Joints | Role::Pose | Role::Tf | Role::Imu);
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let unusable = |(index, stream): (usize, &Stream)| {
        let mut facts = UnusableFacts { unusable: stream.unusable(), ..UnusableFacts::default() };
        let mut joint = None;
        let kept: usize = stream.times().iter().map(|times| times.len()).sum();
        facts.samples = kept as u64 + facts.unusable;
        match &stream.columns {
            Some(Columns::Joints(joints)) => {
                let names = joints.joints.iter().map(|joint| joint.name.as_str());
                let of_arm = names.zip(&joints.unusable).filter(|(name, _)| {
                    let mut of_arms = run.arms.iter().flat_map(|arm| &arm.joint_facts);
                    run.arms.is_empty() || of_arms.any(|joint| joint.name == *name)
                });
                let worst = of_arm.max_by_key(|(_, count)| **count);
                facts.misfits = joints.wrong_length;
                facts.contradictory = joints.contradictory;
                facts.samples = kept as u64 + facts.misfits;
                facts.unusable = worst.map_or(0, |(_, count)| *count);
                joint = worst.filter(|_| facts.unusable > 0).map(|(name, _)| name.to_owned());
            }
            Some(Columns::Poses(poses) | Columns::Transforms(poses)) => {
                let unset = |poses: &PoseColumns| {
                    let is_unset =
                        |q: &&[f64; 4]| q.iter().all(|part| part.abs() < NEXT_TO_NOTHING);
                    poses.q_xyzw.iter().filter(is_unset).count()
                };
                let some = poses.iter().map(|poses| (unset(poses), poses.times.len()));
                facts.unset =
                    some.filter(|(unset, all)| unset < all).map(|(unset, _)| unset as u64).sum();
            }
            Some(Columns::Array(array)) => {
                facts.misfits = array.wrong_length;
                facts.samples += facts.misfits;
            }
            _ => {}
        }
        let mut of = of(run, index, facts);
        of.subject.joint = joint;
        of
    };
    streams.map(unusable).collect()
}

/// The streams of joint states, tool poses and transforms, each with what of it jumps away and back.
fn strays(run: &Run) -> Vec<Of<StrayFacts>> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let is_asked = |stream: &Stream| match stream.role {
        Role::Joints | Role::Tf => true,
        // What a transform says is judged on its own topic.
        Role::Pose => !is_tf(&stream.topic),
        _ => false,
    };
    let sliding: Vec<String> = run
        .arms
        .iter()
        .flat_map(|arm| arm.robot.joints())
        .filter(|joint| joint.kind == JointKind::Prismatic)
        .map(|joint| joint.name.clone())
        .collect();
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let strays = |(index, stream): (usize, &Stream)| {
        let parts = run.sift.strays.iter().filter(|strays| strays.stream == index);
        let found = StrayFacts {
            samples: stream.times().iter().map(|times| times.len()).max().unwrap_or(0),
            sliding: sliding.clone(),
            parts: parts.cloned().collect(),
        };
        of(run, index, found)
    };
    streams.map(strays).collect()
}

/// What was found on the stream `index`.
fn of<T>(run: &Run, index: usize, found: T) -> Of<T> {
    let stream = &run.streams[index];
    let subject = Subject {
        robot: stream.arm.and_then(|arm| run.arms.get(arm)).map(|arm| arm.name.clone()),
        topic: Some(stream.topic.clone()),
        frame: frame_of_several(run, stream),
        ..Subject::default()
    };
    Of { subject, span: span_of(run, index), found }
}

/// The streams of poses that an arm was held against, each with when it stood still.
fn frozen(run: &Run) -> Vec<Of<Vec<Frozen>>> {
    let frozen = |index: usize| {
        let stream = run.streams.get(index)?;
        let times = run.frozen.iter().filter(|found| found.stream == index);
        let is_asked = matches!(stream.role, Role::Pose | Role::Joints);
        if !is_asked && !times.clone().any(|found| found.whole) {
            return None;
        }
        Some(of(run, index, times.copied().collect()))
    };
    let joints = (0..run.streams.len()).filter(|&index| run.streams[index].role == Role::Joints);
    joints.chain(run.watched.iter().copied()).filter_map(frozen).collect()
}

/// The streams whose values could repeat, each with what of it does.
fn held(run: &Run) -> Vec<Of<HeldFacts>> {
    let is_tf = |topic: &str| {
        run.streams.iter().any(|stream| stream.role == Role::Tf && stream.topic == topic)
    };
    let is_asked = |stream: &Stream| match stream.role {
        Role::Joints | Role::Tf | Role::Imu => true,
        // What a transform says is judged on its own topic.
        Role::Pose => !is_tf(&stream.topic),
        _ => false,
    };
    let of_stream = |index: usize| run.sift.held.iter().filter(move |held| held.stream == index);
    let repeats = |index: usize| of_stream(index).any(|held| held.is_taken_once());
    let is_of_joints = |index: usize| {
        run.arms.iter().any(|arm| {
            let follows = |tf: &PoseSource| tf.stream == index && tf.stamps_copied;
            arm.tf.as_ref().is_ok_and(follows)
                && arm.joint_facts.iter().any(|joint| repeats(joint.stream))
        })
    };
    let streams = run.streams.iter().enumerate().filter(|(_, stream)| is_asked(stream));
    let held = |(index, stream): (usize, &Stream)| {
        let found = HeldFacts {
            parts: of_stream(index).cloned().collect(),
            is_latched: stream.topic.to_lowercase().contains("latched"),
            is_of_joints: is_of_joints(index),
        };
        of(run, index, found)
    };
    streams.map(held).collect()
}

/// The streams of an arm whose orientations were never set.
fn unset(arm: &Arm, found: &ArmDiagnosis) -> Vec<Unaudited> {
    let streams = arm.poses.iter().zip(&found.streams);
    let unset =
        streams.filter(|(_, found)| matches!(found.reading, Err(Unseen::OrientationNotSet)));
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
fn in_other_frames(run: &Run) -> Vec<Unaudited> {
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
fn unaudited(run: &Run, unset: &[Unaudited]) -> Vec<Of<Vec<WhyNot>>> {
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

/// The topics that hold nothing and would be audited; of joint states and transforms only where no
/// other topic has any.
fn empty(run: &Run) -> Vec<EmptyFacts> {
    let holds =
        |role: Role| run.streams.iter().any(|stream| stream.role == role && !stream.is_empty);
    let is_missed = |stream: &&Stream| match &stream.columns {
        _ if !stream.is_empty => false,
        Some(Columns::Joints(_)) => !holds(Role::Joints),
        Some(_) => true,
        None => !stream.type_name.contains("TFMessage") || !holds(Role::Tf),
    };
    let of = |stream: &Stream, joint: Option<String>| EmptyFacts {
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
fn missing(run: &Run, topics: &[TopicSettings]) -> Vec<(Subject, String)> {
    let is_there = |said: &TopicSettings| {
        run.streams
            .iter()
            .any(|stream| said.is_of(&stream.topic) && (stream.count > 0 || stream.is_empty))
    };
    let missing = topics.iter().filter(|said| said.is_expected() && !is_there(said));
    let subject = |topic: &str| Subject { topic: Some(topic.to_owned()), ..Subject::default() };
    missing.map(|said| (subject(&said.topic), said.place.clone())).collect()
}
