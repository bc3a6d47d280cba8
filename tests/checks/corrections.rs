//! Corrections of a log: the files that `--fix` writes, and the audit that applies them.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use poseaudit::finding::Finding;
use poseaudit::geometry::{Convention, Pose, QuaternionOrderError};
use poseaudit::report::Report;
use poseaudit::robot::Robot;
use poseaudit::synth::{self, Camera, IMU, JOINT_STATES, LoggedEncoding, POSE, TF, urdf_text};
use tempfile::TempDir;

use crate::checks::case::{Log, single_finding, summary};
use crate::checks::ord::{declare_encoding, misread, poses_to_euler_numbers};
use crate::checks::recording::{Field, Message};
use crate::checks::zer::zero_offset;

/// An audited log, its corrections, and its audit with them.
struct CorrectedLog {
    before: Report,
    folder: TempDir,
    after: Report,
}

impl CorrectedLog {
    fn audit(change: impl Fn(&mut Log)) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let dir = folder.path().join("made/for/it");
        let before = Log::modified(|log| {
            change(log);
            log.fix = Some(dir.clone());
        });
        let before = before.report();
        let after = Log::modified(|log| {
            change(log);
            log.options.corrections = Some(dir.join("corrections.toml"));
        });
        Self { before, after: after.report(), folder }
    }

    fn text(&self, name: &str) -> String {
        let path = self.folder.path().join("made/for/it").join(name);
        fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    /// Asserts that the corrections remove the findings `codes`, and that only `remaining` remain.
    #[track_caller]
    fn assert_corrects(&self, codes: &[&str], remaining: &[&str]) {
        let names = |findings: &[Finding]| -> Vec<&str> {
            let mut codes: Vec<&str> = findings.iter().map(|finding| finding.code).collect();
            codes.sort_unstable();
            codes
        };
        let mut all = [codes, remaining].concat();
        all.sort_unstable();
        let found = summary(&self.before.findings);
        assert_eq!(names(&self.before.findings), all, "before:\n{found}");
        let found = summary(&self.after.findings);
        let file = self.text("corrections.toml");
        assert_eq!(names(&self.after.findings), remaining, "after:\n{found}\nby:\n{file}");
        let notes: Vec<&str> = self.after.log.notes.iter().map(|note| note.note.as_str()).collect();
        assert!(codes.is_empty() || notes.iter().any(|note| note.starts_with("corrected: ")));
    }
}

#[test]
fn the_demos_faults_are_corrected_except_the_yaw_drift() {
    let demo = synth::demo();
    let corrected = CorrectedLog::audit(|log| {
        log.run.pose.encoding = demo.pose.encoding;
        log.run.pose.timing.latency_s = demo.pose.timing.latency_s;
        log.run.joints.zero_offsets = demo.joints.zero_offsets.clone();
        log.run.imu.yaw_drift_rad_s = demo.imu.yaw_drift_rad_s;
    });
    corrected.assert_corrects(&["LAT001", "ORD001", "ZER001"], &["YAW001"]);
    let index = corrected.text("corrections.md");
    for part in [
        "| ORD001 on /tcp_pose_broadcaster/pose | rotvec read as euler:xyz | `conventions.md`",
        "| ZER001 on shoulder_lift_joint | offset of 0.5° | `joint_offsets.yaml`, `robot_description.urdf`",
        "- YAW001 on /imu/data: ",
    ] {
        assert!(index.contains(part), "`{part}` is not in:\n{index}");
    }
    let code = corrected.text("conventions.md");
    assert!(code.contains("SciPy: `Rotation.from_rotvec([rx, ry, rz])`"), "{code}");
    let offsets = corrected.text("joint_offsets.yaml");
    assert!(offsets.contains("\"shoulder_lift_joint\":\n    offset_rad: 0.0087"), "{offsets}");
    let latency = corrected.text("latency.yaml");
    assert!(latency.contains(&format!("\"{POSE}\":\n    latency_s: 0.022")), "{latency}");
}

#[test]
fn misinterpreted_rotations_are_corrected() {
    for (is, read_as) in [
        ("rotvec", "euler:xyz"),
        ("euler:xyz", "rotvec"),
        ("euler:ZYZ", "euler:xyz"),
        ("euler:xzy@axes", "euler:xyz"),
    ] {
        let corrected = CorrectedLog::audit(|log| log.run.pose.encoding = misread(is, read_as));
        corrected.assert_corrects(&["ORD001"], &[]);
    }
    let corrected =
        CorrectedLog::audit(|log| log.run.imu.encoding = misread("euler:ZYX", "euler:xyz"));
    corrected.assert_corrects(&["ORD001"], &[]);
}

#[test]
fn quaternion_orders_and_inverses_are_corrected() {
    for (code, coding) in [
        ("ORD002", LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw)),
        ("ORD002", LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::XyzwReadAsWxyz)),
        ("ORD003", LoggedEncoding::Inverted),
        ("ORD003", LoggedEncoding::Transposed),
    ] {
        CorrectedLog::audit(|log| log.run.pose.encoding = coding).assert_corrects(&[code], &[]);
    }
    let both = CorrectedLog::audit(|log| {
        log.run.pose.encoding =
            LoggedEncoding::WrongQuaternionOrder(QuaternionOrderError::WxyzReadAsXyzw);
        log.run.pose.is_inverted = true;
    });
    both.assert_corrects(&["ORD002", "ORD003"], &[]);
    let imu = CorrectedLog::audit(|log| log.run.imu.encoding = LoggedEncoding::Transposed);
    imu.assert_corrects(&["ORD003"], &[]);
}

#[test]
fn units_and_joint_orders_are_corrected() {
    CorrectedLog::audit(|log| log.run.joints.is_in_degrees = true)
        .assert_corrects(&["ORD004"], &[]);
    let order = || Some(vec![5, 0, 1, 2, 3, 4]);
    let corrected = CorrectedLog::audit(|log| log.run.joints.number_order = order());
    corrected.assert_corrects(&["ORD005"], &[]);
    assert!(corrected.text("conventions.md").contains("wrist_3_joint, shoulder_pan_joint, "));
    CorrectedLog::audit(|log| log.run.pose.is_in_millimetres = true)
        .assert_corrects(&["ORD008"], &[]);
    CorrectedLog::audit(|log| {
        log.edit = Some(|messages| crate::checks::ord::convert_unit(messages, 0.0254))
    })
    .assert_corrects(&["ORD008"], &[]);
    let unity = "x right, y up, z forward (left-handed)";
    let corrected = CorrectedLog::audit(|log| {
        log.edit = Some(|messages| {
            let unity = "x right, y up, z forward (left-handed)";
            crate::checks::ord::convert_axes(messages, unity, unity);
        });
    });
    corrected.assert_corrects(&["ORD010"], &[]);
    assert!(corrected.text("corrections.toml").contains(unity));
    let all = CorrectedLog::audit(|log| {
        log.run.joints.is_in_degrees = true;
        log.run.joints.number_order = order();
        log.run.pose.timing.latency_s = 0.015;
    });
    all.assert_corrects(&["LAT001", "ORD004", "ORD005"], &[]);
}

#[test]
fn latencies_of_joint_states_and_derived_streams_are_corrected() {
    CorrectedLog::audit(|log| log.run.pose.timing.latency_s = -0.015)
        .assert_corrects(&["LAT001"], &[]);
    CorrectedLog::audit(|log| log.run.imu.timing.latency_s = 0.02)
        .assert_corrects(&["LAT001"], &[]);
    CorrectedLog::audit(|log| log.run.tf.timing.latency_s = 0.05).assert_corrects(&["LAT001"], &[]);
    let joints = CorrectedLog::audit(|log| {
        log.run.joints.timing.latency_s = 0.02;
        // /tf at every fourth stamp of the joint states.
        log.run.tf.timing = log.run.joints.timing.clone();
        log.run.tf.timing.rate_hz = 12.5;
    });
    joints.assert_corrects(&["LAT001"], &[]);
    let topics = joints.text("latency.yaml");
    assert!(topics.contains(JOINT_STATES) && topics.contains(&format!("\"{TF}\"")), "{topics}");
}

#[test]
fn clock_skew_is_corrected_with_its_latency() {
    let corrected = CorrectedLog::audit(|log| {
        log.run.duration_s = 20.0;
        log.run.pose.timing.skew = 600e-6;
        log.run.pose.timing.latency_s = 0.012;
    });
    corrected.assert_corrects(&["LAT001", "LAT002"], &[]);
}

#[test]
fn zero_offsets_are_corrected_by_offsets_and_by_the_model() {
    let faulty = |log: &mut Log| log.run.joints.zero_offsets = zero_offset(2, 0.6);
    let corrected = CorrectedLog::audit(faulty);
    corrected.assert_corrects(&["ZER001"], &[]);
    let patched = corrected.text("robot_description.urdf");
    let patch = corrected.text("robot_description.urdf.patch");
    let changed = patch.lines().filter(|line| line.starts_with('+') || line.starts_with('-'));
    assert_eq!(changed.count(), 4, "two headers, one line out and one in:\n{patch}");
    let [model, reported] = [&patched, &urdf_text(&Log::fault_free().run.robot)]
        .map(|text| Robot::from_urdf(text, "model").expect("a robot"));
    let tip = |robot: &Robot, q: &[f64]| {
        let link = |name| robot.link(name).expect(name);
        robot.chain(link("base"), link("tool0")).expect("a chain").forward(q)
    };
    let (q, offset) = ([0.3, -1.0, 1.2, -0.8, 0.5, 0.1], 0.6_f64.to_radians());
    let truth = [q[0], q[1], q[2] + offset, q[3], q[4], q[5]];
    let off_m = (tip(&model, &q).inverse() * tip(&reported, &truth)).translation.vector.norm();
    assert!(off_m < 2e-5, "{off_m}");

    // /tf was published with the model from before the correction.
    let file = corrected.folder.path().join("made/for/it/robot_description.urdf");
    let with_patched_model = Log::modified(|log| {
        faulty(log);
        log.options.run.robots = vec![file.display().to_string().as_str().into()];
    });
    let with_patched_model = with_patched_model.report();
    let codes: Vec<&str> = with_patched_model.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["FRM001"], "{}", summary(&with_patched_model.findings));
    assert_eq!(
        single_finding(&with_patched_model, "FRM001", TF).subject.frame.as_deref(),
        Some("tool0")
    );
}

#[test]
fn a_dh_table_is_corrected_in_its_convention_and_its_rows() {
    let faulty = |log: &mut Log| {
        crate::checks::ord::use_dh_table(log, "modified", [""; 2]);
        log.run.joints.zero_offsets = zero_offset(2, 0.6);
    };
    let folder = tempfile::tempdir().expect("a folder");
    let before = Log::modified(|log| {
        faulty(log);
        log.fix = Some(folder.path().to_owned());
    });
    let before = before.report();
    let codes: Vec<&str> = before.findings.iter().map(|finding| finding.code).collect();
    assert_eq!(codes, ["ORD007", "ZER001"]);
    let file = folder.path().join("ur5e_modified.toml");
    let text = fs::read_to_string(&file).expect("a table");
    assert!(text.contains("convention = \"standard\""), "{text}");
    assert!(text.contains("[-0.3922, 0.0, 0.0, 0.0104"), "{text}");
    let after = Log::modified(|log| {
        faulty(log);
        log.options.run.robots = vec![file.display().to_string().as_str().into()];
    });
    let after = after.report();
    assert!(after.findings.is_empty(), "{}", summary(&after.findings));
}

#[test]
fn the_zero_offset_of_a_rail_is_in_metres() {
    let corrected = CorrectedLog::audit(|log| {
        crate::checks::zer::mount_on_rail(&mut log.run);
        log.run.joints.zero_offsets = vec![0.003];
    });
    corrected.assert_corrects(&["ZER001"], &[]);
    assert!(corrected.text("corrections.toml").contains("offset_m = 0.00"));
}

#[test]
fn frames_are_corrected() {
    let base = CorrectedLog::audit(|log| {
        log.run.pose.reference_from_stream = crate::checks::frm::base_shifted_and_tilted()
    });
    base.assert_corrects(&["FRM002"], &[]);
    let command = base.text("static_transforms.sh");
    assert!(command.contains("--frame-id base --child-frame-id base_of_tcp_pose"), "{command}");
    assert!(base.text("fixed_joints.xml").contains("<parent link=\"base\"/>"));
    let tool = CorrectedLog::audit(|log| {
        log.run.pose.tip_from_stream = crate::checks::frm::tool_offset();
        log.run.pose.encoding = misread("rotvec", "euler:xyz");
        log.run.pose.reference_from_stream = crate::checks::frm::base_rotated_by_180_degrees();
    });
    tool.assert_corrects(&["FRM002", "FRM003", "ORD001"], &[]);
    let mount = CorrectedLog::audit(|log| {
        log.run.imu.mount_error = crate::checks::yaw::rotated_mount(90.0)
    });
    mount.assert_corrects(&["YAW003"], &[]);
    let command = mount.text("static_transforms.sh");
    assert!(command.contains("--frame-id tool0 --child-frame-id imu_link"), "{command}");
    assert!(command.contains(&format!("YAW003 on {IMU}")), "{command}");
}

#[test]
fn the_mount_of_an_imu_in_the_frame_of_its_link_is_a_new_frame() {
    let mount = CorrectedLog::audit(|log| {
        log.run.imu.tip_from_imu = crate::checks::yaw::rotated_mount(90.0);
        log.edit = Some(|messages| set_imu_frame(messages, b"tool0\0"));
    });
    mount.assert_corrects(&["YAW003"], &[]);
    let command = mount.text("static_transforms.sh");
    assert!(command.contains("--frame-id tool0 --child-frame-id tool0_of_imu_data"), "{command}");
    assert!(command.contains("use it as its frame_id"), "{command}");
    assert!(mount.text("fixed_joints.xml").contains("<child link=\"tool0_of_imu_data\"/>"));
}

#[test]
fn the_only_pose_in_tf_is_corrected() {
    let corrected = CorrectedLog::audit(|log| {
        log.run.pose.tip_from_stream = crate::checks::frm::tool_offset();
        log.edit = Some(publish_poses_as_transforms);
    });
    // /tf_static places the same frame.
    corrected.assert_corrects(&["FRM003"], &["FRM004"]);
    let mut findings = corrected.before.findings.iter();
    let finding = findings.find(|finding| finding.code == "FRM003").expect("a tool frame");
    assert!(finding.fix.contains("rename its child_frame_id"), "{}", finding.fix);
    let command = corrected.text("static_transforms.sh");
    assert!(command.contains("--frame-id tool0 --child-frame-id tool0_of_tf"), "{command}");
}

/// Replaces the transforms of the joints by one from the base to the tool.
fn publish_poses_as_transforms(messages: &mut Vec<Message>) {
    let is_tf = |message: &Message| message.topic == TF;
    let tf = messages.iter().find(|message| is_tf(message)).expect("transforms").clone();
    messages.retain(|message| !is_tf(message));
    for message in messages.iter_mut().filter(|message| message.topic == POSE) {
        let (mut xyz, mut xyzw) = ([0.0; 3], [0.0; 4]);
        for field in message.fields() {
            match field {
                Field::Xyz(at, _) => xyz = message.floats(at),
                Field::Xyzw(at) => xyzw = message.floats(at),
                Field::Stamp(_) => {}
            }
        }
        // The number of transforms precedes their headers.
        message.cdr.splice(4..4, [0; 4]);
        message.become_transform("base", "tool0", xyz);
        message.set_floats(message.cdr.len() - size_of_val(&xyzw), &xyzw);
        (message.topic, message.type_name) = (tf.topic.clone(), tf.type_name.clone());
        message.definition.clone_from(&tf.definition);
    }
}

/// Replaces `imu_link`, with its zero byte, by a name that needs as much padding.
fn set_imu_frame(messages: &mut [Message], name: &[u8]) {
    // Offsets after the encapsulation header and the stamp.
    const LENGTH: usize = 12;
    const NAME: usize = 16;
    const QUATERNION: usize = 28;
    for message in messages.iter_mut().filter(|message| message.topic == IMU) {
        message.cdr[LENGTH..NAME].copy_from_slice(&(name.len() as u32).to_le_bytes());
        message.cdr[NAME..QUATERNION].fill(0);
        message.cdr[NAME..NAME + name.len()].copy_from_slice(name);
    }
}

#[test]
fn a_camera_mount_is_corrected() {
    for camera in [Camera::InHand, Camera::InBase] {
        let corrected = CorrectedLog::audit(|log| {
            crate::checks::hec::watch_target(log, camera);
            log.run.target.mount_error = Pose::translation(0.0, 0.012, 0.0);
        });
        corrected.assert_corrects(&["HEC001"], &[]);
    }
}

#[test]
fn unnamed_numbers_are_corrected_in_units_and_frames() {
    let corrected = CorrectedLog::audit(|log| {
        log.options.policy.rules.ignore = vec!["TIM005".parse().expect("a rule")];
        log.run.pose.reference_from_stream = crate::checks::frm::base_shifted_and_tilted();
        log.edit =
            Some(|messages| crate::checks::ord::poses_to_numbers(messages, 1_f64.to_degrees()));
    });
    corrected.assert_corrects(&["FRM002", "ORD001"], &[]);
    assert!(corrected.text("corrections.toml").contains("convention = \"rotvec\""));
}

#[test]
fn a_corrected_unit_of_declared_angles_is_that_of_their_gimbal_lock() {
    let corrected = CorrectedLog::audit(|log| {
        declare_encoding(
            log,
            |messages| poses_to_euler_numbers(messages, Convention::RPY, 1_f64.to_degrees()),
            "euler:xyz",
        );
        (log.run.amplitude, log.run.speed) = (0.3, 1.0);
    });
    corrected.assert_corrects(&["ORD004"], &[]);
    let nearest_rad = |report: &Report| -> f64 {
        let mut rows = report.checks.iter().filter(|row| row.code == "ORD006");
        let nearest = rows.find_map(|row| row.evidence.get("nearest_rad")?.as_f64());
        nearest.expect("a distance")
    };
    let [before, after] = [&corrected.before, &corrected.after].map(nearest_rad);
    assert!((before - after).abs() < 1e-9, "{before} rad before, {after} rad after");
}

#[test]
fn findings_without_a_correction_are_listed() {
    let corrected =
        CorrectedLog::audit(|log| log.run.imu.gyro_bias_rad_s = crate::checks::yaw::gyro_bias());
    corrected.assert_corrects(&[], &["YAW004"]);
    let index = corrected.text("corrections.md");
    assert!(index.contains("## Not in these files\n\n- YAW004 on /imu/data: "), "{index}");
    let clean = CorrectedLog::audit(|_| {});
    clean.assert_corrects(&[], &[]);
    assert!(clean.text("corrections.md").contains("No finding can be corrected by a file"));
}

#[test]
fn corrections_of_one_log_are_always_the_same_bytes() {
    let written = || -> BTreeMap<String, Vec<u8>> {
        let folder = tempfile::tempdir().expect("a folder");
        let log = Log::modified(|log| {
            log.run.joints.zero_offsets = zero_offset(2, 0.6);
            log.run.pose.reference_from_stream = crate::checks::frm::base_shifted_and_tilted();
            log.run.pose.encoding = misread("rotvec", "euler:xyz");
            log.fix = Some(folder.path().to_owned());
        });
        log.report();
        let entries = fs::read_dir(folder.path()).expect("a folder").map(|entry| {
            let entry = entry.expect("an entry");
            let name = entry.file_name().to_string_lossy().into_owned();
            (name, fs::read(entry.path()).expect("a file"))
        });
        entries.collect()
    };
    let once = written();
    assert!(once.len() >= 8, "{:?}", once.keys());
    assert_eq!(once, written());
}

#[test]
fn corrections_for_unknown_topics_and_joints_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("c.toml");
    let refused = |body: &str| {
        let text = format!("schema = \"poseaudit.corrections/1\"\n{body}");
        fs::write(&path, text).expect("a file");
        // Logs of one scenario with equal options are audited once.
        let name = path.with_file_name(format!("{}-c.toml", body.len()));
        fs::rename(&path, &name).expect("it is there");
        trouble(&name)
    };
    let message = refused("[[topic]]\nname = \"/nowhere\"\nlatency_s = 0.1\n");
    assert!(message.contains("-c.toml: the log has no topic '/nowhere'; "), "{message}");
    let message = refused("[[joint]]\nname = \"knee\"\noffset_rad = 0.1\n");
    assert!(message.contains("has a joint 'knee'"), "{message}");
    let message = refused(&format!(
        "[[topic]]\nname = \"{IMU}\"\nlength_unit = {{is = \"mm\", read_as = \"m\"}}\n"
    ));
    assert!(message.contains("length_unit cannot be applied to topic"), "{message}");
}

/// The error for a sound log with these corrections.
fn trouble(corrections: &Path) -> String {
    let log = Log::modified(|log| log.options.corrections = Some(corrections.to_owned()));
    log.try_report().expect_err("it is refused").to_string()
}
