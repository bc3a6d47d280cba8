//! What is estimated on a run and counted in it, stream by stream: what the rules judge. Each family of
//! streams has a file, with what is known of one and how that is had of the run.

mod arm;
mod commands;
mod estimate;
mod hand_eye;
mod joints;
mod poses;
mod samples;
mod shake;
mod streams;
mod topics;

use std::ops::{Deref, DerefMut};

use crate::finding::{Span, Subject};
use crate::log::{self, Loss, Note, Repeat};
use crate::run::{Arm, Frozen, Norms, Run, RunOptions, Unaudited, WhyNot};
use crate::time::Stamp;

pub use arm::ArmEvidence;
pub use commands::{ReferenceEvidence, ReferenceWitness, UnmodelledCommands, WitnessKind};
pub use estimate::DhEvidence;
pub use hand_eye::HandEyeEvidence;
pub use joints::{JointEvidence, JointMotion};
pub use poses::{Declared, EulerEvidence, ImuEvidence, PoseEvidence};
pub use samples::{HeldEvidence, StrayEvidence, UnusableEvidence};
pub use shake::ShakeEvidence;
pub(crate) use streams::frame_of_several;
pub use streams::{Due, RhythmEvidence, StampEvidence};
pub use topics::{
    EmptyEvidence, FrameEvidence, RepeatEvidence, RepeatKind, Undecodable, UndecodableTopic,
};

/// All that is known of one run.
#[derive(Clone, Debug, Default)]
pub struct RunEvidence {
    /// The robots in the log that have a model, each with its streams.
    pub robots: Vec<ArmEvidence>,
    /// Why there is none, where there is none.
    pub no_robot: Option<String>,
    /// Joint commands, if there is no robot.
    pub unmodelled_commands: Vec<Of<UnmodelledCommands>>,
    /// What cameras see, each held against a hand.
    pub hand_eyes: Vec<HandEyeEvidence>,
    /// Every stream that plays a part, by its stamps.
    pub stamps: Vec<Of<StampEvidence>>,
    /// Every stream that is audited, by its samples that hold no usable numbers.
    pub unusable: Vec<Of<UnusableEvidence>>,
    /// Every stream that plays a part, by how regularly it comes.
    pub rhythms: Vec<Of<RhythmEvidence>>,
    /// The TF topics, and what keeps their frames from being a tree.
    pub frames: FrameEvidence,
    /// Every stream that logs rotations as more than three numbers, by how far they are from rotations.
    pub norms: Vec<Of<Vec<Norms>>>,
    /// Every stream of joint states, tool poses or transforms, by the samples that jump away and back.
    pub strays: Vec<Of<StrayEvidence>>,
    /// Every stream of tool poses that the arm can be held against, by when it stood still.
    pub frozen: Vec<Of<Vec<Frozen>>>,
    /// What repeats values with new stamps.
    pub held: Vec<Of<HeldEvidence>>,
    /// Every stream of joint states or tool poses, and every other that says it is one, with why it is not
    /// audited as that.
    pub unaudited: Vec<Of<Vec<WhyNot>>>,
    /// Every stream of poses that does what the arm does before it does, with its lead in seconds.
    pub leaders: Vec<Of<f64>>,
    /// Topics that would play a role, and hold no message, or none with finite numbers.
    pub empty: Vec<EmptyEvidence>,
    /// Topics that the caller expects and the log does not have, with where that is said.
    pub missing: Vec<(Subject, String)>,
    /// First stamp of the run.
    pub start: Option<Stamp>,
    /// The stamp that times in seconds of the diagnosis are relative to.
    pub origin: Stamp,
    /// Whether the log holds `/clock`, the mark of simulation.
    pub simulated: bool,
    /// Damage to the files.
    pub losses: Vec<Loss>,
    /// Topics that the audit wants and that could not be decoded.
    pub undecodable: Vec<UndecodableTopic>,
    /// What metadata declare and the numbers are not; `None` where nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// Columns that hold what others hold, or one value; `None` without tables.
    pub repeats: Option<Vec<RepeatEvidence>>,
}

impl RunEvidence {
    /// What is known of `run`. An arm whose DH table proves to be of the other convention than it says is
    /// read by that one from here on.
    pub fn of(run: &mut Run, lost: &Lost, options: &RunOptions) -> Self {
        let most_lag_s = options.max_latency_s;
        let diagnoses = estimate::diagnose(run, most_lag_s);
        let run = &*run;
        let joints = |arm: usize| estimate::readable_joints(&run.arms[arm], &diagnoses[arm].arm);
        let hand_eyes = hand_eye::hand_eyes(run, joints, most_lag_s);
        let never_set = run
            .arms
            .iter()
            .zip(&diagnoses)
            .flat_map(|(arm, found)| topics::unset(run, arm, &found.arm));
        let unset: Vec<Unaudited> = never_set.chain(topics::in_other_frames(run)).collect();
        let arms = diagnoses.into_iter().enumerate();
        let robots =
            arms.map(|(index, diagnosis)| arm::arm_evidence(run, index, diagnosis, options));
        Self {
            robots: robots.collect(),
            no_robot: run.no_arm.as_ref().map(|error| error.what()),
            unmodelled_commands: commands::without_model(run, most_lag_s),
            hand_eyes,
            stamps: streams::stamps(run),
            unusable: samples::unusable(run),
            rhythms: streams::rhythms(run, &unset),
            frames: topics::frames(run),
            norms: samples::norms(run),
            strays: samples::strays(run),
            frozen: samples::frozen(run),
            held: samples::held(run),
            unaudited: topics::unaudited(run, &unset),
            leaders: run.leaders.iter().map(|&(stream, lead_s)| of(run, stream, lead_s)).collect(),
            empty: topics::empty(run),
            missing: topics::missing(run, &options.topics),
            start: run.span.map(|(start, _)| start),
            origin: run.origin,
            simulated: run.has_clock_topic,
            losses: lost.losses.clone(),
            undecodable: topics::undecodable(run, &lost.undecodable),
            contradictions: lost.contradictions.clone(),
            repeats: topics::repeats(run, lost.repeats.as_deref()),
        }
    }

    /// Number of subjects (streams and joints) in the run, by which intervals are corrected.
    pub fn subjects(&self) -> usize {
        let of_robots: usize = self.robots.iter().map(ArmEvidence::subjects).sum();
        (of_robots + self.hand_eyes.len()).max(1)
    }

    /// Whether messages amid the files are lost, so that what is missing of a stream may be the log's.
    pub fn lost_messages(&self) -> bool {
        self.losses.iter().any(|loss| loss.extent >= log::Extent::Messages)
    }

    /// A moment of the run as a person finds it again: seconds from the start.
    pub fn moment(&self, stamp: Stamp) -> String {
        format!("+{:.2} s", stamp.seconds_since(self.start.unwrap_or(stamp)))
    }

    /// Every pose stream with its robot.
    pub fn poses(&self) -> impl Iterator<Item = (&ArmEvidence, &Of<PoseEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.poses.iter().map(move |stream| (arm, stream)))
    }

    /// Every pose stream and every /tf with its robot.
    pub fn poses_and_tf(&self) -> impl Iterator<Item = (&ArmEvidence, &Of<PoseEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.poses_and_tf().map(move |stream| (arm, stream)))
    }

    /// Every IMU with its robot.
    pub fn imus(&self) -> impl Iterator<Item = (&ArmEvidence, &Of<ImuEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.imus.iter().map(move |imu| (arm, imu)))
    }
}

/// What was found on a stream.
#[derive(Clone, Debug)]
pub struct Of<T> {
    /// The stream.
    pub subject: Subject,
    /// First and last stamp used.
    pub span: Option<Span>,
    /// What was found.
    pub found: T,
}

impl<T> Of<T> {
    /// The topic of the stream.
    pub fn topic(&self) -> &str {
        self.subject.topic.as_deref().unwrap_or_default()
    }

    /// Length of its span, s; 0 without one.
    pub fn seconds(&self) -> f64 {
        self.span.map_or(0.0, |span| span.seconds())
    }

    /// Something else that was found on the same stream.
    pub(crate) fn with<U>(&self, found: U) -> Of<U> {
        Of { subject: self.subject.clone(), span: self.span, found }
    }
}

impl<T> Deref for Of<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.found
    }
}

impl<T> DerefMut for Of<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.found
    }
}

/// What reading the files lost.
#[derive(Clone, Debug, Default)]
pub struct Lost {
    /// Damage to the files.
    pub losses: Vec<Loss>,
    /// Topics that the audit wants and that could not be decoded.
    pub undecodable: Vec<UndecodableTopic>,
    /// What metadata declare and the numbers are not; `None` where nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// What in tables repeats in every row; `None` without tables.
    pub repeats: Option<Vec<Repeat>>,
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

/// What was found on a stream of an arm: with its topic for a subject, whatever frame it is of.
fn of_arm<T>(run: &Run, arm: &Arm, stream: usize, found: T) -> Of<T> {
    let (robot, topic) = (Some(arm.name.clone()), Some(run.streams[stream].topic.clone()));
    let subject = Subject { robot, topic, ..Subject::default() };
    Of { subject, span: Some(span_in(run, stream)), found }
}

/// First and last stamp of a stream.
fn span_of(run: &Run, stream: usize) -> Option<Span> {
    let stream = run.streams.get(stream)?;
    Some(Span { start: stream.start?, end: stream.end? })
}

/// First and last stamp of a stream, else of the run.
fn span_in(run: &Run, stream: usize) -> Span {
    span_of(run, stream).unwrap_or_else(|| {
        let (start, end) = run.span.unwrap_or((run.origin, run.origin));
        Span { start, end }
    })
}
