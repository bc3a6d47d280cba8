//! Array stores, records and packets of third-party writers: valid, truncated, and with wrong declarations.

use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;

use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use super::hdf5_writer::{DataSet, hdf5};
use super::{array, joints, plain, read, refusal, stamps, topic};
use crate::{ColumnSettings, Log, ReadOptions, open};

/// Written by zarr-python 3.1: the same 200 rows of 6 numbers with various codecs, two episodes, 50 rows
/// per second.
const SECOND: &[u8] = include_bytes!("../fixtures/codecs_v2.zarr.zip");
const THIRD: &[u8] = include_bytes!("../fixtures/codecs_v3.zarr.zip");
/// Verified with the package `tfrecord` for TensorFlow: episodes of 20 and 30 steps.
const RECORDS: &[u8] = include_bytes!("../fixtures/steps.tfrecord");

fn of_folder(folder: &Path) -> Result<Log, String> {
    open(&[folder.to_owned()], &ReadOptions::default()).map_err(|error| error.to_string())
}

fn assert_same_rows(log: &Log, arrays: usize) {
    let rows: Vec<f64> =
        (0..200).flat_map(|row| (0..6).map(move |part| f64::from(10 * row + part))).collect();
    let own: Vec<_> = log.topics.iter().filter(|topic| topic.name != "zeros").collect();
    assert_eq!(own.len(), arrays);
    for topic in own {
        assert_eq!(array(log, &topic.name), (6, rows.clone()), "{}", topic.name);
    }
    assert_eq!(log.losses, []);
}

#[test]
fn every_codec_of_a_store_gives_the_same_numbers() {
    let log = plain(SECOND);
    assert_same_rows(&log, 13);
    let stamps = stamps(&log, "raw");
    assert_eq!((stamps[1] - stamps[0], stamps[80]), (20_000_000, stamps[0]));
    let third = plain(THIRD);
    assert_same_rows(&third, 5);
    // No chunk of zeros was written.
    assert_eq!(array(&third, "zeros"), (6, vec![0.0; 1200]));
}

#[test]
fn a_folder_is_read_like_its_archive() {
    for archive in [SECOND, THIRD] {
        let folder = tempfile::tempdir().expect("a folder");
        ZipArchive::new(Cursor::new(archive))
            .and_then(|mut all| all.extract(folder.path()))
            .expect("unpacked");
        let (mut log, mut own) = (of_folder(folder.path()).expect("a log"), plain(archive));
        assert_eq!(log.files[0].container, own.files[0].container);
        log.files.clear();
        own.files.clear();
        log.notes.clear();
        own.notes.clear();
        log.tables.iter_mut().chain(&mut own.tables).for_each(|table| table.file.clear());
        assert_eq!(log, own);
        assert_eq!(crate::episodes(folder.path()), ["0", "1"]);
        let second = Path::new(&format!("{}#1", folder.path().display())).to_owned();
        assert_eq!(of_folder(&second).expect("an episode").topics[0].messages, 120);
    }
}

/// One array `q` of 6 numbers per row.
pub(super) fn store(change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
    let mut metadata = json!({"zarr_format": 2, "shape": [20, 6], "chunks": [20, 6], "dtype": "<f8",
        "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"});
    change(&mut metadata);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let chunk: Vec<u8> = (0..120).flat_map(|n| f64::from(n).to_le_bytes()).collect();
    for (name, content) in [
        (".zgroup", br#"{"zarr_format": 2}"#.to_vec()),
        (".zattrs", br#"{"fps": 10}"#.to_vec()),
        ("q/.zarray", metadata.to_string().into_bytes()),
        ("q/0.0", chunk.clone()),
        ("../../q/0.0", chunk),
    ] {
        archive.start_file(name, SimpleFileOptions::default()).expect("a member");
        archive.write_all(&content).expect("its bytes");
    }
    archive.finish().expect("an archive").into_inner()
}

#[test]
fn declared_but_missing_data_of_a_store_is_reported_in_one_line() {
    assert_eq!(joints(&plain(&store(|_| ())), "q").1.len(), 20);
    let change = |name: &'static str, value: serde_json::Value| {
        refusal(&store(move |metadata| metadata[name] = value.clone()))
    };
    for (name, value, said) in [
        ("shape", json!([1_000_000_000, 6]), "--max-unpacked GIB"),
        ("shape", json!([10_000_000, 6]), "--max-unpacked GIB"),
        ("shape", json!([u64::MAX, 6]), "invalid chunks"),
        ("chunks", json!([200_000_000, 6]), "--max-unpacked GIB"),
        ("chunks", json!([0, 6]), "invalid chunks"),
        ("chunks", json!([20]), "invalid chunks"),
        ("chunks", json!([30, 6]), "a chunk has 960 bytes"),
        ("compressor", json!({"id": "lzma"}), "codec 'lzma' is not supported"),
        ("compressor", json!({"id": "blosc"}), "a chunk"),
        ("compressor", json!({"id": "zstd"}), "a chunk cannot be unpacked"),
        ("compressor", json!({"id": "lz4"}), "a chunk"),
        ("dtype", json!("|O"), "no arrays of numbers"),
    ] {
        let line = change(name, value);
        assert!(line.contains(said), "{name}: {line}");
    }
}

/// `q` with 6 numbers and `pose` with 7, 50 rows in chunks of 10.
fn folder_store() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, content).expect("a file");
    };
    write(".zgroup", br#"{"zarr_format": 2}"#);
    write(".zattrs", br#"{"fps": 10}"#);
    for (name, width) in [("q", 6), ("tcp_pose", 7)] {
        let metadata = json!({"zarr_format": 2, "shape": [50, width], "chunks": [10, width], "dtype": "<f8",
            "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"});
        write(&format!("{name}/.zarray"), metadata.to_string().as_bytes());
        for chunk in 0..5 {
            let numbers = (0..10 * width).map(|at| 0.01 * f64::from(10 * width * chunk + at) + 0.1);
            let bytes: Vec<u8> = numbers.flat_map(f64::to_le_bytes).collect();
            write(&format!("{name}/{chunk}.0"), &bytes);
        }
    }
    folder
}

#[test]
fn missing_chunks_and_metadata_are_losses() {
    let whole = folder_store();
    let log = of_folder(whole.path()).expect("a log");
    assert_eq!((topic(&log, "q").messages, log.losses.as_slice()), (50, [].as_slice()));
    fs::remove_file(whole.path().join("q/2.0")).expect("a chunk");
    let log = of_folder(whole.path()).expect("a log");
    assert_eq!((topic(&log, "q").messages, topic(&log, "tcp_pose").messages), (40, 50));
    assert_eq!(log.losses[0].messages, Some(10));
    assert!(log.losses[0].what.contains("rows 20 to 29 of 50"), "{:?}", log.losses);
    for (file, content) in
        [("q/.zarray", None), ("q/.zarray", Some("{")), ("q/.zarray", Some("null"))]
    {
        let folder = folder_store();
        match content {
            None => fs::remove_file(folder.path().join(file)).expect("metadata"),
            Some(text) => fs::write(folder.path().join(file), text).expect("metadata"),
        }
        let log = of_folder(folder.path()).expect("a log");
        assert!(
            log.losses.iter().any(|loss| loss.what.contains("'q")),
            "{content:?}: {:?}",
            log.losses
        );
    }
}

#[cfg(unix)]
#[test]
fn links_out_of_the_folder_are_not_followed_and_cycles_end() {
    use std::os::unix::fs::symlink;
    let folder = folder_store();
    let outside = tempfile::NamedTempFile::new().expect("a file");
    let chunk: Vec<u8> = (0..60).flat_map(|at| f64::from(at).to_le_bytes()).collect();
    fs::write(outside.path(), chunk).expect("a file");
    let place = folder.path().join("q/1.0");
    fs::remove_file(&place).expect("a chunk");
    symlink(outside.path(), &place).expect("a link");
    for at in 0..30 {
        symlink(folder.path(), folder.path().join(format!("loop{at}"))).expect("a link");
    }
    let log = of_folder(folder.path()).expect("a log");
    assert_eq!(topic(&log, "q").messages, 40);
    assert!(log.losses[0].what.contains("is a link out of the log folder"), "{:?}", log.losses);
    assert!(crate::store_files(folder.path()).iter().all(|file| !file.ends_with("q/1.0")));
}

#[test]
fn damaged_stores_and_records_are_reported_in_one_line() {
    for whole in [SECOND, THIRD, RECORDS] {
        for end in (30..whole.len()).step_by(whole.len() / 40) {
            let cut = read(&whole[..end], ColumnSettings::default());
            assert!(
                cut.map_err(|error| error.to_string()).is_err_and(|line| !line.contains('\n'))
                    || whole == RECORDS
            );
        }
        for at in (0..whole.len()).step_by(211) {
            let mut bytes = whole.to_vec();
            bytes[at] ^= 0x5a;
            let _ = read(&bytes, ColumnSettings::default());
        }
    }
}

#[test]
fn damaged_blosc_is_refused() {
    // Version 2 header with one block, and lengths that exceed the chunk.
    let mut chunk = vec![2, 1, 0x21, 8, 0, 4, 0, 0, 0, 4, 0, 0, 30, 0, 0, 0, 20, 0, 0, 0];
    chunk.extend([0xff; 10]);
    for at in 0..chunk.len() {
        for value in [0, 1, 0x7f, 0xff] {
            let mut other = chunk.clone();
            other[at] = value;
            let unpacked = crate::tables::zarr::unpacked_blosc(&other, 1024);
            assert!(unpacked.is_err() || unpacked.is_ok_and(|bytes| bytes.len() <= 1024));
        }
    }
}

#[test]
fn records_are_episodes_of_steps() {
    let log = plain(RECORDS);
    let (_, rows) = joints(&log, "observation/joint_positions");
    assert_eq!((rows.len(), rows[20][0]), (50, f64::from(0.01_f32)));
    let (width, poses) = array(&log, "observation/tcp_pose");
    assert_eq!((width, poses[7 * 20]), (7, 100.0));
    let stamps = stamps(&log, "observation/tcp_pose");
    assert_eq!(stamps[1] - stamps[0], 100_000_000);
    assert!(log.topics.iter().all(|topic| !topic.name.contains("image")));
}

#[test]
fn declared_features_are_checked_against_the_records() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("set-train.tfrecord-00000-of-00001");
    fs::write(&path, RECORDS).expect("a file");
    let declared = |joints: &str, said: &str| {
        let tensor = |width: &str| json!({"tensor": {"shape": {"dimensions": [width]}}, "description": said});
        let of = |features| json!({"featuresDict": {"features": features}});
        let observation = of(json!({"joint_positions": tensor(joints), "tcp_pose": tensor("7")}));
        let steps = json!({"sequence": {"feature": of(json!({"observation": observation}))}});
        let text = of(json!({"steps": steps})).to_string();
        fs::write(folder.path().join("features.json"), text).expect("a file");
        let log = of_folder(&path).expect("a log");
        log.contradictions.into_iter().flatten().map(|note| note.what).collect::<Vec<_>>()
    };
    assert_eq!(declared("6", "Robot [state]"), Vec::<String>::new());
    let found = declared("7", "");
    assert!(found.len() == 1 && found[0].contains("with 7 numbers per row but has 6"), "{found:?}");
    // As in the template of RLDS datasets.
    let found =
        declared("6", "Robot state, consists of [7x robot joint angles, 2x gripper position].");
    assert!(
        found.len() == 2 && found[0].contains("7 + 2 = 9 numbers per row but has 6"),
        "{found:?}"
    );
    let named = Path::new(&format!("{}#1", path.display())).to_owned();
    assert_eq!(of_folder(&named).expect("an episode").messages % 30, 0);
    assert_eq!(declared("0", "").len(), 1);
}

#[test]
fn a_damaged_record_loses_no_other_record() {
    let mut bytes = RECORDS.to_vec();
    bytes[600] ^= 1;
    let log = plain(&bytes);
    assert_eq!(topic(&log, "observation/tcp_pose").messages, 30);
    assert!(log.losses[0].what.contains("record 0: wrong checksum"));
    let cut = plain(&RECORDS[..RECORDS.len() - 1]);
    assert_eq!(topic(&cut, "observation/tcp_pose").messages, 20);
    assert!(cut.losses[0].what.contains("ends within a record"));
}

/// Pose and axes follow from the number.
pub(crate) fn packet(number: u32) -> String {
    let cells = |names: &[&str]| -> String {
        let of = |(at, name): (usize, &&str)| format!(" {name}=\"{}.5\"", number as usize + at);
        names.iter().enumerate().map(of).collect()
    };
    let (pose, axes) = (["X", "Y", "Z", "A", "B", "C"], ["A1", "A2", "A3", "A4", "A5", "A6"]);
    format!(
        "<Rob Type=\"KUKA\"><RIst{}/><RSol{}/><AIPos{}/><MACur{}/><Delay D=\"0\"/><IPOC>{}</IPOC></Rob>",
        cells(&pose),
        cells(&pose),
        cells(&axes),
        cells(&axes),
        4_208_163_634_u64 + u64::from(4 * number)
    )
}

#[test]
fn kuka_packets_are_rows_in_any_layout() {
    let reply = "<Sen Type=\"ImFree\"><RKorr X=\"0\" Y=\"0\" Z=\"0\"/><IPOC>1</IPOC></Sen>";
    for (before, after) in [("", ""), ("", "\r\n"), ("1700000000.5 ", "\n"), (reply, "\n")] {
        let text: String =
            (0..40).map(|number| format!("{before}{}{after}", packet(number))).collect();
        let log = plain(text.as_bytes());
        let (width, poses) = array(&log, "RIst");
        assert_eq!((width, &poses[6..9]), (6, &[1.5, 2.5, 3.5][..]));
        assert_eq!(joints(&log, "AIPos").0.len(), 6);
        assert_eq!(stamps(&log, "RSol")[1] - stamps(&log, "RSol")[0], 4_000_000);
        assert!(log.topics.iter().all(|topic| topic.name != "MACur"));
        assert_eq!(log.losses, []);
    }
}

#[test]
fn damaged_packets_are_counted() {
    let whole: Vec<String> = (0..40).map(packet).collect();
    let mut text = whole.join("\n");
    let cut = plain(&text.as_bytes()[..text.len() - 20]);
    assert_eq!(topic(&cut, "RIst").messages, 39);
    assert!(cut.losses[0].what.contains("last packet is truncated"), "{:?}", cut.losses);
    text = text.replacen("<RSol", "<RSol <", 1).replacen("</Rob>", "", 1);
    let log = plain(text.as_bytes());
    assert_eq!((topic(&log, "RIst").messages, log.losses[0].messages), (39, Some(1)));
    let hostile = format!("{}{}", packet(0), "<Rob ".repeat(100_000));
    let _ = read(hostile.as_bytes(), ColumnSettings::default());
}

/// TensorFlow's framing.
pub(super) fn framed(record: &[u8]) -> Vec<u8> {
    let masked = |bytes: &[u8]| {
        crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
    };
    let length = (record.len() as u64).to_le_bytes();
    [&length, masked(&length).as_slice(), record, &masked(record)].concat()
}

/// Bytes in Protobuf wire format.
fn field(number: u8, content: &[u8]) -> Vec<u8> {
    let mut all = vec![number << 3 | 2];
    let mut length = content.len();
    while length > 127 {
        all.push((length & 127) as u8 | 128);
        length >>= 7;
    }
    all.push(length as u8);
    all.extend(content);
    all
}

pub(crate) fn example(features: &[(&str, Vec<f32>)]) -> Vec<u8> {
    let of = |(name, numbers): &(&str, Vec<f32>)| {
        let packed: Vec<u8> = numbers.iter().flat_map(|number| number.to_le_bytes()).collect();
        let feature = field(2, &field(1, &packed));
        field(1, &[field(1, name.as_bytes()), field(2, &feature)].concat())
    };
    field(1, &features.iter().flat_map(of).collect::<Vec<u8>>())
}

#[test]
fn an_invalid_declared_rate_is_rejected() {
    let with_rate = |rate_hz: f32| {
        let joints: Vec<f32> = (0..160).flat_map(joints_of).map(|value| value as f32).collect();
        let reward = ("steps/reward", vec![0.5; 160]);
        framed(&example(&[("steps/joint_positions", joints), reward, ("fps", vec![rate_hz])]))
    };
    assert_eq!(topic(&plain(&with_rate(0.5)), "joint_positions").messages, 160);
    for rate_hz in [1e-38, 1e-9, 1e30, 0.0, -1.0, f32::NAN, f32::INFINITY] {
        let line = refusal(&with_rate(rate_hz));
        assert!(line.contains("the metadata has no rate"), "{rate_hz}: {line}");
    }
}

pub(super) fn joints_of(row: usize) -> Vec<f64> {
    (0..6).map(|joint| (0.05 * row as f64 + f64::from(joint)).sin() + 0.001).collect()
}

pub(super) fn zipped(files: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        archive.start_file(name, SimpleFileOptions::default()).expect("a member");
        archive.write_all(content).expect("its bytes");
    }
    archive.finish().expect("an archive").into_inner()
}

/// `rows` and `width` are only declared.
pub(super) fn array_of_numpy(
    rows: usize,
    width: usize,
    values: impl Iterator<Item = f64>,
) -> Vec<u8> {
    let header =
        format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({rows}, {width}), }}\n");
    super::npy(&header, &values.flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
}

/// Container, name of the joints, and file.
type Made = (&'static str, &'static str, Vec<u8>);

/// A table in each container. Rows with `is_lost` are missing or damaged in the way typical of the
/// container. `numbers` are the joint positions of a row.
fn with_lost_rows(
    rows: usize,
    is_lost: &[bool],
    numbers: impl Fn(usize) -> Vec<f64> + Copy,
) -> Vec<Made> {
    let lost = |row: usize| is_lost.get(row).copied().unwrap_or(false);
    let time = |row: usize| 0.01 * row as f64;
    let floats =
        |row: usize| numbers(row).into_iter().map(|value| value as f32).collect::<Vec<f32>>();
    let csv: String = (0..rows)
        .map(|row| {
            let time = if lost(row) { String::new() } else { format!("{:.3}", time(row)) };
            let cells: Vec<String> =
                numbers(row).iter().map(|value| format!("{value:.6}")).collect();
            format!("{time},{}\n", cells.join(","))
        })
        .collect();
    let csv = format!("t,q1,q2,q3,q4,q5,q6\n{csv}");
    let rsi: String = (0..rows)
        .map(|row| {
            let mut packet = packet(row as u32);
            if numbers(row).iter().any(|value| value.is_nan()) {
                packet = packet.replace(&format!("A1=\"{row}.5\""), "A1=\"nan\"");
            }
            if lost(row) { packet.replace("<RIst", "<RIst <") } else { packet }
        })
        .collect();
    let steps: Vec<u8> = (0..rows)
        .flat_map(|row| {
            let mut numbers = floats(row);
            numbers.truncate(if lost(row) { 5 } else { 6 });
            framed(&example(&[("joint_positions", numbers), ("timestamp", vec![time(row) as f32])]))
        })
        .collect();
    let metadata = json!({"zarr_format": 2, "shape": [rows, 6], "chunks": [1, 6], "dtype": "<f8", "compressor": null,
            "filters": null, "fill_value": 0.0, "order": "C"});
    let mut store = vec![
        (".zgroup".to_owned(), br#"{"zarr_format": 2}"#.to_vec()),
        (".zattrs".to_owned(), br#"{"fps": 100}"#.to_vec()),
        ("joint_positions/.zarray".to_owned(), metadata.to_string().into_bytes()),
    ];
    store.extend((0..rows).filter(|row| !lost(*row)).map(|row| {
        let bytes: Vec<u8> = numbers(row).into_iter().flat_map(f64::to_le_bytes).collect();
        (format!("joint_positions/{row}.0"), bytes)
    }));
    // Without chunks, an array lacks its last rows.
    let kept = rows - (0..rows).filter(|row| lost(*row)).count();
    let archive = zipped(&[
        ("timestamp.npy".to_owned(), array_of_numpy(rows, 1, (0..rows).map(time))),
        ("joint_positions.npy".to_owned(), array_of_numpy(rows, 6, (0..kept).flat_map(numbers))),
    ]);
    let of_hdf5 = hdf5(
        &[
            DataSet {
                name: "timestamp",
                width: 1,
                values: (0..rows).map(time).collect(),
                is_chunked: false,
                missing: &[],
            },
            DataSet {
                name: "joint_positions",
                width: 6,
                values: (0..rows).flat_map(numbers).collect(),
                is_chunked: true,
                missing: is_lost,
            },
        ],
        &[],
    );
    vec![
        ("csv", "q", csv.into_bytes()),
        ("rsi", "AIPos", rsi.into_bytes()),
        ("tfrecord", "joint_positions", steps),
        ("zarr", "joint_positions", zipped(&store)),
        ("parquet", "joint_positions", super::lists_of_parquet(rows, numbers, lost)),
        ("npz", "joint_positions", archive),
        ("hdf5", "joint_positions", of_hdf5),
    ]
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(24))]

    #[test]
    fn rows_in_a_file_are_rows_of_the_log_and_rows_reported(
        rows in 40_usize..90,
        lost in proptest::collection::vec(proptest::bool::weighted(0.1), 90),
    ) {
        // The first and last rows set the start of the times and the value before a missing chunk.
        let lost: Vec<bool> = lost.into_iter().enumerate().map(|(row, lost)| lost && row > 1 && row + 2 < rows).collect();
        let count = lost.iter().filter(|lost| **lost).count() as u64;
        // Many gaps would mean a lower rate.
        proptest::prop_assume!(5 * count < rows as u64);
        for (container, name, bytes) in with_lost_rows(rows, &lost, joints_of) {
            let log = plain(&bytes);
            let reported: u64 = log.losses.iter().filter_map(|loss| loss.messages).sum();
            proptest::prop_assert_eq!(topic(&log, name).messages, rows as u64 - count, "{}", container);
            proptest::prop_assert_eq!(reported, count, "{}: {:?}", container, log.losses);
        }
    }

    #[test]
    fn rows_with_damaged_numbers_are_reported(
        rows in 80_usize..120,
        damaged in proptest::collection::vec(proptest::bool::weighted(0.03), 120),
    ) {
        let is_damaged = |row: usize| row > 1 && row + 2 < rows && damaged[row];
        let count = (0..rows).filter(|row| is_damaged(*row)).count() as u64;
        // Many gaps would mean a lower rate.
        proptest::prop_assume!(10 * count < rows as u64);
        let numbers = |row: usize| {
            let mut own = joints_of(row);
            own[0] = if is_damaged(row) { f64::NAN } else { own[0] };
            own
        };
        for (container, name, bytes) in with_lost_rows(rows, &[], numbers) {
            let log = plain(&bytes);
            let reported: u64 = log.losses.iter().filter_map(|loss| loss.messages).sum();
            proptest::prop_assert_eq!(topic(&log, name).messages, rows as u64 - count, "{}", container);
            proptest::prop_assert_eq!(reported, count, "{}: {:?}", container, log.losses);
        }
    }
}

/// Written by `scipy.io.savemat`: `t` of 1 by 20, and a struct `log` with `q` of 6 by 20, `tcp_pose` of 4 by 4 by 20, text
/// and a mode; and a cell array.
const VARIABLES: [&[u8]; 2] = [
    include_bytes!("../fixtures/variables.mat"),
    include_bytes!("../fixtures/variables_compressed.mat"),
];

#[test]
fn variables_of_matlab_are_arrays_and_fields_of_structs_are_paths() {
    for file in VARIABLES {
        let log = plain(file);
        let (_, rows) = joints(&log, "log/q");
        assert_eq!((rows.len(), rows[3].len()), (20, 6));
        assert!((rows[3][5] - 0.053).abs() < 1e-12, "{:?}", rows[3]);
        assert_eq!(stamps(&log, "log/q")[5], 50_000_000);
        let (width, poses) = array(&log, "log/tcp_pose");
        assert_eq!(width, 16);
        // By columns.
        assert!((poses[16 * 7 + 12] - 0.7).abs() < 1e-12 && poses[16 * 7 + 15] == 1.0);
        for (name, why) in [("log/note", "text"), ("gains", "a cell array")] {
            assert!(
                topic(&log, name).read_as.as_ref().is_some_and(|own| own.contains(why)),
                "{name}"
            );
        }
    }
}

/// Written by `scipy.io.savemat`: two cells with a struct of `Time` and `q` of 6 by 18 and 20; an array of 20 structs with
/// `t` and `q`; and six cells of `q` next to `t` and six parameters per joint.
const ELEMENTS: [(&str, &[u8]); 3] = [
    ("Data/q", include_bytes!("../fixtures/cells_of_runs.mat")),
    ("sample/q", include_bytes!("../fixtures/structs_of_rows.mat")),
    ("q", include_bytes!("../fixtures/cells_of_joints.mat")),
];

#[test]
fn elements_of_matlab_are_episodes_rows_or_columns() {
    for (name, file) in ELEMENTS {
        let log = plain(file);
        let (_, rows) = joints(&log, name);
        let count = if name == "Data/q" { 38 } else { 20 };
        assert_eq!((rows.len(), rows[3].len()), (count, 6), "{name}");
        assert!((rows[3][5] - 0.035).abs() < 1e-12, "{name}: {:?}", rows[3]);
        assert_eq!(stamps(&log, name)[5], 50_000_000, "{name}");
    }
    let (_, rows) = joints(&plain(ELEMENTS[0].1), "Data/q");
    assert!((rows[18 + 3][5] - 1.035).abs() < 1e-12, "{:?}", rows[21]);
}

/// A variable of MAT-file level 5, or a field without a name.
fn matlab_matrix(name: &str, class: u32, sides: [u32; 2], content: &[u8]) -> Vec<u8> {
    let words =
        |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    let body = [
        &matlab_element(6, &words(&[class, 0]))[..],
        &matlab_element(5, &words(&sides)),
        &matlab_element(1, name.as_bytes()),
        content,
    ];
    matlab_element(14, &body.concat())
}

fn matlab_element(kind: u32, data: &[u8]) -> Vec<u8> {
    let tag = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
    let mut element = [&tag, data].concat();
    element.resize(8 + data.len().next_multiple_of(8), 0);
    element
}

fn matlab_numbers(name: &str, sides: [u32; 2], values: &[f64]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
    matlab_matrix(name, 6, sides, &matlab_element(9, &bytes))
}

#[test]
fn a_period_of_an_episode_of_matlab_is_its_own() {
    const ROWS: u32 = 20;
    let demo = |dt: f64| {
        let t: Vec<f64> = (0..ROWS).map(|row| dt * f64::from(row)).collect();
        let q: Vec<f64> = (0..6 * ROWS).map(|at| 0.01 * f64::from(at)).collect();
        [
            matlab_numbers("", [1, ROWS], &t),
            matlab_numbers("", [6, ROWS], &q),
            matlab_numbers("", [1, 1], &[dt]),
        ]
        .concat()
    };
    let fields = b"t\0\0\0q\0\0\0dt\0\0";
    let demos = [
        matlab_element(5, &4_u32.to_le_bytes()),
        matlab_element(1, fields),
        demo(0.02),
        demo(0.04),
    ];
    let mut file = b"MATLAB 5.0 MAT-file".to_vec();
    file.resize(126, b' ');
    file.extend(b"IM");
    file.extend(matlab_numbers("dt", [1, 1], &[0.03]));
    file.extend(matlab_matrix("demos", 2, [1, 2], &demos.concat()));
    let log = plain(&file);
    assert_eq!(joints(&log, "demos/q").1.len(), 40);
    assert_eq!(log.contradictions, Some(Vec::new()));
}

#[test]
fn truncated_and_changed_files_of_matlab_are_one_line_or_losses() {
    for (_, file) in ELEMENTS {
        for end in (0..file.len()).step_by(29) {
            let _ = read(&file[..end], ColumnSettings::default());
            let mut changed = file.to_vec();
            changed[end] ^= 0xff;
            let _ = read(&changed, ColumnSettings::default());
        }
    }
    for file in VARIABLES {
        for end in (0..file.len()).step_by(61) {
            let _ = read(&file[..end], ColumnSettings::default());
            let mut changed = file.to_vec();
            changed[end] ^= 0xff;
            let _ = read(&changed, ColumnSettings::default());
        }
        let cut = read(&file[..file.len() - 40], ColumnSettings::default()).expect("the rest");
        assert!(cut.losses.iter().any(|loss| loss.what.contains("variable")), "{:?}", cut.losses);
    }
}

#[test]
fn episodes_in_the_groups_of_people_are_episodes() {
    let wave = |from: usize, rows: usize| (from..from + rows).map(|at| (0.02 * at as f64).sin());
    let time = |rows: usize| (0..rows).map(|row| 0.01 * row as f64).collect::<Vec<f64>>();
    let names = ["user1/demo1", "user1/demo2", "user2/demo1"];
    let paths = names.map(|name| [format!("{name}/time"), format!("{name}/joint_positions")]);
    let mut sets = Vec::new();
    for (at, [of_times, of_joints]) in paths.iter().enumerate() {
        let rows = 60 + 20 * at;
        let set =
            |name, width, values| DataSet { name, width, values, is_chunked: false, missing: &[] };
        sets.push(set(of_times.as_str(), 1, time(rows)));
        sets.push(set(of_joints.as_str(), 6, wave(at, 6 * rows).collect()));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("demos.h5");
    fs::write(&path, hdf5(&sets, &[])).expect("a file");
    assert_eq!(crate::episodes(&path), names);
    let log = open(&[path], &ReadOptions::default()).expect("a log");
    assert_eq!(joints(&log, "joint_positions").1.len(), 60 + 80 + 100);
}
