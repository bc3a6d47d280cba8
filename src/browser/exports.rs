//! Functions for the page's worker. An instance answers one question and is discarded with its memory.
#![allow(unsafe_code, reason = "bytes are passed by address")]

use std::panic;
use std::sync::{Mutex, PoisonError};

use bytes::Bytes;
use poseaudit::log::Progress;

use crate::answer;

#[link(wasm_import_module = "page")]
unsafe extern "C" {
    /// Current step, bytes read, bytes in total.
    fn step(doing: *const u8, length: usize, read: f64, total: f64);
    /// Message of a panic.
    fn failed(message: *const u8, length: usize);
}

/// In the order of the question.
static FILES: Mutex<Vec<Bytes>> = Mutex::new(Vec::new());

/// Allocates memory that the caller fills and passes to `file` or `ask`. Null if out of memory.
#[unsafe(no_mangle)]
pub extern "C" fn room(bytes: usize) -> *mut u8 {
    let mut room = Vec::<u8>::new();
    if room.try_reserve_exact(bytes).is_err() {
        return std::ptr::null_mut();
    }
    // Exact capacity for `Vec::from_raw_parts`.
    room.resize(bytes, 0);
    room.leak().as_mut_ptr()
}

/// Takes the next file.
///
/// # Safety
/// `at` must come from `room(bytes)`, be filled, and be passed once.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn file(at: *mut u8, bytes: usize) {
    // SAFETY: guaranteed by the caller.
    let content = unsafe { filled(at, bytes) };
    FILES.lock().unwrap_or_else(PoisonError::into_inner).push(content.into());
}

/// Answers a JSON question. Returns the answer's length and its JSON.
///
/// # Safety
/// As for `file`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn ask(at: *mut u8, bytes: usize) -> *const u8 {
    panic::set_hook(Box::new(|info| {
        let message = info.to_string();
        // SAFETY: the page copies the text before it returns.
        unsafe { failed(message.as_ptr(), message.len()) }
    }));
    // SAFETY: guaranteed by the caller.
    let question = unsafe { filled(at, bytes) };
    let files = std::mem::take(&mut *FILES.lock().unwrap_or_else(PoisonError::into_inner));
    let last_step = Mutex::new((0, ""));
    let progress = Progress::with_callback(move |progress| {
        // Posts at most 200 updates.
        let (read, total, doing) = (progress.read(), progress.total(), progress.activity());
        let now = (200 * read / total.max(1), doing);
        if std::mem::replace(&mut *last_step.lock().unwrap_or_else(PoisonError::into_inner), now)
            != now
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

/// Reclaims memory of `room`.
///
/// # Safety
/// As for `file`.
unsafe fn filled(at: *mut u8, bytes: usize) -> Vec<u8> {
    // SAFETY: `room` allocated exactly this capacity.
    unsafe { Vec::from_raw_parts(at, bytes, bytes) }
}
