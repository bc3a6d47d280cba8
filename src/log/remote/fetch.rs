//! Downloads an object to a temporary file.

use std::cell::Cell;
use std::io::{self, Seek, SeekFrom, Write};
use std::ops::Range;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::{GetOptions, GetRange, GetResult, ObjectMeta};
use tokio::runtime::{Builder, Runtime};
use tokio::time::{sleep, timeout};

use super::fault::RemoteFault;
use super::patience::Patience;
use super::store::Source;
use super::{Address, Fetched, cause};
use crate::mapped::Mapped;
use crate::mcap::{self, Survey};
use crate::ranges::{Present, Ranges};
use crate::sniff::{self, Kind};
use crate::unpack::Unpacked;
use crate::{Progress, ReadOptions};

/// Size of the first request, which also returns the size of the object.
const HEAD: usize = 64 << 10;

/// Size of the first request at the end of an MCAP file; contains all or most of the summary.
const TAIL: usize = 64 << 10;

/// Objects up to this size are downloaded completely, which is faster than requesting parts.
const SMALL: usize = 1 << 20;

/// Maximum gap that is downloaded with its neighbours, which is faster than another request.
const GAP: usize = 16 << 10;

/// Maximum size of a request.
const PIECE: usize = 8 << 20;

/// Maximum number of concurrent requests.
const AT_ONCE: usize = 32;

/// Maximum number of survey rounds. Summary, indexes, messages and the gaps between them need four.
const ROUNDS: usize = 64;

/// Maximum number of attempts for a request whose connection breaks off.
const TRIES: u32 = 5;

/// Pause before the first retry; doubled for each further one.
const PAUSE: Duration = Duration::from_millis(200);

/// Maximum time until an answer, including the client's retries.
const ANSWER: Duration = Duration::from_secs(50);

/// Maximum time between two parts of an answer before the rest is requested again.
const STALL: Duration = Duration::from_secs(10);

/// Downloads the parts of the object at `address` that are needed, or all of it for verification.
pub(super) fn fetch(address: &Address, options: &ReadOptions) -> Result<Fetched, RemoteFault> {
    let source = Source::of(address)?;
    let came = Rc::clone(&source.came);
    let work = async {
        let mut object = match head(&source).await? {
            Head::Part { meta, bytes } => Object::of(source, meta, &bytes, options)?,
            Head::Whole => {
                let is_told = Cell::new(false);
                return again(async || whole(&source, options, &is_told).await).await;
            }
        };
        if !options.verify && object.size > SMALL && object.kind == Kind::Mcap {
            object.fetch_what_is_read().await?;
        } else {
            object.fetch(Ranges::up_to(object.size)).await?;
        }
        Ok(object.finish())
    };
    let patience = Patience::of_environment()?;
    runtime()?.block_on(patience.watch(&came, work))
}

/// Runtime of the clients, on the current thread.
pub(super) fn runtime() -> Result<Runtime, RemoteFault> {
    Builder::new_current_thread().enable_all().build().map_err(disk)
}

fn disk(source: io::Error) -> RemoteFault {
    RemoteFault::Disk { source }
}

/// Result of the first request.
enum Head {
    /// The first bytes.
    Part { meta: ObjectMeta, bytes: Vec<u8> },
    /// The server does not support ranges.
    Whole,
}

async fn head(source: &Source) -> Result<Head, RemoteFault> {
    again(async || {
        let (meta, answer) = match ask(source, Some(0..HEAD)).await? {
            Ok(answer) => (answer.meta.clone(), Some(answer)),
            Err(object_store::Error::NotSupported { .. }) => return Ok(Head::Whole),
            // An empty object has no first byte.
            Err(error) if cause::is_behind_end(&error) => {
                let options = GetOptions { head: true, ..GetOptions::default() };
                let answer = patiently(source.client.get_opts(&source.key, options)).await?;
                (answer.map_err(|error| cause::fault(&error, source.store))?.meta, None)
            }
            Err(error) => return Err(cause::fault(&error, source.store)),
        };
        let mut bytes = Vec::new();
        if let Some(answer) = answer {
            let keep = |part: &[u8]| {
                bytes.extend_from_slice(part);
                Ok(())
            };
            read(answer, source, &Cell::new(0), keep).await?;
        }
        Ok(Head::Part { meta, bytes })
    })
    .await
}

/// Downloads a complete object, for servers without ranges. `is_told` stores whether its size was reported
/// as progress.
async fn whole(
    source: &Source,
    options: &ReadOptions,
    is_told: &Cell<bool>,
) -> Result<Fetched, RemoteFault> {
    let answer = ask(source, None).await?.map_err(|error| cause::fault(&error, source.store))?;
    let size = answer.meta.size;
    let mut file = None;
    if let Some(progress) = options.progress.as_ref().filter(|_| !is_told.replace(true)) {
        progress.grow(size);
    }
    let at = Cell::new(0);
    let keep = |part: &[u8]| {
        let file = match &mut file {
            None => file.insert(Unpacked::of(part).map_err(disk)?),
            Some(file) => file,
        };
        options.at(at.get());
        file.file.write_all(part).map_err(disk)
    };
    read(answer, source, &at, keep).await?;
    let file = file.map_or_else(|| Unpacked::of(&[]), Ok).map_err(disk)?;
    Ok(Fetched { file, present: Present::Whole, bytes: at.get() as u64 })
}

/// An object during its download.
struct Object {
    source: Source,
    /// Entity tag in the first answer.
    e_tag: Option<String>,
    size: usize,
    kind: Kind,
    file: Unpacked,
    /// Ranges that are in the file.
    present: Ranges,
    /// Bytes received, including repeated ones.
    fetched: Cell<usize>,
    /// Total number of bytes planned so far.
    planned: usize,
    progress: Option<Arc<Progress>>,
}

impl Object {
    /// Creates the file from the first bytes, `head`.
    fn of(
        source: Source,
        meta: ObjectMeta,
        head: &[u8],
        options: &ReadOptions,
    ) -> Result<Self, RemoteFault> {
        let too_large =
            |_| RemoteFault::Refused { cause: format!("its size is {} bytes", meta.size) };
        let size = usize::try_from(meta.size).map_err(too_large)?;
        let mut file = Unpacked::of(head).map_err(disk)?;
        file.file.set_len(meta.size).and_then(|()| file.file.write_all(head)).map_err(disk)?;
        if let Some(progress) = &options.progress {
            progress.grow(meta.size);
        }
        Ok(Self {
            source,
            e_tag: meta.e_tag,
            size,
            kind: sniff::kind(head),
            file,
            present: Ranges::up_to(head.len()),
            fetched: Cell::new(head.len()),
            planned: head.len(),
            progress: options.progress.clone(),
        })
    }

    fn finish(self) -> Fetched {
        let present = Present::of(self.present, self.size);
        Fetched { file: self.file, present, bytes: self.fetched.get() as u64 }
    }

    /// Downloads the ranges that the MCAP reader needs; all of it if there is no index.
    async fn fetch_what_is_read(&mut self) -> Result<(), RemoteFault> {
        let tail = self.size.saturating_sub(TAIL)..self.size;
        self.fetch(Ranges::of(vec![tail], GAP)).await?;
        for _ in 0..ROUNDS {
            let present = Present::of(self.present.clone(), self.size);
            let mapped = Mapped::of(&self.file.file).map_err(disk)?;
            let survey = mcap::survey(mapped.bytes(), &present);
            // The file must not change while it is mapped.
            drop(mapped);
            match survey {
                Survey::Nothing => return Ok(()),
                Survey::Parts(parts) => self.fetch(Ranges::of(parts, GAP)).await?,
                Survey::Rest => break,
            }
        }
        self.fetch(Ranges::up_to(self.size)).await
    }

    /// Downloads the missing parts of `wanted`.
    async fn fetch(&mut self, wanted: Ranges) -> Result<(), RemoteFault> {
        let missing = self.present.missing(&wanted);
        self.planned = self.fetched.get() + missing.bytes();
        let pieces = stream::iter(missing.pieces(PIECE)).map(|piece| self.piece(piece));
        pieces.buffer_unordered(AT_ONCE).try_for_each(|()| async { Ok(()) }).await?;
        self.present.extend(missing);
        Ok(())
    }

    /// Downloads one piece; if the connection breaks off, continues with the rest.
    async fn piece(&self, piece: Range<usize>) -> Result<(), RemoteFault> {
        let at = Cell::new(piece.start);
        again(async || {
            let answer = ask(&self.source, Some(at.get()..piece.end)).await?;
            let answer = answer.map_err(|error| cause::fault(&error, self.source.store))?;
            if answer.meta.e_tag != self.e_tag || answer.meta.size != self.size as u64 {
                return Err(RemoteFault::Changed);
            }
            read(answer, &self.source, &at, |part| self.keep(at.get(), part)).await
        })
        .await
    }

    /// Writes received bytes at offset `at`.
    fn keep(&self, at: usize, part: &[u8]) -> Result<(), RemoteFault> {
        let mut file = &self.file.file;
        file.seek(SeekFrom::Start(at as u64)).and_then(|_| file.write_all(part)).map_err(disk)?;
        self.fetched.update(|fetched| fetched + part.len());
        if let Some(progress) = &self.progress {
            let share = self.fetched.get() as f64 / self.planned as f64;
            // The progress is only complete after the last request.
            progress.at((self.size as f64 * share.min(0.99)) as u64);
        }
        Ok(())
    }
}

/// Requests a range of an object, or all of it.
async fn ask(
    source: &Source,
    range: Option<Range<usize>>,
) -> Result<Result<GetResult, object_store::Error>, RemoteFault> {
    let bounded = |range: Range<usize>| GetRange::Bounded(range.start as u64..range.end as u64);
    let options = GetOptions { range: range.map(bounded), ..GetOptions::default() };
    patiently(source.client.get_opts(&source.key, options)).await
}

/// Waits for an answer, up to the time limit.
pub(super) async fn patiently<T>(answer: impl Future<Output = T>) -> Result<T, RemoteFault> {
    let silent = |_| RemoteFault::Silent { seconds: ANSWER.as_secs() };
    timeout(ANSWER, answer).await.map_err(silent)
}

/// Passes the parts of an answer to `keep`; `at` is the current offset.
async fn read(
    answer: GetResult,
    source: &Source,
    at: &Cell<usize>,
    mut keep: impl FnMut(&[u8]) -> Result<(), RemoteFault>,
) -> Result<(), RemoteFault> {
    let length = answer.range.end - answer.range.start;
    let end = at.get() + usize::try_from(length).unwrap_or(usize::MAX);
    let broken = |cause| RemoteFault::BrokenOff { byte: at.get() as u64, cause };
    let mut parts = answer.into_stream();
    loop {
        let next = timeout(STALL, parts.next()).await;
        match next.map_err(|_| RemoteFault::Silent { seconds: STALL.as_secs() })? {
            Some(Ok(part)) if part.len() <= end - at.get() => {
                keep(&part)?;
                source.came.update(|came| came + part.len());
                at.set(at.get() + part.len());
            }
            Some(Ok(_)) => return Err(broken("it sent more than was requested".to_owned())),
            Some(Err(error)) => return Err(broken(cause::deepest(&error))),
            None if at.get() < end => {
                return Err(broken("it sent less than it announced".to_owned()));
            }
            None => return Ok(()),
        }
    }
}

/// Runs `attempt`, and retries after a pause if the connection broke off or stalled.
async fn again<T>(
    mut attempt: impl AsyncFnMut() -> Result<T, RemoteFault>,
) -> Result<T, RemoteFault> {
    let mut pause = PAUSE;
    for _ in 1..TRIES {
        match attempt().await {
            Err(RemoteFault::BrokenOff { .. } | RemoteFault::Silent { .. }) => sleep(pause).await,
            result => return result,
        }
        pause *= 2;
    }
    attempt().await
}
