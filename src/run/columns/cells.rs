//! The numbers of a table whose meaning is open, and those that names tell, as one sheet.

use std::collections::HashMap;

use crate::diagnosis::Sheet;
use crate::log::{TableCell, Topic};
use crate::run::by_order::TABLE;
use crate::run::role::{Role, beside_arm, plain_role};
use crate::stream::{Columns, Times};
use crate::time::NANOS_PER_SECOND;

/// What is known of a number by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Known {
    /// Nothing.
    Open,
    /// A joint's measured position.
    Joint,
    /// A number of a measured position of the tool.
    Position,
}

/// One number of a table's rows.
pub(super) struct Number {
    /// Its topic, by its place, and its own place in a row of that.
    pub at: (usize, usize),
    pub cell: TableCell,
    pub known: Known,
}

/// All numbers that tell, beside each other.
pub(super) struct Cells {
    /// Where each number is among them.
    places: HashMap<(usize, usize), usize>,
    pub numbers: Vec<Number>,
    pub sheet: Sheet,
}

/// Whether nothing says what the numbers of a topic are.
pub(super) fn is_open(topic: &Topic) -> bool {
    topic.encoding == TABLE
        && matches!(&topic.columns, Some(Columns::Array(array)) if array.unnamed)
}

/// What a topic's numbers are by its names, where an audit measures the arm by them.
fn known(topic: &Topic) -> Option<Known> {
    if topic.encoding != TABLE || topic.columns.as_ref().is_none_or(|it| it.times().is_empty()) {
        return None;
    }
    match topic.columns.as_ref()? {
        Columns::Array(array) if array.unnamed => Some(Known::Open),
        Columns::Array(_) | Columns::Poses(_) => {
            (beside_arm(&topic.name) == Role::Unassigned).then_some(Known::Position)
        }
        columns @ Columns::Joints(_) => {
            let role = plain_role(&topic.name, columns).map(|(role, _)| role);
            (role == Some(Role::Joints)).then_some(Known::Joint)
        }
        _ => None,
    }
}

impl Cells {
    /// Those of the table that most topics are of; `None` where nothing is open.
    pub fn of(topics: &[Topic]) -> Option<Self> {
        let times = topics.iter().filter(|topic| is_open(topic)).filter_map(times_of);
        let rows = times.max_by_key(|times| times.len())?.log.clone();
        let mut numbers: Vec<(Number, Vec<f64>)> = Vec::new();
        for (index, topic) in topics.iter().enumerate() {
            let Some(known) = known(topic) else { continue };
            let Some(own) = Rows::of(topic, &rows) else { continue };
            let count = if known == Known::Position { 3 } else { topic.cells.len() };
            for (part, cell) in topic.cells.iter().enumerate().take(count) {
                let number = Number { at: (index, part), cell: cell.clone(), known };
                numbers.push((number, own.values(topic, part)));
            }
        }
        // Single numbers stand in the order of the table.
        numbers.sort_by_key(|(number, _)| number.cell.at);
        let home = |number: &Number| match topics[number.at.0].cells.len() {
            1 => 0,
            _ => 1 + number.at.0,
        };
        numbers.sort_by_key(|(number, _)| home(number));
        let homes = numbers.iter().map(|(number, _)| home(number)).collect();
        let (numbers, columns): (Vec<Number>, Vec<Vec<f64>>) = numbers.into_iter().unzip();
        let places = numbers.iter().enumerate().map(|(place, number)| (number.at, place)).collect();
        Some(Self { numbers, places, sheet: whole(&rows, columns, homes) })
    }

    /// The place of a number, by its topic and its place there.
    pub fn place(&self, at: (usize, usize)) -> Option<usize> {
        self.places.get(&at).copied()
    }

    /// The numbers by their names.
    pub fn names(&self) -> Vec<String> {
        self.numbers.iter().map(|number| number.cell.name.clone()).collect()
    }

    /// Whether names do not say both where the joints and where the tool are.
    pub fn is_asked(&self) -> bool {
        let are_known = |known| self.numbers.iter().any(|number| number.known == known);
        !(are_known(Known::Joint) && are_known(Known::Position))
    }

    /// The places of the numbers of which that is known.
    pub fn of_kind(&self, known: Known) -> Vec<usize> {
        (0..self.numbers.len()).filter(|&at| self.numbers[at].known == known).collect()
    }
}

/// All numbers of some topics beside each other, each times its factor, in the rows that all have; `None` where
/// they are of different tables.
pub(super) fn side_by_side(topics: &[(&Topic, f64)]) -> Option<Sheet> {
    let rows = times_of(topics.first()?.0)?.log.clone();
    let (mut columns, mut homes) = (Vec::new(), Vec::new());
    for (home, (topic, factor)) in topics.iter().enumerate() {
        let own = Rows::of(topic, &rows)?;
        for part in 0..topic.cells.len() {
            let mut values = own.values(topic, part);
            values.iter_mut().for_each(|value| *value *= factor);
            columns.push(values);
            homes.push(home);
        }
    }
    Some(whole(&rows, columns, homes))
}

/// The rows in which each column has a number, at times that rise.
fn whole(rows: &[i64], mut columns: Vec<Vec<f64>>, homes: Vec<usize>) -> Sheet {
    let mut whole: Vec<usize> = Vec::new();
    let mut last = i64::MIN;
    for (row, stamp) in rows.iter().enumerate() {
        if *stamp > last && columns.iter().all(|values| values[row].is_finite()) {
            last = *stamp;
            whole.push(row);
        }
    }
    let origin = rows.first().copied().unwrap_or_default();
    let second = NANOS_PER_SECOND as f64;
    let t_s = whole.iter().map(|&row| (rows[row] - origin) as f64 / second).collect();
    for values in &mut columns {
        *values = whole.iter().map(|&row| values[row]).collect();
    }
    Sheet::new(t_s, columns, homes)
}

fn times_of(topic: &Topic) -> Option<&Times> {
    topic.columns.as_ref()?.times().first().copied()
}

/// Where the rows of a topic stand among those of the table.
struct Rows(Vec<Option<usize>>);

impl Rows {
    /// `None` where most are missing: it is of another table, or hardly ever a number.
    fn of(topic: &Topic, rows: &[i64]) -> Option<Self> {
        const MOST: f64 = 0.9;
        let own = &times_of(topic)?.log;
        let found: Vec<Option<usize>> = if own == rows {
            (0..rows.len()).map(Some).collect()
        } else {
            let places: HashMap<i64, usize> =
                own.iter().enumerate().map(|(row, stamp)| (*stamp, row)).collect();
            rows.iter().map(|stamp| places.get(stamp).copied()).collect()
        };
        let count = found.iter().flatten().count();
        (count as f64 >= MOST * rows.len() as f64).then_some(Self(found))
    }

    /// One number of a topic in each row, NaN where it is missing.
    fn values(&self, topic: &Topic, part: usize) -> Vec<f64> {
        let at = |row: usize| match &topic.columns {
            Some(Columns::Array(array)) => array.row(row)[part],
            Some(Columns::Joints(joints)) => joints.joints[part].position[row],
            Some(Columns::Poses(poses)) => poses[0].xyz[row][part],
            _ => f64::NAN,
        };
        self.0.iter().map(|row| row.map_or(f64::NAN, at)).collect()
    }
}

/// Numbers as `[columns]` of a config names them: runs of one column in short.
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
