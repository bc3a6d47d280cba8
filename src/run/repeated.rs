//! Detects rows that repeat values with a new stamp during motion: a poller faster than its source, or an
//! up-sampler.
//!
//! Resting arms and slow joints with coarse encoders also repeat. So repeats count only if the next value
//! differs by several of the source's least increments per repeated row.

use std::sync::LazyLock;

use rayon::prelude::*;

use crate::time::Stamp;

use super::part_series::{Part, PartSeries, PartValues, RowsOfPart};
use super::pose_distance::PoseDistance;
use super::poses::are_copied_stamps;
use super::rows::Rows;
use super::streams::with_key;

/// Repeated values of one part of a stream.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RepeatedValues {
    /// Index of the stream.
    pub stream: usize,
    /// Child frame of the transform.
    pub frame: Option<String>,
    /// Rows in motion.
    pub rows: usize,
    /// Rows that repeat the previous one.
    pub repeated: usize,
    /// Row rate in motion, Hz.
    pub rows_hz: f64,
    /// Rate of new values in motion, Hz.
    pub values_hz: f64,
    /// Mean age of a row's value in motion, s.
    pub mean_age_s: f64,
    /// Index of the stream's part.
    pub(super) piece: usize,
    /// Rows with a new value, in order, with corrected times. Empty if few are repeated.
    pub(super) new_rows: Vec<(usize, Stamp)>,
}

impl RepeatedValues {
    /// Whether repeated values are removed.
    pub fn is_deduplicated(&self) -> bool {
        !self.new_rows.is_empty()
    }

    /// Share of repeats among rows in motion.
    pub fn share(&self) -> f64 {
        self.repeated as f64 / self.rows.max(1) as f64
    }
}

/// Minimum share for removal.
const MIN_REMOVED_SHARE: f64 = 0.05;
const HALF_WINDOW_S: f64 = 0.1;
const MIN_MOTION: f64 = 5e-3;
const MIN_ROWS: usize = 40;

pub(super) fn deduplicate(
    repeats: &[RepeatedValues],
    stream: usize,
    piece: usize,
    rows: &mut Rows,
) {
    let of_part = with_key(repeats, (stream, piece), |repeats| (repeats.stream, repeats.piece));
    let Some(repeats) = of_part.iter().find(|repeats| repeats.is_deduplicated()) else { return };
    rows.retain_mut(|(stamp, row)| {
        match repeats.new_rows.binary_search_by_key(row, |(row, _)| *row) {
            Ok(at) => {
                *stamp = repeats.new_rows[at].1;
                true
            }
            Err(_) => false,
        }
    });
}

pub(super) fn detect_repeated_values(
    parts: &[Part<'_>],
    rows: RowsOfPart<'_>,
) -> Vec<RepeatedValues> {
    let is_of_joints = |part: &&Part<'_>| matches!(part.values, PartValues::Joints(_));
    let motion: JointMotion<'_> = LazyLock::new(Box::new(|| {
        let joints = parts.iter().filter(is_of_joints);
        joints.map(|part| joint_speeds(&PartSeries::new(part, rows))).collect()
    }));
    let detect = |part: &Part<'_>, stamps: &[Stamp]| {
        detect_in_series(&PartSeries::new(part, rows), &motion, stamps)
    };
    let of_joints: Vec<Option<RepeatedValues>> = parts
        .par_iter()
        .map(|part| Some(part).filter(is_of_joints).and_then(|part| detect(part, &[])))
        .collect();
    // Poses computed from stale joint states share their stamps.
    let repeats = parts.iter().zip(&of_joints);
    let repeats =
        repeats.filter(|(_, found)| found.as_ref().is_some_and(RepeatedValues::is_deduplicated));
    let mut stamps: Vec<Stamp> =
        repeats.flat_map(|(part, _)| rows(part).into_iter().map(|(stamp, _)| stamp)).collect();
    stamps.sort_unstable();
    let found = |(part, own): (&Part<'_>, Option<RepeatedValues>)| match part.values {
        PartValues::Joints(_) => own,
        _ => detect(part, &stamps),
    };
    parts.par_iter().zip(of_joints).filter_map(found).collect()
}

struct RepeatGroup {
    /// Its first row in the series.
    first: usize,
    count: usize,
}

fn repeat_groups(series: &PartSeries<'_>) -> impl Iterator<Item = RepeatGroup> {
    let rows = &series.rows;
    let mut first = 0;
    std::iter::from_fn(move || {
        let value = rows.get(first)?.1;
        let repeats = rows[first + 1..].iter();
        let count = 1 + repeats.take_while(|(_, row)| series.values.is_same(value, *row)).count();
        first += count;
        Some(RepeatGroup { first: first - count, count })
    })
}

/// Smallest non-zero step of each number, the source's resolution.
fn least_increments(series: &PartSeries<'_>, groups: &[RepeatGroup]) -> Vec<f64> {
    let mut least: Vec<f64> = Vec::new();
    for pair in groups.windows(2) {
        let steps = group_steps(series, [&pair[0], &pair[1]]);
        least.resize(steps.len(), f64::INFINITY);
        for (least, step) in least.iter_mut().zip(steps) {
            if step > 1e-12 {
                *least = least.min(step);
            }
        }
    }
    least
}

/// Steps between two groups: length and angle for a transform, where encoder steps are uniform; else each
/// number.
fn group_steps(series: &PartSeries<'_>, pair: [&RepeatGroup; 2]) -> Vec<f64> {
    let [a, b] = pair.map(|group| series.rows[group.first].1);
    if let (PartValues::Poses(poses), Some(_)) = (&series.values, series.frame) {
        let apart = PoseDistance::between((poses, a), (poses, b));
        return vec![apart.length_m, apart.angle_rad];
    }
    let number =
        |number: usize| (series.values.number(b, number) - series.values.number(a, number)).abs();
    (0..series.values.width()).map(number).collect()
}

/// Joint speed around a time.
struct JointSpeed {
    at: Stamp,
    /// Of the fastest joint, in least increments per second.
    increments_per_s: f64,
    /// Rate of new values.
    values_hz: f64,
    /// Motion of the fastest joint, rad or m.
    moved: f64,
}

type JointMotion<'a> =
    LazyLock<Vec<Vec<JointSpeed>>, Box<dyn FnOnce() -> Vec<Vec<JointSpeed>> + Send + 'a>>;

fn joint_speeds(series: &PartSeries<'_>) -> Vec<JointSpeed> {
    let groups: Vec<RepeatGroup> = repeat_groups(series).collect();
    let quanta = least_increments(series, &groups);
    let stamp = |group: &RepeatGroup| series.rows[group.first].0;
    let (mut from, mut to) = (0, 0);
    let pace = |at: usize| {
        let now = stamp(&groups[at]);
        while now.seconds_since(stamp(&groups[from])) > HALF_WINDOW_S && from < at {
            from += 1;
        }
        while to + 1 < groups.len() && stamp(&groups[to]).seconds_since(now) < HALF_WINDOW_S {
            to += 1;
        }
        let pair = [from, to].map(|at| series.rows[groups[at].first]);
        let span_s = pair[1].0.seconds_since(pair[0].0);
        let (mut increments, mut moved) = (0.0_f64, 0.0_f64);
        for (number, quantum) in quanta.iter().enumerate() {
            let [a, b] = pair.map(|(_, row)| series.values.number(row, number));
            moved = moved.max((b - a).abs());
            increments = increments.max((b - a).abs() / quantum);
        }
        let per_s = |count: f64| if span_s > 0.0 { count / span_s } else { 0.0 };
        JointSpeed {
            at: now,
            increments_per_s: per_s(increments),
            values_hz: per_s((to - from) as f64),
            moved,
        }
    };
    (0..groups.len()).map(pace).collect()
}

/// Whether joints move, and so fast or with new values so often that rows `period_s` apart must differ. `None`
/// without joint states.
fn must_differ(motion: &JointMotion<'_>, at: Stamp, period_s: f64) -> Option<bool> {
    /// Minimum visible motion per period, least increments.
    const MIN_INCREMENTS_PER_PERIOD: f64 = 3.0;
    /// Coarse encoders repeat the other values.
    const MIN_VALUES_PER_PERIOD: f64 = 1.0 - MIN_REMOVED_SHARE;
    let near = motion.iter().filter_map(|paces| {
        let next = paces.partition_point(|pace| pace.at < at);
        paces.get(next.min(paces.len().checked_sub(1)?))
    });
    near.map(|pace| {
        pace.moved > MIN_MOTION
            && (pace.increments_per_s * period_s > MIN_INCREMENTS_PER_PERIOD
                || pace.values_hz * period_s > MIN_VALUES_PER_PERIOD)
    })
    .reduce(|a, b| a || b)
}

/// Whether a transform moves around a group, rather than vibrates.
fn is_moving(series: &PartSeries<'_>, groups: &[RepeatGroup], at: usize) -> bool {
    let stamp = |group: &RepeatGroup| series.rows[group.first].0;
    let now = stamp(&groups[at]);
    let from = groups.partition_point(|group| now.seconds_since(stamp(group)) > HALF_WINDOW_S);
    let to = groups.partition_point(|group| stamp(group).seconds_since(now) < HALF_WINDOW_S);
    let ends = [&groups[from], &groups[to.max(from + 1) - 1]];
    let moved = |pair: [&RepeatGroup; 2]| group_steps(series, pair).into_iter().fold(0.0, f64::max);
    moved(ends) > MIN_MOTION
}

fn detect_in_series(
    series: &PartSeries<'_>,
    motion: &JointMotion<'_>,
    joint_stamps: &[Stamp],
) -> Option<RepeatedValues> {
    /// Minimum step to the next value per repeat, least increments.
    const MIN_INCREMENTS_PER_REPEAT: f64 = 2.0;
    /// Maximum repeats, in usual ones; beyond, the arm rests.
    const MAX_REPEATS_RATIO: usize = 3;
    let rows = &series.rows;
    if rows.len() < MIN_ROWS {
        return None;
    }
    let count = repeat_groups(series).count();
    if count < 3 || count as f64 > (1.0 - 0.01) * rows.len() as f64 {
        return None;
    }
    let groups: Vec<RepeatGroup> = repeat_groups(series).collect();
    let quanta = least_increments(series, &groups);
    let is_of_joints = matches!(series.values, PartValues::Joints(_));
    let has_frame = series.frame.is_some();
    let moves = |at: usize| {
        let (group, pair) = (&groups[at], groups.get(at..at + 2)?);
        let span_s = rows[pair[1].first].0.seconds_since(rows[group.first].0);
        let goes_on =
            group_steps(series, [&pair[0], &pair[1]]).iter().zip(&quanta).any(|(step, quantum)| {
                *step >= MIN_INCREMENTS_PER_REPEAT * quantum * group.count as f64
            });
        let by_joints = || must_differ(motion, rows[group.first].0, span_s / group.count as f64);
        // A transform depends on one joint; others may move.
        let is_repeat_observable = goes_on
            && match is_of_joints || has_frame {
                true => is_of_joints || is_moving(series, &groups, at),
                false => by_joints().unwrap_or(true),
            };
        is_repeat_observable.then_some((at, span_s))
    };
    let mut moving: Vec<(usize, f64)> = (0..groups.len()).filter_map(moves).collect();
    let mut counts: Vec<usize> = moving.iter().map(|(at, _)| groups[*at].count).collect();
    if counts.is_empty() {
        return None;
    }
    let middle = counts.len() / 2;
    let usual = *counts.select_nth_unstable(middle).1;
    moving.retain(|(at, _)| groups[*at].count <= MAX_REPEATS_RATIO * usual + 1);
    let (mut count, mut span_s, mut age_s) = (0, 0.0, 0.0);
    for &(at, own_s) in &moving {
        let RepeatGroup { first, count: own } = groups[at];
        count += own;
        span_s += own_s;
        let ages =
            rows[first..first + own].iter().map(|(stamp, _)| stamp.seconds_since(rows[first].0));
        age_s += ages.sum::<f64>();
    }
    if count < MIN_ROWS || span_s <= 0.0 {
        return None;
    }
    let mut repeats = RepeatedValues {
        stream: series.stream,
        frame: series.frame.map(str::to_owned),
        rows: count,
        repeated: count - moving.len(),
        rows_hz: count as f64 / span_s,
        values_hz: moving.len() as f64 / span_s,
        // A value is new between two rows, on average half a row before the first that has it.
        mean_age_s: (age_s + 0.5 * span_s) / count as f64,
        piece: series.piece,
        new_rows: Vec::new(),
    };
    if repeats.share() >= MIN_REMOVED_SHARE {
        // Splits a rest at the usual rate, so that it is no gap.
        let most = (count as f64 / moving.len() as f64).ceil() as usize;
        let pieces = groups.iter().flat_map(|group| {
            let starts = (0..group.count).step_by(most.max(1));
            starts
                .map(move |start| group.first + start..group.first + group.count.min(start + most))
        });
        let stamps: Vec<Stamp> = rows.iter().map(|(stamp, _)| *stamp).collect();
        let is_own = !is_of_joints && !has_frame && !are_copied_stamps(&stamps, joint_stamps);
        let new =
            pieces.map(|rows| (series.rows[rows.start].1, corrected_stamp(series, rows, is_own)));
        repeats.new_rows = new.collect();
        repeats.new_rows.sort_unstable();
    }
    (repeats.repeated > 0).then_some(repeats)
}

/// Corrected time of a repeated value: the mean of its own stamps. Joint states, the time reference, and
/// values read with them use the first.
fn corrected_stamp(series: &PartSeries<'_>, rows: std::ops::Range<usize>, is_own: bool) -> Stamp {
    let first = series.rows[rows.start].0;
    if !is_own {
        return first;
    }
    let since = |(stamp, _): &(Stamp, usize)| stamp.seconds_since(first);
    let count = rows.len() as f64;
    first.shifted(series.rows[rows].iter().map(since).sum::<f64>() / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::{JointColumn, JointColumns, PoseColumns, Times};

    const MS: i64 = 1_000_000;

    /// Two joints that start, stop and reverse, read every `read_ms` into rows every `row_ms`, with
    /// resolution `bit` rad.
    fn read(row_ms: i64, read_ms: i64, bit: f64) -> JointColumns {
        let mut columns = JointColumns::default();
        for name in ["a", "b"] {
            columns.joints.push(JointColumn { name: name.to_owned(), ..JointColumn::default() });
        }
        for row in 0..20_000 / row_ms {
            let t_ms = row * row_ms;
            let t = (t_ms / read_ms * read_ms) as f64 * 1e-3;
            columns.times.push(1 + t_ms * MS, 1 + t_ms * MS, 0);
            for (joint, rate) in columns.joints.iter_mut().zip([1.0, 1.7]) {
                let q = 0.6 * (rate * t).sin().powi(3);
                joint.position.push(if bit > 0.0 { (q / bit).round() * bit } else { q });
                joint.velocity.push(f64::NAN);
            }
        }
        columns
    }

    fn part<'a>(stream: usize, times: &'a Times, values: PartValues<'a>) -> Part<'a> {
        Part { stream, piece: 0, frame: None, is_table: false, times, values }
    }

    fn rows(part: &Part<'_>) -> Rows {
        part.times.header.iter().map(|&t| Stamp::from_nanos(t)).zip(0..).collect()
    }

    fn detect(columns: &JointColumns) -> Option<RepeatedValues> {
        let part = part(0, &columns.times, PartValues::Joints(columns));
        detect_repeated_values(&[part], &rows).pop()
    }

    #[test]
    fn repeated_rows_are_counted_in_motion_and_used_once() {
        for (row_ms, read_ms, share) in [(8, 48, 5.0 / 6.0), (2, 4, 0.5), (5, 6, 1.0 / 6.0)] {
            let columns = read(row_ms, read_ms, 0.0);
            let found = detect(&columns).expect("rows are held");
            assert!((found.share() - share).abs() < 0.02, "{row_ms} {read_ms}: {}", found.share());
            assert!((found.values_hz - 1e3 / read_ms as f64).abs() < 0.05 * found.values_hz);
            let age_ms = 1e3 * found.mean_age_s;
            let expected_ms = 0.5 * read_ms as f64;
            assert!((age_ms - expected_ms).abs() < 0.08 * read_ms as f64, "{read_ms}: {age_ms}");
            let mut rows: Rows = (0..columns.times.len())
                .map(|row| (Stamp::from_nanos(columns.times.header[row]), row))
                .collect();
            deduplicate(&[found], 0, 0, &mut rows);
            let expected = 20_000 / read_ms;
            assert!((rows.len() as i64 - expected).abs() < expected / 10, "{}", rows.len());
            assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }

    #[test]
    fn coarse_encoders_and_new_values_are_no_repeats() {
        for bit in [0.0, 1.5e-3, 2e-2] {
            let share = detect(&read(5, 5, bit)).map_or(0.0, |found| found.share());
            assert!(share < 0.02, "{bit}: {share}");
        }
    }

    #[test]
    fn held_poses_are_found_beside_slow_joints_with_noisy_coarse_encoders() {
        const BIT: f64 = 6e-3;
        let mut joints = read(8, 8, BIT);
        for column in &mut joints.joints {
            column.position.iter_mut().zip(0..).for_each(|(q, row)| *q += BIT * f64::from(row % 2));
        }
        let held = |count: i64| {
            let times = joints.times.clone().into();
            let mut poses = PoseColumns { times, ..PoseColumns::default() };
            for row in 0..joints.times.len() as i64 {
                let t = (row / count * count) as f64 * 8e-3;
                poses.xyz.push([0.3 * t.sin(), 0.2 * (1.7 * t).cos(), 0.1 * t]);
                poses.q_xyzw.push([0.0, 0.0, 0.0, 1.0]);
            }
            let of_joints = part(0, &joints.times, PartValues::Joints(&joints));
            let of_poses = part(1, &poses.times, PartValues::Poses(&poses));
            detect_repeated_values(&[of_joints, of_poses], &rows).pop().map(|found| found.share())
        };
        assert_eq!(held(1), None);
        let share = held(6).expect("repeated poses");
        assert!((share - 5.0 / 6.0).abs() < 0.02, "{share}");
    }
}
