//! `--columns`: pasting the proposal of an audit gives the same answer. Several tables as one run.

use std::fs;
use std::path::{Path, PathBuf};

use poseaudit::finding::Status;
use poseaudit::geometry::{Convention, rotation_from_xyzw};
use poseaudit::log::FileLayout;
use poseaudit::report::{Report, Trouble, Verdict};
use poseaudit::{Options, audit, info};

use crate::tables::{CLEAN, STEP_S, Table, fault_codes, value_of};

fn text(rows: &[Vec<f64>]) -> String {
    let line = |row: &Vec<f64>| {
        row.iter().map(|number| format!("{number:.9}")).collect::<Vec<_>>().join(",") + "\n"
    };
    rows.iter().map(line).collect()
}

fn audit_with(
    logs: &[PathBuf],
    robot: Option<&str>,
    columns: Option<&str>,
) -> Result<Report, Trouble> {
    let mut options = Options { logs: logs.to_vec(), ..Options::default() };
    options.run.robots = robot.into_iter().map(Into::into).collect();
    let layouts: Vec<FileLayout> =
        columns.into_iter().map(|text| text.parse().expect("a layout")).collect();
    options.read.columns.layouts = layouts;
    audit(&options).map(poseaudit::Audited::into_report)
}

fn write(folder: &Path, name: &str, content: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, content).expect("a file");
    path
}

#[test]
fn the_meaning_that_is_found_can_be_stated_with_the_same_result() {
    let folder = tempfile::tempdir().expect("a folder");
    for (table, expected) in [
        (Table { latency_s: 0.06, ..CLEAN }, "t,q[6],x,y,z,rot[4]"),
        (Table { joint_factor: 1_f64.to_degrees(), ..CLEAN }, "t,q[6]:deg,x,y,z,rot[4]"),
    ] {
        let logs = [write(folder.path(), "run.csv", &text(&table.rows()))];
        let found = audit_with(&logs, Some("ur5e"), None).expect("a report");
        let layout = found.log.tables[0].layout.clone().expect("a layout");
        assert_eq!(layout, expected);
        assert_eq!(found.log.tables[0].layout_reason, None);
        let stated = audit_with(&logs, Some("ur5e"), Some(&layout)).expect("a report");
        assert_eq!(fault_codes(&stated), fault_codes(&found));
        assert_eq!(stated.log.tables[0].layout.as_deref(), Some(expected));
        for code in fault_codes(&found) {
            assert!((value_of(&stated, code) - value_of(&found, code)).abs() < 1e-6);
        }
        // A declared convention is checked.
        let declared = layout.replace("rot[4]", "quat:wxyz");
        let wrong = audit_with(&logs, Some("ur5e"), Some(&declared)).expect("a report");
        assert!(fault_codes(&wrong).contains(&"ORD002"), "{:?}", wrong.findings);
    }
}

#[test]
fn radians_that_are_declared_as_degrees_are_a_wrong_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let logs = [write(folder.path(), "run.csv", &text(&CLEAN.rows()))];
    let layout = Some("t,q[6]:deg,x,y,z,rot[4]");
    let wrong = audit_with(&logs, Some("ur5e"), layout).expect("a report");
    assert_eq!(fault_codes(&wrong), ["ORD004"], "{:?}", wrong.findings);
}

#[test]
fn a_table_of_joints_ends_with_a_proposal_that_is_audited_when_pasted() {
    let folder = tempfile::tempdir().expect("a folder");
    // A counter, the joints, and a constant.
    let rows: Vec<Vec<f64>> = Table { poses: false, ..CLEAN }
        .rows()
        .iter()
        .zip(0..)
        .map(|(row, at)| [&[row[0], f64::from(at)], &row[1..], &[7.0]].concat())
        .collect();
    let logs = [write(folder.path(), "run.csv", &text(&rows))];
    let open = audit_with(&logs, Some("ur5e"), None).expect("a report");
    let trouble = open.error.expect("a question");
    let layout = open.log.tables[0].layout.clone().expect("a proposal");
    assert_eq!(layout, "t,_,q[6],_");
    assert!(trouble.what.contains(&format!("--columns '{layout}'")), "{}", trouble.what);
    let pasted = audit_with(&logs, Some("ur5e"), Some(&layout)).expect("a report");
    assert_eq!(pasted.error, None);
    assert_eq!(pasted.robots[0].name, "ur5e");
    let wide = audit_with(&logs, Some("ur5e"), Some("t,q[6]")).expect_err("a refusal");
    assert!(wide.what.contains("names 7 columns, but its rows have 9"), "{}", wide.what);
}

#[test]
fn one_moving_joint_and_its_rate_are_enough_for_a_proposal() {
    let folder = tempfile::tempdir().expect("a folder");
    let all = Table { poses: false, ..CLEAN }.rows();
    // Joint 2 moves. Positions, velocities and currents.
    let row = |at: usize| -> Vec<f64> {
        let velocity = (all[at + 1][2] - all[at - 1][2]) / (2.0 * STEP_S);
        let noise = |joint: usize| ((at * 7919 + joint * 3571) % 1009) as f64 / 100.0;
        let position = |joint: usize| if joint == 2 { all[at][2] } else { all[0][joint] };
        let rate = |joint: usize| if joint == 2 { velocity } else { 0.0 };
        let joints = 1..=6;
        std::iter::once(all[at][0])
            .chain(joints.clone().map(position))
            .chain(joints.clone().map(rate))
            .chain(joints.map(noise))
            .collect()
    };
    let rows: Vec<Vec<f64>> = (1..all.len() - 1).map(row).collect();
    let logs = [write(folder.path(), "run.csv", &text(&rows))];
    let open = audit_with(&logs, None, None).expect("a report");
    let what = open.error.expect("a question").what;
    assert!(what.contains("--columns 't,q[6],qd[6],_[6]'"), "{what}");
    let layout = open.log.tables[0].layout.clone().expect("a proposal");
    let pasted = audit_with(&logs, Some("ur5e"), Some(&layout)).expect("a report");
    assert_eq!((pasted.error, pasted.robots[0].name.as_str()), (None, "ur5e"));
}

#[test]
fn a_table_without_times_is_refused_with_its_columns_and_the_rate_of_its_velocities() {
    const RATE_HZ: f64 = 125.0;
    let folder = tempfile::tempdir().expect("a folder");
    let all = CLEAN.rows();
    let row = |at: usize| -> Vec<f64> {
        let rate = |joint: usize| (all[at + 1][joint] - all[at - 1][joint]) / 2.0 * RATE_HZ;
        [&all[at][1..7], &(1..=6).map(rate).collect::<Vec<_>>(), &all[at][7..]].concat()
    };
    let rows: Vec<Vec<f64>> = (1..all.len() - 1).map(row).collect();
    let logs = [write(folder.path(), "run.csv", &text(&rows))];
    let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
    assert!(refusal.what.contains("imply 125 rows per second"), "{refusal}");
    let layout = "q[6],qd[6],x,y,z,rot[4]@125";
    assert!(refusal.remedy.contains(&format!("--columns '{layout}'")), "{refusal}");
    assert!(!refusal.to_string().contains('\n'));
    let pasted = audit_with(&logs, Some("ur5e"), Some(layout)).expect("a report");
    assert!(!fault_codes(&pasted).contains(&"VEL001"), "{:?}", pasted.findings);
    assert_eq!((pasted.error, pasted.robots[0].name.as_str()), (None, "ur5e"));
    // Without velocities the rate is open, and with zeros as well.
    let zeros = |row: &Vec<f64>| [&row[1..7], &[0.0; 6], &row[7..]].concat();
    let names = "q1,q2,q3,q4,q5,q6,qd1,qd2,qd3,qd4,qd5,qd6,x,y,z,qx,qy,qz,qw\n".to_owned();
    let text_with_zeros = names + &text(&all.iter().map(zeros).collect::<Vec<_>>());
    let logs = [write(folder.path(), "run.csv", &text_with_zeros)];
    let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
    assert!(!refusal.what.contains("imply"), "{refusal}");
    let rows: Vec<Vec<f64>> = all.iter().map(|row| row[1..].to_vec()).collect();
    let names = "q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw\n".to_owned();
    let logs = [write(folder.path(), "run.csv", &(names + &text(&rows)))];
    let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
    let asks = refusal.remedy.contains("--columns 'q[6],x,y,z,qx,qy,qz,qw@RATE'");
    assert!(asks && !refusal.what.contains("imply"), "{refusal}");
}

#[test]
fn times_in_an_unknown_unit_are_asked_for_their_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let all = CLEAN.rows();
    let row = |at: usize, has_velocities: bool| -> Vec<f64> {
        let rate = |joint: usize| (all[at + 1][joint] - all[at - 1][joint]) / (2.0 * STEP_S);
        let rates: Vec<f64> = (1..=6).filter(|_| has_velocities).map(rate).collect();
        // Whole numbers of ms would be recognised.
        [&[1e3 * all[at][0] + 0.3], &all[at][1..7], &rates, &all[at][7..]].concat()
    };
    for (has_velocities, rates, qd) in
        [(true, "qd1,qd2,qd3,qd4,qd5,qd6,", "qd[6],"), (false, "", "")]
    {
        let rows: Vec<Vec<f64>> = (1..all.len() - 1).map(|at| row(at, has_velocities)).collect();
        let names = format!("Time,q1,q2,q3,q4,q5,q6,{rates}x,y,z,qx,qy,qz,qw\n");
        let logs = [write(folder.path(), "run.csv", &(names + &text(&rows)))];
        let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
        assert_eq!(refusal.what.contains("imply that it counts ms"), has_velocities, "{refusal}");
        let layout = format!("t:ms,q[6],{qd}x,y,z,qx,qy,qz,qw");
        assert!(refusal.remedy.contains(&format!("--columns '{layout}'")), "{refusal}");
        let pasted = audit_with(&logs, Some("ur5e"), Some(&layout)).expect("a report");
        assert!(!fault_codes(&pasted).contains(&"VEL001"), "{:?}", pasted.findings);
        assert_eq!(pasted.error, None);
    }
}

#[test]
fn a_proposal_states_the_units_in_the_names_of_a_pose() {
    let folder = tempfile::tempdir().expect("a folder");
    let convention: Convention = "rotvec".parse().expect("a convention");
    let row = |row: &Vec<f64>| {
        let rotation = rotation_from_xyzw([10, 11, 12, 13].map(|at| row[at])).expect("a rotation");
        let position = [7, 8, 9].map(|at| 1e3 * row[at]);
        let angles = convention.numbers(&rotation).map(f64::to_degrees);
        [&row[1..7], &position, &angles].concat()
    };
    let rows: Vec<Vec<f64>> = CLEAN.rows().iter().map(row).collect();
    let names = "q1,q2,q3,q4,q5,q6,X [mm],Y [mm],Z [mm],RX [deg],RY [deg],RZ [deg]\n".to_owned();
    let logs = [write(folder.path(), "run.csv", &(names + &text(&rows)))];
    let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
    let layout = "q[6],x:mm,y:mm,z:mm,rot[3]:deg";
    assert!(refusal.remedy.contains(&format!("--columns '{layout}@RATE'")), "{refusal}");
    let layout = format!("{layout}@{}", 1.0 / STEP_S);
    let pasted = audit_with(&logs, Some("ur5e"), Some(&layout)).expect("a report");
    assert_eq!(fault_codes(&pasted), Vec::<&str>::new(), "{:?}", pasted.findings);
    assert_eq!(pasted.error, None);
}

#[test]
fn a_proposal_leaves_out_the_poses_of_objects() {
    let folder = tempfile::tempdir().expect("a folder");
    let row = |row: &Vec<f64>| [&row[1..7], &row[7..14]].concat();
    let rows: Vec<Vec<f64>> = CLEAN.rows().iter().map(row).collect();
    for object in ["Box", "object"] {
        let [position, rotation] = ["Position", "Orientation"].map(|it| format!("{object}_{it}"));
        let names = format!(
            "q1,q2,q3,q4,q5,q6,{position}_X,{position}_Y,{position}_Z,{rotation}_X,{rotation}_Y,{rotation}_Z,{rotation}_W\n"
        );
        let logs = [write(folder.path(), "run.csv", &(names + &text(&rows)))];
        let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
        assert!(refusal.remedy.contains("--columns 'q[6],_[7]@RATE'"), "{refusal}");
    }
}

#[test]
fn a_listing_shows_the_columns_of_a_table_without_times() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows: Vec<Vec<f64>> = CLEAN.rows().iter().map(|row| row[1..].to_vec()).collect();
    let names = "q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw\n".to_owned();
    let logs = vec![write(folder.path(), "run.csv", &(names + &text(&rows)))];
    let refusal = audit_with(&logs, None, None).expect_err("a refusal");
    let listed = info(&Options { logs, ..Options::default() }).expect("a report");
    let table = &listed.log.tables[0];
    assert_eq!(table.layout.as_deref(), Some("q[6],x,y,z,qx,qy,qz,qw@RATE"));
    let read_as: Vec<&str> = table.columns.iter().map(|column| column.read_as.as_str()).collect();
    assert_eq!(read_as, ["q", "pose"]);
    assert!(listed.streams.iter().all(|stream| stream.rate_hz.is_none()), "{:?}", listed.streams);
    assert_eq!(listed.log.duration_s, None);
    assert_eq!(listed.error.map(|trouble| trouble.remedy), Some(refusal.remedy));
}

#[test]
fn a_table_of_poses_or_of_configurations_is_not_only_asked_for_its_rate() {
    let folder = tempfile::tempdir().expect("a folder");
    let all = CLEAN.rows();
    let refusal = |names: &str, columns: std::ops::Range<usize>, stride: usize| {
        let rows = (0..60).map(|row| all[row * stride % all.len()][columns.clone()].to_vec());
        let content = names.to_owned() + &text(&rows.collect::<Vec<_>>());
        let logs = [write(folder.path(), "run.csv", &content)];
        audit_with(&logs, None, None).expect_err("a refusal")
    };
    for (names, layout) in [("x,y,z,qx,qy,qz,qw\n", "x,y,z,qx,qy,qz,qw"), ("", "x,y,z,rot[4]")] {
        let poses = refusal(names, 7..14, 20);
        let asks = format!("({layout}), without joint positions");
        assert!(poses.what.contains(&asks), "{poses}");
        assert!(poses.remedy.contains(&format!("--columns '{layout}@RATE'")), "{poses}");
    }
    // One other column is no arm.
    let poses = refusal("", 6..14, 20);
    assert!(poses.what.contains("(_,x,y,z,rot[4]), without joint positions"), "{poses}");
    let at_rest = refusal("q1,q2,q3,q4,q5,q6\n", 1..7, 787);
    assert!(at_rest.remedy.contains("seem to be configurations at rest"), "{at_rest}");
}

/// No layout states the order of joints that are named by parts of the arm.
#[test]
fn named_joints_without_times_lack_only_the_rate() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows: Vec<Vec<f64>> =
        Table { poses: false, ..CLEAN }.rows().iter().map(|row| row[1..7].to_vec()).collect();
    let names = "shoulder_pan,shoulder_lift,elbow,wrist1,wrist2,wrist3\n".to_owned();
    let logs = [write(folder.path(), "run.csv", &(names + &text(&rows)))];
    let refusal = audit_with(&logs, Some("ur5e"), None).expect_err("a refusal");
    assert!(refusal.remedy.starts_with("use --columns '?[6]@RATE'"), "{refusal}");
    assert!(!refusal.remedy.contains("calibrate"), "{refusal}");
    let pasted = audit_with(&logs, Some("ur5e"), Some("?[6]@125")).expect("a report");
    assert_eq!((pasted.error, pasted.robots[0].name.as_str()), (None, "ur5e"));
}

#[test]
fn velocities_that_are_named_belong_to_the_proposal() {
    let folder = tempfile::tempdir().expect("a folder");
    let all = Table { poses: false, ..CLEAN }.rows();
    let row = |at: usize| -> String {
        let list = |numbers: &dyn Fn(usize) -> f64| -> String {
            let gripper_and_joints = std::iter::once(0.0).chain((1..=6).map(numbers));
            gripper_and_joints.map(|number| format!("{number:.8e}")).collect::<Vec<_>>().join(" ")
        };
        let rate = |joint: usize| (all[at + 1][joint] - all[at - 1][joint]) / (2.0 * STEP_S);
        let (positions, velocities) = (list(&|joint| all[at][joint]), list(&rate));
        format!("{:.3},\"[{positions}]\",\"[{velocities}]\"\n", all[at][0])
    };
    let rows: String = (1..all.len() - 1).map(row).collect();
    let logs = [write(folder.path(), "run.csv", &format!("Time,Position,Velocity\n{rows}"))];
    let open = audit_with(&logs, Some("ur5e"), None).expect("a report");
    assert_eq!(open.log.tables[0].layout.as_deref(), Some("t,_,q[6],_,qd[6]"), "{:?}", open.error);
}

/// Any columns follow the rates of others in four rows.
#[test]
fn few_rows_show_no_velocities() {
    let folder = tempfile::tempdir().expect("a folder");
    let number =
        |row: usize, at: usize| ((at * at * 7919 + row * 3571 * (at + 1)) % 1009) as f64 / 1000.0;
    let rows: Vec<Vec<f64>> =
        (0..4).map(|row| (0..40).map(|at| number(row, at)).collect()).collect();
    let logs = [write(folder.path(), "run.csv", &text(&rows))];
    let refusal = audit_with(&logs, None, None).expect_err("a refusal");
    assert!(refusal.remedy.contains("state its 40 columns"), "{refusal}");
}

#[test]
fn columns_that_never_change_are_proposed_as_joints_at_rest() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = CLEAN.rows().swap_remove(0);
    let row = |row: Vec<f64>| [&row[..1], &first[1..7], &[0.0, 0.0]].concat();
    let rows: Vec<Vec<f64>> = CLEAN.rows().into_iter().map(row).collect();
    let names = "timestamp,state_0,state_1,state_2,state_3,state_4,state_5,drive,turn\n";
    let logs = [write(folder.path(), "run.csv", &(names.to_owned() + &text(&rows)))];
    let open = audit_with(&logs, None, None).expect("a report");
    let what = open.error.expect("a question").what;
    assert!(what.contains("never change") && what.contains("--columns 't,q[6],_[2]'"), "{what}");
}

#[test]
fn a_file_that_names_its_joints_needs_no_layout() {
    let folder = tempfile::tempdir().expect("a folder");
    let rows = Table { poses: false, ..CLEAN }.rows();
    let logs = [write(folder.path(), "joint_positions.csv", &text(&rows))];
    let found = audit_with(&logs, Some("ur5e"), None).expect("a report");
    assert_eq!((found.error, found.robots[0].name.as_str()), (None, "ur5e"));
    assert_eq!(found.streams[0].topic, "joint_positions");
}

/// Joints from 0, poses from `origin_s` on, in two files with different rates.
fn two_files(folder: &Path, origin_s: f64, latency_s: f64) -> [PathBuf; 2] {
    let rows = Table { latency_s, ..CLEAN }.rows();
    let joints: Vec<Vec<f64>> = rows.iter().map(|row| row[..7].to_vec()).collect();
    let poses: Vec<Vec<f64>> = rows
        .iter()
        .skip(40)
        .step_by(2)
        .map(|row| [&[row[0] + origin_s], &row[7..]].concat())
        .collect();
    let names = ["time,q1,q2,q3,q4,q5,q6\n", "time,x,y,z,qx,qy,qz,qw\n"];
    [
        write(folder, "joints.csv", &(names[0].to_owned() + &text(&joints))),
        write(folder, "tool.csv", &(names[1].to_owned() + &text(&poses))),
    ]
}

#[test]
fn files_of_one_run_are_joined_by_their_times() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = two_files(folder.path(), 0.0, 0.06);
    for logs in [files.to_vec(), vec![folder.path().to_owned()]] {
        let found = audit_with(&logs, Some("ur5e"), None).expect("a report");
        assert_eq!(fault_codes(&found), ["LAT001"], "{:?}", found.findings);
        assert!((value_of(&found, "LAT001") - 0.06).abs() < 1e-3);
        let notes: Vec<&str> = found.log.notes.iter().map(|row| row.note.as_str()).collect();
        assert!(!notes.iter().any(|note| note.contains("metadata.yaml")), "{notes:?}");
    }
}

/// Neither has joints: each layout declares the encoding of its poses.
#[test]
fn two_files_of_poses_are_compared_in_their_declared_encodings() {
    const LATENCY_S: f64 = 0.06;
    let folder = tempfile::tempdir().expect("a folder");
    let poses = |name: &str, latency_s: f64, convention: &str| {
        let convention: Convention = convention.parse().expect("a convention");
        let row = |row: Vec<f64>| {
            let xyzw = [10, 11, 12, 13].map(|at| row[at]);
            let rotation = rotation_from_xyzw(xyzw).expect("a rotation");
            [&row[..1], &row[7..10], &convention.numbers(&rotation)].concat()
        };
        let rows: Vec<Vec<f64>> =
            Table { latency_s, ..CLEAN }.rows().into_iter().map(row).collect();
        write(folder.path(), name, &text(&rows))
    };
    let on_time = poses("arm.csv", 0.0, "rotvec");
    for (convention, layouts) in [
        ("rotvec", vec!["t,xyz,rotvec"]),
        ("euler:ZYX", vec!["arm.csv=t,xyz,rotvec", "tracker.csv=t,xyz,euler:ZYX"]),
    ] {
        let late = poses("tracker.csv", LATENCY_S, convention);
        let mut options = Options { logs: vec![on_time.clone(), late], ..Options::default() };
        options.read.columns.layouts =
            layouts.into_iter().map(|text| text.parse().expect("a layout")).collect();
        let found = audit(&options).map(poseaudit::Audited::into_report).expect("a report");
        assert_eq!(fault_codes(&found), ["LAT001"], "{:?}", found.findings);
        assert!((value_of(&found, "LAT001").abs() - LATENCY_S).abs() < 1e-3);
    }
}

#[test]
fn another_time_origin_is_found_by_motion_and_hides_only_the_latency() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = two_files(folder.path(), 1_700_000_000.25, 0.06);
    let found = audit_with(&files, Some("ur5e"), None).expect("a report");
    assert_eq!(fault_codes(&found), ["TIM003"], "{:?}", found.findings);
    // The pose is also 0.06 s late.
    assert!((value_of(&found, "TIM003").abs() - 1_700_000_000.31).abs() < 0.02);
    let latency = found.checks.iter().find(|check| check.code == "LAT001").expect("a check");
    assert_eq!(latency.status, Status::Inconclusive);
    assert_ne!(found.verdict, Verdict::Pass);
}

#[test]
fn time_origins_without_motion_are_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let [joints, tool] = two_files(folder.path(), 1_700_000_000.25, 0.0);
    let still = fs::read_to_string(&tool).expect("text");
    let lines: Vec<&str> = still.lines().collect();
    let pose = lines[1].split_once(',').expect("cells").1;
    let rows = lines[1..]
        .iter()
        .map(|line| format!("{},{pose}\n", line.split_once(',').expect("cells").0));
    fs::write(&tool, format!("{}\n{}", lines[0], rows.collect::<String>())).expect("a file");
    let refusal = audit_with(&[joints, tool], Some("ur5e"), None).expect_err("a refusal");
    assert!(refusal.what.contains("at another time origin"), "{}", refusal.what);
    assert!(!refusal.to_string().contains('\n'));
}

#[test]
fn a_folder_of_runs_is_still_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["monday.csv", "tuesday.csv"] {
        let rows = text(&CLEAN.rows()[..if name == "monday.csv" { 50 } else { 60 }]);
        write(folder.path(), name, &format!("time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw\n{rows}"));
    }
    let refusal = audit_with(&[folder.path().to_owned()], None, None).expect_err("a refusal");
    assert!(refusal.what.contains("several runs"), "{}", refusal.what);
}

/// Rows of two arms in turn; those of the second, which is later in the same motion, have a wrong position.
fn long_table(offset_m: f64) -> String {
    const LATER_ROWS: usize = 300;
    let all = CLEAN.rows();
    let mut text = "time,arm,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw\n".to_owned();
    for (left, right) in all.iter().zip(&all[LATER_ROWS..]) {
        for (arm, own, offset_m) in [("left", left, 0.0), ("right", right, offset_m)] {
            let mut numbers = own[1..].to_vec();
            numbers[6] += offset_m;
            let cells: Vec<String> = numbers.iter().map(|own| format!("{own:.9}")).collect();
            text += &format!("{:.3},{arm},{}\n", left[0], cells.join(","));
        }
    }
    text
}

#[test]
fn each_stream_of_a_long_table_is_audited() {
    let folder = tempfile::tempdir().expect("a folder");
    let logs = [write(folder.path(), "run.csv", &long_table(0.0))];
    let clean = audit_with(&logs, Some("ur5e"), None).expect("a report");
    assert_eq!(fault_codes(&clean), <[&str; 0]>::default(), "{:?}", clean.findings);
    let counts = clean.streams.iter().map(|stream| (stream.topic.as_str(), stream.count));
    let counts: Vec<(&str, usize)> =
        counts.map(|(topic, count)| (topic, count as usize)).filter(|own| own.1 > 0).collect();
    for topic in ["left/q", "left/pose", "right/q", "right/pose"] {
        assert!(counts.contains(&(topic, 1200)), "{counts:?}");
    }
    let columns = &clean.log.tables[0].columns;
    assert!(columns.iter().any(|column| column.read_as == "left/q, right/q"), "{columns:?}");
    let layout = clean.log.tables[0].layout.clone().expect("a layout");
    assert_eq!(layout, "t,_,q[6],x,y,z,qx,qy,qz,qw");
    let logs = [write(folder.path(), "run.csv", &long_table(0.05))];
    for columns in [None, Some(layout.as_str())] {
        let wrong = audit_with(&logs, Some("ur5e"), columns).expect("a report");
        assert_eq!(fault_codes(&wrong), ["FRM002"], "{:?}", wrong.findings);
    }
}
