//! Where this program ends before its time: a panic, or memory that is refused, becomes one line, and
//! temporary files go.
#![allow(unsafe_code, reason = "an allocator that counts, and the end of a process without memory")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::any::Any;
use std::fs;
use std::io::{self, Write};
use std::ops::Deref;
use std::panic::{self, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tempfile::TempPath;

/// What `work` returns, or in one line what it said when it panicked and where. Whatever it would print
/// of its own is not printed.
///
/// # Errors
/// If it panics.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    let said = Arc::new(Mutex::new(None));
    let before = panic::take_hook();
    let hears = Arc::clone(&said);
    panic::set_hook(Box::new(move |info| {
        let mut said = hears.lock().unwrap_or_else(PoisonError::into_inner);
        let place = info.location().map(|at| format!(" ({}:{})", at.file(), at.line()));
        said.get_or_insert(format!("{}{}", message(info.payload()), place.unwrap_or_default()));
    }));
    let done = panic::catch_unwind(AssertUnwindSafe(work));
    panic::set_hook(before);
    done.map_err(|payload| {
        let said = said.lock().unwrap_or_else(PoisonError::into_inner).take();
        said.unwrap_or_else(|| message(payload.as_ref()))
    })
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| payload.downcast_ref::<&str>().copied());
    text.unwrap_or("no reason given").lines().next().unwrap_or_default().to_owned()
}

/// Files that are to go where the process ends before they are done with.
static STAGED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A temporary file. It goes when this does, or when the process is interrupted, unless it has got another
/// name.
#[derive(Debug)]
pub struct Staged(TempPath);

impl Staged {
    /// Makes the file by `make`.
    ///
    /// # Errors
    /// Where it fails.
    pub fn new(make: impl FnOnce() -> io::Result<TempPath>) -> io::Result<Self> {
        // Held while it is made: either it is not there yet, or it is known.
        let mut all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
        let path = make()?;
        all.push(path.to_path_buf());
        Ok(Self(path))
    }
}

impl Deref for Staged {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        let mut all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|path| *path != *self.0);
    }
}

/// Deletes the temporary files, and has none made any more: the process is about to end.
pub fn forget_staged() {
    let all = STAGED.lock().unwrap_or_else(PoisonError::into_inner);
    // What has got its name already is whole.
    all.iter().for_each(|path| drop(fs::remove_file(path)));
    std::mem::forget(all);
}

/// The system's memory, as the allocator of a program. Where there is none left, the program ends in one
/// line and status 70: nobody goes on without memory, and the library would abort with a trace.
#[derive(Debug)]
pub struct Memory;

// SAFETY: every call is the system's allocator's, of which nothing but null is kept from the caller.
unsafe impl GlobalAlloc for Memory {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller holds what `alloc` asks for.
        given(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller holds what `alloc_zeroed` asks for.
        given(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller holds what `realloc` asks for.
        given(unsafe { System.realloc(memory, layout, size) }, size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller holds what `dealloc` asks for.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[inline]
fn given(memory: *mut u8, bytes: usize) -> *mut u8 {
    if memory.is_null() {
        refused(bytes);
    }
    memory
}

/// Ends the program without taking any memory. A fleet knows the line.
#[cold]
fn refused(bytes: usize) -> ! {
    // Nobody is left to be told that nobody can be told.
    let _ = writeln!(
        io::stderr(),
        "error: out of memory: a memory allocation of {bytes} bytes was refused; allow more memory, or \
         audit a part of the log"
    );
    #[cfg(target_os = "linux")]
    // SAFETY: the call ends the process at once, and runs nothing that may need memory.
    unsafe {
        libc::_exit(70)
    }
    #[cfg(not(target_os = "linux"))]
    std::process::abort()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a panic says is heard by one hook for all of the process.
    static HOOK: Mutex<()> = Mutex::new(());

    #[test]
    fn a_panic_is_told_in_one_line_with_its_place() {
        let _alone = HOOK.lock().unwrap_or_else(PoisonError::into_inner);
        let told = caught(|| -> u32 { panic!("index {} is out of bounds\nmore", 7) });
        let told = told.expect_err("a panic");
        assert!(told.starts_with("index 7 is out of bounds ("), "{told}");
        assert!(told.contains("boundary.rs:") && !told.contains('\n'), "{told}");
        assert_eq!(caught(|| 3), Ok(3));
    }

    #[test]
    fn a_panic_of_another_thread_that_work_waits_for_is_told_as_the_first_one_said() {
        let _alone = HOOK.lock().unwrap_or_else(PoisonError::into_inner);
        let work = || rayon::join(|| panic!("of a worker"), || 1);
        let told = caught(work).expect_err("a panic");
        assert!(told.starts_with("of a worker (") && told.contains("boundary.rs:"), "{told}");
    }
}
