//! From the paths given to the files to read.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use memmap2::{Mmap, MmapOptions};

use super::intake::Intake;
use super::remote::{self, Address};
use super::{LogError, rosbag2};

/// One file to read.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) struct Input {
    /// Where it is; of an object in a store, what it is called in reports.
    pub(super) path: PathBuf,
    /// The object's address, if it is one.
    pub(super) address: Option<Address>,
    /// Whether it is part of a rosbag2 folder.
    pub(super) in_bag: bool,
    /// How many messages the folder's `metadata.yaml` says it has.
    pub(super) recorded: Option<u64>,
}

impl Input {
    /// A local file that stands alone.
    fn local(path: PathBuf) -> Self {
        Self { path, address: None, in_bag: false, recorded: None }
    }

    /// A file of a rosbag2 folder that nothing is said of.
    pub(super) fn of_bag(path: PathBuf) -> Self {
        Self { in_bag: true, ..Self::local(path) }
    }

    /// Its size; 0 if that cannot be told, as of an object before it is asked for.
    pub(super) fn bytes(&self) -> u64 {
        fs::metadata(&self.path).map_or(0, |metadata| metadata.len())
    }
}

/// The files that `paths` stand for: a folder for those of the recording in it.
pub(super) fn inputs(paths: &[PathBuf], intake: &mut Intake) -> Result<Vec<Input>, LogError> {
    let mut inputs = Vec::new();
    for path in paths {
        let named = remote::local(path);
        let path = named.as_ref().unwrap_or(path);
        match Address::of(path)? {
            Some(address) => {
                let path = address.shown();
                inputs.push(Input { address: Some(address), ..Input::local(path) });
            }
            None if path.is_dir() => inputs.extend(rosbag2::files_of(path, intake)?),
            None => inputs.push(Input::local(path.clone())),
        }
    }
    Ok(inputs)
}

/// Refuses a file that is given twice, under the same or another path, and a copy of it.
pub(super) fn refuse_repeats(inputs: &[Input]) -> Result<(), LogError> {
    let mut by_size: HashMap<u64, Vec<&Input>> = HashMap::new();
    for input in inputs {
        let same_size = by_size.entry(input.bytes()).or_default();
        for first in same_size.iter() {
            let is_same = match (&first.address, &input.address) {
                (None, None) => is_same(&first.path, &input.path),
                (first, other) => first == other,
            };
            if is_same {
                let (path, first) = (input.path.clone(), first.path.clone());
                return Err(LogError::Twice { path, first });
            }
        }
        same_size.push(input);
    }
    Ok(())
}

/// Whether two files of one size are one file, or copies.
fn is_same(a: &Path, b: &Path) -> bool {
    if let (Ok(a), Ok(b)) = (fs::canonicalize(a), fs::canonicalize(b))
        && a == b
    {
        return true;
    }
    // Why one cannot be opened is said when it is read.
    match (Mapped::open(a), Mapped::open(b)) {
        (Ok(a), Ok(b)) => a.bytes() == b.bytes(),
        _ => false,
    }
}

/// How much of a file of `bytes` is mapped: of a hole at its end, which reads as zeros and is of no
/// length, not more than tells that there are zeros.
#[cfg(target_os = "linux")]
fn worth_reading(file: &File, bytes: u64) -> usize {
    use std::os::fd::AsRawFd;
    const ZEROS: u64 = 1 << 20;
    /// Holes beyond which a file is not searched.
    const MOST: usize = 1000;
    let whole = usize::try_from(bytes).unwrap_or(usize::MAX);
    // SAFETY: the call moves the offset of a file that is never read by it.
    let seek = |from: u64, to| unsafe {
        let found = libc::lseek64(file.as_raw_fd(), i64::try_from(from).unwrap_or(i64::MAX), to);
        u64::try_from(found).ok()
    };
    let mut from = 0;
    for _ in 0..MOST {
        let Some(hole) = seek(from, libc::SEEK_HOLE).filter(|hole| *hole < bytes) else {
            return whole;
        };
        match seek(hole, libc::SEEK_DATA) {
            Some(data) if data > hole => from = data,
            _ => return whole.min(usize::try_from(hole + ZEROS).unwrap_or(whole)),
        }
    }
    whole
}

#[cfg(not(target_os = "linux"))]
fn worth_reading(_: &File, bytes: u64) -> usize {
    usize::try_from(bytes).unwrap_or(usize::MAX)
}

/// A file in memory.
pub(super) struct Mapped(Mmap);

impl Mapped {
    /// Maps a file into memory, or says in one line why it cannot be read.
    pub(super) fn open(path: &Path) -> Result<Self, LogError> {
        let io_error = |source: io::Error| LogError::io(path, source);
        // Before it is opened: a pipe would wait for somebody to write to it.
        let metadata = fs::metadata(path).map_err(io_error)?;
        if !metadata.is_file() {
            return Err(LogError::NotAFile { path: path.to_owned() });
        }
        let file = File::open(path).map_err(io_error)?;
        if metadata.len() == 0 {
            return Err(LogError::Empty { path: path.to_owned() });
        }
        // SAFETY: the map is read-only and lives only while its file is decoded. Another process
        // that shortens the file meanwhile ends this one with SIGBUS, as with any memory-mapped
        // reader.
        unsafe { MmapOptions::new().len(worth_reading(&file, metadata.len())).map(&file) }
            .map(Self)
            .map_err(io_error)
    }

    /// Maps an open file that nobody else knows.
    pub(super) fn of(file: &File) -> io::Result<Self> {
        // SAFETY: the map is read-only, and nobody else writes to the file.
        let mapped = unsafe { Mmap::map(file) }.map(Self)?;
        if mapped.bytes().is_empty() {
            Err(io::ErrorKind::UnexpectedEof.into())
        } else {
            Ok(mapped)
        }
    }

    /// Its content.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }
}
