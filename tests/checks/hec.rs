//! HEC: hand-eye calibration.

use poseaudit::finding::{Finding, Status};
use poseaudit::geometry::{Pose, QuaternionOrderError, Vec3, pose, rotation_from_rotvec};
use poseaudit::report::Report;
use poseaudit::synth::{Camera, Coding, Motion, Swapped, TARGET, TF};

use crate::checks::case::On::{Frame as OnFrame, Topic};
use crate::checks::case::What::{About, Frame, ReadAs, ResidualBetween};
use crate::checks::case::{Expected, Log, cases, error, info, the, warning};
use crate::checks::recording::{Field, Message};
use Expected::{BlamedOn, LeftOpenBy, Skipped, Sound, Undecided};

const OPTICAL: &str = "z forward, x right";
const BODY: &str = "x forward, z up";

cases! {
    HEC001 a_target_that_slips: |log| {
        watched(log, Camera::InHand);
        log.run.target.slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => warning(Topic(TARGET), ResidualBetween(0.0025, 0.0045));
    HEC001 a_target_in_the_hand_that_slips: |log| {
        watched(log, Camera::InBase);
        log.run.target.slip = Some((4.0, Pose::translation(0.0, 0.03, 0.0)));
    } => error(Topic(TARGET), ResidualBetween(0.010, 0.017));
    HEC001 a_camera_that_is_not_where_frames_say: |log| {
        watched(log, Camera::InHand);
        log.run.target.mount_error = Pose::translation(0.0, 0.012, 0.0);
    } => error(Topic(TARGET), Frame([0.012, 0.5e-3], [0.0, 0.1]));
    HEC001 a_fixed_camera_that_leans: |log| {
        watched(log, Camera::InBase);
        log.run.target.mount_error = turned(0.6);
    } => warning(Topic(TARGET), Frame([0.0, 1e-3], [0.6, 0.1]));
    HEC001 a_target_of_another_size: |log| {
        watched(log, Camera::InHand);
        log.run.target.scale = 1.1;
    } => error(Topic(TARGET), ResidualBetween(0.002, 0.05));
    HEC001 a_transposed_target: |log| {
        watched(log, Camera::InHand);
        log.run.target.coding = Coding::Transposed;
    } => error(Topic(TARGET), ResidualBetween(0.002, 0.5));
    HEC001 a_target_with_its_scalar_first: |log| {
        watched(log, Camera::InBase);
        log.run.target.coding = Coding::Slipped(QuaternionOrderError::WxyzReadAsXyzw);
    } => error(Topic(TARGET), ResidualBetween(0.002, 1.0));
    HEC001 a_misread_target: |log| {
        watched(log, Camera::InHand);
        log.run.target.coding = crate::checks::ord::misread("rotvec", "euler:xyz");
    } => error(Topic(TARGET), ResidualBetween(0.0, 0.5));
    HEC001 inverted_poses: |log| {
        watched(log, Camera::InHand);
        log.run.target.coding = Coding::Inverted;
    } => error(Topic(TARGET), Frame([0.0, 1e-3], [0.0, 0.1]));

    HEC001 a_camera_in_the_hand: |log| watched(log, Camera::InHand) => Sound;
    HEC001 a_fixed_camera: |log| watched(log, Camera::InBase) => Sound;
    HEC001 a_late_target: |log| {
        watched(log, Camera::InHand);
        log.run.target.timing.latency_s = 0.08;
    } => BlamedOn("LAT001");
    HEC001 a_lens_of_another_focal_length: |log| {
        watched(log, Camera::InHand);
        log.edit = Some(|messages| deepen(messages, 0.8));
    } => error(Topic(TARGET), ResidualBetween(0.005, 0.2));
    HEC001 a_noisy_target: |log| {
        watched(log, Camera::InHand);
        log.run.duration_s = 20.0;
        (log.run.noise.target_m, log.run.noise.target_rad) = (2e-3, 5e-3);
    } => Sound;
    HEC001 an_arm_on_a_rail: |log| {
        crate::checks::zer::on_a_rail(&mut log.run);
        watched(log, Camera::InHand);
    } => Sound;
    HEC001 a_tag_on_tf: |log| {
        watched(log, Camera::InHand);
        log.run.target.in_tf = Some("tag_3".to_owned());
    } => Sound;
    HEC001 without_a_model: |log| {
        watched(log, Camera::InHand);
        without_arm(log);
    } => Sound;
    HEC001 by_transforms_alone: |log| {
        watched(log, Camera::InHand);
        without_arm(log);
        log.run.pose.timing.rate_hz = 0.0;
        log.run.tf.timing.rate_hz = 50.0;
        log.run.target.in_tf = Some("tag_3".to_owned());
    } => Sound;
    HEC001 a_tag_that_slips_on_tf: |log| {
        watched(log, Camera::InHand);
        log.run.target.in_tf = Some("tag_3".to_owned());
        log.run.target.slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => warning(OnFrame(TF, "tag_3"), ResidualBetween(0.0025, 0.0045));

    HEC001 a_joints_zero_is_no_open_chain: |log| {
        watched(log, Camera::InHand);
        log.run.joints.zero_offsets = crate::checks::zer::zero(2, 0.6);
    } => BlamedOn("ZER001");
    HEC001 a_late_tool_pose_is_no_open_chain: |log| {
        watched(log, Camera::InHand);
        log.run.pose.timing.latency_s = 0.05;
    } => BlamedOn("LAT001");
    HEC001 a_misread_tool_pose_is_no_open_chain: |log| {
        watched(log, Camera::InBase);
        log.run.pose.coding = crate::checks::ord::misread("rotvec", "euler:xyz");
    } => BlamedOn("ORD001");
    HEC001 another_forearm_is_no_open_chain: |log| {
        watched(log, Camera::InHand);
        crate::checks::mdl::lengthen_forearm(&mut log.run);
    } => LeftOpenBy("MDL001", "check the model");
    HEC001 swapped_axes_are_no_open_chain: |log| {
        watched(log, Camera::InHand);
        log.run.target.swapped = Swapped::Position;
    } => BlamedOn("HEC003");
    HEC001 no_target: |_| {} => Skipped("no camera-to-target poses");
    HEC001 a_target_of_another_motion: |log| {
        watched(log, Camera::InHand);
        log.edit = Some(|messages| crate::checks::yaw::reverse(messages, TARGET));
    } => Undecided("rotation does not match the hand");

    HEC002 one_joint: |log| {
        watched(log, Camera::InHand);
        (log.run.motion, log.run.amplitude) = (Motion::OneJoint(5), 1.0);
    } => info(Topic(TARGET), About(0.0, 0.01));
    HEC002 small_turns: |log| {
        watched(log, Camera::InBase);
        log.run.amplitude = 0.05;
    } => info(Topic(TARGET), About(0.2, 0.1));
    HEC002 enough_turns: |log| watched(log, Camera::InHand) => Sound;
    HEC002 a_slip_is_no_lack_of_turns: |log| {
        watched(log, Camera::InHand);
        log.run.target.slip = Some((4.0, Pose::translation(0.008, 0.0, 0.0)));
    } => BlamedOn("HEC001");
    HEC002 a_second_of_sight: |log| {
        watched(log, Camera::InHand);
        (log.run.duration_s, log.run.amplitude) = (1.2, 0.1);
    } => Undecided("s; record 10 s or more");
    HEC002 no_target_to_turn: |_| {} => Skipped("no camera-to-target poses");

    HEC003 body_axes_under_an_optical_frame: |log| {
        watched(log, Camera::InHand);
        log.run.target.swapped = Swapped::Whole;
    } => error(Topic(TARGET), ReadAs(BODY, OPTICAL));
    HEC003 body_axes_under_an_optical_name: |log| {
        watched(log, Camera::InBase);
        log.run.target.swapped = Swapped::Whole;
        log.run.target.with_frame = false;
    } => error(Topic(TARGET), ReadAs(BODY, OPTICAL));
    HEC003 a_position_in_body_axes: |log| {
        watched(log, Camera::InHand);
        log.run.target.swapped = Swapped::Position;
        log.run.target.with_frame = false;
    } => error(Topic(TARGET), ReadAs(BODY, OPTICAL));
    HEC003 a_position_in_body_axes_of_a_fixed_camera: |log| {
        watched(log, Camera::InBase);
        log.run.target.swapped = Swapped::Position;
    } => error(Topic(TARGET), ReadAs(BODY, OPTICAL));
    HEC003 axes_as_the_frames_say: |log| watched(log, Camera::InHand) => Sound;
    HEC003 axes_as_the_name_says: |log| {
        watched(log, Camera::InBase);
        log.run.target.with_frame = false;
    } => Sound;
    HEC003 a_camera_that_leans_has_its_axes: |log| {
        watched(log, Camera::InHand);
        log.run.target.mount_error = turned(5.0);
    } => BlamedOn("HEC001");
    HEC003 no_target_with_axes: |_| {} => Skipped("no camera-to-target poses");
    HEC003 no_word_of_the_axes: |log| {
        watched(log, Camera::InHand);
        log.run.target.frame_id = "cam".to_owned();
        log.run.target.with_frame = false;
    } => Skipped("camera axis convention unknown");
}

/// Adds a camera to the log.
pub fn add_camera(log: &mut Log) {
    log.run.watch(Camera::InHand).expect("the arm has a tip");
}

/// Adds a camera, and a motion that keeps the target in its view.
pub fn watched(log: &mut Log, camera: Camera) {
    log.run.watch(camera).expect("the arm has a tip");
    log.run.amplitude = 0.45;
}

/// Scales the depth of the target.
fn deepen(messages: &mut [Message], times: f64) {
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
fn without_arm(log: &mut Log) {
    log.run.joints.timing.rate_hz = 0.0;
    log.run.tf.timing.rate_hz = 0.0;
    log.run.imu.timing.rate_hz = 0.0;
    log.run.description = false;
}

fn turned(degrees: f64) -> Pose {
    let axis = Vec3::new(0.6, 0.0, 0.8);
    pose([0.0; 3], rotation_from_rotvec(axis * degrees.to_radians()))
}

fn row<'a>(report: &'a Report, code: &str) -> &'a poseaudit::finding::CheckRow {
    report.checks.iter().find(|row| row.code == code).expect("it was asked")
}

#[test]
fn the_camera_and_the_offset_are_evidence() {
    for (camera, mount) in [(Camera::InHand, "camera in hand"), (Camera::InBase, "camera fixed")] {
        let log = Log::with(|log| {
            watched(log, camera);
            log.run.target.timing.latency_s = 0.035;
            log.run.target.with_frame = false;
        });
        let report = log.audited();
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
fn a_tag_of_another_size_is_told_from_a_lens() {
    let audited = |scale: f64, edit: Option<fn(&mut Vec<Message>)>| {
        let log = Log::with(|log| {
            watched(log, Camera::InHand);
            log.run.target.scale = scale;
            log.edit = edit;
        });
        the(&log.audited(), "HEC001", TARGET).clone()
    };
    let factor = |finding: &Finding, key: &str| finding.evidence.more.get(key)?["value"].as_f64();
    let tag = audited(1.1, None);
    let size = factor(&tag, "scale").expect("a size");
    assert!((size - 1.1).abs() < 5e-3 && factor(&tag, "depth_scale").is_none(), "{tag:?}");
    assert!(tag.fix.contains("configured as 40 mm measures 36."), "{}", tag.fix);
    let lens = audited(1.0, Some(|messages| deepen(messages, 0.9)));
    let depth = factor(&lens, "depth_scale").expect("a depth");
    assert!((depth - 0.9).abs() < 5e-3 && factor(&lens, "scale").is_none(), "{lens:?}");
    assert!(lens.fix.contains("fx and fy are 1") && lens.fix.contains("too small"), "{}", lens.fix);
    let both = audited(1.1, Some(|messages| deepen(messages, 0.9)));
    let [size, depth] = ["scale", "depth_scale"].map(|key| factor(&both, key).expect("both"));
    assert!((size - 1.1).abs() < 1e-2 && (depth - 0.9).abs() < 1e-2, "{both:?}");
}

#[test]
fn what_mends_a_target_is_said() {
    let said = |coding: Coding| {
        let log = Log::with(|log| {
            watched(log, Camera::InHand);
            log.run.target.coding = coding;
        });
        let report = log.audited();
        the(&report, "HEC001", TARGET).message.clone()
    };
    assert!(said(Coding::Transposed).ends_with("if target rotations are transposed"));
    let misread = said(crate::checks::ord::misread("rotvec", "euler:xyz"));
    assert!(misread.contains("target rotations are rotvec, not euler:xyz"), "{misread}");
}

#[test]
fn a_log_without_an_arm_is_a_report_and_its_hand_a_pose() {
    let report = Log::with(|log| {
        watched(log, Camera::InHand);
        without_arm(log);
    })
    .audited();
    assert!(report.error.is_none(), "{:?}", report.error);
    assert_eq!(row(&report, "HEC001").status, Status::Pass);
    assert!(report.streams.iter().any(|stream| stream.role == "pose"));
}
