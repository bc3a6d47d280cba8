//! Processes that audit: what a log takes, and where its audit dies, is not the caller's affair.
//!
//! A process that audits is this program again, called with the same options. It is told in a line on
//! stdin what to do, tells in a line on stdout at which log it is, and in one how they ended; their rows it
//! writes itself, those of one order together. It then waits for the next order: to start a process, read
//! the catalogue and the metadata of a dataset costs as much as a short log. When its stdin ends, whoever
//! called it is gone, and so is it.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::dataset::{Shared, learnt};
use super::settle::{is_of_memory, settle};
use super::sources::path_of;
use super::store::Store;
use super::task::{Answer, Task};
use crate::Options;
use crate::boundary::forget_staged;

/// What one log may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Time; any where there is none.
    pub time: Option<Duration>,
    /// Memory of a process, bytes; any where there is none. Pages of the log's file do not count. Only
    /// Linux holds it.
    pub memory_bytes: Option<u64>,
}

/// What a process is to do.
#[derive(Debug, Serialize, Deserialize)]
pub enum Order {
    /// Audit these.
    Audit(Vec<Job>),
    /// Say what the log at this path, in the bytes of this system, tells of all logs of its dataset.
    Learn(Vec<u8>),
}

/// One log to audit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Job {
    /// Its path, in the bytes of this system.
    pub path: Vec<u8>,
    /// Under which key its rows are kept, and more.
    pub task: Task,
    /// What others of its dataset told.
    pub shared: Option<Shared>,
}

/// What it tells.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Told {
    /// It begins with a log: its place in the order.
    Begun(usize),
    /// How the first audits of the order ended, whose rows are kept, and what kept each from being one.
    Answers(Vec<Ended>),
    /// What a log tells of others.
    Learnt(Option<Shared>),
    /// Why the rows could not be written.
    Fault(String),
}

/// How an audit ended, and what kept the log from being audited.
pub type Ended = (Answer, Option<String>);

/// How a process ended that gave no answer.
#[derive(Debug)]
pub enum Death {
    /// It took too long.
    TimedOut,
    /// It wanted more memory than it may have.
    OutOfMemory,
    /// It crashed: how.
    Crashed(String),
    /// It could not write its rows, or could not be started: why. That is no fault of the log.
    Unable(String),
}

/// A process that waits for orders.
pub struct Worker {
    child: Child,
    /// With its end the process ends.
    stdin: ChildStdin,
    lines: Receiver<String>,
    errors: File,
    time: Option<Duration>,
}

impl Worker {
    /// Starts `command`, which ends in [`serve`].
    ///
    /// # Errors
    /// Where it cannot be started.
    pub fn start(mut command: Command, limits: &Limits) -> Result<Self, Death> {
        let unable =
            |error: io::Error| Death::Unable(format!("no process can be started: {error}"));
        let errors = tempfile::tempfile().map_err(|error| {
            let folder = std::env::temp_dir();
            let what = format!("no file can be made in {}: {error}", folder.display());
            Death::Unable(what + "; let TMPDIR name another folder")
        })?;
        command
            .env("RAYON_NUM_THREADS", "1")
            .env("POLARS_MAX_THREADS", "1")
            .env_remove("RUST_BACKTRACE")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors.try_clone().map_err(unable)?);
        let mut child = command.spawn().map_err(unable)?;
        let none = || unable(io::ErrorKind::BrokenPipe.into());
        let mut stdin = child.stdin.take().ok_or_else(none)?;
        let stdout = child.stdout.take().ok_or_else(none)?;
        // Where it has died already, its status says so.
        let _ = writeln!(stdin, "{}", limits.memory_bytes.unwrap_or_default());
        let (sender, lines) = channel();
        thread::spawn(move || {
            let lines = BufReader::new(stdout).lines().map_while(Result::ok);
            lines.map_while(|line| sender.send(line).ok()).for_each(drop);
        });
        Ok(Self { child, stdin, lines, errors, time: limits.time })
    }

    /// Has it audit the first of some logs, one at least; how these ended, and what kept each from being
    /// audited.
    ///
    /// # Errors
    /// If it ends without that: how, and at which of the logs it was. The rows of none are kept.
    pub fn audited(&mut self, jobs: Vec<Job>) -> Result<Vec<Ended>, (usize, Death)> {
        match self.told(&Order::Audit(jobs))? {
            Told::Answers(answers) => Ok(answers),
            _ => Err((0, self.gone())),
        }
    }

    /// What the log at `path` tells of all of its dataset.
    ///
    /// # Errors
    /// If the process ends without that.
    pub fn learnt(&mut self, path: Vec<u8>) -> Result<Option<Shared>, Death> {
        match self.told(&Order::Learn(path)).map_err(|(_, death)| death)? {
            Told::Learnt(shared) => Ok(shared),
            _ => Err(self.gone()),
        }
    }

    /// What it tells in the end, and at which log it was where it does not.
    fn told(&mut self, order: &Order) -> Result<Told, (usize, Death)> {
        let said_before = self.errors.metadata().map_or(0, |metadata| metadata.len());
        let mut at = 0;
        // Where it has died already, its status says so.
        let _ = writeln!(self.stdin, "{}", serde_json::to_string(order).unwrap_or_default());
        loop {
            let line = match self.time {
                Some(time) => self.lines.recv_timeout(time),
                None => self.lines.recv().map_err(|_| RecvTimeoutError::Disconnected),
            };
            match line.map(|line| serde_json::from_str(&line)) {
                Ok(Ok(Told::Begun(log))) => at = log,
                Ok(Ok(Told::Fault(why))) => return Err((at, Death::Unable(why))),
                Ok(Ok(told)) => return Ok(told),
                // What is not whole is no answer.
                Ok(Err(_)) => {}
                Err(RecvTimeoutError::Timeout) => {
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    return Err((at, Death::TimedOut));
                }
                Err(RecvTimeoutError::Disconnected) => {
                    let status = self.child.wait();
                    let status = status.map_err(|error| (at, Death::Unable(error.to_string())))?;
                    return Err((at, death(status, &self.words(said_before))));
                }
            }
        }
    }

    /// That it answered what it was not asked.
    fn gone(&mut self) -> Death {
        let _ = self.child.kill();
        let _ = self.child.wait();
        Death::Crashed("it answered what it was not asked".to_owned())
    }

    /// What the process wrote to stderr behind the first of so many bytes.
    fn words(&mut self, said_before: u64) -> String {
        let mut bytes = Vec::new();
        // What cannot be read says nothing.
        let _ = self
            .errors
            .seek(SeekFrom::Start(said_before))
            .and_then(|_| (&mut self.errors).take(1 << 16).read_to_end(&mut bytes));
        String::from_utf8_lossy(&bytes).into_owned()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // It waits for an order, or it has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn death(status: ExitStatus, words: &str) -> Death {
    if is_of_memory(words) {
        return Death::OutOfMemory;
    }
    // The first line says what went wrong; what follows is how to learn more.
    let words = words.lines().find(|line| !line.trim().is_empty()).unwrap_or_default().trim();
    let how = match signal(status) {
        Some(9) => "it was killed, as where the machine runs out of memory".to_owned(),
        Some(signal) => format!("it died of signal {signal}"),
        None => format!("it ended with {status} and without an answer"),
    };
    Death::Crashed(if words.is_empty() { how } else { format!("{how}: {words}") })
}

#[cfg(unix)]
fn signal(status: ExitStatus) -> Option<i32> {
    std::os::unix::process::ExitStatusExt::signal(&status)
}

#[cfg(not(unix))]
fn signal(_: ExitStatus) -> Option<i32> {
    None
}

/// Orders are cut short after so long, that a call which is killed loses little.
const ORDER: Duration = Duration::from_secs(2);

/// What a process does that audits: takes orders from stdin, audits logs as `options` say, writes their rows
/// into `store`, with `paged` their pages, too, and tells how they ended on stdout.
///
/// # Errors
/// If nobody takes the answers.
pub fn serve(options: &Options, store: &Store, paged: bool) -> io::Result<()> {
    let mut lines = BufReader::new(io::stdin()).lines();
    let memory_bytes = lines.next().transpose()?.and_then(|line| line.parse().ok());
    if let Some(bytes) = memory_bytes.filter(|bytes| *bytes > 0) {
        limit_memory(bytes)?;
    }
    let (sender, orders) = channel();
    thread::spawn(move || {
        lines.map_while(Result::ok).map_while(|line| sender.send(line).ok()).for_each(drop);
        forget_staged();
        std::process::exit(1);
    });
    for order in orders {
        match serde_json::from_str(&order)? {
            Order::Learn(path) => tell(&Told::Learnt(learnt(&path_of(&path), options)))?,
            Order::Audit(jobs) => match audited(&jobs, options, store, paged)? {
                Ok(answers) => tell(&Told::Answers(answers))?,
                Err(why) => tell(&Told::Fault(why))?,
            },
        }
    }
    Ok(())
}

/// Audits some logs, as far as it comes in a while, and keeps their rows; or why these cannot be kept.
fn audited(
    jobs: &[Job],
    options: &Options,
    store: &Store,
    paged: bool,
) -> io::Result<Result<Vec<Ended>, String>> {
    let begun = Instant::now();
    let (mut rows, mut answers) = (Vec::new(), Vec::new());
    for (at, Job { path, task, shared }) in jobs.iter().enumerate() {
        if at > 0 && begun.elapsed() > ORDER {
            break;
        }
        tell(&Told::Begun(at))?;
        let mut options = Options { logs: vec![path_of(path)], ..options.clone() };
        options.run.shared = shared.clone();
        match settle(task, &options, store, paged) {
            Ok((row, what)) => {
                answers.push((row.answer, what));
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

fn tell(told: &Told) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", serde_json::to_string(told)?)?;
    stdout.flush()
}

/// Lets this process have no more memory than this. Pages of files that are only read do not count.
#[cfg(target_os = "linux")]
#[allow(unsafe_code, reason = "a limit is set")]
fn limit_memory(bytes: u64) -> io::Result<()> {
    let limit = libc::rlimit { rlim_cur: bytes, rlim_max: bytes };
    // SAFETY: the call reads the struct, which outlives it, and changes nothing but the limit.
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
    fn a_refused_allocation_is_told_whatever_is_said_after_it() {
        let aborted = ExitStatus::from_raw(6);
        let words = "memory allocation of 8589934592 bytes failed\nnote: run with `RUST_BACKTRACE=1` \
                     environment variable to display a backtrace\n";
        assert!(matches!(death(aborted, words), Death::OutOfMemory));
        let Death::Crashed(how) = death(aborted, "\nfree(): invalid pointer\nnote: more\n") else {
            panic!("no crash");
        };
        assert_eq!(how, "it died of signal 6: free(): invalid pointer");
    }
}
