use std::sync::atomic::{AtomicU64, Ordering};

/// How far the reading of a log has come, for another thread to look at.
#[derive(Debug, Default)]
pub struct Progress {
    total: AtomicU64,
    /// Bytes of the files that are done.
    before: AtomicU64,
    /// Bytes of the file that is being read.
    here: AtomicU64,
}

impl Progress {
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
    }

    /// Says that there are `bytes` more: those of an object, which has no size before it is asked for.
    #[cfg_attr(not(feature = "cloud"), allow(dead_code, reason = "without it nothing is fetched"))]
    pub(super) fn grow(&self, bytes: u64) {
        self.total.fetch_add(bytes, Ordering::Relaxed);
    }

    /// Says how far the file that is being read was read.
    pub(super) fn at(&self, offset: u64) {
        self.here.store(offset, Ordering::Relaxed);
    }

    /// Says that a file of `bytes` is done.
    pub(super) fn file_done(&self, bytes: u64) {
        self.here.store(0, Ordering::Relaxed);
        self.before.fetch_add(bytes, Ordering::Relaxed);
    }
}
