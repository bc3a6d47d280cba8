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
use super::minimum_rate::MinimumRate;
use super::store::Source;
use super::{Address, Fetched, error_cause};
use crate::file_format::{self, FileFormat};
use crate::mapped::MappedFile;
use crate::mcap::{self, Survey};
use crate::ranges::{Present, Ranges};
use crate::unpack::Unpacked;
use crate::{Progress, ReadOptions};

/// First request, which also returns the size of the object.
const HEAD_BYTES: usize = 64 << 10;

/// First request at the end of an MCAP file; contains most of the summary.
const TAIL_BYTES: usize = 64 << 10;

/// Objects up to this size are downloaded completely, which is faster.
const MAX_WHOLE_BYTES: usize = 1 << 20;

/// Maximum gap that is downloaded with its neighbours, which is faster than another request.
const MAX_GAP_BYTES: usize = 16 << 10;

const MAX_REQUEST_BYTES: usize = 8 << 20;

const MAX_CONCURRENT_REQUESTS: usize = 32;

/// Summary, indexes, messages and the gaps between them need four.
const MAX_SURVEY_ROUNDS: usize = 64;

/// For a request whose connection breaks off.
const MAX_ATTEMPTS: u32 = 5;

/// Doubled for each further retry.
const FIRST_RETRY_DELAY: Duration = Duration::from_millis(200);

/// Includes the client's retries.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(50);

/// Maximum time between two parts of an answer.
const STALL_TIMEOUT: Duration = Duration::from_secs(10);

pub(super) fn fetch(address: &Address, options: &ReadOptions) -> Result<Fetched, RemoteFault> {
    let source = Source::connect(address)?;
    let came = Rc::clone(&source.came);
    let work = async {
        let mut object = match fetch_head(&source).await? {
            Head::Part { meta, bytes } => Object::create(source, meta, &bytes, options)?,
            Head::Whole => {
                let is_told = Cell::new(false);
                return with_retries(async || fetch_whole(&source, options, &is_told).await).await;
            }
        };
        if !options.verify && object.size > MAX_WHOLE_BYTES && object.kind == FileFormat::Mcap {
            object.fetch_needed().await?;
        } else {
            object.fetch(Ranges::up_to(object.size)).await?;
        }
        Ok(object.finish())
    };
    let patience = MinimumRate::from_environment()?;
    runtime()?.block_on(patience.watch(&came, work))
}

pub(super) fn runtime() -> Result<Runtime, RemoteFault> {
    Builder::new_current_thread().enable_all().build().map_err(disk_error)
}

fn disk_error(source: io::Error) -> RemoteFault {
    RemoteFault::Disk { source }
}

enum Head {
    Part {
        meta: ObjectMeta,
        bytes: Vec<u8>,
    },
    /// The server does not support ranges.
    Whole,
}

async fn fetch_head(source: &Source) -> Result<Head, RemoteFault> {
    with_retries(async || {
        let (meta, answer) = match send_request(source, Some(0..HEAD_BYTES)).await? {
            Ok(answer) => (answer.meta.clone(), Some(answer)),
            Err(object_store::Error::NotSupported { .. }) => return Ok(Head::Whole),
            // An empty object has no first byte.
            Err(error) if error_cause::is_range_beyond_end(&error) => {
                let options = GetOptions { head: true, ..GetOptions::default() };
                let answer = with_timeout(source.client.get_opts(&source.key, options)).await?;
                (
                    answer.map_err(|error| error_cause::remote_fault(&error, source.store))?.meta,
                    None,
                )
            }
            Err(error) => return Err(error_cause::remote_fault(&error, source.store)),
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

/// Downloads a complete object from a server without ranges. `is_told` stores whether its size was
/// reported.
async fn fetch_whole(
    source: &Source,
    options: &ReadOptions,
    is_told: &Cell<bool>,
) -> Result<Fetched, RemoteFault> {
    let answer = send_request(source, None)
        .await?
        .map_err(|error| error_cause::remote_fault(&error, source.store))?;
    let size = answer.meta.size;
    let mut file = None;
    if let Some(progress) = options.progress.as_ref().filter(|_| !is_told.replace(true)) {
        progress.add_total(size);
    }
    let at = Cell::new(0);
    let keep = |part: &[u8]| {
        let file = match &mut file {
            None => file.insert(Unpacked::create(part).map_err(disk_error)?),
            Some(file) => file,
        };
        options.set_position(at.get());
        file.file.write_all(part).map_err(disk_error)
    };
    read(answer, source, &at, keep).await?;
    let file = file.map_or_else(|| Unpacked::create(&[]), Ok).map_err(disk_error)?;
    Ok(Fetched { file, present: Present::Whole, bytes: at.get() as u64 })
}

struct Object {
    source: Source,
    e_tag: Option<String>,
    size: usize,
    kind: FileFormat,
    file: Unpacked,
    present: Ranges,
    /// Bytes received, including repeated ones.
    fetched: Cell<usize>,
    planned: usize,
    progress: Option<Arc<Progress>>,
}

impl Object {
    fn create(
        source: Source,
        meta: ObjectMeta,
        head: &[u8],
        options: &ReadOptions,
    ) -> Result<Self, RemoteFault> {
        let too_large =
            |_| RemoteFault::Refused { cause: format!("its size is {} bytes", meta.size) };
        let size = usize::try_from(meta.size).map_err(too_large)?;
        let mut file = Unpacked::create(head).map_err(disk_error)?;
        file.file
            .set_len(meta.size)
            .and_then(|()| file.file.write_all(head))
            .map_err(disk_error)?;
        if let Some(progress) = &options.progress {
            progress.add_total(meta.size);
        }
        Ok(Self {
            source,
            e_tag: meta.e_tag,
            size,
            kind: file_format::detect_format(head),
            file,
            present: Ranges::up_to(head.len()),
            fetched: Cell::new(head.len()),
            planned: head.len(),
            progress: options.progress.clone(),
        })
    }

    fn finish(self) -> Fetched {
        let present = Present::from_ranges(self.present, self.size);
        Fetched { file: self.file, present, bytes: self.fetched.get() as u64 }
    }

    /// Fetches the needed parts, or everything without an index.
    async fn fetch_needed(&mut self) -> Result<(), RemoteFault> {
        let tail = self.size.saturating_sub(TAIL_BYTES)..self.size;
        self.fetch(Ranges::new(vec![tail], MAX_GAP_BYTES)).await?;
        for _ in 0..MAX_SURVEY_ROUNDS {
            let present = Present::from_ranges(self.present.clone(), self.size);
            let mapped = MappedFile::from_temporary(&self.file.file).map_err(disk_error)?;
            let survey = mcap::survey(mapped.bytes(), &present);
            // The file must not change while it is mapped.
            drop(mapped);
            match survey {
                Survey::Nothing => return Ok(()),
                Survey::Parts(parts) => self.fetch(Ranges::new(parts, MAX_GAP_BYTES)).await?,
                Survey::Rest => break,
            }
        }
        self.fetch(Ranges::up_to(self.size)).await
    }

    async fn fetch(&mut self, wanted: Ranges) -> Result<(), RemoteFault> {
        let missing = self.present.missing(&wanted);
        self.planned = self.fetched.get() + missing.bytes();
        let pieces =
            stream::iter(missing.pieces(MAX_REQUEST_BYTES)).map(|piece| self.fetch_piece(piece));
        pieces
            .buffer_unordered(MAX_CONCURRENT_REQUESTS)
            .try_for_each(|()| async { Ok(()) })
            .await?;
        self.present.extend(missing);
        Ok(())
    }

    /// If the connection breaks off, continues with the rest.
    async fn fetch_piece(&self, piece: Range<usize>) -> Result<(), RemoteFault> {
        let at = Cell::new(piece.start);
        with_retries(async || {
            let answer = send_request(&self.source, Some(at.get()..piece.end)).await?;
            let answer =
                answer.map_err(|error| error_cause::remote_fault(&error, self.source.store))?;
            if answer.meta.e_tag != self.e_tag || answer.meta.size != self.size as u64 {
                return Err(RemoteFault::Changed);
            }
            read(answer, &self.source, &at, |part| self.write_at(at.get(), part)).await
        })
        .await
    }

    fn write_at(&self, at: usize, part: &[u8]) -> Result<(), RemoteFault> {
        let mut file = &self.file.file;
        file.seek(SeekFrom::Start(at as u64))
            .and_then(|_| file.write_all(part))
            .map_err(disk_error)?;
        self.fetched.update(|fetched| fetched + part.len());
        if let Some(progress) = &self.progress {
            let share = self.fetched.get() as f64 / self.planned as f64;
            // Complete only after the last request.
            progress.set_position((self.size as f64 * share.min(0.99)) as u64);
        }
        Ok(())
    }
}

async fn send_request(
    source: &Source,
    range: Option<Range<usize>>,
) -> Result<Result<GetResult, object_store::Error>, RemoteFault> {
    let bounded = |range: Range<usize>| GetRange::Bounded(range.start as u64..range.end as u64);
    let options = GetOptions { range: range.map(bounded), ..GetOptions::default() };
    with_timeout(source.client.get_opts(&source.key, options)).await
}

pub(super) async fn with_timeout<T>(answer: impl Future<Output = T>) -> Result<T, RemoteFault> {
    let silent = |_| RemoteFault::Silent { seconds: ANSWER_TIMEOUT.as_secs() };
    timeout(ANSWER_TIMEOUT, answer).await.map_err(silent)
}

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
        let next = timeout(STALL_TIMEOUT, parts.next()).await;
        match next.map_err(|_| RemoteFault::Silent { seconds: STALL_TIMEOUT.as_secs() })? {
            Some(Ok(part)) if part.len() <= end - at.get() => {
                keep(&part)?;
                source.came.update(|came| came + part.len());
                at.set(at.get() + part.len());
            }
            Some(Ok(_)) => return Err(broken("it sent more than was requested".to_owned())),
            Some(Err(error)) => return Err(broken(error_cause::innermost_cause(&error))),
            None if at.get() < end => {
                return Err(broken("it sent less than it announced".to_owned()));
            }
            None => return Ok(()),
        }
    }
}

/// Retries `attempt` after a pause if the connection broke off or stalled.
async fn with_retries<T>(
    mut attempt: impl AsyncFnMut() -> Result<T, RemoteFault>,
) -> Result<T, RemoteFault> {
    let mut pause = FIRST_RETRY_DELAY;
    for _ in 1..MAX_ATTEMPTS {
        match attempt().await {
            Err(RemoteFault::BrokenOff { .. } | RemoteFault::Silent { .. }) => sleep(pause).await,
            result => return result,
        }
        pause *= 2;
    }
    attempt().await
}
