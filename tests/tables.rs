//! Tables of joints and poses: faults are found as in a log with messages.

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use poseaudit::finding::{Finding, Severity, Status};
use poseaudit::geometry::{
    Convention, Pose, Vec3, pose, rotation_from_rotvec, rotation_from_xyzw, xyzw_from_rotation,
};
use poseaudit::log::ColumnSettings;
use poseaudit::report::{Report, Trouble, Verdict};
use poseaudit::robot::{Chain, catalogue};
use poseaudit::run::RunOptions;
use poseaudit::{Options, audit};

const JOINTS: usize = 6;
const ROWS: usize = 1500;
pub(crate) const STEP_S: f64 = 0.02;

/// A run of a UR5e as the rows of a table.
#[derive(Clone, Copy)]
pub(crate) struct Table {
    /// Latency of the poses, s.
    pub latency_s: f64,
    /// Offset of the logged elbow, rad.
    pub elbow_offset_rad: f64,
    /// Factor of joint positions.
    pub joint_factor: f64,
    /// Whether rotations are logged as roll, pitch, yaw.
    pub rpy: bool,
    /// Whether the table has poses.
    pub poses: bool,
}

pub(crate) const CLEAN: Table =
    Table { latency_s: 0.0, elbow_offset_rad: 0.0, joint_factor: 1.0, rpy: false, poses: true };

pub(crate) fn ur5e() -> Chain {
    let robot = catalogue::find("ur5e").expect("in the catalogue");
    let link =
        |name: &Option<String>| robot.link(name.as_deref().expect("a link")).expect("a link");
    robot.chain(link(&robot.controller_base), link(&robot.default_tip)).expect("a chain")
}

/// Joint positions at a time; each joint moves at a different rate.
fn joint_positions(t_s: f64) -> [f64; JOINTS] {
    const RATES: [f64; JOINTS] = [0.11, 0.17, 0.23, 0.31, 0.37, 0.43];
    std::array::from_fn(|joint| {
        let turn = TAU * RATES[joint] * t_s;
        [-0.4, -1.3, 1.4, -1.2, -1.0, 0.3][joint] + 0.5 * turn.sin() + 0.2 * (2.3 * turn).cos()
    })
}

impl Table {
    pub fn rows(&self) -> Vec<Vec<f64>> {
        let chain = ur5e();
        let row = |row: usize| {
            let t_s = row as f64 * STEP_S;
            let mut logged = joint_positions(t_s);
            logged[2] += self.elbow_offset_rad;
            let mut numbers = vec![t_s];
            numbers.extend(logged.map(|q| q * self.joint_factor));
            let pose: Pose = chain.forward(&joint_positions(t_s - self.latency_s));
            if self.poses {
                // Half of the rounding of a controller's poses.
                let noise = 1e-5 * ((row * 7919 % 13) as f64 - 6.0) / 6.0;
                numbers.extend(pose.translation.vector.iter().map(|length| length + noise));
                match self.rpy {
                    true => numbers.extend(Convention::RPY.numbers(&pose.rotation)),
                    false => numbers.extend(xyzw_from_rotation(&pose.rotation)),
                }
            }
            numbers
        };
        (0..ROWS).map(row).collect()
    }

    fn csv(&self, joint: &str, folder: &Path) -> std::path::PathBuf {
        let path = folder.join("run.csv");
        fs::write(&path, self.text(joint)).expect("a file");
        path
    }

    fn text(&self, joint: &str) -> String {
        let mut text = "time".to_owned();
        (1..=JOINTS).for_each(|number| write!(text, ",{joint}{number}").expect("text"));
        let pose = if self.rpy { ",x,y,z,roll,pitch,yaw" } else { ",x,y,z,qx,qy,qz,qw" };
        text += if self.poses { pose } else { "" };
        for row in self.rows() {
            let cells: Vec<String> = row.iter().map(|number| format!("{number:.9}")).collect();
            write!(text, "\n{}", cells.join(",")).expect("text");
        }
        text.push('\n');
        text
    }
}

/// A run of a UR5e with a zero offset of the elbow, as a table.
pub fn csv_of_ur5e_with_elbow_offset(elbow_offset_rad: f64) -> String {
    Table { elbow_offset_rad, ..CLEAN }.text("q")
}

/// Writes columns of `rows` with a header.
fn write_columns(path: &Path, header: &str, rows: &[Vec<f64>], columns: std::ops::Range<usize>) {
    let mut text = header.to_owned();
    for row in rows {
        let cells = std::iter::once(row[0]).chain(row[columns.clone()].iter().copied());
        let cells: Vec<String> = cells.map(|number| format!("{number:.9}")).collect();
        write!(text, "\n{}", cells.join(",")).expect("text");
    }
    fs::write(path, text + "\n").expect("a file");
}

fn report_on_table(table: &Table, robot: Option<&str>) -> Report {
    let folder = tempfile::tempdir().expect("a folder");
    audit_table(&table.csv("q", folder.path()), robot, ColumnSettings::default()).expect("a report")
}

pub(crate) fn audit_table(
    path: &Path,
    robot: Option<&str>,
    columns: ColumnSettings,
) -> Result<Report, Trouble> {
    let run =
        RunOptions { robots: robot.into_iter().map(Into::into).collect(), ..RunOptions::default() };
    let mut options = Options { logs: vec![path.to_owned()], run, ..Options::default() };
    options.read.columns = columns;
    audit(&options).map(poseaudit::Audited::into_report)
}

/// Reports on a table without and with the corrections of its findings.
pub(crate) fn audit_and_correct(path: &Path, robot: &str) -> [Report; 2] {
    let folder = tempfile::tempdir().expect("a folder");
    let run = RunOptions { robots: vec![robot.into()], ..RunOptions::default() };
    let mut options = Options { logs: vec![path.to_owned()], run, ..Options::default() };
    let before = audit(&options).expect("a report");
    before.write_fixes(folder.path()).expect("corrections");
    options.corrections = Some(folder.path().join("corrections.toml"));
    let after = audit(&options).expect("a report");
    [before, after].map(poseaudit::Audited::into_report)
}

pub(crate) fn value_of(report: &Report, code: &str) -> f64 {
    let found: Vec<&Finding> =
        report.findings.iter().filter(|finding| finding.code == code).collect();
    let [only] = found.as_slice() else { panic!("{code} in {:?}", report.findings) };
    only.estimate.as_ref().and_then(|estimate| estimate.value()).expect("an amount")
}

pub(crate) fn fault_codes(report: &Report) -> Vec<&str> {
    let above = report.findings.iter().filter(|finding| finding.severity > Severity::Info);
    above.map(|finding| finding.code).collect()
}

/// The joints follow their commands through first-order lags that differ, so no latency explains the poses.
#[test]
fn poses_of_the_commanded_joints_are_not_compared_with_the_measured_ones() {
    let mut header = "time".to_owned();
    for ending in ["", "_desired"] {
        (1..=JOINTS).for_each(|joint| write!(header, ",q{joint}{ending}").expect("text"));
    }
    header += ",x,y,z,qx,qy,qz,qw";
    let mut measured = joint_positions(0.0);
    let rows = CLEAN.rows().into_iter().map(|row| {
        for (joint, q) in measured.iter_mut().enumerate() {
            *q += (row[1 + joint] - *q) * STEP_S / (0.02 + 0.012 * joint as f64);
        }
        [&row[..1], &measured, &row[1..]].concat()
    });
    let rows: Vec<Vec<f64>> = rows.collect();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    write_columns(&path, &header, &rows, 1..rows[0].len());
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let poses = ["LAT001", "FRM002", "FRM003", "ZER001", "MDL001"];
    assert!(!fault_codes(&report).iter().any(|code| poses.contains(code)), "{report:?}");
    assert_ne!(report.verdict, Verdict::Pass);
    let stream = report
        .streams
        .iter()
        .find(|stream| stream.role == "unassigned" && stream.reason.contains("FK of the commands"));
    assert!(stream.is_some(), "{:?}", report.streams);
}

#[test]
fn a_tracker_that_names_no_frame_measures_in_its_own_world() {
    let world = pose([1.2, -0.4, 0.8], rotation_from_rotvec(Vec3::new(0.4, -0.9, 1.3)));
    let marker = pose([0.05, -0.02, 0.11], rotation_from_rotvec(Vec3::new(0.2, 0.5, -0.3)));
    let mut rows = CLEAN.rows();
    for row in &mut rows {
        let q_xyzw = [row[10], row[11], row[12], row[13]];
        let tip = pose([row[7], row[8], row[9]], rotation_from_xyzw(q_xyzw).expect("a rotation"));
        let tracked = world * tip * marker;
        row[7..10].copy_from_slice(tracked.translation.vector.as_slice());
        row[10..].copy_from_slice(&xyzw_from_rotation(&tracked.rotation));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let pose_names = ["x", "y", "z", "qx", "qy", "qz", "qw"].map(|name| format!("vicon_{name}"));
    let header = format!("time,q1,q2,q3,q4,q5,q6,{}", pose_names.join(","));
    write_columns(&path, &header, &rows, 1..14);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!(
        (report.verdict, fault_codes(&report)),
        (Verdict::Pass, Vec::new()),
        "{:?}",
        report.findings
    );
}

#[test]
fn a_unit_that_changes_within_an_undeclared_table_is_a_fault() {
    const CHANGE_ROW: usize = 800;
    let mut rows = CLEAN.rows();
    for row in &mut rows[CHANGE_ROW..] {
        row[7..10].iter_mut().for_each(|metres| *metres *= 1e3);
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    write_columns(&path, "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw", &rows, 1..14);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!((report.verdict, fault_codes(&report)), (Verdict::Fail, vec!["ORD008"]));
    let message = &report.findings[0].message;
    assert!(message.starts_with("from +15.99 s on: positions are millimetres"), "{message}");
}

#[test]
fn tables_of_joints_and_poses_with_the_same_clock_are_one_run() {
    let rows = Table { latency_s: 0.03, ..CLEAN }.rows();
    let folder = tempfile::tempdir().expect("a folder");
    let [joints, poses] = ["joints.csv", "poses.csv"].map(|name| folder.path().join(name));
    write_columns(&joints, "time,q1,q2,q3,q4,q5,q6", &rows, 1..7);
    write_columns(&poses, "time,x,y,z,qx,qy,qz,qw", &rows, 7..14);
    let run = RunOptions { robots: vec!["ur5e".into()], ..RunOptions::default() };
    let options = Options { logs: vec![joints, poses], run, ..Options::default() };
    let report = audit(&options).map(poseaudit::Audited::into_report).expect("a report");
    assert_eq!(fault_codes(&report), ["LAT001"], "{:?}", report.findings);
    assert!((value_of(&report, "LAT001") - 0.03).abs() < 5e-4);
}

#[test]
fn tables_without_common_times_are_aligned_by_motion() {
    const OFFSET_S: f64 = 500.0;
    let rows = CLEAN.rows();
    let mut later = rows.clone();
    later.iter_mut().for_each(|row| row[0] += OFFSET_S);
    let folder = tempfile::tempdir().expect("a folder");
    let [joints, poses] = ["joints.csv", "poses.csv"].map(|name| folder.path().join(name));
    write_columns(&joints, "time,q1,q2,q3,q4,q5,q6", &rows, 1..7);
    write_columns(&poses, "time,x,y,z,qx,qy,qz,qw", &later, 7..14);
    let run = RunOptions { robots: vec!["ur5e".into()], ..RunOptions::default() };
    let options = Options { logs: vec![joints, poses], run, ..Options::default() };
    let report = audit(&options).map(poseaudit::Audited::into_report).expect("a report");
    assert_eq!(fault_codes(&report), ["TIM003"], "{:?}", report.findings);
    assert!((value_of(&report, "TIM003") - OFFSET_S).abs() < 0.1);
}

#[test]
fn joints_without_names_that_repeat_an_arm_are_no_second_arm() {
    let rows = CLEAN.rows();
    let folder = tempfile::tempdir().expect("a folder");
    let [named, unnamed] = ["joint_states.csv", "state.csv"].map(|name| folder.path().join(name));
    let names = "time,shoulder_pan_joint,shoulder_lift_joint,elbow_joint,wrist_1_joint,\
        wrist_2_joint,wrist_3_joint,x,y,z,qx,qy,qz,qw";
    write_columns(&named, names, &rows, 1..14);
    write_columns(&unnamed, "time,q0,q1,q2,q3,q4,q5", &rows, 1..7);
    let options = Options { logs: vec![named, unnamed], ..Options::default() };
    let report = audit(&options).map(poseaudit::Audited::into_report).expect("a report");
    assert_eq!(report.robots.len(), 1, "{:?}", report.robots);
    assert!(report.findings.iter().all(|found| found.code != "FRM007"), "{:?}", report.findings);
}

#[test]
fn a_constant_pose_next_to_the_tool_pose_is_an_offset() {
    let header = "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw,ee_offset_x,ee_offset_y,ee_offset_z,\
        ee_offset_qx,ee_offset_qy,ee_offset_qz,ee_offset_qw";
    let mut rows = CLEAN.rows();
    rows.iter_mut().for_each(|row| row.extend([0.0, 0.0, 0.1034, 0.0, 0.0, 0.0, 1.0]));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    write_columns(&path, header, &rows, 1..21);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!(fault_codes(&report), [""; 0], "{:?}", report.findings);
    assert!(report.findings.iter().any(|found| found.code == "META002"), "{:?}", report.findings);
}

#[test]
fn joint_positions_that_are_always_zero_were_never_set() {
    let rows: Vec<Vec<f64>> =
        (0..400).map(|row| [vec![row as f64 * STEP_S], vec![0.0; JOINTS + 1]].concat()).collect();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    // The limits of the Franka's joint 4 exclude 0.
    for (robot, joints, severity) in
        [("franka_fer", JOINTS + 1, Severity::Warning), ("ur5e", JOINTS, Severity::Info)]
    {
        let names: Vec<String> = (1..=joints).map(|joint| format!("q{joint}")).collect();
        write_columns(&path, &format!("time,{}", names.join(",")), &rows, 1..joints + 1);
        let report = audit_table(&path, Some(robot), ColumnSettings::default()).expect("a report");
        let [found] = report.findings.as_slice() else { panic!("{:?}", report.findings) };
        assert!(found.code == "FRM007" && found.severity == severity, "{found:?}");
        assert!(found.message.contains("exactly 0 in all 400 samples"), "{}", found.message);
    }
}

#[test]
fn a_fault_free_table_passes_and_its_arm_is_identified() {
    let report = report_on_table(&CLEAN, None);
    assert_eq!(
        (report.verdict, fault_codes(&report)),
        (Verdict::Pass, Vec::new()),
        "{:?}",
        report.findings
    );
    assert_eq!(report.robots[0].name, "ur5e");
}

#[test]
fn planted_faults_are_found_with_their_values() {
    for rpy in [false, true] {
        let late = report_on_table(&Table { latency_s: 0.06, rpy, ..CLEAN }, Some("ur5e"));
        assert_eq!(fault_codes(&late), ["LAT001"]);
        assert!((value_of(&late, "LAT001") - 0.06).abs() < 5e-4, "{}", value_of(&late, "LAT001"));
        let zero = report_on_table(
            &Table { elbow_offset_rad: -0.5_f64.to_radians(), rpy, ..CLEAN },
            Some("ur5e"),
        );
        assert_eq!(fault_codes(&zero), ["ZER001"]);
        assert!(
            (value_of(&zero, "ZER001").to_degrees() - 0.5).abs() < 0.01,
            "{}",
            value_of(&zero, "ZER001")
        );
    }
}

/// Positions alone violate no convention of rotations or units, in any format.
#[test]
fn poses_without_rotations_are_audited() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let report_of = |table: Table, metres: f64, robot: Option<&str>| {
        let mut text = "time,q1,q2,q3,q4,q5,q6,x,y,z".to_owned();
        for mut row in table.rows() {
            row.truncate(1 + JOINTS + 3);
            row[1 + JOINTS..].iter_mut().for_each(|length| *length /= metres);
            let cells: Vec<String> = row.iter().map(|number| format!("{number:.9}")).collect();
            write!(text, "\n{}", cells.join(",")).expect("text");
        }
        fs::write(&path, text).expect("a file");
        audit_table(&path, robot, ColumnSettings::default()).expect("a report")
    };
    for robot in [None, Some("ur5e")] {
        let sound = report_of(CLEAN, 1.0, robot);
        assert_eq!(sound.verdict, Verdict::Pass, "{:?}", sound.findings);
        assert!(sound.findings.is_empty(), "{:?}", sound.findings);
    }
    let millimetres = report_of(CLEAN, 1e-3, Some("ur5e"));
    let found: Vec<_> =
        millimetres.findings.iter().map(|it| (it.code, it.title.to_string())).collect();
    assert_eq!(found, [("ORD001", "encoding of undeclared numbers was inferred".to_owned())]);
    assert_eq!(millimetres.verdict, Verdict::Pass);
    let late = report_of(Table { latency_s: 0.06, ..CLEAN }, 1.0, Some("ur5e"));
    assert_eq!(fault_codes(&late), ["LAT001"]);
    assert!((value_of(&late, "LAT001") - 0.06).abs() < 5e-4, "{}", value_of(&late, "LAT001"));
    let zero =
        report_of(Table { elbow_offset_rad: -0.5_f64.to_radians(), ..CLEAN }, 1.0, Some("ur5e"));
    assert_eq!(fault_codes(&zero), ["ZER001"]);
    assert!((value_of(&zero, "ZER001").to_degrees() - 0.5).abs() < 0.01);
}

#[test]
fn joint_names_in_an_order_that_contradicts_the_poses_are_a_finding() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let names = ur5e().joint_names().to_vec();
    let mut swapped: Vec<String> = names.clone();
    swapped.swap(0, 2);
    for (names, expected) in [(names, vec![]), (swapped, vec!["ORD005"])] {
        let text = CLEAN.text("q");
        let rows = text.split_once('\n').expect("rows").1;
        let header = format!("time,{},x,y,z,qx,qy,qz,qw", names.join(","));
        fs::write(&path, format!("{header}\n{rows}")).expect("a file");
        let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
        assert_eq!(fault_codes(&report), expected, "{:?}", report.findings);
    }
}

/// KUKA's RSI logs measured and commanded tool poses, but no joints.
#[test]
fn the_delay_of_a_tool_behind_its_command_is_noted_without_an_arm() {
    const DELAY_ROWS: usize = 3;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    // It moves for 10 s, rests and moves again; at rest it is 0.2 off its command.
    let at = |row: usize| {
        let row = row.min(500) + row.saturating_sub(700);
        let t_s = row as f64 * STEP_S;
        [1279.0 + 90.0 * (1.1 * t_s).sin(), 60.0 * (0.7 * t_s).cos(), 40.0 * (1.7 * t_s).sin()]
    };
    let mut text =
        "time,X_RIst,Y_RIst,Z_RIst,A_RIst,B_RIst,C_RIst,X_RSol,Y_RSol,Z_RSol,A_RSol,B_RSol,C_RSol"
            .to_owned();
    for row in 0..1200 {
        let ([x, y, z], [a, b, c]) = (at(row), at(row + DELAY_ROWS));
        let t_s = row as f64 * STEP_S;
        write!(text, "\n{t_s:.3},{:.4},{y:.4},{z:.4},0,1,2,{a:.4},{b:.4},{c:.4},0,1,2", x + 0.2)
            .expect("text");
    }
    fs::write(&path, text).expect("a file");
    let report = audit_table(&path, None, ColumnSettings::default()).expect("a report");
    let notes: String = report.log.notes.iter().map(|note| note.note.as_str()).collect();
    for expected in ["X_RIst follows X_RSol by 60 ms; offset at rest +0.200", "Z_RIst follows"] {
        assert!(notes.contains(expected), "{expected}: {notes}");
    }
}

/// A poll before the source's next value repeats a row, and the following one holds two steps.
#[test]
fn rows_polled_too_early_are_no_abrupt_stops() {
    const ACCELERATION: f64 = 12.0;
    const SPEED: f64 = 0.9;
    // There and back by 0.9 rad, with rests.
    let position = |t_s: f64| {
        let (ramp_s, move_s, rest_s) = (SPEED / ACCELERATION, 1.0 + SPEED / ACCELERATION, 0.5);
        let (turn, t_s) = (t_s.div_euclid(move_s + rest_s), t_s.rem_euclid(move_s + rest_s));
        let speeding_up = |t_s: f64| 0.5 * ACCELERATION * t_s.clamp(0.0, ramp_s).powi(2);
        let at_speed = SPEED * (t_s - ramp_s).clamp(0.0, move_s - 2.0 * ramp_s);
        let slowing_down = speeding_up(ramp_s) - speeding_up(move_s - t_s.max(move_s - ramp_s));
        let moved = speeding_up(t_s) + at_speed + slowing_down;
        if turn % 2.0 == 0.0 { moved } else { SPEED - moved }
    };
    let mut text = "time,q1,q2,q3,q4,q5,q6".to_owned();
    for row in 0..3000 {
        let is_early = row * 7919 % 37 == 4;
        let q = position(0.008 * (row - usize::from(is_early)) as f64);
        write!(text, "\n{:.3}", 0.008 * row as f64).expect("text");
        for joint in [0.0, -1.5, 0.2, 0.3, 0.4, 0.5] {
            write!(text, ",{:.6}", q + joint).expect("text");
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    fs::write(&path, text).expect("a file");
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert!(fault_codes(&report).is_empty(), "{:?}", report.findings);
}

#[test]
fn joints_in_degrees_are_converted_and_noted() {
    let degrees = Table {
        joint_factor: 1_f64.to_degrees(),
        elbow_offset_rad: -0.5_f64.to_radians(),
        rpy: true,
        ..CLEAN
    };
    for robot in [None, Some("ur5e")] {
        let report = report_on_table(&degrees, robot);
        assert_eq!(fault_codes(&report), ["ZER001"], "{:?}", report.findings);
        let joints = report.streams.iter().find(|stream| stream.role == "joints").expect("joints");
        assert!(joints.reason.contains("taken for degrees"), "{}", joints.reason);
    }
}

#[test]
fn units_in_column_names_are_compared_with_the_motion() {
    let folder = tempfile::tempdir().expect("a folder");
    let header = |joint: &str, position: &str| {
        let joints: String = (1..=JOINTS).map(|number| format!(",joint{number}_{joint}")).collect();
        format!("time{joints},x_{position},y_{position},z_{position},qx,qy,qz,qw")
    };
    let audited = |joint: &str, position: &str, table: &Table| {
        let path = folder.path().join("run.csv");
        write_columns(&path, &header(joint, position), &table.rows(), 1..8 + JOINTS);
        audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report")
    };
    let wrong = audited("deg", "m", &CLEAN);
    assert_eq!(fault_codes(&wrong), ["ORD004"], "{:?}", wrong.findings);
    let right = audited("deg", "m", &Table { joint_factor: 1_f64.to_degrees(), ..CLEAN });
    assert_eq!(fault_codes(&right), [""; 0], "{:?}", right.findings);
    let millimetres = audited("rad", "mm", &CLEAN);
    assert_eq!(fault_codes(&millimetres), ["META001"], "{:?}", millimetres.findings);
}

/// Rows with millimetres and degrees in the columns of a FANUC.
fn fanuc_rows(convention: Convention) -> Vec<Vec<f64>> {
    let mut rows = CLEAN.rows();
    for row in &mut rows {
        let rotation =
            rotation_from_xyzw([row[10], row[11], row[12], row[13]]).expect("a rotation");
        row.truncate(10);
        row[7..].iter_mut().for_each(|metres| *metres *= 1e3);
        row.extend(convention.numbers(&rotation).map(f64::to_degrees));
    }
    rows
}

#[test]
fn a_corrected_encoding_is_not_compared_with_the_names_of_columns() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let moving_axes: Convention = "euler:ZYX".parse().expect("a convention");
    for (convention, codes) in [(Convention::RPY, vec![]), (moving_axes, vec!["META001"])] {
        let rows = fanuc_rows(convention);
        write_columns(&path, "time,q1,q2,q3,q4,q5,q6,X,Y,Z,W,P,R", &rows, 1..7 + JOINTS);
        let [before, after] = audit_and_correct(&path, "ur5e");
        assert_eq!(fault_codes(&before), codes, "{:?}", before.findings);
        let inferred = before.findings.iter().find(|finding| finding.code == "ORD001");
        let inferred = inferred.expect("a finding");
        assert!(inferred.message.contains(&convention.to_string()), "{}", inferred.message);
        let is_other = inferred.fix.contains("named as euler:xyz (META001)");
        assert_eq!(is_other, !codes.is_empty(), "{}", inferred.fix);
        assert!(after.findings.is_empty(), "{:?}", after.findings);
        let gimbal_lock = after.checks.iter().find(|row| row.code == "ORD006").expect("a row");
        assert_eq!(gimbal_lock.status, Status::Pass, "{:?}", gimbal_lock.reason);
    }
}

#[test]
fn a_coupled_joint_is_corrected() {
    let mut rows = CLEAN.rows();
    rows.iter_mut().for_each(|row| row[3] -= row[2]);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    write_columns(&path, "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw", &rows, 1..8 + JOINTS);
    let [before, after] = audit_and_correct(&path, "ur5e");
    assert_eq!(fault_codes(&before), ["ORD009"], "{:?}", before.findings);
    assert!(after.findings.is_empty(), "{:?}", after.findings);
    let is_noted = |note: &str| note.contains("elbow_joint by 1.00000 times shoulder_lift_joint");
    assert!(after.log.notes.iter().any(|note| is_noted(&note.note)), "{:?}", after.log.notes);
}

#[test]
fn joints_in_percent_are_not_taken_for_degrees() {
    let shares = Table { joint_factor: 100.0 / 3.0, ..CLEAN };
    let report = report_on_table(&shares, Some("ur5e"));
    assert_eq!(fault_codes(&report), ["ORD009"], "{:?}", report.findings);
}

#[test]
fn without_a_pose_the_unit_of_joints_is_inconclusive() {
    let report =
        report_on_table(&Table { joint_factor: 40.0, poses: false, ..CLEAN }, Some("ur5e"));
    assert_eq!(
        (fault_codes(&report), report.verdict),
        (Vec::new(), Verdict::Inconclusive),
        "{:?}",
        report.findings
    );
    let limits = report.checks.iter().filter(|row| row.code.starts_with("MOT003"));
    assert!(
        limits.clone().count() == JOINTS
            && limits.clone().all(|row| row.status == Status::Inconclusive)
    );
}

#[test]
fn a_table_that_fits_no_arm_is_an_error_that_asks_for_the_robot() {
    // An arm with poses scaled by 1.3 matches no catalogue arm.
    let folder = tempfile::tempdir().expect("a folder");
    let mut text = "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw\n".to_owned();
    for row in CLEAN.rows() {
        let scaled = row
            .iter()
            .enumerate()
            .map(|(at, number)| if (7..10).contains(&at) { 1.3 * number } else { *number });
        let cells: Vec<String> = scaled.map(|number| format!("{number:.9}")).collect();
        writeln!(text, "{}", cells.join(",")).expect("text");
    }
    let path = folder.path().join("run.csv");
    fs::write(&path, text).expect("a file");
    let report = audit_table(&path, None, ColumnSettings::default()).expect("a report");
    let error = report.error.as_ref().expect("a question");
    assert!(
        error.what.contains("does not name its 6 joints") && error.remedy.contains("--robot"),
        "{error:?}"
    );
}

#[test]
fn a_declared_rate_that_contradicts_the_stamps_is_a_finding() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/log/tables/fixtures");
    let status = |report: &Report| {
        let row = report.checks.iter().find(|row| row.code == "META001").expect("it is asked");
        row.status
    };
    let report_of = |file: &str| {
        audit_table(&folder.join(file), Some("ur5e"), ColumnSettings::default()).expect("a report")
    };
    // Its stamps match the declared 25 Hz.
    assert_eq!(status(&report_of("chunked_latest.h5")), Status::Pass);
    let wrong = report_of("wrong_rate.h5");
    assert_eq!(status(&wrong), Status::Fail);
    let finding = wrong.findings.iter().find(|finding| finding.code == "META001");
    let message = finding.map(|finding| finding.message.as_str()).unwrap_or_default();
    assert!(message.contains("declares 40 frames") && message.contains("25.0000"), "{message}");
    // Even without metadata, numbers may contradict column names.
    assert_eq!(status(&report_on_table(&CLEAN, None)), Status::Pass);
}

#[test]
fn columns_without_names_can_be_declared() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.npy");
    let rows = CLEAN.rows();
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({ROWS}, 14), }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    rows.iter().flatten().for_each(|number| bytes.extend(number.to_le_bytes()));
    fs::write(&path, bytes).expect("a file");
    let select = |text: &str| vec![text.parse().expect("a selector")];
    let declared = ColumnSettings {
        rate_hz: Some(1.0 / STEP_S),
        joints: select("array[1:7]"),
        pose: select("array[7:14]"),
        ..ColumnSettings::default()
    };
    let found = audit_table(&path, Some("ur5e"), declared).expect("a report");
    assert_eq!(
        (found.verdict, fault_codes(&found)),
        (Verdict::Pass, Vec::new()),
        "{:?}",
        found.findings
    );
    // Its first number increases in even steps: the times.
    let detected = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    assert_eq!(
        (detected.verdict, fault_codes(&detected)),
        (Verdict::Pass, Vec::new()),
        "{:?}",
        detected.findings
    );
}

/// Message of META002 for the edited rows of a sound UR5e.
fn repeated_columns(
    header: &str,
    edit: impl Fn(&[f64]) -> Vec<f64>,
) -> Vec<(String, Option<String>, String)> {
    let folder = tempfile::tempdir().expect("a folder");
    let mut text = header.to_owned();
    for row in CLEAN.rows() {
        let cells: Vec<String> = edit(&row).iter().map(|number| format!("{number:.9}")).collect();
        write!(text, "\n{}", cells.join(",")).expect("text");
    }
    let path = folder.path().join("run.csv");
    fs::write(&path, text + "\n").expect("a file");
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let found = report.findings.iter().filter(|finding| finding.code == "META002");
    found
        .map(|found| {
            let topic = found.subject.topic.clone().unwrap_or_default();
            (
                topic,
                found.subject.joint.clone(),
                format!("{} {}", found.severity.name(), found.message),
            )
        })
        .collect()
}

#[test]
fn columns_that_repeat_others_are_a_finding() {
    const STATE: &str = "time,q1,q2,q3,q4,q5,q6,tcp_x,tcp_y,tcp_z,tcp_qx,tcp_qy,tcp_qz,tcp_qw";
    assert_eq!(repeated_columns(STATE, <[f64]>::to_vec), []);
    let commands = format!("{STATE},action_q1,action_q2,action_q3,action_q4,action_q5,action_q6");
    let copied = repeated_columns(&commands, |row| [row, &row[1..7]].concat());
    let [(_, None, message)] = copied.as_slice() else { panic!("{copied:?}") };
    assert!(message.starts_with("warning") && message.contains("in every row"), "{message}");
    // Commands that lead by a row are not repeats of the states.
    let ahead =
        repeated_columns(&commands, |row| [row, &joint_positions(row[0] + STEP_S)].concat());
    assert_eq!(ahead, []);
    let tracker = format!(
        "{STATE},tracker_x,tracker_y,tracker_z,tracker_qx,tracker_qy,tracker_qz,tracker_qw"
    );
    let twice = repeated_columns(&tracker, |row| [row, &row[7..]].concat());
    let [(topic, None, message)] = twice.as_slice() else { panic!("{twice:?}") };
    assert!(topic == "tracker" && message.contains("not an independent measurement"), "{message}");
    let still =
        repeated_columns(&tracker, |row| [row, &[0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]].concat());
    let [(topic, None, message)] = still.as_slice() else { panic!("{still:?}") };
    assert!(
        topic == "tracker"
            && message.starts_with("info")
            && message.contains("constant in every row"),
        "{message}"
    );
    let joint = repeated_columns(STATE, |row| [&row[..6], &row[5..6], &row[7..]].concat());
    let [(_, Some(_), message)] = joint.as_slice() else { panic!("{joint:?}") };
    assert!(message.starts_with("warning") && message.contains("identical to"), "{message}");
}

#[test]
fn positions_of_markers_and_objects_that_are_not_compared_are_listed() {
    const HEADER: &str = "time,q1,q2,q3,q4,q5,q6,tcp_x,tcp_y,tcp_z,tcp_qx,tcp_qy,tcp_qz,tcp_qw,\
                          marker1_x,marker1_y,marker1_z,ball_x,ball_y,ball_z";
    let folder = tempfile::tempdir().expect("a folder");
    let mut text = HEADER.to_owned();
    for mut row in CLEAN.rows() {
        let (sin, cos) = row[0].sin_cos();
        row.extend([0.5 + 0.1 * sin, 0.1 * cos, 0.2, 0.3 * cos, 0.2, 0.4 - 0.1 * sin]);
        let cells: Vec<String> = row.iter().map(|number| format!("{number:.9}")).collect();
        write!(text, "\n{}", cells.join(",")).expect("text");
    }
    let path = folder.path().join("run.csv");
    fs::write(&path, text + "\n").expect("a file");
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    for name in ["marker_1", "ball"] {
        let row = report.streams.iter().find(|row| row.topic == name).expect("a stream");
        assert_eq!(row.role, "unassigned", "{name}: {}", row.reason);
        assert!(row.reason.contains("not compared"), "{name}: {}", row.reason);
    }
}

/// Poses of each row are FK of its joint positions, as in a simulation.
#[test]
fn a_vibration_that_the_poses_show_is_no_noise() {
    let chain = ur5e();
    let rows = CLEAN.rows().into_iter().enumerate().map(|(at, row)| {
        let mut q = row[1..=JOINTS].to_vec();
        // Alternates from row to row.
        let shake = if at % 2 == 0 { 0.01 } else { -0.01 };
        q[4] += shake;
        q[5] -= 0.7 * shake;
        let pose = chain.forward(&q);
        let rotation = xyzw_from_rotation(&pose.rotation);
        [vec![0.4 * row[0]], q, pose.translation.vector.as_slice().to_vec(), rotation.to_vec()]
            .concat()
    });
    let rows: Vec<Vec<f64>> = rows.collect();
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.csv");
    let header = "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw";
    write_columns(&path, header, &rows, 1..14);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    // The vibration itself is a fault.
    assert!(
        fault_codes(&report).iter().all(|code| code.starts_with("MOT")),
        "{:?}",
        report.findings
    );
    let residual = report.checks.iter().find(|row| row.code == "MDL001").expect("a residual");
    let rms_m = residual.estimate.as_ref().and_then(|estimate| estimate.value()).expect("a value");
    assert!(rms_m < 1e-5, "{rms_m}");
}

#[test]
fn recordings_of_equal_length_in_one_table_are_segments() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut rows = CLEAN.rows();
    rows.iter_mut().enumerate().for_each(|(at, row)| row[0] = (at % 500) as f64 * STEP_S);
    let path = folder.path().join("run.csv");
    write_columns(&path, "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw", &rows, 1..14);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let is_of_segments =
        |row: &poseaudit::report::NoteRow| row.note.contains("Audited in 3 segments");
    assert!(report.log.notes.iter().any(is_of_segments), "{:?}", report.log.notes);
    assert_eq!(fault_codes(&report), [""; 0]);
}

#[test]
fn a_clock_that_is_set_back_within_a_table_is_a_finding() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut rows = CLEAN.rows();
    rows.iter_mut().skip(700).for_each(|row| row[0] -= 0.5);
    let path = folder.path().join("run.csv");
    write_columns(&path, "time,q1,q2,q3,q4,q5,q6,x,y,z,qx,qy,qz,qw", &rows, 1..14);
    let report = audit_table(&path, Some("ur5e"), ColumnSettings::default()).expect("a report");
    let found = report.findings.iter().find(|finding| finding.code == "TIM001");
    let by_s = found.and_then(|found| found.estimate.as_ref()?.value());
    assert!((by_s.expect("stamps step back") - 0.48).abs() < 1e-6, "{:?}", report.findings);
    assert!(
        !fault_codes(&report).iter().any(|code| code.starts_with("MOT")),
        "{:?}",
        report.findings
    );
}

#[test]
fn rotation_vectors_and_translations_of_a_camera_close_the_hand_eye_chain() {
    let hand_from_camera = pose([0.05, 0.03, 0.08], rotation_from_rotvec([0.1, -0.2, 1.5].into()));
    let base_from_board = pose([0.5, 0.1, 0.0], rotation_from_rotvec([3.0, 0.1, 0.2].into()));
    for (rotation, translation, per_m) in [
        ("T_cam_target_rvec", "T_cam_target_tvec", 1.0),
        ("chessboard_data.rotation_vector", "chessboard_data.translation_mm", 1e3),
    ] {
        let record = |row: i32, is_timed: bool| {
            let t = f64::from(row);
            let turn =
                [2.6 + 0.3 * (0.4 * t).sin(), 0.5 * (0.31 * t + 1.0).sin(), 0.6 * (0.27 * t).cos()];
            let xyz = [
                0.45 + 0.1 * (0.5 * t).sin(),
                0.1 * (0.41 * t).cos(),
                0.5 + 0.06 * (0.7 * t).sin(),
            ];
            let base_from_hand = pose(xyz, rotation_from_rotvec(turn.into()));
            let seen = (base_from_hand * hand_from_camera).inverse() * base_from_board;
            let rotvec = Convention::RotVec.numbers(&seen.rotation);
            let xyz = seen.translation.vector * per_m;
            let hand = base_from_hand.to_homogeneous();
            let hand: Vec<Vec<f64>> =
                hand.row_iter().map(|row| row.iter().copied().collect()).collect();
            let time =
                if is_timed { format!("\"timestamp\":{:?},", 0.5 * t) } else { String::new() };
            format!(
                r#"{{{time}"gripper2base":{hand:?},"{rotation}":{rotvec:?},"{translation}":[{:?},{:?},{:?}]}}"#,
                xyz.x, xyz.y, xyz.z
            )
        };
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("hand_eye.json");
        let report = |is_timed: bool| {
            let records: Vec<String> = (0..24).map(|row| record(row, is_timed)).collect();
            fs::write(&path, format!("[{}]", records.join(","))).expect("a file");
            audit_table(&path, None, ColumnSettings::default())
        };
        let asked = report(false).expect_err("no times").remedy;
        assert!(
            asked.contains("hand-eye calibration, at rest, use --columns 'matrix[16],"),
            "{asked}"
        );
        let report = report(true).expect("a report");
        let closure = report.checks.iter().find(|row| row.code == "HEC001").expect("a check");
        assert_eq!(closure.status, Status::Pass, "{rotation}: {:?}", report.findings);
        let layout = report.log.tables[0].layout.clone().expect("a layout");
        let unit = if per_m == 1.0 { "" } else { ":mm" };
        let own = |item: &str| format!("{translation}/{item}");
        let [x, y, z] = ["x", "y", "z"].map(|axis| own(axis) + unit);
        assert_eq!(layout, format!("t,matrix[16],{},{x},{y},{z}", own("rotvec")));
    }
}
