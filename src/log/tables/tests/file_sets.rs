//! Signals of one run in separate files, identified by the names of the files.

use std::fs;

use super::trajectories::open_files;
use super::{joints, npy, stamps, topic};
use crate::{ColumnSettings, LogError, ReadOptions, open};
use ground::stream::Columns;

/// Rows after 8 or 24 ms, as a slow reader of a controller writes them. `late_s` is the delay of the file's stamps.
fn rows(late_s: f64, value: impl Fn(f64, usize) -> f64) -> String {
    let row = |row: usize| {
        let t = 0.008 * (row + 2 * (row / 2)) as f64;
        let cells: Vec<String> = (0..6).map(|at| format!("{:.6}", value(t, at))).collect();
        format!("{:.6}, {}\n", 0.05 + t + late_s, cells.join(", "))
    };
    (0..40).map(row).collect()
}

fn position(t: f64, joint: usize) -> f64 {
    (3.0 * t + 0.7 * joint as f64).sin()
}

fn velocity(t: f64, joint: usize) -> f64 {
    3.0 * (3.0 * t + 0.7 * joint as f64).cos()
}

#[test]
fn files_of_bare_numbers_are_read_by_their_names() {
    let files = [
        ("log_q_actual.csv", rows(0.0, position)),
        ("log_qd_actual.csv", rows(5e-6, velocity)),
        ("log_q_target.csv", rows(1e-6, position)),
        ("log_tool_vector.csv", rows(2e-5, |t, at| 0.1 * position(t, at))),
        ("log_tcp_force.csv", rows(3e-6, velocity)),
        ("log_tool_acc.csv", rows(4e-6, velocity)),
    ];
    let files: Vec<(&str, &str)> =
        files.iter().map(|(name, text)| (*name, text.as_str())).collect();
    let log = open_files(&files, files.len()).expect("a log");
    assert!((joints(&log, "log_q_actual").1[4][2] - position(0.064, 2)).abs() < 1e-6);
    assert_eq!(stamps(&log, "log_q_actual")[..3], [50_000_000, 58_000_000, 82_000_000]);
    let Some(Columns::Joints(own)) = &topic(&log, "log_q_actual").columns else { panic!() };
    assert!((own.joints[1].velocity[4] - velocity(0.064, 1)).abs() < 1e-6);
    let Some(Columns::Joints(target)) = &topic(&log, "log_q_target").columns else { panic!() };
    assert!(target.joints[0].velocity[0].is_nan());
    let Some(Columns::Array(pose)) = &topic(&log, "log_tool_vector").columns else { panic!() };
    assert!(pose.width == 6 && !pose.unnamed);
    assert!(topic(&log, "log_tcp_force").columns.is_none());
    assert!(log.topics.iter().all(|topic| topic.name != "log_qd_actual"));
    // Velocities that belong to no joints are listed.
    let alone = [files[1], files[3]];
    let log = open_files(&alone, 2).expect("a log");
    let why = topic(&log, "log_qd_actual").read_as.as_deref().unwrap_or_default();
    assert!(why.contains("no joint positions have the same name"), "{why}");
}

#[test]
fn stamps_after_the_other_numbers_are_found() {
    let row = |row: usize| {
        let t = 0.02 * row as f64;
        let cells: Vec<String> = (0..6).map(|at| format!("{:.6}", position(t, at))).collect();
        format!("{} {:.3}\n", cells.join(" "), 9.7 + t)
    };
    let text: String = (0..800).map(row).collect();
    let log = open_files(&[("joint_angles.txt", &text)], 1).expect("a log");
    assert_eq!(stamps(&log, "joint_angles")[..2], [9_700_000_000, 9_720_000_000]);
    assert_eq!(joints(&log, "joint_angles").1[3].len(), 6);
}

#[test]
fn six_joints_that_increase_are_not_taken_for_times() {
    let row = |at: u32| vec![format!("{:.4}", 0.01 * f64::from(at)); 6].join(",") + "\n";
    let rising: String = (1..60).map(row).collect();
    let line = open_files(&[("jointPosition.csv", &rising)], 1).expect_err("refused").to_string();
    assert!(line.contains("no column holds times"), "{line}");
}

#[test]
fn declared_velocities_of_another_file_belong_to_the_joints() {
    let folder = tempfile::tempdir().expect("a folder");
    let [positions, velocities] = ["a.csv", "b.csv"].map(|name| folder.path().join(name));
    fs::write(&positions, rows(0.0, position)).expect("a file");
    fs::write(&velocities, rows(0.0, |t, joint| velocity(t, joint).to_degrees())).expect("a file");
    let layouts =
        ["a.csv=t,q[6]", "b.csv=t,qd[6]:deg"].map(|layout| layout.parse().expect("a layout"));
    let columns = ColumnSettings { layouts: layouts.into(), ..ColumnSettings::default() };
    let options = ReadOptions { columns, ..ReadOptions::default() };
    let log = open(&[positions, velocities], &options).expect("a log");
    let Some(Columns::Joints(own)) = &topic(&log, "joints").columns else { panic!() };
    assert!((own.joints[1].velocity[4] - velocity(0.064, 1)).abs() < 1e-6);
    assert_eq!(topic(&log, "joints").velocity_cells.len(), 6);
}

#[test]
fn a_file_of_times_belongs_to_the_files_with_as_many_rows() {
    let bare = |text: &str| -> String {
        let without = |line: &str| line.split_once(", ").expect("a time").1.to_owned() + "\n";
        text.lines().map(without).collect()
    };
    let all = rows(0.0, position);
    let times: String =
        all.lines().map(|line| line.split(',').next().expect("a time").to_owned() + "\n").collect();
    let named = format!("time\n{times}");
    let positions = bare(&all);
    for times in [&times, &named] {
        let files = [("jointPosition.csv", positions.as_str()), ("simulationTime.csv", times)];
        let log = open_files(&files, 2).expect("a log");
        assert_eq!(stamps(&log, "jointPosition")[..3], [50_000_000, 58_000_000, 82_000_000]);
        assert_eq!(joints(&log, "jointPosition").0.len(), 6);
    }
    let few = [("jointPosition.csv", positions.as_str()), ("simulationTime.csv", "0\n1\n")];
    let line = open_files(&few, 2).expect_err("refused").to_string();
    assert!(line.contains("pass a file with the times of the 40 rows"), "{line}");
}

#[test]
fn arrays_of_numpy_take_their_times_from_another_array() {
    let array = |width: usize, value: &dyn Fn(usize) -> f64| {
        let header =
            format!("{{'descr': '<f8', 'fortran_order': False, 'shape': (40, {width}), }}\n");
        let header = header.replace("(40, 1)", "(40,)");
        npy(&header, &(0..40 * width).flat_map(|at| value(at).to_le_bytes()).collect::<Vec<u8>>())
    };
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: Vec<u8>| fs::write(folder.path().join(name), bytes);
    write("joint_positions.npy", array(6, &|at| (0.1 * at as f64).sin())).expect("a file");
    write("timestamps.npy", array(1, &|at| 7.0 + 0.01 * at as f64)).expect("a file");
    let log = open(&[folder.path().to_owned()], &ReadOptions::default()).expect("a log");
    assert_eq!(stamps(&log, "joint_positions")[..2], [7_000_000_000, 7_010_000_000]);
}

#[test]
fn a_folder_of_tables_without_times_says_so() {
    let row = |at: u32| vec![format!("{:.4}", (0.1 * f64::from(at)).sin()); 6].join(",") + "\n";
    let text: String = (1..60).map(row).collect();
    for (names, expected) in [
        (["joint_angles.csv", "joint_torques.csv"].as_slice(), "no column holds times"),
        (&["run.csv"], "no column holds times"),
        (&["a.csv", "b.csv"], "a directory of tables without times"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        for name in names {
            fs::write(folder.path().join(name), &text).expect("a file");
        }
        let refused = open(&[folder.path().to_owned()], &ReadOptions::default());
        let line = refused.expect_err("refused").to_string();
        assert!(line.contains(expected), "{line}");
    }
}

#[test]
fn a_folder_of_signals_is_one_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("a file");
    let read = || open(&[folder.path().to_owned()], &ReadOptions::default());
    let positions = rows(0.0, position);
    write("q_actual.csv", &positions);
    write("tool_vector.csv", &rows(0.0, velocity));
    // A simulated state may equal its command.
    write("q_target.csv", &positions);
    write("start.csv", "no values\n");
    let log = read().expect("a log");
    assert_eq!(log.files.len(), 3);
    assert!(log.notes.iter().any(|note| note.what.contains("was not read")), "{:?}", log.notes);
    write("q_actual_2.csv", &positions);
    let refused = read().expect_err("refused");
    assert!(matches!(refused, LogError::Runs { .. }), "{refused}");
}

#[test]
fn files_with_one_row_each_are_one_table() {
    let folder = tempfile::tempdir().expect("a folder");
    let q = |row: usize| (0..6).map(|joint| position(0.01 * row as f64, joint)).collect::<Vec<_>>();
    let file = |row: usize| {
        let path = folder.path().join(format!("row_{row}.json"));
        let record = serde_json::json!({"time": 0.01 * row as f64, "joint_positions": q(row)});
        fs::write(&path, record.to_string()).expect("a file");
        path
    };
    let files: Vec<_> = (0..12).rev().map(file).collect();
    for paths in [files.as_slice(), &[folder.path().to_owned()]] {
        let log = open(paths, &ReadOptions::default()).expect("a log");
        assert_eq!(joints(&log, "joint_positions").1, (0..12).map(q).collect::<Vec<_>>());
        assert_eq!(log.files[0].path, folder.path());
        let note = "12 files with one row each, row_0.json to row_11.json";
        assert!(log.notes.iter().any(|own| own.what.contains(note)), "{:?}", log.notes);
    }
}
