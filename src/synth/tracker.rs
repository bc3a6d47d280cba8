//! A tracker that observes a marker on the tip.

use super::messages::{self, Topic};
use super::noise::{Purpose, add_pose_noise};
use super::streams::Message;
use super::truth::Truth;
use super::{LoggedEncoding, Scenario, Timing, ToolSlip};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec};

/// Poses of a marker in the tracker's world, without a transform to the arm.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerStream {
    /// A rate of 0 disables it.
    pub timing: Timing,
    /// Topic.
    pub topic: String,
    /// Frame of the messages.
    pub frame_id: String,
    /// Base in the tracker's world.
    pub world_from_base: Pose,
    /// Marker in the tip.
    pub tip_from_marker: Pose,
    /// Slip of the marker.
    pub slip: Option<ToolSlip>,
    /// Standard deviation of the position per axis, m.
    pub noise_m: f64,
    /// Standard deviation of the rotation per axis, rad.
    pub noise_rad: f64,
}

impl TrackerStream {
    pub(super) fn disabled() -> Self {
        Self {
            timing: Timing::every(0.0, 0.0029),
            topic: "/vrpn_mocap/marker/pose".to_owned(),
            frame_id: "world".to_owned(),
            world_from_base: pose(
                [0.8, -1.3, 0.7],
                rotation_from_rotvec(Vec3::new(0.1, -0.2, 2.1)),
            ),
            tip_from_marker: pose(
                [0.03, -0.05, 0.06],
                rotation_from_rotvec(Vec3::new(0.4, 0.9, -0.3)),
            ),
            slip: None,
            noise_m: 2e-4,
            noise_rad: 0.03_f64.to_radians(),
        }
    }
}

pub(super) fn tracker_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.tracker;
    let mut noise = scenario.unit_noise(Purpose::TrackerNoise, 6);
    let ticks = scenario.ticks(&stream.timing, Purpose::TrackerTransport);
    ticks
        .map(|tick| {
            let base_from_tip = truth.base_from_tip(tick.time_s);
            let mut marker = stream.world_from_base * base_from_tip * stream.tip_from_marker;
            if let Some(slip) = stream.slip.as_ref().filter(|slip| slip.is_active(tick.time_s)) {
                marker *= slip.tool_from_slipped;
            }
            add_pose_noise(&mut marker, noise.next(), stream.noise_m, stream.noise_rad);
            let logged = LoggedEncoding::Correct.encode(&marker);
            let cdr = messages::pose_stamped(tick.stamp, &stream.frame_id, logged);
            tick.message(Topic::Tracker, cdr)
        })
        .collect()
}
