use std::path::Path;

use super::super::testing::BagWriter;
use super::super::{Container, Log, LogFile};
use super::*;
use ground::stream::Columns;
use ground::time::Stamp;

const MESSAGES: u64 = 60;
const A_CHUNK: u64 = 20;
const COMPRESSIONS: [&str; 3] = ["none", "lz4", "bz2"];

/// Bytes vary and do not form a record.
fn content(n: u64) -> Vec<u8> {
    (0..40).map(|i| (n * 37 + i * 11) as u8).collect()
}

/// Messages at times 1, 2, 3, … ns, and the offsets of the chunks.
fn bag(compression: &'static str) -> (Vec<u8>, Vec<usize>) {
    let (bag, chunks) = unfinished(compression, MESSAGES);
    (bag.finish(), chunks)
}

fn unfinished(compression: &'static str, messages: u64) -> (BagWriter, Vec<usize>) {
    let mut bag = BagWriter::new(compression);
    let mut chunks = Vec::new();
    let a = bag.connection("/a", "test_msgs/Blob", "uint8[] data\n");
    let b = bag.connection("/b", "test_msgs/Blob", "uint8[] data\n");
    for n in 1..=messages {
        bag.message(if n % 3 == 0 { b } else { a }, n, &content(n));
        if n % A_CHUNK == 0 {
            chunks.push(bag.end_chunk());
        }
    }
    (bag, chunks)
}

/// Verification also decompresses chunks of unused messages.
fn read_bag(bytes: &[u8]) -> Log {
    read_bag_with(bytes, &ReadOptions { verify: true, ..ReadOptions::default() })
}

fn read_bag_with(bytes: &[u8], options: &ReadOptions) -> Log {
    let (path, mut intake) = (Path::new("run.bag"), Intake::default());
    let mut losses = Losses::new(path);
    intake.begin_file(path, bytes.len() as u64);
    let crc = read(bytes, options, &mut losses, &mut intake);
    intake.losses(losses);
    let (bytes, container) = (bytes.len() as u64, Container::RosBag1);
    intake.finish(vec![LogFile { path: path.to_owned(), container, bytes, fetched: None, crc }])
}

fn lost(log: &Log) -> Vec<(Extent, Option<u64>)> {
    log.losses.iter().map(|loss| (loss.extent, loss.messages)).collect()
}

#[test]
fn every_compression_gives_the_same_messages() {
    for compression in COMPRESSIONS {
        let log = read_bag(&bag(compression).0);
        assert_eq!(log.losses, [], "{compression}");
        assert_eq!(log.messages, MESSAGES);
        assert_eq!(log.span, Some((Stamp::from_nanos(1), Stamp::from_nanos(60))));
        let [a, b] = log.topics.as_slice() else { panic!("two topics") };
        assert_eq!((a.name.as_str(), a.messages), ("/a", 40));
        assert_eq!((b.name.as_str(), b.messages), ("/b", 20));
        assert_eq!((a.type_name.as_str(), a.encoding.as_str()), ("test_msgs/Blob", "ros1"));
        let crc = if compression == "none" { Crc::None } else { Crc::All };
        assert_eq!(log.files[0].crc, crc, "{compression}");
    }
}

#[test]
fn times_have_whole_seconds_and_nanoseconds() {
    let mut bag = BagWriter::new("none");
    let a = bag.connection("/a", "test_msgs/Blob", "");
    bag.message(a, 1_780_000_000_123_456_789, b"x");
    let log = read_bag(&bag.finish());
    assert_eq!(log.span.unwrap().0, Stamp::from_nanos(1_780_000_000_123_456_789));
}

#[test]
fn every_truncation_keeps_the_messages_before_it() {
    for compression in COMPRESSIONS {
        let (whole, chunks) = bag(compression);
        let mut most = 0;
        for length in MAGIC.len()..whole.len() {
            let log = read_bag(&whole[..length]);
            assert!(log.messages >= most, "{compression}, cut at {length}");
            most = log.messages;
            let before = chunks.iter().filter(|&&chunk| chunk < length).count().saturating_sub(1);
            assert!(log.messages >= before as u64 * A_CHUNK, "{compression}, cut at {length}");
            assert_ne!(log.losses, [], "{compression}, cut at {length}");
            let is_cut = log.losses.iter().all(|loss| loss.extent != Extent::Messages);
            assert!(is_cut, "{compression}, cut at {length}: {:?}", log.losses);
        }
        assert_eq!(most, MESSAGES);
    }
}

#[test]
fn a_cut_in_an_uncompressed_chunk_loses_one_message() {
    let (whole, chunks) = bag("none");
    let log = read_bag(&whole[..chunks[1] + 1000]);
    // A message has 40 bytes of data, 38 of header, and 8 for their lengths.
    let expected = A_CHUNK + (1000 - 50) / 100;
    assert!(log.messages.abs_diff(expected) <= 2, "{}", log.messages);
    let [loss] = log.losses.as_slice() else { panic!("{:?}", log.losses) };
    assert_eq!((loss.offset, loss.extent), (Some(chunks[1] as u64), Extent::Tail));
    let saved = log.messages - A_CHUNK;
    assert!(loss.what.contains(&format!("{saved} of its messages were read")), "{}", loss.what);
}

#[test]
fn a_bag_of_a_crashed_recorder_is_read_to_its_last_byte() {
    for compression in COMPRESSIONS {
        let (bag, _) = unfinished(compression, MESSAGES + 7);
        let log = read_bag(&bag.abandon());
        assert_eq!(log.messages, MESSAGES + 7, "{compression}: {:?}", log.losses);
        assert!(log.losses.iter().any(|loss| loss.what.contains("no index")), "{:?}", log.losses);
        assert!(log.losses.iter().all(|loss| loss.extent != Extent::Messages), "{:?}", log.losses);
    }
}

#[test]
fn unused_chunks_are_counted_and_not_unpacked() {
    for compression in ["lz4", "bz2"] {
        let (mut bytes, chunks) = bag(compression);
        bytes[chunks[2] + 120] ^= 0x10;
        let log = read_bag_with(&bytes, &ReadOptions::default());
        assert_eq!(lost(&log), [], "{compression}");
        assert_eq!(log.messages, MESSAGES);
        assert_eq!(log.span, Some((Stamp::from_nanos(1), Stamp::from_nanos(60))));
        assert_eq!(log.topics.iter().map(|topic| topic.messages).collect::<Vec<_>>(), [40, 20]);
        assert_eq!(log.files[0].crc, Crc::None);
    }
}

#[test]
fn a_corrupt_chunk_is_lost_alone_and_its_messages_are_counted() {
    for compression in ["lz4", "bz2"] {
        let (mut bytes, chunks) = bag(compression);
        // The first chunk contains the connections.
        for chunk in [chunks[0], chunks[2]] {
            bytes[chunk + 120] ^= 0x10;
            let log = read_bag(&bytes);
            bytes[chunk + 120] ^= 0x10;
            assert_eq!(lost(&log), [(Extent::Messages, Some(A_CHUNK))], "{compression}");
            assert_eq!(log.losses[0].offset, Some(chunk as u64));
            assert_eq!(log.messages, MESSAGES - A_CHUNK);
        }
    }
}

#[test]
fn a_wrong_length_in_an_uncompressed_chunk_loses_few_messages() {
    let (mut bytes, chunks) = bag("none");
    // Only a message's length has the value 40.
    let length = 40u32.to_le_bytes();
    let at = bytes[chunks[1]..].windows(4).position(|window| window == length).unwrap();
    for wrong in [[200, 0, 0, 0], [0xff; 4]] {
        bytes[chunks[1] + at..][..4].copy_from_slice(&wrong);
        let log = read_bag(&bytes);
        assert!(log.messages >= MESSAGES - 5, "{} {:?}", log.messages, log.losses);
        assert!(log.messages <= MESSAGES);
        assert_ne!(log.losses, []);
    }
}

#[test]
fn a_wrong_chunk_length_is_skipped_and_no_message_is_read_twice() {
    for compression in COMPRESSIONS {
        let (mut bytes, chunks) = bag(compression);
        // The data's length follows the header.
        let header = u32::from_le_bytes(bytes[chunks[1]..][..4].try_into().unwrap()) as usize;
        let length = chunks[1] + 4 + header;
        for wrong in [0xff, 0x7f, 0x00] {
            let was = bytes[length + 1];
            bytes[length + 1] = wrong;
            let log = read_bag(&bytes);
            bytes[length + 1] = was;
            assert!(log.messages >= MESSAGES - A_CHUNK, "{compression} {wrong}: {}", log.messages);
            assert!(log.messages <= MESSAGES, "{compression} {wrong}: {}", log.messages);
            assert_ne!(log.losses, []);
        }
    }
}

#[test]
fn every_flipped_byte_is_survived() {
    for compression in COMPRESSIONS {
        let (mut bytes, _) = bag(compression);
        let step = if compression == "none" { 1 } else { 3 };
        for index in (MAGIC.len()..bytes.len()).step_by(step) {
            bytes[index] ^= 0xff;
            let log = read_bag(&bytes);
            bytes[index] ^= 0xff;
            assert!(log.messages <= MESSAGES, "{compression}, byte {index}");
            assert!(log.messages >= MESSAGES - A_CHUNK, "{compression}, byte {index}");
        }
    }
}

#[test]
fn the_index_counts_lost_messages() {
    let (mut bytes, chunks) = bag("lz4");
    bytes[chunks[1]..chunks[2]].fill(0xee);
    let log = read_bag(&bytes);
    assert_eq!(log.messages, MESSAGES - A_CHUNK);
    let lost: u64 = log.losses.iter().filter_map(|loss| loss.messages).sum();
    assert_eq!(lost, A_CHUNK, "{:?}", log.losses);
}

#[test]
fn a_chunk_that_claims_to_unpack_to_gigabytes_is_refused() {
    let (mut bytes, chunks) = bag("bz2");
    let size = bytes[chunks[1]..].windows(5).position(|window| window == b"size=").unwrap();
    bytes[chunks[1] + size + 5..][..4].fill(0xff);
    let log = read_bag(&bytes);
    assert!(log.losses[0].what.contains("larger than"), "{:?}", log.losses);
    assert_eq!(log.messages, MESSAGES - A_CHUNK);
}

#[test]
fn more_topics_than_any_log_has_are_a_loss() {
    let mut bag = BagWriter::new("none");
    for n in 0..140_000u32 {
        let connection = bag.connection(&format!("/{n}"), "test_msgs/Blob", "");
        bag.message(connection, n.into(), b"x");
    }
    let log = read_bag(&bag.finish());
    assert_eq!(lost(&log), [(Extent::Unread, Some(140_000 - log.messages))]);
    assert_eq!(log.messages, 1 << 17);
}

#[test]
fn a_chunk_that_misstates_its_size_is_read() {
    for compression in COMPRESSIONS {
        let (mut bytes, chunks) = bag(compression);
        let field = bytes[chunks[1]..].windows(5).position(|window| window == b"size=").unwrap();
        let size = chunks[1] + field + 5;
        for change in [-3, 1, 100] {
            let was: [u8; 4] = bytes[size..][..4].try_into().unwrap();
            let wrong = u32::from_le_bytes(was).checked_add_signed(change).unwrap();
            bytes[size..][..4].copy_from_slice(&wrong.to_le_bytes());
            let log = read_bag(&bytes);
            bytes[size..][..4].copy_from_slice(&was);
            assert_eq!(log.messages, MESSAGES, "{compression} {change}: {:?}", log.losses);
            assert_eq!(lost(&log), [(Extent::Index, Some(0))], "{compression} {change}");
            assert!(log.losses[0].what.contains(&wrong.to_string()), "{:?}", log.losses);
        }
    }
}

#[test]
fn unknown_records_are_skipped_and_reported() {
    let (mut bytes, _) = bag("lz4");
    assert_eq!(read_bag(&bytes).notes, []);
    let indices = |bytes: &[u8]| -> Vec<usize> {
        let fields = bytes.windows(4).enumerate().filter(|(_, window)| *window == b"op=\x04");
        fields.map(|(at, _)| at).collect()
    };
    let found = indices(&bytes);
    for &at in &found {
        bytes[at + 3] = 0x2a;
    }
    let log = read_bag(&bytes);
    assert_eq!((log.messages, log.losses.len()), (MESSAGES, 0));
    let [note] = log.notes.as_slice() else { panic!("{:?}", log.notes) };
    let expected = format!("skipped {} records of unknown kinds", found.len());
    assert!(note.what.contains(&expected) && note.what.contains("0x2a"), "{}", note.what);
}

#[test]
fn the_sequence_number_of_a_header_belongs_to_its_row() {
    let mut bag = BagWriter::new("none");
    let definition = "# a comment\n\nint32 CONSTANT=3\nHeader header\ngeometry_msgs/Vector3 vector\n\
        ===\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n\
        ===\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n";
    let connection = bag.connection("/force", "geometry_msgs/Vector3Stamped", definition);
    for number in [7_u32, 8, 11] {
        let mut message = number.to_le_bytes().to_vec();
        message.extend([0; 12]);
        message.extend([0; 24]);
        bag.message(connection, number.into(), &message);
    }
    let log = read_bag(&bag.finish());
    let Some(Columns::Array(array)) = &log.topics[0].columns else { panic!("{:?}", log.topics) };
    assert_eq!(array.times.sequence, [7, 8, 11]);
}
