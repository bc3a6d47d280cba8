//! Streams of different rates in one table: a row without numbers of a stream is not a sample of this stream.

use std::collections::BTreeSet;

use super::{Cell, ColumnGroup, ColumnMeaning};
use crate::tables::Table;

/// Distinct sets of rows that are compared with each other.
const MAX_PATTERNS: usize = 64;
/// Minimum share of its rows that a stream has to itself, in percent.
const MIN_OWN_PERCENT: usize = 10;

/// The rows with numbers of each group of columns, without duplicates.
pub(super) struct Sampling(Vec<Vec<bool>>);

impl Sampling {
    pub fn of_groups(table: &Table, groups: &[ColumnGroup]) -> Self {
        let used = groups.iter().filter(|group| !matches!(group.meaning, ColumnMeaning::Unused));
        let patterns: BTreeSet<Vec<bool>> =
            used.map(|group| rows_with_numbers(table, &group.cells)).collect();
        Self(patterns.into_iter().take(MAX_PATTERNS).collect())
    }

    /// The rows of a stream that has fewer than the table. `None` if an empty row is a gap, as of a tracker that
    /// loses its target: it has numbers in most rows, and no other stream has rows of its own.
    pub fn own_rows(&self, table: &Table, group: &ColumnGroup) -> Option<Vec<bool>> {
        let own = rows_with_numbers(table, &group.cells);
        let count = count_rows(own.iter().copied());
        let has_own = |other: &Vec<bool>| {
            let is_own = |of: &[bool], instead: &[bool]| {
                let apart = of.iter().zip(instead).map(|(of, instead)| *of && !instead);
                100 * count_rows(apart) >= MIN_OWN_PERCENT * count_rows(of.iter().copied()).max(1)
            };
            count_rows(other.iter().copied()) > 0 && is_own(&own, other) && is_own(other, &own)
        };
        let is_stream = count < own.len()
            && count > 0
            && (2 * count <= own.len() || self.0.iter().any(has_own));
        is_stream.then_some(own)
    }
}

fn count_rows(rows: impl Iterator<Item = bool>) -> usize {
    rows.filter(|is_in| *is_in).count()
}

pub(super) fn rows_with_numbers(table: &Table, cells: &[Cell]) -> Vec<bool> {
    let has_number = |row: usize| cells.iter().any(|cell| table.number(row, *cell).is_finite());
    (0..table.rows).map(has_number).collect()
}
