//! Where the metadata and the chunks of a store are: a folder, or a zip archive.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use serde_json::Value;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::contained::{Contained, LEADS_OUT};
use crate::tables::{MOST_COLUMNS, MOST_METADATA, Refusal};

/// Files with the metadata of an array or a group, in the second version and in the third.
const METADATA: [&str; 3] = [".zarray", ".zgroup", "zarr.json"];
const ATTRIBUTES: &str = ".zattrs";
/// Groups within groups that are looked at.
const DEEP: usize = 8;
/// Bytes that packing may add to a chunk: headers, and blocks that cannot be compressed.
const PACKING: u64 = 1 << 16;

pub(super) enum Store<'a> {
    Folder(PathBuf, Contained),
    /// An archive, and the folder in it that is the store.
    Zip(ZipArchive<Cursor<&'a [u8]>>, String),
}

/// Whether a folder is such a store.
pub fn is_store(folder: &Path) -> bool {
    let is_metadata = |name: &&str| {
        let metadata = Store::folder(folder).json(name);
        metadata.is_ok_and(|it| it.is_some_and(|it| is_metadata(&it)))
    };
    METADATA.iter().any(|name| folder.join(name).is_file()) && METADATA.iter().any(is_metadata)
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

    pub fn folder(path: &Path) -> Self {
        Self::Folder(path.to_owned(), Contained::of(path))
    }

    /// The bytes at a key, `most` and what packing adds; `None` if nothing is there.
    pub fn get(&mut self, key: &str, most: u64) -> Result<Option<Vec<u8>>, Refusal> {
        let most = most.saturating_add(most / 8).saturating_add(PACKING);
        let mut bytes = Vec::new();
        let read = match self {
            Self::Folder(folder, contained) => {
                let path = folder.join(key);
                if !contained.holds(&path) {
                    return Err(format!("'{key}' {LEADS_OUT}").into());
                }
                // A pipe would wait for somebody to write to it.
                if !path.is_file() {
                    return Ok(None);
                }
                fs::File::open(path).and_then(|file| file.take(most + 1).read_to_end(&mut bytes))
            }
            Self::Zip(archive, home) => match archive.by_name(&format!("{home}{key}")) {
                Ok(file) => file.take(most + 1).read_to_end(&mut bytes),
                Err(ZipError::FileNotFound) => return Ok(None),
                Err(error) => return Err(format!("'{key}' cannot be unpacked: {error}").into()),
            },
        };
        read.map_err(|error| format!("'{key}' cannot be read: {error}"))?;
        if bytes.len() as u64 > most {
            return Err(format!("'{key}' has more than the {most} bytes that it may have").into());
        }
        Ok(Some(bytes))
    }

    /// The JSON at a key; `None` if nothing is there.
    pub fn json(&mut self, key: &str) -> Result<Option<Value>, Refusal> {
        let Some(bytes) = self.get(key, MOST_METADATA)? else { return Ok(None) };
        let read = serde_json::from_slice(&bytes);
        read.map(Some).map_err(|error| format!("'{key}' cannot be read: {error}").into())
    }

    /// The metadata of all arrays by their paths, in the order of these, or why they cannot be read. Chunks
    /// without metadata are an array that cannot be read.
    pub fn arrays(&mut self) -> Vec<(String, Result<Value, Refusal>)> {
        let (mut paths, chunks) = match self {
            Self::Folder(folder, contained) => in_folder(folder, contained),
            Self::Zip(archive, home) => (folders(archive, home), chunks_of(archive, home)),
        };
        paths.sort();
        paths.dedup();
        let mut are_too_many = paths.len() > MOST_COLUMNS;
        paths.truncate(MOST_COLUMNS);
        let is_array = |metadata: &Value| is_metadata(metadata) && metadata.get("shape").is_some();
        let mut found = BTreeMap::new();
        for path in paths {
            for name in METADATA {
                match self.json(&joined(&path, name)) {
                    Ok(Some(metadata)) if is_array(&metadata) => {
                        found.insert(path.clone(), Ok(metadata));
                        break;
                    }
                    Ok(Some(_)) if name == METADATA[0] => {
                        let what = format!("'{}' describes no array", joined(&path, name));
                        found.entry(path.clone()).or_insert(Err(what.into()));
                    }
                    Ok(_) => {}
                    Err(what) => {
                        found.entry(path.clone()).or_insert(Err(what));
                    }
                }
            }
        }
        let is_part = |path: &str| {
            let mut above = Path::new(path).ancestors();
            above.any(|above| above.to_str().is_some_and(|above| found.contains_key(above)))
        };
        let orphans: Vec<String> = chunks.into_iter().filter(|path| !is_part(path)).collect();
        for path in orphans {
            let what = format!("'{path}' has chunks, and no metadata that say what they are");
            found.insert(path, Err(what.into()));
        }
        are_too_many |= found.len() > MOST_COLUMNS;
        let what = format!("it has more than {MOST_COLUMNS} arrays; the others are not read");
        let others = are_too_many.then(|| (String::new(), Err(what.into())));
        found.into_iter().take(MOST_COLUMNS).chain(others).collect()
    }

    /// What is said of the group at `path`, beside its arrays.
    pub fn attributes(&mut self, path: &str) -> Option<Value> {
        let third = self.json(&joined(path, "zarr.json")).ok().flatten();
        let third = third.and_then(|value| value.get("attributes").cloned());
        third.or_else(|| self.json(&joined(path, ATTRIBUTES)).ok().flatten())
    }
}

/// The path of the array that a chunk is of, by its name: numbers with points between them, or folders of numbers.
fn array_of_chunk(key: &str) -> Option<&str> {
    let is_chunk = |name: &str| {
        let name = name.strip_prefix("c.").unwrap_or(name);
        !name.is_empty()
            && name
                .split('.')
                .all(|part| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit()))
    };
    let (mut path, name) = key.rsplit_once('/')?;
    if !is_chunk(name) {
        return None;
    }
    while let Some((above, last)) = path.rsplit_once('/') {
        if !(is_chunk(last) || last == "c") {
            break;
        }
        path = above;
    }
    (!is_chunk(path) && !path.split('/').any(|part| part == "..")).then_some(path)
}

/// The arrays that the chunks in an archive, below one of its folders, are of.
fn chunks_of(archive: &ZipArchive<Cursor<&[u8]>>, home: &str) -> BTreeSet<String> {
    let names = archive.file_names().filter_map(Result::ok);
    let of = |name: &str| array_of_chunk(name.strip_prefix(home)?).map(str::to_owned);
    names.filter_map(|name| of(&name)).collect()
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

/// The paths of what may have metadata in a folder, and those of chunks without. What is in an array is not looked at.
fn in_folder(folder: &Path, contained: &mut Contained) -> (Vec<String>, BTreeSet<String>) {
    let (mut found, mut chunks, mut seen) = (Vec::new(), BTreeSet::new(), HashSet::new());
    let mut open = vec![(String::new(), 0)];
    while let Some((path, depth)) = open.pop() {
        let own = folder.join(&path);
        // A link may lead to a folder above.
        let is_inside = path.is_empty() || contained.holds(&own);
        let Some(place) = fs::canonicalize(&own).ok().filter(|_| is_inside) else {
            continue;
        };
        if !seen.insert(place) {
            continue;
        }
        let is_array = own.join(".zarray").is_file() || own.join("c").exists();
        found.push(path.clone());
        if is_array || depth == DEEP || found.len() > MOST_COLUMNS {
            continue;
        }
        for entry in fs::read_dir(&own).into_iter().flatten().filter_map(Result::ok) {
            let below = joined(&path, &entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                open.push((below, depth + 1));
            } else if let Some(array) = array_of_chunk(&below) {
                chunks.insert(array.to_owned());
            }
        }
    }
    (found, chunks)
}
