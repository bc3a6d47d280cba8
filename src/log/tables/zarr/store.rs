//! Where the metadata and the chunks of a store are: a folder, or a zip archive.

use std::fs;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use serde_json::Value;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::tables::{MOST_COLUMNS, MOST_PACKED, MOST_SMALL, Refusal};

/// Files with the metadata of an array or a group, in the second version and in the third.
const METADATA: [&str; 3] = [".zarray", ".zgroup", "zarr.json"];
const ATTRIBUTES: &str = ".zattrs";
/// Groups within groups that are looked at.
const DEEP: usize = 8;
/// Largest file of metadata.
const MOST_BYTES: u64 = 16 << 20;
/// Most bytes of a chunk.
const MOST_CHUNK: u64 = 1 << 31;

pub(super) enum Store<'a> {
    Folder(PathBuf),
    /// An archive, and the folder in it that is the store.
    Zip(ZipArchive<Cursor<&'a [u8]>>, String),
}

/// Whether a folder is such a store.
pub fn is_store(folder: &Path) -> bool {
    let store = || Store::Folder(folder.to_owned());
    METADATA.iter().any(|name| folder.join(name).is_file())
        && METADATA.iter().any(|name| store().json(name).is_some_and(|it| is_metadata(&it)))
}

/// Whether a zip archive is one, by the names of its first members or of its last.
pub(crate) fn is_zip_store(bytes: &[u8]) -> bool {
    /// Where names are looked for, from the beginning and from the end.
    const GLANCE: usize = 1 << 16;
    let (head, tail) =
        (&bytes[..bytes.len().min(GLANCE)], &bytes[bytes.len().saturating_sub(GLANCE)..]);
    let names = |part: &[u8]| {
        METADATA.iter().any(|name| memchr::memmem::find(part, name.as_bytes()).is_some())
    };
    names(head) || names(tail)
}

fn is_metadata(value: &Value) -> bool {
    matches!(value.get("zarr_format").and_then(Value::as_u64), Some(2 | 3))
}

impl<'a> Store<'a> {
    pub fn zip(bytes: &'a [u8]) -> Result<Self, Refusal> {
        let archive = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| format!("the zip archive cannot be read: {error}"))?;
        let home = folders(&archive, "").into_iter().min_by_key(String::len);
        let home = home.ok_or("the zip archive holds no Zarr store")?;
        // Where the whole has no metadata of its own, it is the folder above its parts.
        let is_part = |home: &str| home == "data" || home == "meta";
        let home = match home.rsplit_once('/') {
            Some((above, part)) if is_part(part) => format!("{above}/"),
            None if home.is_empty() || is_part(&home) => String::new(),
            _ => format!("{home}/"),
        };
        Ok(Self::Zip(archive, home))
    }

    /// The bytes at a key; `None` where nothing is there.
    pub fn get(&mut self, key: &str) -> Result<Option<Vec<u8>>, Refusal> {
        let mut bytes = Vec::new();
        let read = match self {
            Self::Folder(folder) => {
                let path = folder.join(key);
                // A pipe would wait for somebody to write to it.
                if !path.is_file() {
                    return Ok(None);
                }
                fs::File::open(path).and_then(|file| file.take(MOST_CHUNK).read_to_end(&mut bytes))
            }
            Self::Zip(archive, home) => match archive.by_name(&format!("{home}{key}")) {
                Ok(file) => {
                    let most = MOST_PACKED as u64 * file.compressed_size() + MOST_SMALL as u64;
                    file.take(most.min(MOST_CHUNK)).read_to_end(&mut bytes)
                }
                Err(ZipError::FileNotFound) => return Ok(None),
                Err(error) => return Err(format!("'{key}' cannot be unpacked: {error}")),
            },
        };
        read.map_err(|error| format!("'{key}' cannot be read: {error}"))?;
        Ok(Some(bytes))
    }

    fn json(&mut self, key: &str) -> Option<Value> {
        if let Self::Folder(folder) = self
            && fs::metadata(folder.join(key)).map_or(true, |it| it.len() > MOST_BYTES)
        {
            return None;
        }
        serde_json::from_slice(&self.get(key).ok()??).ok()
    }

    /// The metadata of all arrays by their paths, in the order of these.
    pub fn arrays(&mut self) -> Vec<(String, Value)> {
        let mut paths = match self {
            Self::Folder(folder) => in_folder(folder),
            Self::Zip(archive, home) => folders(archive, home),
        };
        paths.sort();
        paths.dedup();
        paths.truncate(MOST_COLUMNS);
        let is_array = |metadata: &Value| is_metadata(metadata) && metadata.get("shape").is_some();
        let of = |path: String| {
            let found =
                METADATA.iter().find_map(|name| self.json(&joined(&path, name)).filter(is_array));
            found.map(|metadata| (path, metadata))
        };
        paths.into_iter().filter_map(of).collect()
    }

    /// What is said of the group at `path`, beside its arrays.
    pub fn attributes(&mut self, path: &str) -> Option<Value> {
        let third = self.json(&joined(path, "zarr.json"));
        let third = third.and_then(|value| value.get("attributes").cloned());
        third.or_else(|| self.json(&joined(path, ATTRIBUTES)))
    }
}

/// The folders in an archive, below one of them, that have metadata.
fn folders(archive: &ZipArchive<Cursor<&[u8]>>, home: &str) -> Vec<String> {
    let of = |name: &str| {
        let name = name.strip_prefix(home)?;
        let (folder, own) = name.rsplit_once('/').unwrap_or(("", name));
        METADATA.contains(&own).then(|| folder.to_owned())
    };
    archive.file_names().filter_map(Result::ok).filter_map(|name| of(&name)).collect()
}

fn joined(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
}

/// The paths of what has metadata in a folder. What is in an array is not looked at.
fn in_folder(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut open = vec![(String::new(), 0)];
    while let Some((path, depth)) = open.pop() {
        let own = folder.join(&path);
        let is_array = own.join(".zarray").is_file() || own.join("c").exists();
        found.push(path.clone());
        if is_array || depth == DEEP || found.len() > MOST_COLUMNS {
            continue;
        }
        let inside = fs::read_dir(&own).into_iter().flatten().filter_map(Result::ok);
        let folders = inside.filter(|entry| entry.path().is_dir());
        open.extend(
            folders.map(|entry| (joined(&path, &entry.file_name().to_string_lossy()), depth + 1)),
        );
    }
    found
}
