//! Metadata and chunks of a store in a folder or zip archive.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use serde_json::Value;
use zip::ZipArchive;
use zip::result::ZipError;

use crate::containment::{Containment, LINK_LEADS_OUTSIDE};
use crate::tables::{MAX_COLUMNS, MAX_DEPTH, MAX_METADATA_BYTES, TableError};

/// Metadata files of arrays and groups in Zarr 2 and 3.
const METADATA_FILES: [&str; 3] = [".zarray", ".zgroup", "zarr.json"];
const ATTRIBUTES_FILE: &str = ".zattrs";
/// Headers and incompressible blocks.
const MAX_PACKING_BYTES: u64 = 1 << 16;

pub(super) enum ZarrStore<'a> {
    Folder(PathBuf, Containment),
    /// The archive, and the store's folder in it.
    Zip(ZipArchive<Cursor<&'a [u8]>>, String),
}

/// Whether a folder is a Zarr store.
pub fn is_store(folder: &Path) -> bool {
    let is_metadata = |name: &&str| {
        let metadata = ZarrStore::folder(folder).json(name);
        metadata.is_ok_and(|it| it.is_some_and(|it| is_metadata(&it)))
    };
    METADATA_FILES.iter().any(|name| folder.join(name).is_file())
        && METADATA_FILES.iter().any(is_metadata)
}

/// Looks for the metadata names near the start and the end.
pub(crate) fn is_zip_store(bytes: &[u8]) -> bool {
    /// Bytes searched at each end.
    const SEARCHED_BYTES: usize = 1 << 16;
    let (head, tail) = (
        &bytes[..bytes.len().min(SEARCHED_BYTES)],
        &bytes[bytes.len().saturating_sub(SEARCHED_BYTES)..],
    );
    let names = |part: &[u8]| {
        METADATA_FILES.iter().any(|name| memchr::memmem::find(part, name.as_bytes()).is_some())
    };
    names(head) || names(tail)
}

fn is_metadata(value: &Value) -> bool {
    matches!(value.get("zarr_format").and_then(Value::as_u64), Some(2 | 3))
}

impl<'a> ZarrStore<'a> {
    pub fn zip(bytes: &'a [u8]) -> Result<Self, TableError> {
        let archive = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| format!("the zip archive cannot be read: {error}"))?;
        let home = folders_with_metadata(&archive, "").into_iter().min_by_key(String::len);
        let home = home.ok_or("the zip archive holds no Zarr store")?;
        // Without metadata at the top, the store is the folder above its parts.
        let is_part = |home: &str| home == "data" || home == "meta";
        let home = match home.rsplit_once('/') {
            Some((above, part)) if is_part(part) => format!("{above}/"),
            None if home.is_empty() || is_part(&home) => String::new(),
            _ => format!("{home}/"),
        };
        Ok(Self::Zip(archive, home))
    }

    pub fn folder(path: &Path) -> Self {
        Self::Folder(path.to_owned(), Containment::new(path))
    }

    /// Limited to `most` plus packing overhead; `None` if the key does not exist.
    pub fn get(&mut self, key: &str, most: u64) -> Result<Option<Vec<u8>>, TableError> {
        let most = most.saturating_add(most / 8).saturating_add(MAX_PACKING_BYTES);
        let mut bytes = Vec::new();
        let read = match self {
            Self::Folder(folder, contained) => {
                let path = folder.join(key);
                if !contained.holds(&path) {
                    return Err(format!("'{key}' {LINK_LEADS_OUTSIDE}").into());
                }
                // Opening a pipe would block.
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
            return Err(format!("'{key}' exceeds its limit of {most} bytes").into());
        }
        Ok(Some(bytes))
    }

    /// `None` if the key does not exist.
    pub fn json(&mut self, key: &str) -> Result<Option<Value>, TableError> {
        let Some(bytes) = self.get(key, MAX_METADATA_BYTES)? else { return Ok(None) };
        let read = serde_json::from_slice(&bytes);
        read.map(Some).map_err(|error| format!("'{key}' cannot be read: {error}").into())
    }

    /// Sorted by path. Chunks without metadata are listed as an unreadable array.
    pub fn arrays(&mut self) -> Vec<(String, Result<Value, TableError>)> {
        let (mut paths, chunks) = match self {
            Self::Folder(folder, contained) => scan_folder(folder, contained),
            Self::Zip(archive, home) => {
                (folders_with_metadata(archive, home), arrays_with_chunks(archive, home))
            }
        };
        paths.sort();
        paths.dedup();
        let mut are_too_many = paths.len() > MAX_COLUMNS;
        paths.truncate(MAX_COLUMNS);
        let is_array = |metadata: &Value| is_metadata(metadata) && metadata.get("shape").is_some();
        let mut found = BTreeMap::new();
        for path in paths {
            for name in METADATA_FILES {
                match self.json(&join_key(&path, name)) {
                    Ok(Some(metadata)) if is_array(&metadata) => {
                        found.insert(path.clone(), Ok(metadata));
                        break;
                    }
                    Ok(Some(_)) if name == METADATA_FILES[0] => {
                        let what =
                            format!("'{}' does not describe an array", join_key(&path, name));
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
            let what = format!("'{path}' has chunks but no metadata");
            found.insert(path, Err(what.into()));
        }
        are_too_many |= found.len() > MAX_COLUMNS;
        let what = format!("more than {MAX_COLUMNS} arrays; the others are not read");
        let others = are_too_many.then(|| (String::new(), Err(what.into())));
        found.into_iter().take(MAX_COLUMNS).chain(others).collect()
    }

    pub fn attributes(&mut self, path: &str) -> Option<Value> {
        let third = self.json(&join_key(path, "zarr.json")).ok().flatten();
        let third = third.and_then(|value| value.get("attributes").cloned());
        third.or_else(|| self.json(&join_key(path, ATTRIBUTES_FILE)).ok().flatten())
    }
}

/// Chunk names are numbers separated by dots, or nested folders of numbers.
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

fn arrays_with_chunks(archive: &ZipArchive<Cursor<&[u8]>>, home: &str) -> BTreeSet<String> {
    let names = archive.file_names().filter_map(Result::ok);
    let of = |name: &str| array_of_chunk(name.strip_prefix(home)?).map(str::to_owned);
    names.filter_map(|name| of(&name)).collect()
}

fn folders_with_metadata(archive: &ZipArchive<Cursor<&[u8]>>, home: &str) -> Vec<String> {
    let of = |name: &str| {
        let name = name.strip_prefix(home)?;
        let (folder, own) = name.rsplit_once('/').unwrap_or(("", name));
        METADATA_FILES.contains(&own).then(|| folder.to_owned())
    };
    archive.file_names().filter_map(Result::ok).filter_map(|name| of(&name)).collect()
}

fn join_key(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") }
}

/// Paths that may have metadata, and arrays with chunks. Does not search folders of arrays.
fn scan_folder(folder: &Path, contained: &mut Containment) -> (Vec<String>, BTreeSet<String>) {
    let (mut found, mut chunks, mut seen) = (Vec::new(), BTreeSet::new(), HashSet::new());
    let mut open = vec![(String::new(), 0)];
    while let Some((path, depth)) = open.pop() {
        let own = folder.join(&path);
        // A link may lead to a parent folder.
        let is_inside = path.is_empty() || contained.holds(&own);
        let Some(place) = fs::canonicalize(&own).ok().filter(|_| is_inside) else {
            continue;
        };
        if !seen.insert(place) {
            continue;
        }
        let is_array = own.join(".zarray").is_file() || own.join("c").exists();
        found.push(path.clone());
        if is_array || depth == MAX_DEPTH || found.len() > MAX_COLUMNS {
            continue;
        }
        for entry in fs::read_dir(&own).into_iter().flatten().filter_map(Result::ok) {
            let below = join_key(&path, &entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                open.push((below, depth + 1));
            } else if let Some(array) = array_of_chunk(&below) {
                chunks.insert(array.to_owned());
            }
        }
    }
    (found, chunks)
}
