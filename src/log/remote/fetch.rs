//! The bytes of an object, into a temporary file.

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

/// Bytes of the first request, which also says how many there are.
const HEAD: usize = 64 << 10;

/// Bytes of the end of an MCAP that are fetched before it is looked into: its summary, or most of it.
const TAIL: usize = 64 << 10;

/// Objects up to this size are fetched whole: to ask what is needed takes longer.
const SMALL: usize = 1 << 20;

/// What stands between two ranges is fetched with them where it is no longer than this: another
/// request takes longer.
const GAP: usize = 16 << 10;

/// Most bytes of one request.
const PIECE: usize = 8 << 20;

/// Most requests at once.
const AT_ONCE: usize = 32;

/// How often what a file needs may be asked for anew. Summary, indexes, messages and what stands
/// between them take four rounds.
const ROUNDS: usize = 64;

/// How often the rest of a piece is asked for where the connection broke off.
const TRIES: u32 = 5;

/// How long is waited before that first; then twice as long each time.
const PAUSE: Duration = Duration::from_millis(200);

/// How long is waited for an answer, with all that the client repeats.
const ANSWER: Duration = Duration::from_secs(50);

/// How long is waited for the next bytes of an answer before they are asked for anew.
const STALL: Duration = Duration::from_secs(10);

/// Fetches what is read of the object at `address`; all of it where everything is to be verified.
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

/// What the clients run in: this thread.
pub(super) fn runtime() -> Result<Runtime, RemoteFault> {
    Builder::new_current_thread().enable_all().build().map_err(disk)
}

fn disk(source: io::Error) -> RemoteFault {
    RemoteFault::Disk { source }
}

/// What the first request brought.
enum Head {
    /// The first bytes.
    Part { meta: ObjectMeta, bytes: Vec<u8> },
    /// That the server hands out whole objects only.
    Whole,
}

async fn head(source: &Source) -> Result<Head, RemoteFault> {
    again(async || {
        let (meta, answer) = match ask(source, Some(0..HEAD)).await? {
            Ok(answer) => (answer.meta.clone(), Some(answer)),
            Err(object_store::Error::NotSupported { .. }) => return Ok(Head::Whole),
            // There is no first byte in an empty object.
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

/// All of an object, of a server that hands out whole ones only. Once its size `is_told` to who
/// watches.
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

/// An object that is being fetched.
struct Object {
    source: Source,
    /// What it was when it was first asked for.
    e_tag: Option<String>,
    size: usize,
    kind: Kind,
    file: Unpacked,
    /// What of it is in the file.
    present: Ranges,
    /// Bytes that came, also those that came twice.
    fetched: Cell<usize>,
    /// Bytes that are to come in all, as far as is known.
    planned: usize,
    progress: Option<Arc<Progress>>,
}

impl Object {
    /// One that begins with `head`.
    fn of(
        source: Source,
        meta: ObjectMeta,
        head: &[u8],
        options: &ReadOptions,
    ) -> Result<Self, RemoteFault> {
        let too_large = |_| RemoteFault::Refused { cause: format!("it has {} bytes", meta.size) };
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

    /// Fetches what the reader of an MCAP looks at: all of it where there is no index.
    async fn fetch_what_is_read(&mut self) -> Result<(), RemoteFault> {
        let tail = self.size.saturating_sub(TAIL)..self.size;
        self.fetch(Ranges::of(vec![tail], GAP)).await?;
        for _ in 0..ROUNDS {
            let present = Present::of(self.present.clone(), self.size);
            let mapped = Mapped::of(&self.file.file).map_err(disk)?;
            let survey = mcap::survey(mapped.bytes(), &present);
            // Nothing is written while it is mapped.
            drop(mapped);
            match survey {
                Survey::Nothing => return Ok(()),
                Survey::Parts(parts) => self.fetch(Ranges::of(parts, GAP)).await?,
                Survey::Rest => break,
            }
        }
        self.fetch(Ranges::up_to(self.size)).await
    }

    /// Fetches what of `wanted` is not there.
    async fn fetch(&mut self, wanted: Ranges) -> Result<(), RemoteFault> {
        let missing = self.present.missing(&wanted);
        self.planned = self.fetched.get() + missing.bytes();
        let pieces = stream::iter(missing.pieces(PIECE)).map(|piece| self.piece(piece));
        pieces.buffer_unordered(AT_ONCE).try_for_each(|()| async { Ok(()) }).await?;
        self.present.extend(missing);
        Ok(())
    }

    /// Fetches one piece: where the connection breaks off, what is left of it.
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

    /// Keeps what came for the bytes from `at` on.
    fn keep(&self, at: usize, part: &[u8]) -> Result<(), RemoteFault> {
        let mut file = &self.file.file;
        file.seek(SeekFrom::Start(at as u64)).and_then(|_| file.write_all(part)).map_err(disk)?;
        self.fetched.update(|fetched| fetched + part.len());
        if let Some(progress) = &self.progress {
            let share = self.fetched.get() as f64 / self.planned as f64;
            // It is whole when nothing more is asked for, and not before.
            progress.at((self.size as f64 * share.min(0.99)) as u64);
        }
        Ok(())
    }
}

/// Asks for a range of an object, or all of it.
async fn ask(
    source: &Source,
    range: Option<Range<usize>>,
) -> Result<Result<GetResult, object_store::Error>, RemoteFault> {
    let bounded = |range: Range<usize>| GetRange::Bounded(range.start as u64..range.end as u64);
    let options = GetOptions { range: range.map(bounded), ..GetOptions::default() };
    patiently(source.client.get_opts(&source.key, options)).await
}

/// An answer that takes no longer than it may.
pub(super) async fn patiently<T>(answer: impl Future<Output = T>) -> Result<T, RemoteFault> {
    let silent = |_| RemoteFault::Silent { seconds: ANSWER.as_secs() };
    timeout(ANSWER, answer).await.map_err(silent)
}

/// Hands on what comes of an answer, and counts it in `at`, which is where it begins.
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
            Some(Ok(_)) => return Err(broken("it sent more than it was asked for".to_owned())),
            Some(Err(error)) => return Err(broken(cause::deepest(&error))),
            None if at.get() < end => return Err(broken("it sent less than it said".to_owned())),
            None => return Ok(()),
        }
    }
}

/// Does `attempt`, and again after a pause where the connection broke off or fell silent.
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
