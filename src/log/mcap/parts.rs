//! Chunks read ahead with the definitions known at submission.

use std::sync::Arc;

use mcap::records::op;

use super::record;
use super::{Definitions, Reader};
use crate::intake::Intake;
use crate::part::{ChannelSnapshot, PartContent, PartParser};
use crate::unpack::Packed;

/// Maximum number of snapshots. In valid files all definitions are in the summary or the first chunks.
const MAX_SNAPSHOTS: u32 = 1 << 8;

pub(super) struct DefinitionSnapshot {
    definitions: Definitions,
    known: ChannelSnapshot,
}

impl DefinitionSnapshot {
    fn new(definitions: &Definitions, intake: &Intake) -> Option<Self> {
        Some(Self { definitions: definitions.clone(), known: intake.known()? })
    }
}

impl PartParser for DefinitionSnapshot {
    fn part(&self, records: &[u8], offset: usize) -> Option<PartContent> {
        let mut part = self.known.part();
        for frame in record::frames(records, 0) {
            let frame = frame.ok()?;
            let is_known = match frame.opcode {
                op::MESSAGE => {
                    let message = record::Message::parse(frame.body)?;
                    let channel = self.definitions.channel_of(message.channel_id)?;
                    part.message(channel, &message.at_offset(offset))?;
                    true
                }
                op::SCHEMA => self.definitions.has_schema(&record::Schema::parse(frame.body)?),
                op::CHANNEL => self.definitions.has_channel(&record::Channel::parse(frame.body)?),
                _ => false,
            };
            if !is_known {
                return None;
            }
        }
        Some(part.finish(self.definitions.changes))
    }
}

impl Reader<'_, '_, '_> {
    pub(super) fn snapshot(&mut self) -> Option<Arc<dyn PartParser>> {
        if self.table.is_none() && self.tables < MAX_SNAPSHOTS {
            self.tables += 1;
            self.table = DefinitionSnapshot::new(&self.definitions, self.intake).map(Arc::new);
        }
        let table = Arc::clone(self.table.as_ref()?);
        Some(table)
    }

    /// Merges the chunk `packed`, read ahead. Returns false if reading it now would give another result.
    pub(super) fn join_part(&mut self, part: PartContent, packed: &Packed<'_>) -> bool {
        let before = self.intake.messages();
        let is_current = part.changes == self.definitions.changes;
        if !is_current
            || self.intake.unpack_budget.admit(packed).is_err()
            || !self.intake.join(part)
        {
            return false;
        }
        self.intake.unpack_budget.charge(packed);
        if packed.crc != 0 {
            self.covered += self.intake.messages() - before;
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use mcap::{Compression, MAGIC, WriteOptions};

    use super::super::super::testing::{self, Cdr, LogWriter};
    use super::super::tests::{chunks, read_present};
    use super::*;
    use crate::ReadOptions;
    use crate::ranges::Present;

    /// Reads with this number of threads; formatted, because NaN differs from itself.
    fn read_by(threads: usize, bytes: &[u8]) -> String {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let read = || read_present(bytes, &Present::Whole, ReadOptions::default()).unwrap();
        format!("{:?}", pool.install(read))
    }

    /// Messages that depend on previous ones: joints and frames appear and disappear, lengths change, some
    /// cannot be decoded.
    fn changing(options: WriteOptions, [joints, tf, array, text]: [&str; 4]) -> Vec<u8> {
        let mut log = LogWriter::with(options);
        let long = "x".repeat(300);
        let array_schema = "uint32 offset\n";
        let array_schema = format!(
            "std_msgs/MultiArrayLayout layout\nfloat64[] data\n{}\nMSG: std_msgs/MultiArrayLayout\n\
             {array_schema}",
            "=".repeat(80)
        );
        let joints = log.channel(joints, "sensor_msgs/msg/JointState", testing::JOINT_STATE);
        let tf = log.channel(tf, "tf2_msgs/msg/TFMessage", testing::TF_MESSAGE);
        let array = log.channel(array, "std_msgs/msg/Float64MultiArray", &array_schema);
        let text = log.channel(text, "std_msgs/msg/String", "string data\n");
        let image = log.channel("/image", "sensor_msgs/msg/Image", "uint8[] data\n");
        let broken = log.channel("/broken", "sensor_msgs/msg/Imu", "Nothing that is\n");
        for n in 0..400_u64 {
            let at = n as f64;
            let names: &[&str] = match n {
                0..50 => &["a", "b"],
                50..120 => &["b", "a"],
                120..200 if n % 2 == 0 => &["finger"],
                200..260 if n % 3 == 0 => &["a", "a", "c"],
                260..263 => &[&long],
                300 => &["a"],
                _ => &["a", "b"],
            };
            let mut q: Vec<f64> = (0..names.len()).map(|joint| at + joint as f64).collect();
            match n {
                280..290 => q[0] = f64::NAN,
                300 => q.push(1.0),
                _ => {}
            }
            log.message(joints, n, &Cdr::joint_state(names, &q, if n % 5 == 0 { &[] } else { &q }));
            let child = if n < 200 { "tool" } else { ["tool", "camera", "lamp"][n as usize % 3] };
            let x = if n % 97 == 0 { f64::INFINITY } else { at };
            let transform = Cdr::little().u32(1).header(n as u32, 0, "base").text(child);
            log.message(tf, n, &transform.all(&[x, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0]).done());
            let width = if (150..170).contains(&n) { 6 } else { 7 };
            log.message(array, n, &Cdr::little().u32(0).list(&vec![at; width]).done());
            log.message(text, n, &Cdr::little().text(&format!("text {}", n % 90)).done());
            log.message(image, n, &[n as u8; 40]);
            log.message(broken, n, &[0, 1, 0, 0]);
            if n % 50 == 7 {
                log.message(joints, n, &[0, 1, 0, 0, 9]);
            }
        }
        log.finish()
    }

    const TOPICS: [&str; 4] = ["/joint_states", "/tf", "/array", "/robot_description"];

    #[test]
    fn chunks_unpacked_ahead_give_the_same_rows() {
        for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
            let options = WriteOptions::new().compression(compression);
            for size in [700, 5000] {
                let options = options.clone().chunk_size(Some(size));
                let without_summary = options
                    .clone()
                    .emit_summary_records(false)
                    .emit_message_indexes(false)
                    .calculate_chunk_crcs(false);
                for options in [options, without_summary] {
                    let mut bytes = changing(options, TOPICS);
                    assert!(read_by(4, &bytes) == read_by(1, &bytes), "{compression:?}, {size}");
                    let all = chunks(&bytes);
                    bytes[all[all.len() / 2] + 150] ^= 0x21;
                    assert!(read_by(4, &bytes) == read_by(1, &bytes), "{compression:?}, damaged");
                }
            }
        }
    }

    #[test]
    fn redefined_channels_are_read_by_their_current_definition() {
        let options = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            .chunk_size(Some(700))
            .emit_summary_records(false)
            .emit_summary_offsets(false)
            .emit_message_indexes(false)
            .calculate_data_section_crc(false);
        let [one, other] = [TOPICS, ["/a", "/b", "/c", "/d"]].map(|topics| {
            let bytes = changing(options.clone(), topics);
            let ends = record::frames(&bytes, MAGIC.len()).map_while(Result::ok);
            let end =
                ends.filter(|frame| frame.opcode == op::CHUNK).map(|frame| frame.end()).last();
            bytes[MAGIC.len()..end.unwrap()].to_vec()
        });
        let bytes = [MAGIC, &one, &other, &one].concat();
        let read = read_by(4, &bytes);
        assert!(read == read_by(1, &bytes));
        let log = read_present(&bytes, &Present::Whole, ReadOptions::default()).unwrap();
        let messages = |name: &str| -> u64 {
            log.topics.iter().filter(|topic| topic.name == name).map(|topic| topic.messages).sum()
        };
        assert_eq!([messages("/tf"), messages("/b")], [800_u64, 400]);
    }
}
