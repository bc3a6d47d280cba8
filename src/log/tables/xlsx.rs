//! Excel workbooks (`.xlsx`). Each sheet with rows of numbers is a text table.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Read, copy, sink};

use calamine::{DataRef, ExcelDateTime, Reader, Xlsx};

use super::text_rows::CellsBeside;
use super::{Episodes, MAX_COLUMNS, ReadContext, TableError, csv, first_line};
use crate::memory_budget::MemoryBudget;

/// 1970-01-01 in days of Excel.
const UNIX_EPOCH_DAYS: f64 = 25_569.0;
const SECONDS_PER_DAY: f64 = 86_400.0;
const MAX_SHEETS: usize = 64;

/// Whether a zip archive is a workbook, as far as its first bytes show.
pub(crate) fn is_workbook(bytes: &[u8]) -> bool {
    const MEMBERS: [&[u8]; 3] = [b"[Content_Types].xml", b"xl/", b"docProps/"];
    let name = bytes.get(30..).unwrap_or_default();
    MEMBERS.iter().any(|member| name.starts_with(member))
}

pub(super) fn read(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    check_size(bytes, context.memory)?;
    let mut book: Xlsx<_> = Xlsx::new(Cursor::new(bytes)).map_err(|error| refusal(&error))?;
    let mut found: Episodes = Vec::new();
    for name in book.sheet_names().into_iter().take(MAX_SHEETS) {
        let text = sheet_text(&mut book, &name, context.memory);
        let (text, beside) = match text.and_then(|text| align_rows(&text, context.memory)) {
            Ok(aligned) => aligned,
            Err(error) => {
                error.in_part(&name).report(None, context.losses);
                continue;
            }
        };
        if csv::is_table(text.as_bytes()) {
            for (_, mut table) in csv::read(text.as_bytes(), context)? {
                let note = beside.map(|beside| format!("sheet '{name}': {}", beside.note()));
                table.notes.extend(note);
                found.push((name.clone(), table));
            }
        }
    }
    if found.is_empty() {
        return Err("no sheet of the workbook has rows of numbers".into());
    }
    // Sheets with the same columns are runs, otherwise streams of one run.
    let columns: BTreeSet<Vec<String>> =
        found.iter().map(|(_, table)| table.column_names()).collect();
    if columns.len() == found.len() {
        found.iter_mut().for_each(|(name, _)| "0".clone_into(name));
    }
    Ok(found)
}

fn refusal(error: &dyn std::fmt::Display) -> TableError {
    format!("the workbook cannot be read: {}", first_line(error)).into()
}

/// Unpacks every member once: a few kilobytes can declare any size.
fn check_size(bytes: &[u8], memory: &MemoryBudget) -> Result<(), TableError> {
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| refusal(&error))?;
    let most = memory.remaining();
    let mut unpacked = 0;
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).map_err(|error| refusal(&error))?;
        let mut limited = member.by_ref().take(most.saturating_sub(unpacked).saturating_add(1));
        unpacked += copy(&mut limited, &mut sink()).map_err(|error| refusal(&error))?;
        memory.check_available(unpacked)?;
    }
    Ok(())
}

/// The sheet as text, with a line for each row and tabs between the cells. Rows end at their last cell with a value; cells
/// with a style alone are left out.
fn sheet_text(
    book: &mut Xlsx<Cursor<&[u8]>>,
    name: &str,
    memory: &MemoryBudget,
) -> Result<String, TableError> {
    let mut text = String::new();
    let mut cells = book.worksheet_cells_reader(name).map_err(|error| refusal(&error))?;
    let (mut row, mut column) = (0, 0);
    while let Some(cell) = cells.next_cell().map_err(|error| refusal(&error))? {
        let (at_row, at_column) = cell.get_position();
        let value = value_text(cell.get_value());
        if at_column as usize >= MAX_COLUMNS || at_row < row || value.trim().is_empty() {
            continue;
        }
        if at_row > row {
            text.extend(std::iter::repeat_n('\n', (at_row - row) as usize));
            (row, column) = (at_row, 0);
        }
        if at_column < column {
            continue;
        }
        text.extend(std::iter::repeat_n('\t', (at_column - column) as usize));
        column = at_column;
        text += &value;
        memory.check_available(text.len() as u64)?;
    }
    text.push('\n');
    Ok(text)
}

/// Cuts or pads rows to the width of the sheet's table, and returns the cells outside. Most rows have this width; further
/// names belong to columns that are mostly empty.
fn align_rows(
    text: &str,
    memory: &MemoryBudget,
) -> Result<(String, Option<CellsBeside>), TableError> {
    let width_of = |row: &str| row.split('\t').count();
    let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
    for width in text.lines().map(width_of).filter(|width| *width >= csv::MIN_CELLS) {
        *counts.entry(width).or_default() += 1;
    }
    let most = counts.iter().max_by_key(|&(width, count)| (count, width)).map(|(width, _)| *width);
    let head = most.and_then(|most| text.lines().position(|row| width_of(row) >= most));
    let (Some(most), Some(head)) = (most, head) else { return Ok((text.to_owned(), None)) };
    let names = text.lines().nth(head).unwrap_or_default().split('\t').skip(most);
    let width = most + names.take_while(|name| !name.is_empty()).count();
    let (mut aligned, mut beside) = (String::with_capacity(text.len()), None);
    for (index, row) in text.lines().enumerate() {
        let end = row.match_indices('\t').nth(width - 1).map_or(row.len(), |(at, _)| at);
        aligned += &row[..end];
        if index >= head && !row.is_empty() {
            aligned.extend(std::iter::repeat_n('\t', width.saturating_sub(width_of(row))));
        }
        aligned.push('\n');
        let others = row[end..].split('\t').filter(|cell| !cell.is_empty()).count();
        CellsBeside::add(&mut beside, others, index + 1);
        memory.check_available(aligned.len() as u64)?;
    }
    Ok((aligned, beside))
}

fn value_text(value: &DataRef<'_>) -> String {
    let plain = |own: &str| own.replace(['\t', '\n', '\r', '"'], " ");
    match value {
        DataRef::Int(own) => own.to_string(),
        DataRef::Float(own) => own.to_string(),
        DataRef::Bool(own) => u8::from(*own).to_string(),
        DataRef::String(own) => plain(own),
        DataRef::SharedString(own) => plain(own),
        DataRef::DateTimeIso(own) | DataRef::DurationIso(own) => plain(own),
        DataRef::DateTime(own) => seconds(own).to_string(),
        _ => String::new(),
    }
}

/// Seconds since 1970, or of a duration.
fn seconds(date: &ExcelDateTime) -> f64 {
    match date.is_duration() {
        true => date.as_f64() * SECONDS_PER_DAY,
        false => (date.as_f64() - UNIX_EPOCH_DAYS) * SECONDS_PER_DAY,
    }
}
