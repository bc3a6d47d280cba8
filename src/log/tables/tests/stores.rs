//! Stores of arrays, records and packets: what other people's writers write, cut, and declared otherwise.

use std::fs;
use std::io::{Cursor, Write};
use std::path::Path;

use serde_json::json;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use super::{array, joints, plain, read, refusal, stamps, topic};
use crate::{ColumnSettings, Log, ReadOptions, open};

/// By zarr-python 3.1: the same 200 rows of 6 numbers in many packings, two episodes, 50 rows a second.
const SECOND: &[u8] = include_bytes!("../fixtures/codecs_v2.zarr.zip");
const THIRD: &[u8] = include_bytes!("../fixtures/codecs_v3.zarr.zip");
/// Read as TensorFlow's by the package `tfrecord`: episodes of 20 and of 30 steps.
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
fn every_packing_of_a_store_holds_the_same_numbers() {
    let log = plain(SECOND);
    assert_same_rows(&log, 13);
    let stamps = stamps(&log, "raw");
    assert_eq!((stamps[1] - stamps[0], stamps[80]), (20_000_000, stamps[0]));
    let third = plain(THIRD);
    assert_same_rows(&third, 5);
    // No chunk was written of what is all zeros.
    assert_eq!(array(&third, "zeros"), (6, vec![0.0; 1200]));
}

#[test]
fn a_folder_is_read_as_its_archive() {
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
        assert_eq!(log, own);
        assert_eq!(crate::episodes(folder.path()), ["0", "1"]);
        let second = Path::new(&format!("{}#1", folder.path().display())).to_owned();
        assert_eq!(of_folder(&second).expect("an episode").topics[0].messages, 120);
    }
}

/// A store with one array `q` of 6 numbers a row, whose metadata are `change`d.
fn store(change: impl Fn(&mut serde_json::Value)) -> Vec<u8> {
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
fn what_a_store_declares_and_does_not_hold_is_one_line() {
    assert_eq!(joints(&plain(&store(|_| ())), "q").1.len(), 20);
    let change = |name: &'static str, value: serde_json::Value| {
        refusal(&store(move |metadata| metadata[name] = value.clone()))
    };
    for (name, value, said) in [
        ("shape", json!([1_000_000_000, 6]), "more than 268435456 numbers"),
        ("shape", json!([10_000_000, 6]), "are in no chunk"),
        ("shape", json!([u64::MAX, 6]), "no chunks that can be"),
        ("chunks", json!([200_000_000, 6]), "200000000"),
        ("chunks", json!([0, 6]), "no chunks that can be"),
        ("chunks", json!([20]), "no chunks that can be"),
        ("chunks", json!([30, 6]), "a chunk has 960 bytes"),
        ("compressor", json!({"id": "lzma"}), "codec 'lzma' is not read"),
        ("compressor", json!({"id": "blosc"}), "a chunk"),
        ("compressor", json!({"id": "zstd"}), "a chunk cannot be unpacked"),
        ("compressor", json!({"id": "lz4"}), "a chunk"),
        ("dtype", json!("|O"), "no arrays of numbers"),
    ] {
        let line = change(name, value);
        assert!(line.contains(said), "{name}: {line}");
    }
}

#[test]
fn damaged_stores_and_records_are_one_line() {
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
fn blosc_that_is_damaged_is_refused() {
    // A header of version 2 with one block, and lengths that reach beyond the chunk.
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
    // The rate is in the episode's metadata.
    let stamps = stamps(&log, "observation/tcp_pose");
    assert_eq!(stamps[1] - stamps[0], 100_000_000);
    assert!(log.topics.iter().all(|topic| !topic.name.contains("image")));
}

#[test]
fn what_features_declare_is_held_against_the_records() {
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
    assert!(found.len() == 1 && found[0].contains("with 7 numbers a row and has 6"), "{found:?}");
    // As the template of RLDS datasets has it.
    let found =
        declared("6", "Robot state, consists of [7x robot joint angles, 2x gripper position].");
    assert!(
        found.len() == 2 && found[0].contains("7 + 2 = 9 numbers a row and has 6"),
        "{found:?}"
    );
    let named = Path::new(&format!("{}#1", path.display())).to_owned();
    assert_eq!(of_folder(&named).expect("an episode").messages % 30, 0);
}

#[test]
fn a_record_that_is_damaged_does_not_take_the_others_with_it() {
    let mut bytes = RECORDS.to_vec();
    bytes[600] ^= 1;
    let log = plain(&bytes);
    assert_eq!(topic(&log, "observation/tcp_pose").messages, 30);
    assert!(log.losses[0].what.contains("record 0: its checksum does not hold"));
    let cut = plain(&RECORDS[..RECORDS.len() - 1]);
    assert_eq!(topic(&cut, "observation/tcp_pose").messages, 20);
    assert!(cut.losses[0].what.contains("ends within a record"));
}

/// A packet of KUKA's: pose and axes by its number.
fn packet(number: u32) -> String {
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
fn packets_of_kuka_are_rows_however_they_stand() {
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
fn packets_that_are_damaged_are_counted() {
    let whole: Vec<String> = (0..40).map(packet).collect();
    let mut text = whole.join("\n");
    let cut = plain(&text.as_bytes()[..text.len() - 20]);
    assert_eq!(topic(&cut, "RIst").messages, 39);
    assert!(cut.losses[0].what.contains("last packet is cut off"), "{:?}", cut.losses);
    text = text.replacen("<RSol", "<RSol <", 1).replacen("</Rob>", "", 1);
    let log = plain(text.as_bytes());
    assert_eq!((topic(&log, "RIst").messages, log.losses[0].messages), (39, Some(1)));
    let hostile = format!("{}{}", packet(0), "<Rob ".repeat(100_000));
    let _ = read(hostile.as_bytes(), ColumnSettings::default());
}
