//! Tables with unnamed columns: the columns are identified by their numbers, or a question is asked.

use std::fs;
use std::path::{Path, PathBuf};

use poseaudit::config::{Config, template};
use poseaudit::finding::Status;
use poseaudit::geometry::xyzw_from_rotation;
use poseaudit::log::ColumnSettings;
use poseaudit::report::{Report, Verdict};
use poseaudit::{Options, audit};

use crate::tables::{CLEAN, STEP_S, Table, amount, causes, report, ur5e};

/// Writes columns called `t`, `c0`, `c1` and so on, or `names`.
fn csv(folder: &Path, rows: &[Vec<f64>], names: Option<&[&str]>) -> PathBuf {
    let count = rows[0].len() - 1;
    let plain = || std::iter::once("t".to_owned()).chain((0..count).map(|at| format!("c{at}")));
    let header: Vec<String> = match names {
        Some(names) => names.iter().map(|name| (*name).to_owned()).collect(),
        None => plain().collect(),
    };
    let mut text = header.join(",");
    for row in rows {
        let cells: Vec<String> = row.iter().map(|number| format!("{number:.9}")).collect();
        text += &format!("\n{}", cells.join(","));
    }
    let path = folder.join("run.csv");
    fs::write(&path, text + "\n").expect("a file");
    path
}

fn told(rows: &[Vec<f64>], robot: Option<&str>) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    report(&csv(folder.path(), rows, None), robot, ColumnSettings::default()).expect("a report")
}

/// The columns of a topic.
fn columns(report: &Report, topic: &str) -> Vec<String> {
    let own = report.streams.iter().find(|stream| stream.topic == topic);
    own.map(|stream| stream.columns.clone()).unwrap_or_default()
}

fn numbered(range: std::ops::Range<usize>) -> Vec<String> {
    range.map(|at| format!("c{at}")).collect()
}

/// The rows of a table with additional numbers, computed from row index and content.
fn with(table: &Table, more: impl Fn(usize, &[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
    let rows = table.rows();
    let longer = |(at, row): (usize, &Vec<f64>)| {
        let mut longer = vec![row[0]];
        longer.extend(more(at, row));
        longer.extend(&row[1..]);
        longer
    };
    rows.iter().enumerate().map(longer).collect()
}

#[test]
fn joints_and_pose_are_found_among_others_in_any_unit() {
    // Preceded by a gripper, noise, and the rates of two joints.
    let others = |at: usize, row: &[f64]| {
        let noise = ((at * 7919) % 1009) as f64 / 1009.0;
        vec![f64::from(u8::from(at % 200 > 90)), noise, row[0].sin(), (0.7 * row[0]).cos()]
    };
    for table in [CLEAN, Table { unit: 1_f64.to_degrees(), rpy: true, ..CLEAN }] {
        let found = told(&with(&table, others), None);
        let width = if table.rpy { 6 } else { 7 };
        assert_eq!(columns(&found, "joints"), numbered(4..10), "{:?}", found.error);
        assert_eq!(columns(&found, "pose"), numbered(10..10 + width));
        assert_eq!((found.verdict, causes(&found)), (Verdict::Pass, Vec::new()));
        assert_eq!(found.robots[0].name, "ur5e");
        let gripper = found.streams.iter().find(|stream| stream.topic == "c0").expect("listed");
        assert!(gripper.reason.contains("two values"), "{}", gripper.reason);
    }
}

#[test]
fn faults_are_named_as_with_names_and_the_config_of_init_finds_the_same() {
    let folder = tempfile::tempdir().expect("a folder");
    for (table, code, truth, within) in [
        (Table { late_s: 0.06, ..CLEAN }, "LAT001", 0.06, 5e-4),
        (Table { elbow: -0.5_f64.to_radians(), ..CLEAN }, "ZER001", 0.5_f64.to_radians(), 2e-4),
    ] {
        let path = csv(folder.path(), &table.rows(), None);
        let found = report(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
        assert_eq!(causes(&found), [code], "{:?}", found.findings);
        assert!((amount(&found, code) - truth).abs() < within, "{}", amount(&found, code));
        let written = template(&found);
        assert!(written.contains("joints = [\"c0\", \"c1\""), "{written}");
        let config = Config::from_text(written, Path::new("p.toml")).expect("a config");
        let mut options = Options { logs: vec![path], ..config.options() };
        options.run.robots = vec!["ur5e".into()];
        let again = audit(&options).expect("a report").into_report();
        let said = |report: &Report| -> Vec<String> {
            report.findings.iter().map(|one| serde_json::json!(one).to_string()).collect()
        };
        assert_eq!(said(&again), said(&found));
    }
}

#[test]
fn commands_lead_and_copies_are_said() {
    let rows = CLEAN.rows();
    let lead = (0.1 / STEP_S) as usize;
    // The commands lead the joints by five rows.
    let ahead = |at: usize, _: &[f64]| rows[(at + lead).min(rows.len() - 1)][1..7].to_vec();
    let found = told(&with(&CLEAN, ahead), Some("ur5e"));
    assert_eq!(columns(&found, "joint_commands"), numbered(0..6), "{:?}", found.error);
    assert_eq!(columns(&found, "joints"), numbered(6..12));
    assert!((amount(&found, "LAT004") - 0.1).abs() < 0.02, "{}", amount(&found, "LAT004"));
    let copied = told(&with(&CLEAN, |_, row| row[1..7].to_vec()), Some("ur5e"));
    assert_eq!(columns(&copied, "pose"), numbered(12..19));
    let copies =
        copied.streams.iter().filter(|stream| stream.reason.contains("the same numbers as"));
    assert_eq!(copies.count(), 6);
}

#[test]
fn what_is_no_arm_is_silence_or_a_question() {
    let rows = CLEAN.rows();
    // Velocities with a pose, and joints with an object that is not the tool.
    let rates = |at: usize| -> Vec<f64> {
        let next = &rows[(at + 1).min(rows.len() - 1)];
        let last = &rows[at.saturating_sub(1)];
        (1..7).map(|joint| (next[joint] - last[joint]) / (2.0 * STEP_S)).collect()
    };
    let velocities = |(at, row): (usize, &Vec<f64>)| [&row[..1], &rates(at), &row[7..]].concat();
    let object = |row: &Vec<f64>| {
        let t_s = row[0];
        let point =
            [0.4 + 0.1 * (0.9 * t_s).sin(), 0.2 * (0.5 * t_s).cos(), 0.3 + 0.1 * (1.3 * t_s).sin()];
        [&row[..7], &point].concat()
    };
    let all: [Vec<Vec<f64>>; 2] =
        [rows.iter().enumerate().map(velocities).collect(), rows.iter().map(object).collect()];
    for rows in all {
        for robot in [None, Some("ur5e")] {
            let found = told(&rows, robot);
            assert!(found.robots.is_empty() && columns(&found, "joints").is_empty());
            assert_ne!(found.verdict, Verdict::Pass);
        }
    }
    // Joints and a gripper without a pose: the report suggests config lines.
    let folder = tempfile::tempdir().expect("a folder");
    let alone: Vec<Vec<f64>> = rows.iter().map(|row| [&row[..7], &[0.0]].concat()).collect();
    let path = csv(folder.path(), &alone, None);
    let found = report(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let asked = found.error.expect("a question").what;
    assert!(asked.contains("joints = [\"c0\", \"c1\""), "{asked}");
}

#[test]
fn two_arms_of_a_row_are_two_arms() {
    let (left, chain) = (CLEAN.rows(), ur5e());
    // The right arm moves in reverse, with each joint offset by 0.1 rad.
    let both = |(at, row): (usize, &Vec<f64>)| {
        let right: Vec<f64> = left[left.len() - 1 - at][1..7].iter().map(|q| q + 0.1).collect();
        let pose = chain.forward(&right);
        let xyz: [f64; 3] = pose.translation.vector.into();
        [&row[..7], &right, &row[7..], &xyz, &xyzw_from_rotation(&pose.rotation)].concat()
    };
    let rows: Vec<Vec<f64>> = left.iter().enumerate().map(both).collect();
    let found = told(&rows, Some("ur5e"));
    let mut arms: Vec<[Vec<String>; 2]> = ["first", "second"]
        .map(|arm| ["joints", "pose"].map(|topic| columns(&found, &format!("{arm}/{topic}"))))
        .to_vec();
    arms.sort();
    assert_eq!(arms[0], [numbered(0..6), numbered(12..19)], "{:?}", found.error);
    assert_eq!(arms[1], [numbered(6..12), numbered(19..26)]);
    assert_eq!((found.robots.len(), causes(&found)), (2, Vec::new()));
}

#[test]
fn names_that_the_numbers_contradict_are_a_finding() {
    let folder = tempfile::tempdir().expect("a folder");
    let status = |rows: &[Vec<f64>], names: &[&str]| {
        let path = csv(folder.path(), rows, Some(names));
        let found = report(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
        let row = found.checks.iter().find(|row| row.code == "META001").expect("it is asked");
        let finding = found.findings.iter().find(|finding| finding.code == "META001");
        (row.status, finding.map(|finding| finding.message.clone()).unwrap_or_default())
    };
    // Positions and quaternions that are named as joints.
    let poses: Vec<Vec<f64>> =
        CLEAN.rows().iter().map(|row| [&row[..1], &row[7..]].concat()).collect();
    let (found, message) = status(&poses, &["t", "q1", "q2", "q3", "q4", "q5", "q6", "q7"]);
    assert!(found == Status::Fail && message.contains("unit quaternion"), "{message}");
    // Degrees in columns named as rad.
    let degrees = Table { unit: 1_f64.to_degrees(), poses: false, ..CLEAN }.rows();
    let names = ["t", "q1_rad", "q2_rad", "q3_rad", "q4_rad", "q5_rad", "q6_rad"];
    let (found, message) = status(&degrees, &names);
    assert!(found == Status::Fail && message.contains("indicates rad"), "{message}");
}

#[test]
fn ticks_are_read_where_a_pose_tells_them_and_init_writes_their_map() {
    const TURN: f64 = 4096.0;
    let ticks = |row: &Vec<f64>| -> Vec<f64> {
        let of = |(at, number): (usize, &f64)| match at {
            1..7 => (number * TURN / std::f64::consts::TAU + 0.5 * TURN).round(),
            _ => *number,
        };
        row.iter().enumerate().map(of).collect()
    };
    let folder = tempfile::tempdir().expect("a folder");
    let late = Table { late_s: 0.06, ..CLEAN };
    let rows: Vec<Vec<f64>> = late.rows().iter().map(ticks).collect();
    let path = csv(folder.path(), &rows, None);
    let found = report(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!(columns(&found, "pose"), numbered(6..13), "{:?}", found.error);
    assert!((amount(&found, "LAT001") - 0.06).abs() < 2e-3, "{:?}", causes(&found));
    let written = template(&found);
    assert!(
        written.contains("joint_factors = [0.0015") && written.contains("joint_offsets = [-3.14")
    );
    let config = Config::from_text(written, Path::new("p.toml")).expect("a config");
    let mut options = Options { logs: vec![path], ..config.options() };
    options.run.robots = vec!["ur5e".into()];
    let again = audit(&options).expect("a report").into_report();
    assert_eq!(causes(&again), causes(&found));
    assert_eq!(amount(&again, "LAT001"), amount(&found, "LAT001"));
}

#[test]
fn commands_beside_named_joints_are_told_by_their_numbers() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = CLEAN.rows();
    let lead = (0.1 / STEP_S) as usize;
    let names: Vec<String> = std::iter::once("t".to_owned())
        .chain((1..7).map(|at| format!("state.joint_{at}")))
        .chain((1..7).map(|at| format!("action.joint_{at}")))
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let status = |order: [usize; 6]| {
        let row = |(at, row): (usize, &Vec<f64>)| {
            let ahead = &rows[(at + lead).min(rows.len() - 1)];
            [&row[..7], &order.map(|joint| ahead[joint])].concat()
        };
        let table: Vec<Vec<f64>> = rows.iter().enumerate().map(row).collect();
        let path = csv(folder.path(), &table, Some(&names));
        report(&path, Some("ur5e"), ColumnSettings::default()).expect("a report")
    };
    let right = status([1, 2, 3, 4, 5, 6]);
    assert!((amount(&right, "LAT004") - 0.1).abs() < 0.02, "{:?}", causes(&right));
    assert!(!causes(&right).contains(&"META001"));
    let swapped = status([1, 3, 2, 4, 5, 6]);
    let found = swapped.findings.iter().find(|one| one.code == "META001");
    let message = &found.expect("swapped names").message;
    assert!(message.contains("q2, q3 moves") || message.contains("q3, q2 moves"), "{message}");
    assert!(!causes(&swapped).contains(&"LAT004"));
}

#[test]
fn a_pose_that_the_config_names_is_one_where_the_motion_does_not_tell() {
    const NAMES: &str = "timestamp,shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,\
                         wrist_3_joint,x1,y1,z1,phix1,phiy1,phiz1";
    let folder = tempfile::tempdir().expect("a folder");
    // Configurations of a calibration, a second apart, so speeds are unknown.
    let all = Table { rpy: true, ..CLEAN }.rows();
    let posture = |at: usize| [&[0.9 * at as f64], &all[(at * 389) % all.len()][1..]].concat();
    let postures: Vec<Vec<f64>> = (0..25).map(posture).collect();
    let names: Vec<&str> = NAMES.split(',').collect();
    let path = csv(folder.path(), &postures, Some(&names));
    let of = |text: &str| {
        let config = Config::from_text(text.to_owned(), Path::new("p.toml")).expect("a config");
        let mut options = Options { logs: vec![path.clone()], ..config.options() };
        options.run.robots = vec!["ur5e".into()];
        audit(&options).expect("a report").into_report()
    };
    let role = |report: &Report, topic: &str| {
        let own = report.streams.iter().find(|stream| stream.topic == topic);
        own.map(|stream| stream.role).expect("listed")
    };
    let open = of("");
    assert_eq!(role(&open, "1"), "unassigned");
    let note = &open.log.notes.iter().find(|row| row.note.contains("does not confirm"));
    assert!(note.is_some_and(|row| row.note.contains("[stream.\"1\"]")), "{:?}", open.log.notes);
    for said in [
        "[columns]\npose = [\"x1\", \"y1\", \"z1\", \"phix1\", \"phiy1\", \"phiz1\"]",
        "[stream.\"1\"]\nrole = \"pose\"",
    ] {
        let told = of(said);
        assert_eq!(role(&told, if said.starts_with("[columns]") { "pose" } else { "1" }), "pose");
        let reading = told.findings.iter().find(|one| one.code == "ORD001").expect("a reading");
        assert!(reading.message.contains("euler:xyz"), "{}", reading.message);
        assert!(!told.log.notes.iter().any(|row| row.note.contains("does not confirm")));
    }
}
