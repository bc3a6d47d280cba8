//! Chunks of a recording in order of creation. Ids are derived from the content, so equal recordings have
//! equal bytes.

use std::cell::RefCell;

use re_chunk::{Chunk, ChunkId, RowId, TimeColumn, TimePoint};
use re_log_types::external::re_tuid::Tuid;
use re_log_types::{
    ApplicationId, BlueprintActivationCommand, EntityPath, LogMsg, SetStoreInfo, StoreId,
    StoreInfo, StoreKind, StoreSource,
};
use re_sdk_types::{AsComponents, SerializedComponentColumn};

use super::{Replay, ReplayCause};
use crate::report::json;

/// Hash of the report, which contains the log's name and the findings.
#[derive(Clone, Copy, Debug)]
pub(super) struct IdSeed([u8; 32]);

impl IdSeed {
    pub fn from_replay(replay: &Replay<'_>) -> Self {
        let mut text = Vec::new();
        // Writing to memory cannot fail.
        let _ = json::write(replay.report, &mut text);
        Self(*blake3::hash(&text).as_bytes())
    }

    pub fn id(self, what: &str) -> u128 {
        let hash = blake3::keyed_hash(&self.0, what.as_bytes());
        let first: [u8; 16] = std::array::from_fn(|at| hash.as_bytes()[at]);
        u128::from_le_bytes(first)
    }
}

pub(super) struct ChunkWriter {
    pub seed: IdSeed,
    recording: StoreId,
    layout: StoreId,
    rows: RefCell<RowIds>,
}

struct RowIds {
    /// Start of the run, ns since 1970.
    nanos: u64,
    next: u64,
    chunks: Vec<(StoreId, Chunk)>,
}

impl ChunkWriter {
    /// Without `id`, the recording's id is derived from the content.
    pub fn new(replay: &Replay<'_>, application: &ApplicationId, id: Option<String>) -> Self {
        /// Leaves room for ids above and below.
        const FIRST_ROW_ID: u64 = 0x3fff_ffff_0000_0000;
        let seed = IdSeed::from_replay(replay);
        let own = |what: &str| format!("{:032x}", seed.id(what));
        let store = |kind, id: String| StoreId::new(kind, application.clone(), id);
        let nanos = u64::try_from(replay.span.0.nanos()).unwrap_or_default();
        let next = seed.id("rows") as u64 & FIRST_ROW_ID;
        Self {
            seed,
            recording: store(StoreKind::Recording, id.unwrap_or_else(|| own("recording"))),
            layout: store(StoreKind::Blueprint, own("blueprint")),
            rows: RefCell::new(RowIds { nanos, next, chunks: Vec::new() }),
        }
    }

    /// Adds a row without times.
    pub fn log_static(
        &self,
        path: &EntityPath,
        what: &impl AsComponents,
    ) -> Result<(), ReplayCause> {
        self.add(&self.recording, Self::row(path.clone(), TimePoint::default(), what)?);
        Ok(())
    }

    /// One row per entry of `times`.
    pub fn log_columns(
        &self,
        path: &EntityPath,
        times: impl IntoIterator<Item = TimeColumn>,
        columns: impl Iterator<Item = SerializedComponentColumn>,
    ) -> Result<(), ReplayCause> {
        let times = times.into_iter().map(|times| (*times.timeline().name(), times)).collect();
        let columns = columns.map(|column| (column.descriptor, column.list_array)).collect();
        let chunk = Chunk::from_auto_row_ids(ChunkId::ZERO, path.clone(), times, columns)?;
        self.add(&self.recording, chunk);
        Ok(())
    }

    pub fn log_layout(
        &self,
        path: String,
        at: TimePoint,
        what: &impl AsComponents,
    ) -> Result<(), ReplayCause> {
        self.add(&self.layout, Self::row(path.into(), at, what)?);
        Ok(())
    }

    fn row(
        path: EntityPath,
        at: TimePoint,
        what: &impl AsComponents,
    ) -> Result<Chunk, ReplayCause> {
        let row = Chunk::builder_with_id(ChunkId::ZERO, path);
        Ok(row.with_archetype(RowId::ZERO, at, what).build()?)
    }

    fn add(&self, store: &StoreId, chunk: Chunk) {
        let mut rows = self.rows.borrow_mut();
        let (id, row) = (rows.reserve(1), rows.reserve(chunk.num_rows()));
        let chunk = chunk.clone_as(ChunkId::from_tuid(id), RowId::from_tuid(row));
        rows.chunks.push((store.clone(), chunk));
    }

    /// The viewer activates the layout when it is complete.
    ///
    /// # Errors
    /// If a chunk cannot be encoded.
    pub fn messages(self) -> Result<Vec<LogMsg>, ReplayCause> {
        let mut rows = self.rows.into_inner();
        let mut info = |store: &StoreId| {
            let source = StoreSource::Other("poseaudit".to_owned());
            let info = StoreInfo::new(store.clone(), source);
            LogMsg::SetStoreInfo(SetStoreInfo { row_id: rows.reserve(1), info })
        };
        let mut messages = vec![info(&self.recording), info(&self.layout)];
        for (store, chunk) in rows.chunks {
            messages.push(LogMsg::ArrowMsg(store, chunk.to_arrow_msg()?));
        }
        messages.push(BlueprintActivationCommand::make_active(self.layout).into());
        Ok(messages)
    }
}

impl RowIds {
    /// Reserves `count` ids and returns the first. Ids ascend like a clock's.
    fn reserve(&mut self, count: usize) -> Tuid {
        let first = self.next;
        self.next += count as u64;
        Tuid::from_nanos_and_inc(self.nanos, first)
    }
}
