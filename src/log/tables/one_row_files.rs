//! Files with one row each, such as `pose_00/data.json` and `pose_01/data.json`: the configurations of a calibration.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use bytes::Bytes;

use super::records::{self, MATRIX_ROWS};
use super::{TableFormat, is_text};
use crate::containment::Containment;
use crate::file_format::{FileFormat, detect_format};
use crate::files::LogInput;
use crate::intake::Intake;

/// Fewer files may be separate runs.
const MIN_FILES: usize = 3;
/// Maximum size of all files together; images and runs are larger.
const MAX_BYTES: u64 = 1 << 26;

/// Replaces files with one row each by one table.
pub(crate) fn join_inputs(inputs: Vec<LogInput>, intake: &mut Intake) -> Vec<LogInput> {
    let is_plain = |input: &LogInput| {
        input.address.is_none() && input.episode.is_none() && !input.in_bag && !input.path.is_dir()
    };
    if !inputs.iter().all(is_plain) {
        return inputs;
    }
    let Some(rows) = JoinedRows::of(&inputs) else { return inputs };
    let paths: Vec<&Path> = inputs.iter().map(|input| input.path.as_path()).collect();
    let is_common = |folder: &&Path| {
        !folder.as_os_str().is_empty()
            && folder.parent().is_some()
            && paths.iter().all(|path| path.starts_with(folder))
    };
    let common = paths[0].ancestors().skip(1).find(is_common).unwrap_or(paths[0]);
    vec![rows.into_input(common, intake)]
}

/// Rows of several files, in the natural order of their names.
pub(crate) struct JoinedRows {
    pub content: Vec<u8>,
    count: usize,
    ends: [PathBuf; 2],
}

impl JoinedRows {
    /// Joins files of a folder, or of its subfolders, whose names differ only in numbers. `None` unless exactly one such set
    /// exists.
    pub fn in_folder(folder: &Path) -> Option<Self> {
        let mut within = Containment::new(folder);
        let mut entries = |folder: &Path| -> Vec<PathBuf> {
            let entries = fs::read_dir(folder).into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).filter(|path| within.holds(path)).collect()
        };
        let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) =
            entries(folder).into_iter().partition(|path| path.is_dir());
        let nested = folders.iter().flat_map(|folder| entries(folder));
        let regular = |paths: Vec<PathBuf>| paths.into_iter().filter(|path| path.is_file());
        [regular(files), regular(nested.collect())].into_iter().find_map(|files| {
            let mut sets: BTreeMap<String, Vec<LogInput>> = BTreeMap::new();
            for path in files {
                let name = path.strip_prefix(folder).unwrap_or(&path).to_string_lossy();
                let stem = name.replace(|c: char| c.is_ascii_digit(), "");
                sets.entry(stem).or_default().push(LogInput::local(path));
            }
            let mut joined = sets.values().filter_map(|inputs| Self::of(inputs));
            joined.next().filter(|_| joined.next().is_none())
        })
    }

    /// `None` unless each file has one row, with mostly the same names.
    fn of(inputs: &[LogInput]) -> Option<Self> {
        let bytes: u64 = inputs.iter().map(LogInput::bytes).sum();
        if inputs.len() < MIN_FILES || bytes > MAX_BYTES {
            return None;
        }
        let mut inputs: Vec<&LogInput> = inputs.iter().collect();
        inputs.sort_by_cached_key(|input| (natural_key(&input.path), input.path.clone()));
        let mut rows: Vec<FileRow> = Vec::new();
        for input in &inputs {
            let row = FileRow::parse(input.open().ok()?.bytes())?;
            if rows.first().is_some_and(|first| !first.is_like(&row)) {
                return None;
            }
            rows.push(row);
        }
        let names = || rows.iter().map(|row| &row.names);
        let union: BTreeSet<&String> = names().flatten().collect();
        let common = union.iter().filter(|name| names().all(|own| own.contains(**name))).count();
        let ends = [inputs.first()?, inputs.last()?].map(|input| input.path.clone());
        (2 * common >= union.len()).then(|| Self {
            count: rows.len(),
            content: FileRow::join(&rows),
            ends,
        })
    }

    /// As the table at `path`, with a note.
    pub fn into_input(self, path: &Path, intake: &mut Intake) -> LogInput {
        let name = |file: &Path| {
            // The first file, if the files have no folder.
            let name = file.strip_prefix(path).ok().filter(|name| !name.as_os_str().is_empty());
            name.unwrap_or(file).display().to_string()
        };
        let [first, last] = self.ends.each_ref().map(|file| name(file));
        let count = self.count;
        intake.note(
            path,
            format!("{count} files with one row each, {first} to {last}, read as one table in the order of their names"),
        );
        LogInput { given: Some(Bytes::from(self.content)), ..LogInput::local(path.to_owned()) }
    }
}

/// The content of a file with one row.
struct FileRow {
    kind: RowKind,
    /// Of the numbers; empty in text without names.
    names: BTreeSet<String>,
    content: Vec<u8>,
}

#[derive(PartialEq)]
enum RowKind {
    Json,
    Yaml,
    /// Number of lines, and of numbers in each, below an optional line of names.
    Text {
        header: Option<String>,
        lines: usize,
        width: usize,
    },
}

impl FileRow {
    fn parse(bytes: &[u8]) -> Option<Self> {
        let of_record =
            |kind: RowKind, names: BTreeSet<String>| Self { kind, names, content: bytes.to_vec() };
        match detect_format(bytes) {
            FileFormat::Table(TableFormat::Json) => {
                Some(of_record(RowKind::Json, records::names_in_json_record(bytes)?))
            }
            FileFormat::Table(TableFormat::Yaml) => {
                Some(of_record(RowKind::Yaml, records::names_in_yaml_record(bytes)?))
            }
            _ if is_text(bytes) => Self::parse_text(std::str::from_utf8(bytes).ok()?),
            _ => None,
        }
    }

    /// A line of numbers, also below one of names, or the lines of a homogeneous matrix.
    fn parse_text(text: &str) -> Option<Self> {
        const BOTTOM: [f64; MATRIX_ROWS] = [0.0, 0.0, 0.0, 1.0];
        let numbers = |line: &str| -> Option<Vec<f64>> {
            let cells = line.split(|c: char| matches!(c, ',' | ';') || c.is_whitespace());
            cells.filter(|cell| !cell.is_empty()).map(|cell| cell.parse().ok()).collect()
        };
        let lines = text.lines().map(str::trim);
        let lines = lines.filter(|line| !line.is_empty() && !line.starts_with('#'));
        let lines: Vec<&str> = lines.take(MATRIX_ROWS + 1).collect();
        let rows: Vec<Option<Vec<f64>>> = lines.iter().map(|line| numbers(line)).collect();
        let (header, first, width) = match rows.as_slice() {
            [Some(only)] => (None, 0, only.len()),
            [None, Some(only)] => (Some(lines[0].to_owned()), 1, only.len()),
            [Some(a), Some(b), Some(c), Some(bottom)]
                if *bottom == BOTTOM && [a, b, c].iter().all(|row| row.len() == MATRIX_ROWS) =>
            {
                (None, 0, MATRIX_ROWS)
            }
            _ => return None,
        };
        let content = lines[first..].join("\n").into_bytes();
        let kind = RowKind::Text { header, lines: lines.len() - first, width };
        (width > 1).then_some(Self { kind, names: BTreeSet::new(), content })
    }

    fn is_like(&self, other: &Self) -> bool {
        self.kind == other.kind
    }

    fn join(rows: &[Self]) -> Vec<u8> {
        let contents: Vec<&[u8]> = rows.iter().map(|row| row.content.as_slice()).collect();
        match rows.first().map(|first| &first.kind) {
            Some(RowKind::Json) => [b"[".as_slice(), &contents.join(&b","[..]), b"]"].concat(),
            Some(RowKind::Yaml) => contents.join(&b"\n---\n"[..]),
            Some(RowKind::Text { header: Some(header), .. }) => {
                [header.as_bytes(), b"\n", &contents.join(&b"\n"[..]), b"\n"].concat()
            }
            _ => [contents.join(&b"\n"[..]), b"\n".to_vec()].concat(),
        }
    }
}

/// Orders `pose_2` before `pose_10`.
fn natural_key(path: &Path) -> String {
    const DIGITS: usize = 20;
    let path = path.to_string_lossy();
    let mut key = String::new();
    let mut rest = path.as_ref();
    while let Some(at) = rest.find(|c: char| c.is_ascii_digit()) {
        let (text, numbered) = rest.split_at(at);
        let end = numbered.find(|c: char| !c.is_ascii_digit()).unwrap_or(numbered.len());
        let (number, after) = numbered.split_at(end);
        key += &format!("{text}{number:0>DIGITS$}");
        rest = after;
    }
    key + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_natural_order() {
        let mut names = ["b_10.txt", "b_9.txt", "a_100/x2", "a_20/x10", "a_20/x9"];
        names.sort_by_key(|name| natural_key(Path::new(name)));
        assert_eq!(names, ["a_20/x9", "a_20/x10", "a_100/x2", "b_9.txt", "b_10.txt"]);
    }

    #[test]
    fn files_of_one_row_are_one_table() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
            fs::write(path, text).expect("a file");
        };
        let joined = || {
            let rows = JoinedRows::in_folder(folder.path())?;
            String::from_utf8(rows.content).ok()
        };
        for number in [10, 9, 8] {
            write(&format!("pose_{number}/data.json"), &format!("{{\"q\": [{number}, 1]}}"));
        }
        write("notes.txt", "8 poses");
        let expected = "[{\"q\": [8, 1]},{\"q\": [9, 1]},{\"q\": [10, 1]}]";
        assert_eq!(joined().as_deref(), Some(expected));
        // Files in the folder itself come first.
        for number in [2, 1, 3] {
            let matrix = format!("0 -1 0 {number}\n1 0 0 0\n0 0 1 0\n0.0 0.0 0.0 1.0\n");
            write(&format!("pose_{number}.txt"), &matrix);
        }
        let matrices = joined().expect("matrices");
        assert_eq!(matrices.lines().count(), 12);
        assert!(matrices.starts_with("0 -1 0 1\n"), "{matrices}");
        write("pose_3.txt", "1 2 3\n4 5 6\n");
        assert_eq!(joined().as_deref(), Some(expected));
        for row in ["x,y\n1,2\n", "x,y\n3,4\n", "x,y\n5,6\n"] {
            write(&format!("row{}.csv", &row[4..5]), row);
        }
        assert_eq!(joined().as_deref(), Some("x,y\n1,2\n3,4\n5,6\n"));
        for number in 1..=3 {
            write(&format!("other{number}.csv"), "a,b\n1,2\n");
        }
        assert_eq!(joined().as_deref(), Some(expected));
    }
}
