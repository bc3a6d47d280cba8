//! Tables whose columns are given by position.

use proptest::prelude::*;

use super::{joints, plain, read, topic};
use crate::{ColumnSettings, FileLayout, Log, LogError};
use ground::stream::Columns;

fn with_layout(text: &str, layout: &str) -> Result<Log, LogError> {
    let layout: FileLayout = layout.parse().expect("a layout");
    read(text.as_bytes(), ColumnSettings { layouts: vec![layout], ..ColumnSettings::default() })
}

fn refusal(text: &str, layout: &str) -> String {
    let line = with_layout(text, layout).expect_err("refused").to_string();
    assert!(!line.contains('\n'), "{line}");
    line
}

/// A stamp in ns, a counter, text, and five joints with their rates and a position in mm.
fn rows() -> String {
    let row = |row: i32| {
        let at = f64::from(row);
        let cells: Vec<String> = (0..5)
            .map(|joint| format!("{}", 10.0 * (0.1 * at + f64::from(joint)).sin()))
            .chain((0..5).map(|joint| format!("{}", (0.1 * at + f64::from(joint)).cos())))
            .chain(["100.5", "200.5", "-300.5"].map(str::to_owned))
            .collect();
        format!(
            "{},{row},IDLE,{}\n",
            1_692_874_987_554_129_225_i64 + 10_000_000 * i64::from(row),
            cells.join(",")
        )
    };
    (0..50).map(row).collect()
}

#[test]
fn columns_are_read_by_position_in_their_units() {
    let log = with_layout(&rows(), "t,_[2],q[5]:deg,qd[5]:rad,xyz:mm").unwrap();
    let (names, positions) = joints(&log, "joints");
    assert_eq!(names, ["q1", "q2", "q3", "q4", "q5"]);
    assert!((positions[3][1] - (10.0 * 1.3_f64.sin()).to_radians()).abs() < 1e-12);
    let Some(Columns::Joints(columns)) = &topic(&log, "joints").columns else { panic!() };
    // Velocities in rad/s stay.
    assert!((columns.joints[1].velocity[3] - 1.3_f64.cos()).abs() < 1e-12);
    // Every nanosecond of a stamp without a header.
    assert_eq!(columns.times.header[1], 1_692_874_987_564_129_225);
    let Some(Columns::Poses(poses)) = &topic(&log, "pose").columns else { panic!() };
    assert!((poses[0].xyz[0][2] + 0.3005).abs() < 1e-12);
    assert!(topic(&log, "array[1]").columns.is_none());
    let [table] = log.tables.as_slice() else { panic!() };
    assert_eq!(table.layout.as_deref(), Some("t,_[2],q[5]:deg,qd[5]:rad,x:mm,y:mm,z:mm"));
}

#[test]
fn a_layout_that_contradicts_the_table_is_refused_in_one_line() {
    let line = refusal(&rows(), "t,_[2],q[5],xyz");
    assert!(line.contains("--columns names 11 columns, but its rows have 16; the first row is 1692874987554129200,0,text,0,"), "{line}");
    let line = refusal(&rows(), "t,_,q[6],_[8]");
    assert!(line.contains("--columns names column 3 `q`, but it holds text"), "{line}");
    let line = refusal(&rows(), "_[3],t,q[4],_[8]");
    assert!(line.contains("--columns declares times that are not times"), "{line}");
    let line = refusal(&rows(), "other.csv=t,_[2],q[5],_[8]");
    assert!(line.contains("no file it applies to is one"), "{line}");
}

#[test]
fn open_columns_are_identified_by_name() {
    let text = "when,q1,q2,q3,q4,q5,q6,lamp\n".to_owned()
        + &(0..20).map(|at| format!("{at},0.1,0.2,0.{at},0.4,0.5,0.6,1\n")).collect::<String>();
    let log = with_layout(&text, "t:ms,?[6],_").unwrap();
    assert_eq!(joints(&log, "q").0.len(), 6);
    assert!(topic(&log, "lamp").read_as.as_deref().is_some_and(|it| it.contains("`_`")));
}

#[test]
fn seconds_and_nanoseconds_or_a_rate_give_the_times() {
    let text: String =
        (0..30).map(|at| format!("17,{},0.1,0.2,0.3,0.{at}\n", 10_000_000 * (at + 1))).collect();
    let stamps = |layout: &str| -> Vec<i64> {
        let log = with_layout(&text, layout).unwrap();
        let Some(Columns::Joints(joints)) = &topic(&log, "joints").columns else { panic!() };
        joints.times.header.clone()
    };
    assert_eq!(stamps("s,ns,q[4]")[..2], [17_010_000_000, 17_020_000_000]);
    let steps = stamps("_[2],q[4]@50");
    assert_eq!(steps[1] - steps[0], 20_000_000);
}

proptest! {
    /// The same numbers have the same meaning with names and with a layout, in any order of the columns.
    #[test]
    fn names_and_positions_give_the_same_columns(order in Just((0..9).collect::<Vec<usize>>()).prop_shuffle()) {
        let value = |row: usize, column: usize| match column {
            0 => 0.01 * row as f64,
            column => (0.05 * row as f64 + column as f64).sin(),
        };
        let names = ["timestamp", "q1", "q2", "q3", "q4", "q5", "x", "y", "z"];
        let short = ["t", "q", "q", "q", "q", "q", "x", "y", "z"];
        let line = |cells: Vec<String>| cells.join(",") + "\n";
        // Joints stay in their order.
        let mut next = 1;
        let order: Vec<usize> = order.into_iter().map(|column| match column {
            1..=5 => { next += 1; next - 1 }
            column => column,
        }).collect();
        let body: String = (0..20)
            .map(|row| line(order.iter().map(|&column| value(row, column).to_string()).collect()))
            .collect();
        let header = line(order.iter().map(|&column| names[column].to_owned()).collect());
        let layout: Vec<&str> = order.iter().map(|&column| short[column]).collect();
        let by_name = plain((header + &body).as_bytes());
        let by_position = with_layout(&body, &layout.join(",")).unwrap();
        prop_assert_eq!(joints(&by_name, "q").1, joints(&by_position, "joints").1);
        let xyz = |log: &Log, name: &str| match &topic(log, name).columns {
            Some(Columns::Poses(poses)) => poses[0].xyz.clone(),
            _ => Default::default(),
        };
        prop_assert_eq!(xyz(&by_name, "pose"), xyz(&by_position, "pose"));
    }
}
