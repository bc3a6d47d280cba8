//! Tables with unnamed columns: the columns are identified by their numbers, or a question is asked.

use std::fs;
use std::path::{Path, PathBuf};

use poseaudit::config::{Config, template};
use poseaudit::finding::Status;
use poseaudit::geometry::{rotation_from_xyzw, xyzw_from_rotation};
use poseaudit::log::ColumnSettings;
use poseaudit::report::{Report, Verdict};
use poseaudit::{Options, audit};

use crate::tables::{
    CLEAN, STEP_S, Table, audit_and_correct, audit_table, fault_codes, ur5e, value_of,
};

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

fn report_on(rows: &[Vec<f64>], robot: Option<&str>) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    audit_table(&csv(folder.path(), rows, None), robot, ColumnSettings::default())
        .expect("a report")
}

/// The columns of a topic.
fn columns_of(report: &Report, topic: &str) -> Vec<String> {
    let own = report.streams.iter().find(|stream| stream.topic == topic);
    own.map(|stream| stream.columns.clone()).unwrap_or_default()
}

fn column_names(range: std::ops::Range<usize>) -> Vec<String> {
    range.map(|at| format!("c{at}")).collect()
}

/// The rows of a table with additional numbers, computed from row index and content.
fn rows_with(table: &Table, more: impl Fn(usize, &[f64]) -> Vec<f64>) -> Vec<Vec<f64>> {
    let rows = table.rows();
    let extended = |(at, row): (usize, &Vec<f64>)| {
        let mut extended = vec![row[0]];
        extended.extend(more(at, row));
        extended.extend(&row[1..]);
        extended
    };
    rows.iter().enumerate().map(extended).collect()
}

#[test]
fn joints_and_pose_are_found_among_others_in_any_unit() {
    // Preceded by a gripper, noise, and the rates of two joints.
    let others = |at: usize, row: &[f64]| {
        let noise = ((at * 7919) % 1009) as f64 / 1009.0;
        vec![f64::from(u8::from(at % 200 > 90)), noise, row[0].sin(), (0.7 * row[0]).cos()]
    };
    for table in [CLEAN, Table { joint_factor: 1_f64.to_degrees(), rpy: true, ..CLEAN }] {
        let found = report_on(&rows_with(&table, others), None);
        let width = if table.rpy { 6 } else { 7 };
        assert_eq!(columns_of(&found, "joints"), column_names(4..10), "{:?}", found.error);
        assert_eq!(columns_of(&found, "pose"), column_names(10..10 + width));
        assert_eq!((found.verdict, fault_codes(&found)), (Verdict::Pass, Vec::new()));
        assert_eq!(found.robots[0].name, "ur5e");
        let gripper = found.streams.iter().find(|stream| stream.topic == "c0").expect("listed");
        assert!(gripper.reason.contains("two values"), "{}", gripper.reason);
    }
}

#[test]
fn a_rotation_matrix_after_the_position_is_found() {
    let mut rows = CLEAN.rows();
    for row in &mut rows {
        let q_xyzw = [row[10], row[11], row[12], row[13]];
        let matrix = *rotation_from_xyzw(q_xyzw).expect("a rotation").to_rotation_matrix().matrix();
        row.truncate(10);
        row[7..].iter_mut().for_each(|metres| *metres *= 1e3);
        // By rows.
        row.extend(matrix.transpose().iter());
    }
    let found = report_on(&rows, None);
    assert_eq!(columns_of(&found, "pose").len(), 12, "{:?}", found.streams);
    assert_eq!((found.verdict, fault_codes(&found)), (Verdict::Pass, Vec::new()));
}

#[test]
fn faults_are_found_as_with_named_columns_and_again_with_the_config_of_init() {
    let folder = tempfile::tempdir().expect("a folder");
    for (table, code, truth, within) in [
        (Table { latency_s: 0.06, ..CLEAN }, "LAT001", 0.06, 5e-4),
        (
            Table { elbow_offset_rad: -0.5_f64.to_radians(), ..CLEAN },
            "ZER001",
            0.5_f64.to_radians(),
            2e-4,
        ),
    ] {
        let path = csv(folder.path(), &table.rows(), None);
        let found = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
        assert_eq!(fault_codes(&found), [code], "{:?}", found.findings);
        assert!((value_of(&found, code) - truth).abs() < within, "{}", value_of(&found, code));
        let written = template(&found, false);
        assert!(written.contains("joints = [\"c0\", \"c1\""), "{written}");
        let config = Config::from_text(written, Path::new("p.toml")).expect("a config");
        let mut options = Options { logs: vec![path], ..config.options() };
        options.run.robots = vec!["ur5e".into()];
        let again = audit(&options).expect("a report").into_report();
        let findings = |report: &Report| -> Vec<String> {
            report.findings.iter().map(|one| serde_json::json!(one).to_string()).collect()
        };
        assert_eq!(findings(&again), findings(&found));
    }
}

#[test]
fn corrections_apply_to_columns_that_the_motion_identifies() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = Table { latency_s: 0.06, rpy: true, ..CLEAN };
    let [before, after] = audit_and_correct(&csv(folder.path(), &table.rows(), None), "ur5e");
    assert_eq!(fault_codes(&before), ["LAT001"], "{:?}", before.findings);
    assert!(after.findings.is_empty(), "{:?}", after.findings);
    let notes = &after.log.notes;
    assert!(notes.iter().any(|note| note.note.contains("corrected: pose by its latency of 60 ms")));
}

#[test]
fn leading_commands_are_identified_and_copies_are_listed() {
    let rows = CLEAN.rows();
    let lead = (0.1 / STEP_S) as usize;
    // The commands lead the joints by five rows.
    let ahead = |at: usize, _: &[f64]| rows[(at + lead).min(rows.len() - 1)][1..7].to_vec();
    let found = report_on(&rows_with(&CLEAN, ahead), Some("ur5e"));
    assert_eq!(columns_of(&found, "joint_commands"), column_names(0..6), "{:?}", found.error);
    assert_eq!(columns_of(&found, "joints"), column_names(6..12));
    assert!((value_of(&found, "LAT004") - 0.1).abs() < 0.02, "{}", value_of(&found, "LAT004"));
    let copied = report_on(&rows_with(&CLEAN, |_, row| row[1..7].to_vec()), Some("ur5e"));
    assert_eq!(columns_of(&copied, "pose"), column_names(12..19));
    let copies =
        copied.streams.iter().filter(|stream| stream.reason.contains("the same numbers as"));
    assert_eq!(copies.count(), 6);
}

#[test]
fn columns_that_fit_no_arm_are_not_assigned() {
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
            let found = report_on(&rows, robot);
            assert!(found.robots.is_empty() && columns_of(&found, "joints").is_empty());
            assert_ne!(found.verdict, Verdict::Pass);
        }
    }
    // Joints and a gripper without a pose: the report suggests config lines.
    let folder = tempfile::tempdir().expect("a folder");
    let alone: Vec<Vec<f64>> = rows.iter().map(|row| [&row[..7], &[0.0]].concat()).collect();
    let path = csv(folder.path(), &alone, None);
    let found = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let question = found.error.expect("a question").what;
    assert!(question.contains("--columns 't,q[6]"), "{question}");
}

#[test]
fn two_arms_in_one_table_are_identified() {
    let (left, chain) = (CLEAN.rows(), ur5e());
    // The right arm moves in reverse, with each joint offset by 0.1 rad.
    let both = |(at, row): (usize, &Vec<f64>)| {
        let right: Vec<f64> = left[left.len() - 1 - at][1..7].iter().map(|q| q + 0.1).collect();
        let pose = chain.forward(&right);
        let xyz: [f64; 3] = pose.translation.vector.into();
        [&row[..7], &right, &row[7..], &xyz, &xyzw_from_rotation(&pose.rotation)].concat()
    };
    let rows: Vec<Vec<f64>> = left.iter().enumerate().map(both).collect();
    let found = report_on(&rows, Some("ur5e"));
    let mut arms: Vec<[Vec<String>; 2]> = ["first", "second"]
        .map(|arm| ["joints", "pose"].map(|topic| columns_of(&found, &format!("{arm}/{topic}"))))
        .to_vec();
    arms.sort();
    assert_eq!(arms[0], [column_names(0..6), column_names(12..19)], "{:?}", found.error);
    assert_eq!(arms[1], [column_names(6..12), column_names(19..26)]);
    assert_eq!((found.robots.len(), fault_codes(&found)), (2, Vec::new()));
}

#[test]
fn column_names_that_contradict_the_numbers_are_a_finding() {
    let folder = tempfile::tempdir().expect("a folder");
    let status = |rows: &[Vec<f64>], names: &[&str]| {
        let path = csv(folder.path(), rows, Some(names));
        let found = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
        let row = found.checks.iter().find(|row| row.code == "META001").expect("it is asked");
        let finding = found.findings.iter().find(|finding| finding.code == "META001");
        (row.status, finding.map(|finding| finding.message.clone()).unwrap_or_default())
    };
    // Positions and quaternions that are named as joints.
    let poses: Vec<Vec<f64>> =
        CLEAN.rows().iter().map(|row| [&row[..1], &row[7..]].concat()).collect();
    let about_one_axis = |(at, row): (usize, &Vec<f64>)| {
        let half = 0.01 * at as f64;
        [&row[..4], &[0.0, 0.0, half.sin(), half.cos()]].concat()
    };
    let about_one_axis: Vec<Vec<f64>> = poses.iter().enumerate().map(about_one_axis).collect();
    for poses in [&poses, &about_one_axis] {
        let (found, message) = status(poses, &["t", "q1", "q2", "q3", "q4", "q5", "q6", "q7"]);
        assert!(found == Status::Fail && message.contains("unit quaternion"), "{message}");
    }
    // A file of poses that is named after the joint that moves.
    let path = folder.path().join("joint3.csv");
    let row = |row: &Vec<f64>| row.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let text: Vec<String> = poses.iter().map(row).collect();
    fs::write(&path, text.join("\n")).expect("a file");
    let found = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let error = found.error.as_ref().map(|error| error.what.clone()).unwrap_or_default();
    assert!(
        found.findings.is_empty() && error.contains("no columns hold joint positions"),
        "{error}"
    );
    // Degrees in columns named as rad.
    let degrees = Table { joint_factor: 1_f64.to_degrees(), poses: false, ..CLEAN }.rows();
    let names = ["t", "q1_rad", "q2_rad", "q3_rad", "q4_rad", "q5_rad", "q6_rad"];
    let (found, message) = status(&degrees, &names);
    assert!(found == Status::Fail && message.contains("indicates rad"), "{message}");
}

#[test]
fn encoder_ticks_are_converted_by_a_pose_and_init_writes_their_factors() {
    const TURN: f64 = 4096.0;
    let ticks = |row: &Vec<f64>| -> Vec<f64> {
        let ticks_of = |(at, number): (usize, &f64)| match at {
            1..7 => (number * TURN / std::f64::consts::TAU + 0.5 * TURN).round(),
            _ => *number,
        };
        row.iter().enumerate().map(ticks_of).collect()
    };
    let folder = tempfile::tempdir().expect("a folder");
    let late = Table { latency_s: 0.06, ..CLEAN };
    let rows: Vec<Vec<f64>> = late.rows().iter().map(ticks).collect();
    let path = csv(folder.path(), &rows, None);
    let found = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!(columns_of(&found, "pose"), column_names(6..13), "{:?}", found.error);
    assert!((value_of(&found, "LAT001") - 0.06).abs() < 2e-3, "{:?}", fault_codes(&found));
    let written = template(&found, false);
    assert!(
        written.contains("joint_factors = [0.0015") && written.contains("joint_offsets = [-3.14")
    );
    let config = Config::from_text(written, Path::new("p.toml")).expect("a config");
    let mut options = Options { logs: vec![path], ..config.options() };
    options.run.robots = vec!["ur5e".into()];
    let again = audit(&options).expect("a report").into_report();
    assert_eq!(fault_codes(&again), fault_codes(&found));
    assert_eq!(value_of(&again, "LAT001"), value_of(&found, "LAT001"));
}

#[test]
fn commands_are_identified_next_to_named_joints() {
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
        audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report")
    };
    let right = status([1, 2, 3, 4, 5, 6]);
    assert!((value_of(&right, "LAT004") - 0.1).abs() < 0.02, "{:?}", fault_codes(&right));
    assert!(!fault_codes(&right).contains(&"META001"));
    let swapped = status([1, 3, 2, 4, 5, 6]);
    let found = swapped.findings.iter().find(|one| one.code == "META001");
    let message = &found.expect("swapped names").message;
    assert!(message.contains("q2, q3 moves") || message.contains("q3, q2 moves"), "{message}");
    assert!(!fault_codes(&swapped).contains(&"LAT004"));
}

#[test]
fn a_pose_named_in_the_config_is_used_without_confirmation_by_motion() {
    const NAMES: &str = "timestamp,shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,wrist_2_joint,\
                         wrist_3_joint,x1,y1,z1,phix1,phiy1,phiz1";
    let folder = tempfile::tempdir().expect("a folder");
    // Configurations of a calibration, a second apart, so speeds are unknown.
    let all = Table { rpy: true, ..CLEAN }.rows();
    let configuration =
        |at: usize| [&[0.9 * at as f64], &all[(at * 389) % all.len()][1..]].concat();
    let configurations: Vec<Vec<f64>> = (0..25).map(configuration).collect();
    let names: Vec<&str> = NAMES.split(',').collect();
    let path = csv(folder.path(), &configurations, Some(&names));
    let report_with = |text: &str| {
        let config = Config::from_text(text.to_owned(), Path::new("p.toml")).expect("a config");
        let mut options = Options { logs: vec![path.clone()], ..config.options() };
        options.run.robots = vec!["ur5e".into()];
        audit(&options).expect("a report").into_report()
    };
    let role = |report: &Report, topic: &str| {
        let own = report.streams.iter().find(|stream| stream.topic == topic);
        own.map(|stream| stream.role).expect("listed")
    };
    let undeclared = report_with("");
    assert_eq!(role(&undeclared, "1"), "unassigned");
    let note = &undeclared.log.notes.iter().find(|row| row.note.contains("does not confirm"));
    assert!(
        note.is_some_and(|row| row.note.contains("[stream.\"1\"]")),
        "{:?}",
        undeclared.log.notes
    );
    for setting in [
        "[columns]\npose = [\"x1\", \"y1\", \"z1\", \"phix1\", \"phiy1\", \"phiz1\"]",
        "[stream.\"1\"]\nrole = \"pose\"",
    ] {
        let declared = report_with(setting);
        assert_eq!(
            role(&declared, if setting.starts_with("[columns]") { "pose" } else { "1" }),
            "pose"
        );
        let finding = declared.findings.iter().find(|one| one.code == "ORD001").expect("a reading");
        assert!(finding.message.contains("euler:xyz"), "{}", finding.message);
        assert!(!declared.log.notes.iter().any(|row| row.note.contains("does not confirm")));
    }
}
