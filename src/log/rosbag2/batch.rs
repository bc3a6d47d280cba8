//! Batches of database rows, copied for a thread that decodes them: SQLite invalidates a row when it reads
//! the next.

use std::ops::Range;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use crate::intake::{ChannelId, Intake, MAX_BATCH_MESSAGES};
use crate::topic::{Message, MessagePlace};

const BATCH_BYTES: usize = 1 << 20;

const MAX_QUEUED_BATCHES: usize = 3;

#[derive(Default)]
struct Batch {
    bytes: Vec<u8>,
    rows: Vec<Row>,
}

struct Row {
    channel: ChannelId,
    id: i64,
    time: u64,
    data: Range<usize>,
}

impl Batch {
    fn decode(&mut self, intake: &mut Intake) {
        let message = |row: &Row| {
            let message = Message {
                log_time: row.time,
                publish_time: row.time,
                sequence: 0,
                data: &self.bytes[row.data.clone()],
                place: MessagePlace::Row(row.id),
                latched: false,
            };
            (row.channel, message)
        };
        intake.batch(&mut self.rows.iter().map(message).collect());
        self.bytes.clear();
        self.rows.clear();
    }
}

pub(super) struct Batches<'a> {
    filling: Batch,
    sink: Sink<'a>,
}

enum Sink<'a> {
    Here(&'a mut Intake),
    /// Decoded by another thread, which returns them empty.
    Beside {
        full: SyncSender<Batch>,
        empty: Receiver<Batch>,
    },
}

impl Batches<'_> {
    pub(super) fn add(&mut self, channel: ChannelId, id: i64, time: u64, data: &[u8]) {
        let Batch { bytes, rows } = &mut self.filling;
        let from = bytes.len();
        bytes.extend_from_slice(data);
        rows.push(Row { channel, id, time, data: from..bytes.len() });
        if bytes.len() >= BATCH_BYTES || rows.len() == MAX_BATCH_MESSAGES {
            self.flush();
        }
    }

    fn flush(&mut self) {
        match &mut self.sink {
            Sink::Here(intake) => self.filling.decode(intake),
            Sink::Beside { full, empty } => {
                let next = empty.try_recv().unwrap_or_default();
                // The other thread only ends early if it panics; the scope propagates the panic.
                let _panics = full.send(std::mem::replace(&mut self.filling, next));
            }
        }
    }
}

/// Runs `read` and decodes its rows into `intake`, in order, in another thread if possible.
pub(super) fn decoded<R>(intake: &mut Intake, read: impl FnOnce(&mut Batches<'_>) -> R) -> R {
    let through = |sink: Sink<'_>| {
        let mut batches = Batches { filling: Batch::default(), sink };
        let read = read(&mut batches);
        batches.flush();
        read
    };
    if rayon::current_num_threads() == 1 {
        return through(Sink::Here(intake));
    }
    thread::scope(|scope| {
        let (full, waiting) = sync_channel::<Batch>(MAX_QUEUED_BATCHES);
        let (done, empty) = sync_channel(MAX_QUEUED_BATCHES + 2);
        scope.spawn(move || {
            for mut batch in waiting {
                batch.decode(intake);
                // After the last row, empty batches are not needed.
                let _at_the_end = done.try_send(batch);
            }
        });
        through(Sink::Beside { full, empty })
    })
}
