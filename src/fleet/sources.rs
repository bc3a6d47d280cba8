use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use walkdir::{DirEntry, WalkDir};

use super::content::LogContent;
use crate::log::{self, RemoteObject, SourceName};
use crate::report::Trouble;

/// Location of one log.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LogSource {
    /// Absolute path of a file or rosbag2 folder, or URL of an object.
    pub path: PathBuf,
    /// Content, if known from a listing.
    pub content: Option<LogContent>,
}

impl LogSource {
    fn from_path(path: PathBuf) -> Self {
        Self { path, content: None }
    }
}

impl From<&RemoteObject> for LogSource {
    fn from(object: &RemoteObject) -> Self {
        Self { path: PathBuf::from(&object.url), content: Some(object.into()) }
    }
}

/// Files with these names count as logs even if their bytes do not identify them, so empty or truncated
/// logs are reported.
const LOG_SUFFIXES: &[&str] = &[
    ".mcap", ".bag", ".bag.active", ".db3", ".mcap.zst", ".mcap.zstd", ".bag.zst", ".db3.zst",
    ".db3.zstd",
];

/// Metadata file of a rosbag2 folder.
const METADATA_FILE: &str = "metadata.yaml";

/// Logs given by `wanted`, each once, sorted by path. Entries are files, folders (searched recursively),
/// patterns such as `runs/*/*.mcap`, URLs, or URL prefixes and patterns such as `s3://bucket/cell7`. For
/// `-`, paths or URLs are read from `list`, one per line or separated by zero bytes.
///
/// An explicitly named file is always a log; if unreadable, its row contains the error. In folders, logs
/// are identified by their first bytes or extension, and hidden files are skipped. Below a URL prefix, only
/// the extension counts.
///
/// # Errors
/// If a named entry does not exist, a pattern is invalid, a store cannot be listed, or no log is found.
pub fn find_sources(wanted: &[String], mut list: impl Read) -> Result<Vec<LogSource>, Trouble> {
    let mut found = Vec::new();
    for named in wanted {
        let named = &log::normalize_url(Path::new(named)).to_string_lossy().into_owned();
        let before = found.len();
        match named.as_str() {
            "-" => {
                let mut text = Vec::new();
                let read = list.read_to_end(&mut text);
                read.map_err(|error| {
                    source_trouble("-", format!("stdin cannot be read: {error}"))
                })?;
                for path in parse_list(&text) {
                    add_path(&path, &mut found);
                }
            }
            url if log::is_url(Path::new(url)) => add_url(url, &mut found)?,
            path if fs::symlink_metadata(path).is_ok() => add_path(Path::new(path), &mut found),
            pattern if pattern.contains(['*', '?', '[']) => {
                let paths = glob::glob(pattern).map_err(|error| {
                    source_trouble(pattern, format!("invalid pattern: {error}"))
                })?;
                // Unreadable folders.
                paths.filter_map(Result::ok).for_each(|path| add_path(&path, &mut found));
            }
            path => return Err(source_trouble(path, "no such file or folder".to_owned())),
        }
        if found.len() == before {
            return Err(source_trouble(named, "contains no log".to_owned()));
        }
    }
    found.sort();
    // The entry without content precedes its duplicate.
    found.dedup_by(|next, kept| {
        let is_same = next.path == kept.path;
        if is_same {
            kept.content = kept.content.take().or(next.content.take());
        }
        is_same
    });
    Ok(found)
}

fn parse_list(text: &[u8]) -> Vec<PathBuf> {
    let separator = if text.contains(&0) { 0 } else { b'\n' };
    let lines = text.split(|&byte| byte == separator);
    let lines = lines.map(|line| line.strip_suffix(b"\r").unwrap_or(line));
    lines.filter(|line| !line.is_empty()).map(path_of).collect()
}

#[cfg(unix)]
pub(super) fn path_of(bytes: &[u8]) -> PathBuf {
    use std::os::unix::ffi::OsStrExt;
    PathBuf::from(std::ffi::OsStr::from_bytes(bytes))
}

#[cfg(not(unix))]
pub(super) fn path_of(bytes: &[u8]) -> PathBuf {
    PathBuf::from(String::from_utf8_lossy(bytes).into_owned())
}

/// Objects at, below or matching `url`.
fn add_url(url: &str, found: &mut Vec<LogSource>) -> Result<(), Trouble> {
    let is_web = url.starts_with("http");
    let stars = url.find('*').filter(|_| !is_web);
    let Some(stars) = stars else {
        let below = log::list(Path::new(url))?;
        let is_asked = |object: &&RemoteObject| object.url == url || has_log_suffix(&object.url);
        found.extend(below.iter().filter(is_asked).map(LogSource::from));
        return Ok(());
    };
    let pattern = glob::Pattern::new(url);
    let pattern =
        pattern.map_err(|error| source_trouble(url, format!("invalid pattern: {error}")))?;
    let prefix = &url[..url[..stars].rfind('/').map_or(stars, |slash| slash + 1)];
    let options = glob::MatchOptions { require_literal_separator: true, ..Default::default() };
    let below = log::list(Path::new(prefix))?;
    let is_asked = |object: &&RemoteObject| pattern.matches_with(&object.url, options);
    found.extend(below.iter().filter(is_asked).map(LogSource::from));
    Ok(())
}

fn add_path(path: &Path, found: &mut Vec<LogSource>) {
    if log::is_url(path) {
        found.push(LogSource::from_path(log::normalize_url(path)));
        return;
    }
    if !path.is_dir() || is_recording(path) {
        found.extend(episodes_of(path));
        return;
    }
    let is_shown = |entry: &DirEntry| {
        entry.depth() == 0 || !entry.file_name().as_encoded_bytes().starts_with(b".")
    };
    let mut entries = WalkDir::new(path)
        .follow_links(true)
        .sort_by_file_name()
        .into_iter()
        .filter_entry(is_shown);
    // Skips unreadable folders and cyclic links.
    while let Some(entry) = entries.next() {
        let Ok(entry) = entry else { continue };
        let is_folder = entry.file_type().is_dir();
        if is_folder && is_recording(entry.path()) {
            entries.skip_current_dir();
            found.extend(episodes_of(entry.path()));
        } else if !is_folder && is_log(entry.path()) && !is_metadata(entry.path()) {
            found.extend(episodes_of(entry.path()));
        }
    }
}

/// Episodes of a table file, or the file itself.
fn episodes_of(path: &Path) -> Vec<LogSource> {
    let path = absolute(path);
    let names = log::episodes(&path);
    let episode = |name: &String| LogSource::from_path(format!("{}#{name}", path.display()).into());
    match names.is_empty() {
        true => vec![LogSource::from_path(path)],
        false => names.iter().map(episode).collect(),
    }
}

/// Dataset metadata, which LeRobot also stores as tables.
fn is_metadata(path: &Path) -> bool {
    let is_meta = |folder: &Path| folder.ends_with("meta") && folder.join("info.json").is_file();
    path.ancestors().skip(1).take(3).any(is_meta)
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// A rosbag2 recording or a table store.
fn is_recording(folder: &Path) -> bool {
    if log::is_store(folder) {
        return true;
    }
    let is_part = |entry: io::Result<fs::DirEntry>| {
        let name = entry.map(|entry| entry.file_name().to_string_lossy().into_owned());
        name.is_ok_and(|name| name.contains(".db3") || name.contains(".mcap"))
    };
    folder.join(METADATA_FILE).is_file()
        && fs::read_dir(folder).is_ok_and(|mut entries| entries.any(is_part))
}

fn is_log(path: &Path) -> bool {
    if path.file_name().is_some_and(|name| has_log_suffix(&name.to_string_lossy())) {
        return true;
    }
    let is_file = fs::metadata(path).is_ok_and(|metadata| metadata.is_file());
    let mut head = Vec::new();
    let read = |head: &mut Vec<u8>| File::open(path)?.take(log::HEAD_BYTES).read_to_end(head);
    // Other Parquet files may be unrelated, such as fleet results.
    let is_anybodys =
        |head: &[u8]| head.starts_with(b"PAR1") && log::enclosing_dataset(path).is_none();
    is_file && read(&mut head).is_ok() && log::looks_like_log(&head) && !is_anybodys(&head)
}

fn has_log_suffix(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    LOG_SUFFIXES.iter().any(|ending| name.ends_with(ending))
}

fn source_trouble(place: &str, what: String) -> Trouble {
    let remedy = "name logs, folders of logs, a pattern in quotes, or - for a list on stdin";
    Trouble::call(SourceName::from_path(Path::new(place)), what, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::TroubleKind;

    fn names(found: &[LogSource], folder: &Path) -> Vec<String> {
        let inside = |source: &LogSource| source.path.strip_prefix(folder).map(Path::to_owned);
        found.iter().filter_map(|it| Some(inside(it).ok()?.display().to_string())).collect()
    }

    #[test]
    fn a_folder_yields_its_logs_and_nothing_else() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("a/bag"))?;
        fs::create_dir_all(at("a/.hidden"))?;
        fs::write(at("a/empty.mcap"), "")?;
        fs::write(at("a/nameless"), b"\x89MCAP0\r\n")?;
        fs::write(at("a/notes.txt"), "to do")?;
        fs::write(at("a/other.csv"), "x,y\n1,2\n")?;
        fs::write(at("a/robot.csv"), "timestamp actual_q_0 actual_q_1\n0.0 1.0 2.0\n")?;
        fs::write(at("a/.hidden/x.mcap"), "")?;
        fs::write(at("a/bag/metadata.yaml"), "")?;
        fs::write(at("a/bag/bag_0.db3"), "")?;
        let named = folder.path().join("a").display().to_string();
        let found = find_sources(&[named], io::empty()).expect("logs");
        let expected = ["a/bag", "a/empty.mcap", "a/nameless", "a/robot.csv"];
        assert_eq!(names(&found, folder.path()), expected);
        Ok(())
    }

    #[test]
    fn a_folder_of_parquet_yields_only_the_data_of_a_dataset() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let at = |name: &str| folder.path().join(name);
        for (folder, file) in [
            ("set/data/chunk-000", "episode_000000.parquet"),
            ("set/meta/episodes/chunk-000", "file-000.parquet"),
            ("results", "rows.parquet"),
        ] {
            fs::create_dir_all(at(folder))?;
            fs::write(at(folder).join(file), b"PAR1")?;
        }
        fs::write(at("set/meta/info.json"), "{}")?;
        let found =
            find_sources(&[folder.path().display().to_string()], io::empty()).expect("logs");
        assert_eq!(names(&found, folder.path()), ["set/data/chunk-000/episode_000000.parquet"]);
        Ok(())
    }

    #[test]
    fn lists_and_patterns_yield_each_log_once() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let at = |name: &str| folder.path().join(name).display().to_string();
        for name in ["1.mcap", "2.mcap", "3.bag"] {
            fs::write(at(name), "")?;
        }
        let list = format!("{}\r\n\n{}\n", at("1.mcap"), at("gone.mcap"));
        let wanted = [at("*.mcap"), "-".to_owned()];
        let found = find_sources(&wanted, list.as_bytes()).expect("logs");
        assert_eq!(names(&found, folder.path()), ["1.mcap", "2.mcap", "gone.mcap"]);
        let zeros = format!("{}\0{}\0", at("3.bag"), at("1.mcap"));
        assert_eq!(find_sources(&["-".to_owned()], zeros.as_bytes()).expect("logs").len(), 2);
        Ok(())
    }

    #[test]
    fn sources_without_logs_are_rejected() {
        let empty = tempfile::tempdir().expect("a folder");
        let empty = empty.path().display().to_string();
        for wanted in ["no/such", "no/such/*.mcap", "-", empty.as_str()] {
            let refused = find_sources(&[wanted.to_owned()], io::empty()).expect_err(wanted);
            assert_eq!((refused.kind, refused.place.as_str()), (TroubleKind::Call, wanted));
        }
    }
}
