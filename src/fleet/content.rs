//! Identifies a log by its content, not its location.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use blake3::Hasher;
use walkdir::WalkDir;

use crate::log::{RemoteObject, is_store, split_episode, store_files};

/// How the content of a log is identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Identity {
    /// Hash of every byte: copies are the same log.
    Content,
    /// Path, size and modification time; nothing is read.
    File,
}

/// Content identifier, with the state of the files.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogContent {
    /// `blake3:`, `file:` or `object:`, followed by 64 digits.
    pub id: String,
    pub state: FileState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct FileState {
    pub bytes: u64,
    /// Latest modification, ns since 1970.
    pub mtime_ns: i64,
}

/// 128 bits.
const KEY_DIGITS: usize = 32;

impl FileState {
    /// # Errors
    /// If the log does not exist, or contains anything but regular files.
    pub fn read(path: &Path) -> io::Result<Self> {
        let mut state = Self { bytes: 0, mtime_ns: 0 };
        for file in list_files(path)? {
            let metadata = fs::metadata(file)?;
            if !metadata.is_file() {
                return Err(io::Error::other("it is not a regular file"));
            }
            let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
            let mtime_ns = i64::try_from(since.as_nanos()).unwrap_or(i64::MAX);
            state.bytes += metadata.len();
            state.mtime_ns = state.mtime_ns.max(mtime_ns);
        }
        Ok(state)
    }

    /// Hash of path and state. While it is unchanged, a stored content identifier is valid.
    pub fn hash(&self, path: &Path) -> String {
        let mut hasher = Hasher::new();
        for part in [
            path.as_os_str().as_encoded_bytes(),
            &self.bytes.to_le_bytes(),
            &self.mtime_ns.to_le_bytes(),
        ] {
            hash_part(&mut hasher, part);
        }
        hasher.finalize().to_hex().to_string()
    }
}

impl LogContent {
    /// # Errors
    /// If the log cannot be read.
    pub fn identify(path: &Path, state: FileState, identity: Identity) -> io::Result<Self> {
        // Hashing a file once per episode would be too slow.
        let id = match (identity, split_episode(path)) {
            (Identity::Content, (_, None)) => format!("blake3:{}", content_hash(path)?),
            (Identity::File, _) | (_, (_, Some(_))) => format!("file:{}", state.hash(path)),
        };
        Ok(Self { id, state })
    }
}

impl From<&RemoteObject> for LogContent {
    /// From URL, size and version, without a download.
    fn from(object: &RemoteObject) -> Self {
        let mut hasher = Hasher::new();
        for part in [&object.url, &object.bytes.to_string(), &object.version] {
            hash_part(&mut hasher, part.as_bytes());
        }
        let id = format!("object:{}", hasher.finalize().to_hex());
        Self { id, state: FileState { bytes: object.bytes, mtime_ns: 0 } }
    }
}

/// Key of the rows of `content`, audited by this `version` with these settings.
pub fn row_key(content: &str, version: &str, settings: &str) -> String {
    let mut hasher = Hasher::new();
    for part in [content, version, settings] {
        hash_part(&mut hasher, part.as_bytes());
    }
    hasher.finalize().to_hex()[..KEY_DIGITS].to_owned()
}

/// Hashes the length too, to distinguish different splits.
fn hash_part(hasher: &mut Hasher, part: &[u8]) {
    hasher.update(&(part.len() as u64).to_le_bytes()).update(part);
}

/// Hash of a file, or of the names and contents of a folder's files.
fn content_hash(path: &Path) -> io::Result<String> {
    let mut hasher = Hasher::new();
    if !path.is_dir() {
        hasher.update_reader(File::open(path)?)?;
        return Ok(hasher.finalize().to_hex().to_string());
    }
    for file in list_files(path)? {
        let name = file.strip_prefix(path).unwrap_or(&file).as_os_str();
        hash_part(&mut hasher, name.as_encoded_bytes());
        hash_part(&mut hasher, content_hash(&file)?.as_bytes());
    }
    Ok(hasher.finalize().to_hex().to_string())
}

/// Sorted by path.
fn list_files(path: &Path) -> io::Result<Vec<PathBuf>> {
    let (path, _) = &split_episode(path);
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    if is_store(path) {
        return Ok(store_files(path));
    }
    let mut files = Vec::new();
    for entry in WalkDir::new(path).sort_by_file_name() {
        let entry = entry?;
        if !entry.file_type().is_dir() {
            files.push(entry.into_path());
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_share_an_id_and_another_byte_changes_it() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let at = |name: &str| folder.path().join(name);
        let id = |name: &str, identity| -> io::Result<String> {
            Ok(LogContent::identify(&at(name), FileState::read(&at(name))?, identity)?.id)
        };
        for (bag, second) in [("a", "2"), ("b", "2"), ("c", "3")] {
            fs::create_dir(at(bag))?;
            fs::write(at(bag).join("0.db3"), "1")?;
            fs::write(at(bag).join("1.db3"), second)?;
        }
        let same = |a: &str, b: &str| -> io::Result<bool> {
            Ok(id(a, Identity::Content)? == id(b, Identity::Content)?)
        };
        assert!(same("a", "b")? && !same("a", "c")?);
        assert!(same("a/0.db3", "c/0.db3")? && !same("a/0.db3", "a/1.db3")?);
        assert_ne!(id("a/0.db3", Identity::File)?, id("c/0.db3", Identity::File)?);
        Ok(())
    }

    #[test]
    fn a_key_depends_on_all_parts_and_their_order() {
        let keys = [row_key("a", "b", "c"), row_key("ab", "", "c"), row_key("b", "a", "c")];
        assert!(keys[0] != keys[1] && keys[0] != keys[2]);
        assert!(keys.iter().all(|key| key.len() == KEY_DIGITS));
    }
}
