//! Trajectories without column names: TUM (`timestamp tx ty tz qx qy qz qw`) and KITTI odometry (a 3 by 4
//! matrix per line, with the times in another file).
//!
//! TUM RGB-D benchmark, "File formats"; KITTI odometry benchmark, development kit.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::csv::{self, TextLayout};
use super::{
    Column, Episodes, ReadContext, RowLoss, Table, TableError, TableFormat, clock, npy,
    text_encoding,
};
use crate::files::LogInput;
use crate::{LogError, rtde};
use ground::geometry::{rotation_from_matrix_rows, xyzw_from_rotation};

pub(super) const TUM_COLUMNS: [&str; 8] =
    ["timestamp [s]", "tx", "ty", "tz", "qx", "qy", "qz", "qw"];
const W_FIRST: [&str; 4] = ["qw", "qx", "qy", "qz"];
const KITTI_WIDTH: usize = 12;
/// Rows that identify a format.
const CHECKED_ROWS: usize = 200;
/// Deviation of a quaternion from unit norm and of a matrix from a rotation, for numbers with two digits.
const MAX_DEFECT: f64 = 0.03;

/// Identifies a trajectory or its times by the first rows.
pub(crate) fn detect(bytes: &[u8]) -> Option<TableFormat> {
    let rows = first_rows(bytes)?;
    let is_unit = |row: &[f64]| {
        let norm = row[4..].iter().map(|value| value * value).sum::<f64>().sqrt();
        (norm - 1.0).abs() < MAX_DEFECT
    };
    match () {
        () if are_mostly(&rows, TUM_COLUMNS.len(), is_unit) => Some(TableFormat::Tum),
        () if are_mostly(&rows, KITTI_WIDTH, |row| xyzw_of(row).is_some()) => {
            Some(TableFormat::Kitti)
        }
        () => None,
    }
}

/// Whether each line is one number that does not fall, below a name or without.
pub(crate) fn is_list_of_times(bytes: &[u8]) -> bool {
    let rows: Vec<f64> = times_below_name(bytes)
        .take(CHECKED_ROWS)
        .map(|text| rtde::number(text, false).unwrap_or(f64::NAN))
        .collect();
    rows.len() >= 2 && rows.windows(2).all(|pair| pair[0] <= pair[1])
}

/// Text of each line below a name.
fn times_below_name(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let is_name = |(at, text): &(usize, &[u8])| *at == 0 && rtde::number(text, false).is_none();
    let lines = rows(bytes).map(|(_, text)| text).enumerate();
    lines.filter(move |line| !is_name(line)).map(|(_, text)| text)
}

/// Whether a file that is named `.tum` has its number of columns, with quaternions of any norm.
pub(crate) fn is_tum_by_name(path: &Path, bytes: &[u8]) -> bool {
    let is_named = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("tum"));
    let rows = || first_rows(bytes);
    is_named && rows().is_some_and(|rows| are_mostly(&rows, TUM_COLUMNS.len(), |_| true))
}

/// `None` if a row is text or too long.
fn first_rows(bytes: &[u8]) -> Option<Vec<Vec<f64>>> {
    const MAX_LINE_BYTES: usize = 1000;
    let parse = |(_, text): (usize, &[u8])| {
        let row: Vec<f64> = match text.len() {
            ..=MAX_LINE_BYTES => csv::cells(text, b' ').into_iter().map(number).collect(),
            _ => return None,
        };
        let known = row.iter().filter(|value| value.is_finite()).count();
        (2 * known >= row.len()).then_some(row)
    };
    rows(bytes).take(CHECKED_ROWS).map(parse).collect()
}

fn number(cell: &[u8]) -> f64 {
    rtde::number(cell, false).unwrap_or(f64::NAN)
}

/// Number from 1 and text of each line with data.
fn rows(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let lines = csv::lines(&bytes[csv::mark_length(bytes)..]);
    lines.filter(|(_, _, text)| csv::comment(text).is_none()).map(|(_, line, text)| (line, text))
}

/// Whether nearly all rows have `width` numbers, and most of these fit.
fn are_mostly(rows: &[Vec<f64>], width: usize, fits: impl Fn(&[f64]) -> bool) -> bool {
    const MIN_WIDTH_PERCENT: usize = 80;
    let own: Vec<&Vec<f64>> = rows.iter().filter(|row| row.len() == width).collect();
    let fitting = own.iter().filter(|row| fits(row)).count();
    own.len() >= 2 && 100 * own.len() >= MIN_WIDTH_PERCENT * rows.len() && 2 * fitting > own.len()
}

pub(super) fn read_tum(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let mut names = TUM_COLUMNS;
    if declares_w_first(bytes) {
        names[4..].copy_from_slice(&W_FIRST);
    }
    let table = read_numbers(bytes, &names, context)?;
    Ok(vec![("0".to_owned(), table)])
}

/// Whether a comment above the rows names the columns, with w before x.
fn declares_w_first(bytes: &[u8]) -> bool {
    let comments = csv::lines(bytes).map_while(|(_, _, text)| csv::comment(text));
    comments.into_iter().any(|text| {
        let text = String::from_utf8_lossy(text).to_lowercase();
        text.split_whitespace().rev().take(4).eq(W_FIRST.into_iter().rev())
    })
}

fn read_numbers(
    bytes: &[u8],
    names: &[&str],
    context: &mut ReadContext,
) -> Result<Table, TableError> {
    let layout = TextLayout {
        delimiter: b' ',
        width: names.len(),
        names: Some(names.iter().map(|&name| name.to_owned()).collect()),
        rows_at: csv::mark_length(bytes),
        line: 1,
    };
    csv::read_rows(bytes, layout, context)
}

/// Converts the matrices to quaternions. `times` has an entry per row, in billionths of a second; without
/// it, the rate must be configured.
pub(super) fn read_kitti(
    bytes: &[u8],
    times: Option<&[Option<i128>]>,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let names: Vec<String> = (0..KITTI_WIDTH).map(|at| format!("m{}{}", at / 4, at % 4)).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let read = read_numbers(bytes, &names, context)?;
    if read.columns.len() != KITTI_WIDTH {
        return Err("most numbers of a column are unusable".into());
    }
    let lines: Vec<usize> = rows(bytes).map(|(line, _)| line).collect();
    context.memory.reserve(lines.len() + (TUM_COLUMNS.len() + 4) * read.rows)?;
    let mut columns = TUM_COLUMNS.map(|name| Column::untyped(name, 1, Vec::new()));
    let mut table = Table::default();
    let mut malformed: Option<(usize, usize)> = None;
    for (row, &line) in read.lines.iter().enumerate() {
        let matrix: Vec<f64> = read.columns.iter().map(|column| column.values[row]).collect();
        let is_known = matrix.iter().all(|value| value.is_finite());
        let q_xyzw = match xyzw_of(&matrix) {
            Some(q_xyzw) => q_xyzw,
            None if !is_known => [f64::NAN; 4],
            None => {
                malformed.get_or_insert((line, 0)).1 += 1;
                continue;
            }
        };
        let at = lines.binary_search(&line).ok();
        let stamp = at.and_then(|at| times?.get(at).copied().flatten());
        columns[0].billionths.push(stamp);
        let seconds = stamp.map_or(f64::NAN, |stamp| stamp as f64 * 1e-9);
        let values = [seconds, matrix[3], matrix[7], matrix[11]].into_iter().chain(q_xyzw);
        columns.iter_mut().zip(values).for_each(|(column, value)| column.values.push(value));
        table.lines.push(line);
    }
    table.rows = table.lines.len();
    table.columns = columns.into_iter().skip(usize::from(times.is_none())).collect();
    table.losses.extend(malformed.map(|(first, rows)| RowLoss {
        rows,
        what: format!("line {first}: the first three columns are not a rotation").into(),
    }));
    Ok(vec![("0".to_owned(), table)])
}

fn xyzw_of(matrix: &[f64]) -> Option<[f64; 4]> {
    let row = |at: usize| [matrix[4 * at], matrix[4 * at + 1], matrix[4 * at + 2]];
    let (rotation, defect) = rotation_from_matrix_rows([row(0), row(1), row(2)])?;
    (defect < MAX_DEFECT).then(|| xyzw_from_rotation(&rotation))
}

/// A file and its times, in billionths of its unit; `None` in lines that are no number.
type TimesOfFile = (PathBuf, Vec<Option<i128>>);

/// `None` if the file holds other numbers.
fn times_in(input: &LogInput) -> Option<TimesOfFile> {
    let mapped = input.open().ok().filter(|_| input.address.is_none())?;
    let bytes = mapped.bytes();
    if let Some(values) = npy::single_numbers(bytes) {
        let billionth = |value: &f64| value.is_finite().then(|| (value * 1e9).round() as i128);
        let is_time = clock::increases_like_times(&values, "");
        return is_time.then(|| (input.path.clone(), values.iter().map(billionth).collect()));
    }
    let is_text = text_encoding::is_text(bytes) && is_list_of_times(bytes);
    let billionths = |text: &[u8]| csv::decimal_billionths(text, false);
    is_text.then(|| (input.path.clone(), times_below_name(bytes).map(billionths).collect()))
}

/// Times of `count` rows of the file at `path` that another file of the run has. `None` if two files have them.
pub(super) fn given_times(path: &Path, count: usize, inputs: &[LogInput]) -> Option<TimesOfFile> {
    let others = inputs.iter().filter(|input| input.path != path);
    let mut found: Vec<TimesOfFile> =
        others.filter_map(times_in).filter(|(_, times)| times.len() == count).collect();
    if found.len() > 1 {
        found.retain(|(file, _)| file.parent() == path.parent());
    }
    if found.len() == 1 { found.pop() } else { None }
}

/// Number from 1 of each line with data, from `first`.
pub(super) fn row_lines(bytes: &[u8], first: usize) -> Vec<usize> {
    rows(bytes).map(|(line, _)| line).filter(|line| *line >= first).collect()
}

/// Where the times of KITTI poses are looked for, besides the given files.
pub fn times_beside(path: &Path) -> Vec<PathBuf> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let names = [format!("{stem}_times.txt"), "times.txt".to_owned()];
    names.map(|name| path.with_file_name(name)).into()
}

/// Times of the KITTI poses at `path`, with their file: one of the run, otherwise one in the same folder.
pub(super) fn pose_times(
    path: &Path,
    poses: &[u8],
    inputs: &[LogInput],
) -> Result<TimesOfFile, LogError> {
    let count = rows(poses).count();
    let refusal = |what: String| LogError::PoseTimes { path: path.to_owned(), what };
    let mut found: Vec<TimesOfFile> = inputs.iter().filter_map(times_in).collect();
    let is_given = !found.is_empty();
    if !is_given {
        let beside = times_beside(path).into_iter().map(LogInput::local);
        found = beside.filter_map(|input| times_in(&input)).collect();
    }
    let misfit = found.first().map(|(file, times)| (file.clone(), times.len()));
    found.retain(|(_, times)| times.len() == count);
    if is_given && found.len() > 1 {
        let in_folder = |(file, _): &TimesOfFile| file.parent() == path.parent();
        if found.iter().filter(|file| in_folder(file)).count() != 1 {
            let names = [&found[0], &found[1]].map(|(file, _)| file.display());
            let [first, second] = names;
            return Err(refusal(format!("{first} and {second} both have {count} times")));
        }
        found.retain(in_folder);
    }
    match (found.into_iter().next(), misfit) {
        (Some(found), _) => Ok(found),
        (None, None) => Err(refusal(format!("{count} KITTI poses without times"))),
        (None, Some((file, own))) => {
            let file = file.display();
            Err(refusal(format!("{count} KITTI poses, but {file} has {own} times")))
        }
    }
}

/// Names of streams that only their files name: the shortest end of each path that no other path has,
/// without the extension if possible.
pub(super) fn stream_names(paths: &[&Path]) -> Vec<String> {
    let end = |path: &Path, depth: usize, is_bare: bool| -> String {
        let is_packed = path.extension().is_some_and(|extension| extension == "zst");
        let path = if is_packed { path.with_extension("") } else { path.to_owned() };
        let path = if is_bare { path.with_extension("") } else { path };
        let parts: Vec<_> = path.iter().map(|part| part.to_string_lossy()).collect();
        parts[parts.len().saturating_sub(depth)..].join("/")
    };
    let deepest = paths.iter().map(|path| path.iter().count()).max().unwrap_or(0);
    let ends = [true, false].into_iter().flat_map(|bare| (1..=deepest).map(move |at| (at, bare)));
    let mut names: Vec<String> = vec![String::new(); paths.len()];
    for (depth, is_bare) in ends {
        let mut counts: HashMap<String, usize> = HashMap::new();
        names.iter().for_each(|name| *counts.entry(name.clone()).or_default() += 1);
        for (name, path) in names.iter_mut().zip(paths) {
            if name.is_empty() || counts[name] > 1 {
                *name = end(path, depth, is_bare);
            }
        }
    }
    names
}
