//! Evidence: everything estimated and counted in a run, per stream, for the rules to judge. Each family of
//! streams has a file.

mod arm;
mod commanded_poses;
mod commands;
mod estimate;
mod hand_eye;
mod joint_axes;
mod joint_clock;
mod joint_stamps;
mod joint_topics;
mod joints;
mod poses;
mod samples;
mod streams;
mod topics;
mod unmodelled;
mod vibration;

use std::ops::{Deref, DerefMut};

use crate::finding::{Span, Subject};
use crate::log::{self, Loss, Note, Repeat};
use crate::run::{Arm, FrozenSpan, NormDefects, NotAudited, NotAuditedReason, Run, RunOptions};
use crate::time::Stamp;

pub use arm::ArmEvidence;
pub use commands::{ReferenceEvidence, TipPoseKind, TipPoseSource, UnmodelledCommands};
pub use estimate::DhEvidence;
pub use hand_eye::HandEyeEvidence;
pub use joint_axes::{JointAxes, Tolerance};
pub use joint_stamps::{HiddenPauses, JointStamps, Resampling};
pub use joints::{JointEvidence, JointMotion, WrappedRange};
pub use poses::{DeclaredUnits, EulerEvidence, ImuEvidence, LateTransforms, PoseEvidence};
pub use samples::{OutlierEvidence, RepeatedValueEvidence, UnusableSampleEvidence};
pub(crate) use streams::frame_of_several;
pub use streams::{ExpectedTiming, RhythmEvidence, StampEvidence};
pub use topics::{
    EmptyStreamEvidence, RepeatedColumnEvidence, RepeatedColumnKind, TfEvidence,
    UndecodableContent, UndecodableTopic,
};
pub use vibration::VibrationEvidence;

/// All evidence about one run.
#[derive(Clone, Debug, Default)]
pub struct RunEvidence {
    /// Robots with a model.
    pub robots: Vec<ArmEvidence>,
    /// Joint states of arms without a model; empty if the log cannot be audited without one.
    pub unmodelled_arms: Vec<ArmEvidence>,
    /// Why there is no robot.
    pub no_robot: Option<String>,
    /// What to do about it.
    pub no_robot_remedy: &'static str,
    /// Joint commands, without a robot.
    pub unmodelled_commands: Vec<StreamEvidence<UnmodelledCommands>>,
    /// Targets seen by cameras.
    pub hand_eyes: Vec<HandEyeEvidence>,
    /// Stream stamps.
    pub stamps: Vec<StreamEvidence<StampEvidence>>,
    /// Unusable samples.
    pub unusable: Vec<StreamEvidence<UnusableSampleEvidence>>,
    /// Message rhythms.
    pub rhythms: Vec<StreamEvidence<RhythmEvidence>>,
    /// TF topics and their problems.
    pub tf: TfEvidence,
    /// Deviation from rotations, if those have more than three numbers.
    pub norms: Vec<StreamEvidence<Vec<NormDefects>>>,
    /// Outliers of joint states, tool poses and transforms.
    pub outliers: Vec<StreamEvidence<OutlierEvidence>>,
    /// Frozen intervals of streams compared with the arm.
    pub frozen_intervals: Vec<StreamEvidence<Vec<FrozenSpan>>>,
    /// Streams that repeat values with new stamps.
    pub repeated_values: Vec<StreamEvidence<RepeatedValueEvidence>>,
    /// Streams that are, or are declared, joint states or tool poses, and why they are not audited.
    pub not_audited: Vec<StreamEvidence<Vec<NotAuditedReason>>>,
    /// Pose streams that lead the arm, with the lead, s.
    pub leading_streams: Vec<StreamEvidence<f64>>,
    /// Relevant topics without finite numbers.
    pub empty_streams: Vec<EmptyStreamEvidence>,
    /// Missing topics with the place of declaration.
    pub missing_topics: Vec<(Subject, String)>,
    /// First stamp.
    pub start: Option<Stamp>,
    /// Origin of times in seconds.
    pub origin: Stamp,
    /// The log contains `/clock`: simulation.
    pub simulated: bool,
    /// Damage to the files.
    pub losses: Vec<Loss>,
    /// Relevant undecodable topics.
    pub undecodable: Vec<UndecodableTopic>,
    /// Contradictions between metadata and numbers. `None` if nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// Duplicate or constant columns. `None` without tables.
    pub repeated_columns: Option<Vec<RepeatedColumnEvidence>>,
}

impl RunEvidence {
    /// Collects the evidence. Replaces arms whose DH table uses the undeclared convention.
    pub fn collect(run: &mut Run, lost: &ReadLosses, options: &RunOptions) -> Self {
        let max_lag_s = options.max_latency_s;
        let diagnoses = estimate::diagnose(run, max_lag_s);
        let run = &*run;
        let joints = |arm: usize| estimate::readable_joints(&run.arms[arm], &diagnoses[arm].arm);
        let hand_eyes = hand_eye::hand_eyes(run, joints, max_lag_s);
        let never_set = run
            .arms
            .iter()
            .zip(&diagnoses)
            .flat_map(|(arm, found)| topics::unset(run, arm, &found.arm));
        let never_set = never_set.chain(topics::joints_never_set(run));
        let unset: Vec<NotAudited> = never_set.chain(topics::in_other_frames(run)).collect();
        let arms = diagnoses.into_iter().enumerate();
        let unmodelled_commands = commands::unmodelled_commands(run, max_lag_s);
        let robots =
            arms.map(|(index, diagnosis)| arm::arm_evidence(run, index, diagnosis, options));
        Self {
            robots: robots.collect(),
            unmodelled_arms: unmodelled::unmodelled_arms(run, &unmodelled_commands),
            no_robot: run.no_arm.as_ref().map(|error| error.what()),
            no_robot_remedy: run.no_arm.as_ref().map_or("", |error| error.remedy()),
            unmodelled_commands,
            hand_eyes,
            stamps: streams::stamps(run),
            unusable: samples::unusable(run),
            rhythms: streams::rhythms(run, &unset),
            tf: topics::tf(run),
            norms: samples::norms(run),
            outliers: samples::outliers(run),
            frozen_intervals: samples::frozen_intervals(run),
            repeated_values: samples::repeated_values(run),
            not_audited: topics::not_audited(run, &unset),
            leading_streams: run
                .leaders
                .iter()
                .map(|&(stream, lead_s)| stream_evidence(run, stream, lead_s))
                .collect(),
            empty_streams: topics::empty_streams(run),
            missing_topics: topics::missing(run, &options.topics),
            start: run.span.map(|(start, _)| start),
            origin: run.origin,
            simulated: run.has_clock_topic,
            losses: lost.losses.clone(),
            undecodable: topics::undecodable(run, &lost.undecodable),
            contradictions: lost.contradictions.clone(),
            repeated_columns: topics::repeated_columns(run, lost.repeats.as_deref()),
        }
    }

    /// Number of streams and joints, for the multiple-comparison correction of intervals.
    pub fn subjects(&self) -> usize {
        let of_robots: usize = self.arms_with_or_without_model().map(ArmEvidence::subjects).sum();
        (of_robots + self.hand_eyes.len()).max(1)
    }

    /// Whether messages within the files are lost, so gaps may be the recording's fault.
    pub fn lost_messages(&self) -> bool {
        self.losses.iter().any(|loss| loss.extent >= log::Extent::Messages)
    }

    /// A stamp as seconds from the start.
    pub fn moment(&self, stamp: Stamp) -> String {
        format!("+{:.2} s", stamp.seconds_since(self.start.unwrap_or(stamp)))
    }

    /// A time in seconds from the origin, as seconds from the start.
    pub fn moment_at(&self, at_s: f64) -> String {
        self.moment(self.origin.shifted(at_s))
    }

    /// Every robot, and the joint states of arms without a model.
    pub fn arms_with_or_without_model(&self) -> impl Iterator<Item = &ArmEvidence> {
        self.robots.iter().chain(&self.unmodelled_arms)
    }

    /// Every pose stream with its robot.
    pub fn poses(&self) -> impl Iterator<Item = (&ArmEvidence, &StreamEvidence<PoseEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.poses.iter().map(move |stream| (arm, stream)))
    }

    /// Every pose stream and /tf with its robot.
    pub fn poses_and_tf(
        &self,
    ) -> impl Iterator<Item = (&ArmEvidence, &StreamEvidence<PoseEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.poses_and_tf().map(move |stream| (arm, stream)))
    }

    /// Every IMU with its robot.
    pub fn imus(&self) -> impl Iterator<Item = (&ArmEvidence, &StreamEvidence<ImuEvidence>)> {
        self.robots.iter().flat_map(|arm| arm.imus.iter().map(move |imu| (arm, imu)))
    }
}

/// Evidence about a stream.
#[derive(Clone, Debug)]
pub struct StreamEvidence<T> {
    /// The stream.
    pub subject: Subject,
    /// First and last stamp used.
    pub span: Option<Span>,
    /// The evidence.
    pub value: T,
}

impl<T> StreamEvidence<T> {
    /// Topic of the stream.
    pub fn topic(&self) -> &str {
        self.subject.topic.as_deref().unwrap_or_default()
    }

    /// Length of the span, s; 0 without one.
    pub fn seconds(&self) -> f64 {
        self.span.map_or(0.0, |span| span.seconds())
    }

    pub(crate) fn with_value<U>(&self, value: U) -> StreamEvidence<U> {
        StreamEvidence { subject: self.subject.clone(), span: self.span, value }
    }
}

impl<T> Deref for StreamEvidence<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for StreamEvidence<T> {
    fn deref_mut(&mut self) -> &mut T {
        &mut self.value
    }
}

/// Data lost or rejected while reading.
#[derive(Clone, Debug, Default)]
pub struct ReadLosses {
    /// Damage to the files.
    pub losses: Vec<Loss>,
    /// Relevant undecodable topics.
    pub undecodable: Vec<UndecodableTopic>,
    /// Contradictions between metadata and numbers. `None` if nothing is declared.
    pub contradictions: Option<Vec<Note>>,
    /// Duplicate or constant columns. `None` without tables.
    pub repeats: Option<Vec<Repeat>>,
}

fn stream_evidence<T>(run: &Run, index: usize, value: T) -> StreamEvidence<T> {
    let stream = &run.streams[index];
    let arm = stream.arm.and_then(|arm| run.arms.get(arm));
    let subject = Subject {
        robot: arm.filter(|arm| arm.trajectory.is_none()).map(|arm| arm.name.clone()),
        topic: Some(stream.topic.clone()),
        frame: frame_of_several(stream),
        ..Subject::default()
    };
    StreamEvidence { subject, span: stream_span(run, index), value }
}

/// The subject has no frame.
fn arm_stream_evidence<T>(run: &Run, arm: &Arm, stream: usize, value: T) -> StreamEvidence<T> {
    let topic = |stream: usize| Some(run.streams[stream].topic.clone());
    let (robot, reference) = match &arm.trajectory {
        Some(trajectory) => (None, topic(trajectory.stream)),
        None => (Some(arm.name.clone()), None),
    };
    let subject = Subject { robot, reference, topic: topic(stream), ..Subject::default() };
    StreamEvidence { subject, span: Some(span_or_run(run, stream)), value }
}

fn stream_span(run: &Run, stream: usize) -> Option<Span> {
    let stream = run.streams.get(stream)?;
    Some(Span { start: stream.start?, end: stream.end? })
}

/// Span of a stream; otherwise of the run.
fn span_or_run(run: &Run, stream: usize) -> Span {
    stream_span(run, stream).unwrap_or_else(|| {
        let (start, end) = run.span.unwrap_or((run.origin, run.origin));
        Span { start, end }
    })
}
