//! Stamps of table rows: from a column of times, otherwise from a declared rate.

use std::borrow::Cow;
use std::collections::BTreeMap;

use jiff::civil::DateTime;
use jiff::tz::TimeZone;

use super::{Cell, Column, ColumnSettings, Table, names};
use crate::decode::excerpt;
use ground::stats::median;
use ground::time::NANOS_PER_SECOND;

/// Last words of the names of time columns.
const TIME_WORDS: &[&str] = &[
    "timestamp", "timestamps", "time", "times", "t", "stamp", "stamps", "ts", "ipoc", "elapsed",
    "zeit", "zeitstempel", "uhrzeit", "temps", "tiempo", "tempo", "时间", "时间戳", "時間", "時刻",
];
/// Words for times that are not row stamps.
const EXCLUDED_WORDS: &[&str] = &[
    "delta", "dt", "duration", "delay", "remaining", "index", "control", "policy", "cameras",
    "sleep",
];

/// Words in the names of stamps of images.
const IMAGE_WORDS: &[&str] =
    &["image", "images", "img", "camera", "cameras", "cam", "video", "depth", "rgb"];

/// Words for numbers that count rows or messages, at whatever rate.
const COUNTER_WORDS: &[&str] =
    &["id", "ids", "index", "idx", "seq", "sequence", "count", "counter", "frame", "row", "packet"];

/// Share of the steps.
const MAX_BACKWARD_PERCENT: usize = 2;

/// Share of the rows that repeat the stamp of the row before, because stamps are rounded or the clock is late.
const MAX_REPEATED_PERCENT: usize = 5;

const MAX_NANOS: f64 = 9e18;

/// Numbers beyond two turns are not joint positions in rad.
pub(super) const TWO_TURNS_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Why a table has no clock.
pub(super) enum ClockError {
    /// It has no times.
    NoTimes(String),
    /// Ambiguous times, or a time column of the config that holds no times.
    Other(String),
}

#[derive(Default)]
pub(super) struct Clock {
    /// ns.
    pub stamps: Vec<Option<i64>>,
    /// The numbers that it is read from.
    pub cell: Option<Cell>,
    /// Set if `cell` holds whole seconds.
    pub nanos: Option<Cell>,
    /// Whether `nanos` holds microseconds.
    pub is_fraction_in_micros: bool,
    /// Origin of the stamps.
    pub description: String,
    /// Set if identified by its numbers.
    pub unnamed_column: Option<String>,
    /// Unit of `cell`, s, unless its numbers show that they are seconds.
    pub unit_s: Option<f64>,
    /// Set if the stamps are generated.
    pub rate_hz: Option<f64>,
    /// Median step, s.
    step_s: f64,
}

pub(super) fn is_time(name: &str) -> bool {
    let words = names::split_words(name);
    let is_unit = |word: &&String| unit_by_word(word).is_some();
    let is_general = |word: &&String| ["data", "info", "value", "values"].contains(&word.as_str());
    let mut named = words.iter().rev().filter(|word| !is_general(word));
    let last = named.find(|word| !is_unit(word) || *word == "t");
    // `seconds`, but not `s`.
    let is_unit_alone = last.is_none() && words.iter().any(|word| word.len() > 2 && is_unit(&word));
    // DROID keeps its stamps in a group of that name.
    let is_below = name.contains('/') && words.contains(&"timestamp".to_owned());
    (is_below || is_unit_alone || last.is_some_and(|word| TIME_WORDS.contains(&word.as_str())))
        && !names::contains_any(&words, EXCLUDED_WORDS)
}

/// Unit of a time, s.
fn unit_by_word(word: &str) -> Option<f64> {
    Some(match word {
        "ns" | "nsec" | "nsecs" | "nseconds" | "nanos" | "nanosec" | "nanosecs" | "nanoseconds" => {
            1e-9
        }
        "us" | "usec" | "usecs" | "micros" | "microseconds" => 1e-6,
        "ms" | "msec" | "msecs" | "millis" | "milliseconds" => 1e-3,
        "s" | "sec" | "secs" | "seconds" => 1.0,
        _ => return None,
    })
}

/// Whether a name begins with a word for times, as `time_joints` and `time_tcp` do.
fn begins_with_time(name: &str) -> bool {
    const FIRST_WORDS: &[&str] =
        &["time", "times", "timestamp", "timestamps", "stamp", "stamps", "zeit", "zeitstempel"];
    let words = names::split_words(name);
    words.first().is_some_and(|word| FIRST_WORDS.contains(&word.as_str()))
        && !names::contains_any(&words, EXCLUDED_WORDS)
}

/// # Errors
/// If the row times are unknown or ambiguous, or the configured column does not hold times.
pub(super) fn detect(table: &Table, settings: &ColumnSettings) -> Result<Clock, ClockError> {
    if let Some(name) = &settings.time {
        let missing = || format!("`columns.time` names '{name}', but there is no such column");
        let cell = find_cell(table, name).ok_or_else(|| ClockError::Other(missing()))?;
        let billionths = table.columns[cell.column].billionths.clone();
        let own = Column { billionths, ..cell_column(table, cell, name.clone()) };
        return from_column(Some(cell), &own, None).ok_or_else(|| {
            let what = "but its numbers are not times: they must increase";
            ClockError::Other(format!("`columns.time` names '{name}', {what}"))
        });
    }
    if let Some(rate_hz) = settings.rate_hz {
        return Ok(from_rate(table, rate_hz, "from `columns.rate_hz`"));
    }
    let mut clocks = clocks_by_name(table, None);
    clocks.retain(Clock::covers_most_rows);
    let is_of_rows = |clock: &Clock| clock.name(table).is_none_or(is_time);
    if clocks.iter().any(is_of_rows) {
        clocks.retain(is_of_rows);
    }
    let best = best_clock(clocks, table);
    let of_file = || {
        let times = table.times.as_ref()?;
        let clock = from_column(None, times, None)?;
        let description = clock.description.replacen("column", "file", 1);
        Some(Clock { description, ..clock })
    };
    let best = best.or_else(of_file).or_else(|| from_time_steps(table));
    match (best, table.rate_hz) {
        (Some(clock), _) => Ok(clock),
        (None, Some(rate_hz)) => Ok(from_rate(table, rate_hz, "from the metadata")),
        (None, None) => clock_by_values(table),
    }
}

/// Sums the only column that is named as the time since the previous row, such as `dt` or `delta_ms`.
fn from_time_steps(table: &Table) -> Option<Clock> {
    let is_step = |name: &str| {
        let words = names::split_words(name);
        let is_time =
            |word: &str| TIME_WORDS.contains(&word) || unit_by_word(word).is_some() && word != "s";
        match words.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
            ["dt", units @ ..] => units.iter().all(|unit| unit_by_word(unit).is_some()),
            ["delta", rest @ ..] => rest.first().is_some_and(|word| is_time(word)),
            ["time", "step" | "delta", ..] => true,
            _ => false,
        }
    };
    let mut named =
        table.columns.iter().filter(|column| column.width == 1 && is_step(&column.name));
    let column = named.next().filter(|_| named.next().is_none())?;
    // The first row has no step.
    let steps = || column.values.iter().map(|step| if step.is_finite() { *step } else { 0.0 });
    let later = column.values.get(1..)?;
    if steps().any(|step| step < 0.0) || increases_like_times(later, &column.kind) {
        return None;
    }
    let values = steps().scan(0.0, |sum, step| {
        *sum += step;
        Some(*sum)
    });
    let times = Column { values: values.collect(), billionths: Vec::new(), ..column.clone() };
    let clock = from_column(None, &times, None)?;
    let description = clock.description.replacen("stamps from", "stamps summed from", 1);
    Some(Clock { description, ..clock })
}

/// Clock that a layout declares; `None` if it leaves the times open.
///
/// # Errors
/// If the declared columns do not hold times.
pub(super) fn of_layout(table: &Table, time: &CellTime) -> Result<Option<Clock>, String> {
    let clock = match *time {
        CellTime::Open => return Ok(None),
        CellTime::Rate(rate_hz) => Some(from_rate(table, rate_hz, "from --columns")),
        CellTime::SecondsAndNanos(cells) => seconds_and_nanos(table, cells),
        CellTime::Column(cell, unit_s) => {
            let column = &table.columns[cell.column];
            let billionths = match column.width {
                1 => column.billionths.clone(),
                _ => table.exact_times.get(&cell).cloned().unwrap_or_default(),
            };
            let own = Column { billionths, ..cell_column(table, cell, table.cell_name(cell)) };
            from_column(Some(cell), &own, unit_s)
        }
    };
    let refuse = || {
        let what = match time {
            CellTime::Column(cell, _) => {
                let column = &table.columns[cell.column];
                if column.width == 1 { why_not_times(column) } else { NOT_INCREASING.to_owned() }
            }
            _ => "they are not whole seconds and nanoseconds".to_owned(),
        };
        format!("--columns declares times that are not times: {what}")
    };
    clock.map(Some).ok_or_else(refuse)
}

const NOT_INCREASING: &str = "its numbers must increase, in s, ms, us or ns (such as `t:ms`)";

/// Times that a layout declares.
pub(super) enum CellTime {
    /// With its unit, s.
    Column(Cell, Option<f64>),
    SecondsAndNanos([Cell; 2]),
    Rate(f64),
    Open,
}

/// Best clock per column group, keyed by the group's path, and all clocks outside of groups but `main`.
pub(super) fn further_clocks(table: &Table, main: &Clock) -> (BTreeMap<String, Clock>, Vec<Clock>) {
    let main = main.cell.filter(|cell| group_of(&table.columns[cell.column].name).is_none());
    let mut groups: BTreeMap<String, Vec<Clock>> = BTreeMap::new();
    let mut outside = Vec::new();
    for clock in clocks_by_name(table, main.map(|cell| cell.column)) {
        match clock.name(table).and_then(group_of) {
            Some(group) => groups.entry(group.to_owned()).or_default().push(clock),
            None => outside.push(clock),
        }
    }
    let best = |(group, clocks)| Some((group, best_clock(clocks, table)?));
    (groups.into_iter().filter_map(best).collect(), outside)
}

pub(super) fn group_of(name: &str) -> Option<&str> {
    name.rsplit_once('/').map(|(group, _)| group)
}

fn clocks_by_name(table: &Table, without: Option<usize>) -> Vec<Clock> {
    let columns = || table.columns.iter().enumerate();
    let wanted = || columns().filter(|(at, _)| Some(*at) != without);
    // Kawasaki's third angle is also named T.
    let has = |name: &str| table.columns.iter().any(|column| column.name == name);
    let is_angle = |name: &str| name == "T" && has("O") && has("A");
    let is_named = |name: &str| is_time(name) || begins_with_time(name);
    let times = wanted().filter(|(_, column)| is_named(&column.name) && !is_angle(&column.name));
    let mut clocks: Vec<Clock> = times
        .filter_map(|(at, column)| match column.width {
            1 => from_sparse_column(Some(Cell { column: at, part: 0 }), column, None),
            2 => seconds_and_nanos(table, [0, 1].map(|part| Cell { column: at, part })),
            _ => None,
        })
        .collect();
    for (at, column) in wanted().filter(|(_, column)| column.width == 1) {
        let Some(stem) = stem_of(&column.name, 1.0) else { continue };
        let other = columns().find(|(_, other)| {
            other.width == 1 && stem_of(&other.name, 1e-9).as_ref() == Some(&stem)
        });
        clocks.extend(other.and_then(|(other, _)| {
            seconds_and_nanos(table, [at, other].map(|column| Cell { column, part: 0 }))
        }));
    }
    clocks
}

/// Words before the unit, if it is this one.
fn stem_of(name: &str, unit_s: f64) -> Option<Vec<String>> {
    let mut words = names::split_words(name);
    let own_s = unit_by_word(&words.pop()?)?;
    (own_s == unit_s).then_some(words)
}

/// Selects the finest clock, because a stamp in whole seconds repeats. Header stamps take precedence over
/// receive times, and stamps of the robot over those of images.
fn best_clock(clocks: Vec<Clock>, table: &Table) -> Option<Clock> {
    let has_word = |clock: &Clock, known: &[&str]| {
        clock.name(table).is_some_and(|name| names::has_word(name, known))
    };
    clocks.into_iter().min_by_key(|clock| {
        let repeats = clock.repeats();
        let is_coarse = 100 * repeats > MAX_REPEATED_PERCENT * table.rows;
        let is_of_images = has_word(clock, IMAGE_WORDS);
        let is_received = !has_word(clock, &["header"]);
        (is_of_images, is_coarse, is_received, clock.nanos.is_none(), repeats, clock.cell)
    })
}

fn seconds_and_nanos(table: &Table, cells: [Cell; 2]) -> Option<Clock> {
    let [seconds, nanos] = cells.map(|cell| table.columns[cell.column].numbers(cell.part));
    let second = NANOS_PER_SECOND as f64;
    let micros = are_micros(seconds.clone(), nanos.clone());
    let unit = if micros { 1e3 } else { 1.0 };
    let stamp = |(seconds, nanos): (f64, f64)| -> Option<i64> {
        let is_whole = seconds.fract() == 0.0 && (0.0..9e9).contains(&seconds);
        let whole = (is_whole && (0.0..second).contains(&nanos)).then_some(seconds as i64)?;
        whole.checked_mul(NANOS_PER_SECOND)?.checked_add((unit * nanos).round() as i64)
    };
    let stamps: Vec<Option<i64>> = seconds.zip(nanos).map(stamp).collect();
    let known: Vec<i64> = stamps.iter().flatten().copied().collect();
    let steps = known.windows(2).map(|pair| (pair[1] - pair[0]) as f64 / second);
    let (back, step_s) = backward_and_median_step(steps)?;
    // Fractions in another unit never approach a second.
    let is_one_column = cells[0].column == cells[1].column;
    let is_nanos = !is_one_column || known.iter().any(|stamp| stamp % NANOS_PER_SECOND > 1_000_000);
    if falls_often(back, known.len()) || 2 * known.len() < stamps.len() || !is_nanos {
        return None;
    }
    let fraction = if micros { "µs, because it never reaches 1 ms in ns" } else { "ns" };
    let [one, other] = cells.map(|cell| &table.columns[cell.column].name);
    let description = match is_one_column {
        true => format!("stamps from column '{one}', s and {fraction}"),
        false => format!("stamps from columns '{one}', s, and '{other}', {fraction}"),
    };
    let [cell, nanos] = cells;
    Some(Clock {
        stamps,
        cell: Some(cell),
        nanos: Some(nanos),
        is_fraction_in_micros: micros,
        description,
        step_s,
        ..Clock::default()
    })
}

/// Whether fractions of seconds are in microseconds: in nanoseconds, all rows of a second would lie within 1 ms.
fn are_micros(seconds: impl Iterator<Item = f64>, nanos: impl Iterator<Item = f64>) -> bool {
    const MICROS_PER_SECOND: f64 = 1e6;
    /// Rows may start with each second, so smaller fractions show nothing.
    const MIN_LARGEST: f64 = 0.5 * MICROS_PER_SECOND;
    const MIN_ROWS_PER_SECOND: usize = 2;
    let (mut largest, mut rows, mut changes, mut last) = (0.0_f64, 0, 1, None);
    for (second, fraction) in seconds.zip(nanos) {
        largest = largest.max(fraction);
        changes += usize::from(last.is_some_and(|last| last != second));
        last = Some(second);
        rows += 1;
    }
    (MIN_LARGEST..MICROS_PER_SECOND).contains(&largest) && rows >= MIN_ROWS_PER_SECOND * changes
}

/// Selects the only column that increases evenly, or whose steps times the recorded velocities give the changes of
/// positions. Copies in another unit or with another zero count as the same column.
fn clock_by_values(table: &Table) -> Result<Clock, ClockError> {
    /// More increasing columns, copies included, are ramps rather than clocks.
    const MAX_INCREASING_COLUMNS: usize = 2;
    /// In fewer rows, any numbers may increase evenly.
    const MIN_ROWS: usize = 5;
    let none = || {
        let is_named = |column: &&Column| column.width <= 2 && is_time(&column.name);
        let mut named = table.columns.iter().filter(is_named);
        ClockError::NoTimes(match named.next() {
            Some(column) => {
                format!(
                    "column '{}' is named as a time, but {}",
                    column.name,
                    why_not_times(column)
                )
            }
            None => match table.texts.iter().find(|(name, _)| is_time(name)) {
                Some((name, text)) => {
                    format!(
                        "column '{name}' is named as a time, but '{}' is not read as one",
                        excerpt(text)
                    )
                }
                None => "no column holds times, and the metadata has no rate".to_owned(),
            },
        })
    };
    if table.rows < MIN_ROWS {
        return Err(none());
    }
    let mut found: Vec<(Clock, Column, bool)> = Vec::new();
    let mut alike = 0;
    let is_counter = |column: &Column| names::has_word(&column.name, COUNTER_WORDS);
    let distinct = distinct_rows(table);
    let is_even = |values: &[f64]| {
        increases_evenly(&distinct.iter().map(|&row| values[row]).collect::<Vec<f64>>())
    };
    let columns = table.columns.iter().enumerate();
    for (at, column) in columns.filter(|(_, column)| !is_counter(column)) {
        for part in 0..column.width {
            let cell = Cell { column: at, part };
            let own = cell_column(table, cell, String::new());
            let clock = clock_of_numbers(table, cell, &own);
            let Some(clock) = clock else { continue };
            let is_confirmed = do_velocities_confirm(table, &clock);
            if !is_confirmed && !is_even(&own.values) {
                continue;
            }
            alike += 1;
            let is_known = found.iter().any(|(_, other, other_is_confirmed)| {
                *other_is_confirmed >= is_confirmed && is_linear_in(&other.values, &own.values)
            });
            if !is_known {
                found.push((clock, own, is_confirmed));
            }
        }
    }
    if found.iter().any(|(.., is_confirmed)| *is_confirmed) {
        found.retain(|(.., is_confirmed)| *is_confirmed);
    }
    match found.as_slice() {
        [] => clock_at_edge(table).ok_or_else(none),
        [(clock, _, true)] => {
            let description = format!("{}; recorded velocities confirm them", clock.description);
            Ok(Clock { description, ..found.swap_remove(0).0 })
        }
        [_] if alike > MAX_INCREASING_COLUMNS => Err(none()),
        [_] => Ok(found.swap_remove(0).0),
        several => {
            const MAX_SHOWN: usize = 3;
            let names = several.iter().filter_map(|(clock, ..)| clock.unnamed_column.as_ref());
            let shown = names.take(MAX_SHOWN);
            let names: Vec<String> = shown.map(|name| format!("time = \"{name}\"")).collect();
            let more = if several.len() > MAX_SHOWN { ", or another" } else { "" };
            Err(ClockError::Other(format!(
                "{} columns increase like times, and no name shows which one to use: {}{more}",
                several.len(),
                names.join(", or ")
            )))
        }
    }
}

/// Whether recorded velocities, integrated by these stamps, give the changes of the positions of their joints.
fn do_velocities_confirm(table: &Table, clock: &Clock) -> bool {
    /// Of the regression of changes on integrals from 1.
    const MAX_SLOPE_DEVIATION: f64 = 0.02;
    /// Share of the squared changes. Stamps rounded to a third of a step leave a tenth.
    const MAX_RESIDUAL_SHARE: f64 = 0.25;
    let stamps = &clock.stamps;
    if stamps.windows(2).any(|pair| pair[0].zip(pair[1]).is_none_or(|(one, other)| other < one)) {
        return false;
    }
    let words: Vec<Vec<String>> =
        table.columns.iter().map(|column| names::split_words(&column.name)).collect();
    let mut pairs: Vec<[Cell; 2]> = Vec::new();
    for (column, own) in words.iter().enumerate() {
        let width = table.columns[column].width;
        let is_its = |velocity: &usize| {
            let other = &words[*velocity];
            table.columns[*velocity].width == width
                && names::is_joint_velocities(other)
                && names::shared_words(own) == names::shared_words(other)
        };
        if let Some(velocity) =
            (0..words.len()).filter(|_| names::is_joint_positions(own)).find(is_its)
        {
            pairs.extend(
                (0..width).map(|part| [column, velocity].map(|column| Cell { column, part })),
            );
        }
    }
    let (mut products, mut integrals, mut changes) = (0.0, 0.0, 0.0);
    for row in 1..stamps.len() {
        let (Some(before), Some(at)) = (stamps[row - 1], stamps[row]) else { continue };
        let step_s = at.saturating_sub(before) as f64 / NANOS_PER_SECOND as f64;
        for [position, velocity] in &pairs {
            let [before, at] = [row - 1, row].map(|row| table.number(row, *position));
            let speeds = [row - 1, row].map(|row| table.number(row, *velocity));
            let (change, integral) = (at - before, 0.5 * (speeds[0] + speeds[1]) * step_s);
            if change.is_finite() && integral.is_finite() {
                products += change * integral;
                integrals += integral * integral;
                changes += change * change;
            }
        }
    }
    let residual = changes - 2.0 * products + integrals;
    (products / integrals - 1.0).abs() <= MAX_SLOPE_DEVIATION
        && residual <= MAX_RESIDUAL_SHARE * changes
}

/// Rows that are not copies of the row before: a recorder that is faster than its source repeats rows with their stamps.
fn distinct_rows(table: &Table) -> Vec<usize> {
    let is_copy = |column: &Column, row: usize| {
        let numbers = |row: usize| {
            let numbers = column.values.iter().skip(row * column.width).take(column.width);
            numbers.map(|number| number.to_bits())
        };
        numbers(row).eq(numbers(row - 1))
    };
    let differs =
        |row: &usize| *row == 0 || !table.columns.iter().all(|column| is_copy(column, *row));
    (0..table.rows).filter(differs).collect()
}

/// The first or the last number of the rows of one array, if only one of the two increases like times.
fn clock_at_edge(table: &Table) -> Option<Clock> {
    let [column] = table.columns.as_slice() else { return None };
    if column.width < 2 || names::is_joints_or_pose(&column.name) {
        return None;
    }
    let clock = |part: usize| {
        let cell = Cell { column: 0, part };
        let own = cell_column(table, cell, String::new());
        let is_clock = exceed_joints(&own.values) && increases_like_times(&own.values, &own.kind);
        if is_clock { clock_of_numbers(table, cell, &own) } else { None }
    };
    match [clock(0), clock(column.width - 1)] {
        [Some(own), None] | [None, Some(own)] => Some(own),
        _ => None,
    }
}

/// The clock of the cell whose numbers `own` holds without a name.
fn clock_of_numbers(table: &Table, cell: Cell, own: &Column) -> Option<Clock> {
    let clock = from_column(Some(cell), own, None)?;
    let name = table.cell_name(cell);
    let description = clock.description.replacen("''", &format!("'{name}', by its numbers"), 1);
    Some(Clock { description, unnamed_column: Some(name), ..clock })
}

/// The first column that is named as a time and increases, but in an unknown unit, and its median step.
pub(super) fn time_without_unit(table: &Table) -> Option<(Cell, f64)> {
    let named = table.columns.iter().enumerate();
    let mut named = named.filter(|(_, column)| column.width == 1 && is_time(&column.name));
    named.find_map(|(column, own)| {
        let steps = own.values.windows(2).map(|pair| pair[1] - pair[0]);
        let (back, step) = backward_and_median_step(steps)?;
        let is_open =
            !falls_often(back, own.values.len()) && from_column(None, own, None).is_none();
        is_open.then_some((Cell { column, part: 0 }, step))
    })
}

fn why_not_times(column: &Column) -> String {
    let steps = column.values.windows(2).map(|pair| pair[1] - pair[0]);
    match backward_and_median_step(steps) {
        None => "its numbers never increase".to_owned(),
        Some((back, _)) if falls_often(back, column.values.len()) => {
            format!("its numbers fall in {back} rows")
        }
        Some((_, step)) => format!("its numbers increase by {step} per row, in an unknown unit"),
    }
}

/// Number of backward steps, and median of the forward ones. `None` without forward steps.
fn backward_and_median_step(steps: impl Iterator<Item = f64> + Clone) -> Option<(usize, f64)> {
    let back = steps.clone().filter(|step| *step < 0.0).count();
    let mut ahead: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    Some((back, median(&mut ahead)?))
}

fn falls_often(back: usize, rows: usize) -> bool {
    100 * back > MAX_BACKWARD_PERCENT * rows.max(100)
}

/// Whether no step is negative, few are zero, and nearly all are near the median, or one to several of the short ones where
/// rows are lost.
fn increases_evenly(values: &[f64]) -> bool {
    /// Share of regular steps.
    const MIN_REGULAR_PERCENT: usize = 90;
    const REGULAR_STEP: std::ops::RangeInclusive<f64> = 0.5..=2.0;
    /// Steps between rows, and their deviation from a whole number.
    const WHOLE_STEPS: std::ops::RangeInclusive<f64> = 1.0..=10.0;
    const MAX_DEVIATION_STEPS: f64 = 0.15;
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let (Some(middle), Some(short)) = (steps.get(steps.len() / 2), steps.get(steps.len() / 4))
    else {
        return false;
    };
    let is_near = |own: &&f64| REGULAR_STEP.contains(&(**own / middle));
    let is_whole = |own: &&f64| {
        let count = **own / short;
        WHOLE_STEPS.contains(&count.round()) && (count - count.round()).abs() <= MAX_DEVIATION_STEPS
    };
    let regular = steps.iter().filter(is_near).count().max(steps.iter().filter(is_whole).count());
    let repeated = steps.iter().filter(|own| **own == 0.0).count();
    steps.iter().all(|own| *own >= 0.0)
        && 100 * repeated <= MAX_REPEATED_PERCENT * steps.len()
        && 100 * regular >= MIN_REGULAR_PERCENT * steps.len()
}

/// Whether numbers may be the stamps of rows, evenly spaced or not. A joint that starts and stops has many steps that
/// are much shorter than usual.
pub(super) fn increases_like_times(values: &[f64], kind: &str) -> bool {
    const MIN_STEP_RATIO: f64 = 0.05;
    const MIN_REGULAR_PERCENT: usize = 98;
    let column =
        Column { kind: kind.to_owned(), width: 1, values: values.to_vec(), ..Column::default() };
    let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let is_rising = steps.iter().all(|step| *step >= 0.0);
    let Some(middle) = median(&mut steps) else { return false };
    let regular = steps.iter().filter(|step| **step >= MIN_STEP_RATIO * middle).count();
    // If most rows repeat the number, it counts configurations.
    is_rising
        && middle > 0.0
        && 100 * regular >= MIN_REGULAR_PERCENT * steps.len()
        && from_column(None, &column, None).is_some()
}

/// Whether increasing numbers exceed two turns, which no joint in rad does.
pub(super) fn exceed_joints(values: &[f64]) -> bool {
    values.last().zip(values.first()).is_some_and(|(last, first)| last - first > TWO_TURNS_RAD)
}

/// Whether two clocks agree without drift.
fn is_linear_in(one: &[f64], other: &[f64]) -> bool {
    const MAX_RELATIVE_RESIDUAL: f64 = 1e-4;
    let (Some(first), Some(last)) = (one.first().zip(other.first()), one.last().zip(other.last()))
    else {
        return false;
    };
    let slope = (last.1 - first.1) / (last.0 - first.0);
    let span = (last.1 - first.1).abs();
    let mut pairs = one.iter().zip(other);
    pairs.all(|(a, b)| (first.1 + slope * (a - first.0) - b).abs() <= MAX_RELATIVE_RESIDUAL * span)
}

/// Accepts `NAME` and `NAME[INDEX]`.
fn find_cell(table: &Table, name: &str) -> Option<Cell> {
    if let Some(column) = table.column(name) {
        return Some(Cell { column, part: 0 });
    }
    let (vector, part) = name.strip_suffix(']')?.rsplit_once('[')?;
    let (column, part) = (table.column(vector)?, part.parse().ok()?);
    (part < table.columns[column].width).then_some(Cell { column, part })
}

pub(super) fn from_rate(table: &Table, rate_hz: f64, by: &str) -> Clock {
    let step_ns = NANOS_PER_SECOND as f64 / rate_hz;
    // A low rate may exceed the range of stamps.
    let stamp = |row: usize| {
        let nanos = (row as f64 * step_ns).round();
        (nanos < MAX_NANOS).then_some(NANOS_PER_SECOND + nanos as i64)
    };
    Clock {
        stamps: (0..table.rows).map(stamp).collect(),
        description: format!(
            "stamps generated at {rate_hz} rows per second, {by}; latencies are only relative to other \
             columns"
        ),
        rate_hz: Some(rate_hz),
        step_s: 1.0 / rate_hz,
        ..Clock::default()
    }
}

/// The numbers of a cell, as a column of this name.
fn cell_column(table: &Table, cell: Cell, name: String) -> Column {
    let column = &table.columns[cell.column];
    let (kind, values) = (column.kind.clone(), column.numbers(cell.part).collect());
    Column { name, kind, width: 1, values, ..Column::default() }
}

/// `None` if it does not hold times in at least half of the rows. `unit_s` is declared.
fn from_column(cell: Option<Cell>, column: &Column, unit_s: Option<f64>) -> Option<Clock> {
    from_sparse_column(cell, column, unit_s).filter(Clock::covers_most_rows)
}

/// Seconds since 1970 of dates from 2000 to 2100 in days: since 1899-12-30 in spreadsheets, since year 0 in MATLAB.
fn seconds_of_days(column: &Column) -> Option<Column> {
    const DAYS_UNTIL_1970: [f64; 2] = [25_569.0, 719_529.0];
    const DAYS_SINCE_1970: std::ops::Range<f64> = 10_957.0..47_482.0;
    const DAY_S: f64 = 86_400.0;
    /// Larger steps are those of seconds.
    const MAX_STEP: f64 = 1e-4;
    let known = || column.values.iter().filter(|value| value.is_finite());
    let first = known().next()?;
    let epoch = DAYS_UNTIL_1970.iter().find(|epoch| DAYS_SINCE_1970.contains(&(first - *epoch)))?;
    let mean_step = (known().next_back()? - first) / known().count().max(2) as f64;
    (0.0 < mean_step && mean_step < MAX_STEP).then(|| Column {
        values: column.values.iter().map(|days| (days - epoch) * DAY_S).collect(),
        billionths: Vec::new(),
        ..column.clone()
    })
}

/// Seconds since 1970 of dates and times of day in digits: `20260131235959`.
fn seconds_of_digits(column: &Column) -> Option<Column> {
    const FIRST: f64 = 19_700_101_000_000.0;
    let seconds = |value: f64| -> Option<f64> {
        if !value.is_finite() {
            return Some(f64::NAN);
        }
        if value < FIRST || value.fract() != 0.0 {
            return None;
        }
        let date = value as i64;
        let part = |unit: i64| (date / unit % 100) as i8;
        let year = i16::try_from(date / 10_000_000_000).ok()?;
        let [month, day, hour, minute] = [100_000_000, 1_000_000, 10_000, 100].map(part);
        let date = DateTime::new(year, month, day, hour, minute, part(1), 0).ok()?;
        Some(date.to_zoned(TimeZone::UTC).ok()?.timestamp().as_second() as f64)
    };
    let values = column.values.iter().map(|value| seconds(*value)).collect::<Option<_>>()?;
    Some(Column { values, billionths: Vec::new(), ..column.clone() })
}

/// The other rows may belong to other streams.
fn from_sparse_column(cell: Option<Cell>, column: &Column, unit_s: Option<f64>) -> Option<Clock> {
    let of_dates = || {
        let days = seconds_of_days(column).map(|own| (own, "in days"));
        days.or_else(|| Some((seconds_of_digits(column)?, "in digits")))
    };
    if let Some((seconds, form)) = unit_s.is_none().then(of_dates).flatten() {
        let clock = from_sparse_column(cell, &seconds, Some(1.0))?;
        let description = clock.description.replacen("', s", &format!("', dates {form}"), 1);
        return Some(Clock { description, unit_s: None, ..clock });
    }
    let values = &column.values;
    let finite: Cow<'_, [f64]> = match values.iter().all(|value| value.is_finite()) {
        true => values.as_slice().into(),
        false => values.iter().copied().filter(|value| value.is_finite()).collect(),
    };
    let steps = || finite.windows(2).map(|pair| pair[1] - pair[0]);
    let (back, step) = backward_and_median_step(steps())?;
    if falls_often(back, steps().len()) {
        return None;
    }
    let (first, words) = (*finite.first()?, names::split_words(&column.name));
    let by_name = words.iter().rev().find_map(|word| unit_by_word(word));
    let by_name = by_name.or_else(|| words.contains(&"ipoc".to_owned()).then_some(1e-3));
    let is_whole = finite.iter().all(|value| value.fract() == 0.0);
    let rise = (finite[finite.len() - 1] - first) / (finite.len() - 1).max(1) as f64;
    // Dates and times of day in text are in s, even below a name such as `timestamp_ms`.
    let is_text = !column.billionths.is_empty() && column.billionths.iter().all(Option::is_none);
    let unit = if is_text { Some(1.0) } else { unit_s.or(by_name) };
    let is_declared = unit.is_some();
    let unit = unit
        .filter(|unit| (1e-5..=1e3).contains(&(unit * step)))
        .or_else(|| unit_of(first, step, rise, is_whole))?;
    let step_s = step * unit;
    let per_second = (1.0 / unit).round() as i128;
    let nanos = |(row, &value): (usize, &f64)| -> Option<i64> {
        let is_in_range = value.is_finite() && (value * unit).abs() < 9e9;
        // Converts integers without rounding.
        let whole = (unit * NANOS_PER_SECOND as f64).round() as i64;
        let nanos = match column.billionths.get(row).copied().flatten() {
            Some(own) => i64::try_from((own + own.signum() * per_second / 2) / per_second).ok()?,
            None if is_whole => (value as i64).checked_mul(whole)?,
            None => (value * unit * NANOS_PER_SECOND as f64).round() as i64,
        };
        // A stamp of 0 means unset. Tables of one run share a clock, so the others are not shifted.
        is_in_range.then_some(if nanos == 0 { 1 } else { nanos })
    };
    let grain = rounding_error(column);
    let is_grid = steps().all(|own| (own - step).abs() <= 2e-3 * step + grain);
    let unit_name = match unit {
        1.0 => "s",
        1e-3 => "ms",
        1e-6 => "µs",
        _ => "ns",
    };
    let mut description = format!("stamps from column '{}', {unit_name}", column.name);
    if is_grid {
        description += &format!(
            ", an even grid of {:.4} rows per second; latencies are only relative to other columns",
            1.0 / step_s
        );
    }
    Some(Clock {
        stamps: values.iter().enumerate().map(nanos).collect(),
        cell,
        description,
        unit_s: (is_declared || unit != 1.0).then_some(unit),
        step_s,
        ..Clock::default()
    })
}

/// Rounding error of a step, in the column's unit.
fn rounding_error(column: &Column) -> f64 {
    let largest = column.values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let bits = if column.kind.contains("32") || column.kind.contains("f4") {
        f32::EPSILON.into()
    } else {
        f64::EPSILON
    };
    2.0 * largest * bits
}

/// Unit in seconds; `None` if ambiguous. `rise` is the mean increase per row.
fn unit_of(first: f64, step: f64, rise: f64, is_whole: bool) -> Option<f64> {
    /// Integers that most rows repeat are seconds: as ms they would be 2000 rows per second or more.
    const MAX_MEAN_INCREASE: f64 = 0.5;
    // Since 1970: from 2001 to 2128.
    let epoch =
        [1.0, 1e-3, 1e-6, 1e-9].into_iter().find(|unit| (1e9..5e9).contains(&(first * unit)));
    epoch.or(match (step, is_whole) {
        (..0.0001, _) => None,
        (..=10.0, true) if rise <= MAX_MEAN_INCREASE => Some(1.0),
        (..=2.0, false) => Some(1.0),
        (2.0..=1000.0, true) => Some(1e-3),
        (1000.0..=1e6, true) => Some(1e-6),
        (1e6..=2e9, true) => Some(1e-9),
        _ => None,
    })
}

impl Clock {
    fn covers_most_rows(&self) -> bool {
        2 * self.stamps.iter().flatten().count() >= self.stamps.len()
    }

    fn name<'a>(&self, table: &'a Table) -> Option<&'a str> {
        self.cell.map(|cell| table.columns[cell.column].name.as_str())
    }

    /// Words of its name that are neither times nor units, in the singular: `tcp` of `tcp_times`.
    pub fn stream_words(&self, table: &Table) -> Vec<String> {
        let mut words = names::split_words(self.name(table).unwrap_or_default());
        words.retain(|word| {
            let word = word.as_str();
            !TIME_WORDS.contains(&word) && unit_by_word(word).is_none()
        });
        words.iter().map(|word| names::singular(word).to_owned()).collect()
    }

    pub fn first(&self) -> i64 {
        self.stamps.iter().flatten().next().copied().unwrap_or(0)
    }

    pub fn last(&self) -> i64 {
        self.stamps.iter().flatten().next_back().copied().unwrap_or(0)
    }

    fn repeats(&self) -> usize {
        self.stamps.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }

    pub fn contradiction(&self, table: &Table) -> Option<String> {
        const MAX_RATE_DEVIATION: f64 = 0.02;
        if let (Some(cell), true) = (self.nanos, self.is_fraction_in_micros) {
            let name = &table.columns[cell.column].name;
            let is_named =
                names::split_words(name).iter().any(|word| unit_by_word(word) == Some(1e-9));
            return is_named.then(|| format!("the name '{name}' indicates ns, but it counts µs"));
        }
        let (rate_hz, own_hz) = (table.rate_hz?, 1.0 / self.step_s);
        ((own_hz / rate_hz - 1.0).abs() > MAX_RATE_DEVIATION && self.cell.is_some()).then(|| {
            format!(
                "the metadata declares {} frames per second, but the stamps advance at {own_hz:.4} per second",
                (1e4 * rate_hz).round() / 1e4
            )
        })
    }
}
