//! Limits listed in SECURITY.md.

use std::time::{Duration, Instant};

use serde_json::json;

use super::hdf5_writer::{DataSet, hdf5};
use super::stores::{array_of_numpy, example, framed, joints_of, packet, store, zipped};
use super::{plain, read, refusal, topic};
use crate::{ColumnSettings, Log, LogError};

fn lost(log: &Log) -> String {
    log.losses.iter().map(|loss| format!("{}\n", loss.what)).collect()
}

#[test]
fn more_than_2000_columns_are_a_loss() {
    let times = || (0..3).map(|row| 0.01 * f64::from(row));
    let numbers = || [0.5, 0.25, 0.75].into_iter();
    let mut files = vec![("timestamp.npy".to_owned(), array_of_numpy(3, 1, times()))];
    files.extend(
        (1..2001).map(|number| (format!("z{number}.npy"), array_of_numpy(3, 1, numbers()))),
    );
    assert!(lost(&plain(&zipped(&files))).contains("2001 arrays; only 2000 are read"));
    let metadata = json!({"zarr_format": 2, "shape": [3, 1], "chunks": [3, 1], "dtype": "<f8",
        "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"});
    let mut files = vec![
        (".zgroup".to_owned(), br#"{"zarr_format": 2}"#.to_vec()),
        (".zattrs".to_owned(), br#"{"fps": 10}"#.to_vec()),
    ];
    for number in 0..2001 {
        files.push((format!("z{number:04}/.zarray"), metadata.to_string().into_bytes()));
        files.push((format!("z{number:04}/0.0"), numbers().flat_map(f64::to_le_bytes).collect()));
    }
    assert!(lost(&plain(&zipped(&files))).contains("more than 2000 arrays"));
}

#[test]
fn rows_of_more_than_256_numbers_are_images() {
    let archive = |width: usize| {
        let rows = 20;
        let numbers = (0..rows * width).map(|at| (at as f64).sin());
        plain(&zipped(&[
            (
                "timestamp.npy".to_owned(),
                array_of_numpy(rows, 1, (0..20).map(|row| 0.01 * f64::from(row))),
            ),
            ("q.npy".to_owned(), array_of_numpy(rows, 6, (0..rows).flat_map(joints_of))),
            ("wide.npy".to_owned(), array_of_numpy(rows, width, numbers)),
        ]))
    };
    assert!(topic(&archive(256), "wide").columns.is_some());
    let wider = archive(257);
    let wide = topic(&wider, "wide");
    assert!(
        wide.columns.is_none() && wide.read_as.as_deref().is_some_and(|it| it.contains("images"))
    );
}

#[test]
fn more_than_100_episodes_are_not_one_audit() {
    let episode = || {
        let joints: Vec<f32> = (0..20).flat_map(joints_of).map(|value| value as f32).collect();
        let reward = ("steps/reward", vec![0.5; 20]);
        framed(&example(&[("steps/joint_positions", joints), reward, ("fps", vec![20.0])]))
    };
    let file = |count: usize| read(&episode().repeat(count), ColumnSettings::default());
    assert_eq!(topic(&file(100).expect("a log"), "joint_positions").messages, 2000);
    assert!(matches!(file(102), Err(LogError::Episodes { most: 100, .. })));
}

#[test]
fn metadata_of_more_than_4_mib_are_refused() {
    let with_padding = |bytes: usize| {
        zipped(&[
            (".zgroup".to_owned(), br#"{"zarr_format": 2}"#.to_vec()),
            (".zattrs".to_owned(), br#"{"fps": 10}"#.to_vec()),
            ("q/.zarray".to_owned(), {
                let mut metadata =
                    json!({"zarr_format": 2, "shape": [2, 1], "chunks": [2, 1], "dtype": "<f8",
                    "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"})
                    .to_string()
                    .into_bytes();
                metadata.resize(bytes, b' ');
                metadata
            }),
            ("q/0.0".to_owned(), [1.5_f64, 2.5].iter().flat_map(|it| it.to_le_bytes()).collect()),
        ])
    };
    assert_eq!(topic(&plain(&with_padding(1000)), "q").messages, 2);
    let line = refusal(&with_padding(5 << 20));
    assert!(line.contains("exceeds its limit"), "{line}");
}

#[test]
fn more_than_16_codecs_of_an_array_are_refused() {
    let with_filters = |count: usize| {
        store(|metadata| metadata["filters"] = vec![json!({"id": "zlib"}); count].into())
    };
    let line = refusal(&with_filters(17));
    assert!(line.contains("more than 16 codecs"), "{line}");
    assert!(!refusal(&with_filters(16)).contains("more than 16 codecs"));
}

#[test]
fn the_search_for_missing_chunks_ends() {
    const ROWS: usize = 200_000;
    let metadata = json!({"zarr_format": 2, "shape": [ROWS, 6], "chunks": [1, 6], "dtype": "<f8",
        "compressor": null, "filters": null, "fill_value": 0.0, "order": "C"});
    let mut files = vec![
        (".zgroup".to_owned(), br#"{"zarr_format": 2}"#.to_vec()),
        (".zattrs".to_owned(), br#"{"fps": 100}"#.to_vec()),
        ("joint_positions/.zarray".to_owned(), metadata.to_string().into_bytes()),
    ];
    files.extend([0, 1, 2, ROWS - 2, ROWS - 1].map(|row| {
        let bytes = joints_of(row).into_iter().flat_map(f64::to_le_bytes).collect();
        (format!("joint_positions/{row}.0"), bytes)
    }));
    let log = plain(&zipped(&files));
    let read = topic(&log, "joint_positions").messages;
    let reported: u64 = log.losses.iter().filter_map(|loss| loss.messages).sum();
    assert_eq!((read, read + reported), (3, ROWS as u64), "{}", lost(&log));
}

#[test]
fn groups_of_hdf5_that_contain_themselves_are_visited_once() {
    let set = |name: &'static str, width: usize, values: Vec<f64>| DataSet {
        name,
        width,
        values,
        is_chunked: false,
        missing: &[],
    };
    let names: Vec<String> = (0..30).map(|number| format!("loop{number}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let sets = [
        set("timestamp", 1, (0..20).map(|row| 0.01 * f64::from(row)).collect()),
        set("joint_positions", 6, (0..20).flat_map(joints_of).collect()),
    ];
    let begin = Instant::now();
    let log = plain(&hdf5(&sets, &names));
    assert_eq!(topic(&log, "joint_positions").messages, 20);
    assert_eq!(log.topics.len(), 1);
    // Without a set of visited groups: 30⁸ visits.
    assert!(begin.elapsed() < Duration::from_secs(10));
}

#[test]
fn a_packet_of_rsi_of_more_than_64_kib_is_lost() {
    let long =
        |bytes: usize| packet(20).replace("<Delay", &format!("<!--{}--><Delay", "x".repeat(bytes)));
    let text = |middle: &str| {
        let packets = (0..40).map(|row| if row == 20 { middle.to_owned() } else { packet(row) });
        plain(packets.collect::<String>().as_bytes())
    };
    assert_eq!(topic(&text(&long(60_000)), "AIPos").messages, 40);
    let log = text(&long(70_000));
    assert_eq!(topic(&log, "AIPos").messages, 39);
    assert_eq!(log.losses[0].messages, Some(1), "{}", lost(&log));
}

#[test]
fn a_line_of_text_of_more_than_1_mib_is_lost() {
    let row = |row: usize| {
        let cells: Vec<String> = joints_of(row).iter().map(|value| format!("{value:.6}")).collect();
        format!("{:.2},{}\n", 0.01 * row as f64, cells.join(","))
    };
    let rows: Vec<String> = (0..40).map(row).collect();
    let long = format!("{}{}", ",".repeat(1 << 20), rows[20]);
    let text = format!("t,q1,q2,q3,q4,q5,q6\n{}{long}{}", rows[..20].concat(), rows[20..].concat());
    let log = plain(text.as_bytes());
    assert_eq!(topic(&log, "q").messages, 40);
    assert!(lost(&log).contains("line 22 has 1048"), "{}", lost(&log));
}
