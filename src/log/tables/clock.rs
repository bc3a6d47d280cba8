//! When the rows of a table were: by a column of times, else by the rate that metadata or the caller give.

use super::{Column, ColumnSettings, Refusal, Table, names};
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

/// The stamps of a table.
pub(super) struct Clock {
    /// Of every row, ns; `None` where it has none.
    pub stamps: Vec<Option<i64>>,
    /// The column that they were read from, and the number of its rows.
    pub cell: Option<(usize, usize)>,
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
    let last = words.iter().rev().find(|word| !is_unit(word) || *word == "t");
    // DROID keeps its stamps below a group of that name.
    let is_below = name.contains('/') && words.contains(&"timestamp".to_owned());
    (is_below || last.is_some_and(|word| TIMES.contains(&word.as_str())))
        && !words.iter().any(|word| OTHERS.contains(&word.as_str()))
}

/// The stamps of `table`.
///
/// # Errors
/// Where nothing says when its rows were, or several columns say it differently.
pub(super) fn of(table: &Table, settings: &ColumnSettings) -> Result<Clock, Refusal> {
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
    let candidates = table.columns.iter().enumerate();
    let candidates = candidates.filter(|(_, column)| column.width == 1 && is_time(&column.name));
    let clocks = candidates.filter_map(|(at, column)| timed(at, column));
    // The finest is the one of this table: a stamp in whole seconds repeats.
    let best = clocks.min_by_key(|clock| (clock.repeats(), clock.cell));
    match (best, table.rate_hz) {
        (Some(clock), _) => Ok(clock),
        (None, Some(rate_hz)) => Ok(made(table, rate_hz, "as the metadata say")),
        (None, None) => by_numbers(table),
    }
}

/// The stamps in the one column whose numbers are times though its name does not say so: they rise by even
/// steps. Copies of them in another unit or from another zero are the same.
fn by_numbers(table: &Table) -> Result<Clock, Refusal> {
    /// More columns that rise alike are ramps, not clocks.
    const MOST_ALIKE: usize = 2;
    let none = || {
        "no column holds times, and no metadata the rate: add `[columns]` with `rate_hz = 30` (the true rows a \
         second) or `time = \"COLUMN\"` to poseaudit.toml; rows that are postures, not a run, \
         are `poseaudit calibrate`'s"
            .to_owned()
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
    let column = |name: &str| table.columns.iter().position(|column| column.name == name);
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
    let stamp = |row: usize| Some(NANOS_PER_SECOND + (row as f64 * step_ns).round() as i64);
    Clock {
        stamps: (0..table.rows).map(stamp).collect(),
        cell: None,
        said: format!(
            "its stamps are made: {rate_hz} rows a second, {by}; latencies are those between its columns"
        ),
        told: None,
        step_s: 1.0 / rate_hz,
    }
}

/// The stamps in a column, if it is one of times.
fn timed(at: usize, column: &Column) -> Option<Clock> {
    /// Steps that go back are this many at most, of a hundred.
    const BACK: usize = 2;
    let values = &column.values;
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    let steps: Vec<f64> = finite.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let back = steps.iter().filter(|step| **step < 0.0).count();
    let mut ahead: Vec<f64> = steps.iter().copied().filter(|step| *step > 0.0).collect();
    let step = median(&mut ahead)?;
    if 100 * back > BACK * steps.len().max(100) || 2 * finite.len() < values.len() {
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
    let is_grid = steps.iter().all(|own| (own - step).abs() <= 2e-3 * step + grain(column));
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
