//! Long tables: a column names the arm or body that each row is of, such as `arm` or `rigid_id`.

use super::{Cell, Table};
use ground::stats::{mean, median};
use ground::stream::is_usable;

/// Streams that one table may hold. Columns with more values are measurements or free text.
const MAX_LABELS: usize = 16;

/// Distinct values of a column and the rows that have them. Stops at more than [`MAX_LABELS`] values.
#[derive(Clone, Debug, Default)]
pub(super) struct Levels<T> {
    known: Vec<T>,
    /// Row, and index of its value.
    rows: Vec<(usize, usize)>,
}

impl<T: Clone + PartialEq> Levels<T> {
    pub fn push(&mut self, row: usize, value: T) {
        if self.are_too_many() {
            return;
        }
        let known = self.known.iter().position(|known| *known == value);
        let at = known.unwrap_or(self.known.len());
        if known.is_none() {
            self.known.push(value);
        }
        self.rows.push((row, at));
        if self.are_too_many() {
            self.rows = Vec::new();
        }
    }

    /// Appends those of a block of rows.
    pub fn extend(&mut self, more: &Self, first_row: usize) {
        if more.are_too_many() {
            self.clone_from(more);
        }
        for (row, at) in &more.rows {
            self.push(first_row + row, more.known[*at].clone());
        }
    }

    /// Number of rows in memory.
    pub fn row_count(&self) -> usize {
        self.rows.len()
    }

    fn are_too_many(&self) -> bool {
        self.known.len() > MAX_LABELS
    }

    /// `None` if there are too many values for labels, or only one.
    fn to_labels(&self, rows: usize, name: impl Fn(&T) -> String) -> Option<RowLabels> {
        if self.known.len() < 2 || self.are_too_many() {
            return None;
        }
        let mut labels = vec![None; rows];
        self.rows.iter().for_each(|(row, at)| labels[*row] = Some(*at));
        let values = self.known.iter().map(name).collect();
        Some(RowLabels { values, rows: labels, ..RowLabels::default() })
    }
}

/// The stream of each row.
#[derive(Clone, Debug, Default)]
pub(crate) struct RowLabels {
    /// Name of the column that holds them; empty without names.
    pub column: String,
    /// Its numbers; `None` if it holds text.
    pub cell: Option<Cell>,
    /// Names of the streams.
    pub values: Vec<String>,
    /// Index of the row's stream. `None` if its cell is empty.
    pub rows: Vec<Option<usize>>,
}

impl RowLabels {
    pub(super) fn of_texts<T: AsRef<[u8]> + Clone + PartialEq>(
        column: &str,
        rows: usize,
        levels: &Levels<T>,
    ) -> Option<Self> {
        let name =
            |text: &T| String::from_utf8_lossy(text.as_ref()).trim_matches(['/', ' ']).to_owned();
        let own = levels.to_labels(rows, name)?;
        Some(Self { column: column.to_owned(), ..own })
    }

    /// Whole numbers, such as identifiers.
    fn of_numbers(table: &Table, cell: Cell) -> Option<Self> {
        let numbers = || table.columns[cell.column].numbers(cell.part);
        let first = numbers().next()?;
        if numbers().all(|number| number == first || number.is_nan()) {
            return None;
        }
        let mut levels = Levels::default();
        for (row, number) in numbers().enumerate().filter(|(_, number)| !number.is_nan()) {
            if number.fract() != 0.0 || levels.are_too_many() {
                return None;
            }
            levels.push(row, number);
        }
        let is_named = table.columns[cell.column].width == 1;
        let column = if is_named { table.cell_name(cell) } else { String::new() };
        let before = if is_named { column.as_str() } else { "stream" };
        let own = levels.to_labels(table.rows, |number| format!("{before}_{number}"))?;
        Some(Self { column, cell: Some(cell), ..own })
    }

    /// Labels that separate the numbers of the table into streams that are continuous only among themselves. `groups` are
    /// the cells of joints, poses and other numbers.
    pub fn detect(table: &Table, groups: &[&[Cell]]) -> Option<Self> {
        /// Numbers of a position: fewer may be those of a sensor that measures several quantities in turn.
        const MIN_CELLS: usize = 3;
        let columns = table.columns.iter().enumerate();
        let cells =
            columns.flat_map(|(column, own)| (0..own.width).map(move |part| Cell { column, part }));
        let of_numbers = cells.filter_map(|cell| Self::of_numbers(table, cell));
        let of_texts = table.labels.iter().filter(|own| own.are_interleaved()).cloned();
        let mut candidates: Vec<Self> =
            of_texts.chain(of_numbers.filter(Self::are_interleaved)).collect();
        candidates.sort_by_key(|own| std::cmp::Reverse(own.values.len()));
        candidates.into_iter().find(|own| {
            let is_apart = |cell: &&Cell| own.cell != Some(**cell) && own.separates(table, **cell);
            let apart =
                groups.iter().map(|cells| (cells.len(), cells.iter().filter(is_apart).count()));
            let apart: Vec<(usize, usize)> = apart.collect();
            apart.iter().any(|(width, count)| *width >= MIN_CELLS && *count > 0)
                || apart.iter().map(|(_, count)| count).sum::<usize>() >= MIN_CELLS
        })
    }

    /// Whether the rows of the streams alternate. Phases of a run last for many rows.
    fn are_interleaved(&self) -> bool {
        /// Rows of all streams but the longest, per change of the stream. Two streams in turn have half a row.
        const MAX_ROWS_PER_CHANGE: usize = 2;
        let known: Vec<usize> = self.rows.iter().flatten().copied().collect();
        let count = |of: usize| known.iter().filter(|own| **own == of).count();
        let most = (0..self.values.len()).map(count).max().unwrap_or(0);
        let changes = known.windows(2).filter(|pair| pair[0] != pair[1]).count();
        MAX_ROWS_PER_CHANGE * changes >= known.len() - most && changes > 0
    }

    /// Whether a number jumps from stream to stream, and moves steadily within one.
    fn separates(&self, table: &Table, cell: Cell) -> bool {
        /// Of the median steps. They are equal or halved if the label has nothing to do with the number.
        const MIN_STEP_RATIO: f64 = 4.0;
        /// Range of a stream, in median steps. White noise around stations that the robot visits in turn has 10 in a
        /// million rows.
        const MIN_RANGE_STEPS: f64 = 12.0;
        /// A median of fewer steps has such ratios by chance.
        const MIN_STEPS: usize = 20;
        let (mut within, mut between) = (Vec::new(), Vec::new());
        let mut last: Vec<Option<f64>> = vec![None; self.values.len()];
        let mut ranges = vec![[f64::INFINITY, f64::NEG_INFINITY]; self.values.len()];
        let mut before: Option<(usize, f64)> = None;
        let numbers = table.columns[cell.column].numbers(cell.part).zip(&self.rows);
        for (number, label) in numbers.filter(|(number, _)| is_usable(*number)) {
            let Some(label) = *label else { continue };
            if let Some((_, other)) = before.filter(|(stream, _)| *stream != label) {
                between.push((number - other).abs());
            }
            within.extend(last[label].map(|own| (number - own).abs()));
            before = Some((label, number));
            last[label] = Some(number);
            let [low, high] = ranges[label];
            ranges[label] = [low.min(number), high.max(number)];
        }
        let has_enough = within.len() >= MIN_STEPS && between.len() >= MIN_STEPS;
        let (Some(step), Some(jump)) = (median(&mut within), median(&mut between)) else {
            return false;
        };
        // The median is 0 if most values repeat.
        let step = step.max(mean(within.iter().copied()));
        let range = ranges.iter().map(|[low, high]| high - low).fold(0.0, f64::max);
        // A number that is constant in some rows is missing there, and the label says so, as `valid` does.
        let all_change = self.cell.is_none() || ranges.iter().all(|[low, high]| low != high);
        has_enough && all_change && jump > MIN_STEP_RATIO * step && range > MIN_RANGE_STEPS * step
    }

    /// The streams; `None` for rows without a label.
    pub fn streams(&self) -> Vec<Option<usize>> {
        let without = self.rows.contains(&None).then_some(None);
        (0..self.values.len()).map(Some).chain(without).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tables::Column;

    /// Whether the labels separate three numbers.
    fn are_streams(label: impl Fn(usize) -> f64, number: impl Fn(usize, usize) -> f64) -> bool {
        const ROWS: usize = 400;
        let values = (0..ROWS).flat_map(|row| [0, 1, 2].map(|at| number(row, at))).collect();
        let labels = Column::untyped("id", 1, (0..ROWS).map(label).collect());
        let columns = vec![labels, Column::untyped("p", 3, values)];
        let table = Table { rows: ROWS, columns, ..Table::default() };
        let cells = [0, 1, 2].map(|part| Cell { column: 1, part });
        RowLabels::detect(&table, &[&cells]).is_some()
    }

    fn wave(row: usize, at: usize) -> f64 {
        (0.02 * row as f64 + at as f64).sin()
    }

    fn noise(row: usize, at: usize) -> f64 {
        (7.3 * (row * row + 31 * at) as f64).sin()
    }

    #[test]
    fn labels_separate_streams_that_move() {
        let parity = |row: usize| (row % 2) as f64;
        let of_two = |row: usize, at: usize| wave(row, at) + 0.3 * parity(row);
        assert!(are_streams(parity, of_two));
        assert!(are_streams(|row| parity(row / 2), |row, at| of_two(row / 2, at)));
        // One of four rows is of the second stream.
        let rare = |row: usize| f64::from(u8::from(row % 4 == 3));
        assert!(are_streams(rare, |row, at| wave(row, at) + 0.5 * rare(row)));
        // Whether a pose is valid, or new, in a table that repeats poses.
        let valid = |row: usize| f64::from(u8::from(row % 7 != 3));
        assert!(!are_streams(valid, |row, at| valid(row) * (2.0 + wave(row, at))));
        let new = |row: usize| f64::from(u8::from(row.is_multiple_of(5)));
        assert!(!are_streams(new, |row, at| wave(row / 5, at)));
        // A bit that toggles, phases, two stations, and numbers that are not whole.
        assert!(!are_streams(parity, wave));
        let phase = |row: usize| (row / 20 % 2) as f64;
        assert!(!are_streams(phase, |row, at| wave(row, at) + phase(row)));
        assert!(!are_streams(parity, |row, at| parity(row) + 1e-4 * noise(row, at)));
        assert!(!are_streams(|row| 0.5 * parity(row), of_two));
        assert!(!are_streams(|row| row as f64, of_two));
    }
}
