//! One run: the role of each topic, the arms, and the frames between them.
//!
//! [`Run::assemble`] prepares the estimators' input from decoded data. Pose streams whose name and frames
//! leave their role open are [`Role::Candidate`]s until the motion decides ([`Run::complete`]). Without an
//! arm or model, streams, clocks and transforms are still audited, and [`Run::no_arm`] gives the reason.

mod arm;
mod assemble;
mod cadence;
mod catalogue_selection;
mod clock;
mod columns;
mod declaration;
mod error;
mod excerpts;
mod frozen;
mod given_calibrations;
mod joint_order;
mod joints;
mod model;
mod models;
mod namespace;
mod norm_defects;
mod not_audited;
mod objects;
mod outliers;
mod part_series;
mod periodic;
mod pose_distance;
mod poses;
mod publishers;
mod repeated;
mod resolve;
mod role;
mod rounded;
mod rows;
mod sample_filter;
mod seams;
mod segments;
mod set_back;
mod shared_stream;
mod skeleton;
mod source_kind;
mod sources;
mod stale;
mod stale_end;
mod streams;
mod table_clocks;
mod targets;
#[cfg(test)]
mod tests;
mod tf_error;
mod tf_problems;
mod tf_tree;
mod tick_grid;
mod timing;
mod topics;
mod trajectory;
mod unwrap;
mod velocities;
mod vibration;
mod zero_rows;

use std::sync::Arc;

use crate::diagnosis::{PoseStream, ToolSwitching};
use crate::finding::rounded;
use crate::robot::RobotError;
use crate::time::{Clock, Stamp};

pub use arm::{Arm, CoupledColumn, JointStateCorrection, TfUnavailable};
pub(crate) use assemble::{MAX_TOOL_M, MIN_RESIDUAL_RATIO};
pub use assemble::{ReferenceContent, ReferenceSource};
pub use cadence::{Cadence, MissingRows, RateSpan, Rhythm, StreamExtent};
pub use clock::{Alignment, Epoch, HeaderStamps, StreamClock};
pub use columns::{SharedColumns, SharedMapping, SharedRow, identify_columns, selectors};
pub use declaration::{CalibrationSource, Declaration, DeclarationError, JointName, RobotSource};
pub use error::RunError;
pub use excerpts::Excerpts;
pub use frozen::FrozenSpan;
pub use joints::{JointSamples, JointSource};
pub use model::CompetingModel;
pub use models::load_robot;
pub use norm_defects::{NormDefects, RotationStorage};
pub use not_audited::{NotAudited, NotAuditedReason};
pub use outliers::{MIN_OUTLIER_SAMPLES, Outliers, outlier_count};
pub use pose_distance::PoseDistance;
pub use publishers::TwoPublishers;
pub use repeated::RepeatedValues;
pub(crate) use resolve::{common_diagnosis_count, realign_moving_bases};
pub use role::{Role, named_encodings};
pub(crate) use role::{is_of_camera, is_outside_arm, unnamed_poses};
pub use rounded::RoundedStamps;
pub use sample_filter::SampleFilter;
pub use segments::{Cut, Segment, segments};
pub use shared_stream::{CandidateArm, SharedStream};
pub use source_kind::PoseSourceKind;
pub(crate) use source_kind::source_of_column;
pub use sources::MovingBase;
pub use sources::{ImuSource, PoseSource};
pub use stale::JointLeap;
pub use streams::Stream;
pub(crate) use streams::{tf_topics, with_key};
pub use table_clocks::align_table_clocks;
pub use targets::{CameraAxes, HandKind, HandSource, TargetSource};
pub use tf_error::TfError;
pub use tf_problems::{FramePair, TfProblem, TfProblemKind};
pub use tf_tree::{Edge, EdgeKind, TfPath, TfTree};
pub use topics::{RoleSetting, TopicSettings};
pub use trajectory::Trajectory;
pub(crate) use trajectory::are_of_one_body;
pub use unwrap::WrappedJoint;
pub use velocities::VelocitySource;

/// Minimum speed correlation of a stream that follows the arm.
const MIN_FOLLOWER_CORRELATION: f64 = 0.7;

/// Same if its frame suggests a tool pose. Lower, because faulty clocks or conventions reduce it.
const MIN_PRESUMED_CORRELATION: f64 = 0.4;

/// The caller's options for a run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Robots; if empty, from the log, then the catalogue.
    pub robots: Vec<RobotSource>,
    /// Calibrations of URs; if empty, from the log.
    pub calibrations: Vec<CalibrationSource>,
    /// Base link.
    pub base: Option<String>,
    /// Tip link.
    pub tip: Option<String>,
    /// Topic whose poses the others are compared with, without joint states.
    pub reference: Option<String>,
    /// Clock of the messages.
    pub stamp: Clock,
    /// Maximum stamp difference of a stream from the others, s; beyond it, it uses another clock.
    pub max_latency_s: f64,
    /// Model names of joints named differently.
    pub joint_map: Vec<JointName>,
    /// Declared encodings of streams.
    pub declared: Vec<Declaration>,
    /// Other settings for single topics.
    pub topics: Vec<TopicSettings>,
    /// Robot and columns from other logs of the dataset.
    pub shared: Option<SharedMapping>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            robots: Vec::new(),
            calibrations: Vec::new(),
            joint_map: Vec::new(),
            base: None,
            tip: None,
            reference: None,
            stamp: Clock::Header,
            max_latency_s: 5.0,
            declared: Vec::new(),
            topics: Vec::new(),
            shared: None,
        }
    }
}

/// One run, ready for diagnosis.
#[derive(Debug)]
pub struct Run {
    /// Zero of times in seconds: first stamp of the joint states, else of all streams.
    pub origin: Stamp,
    /// First and last stamp on the audit's clock.
    pub span: Option<(Stamp, Stamp)>,
    /// Topics in log order, then transforms that are measured poses.
    pub streams: Vec<Stream>,
    /// The arms.
    pub arms: Vec<Arm>,
    /// Camera targets with candidate hands.
    pub targets: Vec<TargetSource>,
    /// Encodings that the caller declares.
    pub declared: Vec<Declaration>,
    /// Commands to the arms (reference inputs, not frames).
    pub references: Vec<ReferenceSource>,
    /// All frames and transforms.
    pub tf: Arc<TfTree>,
    /// Clocks of the stamped streams, sorted by stream.
    pub clocks: Vec<StreamClock>,
    /// Streams with rounded stamps, restored from row order; sorted by stream.
    pub rounded: Vec<RoundedStamps>,
    /// Regularity of streams with a role.
    pub rhythms: Vec<Rhythm>,
    /// TF problems.
    pub tf_problems: Vec<TfProblem>,
    /// Joints logged modulo one turn, now unwrapped.
    pub wrapped: Vec<WrappedJoint>,
    /// Norm defects of quaternions and matrices, sorted by stream.
    pub norm_defects: Vec<NormDefects>,
    /// Streams that may belong to several arms.
    pub shared_streams: Vec<SharedStream>,
    /// Streams not audited, or only in part.
    pub not_audited: Vec<NotAudited>,
    /// Streams that lead the arm, and the lead, s: commands, or tool poses with late joint states.
    pub leaders: Vec<(usize, f64)>,
    /// Candidates unassigned because neither frame nor motion decides.
    pub undecided: Vec<usize>,
    /// Samples excluded from estimation.
    pub sample_filter: SampleFilter,
    /// Frozen spans while the arm moved, also excluded.
    pub frozen: Vec<FrozenSpan>,
    /// Streams that were searched for frozen spans.
    pub searched_for_frozen: Vec<usize>,
    /// Streams alternating between rigid bodies on the tool, converted to the main body.
    pub tool_switching: Vec<(usize, ToolSwitching)>,
    /// Excerpts for estimation; `None` if all is used.
    pub excerpts: Option<Excerpts>,
    /// Whether `/clock` indicates simulated time.
    pub has_clock_topic: bool,
    /// Why there is no arm.
    pub no_arm: Option<RunError>,
    /// Unreadable required robot descriptions, with the errors.
    pub unreadable: Vec<(String, RobotError)>,
}

/// Standard error of receive times, s: transport delays vary by about a millisecond.
const TRANSPORT_STD_ERROR_S: f64 = 1e-3;

impl Run {
    /// Pose source as diagnosis input.
    pub fn pose_stream<'a>(&self, source: &'a PoseSource) -> PoseStream<'a> {
        let mut clocks = self.clocks_of(source.stream).iter();
        let uses_receive_times = clocks.any(|clock| clock.stamps != HeaderStamps::Sound);
        PoseStream {
            stamp_error_s: source.stamp_error_s.max(if uses_receive_times {
                TRANSPORT_STD_ERROR_S
            } else {
                0.0
            }),
            ..source.as_stream()
        }
    }

    /// Clocks of a stream; a TF topic may have several.
    pub fn clocks_of(&self, stream: usize) -> &[StreamClock] {
        with_key(&self.clocks, stream, |clock| clock.stream)
    }

    /// Stream indices of the candidates.
    pub fn candidates(&self) -> impl Iterator<Item = usize> + '_ {
        let is_candidate =
            |index: &usize| matches!(self.streams[*index].role, Role::Candidate { .. });
        (0..self.streams.len()).filter(is_candidate)
    }

    /// Replaces an arm by one with another model, also in the chains of the targets' hands.
    pub(crate) fn replace_arm(&mut self, index: usize, arm: Arm) {
        for hand in self.targets.iter_mut().flat_map(|target| &mut target.hands) {
            let HandKind::Joints { arm: hand_arm, chain, .. } = &mut hand.kind else { continue };
            if *hand_arm == index
                && let Some(new_chain) = arm::same_chain(&arm.robot, chain)
            {
                *chain = new_chain;
            }
        }
        self.arms[index] = arm;
    }

    /// Makes `stream`, which has no arm, the hand pose for the target on `topic`: their angular speeds
    /// correlate.
    pub fn resolve_hand(&mut self, stream: usize, topic: &str, correlation: f64) {
        let Some(resolved) = self.streams.get_mut(stream) else { return };
        if resolved.role == Role::Unassigned {
            resolved.role = Role::Pose;
            resolved.reason = format!(
                "it rotates with the target on '{topic}' (angular speed correlation {correlation:.2})"
            );
        }
    }

    /// Decides whether candidate `stream` is a tool pose. `peak` is its highest speed correlation with the
    /// arm, 0 to 1, or `None` if the motion does not decide. `follows_otherwise`: it follows if the joint states are
    /// interpreted otherwise.
    ///
    /// A rejected candidate becomes a command or camera target if its name says so, else unassigned. Its
    /// sources remain until [`Run::remove_rejected`].
    pub(crate) fn resolve_candidate(
        &mut self,
        stream: usize,
        peak: Option<f64>,
        follows_otherwise: bool,
    ) {
        let Some(resolved) = self.streams.get_mut(stream) else { return };
        let Role::Candidate { presumed } = resolved.role else { return };
        let is_compared = |arm: &Arm| {
            arm.trajectory.as_ref().is_some_and(|trajectory| trajectory.others.contains(&stream))
        };
        let reference = self.arms.iter().find(|arm| is_compared(arm));
        let of = reference.map_or("the arm".to_owned(), |arm| format!("'{}'", arm.name));
        let (is_pose, verdict) = match peak {
            _ if follows_otherwise => {
                (true, format!("it follows {of} if the joint states are interpreted otherwise"))
            }
            Some(peak)
                if peak >= MIN_FOLLOWER_CORRELATION
                    || (reference.is_some() && peak >= MIN_PRESUMED_CORRELATION) =>
            {
                (true, format!("it follows {of} (speed correlation {peak:.2})"))
            }
            Some(peak) if presumed && peak >= MIN_PRESUMED_CORRELATION => {
                (true, format!("its motion is consistent with that (speed correlation {peak:.2})"))
            }
            // Joints in a wrong order or with wrong signs move otherwise.
            Some(peak)
                if presumed
                    && (role::is_driver_topic(&resolved.topic)
                        || role::is_driver_frame(&resolved.child_frame_id)) =>
            {
                (
                    true,
                    format!("as recorded, it does not follow {of} (speed correlation {peak:.2})"),
                )
            }
            Some(peak) => (
                false,
                format!(
                    "it does not follow {of} (speed correlation {}, below {MIN_FOLLOWER_CORRELATION})",
                    rounded(peak, 2)
                ),
            ),
            None if presumed => (true, "the motion neither confirms nor refutes it".to_owned()),
            None => (false, format!("the motion does not show whether it follows {of}")),
        };
        resolved.role = if is_pose { Role::Pose } else { Role::Unassigned };
        resolved.reason = format!("{}; {verdict}", resolved.reason);
        if peak.is_none() && !is_pose {
            self.undecided.push(stream);
        }
        if is_pose {
            // By name, it may also have been a camera target or a command.
            self.targets.retain(|target| target.stream != stream);
            self.references.retain(|reference| reference.stream != stream);
        } else {
            let reason = resolved.reason.clone();
            self.assign_role_by_name(stream, reason);
        }
    }

    /// Clears the role of a stream. Its topic name may still make it a command or camera target.
    pub(crate) fn assign_role_by_name(&mut self, stream: usize, reason: String) {
        self.clear_role(stream, reason);
        let is_target = self.targets.iter().any(|target| target.stream == stream);
        let Some(resolved) = self.streams.get_mut(stream) else { return };
        let role = role::role_outside_arm(&resolved.topic);
        if role != Role::Target || is_target {
            resolved.role = role;
        }
    }

    /// Excludes poses that are FK of the commands on these topics.
    pub(crate) fn exclude_commanded_poses(&mut self, poses: Vec<(usize, String)>) {
        self.remove_sources(&poses.iter().map(|(stream, _)| *stream).collect());
        for (stream, commands) in poses {
            let reason = format!(
                "{}; FK of the commands on {commands}, not of the joint states, explains it",
                self.streams[stream].reason
            );
            self.clear_role(stream, reason);
        }
    }

    /// Makes candidate `stream` a command: it leads the arm by `lead_s`. Its sources remain until
    /// [`Run::remove_rejected`].
    pub(crate) fn resolve_leader(&mut self, stream: usize, lead_s: f64) {
        let Some(resolved) = self.streams.get(stream) else { return };
        let reason = format!(
            "{}; it leads the arm: received {:.0} ms before the arm made the same motion, like a command \
             (hand tracker, leader arm), or because the joint states are recorded late",
            resolved.reason,
            1e3 * lead_s
        );
        self.clear_role(stream, reason);
        if let Some(leader) = self.streams.get_mut(stream) {
            leader.role = Role::Reference;
        }
        self.leaders.push((stream, lead_s));
    }
}
