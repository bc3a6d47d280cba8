use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Needed if there are no threads.
type StepCallback = Box<dyn Fn(&Progress) + Send + Sync>;

/// Progress of an audit, readable from other threads.
#[derive(Default)]
pub struct Progress {
    total: AtomicU64,
    before: AtomicU64,
    here: AtomicU64,
    doing: Mutex<&'static str>,
    callback: Option<StepCallback>,
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} of {} bytes", self.activity(), self.read(), self.total())
    }
}

impl Progress {
    /// Calls `callback` at each step.
    pub fn with_callback(callback: impl Fn(&Self) + Send + Sync + 'static) -> Self {
        Self { callback: Some(Box::new(callback)), ..Self::default() }
    }

    /// Current activity, one word.
    pub fn activity(&self) -> &'static str {
        *self.doing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the current activity.
    pub fn set_activity(&self, doing: &'static str) {
        *self.doing.lock().unwrap_or_else(PoisonError::into_inner) = doing;
        self.notify();
    }

    fn notify(&self) {
        if let Some(callback) = &self.callback {
            callback(self);
        }
    }

    /// Bytes of all files; 0 until known.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Bytes read; at most [`Progress::total`].
    pub fn read(&self) -> u64 {
        let read = self.before.load(Ordering::Relaxed) + self.here.load(Ordering::Relaxed);
        read.min(self.total())
    }

    pub(super) fn set_total(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
        self.set_activity("reading");
    }

    /// For an object whose size was unknown.
    #[cfg_attr(not(feature = "cloud"), allow(dead_code, reason = "without it nothing is fetched"))]
    pub(super) fn add_total(&self, bytes: u64) {
        self.total.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(super) fn set_position(&self, offset: u64) {
        self.here.store(offset, Ordering::Relaxed);
        self.notify();
    }

    pub(super) fn finish_file(&self, bytes: u64) {
        self.here.store(0, Ordering::Relaxed);
        self.before.fetch_add(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn the_callback_receives_each_step() {
        let heard = Arc::new(Mutex::new(Vec::new()));
        let progress = Progress::with_callback({
            let heard = Arc::clone(&heard);
            move |progress| {
                heard.lock().expect("one thread").push((progress.activity(), progress.read()))
            }
        });
        progress.set_total(10);
        progress.set_position(4);
        progress.finish_file(10);
        progress.set_activity("judging");
        let heard = heard.lock().expect("one thread");
        assert_eq!(*heard, [("reading", 0), ("reading", 4), ("judging", 10)]);
    }
}
