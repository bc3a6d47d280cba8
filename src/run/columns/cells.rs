//! Unidentified and identified numbers of a table, as one [`NumericTable`].

use std::collections::HashMap;

use crate::diagnosis::NumericTable;
use crate::log::{TableCell, Topic};
use crate::run::joint_order::TABLE;
use crate::run::role::{Role, role_by_content, role_by_name, role_outside_arm};
use crate::stream::{Columns, Times};
use crate::time::seconds;

/// Meaning of a number by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NumberKind {
    /// Not identified.
    Unidentified,
    /// Measured joint position.
    Joint,
    /// Coordinate of the measured tool position.
    Position,
}

pub(super) struct TableNumber {
    /// Topic index, and index within its row.
    pub at: (usize, usize),
    pub cell: TableCell,
    pub kind: NumberKind,
}

pub(super) struct TableNumbers {
    /// Topic and index of a number, to its column in `table`.
    places: HashMap<(usize, usize), usize>,
    pub numbers: Vec<TableNumber>,
    pub table: NumericTable,
}

pub(super) fn is_unidentified(topic: &Topic) -> bool {
    topic.encoding == TABLE
        && matches!(&topic.columns, Some(Columns::Array(array)) if array.unnamed)
}

/// Meaning of a topic's numbers by name. `None` if they are no measurements.
fn number_kind(topic: &Topic) -> Option<NumberKind> {
    if topic.encoding != TABLE || topic.columns.as_ref().is_none_or(|it| it.times().is_empty()) {
        return None;
    }
    match topic.columns.as_ref()? {
        Columns::Array(array) if array.unnamed => {
            (role_by_name(&topic.name) != Role::Target).then_some(NumberKind::Unidentified)
        }
        Columns::Array(_) | Columns::Poses(_) => {
            (role_outside_arm(&topic.name) == Role::Unassigned).then_some(NumberKind::Position)
        }
        columns @ Columns::Joints(_) => {
            let role = role_by_content(&topic.name, columns).map(|(role, _)| role);
            (role == Some(Role::Joints)).then_some(NumberKind::Joint)
        }
        _ => None,
    }
}

impl TableNumbers {
    /// Columns of the table with the most rows. `None` if all topics are identified.
    pub fn collect(topics: &[Topic]) -> Option<Self> {
        let times = topics.iter().filter(|topic| is_unidentified(topic)).filter_map(times_of);
        let rows = times.max_by_key(|times| times.len())?.log.clone();
        let mut numbers: Vec<(TableNumber, Vec<f64>)> = Vec::new();
        for (index, topic) in topics.iter().enumerate() {
            let Some(known) = number_kind(topic) else { continue };
            let Some(own) = RowMap::match_rows(topic, &rows) else { continue };
            let count = if known == NumberKind::Position { 3 } else { topic.cells.len() };
            for (part, cell) in topic.cells.iter().enumerate().take(count) {
                let number = TableNumber { at: (index, part), cell: cell.clone(), kind: known };
                numbers.push((number, own.values(topic, part)));
            }
        }
        numbers.sort_by_key(|(number, _)| number.cell.at);
        // Streams of a long table have the same columns.
        let earlier_streams = |topic: usize| {
            let is_same = |other: &&Topic| other.cells == topics[topic].cells;
            topics[..topic].iter().filter(is_same).count()
        };
        let home = |number: &TableNumber| match topics[number.at.0].cells.len() {
            1 => match earlier_streams(number.at.0) {
                0 => 0,
                stream => topics.len() + stream,
            },
            _ => 1 + number.at.0,
        };
        numbers.sort_by_cached_key(|(number, _)| home(number));
        let homes = numbers.iter().map(|(number, _)| home(number)).collect();
        let (numbers, columns): (Vec<TableNumber>, Vec<Vec<f64>>) = numbers.into_iter().unzip();
        let places = numbers.iter().enumerate().map(|(place, number)| (number.at, place)).collect();
        Some(Self { numbers, places, table: from_complete_rows(&rows, columns, homes) })
    }

    /// Column of a number.
    pub fn column(&self, at: (usize, usize)) -> Option<usize> {
        self.places.get(&at).copied()
    }

    pub fn names(&self) -> Vec<String> {
        self.numbers.iter().map(|number| number.cell.name.clone()).collect()
    }

    /// Whether names leave joints or tool position open.
    pub fn needs_search(&self) -> bool {
        let are_known = |known| self.numbers.iter().any(|number| number.kind == known);
        !(are_known(NumberKind::Joint) && are_known(NumberKind::Position))
    }

    pub fn columns_of_kind(&self, known: NumberKind) -> Vec<usize> {
        (0..self.numbers.len()).filter(|&at| self.numbers[at].kind == known).collect()
    }
}

/// The topics' numbers times their factors, for rows that all have. `None` if from different tables.
pub(super) fn join_tables(topics: &[(&Topic, f64)]) -> Option<NumericTable> {
    let rows = times_of(topics.first()?.0)?.log.clone();
    let (mut columns, mut homes) = (Vec::new(), Vec::new());
    for (home, (topic, factor)) in topics.iter().enumerate() {
        let own = RowMap::match_rows(topic, &rows)?;
        for part in 0..topic.cells.len() {
            let mut values = own.values(topic, part);
            values.iter_mut().for_each(|value| *value *= factor);
            columns.push(values);
            homes.push(home);
        }
    }
    Some(from_complete_rows(&rows, columns, homes))
}

fn from_complete_rows(rows: &[i64], mut columns: Vec<Vec<f64>>, homes: Vec<usize>) -> NumericTable {
    let mut whole: Vec<usize> = Vec::new();
    let mut last = i64::MIN;
    for (row, stamp) in rows.iter().enumerate() {
        if *stamp > last && columns.iter().all(|values| values[row].is_finite()) {
            last = *stamp;
            whole.push(row);
        }
    }
    let origin = rows.first().copied().unwrap_or_default();
    let t_s = whole.iter().map(|&row| seconds(rows[row] - origin)).collect();
    for values in &mut columns {
        *values = whole.iter().map(|&row| values[row]).collect();
    }
    NumericTable::new(t_s, columns, homes)
}

fn times_of(topic: &Topic) -> Option<&Times> {
    topic.columns.as_ref()?.times().first().copied()
}

struct RowMap(Vec<Option<usize>>);

impl RowMap {
    /// `None` if it lacks more than 10 % of the rows: another table, or seldom a number.
    fn match_rows(topic: &Topic, rows: &[i64]) -> Option<Self> {
        const MIN_ROW_SHARE: f64 = 0.9;
        let own = &times_of(topic)?.log;
        let found: Vec<Option<usize>> = if own == rows {
            (0..rows.len()).map(Some).collect()
        } else {
            let places: HashMap<i64, usize> =
                own.iter().enumerate().map(|(row, stamp)| (*stamp, row)).collect();
            rows.iter().map(|stamp| places.get(stamp).copied()).collect()
        };
        let count = found.iter().flatten().count();
        (count as f64 >= MIN_ROW_SHARE * rows.len() as f64).then_some(Self(found))
    }

    /// Values of one number per table row; NaN if missing.
    fn values(&self, topic: &Topic, part: usize) -> Vec<f64> {
        let at = |row: usize| match &topic.columns {
            Some(Columns::Array(array)) => array.row(row)[part],
            Some(Columns::Joints(joints)) => joints.joints[part].position[row],
            Some(Columns::Poses(poses)) => {
                let (xyz, q_xyzw) = (poses[0].xyz[row], poses[0].q_xyzw[row]);
                xyz.into_iter().chain(q_xyzw).nth(part).unwrap_or(f64::NAN)
            }
            _ => f64::NAN,
        };
        self.0.iter().map(|row| row.map_or(f64::NAN, at)).collect()
    }
}

/// Formats columns for `[columns]` in the config, with ranges.
pub fn selectors(cells: &[String]) -> Vec<String> {
    let split = |cell: &str| -> Option<(String, usize)> {
        let (column, at) = cell.strip_suffix(']')?.rsplit_once('[')?;
        Some((column.to_owned(), at.parse().ok()?))
    };
    let mut runs: Vec<(String, Option<(usize, usize)>)> = Vec::new();
    for cell in cells {
        match (split(cell), runs.last_mut()) {
            (Some((column, at)), Some((last, Some((_, end))))) if column == *last && at == *end => {
                *end += 1;
            }
            (Some((column, at)), _) => runs.push((column, Some((at, at + 1)))),
            (None, _) => runs.push((cell.clone(), None)),
        }
    }
    let shown = |(column, range): (String, Option<(usize, usize)>)| match range {
        Some((first, end)) if end == first + 1 => format!("{column}[{first}]"),
        Some((first, end)) => format!("{column}[{first}:{end}]"),
        None => column,
    };
    runs.into_iter().map(shown).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_one_column_are_named_as_a_range() {
        let cells = ["state[0]", "state[1]", "state[2]", "a", "b", "state[5]"].map(str::to_owned);
        assert_eq!(selectors(&cells), ["state[0:3]", "a", "b", "state[5]"]);
    }
}
