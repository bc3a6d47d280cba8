//! Distributes logs over worker processes on this machine.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use std::{io, mem};

use super::audit_log::{crash_trouble, store_failure};
use super::content::{FileState, Identity, LogContent, row_key};
use super::dataset::{self, Groups, SharedMapping};
use super::labels::{Labels, Template};
use super::outcomes::{Failure, Outcomes};
use super::settings::AuditSettings;
use super::sources::LogSource;
use super::store::{SourceRow, Status, Store};
use super::task::{AuditAnswer, Task};
use super::worker::{AuditJob, Limits, Worker, WorkerFailure};
use crate::log::{SourceName, is_url, list};
use crate::report::Trouble;

/// When content hashes are saved, in logs and in time.
const SAVE_INTERVAL_LOGS: usize = 100;
const SAVE_INTERVAL: Duration = Duration::from_secs(10);

/// Logs after which small table parts are merged.
const MERGE_INTERVAL_LOGS: usize = 100;

/// Parameters of one call.
pub struct FleetCall<'a> {
    /// Logs.
    pub sources: Vec<LogSource>,
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
    pub progress: &'a (dyn Fn(FleetProgress) + Sync),
}

/// Progress of a call.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FleetProgress {
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
pub fn run(call: &FleetCall<'_>) -> Result<Outcomes, Trouble> {
    call.store.save_settings(call.settings)?;
    let engine = Engine {
        call,
        stored_answers: call.store.finished_answers()?,
        contents: call.store.known_contents()?,
        groups: dataset::group_by_dataset(&call.sources),
        shared: Mutex::new(HashMap::new()),
        next: AtomicUsize::new(0),
        since_merge: AtomicUsize::new(0),
        state: Mutex::new(EngineState::default()),
    };
    thread::scope(|scope| {
        for _ in 0..call.jobs.clamp(1, call.sources.len().max(1)) {
            scope.spawn(|| engine.run_thread());
        }
    });
    let mut state = engine.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    call.store.add_sources(&mem::take(&mut state.new_sources))?;
    if let Some(trouble) = state.trouble {
        return Err(trouble);
    }
    call.store.compact()?;
    state.outcomes.logs = call.sources.len();
    state.outcomes.errors.sort();
    Ok(state.outcomes)
}

/// Content according to the listing.
fn remote_content(url: &Path) -> io::Result<LogContent> {
    let found = list(url).map_err(io::Error::other)?;
    let object = found.iter().find(|object| Path::new(&object.url) == url);
    object.map(LogContent::from).ok_or_else(|| io::Error::other("no such object"))
}

struct Engine<'a> {
    call: &'a FleetCall<'a>,
    /// Stored answers per row key.
    stored_answers: HashMap<String, AuditAnswer>,
    /// Keyed by file state (path, size, modification time).
    contents: HashMap<String, String>,
    /// Datasets of the logs, and their shared properties.
    groups: Groups,
    shared: Mutex<HashMap<PathBuf, Option<SharedMapping>>>,
    next: AtomicUsize,
    since_merge: AtomicUsize,
    state: Mutex<EngineState>,
}

#[derive(Default)]
struct EngineState {
    outcomes: Outcomes,
    progress: FleetProgress,
    /// Assigned to a thread.
    assigned: HashSet<String>,
    /// Rows to save.
    new_sources: Vec<SourceRow>,
    last_save: Option<Instant>,
    /// Ends the call.
    trouble: Option<Trouble>,
}

enum LogResult {
    New(AuditAnswer, Option<Trouble>),
    Stored(AuditAnswer),
    Duplicate,
}

enum LogLookup {
    Known(LogResult),
    ToAudit(Box<AuditJob>),
}

impl Engine<'_> {
    fn state(&self) -> MutexGuard<'_, EngineState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn run_thread(&self) {
        /// Logs per order. An order is also limited to a share of the logs, so all workers finish at about
        /// the same time.
        const MAX_LOGS_PER_ORDER: usize = 32;
        const MIN_ORDERS_PER_JOB: usize = 4;
        let all = self.call.sources.len();
        let count =
            (all / (MIN_ORDERS_PER_JOB * self.call.jobs.max(1))).clamp(1, MAX_LOGS_PER_ORDER);
        let mut worker = None;
        loop {
            let first = self.next.fetch_add(count, Ordering::Relaxed);
            let Some(sources) = self.call.sources.get(first..all.min(first + count)) else {
                return;
            };
            if sources.is_empty() {
                return;
            }
            if let Err(trouble) = self.process_logs(sources, &mut worker) {
                self.next.store(all, Ordering::Relaxed);
                self.state().trouble.get_or_insert(trouble);
                return;
            }
        }
    }

    /// Ensures that each log has a row.
    fn process_logs(
        &self,
        sources: &[LogSource],
        worker: &mut Option<Worker>,
    ) -> Result<(), Trouble> {
        let mut pending: Vec<(&Path, AuditJob)> = Vec::new();
        for source in sources {
            match self.look_up(source, worker)? {
                LogLookup::Known(result) => self.record_result(&source.path, result)?,
                LogLookup::ToAudit(job) => pending.push((&source.path, *job)),
            }
        }
        while !pending.is_empty() {
            let jobs = pending.iter().map(|(_, job)| job.clone()).collect();
            match self.worker(worker)?.audit(jobs) {
                Ok(answers) => {
                    let is_over = answers.iter().any(|(answer, _)| !answer.status.is_final());
                    let done: Vec<_> = pending.drain(..answers.len().min(pending.len())).collect();
                    for ((path, _), (answer, trouble)) in done.into_iter().zip(answers) {
                        self.record_result(path, LogResult::New(answer, trouble))?;
                    }
                    // The failure may have left the process in a bad state.
                    if is_over {
                        *worker = None;
                    }
                }
                Err((at, failure)) => {
                    *worker = None;
                    let (path, AuditJob { task, .. }) = pending.remove(at.min(pending.len() - 1));
                    let result = self.record_failure(&task, failure)?;
                    self.record_result(path, result)?;
                }
            }
        }
        Ok(())
    }

    fn worker<'a>(&self, worker: &'a mut Option<Worker>) -> Result<&'a mut Worker, Trouble> {
        if let Some(worker) = worker {
            return Ok(worker);
        }
        let command = (self.call.worker)().map_err(|error| self.call_trouble(error.to_string()))?;
        match Worker::start(command, &self.call.limits) {
            Ok(started) => Ok(worker.insert(started)),
            Err(WorkerFailure::Unavailable(why)) => Err(self.call_trouble(why)),
            Err(failure) => Err(self.call_trouble(format!("{failure:?}"))),
        }
    }

    /// Stores the row of a log whose process failed.
    fn record_failure(&self, task: &Task, failure: WorkerFailure) -> Result<LogResult, Trouble> {
        let (status, trouble) = match failure {
            WorkerFailure::Unavailable(why) => return Err(self.call_trouble(why)),
            WorkerFailure::TimedOut => (Status::TimedOut, self.timeout_trouble(task)),
            WorkerFailure::OutOfMemory => (Status::OutOfMemory, self.memory_trouble(task)),
            WorkerFailure::Crashed(how) => {
                (Status::Crashed, crash_trouble(task, format!("the audit process failed: {how}")))
            }
        };
        let answer = store_failure(task, status, &trouble, self.call.store)?;
        Ok(LogResult::New(answer, Some(trouble)))
    }

    fn look_up(
        &self,
        source: &LogSource,
        worker: &mut Option<Worker>,
    ) -> Result<LogLookup, Trouble> {
        let path = &source.path;
        let content = match &source.content {
            Some(content) => Ok(content.clone()),
            None if is_url(path) => remote_content(path),
            None => self.content(path),
        };
        let content = match content {
            Ok(content) => content,
            Err(error) => return self.record_unreadable(path, &error).map(LogLookup::Known),
        };
        let task = self.task(path, &content.id, content.state);
        if !self.state().assigned.insert(task.key.clone()) {
            return Ok(LogLookup::Known(LogResult::Duplicate));
        }
        if let Some(answer) = self.stored_answers.get(&task.key)
            && (answer.status.is_final() || !self.call.retry)
        {
            return Ok(LogLookup::Known(LogResult::Stored(*answer)));
        }
        let unread = self.task(path, &unreadable_id(path), FileState { bytes: 0, mtime_ns: 0 });
        if self.stored_answers.contains_key(&unread.key) {
            self.call.store.delete_parts(&unread.key)?;
        }
        let shared = self.shared(path, worker)?;
        let path = path.as_os_str().as_encoded_bytes().to_vec();
        Ok(LogLookup::ToAudit(Box::new(AuditJob { path, task, shared })))
    }

    /// Inferred once from a sample, and stored.
    fn shared(
        &self,
        path: &Path,
        worker: &mut Option<Worker>,
    ) -> Result<Option<SharedMapping>, Trouble> {
        let group = dataset::dataset_of(path);
        if group.as_os_str().is_empty() {
            return Ok(None);
        }
        let mut known = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(shared) = known.get(&group) {
            return Ok(shared.clone());
        }
        let (store, settings) = (self.call.store, &self.call.settings.hash);
        let stored = store.load_dataset(&group, settings);
        let shared = match (stored, self.groups.get(&group)) {
            (Some(stored), _) => Some(stored),
            (None, Some(members)) => {
                let mut samples: Vec<SharedMapping> = Vec::new();
                for at in dataset::sample_logs(members) {
                    if samples.len() >= dataset::SAMPLED_LOGS && !dataset::is_undetermined(&samples)
                    {
                        break;
                    }
                    let path = self.call.sources[at].path.as_os_str().as_encoded_bytes().to_vec();
                    match self.worker(worker)?.learn(path) {
                        Ok(shared) => samples.extend(shared),
                        // Reported by the log's own audit.
                        Err(_) => *worker = None,
                    }
                }
                let shared = dataset::merge_shared(samples, &group);
                if let Some(shared) = &shared {
                    store.save_dataset(&group, settings, shared)?;
                }
                shared
            }
            (None, None) => None,
        };
        known.insert(group, shared.clone());
        Ok(shared)
    }

    /// Uses the stored hash if the files are unchanged.
    fn content(&self, path: &Path) -> io::Result<LogContent> {
        let file_state = FileState::read(path)?;
        if self.call.identity == Identity::File {
            return LogContent::identify(path, file_state, Identity::File);
        }
        let source = file_state.hash(path);
        if let Some(id) = self.contents.get(&source) {
            return Ok(LogContent { id: id.clone(), state: file_state });
        }
        let content = LogContent::identify(path, file_state, Identity::Content)?;
        // The log may still be written.
        if FileState::read(path)? == file_state {
            self.state().new_sources.push(SourceRow {
                source,
                path: SourceName::from_path(path).to_string(),
                bytes: file_state.bytes,
                mtime_ns: file_state.mtime_ns,
                content: content.id.clone(),
            });
        }
        Ok(content)
    }

    fn task(&self, path: &Path, content: &str, file_state: FileState) -> Task {
        let call = self.call;
        let version = env!("CARGO_PKG_VERSION");
        let name = SourceName::from_path(path).to_string();
        let by_path = call.template.as_ref().map(|template| template.labels(Path::new(&name)));
        let mut labels = by_path.unwrap_or_default();
        labels.extend(call.labels.clone());
        Task {
            key: row_key(content, version, &call.settings.hash),
            path: name,
            content: content.to_owned(),
            version: version.to_owned(),
            settings: call.settings.hash.clone(),
            bytes: file_state.bytes,
            mtime_ns: file_state.mtime_ns,
            labels,
        }
    }

    /// The path replaces the content.
    fn record_unreadable(&self, path: &Path, error: &io::Error) -> Result<LogResult, Trouble> {
        let task = self.task(path, &unreadable_id(path), FileState { bytes: 0, mtime_ns: 0 });
        let what = format!("cannot be read: {error}");
        let trouble = Trouble::log(&task.path, what, "make it readable and run again");
        let answer = store_failure(&task, Status::Unreadable, &trouble, self.call.store)?;
        Ok(LogResult::New(answer, Some(trouble)))
    }

    fn timeout_trouble(&self, task: &Task) -> Trouble {
        let seconds = self.call.limits.time.unwrap_or_default().as_secs_f64();
        let what = format!("the audit took longer than {seconds} s");
        Trouble::log(&task.path, what, "raise --timeout and run again with --retry")
    }

    fn memory_trouble(&self, task: &Task) -> Trouble {
        let mebibytes = self.call.limits.memory_bytes.unwrap_or_default() >> 20;
        let what = format!("the audit needed more than {mebibytes} MiB of memory");
        Trouble::log(&task.path, what, "raise --memory and run again with --retry")
    }

    fn call_trouble(&self, what: String) -> Trouble {
        let remedy = "fix this and run again; finished logs are kept";
        Trouble::call(self.call.store.path().display(), what, remedy)
    }

    /// Records the outcome of a log, and saves and merges tables at intervals.
    fn record_result(&self, path: &Path, result: LogResult) -> Result<(), Trouble> {
        let mut is_new = false;
        let mut state = self.state();
        match result {
            LogResult::Duplicate => state.outcomes.duplicates += 1,
            LogResult::Stored(answer) => {
                state.outcomes.done_before += 1;
                state.outcomes.add(answer);
            }
            LogResult::New(answer, trouble) => {
                is_new = true;
                state.outcomes.done_now += 1;
                state.progress.audited += 1;
                state.outcomes.add(answer);
                if let Some(Trouble { what, remedy, .. }) = trouble {
                    let path = SourceName::from_path(path).to_string();
                    let failure = Failure { path, status: answer.status, what, remedy };
                    state.outcomes.errors.push(failure);
                }
            }
        }
        state.progress.done += 1;
        state.progress.total = self.call.sources.len();
        let progress = state.progress;
        let is_due = state.last_save.get_or_insert_with(Instant::now).elapsed() > SAVE_INTERVAL;
        let new_sources = match is_due || state.new_sources.len() >= SAVE_INTERVAL_LOGS {
            true => {
                state.last_save = Some(Instant::now());
                mem::take(&mut state.new_sources)
            }
            false => Vec::new(),
        };
        drop(state);
        self.call.store.add_sources(&new_sources)?;
        (self.call.progress)(progress);
        if is_new {
            let since_merge = self.since_merge.fetch_add(1, Ordering::Relaxed) + 1;
            if since_merge.is_multiple_of(MERGE_INTERVAL_LOGS) {
                self.call.store.compact()?;
            }
        }
        Ok(())
    }
}

fn unreadable_id(path: &Path) -> String {
    let path = path.as_os_str().as_encoded_bytes();
    format!("unread:{}", blake3::hash(path).to_hex())
}
