//! A cell's log beyond one arm: moving bases, second publishers, wrapped joints, leading hands.

use std::f64::consts::{PI, TAU};

use super::messages::{self, LoggedTransform, Topic};
use super::noise::{Noise, Purpose, add_pose_noise};
use super::streams::Message;
use super::truth::Truth;
use super::{LoggedEncoding, Scenario, Timing};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec};
use crate::robot::JointKind;

/// Moving base, and its transform on /tf.
#[derive(Debug, Clone, PartialEq)]
pub struct MovingBase {
    /// Fixed frame; a stream in it contains the poses of the moving arm.
    pub frame_id: String,
    /// Maximum distance from the start, m.
    pub reach_m: f64,
    /// Maximum angle to either side, rad.
    pub turn_rad: f64,
    /// Timing of the transform to the robot's root; a rate of 0 omits it.
    pub transform_timing: Timing,
}

impl MovingBase {
    /// Root in the fixed frame.
    pub(super) fn pose_at(&self, time_s: f64) -> Pose {
        const PERIODS_S: [f64; 3] = [17.0, 23.0, 13.0];
        let [x, y, turn] = PERIODS_S.map(|period_s| (TAU * time_s / period_s).sin());
        let turn = rotation_from_rotvec(self.turn_rad * turn * Vec3::z());
        pose([self.reach_m * x, 0.6 * self.reach_m * y, 0.0], turn)
    }
}

/// Second publisher of the arm's transforms.
#[derive(Debug, Clone, PartialEq)]
pub struct SecondPublisher {
    /// With the first publisher's timing, stamps are equal.
    pub timing: Timing,
    /// Offset of one joint's transform, counted from the root.
    pub offset_joint: Option<(usize, Pose)>,
}

/// Poses of a hand that the arm follows.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaderStream {
    /// A rate of 0 disables it.
    pub timing: Timing,
    /// Topic.
    pub topic: String,
    /// Frame, without a transform to the arm.
    pub frame_id: String,
    /// Lead over the arm, s.
    pub lead_s: f64,
    /// `frame_from_base`.
    pub frame_from_base: Pose,
    /// Hand in the tip.
    pub tip_from_hand: Pose,
}

impl LeaderStream {
    pub(super) fn disabled() -> Self {
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

/// Wrapping of continuous joints into one turn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JointWrapping {
    /// Into −π to π.
    PlusMinusPi,
    /// Into 0 to 2π.
    ZeroToTwoPi,
}

impl JointWrapping {
    /// Other joints are unchanged.
    pub(super) fn wrap(self, q: f64, kind: JointKind) -> f64 {
        match (self, kind) {
            (Self::PlusMinusPi, JointKind::Continuous) => (q + PI).rem_euclid(TAU) - PI,
            (Self::ZeroToTwoPi, JointKind::Continuous) => q.rem_euclid(TAU),
            _ => q,
        }
    }
}

/// Temporary displacement of the tool.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolSlip {
    /// In s after the start.
    pub from_s: f64,
    /// In s after the start.
    pub to_s: f64,
    /// Relative to the original tool.
    pub tool_from_slipped: Pose,
}

impl ToolSlip {
    pub(super) fn is_active(&self, time_s: f64) -> bool {
        (self.from_s..self.to_s).contains(&time_s)
    }
}

pub(super) fn leader_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.leader;
    let mut noise = scenario.unit_noise(Purpose::LeaderNoise, 6);
    let ticks = scenario.ticks(&stream.timing, Purpose::LeaderTransport);
    ticks
        .map(|tick| {
            let base_from_tip = truth.base_from_tip(tick.time_s + stream.lead_s);
            let mut hand = stream.frame_from_base * base_from_tip * stream.tip_from_hand;
            let Noise { pose_m, pose_rad, .. } = scenario.noise;
            add_pose_noise(&mut hand, noise.next(), pose_m, pose_rad);
            let logged = LoggedEncoding::Correct.encode(&hand);
            let cdr = messages::pose_stamped(tick.stamp, &stream.frame_id, logged);
            tick.message(Topic::Leader, cdr)
        })
        .collect()
}

pub(super) fn moving_base_messages(scenario: &Scenario) -> Vec<Message> {
    let Some(drive) = &scenario.moving_base else { return Vec::new() };
    let root = scenario.robot.link_name(scenario.robot.root());
    let ticks = scenario.ticks(&drive.transform_timing, Purpose::DriveTransport);
    ticks
        .map(|tick| {
            let transform = LoggedTransform {
                parent: &drive.frame_id,
                child: root,
                parent_from_child: LoggedEncoding::Correct.encode(&drive.pose_at(tick.time_s)),
            };
            tick.message(Topic::Tf, messages::tf_message(tick.stamp, &[transform]))
        })
        .collect()
}
