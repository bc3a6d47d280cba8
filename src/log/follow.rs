//! Reads a log while it is being written, each byte once.

use std::fs::{File, Metadata};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::MAGIC;

use super::intake::Intake;
use super::losses::Losses;
use super::mcap::GrowingFile;
use super::{Container, Crc, Log, LogError, LogFile, ReadOptions, mcap as container};

const MAX_READ_BYTES: u64 = 64 << 20;

/// Bytes before the read position that are compared again: if they changed, the file was restarted.
const COMPARED_BYTES: usize = 64;

/// Change since the last call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Growth {
    /// No further complete record.
    None,
    /// More records were read.
    More,
    /// Replaced or truncated; earlier content is discarded.
    Restarted,
    /// Closed or damaged; following stops.
    Ended,
}

/// MCAP file that is read while it is being written. Keeps columns, plus the bytes of an incomplete record.
pub struct LogFollower {
    path: PathBuf,
    options: ReadOptions,
    state: FollowState,
}

#[derive(Default)]
struct FollowState {
    file: Option<u64>,
    /// Bytes read, including `rest`.
    read: u64,
    rest: Vec<u8>,
    compared: Vec<u8>,
    growing: GrowingFile,
    intake: Intake,
    has_begun: bool,
    has_ended: bool,
}

impl LogFollower {
    /// Follows the file at `path` from its start.
    pub fn new(path: &Path, options: &ReadOptions) -> Self {
        Self { path: path.to_owned(), options: options.clone(), state: FollowState::default() }
    }

    /// Whether the file at `path` starts like an MCAP file, the only supported format.
    pub fn is_supported(path: &Path) -> bool {
        let mut head = [0; MAGIC.len()];
        let read = File::open(path).and_then(|mut file| file.read_exact(&mut head));
        read.is_ok() && head == MAGIC
    }

    /// Reads the bytes written since the last call.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn advance(&mut self) -> Result<Growth, LogError> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| LogError::io(&path, source)
        };
        let mut file = File::open(&self.path).map_err(failed(&self.path))?;
        let metadata = file.metadata().map_err(failed(&self.path))?;
        let is_same = self.is_same(&mut file, &metadata).map_err(failed(&self.path))?;
        if !is_same {
            self.state = FollowState::default();
            // The new content is read at the next call, after the previous one is finished.
            return Ok(Growth::Restarted);
        }
        if self.state.has_ended {
            return Ok(Growth::Ended);
        }
        self.state.file = identity(&metadata);
        let new = metadata.len().saturating_sub(self.state.read).min(MAX_READ_BYTES);
        if new == 0 {
            return Ok(Growth::None);
        }
        file.seek(SeekFrom::Start(self.state.read)).map_err(failed(&self.path))?;
        let before = self.state.rest.len();
        file.take(new).read_to_end(&mut self.state.rest).map_err(failed(&self.path))?;
        let state = &mut self.state;
        state.read += (state.rest.len() - before) as u64;
        let from = state.rest.len().saturating_sub(COMPARED_BYTES);
        state.compared = state.rest[from..].to_vec();
        Ok(self.add_records(metadata.len()))
    }

    fn add_records(&mut self, bytes: u64) -> Growth {
        let Self { path, options, state } = self;
        if !state.has_begun {
            let Some(rest) = state.rest.strip_prefix(MAGIC) else { return Growth::None };
            state.rest = rest.to_vec();
            state.has_begun = true;
            state.intake.begin_file(path, bytes);
        }
        let (whole, has_end) = container::whole_records(&state.rest);
        if whole == 0 && !has_end {
            return Growth::None;
        }
        let rest = state.rest.split_off(whole);
        let records = [MAGIC, &std::mem::replace(&mut state.rest, rest)].concat();
        let mut losses = Losses::new(path);
        let options = ReadOptions { progress: None, ..options.clone() };
        state.growing.read(&records, &options, &mut losses, &mut state.intake);
        // Damage can only be located by reading the whole file.
        state.has_ended = has_end || !losses.is_empty();
        if state.has_ended { Growth::Ended } else { Growth::More }
    }

    /// Content so far. `None` without a message.
    pub fn log(&self) -> Option<Log> {
        let file = LogFile {
            path: self.path.clone(),
            container: Container::Mcap,
            bytes: self.state.read,
            fetched: None,
            crc: Crc::None,
        };
        (self.state.intake.messages() > 0).then(|| self.state.intake.snapshot(vec![file]))
    }

    /// Number of bytes read.
    pub fn read(&self) -> u64 {
        self.state.read
    }

    fn is_same(&self, file: &mut File, metadata: &Metadata) -> std::io::Result<bool> {
        let state = &self.state;
        if state.read == 0 {
            return Ok(true);
        }
        if state.file != identity(metadata) || metadata.len() < state.read {
            return Ok(false);
        }
        let mut there = vec![0; state.compared.len()];
        file.seek(SeekFrom::Start(state.read - there.len() as u64))?;
        file.read_exact(&mut there)?;
        Ok(there == state.compared)
    }
}

/// Identity of a file, to detect replacement, if the system provides one.
#[cfg(unix)]
fn identity(metadata: &Metadata) -> Option<u64> {
    use std::os::unix::fs::MetadataExt;
    Some(metadata.ino())
}

#[cfg(not(unix))]
fn identity(_: &Metadata) -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::testing::{self, Cdr, LogWriter};

    fn poses(first: u64, count: u64) -> Vec<u8> {
        let mut log = LogWriter::default();
        let channel = log.channel("/pose", "geometry_msgs/msg/PoseStamped", testing::POSE_STAMPED);
        for time in first..first + count {
            let message = Cdr::pose_stamped(0, time as u32, "base", [1.0, 2.0, 3.0]);
            log.message(channel, time, &message);
        }
        log.finish()
    }

    fn follow(path: &Path) -> LogFollower {
        LogFollower::new(path, &ReadOptions::default())
    }

    #[test]
    fn following_a_file_gives_the_same_log_as_reading_it_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let whole = poses(100, 500);
        for step in [1, 7, 100, 4096] {
            fs::write(&path, b"").unwrap();
            let mut following = follow(&path);
            let mut ended = Growth::None;
            let mut steps: Vec<usize> =
                (0..whole.len()).step_by(step.max(whole.len() / 200)).collect();
            steps.push(whole.len());
            for end in steps {
                use std::io::Write;
                let there = fs::metadata(&path).unwrap().len() as usize;
                let mut file = fs::OpenOptions::new().append(true).open(&path).unwrap();
                file.write_all(&whole[there..end.max(there)]).unwrap();
                ended = following.advance().unwrap();
            }
            assert_eq!(ended, Growth::Ended);
            let whole_log =
                crate::open(std::slice::from_ref(&path), &ReadOptions::default()).unwrap();
            let log = following.log().unwrap();
            assert_eq!((log.topics, log.messages), (whole_log.topics, whole_log.messages));
            assert!(following.read() <= whole.len() as u64);
        }
    }

    #[test]
    fn a_restarted_file_is_read_anew() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let (first, second) = (poses(100, 500), poses(9000, 700));
        for (kept, is_new) in
            [(second.len() / 4, false), (second.len(), false), (second.len(), true)]
        {
            fs::write(&path, &first[..first.len() / 2]).unwrap();
            let mut following = follow(&path);
            assert_eq!(following.advance().unwrap(), Growth::More);
            let before = following.log().unwrap().messages;
            assert!(before > 0);
            if is_new {
                fs::rename(&path, folder.path().join("old.mcap")).unwrap();
            }
            fs::write(&path, &second[..kept]).unwrap();
            assert_eq!(following.advance().unwrap(), Growth::Restarted);
            assert_eq!(following.log(), None);
            following.advance().unwrap();
            let log = following.log();
            assert!(log.is_none_or(|log| log.span.unwrap().0.nanos() == 9000), "{kept}");
        }
    }

    #[test]
    fn damage_ends_the_following_of_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut bytes = poses(100, 500);
        let half = bytes.len() / 2;
        bytes[half..half + 200].fill(0);
        fs::write(&path, &bytes).unwrap();
        assert!(LogFollower::is_supported(&path));
        let mut following = follow(&path);
        assert_eq!(following.advance().unwrap(), Growth::Ended);
        assert_eq!(following.advance().unwrap(), Growth::Ended);
    }
}
