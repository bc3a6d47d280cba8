//! When the rows of a table were: by a column of times, else by the rate that metadata or the caller give.

use std::collections::BTreeMap;

use super::{Column, ColumnSettings, Table, names};
use ground::stats::median;
use ground::time::NANOS_PER_SECOND;

/// Names of columns of times, by the words that they end in.
const TIMES: &[&str] =
    &["timestamp", "timestamps", "time", "times", "t", "stamp", "stamps", "ts", "ipoc", "elapsed"];
/// Words that say the unit, and it in seconds.
const UNITS: &[(&str, f64)] = &[
    ("ns", 1e-9),
    ("nsec", 1e-9),
    ("nanos", 1e-9),
    ("nanoseconds", 1e-9),
    ("us", 1e-6),
    ("usec", 1e-6),
    ("micros", 1e-6),
    ("ms", 1e-3),
    ("msec", 1e-3),
    ("millis", 1e-3),
    ("milliseconds", 1e-3),
    ("s", 1.0),
    ("sec", 1.0),
    ("secs", 1.0),
    ("seconds", 1.0),
];
/// Words of times that are no row's.
const OTHERS: &[&str] = &[
    "delta",
    "dt",
    "duration",
    "delay",
    "remaining",
    "index",
    "control",
    "policy",
    "cameras",
    "sleep",
];

/// Steps that go back are this many at most, of a hundred.
const MOST_BACK: usize = 2;

/// Latest time since the start of a table, ns.
const MOST_NANOS: f64 = 9e18;

/// The stamps of a table.
pub(super) struct Clock {
    /// Of every row, ns; `None` where it has none.
    pub stamps: Vec<Option<i64>>,
    /// The column that they were read from, and the number of its rows.
    pub cell: Option<(usize, usize)>,
    /// That of their nanoseconds, where the other holds whole seconds.
    pub nanos: Option<(usize, usize)>,
    /// How they came about, in one line.
    pub said: String,
    /// The column, where its numbers told that it holds times and its name does not.
    pub told: Option<String>,
    /// The median of their steps, s.
    step_s: f64,
}

/// Whether a name is one of a column of times.
pub(super) fn is_time(name: &str) -> bool {
    let words = names::words(name);
    let is_unit = |word: &&String| UNITS.iter().any(|(unit, _)| unit == word);
    let is_general = |word: &&String| ["data", "info", "value", "values"].contains(&word.as_str());
    let mut named = words.iter().rev().filter(|word| !is_general(word));
    let last = named.find(|word| !is_unit(word) || *word == "t");
    // DROID keeps its stamps below a group of that name.
    let is_below = name.contains('/') && words.contains(&"timestamp".to_owned());
    (is_below || last.is_some_and(|word| TIMES.contains(&word.as_str())))
        && !words.iter().any(|word| OTHERS.contains(&word.as_str()))
}

/// The stamps of `table`.
///
/// # Errors
/// Where nothing says when its rows were, or several columns say it differently.
pub(super) fn of(table: &Table, settings: &ColumnSettings) -> Result<Clock, String> {
    if let Some(name) = &settings.time {
        let cell = cell_of(table, name)
            .ok_or_else(|| format!("`columns.time` names '{name}', which is no column of it"))?;
        let column = &table.columns[cell.0];
        let values = column.values.iter().skip(cell.1).step_by(column.width).copied().collect();
        let kind = column.kind.clone();
        let own = Column { name: name.clone(), kind, width: 1, values, ..Column::default() };
        return timed(cell.0, &own).map(|clock| Clock { cell: Some(cell), ..clock }).ok_or_else(
            || format!("`columns.time` names '{name}', whose numbers are no times: they must rise"),
        );
    }
    if let Some(rate_hz) = settings.rate_hz {
        return Ok(made(table, rate_hz, "as `columns.rate_hz` says"));
    }
    let best = best_of(named(table), table);
    match (best, table.rate_hz) {
        (Some(clock), _) => Ok(clock),
        (None, Some(rate_hz)) => Ok(made(table, rate_hz, "as the metadata say")),
        (None, None) => by_numbers(table),
    }
}

/// The clocks of groups of columns that have one of their own, by the path of the group.
pub(super) fn of_groups(table: &Table) -> BTreeMap<String, Clock> {
    let mut groups: BTreeMap<String, Vec<Clock>> = BTreeMap::new();
    for clock in named(table) {
        let name = clock.cell.and_then(|(at, _)| Some(table.columns.get(at)?.name.as_str()));
        if let Some(group) = name.and_then(group_of) {
            groups.entry(group.to_owned()).or_default().push(clock);
        }
    }
    let best = |(group, clocks)| Some((group, best_of(clocks, table)?));
    groups.into_iter().filter_map(best).collect()
}

/// The path of the group that a column is in.
pub(super) fn group_of(name: &str) -> Option<&str> {
    name.rsplit_once('/').map(|(group, _)| group)
}

/// The clocks that names say.
fn named(table: &Table) -> Vec<Clock> {
    let columns = || table.columns.iter().enumerate();
    // Kawasaki's third angle is no time.
    let has = |name: &str| table.columns.iter().any(|column| column.name == name);
    let is_angle = |name: &str| name == "T" && has("O") && has("A");
    let times = columns().filter(|(_, column)| is_time(&column.name) && !is_angle(&column.name));
    let mut clocks: Vec<Clock> = times
        .filter_map(|(at, column)| match column.width {
            1 => timed(at, column),
            2 => seconds_and_nanos(table, [(at, 0), (at, 1)]),
            _ => None,
        })
        .collect();
    for (at, column) in columns().filter(|(_, column)| column.width == 1) {
        let Some(stem) = stem_of(&column.name, &["s", "sec", "secs", "seconds"]) else { continue };
        let other = columns().find(|(_, other)| {
            let own = stem_of(
                &other.name,
                &["ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"],
            );
            other.width == 1 && own.as_ref() == Some(&stem)
        });
        clocks.extend(other.and_then(|(other, _)| seconds_and_nanos(table, [(at, 0), (other, 0)])));
    }
    clocks
}

/// The words of a name that ends in one of `units`, without it.
fn stem_of(name: &str, units: &[&str]) -> Option<Vec<String>> {
    let mut words = names::words(name);
    let unit = words.pop()?;
    units.contains(&unit.as_str()).then_some(words)
}

/// Of several clocks the finest: a stamp in whole seconds repeats. That of a message's header is before
/// that of its receipt.
fn best_of(clocks: Vec<Clock>, table: &Table) -> Option<Clock> {
    /// Rows of a hundred that may repeat a stamp.
    const REPEATS: usize = 5;
    let is_header = |clock: &Clock| {
        let name = clock.cell.map(|(at, _)| names::words(&table.columns[at].name));
        name.is_some_and(|words| words.contains(&"header".to_owned()))
    };
    clocks.into_iter().min_by_key(|clock| {
        let repeats = clock.repeats();
        let is_coarse = 100 * repeats > REPEATS * table.rows;
        (is_coarse, !is_header(clock), clock.nanos.is_none(), repeats, clock.cell)
    })
}

/// The stamps in two numbers of each row: whole seconds, and the nanoseconds beyond them.
fn seconds_and_nanos(table: &Table, cells: [(usize, usize); 2]) -> Option<Clock> {
    let [seconds, nanos] = cells.map(|(at, part)| {
        let column = &table.columns[at];
        column.values.iter().skip(part).step_by(column.width)
    });
    let second = NANOS_PER_SECOND as f64;
    let stamp = |(seconds, nanos): (&f64, &f64)| -> Option<i64> {
        let is_whole = seconds.fract() == 0.0 && (0.0..9e9).contains(seconds);
        let whole = (is_whole && (0.0..second).contains(nanos)).then_some(*seconds as i64)?;
        whole.checked_mul(NANOS_PER_SECOND)?.checked_add(nanos.round() as i64)
    };
    let stamps: Vec<Option<i64>> = seconds.zip(nanos).map(stamp).collect();
    let known: Vec<i64> = stamps.iter().flatten().copied().collect();
    let steps = || known.windows(2).map(|pair| (pair[1] - pair[0]) as f64 / second);
    let mut ahead: Vec<f64> = steps().filter(|step| *step > 0.0).collect();
    let back = steps().filter(|step| *step < 0.0).count();
    let step_s = median(&mut ahead)?;
    // Fractions in another unit never come near a second.
    let is_nanos =
        cells[1].0 != cells[0].0 || known.iter().any(|stamp| stamp % NANOS_PER_SECOND > 1_000_000);
    if 100 * back > MOST_BACK * known.len().max(100) || 2 * known.len() < stamps.len() || !is_nanos
    {
        return None;
    }
    let name = |at: usize| &table.columns[at].name;
    let said = match cells {
        [(one, _), (other, _)] if one == other => {
            format!("its stamps are column '{}', s and ns", name(one))
        }
        [(one, _), (other, _)] => {
            format!("its stamps are columns '{}', s, and '{}', ns", name(one), name(other))
        }
    };
    let [cell, nanos] = cells;
    Some(Clock { stamps, cell: Some(cell), nanos: Some(nanos), said, told: None, step_s })
}

/// The stamps in the one column whose numbers are times though its name does not say so: they rise by even
/// steps. Copies of them in another unit or from another zero are the same.
fn by_numbers(table: &Table) -> Result<Clock, String> {
    /// More columns that rise alike are ramps, not clocks.
    const MOST_ALIKE: usize = 2;
    let none = || {
        let mut named = table.columns.iter().filter(|column| is_time(&column.name));
        let why = match named.next() {
            Some(column) => {
                format!("column '{}' is named as a time, and {}", column.name, no_time(column))
            }
            None => "no column holds times, and no metadata the rate".to_owned(),
        };
        format!(
            "{why}: add `[columns]` with `rate_hz = 30` (the true rows a second) or `time = \"COLUMN\"` to \
             poseaudit.toml; rows that are postures, not a run, are `poseaudit calibrate`'s"
        )
    };
    let mut found: Vec<(String, Clock, Column)> = Vec::new();
    let mut alike = 0;
    for (at, column) in table.columns.iter().enumerate() {
        for part in 0..column.width {
            let values = column.values.iter().skip(part).step_by(column.width).copied().collect();
            let kind = column.kind.clone();
            let own = Column { kind, width: 1, values, ..Column::default() };
            let Some(clock) = timed(at, &own).filter(|_| rises_evenly(&own.values)) else {
                continue;
            };
            let name = match column.width {
                1 => column.name.clone(),
                _ => format!("{}[{part}]", column.name),
            };
            alike += 1;
            let is_known = found.iter().any(|(_, _, other)| is_line(&other.values, &own.values));
            if !is_known {
                found.push((name, Clock { cell: Some((at, part)), ..clock }, own));
            }
        }
    }
    match found.as_mut_slice() {
        [] => Err(none()),
        [_] if alike > MOST_ALIKE => Err(none()),
        [(name, ..)] => {
            let name = std::mem::take(name);
            let (_, clock, _) = found.swap_remove(0);
            let said = clock.said.replacen("''", &format!("'{name}', by its numbers"), 1);
            Ok(Clock { said, told: Some(name), ..clock })
        }
        several => {
            let names: Vec<String> =
                several.iter().map(|(name, ..)| format!("time = \"{name}\"")).collect();
            Err(format!(
                "{} columns rise as times do, and no name says which is one: {}",
                names.len(),
                names.join(", or ")
            ))
        }
    }
}

/// Why the numbers of a column are no times.
fn no_time(column: &Column) -> String {
    let steps = || column.values.windows(2).map(|pair| pair[1] - pair[0]);
    let back = steps().filter(|step| *step < 0.0).count();
    let mut ahead: Vec<f64> = steps().filter(|step| *step > 0.0).collect();
    match median(&mut ahead) {
        None => "its numbers never rise".to_owned(),
        Some(_) if 100 * back > MOST_BACK * column.values.len().max(100) => {
            format!("its numbers fall in {back} rows")
        }
        Some(step) => format!("its numbers rise by {step} a row, in a unit that nothing says"),
    }
}

/// Whether numbers rise at each step, and nearly always by about as much.
fn rises_evenly(values: &[f64]) -> bool {
    /// Steps in a hundred that are of the usual size, and what that is.
    const USUAL: usize = 90;
    const SIZE: std::ops::RangeInclusive<f64> = 0.5..=2.0;
    let steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let Some(step) = median(&mut steps.clone()) else { return false };
    let usual = steps.iter().filter(|own| SIZE.contains(&(**own / step))).count();
    steps.iter().all(|own| *own > 0.0) && 100 * usual >= USUAL * steps.len()
}

/// Whether one column is a line in another, as two clocks are that do not drift.
fn is_line(one: &[f64], other: &[f64]) -> bool {
    const LEFT: f64 = 1e-4;
    let (Some(first), Some(last)) = (one.first().zip(other.first()), one.last().zip(other.last()))
    else {
        return false;
    };
    let slope = (last.1 - first.1) / (last.0 - first.0);
    let span = (last.1 - first.1).abs();
    let mut pairs = one.iter().zip(other);
    pairs.all(|(a, b)| (first.1 + slope * (a - first.0) - b).abs() <= LEFT * span)
}

/// The column of a name, or the one number of its rows that `NAME[AT]` is.
fn cell_of(table: &Table, name: &str) -> Option<(usize, usize)> {
    let column = |name: &str| table.column(name);
    if let Some(at) = column(name) {
        return Some((at, 0));
    }
    let (vector, part) = name.strip_suffix(']')?.rsplit_once('[')?;
    let (at, part) = (column(vector)?, part.parse().ok()?);
    (part < table.columns[at].width).then_some((at, part))
}

/// Stamps made of a rate.
fn made(table: &Table, rate_hz: f64, by: &str) -> Clock {
    let step_ns = NANOS_PER_SECOND as f64 / rate_hz;
    // A low rate may put rows beyond the range of stamps.
    let stamp = |row: usize| {
        let nanos = (row as f64 * step_ns).round();
        (nanos < MOST_NANOS).then_some(NANOS_PER_SECOND + nanos as i64)
    };
    Clock {
        stamps: (0..table.rows).map(stamp).collect(),
        cell: None,
        nanos: None,
        said: format!(
            "its stamps are made: {rate_hz} rows a second, {by}; latencies are those between its columns"
        ),
        told: None,
        step_s: 1.0 / rate_hz,
    }
}

/// The stamps in a column, if it is one of times.
fn timed(at: usize, column: &Column) -> Option<Clock> {
    let values = &column.values;
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let steps: Vec<f64> = finite.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let back = steps.iter().filter(|step| **step < 0.0).count();
    let mut ahead: Vec<f64> = steps.iter().copied().filter(|step| *step > 0.0).collect();
    let step = median(&mut ahead)?;
    if 100 * back > MOST_BACK * steps.len().max(100) || 2 * finite.len() < values.len() {
        return None;
    }
    let (first, words) = (*finite.first()?, names::words(&column.name));
    let by_name = words.iter().rev().find_map(|word| UNITS.iter().find(|(unit, _)| unit == word));
    let by_name = by_name
        .map(|(_, unit)| *unit)
        .or_else(|| words.contains(&"ipoc".to_owned()).then_some(1e-3));
    let is_whole = finite.iter().all(|value| value.fract() == 0.0);
    let rise = (finite[finite.len() - 1] - first) / (finite.len() - 1).max(1) as f64;
    let unit = by_name
        .filter(|unit| (1e-5..=1e3).contains(&(unit * step)))
        .or_else(|| unit_of(first, step, rise, is_whole))?;
    let step_s = step * unit;
    // A stamp of 0 is none: those that begin there begin at 1 s.
    let from = if first * unit < 1.0 && first >= 0.0 { NANOS_PER_SECOND } else { 0 };
    let nanos = |value: f64| -> Option<i64> {
        let exact = value.is_finite() && (value * unit).abs() < 9e9;
        // Whole numbers of nanoseconds and the like are kept whole.
        let whole = (unit * NANOS_PER_SECOND as f64).round() as i64;
        let nanos = match is_whole {
            true => (value as i64).checked_mul(whole)?,
            false => (value * unit * NANOS_PER_SECOND as f64).round() as i64,
        };
        exact.then_some(from.checked_add(nanos)?)
    };
    let grain = grain(column);
    let is_grid = steps.iter().all(|own| (own - step).abs() <= 2e-3 * step + grain);
    let unit_name = match unit {
        1.0 => "s",
        1e-3 => "ms",
        1e-6 => "µs",
        _ => "ns",
    };
    let mut said = format!("its stamps are column '{}', {unit_name}", column.name);
    if is_grid {
        said += &format!(
            ", a made grid of {:.4} rows a second; latencies are those between its columns",
            1.0 / step_s
        );
    }
    Some(Clock {
        stamps: values.iter().map(|value| nanos(*value)).collect(),
        cell: Some((at, 0)),
        nanos: None,
        said,
        told: None,
        step_s,
    })
}

/// How far rounding may move a step, in the column's unit.
fn grain(column: &Column) -> f64 {
    let largest = column.values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let bits = if column.kind.contains("32") || column.kind.contains("f4") {
        f32::EPSILON.into()
    } else {
        f64::EPSILON
    };
    2.0 * largest * bits
}

/// The unit of times that begin at `first`, step by `step` where they rise, and rise by `rise` a row, s; `None` if it
/// may be several.
fn unit_of(first: f64, step: f64, rise: f64, is_whole: bool) -> Option<f64> {
    /// Whole numbers that most rows repeat are seconds: in ms there would be 2000 rows a second and more.
    const REPEATED: f64 = 0.5;
    // Since 1970, from 2001 to 2128.
    let epoch =
        [1.0, 1e-3, 1e-6, 1e-9].into_iter().find(|unit| (1e9..5e9).contains(&(first * unit)));
    epoch.or(match (step, is_whole) {
        (..0.0001, _) => None,
        (..=10.0, true) if rise <= REPEATED => Some(1.0),
        (..=2.0, false) => Some(1.0),
        (2.0..=1000.0, true) => Some(1e-3),
        (1000.0..=1e6, true) => Some(1e-6),
        (1e6..=2e9, true) => Some(1e-9),
        _ => None,
    })
}

impl Clock {
    pub fn first(&self) -> i64 {
        self.stamps.iter().flatten().next().copied().unwrap_or(0)
    }

    pub fn last(&self) -> i64 {
        self.stamps.iter().flatten().next_back().copied().unwrap_or(0)
    }

    fn repeats(&self) -> usize {
        self.stamps.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }

    /// What of the metadata its steps are not.
    pub fn contradiction(&self, table: &Table) -> Option<String> {
        /// Of the rate that is declared.
        const OFF: f64 = 0.02;
        let (rate_hz, own_hz) = (table.rate_hz?, 1.0 / self.step_s);
        ((own_hz / rate_hz - 1.0).abs() > OFF && self.cell.is_some()).then(|| {
            format!("the metadata declare {rate_hz} frames a second; the stamps step at {own_hz:.4} a second")
        })
    }
}
