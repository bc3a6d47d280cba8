//! Rows of a database, copied for a thread that decodes them while SQLite finds the next: what it hands out
//! is gone with the next row.

use std::ops::Range;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use crate::intake::{ChannelId, Intake, MOST_AT_ONCE};
use crate::topic::{Message, Place};

/// Bytes of a batch beyond which no row is added to it.
const ENOUGH_BYTES: usize = 1 << 20;

/// Batches that wait to be decoded.
const WAITING: usize = 3;

/// Some rows.
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
                place: Place::Row(row.id),
                latched: false,
            };
            (row.channel, message)
        };
        intake.batch(&mut self.rows.iter().map(message).collect());
        self.bytes.clear();
        self.rows.clear();
    }
}

/// Takes rows in their order.
pub(super) struct Batches<'a> {
    filling: Batch,
    sink: Sink<'a>,
}

/// Where full batches go.
enum Sink<'a> {
    /// They are decoded at once.
    Here(&'a mut Intake),
    /// Another thread decodes them, and gives them back empty.
    Beside { full: SyncSender<Batch>, empty: Receiver<Batch> },
}

impl Batches<'_> {
    /// Adds a row.
    pub(super) fn add(&mut self, channel: ChannelId, id: i64, time: u64, data: &[u8]) {
        let Batch { bytes, rows } = &mut self.filling;
        let from = bytes.len();
        bytes.extend_from_slice(data);
        rows.push(Row { channel, id, time, data: from..bytes.len() });
        if bytes.len() >= ENOUGH_BYTES || rows.len() == MOST_AT_ONCE {
            self.flush();
        }
    }

    fn flush(&mut self) {
        match &mut self.sink {
            Sink::Here(intake) => self.filling.decode(intake),
            Sink::Beside { full, empty } => {
                let next = empty.try_recv().unwrap_or_default();
                // Only a panic ends the other thread before all was sent, and that goes on here.
                let _panics = full.send(std::mem::replace(&mut self.filling, next));
            }
        }
    }
}

/// Runs `read`; what it adds is decoded into `intake`, in its order, by another thread if there may be one.
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
        let (full, waiting) = sync_channel::<Batch>(WAITING);
        let (done, empty) = sync_channel(WAITING + 2);
        scope.spawn(move || {
            for mut batch in waiting {
                batch.decode(intake);
                // When nothing more is read, nobody wants it.
                let _at_the_end = done.try_send(batch);
            }
        });
        through(Sink::Beside { full, empty })
    })
}
