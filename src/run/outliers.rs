//! Detects samples that jump away and return within a few samples: a dropped encoder bit, a lost tracker
//! target, a zero before the first valid pose.
//!
//! Checks all rows. Estimators exclude outliers, as one ten metres off would dominate speeds and spreads.

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::ops::Range;

use rayon::prelude::*;

use crate::stream::{ArrayColumns, Columns, JointColumn, JointColumns, PoseColumns};
use crate::time::Stamp;

use super::pose_distance::PoseDistance;
use super::poses::MatrixOrder;
use super::publishers::TwoPublishers;
use super::role::Role;
use super::rows::Rows;
use super::stale::MAX_ACCELERATION;
use super::streams::{Stream, StreamClocks, with_key};

/// Maximum number of consecutive outliers.
const MAX_CONSECUTIVE: usize = 3;
/// Maximum duration, s; longer excursions may be motion.
pub(super) const MAX_DURATION_S: f64 = 0.25;
/// Minimum ratio of a jump to the usual and nearby steps.
const MIN_STEP_RATIO: f64 = 5.0;
/// Ratio to the usual steps that always suffices.
const SUFFICIENT_STEP_RATIO: f64 = 1000.0;
/// Maximum distance after the return, as a share of the jump.
const MAX_RETURN_SHARE: f64 = 0.2;
/// Minimum jump, rad or m.
const MIN_JUMP: f64 = 1e-3;
/// The same if mostly stationary, because an encoder's last bit flips.
const MIN_JUMP_AT_REST: f64 = 5e-3;
/// Maximum share; more are indistinguishable from data.
const MAX_SHARE: f64 = 0.05;
/// Minimum number of samples; with fewer, no outliers are reported.
pub const MIN_OUTLIER_SAMPLES: usize = 20;

/// Outliers of a stream, transform or joint, or its rows of zeros.
#[derive(Clone, Debug, PartialEq)]
pub struct Outliers {
    /// Index of the stream.
    pub stream: usize,
    /// Child frame of the transform.
    pub frame: Option<String>,
    /// The joint; of rows of zeros, the one that jumps farthest.
    pub joint: Option<String>,
    /// Whether all joints are exactly 0 in these rows.
    pub are_zeros: bool,
    /// Largest jump; a joint's, in its unit, as `length_m`.
    pub largest_jump: PoseDistance,
    /// Stamp of that sample, if it has one.
    pub largest_at: Option<Stamp>,
    /// Index of the stream's part.
    pub(super) piece: usize,
    /// Outlier rows in order. Empty if indistinguishable from data.
    pub(super) rows: Vec<usize>,
}

impl Outliers {
    /// Number of outliers; 0 if more than one in twenty samples jumps.
    pub fn count(&self) -> usize {
        self.rows.len()
    }
}

/// Number of samples of a stream that are outliers in some part: joints jump together in one sample.
pub fn outlier_count(parts: &[Outliers]) -> usize {
    let samples = parts.iter().flat_map(|part| part.rows.iter().map(|row| (part.piece, *row)));
    samples.collect::<HashSet<_>>().len()
}

pub(super) fn remove_outliers(outliers: &[Outliers], stream: usize, piece: usize, rows: &mut Rows) {
    let of_it = with_key(outliers, (stream, piece), |found| (found.stream, found.piece));
    let outlier: HashSet<usize> = of_it.iter().flat_map(|found| &found.rows).copied().collect();
    if !outlier.is_empty() {
        rows.retain(|(_, row)| !outlier.contains(row));
    }
}

/// Outliers of joint states, poses and transforms. Skips parts with two publishers, whose rows differ, and rows of zeros.
pub(super) fn detect_outliers(
    streams: &[Stream],
    clocks: &StreamClocks,
    publishers: &[TwoPublishers],
    zeros: &[Outliers],
) -> Vec<Outliers> {
    let is_of_two =
        |stream: usize, piece: usize| TwoPublishers::of_part(publishers, stream, piece).is_some();
    let may_jump = |role| {
        matches!(
            role,
            Role::Joints | Role::Pose | Role::Tf | Role::Candidate { .. } | Role::Unassigned
        )
    };
    let of = |(index, stream): (usize, &Stream)| {
        // Without stamps, compare only consecutive samples.
        let times = stream.times();
        let at = |piece: usize, row: usize| {
            let clock = clocks.clock(index, piece).zip(times.get(piece));
            clock.and_then(|(clock, times)| clock.stamp_of(times, row))
        };
        let rows_of_zeros = |piece: usize| {
            let of_part = with_key(zeros, (index, piece), |found| (found.stream, found.piece));
            of_part.first().map_or(&[] as &[_], |found| found.rows.as_slice())
        };
        match &stream.columns {
            _ if !may_jump(stream.role) || is_of_two(index, 0) && times.len() == 1 => Vec::new(),
            Some(Columns::Joints(joints)) => {
                joint_outliers(index, joints, rows_of_zeros(0), &|row| at(0, row))
            }
            Some(columns @ (Columns::Poses(poses) | Columns::Transforms(poses))) => {
                let is_tf = matches!(columns, Columns::Transforms(_));
                let of = |(piece, poses)| {
                    let zeros = rows_of_zeros(piece);
                    pose_outliers((index, piece), poses, is_tf, zeros, &|row| at(piece, row))
                };
                let pieces = poses.par_iter().enumerate();
                let pieces = pieces.filter(|(piece, _)| !(is_tf && is_of_two(index, *piece)));
                pieces.filter_map(of).collect()
            }
            Some(Columns::Array(array)) if array.width >= 6 => {
                array_outliers(index, array, &|row| at(0, row)).into_iter().collect()
            }
            _ => Vec::new(),
        }
    };
    streams.par_iter().enumerate().flat_map_iter(of).collect()
}

type StampOfRow<'a> = &'a (dyn Fn(usize) -> Option<Stamp> + Sync);

fn joint_outliers(
    stream: usize,
    joints: &JointColumns,
    zeros: &[usize],
    at: StampOfRow,
) -> Vec<Outliers> {
    let of = |column: &JointColumn| {
        let q = &column.position;
        let is_known = |row: usize| q[row].is_finite() && zeros.binary_search(&row).is_err();
        let known = KnownRows::select(q.len(), is_known);
        let row = |sample: usize| known.row(sample);
        let samples = known.count;
        let distance = |a: usize, b: usize| angular_distance(q[row(b)] - q[row(a)]);
        let jumps = find_jumps(samples, &|sample| at(row(sample)), distance)?;
        let (farthest, length_m) = largest_jump(&jumps)?;
        Some(Outliers {
            stream,
            frame: None,
            joint: Some(column.name.clone()),
            are_zeros: false,
            largest_jump: PoseDistance { length_m, angle_rad: 0.0 },
            largest_at: at(row(farthest)),
            piece: 0,
            rows: identifiable_rows(&jumps, samples).map(row).collect(),
        })
    };
    joints.joints.par_iter().filter_map(of).collect()
}

/// Joint motion without whole turns in rad or degrees, as joints may be wrapped.
fn angular_distance(by: f64) -> f64 {
    const MAX_TURNS: f64 = 4.0;
    let without = |turn: f64| match by.abs() > MAX_TURNS * turn {
        true => f64::INFINITY,
        false => (by - turn * (by / turn).round()).abs(),
    };
    match by.abs() {
        small if small < 3.0 => small,
        far => far.min(without(TAU)).min(without(360.0)),
    }
}

/// Outliers of poses. Checks orientations only of a `transform`; misinterpreted ones jump without an
/// outlier.
fn pose_outliers(
    part: (usize, usize),
    poses: &PoseColumns,
    transform: bool,
    zeros: &[usize],
    at: StampOfRow,
) -> Option<Outliers> {
    let frame = (!poses.child_frame_id.is_empty()).then(|| poses.child_frame_id.clone());
    let known = KnownRows::select(poses.times.len(), |row| zeros.binary_search(&row).is_err());
    let samples = known.count;
    let at_sample = |sample: usize| at(known.row(sample));
    let xyz = |sample: usize| poses.xyz[known.row(sample)];
    let moved =
        find_jumps(samples, &at_sample, |a: usize, b: usize| point_distance(xyz(a), xyz(b)));
    let turned = transform
        .then(|| find_jumps(samples, &at_sample, OrientationDistance { poses, known: &known }))
        .flatten();
    let [moved, turned] = [moved, turned].map(|jumps| {
        let jumps = jumps.unwrap_or_default().into_iter();
        jumps.map(|(sample, by)| (known.row(sample), by)).collect::<Vec<_>>()
    });
    outliers_from_jumps(part, frame, [&moved, &turned], samples, at)
}

/// Rows without those that are missing or excluded, as samples.
struct KnownRows {
    count: usize,
    /// `None` of all rows.
    rows: Option<Vec<usize>>,
}

impl KnownRows {
    fn select(rows: usize, is_known: impl Fn(usize) -> bool) -> Self {
        if (0..rows).all(&is_known) {
            return Self { count: rows, rows: None };
        }
        let known: Vec<usize> = (0..rows).filter(|row| is_known(*row)).collect();
        Self { count: known.len(), rows: Some(known) }
    }

    fn row(&self, sample: usize) -> usize {
        self.rows.as_ref().map_or(sample, |rows| rows[sample])
    }
}

/// Outliers of unnamed positions; angles may jump by a turn.
fn array_outliers(stream: usize, array: &ArrayColumns, at: StampOfRow) -> Option<Outliers> {
    let layout = MatrixOrder::detect(array);
    let xyz = |row: usize| match layout {
        Some(layout) => layout.split(array.row(row)).0,
        None => [0, 1, 2].map(|axis| array.row(row)[axis]),
    };
    let samples = array.times.len();
    let moved = find_jumps(samples, at, |a, b| point_distance(xyz(a), xyz(b)))?;
    outliers_from_jumps((stream, 0), None, [&moved, &[]], samples, at)
}

fn point_distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Outliers from jumps in position and in orientation.
fn outliers_from_jumps(
    (stream, piece): (usize, usize),
    frame: Option<String>,
    [moved, turned]: [&[(usize, f64)]; 2],
    samples: usize,
    at: StampOfRow,
) -> Option<Outliers> {
    let [by_length, by_angle] = [moved, turned].map(largest_jump);
    let largest_at = at(by_length.or(by_angle)?.0);
    let amount = |farthest: Option<(usize, f64)>| farthest.map_or(0.0, |(_, amount)| amount);
    let largest_jump = PoseDistance { length_m: amount(by_length), angle_rad: amount(by_angle) };
    let mut rows: Vec<usize> =
        identifiable_rows(moved, samples).chain(identifiable_rows(turned, samples)).collect();
    rows.sort_unstable();
    rows.dedup();
    Some(Outliers {
        stream,
        frame,
        joint: None,
        are_zeros: false,
        largest_jump,
        largest_at,
        piece,
        rows,
    })
}

fn largest_jump(jumps: &[(usize, f64)]) -> Option<(usize, f64)> {
    jumps.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))
}

/// The samples of `jumps`, unless too large a share of `samples`.
fn identifiable_rows(jumps: &[(usize, f64)], samples: usize) -> impl Iterator<Item = usize> {
    let are_few = jumps.len() as f64 <= MAX_SHARE * samples as f64;
    jumps.iter().filter(move |_| are_few).map(|(sample, _)| *sample)
}

trait SampleDistance {
    fn between(&self, a: usize, b: usize) -> f64;

    /// Whether the distance is at most `limit`. Fast; may miss some.
    fn is_certainly_within(&self, a: usize, b: usize, limit: f64) -> bool;
}

impl<F: Fn(usize, usize) -> f64> SampleDistance for F {
    fn between(&self, a: usize, b: usize) -> f64 {
        self(a, b)
    }

    fn is_certainly_within(&self, a: usize, b: usize, limit: f64) -> bool {
        self(a, b) <= limit
    }
}

struct OrientationDistance<'a> {
    poses: &'a PoseColumns,
    known: &'a KnownRows,
}

impl SampleDistance for OrientationDistance<'_> {
    fn between(&self, a: usize, b: usize) -> f64 {
        let [a, b] = [a, b].map(|sample| (self.poses, self.known.row(sample)));
        PoseDistance::between(a, b).angle_rad
    }

    fn is_certainly_within(&self, a: usize, b: usize, limit: f64) -> bool {
        let [a, b] = [a, b].map(|sample| self.poses.q_xyzw[self.known.row(sample)]);
        PoseDistance::is_rotation_certainly_below(a, b, limit)
    }
}

/// Outliers with their distances. `None` with too few samples.
fn find_jumps(
    samples: usize,
    at: StampOfRow,
    measure: impl SampleDistance,
) -> Option<Vec<(usize, f64)>> {
    let mut found = Vec::new();
    let distance = |a: usize, b: usize| measure.between(a, b);
    let usual = usual_step(samples, &distance)?;
    let least = if usual > 0.0 {
        MIN_JUMP.max(MIN_STEP_RATIO * usual)
    } else {
        MIN_JUMP_AT_REST.max(min_flip_distance(samples, &distance))
    };
    let step = |sample: usize| distance(sample, sample + 1);
    let is_soon = |from: usize, to: usize| match (at(from), at(to)) {
        (Some(from), Some(to)) => to.seconds_since(from).abs() <= MAX_DURATION_S,
        _ => true,
    };
    // Ends have no return, and the start of a motion is no outlier.
    let inside = || (MAX_CONSECUTIVE..samples.saturating_sub(MAX_CONSECUTIVE + 1)).map(step);
    let is_unlike_all = |far: f64| {
        let longest = inside().filter(|step| step.is_finite()).fold(0.0, f64::max);
        longest > 0.0 && far > MIN_STEP_RATIO * longest
    };
    let mut sample = 0;
    while sample + 1 < samples {
        if measure.is_certainly_within(sample, sample + 1, least) {
            sample += 1;
            continue;
        }
        let far = step(sample);
        if far.is_nan() || far <= least {
            sample += 1;
            continue;
        }
        let back = |next: usize| {
            let span_s = |from: Stamp, to: Stamp| to.seconds_since(from).abs();
            // Leaving and returning at rest takes four accelerations of a quarter of the time each.
            let own = at(sample)
                .zip(at(next))
                .map(|(from, to)| MAX_ACCELERATION * span_s(from, to).powi(2) / 16.0);
            is_soon(sample, next)
                && distance(sample, next) < MAX_RETURN_SHARE * far
                && own.is_none_or(|own| far > own)
        };
        let next = (sample + 2..samples.min(sample + 2 + MAX_CONSECUTIVE)).find(|&next| back(next));
        let excursion = match next {
            Some(next) => Some(sample + 1..next),
            None if sample < MAX_CONSECUTIVE && is_soon(0, sample + 1) && is_unlike_all(far) => {
                Some(0..sample + 1)
            }
            None if samples - sample - 1 <= MAX_CONSECUTIVE
                && is_soon(sample, samples - 1)
                && is_unlike_all(far) =>
            {
                Some(sample + 1..samples)
            }
            None => None,
        };
        let stands_out = |excursion: &Range<usize>| {
            (usual > 0.0 && far > SUFFICIENT_STEP_RATIO * usual)
                || far > MIN_STEP_RATIO * nearby_step(samples, excursion, &step)
        };
        let Some(excursion) = excursion.filter(stands_out) else {
            sample += 1;
            continue;
        };
        let other = if excursion.start == 0 { excursion.end } else { excursion.start - 1 };
        sample = excursion.end;
        found.extend(excursion.map(|outlier| (outlier, distance(outlier, other))));
    }
    Some(found)
}

/// Minimum outlier distance if several steps equal the smallest one, an encoder's last bit or a text's last
/// digit; else 0.
fn min_flip_distance(samples: usize, distance: &impl Fn(usize, usize) -> f64) -> f64 {
    let steps =
        || (1..samples).map(|sample| distance(sample - 1, sample)).filter(|step| *step > 0.0);
    let least = steps().fold(f64::INFINITY, f64::min);
    let alike = steps().filter(|step| *step < 1.5 * least).count();
    if alike > 2 * MAX_CONSECUTIVE { MIN_STEP_RATIO * least } else { 0.0 }
}

/// Upper quartile of the non-zero steps, of a subset if many; 0 if nearly all are zero.
fn usual_step(samples: usize, distance: &impl Fn(usize, usize) -> f64) -> Option<f64> {
    const MAX_SAMPLED_STEPS: usize = 4096;
    let stride = samples.div_ceil(MAX_SAMPLED_STEPS).max(1);
    let some = (1..samples).step_by(stride).map(|sample| distance(sample - 1, sample));
    let looked_at = some.len();
    let mut steps: Vec<f64> = some.filter(|step| *step > 0.0 && step.is_finite()).collect();
    if samples < MIN_OUTLIER_SAMPLES {
        return None;
    }
    if steps.len() * 10 < looked_at {
        return Some(0.0);
    }
    let rank = (steps.len() - 1) * 3 / 4;
    Some(*steps.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Sixth largest step within eight samples of `excursion`: more than a few outliers, fewer than a fast motion
/// has.
fn nearby_step(samples: usize, excursion: &Range<usize>, step: &impl Fn(usize) -> f64) -> f64 {
    const WINDOW_SAMPLES: usize = 8;
    let before =
        excursion.start.saturating_sub(WINDOW_SAMPLES + 1)..excursion.start.saturating_sub(1);
    let after = excursion.end..(excursion.end + WINDOW_SAMPLES).min(samples - 1);
    let mut steps: Vec<f64> = before.chain(after).map(step).collect();
    steps.sort_by(f64::total_cmp);
    steps.len().checked_sub(6).map_or(f64::INFINITY, |sixth| steps[sixth])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn consecutive_outliers_are_detected() {
        let mut q = smooth(400);
        let outlier: Vec<usize> = (60..120).step_by(4).collect();
        outlier.iter().for_each(|&sample| q[sample] = 1e6);
        let found = find_jumps(q.len(), &|_| None, |a: usize, b: usize| (q[b] - q[a]).abs())
            .expect("samples");
        assert_eq!(found.iter().map(|(sample, _)| *sample).collect::<Vec<_>>(), outlier);
    }

    fn smooth(samples: usize) -> Vec<f64> {
        let at = |sample: usize| match sample as f64 * 0.02 {
            t if t < 4.0 => (1.3 * t).sin(),
            t if t < 6.0 => 5.2_f64.sin(),
            t => (1.3 * (t - 2.0)).sin(),
        };
        (0..samples).map(at).collect()
    }

    fn excursion(q: &[f64]) -> Vec<usize> {
        let at = |row: usize| Some(Stamp::from_nanos(row as i64 * 20_000_000));
        let jumps = find_jumps(q.len(), &at, |a: usize, b: usize| angular_distance(q[b] - q[a]))
            .expect("enough samples");
        jumps.iter().map(|(row, _)| *row).collect()
    }

    #[test]
    fn an_outlier_is_detected_at_any_position() {
        for planted in
            [vec![200], vec![250, 251, 252], vec![0, 1], vec![498, 499], vec![7, 100, 460]]
        {
            let mut q = smooth(500);
            planted.iter().for_each(|&row| q[row] += 0.9);
            assert_eq!(excursion(&q), planted);
        }
    }

    #[test]
    fn motion_is_no_outlier() {
        assert_eq!(excursion(&smooth(500)), Vec::<usize>::new());
        // So coarse that it leaves and returns between samples.
        let coarse: Vec<f64> = smooth(2000).into_iter().step_by(60).collect();
        assert_eq!(excursion(&coarse), Vec::<usize>::new());
        // A permanent step is a motion.
        let mut moved = smooth(500);
        moved[200..].iter_mut().for_each(|q| *q += 0.5);
        assert_eq!(excursion(&moved), Vec::<usize>::new());
    }

    #[test]
    fn a_turn_more_or_less_is_no_jump() {
        let mut q = smooth(500);
        q[100] += TAU;
        q[300] -= TAU;
        assert_eq!(excursion(&q), Vec::<usize>::new());
    }

    #[test]
    fn a_flipping_encoder_bit_at_rest_is_no_outlier() {
        for bit in [0.002, 0.006, 0.29] {
            let at = |row: usize| if row % 97 == 3 { 1.0 + bit } else { 1.0 };
            assert_eq!(excursion(&(0..500).map(at).collect::<Vec<f64>>()), Vec::<usize>::new());
        }
    }

    #[test]
    fn motion_at_the_start_or_end_is_no_outlier() {
        let rest = |from: usize, to: usize| {
            let at = |row: usize| if (from..to).contains(&row) { 0.02 * row as f64 } else { 1.0 };
            (0..500).map(at).collect::<Vec<f64>>()
        };
        assert_eq!(excursion(&rest(0, 2)), Vec::<usize>::new());
        assert_eq!(excursion(&rest(498, 500)), Vec::<usize>::new());
        // Each value occurs several times.
        let held: Vec<f64> = (0..500).map(|row| (row / 12) as f64 * 0.01).collect();
        assert_eq!(excursion(&held), Vec::<usize>::new());
    }

    #[test]
    fn a_long_excursion_is_motion() {
        let mut q = vec![0.0_f64; 100];
        q[40..42].fill(0.8);
        let each = |seconds: i64| move |row: usize| Some(Stamp::from_nanos(row as i64 * seconds));
        let found = |at: StampOfRow| {
            find_jumps(100, at, |a: usize, b: usize| (q[a] - q[b]).abs()).expect("enough").len()
        };
        assert_eq!((found(&each(1_000_000_000)), found(&each(20_000_000))), (0, 2));
    }

    #[test]
    fn many_jumps_are_reported_without_rows() {
        let mut q = smooth(500);
        q.iter_mut().skip(5).step_by(12).for_each(|q| *q = 0.0);
        let found = excursion(&q);
        assert!(
            found.len() > 25
                && identifiable_rows(&vec![(0, 1.0); found.len()], 500).next().is_none()
        );
    }

    #[test]
    fn outliers_at_rest_are_detected() {
        let mut q = vec![0.3; 500];
        q[120] = 0.1;
        assert_eq!(excursion(&q), [120]);
    }

    #[test]
    fn missing_values_are_skipped() {
        let mut joints = JointColumns::default();
        let q = smooth(500);
        let mut position: Vec<f64> = q.iter().flat_map(|q| [*q, f64::NAN]).collect();
        position[400] += 1.0;
        joints.joints.push(JointColumn::from_positions("a".into(), position));
        let found = joint_outliers(0, &joints, &[], &|_| None);
        assert_eq!(found[0].rows, [400]);
        assert!((found[0].largest_jump.length_m - 1.0).abs() < 0.1);
    }
}
