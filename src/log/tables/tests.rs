//! Tables as their writers make them: valid, truncated, and with wrong declarations.

mod episodes;
mod file_sets;
mod hdf5_writer;
mod layouts;
mod limits;
mod rates;
mod records;
pub(crate) mod stores;
mod trajectories;

use std::fs;
use std::path::Path;
use std::sync::Arc;

use ::parquet::basic::Compression;
use ::parquet::data_type::{DoubleType, FloatType, Int64Type};
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;

use crate::losses::Losses;
use crate::memory_budget::MemoryBudget;
use crate::{ColumnSettings, Log, LogError, ReadOptions, Topic, open};
use ground::stream::Columns;
use ground::time::NANOS_PER_SECOND;

pub(crate) const CHUNKED: &[u8] = include_bytes!("fixtures/chunked_latest.h5");
const EPISODES: &[u8] = include_bytes!("fixtures/episodes_earliest.h5");

/// The file has a neutral name.
fn read(bytes: &[u8], columns: ColumnSettings) -> Result<Log, LogError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("table");
    fs::write(&path, bytes).expect("a file");
    open(&[path], &ReadOptions { columns, ..ReadOptions::default() })
}

fn plain(bytes: &[u8]) -> Log {
    read(bytes, ColumnSettings::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn refusal(bytes: &[u8]) -> String {
    let line = read(bytes, ColumnSettings::default()).expect_err("refused").to_string();
    assert!(!line.contains('\n'), "{line}");
    line
}

fn topic<'a>(log: &'a Log, name: &str) -> &'a Topic {
    let names: Vec<&str> = log.topics.iter().map(|topic| topic.name.as_str()).collect();
    log.topics
        .iter()
        .find(|topic| topic.name == name)
        .unwrap_or_else(|| panic!("{name} of {names:?}"))
}

/// Names, and positions by row.
fn joints(log: &Log, name: &str) -> (Vec<String>, Vec<Vec<f64>>) {
    let Some(Columns::Joints(joints)) = &topic(log, name).columns else {
        panic!("no joints: {name}")
    };
    let rows = (0..joints.times.len())
        .map(|row| joints.joints.iter().map(|it| it.position[row]).collect());
    (joints.joints.iter().map(|joint| joint.name.clone()).collect(), rows.collect())
}

fn array(log: &Log, name: &str) -> (usize, Vec<f64>) {
    let Some(Columns::Array(array)) = &topic(log, name).columns else {
        panic!("no numbers: {name}")
    };
    (array.width, array.values.clone())
}

fn stamps(log: &Log, name: &str) -> Vec<i64> {
    topic(log, name).columns.as_ref().expect("columns").times()[0].header.clone()
}

pub(crate) fn npy(header: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

/// A time and six joints per row.
pub(crate) fn records(rows: usize) -> Vec<u8> {
    let header = format!(
        "{{'descr': [('t', '<f8'), ('q', '>f4', (6,))], 'fortran_order': False, 'shape': ({rows},), }}\n"
    );
    let mut data = Vec::new();
    for row in 0..rows {
        data.extend((0.01 * row as f64).to_le_bytes());
        (0..6).for_each(|joint| data.extend((0.01 * (row * joint) as f32).to_be_bytes()));
    }
    npy(&header, &data)
}

#[test]
fn records_of_numpy_are_joints_and_times() {
    let log = plain(&records(30));
    let (names, rows) = joints(&log, "q");
    assert_eq!(names, ["q1", "q2", "q3", "q4", "q5", "q6"]);
    assert_eq!(rows[4], [0, 4, 8, 12, 16, 20].map(|q| f64::from(0.01 * q as f32)));
    // A stamp of 0 means unset.
    assert_eq!(stamps(&log, "q")[..2], [1, 10_000_000]);
    assert!(topic(&log, "q").read_as.as_ref().is_some_and(|why| why.contains("by the name")));
}

/// Rows as `trajectory_recorder` for ROS writes them.
#[test]
fn whole_seconds_and_nanoseconds_are_one_stamp_and_headings_distinguish_equal_names() {
    const STAMPS: [&str; 6] = [
        "seconds,nseconds",
        "secs,nsecs",
        "sec,nanosec",
        "stamp_sec,stamp_nanosec",
        "header.stamp.secs,header.stamp.nsecs",
        "Sec,Nanoseconds",
    ];
    let joints_of = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint"];
    let row = |row: i64| {
        let ns = 990_000_000 + 4_000_001 * row;
        let (sec, ns) = (1_608_307_638 + ns / 1_000_000_000, ns % 1_000_000_000);
        format!("{sec},{ns},0.{row:02},1,2,3,4,5,6,7\n")
    };
    let rows: String = (0..20).map(row).collect();
    for stamp in STAMPS {
        let names = joints_of.join(",");
        let text = format!(
            "Recorded at,Fri Dec 18 17:07:18 2020\n\nTime Stamp,Time Stamp,Position,,,,Velocity,,,\n\
            {stamp},{names},{names}\n{rows}"
        );
        let log = plain(text.as_bytes());
        let (names, positions) = joints(&log, "Position");
        assert_eq!(
            (names, &positions[2]),
            (joints_of.map(str::to_owned).to_vec(), &vec![0.02, 1.0, 2.0, 3.0])
        );
        assert_eq!(stamps(&log, "Position")[3], 1_608_307_639_002_000_003, "{stamp}");
        let Some(Columns::Joints(read)) = &topic(&log, "Position").columns else { panic!() };
        assert_eq!(read.joints[1].velocity[4], 5.0);
    }
}

#[test]
fn the_columns_of_a_single_joint_are_its_state_and_its_command() {
    let row =
        |row: i32| format!("{},0.1{row:02},0.2{row:02},3,4,5,6,1,0.5\n", 0.002 * f64::from(row));
    let rows: String = (0..20).map(row).collect();
    let log = plain(
        format!("time,q_des,q_act,dq_des,dq_act,ddq_des,torque,stage,dq_step\n{rows}").as_bytes(),
    );
    for (name, position, velocity) in [("q_act", 0.202, 4.0), ("q_des", 0.102, 3.0)] {
        let Some(Columns::Joints(read)) = &topic(&log, name).columns else { panic!("{name}") };
        let [joint] = read.joints.as_slice() else { panic!("{name}") };
        assert_eq!((joint.position[2], joint.velocity[2]), (position, velocity), "{name}");
    }
    // Nothing else is known of the numbers of the second table.
    for names in ["time,q,a1,a2,a3,a4,a5,a6,a7", "time,q,b,c,d,e,f,g,h"] {
        let log = plain(format!("{names}\n{rows}").as_bytes());
        assert!(!log.topics.iter().any(|topic| topic.name == "q"
            && topic.columns.is_some()
            && matches!(topic.columns, Some(Columns::Joints(_)))));
    }
}

/// WorkVisual's trace of a drive.
#[test]
fn german_names_of_a_single_joint_are_its_state_and_its_command() {
    let names = [
        "Zeit[sec]",
        "Sollposition[°]",
        "Istposition[°]",
        "Positionsschleppfehler[°]",
        "Sollgeschwindigkeit[°/s]",
        "Istgeschwindigkeit[°/s]",
        "Geschwindigkeitsdifferenz[°/s]",
        "Sollbeschleunigung[°/s*s]",
        "Istbeschleunigung[°/s*s]",
        "Beschleunigungsdifferenz[°/s*s]",
    ];
    let text =
        csv(&names, 40, |row, at| if at == 0 { 0.004 * row as f64 } else { (row + at) as f64 });
    let log = plain(text.as_bytes());
    for (name, position, velocity) in [("ist_position", 2.0, 5.0), ("soll_position", 1.0, 4.0)] {
        let Some(Columns::Joints(read)) = &topic(&log, name).columns else { panic!("{name}") };
        let [joint] = read.joints.as_slice() else { panic!("{name}") };
        let logged = [position, velocity].map(f64::to_radians);
        assert_eq!([joint.position[0], joint.velocity[0]], logged, "{name}");
    }
}

#[test]
fn joints_of_hands_are_not_those_of_an_arm() {
    let parts = ["left", "right", "left_hand", "right_hand"];
    let names = parts.map(|part| {
        let count = if part.ends_with("hand") { 10 } else { 7 };
        (1..=count).map(|joint| format!("{part}.joint_{joint}.pos")).collect::<Vec<_>>()
    });
    let names = names.concat();
    let names: Vec<&str> =
        std::iter::once("time").chain(names.iter().map(String::as_str)).collect();
    let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
    let is_of_joints = |topic: &&Topic| matches!(topic.columns, Some(Columns::Joints(_)));
    let joints: Vec<&str> =
        log.topics.iter().filter(is_of_joints).map(|topic| topic.name.as_str()).collect();
    assert_eq!(joints.len(), 2, "{joints:?}");
}

#[test]
fn a_count_that_most_rows_repeat_is_not_a_clock() {
    let row = |row: usize| -> String {
        let sines: Vec<String> =
            (1..20).map(|k| format!("{:.4}", (k as f64 * row as f64 * 0.07).sin())).collect();
        format!("{},{}\n", 1 + row / 14, sines.join(","))
    };
    let error = refusal((0..400).map(row).collect::<String>().as_bytes());
    assert!(error.contains("no column holds times"), "{error}");
    // Nor is one that is named as a count of messages.
    let names = ["id", "q1", "q2", "q3", "q4"];
    let text =
        csv(&names, 40, |row, at| if at == 0 { 2.0 * row as f64 } else { (row + at) as f64 % 3.0 });
    assert!(refusal(text.as_bytes()).contains("no column holds times"));
}

/// Serial numbers of dates, as a spreadsheet stores them without a date format, and MATLAB's `datenum`.
#[test]
fn dates_in_days_are_seconds_since_1970() {
    for epoch in [25_569.0, 719_529.0] {
        let row = |row: i32| {
            let days = epoch + 19_000.5 + 0.01 * f64::from(row) / 86_400.0;
            format!("{days:.12},0,1,2,3,4,5\n")
        };
        let text: String = (0..50).map(row).collect();
        let log = plain(format!("timestamp,q1,q2,q3,q4,q5,q6\n{text}").as_bytes());
        let (own, noon) = (stamps(&log, "q"), (19_000 * 86_400 + 43_200) * NANOS_PER_SECOND);
        assert!((own[0] - noon).abs() < 20_000 && (own[49] - noon - 490_000_000).abs() < 20_000);
    }
}

#[test]
fn dates_in_text_are_in_seconds_whatever_their_name() {
    let row = |row: u32| {
        format!("2026-01-31 23:59:{:02}.{:03},0,0,0,0,0,{row}\n", row / 10, 100 * (row % 10))
    };
    let rows: String = (0..40).map(row).collect();
    let log = plain(("timestamp_ms,q1,q2,q3,q4,q5,q6\n".to_owned() + &rows).as_bytes());
    let own = stamps(&log, "q");
    assert_eq!((own[0], own[1] - own[0]), (1_769_903_940_000_000_000, 100_000_000));
}

#[test]
fn dates_in_digits_are_seconds_since_1970() {
    let row = |row: i32| format!("202601312359{:02},0.{row:02},1,2,3,4,5\n", 10 + row);
    let text: String = (0..50).map(row).collect();
    let log = plain(format!("timestamp,q1,q2,q3,q4,q5,q6\n{text}").as_bytes());
    let own = stamps(&log, "q");
    let first = 1_769_903_950 * NANOS_PER_SECOND;
    assert_eq!([own[0], own[49]], [first, first + 49 * NANOS_PER_SECOND]);
    // A count of nanoseconds of the same size is none.
    let row =
        |row: i64| format!("{},0.{row:02},1,2,3,4,5\n", 20_269_999_999_990 + 10_000_000 * row);
    let text: String = (0..50).map(row).collect();
    let log = plain(format!("time_ns,q1,q2,q3,q4,q5,q6\n{text}").as_bytes());
    let own = stamps(&log, "q");
    assert_eq!(own[49] - own[0], 490_000_000);
}

#[test]
fn units_in_names_may_differ_within_a_row() {
    let names = "t,J1 [deg],J2 [deg],J3 [rad],J4 [rad],x [mm],y [mm],z [m],qx,qy,qz,qw";
    let row = |row: i32| {
        format!("{},180,90,1.5,0.{row:02},500,250,0.75,0,0,0,1\n", 0.01 * f64::from(row))
    };
    let rows: String = (0..50).map(row).collect();
    let log = plain(format!("{names}\n{rows}").as_bytes());
    let (_, positions) = joints(&log, "j");
    let [first, second, third, _] = positions[0][..] else { panic!("{positions:?}") };
    assert!(
        (first - std::f64::consts::PI).abs() + (second - 0.5 * std::f64::consts::PI).abs() < 1e-12
    );
    assert_eq!(third, 1.5);
    assert_eq!(array(&log, "pose").1[..3], [0.5, 0.25, 0.75]);
}

#[test]
fn columns_first_and_rows_first_are_the_same_array() {
    let by_rows: Vec<u8> = (0..6).flat_map(|n| (n as f64).to_le_bytes()).collect();
    let by_columns: Vec<u8> =
        [0, 3, 1, 4, 2, 5].iter().flat_map(|n| f64::from(*n).to_le_bytes()).collect();
    let read = |order: &str, data: &[u8]| {
        let header = format!("{{'descr': '<f8', 'fortran_order': {order}, 'shape': (2, 3), }}\n");
        let (mut losses, mut memory) = (Losses::new(Path::new("a")), MemoryBudget::new(None));
        let mut context =
            super::ReadContext { losses: &mut losses, memory: &mut memory, times: Vec::new() };
        let read = super::npy::read_npy(&npy(&header, data), &mut context).expect("an array");
        read[0].1.columns[0].values.clone()
    };
    assert_eq!(read("False", &by_rows), read("True", &by_columns));
}

#[test]
fn a_truncated_array_is_reported_in_one_line() {
    let whole = records(30);
    for end in [4, 9, 40] {
        refusal(&whole[..end]);
    }
    let cut = plain(&whole[..whole.len() - 1]);
    assert_eq!((topic(&cut, "q").messages, cut.losses[0].messages), (29, Some(1)));
    let billion = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 7), }\n";
    assert!(
        refusal(&npy(billion, &[0; 80])).contains("rows 1 to 999999999 of 1000000000"),
        "{}",
        refusal(&npy(billion, &[0; 80]))
    );
    let objects = "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }\n";
    assert!(refusal(&npy(objects, &[0; 80])).contains("Python objects"));
    let empty = "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 7), }\n";
    refusal(&npy(empty, &[]));
}

/// Per row: a list of `widths` numbers, a time and an episode.
pub(crate) fn parquet(
    rows: usize,
    episodes: usize,
    compression: Compression,
    widths: impl Fn(usize) -> usize,
) -> Vec<u8> {
    let schema = "message rows {
        optional group observation.state (LIST) { repeated group list { optional float element; } }
        required double timestamp; required int64 episode_index; optional binary image; }";
    let schema = Arc::new(parse_message_type(schema).expect("a schema"));
    let properties = Arc::new(WriterProperties::builder().set_compression(compression).build());
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(&mut bytes, schema, properties).expect("a writer");
    for episode in 0..episodes {
        let mut group = file.next_row_group().expect("a group");
        let mut states = group.next_column().expect("a column").expect("another");
        let (mut values, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
        for row in 0..rows {
            for part in 0..widths(row) {
                // One number is missing.
                let is_there = (row, part) != (3, 2);
                values.extend(is_there.then_some((row * 10 + part) as f32));
                definitions.push(if is_there { 3 } else { 2 });
                repetitions.push(i16::from(part > 0));
            }
        }
        let written = states.typed::<FloatType>().write_batch(
            &values,
            Some(&definitions),
            Some(&repetitions),
        );
        written.expect("lists");
        states.close().expect("a column");
        let mut times = group.next_column().expect("a column").expect("another");
        let stamps: Vec<f64> = (0..rows).map(|row| row as f64 / 30.0).collect();
        times.typed::<DoubleType>().write_batch(&stamps, None, None).expect("times");
        times.close().expect("a column");
        let mut index = group.next_column().expect("a column").expect("another");
        index
            .typed::<Int64Type>()
            .write_batch(&vec![episode as i64; rows], None, None)
            .expect("episodes");
        index.close().expect("a column");
        let mut images = group.next_column().expect("a column").expect("another");
        images
            .typed::<::parquet::data_type::ByteArrayType>()
            .write_batch(&[], Some(&vec![0; rows]), None)
            .expect("none");
        images.close().expect("a column");
        group.close().expect("a group");
    }
    file.close().expect("a file");
    bytes
}

/// Per row: a time and a list `joint_positions`, null if lost.
fn lists_of_parquet(
    rows: usize,
    numbers: impl Fn(usize) -> Vec<f64>,
    is_lost: impl Fn(usize) -> bool,
) -> Vec<u8> {
    let schema = "message table { required double timestamp; optional group joint_positions (LIST) { \
                  repeated group list { optional double element; } } }";
    let schema = Arc::new(parse_message_type(schema).expect("a schema"));
    let mut bytes = Vec::new();
    let properties = Arc::new(WriterProperties::default());
    let mut file = SerializedFileWriter::new(&mut bytes, schema, properties).expect("a writer");
    let mut group = file.next_row_group().expect("a row group");
    let times: Vec<f64> = (0..rows).map(|row| 0.01 * row as f64).collect();
    let mut column = group.next_column().expect("no error").expect("a column");
    column.typed::<DoubleType>().write_batch(&times, None, None).expect("numbers");
    column.close().expect("a column");
    let (mut values, mut definitions, mut repetitions) = (Vec::new(), Vec::new(), Vec::new());
    for row in 0..rows {
        let own = if is_lost(row) { Vec::new() } else { numbers(row) };
        let levels = own.len().max(1);
        definitions.extend(std::iter::repeat_n(if own.is_empty() { 0 } else { 3 }, levels));
        repetitions.extend((0..levels).map(|at| i16::from(at > 0)));
        values.extend(own);
    }
    let mut column = group.next_column().expect("no error").expect("a column");
    let written = column.typed::<DoubleType>();
    written.write_batch(&values, Some(&definitions), Some(&repetitions)).expect("numbers");
    column.close().expect("a column");
    group.close().expect("a row group");
    file.close().expect("a file");
    bytes
}

#[test]
fn a_damaged_page_loses_only_its_rows() {
    let whole = parquet(3000, 1, Compression::ZSTD(Default::default()), |_| 7);
    let rows = topic(&plain(&whole), "observation.state").messages;
    let mut salvaged = 0;
    for at in (0..whole.len() - 2000).step_by(97) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x5a;
        let Ok(log) = read(&bytes, ColumnSettings::default()) else { continue };
        let Some(state) = log.topics.iter().find(|it| it.name == "observation.state") else {
            continue;
        };
        if state.messages < rows {
            salvaged += 1;
            assert!(!log.losses.is_empty(), "byte {at}: {} of {rows} rows", state.messages);
        }
    }
    assert!(salvaged > 0);
}

#[test]
fn lists_of_parquet_are_vectors_in_any_compression() {
    for compression in
        [Compression::UNCOMPRESSED, Compression::SNAPPY, Compression::ZSTD(Default::default())]
    {
        let bytes = parquet(50, 1, compression, |_| 7);
        let (width, values) = array(&plain(&bytes), "observation.state");
        // Without the row of the missing number.
        assert_eq!((width, values.len()), (7, 49 * 7));
        assert_eq!(values[7..9], [10.0, 11.0]);
        assert_eq!(values[3 * 7], 40.0);
    }
    let ragged = parquet(50, 1, Compression::SNAPPY, |row| 6 + row % 2);
    assert!(refusal(&ragged).contains("neither joint positions nor poses"), "{}", refusal(&ragged));
}

#[test]
fn episodes_are_consecutive_and_one_can_be_selected() {
    let bytes = parquet(60, 3, Compression::SNAPPY, |_| 7);
    let log = plain(&bytes);
    let (header, received) = {
        let times = topic(&log, "observation.state").columns.as_ref().expect("columns").times()[0];
        (times.header.clone(), times.log.clone())
    };
    assert_eq!(header.len(), 3 * 59);
    assert_eq!(header.iter().filter(|stamp| **stamp == NANOS_PER_SECOND).count(), 3);
    assert!(received.is_sorted_by(|a, b| a < b));
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run#1.parquet");
    fs::write(&path, &bytes).expect("a file");
    let of = |episode: &str| {
        let named = Path::new(&format!("{}#{episode}", path.display())).to_owned();
        open(&[named], &ReadOptions::default())
    };
    assert_eq!(stamps(&of("2").expect("an episode"), "observation.state").len(), 59);
    let missing = of("9").expect_err("no such episode").to_string();
    assert!(missing.contains("no episode '9'"), "{missing}");
    assert_eq!(super::episodes(&path), ["0", "1", "2"]);
}

#[test]
fn the_only_episode_of_a_shared_lerobot_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let (meta, chunk) = (folder.path().join("meta"), folder.path().join("data/chunk-000"));
    fs::create_dir_all(&meta).and_then(|()| fs::create_dir_all(&chunk)).expect("folders");
    let bytes = parquet(60, 1, Compression::SNAPPY, |_| 7);
    let episodes = |name: &str| {
        let path = chunk.join(name);
        fs::write(&path, &bytes).expect("data");
        super::episodes(&path)
    };
    assert!(episodes("file-000.parquet").is_empty(), "not a dataset yet");
    fs::write(meta.join("info.json"), r#"{"fps": 30, "features": {}}"#).expect("metadata");
    assert_eq!(episodes("file-000.parquet"), ["0"]);
    assert!(episodes("episode_000000.parquet").is_empty());
}

#[test]
fn damaged_parquet_is_reported_in_one_line() {
    let whole = parquet(50, 2, Compression::SNAPPY, |_| 7);
    for end in [4, 12, 100, whole.len() / 2, whole.len() - 1] {
        refusal(&whole[..end]);
    }
    for at in (0..whole.len()).step_by(7) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x5a;
        let _ = read(&bytes, ColumnSettings::default());
    }
}

#[test]
fn a_column_without_its_dictionary_is_lost() {
    let mut bytes = parquet(50, 1, Compression::UNCOMPRESSED, |_| 7);
    // The first page becomes the dictionary of the state (type 2, zigzag) or an index page, which is
    // skipped.
    assert_eq!(bytes[4..6], [0x15, 4]);
    bytes[5] = 2;
    // Only the times remain. The decoder of the crate panics on such a page.
    let line = refusal(&bytes);
    assert!(line.contains("neither joint positions nor poses"), "{line}");
}

#[test]
fn chunked_hdf5_with_filters_is_read_and_images_are_not() {
    let log = plain(CHUNKED);
    let (names, rows) = joints(&log, "observation/joint_positions");
    assert_eq!((names.len(), rows.len()), (6, 40));
    assert_eq!(rows[39][5], f64::from(39.0_f32 * 6.0 * 1e-3));
    assert_eq!(stamps(&log, "observation/joint_positions")[1], 1_700_000_000_040_000_000);
    assert!(log.topics.iter().all(|topic| !topic.name.contains("image")));
    assert_eq!(log.losses, []);
}

#[test]
fn episodes_of_hdf5_are_in_the_order_of_their_numbers() {
    let log = plain(EPISODES);
    let (_, rows) = joints(&log, "obs/robot0_joint_pos");
    assert_eq!(
        rows.iter().map(|row| row[0]).collect::<Vec<_>>(),
        [vec![0.0; 20], vec![1.0; 21], vec![10.0; 30]].concat()
    );
    assert_eq!(
        array(&log, "obs/robot0_eef_pos"),
        (7, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0].repeat(71))
    );
    // The rate is in robomimic's `env_args`.
    let stamps = stamps(&log, "obs/robot0_joint_pos");
    assert_eq!(stamps[1] - stamps[0], NANOS_PER_SECOND / 20);
}

#[test]
fn damaged_hdf5_is_reported_in_one_line() {
    for whole in [CHUNKED, EPISODES] {
        for end in [9, 64, 512, whole.len() / 2] {
            let _ =
                read(&whole[..end], ColumnSettings::default()).map_err(|error| error.to_string());
        }
        for at in (0..whole.len()).step_by(11) {
            let mut bytes = whole.to_vec();
            bytes[at] ^= 0xff;
            let _ = read(&bytes, ColumnSettings::default());
        }
    }
}

/// A time and six joints, with one line changed.
fn text_with(delimiter: &str, line: usize, change: impl Fn(&str) -> String) -> Log {
    let names = ["t", "q1", "q2", "q3", "q4", "q5", "q6"].join(delimiter);
    let mut lines = vec![names];
    lines.extend((0..40).map(|row| {
        let cell = |at: usize| {
            format!("{:.4}", 0.01 * row as f64 + if at > 0 { 0.3 * at as f64 } else { 0.0 })
        };
        (0..7).map(cell).collect::<Vec<_>>().join(delimiter)
    }));
    lines[line - 1] = change(&lines[line - 1]);
    plain((lines.join("\n") + "\n").as_bytes())
}

#[test]
fn rows_of_text_that_are_no_numbers_are_reported_with_their_line() {
    for (change, rows, expected) in [
        ((&|line: &str| line.to_owned()) as &dyn Fn(&str) -> String, 40, None),
        (&|line| format!("{line}\n # stopped by hand\n\t% twice"), 40, None),
        (&|line| format!("{line}\t\t"), 40, None),
        (&|line| format!("{line}\nt\tq1\tq2\tq3\tq4\tq5\tq6"), 40, None),
        (
            &|line| format!("{line}\nstop\tby\thand\tat\t1\t2\tnow"),
            40,
            Some("line 22: 5 of 7 cells are not numbers"),
        ),
        (&|line| line.replacen("\t0.7900", "\t", 1), 39, Some("line 21: 1 of 6 numbers unusable")),
        (
            &|line| line.rsplit_once('\t').map_or(String::new(), |it| format!("{}\t", it.0)),
            39,
            Some("line 21: 1 of 6 numbers unusable"),
        ),
        (
            &|line| format!("\t{}", line.split_once('\t').map_or("", |it| it.1)),
            39,
            Some("1 of 40 rows have no stamp"),
        ),
    ] {
        let log = text_with("\t", 21, change);
        assert_eq!(topic(&log, "q").messages, rows, "{expected:?}");
        match expected {
            None => assert_eq!(log.losses, []),
            Some(expected) => {
                assert_eq!((log.losses.len(), log.losses[0].messages), (1, Some(1)), "{expected}");
                assert!(log.losses[0].what.contains(expected), "{:?}", log.losses);
            }
        }
    }
}

#[test]
fn cells_beside_a_table_of_text_are_noted() {
    for (line, cells, note) in [
        (2, ",,by hand,1.25", Some("cells beside the table are not used: 2, from line 2 on")),
        (30, ",,,7", Some("cells beside the table are not used: 1, from line 30 on")),
        (1, ",,by hand", None),
    ] {
        let log = text_with(",", line, |own| format!("{own}{cells}"));
        assert_eq!(topic(&log, "q").messages, 40, "{cells}");
        assert_eq!(log.losses, []);
        let notes: Vec<&str> = log.notes.iter().map(|note| note.what.as_str()).collect();
        let found = notes.iter().find(|note| note.contains("beside")).copied();
        assert_eq!(found, note, "{notes:?}");
    }
    // No cell separates it from the row.
    let log = text_with(",", 3, |own| format!("{own},7"));
    assert!(log.losses[0].what.contains("line 3: 8 columns, not 7"), "{:?}", log.losses);
}

/// As Vicon's Nexus exports segments and markers.
#[test]
fn another_table_below_the_rows_is_noted() {
    let other = "Trajectories\n100\nFrame,X,Y,Z\n,mm,mm,mm\n1,0.5,2,3\n2,0.6,2,3\n";
    let as_wide = "Forces\nframe,a,b,c,d,e,f\n1,2,3,4,5,6,7\n2,2,3,4,5,6,7\n";
    for (below, is_other) in [(other, true), (as_wide, true), ("t,q1,q2,q3,q4,q5,q6\n", false)] {
        for end in ["\n", "\r\n"] {
            let below = below.replace('\n', end);
            let log = text_with(",", 41, |line| format!("{line}{end}{end}{below}"));
            assert_eq!(topic(&log, "q").messages, 40, "{below}");
            assert_eq!(log.losses, []);
            let notes: Vec<&str> = log.notes.iter().map(|note| note.what.as_str()).collect();
            let is_noted =
                notes.iter().any(|note| note.contains("another table follows from line 43"));
            assert_eq!(is_noted, is_other, "{notes:?}");
        }
    }
}

#[test]
fn first_rows_that_are_mostly_empty_are_rows() {
    for delimiter in [",", "\t"] {
        let empty = |line: &str| {
            let cells: Vec<&str> = line.split(delimiter).collect();
            let kept = [&cells[..2], &[""; 5]].concat().join(delimiter);
            format!("{kept}{delimiter}\n{kept}")
        };
        let log = text_with(delimiter, 2, empty);
        let Some(Columns::Joints(joints)) = &topic(&log, "q").columns else { panic!("no joints") };
        assert_eq!(
            (topic(&log, "q").messages, joints.unusable.as_slice()),
            (41, &[0, 2, 2, 2, 2, 2][..])
        );
        assert_eq!(log.losses, []);
    }
}

#[test]
fn csv_finds_poses_joints_and_the_finest_time() {
    let mut text =
        "Timestamp,IPOC,X_RIst,Y_RIst,Z_RIst,A_RIst,B_RIst,C_RIst,A1,A2,A3,A4,A5,A6,Delay\n"
            .to_owned();
    for row in 0..40 {
        let joints = "0.5,".repeat(6);
        text += &format!(
            "2024-09-24 14:05:{:02},{},1279.5,{row},977.3,80.4,60.3,116.8,{joints}0\n",
            row / 20,
            1000 + 12 * row
        );
    }
    let log = plain(text.as_bytes());
    assert_eq!(array(&log, "rist").0, 6);
    assert_eq!(joints(&log, "a").0.len(), 6);
    let stamps = stamps(&log, "rist");
    assert_eq!(stamps[1] - stamps[0], 12_000_000);
    assert!(
        log.notes.iter().any(|note| note.what.contains("IPOC") && note.what.contains("even grid"))
    );
}

#[test]
fn malformed_csv_rows_are_counted() {
    let mut text = "t;q1;q2;q3;q4\n".to_owned();
    (0..20).for_each(|row| {
        text += &format!("0,{row:02};1,5;{};3;4\n", if row == 0 { "nan" } else { "2" })
    });
    text += "0,20;1;2\n0,21;1;2;3;4";
    let log = plain(text.as_bytes());
    let (_, rows) = joints(&log, "q");
    assert_eq!((rows.len(), rows[0][0]), (21, 1.5));
    assert!(rows[0][1].is_nan());
    assert_eq!(log.losses.len(), 1, "{:?}", log.losses);
}

#[test]
fn columns_unidentified_by_name_are_asked_for_and_configurable() {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (30, 13), }\n";
    let data: Vec<u8> = (0..30 * 13).flat_map(|n| (1e-3 * f64::from(n)).to_le_bytes()).collect();
    let bytes = npy(header, &data);
    let question = refusal(&bytes);
    assert!(
        question.contains("no column holds times") && question.contains("[columns]"),
        "{question}"
    );
    let expected = ColumnSettings {
        rate_hz: Some(50.0),
        joints: vec!["array[0:6]".parse().expect("a selector")],
        pose: vec!["array[6:13]".parse().expect("a selector")],
        ..ColumnSettings::default()
    };
    let log = read(&bytes, expected).expect("a log");
    assert_eq!(joints(&log, "joints").0.len(), 6);
    assert_eq!(array(&log, "pose").0, 7);
    let wrong = ColumnSettings {
        rate_hz: Some(50.0),
        pose: vec!["array[6:19]".parse().expect("a selector")],
        ..ColumnSettings::default()
    };
    let refused = read(&bytes, wrong).expect_err("too far").to_string();
    assert!(refused.contains("has 13 numbers per row"), "{refused}");
}

#[test]
fn joints_beyond_two_turns_are_read_as_degrees() {
    let mut text = "time,q1,q2,q3,q4,q5,q6\n".to_owned();
    (0..30).for_each(|row| text += &format!("{},90,-45,0,10,20,{row}\n", 0.02 * f64::from(row)));
    let log = plain(text.as_bytes());
    let (_, rows) = joints(&log, "q");
    assert!((rows[0][0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert!(topic(&log, "q").read_as.as_ref().is_some_and(|why| why.contains("taken for degrees")));
}

#[test]
fn lerobot_metadata_names_the_numbers_and_is_checked() {
    let folder = tempfile::tempdir().expect("a folder");
    let (meta, chunk) = (folder.path().join("meta"), folder.path().join("data/chunk-000"));
    fs::create_dir_all(&meta).and_then(|()| fs::create_dir_all(&chunk)).expect("folders");
    let names = r#"["x", "y", "z", "qx", "qy", "qz", "qw"]"#;
    let info = |fps: u32, shape: u32| {
        format!(
            r#"{{"fps": {fps}, "robot_type": "so101_follower", "features": {{"observation.state":
               {{"dtype": "float32", "shape": [{shape}], "names": {{"motors": {names}}}}}}}}}"#
        )
    };
    fs::write(chunk.join("file-000.parquet"), parquet(60, 2, Compression::SNAPPY, |_| 7))
        .expect("data");
    fs::write(meta.join("info.json"), info(30, 7)).expect("metadata");
    let of = || open(&[folder.path().to_owned()], &ReadOptions::default()).expect("a log");
    let log = of();
    assert_eq!(array(&log, "observation.state").0, 7);
    assert_eq!(log.robot_type.as_deref(), Some("so101_follower"));
    assert_eq!(log.contradictions, Some(Vec::new()));
    fs::write(meta.join("info.json"), info(50, 6)).expect("metadata");
    let found: Vec<String> =
        of().contradictions.into_iter().flatten().map(|note| note.what).collect();
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(
        found[0].contains("6 numbers") && found[1].contains("50 frames per second"),
        "{found:?}"
    );
}

fn csv(names: &[&str], rows: usize, cell: impl Fn(usize, usize) -> f64) -> String {
    let line = |row: usize| {
        let cells: Vec<String> = (0..names.len()).map(|at| cell(row, at).to_string()).collect();
        cells.join(",")
    };
    let lines = (0..rows).map(line).collect::<Vec<_>>().join("\n");
    format!("{}\n{lines}\n", names.join(","))
}

#[test]
fn vendor_labels_identify_a_rotation() {
    use crate::RotationLabels::{Abc, Oat, Quaternion, RollPitchYaw, Wpr};
    for (labels, expected) in [
        (["W", "P", "R"].as_slice(), Some(Wpr)),
        (&["O", "A", "T"], Some(Oat)),
        (&["A", "B", "C"], Some(Abc)),
        (&["roll", "pitch", "yaw"], Some(RollPitchYaw)),
        (&["orientation.w", "orientation.x", "orientation.y", "orientation.z"], Some(Quaternion)),
        (&["theta_x", "theta_y", "theta_z"], None),
    ] {
        let names = [&["time", "X", "Y", "Z"], labels].concat();
        let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
        let pose = topic(&log, "table");
        let own: Vec<_> = pose.cells.iter().skip(3).map(|cell| cell.labels).collect();
        assert_eq!(own, vec![expected; labels.len()], "{labels:?}");
    }
}

#[test]
fn unidentified_measurements_are_marked() {
    let names = ["time", "X", "Y", "Z", "alfa", "step", "force_x"];
    let log = plain(
        csv(&names, 30, |row, at| match at {
            5 => row as f64,
            _ => 0.01 * row as f64 + at as f64,
        })
        .as_bytes(),
    );
    let marked: Vec<&str> = log
        .topics
        .iter()
        .flat_map(|topic| &topic.cells)
        .filter(|cell| cell.is_unidentified)
        .map(|cell| cell.name.as_str())
        .collect();
    assert_eq!(marked, ["alfa"]);
}

#[test]
fn velocities_are_assigned_to_their_joints() {
    let names = ["t", "q1", "q2", "q3", "q4", "dq_1", "dq_2", "dq_3", "dq_4", "speed_x"];
    let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
    let Some(Columns::Joints(joints)) = &topic(&log, "q").columns else { panic!("no joints") };
    let first: Vec<f64> = joints.joints.iter().map(|joint| joint.velocity[0]).collect();
    assert_eq!(first, [5.0, 6.0, 7.0, 8.0]);
    // `qd` means desired positions if its values follow the positions rather than their rates.
    let names = ["t", "q1", "q2", "q3", "q4", "qd1", "qd2", "qd3", "qd4"];
    let log = plain(
        csv(&names, 30, |row, at| match at {
            0 => 0.01 * row as f64,
            _ => (0.3 * row as f64).sin() + (at - 1).rem_euclid(4) as f64,
        })
        .as_bytes(),
    );
    assert_eq!(self::joints(&log, "qd_command").0.len(), 4);
    // The gripper has one, too.
    let parts = ["waist", "shoulder", "elbow", "wrist_angle", "left_finger"];
    let names = parts.map(|part| [format!("{part}_pos"), format!("{part}_vel")]).concat();
    let names: Vec<&str> =
        std::iter::once("time").chain(names.iter().map(String::as_str)).collect();
    let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
    let Some(Columns::Joints(joints)) = &topic(&log, "joints").columns else { panic!("no joints") };
    let first: Vec<f64> = joints.joints.iter().map(|joint| joint.velocity[0]).collect();
    assert_eq!(first, [2.0, 4.0, 6.0, 8.0, 10.0]);
}

#[test]
fn a_table_of_forces_is_refused_with_its_columns() {
    let names = ["timestamp", "tcp_force_0", "tcp_force_1", "tcp_force_2", "tcp_force_scalar"];
    let text = csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64);
    let error = refusal(text.as_bytes());
    assert!(error.contains("neither joint positions nor poses: tcp_force_0"), "{error}");
}

/// Rows that were read too late are lost: 8 or 24 ms apart.
#[test]
fn a_column_with_lost_rows_is_a_clock() {
    let text = |at: fn(usize) -> f64| -> String {
        let row = |row: usize| {
            let sines: Vec<String> =
                (1..7).map(|k| format!("{:.4}", (f64::from(k) * at(row) * 9.0).sin())).collect();
            format!("{:.6},{}\n", at(row), sines.join(","))
        };
        (0..200).map(row).collect()
    };
    let log = plain(text(|row| 0.008 * (row + 2 * (row / 2)) as f64).as_bytes());
    assert!(log.notes.iter().any(|note| note.what.contains("by its numbers")), "{:?}", log.notes);
    // The steps of an accelerating joint are no multiples.
    let error = refusal(text(|row| 1e-4 * (row as f64).powi(2)).as_bytes());
    assert!(error.contains("no column holds times"), "{error}");
}

#[test]
fn seconds_and_nanoseconds_are_one_stamp() {
    let names = ["header.stamp.secs", "header.stamp.nsecs", "q1", "q2", "q3", "q4"];
    let log = plain(
        csv(&names, 40, |row, at| match at {
            0 => (1_700_000_000 + row / 20) as f64,
            1 => (50_000_000 * (row % 20) + 1) as f64,
            _ => row as f64,
        })
        .as_bytes(),
    );
    let stamps = stamps(&log, "q");
    assert_eq!(stamps[0], 1_700_000_000_000_000_001);
    assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 50_000_000));
}

#[test]
fn transposed_arrays_are_turned() {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (5, 60), }\n";
    let data: Vec<u8> = (0..300)
        .flat_map(|n| (0.02 * f64::from(n % 60) + 1e-3 * f64::from(n / 60)).to_le_bytes())
        .collect();
    let settings = ColumnSettings { rate_hz: Some(50.0), ..ColumnSettings::default() };
    let log = read(&npy(header, &data), settings).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(log.topics[0].messages, 60);
}

#[test]
fn a_matrix_by_row_and_column_is_a_pose() {
    let mut names = vec!["t".to_owned()];
    names.extend((0..16).map(|at| format!("T_{}{}", at / 4, at % 4)));
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
    let (width, values) = array(&log, "t");
    assert_eq!((width, values[3]), (16, 4.0));
}

/// Fractions in microseconds, as in `struct timeval`.
#[test]
fn fractions_that_never_reach_a_millisecond_are_microseconds() {
    let names = ["sec", "nanosec", "q1", "q2", "q3", "q4"];
    let text = |step: usize| {
        csv(&names, 60, |row, at| match at {
            0 => (1_700_000_000 + step * row / 1_000_000) as f64,
            1 => (step * row % 1_000_000) as f64,
            _ => row as f64,
        })
    };
    let log = plain(text(50_000).as_bytes());
    assert!(stamps(&log, "q").windows(2).all(|pair| pair[1] - pair[0] == 50_000_000));
    let contradictions = log.contradictions.as_deref().unwrap_or_default();
    assert!(
        contradictions.iter().any(|note| note.what.contains("'nanosec'")),
        "{contradictions:?}"
    );
    // One row a second, always a little later.
    let log = plain(text(1_010_000).as_bytes());
    assert!(log.contradictions.is_none_or(|all| all.is_empty()));
}

#[test]
fn times_since_the_last_row_are_summed() {
    let table = |name: &str, step: &dyn Fn(usize) -> f64| {
        csv(&[name, "q1", "q2", "q3", "q4"], 40, |row, at| match at {
            0 => step(row),
            _ => (0.1 * (row + 7 * at) as f64).sin(),
        })
    };
    let uneven = |row: usize| if row == 0 { 0.0 } else { 0.02 + 1e-3 * (row % 3) as f64 };
    let log = plain(table("dt", &uneven).as_bytes());
    let own = stamps(&log, "q");
    assert_eq!([own[1] - own[0] + 1, own[3] - own[2]], [21_000_000, 20_000_000]);
    assert!(log.notes[0].what.starts_with("stamps summed from column 'dt', s"), "{:?}", log.notes);
    let log = plain(table("delta_ms", &|row| 20.0 + (row % 2) as f64).as_bytes());
    let own = stamps(&log, "q");
    assert_eq!(own[2] - own[0], 41_000_000);
    assert!(plain(table("dt", &|_| 0.02).as_bytes()).notes[0].what.contains("50.0000 rows"));
    // Elapsed times are not summed.
    let log = plain(table("dt", &|row| 0.02 * row as f64).as_bytes());
    assert_eq!(stamps(&log, "q")[39], 780_000_000);
}

#[test]
fn joints_named_by_parts_have_positions_and_velocities() {
    const PARTS: [&str; 6] =
        ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    for (before, [position, velocity]) in [
        ("", ["_pos", "_vel"]),
        ("", ["_p", "_v"]),
        ("/joint_states/", ["/position", "/velocity"]),
        ("state.", [".pos", ".vel"]),
    ] {
        let all = |end: &str| PARTS.map(|part| format!("{before}{part}{end}"));
        let names = [vec!["t".to_owned()], all(position).to_vec(), all(velocity).to_vec()].concat();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
        let own = log.topics.iter().find(|topic| matches!(topic.columns, Some(Columns::Joints(_))));
        let name = own.expect("joints").name.clone();
        assert_eq!(joints(&log, &name).0, PARTS, "{position}");
        let Some(Columns::Joints(own)) = &topic(&log, &name).columns else { panic!() };
        assert_eq!([own.joints[0].velocity[0], own.joints[5].velocity[0]], [7.0, 12.0]);
        assert_eq!(log.topics.len(), 1, "{:?}", log.topics);
    }
}

#[test]
fn targets_of_joints_named_by_parts_are_commands() {
    const PARTS: [&str; 4] =
        ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint"];
    for (before, after) in
        [("", "_pos_target"), ("", "_cmd"), ("target_", "_pos"), ("", "_position_command")]
    {
        let all = |before: &str, after: &str| PARTS.map(|part| format!("{before}{part}{after}"));
        let limits = PARTS.map(|part| format!("{part}_pos_limit_upper"));
        let names = [
            vec!["t".to_owned()],
            all("", "_pos").to_vec(),
            all(before, after).to_vec(),
            all("", "_vel").to_vec(),
            limits.to_vec(),
        ];
        let names = names.concat();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
        assert_eq!(joints(&log, "joints").0, PARTS, "{after}");
        let Some(Columns::Joints(own)) = &topic(&log, "joints").columns else { panic!() };
        assert_eq!(own.joints[0].velocity[0], 9.0, "{after}");
        let commands = log.topics.iter().find(|topic| topic.name.starts_with("joints_"));
        let name = commands.expect("commands").name.clone();
        assert_eq!(joints(&log, &name).0, PARTS, "{after}");
    }
}

#[test]
fn velocities_in_radians_stay_beside_positions_in_degrees() {
    let degrees = |row: usize, joint: usize| 40.0 * (0.1 * row as f64 + joint as f64).sin();
    let rate = |row: usize, joint: usize| 200.0 * (0.1 * row as f64 + joint as f64).cos();
    let names = ["t", "q1 [deg]", "q2 [deg]", "q3 [deg]", "q4 [deg]", "qd1", "qd2", "qd3", "qd4"];
    for unit in [1f64.to_radians(), 1.0] {
        let cell = |row: usize, at: usize| match at {
            0 => 0.02 * row as f64,
            1..=4 => degrees(row, at),
            _ => unit * rate(row, at - 4),
        };
        let log = plain(csv(&names, 60, cell).as_bytes());
        let own = log.topics.iter().find_map(|topic| match &topic.columns {
            Some(Columns::Joints(joints)) => Some(joints),
            _ => None,
        });
        let velocity = own.expect("joints").joints[0].velocity[10];
        let expected = rate(10, 1).to_radians();
        assert!((velocity - expected).abs() < 1e-6, "{unit}: {velocity} {expected}");
    }
}

#[test]
fn a_hand_s_position_and_quaternion_are_a_pose_of_that_order() {
    let record = |row: usize| {
        let a = 0.05 * row as f64;
        let [w, x] = [(0.5 * a).cos(), (0.5 * a).sin()];
        format!(
            r#"{{"time_s":{a},"arm_joint_position_rad":[{a},1,2,3,{a},5],"hand_position_w_m":[{a},0.2,0.3],"hand_quaternion_wxyz":[{w},{x},0,0]}}"#
        )
    };
    let text = (0..40).map(record).collect::<Vec<_>>().join(",\n");
    let log = plain(format!("[{text}]").as_bytes());
    let pose = topic(&log, "hand_position_w_m");
    assert_eq!(pose.cells.len(), 7, "{:?}", pose.cells);
    assert_eq!(pose.cells[3].labels, Some(crate::RotationLabels::ScalarFirst));
}

#[test]
fn rows_of_zeros_at_the_end_are_left_out() {
    let names = ["t", "q1", "q2", "q3", "q4"];
    let q = |row: usize, at: usize| (0.1 * row as f64 + at as f64).sin();
    // All numbers, or the times only; zeros of a joint are data.
    for (is_zero, rows) in [
        ((|row, _| row >= 30) as fn(usize, usize) -> bool, 30),
        (|row, at| row >= 30 && at == 0, 30),
        (|row, at| row >= 30 && at == 1, 40),
        (|row, at| row == 30 && at > 0, 40),
    ] {
        let cell = |row: usize, at: usize| match at {
            _ if is_zero(row, at) => 0.0,
            0 => 0.01 * (row + 1) as f64,
            _ => q(row, at),
        };
        let log = plain(csv(&names, 40, cell).as_bytes());
        assert_eq!(joints(&log, "q").1.len(), rows);
        let notes = log.notes.iter().filter(|note| note.what.contains("last 10 of 40 rows"));
        assert_eq!(notes.count(), usize::from(rows == 30), "{:?}", log.notes);
    }
    // A camera that stopped before, and times that end at their zero.
    let cell = |row: usize, at: usize| match at {
        0 => 0.01 * row as f64 - 0.39,
        1 if row >= 30 => 0.0,
        1 => 0.01 * (row + 1) as f64,
        _ => q(row, at),
    };
    let names = ["t", "camera_timestamp", "q1", "q2", "q3", "q4"];
    let log = plain(csv(&names, 40, cell).as_bytes());
    assert!(log.notes.iter().all(|note| !note.what.contains("zeros")), "{:?}", log.notes);
}

#[test]
fn a_rotation_vector_and_a_translation_are_a_pose() {
    for (rotation, position) in [
        ("rvec", "tvec"),
        ("T_cam_target_rvec", "T_cam_target_tvec"),
        ("chessboard_data.rotation_vector", "chessboard_data.translation_mm"),
    ] {
        let record = |row: usize| {
            let a = 0.05 * row as f64;
            format!(
                r#"{{"time":{a},"{rotation}":[[{a}],[0.2],[0.3]],"{position}":[[{a}],[1],[2]]}}"#
            )
        };
        let text = (0..40).map(record).collect::<Vec<_>>().join(",\n");
        let log = plain(format!("[{text}]").as_bytes());
        let pose = topic(&log, position);
        assert_eq!(pose.cells[3].name, format!("{rotation}[0]"));
        assert_eq!(pose.cells[3].labels, Some(crate::RotationLabels::RotationVector));
    }
}

#[test]
fn poses_in_two_frames_keep_their_own_rotations() {
    let record = |row: usize| {
        let a = 0.05 * row as f64;
        let [w, x] = [(0.5 * a).cos(), (0.5 * a).sin()];
        format!(
            r#"{{"time":{a},"ee_pos":[{a},1,2],"ee_quat":[{w},{x},0,0],"ee_pos_w":[{a},3,4],"ee_quat_w":[0,{w},{x},0]}}"#
        )
    };
    let text = (0..40).map(record).collect::<Vec<_>>().join(",\n");
    let log = plain(format!("[{text}]").as_bytes());
    for (name, rotation) in [("ee_pos", "ee_quat[0]"), ("ee_pos_w", "ee_quat_w[0]")] {
        assert_eq!(topic(&log, name).cells[3].name, rotation, "{name}");
    }
}

#[test]
fn positions_with_velocities_are_joints_only_if_they_are_angles() {
    let record = |names: [&str; 2]| {
        let row = |row: usize| {
            let a = 0.05 * row as f64;
            let six = |from: f64| {
                let numbers = (0..6).map(|at| (a + from + f64::from(at)).sin().to_string());
                format!("[{}]", numbers.collect::<Vec<_>>().join(","))
            };
            let [first, second] = names;
            format!(
                r#"{{"time":{a},"{first}":{},"{second}":{},"q":{}}}"#,
                six(0.0),
                six(1.6),
                six(3.0)
            )
        };
        format!("[{}]", (0..40).map(row).collect::<Vec<_>>().join(",\n"))
    };
    let is_joints = |names: [&str; 2]| {
        let log = plain(record(names).as_bytes());
        let own = log.topics.iter().find(|topic| topic.name == names[0]);
        own.is_some_and(|topic| matches!(topic.columns, Some(Columns::Joints(_))))
    };
    assert!(is_joints(["act_pos_se_deg", "act_vel_se_deg_per_s"]));
    assert!(!is_joints(["base_position", "base_velocity"]));
}

#[test]
fn rows_that_repeat_with_their_stamp_hide_no_clock() {
    // Every ninth row is a copy of the one before.
    let source = |row: usize| row - row.div_ceil(9);
    let cell = |row: usize, at: usize| match at {
        0 => 0.02 * source(row + 1) as f64,
        _ => (0.1 * source(row + 1) as f64 + at as f64).sin(),
    };
    let names = ["c0", "c1", "c2", "c3", "c4", "c5", "c6"];
    let log = plain(csv(&names, 200, cell).as_bytes());
    assert_eq!(log.time_column.as_deref(), Some("c0"));
}

#[test]
fn differentials_of_joints_are_velocities() {
    for [position, velocity, acceleration] in [
        ["Theta_{}", "D_Theta_{}", "DD_Theta_{}"],
        ["q{}", "q{}_dot", "q{}_ddot"],
        ["q_{}", "q_dot_{}", "q_ddot_{}"],
        ["theta{}", "dtheta{}", "ddtheta{}"],
    ] {
        let all =
            |stem: &str| (1..=6).map(|at: usize| stem.replace("{}", &at.to_string())).collect();
        let groups: [Vec<String>; 3] = [position, velocity, acceleration].map(all);
        let names = [vec!["t".to_owned()], groups.concat()].concat();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let log = plain(csv(&names, 30, |row, at| 0.01 * row as f64 + at as f64).as_bytes());
        let all: Vec<&Topic> = log
            .topics
            .iter()
            .filter(|topic| matches!(topic.columns, Some(Columns::Joints(_))))
            .collect();
        let [own] = all.as_slice() else { panic!("{position}: {all:?}") };
        let Some(Columns::Joints(own)) = &own.columns else { panic!() };
        assert_eq!(own.joints[1].velocity[0], 8.0, "{velocity}");
    }
}

/// Turns about z: a matrix by rows, with a position below.
fn turn(row: usize) -> [f64; 9] {
    let (sin, cos) = (0.05 * row as f64).sin_cos();
    [cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0]
}

#[test]
fn homogeneous_matrices_are_poses_under_any_name() {
    let matrix = |row: usize| {
        let r = turn(row);
        let (x, y, z) = (0.1 * row as f64, 0.2, 0.3);
        [r[0], r[1], r[2], x, r[3], r[4], r[5], y, r[6], r[7], r[8], z, 0.0, 0.0, 0.0, 1.0]
    };
    let rows = |value: &dyn Fn(usize) -> [f64; 16]| -> String {
        let row =
            |row: usize| format!("{{\"t\": {}, \"H\": {:?}}}\n", 0.02 * row as f64, value(row));
        (0..40).map(row).collect()
    };
    let is_known = |log: &Log| match &topic(log, "H").columns {
        Some(Columns::Array(array)) => !array.unnamed,
        _ => false,
    };
    assert!(is_known(&plain(rows(&matrix).as_bytes())));
    let transposed = |row: usize| {
        let own = matrix(row);
        std::array::from_fn(|at| own[4 * (at % 4) + at / 4])
    };
    assert!(is_known(&plain(rows(&transposed).as_bytes())));
    // Constant ones may be a camera's mount.
    assert!(!is_known(&plain(rows(&|_| matrix(3)).as_bytes())));
    assert!(!is_known(&plain(rows(&|row| matrix(row).map(|it| 2.0 * it)).as_bytes())));
}

#[test]
fn matrices_side_by_side_or_below_each_other_are_rows() {
    const COUNT: usize = 6;
    let line = |matrix: usize, line: usize| match line {
        3 => "0,0,0,1".to_owned(),
        line => {
            let [x, y, z] = [0, 1, 2].map(|at| turn(matrix)[3 * line + at]);
            format!("{x},{y},{z},{}", 10 * matrix + line)
        }
    };
    let beside =
        |at: usize| (0..COUNT).map(|matrix| line(matrix, at)).collect::<Vec<_>>().join(",");
    let side_by_side: Vec<String> = (0..4).map(beside).collect();
    let all = |matrix: usize| (0..4).map(move |at| line(matrix, at));
    let below: Vec<String> = (0..COUNT).flat_map(all).collect();
    for lines in [side_by_side, below] {
        let columns = ColumnSettings { rate_hz: Some(10.0), ..ColumnSettings::default() };
        let log = read((lines.join("\n") + "\n").as_bytes(), columns).expect("a log");
        let (width, values) = array(&log, "array");
        assert_eq!((width, values.len()), (16, 16 * COUNT), "{lines:?}");
        let positions: Vec<[f64; 3]> =
            values.chunks(16).map(|own| [own[3], own[7], own[11]]).collect();
        assert_eq!(positions[2], [20.0, 21.0, 22.0]);
        assert!(log.notes.iter().any(|note| note.what.contains("read as 6 matrices")));
    }
    // Identities are no motion, and zeros no rotations.
    let constant = "0,0,0,1\n".repeat(4 * COUNT);
    let columns = ColumnSettings { rate_hz: Some(10.0), ..ColumnSettings::default() };
    let log = read(constant.as_bytes(), columns).expect("a log");
    assert_eq!(array(&log, "array").0, 4);
}

#[test]
fn rotation_matrices_join_the_position() {
    let row = |row: usize| {
        let t = 0.02 * row as f64;
        format!("{{\"t\": {t}, \"p\": [{t}, 0.2, 0.3], \"R\": {:?}}}\n", turn(row))
    };
    let log = plain((0..40).map(row).collect::<String>().as_bytes());
    let (width, values) = array(&log, "p");
    assert_eq!((width, values[3], values[7]), (12, 0.0, 0.2));
}

#[test]
fn few_rows_have_no_times_by_their_numbers() {
    let error = refusal(b"0.1,0.5,3.2,1.9\n0.2,0.4,3.3,1.1\n0.3,0.2,3.1,1.7\n");
    assert!(error.contains("no column holds times"), "{error}");
}

#[test]
fn a_file_may_name_its_only_array() {
    let folder = tempfile::tempdir().expect("a folder");
    let row = |row: usize| {
        let q: Vec<f64> = (0..7).map(|joint| (0.1 * (row + joint) as f64).sin()).collect();
        format!("{{\"timestamp\": {}, \"positions\": {q:?}}}\n", 0.02 * row as f64)
    };
    let text: String = (0..40).map(row).collect();
    let read = |name: &str| {
        let path = folder.path().join(name);
        fs::write(&path, &text).expect("a file");
        open(&[path], &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
    };
    let is_joints = |topic: &Topic| matches!(topic.columns, Some(Columns::Joints(_)));
    assert!(read("qpos.jsonl").topics.iter().any(is_joints));
    assert!(!read("run.jsonl").topics.iter().any(is_joints));
}

#[test]
fn lists_and_headers_alone_are_named_as_such() {
    let error = refusal(b"-0.9584\n0.5622\n-1.4576\n-2.1\n");
    assert!(error.contains("one number per line") && error.contains("paste -d,"), "{error}");
    let pairs = |names: &str| names.to_owned() + "0.00,0.1\n0.01,0.2\n0.02,0.3\n0.03,0.4\n";
    for text in [pairs("time,position\n"), pairs("")] {
        let error = refusal(text.as_bytes());
        assert!(error.contains("each joint is a column"), "{error}");
    }
    let error = refusal(b"Time,q1,q2,q3,q4,q5,q6\n");
    assert!(error.contains("column names and no rows"), "{error}");
}
