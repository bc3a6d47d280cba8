//! One run: the role of each topic, the arms, and the frames between them.
//!
//! [`Run::assemble`] converts decoded data to the input of the estimators: joint states on one time grid,
//! pose and IMU streams with the chains that predict them, interpolated transforms, and all streams on one
//! clock. The name does not always determine the role of a pose stream. Such streams are
//! [`Role::Candidate`]s until the motion shows whether they follow the arm ([`Run::complete`]).
//!
//! A log without an arm or without its model is not an error: its streams, clocks and transforms are still
//! audited, and [`Run::no_arm`] gives the reason.

mod arm;
mod assemble;
mod by_order;
mod cadence;
mod calibrations;
mod catalogued;
mod clock;
mod columns;
mod declaration;
mod error;
mod excerpts;
mod frozen;
mod grid;
mod joints;
mod model;
mod models;
mod moving_base;
mod norms;
mod outliers;
mod periodic;
mod pose_distance;
mod poses;
mod publishers;
mod repeated;
mod role;
mod rounded;
mod rows;
mod sample_filter;
mod segments;
mod series;
mod settle;
mod shared_stream;
mod skeleton;
mod source_kind;
mod sources;
mod space;
mod stale;
mod streams;
mod targets;
#[cfg(test)]
mod tests;
mod tf_error;
mod tf_problems;
mod tf_tree;
mod timing;
mod topics;
mod unaudited;
mod unwrap;
mod velocities;

use std::sync::Arc;

use crate::diagnosis::{PoseStream, ToolSwitching};
use crate::finding::rounded;
use crate::robot::RobotError;
use crate::time::{Clock, Stamp};

pub use arm::{Arm, JointStateCorrection, TfUnavailable};
pub use assemble::{ReferenceContent, ReferenceSource};
pub use cadence::{Cadence, Extent, Hole, Rhythm, Stretch};
pub use clock::{Alignment, Epoch, HeaderStamps, StreamClock};
pub use columns::{Shared, SharedColumns, SharedRow, identify_columns, selectors};
pub use declaration::{CalibrationSource, Declaration, DeclarationError, JointName, RobotSource};
pub use error::RunError;
pub use excerpts::Excerpts;
pub use frozen::Frozen;
pub use joints::{JointFacts, JointSamples};
pub use model::CompetingModel;
pub use models::robot_of;
pub use norms::{Norms, Written};
pub use outliers::{FEWEST_SAMPLES, Outliers};
pub use pose_distance::PoseDistance;
pub use publishers::Publishers;
pub use repeated::RepeatedValues;
pub use role::Role;
pub use rounded::RoundedStamps;
pub use sample_filter::SampleFilter;
pub use segments::{Segment, segments};
pub(crate) use settle::{realign_moving_bases, together};
pub use shared_stream::{CandidateArm, SharedStream};
pub use source_kind::PoseSourceKind;
pub use sources::MovingBase;
pub use sources::{ImuSource, PoseSource};
pub use streams::Stream;
pub use targets::{CameraAxes, HandKind, HandSource, TargetSource};
pub use tf_error::TfError;
pub use tf_problems::{FramePair, TfProblem, TfProblemKind};
pub use tf_tree::{Edge, EdgeKind, TfPath, TfTree};
pub use topics::{RoleSetting, TopicSettings};
pub use unaudited::{NotAudited, NotAuditedReason};
pub use unwrap::WrappedJoint;
pub use velocities::Velocities;

/// Minimum correlation of speeds for a stream that follows the arm.
const FOLLOWS: f64 = 0.7;

/// Correlation of speeds below which a stream does not follow the arm, whatever its frame. Less than
/// [`FOLLOWS`], because a faulty clock or convention also lowers it.
const CONTRADICTS: f64 = 0.4;

/// The caller's options for a run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// Robots of the run. If empty, they come from the log, then from the catalogue.
    pub robots: Vec<RobotSource>,
    /// Calibrations of its URs. If empty, the log may contain one.
    pub calibrations: Vec<CalibrationSource>,
    /// Base link.
    pub base: Option<String>,
    /// Tip link.
    pub tip: Option<String>,
    /// Clock of the messages.
    pub stamp: Clock,
    /// Maximum difference between the stamps of a stream and the others, s; beyond it, the stream uses
    /// another clock.
    pub max_latency_s: f64,
    /// Model names of joints that have different names in the log.
    pub joint_map: Vec<JointName>,
    /// Declared encodings of streams.
    pub declared: Vec<Declaration>,
    /// Other settings for single topics.
    pub topics: Vec<TopicSettings>,
    /// Robot and columns determined from other logs of the same dataset.
    pub shared: Option<Shared>,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            robots: Vec::new(),
            calibrations: Vec::new(),
            joint_map: Vec::new(),
            base: None,
            tip: None,
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
    /// Zero of times in seconds: the first stamp of the joint states or, without any, of all streams.
    pub origin: Stamp,
    /// First and last stamp of all streams, on the audit's clock.
    pub span: Option<(Stamp, Stamp)>,
    /// All topics in the order of the log, then transforms of TF topics that are measured poses.
    pub streams: Vec<Stream>,
    /// The arms.
    pub arms: Vec<Arm>,
    /// Camera targets, with the hands that they can be compared with.
    pub targets: Vec<TargetSource>,
    /// Commands to the arms.
    pub references: Vec<ReferenceSource>,
    /// The frames of all arms, and the transforms between them.
    pub tf: Arc<TfTree>,
    /// Clock of every stream with time stamps.
    pub clocks: Vec<StreamClock>,
    /// Streams with rounded stamps that were restored from the row order.
    pub rounded: Vec<RoundedStamps>,
    /// Regularity of every stream with a role.
    pub rhythms: Vec<Rhythm>,
    /// TF problems.
    pub tf_problems: Vec<TfProblem>,
    /// Joints that are logged modulo one turn; their positions are unwrapped.
    pub wrapped: Vec<WrappedJoint>,
    /// Norm defects of all streams with quaternions or matrices.
    pub norms: Vec<Norms>,
    /// Streams that may belong to several arms.
    pub shared_streams: Vec<SharedStream>,
    /// Streams that are not audited, or only in part.
    pub unaudited: Vec<NotAudited>,
    /// Streams that lead the arm, with their lead in seconds: commands, or tool poses with late joint
    /// states.
    pub leaders: Vec<(usize, f64)>,
    /// Candidate tool poses that the motion neither confirms nor rejects.
    pub undecided: Vec<usize>,
    /// Samples excluded from estimation: outliers, second publishers, repeats.
    pub sample_filter: SampleFilter,
    /// Spans of frozen poses while the arm moved, and of frozen joint states in motion; also excluded from
    /// estimation.
    pub frozen: Vec<Frozen>,
    /// Streams that were searched for frozen spans.
    pub watched: Vec<usize>,
    /// Streams whose poses alternate between several rigid bodies on the tool; their poses are converted to
    /// those of the main body.
    pub alternations: Vec<(usize, ToolSwitching)>,
    /// Excerpts used for estimation; `None` if the whole run is used.
    pub excerpts: Option<Excerpts>,
    /// Whether the log contains `/clock`, which indicates simulated time.
    pub has_clock_topic: bool,
    /// Why there is no arm.
    pub no_arm: Option<RunError>,
    /// Sources of required robot descriptions that cannot be read, with the errors.
    pub unreadable: Vec<(String, RobotError)>,
}

/// Standard error of receive times, s, for a stream without header stamps: transport delays vary by about a
/// millisecond.
const TRANSPORT_S: f64 = 1e-3;

impl Run {
    /// Converts a pose source to the input of the diagnosis.
    pub fn pose_stream<'a>(&self, source: &'a PoseSource) -> PoseStream<'a> {
        let mut clocks = self.clocks.iter().filter(|clock| clock.stream == source.stream);
        let received = clocks.any(|clock| clock.stamps != HeaderStamps::Sound);
        PoseStream {
            track: &source.track,
            chain: &source.chain,
            columns: &source.columns,
            reference_known: source.reference_known,
            stamp_error_s: source.stamp_error_s.max(if received { TRANSPORT_S } else { 0.0 }),
            stamps_copied: source.stamps_copied,
            removed_ramp: None,
        }
    }

    /// Stream indices of the candidates.
    pub fn candidates(&self) -> impl Iterator<Item = usize> + '_ {
        let is_candidate =
            |index: &usize| matches!(self.streams[*index].role, Role::Candidate { .. });
        (0..self.streams.len()).filter(is_candidate)
    }

    /// Replaces arm `index` by `arm`, and updates the chains of its hands.
    pub(crate) fn replace_arm(&mut self, index: usize, arm: Arm) {
        for hand in self.targets.iter_mut().flat_map(|target| &mut target.hands) {
            let HandKind::Joints { arm: of, chain, .. } = &mut hand.kind else { continue };
            let robot = &arm.robot;
            let link = |name: &str| robot.link(name);
            let ends = link(chain.base_name()).zip(link(chain.tip_name()));
            let anew = ends.and_then(|(base, tip)| robot.chain(base, tip).ok());
            if let (true, Some(anew)) = (*of == index, anew) {
                *chain = anew;
            }
        }
        self.arms[index] = arm;
    }

    /// Makes `stream`, which belongs to no arm, the hand pose for the target on `topic`: their angular
    /// speeds correlate.
    pub fn resolve_hand(&mut self, stream: usize, topic: &str, correlation: f64) {
        let Some(settled) = self.streams.get_mut(stream) else { return };
        if settled.role == Role::Unassigned {
            settled.role = Role::Pose;
            settled.reason = format!(
                "it rotates with the target on '{topic}' (angular speed correlation {correlation:.2})"
            );
        }
    }

    /// Decides whether candidate `stream` is a tool pose. `peak` is the highest correlation of its speeds
    /// with the arm's, from 0 to 1, or `None` if the motion does not determine it.
    ///
    /// A rejected candidate is unassigned with the reason. A stream that is not a candidate keeps its role.
    pub fn settle(&mut self, stream: usize, peak: Option<f64>) {
        let Some(settled) = self.streams.get_mut(stream) else { return };
        let Role::Candidate { presumed } = settled.role else { return };
        let (is_pose, verdict) = match peak {
            Some(peak) if peak >= FOLLOWS => {
                (true, format!("it follows the arm (speed correlation {peak:.2})"))
            }
            Some(peak) if presumed && peak >= CONTRADICTS => {
                (true, format!("its motion is consistent with that (speed correlation {peak:.2})"))
            }
            Some(peak) => (
                false,
                format!(
                    "it does not follow the arm (speed correlation {}, below {FOLLOWS})",
                    rounded(peak, 2)
                ),
            ),
            None if presumed => (true, "the motion neither confirms nor refutes it".to_owned()),
            None => (false, "the motion does not show whether it follows the arm".to_owned()),
        };
        settled.role = if is_pose { Role::Pose } else { Role::Unassigned };
        settled.reason = format!("{}; {verdict}", settled.reason);
        if peak.is_none() && !is_pose {
            self.undecided.push(stream);
        }
        if is_pose {
            self.targets.retain(|target| target.stream != stream);
            self.references.retain(|reference| reference.stream != stream);
        } else {
            let reason = settled.reason.clone();
            self.settle_by_name(stream, reason);
        }
    }

    /// Assigns the role of its name to candidate `stream`, which is not a tool pose.
    pub(crate) fn settle_by_name(&mut self, stream: usize, reason: String) {
        self.unassign(stream, reason);
        let Some(settled) = self.streams.get_mut(stream) else { return };
        settled.role = role::beside_arm(&settled.topic);
    }

    /// Makes candidate `stream` a command: it leads the arm by `lead_s`.
    pub fn resolve_leader(&mut self, stream: usize, lead_s: f64) {
        let Some(settled) = self.streams.get(stream) else { return };
        let reason = format!(
            "{}; it leads the arm: received {:.0} ms before the arm made the same motion, like a command \
             (hand tracker, leader arm), or because the joint states are recorded late",
            settled.reason,
            1e3 * lead_s
        );
        self.unassign(stream, reason);
        if let Some(leader) = self.streams.get_mut(stream) {
            leader.role = Role::Reference;
        }
        self.leaders.push((stream, lead_s));
    }
}
