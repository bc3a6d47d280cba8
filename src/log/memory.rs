//! How much memory the numbers of tables may take.
//!
//! A few kilobytes of a table can declare gigabytes of numbers: by compression, by run lengths, by chunks that
//! are not there. Every reader of tables counts its numbers here before it asks for their memory.

use super::Extent;

/// The memory that the numbers of all files of a run may take.
#[derive(Debug)]
pub(super) struct Memory {
    limit: u64,
    used: u64,
}

/// Numbers that are not read, because they would take more than the limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} MiB of numbers are not read: with them the tables would take more than {} MiB; allow more with \
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

impl Memory {
    /// What a run may take however small its files are: 4 million numbers. An audit takes up to seven times as
    /// much in all.
    const BASE: u64 = 32 << 20;
    /// What each byte of a file may take beyond that: 4 numbers. Episodes of LeRobot (Parquet) and robomimic
    /// (HDF5 with gzip) need 1 to 4 bytes for a number.
    const RATIO: u64 = 32;

    /// The memory of a run, and as many GiB as were asked for.
    pub(super) fn of(asked_gib: Option<u32>) -> Self {
        Self { limit: Self::BASE.max(u64::from(asked_gib.unwrap_or(0)) << 30), used: 0 }
    }

    /// Adds what a file of `bytes` may take.
    pub(super) fn add_file(&mut self, bytes: u64) {
        self.limit = self.limit.saturating_add(bytes.saturating_mul(Self::RATIO));
    }

    /// Counts `numbers` that are to be kept.
    pub(super) fn take(&mut self, numbers: usize) -> Result<(), OutOfMemory> {
        self.take_bytes((numbers as u64).saturating_mul(8))
    }

    /// Counts `bytes`.
    pub(super) fn take_bytes(&mut self, bytes: u64) -> Result<(), OutOfMemory> {
        let used = self.used.saturating_add(bytes);
        if used > self.limit {
            return Err(OutOfMemory { bytes, limit: self.limit });
        }
        self.used = used;
        Ok(())
    }

    /// Whether `bytes` may be used for a moment.
    pub(super) fn allows(&self, bytes: u64) -> Result<(), OutOfMemory> {
        match self.used.saturating_add(bytes) > self.limit {
            true => Err(OutOfMemory { bytes, limit: self.limit }),
            false => Ok(()),
        }
    }

    /// The bytes that are left.
    pub(super) fn left(&self) -> u64 {
        self.limit.saturating_sub(self.used)
    }

    /// Gives back what was taken for numbers that are not kept.
    pub(super) fn give_back(&mut self, numbers: usize) {
        self.used = self.used.saturating_sub((numbers as u64).saturating_mul(8));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_files_share_what_they_may_take_together() {
        let mut memory = Memory::of(None);
        memory.add_file(1000);
        assert_eq!(memory.take((4 << 20) + 4001).map_err(|it| it.limit), Err((32 << 20) + 32_000));
        memory.take(4 << 20).expect("within the base");
        memory.take(4000).expect("within the file's own");
        let refusal = memory.take(1).expect_err("beyond").to_string();
        assert!(refusal.contains("--max-unpacked") && !refusal.contains('\n'), "{refusal}");
        memory.give_back(1);
        memory.take(1).expect("as much as was given back");
        assert!(memory.allows(u64::MAX).is_err());
        Memory::of(Some(1)).take(1 << 27).expect("as asked for");
    }
}
