//! Distributes logs over worker processes on this machine.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use std::{io, mem};

use super::child::{Death, Job, Limits, Worker};
use super::content::{Content, Identity, Stand, key_of};
use super::dataset::{self, Groups, SharedMapping};
use super::labels::{Labels, Template};
use super::outcomes::{Failure, Outcomes};
use super::settings::AuditSettings;
use super::settle::{crashed, give_up};
use super::sources::Source;
use super::store::{SourceRow, Status, Store};
use super::task::{Answer, Task};
use crate::log::{SourceName, is_url, list};
use crate::report::{Trouble, TroubleKind};

/// When content hashes are saved, in logs and in time.
const NOTED_AFTER: usize = 100;
const NOTED_EVERY: Duration = Duration::from_secs(10);

/// Logs after which small table parts are merged.
const MERGED_AFTER: usize = 100;

/// Parameters of one call.
pub struct Call<'a> {
    /// Logs.
    pub sources: Vec<Source>,
    /// Destination of the results.
    pub store: &'a Store,
    /// Settings.
    pub settings: &'a AuditSettings,
    /// How a log's content is identified.
    pub identity: Identity,
    /// Labels of all logs.
    pub labels: Labels,
    /// Labels derived from the logs' paths.
    pub template: Option<Template>,
    /// Parallel jobs.
    pub jobs: usize,
    /// Limits per log.
    pub limits: Limits,
    /// Retry logs that exceeded a limit or crashed.
    pub retry: bool,
    /// Starts a worker process: see [`super::serve`].
    pub worker: &'a (dyn Fn() -> io::Result<Command> + Sync),
    /// Called after each log.
    pub progress: &'a (dyn Fn(Course) + Sync),
}

/// Progress of a call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Course {
    /// Logs processed.
    pub done: usize,
    /// Logs audited by this call.
    pub audited: usize,
    /// Logs in total.
    pub total: usize,
}

/// Audits all logs without a row and stores a row for each.
///
/// # Errors
/// If the store cannot be read or written, or a process cannot be started. Problems of a log are stored in
/// its row.
pub fn run(call: &Call<'_>) -> Result<Outcomes, Trouble> {
    call.store.keep_settings(call.settings)?;
    let engine = Engine {
        call,
        done: call.store.done()?,
        contents: call.store.contents()?,
        groups: dataset::groups(&call.sources),
        shared: Mutex::new(HashMap::new()),
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

/// Content according to the listing.
fn object(url: &Path) -> io::Result<Content> {
    let found = list(url).map_err(io::Error::other)?;
    let object = found.iter().find(|object| Path::new(&object.url) == url);
    object.map(Content::from).ok_or_else(|| io::Error::other("no such object"))
}

struct Engine<'a> {
    call: &'a Call<'a>,
    /// Stored answers per row key.
    done: HashMap<String, Answer>,
    /// Keyed by file state (path, size, modification time).
    contents: HashMap<String, String>,
    /// Datasets of the logs, and their shared properties.
    groups: Groups,
    shared: Mutex<HashMap<PathBuf, Option<SharedMapping>>>,
    next: AtomicUsize,
    since_merge: AtomicUsize,
    book: Mutex<Book>,
}

#[derive(Default)]
struct Book {
    outcomes: Outcomes,
    course: Course,
    /// Assigned to a thread.
    taken: HashSet<String>,
    /// Rows to save.
    learnt: Vec<SourceRow>,
    noted: Option<Instant>,
    /// Ends the call.
    trouble: Option<Trouble>,
}

enum Settled {
    Now(Answer, Option<String>),
    Before(Answer),
    Duplicate,
}

enum Looked {
    Settled(Settled),
    Open(Box<Job>),
}

impl Engine<'_> {
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self) {
        /// Logs per order. An order is also limited to a share of the logs, so all workers finish at about
        /// the same time.
        const MOST: usize = 32;
        const SHARES: usize = 4;
        let all = self.call.sources.len();
        let count = (all / (SHARES * self.call.jobs.max(1))).clamp(1, MOST);
        let mut worker = None;
        loop {
            let first = self.next.fetch_add(count, Ordering::Relaxed);
            let Some(sources) = self.call.sources.get(first..all.min(first + count)) else {
                return;
            };
            if sources.is_empty() {
                return;
            }
            if let Err(trouble) = self.settle(sources, &mut worker) {
                self.next.store(all, Ordering::Relaxed);
                self.book().trouble.get_or_insert(trouble);
                return;
            }
        }
    }

    /// Ensures that each log has a row.
    fn settle(&self, sources: &[Source], worker: &mut Option<Worker>) -> Result<(), Trouble> {
        let mut open: Vec<(&Path, Job)> = Vec::new();
        for source in sources {
            match self.looked(source, worker)? {
                Looked::Settled(settled) => self.enter(&source.path, settled)?,
                Looked::Open(job) => open.push((&source.path, *job)),
            }
        }
        while !open.is_empty() {
            let jobs = open.iter().map(|(_, job)| job.clone()).collect();
            match self.worker(worker)?.audited(jobs) {
                Ok(answers) => {
                    let is_over = answers.iter().any(|(answer, _)| !answer.status.is_final());
                    let done: Vec<_> = open.drain(..answers.len().min(open.len())).collect();
                    for ((path, _), (answer, what)) in done.into_iter().zip(answers) {
                        self.enter(path, Settled::Now(answer, what))?;
                    }
                    // The failure may have left the process in a bad state.
                    if is_over {
                        *worker = None;
                    }
                }
                Err((at, death)) => {
                    *worker = None;
                    let (path, Job { task, .. }) = open.remove(at.min(open.len() - 1));
                    let settled = self.died(&task, death)?;
                    self.enter(path, settled)?;
                }
            }
        }
        Ok(())
    }

    fn worker<'a>(&self, worker: &'a mut Option<Worker>) -> Result<&'a mut Worker, Trouble> {
        if let Some(worker) = worker {
            return Ok(worker);
        }
        let command = (self.call.worker)().map_err(|error| self.unable(error.to_string()))?;
        match Worker::start(command, &self.call.limits) {
            Ok(started) => Ok(worker.insert(started)),
            Err(Death::Unable(why)) => Err(self.unable(why)),
            Err(death) => Err(self.unable(format!("{death:?}"))),
        }
    }

    /// Stores the row of a log whose process failed.
    fn died(&self, task: &Task, death: Death) -> Result<Settled, Trouble> {
        let (status, what) = match death {
            Death::Unable(why) => return Err(self.unable(why)),
            Death::TimedOut => (Status::TimedOut, self.too_long()),
            Death::OutOfMemory => (Status::OutOfMemory, self.too_much()),
            Death::Crashed(how) => {
                (Status::Crashed, crashed(task, format!("the audit process failed: {how}")))
            }
        };
        let trouble = Trouble { place: task.path.clone(), ..what };
        let answer = give_up(task, status, &trouble, self.call.store)?;
        Ok(Settled::Now(answer, Some(trouble.what)))
    }

    fn looked(&self, source: &Source, worker: &mut Option<Worker>) -> Result<Looked, Trouble> {
        let path = &source.path;
        let content = match &source.content {
            Some(content) => Ok(content.clone()),
            None if is_url(path) => object(path),
            None => self.content(path),
        };
        let content = match content {
            Ok(content) => content,
            Err(error) => return self.unreadable(path, &error).map(Looked::Settled),
        };
        let task = self.task(path, &content.id, content.stand);
        if !self.book().taken.insert(task.key.clone()) {
            return Ok(Looked::Settled(Settled::Duplicate));
        }
        if let Some(answer) = self.done.get(&task.key)
            && (answer.status.is_final() || !self.call.retry)
        {
            return Ok(Looked::Settled(Settled::Before(*answer)));
        }
        let unread = self.task(path, &unread_content(path), Stand { bytes: 0, mtime_ns: 0 });
        if self.done.contains_key(&unread.key) {
            self.call.store.forget(&unread.key)?;
        }
        let shared = self.shared(path, worker)?;
        let path = path.as_os_str().as_encoded_bytes().to_vec();
        Ok(Looked::Open(Box::new(Job { path, task, shared })))
    }

    /// Inferred once from a sample, and stored.
    fn shared(
        &self,
        path: &Path,
        worker: &mut Option<Worker>,
    ) -> Result<Option<SharedMapping>, Trouble> {
        let group = dataset::group_of(path);
        if group.as_os_str().is_empty() {
            return Ok(None);
        }
        let mut known = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shared) = known.get(&group) {
            return Ok(shared.clone());
        }
        let (store, settings) = (self.call.store, &self.call.settings.hash);
        let kept = store.dataset(&group, settings);
        let shared = match (kept, self.groups.get(&group)) {
            (Some(kept), _) => Some(kept),
            (None, Some(members)) => {
                let mut told: Vec<SharedMapping> = Vec::new();
                for at in dataset::asked(members) {
                    if told.len() >= dataset::ASKED && !dataset::is_open(&told) {
                        break;
                    }
                    let path = self.call.sources[at].path.as_os_str().as_encoded_bytes().to_vec();
                    match self.worker(worker)?.learnt(path) {
                        Ok(shared) => told.extend(shared),
                        // Reported by the log's own audit.
                        Err(_) => *worker = None,
                    }
                }
                let shared = dataset::together(told, &group);
                if let Some(shared) = &shared {
                    store.keep_dataset(&group, settings, shared)?;
                }
                shared
            }
            (None, None) => None,
        };
        known.insert(group, shared.clone());
        Ok(shared)
    }

    /// Uses the stored hash if the files are unchanged.
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
        // The log may still be written.
        if Stand::of(path)? == stand {
            self.book().learnt.push(SourceRow {
                source,
                path: SourceName::from_path(path).to_string(),
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
        let name = SourceName::from_path(path).to_string();
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

    /// The path replaces the content.
    fn unreadable(&self, path: &Path, error: &io::Error) -> Result<Settled, Trouble> {
        let task = self.task(path, &unread_content(path), Stand { bytes: 0, mtime_ns: 0 });
        let trouble = Trouble {
            kind: TroubleKind::Log,
            what: format!("cannot be read: {error}"),
            place: task.path.clone(),
            remedy: "make it readable and run again".to_owned(),
        };
        let answer = give_up(&task, Status::Unreadable, &trouble, self.call.store)?;
        Ok(Settled::Now(answer, Some(trouble.what)))
    }

    fn too_long(&self) -> Trouble {
        let seconds = self.call.limits.time.unwrap_or_default().as_secs_f64();
        let what = format!("the audit took longer than {seconds} s");
        let remedy = "raise --timeout and run again with --retry".to_owned();
        Trouble { kind: TroubleKind::Log, what, place: String::new(), remedy }
    }

    fn too_much(&self) -> Trouble {
        let mebibytes = self.call.limits.memory_bytes.unwrap_or_default() >> 20;
        let what = format!("the audit needed more than {mebibytes} MiB of memory");
        let remedy = "raise --memory and run again with --retry".to_owned();
        Trouble { kind: TroubleKind::Log, what, place: String::new(), remedy }
    }

    fn unable(&self, what: String) -> Trouble {
        let place = self.call.store.path().display().to_string();
        let remedy = "fix this and run again; finished logs are kept".to_owned();
        Trouble { kind: TroubleKind::Call, what, place, remedy }
    }

    /// Records the outcome of a log, and saves and merges tables at intervals.
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
                    let path = SourceName::from_path(path).to_string();
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

fn unread_content(path: &Path) -> String {
    let path = path.as_os_str().as_encoded_bytes();
    format!("unread:{}", blake3::hash(path).to_hex())
}
