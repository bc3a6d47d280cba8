//! Target seen by a camera, in the hand or fixed.

use std::f64::consts::{FRAC_PI_2, PI};

use super::messages::{self, LoggedTransform, Topic};
use super::noise::{Noise, Purpose, add_pose_noise};
use super::streams::Message;
use super::truth::Truth;
use super::{LoggedEncoding, Scenario, SynthError, Timing};
use crate::geometry::{Pose, Vec3, pose, rotation_from_rotvec, rotation_from_rpy};

/// Mounting of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Camera {
    /// At the tip; target fixed in the base.
    InHand,
    /// In the base; target at the tip.
    InBase,
}

/// Part of a pose in body axes (x forward, z up) instead of optical (z forward, x right).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BodyAxesPart {
    /// None.
    None,
    /// Whole pose.
    Whole,
    /// Position.
    Position,
}

/// Target poses in a camera: `camera_from_target`, then swapped, then encoded.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetStream {
    /// Timing.
    pub timing: Timing,
    /// Frame of the messages.
    pub frame_id: String,
    /// Mounting of the camera.
    pub camera: Camera,
    /// In /tf_static: `tip_from_camera` or `base_from_camera`.
    pub mount: Pose,
    /// True mount in the published one: `camera_as_published_from_camera`.
    pub mount_error: Pose,
    /// Whether /tf_static contains the camera.
    pub has_frame: bool,
    /// `base_from_target` or `tip_from_target`.
    pub target: Pose,
    /// Time, s after the start, and `target_from_slipped`.
    pub target_slip: Option<(f64, Pose)>,
    /// Logged over true distances, as with a wrong target size.
    pub scale: f64,
    /// Part in other axes.
    pub in_body_axes: BodyAxesPart,
    /// Encoding of the logged pose.
    pub encoding: LoggedEncoding,
    /// Target frame if published on /tf.
    pub tf_frame: Option<String>,
}

impl TargetStream {
    pub(super) fn disabled() -> Self {
        Self {
            timing: Timing::every(0.0, 0.0047),
            frame_id: "camera_optical_frame".to_owned(),
            camera: Camera::InHand,
            mount: Pose::identity(),
            mount_error: Pose::identity(),
            has_frame: true,
            target: Pose::identity(),
            target_slip: None,
            scale: 1.0,
            in_body_axes: BodyAxesPart::None,
            encoding: LoggedEncoding::Correct,
            tf_frame: None,
        }
    }

    fn camera_from_target(&self, base_from_tip: &Pose, time_s: f64) -> Pose {
        let mount = self.mount * self.mount_error;
        let slipped = self.target_slip.filter(|(at_s, _)| time_s > *at_s);
        let target = slipped.map_or(self.target, |(_, slip)| self.target * slip);
        match self.camera {
            Camera::InHand => (base_from_tip * mount).inverse() * target,
            Camera::InBase => mount.inverse() * base_from_tip * target,
        }
    }

    fn swap_axes(&self, seen: &Pose) -> Pose {
        let body_from_optical = rotation_from_rpy([-FRAC_PI_2, 0.0, -FRAC_PI_2]);
        let body = pose([0.0; 3], body_from_optical) * seen;
        match self.in_body_axes {
            BodyAxesPart::None => *seen,
            BodyAxesPart::Whole => body,
            BodyAxesPart::Position => Pose::from_parts(body.translation, seen.rotation),
        }
    }

    fn mount_link<'a>(&self, scenario: &'a Scenario) -> &'a str {
        match self.camera {
            Camera::InHand => &scenario.tip,
            Camera::InBase => &scenario.base,
        }
    }

    /// Camera frame, if /tf_static contains it.
    pub(super) fn frame<'a>(&'a self, scenario: &'a Scenario) -> Option<LoggedTransform<'a>> {
        (self.timing.rate_hz > 0.0 && self.has_frame).then(|| LoggedTransform {
            parent: self.mount_link(scenario),
            child: &self.frame_id,
            parent_from_child: LoggedEncoding::Correct.encode(&self.mount),
        })
    }
}

impl Scenario {
    /// Adds a camera at 30 Hz, with the target in view of an arm at home.
    ///
    /// # Errors
    /// If there is no chain between `base` and `tip`.
    pub fn add_camera(&mut self, camera: Camera) -> Result<(), SynthError> {
        let truth = Truth::new(self)?;
        let mut home = self.home.clone();
        home.resize(truth.chain.dof(), 0.0);
        let base_from_tip = truth.chain.forward(&home);
        // The target faces the camera.
        let ahead =
            |distance_m: f64| pose([0.0, 0.0, distance_m], rotation_from_rotvec(Vec3::x() * PI));
        let askew = |xyz: [f64; 3]| pose(xyz, rotation_from_rotvec(Vec3::new(0.1, -0.2, 0.7)));
        let (mount, target) = match camera {
            Camera::InHand => {
                let tip_from_camera = askew([0.06, -0.03, 0.05]);
                (tip_from_camera, base_from_tip * tip_from_camera * ahead(0.5))
            }
            Camera::InBase => {
                let tip_from_target = askew([0.01, 0.04, 0.03]);
                (base_from_tip * tip_from_target * ahead(0.8), tip_from_target)
            }
        };
        self.target = TargetStream { camera, mount, target, ..self.target.clone() };
        self.target.timing.rate_hz = 30.0;
        Ok(())
    }
}

pub(super) fn target_messages(scenario: &Scenario, truth: &Truth) -> Vec<Message> {
    let stream = &scenario.target;
    let mut noise = scenario.unit_noise(Purpose::TargetNoise, 6);
    let ticks = scenario.ticks(&stream.timing, Purpose::TargetTransport);
    ticks
        .map(|tick| {
            let stream = &scenario.scenario_at(tick.time_s).target;
            let base_from_tip = truth.base_from_tip(tick.time_s);
            let mut seen = stream.camera_from_target(&base_from_tip, tick.time_s);
            let Noise { target_m, target_rad, .. } = scenario.noise;
            let far = scenario.noise.factor_at_distance(seen.translation.vector.norm());
            add_pose_noise(&mut seen, noise.next(), far * target_m, far * target_rad);
            seen.translation.vector *= stream.scale;
            let logged = stream.encoding.encode(&stream.swap_axes(&seen));
            let parent = stream.frame_id.as_str();
            match &stream.tf_frame {
                Some(child) => {
                    let transform = LoggedTransform { parent, child, parent_from_child: logged };
                    tick.message(Topic::Tf, messages::tf_message(tick.stamp, &[transform]))
                }
                None => {
                    let cdr = messages::pose_stamped(tick.stamp, parent, logged);
                    tick.message(Topic::Target, cdr)
                }
            }
        })
        .collect()
}
