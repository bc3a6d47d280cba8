//! Read-ahead advice: only the useful parts of uncompressed chunks with large unused messages.

use super::Reader;
use super::record::Frame;
use crate::mapped::{AccessPattern, advise};
use crate::ranges::Ranges;
use crate::unpack::{Compression, Packed};

impl<'a> Reader<'a, '_, '_> {
    /// Advises the system which parts of a chunk will be read, according to its message indexes. If they
    /// are wrong, parts are read on demand.
    pub(super) fn advise(&mut self, chunk: &Frame<'a>, packed: &Packed<'a>) {
        let wanted = match packed.compression {
            Compression::None => self.useful_parts(chunk, packed.data),
            _ => None,
        };
        match wanted {
            Some(wanted) => {
                if !std::mem::replace(&mut self.is_scattered, true) {
                    advise(&self.bytes[chunk.offset..], AccessPattern::Scattered);
                }
                wanted.into_iter().for_each(|run| advise(run, AccessPattern::Whole));
            }
            None if self.is_scattered => advise(packed.data, AccessPattern::Whole),
            None => {}
        }
    }

    /// `None` unless unused messages make up most of the chunk's bytes.
    fn useful_parts(&self, chunk: &Frame<'a>, records: &'a [u8]) -> Option<Vec<&'a [u8]>> {
        if self.options.verify || !self.has_ignored_channels() {
            return None;
        }
        let parts = Ranges::new(self.needed_parts(chunk, records.len())?, 0);
        let is_most_unused = 2 * parts.bytes() < records.len();
        is_most_unused.then(|| parts.iter().map(|part| &records[part]).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use mcap::records::op;
    use mcap::{MAGIC, WriteOptions};

    use super::super::record;
    use super::*;
    use crate::ReadOptions;
    use crate::chunk_pool;
    use crate::intake::Intake;
    use crate::losses::Losses;
    use crate::ranges::Present;
    use crate::testing::{self, Cdr, LogWriter};

    fn log(image: usize) -> Vec<u8> {
        let mut log = LogWriter::with(WriteOptions::new().compression(None));
        let pose = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
        let camera = log.channel("/camera", "sensor_msgs/msg/Image", "uint8[] data\n");
        for time in 0..60 {
            log.message(pose, time, &Cdr::pose_stamped(0, 1, "base", [time as f64, 0.5, 0.25]));
            if time % 10 == 9 {
                log.message(camera, time, &vec![0; image]);
            }
        }
        log.finish()
    }

    fn wanted(bytes: &[u8]) -> (Option<Vec<(usize, usize)>>, usize) {
        let (mut losses, mut intake) = (Losses::new(Path::new("run.mcap")), Intake::default());
        let options = ReadOptions::default();
        chunk_pool::with_pool(|ahead| {
            let present = &Present::Whole;
            let mut reader = Reader::new(bytes, present, &options, &mut losses, &mut intake, ahead);
            reader.summary();
            let mut frames = record::frames(bytes, MAGIC.len()).map_while(Result::ok);
            let chunk = frames.find(|frame| frame.opcode == op::CHUNK).expect("a chunk");
            let packed = record::Chunk::parse(chunk.body).and_then(|chunk| chunk.packed()).unwrap();
            let begin = packed.data.as_ptr().addr();
            let place = |run: &[u8]| {
                let from = run.as_ptr().addr() - begin;
                (from, from + run.len())
            };
            let runs = reader.useful_parts(&chunk, packed.data);
            (runs.map(|runs| runs.into_iter().map(place).collect()), packed.data.len())
        })
    }

    #[test]
    fn only_useful_ranges_between_images_are_prefetched() {
        let (runs, all) = wanted(&log(5000));
        let runs = runs.expect("images make up most of it");
        let asked: usize = runs.iter().map(|(from, to)| to - from).sum();
        assert_eq!(runs.len(), 6);
        assert!(runs.windows(2).all(|pair| pair[1].0 - pair[0].1 == 5000), "{runs:?}");
        assert_eq!((runs[0].0, all - asked), (0, 6 * 5000));
    }

    #[test]
    fn small_gaps_between_useful_ranges_are_included() {
        assert_eq!(wanted(&log(50)).0, None);
    }

    #[test]
    fn a_wrong_index_changes_no_result() {
        let sound = log(5000);
        let read = |bytes: &[u8]| {
            let present = &Present::Whole;
            let log = super::super::tests::read_present(bytes, present, ReadOptions::default());
            log.unwrap().topics
        };
        let mut index = record::frames(&sound, MAGIC.len()).map_while(Result::ok);
        let index = index.find(|frame| frame.opcode == op::MESSAGE_INDEX).unwrap();
        for value in [0, 0x41, 0xff] {
            let mut lying = sound.clone();
            // After channel and length, each entry is a time and an offset.
            let entries = index.end() - index.body.len() + 6;
            for place in (entries + 8..index.end()).step_by(16) {
                lying[place..place + 8].fill(value);
            }
            assert_eq!(read(&lying), read(&sound), "{value:#x}");
        }
    }
}
