//! Tables with odd numbers, missing rows and damage for the whole audits, and the check that each row that was
//! written is audited or reported.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

use polars::prelude::{Column, DataFrame, ParquetWriter};
use poseaudit::report::{Report, Verdict};
use poseaudit::robot::catalogue;
use serde_json::{Value, json};

use self::containers::{tfrecord_frame, zip_archive};
use self::hdf5_writer::{DataSet, hdf5};
use super::{ChoiceSource, EXTREME_NUMBERS, select_rows};

#[allow(clippy::duplicate_mod, reason = "the tests also load it with feed.rs")]
#[path = "containers.rs"]
mod containers;
#[path = "../src/log/tables/tests/hdf5_writer.rs"]
mod hdf5_writer;

/// Rows a second.
const RATE_HZ: f64 = 50.0;
/// Names of the joint positions and of the poses, as topics.
const JOINTS: &[&str] = &["q", "joint_positions"];
const POSES: &[&str] = &["pose", "tcp_pose"];
/// Times of rows, s.
const EXTREME_TIMES_S: [f64; 7] = [f64::NAN, 0.0, -1.0, 1e9, 1e308, f64::INFINITY, 3.0];

/// One row: its time, six joint positions and a pose.
#[derive(Clone)]
struct Row {
    time_s: f64,
    joints: Vec<f64>,
    pose: Vec<f64>,
}

impl Row {
    /// Whether the row holds a number in these cells.
    fn has_numbers(&self, cells: impl Fn(&Self) -> &Vec<f64>) -> bool {
        cells(self).iter().any(|value| value.is_finite())
    }
}

/// What was written of each topic.
#[derive(Debug)]
pub struct WrittenRows {
    joints: u64,
    poses: u64,
    /// Whether the bytes of the file were damaged, so that names and numbers may be others.
    is_damaged: bool,
}

/// Writes a table at `path`.
pub fn write(draw: &mut ChoiceSource, path: &Path) -> WrittenRows {
    let mut rows = draw_rows(draw);
    for _ in 0..draw.below(5) {
        edit(draw, &mut rows);
    }
    let count = |cells: fn(&Row) -> &Vec<f64>| {
        rows.iter().filter(|row| row.has_numbers(cells)).count() as u64
    };
    let mut written = WrittenRows {
        joints: count(|row| &row.joints),
        poses: count(|row| &row.pose),
        is_damaged: false,
    };
    let mut content = match draw.below(7) {
        0 => text_table(draw, &rows, ","),
        1 => text_table(draw, &rows, "\t"),
        2 => npz_archive(&rows),
        3 => hdf5_file(draw, &rows, &mut written),
        4 => tfrecord_steps(&rows),
        5 => parquet_file(&rows),
        _ => {
            write_zarr(draw, &rows, path);
            return written;
        }
    };
    let at = draw.index_below(content.len());
    match draw.below(6) {
        4 => {
            content.truncate(at);
            written.is_damaged = true;
        }
        5 => {
            let end = (at + 1 + draw.below(16)).min(content.len());
            content.get_mut(at..end).into_iter().flatten().for_each(|byte| *byte ^= 0x55);
            written.is_damaged = true;
        }
        _ => {}
    }
    fs::write(path, content).expect("a file");
    written
}

/// Rows of a UR5e that moves all its joints.
fn draw_rows(draw: &mut ChoiceSource) -> Vec<Row> {
    let robot = catalogue::find("ur5e").expect("a UR5e");
    let link = |name: &str| robot.link(name).expect("a link");
    let chain = robot.chain(link("base_link"), link("tool0")).expect("a chain");
    let from_s = draw.choose(&[0.0, 1.7e9, 5.0]);
    let row = |row: usize| {
        let elapsed_s = row as f64 / RATE_HZ;
        let joints: Vec<f64> = (0..6)
            .map(|joint| {
                let rate = TAU * (0.11 + 0.05 * joint as f64);
                0.2 * joint as f64 - 0.9 + 0.6 * (rate * elapsed_s + joint as f64).sin()
            })
            .collect();
        let pose = chain.forward(&joints);
        let (at, turn) = (pose.translation, pose.rotation);
        let pose = vec![at.x, at.y, at.z, turn.i, turn.j, turn.k, turn.w];
        Row { time_s: from_s + elapsed_s, joints, pose }
    };
    (0..100 + 50 * draw.below(5)).map(row).collect()
}

/// Changes some of the rows.
fn edit(draw: &mut ChoiceSource, rows: &mut Vec<Row>) {
    let all: Vec<usize> = (0..rows.len()).collect();
    let chosen = select_rows(draw, &all);
    match draw.below(8) {
        0..3 => {
            let (at, value, is_whole) =
                (draw.below(13), draw.choose(&EXTREME_NUMBERS), draw.below(4) == 3);
            for row in chosen {
                let Row { joints, pose, .. } = &mut rows[row];
                let cells = if at < 6 { joints } else { pose };
                match is_whole {
                    true => cells.fill(value),
                    false => cells[if at < 6 { at } else { at - 6 }] = value,
                }
            }
        }
        3 => {
            let time_s = draw.choose(&EXTREME_TIMES_S);
            chosen.into_iter().for_each(|row| rows[row].time_s = time_s);
        }
        4 => {
            let by_s = draw.choose(&[1e-3, -0.5, 10.0, -100.0]);
            chosen.into_iter().for_each(|row| rows[row].time_s += by_s);
        }
        5 => {
            let mut row = 0..;
            rows.retain(|_| !chosen.contains(&row.next().unwrap_or(0)));
        }
        6 => {
            let repeated: Vec<Row> = chosen.into_iter().map(|row| rows[row].clone()).collect();
            rows.extend(repeated);
        }
        _ => {
            let others: Vec<Row> = chosen.iter().rev().map(|&row| rows[row].clone()).collect();
            chosen.into_iter().zip(others).for_each(|(row, other)| rows[row] = other);
        }
    }
}

/// A table in text, with some lines changed.
fn text_table(draw: &mut ChoiceSource, rows: &[Row], delimiter: &str) -> Vec<u8> {
    let names = "timestamp q1 q2 q3 q4 q5 q6 x y z qx qy qz qw".replace(' ', delimiter);
    let row = |row: &Row| {
        let cells = [&[row.time_s][..], &row.joints, &row.pose].concat();
        let shown =
            |value: &f64| if value.is_nan() { String::new() } else { format!("{value:.9}") };
        cells.iter().map(shown).collect::<Vec<_>>().join(delimiter)
    };
    let mut lines: Vec<String> = rows.iter().map(row).collect();
    if !lines.is_empty() {
        for _ in 0..draw.below(3) {
            let line = draw.index_below(lines.len());
            let own = &mut lines[line];
            match draw.below(6) {
                0 => *own += delimiter,
                1 => *own += &format!("\n # stopped{delimiter}by hand"),
                2 => *own += &format!("\n{names}"),
                3 => *own = own.replacen('.', "x", 1),
                4 => own.truncate(own.len() / 2),
                _ => *own = vec!["stop"; 14].join(delimiter),
            }
        }
    }
    format!("{names}\n{}\n", lines.join("\n")).into_bytes()
}

/// Arrays by their names: the width, and the numbers of all rows.
fn arrays(rows: &[Row]) -> [(&'static str, usize, Vec<f64>); 3] {
    [
        ("timestamp", 1, rows.iter().map(|row| row.time_s).collect()),
        ("joint_positions", 6, rows.iter().flat_map(|row| row.joints.clone()).collect()),
        ("tcp_pose", 7, rows.iter().flat_map(|row| row.pose.clone()).collect()),
    ]
}

fn le_bytes(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// An archive of NumPy.
fn npz_archive(rows: &[Row]) -> Vec<u8> {
    let files = arrays(rows).map(|(name, width, values)| {
        let header = format!(
            "{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, {width}), }}\n",
            rows.len()
        );
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(le_bytes(&values));
        (format!("{name}.npy"), bytes)
    });
    let files: Vec<(&str, &[u8])> =
        files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
    zip_archive(&files)
}

/// Rows whose chunks are not written: some of those that are neither the first nor the last.
fn draw_missing_rows(draw: &mut ChoiceSource, rows: usize) -> Vec<bool> {
    let mut missing = vec![false; rows];
    if rows > 4 && draw.below(3) == 2 {
        let inner: Vec<usize> = (2..rows - 2).collect();
        select_rows(draw, &inner).into_iter().for_each(|row| missing[row] = true);
    }
    missing
}

fn hdf5_file(draw: &mut ChoiceSource, rows: &[Row], written: &mut WrittenRows) -> Vec<u8> {
    let missing = draw_missing_rows(draw, rows.len());
    let is_chunked = draw.flag();
    // Contiguous numbers have no missing chunks. Numbers that are missing everywhere were never there.
    if rows.is_empty() || missing.iter().all(|missing| *missing) {
        written.is_damaged = true;
    }
    let sets = arrays(rows).map(|(name, width, values)| (name, width, values));
    let sets: Vec<DataSet<'_>> = sets
        .into_iter()
        .map(|(name, width, values)| DataSet {
            name,
            width,
            values,
            is_chunked: is_chunked && width == 6,
            missing: &missing,
        })
        .collect();
    hdf5(&sets, &[])
}

/// A folder of Zarr with a chunk for each row of joint positions.
fn write_zarr(draw: &mut ChoiceSource, rows: &[Row], path: &Path) {
    let missing = draw_missing_rows(draw, rows.len());
    fs::create_dir_all(path).expect("a folder");
    fs::write(path.join(".zgroup"), r#"{"zarr_format": 2}"#).expect("a file");
    for (name, width, values) in arrays(rows) {
        let folder = path.join(name);
        fs::create_dir_all(&folder).expect("a folder");
        let deep = if width == 6 { 1 } else { rows.len().max(1) };
        let metadata = json!({"zarr_format": 2, "shape": [rows.len(), width], "chunks": [deep, width],
            "dtype": "<f8", "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"});
        fs::write(folder.join(".zarray"), metadata.to_string()).expect("a file");
        for (number, chunk) in values.chunks(deep * width).enumerate() {
            if width == 6 && missing[number] {
                continue;
            }
            fs::write(folder.join(format!("{number}.0")), le_bytes(chunk)).expect("a file");
        }
    }
}

/// Records of a step each, as TensorFlow writes them.
fn tfrecord_steps(rows: &[Row]) -> Vec<u8> {
    let field = |number: u8, content: &[u8]| -> Vec<u8> {
        let mut all = vec![number << 3 | 2];
        let mut length = content.len();
        while length > 127 {
            all.push((length & 127) as u8 | 128);
            length >>= 7;
        }
        all.push(length as u8);
        all.extend(content);
        all
    };
    let feature = |name: &str, values: &[f64]| {
        let packed: Vec<u8> =
            values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect();
        let list = field(2, &field(2, &field(1, &packed)));
        field(1, &[field(1, name.as_bytes()), list].concat())
    };
    let record = |row: &Row| {
        // Times since 1970 have no digits left as f32.
        let time_s = if row.time_s > 1e9 { row.time_s - 1.7e9 } else { row.time_s };
        let features = [
            feature("timestamp", &[time_s]),
            feature("joint_positions", &row.joints),
            feature("tcp_pose", &row.pose),
        ];
        tfrecord_frame(&field(1, &features.concat()))
    };
    rows.iter().flat_map(record).collect()
}

/// A file of Parquet with a column for each number.
fn parquet_file(rows: &[Row]) -> Vec<u8> {
    let mut columns: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut put = |name: &str, value: f64| columns.entry(name.to_owned()).or_default().push(value);
    for row in rows {
        put("timestamp", row.time_s);
        row.joints.iter().enumerate().for_each(|(at, value)| put(&format!("q{}", at + 1), *value));
        let names = ["x", "y", "z", "qx", "qy", "qz", "qw"];
        names.iter().zip(&row.pose).for_each(|(name, value)| put(name, *value));
    }
    let columns = columns.into_iter().map(|(name, values)| Column::new(name.into(), values));
    let mut frame = DataFrame::new(rows.len(), columns.collect()).expect("a frame");
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes).finish(&mut frame).expect("a file");
    bytes
}

/// Asserts that each row that was written is audited or reported as lost.
pub fn assert_rows_are_reported(written: &WrittenRows, report: &Report) {
    if report.error.is_some() {
        return;
    }
    let losses = report.findings.iter().filter(|found| found.code == "ING001");
    let lost: Vec<Option<u64>> = losses
        .map(|found| found.evidence.more.get("messages_lost").and_then(Value::as_u64))
        .collect();
    // Damage may take what nothing counts.
    let has_uncounted_loss = lost.iter().any(Option::is_none);
    let lost: u64 = lost.into_iter().flatten().sum();
    for (names, rows) in [(JOINTS, written.joints), (POSES, written.poses)] {
        let own = report.streams.iter().filter(|stream| names.contains(&stream.topic.as_str()));
        let read: u64 = own.map(|stream| stream.count).sum();
        let missing = rows.saturating_sub(read);
        if missing == 0 || has_uncounted_loss {
            continue;
        }
        assert!(
            written.is_damaged || missing <= lost,
            "{rows} rows of {names:?} were written, {read} read, {lost} reported"
        );
        let is_unreported = report.verdict == Verdict::Pass && report.findings.is_empty();
        assert!(!is_unreported, "it passes without {missing} of {rows} rows of {names:?}");
    }
}
