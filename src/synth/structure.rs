//! How a cell's log is put together beyond one arm with its streams: what moves the arm's base, second
//! publishers, values that are held, hand trackers that lead, several arms in one log.

use std::f64::consts::{PI, TAU};
use std::io::{Seek, Write};

use mcap::Compression;

use super::messages::{self, LoggedTransform, Topic};
use super::noise::{Purpose, small_rotation};
use super::streams::Message;
use super::truth::Truth;
use super::{Coding, Scenario, SynthError, Timing, write};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use crate::robot::JointKind;

/// A base that drives about, and what /tf says of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Drive {
    /// The frame that stands still; poses of a stream in it are those of the driven arm.
    pub frame_id: String,
    /// How far the base goes from where it starts, m.
    pub reach_m: f64,
    /// How far it turns to either side, rad.
    pub turn_rad: f64,
    /// When the transform from that frame to the robot's root is published; a rate of 0 leaves it out.
    pub edge: Timing,
}

impl Drive {
    /// Where the robot's root is, in the frame that stands still.
    pub(super) fn at(&self, time_s: f64) -> Pose {
        const PERIODS_S: [f64; 3] = [17.0, 23.0, 13.0];
        let [x, y, turn] = PERIODS_S.map(|period_s| (TAU * time_s / period_s).sin());
        let turn = rotation_from_rotvec(self.turn_rad * turn * Vec3::z());
        pose([self.reach_m * x, 0.6 * self.reach_m * y, 0.0], turn)
    }
}

/// A second program that publishes the arm's transforms.
#[derive(Debug, Clone, PartialEq)]
pub struct SecondPublisher {
    /// Its times; those of the first give it the same stamps.
    pub timing: Timing,
    /// By how much its transform of one joint, counted from the root, is another one.
    pub moved: Option<(usize, Pose)>,
}

/// Poses that somebody gives by hand, and that the arm follows: no measurement of the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaderStream {
    /// Its times; a rate of 0 leaves it out.
    pub timing: Timing,
    /// The topic that it is on.
    pub topic: String,
    /// The frame that it is in, which nothing ties to the arm.
    pub frame_id: String,
    /// By how much it is ahead of the arm, s.
    pub lead_s: f64,
    /// Where that frame's origin is seen from: `frame_from_base`.
    pub frame_from_base: Pose,
    /// The hand in the tip.
    pub tip_from_hand: Pose,
}

impl LeaderStream {
    /// None.
    pub(super) fn none() -> Self {
        Self {
            timing: Timing::every(0.0, 0.0053),
            topic: "/hand/pose".to_owned(),
            frame_id: "hand_world".to_owned(),
            lead_s: 0.15,
            frame_from_base: pose([0.4, -1.1, 0.2], rotation_from_rotvec(Vec3::new(0.2, 0.1, 1.9))),
            tip_from_hand: pose([0.02, 0.01, 0.05], rotation_from_rotvec(Vec3::new(0.0, 1.2, 0.3))),
        }
    }
}

/// How positions of joints without an end are brought back into one turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fold {
    /// Into −π to π.
    PlusMinusPi,
    /// Into 0 to 2π.
    ZeroToTwoPi,
}

impl Fold {
    /// A position of a joint of that kind, in one turn where it has no end.
    pub(super) fn folded(self, q: f64, kind: JointKind) -> f64 {
        match (self, kind) {
            (Self::PlusMinusPi, JointKind::Continuous) => (q + PI).rem_euclid(TAU) - PI,
            (Self::ZeroToTwoPi, JointKind::Continuous) => q.rem_euclid(TAU),
            _ => q,
        }
    }
}

/// A tool that is elsewhere for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolSlip {
    /// From when, s after the start.
    pub from_s: f64,
    /// Until when.
    pub to_s: f64,
    /// Where the tool is meanwhile, seen from where it was.
    pub tool_from_slipped: Pose,
}

/// What the leader's hand does.
pub(super) fn hand(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.leader;
    let mut noise = scenario.unit_noise(Purpose::LeaderNoise, 6);
    let ticks = scenario.ticks(&stream.timing, Purpose::LeaderTransport);
    ticks
        .map(|tick| {
            let base_from_tip = truth.base_from_tip(tick.time_s + stream.lead_s);
            let mut hand = stream.frame_from_base * base_from_tip * stream.tip_from_hand;
            let noise = noise.next();
            hand.translation.vector += scenario.noise.pose_m * Vec3::from_column_slice(&noise[..3]);
            hand.rotation *= small_rotation(&noise[3..], scenario.noise.pose_rad);
            let logged = Coding::Faithful.logged(&hand);
            let cdr = messages::pose_stamped(tick.stamp, &stream.frame_id, logged);
            tick.message(Topic::Leader, cdr)
        })
        .collect()
}

/// Where /tf says that the base drives.
pub(super) fn driving(scenario: &Scenario) -> Vec<Message> {
    let Some(drive) = &scenario.drive else { return Vec::new() };
    let root = scenario.robot.link_name(scenario.robot.root());
    let ticks = scenario.ticks(&drive.edge, Purpose::DriveTransport);
    ticks
        .map(|tick| {
            let transform = LoggedTransform {
                parent: &drive.frame_id,
                child: root,
                parent_from_child: Coding::Faithful.logged(&drive.at(tick.time_s)),
            };
            tick.message(Topic::Tf, messages::tf_message(tick.stamp, &[transform]))
        })
        .collect()
}

/// Writes the runs of several arms as one MCAP file; each names its own topics and frames.
///
/// # Errors
/// As [`Scenario::write_mcap`].
///
/// # Panics
/// As [`Scenario::write_mcap`].
pub fn write_cell(
    arms: &[Scenario],
    out: impl Write + Seek,
    compression: Option<Compression>,
) -> Result<(), SynthError> {
    write(arms, out, compression)
}
