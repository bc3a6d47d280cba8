//! Source of a pose stream: the controller, or an independent measurement.
//!
//! A controller's pose is FK of the same encoders with its own calibration. It reveals different models,
//! but not mechanics that differ from both. Names and frames decide, because filters and rounding make
//! noise unreliable.

use schemars::JsonSchema;
use serde::Deserialize;

use super::Stream;
use super::role::{FrameKind, find_driver, find_word, split_words};

/// Source of poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
#[schemars(rename = "WitnessName")]
pub enum PoseSourceKind {
    /// The controller, or a program that computes poses from joint states.
    Controller,
    /// A tracker or a camera.
    External,
    /// Not known.
    Unknown,
}

impl PoseSourceKind {
    /// Name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            PoseSourceKind::Controller => "controller",
            PoseSourceKind::External => "external",
            PoseSourceKind::Unknown => "unknown",
        }
    }
}

/// Motion-capture systems and laser trackers.
const TRACKER_WORDS: &[&str] = &[
    "vicon", "optitrack", "natnet", "mocap", "qualisys", "phasespace", "vrpn", "tracker",
    "polaris", "atracsys", "leica", "vive", "lighthouse",
];

const CAMERA_WORDS: &[&str] = &["apriltag", "aruco", "charuco", "camera", "optical"];

/// Packages with controller messages.
const CONTROLLER_PACKAGES: &[&str] =
    &["franka_", "ur_", "lbr_fri_", "iiwa_", "kuka_", "xarm_", "dsr_", "jaka_", "aubo_", "kinova_"];

/// Packages with tracker or camera messages.
const TRACKER_PACKAGES: &[&str] =
    &["vicon_", "mocap", "motion_capture_", "optitrack_", "vrpn_", "apriltag_", "aruco_"];

#[derive(Clone, Copy, Debug)]
pub(super) struct PoseNames<'a> {
    pub topic: &'a str,
    pub type_name: &'a str,
    pub frame_id: &'a str,
    pub child_frame_id: &'a str,
    /// Relation of the poses' frame to the arm.
    pub frame: FrameKind,
    /// Whether its stamps are the joints'.
    pub stamps_copied: bool,
}

fn external_word(words: &[String]) -> Option<&'static str> {
    find_word(words, TRACKER_WORDS).or_else(|| find_word(words, CAMERA_WORDS))
}

/// Whether the names of a stream are those of a motion-capture system or a laser tracker.
pub(super) fn names_tracker(stream: &Stream) -> bool {
    let names = [&stream.topic, &stream.frame_id];
    names.into_iter().any(|name| find_word(&split_words(name), TRACKER_WORDS).is_some())
}

pub(super) fn classify_source(names: &PoseNames<'_>) -> (PoseSourceKind, String) {
    let PoseNames { topic, type_name, frame_id, child_frame_id, .. } = *names;
    let package = type_name.split('/').next().unwrap_or_default();
    let of_package = |known: &[&str]| known.iter().any(|start| package.starts_with(start));
    let topic_words = split_words(topic);
    let outside = [topic, frame_id, child_frame_id]
        .into_iter()
        .find_map(|name| external_word(&split_words(name)));
    if let Some(word) = outside {
        return (PoseSourceKind::External, format!("the word '{word}' in its names"));
    }
    if of_package(TRACKER_PACKAGES) {
        return (PoseSourceKind::External, format!("messages of {package}"));
    }
    if let Some(driver) = find_driver(&topic_words) {
        return (
            PoseSourceKind::Controller,
            format!("the topic name that {driver} use for the tool pose"),
        );
    }
    if of_package(CONTROLLER_PACKAGES) {
        return (PoseSourceKind::Controller, format!("messages of {package}"));
    }
    if find_word(&split_words(child_frame_id), &["controller"]).is_some() {
        return (PoseSourceKind::Controller, format!("its child frame '{child_frame_id}'"));
    }
    if names.stamps_copied {
        return (PoseSourceKind::Controller, "its stamps, copied from the joint states".to_owned());
    }
    match names.frame {
        FrameKind::Unknown => {
            let why = format!("its frame '{frame_id}', which is not fixed to the robot");
            (PoseSourceKind::External, why)
        }
        _ => (PoseSourceKind::Unknown, "lack of a known name or frame".to_owned()),
    }
}

/// Source of the poses in a column of this name, which has neither a message type nor frames.
pub(crate) fn source_of_column(name: &str) -> PoseSourceKind {
    let names = PoseNames {
        topic: name,
        type_name: "",
        frame_id: "",
        child_frame_id: "",
        frame: FrameKind::Unnamed,
        stamps_copied: false,
    };
    classify_source(&names).0
}

#[cfg(test)]
mod tests {
    use super::*;
    use FrameKind::{StaticallyTied, StillLink, Unknown, Unnamed};

    fn witness(
        topic: &str,
        type_name: &str,
        (frame_id, frame): (&str, FrameKind),
    ) -> PoseSourceKind {
        let (child_frame_id, stamps_copied) = ("", false);
        let names = PoseNames { topic, type_name, frame_id, child_frame_id, frame, stamps_copied };
        classify_source(&names).0
    }

    #[test]
    fn source_kinds_follow_from_names() {
        use PoseSourceKind::{Controller, External, Unknown as Nobody};
        const POSE: &str = "geometry_msgs/msg/PoseStamped";
        for (topic, type_name, frame, expected) in [
            ("/tcp_pose_broadcaster/pose", POSE, ("base", StillLink), Controller),
            ("/ur/actual_TCP_pose", "std_msgs/msg/Float64MultiArray", ("", Unnamed), Controller),
            ("/franka_robot_state_broadcaster/current_pose", POSE, ("", Unnamed), Controller),
            ("/state", "franka_msgs/msg/FrankaRobotState", ("", Unnamed), Controller),
            ("/tcp_pose_broadcaster/pose", POSE, ("mocap_world", Unknown), External),
            ("/vrpn_client_node/tool/pose", POSE, ("world", StaticallyTied), External),
            ("/tool/apriltag", POSE, ("base", StillLink), External),
            ("/hand_pose", POSE, ("camera_color_optical_frame", StaticallyTied), External),
            ("/hand_pose", POSE, ("map", Unknown), External),
            ("/hand_pose", POSE, ("base", StillLink), Nobody),
            ("/hand_pose", POSE, ("", Unnamed), Nobody),
        ] {
            assert_eq!(witness(topic, type_name, frame), expected, "{topic} in {frame:?}");
        }
    }

    #[test]
    fn names_of_columns_indicate_the_source() {
        use PoseSourceKind::{Controller, External, Unknown as Nobody};
        for (name, expected) in [
            ("O_T_EE[12]", Controller),
            ("actual_TCP_pose[0]", Controller),
            ("leica_x", External),
            ("x", Nobody),
        ] {
            assert_eq!(source_of_column(name), expected, "{name}");
        }
    }

    #[test]
    fn copied_stamps_or_controller_names_indicate_the_controller() {
        let names = PoseNames {
            topic: "/hand_pose",
            type_name: "geometry_msgs/msg/PoseStamped",
            frame_id: "base",
            child_frame_id: "",
            frame: StillLink,
            stamps_copied: true,
        };
        assert_eq!(classify_source(&names).0, PoseSourceKind::Controller);
        let tool = PoseNames { stamps_copied: false, child_frame_id: "tool0_controller", ..names };
        assert_eq!(classify_source(&tool).0, PoseSourceKind::Controller);
    }
}
