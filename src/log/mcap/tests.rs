use std::borrow::Cow;
use std::io;
use std::path::Path;
use std::time::{Duration, Instant};

use mcap::{Compression, WriteOptions};

use super::super::mapped::MappedFile;
use super::super::testing::{self, Cdr, LogWriter};
use super::super::unpack::UnpackBudget;
use super::super::{Container, Log, LogFile, Loss};
use super::*;
use ground::stream::{Columns, PoseColumns};
use ground::time::{Clock, Stamp};

const MESSAGES: u64 = 100;

pub(super) fn poses(mut log: LogWriter) -> Vec<u8> {
    let channel = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    for time in 0..MESSAGES {
        let message = Cdr::pose_stamped(0, time as u32, "base", [time as f64, 0.5, 0.25]);
        log.message(channel, time, &message);
    }
    log.finish()
}

fn read_with(bytes: &[u8], options: ReadOptions) -> Log {
    read_present(bytes, &Present::Whole, options).unwrap()
}

pub(super) fn read_present(
    bytes: &[u8],
    present: &Present,
    options: ReadOptions,
) -> Result<Log, MissingByte> {
    let (path, mut intake) = (Path::new("run.mcap"), Intake::default());
    let mut losses = Losses::new(path);
    intake.begin_file(path, bytes.len() as u64);
    let crc = read(bytes, present, &options, &mut losses, &mut intake)?;
    intake.losses(losses);
    let bytes = bytes.len() as u64;
    let container = Container::Mcap;
    let path = path.to_owned();
    Ok(intake.finish(vec![LogFile { path, container, bytes, fetched: None, crc }]))
}

fn read_all(bytes: &[u8]) -> Log {
    read_with(bytes, ReadOptions { verify: true, ..ReadOptions::default() })
}

fn rows(log: &Log) -> &PoseColumns {
    match log.topics[0].columns.as_ref() {
        Some(Columns::Poses(poses)) => &poses[0],
        other => panic!("{other:?}"),
    }
}

fn lost(log: &Log) -> Vec<(Extent, Option<u64>)> {
    log.losses.iter().map(|loss| (loss.extent, loss.messages)).collect()
}

fn records(bytes: &[u8], opcode: u8) -> Vec<usize> {
    let frames = record::frames(bytes, MAGIC.len()).map_while(Result::ok);
    frames.filter(|frame| frame.opcode == opcode).map(|frame| frame.offset).collect()
}

pub(super) fn chunks(bytes: &[u8]) -> Vec<usize> {
    records(bytes, op::CHUNK)
}

#[test]
fn every_compression_gives_the_same_rows() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let log = read_all(&poses(LogWriter::new(compression)));
        assert_eq!(log.losses, []);
        assert_eq!(log.files[0].crc, Crc::All);
        assert_eq!(log.messages, MESSAGES);
        let topic = &log.topics[0];
        assert_eq!((topic.name.as_str(), topic.encoding.as_str()), ("/pose", "cdr"));
        assert_eq!(topic.type_name, "geometry_msgs/msg/PoseStamped");
        assert_eq!(topic.messages, MESSAGES);
        assert_eq!(
            rows(&log).times.nanos_on(Clock::Publish),
            (1..=MESSAGES as i64).collect::<Vec<_>>()
        );
        assert_eq!(rows(&log).xyz[99], [99.0, 0.5, 0.25]);
    }
}

/// Two images after every tenth pose; images fill separate chunks.
pub(super) fn with_images(compression: Option<Compression>) -> Vec<u8> {
    let mut log = LogWriter::new(compression);
    let pose = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    let camera = log.channel("/camera", "sensor_msgs/msg/Image", "uint8[] data\n");
    for time in 0..MESSAGES {
        let message = Cdr::pose_stamped(0, time as u32, "base", [time as f64, 0.5, 0.25]);
        log.message(pose, time, &message);
        if time % 10 == 9 {
            for _ in 0..2 {
                log.message(camera, time, &vec![time as u8; 5000]);
            }
        }
    }
    log.finish()
}

#[test]
fn images_are_counted_and_skipped() {
    for (compression, crc) in [(None, Crc::Partial), (Some(Compression::Zstd), Crc::Partial)] {
        let bytes = with_images(compression);
        for (verify, crc) in [(false, crc), (true, Crc::All)] {
            let log = read_with(&bytes, ReadOptions { verify, ..ReadOptions::default() });
            assert_eq!(log.losses, []);
            assert_eq!(log.files[0].crc, crc, "{compression:?}, verify {verify}");
            let [camera, pose] = log.topics.as_slice() else { panic!("two topics") };
            assert_eq!((camera.messages, pose.messages), (20, MESSAGES));
            let nanos = Stamp::from_nanos;
            assert_eq!(camera.span, Some((nanos(9), nanos(99))));
            assert_eq!(log.span, Some((nanos(0), nanos(99))));
            let Some(Columns::Poses(poses)) = &pose.columns else { panic!("poses") };
            assert_eq!(poses[0].times.len() as u64, MESSAGES);
            assert_eq!(poses[0].xyz[99], [99.0, 0.5, 0.25]);
        }
    }
}

#[test]
fn a_damaged_image_is_detected_with_full_verification() {
    for compression in [None, Some(Compression::Zstd)] {
        let mut bytes = with_images(compression);
        let images = chunks(&bytes).into_iter().find(|&chunk| {
            let behind = record::frame(&bytes, record::frame(&bytes, chunk).unwrap().end());
            let index = record::MessageIndex::parse(behind.unwrap().body);
            index.unwrap().channel_id == 2
        });
        let length = record::frame(&bytes, images.unwrap()).unwrap().body.len();
        bytes[images.unwrap() + length] ^= 0x55;
        let lost_with = |verify| {
            let log = read_with(&bytes, ReadOptions { verify, ..ReadOptions::default() });
            assert_eq!(log.topics[1].messages, MESSAGES);
            log.losses.iter().filter(|loss| loss.extent == Extent::Messages).count()
        };
        assert_eq!((lost_with(false), lost_with(true)), (0, 1), "{compression:?}");
    }
}

#[test]
fn files_without_chunks_or_index_give_the_same_rows() {
    let unchunked = WriteOptions::new().use_chunks(false);
    let bare = WriteOptions::new()
        .chunk_size(Some(512))
        .emit_summary_records(false)
        .emit_message_indexes(false)
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false);
    for (options, verify, crc) in [
        (unchunked.clone(), true, Crc::All),
        (unchunked, false, Crc::None),
        (bare, true, Crc::None),
    ] {
        let log = read_with(
            &poses(LogWriter::with(options)),
            ReadOptions { verify, ..ReadOptions::default() },
        );
        assert_eq!(log.losses, []);
        assert_eq!(rows(&log).times.len() as u64, MESSAGES);
        assert_eq!(log.files[0].crc, crc);
    }
}

#[test]
fn a_truncated_file_is_read_up_to_its_end() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let whole = poses(LogWriter::new(compression));
        let mut most = 0;
        for length in (MAGIC.len()..whole.len()).step_by(7) {
            let log = read_all(&whole[..length]);
            assert!(!log.losses.is_empty(), "cut at {length}");
            assert!(log.losses.iter().all(|loss| loss.extent != Extent::Messages), "{log:?}");
            assert!(log.messages >= most, "cut at {length}");
            most = log.messages;
            if log.messages > 0 {
                let expected: Vec<i64> = (0..log.messages as i64).collect();
                assert_eq!(rows(&log).times.header, expected, "cut at {length}");
            }
        }
        assert_eq!(most, MESSAGES);
    }
}

#[test]
fn messages_before_a_cut_within_a_chunk_are_salvaged() {
    let whole = poses(LogWriter::new(None));
    let [_, second, third, ..] = chunks(&whole)[..] else { panic!("chunks") };
    let before = read_all(&whole[..second]).messages;
    let log = read_all(&whole[..third - 200]);
    assert!(log.messages > before);
    let [Loss { offset, extent: Extent::Tail, what, .. }] = log.losses.as_slice() else {
        panic!("{:?}", log.losses)
    };
    assert_eq!(*offset, Some(second as u64));
    assert_eq!(
        *what,
        format!(
            "the file ends within a chunk; {} of its messages were read",
            log.messages - before
        )
    );
    assert_eq!(log.files[0].crc, Crc::Partial);
}

#[test]
fn a_corrupt_chunk_is_lost_alone_and_its_messages_are_counted() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let mut bytes = poses(LogWriter::new(compression));
        let chunks = chunks(&bytes);
        // The first chunk defines the channel.
        for &chunk in [chunks[0], chunks[2]].iter() {
            let damaged = chunk + 120;
            bytes[damaged] ^= 0x10;
            let log = read_all(&bytes);
            bytes[damaged] ^= 0x10;
            let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
            assert_eq!((loss.offset, loss.extent), (Some(chunk as u64), Extent::Messages));
            assert_eq!(loss.messages, Some(MESSAGES - log.messages));
            assert!(log.messages > MESSAGES / 2);
            let kept = &rows(&log).times.log;
            let lost = (0..MESSAGES as i64).filter(|time| !kept.contains(time));
            let (first, last) = loss.span.unwrap();
            assert_eq!((lost.clone().min(), lost.max()), (Some(first.nanos()), Some(last.nanos())));
        }
    }
}

#[test]
fn without_chunks_the_messages_after_damage_are_read() {
    let plain = WriteOptions::new().use_chunks(false);
    let mut bytes = poses(LogWriter::with(plain));
    let damaged = records(&bytes, op::MESSAGE)[MESSAGES as usize / 2];
    for garbage in [0x7f, 0xff] {
        // Fourth byte of the record's length.
        bytes[damaged + 4] = garbage;
        let log = read_all(&bytes);
        let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
        assert_eq!((loss.offset, loss.messages), (Some(damaged as u64), Some(1)));
        assert_eq!(log.messages, MESSAGES - 1);
    }
}

#[test]
fn a_wrong_length_loses_only_its_record() {
    let mut bytes = poses(LogWriter::default());
    let chunk = chunks(&bytes)[1];
    for garbage in [0x7f, 0xff] {
        bytes[chunk + 7] = garbage;
        let log = read_all(&bytes);
        let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
        assert_eq!((loss.offset, loss.extent), (Some(chunk as u64), Extent::Messages));
        assert_eq!(loss.messages, Some(MESSAGES - log.messages));
        assert!(loss.what.contains("continued at byte"), "{}", loss.what);
        assert!(log.messages > MESSAGES / 2);
    }
}

#[test]
fn every_flipped_byte_is_survived_and_detected() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let mut bytes = poses(LogWriter::new(compression));
        let sound = read_all(&bytes);
        for index in (MAGIC.len()..bytes.len()).step_by(3) {
            bytes[index] ^= 0xff;
            let log = read_all(&bytes);
            bytes[index] ^= 0xff;
            assert!(log.messages <= MESSAGES);
            let unseen = log.losses.is_empty() && log.files[0].crc == Crc::All;
            assert!(!unseen || log.topics == sound.topics, "byte {index}");
            assert!(log.topics.iter().all(|topic| topic.undecodable.is_none()), "byte {index}");
        }
    }
}

#[test]
fn a_file_that_ends_in_zeros_is_truncated() {
    let whole = poses(LogWriter::default());
    let mut bytes = whole[..chunks(&whole)[1]].to_vec();
    bytes.extend([0; 4096]);
    let log = read_all(&bytes);
    assert!(log.messages > 0);
    assert_eq!(lost(&log), [(Extent::Tail, None)]);
}

#[test]
fn gigabytes_of_trailing_zeros_are_skipped_quickly() {
    let whole = poses(LogWriter::default());
    let mut file = tempfile::NamedTempFile::new().unwrap();
    io::Write::write_all(&mut file, &whole[..chunks(&whole)[1]]).unwrap();
    file.as_file().set_len(4 << 30).unwrap();
    let start = Instant::now();
    let mapped = MappedFile::open(file.path()).unwrap();
    let log = read_with(mapped.bytes(), ReadOptions::default());
    assert!(start.elapsed() < Duration::from_secs(10), "{:?}", start.elapsed());
    assert!(log.messages > 0);
    assert_eq!(lost(&log), [(Extent::Tail, None)]);
}

#[test]
fn chunks_beyond_the_unpacking_limit_are_unread_not_damaged() {
    let whole = poses(LogWriter::new(Some(Compression::Zstd)));
    let read = |allowance: UnpackBudget| {
        let (path, mut intake) = (Path::new("run.mcap"), Intake::default());
        let mut losses = Losses::new(path);
        intake.begin_file(path, whole.len() as u64);
        intake.unpack_budget = allowance;
        read(&whole, &Present::Whole, &ReadOptions::default(), &mut losses, &mut intake).unwrap();
        (intake.messages(), losses.finish())
    };
    let (messages, losses) = read(UnpackBudget::for_file(0, None));
    assert_eq!((messages, losses), (MESSAGES, Vec::new()));
    let (messages, losses) = read(UnpackBudget::with_limit(5000));
    let [unread] = losses.as_slice() else { panic!("{losses:?}") };
    assert!(0 < messages && messages < MESSAGES, "{messages}");
    assert_eq!((unread.extent, unread.messages), (Extent::Unread, Some(MESSAGES - messages)));
}

#[test]
fn a_missing_footer_is_damage_to_the_index() {
    let whole = poses(LogWriter::default());
    let log = read_all(&whole[..whole.len() - 40]);
    assert_eq!(log.messages, MESSAGES);
    assert_eq!(lost(&log), [(Extent::Index, Some(0))]);
}

#[test]
fn hostile_chunk_sizes_are_refused() {
    let mut bytes = poses(LogWriter::default());
    let size = chunks(&bytes)[0] + record::FRAME_HEADER + 16;
    for (high, expected) in [(0xff, "larger than"), (0x00, "its header says 805306368")] {
        bytes[size..size + 8].copy_from_slice(&[0, 0, 0, 0x30, 0, 0, 0, high]);
        let log = read_all(&bytes);
        assert!(log.losses[0].what.contains(expected), "{:?}", log.losses);
        assert!(log.messages > 0);
    }
}

#[test]
fn topics_that_cannot_be_decoded_do_not_stop_the_others() {
    let mut log = LogWriter::default();
    let pose = "geometry_msgs/msg/PoseStamped";
    let other = log.encoded_channel("/other", pose, "xml", testing::POSE_STAMPED);
    let cdr = log.channel("/cdr", pose, testing::POSE_STAMPED);
    log.message(other, 1, b"{}");
    log.message(other, 2, b"{}");
    log.message(cdr, 3, &Cdr::pose_stamped(1, 2, "base", [0.0; 3]));
    log.message(cdr, 4, &Cdr::pose_stamped(1, 2, "base", [0.0; 3])[..30]);
    let log = read_all(&log.finish());
    assert_eq!(log.losses, []);
    let [cdr, other] = log.topics.as_slice() else { panic!("two topics") };
    let undecodable = cdr.undecodable.as_ref().unwrap();
    assert_eq!(undecodable.messages, 1);
    assert!(
        undecodable.first.starts_with("field `pose.position.x`: byte 28 of the message: needs 8 ")
    );
    assert!(matches!(&cdr.columns, Some(Columns::Poses(poses)) if poses[0].times.len() == 1));
    assert_eq!(other.columns, None);
    let undecodable = other.undecodable.as_ref().unwrap();
    assert_eq!(undecodable.messages, 2);
    assert!(undecodable.first.starts_with("messages are encoded as `xml`, expected `cdr`"));
}

#[test]
fn a_pose_does_not_inherit_the_child_frame_of_a_transform() {
    let mut log = LogWriter::default();
    let tf = log.channel("/tf", "tf2_msgs/msg/TFMessage", testing::TF_MESSAGE);
    let pose = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    let transform = Cdr::little().u32(1).header(1, 0, "base").text("flange");
    log.message(tf, 1, &transform.all(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).done());
    log.message(pose, 2, &Cdr::pose_stamped(1, 2, "base", [0.0; 3]));
    let log = read_all(&log.finish());
    assert_eq!(rows(&log).child_frame_id, "");
}

#[test]
fn robot_descriptions_in_attachments_and_metadata_are_found() {
    let urdf = "<?xml version=\"1.0\"?>\n<robot name=\"arm\"/>";
    let mut log = LogWriter::default();
    let attachment = |name: &str, text: &'static str| mcap::Attachment {
        log_time: 0,
        create_time: 0,
        name: name.to_owned(),
        media_type: "text/xml".to_owned(),
        data: Cow::Borrowed(text.as_bytes()),
    };
    log.writer().attach(&attachment("arm.urdf", urdf)).unwrap();
    log.writer().attach(&attachment("notes.txt", "the <robot> is new")).unwrap();
    let metadata = [("robot_description".to_owned(), urdf.to_owned())].into();
    let metadata = mcap::records::Metadata { name: "run".to_owned(), metadata };
    log.writer().write_metadata(&metadata).unwrap();
    let log = read_all(&log.finish());
    let names: Vec<&str> = log.descriptions.iter().map(|found| found.name.as_str()).collect();
    assert_eq!(names, ["arm.urdf", "run/robot_description"]);
    assert_eq!(log.descriptions[0].text, urdf);
}

#[test]
fn unknown_records_are_reported_except_private_ones() {
    let mut whole = poses(LogWriter::default());
    // Without a summary, whose offset would change.
    whole.truncate(records(&whole, op::DATA_END)[0]);
    for (opcode, is_unknown) in [(0x10, true), (0x7f, true), (0x80, false), (0xff, false)] {
        let mut bytes = whole.clone();
        let record = [&[opcode][..], &3_u64.to_le_bytes(), b"abc"].concat();
        bytes.splice(MAGIC.len()..MAGIC.len(), [&record[..], &record].concat());
        let log = read_all(&bytes);
        assert_eq!(log.messages, MESSAGES);
        let expected =
            format!("skipped 2 records of unknown kinds (the first: opcode {opcode:#04x})");
        let said: Vec<bool> = log.notes.iter().map(|note| note.what == expected).collect();
        assert_eq!(said, vec![true; usize::from(is_unknown)], "{:?}", log.notes);
    }
}

#[test]
fn the_sequence_number_of_a_message_belongs_to_its_row() {
    let mut log = LogWriter::default();
    let channel_id = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
    for sequence in [4, 5, 9] {
        let (log_time, publish_time) = (sequence.into(), 0);
        let header = mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time };
        let message = Cdr::pose_stamped(0, sequence, "base", [0.0; 3]);
        log.writer().write_to_known_channel(&header, &message).unwrap();
    }
    assert_eq!(rows(&read_all(&log.finish())).times.sequence, [4, 5, 9]);
}
