//! Whose word a stream of poses is: the controller's own, or somebody's who looks at the arm.
//!
//! A controller's pose is FK of the same encoders as the joint states, with its own calibration. It
//! can show that a model differs from the controller's, and never that the mechanics differ from
//! both. Whether a stream is one is told from names and frames alone: how its noise relates to the
//! joints' would be a further hint, but filters and rounding make it a poor one.

use schemars::JsonSchema;
use serde::Deserialize;

use super::role::{Place, driver_of, shared, words};

/// Whose word poses are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "WitnessName")]
pub enum Witness {
    /// The controller's, or a program's that computes it from the joint states.
    Controller,
    /// A tracker's or a camera's.
    External,
    /// Nobody knows.
    Unknown,
}

impl Witness {
    /// The name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Witness::Controller => "controller",
            Witness::External => "external",
            Witness::Unknown => "unknown",
        }
    }
}

/// Words of topics and frames of what looks at an arm from outside.
const OUTSIDE: &[&str] = &[
    "vicon",
    "optitrack",
    "natnet",
    "mocap",
    "qualisys",
    "phasespace",
    "vrpn",
    "tracker",
    "polaris",
    "atracsys",
    "leica",
    "vive",
    "lighthouse",
    "apriltag",
    "aruco",
    "charuco",
    "camera",
    "optical",
];

/// How packages begin whose messages come from a controller.
const CONTROLLERS: &[&str] =
    &["franka_", "ur_", "lbr_fri_", "iiwa_", "kuka_", "xarm_", "dsr_", "jaka_", "aubo_", "kinova_"];

/// How packages begin whose messages come from a tracker or a camera.
const TRACKERS: &[&str] =
    &["vicon_", "mocap", "motion_capture_", "optitrack_", "vrpn_", "apriltag_", "aruco_"];

/// What the witness of a pose stream is told from.
#[derive(Clone, Copy, Debug)]
pub(super) struct PoseNames<'a> {
    pub topic: &'a str,
    pub type_name: &'a str,
    pub frame_id: &'a str,
    pub child_frame_id: &'a str,
    /// What is known of the frame that the poses are in.
    pub frame: Place,
    /// Whether its stamps are copies of the joints' stamps.
    pub stamps_copied: bool,
}

/// Whose word a stream of poses is, and why in words.
pub(super) fn witness_of(names: &PoseNames<'_>) -> (Witness, String) {
    let PoseNames { topic, type_name, frame_id, child_frame_id, .. } = *names;
    let package = type_name.split('/').next().unwrap_or_default();
    let of_package = |known: &[&str]| known.iter().any(|start| package.starts_with(start));
    let topic_words = words(topic);
    let outside = [topic, frame_id, child_frame_id]
        .into_iter()
        .find_map(|name| shared(&words(name), OUTSIDE));
    if let Some(word) = outside {
        return (Witness::External, format!("the word '{word}' in its names"));
    }
    if of_package(TRACKERS) {
        return (Witness::External, format!("messages of {package}"));
    }
    if let Some(driver) = driver_of(&topic_words) {
        return (
            Witness::Controller,
            format!("the topic name that {driver} use for the tool pose"),
        );
    }
    if of_package(CONTROLLERS) {
        return (Witness::Controller, format!("messages of {package}"));
    }
    if shared(&words(child_frame_id), &["controller"]).is_some() {
        return (Witness::Controller, format!("its child frame '{child_frame_id}'"));
    }
    if names.stamps_copied {
        return (Witness::Controller, "its stamps, which are the joint states'".to_owned());
    }
    match names.frame {
        Place::Unknown => {
            let why = format!("its frame '{frame_id}', which nothing ties to the robot");
            (Witness::External, why)
        }
        _ => (Witness::Unknown, "neither name nor frame".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Place::{StillLink, Tied, Unknown, Unnamed};

    fn witness(topic: &str, type_name: &str, (frame_id, frame): (&str, Place)) -> Witness {
        let (child_frame_id, stamps_copied) = ("", false);
        let names = PoseNames { topic, type_name, frame_id, child_frame_id, frame, stamps_copied };
        witness_of(&names).0
    }

    #[test]
    fn the_witness_table() {
        use Witness::{Controller, External, Unknown as Nobody};
        const POSE: &str = "geometry_msgs/msg/PoseStamped";
        for (topic, type_name, frame, expected) in [
            ("/tcp_pose_broadcaster/pose", POSE, ("base", StillLink), Controller),
            ("/ur/actual_TCP_pose", "std_msgs/msg/Float64MultiArray", ("", Unnamed), Controller),
            ("/franka_robot_state_broadcaster/current_pose", POSE, ("", Unnamed), Controller),
            ("/state", "franka_msgs/msg/FrankaRobotState", ("", Unnamed), Controller),
            ("/tcp_pose_broadcaster/pose", POSE, ("mocap_world", Unknown), External),
            ("/vrpn_client_node/tool/pose", POSE, ("world", Tied), External),
            ("/tool/apriltag", POSE, ("base", StillLink), External),
            ("/hand_pose", POSE, ("camera_color_optical_frame", Tied), External),
            ("/hand_pose", POSE, ("map", Unknown), External),
            ("/hand_pose", POSE, ("base", StillLink), Nobody),
            ("/hand_pose", POSE, ("", Unnamed), Nobody),
        ] {
            assert_eq!(witness(topic, type_name, frame), expected, "{topic} in {frame:?}");
        }
    }

    #[test]
    fn what_copies_the_stamps_of_the_joints_or_is_named_after_the_controller_is_its_own() {
        let names = PoseNames {
            topic: "/hand_pose",
            type_name: "geometry_msgs/msg/PoseStamped",
            frame_id: "base",
            child_frame_id: "",
            frame: StillLink,
            stamps_copied: true,
        };
        assert_eq!(witness_of(&names).0, Witness::Controller);
        let tool = PoseNames { stamps_copied: false, child_frame_id: "tool0_controller", ..names };
        assert_eq!(witness_of(&tool).0, Witness::Controller);
    }
}
