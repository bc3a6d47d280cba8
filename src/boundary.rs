//! Where a fault of this program ends: a panic becomes one line.

use std::any::Any;
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Arc, Mutex, PoisonError};

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_told_in_one_line_with_its_place() {
        let told = caught(|| -> u32 { panic!("index {} is out of bounds\nmore", 7) });
        let told = told.expect_err("a panic");
        assert!(told.starts_with("index 7 is out of bounds ("), "{told}");
        assert!(told.contains("boundary.rs:") && !told.contains('\n'), "{told}");
        assert_eq!(caught(|| 3), Ok(3));
    }

    #[test]
    fn a_panic_of_another_thread_that_work_waits_for_is_told_as_the_first_one_said() {
        let work = || rayon::join(|| panic!("of a worker"), || 1);
        let told = caught(work).expect_err("a panic");
        assert!(told.starts_with("of a worker (") && told.contains("boundary.rs:"), "{told}");
    }
}
