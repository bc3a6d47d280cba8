use std::fs;
use std::path::PathBuf;

use super::super::{Container, Extent, Log, LogError, ReadOptions, open};
use super::*;
use ground::stream::ArrayColumns;

fn names(vectors: &[(&str, usize)], delimiter: &str) -> String {
    let mut names = vec![TIMESTAMP.to_owned()];
    for (name, width) in vectors {
        names.extend((0..*width).map(|part| format!("{name}_{part}")));
    }
    names.join(delimiter)
}

fn row(seconds: f64, width: usize, delimiter: &str) -> String {
    let numbers: Vec<String> =
        (0..=width).map(|part| format!("{:.4}", seconds + part as f64 * 0.25)).collect();
    numbers.join(delimiter)
}

/// Joint positions and a pose, every 0.008 s.
fn table(delimiter: &str, line_end: &str, rows: usize) -> String {
    let mut text = names(&[("actual_q", 6), ("actual_TCP_pose", 6)], delimiter) + line_end;
    for n in 0..rows {
        text += &row(100.0 + n as f64 * 0.008, 12, delimiter);
        text += line_end;
    }
    text
}

fn read_tables(tables: &[&[u8]]) -> Result<Log, LogError> {
    let folder = tempfile::tempdir().unwrap();
    let path = |n: usize| folder.path().join(format!("{n}.mcap"));
    let paths: Vec<PathBuf> = (0..tables.len()).map(path).collect();
    for (path, table) in paths.iter().zip(tables) {
        fs::write(path, table).unwrap();
    }
    open(&paths, &ReadOptions::default())
}

fn read(table: &str) -> Log {
    read_tables(&[table.as_bytes()]).unwrap()
}

#[test]
fn a_line_without_an_end_is_bounded() {
    let text = table(",", "\n", 50);
    for (rest, extent, what) in [
        (vec![b'1'; 5 << 20], Extent::Messages, "line 52 has more than 1048576 bytes"),
        (vec![0; 5 << 20], Extent::Tail, "the file ends in zeros"),
    ] {
        let log = read_tables(&[&[text.as_bytes(), &rest].concat()]).unwrap();
        assert_eq!(joints(&log, "actual_q").times.log.len(), 50);
        let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
        assert_eq!((loss.extent, loss.offset), (extent, Some(text.len() as u64)));
        assert!(loss.what.starts_with(what), "{}", loss.what);
    }
}

fn joints<'a>(log: &'a Log, topic: &str) -> &'a JointColumns {
    match log.topics.iter().find(|found| found.name == topic).map(|found| &found.columns) {
        Some(Some(Columns::Joints(joints))) => joints,
        other => panic!("{topic}: {other:?}"),
    }
}

fn array<'a>(log: &'a Log, topic: &str) -> &'a ArrayColumns {
    match log.topics.iter().find(|found| found.name == topic).map(|found| &found.columns) {
        Some(Some(Columns::Array(array))) => array,
        other => panic!("{topic}: {other:?}"),
    }
}

#[test]
fn every_csv_dialect_gives_the_same_columns() {
    let plain = read(&table(" ", "\n", 20));
    assert_eq!(plain.losses, []);
    assert_eq!(plain.files[0].container, Container::RtdeCsv);
    let found = joints(&plain, "actual_q");
    assert_eq!(found.joints[5].name, "wrist_3_joint");
    assert_eq!(found.joints[0].position[1], 100.258);
    assert_eq!(found.times.header[1], 100_008_000_000);
    let pose = array(&plain, "actual_TCP_pose");
    assert_eq!((pose.width, pose.times.len()), (6, 20));
    assert_eq!(pose.row(0), [101.75, 102.0, 102.25, 102.5, 102.75, 103.0]);
    let quoted =
        table(",", "\n", 20).replace("timestamp,actual_q_0", "\"timestamp\",\"actual_q_0\"");
    for spelled in [
        table(",", "\r\n", 20),
        table("\t", "\r", 20),
        table(", ", "\n", 20),
        table(";", "\n", 20).replace('.', ","),
        format!("\u{feff}{}", table(",", "\n", 20)),
        quoted,
    ] {
        let log = read(&spelled);
        assert_eq!(log.losses, [], "{spelled}");
        // NaN velocities differ from themselves.
        assert_eq!(format!("{:?}", log.topics), format!("{:?}", plain.topics), "{spelled}");
    }
}

#[test]
fn tables_with_different_columns_are_merged() {
    let mut velocities = names(&[("actual_qd", 6), ("joint_temperatures", 6)], ",") + "\n";
    for n in 0..10 {
        velocities += &(row(100.0 + f64::from(n) * 0.016, 12, ",") + "\n");
    }
    let positions = table(",", "\n", 20);
    let log = read_tables(&[positions.as_bytes(), velocities.as_bytes()]).unwrap();
    assert_eq!(log.losses, []);
    assert_eq!(log.notes, []);
    let velocity = &joints(&log, "actual_q").joints[0].velocity;
    assert_eq!(velocity[2], 100.266);
    assert!(velocity[1].is_nan());
    let listed = log.topics.iter().find(|topic| topic.name == "joint_temperatures").unwrap();
    assert_eq!((listed.messages, &listed.columns), (10, &None));
    assert!(log.topics.iter().all(crate::Topic::is_from_table));
    let turned = read_tables(&[velocities.as_bytes(), positions.as_bytes()]).unwrap();
    let same = joints(&turned, "actual_q").joints[0].velocity.iter().zip(velocity.iter());
    assert!(same.into_iter().all(|(a, b)| a.to_bits() == b.to_bits()));
}

#[test]
fn a_later_table_with_the_same_columns_continues_the_first() {
    let (first, second) = (table(",", "\n", 200), table(",", "\n", 200).replace(",\n", "\n"));
    let later = second.lines().skip(1).map(|line| line.replacen("10", "20", 1) + "\n");
    let later =
        names(&[("actual_q", 6), ("actual_TCP_pose", 6)], ",") + "\n" + &later.collect::<String>();
    let log = read_tables(&[first.as_bytes(), later.as_bytes()]).unwrap();
    assert_eq!(log.notes, []);
    assert_eq!(joints(&log, "actual_q").times.len(), 400);
    let overlapping = second.replace("100.0000,", "100.0001,");
    let log = read_tables(&[first.as_bytes(), overlapping.as_bytes()]).unwrap();
    let [note] = log.notes.as_slice() else { panic!("{:?}", log.notes) };
    assert!(note.what.starts_with("1.6 s of `actual_q` are also in "), "{}", note.what);
}

#[test]
fn malformed_rows_are_reported_with_their_line() {
    let text = table(",", "\n", 10);
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    lines[3] = lines[3].replacen("100.0160", "soon", 1);
    lines[5] = lines[5].rsplit_once(',').unwrap().0.to_owned();
    lines[7] = lines[7].replacen("100.2980", "nan", 1);
    let log = read(&(lines.join("\n") + "\n"));
    let whats: Vec<&str> = log.losses.iter().map(|loss| loss.what.as_str()).collect();
    let expected = [
        "line 4: column 1: `soon` is not a number",
        "line 6: 12 columns, but the first line names 13",
    ];
    assert_eq!(whats, expected);
    assert!(log.losses.iter().all(|loss| loss.messages == Some(2)));
    assert_eq!(joints(&log, "actual_q").times.len(), 8);
    assert_eq!(joints(&log, "actual_q").not_finite, 1);
    assert!(joints(&log, "actual_q").joints[0].position[4].is_nan());
}

#[test]
fn decimal_commas_in_comma_separated_files_are_explained() {
    let header = names(&[("actual_q", 6)], ",") + "\n";
    let text = header + "1,0,2,0,3,0,4,0,5,0,6,0,7,0\n";
    let error = read_tables(&[text.as_bytes()]).unwrap_err().to_string();
    assert!(error.contains("decimal commas need `;` between the columns"), "{error}");
}

#[test]
fn a_table_without_controller_time_is_read_as_csv() {
    let text = table(",", "\n", 10).replace("timestamp", "time");
    let log = read_tables(&[text.as_bytes()]).unwrap();
    assert_eq!(log.files[0].container, Container::Csv);
    assert_eq!(log.topics[0].name, "actual_q");
    let text = table(",", "\n", 10).replace("timestamp", "other");
    let error = read_tables(&[text.as_bytes()]).unwrap_err().to_string();
    assert!(error.contains("rows per second"), "{error}");
}

#[test]
fn seven_joints_are_no_universal_robot() {
    let text = table(",", "\n", 10).replace("actual_TCP_pose_0", "actual_q_6");
    let log = read_tables(&[text.as_bytes()]).unwrap();
    assert_eq!(log.files[0].container, Container::Csv);
}

#[test]
fn an_incomplete_vector_is_reported() {
    let text = table(",", "\n", 10).replace("actual_q_5", "other");
    let log = read(&text);
    let [note] = log.notes.as_slice() else { panic!("{:?}", log.notes) };
    assert!(note.what.contains("5 of the 6 columns of `actual_q`"), "{}", note.what);
    assert_eq!(array(&log, "actual_TCP_pose").times.len(), 10);
}

#[test]
fn no_truncation_gives_a_wrong_number() {
    let whole = table(" ", "\n", 5);
    let sound = read(&whole);
    let sound = &array(&sound, "actual_TCP_pose").values;
    let header = whole.find('\n').unwrap();
    for length in header..whole.len() {
        let cut = read_tables(&[&whole.as_bytes()[..length]]);
        if let Ok(log) = cut {
            let values = &array(&log, "actual_TCP_pose").values;
            assert_eq!(values[..], sound[..values.len()], "cut at {length}");
            assert!(log.losses.iter().all(|loss| loss.extent == Extent::Tail));
            let complete = whole[..length].matches('\n').count() - 1;
            assert_eq!(values.len(), complete * 6, "cut at {length}");
        }
    }
}

#[test]
fn every_flipped_byte_is_survived() {
    let whole = table(",", "\n", 3).into_bytes();
    for index in 0..whole.len() {
        for flip in [0xff, 0x01] {
            let mut bytes = whole.clone();
            bytes[index] ^= flip;
            if let Ok(log) = read_tables(&[&bytes]) {
                assert!(log.messages <= 20 * 3, "byte {index}");
            }
        }
    }
}
