//! One run: which part each topic plays and why, the arms in it, and the frames between them.
//!
//! [`Run::assemble`] turns what was decoded into what the estimators need: joint states on one time
//! grid, pose and IMU streams with the chains that predict them, transforms with interpolation, and
//! every stream on one clock. What a stream is cannot always be told from its name: such streams are
//! [`Role::Candidate`]s until the motion tells whether they follow the arm ([`Run::complete`]).
//!
//! A log without an arm, or without a model of it, is no error here: its streams, clocks and
//! transforms can still be audited, and [`Run::no_arm`] says what is missing.

mod apart;
mod arm;
mod assemble;
mod by_order;
mod cadence;
mod calibrations;
mod carrier;
mod catalogued;
mod clock;
mod columns;
mod contest;
mod declaration;
mod error;
mod excerpts;
mod flaws;
mod frozen;
mod grid;
mod held;
mod joints;
mod model;
mod models;
mod norms;
mod poses;
mod publishers;
mod role;
mod rounded;
mod rows;
mod segments;
mod series;
mod settle;
mod sift;
mod skeleton;
mod sources;
mod space;
mod stalled;
mod strays;
mod streams;
mod targets;
#[cfg(test)]
mod tests;
mod tf_error;
mod tf_tree;
mod timing;
mod topics;
mod trains;
mod unaudited;
mod unfold;
mod velocities;
mod witness;

use std::sync::Arc;

use crate::diagnosis::{Alternation, PoseStream};
use crate::finding::rounded;
use crate::robot::RobotError;
use crate::time::{Clock, Stamp};

pub use apart::Apart;
pub use arm::{Arm, JointMending, NoTf};
pub use assemble::{ReferenceContent, ReferenceSource};
pub use cadence::{Cadence, Extent, Hole, Rhythm, Stretch};
pub use clock::{Alignment, Epoch, HeaderStamps, StreamClock};
pub use columns::{Shared, SharedColumns, SharedRow, selectors, tell_columns};
pub use contest::{Claimant, Contest};
pub use declaration::{CalibrationSource, Declaration, DeclarationError, JointName, RobotSource};
pub use error::RunError;
pub use excerpts::Excerpts;
pub use flaws::{Between, Flaw, FlawKind};
pub use frozen::Frozen;
pub use held::Held;
pub use joints::{JointFacts, JointSamples};
pub use model::BetterModel;
pub use models::robot_of;
pub use norms::{Norms, Written};
pub use publishers::Publishers;
pub use role::Role;
pub use rounded::RoundedStamps;
pub use segments::{Segment, segments};
pub(crate) use settle::{retake_carried, together};
pub use sift::Sift;
pub use sources::Carrier;
pub use sources::{ImuSource, PoseSource};
pub use strays::{FEWEST_SAMPLES, Strays};
pub use streams::Stream;
pub use targets::{CameraAxes, HandKind, HandSource, TargetSource};
pub use tf_error::TfError;
pub use tf_tree::{Edge, EdgeKind, TfPath, TfTree};
pub use topics::{SaidRole, TopicSettings};
pub use unaudited::{Unaudited, WhyNot};
pub use unfold::Folded;
pub use velocities::Velocities;
pub use witness::Witness;

/// Correlation of speeds from which a stream follows the arm.
const FOLLOWS: f64 = 0.7;

/// Correlation of speeds below which a stream does not follow the arm, whatever its frame says. Less
/// than [`FOLLOWS`], because a bad clock or convention lowers it too.
const CONTRADICTS: f64 = 0.4;

/// What the caller says of a run.
#[derive(Clone, Debug)]
pub struct RunOptions {
    /// The robots in it; where none is named, the log is asked and then the catalogue.
    pub robots: Vec<RobotSource>,
    /// Calibrations of the URs among them; where none is named, the log may hold one.
    pub calibrations: Vec<CalibrationSource>,
    /// The link to take as base.
    pub base: Option<String>,
    /// The link to take as tip.
    pub tip: Option<String>,
    /// The clock to place messages by.
    pub stamp: Clock,
    /// Stamps further than this off the other streams', s, are of another clock.
    pub max_latency_s: f64,
    /// What the model calls joints that the log names otherwise.
    pub joint_map: Vec<JointName>,
    /// How the caller says that single streams are coded.
    pub declared: Vec<Declaration>,
    /// What else the caller says of single topics.
    pub topics: Vec<TopicSettings>,
    /// What other logs of the same dataset told of all of them.
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

/// One run, ready to be diagnosed.
#[derive(Debug)]
pub struct Run {
    /// The stamp that times in seconds are relative to: the earliest of the joint states or, without
    /// any, of all streams.
    pub origin: Stamp,
    /// First and last stamp of all streams, on the clock that the audit uses.
    pub span: Option<(Stamp, Stamp)>,
    /// All topics, in the order of the log; after them transforms of TF topics that are measured
    /// poses.
    pub streams: Vec<Stream>,
    /// The arms.
    pub arms: Vec<Arm>,
    /// What cameras see, with the hands that it may be held against.
    pub targets: Vec<TargetSource>,
    /// What the arms were told, as far as it can be held against them.
    pub references: Vec<ReferenceSource>,
    /// The frames of all arms, and the transforms between them.
    pub tf: Arc<TfTree>,
    /// The clock of every stream that moves in time.
    pub clocks: Vec<StreamClock>,
    /// The streams whose stamps were rounded, and were restored from the order of their rows.
    pub rounded: Vec<RoundedStamps>,
    /// How regularly every stream comes that plays a part.
    pub rhythms: Vec<Rhythm>,
    /// What keeps the transforms from being a tree.
    pub flaws: Vec<Flaw>,
    /// The joints that are logged within one turn; their positions are unwrapped.
    pub folded: Vec<Folded>,
    /// How far the rotations of every stream that logs them are from being rotations.
    pub norms: Vec<Norms>,
    /// The streams that several arms may claim.
    pub contests: Vec<Contest>,
    /// The streams that are not audited, or not as what they say they are.
    pub unaudited: Vec<Unaudited>,
    /// The streams that do what the arm does before it does, each with its lead in seconds: commands, or
    /// poses of the tool beside joint states that are late.
    pub leaders: Vec<(usize, f64)>,
    /// The streams that may be tool poses, of which the motion does not tell.
    pub undecided: Vec<usize>,
    /// What the estimators do not see: stray samples, second publishers, repeats.
    pub sift: Sift,
    /// When streams of poses stood still and their arm did not, and joint states on their way; the
    /// estimators do not see that either.
    pub frozen: Vec<Frozen>,
    /// The streams that were looked at for that.
    pub watched: Vec<usize>,
    /// The streams whose poses alternate between several rigid bodies on the tool; the estimators see all
    /// of them as those of the usual one.
    pub alternations: Vec<(usize, Alternation)>,
    /// What of it the estimators see; `None` where that is all of it.
    pub excerpts: Option<Excerpts>,
    /// Whether the log holds `/clock`, the mark of simulated time.
    pub has_clock_topic: bool,
    /// Why there is no arm.
    pub no_arm: Option<RunError>,
    /// Where the log holds a robot description that is wanted and cannot be read, and why not.
    pub unreadable: Vec<(String, RobotError)>,
}

/// Standard error of receive times, s, where a stream has no stamps of its own: transports differ by
/// about a millisecond.
const TRANSPORT_S: f64 = 1e-3;

impl Run {
    /// A stream of poses, as the diagnosis takes it.
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
            taken_off: None,
        }
    }

    /// The candidates of an arm: indices of their streams.
    pub fn candidates(&self) -> impl Iterator<Item = usize> + '_ {
        let is_candidate =
            |index: &usize| matches!(self.streams[*index].role, Role::Candidate { .. });
        (0..self.streams.len()).filter(is_candidate)
    }

    /// Puts `arm` in the place of arm `index`, and its chains into the hands that are this arm's.
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

    /// Makes `stream`, which belongs to no arm, the tool pose that the target on `topic` is held
    /// against: their angular speeds correlate by `correlation`.
    pub fn settle_hand(&mut self, stream: usize, topic: &str, correlation: f64) {
        let Some(settled) = self.streams.get_mut(stream) else { return };
        if settled.role == Role::Unassigned {
            settled.role = Role::Pose;
            settled.reason = format!(
                "it turns as the target on '{topic}' does: its angular speed correlates by \
                 {correlation:.2}"
            );
        }
    }

    /// Settles whether candidate `stream` is a tool pose: `peak` is the highest correlation of its
    /// speeds with the arm's, from 0 to 1, or `None` where the motion cannot tell.
    ///
    /// A stream that is no tool pose is unassigned with the reason, and leaves its arm. A stream
    /// that is no candidate keeps its role.
    pub fn settle(&mut self, stream: usize, peak: Option<f64>) {
        let Some(settled) = self.streams.get_mut(stream) else { return };
        let Role::Candidate { presumed } = settled.role else { return };
        let (is_pose, verdict) = match peak {
            Some(peak) if peak >= FOLLOWS => {
                (true, format!("it follows the arm: its speed correlates by {peak:.2}"))
            }
            Some(peak) if presumed && peak >= CONTRADICTS => (
                true,
                format!("its motion does not contradict that: its speed correlates by {peak:.2}"),
            ),
            Some(peak) => (
                false,
                format!(
                    "it does not follow the arm: its speed correlates by {}, not {FOLLOWS}",
                    rounded(peak, 2)
                ),
            ),
            None if presumed => (true, "the motion cannot tell".to_owned()),
            None => (false, "the motion cannot tell whether it follows the arm".to_owned()),
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

    /// Makes candidate `stream`, which is no tool pose, what its name says.
    pub(crate) fn settle_by_name(&mut self, stream: usize, reason: String) {
        self.unassign(stream, reason);
        let Some(settled) = self.streams.get_mut(stream) else { return };
        settled.role = role::beside_arm(&settled.topic);
    }

    /// Makes candidate `stream` a command: it does by `lead_s` before the arm what the arm then does.
    pub fn settle_leader(&mut self, stream: usize, lead_s: f64) {
        let Some(settled) = self.streams.get(stream) else { return };
        let reason = format!(
            "{}; it leads the arm: it was received {:.0} ms before the arm did the same, as a command \
             is (a hand tracker or a leader arm), or joint states are that are recorded late",
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
