//! Worker processes, which isolate the caller from crashes and resource use of an audit.
//!
//! A worker is this program with the same options. It reads orders from stdin, one per line, and reports
//! the start of each log and the results on stdout. It writes the rows itself and waits for the next order:
//! process start, catalogue and dataset metadata cost as much as a short log. A worker exits when its stdin
//! closes.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::audit_log::{audit_log, is_allocation_failure};
use super::dataset::{SharedMapping, infer_shared};
use super::sources::path_of;
use super::store::Store;
use super::task::{AuditAnswer, Task};
use crate::Options;
use crate::boundary::delete_staged_files;
use crate::report::Trouble;

/// Resource limits per log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Time limit.
    pub time: Option<Duration>,
    /// Memory limit of a process in bytes, without mapped pages. Linux only.
    pub memory_bytes: Option<u64>,
}

#[derive(Debug, Serialize, Deserialize)]
pub enum WorkerOrder {
    Audit(Vec<AuditJob>),
    /// Infer dataset-wide properties from the log at this path, in the system's byte encoding.
    Learn(Vec<u8>),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AuditJob {
    /// Path in the system's byte encoding.
    pub path: Vec<u8>,
    pub task: Task,
    /// Common properties of its dataset.
    pub shared: Option<SharedMapping>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum WorkerMessage {
    /// Index of the log that starts.
    Started(usize),
    /// Results of the first logs of the order; their rows are stored.
    Answers(Vec<AuditResult>),
    Learned(Option<SharedMapping>),
    /// Why the rows could not be written.
    Fault(String),
}

/// Result, and why the log could not be audited, if it was not.
pub type AuditResult = (AuditAnswer, Option<Trouble>);

/// How a process ended without an answer.
#[derive(Debug)]
pub enum WorkerFailure {
    TimedOut,
    OutOfMemory,
    Crashed(String),
    /// Could not write its rows or be started; not the fault of the log.
    Unavailable(String),
}

pub struct Worker {
    child: Child,
    /// Closing it ends the process.
    stdin: ChildStdin,
    lines: Receiver<String>,
    errors: File,
    time: Option<Duration>,
}

impl Worker {
    /// Starts `command`, which must call [`serve`].
    pub fn start(mut command: Command, limits: &Limits) -> Result<Self, WorkerFailure> {
        let unable = |error: io::Error| {
            WorkerFailure::Unavailable(format!("cannot start a process: {error}"))
        };
        let errors = tempfile::tempfile().map_err(|error| {
            let folder = std::env::temp_dir();
            let what = format!("cannot create a file in {}: {error}", folder.display());
            WorkerFailure::Unavailable(what + "; set TMPDIR to another folder")
        })?;
        command
            .env("RAYON_NUM_THREADS", "1")
            .env("POLARS_MAX_THREADS", "1")
            // Audits run on the thread of the pool.
            .env("RUST_MIN_STACK", STACK_BYTES.to_string())
            .env_remove("RUST_BACKTRACE")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors.try_clone().map_err(unable)?);
        let mut child = command.spawn().map_err(unable)?;
        let none = || unable(io::ErrorKind::BrokenPipe.into());
        let mut stdin = child.stdin.take().ok_or_else(none)?;
        let stdout = child.stdout.take().ok_or_else(none)?;
        // If the process has ended, its exit status shows why.
        let _ = writeln!(stdin, "{}", limits.memory_bytes.unwrap_or_default());
        let (sender, lines) = channel();
        thread::spawn(move || {
            let lines = BufReader::new(stdout).lines().map_while(Result::ok);
            lines.map_while(|line| sender.send(line).ok()).for_each(drop);
        });
        Ok(Self { child, stdin, lines, errors, time: limits.time })
    }

    /// Audits the first logs of `jobs`, at least one.
    ///
    /// # Errors
    /// If the process ends without an answer: its exit and the current log. No rows are stored.
    pub fn audit(
        &mut self,
        jobs: Vec<AuditJob>,
    ) -> Result<Vec<AuditResult>, (usize, WorkerFailure)> {
        match self.send(&WorkerOrder::Audit(jobs))? {
            WorkerMessage::Answers(answers) => Ok(answers),
            _ => Err((0, self.unexpected_answer())),
        }
    }

    pub fn learn(&mut self, path: Vec<u8>) -> Result<Option<SharedMapping>, WorkerFailure> {
        match self.send(&WorkerOrder::Learn(path)).map_err(|(_, failure)| failure)? {
            WorkerMessage::Learned(shared) => Ok(shared),
            _ => Err(self.unexpected_answer()),
        }
    }

    /// Returns the final message, or the log that ended the process.
    fn send(&mut self, order: &WorkerOrder) -> Result<WorkerMessage, (usize, WorkerFailure)> {
        let stderr_length = self.errors.metadata().map_or(0, |metadata| metadata.len());
        let mut at = 0;
        // If the process has ended, its exit status shows why.
        let _ = writeln!(self.stdin, "{}", serde_json::to_string(order).unwrap_or_default());
        loop {
            let line = match self.time {
                Some(time) => self.lines.recv_timeout(time),
                None => self.lines.recv().map_err(|_| RecvTimeoutError::Disconnected),
            };
            match line.map(|line| serde_json::from_str(&line)) {
                Ok(Ok(WorkerMessage::Started(log))) => at = log,
                Ok(Ok(WorkerMessage::Fault(why))) => {
                    return Err((at, WorkerFailure::Unavailable(why)));
                }
                Ok(Ok(message)) => return Ok(message),
                // Incomplete messages.
                Ok(Err(_)) => {}
                Err(RecvTimeoutError::Timeout) => {
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    return Err((at, WorkerFailure::TimedOut));
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let status = self.child.wait();
                    let status = status
                        .map_err(|error| (at, WorkerFailure::Unavailable(error.to_string())))?;
                    return Err((at, failure_of_exit(status, &self.read_stderr(stderr_length))));
                }
            }
        }
    }

    fn unexpected_answer(&mut self) -> WorkerFailure {
        let _ = self.child.kill();
        let _ = self.child.wait();
        WorkerFailure::Crashed("unexpected answer to an order".to_owned())
    }

    /// Stderr without the first `stderr_length` bytes.
    fn read_stderr(&mut self, stderr_length: u64) -> String {
        let mut bytes = Vec::new();
        let _ = self
            .errors
            .seek(SeekFrom::Start(stderr_length))
            .and_then(|_| (&mut self.errors).take(1 << 16).read_to_end(&mut bytes));
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // The process is idle or has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn failure_of_exit(status: ExitStatus, stderr: &str) -> WorkerFailure {
    if is_allocation_failure(stderr) {
        return WorkerFailure::OutOfMemory;
    }
    // The first line contains the error; the rest are hints.
    let stderr = stderr.lines().find(|line| !line.trim().is_empty()).unwrap_or_default().trim();
    let how = match signal(status) {
        Some(9) => "killed, possibly because the machine ran out of memory".to_owned(),
        Some(signal) => format!("killed by signal {signal}"),
        None => format!("exited with {status} without an answer"),
    };
    WorkerFailure::Crashed(if stderr.is_empty() { how } else { format!("{how}: {stderr}") })
}

#[cfg(unix)]
fn signal(status: ExitStatus) -> Option<i32> {
    std::os::unix::process::ExitStatusExt::signal(&status)
}

#[cfg(not(unix))]
fn signal(_: ExitStatus) -> Option<i32> {
    None
}

/// Stack of an audit, as of a main thread.
const STACK_BYTES: usize = 8 << 20;

/// Maximum duration of an order: an interrupted call loses little.
const MAX_ORDER_DURATION: Duration = Duration::from_secs(2);

/// Main loop of a worker: audits logs with `options`, writes their rows to `store` (and pages, if `with_page`),
/// and reports the results on stdout.
///
/// # Errors
/// If stdout cannot be written.
pub fn serve(options: &Options, store: &Store, with_page: bool) -> io::Result<()> {
    let mut lines = BufReader::new(io::stdin()).lines();
    let memory_bytes = lines.next().transpose()?.and_then(|line| line.parse().ok());
    if let Some(bytes) = memory_bytes.filter(|bytes| *bytes > 0) {
        limit_memory(bytes)?;
    }
    let (sender, orders) = channel();
    thread::spawn(move || {
        lines.map_while(Result::ok).map_while(|line| sender.send(line).ok()).for_each(drop);
        delete_staged_files();
        std::process::exit(1);
    });
    for order in orders {
        match serde_json::from_str(&order)? {
            WorkerOrder::Learn(path) => {
                send_message(&WorkerMessage::Learned(infer_shared(&path_of(&path), options)))?
            }
            // On the only thread of the pool, parallel loops are plain loops: no other thread has to wake up for each.
            WorkerOrder::Audit(jobs) => {
                match rayon::scope(|_| audit_jobs(&jobs, options, store, with_page))? {
                    Ok(answers) => send_message(&WorkerMessage::Answers(answers))?,
                    Err(why) => send_message(&WorkerMessage::Fault(why))?,
                }
            }
        }
    }
    Ok(())
}

/// Audits logs until the time is up. Returns why rows cannot be stored, if so.
fn audit_jobs(
    jobs: &[AuditJob],
    options: &Options,
    store: &Store,
    with_page: bool,
) -> io::Result<Result<Vec<AuditResult>, String>> {
    let begun = Instant::now();
    let (mut rows, mut answers) = (Vec::new(), Vec::new());
    for (at, AuditJob { path, task, shared }) in jobs.iter().enumerate() {
        if at > 0 && begun.elapsed() > MAX_ORDER_DURATION {
            break;
        }
        send_message(&WorkerMessage::Started(at))?;
        let mut options = Options { logs: vec![path_of(path)], ..options.clone() };
        options.run.shared = shared.clone();
        match audit_log(task, &options, store, with_page) {
            Ok((row, trouble)) => {
                answers.push((row.answer, trouble));
                rows.push(row);
            }
            Err(error) => return Ok(Err(error.to_string())),
        }
        if !answers.last().is_some_and(|(answer, _)| answer.status.is_final()) {
            break;
        }
    }
    Ok(store.commit(rows).map(|()| answers).map_err(|error| error.to_string()))
}

fn send_message(message: &WorkerMessage) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", serde_json::to_string(message)?)?;
    stdout.flush()
}

/// Pages of read-only mapped files do not count.
#[cfg(target_os = "linux")]
#[allow(unsafe_code, reason = "sets a resource limit")]
fn limit_memory(bytes: u64) -> io::Result<()> {
    let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
    // SAFETY: the call only reads the struct, which outlives it, and has no effect other than the limit.
    match unsafe { libc::setrlimit(libc::RLIMIT_DATA, &limit) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

#[cfg(not(target_os = "linux"))]
fn limit_memory(_: u64) -> io::Result<()> {
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn a_refused_allocation_is_recognised_before_other_messages() {
        let aborted = ExitStatus::from_raw(6);
        let stderr = "memory allocation of 8589934592 bytes failed\nnote: run with `RUST_BACKTRACE=1` \
                     environment variable to display a backtrace\n";
        assert!(matches!(failure_of_exit(aborted, stderr), WorkerFailure::OutOfMemory));
        let WorkerFailure::Crashed(how) =
            failure_of_exit(aborted, "\nfree(): invalid pointer\nnote: more\n")
        else {
            panic!("no crash");
        };
        assert_eq!(how, "killed by signal 6: free(): invalid pointer");
    }
}
