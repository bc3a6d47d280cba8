//! Chunks unpacked ahead of their reading, on all cores that an audit may use.
//!
//! What a chunk unpacks to depends on nothing but its own bytes, and is most of the work of reading
//! a log. So that alone is done ahead, by other threads. The records inside are read by one thread in
//! the order of the file, as if nothing had been done ahead.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, Scope};

use super::unpack::{Packed, UnpackedChunk, Unpacker};

/// Bytes of chunks that wait to be read, unpacked, beyond which no other is handed in; and the most
/// that one of them has.
const MOST_BYTES: u64 = 24 << 20;

/// How far beyond what is being read chunks are looked for, in bytes: a file may have none.
pub(super) const MOST_DISTANCE: usize = 64 << 20;

/// Most threads that unpack. One thread reads what they unpack, and keeps up with no more.
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
    content: Receiver<UnpackedChunk>,
}

struct Task<'env> {
    packed: Packed<'env>,
    buffer: Vec<u8>,
    reply: SyncSender<UnpackedChunk>,
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
    pub(super) fn unpack(&mut self, offset: usize, packed: Packed<'env>) {
        if packed.size > MOST_BYTES {
            return;
        }
        let (reply, content) = sync_channel(1);
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
        if tasks.send(Task { packed, buffer, reply }).is_ok() {
            self.bytes += packed.size;
            self.waiting.push_back(Waiting { offset, packed, content });
        }
    }

    /// The chunk whose record is at `offset`, if it was handed in. Those before it are dropped.
    pub(super) fn take(&mut self, offset: usize) -> Option<UnpackedChunk> {
        while self.waiting.front().is_some_and(|waiting| waiting.offset <= offset) {
            let waiting = self.waiting.pop_front()?;
            self.bytes -= waiting.packed.size;
            if waiting.offset == offset {
                return waiting.content.recv().ok();
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
    loop {
        // The lock is held while waiting: whoever has it is the next to get a chunk.
        let task = queue.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(Task { packed, buffer, reply }) = task else { return };
        // Nobody waits for a chunk that was passed over.
        let _passed_over = reply.send(unpacker.chunk_into(buffer, &packed));
    }
}
