//! Decompresses chunks in advance on several threads. If possible, the same thread also parses the records
//! while they are in its cache. One thread collects the results in file order.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Scope};

use super::part::{PartContent, PartParser};
use super::unpack::{Packed, UnpackedChunk, Unpacker};

/// Maximum decompressed size of all waiting chunks, and of one, in bytes.
const MAX_QUEUED_BYTES: u64 = 24 << 20;

/// Maximum distance of the search for chunks, in bytes: a file may have none.
pub(super) const MAX_LOOKAHEAD_BYTES: usize = 64 << 20;

/// Maximum number of threads. The thread that collects the results cannot keep up with more.
const MAX_THREADS: usize = 6;

const QUEUED_PER_THREAD: usize = 3;

/// Chunks being decompressed, in file order.
pub(super) struct ChunkPool<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    tasks: Option<SyncSender<Task<'env>>>,
    threads: usize,
    waiting: VecDeque<QueuedChunk<'env>>,
    /// Decompressed size of the waiting chunks.
    bytes: u64,
    buffers: Vec<Vec<u8>>,
}

struct QueuedChunk<'env> {
    offset: usize,
    packed: Packed<'env>,
    done: Receiver<ChunkResult>,
}

struct Task<'env> {
    offset: usize,
    packed: Packed<'env>,
    records: Option<Arc<dyn PartParser>>,
    buffer: Vec<u8>,
    reply: SyncSender<ChunkResult>,
}

pub(super) enum ChunkResult {
    Unpacked(UnpackedChunk),
    Read(PartContent),
}

impl ChunkResult {
    pub(super) fn unpacked(self) -> Option<UnpackedChunk> {
        match self {
            Self::Unpacked(unpacked) => Some(unpacked),
            Self::Read(_) => None,
        }
    }
}

pub(super) fn with_pool<'env, R>(
    read: impl for<'scope> FnOnce(&mut ChunkPool<'scope, 'env>) -> R,
) -> R {
    let threads = rayon::current_num_threads().min(MAX_THREADS);
    thread::scope(|scope| {
        read(&mut ChunkPool {
            scope,
            tasks: None,
            threads,
            waiting: VecDeque::new(),
            bytes: 0,
            buffers: Vec::new(),
        })
    })
}

impl<'env> ChunkPool<'_, 'env> {
    pub(super) fn has_room(&self) -> bool {
        self.threads > 1
            && self.bytes < MAX_QUEUED_BYTES
            && self.waiting.len() < QUEUED_PER_THREAD * self.threads
    }

    /// Queues the chunk whose record is at `offset`. Larger chunks are decompressed when they are read.
    pub(super) fn unpack(
        &mut self,
        offset: usize,
        packed: Packed<'env>,
        records: Option<Arc<dyn PartParser>>,
    ) {
        if packed.size > MAX_QUEUED_BYTES {
            return;
        }
        let (reply, done) = sync_channel(1);
        let buffer = self.buffers.pop().unwrap_or_default();
        let tasks = self.tasks.get_or_insert_with(|| {
            let (tasks, queue) = sync_channel::<Task<'env>>(QUEUED_PER_THREAD * self.threads);
            let queue = Arc::new(Mutex::new(queue));
            for _ in 0..self.threads {
                let queue = Arc::clone(&queue);
                self.scope.spawn(move || run_worker(&queue));
            }
            tasks
        });
        if tasks.send(Task { offset, packed, records, buffer, reply }).is_ok() {
            self.bytes += packed.size;
            self.waiting.push_back(QueuedChunk { offset, packed, done });
        }
    }

    /// Result of the chunk whose record is at `offset`, if queued. Drops earlier ones.
    pub(super) fn take_result(&mut self, offset: usize) -> Option<ChunkResult> {
        while self.waiting.front().is_some_and(|waiting| waiting.offset <= offset) {
            let waiting = self.waiting.pop_front()?;
            self.bytes -= waiting.packed.size;
            if waiting.offset == offset {
                return waiting.done.recv().ok();
            }
        }
        None
    }

    pub(super) fn recycle(&mut self, unpacked: UnpackedChunk) {
        self.buffers.push(unpacked.buffer);
    }
}

fn run_worker(queue: &Mutex<Receiver<Task<'_>>>) {
    let mut unpacker = Unpacker::default();
    let mut own = Vec::new();
    loop {
        // The lock is held while waiting: its owner gets the next chunk.
        let task = queue.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(Task { offset, packed, records, buffer, reply }) = task else { return };
        let buffer = if buffer.capacity() > 0 { buffer } else { std::mem::take(&mut own) };
        let unpacked = unpacker.chunk_into(buffer, &packed);
        let content = unpacked.if_sound(&packed);
        let part =
            content.zip(records).and_then(|(content, records)| records.part(content, offset));
        let done = match part {
            Some(part) => {
                own = unpacked.buffer;
                ChunkResult::Read(part)
            }
            None => ChunkResult::Unpacked(unpacked),
        };
        let _passed_over = reply.send(done);
    }
}
