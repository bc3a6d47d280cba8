//! Memory limit for numbers from tables. A few kilobytes can declare gigabytes of numbers by compression,
//! run lengths or missing chunks, so every table reader reserves memory here first.

use super::Extent;

/// Shared by all files of a run.
#[derive(Debug)]
pub(super) struct MemoryBudget {
    limit: u64,
    used: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} MiB of numbers not read: the tables would need more than {} MiB; raise the limit with \
     --max-unpacked GIB",
    bytes.div_ceil(1 << 20),
    limit >> 20
)]
pub(super) struct OutOfMemory {
    bytes: u64,
    limit: u64,
}

impl OutOfMemory {
    pub(super) const EXTENT: Extent = Extent::Unread;
}

impl MemoryBudget {
    /// Base limit of a run: 4 million numbers. An audit needs up to seven times as much.
    const BASE_BYTES: u64 = 32 << 20;
    /// Additional limit per byte of a file: 4 numbers. Episodes of LeRobot (Parquet) and robomimic (HDF5
    /// with gzip) need 1 to 4 bytes per number.
    const BYTES_PER_FILE_BYTE: u64 = 32;

    pub(super) fn new(requested_gib: Option<u32>) -> Self {
        Self { limit: Self::BASE_BYTES.max(u64::from(requested_gib.unwrap_or(0)) << 30), used: 0 }
    }

    pub(super) fn with_limit(bytes: u64) -> Self {
        Self { limit: bytes, used: 0 }
    }

    pub(super) fn add_file(&mut self, bytes: u64) {
        self.limit = self.limit.saturating_add(bytes.saturating_mul(Self::BYTES_PER_FILE_BYTE));
    }

    pub(super) fn reserve(&mut self, numbers: usize) -> Result<(), OutOfMemory> {
        self.reserve_bytes((numbers as u64).saturating_mul(8))
    }

    pub(super) fn reserve_bytes(&mut self, bytes: u64) -> Result<(), OutOfMemory> {
        let used = self.used.saturating_add(bytes);
        if used > self.limit {
            return Err(OutOfMemory { bytes, limit: self.limit });
        }
        self.used = used;
        Ok(())
    }

    /// Whether `bytes` may be used temporarily.
    pub(super) fn check_available(&self, bytes: u64) -> Result<(), OutOfMemory> {
        match self.used.saturating_add(bytes) > self.limit {
            true => Err(OutOfMemory { bytes, limit: self.limit }),
            false => Ok(()),
        }
    }

    pub(super) fn remaining(&self) -> u64 {
        self.limit.saturating_sub(self.used)
    }

    /// Releases numbers that are not kept.
    pub(super) fn release(&mut self, numbers: usize) {
        self.used = self.used.saturating_sub((numbers as u64).saturating_mul(8));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_share_one_memory_budget() {
        let mut memory = MemoryBudget::new(None);
        memory.add_file(1000);
        assert_eq!(
            memory.reserve((4 << 20) + 4001).map_err(|it| it.limit),
            Err((32 << 20) + 32_000)
        );
        memory.reserve(4 << 20).expect("within the base");
        memory.reserve(4000).expect("within the limit of the file");
        let refusal = memory.reserve(1).expect_err("beyond").to_string();
        assert!(refusal.contains("--max-unpacked") && !refusal.contains('\n'), "{refusal}");
        memory.release(1);
        memory.reserve(1).expect("as much as was released");
        assert!(memory.check_available(u64::MAX).is_err());
        MemoryBudget::new(Some(1)).reserve(1 << 27).expect("as asked for");
    }
}
