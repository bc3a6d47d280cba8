//! Two pose streams without joint states.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use poseaudit::finding::{Estimate, Finding, Severity};
use poseaudit::geometry::{Pose, Vec3, pose, rotation_from_rotvec, xyz_of, xyzw_from_rotation};
use poseaudit::report::{Report, Verdict};
use poseaudit::run::RunOptions;
use poseaudit::{Options, audit};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const SECONDS: f64 = 40.0;

/// Path of a body that moves and turns.
fn body_at(t_s: f64) -> Pose {
    let wave = |rate: f64, phase: f64| (TAU * rate * t_s + phase).sin();
    let xyz = [0.3 * wave(0.11, 0.0), 0.25 * wave(0.17, 1.0), 0.8 + 0.2 * wave(0.23, 2.0)];
    let turn = Vec3::new(0.8 * wave(0.13, 0.5), 0.7 * wave(0.19, 1.5), 1.1 * wave(0.07, 2.5));
    pose(xyz, rotation_from_rotvec(turn))
}

/// World of the second stream, and its body on the first.
fn frames() -> [Pose; 2] {
    [
        pose([1.5, -0.7, 0.2], rotation_from_rotvec(Vec3::new(0.2, -0.4, 2.1))),
        pose([0.04, -0.02, 0.11], rotation_from_rotvec(Vec3::new(1.2, 0.3, -0.5))),
    ]
}

fn in_its_frames(body: &Pose) -> Pose {
    let [world, on_body] = frames();
    world * body * on_body
}

/// A TUM file with noise of 0.2 mm and 0.02°.
fn write(path: &Path, rate_hz: f64, seed: u64, pose_at: impl Fn(f64) -> Pose) -> PathBuf {
    let mut random = Pcg64::seed_from_u64(seed);
    let mut noise = |size: f64| {
        // A sum of twelve uniform numbers is nearly normal.
        let mut normal = || (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
        Vec3::new(size * normal(), size * normal(), size * normal())
    };
    let mut text = String::new();
    for row in 0..(SECONDS * rate_hz) as usize {
        // The stamps of two devices do not coincide.
        let t_s = (row as f64 + 0.3 * seed as f64) / rate_hz;
        let mut pose = pose_at(t_s);
        pose.translation.vector += noise(2e-4);
        pose.rotation *= rotation_from_rotvec(noise(0.02_f64.to_radians()));
        let _ = write!(text, "{:.6}", 1_780_000_000.0 + t_s);
        for number in xyz_of(&pose).into_iter().chain(xyzw_from_rotation(&pose.rotation)) {
            let _ = write!(text, " {number:.7}");
        }
        text.push('\n');
    }
    fs::write(path, text).expect("written");
    path.to_owned()
}

/// Files of the first and the second stream.
fn write_pair(
    folder: &Path,
    first: impl Fn(f64) -> Pose,
    second: impl Fn(f64) -> Pose,
) -> Vec<PathBuf> {
    vec![
        write(&folder.join("a.tum"), 100.0, 1, first),
        write(&folder.join("b.tum"), 60.0, 2, second),
    ]
}

fn audited(logs: &[PathBuf], reference: Option<&str>) -> Report {
    let run = RunOptions { reference: reference.map(str::to_owned), ..RunOptions::default() };
    let options = Options { logs: logs.to_vec(), run, ..Options::default() };
    audit(&options).expect("an audit").into_report()
}

/// The second stream against the first, which is right.
fn compared(second: impl Fn(f64) -> Pose) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    audited(&write_pair(folder.path(), body_at, second), Some("a"))
}

fn only_fault<'a>(report: &'a Report, code: &str) -> &'a Finding {
    let faults = report.findings.iter().filter(|finding| finding.severity > Severity::Info);
    let faults: Vec<&Finding> = faults.collect();
    let [fault] = faults.as_slice() else { panic!("{faults:?}") };
    assert_eq!(fault.code, code, "{fault:?}");
    fault
}

fn value_of(finding: &Finding) -> f64 {
    finding.estimate.as_ref().and_then(Estimate::value).expect("a value")
}

/// Whether `value` is within twice the 95 % interval.
fn assert_contains(finding: &Finding, value: f64) {
    let (Some(Estimate::Scalar { ci95, .. } | Estimate::Frame { ci95, .. }), found) =
        (&finding.estimate, value_of(finding))
    else {
        panic!("{finding:?}")
    };
    let [low, high] = ci95.expect("an interval").map(|end| found + 2.0 * (end - found));
    assert!((low..=high).contains(&value), "{value}: {finding:?}");
}

#[test]
fn a_healthy_pair_passes_and_its_unknown_frames_are_estimated() {
    let report = compared(|t_s| in_its_frames(&body_at(t_s)));
    assert_eq!(report.verdict, Verdict::Pass, "{:?}", report.findings);
    let [world, on_body] = frames();
    for (code, frame) in [("FRM002", world), ("FRM003", on_body)] {
        let finding = report.findings.iter().find(|finding| finding.code == code);
        let finding = finding.unwrap_or_else(|| panic!("no {code}"));
        let distance_m = frame.translation.vector.norm();
        assert!((value_of(finding) - distance_m).abs() < 1e-3, "{finding:?}");
        assert_eq!(finding.subject.reference.as_deref(), Some("a"));
        assert_eq!(finding.subject.robot, None);
    }
    let [row] = report.comparisons.as_slice() else { panic!("{:?}", report.comparisons) };
    assert_eq!((row.topic.as_str(), row.reference.as_str()), ("b", "a"));
    assert!(row.pairs > 2000 && row.ate_aligned.is_some(), "{row:?}");
}

#[test]
fn the_reference_decides_the_sign_of_a_latency() {
    const LATENCY_S: f64 = 0.045;
    let folder = tempfile::tempdir().expect("a folder");
    let late = |t_s: f64| in_its_frames(&body_at(t_s - LATENCY_S));
    let logs = write_pair(folder.path(), body_at, late);
    for (reference, sign) in [("a", 1.0), ("b", -1.0)] {
        let report = audited(&logs, Some(reference));
        let fault = only_fault(&report, "LAT001");
        assert_eq!(fault.subject.reference.as_deref(), Some(reference));
        assert_contains(fault, sign * LATENCY_S);
    }
}

#[test]
fn a_slip_of_a_few_standard_deviations_is_named_with_its_size() {
    const SLIP_M: f64 = 1.5e-3;
    let slip = pose([0.0, SLIP_M, 0.0], rotation_from_rotvec(Vec3::zeros()));
    let report = compared(|t_s| {
        let body = in_its_frames(&body_at(t_s));
        if t_s < 23.0 { body } else { body * slip }
    });
    assert_contains(only_fault(&report, "FRM003"), SLIP_M);
}

#[test]
fn a_drifting_frame_is_named_with_its_rotation() {
    let rate_rad_s = 2_f64.to_radians() / 60.0;
    let report = compared(|t_s| {
        let drift = rotation_from_rotvec(Vec3::new(0.0, 0.0, rate_rad_s * t_s));
        pose([0.0; 3], drift) * in_its_frames(&body_at(t_s))
    });
    let fault = only_fault(&report, "FRM002");
    assert!(fault.message.contains("drifts"), "{}", fault.message);
    let Some(Estimate::Frame { rotation, .. }) = &fault.estimate else { panic!("{fault:?}") };
    let drift_rad = rate_rad_s * SECONDS;
    assert!((rotation.value - drift_rad).abs() < 0.02 * drift_rad, "{fault:?}");
}

#[test]
fn an_error_of_the_reference_is_found_by_exchanging_the_streams() {
    let folder = tempfile::tempdir().expect("a folder");
    let in_mm = |t_s: f64| {
        let Pose { mut translation, rotation } = body_at(t_s);
        translation.vector *= 1000.0;
        Pose::from_parts(translation, rotation)
    };
    let logs = write_pair(folder.path(), in_mm, |t_s| in_its_frames(&body_at(t_s)));
    let report = audited(&logs, Some("a"));
    let fault = only_fault(&report, "ORD008");
    assert_eq!(fault.subject.topic.as_deref(), Some("a"));
    assert_eq!(fault.subject.reference.as_deref(), Some("b"));
}

#[test]
fn a_third_stream_decides_which_one_is_late() {
    let folder = tempfile::tempdir().expect("a folder");
    let late = |t_s: f64| body_at(t_s - 0.06);
    let mut logs = write_pair(folder.path(), late, |t_s| in_its_frames(&body_at(t_s)));
    logs.push(write(&folder.path().join("c.tum"), 70.0, 5, body_at));
    let report = audited(&logs, Some("a"));
    let fault = only_fault(&report, "LAT001");
    assert_eq!(fault.subject.topic.as_deref(), Some("a"));
    assert_contains(fault, 0.06);
}

#[test]
fn another_world_does_not_change_the_latency() {
    let moved = pose([-4.0, 2.0, 1.0], rotation_from_rotvec(Vec3::new(0.5, 1.0, -0.7)));
    let late = |t_s: f64| in_its_frames(&body_at(t_s - 0.03));
    let [here, there] = [compared(late), compared(|t_s| moved * late(t_s))]
        .map(|report| value_of(only_fault(&report, "LAT001")));
    assert!((here - there).abs() < 2e-4, "{here} {there}");
}

#[test]
fn an_unknown_reference_is_an_error_of_the_call() {
    let folder = tempfile::tempdir().expect("a folder");
    let logs = write_pair(folder.path(), body_at, body_at);
    let run = RunOptions { reference: Some("/nothing".to_owned()), ..RunOptions::default() };
    let Err(trouble) = audit(&Options { logs, run, ..Options::default() }) else {
        panic!("an error")
    };
    assert_eq!(trouble.place, "--reference");
    assert!(trouble.what.contains("no topic '/nothing'"), "{}", trouble.what);
}

/// Path of a body that moves otherwise.
fn other_body_at(t_s: f64) -> Pose {
    body_at(1.7 * t_s + 90.0)
}

#[test]
fn a_file_whose_poses_do_not_follow_the_others_is_a_warning() {
    let held = |t_s: f64| if (8.0..32.0).contains(&t_s) { 8.0 } else { t_s };
    let dithered = |t_s: f64| body_at(t_s + 5.0 * (1e5 * t_s).sin());
    let faults: [&dyn Fn(f64) -> Pose; 3] = [&|t_s| body_at(held(t_s)), &dithered, &other_body_at];
    for fault in faults {
        let folder = tempfile::tempdir().expect("a folder");
        let mut logs = write_pair(folder.path(), body_at, |t_s| in_its_frames(&body_at(t_s)));
        logs.push(write(&folder.path().join("c.tum"), 70.0, 5, fault));
        let report = audited(&logs, None);
        assert_eq!(report.verdict, Verdict::Fail, "{:?}", report.findings);
        let finding = only_fault(&report, "FRM007");
        assert_eq!(finding.subject.topic.as_deref(), Some("c"));
        assert_eq!(finding.evidence.more["why"], "does-not-follow", "{finding:?}");
    }
}

#[test]
fn several_bodies_of_one_file_may_move_differently() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join("bodies.csv");
    let bodies: [(&str, &dyn Fn(f64) -> Pose); 3] = [
        ("tool", &body_at),
        ("flange", &|t_s| in_its_frames(&body_at(t_s))),
        ("person", &other_body_at),
    ];
    let columns = ["x", "y", "z", "qx", "qy", "qz", "qw"];
    let mut text = "time".to_owned();
    for (name, _) in &bodies {
        for column in columns {
            let _ = write!(text, ",{name}_{column}");
        }
    }
    for row in 0..4000 {
        let t_s = 0.01 * f64::from(row);
        let _ = write!(text, "\n{t_s:.2}");
        for pose in bodies.iter().map(|(_, pose_at)| pose_at(t_s)) {
            for number in xyz_of(&pose).into_iter().chain(xyzw_from_rotation(&pose.rotation)) {
                let _ = write!(text, ",{number:.6}");
            }
        }
    }
    fs::write(&log, text).expect("written");
    let report = audited(&[log], None);
    assert_eq!(report.verdict, Verdict::Pass, "{:?}", report.findings);
    assert!(
        report.findings.iter().all(|finding| finding.code != "FRM007"),
        "{:?}",
        report.findings
    );
}
