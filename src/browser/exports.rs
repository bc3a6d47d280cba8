//! What the worker of the page calls. An instance answers one question, and is thrown away with its memory.
#![allow(unsafe_code, reason = "bytes go by their address")]

use std::panic;
use std::sync::{Mutex, PoisonError};

use bytes::Bytes;
use poseaudit::log::Progress;

use crate::answer;

#[link(wasm_import_module = "page")]
unsafe extern "C" {
    /// Takes what is being done, and how many bytes of how many were read.
    fn step(doing: *const u8, length: usize, read: f64, total: f64);
    /// Takes what the program said when it failed.
    fn failed(said: *const u8, length: usize);
}

/// The files of the question, in its order.
static FILES: Mutex<Vec<Bytes>> = Mutex::new(Vec::new());

/// Room for so many bytes, which the caller fills and gives back to `file` or `ask`; null where there is none.
#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    let mut room = Vec::<u8>::new();
    if room.try_reserve_exact(bytes).is_err() {
        return std::ptr::null_mut();
    }
    // Without growing: the file has this many bytes, and nothing to spare.
    room.resize(bytes, 0);
    room.leak().as_mut_ptr()
}

/// Takes the next file of the question.
///
/// # Safety
/// `at` is of `room(bytes)`, filled, and given back once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn file(at: *mut u8, bytes: usize) {
    // SAFETY: as the caller holds.
    let content = unsafe { filled(at, bytes) };
    FILES.lock().unwrap_or_else(PoisonError::into_inner).push(content.into());
}

/// Answers the question that is there as JSON: the answer's length, and behind it the answer as JSON.
///
/// # Safety
/// As of `file`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ask(at: *mut u8, bytes: usize) -> *const u8 {
    panic::set_hook(Box::new(|info| {
        let said = info.to_string();
        // SAFETY: the page copies the text before it returns.
        unsafe { failed(said.as_ptr(), said.len()) }
    }));
    // SAFETY: as the caller holds.
    let question = unsafe { filled(at, bytes) };
    let files = std::mem::take(&mut *FILES.lock().unwrap_or_else(PoisonError::into_inner));
    let told = Mutex::new((0, ""));
    let progress = Progress::telling(move |progress| {
        // No more often than it can be seen.
        let (read, total, doing) = (progress.read(), progress.total(), progress.doing());
        let now = (200 * read / total.max(1), doing);
        if std::mem::replace(&mut *told.lock().unwrap_or_else(PoisonError::into_inner), now) != now
        {
            // SAFETY: the page copies the text before it returns.
            unsafe { step(doing.as_ptr(), doing.len(), read as f64, total as f64) }
        }
    });
    let answer = answer(&String::from_utf8_lossy(&question), files, progress);
    let text = serde_json::to_vec(&answer).unwrap_or_default();
    let length = u32::try_from(text.len()).unwrap_or_default();
    [length.to_le_bytes().as_slice(), &text].concat().leak().as_ptr()
}

/// Takes back what `room` gave.
///
/// # Safety
/// As of `file`.
unsafe fn filled(at: *mut u8, bytes: usize) -> Vec<u8> {
    // SAFETY: `room` gave this much, with nothing to spare.
    unsafe { Vec::from_raw_parts(at, bytes, bytes) }
}
