//! `poseaudit calibrate --fixed-point` on joint angles of a real Panda whose ball sits in sockets of a tool
//! (`tests/real/mukca`, MIT).

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use poseaudit::geometry::Vec3;
use poseaudit::robot::Robot;
use serde_json::Value;
use tempfile::TempDir;

use crate::program::poseaudit;

const POSITIONS: [&str; 3] = ["front", "left", "right"];

fn recorded(position: &str, hole: usize) -> String {
    let path = format!("tests/real/mukca/{position}/hole_{hole}.csv");
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path).display().to_string()
}

fn calibrate(logs: &[String], out: &Path, more: &[&str]) -> Output {
    let logs: Vec<&str> = logs.iter().map(String::as_str).collect();
    let out = out.display().to_string();
    let options = ["--fixed-point", "--robot", "franka_fer", "--tip", "fer_link8", "--out", &out];
    poseaudit(&[&["calibrate"], &logs[..], &options[..], more].concat())
}

fn json(output: &Output) -> Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {stderr}"))
}

fn held_out_mm(report: &Value, time: &str) -> f64 {
    let streams = report["streams"].as_array().expect("streams");
    let residuals = streams.iter().map(|one| one["held_out"][time]["m"].as_f64().expect("m"));
    1e3 * residuals.fold(0.0, f64::max)
}

/// Rms distance of the ball from its mean, mm.
fn closure_mm(robot: &Robot, ball: Vec3, log: &str) -> f64 {
    let link = |name: &str| robot.link(name).expect("a link");
    let chain = robot.chain(robot.root(), link("fer_link8")).expect("a chain");
    let text = fs::read_to_string(log).expect("a table");
    let points: Vec<Vec3> = text
        .lines()
        .map(|line| {
            let q: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
            let tip = chain.forward(&q);
            tip.translation.vector + tip.rotation * ball
        })
        .collect();
    let mean = points.iter().sum::<Vec3>() / points.len() as f64;
    let squares: f64 = points.iter().map(|point| (point - mean).norm_squared()).sum();
    1e3 * (squares / points.len() as f64).sqrt()
}

#[test]
fn a_ball_in_sockets_calibrates_a_real_arm_also_at_another_position() {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().join("calibrated");
    let logs: Vec<String> =
        POSITIONS[..2].iter().flat_map(|at| [0, 1].map(|hole| recorded(at, hole))).collect();
    let output = calibrate(&logs, &out, &["--distance", "0.05", "--format", "json"]);
    let report = json(&output);
    assert_eq!(output.status.code(), Some(0), "{}", report["refused"]);
    assert!(held_out_mm(&report, "before") > 5.0 && held_out_mm(&report, "after") < 0.8);
    let tool = &report["streams"][0]["tip_from_tool"]["xyz"];
    let ball = Vec3::from([0, 1, 2].map(|axis| tool[axis].as_f64().expect("a number")));
    let nominal = poseaudit::robot::catalogue::find("franka_fer").expect("a Panda");
    let written = Robot::from_file(&out.join("robot.urdf")).expect("a robot");
    for hole in [0, 1] {
        let log = recorded("right", hole);
        let (before, after) = (closure_mm(nominal, ball, &log), closure_mm(&written, ball, &log));
        assert!(before > 2.0 && after < 0.4, "{before} {after}");
    }
    for distance in report["distances"].as_array().expect("two pairs") {
        let after = distance["after_m"].as_f64().expect("a number");
        assert!((after - 0.05).abs() < 0.3e-3, "{distance}");
    }
}

#[test]
fn a_file_whose_ball_moved_is_left_out_and_the_others_are_used() {
    let folder = TempDir::new().expect("a folder");
    let moved = folder.path().join("moved.csv");
    let rows = |hole| fs::read_to_string(recorded("right", hole)).expect("a table");
    let first = rows(0).lines().take(12).map(str::to_owned).collect::<Vec<_>>();
    let second = rows(1).lines().take(12).map(str::to_owned).collect::<Vec<_>>();
    fs::write(&moved, [first, second].concat().join("\n")).expect("a file");
    let few = folder.path().join("few.csv");
    fs::write(&few, rows(0).lines().take(3).collect::<Vec<_>>().join("\n")).expect("a file");
    let mut logs: Vec<String> =
        POSITIONS.iter().flat_map(|at| [0, 1].map(|hole| recorded(at, hole))).collect();
    logs.extend([&moved, &few].map(|path: &PathBuf| path.display().to_string()));
    let output = calibrate(&logs, &folder.path().join("out"), &["--format", "json"]);
    let report = json(&output);
    assert_eq!(output.status.code(), Some(0), "{}", report["refused"]);
    assert_eq!(report["streams"].as_array().map(Vec::len), Some(6));
    // Without a given distance, the nominal lengths determine the scale.
    let point = |stream: usize| {
        let xyz = &report["streams"][stream]["fixed_point_in_base"];
        Vec3::from([0, 1, 2].map(|axis| xyz[axis].as_f64().expect("a number")))
    };
    for first in [0, 2, 4] {
        let distance = (point(first) - point(first + 1)).norm();
        assert!((distance - 0.05).abs() < 0.5e-3, "{distance}");
    }
    let left_out = report["left_out"].to_string();
    assert!(left_out.contains("moved.csv: the point moves by"), "{left_out}");
    assert!(left_out.contains("after row 12"), "{left_out}");
    assert!(left_out.contains("few.csv: only 3 rows"), "{left_out}");
}

/// Joint positions of a table.
fn rows(log: &str) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(log).expect("a table");
    let row = |line: &str| line.split(',').map(|cell| cell.parse().expect("a number")).collect();
    text.lines().map(row).collect()
}

/// 50 joint states per second: the arm rests for 1.4 s in each row, and moves for 1 s to the next.
fn stamped(rows: &[Vec<f64>]) -> String {
    let names: Vec<String> = (1..=7).map(|joint| format!("fer_joint{joint}")).collect();
    let mut text = format!("time,{}\n", names.join(","));
    let mut at = 0;
    for (row, next) in rows.iter().zip(rows.iter().skip(1).chain(rows.last())) {
        for share in std::iter::repeat_n(0.0, 70).chain((1..50).map(|step| f64::from(step) / 50.0))
        {
            let q = row.iter().zip(next).map(|(a, b)| format!("{:.9}", a + share * (b - a)));
            text += &format!("{:.3},{}\n", 0.02 * f64::from(at), q.collect::<Vec<_>>().join(","));
            at += 1;
        }
    }
    text
}

#[test]
fn rests_of_a_log_and_lists_give_the_same_result_as_tables() {
    let folder = TempDir::new().expect("a folder");
    let tables: Vec<String> =
        POSITIONS[..2].iter().flat_map(|at| [0, 1].map(|hole| recorded(at, hole))).collect();
    let line = |row: &Vec<f64>| format!("{row:?}");
    let record = |row: &Vec<f64>| format!("{{\"joint_positions\": {row:?}}}");
    let lists = [
        ("a/log.csv", stamped(&rows(&tables[0]))),
        (
            "a/list.yaml",
            "- ".to_owned() + &rows(&tables[1]).iter().map(line).collect::<Vec<_>>().join("\n- "),
        ),
        (
            "b/list.json",
            format!("[{}]", rows(&tables[2]).iter().map(record).collect::<Vec<_>>().join(",")),
        ),
        ("b/hole.csv", fs::read_to_string(&tables[3]).expect("a table")),
    ];
    let logs = lists.map(|(name, text)| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(&path, text).expect("a file");
        path.display().to_string()
    });
    let [from_tables, from_lists] = [tables, logs.to_vec()].map(|logs| {
        let out = folder.path().join("out");
        let output = calibrate(&logs, &out, &["--distance", "0.05", "--format", "json"]);
        let report = json(&output);
        assert_eq!(output.status.code(), Some(0), "{} {}", report["refused"], report["left_out"]);
        report
    });
    let difference = held_out_mm(&from_tables, "after") - held_out_mm(&from_lists, "after");
    assert!(difference.abs() < 0.02, "{difference}");
}

#[test]
fn a_log_in_which_the_arm_does_not_rest_is_refused() {
    let folder = TempDir::new().expect("a folder");
    let log = folder.path().join("log.csv");
    fs::write(&log, stamped(&rows(&recorded("front", 0))[..4])).expect("a file");
    let output = calibrate(&[log.display().to_string()], &folder.path().join("out"), &[]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(3), "{stderr}");
    assert!(stderr.contains("rest in only 4 configurations"), "{stderr}");
}

#[test]
fn an_unusable_file_is_refused_in_one_line() {
    let folder = TempDir::new().expect("a folder");
    let recorded = fs::read_to_string(recorded("front", 0)).expect("a table");
    let six: Vec<String> =
        recorded.lines().map(|line| line.rsplit_once(',').expect("columns").0.to_owned()).collect();
    let scattered: Vec<String> = (0..20)
        .map(|row| {
            (0..7)
                .map(|q| format!("{}", ((row * 7 + q) as f64).sin()))
                .collect::<Vec<_>>()
                .join(",")
        })
        .collect();
    let cases = [
        ("few.csv", "1,2,3,4,5,6,7\n1,2,3,4,5,6,7\n".to_owned(), "only 2 rows"),
        ("six.csv", six.join("\n"), "has 6 columns, but the arm has 7 joints"),
        (
            "words.csv",
            "a,b\n1,2\n3,4\n5,6\n7,8\n9,1\n2,3\n".to_owned(),
            "has no columns for the joints",
        ),
        ("scattered.csv", scattered.join("\n"), "mm rms from one point"),
        ("bytes.csv", "\0\u{1}\u{2}".to_owned(), "unknown binary data"),
    ];
    for (name, text, expected) in cases {
        let log = folder.path().join(name);
        fs::write(&log, text).expect("a file");
        let output = calibrate(&[log.display().to_string()], &folder.path().join("out"), &[]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{name}: {stderr}");
        assert!(stderr.contains(expected) && stderr.trim().lines().count() == 1, "{stderr}");
    }
    let pair = calibrate(
        &[self::recorded("front", 0), self::recorded("left", 1)],
        &folder.path().join("out"),
        &["--distance", "0.05"],
    );
    let stderr = String::from_utf8_lossy(&pair.stderr).into_owned();
    assert_eq!(pair.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("no folder has exactly two files"), "{stderr}");
}
