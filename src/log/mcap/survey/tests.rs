use std::collections::BTreeMap;

use mcap::{Compression, WriteOptions};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::mcap::tests::{chunks, poses, read_present, with_images};
use crate::ranges::Ranges;
use crate::testing::{self, Cdr, LogWriter};
use crate::{Log, Loss, Topic};

/// Bytes that were not requested have the value `hole`.
fn fetched(bytes: &[u8], hole: u8) -> (Vec<u8>, Present, usize) {
    let mut file = vec![hole; bytes.len()];
    let mut present = Ranges::default();
    let magic = 0..bytes.len().min(MAGIC.len());
    let whole = 0..bytes.len();
    let mut parts = vec![magic];
    loop {
        for part in &parts {
            file[part.clone()].copy_from_slice(&bytes[part.clone()]);
        }
        present.extend(Ranges::new(parts, 0));
        let there = Present::from_ranges(present.clone(), bytes.len());
        if there == Present::Whole {
            return (file, there, bytes.len());
        }
        parts = match survey(&file, &there) {
            Survey::Nothing => return (file, there, present.bytes()),
            Survey::Parts(parts) => parts,
            Survey::Rest => vec![whole.clone()],
        };
        let asked = Ranges::new(parts.clone(), 0);
        assert!(present.missing(&asked).bytes() > 0, "requested again: {asked:?}");
    }
}

fn read(bytes: &[u8], present: &Present) -> Log {
    read_present(bytes, present, ReadOptions::default()).expect("all needed ranges are present")
}

fn topic<'l>(log: &'l Log, name: &str) -> Option<&'l Topic> {
    log.topics.iter().find(|topic| topic.name == name)
}

fn mixed(compression: Option<Compression>) -> Vec<u8> {
    let mut log =
        LogWriter::with(WriteOptions::new().compression(compression).chunk_size(Some(100_000)));
    let pose = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    for time in 0..400 {
        let message = Cdr::pose_stamped(0, time as u32, "base", [time as f64, 0.5, 0.25]);
        log.message(pose, time, &message);
        if time % 100 == 50 {
            log.channel(&format!("/late/{time}"), "std_msgs/msg/String", "string data\n");
        }
        if time % 10 == 9 {
            let camera = log.channel("/camera", "sensor_msgs/msg/Image", "uint8[] data\n");
            log.message(camera, time, &vec![time as u8; 20_000]);
        }
    }
    let metadata = BTreeMap::from([("key".to_owned(), "value".to_owned())]);
    let metadata = mcap::records::Metadata { name: "of the run".to_owned(), metadata };
    log.writer().write_metadata(&metadata).unwrap();
    log.finish()
}

#[test]
fn fetched_parts_give_the_same_log_as_the_whole_file() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        for bytes in
            [poses(LogWriter::new(compression)), with_images(compression), mixed(compression)]
        {
            let whole = read(&bytes, &Present::Whole);
            for hole in [0, 0x05, 0x06, 0xa5, 0xff] {
                let (file, present, _) = fetched(&bytes, hole);
                assert_eq!(read(&file, &present), whole, "{compression:?}, holes of {hole:#x}");
            }
        }
    }
}

#[test]
fn unused_messages_are_not_fetched() {
    let share = |bytes: &[u8]| fetched(bytes, 0).2 as f64 / bytes.len() as f64;
    assert!(share(&mixed(None)) < 0.1, "{}", share(&mixed(None)));
    assert!(share(&with_images(None)) < 0.5);
    // In a compressed chunk, messages can only be read in order.
    assert_eq!(fetched(&mixed(Some(Compression::Zstd)), 0).1, Present::Whole);
}

#[test]
fn a_file_without_an_index_is_fetched_whole() {
    let unindexed = LogWriter::with(WriteOptions::new().emit_message_indexes(false));
    let unchunked = LogWriter::with(WriteOptions::new().use_chunks(false));
    let mut cut = mixed(None);
    cut.truncate(cut.len() * 2 / 3);
    for bytes in [poses(unindexed), poses(unchunked), cut, MAGIC.to_vec(), b"\x89MCA".to_vec()] {
        assert_eq!(fetched(&bytes, 0).1, Present::Whole, "{} bytes", bytes.len());
    }
}

#[test]
fn a_channel_defined_within_a_chunk_is_read() {
    let mut log = LogWriter::with(WriteOptions::new().compression(None));
    let camera = log.channel("/camera", "sensor_msgs/msg/Image", "uint8[] data\n");
    let schema = log.writer().add_schema(
        "geometry_msgs/msg/PoseStamped",
        "ros2msg",
        testing::POSE_STAMPED.as_bytes(),
    );
    for time in 0..10 {
        log.message(camera, time, &vec![7; 5000]);
    }
    let pose = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    log.message(pose, 10, &Cdr::pose_stamped(0, 10, "base", [1.0, 0.5, 0.25]));
    assert!(schema.is_ok());
    let bytes = log.finish();
    let (file, present, _) = fetched(&bytes, 0xa5);
    assert_ne!(present, Present::Whole);
    assert_eq!(read(&file, &present), read(&bytes, &Present::Whole));
}

#[test]
fn unfetched_ranges_are_never_read_as_damage() {
    let mut random = Pcg64::seed_from_u64(1);
    let mut sparse = 0;
    for bytes in [mixed(None), with_images(None), with_images(Some(Compression::Zstd))] {
        let ends: Vec<usize> =
            chunks(&bytes).into_iter().chain([bytes.len() - record::Footer::SIZE - 8]).collect();
        for _ in 0..300 {
            let mut damaged = bytes.clone();
            for _ in 0..1 + random.next_u32() % 3 {
                let any = random.next_u32() as usize % bytes.len();
                let near = ends[random.next_u32() as usize % ends.len()] + any % 200;
                let at = if random.next_u32() % 2 == 0 { any } else { near.min(bytes.len() - 1) };
                damaged[at] = random.next_u32() as u8;
            }
            let (file, present, _) = fetched(&damaged, 0);
            sparse += u32::from(present != Present::Whole);
            let whole = read(&damaged, &Present::Whole);
            let log = read(&file, &present);
            // Damage to skipped ranges is not detected. Of a damaged chunk, the decompressor may find another part first.
            let is_known = |loss: &&Loss| {
                let with_its_text =
                    |other: &Loss| Loss { what: loss.what.clone(), ..other.clone() };
                whole.losses.iter().any(|other| with_its_text(other) == **loss)
            };
            let unknown: Vec<_> = log.losses.iter().filter(|loss| !is_known(loss)).collect();
            assert!(unknown.is_empty(), "{unknown:?} but not {:?}", whole.losses);
            if log.losses.len() == whole.losses.len() {
                assert_eq!(topic(&log, "/pose"), topic(&whole, "/pose"));
            }
        }
    }
    assert!(sparse > 300, "only {sparse} files were read in parts");
}

#[test]
fn absent_bytes_are_refused() {
    let bytes = mixed(None);
    let (file, present, _) = fetched(&bytes, 0);
    let Present::Parts(ranges) = &present else { panic!("in parts") };
    for piece in ranges.pieces(usize::MAX) {
        let rest = ranges.pieces(usize::MAX).filter(|other| *other != piece).collect();
        let present = Present::Parts(Ranges::new(rest, 0));
        let mut file = file.clone();
        file[piece.clone()].fill(0);
        let read = read_present(&file, &present, ReadOptions::default());
        assert!(read.is_err(), "{piece:?} is missing, but the file is read");
    }
}
