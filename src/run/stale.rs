//! Detects frozen joint states, of all joints or of one: a joint that stops abruptly at full speed and is elsewhere one
//! sample later. Estimation excludes them like gaps.

use std::borrow::Cow;
use std::ops::Range;

use crate::stats::median;
use crate::stream::{JointColumn, sample_noise};
use crate::time::Stamp;

use super::frozen::FrozenSpan;
use super::part_series::{PartSeries, PartValues};
use super::rows::Rows;

/// Minimum duration, s, and rows; slow sources have shorter spans.
const MIN_DURATION_S: f64 = 0.25;
const MIN_ROWS: usize = 10;
/// Maximum frozen motion, noise standard deviations.
pub(super) const MAX_FROZEN_MOTION_SIGMAS: f64 = 8.0;
/// Minimum final jump, rad or m, and in usual non-zero steps, to exclude a coarse encoder's resolution.
pub(super) const MIN_JUMP: f64 = 5e-3;
const MIN_JUMP_STEPS: f64 = 4.0;
/// Minimum ratio to the steps after it.
pub(super) const MIN_STEP_RATIO: f64 = 5.0;
/// Maximum acceleration of a real joint, rad/s² or m/s²; jumps exceed it. A hand-guided UR5e stops by up to
/// 87 rad/s² in public recordings (docs/real-logs.md).
pub(super) const MAX_ACCELERATION: f64 = 100.0;
/// Rows on each side that show joint speeds.
pub(super) const SPEED_ROWS: usize = 4;

/// Fewer joints may jump together, such as the fingers of a gripper.
const MIN_LEAPING_JOINTS: usize = 3;

/// Several joints that jump in one sample, without all being frozen before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointLeap {
    /// Index of the stream.
    pub stream: usize,
    /// First stamp after the jump.
    pub at: Stamp,
    /// Number of joints.
    pub joints: usize,
}

#[derive(Debug)]
pub(super) struct StaleJoints {
    pub frozen: FrozenSpan,
    pub rows: Vec<usize>,
}

pub(super) fn remove_stale_rows(stale: &[StaleJoints], stream: usize, rows: &mut Rows) {
    for found in stale.iter().filter(|found| found.frozen.stream == stream) {
        rows.retain(|(_, row)| found.rows.binary_search(row).is_err());
    }
}

/// Frozen joint states, and other jumps of several joints.
pub(super) fn detect_stale_joints<'s>(
    series: &PartSeries<'s>,
) -> (Vec<StaleJoints>, Vec<JointLeap>) {
    let rows = &series.rows;
    let PartValues::Joints(joints) = series.values else { return Default::default() };
    let is_all = rows.len() == joints.times.len() && (0..).zip(rows).all(|(at, row)| row.1 == at);
    let of_rows = |joint: &'s JointColumn| -> Cow<'s, [f64]> {
        match is_all {
            true => joint.position.as_slice().into(),
            false => rows.iter().map(|(_, row)| joint.position[*row]).collect(),
        }
    };
    let positions: Vec<Cow<'_, [f64]>> = joints.joints.iter().map(of_rows).collect();
    let q = |at: usize, joint: usize| positions[joint][at];
    let noise: Vec<f64> = positions.iter().map(|q| sample_noise(q)).collect();
    let count = noise.len();
    let jump_rows: Vec<Vec<usize>> =
        positions.iter().zip(&noise).map(|(q, noise)| find_jumps(q, *noise, rows)).collect();
    let mut all_jumps = jump_rows.concat();
    all_jumps.sort_unstable();
    all_jumps.dedup();
    // First row of the span that ends at a row, and the jump of the fastest joint after it.
    let find = |at: usize, joints: Range<usize>| {
        let is_still = |other: &usize| {
            joints.clone().all(|joint| {
                (q(*other, joint) - q(at, joint)).abs()
                    <= MAX_FROZEN_MOTION_SIGMAS * noise[joint] + 1e-9
            })
        };
        let first = (0..at).rev().take_while(is_still).last().unwrap_or(at);
        let (start, end) = (rows[first].0, rows[at].0);
        let is_long = end.seconds_since(start) >= MIN_DURATION_S && at - first >= MIN_ROWS;
        let period_s = end.seconds_since(start) / (at - first).max(1) as f64;
        let is_adjacent = rows[at + 1].0.seconds_since(end) < 3.0 * period_s;
        // A value redefined at rest also jumps, but without motion around it.
        let moves = |a: usize, b: usize| {
            joints.clone().any(|joint| {
                let by = (q(b, joint) - q(a, joint)).abs();
                let jumps = jump_rows[joint].binary_search(&at).is_ok();
                jumps && by > (10.0 * noise[joint]).max(1e-4)
            })
        };
        // One joint that stopped may also rest while others move.
        let stopped =
            || joints.len() == count && first >= SPEED_ROWS && moves(first - SPEED_ROWS, first);
        let goes_on = moves(at + 1, at + SPEED_ROWS) || stopped();
        if !is_long || !is_adjacent || !goes_on {
            return None;
        }
        let moved = joints.clone().map(|j| (q(at + 1, j) - q(at, j)).abs()).fold(0.0, f64::max);
        Some((first, moved))
    };
    let stale = |at: usize, (first, moved): (usize, f64), frozen: &[usize]| {
        let mut stale_rows: Vec<usize> = (first + 1..=at).map(|at| rows[at].1).collect();
        stale_rows.sort_unstable();
        let frozen = FrozenSpan {
            stream: series.stream,
            joints: frozen.iter().map(|&joint| joints.joints[joint].name.clone()).collect(),
            start: rows[first].0,
            end: rows[at].0,
            samples: at + 1 - first,
            is_whole_stream: false,
            joint_motion: Some(moved),
        };
        StaleJoints { frozen, rows: stale_rows }
    };
    let (mut found, mut leaps) = (Vec::new(), Vec::new());
    for at in all_jumps {
        if let Some(all) = find(at, 0..count) {
            found.push(stale(at, all, &[]));
            continue;
        }
        let jumping = (0..count).filter(|joint| jump_rows[*joint].binary_search(&at).is_ok());
        let jumping: Vec<usize> = jumping.collect();
        let (frozen, spans): (Vec<usize>, Vec<(usize, f64)>) =
            jumping.iter().filter_map(|&joint| Some((joint, find(at, joint..joint + 1)?))).unzip();
        // If others jump from a motion, those at rest were not frozen.
        if jumping.len() >= MIN_LEAPING_JOINTS && frozen.len() < jumping.len() {
            let (stream, at) = (series.stream, rows[at + 1].0);
            leaps.push(JointLeap { stream, at, joints: jumping.len() });
        } else if let Some(longest) =
            spans.into_iter().reduce(|one, other| (one.0.min(other.0), one.1.max(other.1)))
        {
            found.push(stale(at, longest, &frozen));
        }
    }
    (found, leaps)
}

/// Samples before a jump of one joint.
fn find_jumps(q: &[f64], noise: f64, rows: &Rows) -> Vec<usize> {
    let step = |at: usize| (q[at + 1] - q[at]).abs();
    let stands_out = |at: &usize| {
        let own = MAX_ACCELERATION * rows[at + 1].0.seconds_since(rows[*at].0).powi(2);
        let after = (at + 1..at + SPEED_ROWS).map(step).fold(0.0, f64::max);
        step(*at) > own && step(*at) > MIN_STEP_RATIO * after
    };
    let least = MIN_JUMP.max(20.0 * noise);
    let last = rows.len().saturating_sub(1 + SPEED_ROWS);
    let mut found: Vec<usize> =
        (0..last).filter(|&at| step(at) > least).filter(stands_out).collect();
    // The usual step takes far longer than all the rest, and most joints never jump.
    if !found.is_empty() {
        let usual = usual_step(q, noise);
        found.retain(|&at| step(at) > MIN_JUMP_STEPS * usual);
    }
    found
}

/// Median step beyond the noise; 0 if there is none.
fn usual_step(q: &[f64], noise: f64) -> f64 {
    let least = (6.0 * noise).max(1e-6);
    let steps = q.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let mut steps: Vec<f64> = steps.filter(|step| *step > least).collect();
    median(&mut steps).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::part_series::Part;
    use crate::stream::JointColumns;

    /// 20 s of a noisy oscillation at 100 Hz. `edit` returns when the position is taken, and an offset.
    fn swings(noise: f64, edit: impl Fn(f64) -> (f64, f64)) -> JointColumns {
        let mut columns = JointColumns::default();
        columns.joints.push(JointColumn { name: "a".to_owned(), ..JointColumn::default() });
        for row in 0..2000_i64 {
            let (t, offset) = edit(row as f64 * 0.01);
            columns.times.push(1 + row * 10_000_000, 0, 0);
            let noise = noise * f64::from((row * 7919 % 13) as i32 - 6) / 6.0;
            columns.joints[0].position.push((1.1 * t).sin() + offset + noise);
            columns.joints[0].velocity.push(f64::NAN);
        }
        columns
    }

    fn detect(columns: &JointColumns) -> Vec<StaleJoints> {
        detect_both(columns).0
    }

    fn detect_both(columns: &JointColumns) -> (Vec<StaleJoints>, Vec<JointLeap>) {
        let rows: Rows =
            columns.times.header.iter().map(|&t| Stamp::from_nanos(t)).zip(0..).collect();
        let (times, values) = (&columns.times, PartValues::Joints(columns));
        let part = Part { stream: 0, piece: 0, frame: None, is_table: false, times, values };
        detect_stale_joints(&PartSeries { part, rows })
    }

    #[test]
    fn joints_that_leap_to_constants_are_detected() {
        let mut columns = swings(5e-5, |t| if t < 8.0 { (t, 0.0) } else { (5.0, 0.3) });
        let joint = columns.joints[0].clone();
        columns.joints.push(joint.clone());
        assert!(detect_both(&columns).1.is_empty());
        columns.joints.push(joint);
        let (frozen, leaps) = detect_both(&columns);
        assert!(frozen.is_empty(), "{}", frozen.len());
        assert!(matches!(leaps.as_slice(), [JointLeap { joints: 3, .. }]), "{leaps:?}");
    }

    #[test]
    fn a_joint_at_rest_before_a_leap_of_all_is_not_frozen() {
        let leap = |t: f64| if t < 8.0 { (t, 0.0) } else { (t, 0.3) };
        let mut columns = swings(5e-5, leap);
        columns.joints.push(columns.joints[0].clone());
        let rests = swings(5e-5, |t| leap(if (6.0..8.0).contains(&t) { 6.0 } else { t }));
        columns.joints.extend(rests.joints);
        let (frozen, leaps) = detect_both(&columns);
        assert!(frozen.is_empty(), "{}", frozen.len());
        assert!(matches!(leaps.as_slice(), [JointLeap { joints: 3, .. }]), "{leaps:?}");
    }

    #[test]
    fn a_frozen_joint_is_detected_with_and_without_noise() {
        for noise in [0.0, 5e-5] {
            let columns = swings(noise, |t| (if (5.0..7.0).contains(&t) { 5.0 } else { t }, 0.0));
            let found = detect(&columns);
            let [one] = found.as_slice() else { panic!("{noise}: {}", found.len()) };
            assert!((one.frozen.samples as i64 - 200).abs() < 5, "{:?}", one.frozen);
            let times: Vec<FrozenSpan> = found.iter().map(|one| one.frozen.clone()).collect();
            let within = times[0].start..=times[0].end;
            assert!(within.contains(&Stamp::from_nanos(6_000_000_000)));
            let mut rows: Rows = (0..2000).map(|row| (Stamp::default(), row)).collect();
            remove_stale_rows(&found, 0, &mut rows);
            assert!((rows.len() as i64 - 1801).abs() < 5);
        }
    }

    #[test]
    fn one_frozen_joint_among_moving_ones_is_detected() {
        let joint = |edit: &dyn Fn(f64) -> (f64, f64)| swings(5e-5, edit).joints.remove(0);
        let from = |start_s: f64| {
            let edit = move |t: f64| (if (start_s..6.5).contains(&t) { start_s } else { t }, 0.0);
            JointColumn { name: format!("from {start_s}"), ..joint(&edit) }
        };
        let mut columns = swings(5e-5, |t| (0.7 * t, 0.0));
        columns.joints.push(from(5.0));
        let found = detect(&columns);
        let [one] = found.as_slice() else { panic!("{}", found.len()) };
        assert_eq!(one.frozen.joints, ["from 5"]);
        assert!((one.frozen.samples as i64 - 150).abs() < 5, "{:?}", one.frozen);
        let (start, rows) = (one.frozen.start, one.rows.clone());
        columns.joints.push(from(5.2));
        let found = detect(&columns);
        let [both] = found.as_slice() else { panic!("{}", found.len()) };
        assert_eq!(both.frozen.joints, ["from 5", "from 5.2"]);
        assert_eq!((both.frozen.start, &both.rows), (start, &rows));
        columns.joints.pop();
        // A zero that is redefined at rest.
        columns.joints[1] = joint(&|t| (1.43, if t > 8.0 { 0.1 } else { 0.0 }));
        assert!(detect(&columns).is_empty());
    }

    #[test]
    fn a_coarse_encoder_is_not_frozen() {
        const BIT: f64 = std::f64::consts::TAU / 1024.0;
        let mut columns = swings(0.0, |t| (0.08 * t, 0.0));
        for (row, q) in columns.joints[0].position.iter_mut().enumerate() {
            *q = (*q / BIT).round() * BIT + 2e-5 * ((row * 7919 % 13) as f64 - 6.0) / 6.0;
        }
        assert!(detect(&columns).is_empty());
    }

    #[test]
    fn rests_outliers_and_redefined_values_are_not_frozen() {
        let rests = swings(5e-5, |t| {
            (
                if (5.0..7.0).contains(&t) {
                    5.0
                } else if t < 5.0 {
                    t
                } else {
                    t - 2.0
                },
                0.0,
            )
        });
        let outlier = swings(5e-5, |t| (t, if (t - 5.0).abs() < 1e-3 { 0.4 } else { 0.0 }));
        let anew = swings(5e-5, |t| (1.43, if t > 8.0 { 0.1 } else { 0.0 }));
        for columns in [rests, outlier, anew] {
            assert!(detect(&columns).is_empty());
        }
    }
}
