//! The same bytes for the same recording. The SDK draws ids at random and takes times from a clock; here they
//! follow from what the recording shows.

use rerun::external::re_log_encoding::Encoder;
use rerun::external::re_log_types::SetStoreInfo;
use rerun::external::re_log_types::external::re_tuid::Tuid;
use rerun::log::{Chunk, ChunkBatcherConfig, ChunkId, LogMsg, RowId};

use super::{Replay, ReplayCause};
use crate::report::json;

/// Rows go on as they come, one by one: what goes together must not be a matter of time.
pub(super) const BATCHES: ChunkBatcherConfig = ChunkBatcherConfig::ALWAYS_TEST_ONLY;

/// What ids follow from: a hash of the report, which names the log and says what was found in it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seed([u8; 32]);

impl Seed {
    pub fn of(replay: &Replay<'_>) -> Self {
        let mut text = Vec::new();
        // What is written to memory can be.
        let _ = json::write(replay.report, &mut text);
        Self(*blake3::hash(&text).as_bytes())
    }

    /// An id of its own for `what`.
    pub fn id(self, what: &str) -> u128 {
        let hash = blake3::keyed_hash(&self.0, what.as_bytes());
        let first: [u8; 16] = std::array::from_fn(|at| hash.as_bytes()[at]);
        u128::from_le_bytes(first)
    }
}

/// The file of these messages.
///
/// # Errors
/// If one has no form in a file.
pub(super) fn bytes(messages: Vec<LogMsg>, replay: &Replay<'_>) -> Result<Vec<u8>, ReplayCause> {
    let mut encoder = Encoder::local()?;
    // The index in it stands in the order of a hash map.
    encoder.do_not_emit_footer();
    let mut ids = Ids::of(replay);
    let (mut chunks, mut activations) = (Vec::new(), Vec::new());
    for message in messages {
        match message {
            LogMsg::SetStoreInfo(info) => {
                let info = SetStoreInfo { row_id: ids.take(1), ..info };
                encoder.append(&LogMsg::SetStoreInfo(info))?;
            }
            LogMsg::ArrowMsg(store, message) => {
                chunks.push((store, Chunk::from_arrow_msg(&message)?));
            }
            activation => activations.push(activation),
        }
    }
    // Rows and columns come by two ways, which overtake each other; their ids ascend as they were made.
    chunks.sort_by_key(|(_, chunk)| chunk.row_id_range().map(|(first, _)| first));
    for (store, chunk) in chunks {
        let (id, row) = (ids.take(1), ids.take(chunk.num_rows()));
        let chunk = chunk.clone_as(ChunkId::from_tuid(id), RowId::from_tuid(row));
        encoder.append(&LogMsg::ArrowMsg(store, chunk.to_arrow_msg()?))?;
    }
    for activation in activations {
        encoder.append(&activation)?;
    }
    encoder.finish()?;
    Ok(encoder.into_inner()?)
}

/// Ids that ascend, as those of a clock do.
struct Ids {
    nanos: u64,
    next: u64,
}

impl Ids {
    fn of(replay: &Replay<'_>) -> Self {
        /// Room above for all that follow, and below for all that there are.
        const MIDDLE: u64 = 0x3fff_ffff_0000_0000;
        let nanos = u64::try_from(replay.span.0.nanos()).unwrap_or_default();
        Self { nanos, next: Seed::of(replay).id("rows") as u64 & MIDDLE }
    }

    /// The first of so many.
    fn take(&mut self, count: usize) -> Tuid {
        let first = self.next;
        self.next += count as u64;
        Tuid::from_nanos_and_inc(self.nanos, first)
    }
}
