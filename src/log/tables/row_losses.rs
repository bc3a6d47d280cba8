//! Rows and columns that are in a file but not in the audit.
//!
//! Readers pass their columns to [`Table::of`]. Each loss on the way becomes a [`RowLoss`].

use std::collections::BTreeSet;
use std::ops::Range;

use super::clock::{self, Clock};
use super::{
    Column, ColumnSettings, Extent, Losses, MAX_PARAMETERS, Table, most_frequent_rows, names,
};
use crate::memory_budget::{MemoryBudget, OutOfMemory};
use ground::stream::is_usable;

/// Error in a table file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum TableError {
    /// Damaged or unsupported.
    Damage(String),
    /// Exceeds the memory limit.
    Memory(OutOfMemory),
    /// Too many for one audit.
    Episodes,
}

impl TableError {
    pub fn report(&self, rows: Option<u64>, losses: &mut Losses) {
        losses.add_unplaced(self.extent(), rows, self.to_string());
    }

    fn extent(&self) -> Extent {
        match self {
            Self::Memory(_) => OutOfMemory::EXTENT,
            Self::Damage(_) | Self::Episodes => Extent::Messages,
        }
    }

    /// Prefixes the message with the part's name.
    pub fn in_part(self, name: &str) -> Self {
        match self {
            Self::Damage(what) => Self::Damage(format!("'{name}': {what}")),
            other => other,
        }
    }
}

impl std::fmt::Display for TableError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Damage(what) => f.write_str(what),
            Self::Memory(what) => what.fmt(f),
            Self::Episodes => f.write_str("too many episodes"),
        }
    }
}

impl From<String> for TableError {
    fn from(what: String) -> Self {
        Self::Damage(what)
    }
}

impl From<&str> for TableError {
    fn from(what: &str) -> Self {
        Self::Damage(what.to_owned())
    }
}

impl From<OutOfMemory> for TableError {
    fn from(what: OutOfMemory) -> Self {
        Self::Memory(what)
    }
}

/// First line of an error's text.
pub(super) fn first_line(error: &dyn std::fmt::Display) -> String {
    error.to_string().lines().next().unwrap_or_default().to_owned()
}

/// Rows of a column, or a whole column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RowLoss {
    pub rows: usize,
    pub what: TableError,
}

impl RowLoss {
    /// `label` names the episode.
    pub fn report(&self, label: &str, losses: &mut Losses) {
        let what = format!("{label}{}", self.what);
        losses.add_unplaced(self.what.extent(), Some(self.rows as u64), what);
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct ReadColumn {
    /// The last rows may be absent.
    pub column: Column,
    /// Declared rows.
    pub rows: usize,
    /// Unreadable rows.
    pub lost: Vec<Range<usize>>,
    /// Reason of the first loss.
    pub why: Option<TableError>,
}

impl ReadColumn {
    pub fn complete(column: Column) -> Self {
        let rows = column.values.len() / column.width.max(1);
        Self { column, rows, ..Self::default() }
    }

    pub fn unreadable(name: &str, rows: usize, why: TableError) -> Self {
        let column = Column { name: name.to_owned(), width: 1, ..Column::default() };
        Self { column, rows, lost: std::iter::once(0..rows).collect(), why: Some(why) }
    }
}

impl Table {
    /// `rows` defaults to the most frequent declared number.
    pub fn from_columns(
        candidates: Vec<ReadColumn>,
        rows: Option<usize>,
        memory: &mut MemoryBudget,
    ) -> Self {
        let rows =
            rows.unwrap_or_else(|| most_frequent_rows(candidates.iter().map(|column| column.rows)));
        let mut table = Self { rows, ..Self::default() };
        for candidate in candidates {
            table.add(candidate, memory);
        }
        table
    }

    /// One table for the most frequent number of rows, then one for each other number whose columns have a clock of
    /// their own: streams of different rates. The first table reports the remaining columns.
    pub fn by_row_count(candidates: Vec<ReadColumn>, memory: &mut MemoryBudget) -> Vec<Self> {
        let main = most_frequent_rows(candidates.iter().map(|candidate| candidate.rows));
        let counts: BTreeSet<usize> = candidates.iter().map(|candidate| candidate.rows).collect();
        let is_stream = |rows: &usize| {
            *rows != main && *rows > MAX_PARAMETERS && has_own_clock(&candidates, *rows)
        };
        let streams: Vec<usize> = counts.into_iter().filter(is_stream).collect();
        let (others, own): (Vec<_>, Vec<_>) =
            candidates.into_iter().partition(|candidate| streams.contains(&candidate.rows));
        let mut tables = vec![Self::from_columns(own, Some(main), memory)];
        let mut others = others;
        for rows in streams.into_iter().rev() {
            let own = others.extract_if(.., |candidate| candidate.rows == rows).collect();
            tables.push(Self::from_columns(own, Some(rows), memory));
        }
        tables
    }

    fn add(&mut self, candidate: ReadColumn, memory: &mut MemoryBudget) {
        let ReadColumn { mut column, rows: own, mut lost, why } = candidate;
        let (rows, width, name) = (self.rows, column.width, column.name.clone());
        if own != rows {
            let mut why = format!("{own} rows, not {rows}");
            if covers_same_rows(own, rows) {
                why += ": it is unknown which are missing";
                // Differences, errors and spectra are shorter by nature.
                let is_transition = own + 1 == rows && names::is_transition(&name);
                if names::is_joints_or_pose(&name) && !is_transition {
                    let what = format!("'{name}' has {why}");
                    self.losses.push(RowLoss { rows: own, what: what.into() });
                }
            }
            self.unread.push((name, why));
            return;
        }
        let read = column.values.len() / width.max(1);
        if read < rows {
            lost.push(read..rows);
        }
        let lost = merged_ranges(lost, rows);
        let count: usize = lost.iter().map(Range::len).sum();
        let mut lose = |rows: usize, what: TableError| self.losses.push(RowLoss { rows, what });
        if count > 0 {
            let which = describe_rows(&lost, rows);
            lose(
                count,
                match why {
                    Some(TableError::Damage(what)) => {
                        TableError::Damage(format!("'{name}': {what}{which}"))
                    }
                    Some(other) => other,
                    None => TableError::Damage(format!("'{name}'{which}")),
                },
            );
        }
        // Missing rows use memory too.
        let missing = rows.saturating_sub(read).saturating_mul(width);
        if count == rows {
            self.unread.push((name, "none of its rows can be read".to_owned()));
        } else if let Err(refusal) = memory.reserve(missing) {
            lose(rows - count, refusal.into());
            self.unread.push((name, "its rows take too much memory".to_owned()));
        } else {
            column.values.resize(rows * width, f64::NAN);
            for row in lost.iter().cloned().flatten() {
                column.values[row * width..(row + 1) * width].fill(f64::NAN);
            }
            if count > 0 {
                self.lost_rows.insert(self.columns.len(), lost);
            }
            self.columns.push(column);
        }
    }

    pub fn is_lost(&self, column: usize, row: usize) -> bool {
        let Some(lost) = self.lost_rows.get(&column) else { return false };
        let after = lost.partition_point(|range| range.end <= row);
        lost.get(after).is_some_and(|range| range.contains(&row))
    }
}

/// Whether the columns with this number of rows contain times and other numbers.
fn has_own_clock(candidates: &[ReadColumn], rows: usize) -> bool {
    let own = || candidates.iter().filter(|candidate| candidate.rows == rows);
    let columns = own().filter(|own| may_be_clock(own.column.width) && own.lost.is_empty());
    let columns: Vec<Column> = columns.map(|candidate| candidate.column.clone()).collect();
    let table = Table { rows, columns, ..Table::default() };
    own().count() > 1 && clock::detect(&table, &ColumnSettings::default()).is_ok()
}

/// Whether a column of this width may contain times: one number, or seconds and nanoseconds.
pub(super) fn may_be_clock(width: usize) -> bool {
    matches!(width, 1 | 2)
}

/// Columns of the same instants with different row counts lack rows. A slower stream of the same run has at
/// most half as many.
fn covers_same_rows(own: usize, rows: usize) -> bool {
    own > rows / 2 && own < rows.saturating_mul(2)
}

/// Sorted, merged and limited to the rows.
fn merged_ranges(mut ranges: Vec<Range<usize>>, rows: usize) -> Vec<Range<usize>> {
    ranges.sort_by_key(|range| range.start);
    let mut all: Vec<Range<usize>> = Vec::new();
    for range in ranges {
        let range = range.start.min(rows)..range.end.min(rows);
        match all.last_mut().filter(|last| range.start <= last.end) {
            _ if range.is_empty() => {}
            Some(last) => last.end = last.end.max(range.end),
            None => all.push(range),
        }
    }
    all
}

fn describe_rows(lost: &[Range<usize>], rows: usize) -> String {
    let count: usize = lost.iter().map(Range::len).sum();
    match lost {
        [all] if all.len() == rows => format!("; all its {rows} rows"),
        [one] if one.len() == 1 => format!("; row {} of {rows}", one.start),
        [one] => format!("; rows {} to {} of {rows}", one.start, one.end - 1),
        [first, ..] => format!("; {count} of {rows} rows, from row {} on", first.start),
        [] => String::new(),
    }
}

/// Rows with numbers but without a stamp.
pub(super) fn report_unstamped(table: &Table, clock: &Clock, label: &str, losses: &mut Losses) {
    let clocks: Vec<usize> =
        [clock.cell, clock.nanos].into_iter().flatten().map(|cell| cell.column).collect();
    let has_numbers = |row: usize| {
        let mut others = table.columns.iter().enumerate().filter(|(at, _)| !clocks.contains(at));
        others.any(|(_, column)| column.has_numbers(row))
    };
    let is_reported = |row: usize| clocks.iter().any(|at| table.is_lost(*at, row));
    let unstamped = clock.stamps.iter().enumerate().filter(|(_, stamp)| stamp.is_none());
    let lost = unstamped.filter(|(row, _)| !is_reported(*row) && has_numbers(*row)).count();
    if lost > 0 {
        let column = clock.cell.and_then(|cell| table.columns.get(cell.column));
        let column = column.map_or(String::new(), |column| format!(" in '{}'", column.name));
        let what = format!("{label}{lost} of {} rows have no stamp{column}", table.rows);
        losses.add_unplaced(Extent::Messages, Some(lost as u64), what);
    }
}

/// Removes rows with damaged numbers. Returns their number and describes the first. `values` returns the
/// `width` numbers of a row.
///
/// A number is damaged if it is not [`is_usable`] although nearly all others of its column are. Kept are
/// rows without any usable number (a tracker without its target; ING003 counts them), rows before the first
/// and after the last whole row (sensors not yet ready) and rows that are incomplete only in columns with
/// many gaps (sampled less often than the table).
pub(super) fn remove_damaged_rows<T: Copy>(
    table: &Table,
    rows: &mut Vec<(usize, T)>,
    width: usize,
    value: impl Fn(usize, usize) -> f64,
) -> Option<(u64, String)> {
    /// Share of usable rows in a column without gaps.
    const MIN_USABLE_PERCENT: usize = 90;
    let is_unusable = |row: usize, cell: usize| !is_usable(value(row, cell));
    let is_incomplete = |row: usize| {
        let unusable = (0..width).filter(|&cell| is_unusable(row, cell)).count();
        (1..width).contains(&unusable)
    };
    let mut counts = vec![0; width];
    for &(row, _) in rows.iter().filter(|(row, _)| is_incomplete(*row)) {
        (0..width).filter(|&cell| is_unusable(row, cell)).for_each(|cell| counts[cell] += 1);
    }
    if counts.iter().all(|count| *count == 0) {
        return None;
    }
    let is_dense =
        |cell: usize| 100 * (rows.len() - counts[cell]) >= MIN_USABLE_PERCENT * rows.len();
    let damaged_cells = |&(row, _): &(usize, T)| match is_incomplete(row) {
        true => (0..width).filter(|&cell| is_unusable(row, cell) && is_dense(cell)).count(),
        false => 0,
    };
    let damaged: Vec<usize> = rows.iter().map(damaged_cells).collect();
    let first = damaged.iter().position(|count| *count == 0)?;
    let last = damaged.iter().rposition(|count| *count == 0)?;
    let is_damaged = |at: usize| (first..last).contains(&at) && damaged[at] > 0;
    let at = (first..last).find(|at| is_damaged(*at))?;
    let place = table.place(rows[at].0);
    let mut index = 0..;
    let before = rows.len();
    rows.retain(|_| !index.next().is_some_and(is_damaged));
    let count = before - rows.len();
    let which = match count {
        1 => place,
        _ => format!("{count} rows, first {place}"),
    };
    let what =
        format!("{} of {width} numbers unusable (NaN, infinite or beyond 1e12)", damaged[at]);
    Some((count as u64, format!("{which}: {what}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(name: &str, rows: usize, read: usize) -> ReadColumn {
        let values = (0..2 * read).map(|n| n as f64).collect();
        let column = Column { name: name.to_owned(), width: 2, values, ..Column::default() };
        ReadColumn { column, rows, ..ReadColumn::default() }
    }

    #[test]
    fn rows_with_damaged_numbers_are_lost_but_missing_values_are_not() {
        let of = |damaged: &[(usize, usize)]| {
            let table = Table { rows: 40, ..Table::default() };
            let mut rows: Vec<(usize, ())> = (0..40).map(|row| (row, ())).collect();
            let value = |row: usize, cell: usize| match damaged.contains(&(row, cell)) {
                true => f64::NAN,
                false => 1.0,
            };
            let taken = remove_damaged_rows(&table, &mut rows, 3, value);
            (taken.map(|(count, what)| format!("{count}: {what}")), rows.len())
        };
        assert_eq!(of(&[]), (None, 40));
        let one = "1: row 9 of 40: 2 of 3 numbers unusable (NaN, infinite or beyond 1e12)";
        assert_eq!(of(&[(9, 0), (9, 2)]), (Some(one.to_owned()), 39));
        let two =
            "2: 2 rows, first row 5 of 40: 1 of 3 numbers unusable (NaN, infinite or beyond 1e12)";
        assert_eq!(of(&[(5, 1), (30, 2)]), (Some(two.to_owned()), 38));
        // A tracker loses its target.
        assert_eq!(of(&[(9, 0), (9, 1), (9, 2), (10, 0), (10, 1), (10, 2)]), (None, 40));
        // A sensor starts late, another ends early.
        assert_eq!(of(&[(0, 0), (1, 0), (39, 1)]), (None, 40));
        // Sampled in half of the rows; never filled.
        let half: Vec<(usize, usize)> = (0..20).map(|row| (2 * row, 1)).collect();
        assert_eq!(of(&half), (None, 40));
        let never: Vec<(usize, usize)> = (0..40).map(|row| (row, 1)).collect();
        assert_eq!(of(&never), (None, 40));
    }

    #[test]
    fn rows_are_either_in_the_table_or_reported() {
        let damaged = ReadColumn {
            lost: vec![30..40, 10..20, 15..25, 99..200],
            why: Some("a chunk is damaged".into()),
            ..candidate("damaged", 100, 100)
        };
        let refused = ReadColumn::unreadable("refused", 100, "it cannot be unpacked".into());
        let all = vec![
            candidate("whole", 100, 100),
            candidate("cut", 100, 60),
            damaged,
            refused,
            candidate("joint_positions", 99, 99),
            candidate("tool_pose", 101, 101),
            candidate("dt", 99, 99),
            candidate("qdd", 98, 98),
            candidate("err", 90, 90),
            candidate("rewards", 99, 99),
            candidate("slow", 50, 50),
        ];
        let table = Table::from_columns(all, None, &mut MemoryBudget::new(None));
        let kept: Vec<&str> = table.columns.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(kept, ["whole", "cut", "damaged"]);
        let lost: Vec<usize> = table.losses.iter().map(|loss| loss.rows).collect();
        assert_eq!(lost, [40, 26, 100, 99, 101]);
        let texts: Vec<String> = table.losses.iter().map(|loss| loss.what.to_string()).collect();
        assert_eq!(texts[0], "'cut'; rows 60 to 99 of 100");
        assert_eq!(texts[1], "'damaged': a chunk is damaged; 26 of 100 rows, from row 10 on");
        for (at, column) in table.columns.iter().enumerate() {
            for row in 0..100 {
                assert_eq!(column.values[2 * row].is_nan(), table.is_lost(at, row), "{row}");
            }
        }
        assert_eq!(table.unread.len(), 8);
        let reason = |name: &str| table.unread.iter().find(|(unread, _)| unread == name).cloned();
        let left_out = "90 rows, not 100: it is unknown which are missing".to_owned();
        assert_eq!(reason("err"), Some(("err".to_owned(), left_out)));
    }
}
