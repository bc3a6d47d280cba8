//! Logs over the cores of this machine, each in its own process.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use std::{io, mem};

use serde::Serialize;

use super::child::{Death, Limits, audited};
use super::content::{Content, Identity, Stand, key_of};
use super::labels::{Labels, Template};
use super::settings::AuditSettings;
use super::settle::{crashed, give_up};
use super::sources::Source;
use super::store::{SourceRow, Status, Store};
use super::task::{Answer, Task};
use crate::finding::Severity;
use crate::log::{SourceName, is_url, list};
use crate::report::{Trouble, TroubleKind, Verdict};

/// After so many logs, or so long, what was learnt of files is written down.
const NOTED_AFTER: usize = 100;
const NOTED_EVERY: Duration = Duration::from_secs(10);

/// Parts are merged, where they are many, after so many logs.
const MERGED_AFTER: usize = 100;

/// What one call is to do.
pub struct Call<'a> {
    /// The logs.
    pub sources: Vec<Source>,
    /// Where the results go.
    pub store: &'a Store,
    /// How logs are audited.
    pub settings: &'a AuditSettings,
    /// What stands for a log's content.
    pub identity: Identity,
    /// What all logs are of, …
    pub labels: Labels,
    /// … and what their paths say beside it.
    pub template: Option<Template>,
    /// Logs at a time.
    pub jobs: usize,
    /// What one log may take.
    pub limits: Limits,
    /// Whether logs are tried again that took too much, or that made the program fail.
    pub retry: bool,
    /// The call that audits the log at a path: see [`super::serve`].
    pub worker: &'a (dyn Fn(&Path) -> io::Result<Command> + Sync),
    /// Is told how far it is after each log.
    pub progress: &'a (dyn Fn(Course) + Sync),
}

/// How far a call is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Course {
    /// Logs that it has been through, …
    pub done: usize,
    /// … of which it audited so many itself, …
    pub audited: usize,
    /// … of so many.
    pub total: usize,
}

/// How a call ended.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcomes {
    /// Logs that were named.
    pub logs: usize,
    /// Logs that have the content of another of them, whose row is theirs.
    pub duplicates: usize,
    /// Logs that an earlier call had done.
    pub done_before: usize,
    /// Logs that this call did.
    pub done_now: usize,
    /// How the audits ended, of all that were named, each content once.
    pub statuses: Statuses,
    /// What the reports say, where warnings fail a run.
    pub verdicts: Verdicts,
    /// Logs that this call could not audit, by their paths.
    pub errors: Vec<Failure>,
    /// Each answer, for what is yet to be asked.
    #[serde(skip)]
    answers: Vec<Answer>,
}

/// Logs by the status of their audit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Statuses {
    /// See [`Status`], here and below.
    pub audited: usize,
    /// It could be read, and not audited.
    pub not_audited: usize,
    /// It could not be read.
    pub unreadable: usize,
    /// It took too long.
    pub timed_out: usize,
    /// It took too much memory.
    pub out_of_memory: usize,
    /// The audit of it died.
    pub crashed: usize,
}

/// Logs by their verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Verdicts {
    /// Nothing wrong.
    pub pass: usize,
    /// A warning or an error.
    pub fail: usize,
    /// A main question stayed open.
    pub inconclusive: usize,
}

/// A log that could not be audited.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct Failure {
    /// Its path.
    pub path: String,
    /// How its audit ended.
    pub status: Status,
    /// Why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub what: Option<String>,
}

impl Outcomes {
    /// Logs with a finding of severity `fail_on` or above; where `fails_open`, those whose verdict is
    /// inconclusive, too.
    pub fn failing(&self, fail_on: Option<Severity>, fails_open: bool) -> usize {
        let is_open = |answer: &Answer| fails_open && answer.verdict == Some(Verdict::Inconclusive);
        self.answers.iter().filter(|answer| answer.fails(fail_on) || is_open(answer)).count()
    }

    /// Logs on which there is no audit.
    pub fn unaudited(&self) -> usize {
        self.answers.iter().filter(|answer| answer.status != Status::Audited).count()
    }

    fn count(&mut self, answer: Answer) {
        self.statuses.count(answer.status);
        self.verdicts.count(answer.verdict);
        self.answers.push(answer);
    }
}

impl Statuses {
    /// Counts one more.
    pub(super) fn count(&mut self, status: Status) {
        *match status {
            Status::Audited => &mut self.audited,
            Status::NotAudited => &mut self.not_audited,
            Status::Unreadable => &mut self.unreadable,
            Status::TimedOut => &mut self.timed_out,
            Status::OutOfMemory => &mut self.out_of_memory,
            Status::Crashed => &mut self.crashed,
        } += 1;
    }
}

impl Verdicts {
    /// Counts one more.
    pub(super) fn count(&mut self, verdict: Option<Verdict>) {
        match verdict {
            Some(Verdict::Pass) => self.pass += 1,
            Some(Verdict::Fail) => self.fail += 1,
            Some(Verdict::Inconclusive) => self.inconclusive += 1,
            None => {}
        }
    }
}

/// Audits what has no row yet, and keeps a row for each log.
///
/// # Errors
/// Where the store cannot be read or written, or no process can be started. What is wrong with a log is
/// its row.
pub fn run(call: &Call<'_>) -> Result<Outcomes, Trouble> {
    call.store.keep_settings(call.settings)?;
    let engine = Engine {
        call,
        done: call.store.done()?,
        contents: call.store.contents()?,
        next: AtomicUsize::new(0),
        since_merge: AtomicUsize::new(0),
        book: Mutex::new(Book::default()),
    };
    thread::scope(|scope| {
        for _ in 0..call.jobs.clamp(1, call.sources.len().max(1)) {
            scope.spawn(|| engine.work());
        }
    });
    let mut book = engine.book.into_inner().unwrap_or_else(PoisonError::into_inner);
    call.store.add_sources(&mem::take(&mut book.learnt))?;
    if let Some(trouble) = book.trouble {
        return Err(trouble);
    }
    call.store.compact()?;
    book.outcomes.logs = call.sources.len();
    book.outcomes.errors.sort();
    Ok(book.outcomes)
}

/// The content of the object at `url`, as its store tells.
fn object(url: &Path) -> io::Result<Content> {
    let found = list(url).map_err(io::Error::other)?;
    let object = found.iter().find(|object| Path::new(&object.url) == url);
    object.map(Content::from).ok_or_else(|| io::Error::other("no such object"))
}

struct Engine<'a> {
    call: &'a Call<'a>,
    /// What was done before, by key.
    done: HashMap<String, Answer>,
    /// Contents of files as they stood before.
    contents: HashMap<String, String>,
    next: AtomicUsize,
    since_merge: AtomicUsize,
    book: Mutex<Book>,
}

/// What the threads know together.
#[derive(Default)]
struct Book {
    outcomes: Outcomes,
    course: Course,
    /// Keys that one of them has taken.
    taken: HashSet<String>,
    /// What was learnt of files and is not written down yet.
    learnt: Vec<SourceRow>,
    noted: Option<Instant>,
    /// What ends the call.
    trouble: Option<Trouble>,
}

/// How it went with one log.
enum Settled {
    Now(Answer, Option<String>),
    Before(Answer),
    Duplicate,
}

impl Engine<'_> {
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes logs until there are none left, or the call is at its end.
    fn work(&self) {
        while let Some(source) = self.call.sources.get(self.next.fetch_add(1, Ordering::Relaxed)) {
            let settled = self.settle(source);
            let settled = settled.and_then(|settled| self.enter(&source.path, settled));
            if let Err(trouble) = settled {
                self.next.store(self.call.sources.len(), Ordering::Relaxed);
                self.book().trouble.get_or_insert(trouble);
                return;
            }
        }
    }

    fn settle(&self, source: &Source) -> Result<Settled, Trouble> {
        let path = &source.path;
        let content = match &source.content {
            Some(content) => Ok(content.clone()),
            None if is_url(path) => object(path),
            None => self.content(path),
        };
        let content = match content {
            Ok(content) => content,
            Err(error) => return self.unreadable(path, &error),
        };
        let task = self.task(path, &content.id, content.stand);
        if !self.book().taken.insert(task.key.clone()) {
            return Ok(Settled::Duplicate);
        }
        if let Some(answer) = self.done.get(&task.key)
            && (answer.status.is_final() || !self.call.retry)
        {
            return Ok(Settled::Before(*answer));
        }
        let unread = self.task(path, &unread_content(path), Stand { bytes: 0, mtime_ns: 0 });
        if self.done.contains_key(&unread.key) {
            self.call.store.forget(&unread.key)?;
        }
        let command = (self.call.worker)(path).map_err(|error| self.unable(error.to_string()))?;
        let (status, what) = match audited(command, &task, &self.call.limits) {
            Ok((answer, what)) => return Ok(Settled::Now(answer, what)),
            Err(Death::Unable(why)) => return Err(self.unable(why)),
            Err(Death::TimedOut) => (Status::TimedOut, self.too_long()),
            Err(Death::OutOfMemory) => (Status::OutOfMemory, self.too_much()),
            Err(Death::Crashed(how)) => {
                (Status::Crashed, crashed(&task, format!("the audit died: {how}")))
            }
        };
        let trouble = Trouble { place: task.path.clone(), ..what };
        let answer = give_up(&task, status, &trouble, self.call.store)?;
        Ok(Settled::Now(answer, Some(trouble.what)))
    }

    /// The content of a log: as it is known, where its files stand as they did.
    fn content(&self, path: &Path) -> io::Result<Content> {
        let stand = Stand::of(path)?;
        if self.call.identity == Identity::File {
            return Content::of(path, stand, Identity::File);
        }
        let source = stand.name(path);
        if let Some(id) = self.contents.get(&source) {
            return Ok(Content { id: id.clone(), stand });
        }
        let content = Content::of(path, stand, Identity::Content)?;
        // A log that is still being written is another one soon.
        if Stand::of(path)? == stand {
            self.book().learnt.push(SourceRow {
                source,
                path: SourceName::of(path).to_string(),
                bytes: stand.bytes,
                mtime_ns: stand.mtime_ns,
                content: content.id.clone(),
            });
        }
        Ok(content)
    }

    fn task(&self, path: &Path, content: &str, stand: Stand) -> Task {
        let call = self.call;
        let version = env!("CARGO_PKG_VERSION");
        let name = SourceName::of(path).to_string();
        let by_path = call.template.as_ref().map(|template| template.labels(Path::new(&name)));
        let mut labels = by_path.unwrap_or_default();
        labels.extend(call.labels.clone());
        Task {
            key: key_of(content, version, &call.settings.hash),
            path: name,
            content: content.to_owned(),
            version: version.to_owned(),
            settings: call.settings.hash.clone(),
            bytes: stand.bytes,
            mtime_ns: stand.mtime_ns,
            labels,
        }
    }

    /// The row of a log that cannot be read: its path stands for its content.
    fn unreadable(&self, path: &Path, error: &io::Error) -> Result<Settled, Trouble> {
        let task = self.task(path, &unread_content(path), Stand { bytes: 0, mtime_ns: 0 });
        let trouble = Trouble {
            kind: TroubleKind::Log,
            what: format!("it cannot be read: {error}"),
            place: task.path.clone(),
            remedy: "make it readable, and call again".to_owned(),
        };
        let answer = give_up(&task, Status::Unreadable, &trouble, self.call.store)?;
        Ok(Settled::Now(answer, Some(trouble.what)))
    }

    fn too_long(&self) -> Trouble {
        let seconds = self.call.limits.time.unwrap_or_default().as_secs_f64();
        let what = format!("its audit took longer than {seconds} s");
        let remedy = "allow more with --timeout, and call again with --retry".to_owned();
        Trouble { kind: TroubleKind::Log, what, place: String::new(), remedy }
    }

    fn too_much(&self) -> Trouble {
        let mebibytes = self.call.limits.memory_bytes.unwrap_or_default() >> 20;
        let what = format!("its audit wanted more than {mebibytes} MiB of memory");
        let remedy = "allow more with --memory, and call again with --retry".to_owned();
        Trouble { kind: TroubleKind::Log, what, place: String::new(), remedy }
    }

    fn unable(&self, what: String) -> Trouble {
        let place = self.call.store.path().display().to_string();
        let remedy = "mend that, and call again: what is done stays done".to_owned();
        Trouble { kind: TroubleKind::Call, what, place, remedy }
    }

    /// Enters what became of a log, and sees to the store from time to time.
    fn enter(&self, path: &Path, settled: Settled) -> Result<(), Trouble> {
        let mut is_new = false;
        let mut book = self.book();
        match settled {
            Settled::Duplicate => book.outcomes.duplicates += 1,
            Settled::Before(answer) => {
                book.outcomes.done_before += 1;
                book.outcomes.count(answer);
            }
            Settled::Now(answer, what) => {
                is_new = true;
                book.outcomes.done_now += 1;
                book.course.audited += 1;
                book.outcomes.count(answer);
                if answer.status != Status::Audited {
                    let path = SourceName::of(path).to_string();
                    book.outcomes.errors.push(Failure { path, status: answer.status, what });
                }
            }
        }
        book.course.done += 1;
        book.course.total = self.call.sources.len();
        let course = book.course;
        let is_due = book.noted.get_or_insert_with(Instant::now).elapsed() > NOTED_EVERY;
        let learnt = match is_due || book.learnt.len() >= NOTED_AFTER {
            true => {
                book.noted = Some(Instant::now());
                mem::take(&mut book.learnt)
            }
            false => Vec::new(),
        };
        drop(book);
        self.call.store.add_sources(&learnt)?;
        (self.call.progress)(course);
        if is_new {
            let since_merge = self.since_merge.fetch_add(1, Ordering::Relaxed) + 1;
            if since_merge.is_multiple_of(MERGED_AFTER) {
                self.call.store.compact()?;
            }
        }
        Ok(())
    }
}

/// What stands for the content of a log that cannot be read.
fn unread_content(path: &Path) -> String {
    let path = path.as_os_str().as_encoded_bytes();
    format!("unread:{}", blake3::hash(path).to_hex())
}
