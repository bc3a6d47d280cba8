//! The columns and the rate of a table whose rows have no times, for the error that asks for the rate.

use super::Options;
use crate::log::{
    self, Container, FileLayout, LayoutItem, Log, LogError, Meaning, RowLayout, SourceName,
};
use crate::report::Trouble;
use crate::run::{identify_columns, is_of_camera, unnamed_poses};
use crate::stats::mean;
use crate::stream::{Columns, JointColumns};

/// Makes the stamps with which columns are identified.
const ASSUMED_RATE_HZ: f64 = 50.0;

/// Opens the log of an audit.
///
/// # Errors
/// If it cannot be read. If the rows of a table have no times, the error states its columns, and the rate that recorded
/// velocities imply, or that it has no joint positions.
pub(crate) fn open(options: &Options) -> Result<Log, Trouble> {
    log::open(&options.logs, &options.read).map_err(|error| with_columns(error, options))
}

/// Opens a log to list its topics. If the rows of a table have no times, they are stamped at an assumed rate, and
/// the error of [`open`] is returned as well.
///
/// # Errors
/// If it cannot be read at an assumed rate.
pub(crate) fn open_listing(options: &Options) -> Result<(Log, Option<Trouble>), Trouble> {
    let error = match log::open(&options.logs, &options.read) {
        Ok(log) => return Ok((log, None)),
        Err(error) => error,
    };
    let is_readable = matches!(error, LogError::NoTimes { .. });
    let trouble = with_columns(error, options);
    match is_readable.then(|| open_at_assumed_rate(options, None)).flatten() {
        Some(log) => Ok((log, Some(trouble))),
        None => Err(trouble),
    }
}

/// States the columns of a table without times.
fn with_columns(error: LogError, options: &Options) -> Trouble {
    let question = match &error {
        LogError::NoTimes { path, what, rows, .. } => question(options, what, *rows)
            .map(|(what, remedy)| Trouble::log(SourceName::from_path(path), what, remedy)),
        _ => None,
    };
    question.unwrap_or_else(|| error.into())
}

/// The columns of a table of configurations, as a remedy. `None` if joints and positions of the tool are not among them.
pub(super) fn columns_of_configurations(options: &Options) -> Option<String> {
    let (log, layouts, _) = propose_layouts(options)?;
    may_be_configurations(&log, &layouts).then(|| {
        let options: Vec<String> = layouts.iter().map(|layout| option(layout, "")).collect();
        format!("if these are the columns, use {}", options.join(" "))
    })
}

/// `--columns` with a layout and the rate of its rows.
fn option(FileLayout { file, layout }: &FileLayout, rate: &str) -> String {
    let file = file.as_ref().map(|file| format!("{file}=")).unwrap_or_default();
    format!("--columns '{file}{layout}{rate}'")
}

/// Longer layouts are not proposed: nobody can check them, and their columns are hardly those of one recording.
const MAX_LAYOUT_BYTES: usize = 300;

/// Layouts of the tables without times, and whether their names state them. `None` if the columns are unknown as well, or
/// are too many to state.
fn propose_layouts(options: &Options) -> Option<(Log, Vec<FileLayout>, bool)> {
    let mut log = open_at_assumed_rate(options, None)?;
    identify_columns(&mut log, &options.run);
    let mut tables = log.tables.iter().filter(|table| table.lacks_times);
    let is_certain = tables.all(|table| table.layout_reason.is_none());
    let mut layouts: Vec<FileLayout> = Vec::new();
    for (index, table) in log.tables.iter().enumerate().filter(|(_, table)| table.lacks_times) {
        let layout = match &table.layout {
            Some(layout) => layout.parse().ok(),
            None => open_layout(&log, index),
        };
        let own = FileLayout {
            file: table.file.file_name().map(|name| name.to_string_lossy().into_owned()),
            layout: layout.filter(is_short)?,
        };
        if !layouts.contains(&own) {
            layouts.push(own);
        }
    }
    if layouts.windows(2).all(|pair| pair[0].layout == pair[1].layout) {
        layouts.truncate(1);
        layouts.iter_mut().for_each(|own| own.file = None);
    }
    Some((log, layouts, is_certain))
}

fn is_short(layout: &RowLayout) -> bool {
    layout.to_string().len() <= MAX_LAYOUT_BYTES
}

/// The problem and the remedy. `None` if the columns are unknown as well.
fn question(options: &Options, what: &str, rows: usize) -> Option<(String, String)> {
    let Some((log, layouts, is_certain)) = propose_layouts(options) else {
        return Some(of_unnamed_poses(&layout_of_unnamed_poses(options)?, what));
    };
    if let [layout] = layouts.as_slice()
        && log.tables.len() == 1
        && !log.topics.iter().any(|topic| matches!(topic.columns, Some(Columns::Joints(_))))
        && !has_joints(&layout.layout)
        && count_positions(&layout.layout) == 1
    {
        return Some(without_joints(layout));
    }
    let rate_hz = implied_rate_hz(&open_at_assumed_rate(options, Some(&layouts))?);
    let with = |rate: &str| -> String {
        layouts.iter().map(|layout| option(layout, rate)).collect::<Vec<_>>().join(" ")
    };
    let condition = if is_certain { "" } else { "if these are the columns, " };
    if let Some((unit, layout)) = with_time_unit(&log, &layouts, rate_hz) {
        let layout = option(&layout, "");
        return Some(match rate_hz {
            Some(_) => (
                format!("{what}; recorded velocities imply that it counts {unit}"),
                format!("{condition}use {layout}"),
            ),
            None => (
                what.to_owned(),
                format!("{condition}use {layout}, or the true unit of its times (s, ms, us, ns)"),
            ),
        });
    }
    let or_times = format!("or pass a file with the times of the {rows} rows as well");
    Some(match rate_hz {
        Some(rate_hz) => (
            format!("{what}; recorded velocities imply {rate_hz} rows per second"),
            format!("{condition}use {} or the true rate, {or_times}", with(&format!("@{rate_hz}"))),
        ),
        None => {
            let calibrate = match () {
                () if may_be_configurations(&log, &layouts) => format!(
                    "; if each row is a configuration at rest, use `poseaudit calibrate` with {}",
                    with("")
                ),
                () if are_rows_independent(&log) => {
                    "; these rows seem to be configurations at rest: use `poseaudit calibrate` with the measured \
                     poses of the same rows as well"
                        .to_owned()
                }
                () => String::new(),
            };
            let hand_eye = match log.topics.iter().any(|topic| is_of_camera(&topic.name)) {
                true => format!(
                    "; if the rows are those of a hand-eye calibration, at rest, use {}",
                    with("@1")
                ),
                false => String::new(),
            };
            let with = with("@RATE");
            let remedy = format!(
                "{condition}use {with} with the true rows per second as RATE, {or_times}{calibrate}{hand_eye}"
            );
            (what.to_owned(), remedy)
        }
    })
}

/// The unit of a column that is named as a time, by the rate that velocities imply, otherwise a likely one, and the
/// layout with these times.
fn with_time_unit(
    log: &Log,
    layouts: &[FileLayout],
    rate_hz: Option<f64>,
) -> Option<(&'static str, FileLayout)> {
    const UNITS: [(&str, f64); 4] = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];
    /// Of the implied rate.
    const MAX_DEVIATION: f64 = 0.1;
    /// Longer steps would be read as s if they were fractions of them.
    const MAX_STEP_S: f64 = 2.0;
    /// It counts rows.
    const STEP_OF_COUNTER: f64 = 1.0;
    let ([table], [FileLayout { file, layout }]) = (log.tables.as_slice(), layouts) else {
        return None;
    };
    let (cell, step) = table.time_without_unit?;
    let index = table.numbers.iter().position(|number| number.at == Some(cell))?;
    let is_likely = |unit_s: f64| match rate_hz {
        Some(rate_hz) => (unit_s * step * rate_hz - 1.0).abs() <= MAX_DEVIATION,
        None => step != STEP_OF_COUNTER && unit_s * step <= MAX_STEP_S,
    };
    let (unit, unit_s) = UNITS.into_iter().find(|(_, unit_s)| is_likely(*unit_s))?;
    let layout = layout.with_times(index, unit_s)?;
    Some((unit, FileLayout { file: file.clone(), layout }))
}

/// For a table of poses only.
fn without_joints(layout: &FileLayout) -> (String, String) {
    (
        format!("its columns are poses ({}), without joint positions or times", layout.layout),
        format!(
            "pass the joint positions of the same rows as well, to `poseaudit calibrate` if each row is a configuration \
             at rest; or compare two series of poses, both with {}",
            option(layout, "@RATE")
        ),
    )
}

/// For a table whose only known columns are poses without names. As many others as an arm has joints may be these.
fn of_unnamed_poses(layout: &RowLayout, what: &str) -> (String, String) {
    const JOINTS: std::ops::RangeInclusive<usize> = 4..=8;
    let own = |layout: &RowLayout| FileLayout { file: None, layout: layout.clone() };
    let as_joints = |item: &LayoutItem| match item.meaning {
        Meaning::Ignored if JOINTS.contains(&item.count) => {
            LayoutItem { meaning: Meaning::Joints, ..item.clone() }
        }
        _ => item.clone(),
    };
    let with_joints = RowLayout::new(layout.items().iter().map(as_joints).collect(), None);
    match with_joints {
        Ok(with_joints) if with_joints != *layout => (
            format!("{what}; {layout} are poses"),
            format!(
                "if the others are joints, use {} with the true rows per second as RATE, or, if each row is a \
                 configuration at rest, `poseaudit calibrate` with {}, or quat:wxyz",
                option(&own(&with_joints), "@RATE"),
                option(&own(&with_joints), "").replace("rot[4]", "quat:xyzw"),
            ),
        ),
        _ if count_positions(layout) == 1 => without_joints(&own(layout)),
        _ => (
            format!("{what}; {layout} are poses"),
            format!(
                "use {} with the true rows per second as RATE; the poses are compared with each other",
                option(&own(layout), "@RATE")
            ),
        ),
    }
}

/// Layout of a table with the numbers of positions and unit quaternions, and no names.
fn layout_of_unnamed_poses(options: &Options) -> Option<RowLayout> {
    let log = open_at_assumed_rate(options, None)?;
    let ([topic], [table]) = (log.topics.as_slice(), log.tables.as_slice()) else { return None };
    let Some(Columns::Array(array)) = &topic.columns else { return None };
    // Text between numbers would move the columns.
    if !array.unnamed || table.numbers.len() != array.width {
        return None;
    }
    let poses = unnamed_poses(array);
    let arm = |pose: usize| (poses.len() > 1).then(|| format!("pose{}", pose + 1));
    let mut items: Vec<LayoutItem> = Vec::new();
    let mut at = 0;
    while at < array.width {
        let place = |part: usize| poses.iter().position(|pose| pose[part] == at);
        let (pose, meanings): (usize, &[Meaning]) = match (place(0), place(1)) {
            (Some(pose), _) => (pose, &[Meaning::Axis(0), Meaning::Axis(1), Meaning::Axis(2)]),
            (_, Some(pose)) => (pose, &[Meaning::Rotation(None)]),
            _ => {
                at += 1;
                match items.last_mut() {
                    Some(last) if last.meaning == Meaning::Ignored => last.count += 1,
                    _ => items.push(LayoutItem::new(Meaning::Ignored, 1)),
                }
                continue;
            }
        };
        let count = if meanings.len() == 1 { 4 } else { 1 };
        let own = meanings
            .iter()
            .map(|meaning| LayoutItem { arm: arm(pose), ..LayoutItem::new(*meaning, count) });
        items.extend(own);
        at += count * meanings.len();
    }
    (!poses.is_empty()).then(|| RowLayout::new(items, None).ok())?
}

/// Whether successive rows are as different as any two, as of configurations at rest, and unlike those of a motion.
fn are_rows_independent(log: &Log) -> bool {
    /// Mean squared difference of successive values per variance: 2 for independent values, 0 for a slow motion (von
    /// Neumann, *Distribution of the ratio of the mean square successive difference to the variance*, Ann. Math. Stat. 12,
    /// 1941).
    const MIN_RATIO: f64 = 1.0;
    let joints = log.topics.iter().filter_map(|topic| match &topic.columns {
        Some(Columns::Joints(joints)) => Some(&joints.joints),
        _ => None,
    });
    let ratios = joints.flatten().filter_map(|joint| {
        let middle = mean(joint.position.iter().copied());
        let variance = mean(joint.position.iter().map(|position| (position - middle).powi(2)));
        let step = mean(joint.position.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)));
        (variance > 0.0).then(|| step / variance)
    });
    mean(ratios) > MIN_RATIO
}

/// Layout that identifies the columns of a table by their names, if these show the joints.
fn open_layout(log: &Log, table: usize) -> Option<RowLayout> {
    let has_joints = log.topics.iter().any(|topic| {
        matches!(topic.columns, Some(Columns::Joints(_)))
            && topic.cells.first().is_some_and(|cell| cell.table == table)
    });
    let count = log.tables[table].numbers.len();
    has_joints.then(|| RowLayout::new(vec![LayoutItem::new(Meaning::Open, count)], None).ok())?
}

/// Whether `calibrate` reads the tables with these layouts.
fn may_be_configurations(log: &Log, layouts: &[FileLayout]) -> bool {
    layouts.iter().any(|own| has_joints(&own.layout))
        && layouts.iter().any(|own| count_positions(&own.layout) > 0)
        && log.files.iter().all(|file| is_read_by_calibrate(file.container))
}

fn has_joints(layout: &RowLayout) -> bool {
    layout.items().iter().any(|item| item.meaning == Meaning::Joints && !item.is_command)
}

/// Number of measured positions that it states.
fn count_positions(layout: &RowLayout) -> usize {
    let is_position = |item: &&LayoutItem| {
        matches!(item.meaning, Meaning::Axis(0) | Meaning::Matrix | Meaning::Vendor(_))
            && !item.is_command
    };
    layout.items().iter().filter(is_position).count()
}

fn is_read_by_calibrate(container: Container) -> bool {
    use Container::{Csv, Json, Matlab, Npy, Npz, Xlsx, Yaml};
    matches!(container, Csv | Json | Matlab | Npy | Npz | Xlsx | Yaml)
}

fn open_at_assumed_rate(options: &Options, layouts: Option<&[FileLayout]>) -> Option<Log> {
    let mut read = options.read.clone();
    read.progress = None;
    read.columns.assumed_rate_hz = Some(ASSUMED_RATE_HZ);
    if let Some(layouts) = layouts {
        read.columns.layouts = layouts.to_vec();
    }
    log::open(&options.logs, &read).ok()
}

/// Rows per second at which the joints move as fast as their velocities, to three digits.
fn implied_rate_hz(log: &Log) -> Option<f64> {
    /// Between velocities and rates.
    const MIN_CORRELATION: f64 = 0.95;
    let joints = log.topics.iter().filter_map(|topic| match &topic.columns {
        Some(Columns::Joints(joints)) => Some(joints),
        _ => None,
    });
    let pairs = joints.flat_map(velocities_and_rates);
    let [vv, rr, vr] = pairs.fold([0.0; 3], |[vv, rr, vr], (velocity, rate)| {
        [vv + velocity * velocity, rr + rate * rate, vr + velocity * rate]
    });
    let rate_hz = ASSUMED_RATE_HZ * vr / rr;
    // All velocities may be zero.
    let is_known = rate_hz.is_finite() && rate_hz > 0.0 && vr >= MIN_CORRELATION * (vv * rr).sqrt();
    let digits = || 10.0_f64.powf(2.0 - rate_hz.log10().floor());
    is_known.then(|| (rate_hz * digits()).round() / digits())
}

/// Per assumed second. Rows without a velocity are omitted.
fn velocities_and_rates(joints: &JointColumns) -> impl Iterator<Item = (f64, f64)> + '_ {
    let stamps = &joints.times.header;
    joints.joints.iter().flat_map(move |joint| {
        (1..joint.position.len().saturating_sub(1)).filter_map(move |row| {
            let moved = joint.position[row + 1] - joint.position[row - 1];
            let took_s = stamps[row + 1].saturating_sub(stamps[row - 1]) as f64 * 1e-9;
            let pair = (joint.velocity[row], moved / took_s);
            (pair.0.is_finite() && pair.1.is_finite()).then_some(pair)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_of_many_named_positions_are_not_proposed() {
        let layout = |positions: usize| {
            let axis = |position: usize, axis: usize| LayoutItem {
                arm: Some(format!("leftPositions{position}")),
                ..LayoutItem::new(Meaning::Axis(axis), 1)
            };
            let items =
                (0..positions).flat_map(|position| (0..3).map(move |at| axis(position, at)));
            RowLayout::new(items.collect(), None).expect("a layout")
        };
        assert_eq!([1, 4, 40].map(|positions| is_short(&layout(positions))), [true, true, false]);
    }
}
