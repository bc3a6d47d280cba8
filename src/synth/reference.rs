//! Commands to the arm: poses, joints, or a goal before each motion.

use super::messages::{self, Topic};
use super::noise::Purpose;
use super::streams::Message;
use super::truth::Truth;
use super::{LoggedEncoding, Scenario, Timing};
use crate::geometry::Pose;

/// Kind of commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Commands {
    /// Stream of tip poses.
    Poses,
    /// Pose of the next rest, sent once before the motion.
    Goals,
    /// Stream of joint positions.
    Joints,
}

/// Commands: the exact lines for a motion along lines, otherwise the arm's motion.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceStream {
    /// Any rate enables goals; a negative latency leads the arm.
    pub timing: Timing,
    /// Kind of commands.
    pub commands: Commands,
    /// Frame of commanded poses.
    pub frame_id: String,
    /// `q_commanded − q_true`, rad or m, per joint from base to tip; zero beyond the list.
    pub command_offset: Vec<f64>,
    /// Commanded point in the tip.
    pub tip_from_commanded: Pose,
}

impl ReferenceStream {
    pub(super) fn disabled(base: &str) -> Self {
        Self {
            timing: Timing::every(0.0, 0.0029),
            commands: Commands::Poses,
            frame_id: base.to_owned(),
            command_offset: Vec::new(),
            tip_from_commanded: Pose::identity(),
        }
    }

    fn joints(&self, truth: &Truth, time_s: f64) -> Vec<f64> {
        let (mut q, _) = truth.encoder_joints(time_s);
        q.iter_mut().zip(&self.command_offset).for_each(|(q, short)| *q += short);
        q
    }

    fn pose(&self, truth: &Truth, time_s: f64) -> Pose {
        let line = truth.commanded_pose(time_s).filter(|_| self.command_offset.is_empty());
        let base_from_tip =
            line.unwrap_or_else(|| truth.chain.forward(&self.joints(truth, time_s)));
        base_from_tip * self.tip_from_commanded
    }

    fn message(&self, truth: &Truth, time_s: f64, stamp: crate::time::Stamp) -> (Topic, Vec<u8>) {
        let pose = || {
            let logged = LoggedEncoding::Correct.encode(&self.pose(truth, time_s));
            messages::pose_stamped(stamp, &self.frame_id, logged)
        };
        match self.commands {
            Commands::Poses => (Topic::CommandedPose, pose()),
            Commands::Goals => (Topic::Goal, pose()),
            Commands::Joints => {
                let names = truth.chain.joint_names();
                let q = self.joints(truth, time_s);
                (Topic::CommandedJoints, messages::joint_state(stamp, names, &q, &[]))
            }
        }
    }
}

pub(super) fn command_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.reference;
    if stream.timing.rate_hz <= 0.0 {
        return Vec::new();
    }
    if stream.commands != Commands::Goals {
        let ticks = scenario.ticks(&stream.timing, Purpose::ReferenceTransport);
        let message = |tick: super::streams::Tick| {
            let (topic, cdr) = stream.message(truth, tick.time_s, tick.stamp);
            tick.message(topic, cdr)
        };
        return ticks.map(message).collect();
    }
    let goals = truth.rests();
    let ways = goals.windows(2).filter(|pair| pair[0].1 < scenario.duration_s);
    ways.map(|pair| {
        let ((arrived_s, leave_s), (arrive_s, _)) = (pair[0], pair[1]);
        let given_s = (leave_s - 0.1).max(0.5 * (arrived_s + leave_s));
        let tick = scenario.tick_at(&stream.timing, given_s);
        let (topic, cdr) = stream.message(truth, arrive_s, tick.stamp);
        tick.message(topic, cdr)
    })
    .collect()
}
