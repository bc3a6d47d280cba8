use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Who is told of each step: where there are no threads, nobody else can look.
type Told = Box<dyn Fn(&Progress) + Send + Sync>;

/// How far an audit has come, for another thread to look at.
#[derive(Default)]
pub struct Progress {
    total: AtomicU64,
    /// Bytes of the files that are done.
    before: AtomicU64,
    /// Bytes of the file that is being read.
    here: AtomicU64,
    doing: Mutex<&'static str>,
    told: Option<Told>,
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} of {} bytes", self.doing(), self.read(), self.total())
    }
}

impl Progress {
    /// One of whose steps `told` is told.
    pub fn telling(told: impl Fn(&Self) + Send + Sync + 'static) -> Self {
        Self { told: Some(Box::new(told)), ..Self::default() }
    }

    /// What is being done, in a word.
    pub fn doing(&self) -> &'static str {
        *self.doing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says what is done from now on.
    pub fn begins(&self, doing: &'static str) {
        *self.doing.lock().unwrap_or_else(PoisonError::into_inner) = doing;
        self.tell();
    }

    fn tell(&self) {
        if let Some(told) = &self.told {
            told(self);
        }
    }

    /// Bytes of all files; 0 until they were looked at.
    pub fn total(&self) -> u64 {
        self.total.load(Ordering::Relaxed)
    }

    /// Bytes read; at most [`Progress::total`].
    pub fn read(&self) -> u64 {
        let read = self.before.load(Ordering::Relaxed) + self.here.load(Ordering::Relaxed);
        read.min(self.total())
    }

    /// Says how many bytes there are in all.
    pub(super) fn begin(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
        self.begins("reading");
    }

    /// Says that there are `bytes` more: those of an object, which has no size before it is asked for.
    #[cfg_attr(not(feature = "cloud"), allow(dead_code, reason = "without it nothing is fetched"))]
    pub(super) fn grow(&self, bytes: u64) {
        self.total.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Says how far the file that is being read was read.
    pub(super) fn at(&self, offset: u64) {
        self.here.store(offset, Ordering::Relaxed);
        self.tell();
    }

    /// Says that a file of `bytes` is done.
    pub(super) fn file_done(&self, bytes: u64) {
        self.here.store(0, Ordering::Relaxed);
        self.before.fetch_add(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    #[test]
    fn who_asked_is_told_of_each_step() {
        let heard = Arc::new(Mutex::new(Vec::new()));
        let progress = Progress::telling({
            let heard = Arc::clone(&heard);
            move |progress| {
                heard.lock().expect("one thread").push((progress.doing(), progress.read()))
            }
        });
        progress.begin(10);
        progress.at(4);
        progress.file_done(10);
        progress.begins("judging");
        let heard = heard.lock().expect("one thread");
        assert_eq!(*heard, [("reading", 0), ("reading", 4), ("judging", 10)]);
    }
}
