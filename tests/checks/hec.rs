//! HEC: hand-eye calibration.

use poseaudit::finding::{Finding, Status};
use poseaudit::geometry::{Pose, QuaternionOrderError, Vec3, pose, rotation_from_rotvec};
use poseaudit::report::Report;
use poseaudit::synth::{BodyAxesPart, Camera, LoggedEncoding, Motion, TARGET, TF};

use crate::checks::case::ExpectedEstimate::{
    AmountWithoutInterval, Frame, IsReadAs, ResidualBetween,
};
use crate::checks::case::ExpectedSubject::{Frame as OnFrame, Topic};
use crate::checks::case::{Expected, Log, cases, error, info, single_finding, warning};
use crate::checks::recording::{Field, Message};
use Expected::{Inconclusive, NoFindings, OnlyOtherFinding, OtherFindingAndInconclusive, Skipped};

const OPTICAL: &str = "z forward, x right";
const BODY: &str = "x forward, z up";

cases! {
    HEC001 a_target_that_slips: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.target_slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => warning(Topic(TARGET), ResidualBetween(0.0025, 0.0045));
    HEC001 a_target_in_the_hand_that_slips: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.target_slip = Some((4.0, Pose::translation(0.0, 0.03, 0.0)));
    } => error(Topic(TARGET), ResidualBetween(0.010, 0.017));
    HEC001 a_camera_that_contradicts_its_transforms: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.mount_error = Pose::translation(0.0, 0.012, 0.0);
    } => error(Topic(TARGET), Frame([0.012, 0.5e-3], [0.0, 0.1]));
    HEC001 a_tilted_fixed_camera: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.mount_error = tilted_mount(0.6);
    } => warning(Topic(TARGET), Frame([0.0, 1e-3], [0.6, 0.1]));
    HEC001 a_target_of_another_size: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.scale = 1.1;
    } => error(Topic(TARGET), ResidualBetween(0.002, 0.05));
    HEC001 a_transposed_target: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.encoding = LoggedEncoding::Transposed;
    } => error(Topic(TARGET), ResidualBetween(0.002, 0.5));
    HEC001 a_target_with_the_scalar_first: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.encoding = LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(TARGET), ResidualBetween(0.002, 1.0));
    HEC001 a_misread_target: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.encoding = crate::checks::ord::misread("rotvec", "euler:xyz");
    } => error(Topic(TARGET), ResidualBetween(0.0, 0.5));
    HEC001 inverted_poses: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.encoding = LoggedEncoding::Inverted;
    } => error(Topic(TARGET), Frame([0.0, 1e-3], [0.0, 0.1]));

    HEC001 a_camera_in_the_hand: |log| watch_target(log, Camera::InHand) => NoFindings;
    HEC001 a_fixed_camera: |log| watch_target(log, Camera::InBase) => NoFindings;
    HEC001 a_late_target: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.timing.latency_s = 0.08;
    } => OnlyOtherFinding("LAT001");
    HEC001 a_lens_of_another_focal_length: |log| {
        watch_target(log, Camera::InHand);
        log.edit = Some(|messages| scale_depth(messages, 0.8));
    } => error(Topic(TARGET), ResidualBetween(0.005, 0.2));
    HEC001 a_noisy_target: |log| {
        watch_target(log, Camera::InHand);
        log.run.duration_s = 20.0;
        (log.run.noise.target_m, log.run.noise.target_rad) = (2e-3, 5e-3);
    } => NoFindings;
    HEC001 an_arm_on_a_rail: |log| {
        crate::checks::zer::mount_on_rail(&mut log.run);
        watch_target(log, Camera::InHand);
    } => NoFindings;
    HEC001 a_tag_on_tf: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.tf_frame = Some("tag_3".to_owned());
    } => NoFindings;
    HEC001 without_a_model: |log| {
        watch_target(log, Camera::InHand);
        remove_arm(log);
    } => NoFindings;
    HEC001 only_transforms: |log| {
        watch_target(log, Camera::InHand);
        remove_arm(log);
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 50.0;
        log.run.target.tf_frame = Some("tag_3".to_owned());
    } => NoFindings;
    HEC001 a_tag_that_slips_on_tf: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.tf_frame = Some("tag_3".to_owned());
        log.run.target.target_slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => warning(OnFrame(TF, "tag_3"), ResidualBetween(0.0025, 0.0045));

    HEC001 a_joint_zero_offset_is_not_reported_as_handeye_error: |log| {
        watch_target(log, Camera::InHand);
        log.run.joints.zero_offsets = crate::checks::zer::zero_offset(2, 0.6);
    } => OnlyOtherFinding("ZER001");
    HEC001 a_late_tool_pose_is_not_reported_as_handeye_error: |log| {
        watch_target(log, Camera::InHand);
        log.run.pose.timing.latency_s = 0.05;
    } => OnlyOtherFinding("LAT001");
    HEC001 a_misread_tool_pose_is_not_reported_as_handeye_error: |log| {
        watch_target(log, Camera::InBase);
        log.run.pose.encoding = crate::checks::ord::misread("rotvec", "euler:xyz");
    } => OnlyOtherFinding("ORD001");
    HEC001 another_forearm_is_not_reported_as_handeye_error: |log| {
        watch_target(log, Camera::InHand);
        crate::checks::mdl::lengthen_forearm(&mut log.run);
    } => OtherFindingAndInconclusive("MDL001", "check the model");
    HEC001 swapped_axes_are_not_reported_as_handeye_error: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.in_body_axes = BodyAxesPart::Position;
    } => OnlyOtherFinding("HEC003");
    HEC001 no_target: |_| {} => Skipped("no camera-to-target poses");
    HEC001 a_target_with_unrelated_motion: |log| {
        watch_target(log, Camera::InHand);
        log.edit = Some(|messages| crate::checks::yaw::reverse_contents(messages, TARGET));
    } => Inconclusive("rotation does not match the hand");

    HEC002 rotations_about_one_joint: |log| {
        watch_target(log, Camera::InHand);
        (log.run.motion, log.run.amplitude) = (Motion::OneJoint(5), 1.0);
    } => info(Topic(TARGET), AmountWithoutInterval(0.0, 0.01));
    HEC002 too_small_rotations: |log| {
        watch_target(log, Camera::InBase);
        log.run.amplitude = 0.05;
    } => info(Topic(TARGET), AmountWithoutInterval(0.2, 0.1));
    HEC002 sufficient_rotations: |log| watch_target(log, Camera::InHand) => NoFindings;
    HEC002 a_slip_is_not_reported_as_too_little_rotation: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.target_slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => OnlyOtherFinding("HEC001");
    HEC002 target_visible_for_one_second: |log| {
        watch_target(log, Camera::InHand);
        (log.run.duration_s, log.run.amplitude) = (1.2, 0.1);
    } => Inconclusive("s; record 10 s or more");
    HEC002 no_target_to_rotate: |_| {} => Skipped("no camera-to-target poses");

    HEC003 body_axes_under_an_optical_frame: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.in_body_axes = BodyAxesPart::Whole;
    } => error(Topic(TARGET), IsReadAs(BODY, OPTICAL));
    HEC003 body_axes_under_an_optical_name: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.in_body_axes = BodyAxesPart::Whole;
        log.run.target.has_frame = false;
    } => error(Topic(TARGET), IsReadAs(BODY, OPTICAL));
    HEC003 a_position_in_body_axes: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.in_body_axes = BodyAxesPart::Position;
        log.run.target.has_frame = false;
    } => error(Topic(TARGET), IsReadAs(BODY, OPTICAL));
    HEC003 a_position_in_body_axes_of_a_fixed_camera: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.in_body_axes = BodyAxesPart::Position;
    } => error(Topic(TARGET), IsReadAs(BODY, OPTICAL));
    HEC003 axes_as_the_frames_say: |log| watch_target(log, Camera::InHand) => NoFindings;
    HEC003 axes_as_the_name_says: |log| {
        watch_target(log, Camera::InBase);
        log.run.target.has_frame = false;
    } => NoFindings;
    HEC003 a_tilted_camera_is_not_reported_as_axis_convention: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.mount_error = tilted_mount(5.0);
    } => OnlyOtherFinding("HEC001");
    HEC003 no_target_with_axes: |_| {} => Skipped("no camera-to-target poses");
    HEC003 unknown_camera_axes: |log| {
        watch_target(log, Camera::InHand);
        log.run.target.frame_id = "cam".to_owned();
        log.run.target.has_frame = false;
    } => Skipped("camera axis convention unknown");
}

/// Adds a camera to the log.
pub fn add_camera(log: &mut Log) {
    log.run.add_camera(Camera::InHand).expect("the arm has a tip");
}

/// Adds a camera, and a motion that keeps the target in its view.
pub fn watch_target(log: &mut Log, camera: Camera) {
    log.run.add_camera(camera).expect("the arm has a tip");
    log.run.amplitude = 0.45;
}

/// Scales the depth of the target.
fn scale_depth(messages: &mut [Message], times: f64) {
    for message in messages.iter_mut().filter(|message| message.topic == TARGET) {
        for field in message.fields() {
            if let Field::Xyz(at, _) = field {
                let [x, y, z]: [f64; 3] = message.floats(at);
                message.set_floats(at, &[x, y, times * z]);
            }
        }
    }
}

/// Removes the arm, and keeps hand and target.
fn remove_arm(log: &mut Log) {
    log.run.joints.timing.rate_hz = 0.0;
    log.run.tf.timing.rate_hz = 0.0;
    log.run.imu.timing.rate_hz = 0.0;
    log.run.has_description = false;
}

fn tilted_mount(degrees: f64) -> Pose {
    let axis = Vec3::new(0.6, 0.0, 0.8);
    pose([0.0; 3], rotation_from_rotvec(axis * degrees.to_radians()))
}

fn row<'a>(report: &'a Report, code: &str) -> &'a poseaudit::finding::CheckRow {
    report.checks.iter().find(|row| row.code == code).expect("it was asked")
}

#[test]
fn evidence_holds_the_camera_pose_and_the_time_offset() {
    for (camera, mount) in [(Camera::InHand, "camera in hand"), (Camera::InBase, "camera fixed")] {
        let log = Log::modified(|log| {
            watch_target(log, camera);
            log.run.target.timing.latency_s = 0.035;
            log.run.target.has_frame = false;
        });
        let report = log.report();
        let evidence = &row(&report, "HEC001").evidence;
        assert_eq!(evidence["mount"], mount);
        let offset = &evidence["time_offset_s"];
        let number = |value: &serde_json::Value| value.as_f64().expect("a number");
        assert!((number(&offset["value"]) - 0.035).abs() < 1.5e-3, "{offset}");
        let truth = log.run.target.mount.translation.vector;
        for axis in 0..3 {
            let off = number(&evidence["pose"]["xyz"][axis]) - truth[axis];
            assert!(off.abs() < 1.5e-3, "{off} along {axis}");
        }
    }
}

#[test]
fn a_wrong_tag_size_is_distinguished_from_a_wrong_focal_length() {
    let finding_with = |scale: f64, edit: Option<fn(&mut Vec<Message>)>| {
        let log = Log::modified(|log| {
            watch_target(log, Camera::InHand);
            log.run.target.scale = scale;
            log.edit = edit;
        });
        single_finding(&log.report(), "HEC001", TARGET).clone()
    };
    let factor = |finding: &Finding, key: &str| finding.evidence.more.get(key)?["value"].as_f64();
    let tag = finding_with(1.1, None);
    let size = factor(&tag, "scale").expect("a size");
    assert!((size - 1.1).abs() < 5e-3 && factor(&tag, "depth_scale").is_none(), "{tag:?}");
    assert!(tag.fix.contains("configured as 40 mm measures 36."), "{}", tag.fix);
    let lens = finding_with(1.0, Some(|messages| scale_depth(messages, 0.9)));
    let depth = factor(&lens, "depth_scale").expect("a depth");
    assert!((depth - 0.9).abs() < 5e-3 && factor(&lens, "scale").is_none(), "{lens:?}");
    assert!(lens.fix.contains("fx and fy are 1") && lens.fix.contains("too small"), "{}", lens.fix);
    let both = finding_with(1.1, Some(|messages| scale_depth(messages, 0.9)));
    let [size, depth] = ["scale", "depth_scale"].map(|key| factor(&both, key).expect("both"));
    assert!((size - 1.1).abs() < 1e-2 && (depth - 0.9).abs() < 1e-2, "{both:?}");
}

#[test]
fn the_message_names_the_correction_of_target_rotations() {
    let message_with = |coding: LoggedEncoding| {
        let log = Log::modified(|log| {
            watch_target(log, Camera::InHand);
            log.run.target.encoding = coding;
        });
        let report = log.report();
        single_finding(&report, "HEC001", TARGET).message.clone()
    };
    assert!(
        message_with(LoggedEncoding::Transposed).ends_with("if target rotations are transposed")
    );
    let misread = message_with(crate::checks::ord::misread("rotvec", "euler:xyz"));
    assert!(misread.contains("target rotations are rotvec, not euler:xyz"), "{misread}");
}

#[test]
fn a_log_without_an_arm_is_audited_with_the_hand_as_pose_stream() {
    let report = Log::modified(|log| {
        watch_target(log, Camera::InHand);
        remove_arm(log);
    })
    .report();
    assert!(report.error.is_none(), "{:?}", report.error);
    assert_eq!(row(&report, "HEC001").status, Status::Pass);
    assert!(report.streams.iter().any(|stream| stream.role == "pose"));
}
