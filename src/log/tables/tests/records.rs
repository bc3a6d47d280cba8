//! Records as text, workbooks, and lists of numbers in text tables.

use serde_json::json;

use super::{joints, plain, read, topic};
use crate::ColumnSettings;
use ground::stream::Columns;

const ROWS: usize = 40;

fn q(row: usize) -> Vec<f64> {
    (0..6).map(|joint| (0.05 * row as f64 + joint as f64).sin()).collect()
}

fn assert_has_joints(bytes: &[u8], name: &str, container: &str) {
    let log = plain(bytes);
    assert_eq!(log.files[0].container.name(), container);
    let (_, positions) = joints(&log, name);
    assert_eq!(positions.len(), ROWS, "{:?}", log.losses);
    assert!(positions.iter().enumerate().all(|(row, own)| *own == q(row)));
}

#[test]
fn json_records_are_rows_in_each_layout() {
    let record = |row: usize| json!({"t": 0.01 * row as f64, "state": {"joint_positions": q(row)}});
    let records: Vec<_> = (0..ROWS).map(record).collect();
    let lines: String = records.iter().map(|record| format!("{record}\n")).collect();
    let columns = json!({
        "fps": 100,
        "joint_positions": (0..ROWS).map(q).collect::<Vec<_>>(),
        "note": "by hand"
    });
    let name = "state.joint_positions";
    for (document, name) in [
        (lines, name),
        (json!(records).to_string(), name),
        (json!({"robot": "ur5e", "frames": records}).to_string(), name),
        (columns.to_string(), "joint_positions"),
    ] {
        assert_has_joints(document.as_bytes(), name, "json");
    }
}

#[test]
fn a_cut_line_of_json_is_a_loss() {
    let line = |row: usize| json!({"t": 0.01 * row as f64, "joint_positions": q(row)}).to_string();
    let mut lines: String = (0..ROWS).map(|row| line(row) + "\n").collect();
    lines += &line(ROWS)[..20];
    let log = plain(lines.as_bytes());
    assert_eq!(joints(&log, "joint_positions").1.len(), ROWS);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert!(loss.what.contains("line 41 is not a JSON record"), "{}", loss.what);
}

#[test]
fn json_documents_one_after_another_are_rows_of_one_table() {
    let record = |row: usize| json!({"t": 0.01 * row as f64, "joint_positions": q(row)});
    let pretty =
        |document: &serde_json::Value| serde_json::to_string_pretty(document).expect("JSON");
    let one_each: String = (0..ROWS).map(|row| pretty(&record(row))).collect();
    let half = |from: usize| json!((from..from + ROWS / 2).map(record).collect::<Vec<_>>());
    let lists = format!("{}\n{}", pretty(&half(0)), pretty(&half(ROWS / 2)));
    for document in [&one_each, &lists] {
        assert_has_joints(document.as_bytes(), "joint_positions", "json");
    }
    let cut = one_each + "{\n  \"t\": 0.";
    let log = plain(cut.as_bytes());
    assert_eq!(joints(&log, "joint_positions").1.len(), ROWS);
    assert!(log.losses[0].what.contains("after 40 JSON documents"), "{:?}", log.losses);
}

#[test]
fn documents_with_one_numbered_key_are_records() {
    let record = |row: usize| {
        let name = format!("Timestep {row}");
        json!({name: {"t": 0.01 * row as f64, "obs": {"joint_positions": q(row)}}})
    };
    let lines: String = (0..ROWS).map(|row| format!("{}\n", record(row))).collect();
    let pretty = |row| serde_json::to_string_pretty(&record(row)).expect("JSON");
    let documents: String = (0..ROWS).map(pretty).collect();
    for text in [lines, documents] {
        assert_has_joints(text.as_bytes(), "obs.joint_positions", "json");
    }
    // One key for all rows is the name of the arm.
    let of_arm = |row: usize| json!({"arm_1": {"t": 0.01 * row as f64, "joint_positions": q(row)}});
    let lines: String = (0..ROWS).map(|row| format!("{}\n", of_arm(row))).collect();
    assert_has_joints(lines.as_bytes(), "arm_1.joint_positions", "json");
}

#[test]
fn one_sample_with_matrices_is_one_row() {
    let sample = json!({
        "joint_pose": q(0),
        "camera_matrix": [[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]],
        "tvec": [[0.1], [0.2], [0.3]],
        "corners_px": (0..12).map(|at| [at, at + 1]).collect::<Vec<_>>()
    });
    let error = read(sample.to_string().as_bytes(), ColumnSettings::default());
    let line = error.expect_err("refused").to_string();
    assert!(line.contains("it has only one row"), "{line}");
}

#[test]
fn positions_with_as_many_velocities_are_joints() {
    let record = |row: usize, width: usize| {
        let (positions, velocities) = (&q(row)[..width], vec![0.1 * row as f64; width]);
        json!({"time": 0.01 * row as f64, "positions": positions, "velocities": velocities})
            .to_string()
            + "\n"
    };
    let log = plain((0..ROWS).map(|row| record(row, 6)).collect::<String>().as_bytes());
    let Some(Columns::Joints(own)) = &topic(&log, "positions").columns else { panic!() };
    assert_eq!((own.joints.len(), own.joints[2].velocity[10]), (6, 1.0));
    // Of a point, they are not.
    let log = plain((0..ROWS).map(|row| record(row, 3)).collect::<String>().as_bytes());
    assert!(!matches!(topic(&log, "positions").columns, Some(Columns::Joints(_))));
}

#[test]
fn consecutive_numbers_as_keys_are_rows() {
    let numbered = |row: &dyn Fn(usize) -> serde_json::Value| -> serde_json::Value {
        let rows = (1..=ROWS).map(|number| (number.to_string(), row(number - 1)));
        serde_json::Value::Object(rows.collect())
    };
    let times = numbered(&|row| json!(0.01 * row as f64));
    let joints = numbered(&|row| json!(q(row)));
    let text = json!({"robot": "arm", "time": &times, "joint_positions": joints}).to_string();
    assert_has_joints(text.as_bytes(), "joint_positions", "json");
    // As pandas writes a table.
    let columns =
        (0..6).map(|joint| (format!("q{}", joint + 1), numbered(&|row| json!(q(row)[joint]))));
    let columns = columns.chain([("time".to_owned(), times)]);
    let text = serde_json::Value::Object(columns.collect()).to_string();
    assert_has_joints(text.as_bytes(), "q", "json");
    // Rows that are numbered alike have numbered columns.
    let record = |row: usize| {
        let numbers = std::iter::once(0.01 * row as f64).chain(q(3 * row));
        let columns = (0..).zip(numbers).map(|(at, it): (usize, f64)| (at.to_string(), json!(it)));
        (format!("row{row}"), serde_json::Value::Object(columns.collect()))
    };
    let text = serde_json::Value::Object((0..ROWS).map(record).collect()).to_string();
    assert_eq!(plain(text.as_bytes()).tables[0].numbers.len(), 7);
}

#[test]
fn stamps_of_messages_keep_every_nanosecond() {
    let line = |row: usize| {
        let stamp = json!({"sec": 1_700_000_000, "nanosec": 123_456_789 + row});
        json!({"header": {"stamp": stamp}, "joint_positions": q(row)}).to_string() + "\n"
    };
    let log = plain((0..ROWS).map(line).collect::<String>().as_bytes());
    let Some(Columns::Joints(joints)) = &topic(&log, "joint_positions").columns else { panic!() };
    assert_eq!(joints.times.header[1], 1_700_000_000_123_456_790);
    let line = |row: usize| {
        json!({"stamp": 1_700_000_000_123_456_789_u64 + 1_000_000 * row as u64, "joint_positions": q(row)})
            .to_string()
            + "\n"
    };
    let log = plain((0..ROWS).map(line).collect::<String>().as_bytes());
    let Some(Columns::Joints(joints)) = &topic(&log, "joint_positions").columns else { panic!() };
    assert_eq!(joints.times.header[1], 1_700_000_000_124_456_789);
}

#[test]
fn yaml_is_a_list_a_record_for_each_key_or_several_records() {
    let numbers = |row: usize| q(row).iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
    let list: String = (0..ROWS)
        .map(|row| {
            format!("- time: {}\n  joint_positions: [{}]\n", 0.01 * row as f64, numbers(row))
        })
        .collect();
    let in_brackets: String = (0..ROWS)
        .map(|row| {
            format!("- {{time: {}, joint_positions: [{}]}}\n", 0.01 * row as f64, numbers(row))
        })
        .collect();
    let by_key: String = (0..ROWS)
        .map(|row| {
            format!(
                "'{}':\n  images: []\n  joint_positions: [{}]\n",
                1_593_701_755 + row,
                numbers(row)
            )
        })
        .collect();
    let documents: String = (0..ROWS)
        .map(|row| {
            format!(
                "header:\n  stamp:\n    secs: 17\n    nsecs: {}\njoint_positions: [{}]\n---\n",
                10_000_000 * (row + 1),
                numbers(row)
            )
        })
        .collect();
    let repeated_keys: String = (0..ROWS)
        .map(|row| format!("time: {}\njoint_positions: [{}]\n\n", 0.01 * row as f64, numbers(row)))
        .collect();
    for text in [list, in_brackets, by_key, documents, repeated_keys] {
        assert_has_joints(text.as_bytes(), "joint_positions", "yaml");
    }
}

#[test]
fn nested_lists_of_the_same_records_are_one_table() {
    let numbers = |row: usize| q(row).iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
    let record = |row: usize| {
        format!(
            "      - time: {}\n        joint_positions: [{}]\n",
            0.01 * row as f64,
            numbers(row).replacen(", ", ",\n          ", 2)
        )
    };
    let list = |name: &str, rows: std::ops::Range<usize>| {
        format!("    {name}:\n{}", rows.map(record).collect::<String>())
    };
    let yaml = format!(
        "names: [a, b,\n  c]\nheights:\n  1.98:\n{}{}  2.48:\n    other:\n      - id: 1\n{}",
        list("near", 0..15),
        list("far", 15..20),
        list("near", 20..ROWS)
    );
    assert_has_joints(yaml.as_bytes(), "joint_positions", "yaml");
}

#[test]
fn lists_in_text_tables_are_columns() {
    let row = |row: usize| format!("{},\"{:?}\",on\n", 0.01 * row as f64, q(row));
    let text =
        "timestamp,joint_positions,mode\n".to_owned() + &(0..ROWS).map(row).collect::<String>();
    assert_has_joints(text.as_bytes(), "joint_positions", "csv");
}

#[test]
fn files_that_cannot_be_read_say_how_to_export_them() {
    let line =
        |bytes: &[u8]| read(bytes, ColumnSettings::default()).expect_err("refused").to_string();
    let pickle = line(b"\x80\x04\x95\x10\x00\x00\x00\x00\x00\x00\x00}\x94.");
    assert!(pickle.contains("Python pickle") && pickle.contains("numpy.savez"), "{pickle}");
    let broken = line(b"{\"t\": [1, 2\n");
    assert!(broken.contains("the JSON cannot be read: EOF"), "{broken}");
    let settings = line(b"robot: ur5e\nrate: 30\n");
    assert!(settings.contains("has only one row"), "{settings}");
}

#[test]
fn matlab_puts_its_own_header_before_hdf5() {
    let mut file = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".to_vec();
    file.resize(512, 0);
    file.extend(super::CHUNKED);
    let name = "observation/joint_positions";
    assert_eq!(joints(&plain(&file), name), joints(&plain(super::CHUNKED), name));
}

#[test]
fn aliases_in_yaml_do_not_multiply_its_size() {
    let mut text = "a: &a [1, 2, 3, 4, 5, 6, 7, 8]\n".to_owned();
    for (name, of) in ["b", "c", "d", "e", "f", "g", "h"].iter().zip("abcdefg".chars()) {
        let all: Vec<String> = (0..9).map(|_| format!("*{of}")).collect();
        text += &format!("{name}: &{name} [{}]\n", all.join(", "));
    }
    let line = read(text.as_bytes(), ColumnSettings::default()).expect_err("refused").to_string();
    assert!(line.contains("the YAML cannot be read"), "{line}");
}

#[test]
fn a_first_record_without_times_describes_the_others() {
    let rows: String = (0..ROWS)
        .map(|row| json!({"t": 0.01 * row as f64, "joint_positions": q(row)}).to_string() + "\n")
        .collect();
    let meta = json!({"meta": {"robot": "ur5e", "fps": 100}}).to_string() + "\n";
    let log = plain((meta.clone() + &rows).as_bytes());
    assert_eq!(joints(&log, "joint_positions").1.len(), ROWS);
    assert!(log.losses.is_empty(), "{:?}", log.losses);
    let why = topic(&log, "meta.fps").read_as.as_deref().unwrap_or_default();
    assert!(why.contains("only in the first record"), "{why}");
    // Its rate stamps records without times.
    let without: String =
        (0..ROWS).map(|row| json!({"joint_positions": q(row)}).to_string() + "\n").collect();
    let log = plain((meta + &without).as_bytes());
    assert!(
        log.notes.iter().any(|note| note.what.contains("100 rows per second")),
        "{:?}",
        log.notes
    );
}

#[test]
fn lists_of_names_name_the_joints_beside_them() {
    let names = ["gripper", "wrist_roll", "wrist_flex", "elbow_flex", "lift", "pan"];
    for (list, values, expected) in [
        ("joint_names", "joint_values", names.map(str::to_owned)),
        ("joint_names", "q", names.map(str::to_owned)),
        ("names", "positions", names.map(str::to_owned)),
        // Of others.
        ("other_names", "q", [1, 2, 3, 4, 5, 6].map(|at| format!("q{at}"))),
    ] {
        let record = |row: usize| {
            let numbers: Vec<f64> = (0..6).map(|at| 0.01 * row as f64 + 0.1 * at as f64).collect();
            format!(
                "{{\"time\":{},\"{list}\":{names:?},\"{values}\":{numbers:?}}}\n",
                0.1 * row as f64
            )
        };
        let log = plain((0..30).map(record).collect::<String>().as_bytes());
        assert_eq!(joints(&log, values).0, expected);
    }
}
