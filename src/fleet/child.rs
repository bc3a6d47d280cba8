//! A process for each log: what it takes, and where it dies, is its own affair.
//!
//! The process that audits is this program again, called with the same options. It is told its task in
//! a line on stdin, and tells how it ended in a line on stdout; its rows it writes itself. When its
//! stdin ends, whoever called it is gone, and so is it.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, Write};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::settle::{is_of_memory, settle};
use super::store::Store;
use super::task::{Answer, Task};
use crate::Options;
use crate::boundary::forget_staged;

/// What one log may take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Time; any where there is none.
    pub time: Option<Duration>,
    /// Memory of its own, bytes; any where there is none. Pages of the log's file do not count. Only
    /// Linux holds it.
    pub memory_bytes: Option<u64>,
}

/// What a process is told.
#[derive(Debug, Serialize, Deserialize)]
struct Order {
    task: Task,
    memory_bytes: Option<u64>,
}

/// What it tells.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Told {
    /// How the audit ended, and what kept it from being one.
    Answer(Answer, Option<String>),
    /// Why the rows could not be written.
    Fault(String),
}

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

/// Has `command`, which ends in [`serve`], do `task`; tells how that ended, and what kept the log from
/// being audited.
///
/// # Errors
/// If it gives no answer.
pub fn audited(
    mut command: Command,
    task: &Task,
    limits: &Limits,
) -> Result<(Answer, Option<String>), Death> {
    let unable = |error: io::Error| Death::Unable(format!("no process can be started: {error}"));
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
    let order = Order { task: task.clone(), memory_bytes: limits.memory_bytes };
    // Kept open until the end: with it the process would end.
    let mut stdin = child.stdin.take();
    if let Some(stdin) = &mut stdin {
        // Where it has died already, its status says so.
        let _ = writeln!(stdin, "{}", serde_json::to_string(&order).unwrap_or_default());
    }
    let said = match heard(&mut child, limits.time) {
        Some(said) => said,
        None => {
            let _ = child.kill();
            let _ = child.wait();
            return Err(Death::TimedOut);
        }
    };
    let status = child.wait().map_err(unable)?;
    match said.lines().last().and_then(|line| serde_json::from_str(line).ok()) {
        Some(Told::Answer(answer, what)) => Ok((answer, what)),
        Some(Told::Fault(why)) => Err(Death::Unable(why)),
        None => Err(death(status, &words(errors))),
    }
}

/// All that a process says; `None` where it takes longer than it may.
fn heard(child: &mut Child, time: Option<Duration>) -> Option<String> {
    let mut stdout = child.stdout.take()?;
    let (sender, receiver) = channel();
    thread::spawn(move || {
        let mut said = String::new();
        // What is not whole is no answer.
        let _ = stdout.read_to_string(&mut said);
        let _ = sender.send(said);
    });
    let said = match time {
        Some(time) => receiver.recv_timeout(time),
        None => receiver.recv().map_err(|_| RecvTimeoutError::Disconnected),
    };
    match said {
        Err(RecvTimeoutError::Timeout) => None,
        said => Some(said.unwrap_or_default()),
    }
}

/// What a process wrote to stderr.
fn words(mut errors: File) -> String {
    let mut bytes = Vec::new();
    // What cannot be read says nothing.
    let _ = errors.rewind().and_then(|()| errors.take(1 << 16).read_to_end(&mut bytes));
    String::from_utf8_lossy(&bytes).into_owned()
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

/// What the process of one log does: takes its task from stdin, audits the log at `path` as `options`
/// say, writes its rows into `store`, with `paged` its page, too, and tells how that ended on stdout.
///
/// # Errors
/// If no task comes, or nobody takes the answer.
pub fn serve(path: &Path, options: &Options, store: &Store, paged: bool) -> io::Result<()> {
    let mut stdin = BufReader::new(io::stdin());
    let mut line = String::new();
    stdin.read_line(&mut line)?;
    let Order { task, memory_bytes } = serde_json::from_str(&line)?;
    thread::spawn(move || {
        let _ = io::copy(&mut stdin, &mut io::sink());
        forget_staged();
        std::process::exit(1);
    });
    if let Some(bytes) = memory_bytes {
        limit_memory(bytes)?;
    }
    let told = match settle(path, &task, options, store, paged) {
        Ok((answer, what)) => Told::Answer(answer, what),
        Err(error) => Told::Fault(error.to_string()),
    };
    let mut stdout = io::stdout().lock();
    writeln!(stdout, "{}", serde_json::to_string(&told)?)?;
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
