//! rosbag2 recordings: folders of SQLite databases or MCAP files with a `metadata.yaml`, and single
//! databases.
//!
//! Only the list of files and their message counts are used from `metadata.yaml`.

#[cfg(not(target_arch = "wasm32"))]
mod batch;
#[cfg(not(target_arch = "wasm32"))]
mod database;
#[cfg(test)]
mod tests;
#[cfg(not(target_arch = "wasm32"))]
mod wal;

use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::decode::excerpt;
use super::file_format::{self, FileFormat};
use super::files::LogInput;
use super::intake::Intake;
use super::losses::Losses;
use super::mapped::MappedFile;
use super::tables::{self, TableFormat};
use super::{Extent, LogError, looks_like_log, read_head};

#[cfg(not(target_arch = "wasm32"))]
pub(super) use self::database::read as read_database;

/// Levels of folders that are searched for logs.
const MAX_FOLDER_DEPTH: usize = 4;
const METADATA: &str = "metadata.yaml";

/// Note on another file in the folder of a run.
const NOT_READ: &str = "was not read: neither its rows nor its name show what it holds";

const MAX_METADATA_BYTES: u64 = 16 << 20;

#[derive(Deserialize)]
struct Document {
    rosbag2_bagfile_information: Information,
}

#[derive(Deserialize)]
struct Information {
    #[serde(default)]
    relative_file_paths: Vec<String>,
    #[serde(default)]
    message_count: Option<u64>,
    /// Present from version 5.
    #[serde(default)]
    files: Vec<FileInformation>,
}

#[derive(Deserialize)]
struct FileInformation {
    path: String,
    #[serde(default)]
    message_count: Option<u64>,
}

/// SQLite's companion file with this suffix.
pub(super) fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}

/// Files of the recording in `folder`. Missing files are recorded as losses.
///
/// # Errors
/// If the folder contains no recording or more than one.
pub(super) fn files_of(folder: &Path, intake: &mut Intake) -> Result<Vec<LogInput>, LogError> {
    let path = folder.join(METADATA);
    if !path.is_file() {
        let inputs = logs_in(folder)?;
        for path in unread_tables(folder, &inputs) {
            intake.note(&path, NOT_READ.to_owned());
        }
        if inputs.iter().any(|input| is_bag_file(&input.path)) {
            let count = inputs.len();
            intake.note(
                folder,
                format!("no {METADATA}: the {count} log files in the folder are read"),
            );
        }
        return Ok(inputs);
    }
    let mut losses = Losses::new(&path);
    let inputs = match information(&path) {
        Ok(information) => {
            let mut inputs = listed(folder, &information, &mut losses);
            let further = further_splits(folder, &inputs);
            for path in &further {
                let what = format!("does not list {}, which was read as well", path.display());
                losses.add_unplaced(Extent::Index, Some(0), what);
            }
            inputs.extend(further.into_iter().map(LogInput::bag_file));
            inputs
        }
        Err(cause) => {
            let what =
                format!("cannot be read: {cause}; the log files in its folder are read instead");
            losses.add_unplaced(Extent::Index, Some(0), what);
            logs_in(folder)?
        }
    };
    intake.losses(losses);
    for path in unlisted(folder, &inputs) {
        intake.note(&path, format!("not listed in {METADATA}, so it was not read"));
    }
    if inputs.is_empty() {
        let cause = "that contains none of the files listed in metadata.yaml";
        return Err(LogError::Directory { path: folder.to_owned(), cause });
    }
    Ok(inputs)
}

/// Reads `metadata.yaml`; errors are one line.
fn information(path: &Path) -> Result<Information, String> {
    let bytes = fs::metadata(path).map_err(|error| error.to_string())?.len();
    if bytes > MAX_METADATA_BYTES {
        return Err(format!("has {bytes} bytes; the limit is {MAX_METADATA_BYTES}"));
    }
    let text = fs::read_to_string(path).map_err(|error| error.to_string())?;
    let document: Document = serde_saphyr::from_str(&text)
        .map_err(|error| excerpt(error.to_string().lines().next().unwrap_or_default()))?;
    Ok(document.rosbag2_bagfile_information)
}

fn listed(folder: &Path, information: &Information, losses: &mut Losses) -> Vec<LogInput> {
    let by_file = information.files.iter().map(|file| file.path.as_str());
    let by_path = information.relative_file_paths.iter().map(String::as_str);
    let mut names: Vec<&OsStr> = Vec::new();
    // Old versions list paths relative to the folder's parent.
    for name in by_path.chain(by_file).filter_map(|path| Path::new(path).file_name()) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let recorded = |name: &OsStr| {
        let is_it = |file: &&FileInformation| Path::new(&file.path).file_name() == Some(name);
        let count = information.files.iter().find(is_it).and_then(|file| file.message_count);
        count.or(information.message_count.filter(|_| names.len() == 1))
    };
    let mut inputs = Vec::new();
    for name in &names {
        let path = folder.join(name);
        let unpacked = path.with_extension("");
        let is_packed = path.extension() == Some(OsStr::new("zstd"));
        if path.is_file() {
            inputs.push(LogInput { recorded: recorded(name), ..LogInput::bag_file(path) });
        } else if is_packed && unpacked.is_file() {
            // The last file was not compressed, or was decompressed later.
            inputs.push(LogInput { recorded: recorded(name), ..LogInput::bag_file(unpacked) });
        } else {
            let what =
                format!("lists `{}`, which does not exist", excerpt(&name.to_string_lossy()));
            losses.add_unplaced(Extent::Messages, recorded(name), what);
        }
    }
    inputs
}

/// Log files of a folder without a list, if they look like parts of one recording.
fn logs_in(folder: &Path) -> Result<Vec<LogInput>, LogError> {
    let refuse = |cause| LogError::Directory { path: folder.to_owned(), cause };
    let paths = files_in(folder).map_err(|source| LogError::io(folder, source))?;
    let tables: Vec<PathBuf> = paths.iter().filter(|path| is_text_table(path)).cloned().collect();
    let paths: Vec<PathBuf> = paths.into_iter().filter(|path| is_log(path)).collect();
    let runs = || LogError::Runs { path: folder.to_owned() };
    if paths.iter().all(|path| tables.contains(path)) && have_different_columns(&tables) {
        let bare = files_in(folder).map_err(|source| LogError::io(folder, source))?;
        let bare: Vec<PathBuf> = bare.into_iter().filter(|path| is_bare_table(path)).collect();
        match tables::are_one_run(&bare.iter().map(PathBuf::as_path).collect::<Vec<_>>()) {
            Some(true) => {
                let all: BTreeSet<PathBuf> = tables.into_iter().chain(bare).collect();
                return Ok(all.into_iter().map(LogInput::bag_file).collect());
            }
            Some(false) if tables.is_empty() => return Err(runs()),
            _ => {}
        }
    }
    let is_of_tables = paths.iter().all(|path| tables.contains(path));
    if tables.len() > 1 && is_of_tables && recording_names(&tables).len() > 1 {
        return match have_different_columns(&tables) {
            true => Ok(tables.into_iter().map(LogInput::bag_file).collect()),
            false => Err(runs()),
        };
    }
    let Some(first) = paths.first() else {
        let files = files_in(folder).unwrap_or_default();
        return match files.into_iter().filter(|path| is_bare_table(path)).collect::<Vec<_>>() {
            only if only.len() == 1 => Ok(only.into_iter().map(LogInput::bag_file).collect()),
            _ if let Some(only) = only_table(folder) => Ok(vec![LogInput::bag_file(only)]),
            _ if contains_logs(folder, MAX_FOLDER_DEPTH) => Err(runs()),
            none if none.is_empty() => Err(refuse("without log files")),
            _ => Err(refuse("of tables without times, whose names show no joints or poses")),
        };
    };
    if paths.iter().any(|path| recording_name(path) != recording_name(first)) {
        return Err(runs());
    }
    Ok(paths.into_iter().map(LogInput::bag_file).collect())
}

fn recording_names(paths: &[PathBuf]) -> BTreeSet<&str> {
    paths.iter().map(|path| recording_name(path)).collect()
}

/// Text tables of one run have one signal each; runs have the same columns.
fn have_different_columns(paths: &[PathBuf]) -> bool {
    let columns: Vec<Vec<String>> = paths.iter().filter_map(|path| columns_of(path)).collect();
    let distinct: BTreeSet<&Vec<String>> = columns.iter().collect();
    distinct.len() == paths.len()
}

fn is_text_table(path: &Path) -> bool {
    columns_of(path).is_some()
}

/// A table whose columns have no names or no times, or the times of one.
fn is_bare_table(path: &Path) -> bool {
    let Some(FileFormat::Table(format)) = format_of(path) else { return false };
    matches!(format, TableFormat::Csv | TableFormat::Npy | TableFormat::Times)
        && !is_text_table(path)
}

/// The only log in the folder, if it is a table. A dataset's folder also holds metadata.
fn only_table(folder: &Path) -> Option<PathBuf> {
    let is_table = |path: &PathBuf| matches!(format_of(path), Some(FileFormat::Table(_)));
    let entries = fs::read_dir(folder).ok()?.flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    let only = paths.pop().filter(|path| path.is_file() && is_table(path));
    only.filter(|_| paths.is_empty())
}

/// Other files in the folder with the extension of the tables.
fn unread_tables(folder: &Path, inputs: &[LogInput]) -> Vec<PathBuf> {
    if !inputs.iter().all(|input| is_bare_table(&input.path) || is_text_table(&input.path)) {
        return Vec::new();
    }
    let extensions: BTreeSet<&OsStr> =
        inputs.iter().filter_map(|input| input.path.extension()).collect();
    let mut paths = files_in(folder).unwrap_or_default();
    paths.retain(|path| {
        let is_read = inputs.iter().any(|input| input.path == *path);
        !is_read && path.extension().is_some_and(|own| extensions.contains(own))
    });
    paths
}

/// Names of the columns of a text table. `None` if none is a time.
fn columns_of(path: &Path) -> Option<Vec<String>> {
    let mapped = MappedFile::open(path).ok()?;
    match file_format::detect_format(mapped.bytes()) {
        FileFormat::Rtde | FileFormat::Table(TableFormat::Csv) => {
            tables::column_names(mapped.bytes())
        }
        _ => None,
    }
}

/// Log files not in `inputs` that differ from one of them only in the split number: the list may be
/// truncated.
fn further_splits(folder: &Path, inputs: &[LogInput]) -> Vec<PathBuf> {
    let family = |path: &Path| {
        let name = path.file_name().and_then(OsStr::to_str)?;
        let (run, split) = name.rsplit_once('_')?;
        let digits = split.bytes().take_while(u8::is_ascii_digit).count();
        (digits > 0).then(|| (run.to_owned(), split[digits..].to_owned()))
    };
    let families: Vec<_> = inputs.iter().filter_map(|input| family(&input.path)).collect();
    let mut paths = unlisted(folder, inputs);
    paths.retain(|path| family(path).is_some_and(|family| families.contains(&family)));
    paths.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
    paths
}

fn unlisted(folder: &Path, inputs: &[LogInput]) -> Vec<PathBuf> {
    let mut paths = files_in(folder).unwrap_or_default();
    paths.retain(|path| !inputs.iter().any(|input| input.path == *path) && is_log(path));
    paths
}

/// Regular files, sorted by name.
fn files_in(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// Whether the folder or one of its subfolders, down to `depth`, contains a file that looks like a log.
fn contains_logs(folder: &Path, depth: usize) -> bool {
    let is_log = |path: PathBuf| read_head(&path).is_some_and(|head| looks_like_log(&head));
    if files_in(folder).unwrap_or_default().into_iter().any(is_log) {
        return true;
    }
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut folders = entries.map(|entry| entry.path()).filter(|path| path.is_dir());
    depth > 0 && folders.any(|folder| contains_logs(&folder, depth - 1))
}

/// `None` if the file cannot be opened.
fn format_of(path: &Path) -> Option<FileFormat> {
    MappedFile::open(path).ok().map(|mapped| file_format::detect_format(mapped.bytes()))
}

fn is_log(path: &Path) -> bool {
    use FileFormat::{Mcap, RosBag1, Rtde, Sqlite, Zstd};
    matches!(format_of(path), Some(Mcap | RosBag1 | Sqlite | Zstd | Rtde))
}

/// Whether rosbag2 writes such files.
fn is_bag_file(path: &Path) -> bool {
    matches!(format_of(path), Some(FileFormat::Mcap | FileFormat::Sqlite | FileFormat::Zstd))
}

/// Common name of a recording's files, without extensions and split number.
fn recording_name(path: &Path) -> &str {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    let name = name.strip_suffix(".zstd").unwrap_or(name);
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    match stem.rsplit_once('_') {
        Some((run, split)) if split.bytes().all(|byte| byte.is_ascii_digit()) => run,
        _ => stem,
    }
}
