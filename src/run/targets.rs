//! Camera targets and their candidate hands.

use crate::geometry::Pose;
use crate::robot::{Chain, LinkId};
use crate::stream::PoseTrack;

use super::arm::Arm;
use super::role::{CAMERA_WORDS, DETECTION_WORDS, FrameKind, find_word, split_words};
use super::tf_tree::{Edge, EdgeKind, TfTree};

/// Axis convention of a camera frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraAxes {
    /// z forward, x right: named `optical` (REP 103).
    Optical,
    /// x forward, z up: statically tied so to an optical frame.
    Body,
}

/// A target seen by a camera.
#[derive(Clone, Debug)]
pub struct TargetSource {
    /// Index of the stream.
    pub stream: usize,
    /// `camera_from_target` as logged.
    pub track: PoseTrack,
    /// Expected camera convention, if logged.
    pub axes: Option<CameraAxes>,
    /// Hands that may move camera or target.
    pub hands: Vec<HandSource>,
}

/// A hand, and the camera's pose by the log's frames.
#[derive(Clone, Debug)]
pub struct HandSource {
    /// Source of the hand's poses.
    pub kind: HandKind,
    /// Camera in the hand, if static.
    pub hand_from_camera: Option<Pose>,
    /// Camera in the base, if static.
    pub base_from_camera: Option<Pose>,
    /// Standard error of clock alignment, s; 0 on a shared clock.
    pub stamp_error_s: f64,
}

/// Source of a hand's poses.
#[derive(Clone, Debug)]
pub enum HandKind {
    /// FK of an arm's joint states.
    Joints {
        /// Index of the arm.
        arm: usize,
        /// From the base to the hand.
        chain: Chain,
        /// Column in the joint track of each joint of `chain`.
        columns: Vec<usize>,
    },
    /// A pose stream.
    Stream {
        /// Its index.
        stream: usize,
        /// `base_from_hand`.
        track: PoseTrack,
    },
    /// Transforms of the log.
    Transforms {
        /// Frame of the base.
        base: String,
        /// Frame of the hand.
        frame: String,
        /// `base_from_hand`.
        track: PoseTrack,
    },
}

impl HandKind {
    /// FK of `arm` to the link with the camera's frame, else its tip, with camera poses in hand and base.
    pub(super) fn from_arm(
        index: usize,
        arm: &Arm,
        camera: &str,
    ) -> Option<(Self, [Option<Pose>; 2])> {
        let (place, anchor) = arm.classify_frame(camera);
        // A camera next to a rail does not move with it.
        let base = arm.outermost_base(arm.tip);
        let fixed = |link: LinkId| arm.robot.fixed_transform(base, link);
        let (hand, hand_from_camera, base_from_camera) = match (place, anchor) {
            (FrameKind::MovingLink, Some(anchor)) => {
                let tip_from_link = arm.robot.fixed_transform(arm.tip, anchor.link);
                match tip_from_link {
                    Some(tip_from_link) => {
                        (arm.tip, Some(tip_from_link * anchor.link_from_frame), None)
                    }
                    None => (anchor.link, Some(anchor.link_from_frame), None),
                }
            }
            (_, Some(anchor)) => {
                let base_from_camera = fixed(anchor.link).map(|link| link * anchor.link_from_frame);
                (arm.tip, None, base_from_camera)
            }
            (_, None) => (arm.tip, None, None),
        };
        let (chain, columns) = arm.chain_between(base, hand)?;
        let kind = Self::Joints { arm: index, chain, columns };
        Some((kind, [hand_from_camera, base_from_camera]))
    }
}

/// Whether names make a dynamic transform a camera detection.
pub(super) fn is_detection(frame: &str, child: &str) -> bool {
    let is_camera = |name: &str| find_word(&split_words(name), CAMERA_WORDS).is_some();
    is_camera(frame)
        && (!is_camera(child) || find_word(&split_words(child), DETECTION_WORDS).is_some())
}

pub(super) fn camera_axes(tf: &TfTree, camera: &str) -> Option<CameraAxes> {
    let is_optical = |frame: &str| split_words(frame).iter().any(|word| word == "optical");
    if is_optical(camera) {
        return Some(CameraAxes::Optical);
    }
    let (_, optical_from_camera) = tf.nearest_fixed(camera, is_optical)?;
    // Optical z is body x, optical x is body −y.
    let turn = optical_from_camera.rotation;
    let forward = turn * crate::geometry::Vec3::x();
    let left = turn * crate::geometry::Vec3::y();
    (forward.z > 0.98 && left.x < -0.98).then_some(CameraAxes::Body)
}

/// Base and hand frame without an arm: the moving frame with the camera, else the one moved by the most
/// dynamic transforms. Ignores detections.
pub(super) fn hand_frame(tf: &TfTree, camera: &str) -> Option<(String, String)> {
    let moves = |edge: &Edge| {
        let (parent, child) = tf.names(edge);
        edge.kind == EdgeKind::Dynamic && !is_detection(parent, child)
    };
    let moved_by =
        |frame: &str| tf.edges_above(frame).into_iter().filter(|edge| moves(edge)).count();
    let is_moved =
        |frame: &str| tf.edges().iter().any(|edge| moves(edge) && tf.names(edge).1 == frame);
    let carrier = tf.nearest_fixed(camera, is_moved).map(|(frame, _)| frame);
    let farthest = || {
        let frames = tf.frames().filter(|frame| is_moved(frame));
        frames.max_by_key(|frame| moved_by(frame))
    };
    let hand = carrier.or_else(farthest)?;
    (moved_by(hand) > 0).then(|| (tf.root_of(hand).to_owned(), hand.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{pose, rotation_from_rpy};

    #[test]
    fn a_body_frame_is_one_that_is_tied_to_an_optical_one() {
        use std::f64::consts::FRAC_PI_2;
        let mut tf = TfTree::default();
        let turn = rotation_from_rpy([-FRAC_PI_2, 0.0, -FRAC_PI_2]);
        let body_from_optical = pose([0.0, 0.015, 0.0], turn);
        tf.insert_fixed("camera_link", "camera_optical", EdgeKind::Static, body_from_optical);
        tf.insert_fixed("tool0", "cam", EdgeKind::Static, Pose::identity());
        assert_eq!(camera_axes(&tf, "camera_optical"), Some(CameraAxes::Optical));
        assert_eq!(camera_axes(&tf, "camera_link"), Some(CameraAxes::Body));
        assert_eq!(camera_axes(&tf, "cam"), None);
        assert_eq!(camera_axes(&tf, "elsewhere"), None);
    }

    #[test]
    fn a_tag_is_a_detection_and_a_camera_frame_is_not() {
        assert!(is_detection("camera_optical_frame", "tag_3"));
        assert!(is_detection("camera", "camera_board"));
        assert!(!is_detection("camera_link", "camera_optical_frame"));
        assert!(!is_detection("base_link", "tag_3"));
    }
}
