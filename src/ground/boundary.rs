//! Abnormal termination: turns a panic or a failed allocation into one line, and deletes temporary files.
#![allow(unsafe_code, reason = "a counting allocator, and process exit without memory")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::any::Any;
use std::fs;
use std::io::{self, Write};
use std::ops::Deref;
use std::panic::{self, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, PoisonError};

use tempfile::TempPath;

/// Panics while [`catch_panic`] runs on some thread.
struct CaughtPanics {
    /// Number of calls that run.
    calls: usize,
    /// Messages without and with their source location.
    located: Vec<[String; 2]>,
}

static CAUGHT: Mutex<CaughtPanics> = Mutex::new(CaughtPanics { calls: 0, located: Vec::new() });

/// Runs `work` without printing a panic, also one of a worker thread. Calls may be nested and concurrent.
///
/// # Errors
/// If it panics: first line of the message, and source location.
pub fn catch_panic<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let mut caught = CAUGHT.lock().unwrap_or_else(PoisonError::into_inner);
            if caught.calls == 0 {
                drop(caught);
                return before(info);
            }
            let message = message(info.payload());
            let place = info.location().map(|at| format!(" ({}:{})", at.file(), at.line()));
            let located = format!("{message}{}", place.unwrap_or_default());
            caught.located.push([message, located]);
        }));
    });
    CAUGHT.lock().unwrap_or_else(PoisonError::into_inner).calls += 1;
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    let mut caught = CAUGHT.lock().unwrap_or_else(PoisonError::into_inner);
    let outcome = outcome.map_err(|payload| {
        let message = message(payload.as_ref());
        let at = caught.located.iter().position(|[plain, _]| *plain == message);
        at.map(|at| caught.located.swap_remove(at)).map_or(message, |[_, located]| located)
    });
    caught.calls -= 1;
    if caught.calls == 0 {
        caught.located.clear();
    }
    outcome
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
    text.unwrap_or("no reason given").lines().next().unwrap_or_default().to_owned()
}

static STAGED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Temporary file, deleted on drop or interrupt unless it was renamed.
#[derive(Debug)]
pub struct StagedFile(TempPath);

impl StagedFile {
    /// Creates the file with `make`.
    ///
    /// # Errors
    /// If `make` fails.
    pub fn new(make: impl FnOnce() -> io::Result<TempPath>) -> io::Result<Self> {
        // Locked during creation, so every existing file is registered.
        let mut all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
        let path = make()?;
        all.push(path.to_path_buf());
        Ok(Self(path))
    }
}

impl Deref for StagedFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for StagedFile {
    fn drop(&mut self) {
        let mut all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|path| *path != *self.0);
    }
}

/// Deletes the temporary files before exit. Keeps the lock, so no more can be created.
pub fn delete_staged_files() {
    let all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
    // Renamed files are complete and stay.
    all.iter().for_each(|path| drop(fs::remove_file(path)));
    std::mem::forget(all);
}

/// System allocator that prints one line and exits with status 70 if an allocation fails.
#[derive(Debug)]
pub struct ReportingAllocator;

// SAFETY: forwards every call to the system allocator; only null results are intercepted.
unsafe impl GlobalAlloc for ReportingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract of `alloc`.
        check_allocation(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract of `alloc_zeroed`.
        check_allocation(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller upholds the contract of `realloc`.
        check_allocation(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller upholds the contract of `dealloc`.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[inline]
fn check_allocation(memory: *mut u8, bytes: usize) -> *mut u8 {
    if memory.is_null() {
        abort_without_memory(bytes);
    }
    memory
}

/// `fleet` recognises the printed line. Does not allocate.
#[cold]
fn abort_without_memory(bytes: usize) -> ! {
    let _ = writeln!(
        io::stderr(),
        "error: out of memory: a memory allocation of {bytes} bytes was refused; allow more memory, or \
         audit a part of the log"
    );
    #[cfg(target_os = "linux")]
    // SAFETY: ends the process without running code that may allocate.
    unsafe {
        libc::_exit(70)
    }
    #[cfg(not(target_os = "linux"))]
    std::process::abort()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_reported_in_one_line_with_its_place() {
        let error = catch_panic(|| -> u32 { panic!("index {} is out of bounds\nmore", 7) });
        let error = error.expect_err("a panic");
        assert!(error.starts_with("index 7 is out of bounds ("), "{error}");
        assert!(error.contains("boundary.rs:") && !error.contains('\n'), "{error}");
        assert_eq!(catch_panic(|| 3), Ok(3));
    }

    #[test]
    fn a_panic_of_a_worker_thread_keeps_its_first_message() {
        let work = || rayon::join(|| panic!("of a worker"), || 1);
        let error = catch_panic(work).expect_err("a panic");
        assert!(error.starts_with("of a worker (") && error.contains("boundary.rs:"), "{error}");
    }

    #[test]
    fn a_panic_within_a_panic_is_caught_where_it_happened() {
        let inner = || catch_panic(|| panic!("inner")).map(|()| 1);
        let outer = catch_panic(|| {
            let inner = inner();
            assert!(inner.is_err_and(|error| error.starts_with("inner (")));
            panic!("outer");
        });
        assert!(outer.is_err_and(|error: String| error.starts_with("outer (")));
    }
}
