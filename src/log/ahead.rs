//! Chunks unpacked ahead of their reading, on all cores that an audit may use.
//!
//! What a chunk unpacks to depends on nothing but its own bytes, so that other threads unpack it. Where the
//! format says how, the thread that unpacked a chunk also reads its records into columns of their own,
//! while they are in its cache. What came of the chunks is taken by one thread in the order of the file, as
//! if nothing had been done ahead.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Scope};

use super::part::{Part, Records};
use super::unpack::{Packed, UnpackedChunk, Unpacker};

/// Bytes of chunks that wait to be read, unpacked, beyond which no other is handed in; and the most
/// that one of them has.
const MOST_BYTES: u64 = 24 << 20;

/// How far beyond what is being read chunks are looked for, in bytes: a file may have none.
pub(super) const MOST_DISTANCE: usize = 64 << 20;

/// Most threads that unpack. One thread takes what they made, and keeps up with no more.
const MOST_THREADS: usize = 6;

/// Chunks that wait for each thread.
const WAITING: usize = 3;

/// Chunks that are being unpacked, in the order of the file.
pub(super) struct Ahead<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    /// Set when the threads run.
    tasks: Option<SyncSender<Task<'env>>>,
    threads: usize,
    waiting: VecDeque<Waiting<'env>>,
    /// Bytes that those waiting unpack to.
    bytes: u64,
    /// Buffers for the next ones.
    buffers: Vec<Vec<u8>>,
}

/// A chunk that one of the threads unpacks.
struct Waiting<'env> {
    /// Where in the file its record is.
    offset: usize,
    packed: Packed<'env>,
    done: Receiver<Done>,
}

struct Task<'env> {
    offset: usize,
    packed: Packed<'env>,
    /// How to read its records, where that may be done ahead, too.
    records: Option<Arc<dyn Records>>,
    buffer: Vec<u8>,
    reply: SyncSender<Done>,
}

/// What became of a chunk.
pub(super) enum Done {
    /// It was unpacked, or cannot be.
    Unpacked(UnpackedChunk),
    /// It was unpacked and read.
    Read(Part),
}

impl Done {
    /// What it was unpacked to, where it was not read, too.
    pub(super) fn unpacked(self) -> Option<UnpackedChunk> {
        match self {
            Self::Unpacked(unpacked) => Some(unpacked),
            Self::Read(_) => None,
        }
    }
}

/// Runs `read` with threads that unpack for it.
pub(super) fn with<'env, R>(read: impl for<'scope> FnOnce(&mut Ahead<'scope, 'env>) -> R) -> R {
    let threads = rayon::current_num_threads().min(MOST_THREADS);
    thread::scope(|scope| {
        read(&mut Ahead {
            scope,
            tasks: None,
            threads,
            waiting: VecDeque::new(),
            bytes: 0,
            buffers: Vec::new(),
        })
    })
}

impl<'env> Ahead<'_, 'env> {
    /// Whether another chunk may be handed in.
    pub(super) fn has_room(&self) -> bool {
        self.threads > 1 && self.bytes < MOST_BYTES && self.waiting.len() < WAITING * self.threads
    }

    /// Hands in the chunk whose record is at `offset`: behind all that were handed in before. One
    /// that is larger than all that may wait is left to be unpacked when it is read.
    /// Its records are read where `records` says how.
    pub(super) fn unpack(
        &mut self,
        offset: usize,
        packed: Packed<'env>,
        records: Option<Arc<dyn Records>>,
    ) {
        if packed.size > MOST_BYTES {
            return;
        }
        let (reply, done) = sync_channel(1);
        let buffer = self.buffers.pop().unwrap_or_default();
        let tasks = self.tasks.get_or_insert_with(|| {
            let (tasks, queue) = sync_channel::<Task<'env>>(WAITING * self.threads);
            let queue = Arc::new(Mutex::new(queue));
            for _ in 0..self.threads {
                let queue = Arc::clone(&queue);
                self.scope.spawn(move || work(&queue));
            }
            tasks
        });
        if tasks.send(Task { offset, packed, records, buffer, reply }).is_ok() {
            self.bytes += packed.size;
            self.waiting.push_back(Waiting { offset, packed, done });
        }
    }

    /// The chunk whose record is at `offset`, if it was handed in. Those before it are dropped.
    pub(super) fn take(&mut self, offset: usize) -> Option<Done> {
        while self.waiting.front().is_some_and(|waiting| waiting.offset <= offset) {
            let waiting = self.waiting.pop_front()?;
            self.bytes -= waiting.packed.size;
            if waiting.offset == offset {
                return waiting.done.recv().ok();
            }
        }
        None
    }

    /// Takes back what was read.
    pub(super) fn give_back(&mut self, unpacked: UnpackedChunk) {
        self.buffers.push(unpacked.buffer);
    }
}

/// Unpacks what is in the queue, until nothing will come any more.
fn work(queue: &Mutex<Receiver<Task<'_>>>) {
    let mut unpacker = Unpacker::default();
    // What chunks are unpacked into that are read here.
    let mut own = Vec::new();
    loop {
        // The lock is held while waiting: whoever has it is the next to get a chunk.
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
                Done::Read(part)
            }
            None => Done::Unpacked(unpacked),
        };
        // Nobody waits for a chunk that was passed over.
        let _passed_over = reply.send(done);
    }
}
