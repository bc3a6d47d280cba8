//! Rows that repeat the values of the row before with a new stamp while the arm moves: a poller that
//! asks more often than there is something new, or an up-sampler.
//!
//! An arm at rest repeats values, and so does a slow joint whose encoder is coarse. So rows count only
//! where the next value is several of the source's own least steps off for each row that it was held.

use std::sync::LazyLock;

use rayon::prelude::*;

use crate::time::Stamp;

use super::apart::Apart;
use super::rows::Rows;
use super::series::{Series, Values};

/// What a piece of a stream repeats.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Held {
    /// Index of the stream.
    pub stream: usize,
    /// The child frame of the transform.
    pub frame: Option<String>,
    /// Rows in motion.
    pub rows: usize,
    /// How many of them repeat the row before.
    pub repeated: usize,
    /// Rows a second in motion.
    pub rows_hz: f64,
    /// New values a second in motion.
    pub values_hz: f64,
    /// Mean time that a row's value had been there, s, in motion.
    pub mean_age_s: f64,
    /// Which of the stream's pieces.
    pub(super) piece: usize,
    /// The rows with a new value, in order, each with the time that it is taken at; none where
    /// too few are repeated for that.
    pub(super) new: Vec<(usize, Stamp)>,
}

impl Held {
    /// Whether so many are repeated that each value is taken once.
    pub fn is_taken_once(&self) -> bool {
        !self.new.is_empty()
    }

    /// The share of rows in motion that repeat the row before.
    pub fn share(&self) -> f64 {
        self.repeated as f64 / self.rows.max(1) as f64
    }
}

/// From this share on each value is taken once.
const TAKEN_ONCE: f64 = 0.05;
/// Time over which a joint is seen to move, s, and what it then comes to, rad or m.
const AROUND_S: f64 = 0.1;
const MOVED: f64 = 5e-3;
/// Rows in motion without which nothing is told.
const ENOUGH: usize = 40;

/// Whether each value of a piece is taken once.
pub(super) fn is_taken_once(held: &[Held], stream: usize, piece: usize) -> bool {
    held.iter().any(|held| (held.stream, held.piece) == (stream, piece) && held.is_taken_once())
}

/// Keeps of the rows of a piece those with a new value, at the time that it is taken at.
pub(super) fn take_once(held: &[Held], stream: usize, piece: usize, rows: &mut Rows) {
    let of_it = |held: &&Held| (held.stream, held.piece) == (stream, piece) && !held.new.is_empty();
    let Some(held) = held.iter().find(of_it) else { return };
    rows.retain_mut(|(stamp, row)| match held.new.binary_search_by_key(row, |(row, _)| *row) {
        Ok(at) => {
            *stamp = held.new[at].1;
            true
        }
        Err(_) => false,
    });
}

/// What is held of each piece.
pub(super) fn held(series: &[Series<'_>]) -> Vec<Held> {
    let motion: Motion<'_> = LazyLock::new(Box::new(|| {
        let joints = series.iter().filter(|series| matches!(series.values, Values::Joints(_)));
        joints.map(paces).collect()
    }));
    let is_of_joints = |series: &&Series<'_>| matches!(series.values, Values::Joints(_));
    let of_joints: Vec<Option<Held>> = series
        .par_iter()
        .map(|series| Some(series).filter(is_of_joints).and_then(|own| of(own, &motion, &[])))
        .collect();
    // What is computed from joint states that are held has their stamps; of fresh ones it holds its own.
    let held = series.iter().zip(&of_joints);
    let held = held.filter(|(_, found)| found.as_ref().is_some_and(Held::is_taken_once));
    let mut stamps: Vec<Stamp> =
        held.flat_map(|(series, _)| series.rows.iter().map(|(stamp, _)| *stamp)).collect();
    stamps.sort_unstable();
    let found = |(series, own): (&Series<'_>, Option<Held>)| match series.values {
        Values::Joints(_) => own,
        _ => of(series, &motion, &stamps),
    };
    series.par_iter().zip(of_joints).filter_map(found).collect()
}

/// Rows that follow each other with one value.
struct Group {
    /// The first of them, among the series' rows.
    first: usize,
    count: usize,
}

fn groups(series: &Series<'_>) -> impl Iterator<Item = Group> {
    let rows = &series.rows;
    let mut first = 0;
    std::iter::from_fn(move || {
        let value = rows.get(first)?.1;
        let repeats = rows[first + 1..].iter();
        let count = 1 + repeats.take_while(|(_, row)| series.values.is_same(value, *row)).count();
        first += count;
        Some(Group { first: first - count, count })
    })
}

/// The least step of each kind that is one: the source's last bit, or next to nothing.
fn quanta(series: &Series<'_>, groups: &[Group]) -> Vec<f64> {
    let mut least: Vec<f64> = Vec::new();
    for pair in groups.windows(2) {
        let steps = steps(series, [&pair[0], &pair[1]]);
        least.resize(steps.len(), f64::INFINITY);
        for (least, step) in least.iter_mut().zip(steps) {
            if step > 1e-12 {
                *least = least.min(step);
            }
        }
    }
    least
}

/// The steps from one group to the next: of a transform its length and its angle, in which a coarse
/// encoder's steps are alike, else of each number.
fn steps(series: &Series<'_>, pair: [&Group; 2]) -> Vec<f64> {
    let [a, b] = pair.map(|group| series.rows[group.first].1);
    if let (Values::Poses(poses), Some(_)) = (&series.values, series.frame) {
        let apart = Apart::between((poses, a), (poses, b));
        return vec![apart.length_m, apart.angle_rad];
    }
    let number = |number: usize| (series.values.at(b, number) - series.values.at(a, number)).abs();
    (0..series.values.width()).map(number).collect()
}

/// How fast joints go at a time, in their last bits a second, and by how much the one that goes
/// farthest moves around it, rad or m.
struct Pace {
    at: Stamp,
    bits_per_s: f64,
    moved: f64,
}

/// The paces of all joint states, which hardly a log needs.
type Motion<'a> = LazyLock<Vec<Vec<Pace>>, Box<dyn FnOnce() -> Vec<Vec<Pace>> + Send + 'a>>;

fn paces(series: &Series<'_>) -> Vec<Pace> {
    let groups: Vec<Group> = groups(series).collect();
    let quanta = quanta(series, &groups);
    let stamp = |group: &Group| series.rows[group.first].0;
    let (mut from, mut to) = (0, 0);
    let pace = |at: usize| {
        let now = stamp(&groups[at]);
        while now.seconds_since(stamp(&groups[from])) > AROUND_S && from < at {
            from += 1;
        }
        while to + 1 < groups.len() && stamp(&groups[to]).seconds_since(now) < AROUND_S {
            to += 1;
        }
        let pair = [from, to].map(|at| series.rows[groups[at].first]);
        let span_s = pair[1].0.seconds_since(pair[0].0);
        let (mut bits, mut moved) = (0.0_f64, 0.0_f64);
        for (number, quantum) in quanta.iter().enumerate() {
            let [a, b] = pair.map(|(_, row)| series.values.at(row, number));
            moved = moved.max((b - a).abs());
            bits = bits.max((b - a).abs() / quantum);
        }
        Pace { at: now, bits_per_s: if span_s > 0.0 { bits / span_s } else { 0.0 }, moved }
    };
    (0..groups.len()).map(pace).collect()
}

/// Whether the joints go fast enough at a time that rows `period_s` apart must differ; `None` where
/// none say.
fn must_differ(motion: &Motion<'_>, at: Stamp, period_s: f64) -> Option<bool> {
    /// Last bits in a period that a pose shows at any noise.
    const BITS: f64 = 3.0;
    let near = motion.iter().filter_map(|paces| {
        let next = paces.partition_point(|pace| pace.at < at);
        paces.get(next.min(paces.len().checked_sub(1)?))
    });
    near.map(|pace| pace.moved > MOVED && pace.bits_per_s * period_s > BITS).reduce(|a, b| a || b)
}

/// Whether a transform goes somewhere around one of its groups, and does not only tremble.
fn travels(series: &Series<'_>, groups: &[Group], at: usize) -> bool {
    let stamp = |group: &Group| series.rows[group.first].0;
    let now = stamp(&groups[at]);
    let from = groups.partition_point(|group| now.seconds_since(stamp(group)) > AROUND_S);
    let to = groups.partition_point(|group| stamp(group).seconds_since(now) < AROUND_S);
    let ends = [&groups[from], &groups[to.max(from + 1) - 1]];
    let moved = |pair: [&Group; 2]| steps(series, pair).into_iter().fold(0.0, f64::max);
    moved(ends) > MOVED
}

fn of(series: &Series<'_>, motion: &Motion<'_>, joint_stamps: &[Stamp]) -> Option<Held> {
    /// The next value is as many least steps off for each row that one was held.
    const STEPS: f64 = 2.0;
    /// What is held longer than so many times the usual rests.
    const RESTS: usize = 3;
    let rows = &series.rows;
    if rows.len() < ENOUGH {
        return None;
    }
    let count = groups(series).count();
    if count < 3 || count as f64 > (1.0 - 0.01) * rows.len() as f64 {
        return None;
    }
    let groups: Vec<Group> = groups(series).collect();
    let quanta = quanta(series, &groups);
    let is_of_joints = matches!(series.values, Values::Joints(_));
    let has_frame = series.frame.is_some();
    let moves = |at: usize| {
        let (group, pair) = (&groups[at], groups.get(at..at + 2)?);
        let span_s = rows[pair[1].first].0.seconds_since(rows[group.first].0);
        let goes_on = steps(series, [&pair[0], &pair[1]])
            .iter()
            .zip(&quanta)
            .any(|(step, quantum)| *step >= STEPS * quantum * group.count as f64);
        let by_joints = || must_differ(motion, rows[group.first].0, span_s / group.count as f64);
        // A transform is of one joint, and others may move.
        let is_told = goes_on
            && match is_of_joints || has_frame {
                true => is_of_joints || travels(series, &groups, at),
                false => by_joints().unwrap_or(true),
            };
        is_told.then_some((at, span_s))
    };
    let mut moving: Vec<(usize, f64)> = (0..groups.len()).filter_map(moves).collect();
    let mut counts: Vec<usize> = moving.iter().map(|(at, _)| groups[*at].count).collect();
    if counts.is_empty() {
        return None;
    }
    let middle = counts.len() / 2;
    let usual = *counts.select_nth_unstable(middle).1;
    moving.retain(|(at, _)| groups[*at].count <= RESTS * usual + 1);
    let (mut count, mut span_s, mut age_s) = (0, 0.0, 0.0);
    for &(at, own_s) in &moving {
        let Group { first, count: own } = groups[at];
        count += own;
        span_s += own_s;
        let ages =
            rows[first..first + own].iter().map(|(stamp, _)| stamp.seconds_since(rows[first].0));
        age_s += ages.sum::<f64>();
    }
    if count < ENOUGH || span_s <= 0.0 {
        return None;
    }
    let mut held = Held {
        stream: series.stream,
        frame: series.frame.map(str::to_owned),
        rows: count,
        repeated: count - moving.len(),
        rows_hz: count as f64 / span_s,
        values_hz: moving.len() as f64 / span_s,
        mean_age_s: age_s / count as f64,
        piece: series.piece,
        new: Vec::new(),
    };
    if held.share() >= TAKEN_ONCE {
        // What rests goes on at the usual pace, so that a rest is no gap.
        let most = (count as f64 / moving.len() as f64).ceil() as usize;
        let pieces = groups.iter().flat_map(|group| {
            let starts = (0..group.count).step_by(most.max(1));
            starts
                .map(move |start| group.first + start..group.first + group.count.min(start + most))
        });
        let is_own = !is_of_joints && !has_frame && !is_of(rows, joint_stamps);
        let new = pieces.map(|rows| (series.rows[rows.start].1, taken_at(series, rows, is_own)));
        held.new = new.collect();
        held.new.sort_unstable();
    }
    (held.repeated > 0).then_some(held)
}

/// Whether nearly all of some rows have stamps that are among others.
fn is_of(rows: &Rows, stamps: &[Stamp]) -> bool {
    let copies = rows.iter().filter(|(stamp, _)| stamps.binary_search(stamp).is_ok()).count();
    10 * copies >= 9 * rows.len()
}

/// When the value of some rows is taken to be. What has stamps of its own is as late as its rows are,
/// in the mean; joint states, which are the reference, and what was read together with them, is taken
/// at the time it was new.
fn taken_at(series: &Series<'_>, rows: std::ops::Range<usize>, is_own: bool) -> Stamp {
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
    use crate::stream::{JointColumn, JointColumns};

    const MS: i64 = 1_000_000;

    /// Two joints that start, stop and turn back, read every so many ms, at rows every so many, to so
    /// many rad.
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

    fn found(columns: &JointColumns) -> Option<Held> {
        let rows = columns.times.header.iter().map(|&t| Stamp::from_nanos(t)).zip(0..).collect();
        let (times, values) = (&columns.times, Values::Joints(columns));
        held(&[Series { stream: 0, piece: 0, frame: None, is_table: false, rows, times, values }])
            .pop()
    }

    #[test]
    fn repeated_rows_are_counted_in_motion_and_taken_once() {
        for (row_ms, read_ms, share) in [(8, 48, 5.0 / 6.0), (2, 4, 0.5), (5, 6, 1.0 / 6.0)] {
            let columns = read(row_ms, read_ms, 0.0);
            let found = found(&columns).expect("rows are held");
            assert!((found.share() - share).abs() < 0.02, "{row_ms} {read_ms}: {}", found.share());
            assert!((found.values_hz - 1e3 / read_ms as f64).abs() < 0.05 * found.values_hz);
            let mut rows: Rows = (0..columns.times.len())
                .map(|row| (Stamp::from_nanos(columns.times.header[row]), row))
                .collect();
            take_once(&[found], 0, 0, &mut rows);
            let expected = 20_000 / read_ms;
            assert!((rows.len() as i64 - expected).abs() < expected / 10, "{}", rows.len());
            assert!(rows.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }

    #[test]
    fn coarse_encoders_and_fresh_rows_hold_nothing() {
        for bit in [0.0, 1.5e-3, 2e-2] {
            let share = found(&read(5, 5, bit)).map_or(0.0, |found| found.share());
            assert!(share < 0.02, "{bit}: {share}");
        }
    }
}
