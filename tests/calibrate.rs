//! `poseaudit calibrate` end to end: logs and tables in, files out, and these files read again.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Output;

use poseaudit::geometry::{Convention, Pose, pose, rotation_from_rotvec, rotation_from_rpy};
use poseaudit::robot::{Robot, catalogue};
use serde_json::Value;
use tempfile::TempDir;

use crate::program::poseaudit;

const CLEAN: &str = "fixtures/clean.mcap";

/// Runs `calibrate` on a table of configurations of that UR10.
fn calibrate_table(log: &str, out: &str) -> Output {
    const ARM: [&str; 6] = ["--robot", "ur10", "--base", "base", "--tip", "tool0"];
    poseaudit(&[&["calibrate", log, "--out", out, "--format", "json"], &ARM[..]].concat())
}

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn json(output: &Output) -> Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {stderr}"))
}

/// A reproducible pseudo-random number in ±1.
fn noise(seed: usize) -> f64 {
    let mut state = (seed as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    state = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    state = (state ^ (state >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((state ^ (state >> 31)) >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A UR10 with link deviations of up to 0.5 mm and 0.05°.
fn robot_with_deviations() -> Robot {
    let nominal = catalogue::find("ur10").expect("it is in the catalogue");
    let [base, tip] = ["base", "tool0"].map(|name| nominal.link(name).expect("a link"));
    let links = nominal.link_path(base, tip).expect("a path");
    let deviation = |link: usize| {
        // A free base and a free tool absorb deviations before the first and after the last joint, and
        // along the last axis.
        let is_free = link == 0 || link == 6;
        let at = |axis: usize| match is_free || (link == 5 && axis % 3 == 1) {
            true => 0.0,
            false => noise(1000 + 6 * link + axis),
        };
        let turn = [3, 4, 5].map(|axis| 9e-4 * at(axis));
        pose([0, 1, 2].map(|axis| 5e-4 * at(axis)), rotation_from_rotvec(turn.into()))
    };
    let deviations: Vec<Pose> = (0..links.links.len()).map(deviation).collect();
    nominal.with_deviations(&links, &deviations, &[])
}

/// A table of `rows` configurations with the poses of a marker on the tool from a tracker: in mm, and
/// degrees of Euler angles about the moving z, y and x axes.
fn table_of_configurations(rows: usize, moves: [bool; 6]) -> String {
    let robot = robot_with_deviations();
    let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
    let chain = robot.chain(base, tip).expect("a chain");
    let world = pose([1.4, -0.3, 0.8], rotation_from_rpy([0.3, -0.2, 1.9]));
    let tool = pose([0.03, -0.02, 0.11], rotation_from_rpy([-0.4, 0.5, 0.2]));
    let mut text = "J1,J2,J3,J4,J5,J6,x,y,z,a,b,c\n".to_owned();
    for row in 0..rows {
        let q: Vec<f64> = (0..6)
            .map(|joint| if moves[joint] { 2.2 * noise(6 * row + joint) } else { 0.7 })
            .collect();
        let seen = world * chain.forward(&q) * tool;
        let noise_m = |axis: usize| 2e-5 * noise(100_000 + 3 * row + axis);
        let [x, y, z] = [0, 1, 2].map(|axis| 1e3 * (seen.translation.vector[axis] + noise_m(axis)));
        let [roll, pitch, yaw] = Convention::RPY.numbers(&seen.rotation);
        let angles = [yaw, pitch, roll].map(f64::to_degrees);
        let q: Vec<String> = q.iter().map(f64::to_string).collect();
        let _ =
            writeln!(text, "{},{x},{y},{z},{},{},{}", q.join(","), angles[0], angles[1], angles[2]);
    }
    text
}

/// Rms difference between two robots' distances of tip pairs at random configurations, m. Independent of
/// the bases.
fn tip_distance_difference_m(a: &Robot, b: &Robot) -> f64 {
    let chain = |robot: &Robot| {
        let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
        robot.chain(base, tip).expect("a chain")
    };
    let (a, b) = (chain(a), chain(b));
    let configuration =
        |k: usize| -> Vec<f64> { (0..6).map(|joint| 3.0 * noise(7000 + 6 * k + joint)).collect() };
    let squares: Vec<f64> = (0..200)
        .map(|k| {
            let (one, other) = (configuration(2 * k), configuration(2 * k + 1));
            let between = |chain: &poseaudit::robot::Chain| {
                (chain.forward(&one).translation.vector - chain.forward(&other).translation.vector)
                    .norm()
            };
            (between(&a) - between(&b)).powi(2)
        })
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn the_files_of_a_calibration_are_read_back_and_the_log_passes_with_them() {
    let folder = TempDir::new().expect("a folder");
    let out = path(&folder, "calibrated");
    let report =
        json(&poseaudit(&["calibrate", CLEAN, "--out", &out, "--force", "--format", "json"]));
    assert_eq!(report["schema"], "poseaudit.calibration/1");
    assert_eq!(report["written"], true, "{}", report["refused"]);
    assert_eq!(report["converged"], true, "{}", report["last_step"]);
    let file =
        fs::read_to_string(folder.path().join("calibrated/calibration.json")).expect("a file");
    assert_eq!(serde_json::from_str::<Value>(&file).expect("JSON"), report);
    let [width, rows] = [&report["parameters"], &report["covariance"]]
        .map(|of| of.as_array().expect("a list").len());
    assert!(width == rows && width >= 24, "{width} {rows}");
    for option in ["--robot", "--calibration", "--calibration"]
        .iter()
        .zip(["robot.urdf", "calibration.json", "calibration.yaml"])
    {
        let file = path(&folder, &format!("calibrated/{}", option.1));
        let audited = poseaudit(&["audit", CLEAN, option.0, &file, "--format", "json"]);
        let report = json(&audited);
        assert_eq!(report["verdict"], "pass", "{option:?}: {:?}", report["findings"]);
    }
}

#[test]
fn an_arm_that_equals_its_model_is_reported_and_nothing_is_written_unless_forced() {
    let folder = TempDir::new().expect("a folder");
    let out = path(&folder, "calibrated");
    let output = poseaudit(&["calibrate", CLEAN, "--out", &out]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    assert!(text.starts_with("UNCHANGED   ur5e: the arm equals its model"), "{text}");
    assert!(text.contains("nothing was written") && !Path::new(&out).exists(), "{text}");
    let report = json(&poseaudit(&["calibrate", CLEAN, "--out", &out, "--format", "json"]));
    assert_eq!(report["written"], false);
    assert_eq!(report["equals_model"], true);
    let forced = poseaudit(&["calibrate", CLEAN, "--out", &out, "--force"]);
    let text = String::from_utf8_lossy(&forced.stdout).into_owned();
    assert!(text.contains("written: ") && text.contains("over the whole workspace"), "{text}");
}

#[test]
fn a_table_without_stamps_is_calibrated_in_any_unit_and_convention() {
    let folder = TempDir::new().expect("a folder");
    let (log, out) = (path(&folder, "postures.csv"), path(&folder, "calibrated"));
    fs::write(&log, table_of_configurations(120, [true; 6])).expect("a file");
    let output = calibrate_table(&log, &out);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stdout));
    let report = json(&output);
    let stream = &report["streams"][0];
    assert_eq!(stream["read_as"], "euler:ZYX, in degrees");
    assert!(stream["after"]["m"].as_f64().expect("a number") < 3e-5, "{stream}");
    assert_eq!(report["witness"], "external");
    assert_eq!((&report["written"], &report["equals_model"]), (&true.into(), &false.into()));
    let written =
        Robot::from_file(Path::new(&path(&folder, "calibrated/robot.urdf"))).expect("a robot");
    let (before, after) = (
        tip_distance_difference_m(&robot_with_deviations(), catalogue::find("ur10").expect("ur10")),
        tip_distance_difference_m(&robot_with_deviations(), &written),
    );
    assert!(before > 5e-4 && after < 3e-5, "{before} {after}");
}

#[test]
fn poses_that_a_controller_computes_by_the_nominal_model_are_accepted_as_its_own() {
    let folder = TempDir::new().expect("a folder");
    let robot = catalogue::find("ur10").expect("it is in the catalogue");
    let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
    let chain = robot.chain(base, tip).expect("a chain");
    let record = |row: usize| {
        let q: Vec<f64> = (0..6)
            .map(|joint| [0.0, -1.2, 1.3, -1.0, -1.5, 0.3][joint] + 0.15 * noise(6 * row + joint))
            .collect();
        let pose = chain.forward(&q);
        let [x, y, z] = [0, 1, 2].map(|axis| pose.translation.vector[axis]);
        let [rx, ry, rz] = Convention::RotVec.numbers(&pose.rotation);
        format!(r#"{{"joints": {q:?}, "actual_TCP_pose": {:?}}}"#, [x, y, z, rx, ry, rz])
    };
    let records: Vec<String> = (0..12).map(record).collect();
    let (log, out) = (path(&folder, "rows.json"), path(&folder, "calibrated"));
    fs::write(&log, format!("[{}]", records.join(",\n"))).expect("a file");
    let arm = ["--robot", "ur10", "--base", "base", "--tip", "tool0"];
    let given = ["calibrate", &log, "--columns", "q[6],xyz,rot[3]", "--out", &out];
    let output = poseaudit(&[&given[..], &arm[..], &["--format", "json"]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report = json(&output);
    assert_eq!((&report["equals_model"], &report["refused"]), (&true.into(), &Value::Null));
    assert_eq!(report["witness"], "controller");
}

/// As records of JSON, and as text in another encoding than UTF-8.
#[test]
fn tables_of_configurations_are_read_in_other_formats() {
    let folder = TempDir::new().expect("a folder");
    let table = table_of_configurations(60, [true; 6]);
    let rows: Vec<Vec<&str>> =
        table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let record = |row: &Vec<&str>| {
        format!(
            r#"{{"image": "1.png", "joints": [{}], "pose": [{}]}}"#,
            row[..6].join(","),
            row[6..].join(",")
        )
    };
    let records: Vec<String> = rows.iter().map(record).collect();
    let json_path = path(&folder, "rows.json");
    fs::write(&json_path, format!("[{}]", records.join(",\n"))).expect("a file");
    let in_latin = [b"# \xb0\n".as_slice(), table.as_bytes()].concat();
    let latin_path = path(&folder, "rows.csv");
    fs::write(&latin_path, in_latin).expect("a file");
    let layout = "q[6],xyz:mm,_[3]";
    for log in [json_path, latin_path] {
        let out = path(&folder, "calibrated");
        let arguments = ["calibrate", &log, "--robot", "ur10", "--columns", layout];
        let output = poseaudit(&[&arguments[..], &["--format", "json", "--out", &out]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let report = json(&output);
        assert_eq!(report["streams"][0]["samples"], 60, "{report}");
        fs::remove_dir_all(out).expect("the folder");
    }
}

#[test]
fn a_log_with_one_moving_joint_gives_no_calibration() {
    let folder = TempDir::new().expect("a folder");
    let (log, out) = (path(&folder, "postures.csv"), path(&folder, "calibrated"));
    fs::write(&log, table_of_configurations(60, [false, false, true, false, false, false]))
        .expect("a file");
    let output = calibrate_table(&log, &out);
    let text = String::from_utf8_lossy(&output.stdout).into_owned()
        + &String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(1 | 3)), "{text}");
    assert!(!Path::new(&out).exists(), "{text}");
    if output.status.code() == Some(1) {
        let plan = json(&output)["plan"].as_str().expect("a call").to_owned();
        assert!(plan.starts_with("poseaudit plan ur10 ") && plan.contains(" --around="), "{plan}");
        assert!(plan.ends_with(" --for calibration --outside"), "{plan}");
    }
}

/// A table of positions of a tool on a nominal UR5e, in m.
fn table_of_ur5e(rows: usize, noise_m: f64) -> String {
    let robot = catalogue::find("ur5e").expect("it is in the catalogue");
    let [base, tip] = ["base_link", "tool0"].map(|name| robot.link(name).expect("a link"));
    let chain = robot.chain(base, tip).expect("a chain");
    let tool = pose([0.03, 0.02, 0.1], rotation_from_rpy([0.0, 0.0, 0.0]));
    let mut text = "J1,J2,J3,J4,J5,J6,x,y,z\n".to_owned();
    for row in 0..rows {
        let q: Vec<f64> = (0..6).map(|joint| 1.2 * noise(6 * row + joint)).collect();
        let seen = (chain.forward(&q) * tool).translation.vector;
        let [x, y, z] = [0, 1, 2].map(|axis| seen[axis] + noise_m * noise(50_000 + 3 * row + axis));
        let q: Vec<String> = q.iter().map(f64::to_string).collect();
        let _ = writeln!(text, "{},{x},{y},{z}", q.join(","));
    }
    text
}

#[test]
fn another_arm_is_refused_and_the_one_that_fits_is_named() {
    let folder = TempDir::new().expect("a folder");
    let (log, out) = (path(&folder, "poses.csv"), path(&folder, "out"));
    fs::write(&log, table_of_ur5e(30, 2e-4)).expect("a file");
    let call = |robot: &str| poseaudit(&["calibrate", &log, "--out", &out, "--robot", robot]);
    for other in ["ur5", "ur16e"] {
        let output = call(other);
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains("mm from its place"), "{text}");
        assert!(text.contains("nominal links of ur5e fit the positions within"), "{text}");
        assert!(text.contains("if it is that arm, use --robot ur5e"), "{text}");
        assert!(!Path::new(&out).exists(), "{text}");
    }
    let own = call("ur5e");
    let text = String::from_utf8_lossy(&own.stdout);
    assert_eq!(own.status.code(), Some(0), "{text}");
    assert!(text.starts_with("UNCHANGED   ur5e"), "{text}");
}

#[test]
fn positions_in_an_unknown_unit_are_refused() {
    let folder = TempDir::new().expect("a folder");
    let (log, out) = (path(&folder, "poses.csv"), path(&folder, "out"));
    let text = table_of_ur5e(30, 2e-4);
    let in_mm = |line: &str| -> String {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let cells = cells.iter().enumerate().map(|(at, it)| if at < 6 { *it } else { 1e3 * it });
        cells.map(|cell| cell.to_string()).collect::<Vec<_>>().join(",")
    };
    let lines: Vec<String> = text.lines().skip(1).map(in_mm).collect();
    fs::write(&log, format!("J1,J2,J3,J4,J5,J6,x,y,z\n{}\n", lines.join("\n"))).expect("a file");
    let output = poseaudit(&["calibrate", &log, "--out", &out, "--robot", "agilex_piper"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    assert!(stderr.contains("its positions do not match FK"), "{stderr}");
    assert!(!Path::new(&out).exists(), "{stderr}");
}

#[test]
fn a_table_of_poses_is_asked_for_its_joints() {
    let folder = TempDir::new().expect("a folder");
    let (log, out) = (path(&folder, "poses.json"), path(&folder, "out"));
    let record = |row: usize| {
        let pose: Vec<f64> = (0..6).map(|part| noise(6 * row + part)).collect();
        format!(r#"{{"pose": {pose:?}}}"#)
    };
    let records: Vec<String> = (0..20).map(record).collect();
    fs::write(&log, format!("[{}]", records.join(",\n"))).expect("a file");
    let output = calibrate_table(&log, &out);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    assert!(stderr.contains("--columns 'q[6]:deg,xyz:mm'"), "{stderr}");
    assert!(!stderr.contains("use `poseaudit calibrate`"), "{stderr}");
}

#[test]
fn a_table_needs_a_model_and_no_input_is_overwritten() {
    let folder = TempDir::new().expect("a folder");
    let log = path(&folder, "postures.csv");
    fs::write(&log, table_of_configurations(20, [true; 6])).expect("a file");
    let output = poseaudit(&["calibrate", &log, "--out", &path(&folder, "out")]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--robot"));
    let urdf = path(&folder, "robot.urdf");
    fs::write(&urdf, catalogue::find("ur10").expect("ur10").to_urdf()).expect("a file");
    let here = folder.path().display().to_string();
    let output = poseaudit(&["calibrate", &log, "--robot", &urdf, "--out", &here]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("would be lost"));
}

#[test]
fn the_calibration_next_to_the_config_is_used_on_request() {
    let folder = TempDir::new().expect("a folder");
    let config = path(&folder, "poseaudit.toml");
    fs::write(&config, "max_latency = \"1 s\"\n").expect("a file");
    let audit = |more: &[&str]| {
        let given = ["audit", CLEAN, "--calibration", "auto", "--format", "json"];
        poseaudit(&[&given[..], more].concat())
    };
    for (more, expected) in [(&[][..], "there is no config"), (&["--config", &config], "exists")] {
        let refused = audit(more);
        let stderr = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert_eq!(refused.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains("--calibration auto") && stderr.contains(expected), "{stderr}");
    }
    let here = folder.path().display().to_string();
    poseaudit(&["calibrate", CLEAN, "--out", &here, "--force"]);
    let report = json(&audit(&["--config", &config]));
    let source = report["robots"][0]["source"].as_str().expect("a source");
    assert!(source.contains("calibration.json"), "{source}");
}

/// Positions of three nests on the tool from a laser tracker, m. With `one_joint`, only one joint turns at a time.
fn table_of_nests(rows: usize, one_joint: bool) -> String {
    const NESTS: [[f64; 3]; 3] = [[0.08, 0.0, 0.1], [-0.05, 0.07, 0.09], [-0.04, -0.06, 0.16]];
    let robot = robot_with_deviations();
    let [base, tip] = ["base", "tool0"].map(|name| robot.link(name).expect("a link"));
    let chain = robot.chain(base, tip).expect("a chain");
    let world = pose([3.4, -1.3, 0.2], rotation_from_rpy([0.1, -0.2, 1.9]));
    let mut text = "J1,J2,J3,J4,J5,J6,x1,y1,z1,x2,y2,z2,x3,y3,z3\n".to_owned();
    for row in 0..rows {
        let q: Vec<f64> = (0..6)
            .map(|joint| match one_joint && joint != row % 6 {
                true => [0.3, -1.2, 1.1, -0.7, 0.9, 0.4][joint],
                false => 2.2 * noise(6 * row + joint),
            })
            .collect();
        let measured = NESTS.iter().enumerate().flat_map(|(nest, xyz)| {
            let tool = pose(*xyz, rotation_from_rpy([0.0; 3]));
            let seen = world * chain.forward(&q) * tool;
            [0, 1, 2].map(|axis| {
                seen.translation.vector[axis] + 2e-5 * noise(200_000 + 9 * row + 3 * nest + axis)
            })
        });
        let numbers: Vec<String> =
            q.iter().copied().chain(measured).map(|number| number.to_string()).collect();
        text += &(numbers.join(",") + "\n");
    }
    text
}

#[test]
fn positions_of_several_nests_calibrate_the_arm_in_one_tracker_frame() {
    let folder = TempDir::new().expect("a folder");
    for (name, one_joint, most_m) in [("nests", false, 4e-5), ("circles", true, 2.5e-4)] {
        let log = path(&folder, &format!("{name}.csv"));
        let out = path(&folder, name);
        fs::write(&log, table_of_nests(90, one_joint)).expect("a file");
        let report = json(&calibrate_table(&log, &out));
        assert_eq!(report["refused"], Value::Null, "{name}");
        let streams = report["streams"].as_array().expect("streams");
        assert_eq!(streams.len(), 3);
        assert!(
            streams.iter().all(|one| one["stream_from_base"] == streams[0]["stream_from_base"])
        );
        let written = Robot::from_file(Path::new(&out).join("robot.urdf").as_path());
        let written = written.expect("a robot");
        let error_m = tip_distance_difference_m(&robot_with_deviations(), &written);
        assert!(error_m < most_m, "{name}: {error_m}");
    }
}
