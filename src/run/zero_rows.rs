//! Detects joint states in which all joints are exactly 0 while the arm is elsewhere: the defaults of a driver that has not
//! read the encoders.
//!
//! No statistics are needed, unlike for outliers: measured joints are never all 0 between two jumps, at any share of the rows.

use std::collections::BTreeMap;

use rayon::prelude::*;

use crate::stream::{Columns, JointColumns};
use crate::time::Stamp;

use super::outliers::{MAX_DURATION_S, Outliers};
use super::part_series::{Part, PartValues};
use super::pose_distance::PoseDistance;
use super::poses::are_copied_stamps;
use super::publishers::{self, TwoPublishers};
use super::role::Role;
use super::rows::Rows;
use super::stale::{MAX_ACCELERATION, MIN_JUMP, MIN_STEP_RATIO, SPEED_ROWS};
use super::streams::{Stream, StreamClocks};
use super::unwrap::TURN_LENGTHS;

/// Minimum number of joints. The one or two fingers of a gripper jump to exactly 0 when it closes.
const MIN_JOINTS: usize = 3;

/// Rows of zeros of each stream of joint states, by stream.
pub(super) fn detect_zero_rows(
    streams: &[Stream],
    clocks: &StreamClocks,
    publishers: &[TwoPublishers],
) -> Vec<Outliers> {
    let of = |(index, stream): (usize, &Stream)| {
        let columns = stream.columns.as_ref().filter(|_| stream.role == Role::Joints);
        let Some(Columns::Joints(joints)) = columns else { return None };
        // Most streams have none, and sorting all rows takes far longer.
        if !(0..joints.times.len()).any(|row| is_zero(joints, row)) {
            return None;
        }
        let mut rows = clocks.rows(streams, index, 0);
        rows.sort_by_key(|(stamp, row)| (*stamp, joints.times.log[*row]));
        publishers::remove_second_publisher(publishers, index, 0, &mut rows);
        zero_rows(index, joints, rows)
    };
    streams.par_iter().enumerate().filter_map(of).collect()
}

/// Rows of poses that were computed from rows of zeros: those with their stamps, in streams that copy the stamps of the joint
/// states. `rows` returns those of a stream's part, sorted by stamp; `parts` lack joint states with incomplete messages.
pub(super) fn poses_of_zero_rows(
    parts: &[Part<'_>],
    rows: &(dyn Fn(usize, usize) -> Rows + Sync),
    zeros: &[Outliers],
) -> Vec<Outliers> {
    let of_joints = |zeros: &Outliers| {
        let rows = rows(zeros.stream, zeros.piece);
        let stamps: Vec<Stamp> = rows.iter().map(|(stamp, _)| *stamp).collect();
        let is_zero = |(_, row): &&(Stamp, usize)| zeros.rows.binary_search(row).is_ok();
        let of_zeros: Vec<Stamp> = rows.iter().filter(is_zero).map(|(stamp, _)| *stamp).collect();
        (stamps, of_zeros)
    };
    let joints: Vec<(Vec<Stamp>, Vec<Stamp>)> = zeros.iter().map(of_joints).collect();
    if joints.is_empty() {
        return Vec::new();
    }
    let of_part = |part: &Part<'_>| {
        let PartValues::Poses(_) = part.values else { return None };
        let all = rows(part.stream, part.piece);
        let stamps: Vec<Stamp> = all.iter().map(|(stamp, _)| *stamp).collect();
        let (_, of_zeros) = joints.iter().find(|(of, _)| are_copied_stamps(&stamps, of))?;
        let is_of_zeros = |(stamp, _): &&(Stamp, usize)| of_zeros.binary_search(stamp).is_ok();
        let mut rows: Vec<usize> = all.iter().filter(is_of_zeros).map(|(_, row)| *row).collect();
        rows.sort_unstable();
        Some(rows_of_part(part.stream, part.piece, rows))
    };
    parts.par_iter().filter_map(of_part).collect()
}

fn rows_of_part(stream: usize, piece: usize, rows: Vec<usize>) -> Outliers {
    Outliers {
        stream,
        frame: None,
        joint: None,
        are_zeros: true,
        largest_jump: PoseDistance { length_m: 0.0, angle_rad: 0.0 },
        largest_at: None,
        piece,
        rows,
    }
}

fn known_positions(joints: &JointColumns, row: usize) -> impl Iterator<Item = (&str, f64)> {
    let named = joints.joints.iter().map(move |joint| (joint.name.as_str(), joint.position[row]));
    named.filter(|(_, q)| q.is_finite())
}

/// Whether all joints are exactly 0. A joint near a full turn then seems to wrap, and unwrapping adds whole turns to the 0.
fn is_zero(joints: &JointColumns, row: usize) -> bool {
    let mut count = 0;
    known_positions(joints, row).all(|(_, q)| {
        count += 1;
        q == 0.0 || TURN_LENGTHS.iter().any(|turn| q % turn == 0.0)
    }) && count >= MIN_JOINTS
}

/// Rows of zeros of each set of joints that a message names: joints of other messages do not show whether these jump.
fn zero_rows(stream: usize, joints: &JointColumns, rows: Rows) -> Option<Outliers> {
    let mut by_joints: BTreeMap<Vec<bool>, Rows> = BTreeMap::new();
    for row in rows {
        let is_known = joints.joints.iter().map(|joint| joint.position[row.1].is_finite());
        by_joints.entry(is_known.collect()).or_default().push(row);
    }
    let found = by_joints.values().filter_map(|rows| zero_rows_of_set(stream, joints, rows));
    found.reduce(|one, other| {
        let length_m = |found: &Outliers| found.largest_jump.length_m;
        let (mut largest, other) =
            if length_m(&one) < length_m(&other) { (other, one) } else { (one, other) };
        largest.rows.extend(other.rows);
        largest.rows.sort_unstable();
        largest
    })
}

/// Rows of zeros that the joints jump to and from. The log may start or end with zeros. A simulated arm also rests at 0, but
/// moves there, and one that is reset to 0 moves on from there.
fn zero_rows_of_set(stream: usize, joints: &JointColumns, rows: &Rows) -> Option<Outliers> {
    let (zero, measured): (Vec<usize>, Vec<usize>) =
        (0..rows.len()).partition(|&at| is_zero(joints, rows[at].1));
    if zero.is_empty() {
        return None;
    }
    let seconds = |a: usize, b: usize| rows[b].0.seconds_since(rows[a].0).abs();
    let fastest = |nearby: &[usize]| {
        let speed = |pair: &[usize]| {
            let by = joints.joints.iter().map(|joint| {
                (joint.position[rows[pair[1]].1] - joint.position[rows[pair[0]].1]).abs()
            });
            by.fold(0.0, f64::max) / seconds(pair[0], pair[1]).max(f64::MIN_POSITIVE)
        };
        nearby.windows(2).map(speed).fold(0.0, f64::max)
    };
    // Joint that jumps farthest between a measured row and the next row of zeros, and how far. Leaving and stopping at rest
    // takes twice an acceleration of half the time.
    let jump = |measured: usize, zero: usize, speed: f64| {
        let (joint, far) = known_positions(joints, rows[measured].1)
            .map(|(joint, q)| (joint, q.abs()))
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let step_s = seconds(measured, zero);
        let own = (MAX_ACCELERATION * step_s.powi(2) / 4.0).max(MIN_STEP_RATIO * speed * step_s);
        (step_s <= MAX_DURATION_S && far > MIN_JUMP.max(own)).then_some((joint, far))
    };
    let mut found = Vec::new();
    let mut largest: Option<((&str, f64), Stamp)> = None;
    let mut is_moving = false;
    for next in 0..=measured.len() {
        let (before, after) = measured.split_at(next);
        let before = &before[next.saturating_sub(SPEED_ROWS)..];
        let after = &after[..after.len().min(SPEED_ROWS)];
        let zeros = before.last().map_or(0, |last| last + 1)
            ..after.first().map_or(rows.len(), |first| *first);
        if zeros.is_empty() {
            continue;
        }
        let sides = [
            before.last().map(|&last| (last, zeros.start, fastest(before))),
            after.first().map(|&first| (first, zeros.end - 1, fastest(after))),
        ];
        let sides: Vec<_> = sides.into_iter().flatten().collect();
        let jumps: Vec<((&str, f64), Stamp)> = sides
            .iter()
            .filter_map(|&(measured, zero, speed)| {
                Some((jump(measured, zero, speed)?, rows[zero].0))
            })
            .collect();
        if jumps.is_empty() || jumps.len() < sides.len() {
            continue;
        }
        is_moving |= sides.iter().any(|(.., speed)| *speed > 0.0);
        largest = jumps.into_iter().chain(largest).max_by(|a, b| a.0.1.total_cmp(&b.0.1));
        found.extend(zeros.map(|at| rows[at].1));
    }
    found.sort_unstable();
    // Commands of a hand or a simulation may jump to 0, between rows without any noise.
    let ((joint, length_m), at) = largest.filter(|_| is_moving)?;
    Some(Outliers {
        joint: Some(joint.to_owned()),
        largest_jump: PoseDistance { length_m, angle_rad: 0.0 },
        largest_at: Some(at),
        ..rows_of_part(stream, 0, found)
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::stream::{JointColumn, PoseColumns};

    const NONE: [usize; 0] = [];

    /// 10 s at 100 Hz.
    fn rows() -> Rows {
        (0..1000).map(|row| (Stamp::from_nanos(10_000_000 * row as i64), row)).collect()
    }

    /// 10 s of three joints at 100 Hz; `is_zero` by time.
    fn detect(q: impl Fn(f64) -> f64, is_zero: impl Fn(f64) -> bool) -> Vec<usize> {
        let mut columns = JointColumns::default();
        let times: Vec<f64> = (0..1000).map(|row| f64::from(row) * 0.01).collect();
        for (name, share) in [("a", 1.0), ("b", -0.7), ("c", 0.3)] {
            let position =
                times.iter().map(|&t| if is_zero(t) { 0.0 } else { share * q(t) }).collect();
            columns.joints.push(JointColumn::from_positions(name.into(), position));
        }
        zero_rows(0, &columns, rows()).map_or_else(Vec::new, |found| found.rows)
    }

    fn swing(t: f64) -> f64 {
        1.0 + 0.5 * (1.3 * t).sin()
    }

    #[test]
    fn zeros_are_found_at_any_share_and_place() {
        let rows = |is_zero: &dyn Fn(usize) -> bool| {
            (0..1000).filter(|&row| is_zero(row)).collect::<Vec<_>>()
        };
        let cases: [&dyn Fn(usize) -> bool; 5] = [
            &|row| row == 500,
            &|row| row * 7919 % 13 < 6,
            &|row| row % 300 > 270,
            &|row| row < 150,
            &|row| row >= 850,
        ];
        for is_zero in cases {
            let at = |t: f64| is_zero((100.0 * t).round() as usize);
            assert_eq!(detect(swing, at), rows(is_zero));
        }
    }

    #[test]
    fn joints_of_other_messages_do_not_make_zeros_jump() {
        // Messages of a swinging arm and of wheels at rest alternate.
        let columns = |zeros_of_arm: &[usize]| {
            let column = |name: &str, q: &dyn Fn(usize) -> f64| {
                JointColumn::from_positions(name.into(), (0..1000).map(q).collect())
            };
            let arm = |row: usize| match row % 2 {
                0 if zeros_of_arm.contains(&row) => 0.0,
                0 => swing(0.01 * row as f64),
                _ => f64::NAN,
            };
            let wheel = |row: usize| if row.is_multiple_of(2) { f64::NAN } else { 0.0 };
            let mut columns = JointColumns::default();
            columns.joints.extend(["a", "c"].map(|name| column(name, &arm)));
            columns.joints.push(column("rail", &|row| 2.0 * arm(row)));
            columns.joints.extend(["d", "e", "f"].map(|name| column(name, &wheel)));
            columns
        };
        assert_eq!(zero_rows(0, &columns(&[]), rows()), None);
        let found = zero_rows(0, &columns(&[300, 302]), rows()).expect("rows of zeros");
        assert_eq!(found.rows, [300, 302]);
        assert_eq!(found.joint.as_deref(), Some("rail"));
    }

    #[test]
    fn zeros_of_an_unwrapped_joint_are_whole_turns() {
        let is_zero = |row: usize| (500..520).contains(&row);
        let column = |name: &str, near: f64, zero: f64| {
            let q = |row| if is_zero(row) { zero } else { near + 0.1 * swing(0.01 * row as f64) };
            JointColumn::from_positions(name.into(), (0..1000).map(q).collect())
        };
        let mut columns = JointColumns::default();
        for (name, near, zero) in [("a", 1.0, 0.0), ("b", -0.7, 0.0), ("c", 6.1, TAU)] {
            columns.joints.push(column(name, near, zero));
        }
        let found = zero_rows(0, &columns, rows()).expect("rows of zeros");
        assert_eq!(found.rows, (500..520).collect::<Vec<_>>());
    }

    #[test]
    fn poses_with_the_stamps_of_zeros_are_excluded() {
        // Joint states with incomplete messages are no part.
        let poses = PoseColumns::default();
        let (times, values) = (&*poses.times, PartValues::Poses(&poses));
        let part = Part { stream: 1, piece: 0, frame: None, is_table: false, times, values };
        let rows = |_: usize, _: usize| -> Rows {
            (0..100).map(|row| (Stamp::from_nanos(1000 * row as i64), row)).collect()
        };
        let found = poses_of_zero_rows(&[part], &rows, &[rows_of_part(0, 0, vec![3, 50])]);
        assert_eq!(found, [rows_of_part(1, 0, vec![3, 50])]);
    }

    #[test]
    fn an_arm_that_moves_to_or_from_zero_is_measured() {
        // It rests at 0, moves away and returns.
        let home = |t: f64| {
            if (2.0..8.0).contains(&t) { 0.5 - 0.5 * (TAU * (t - 2.0) / 6.0).cos() } else { 0.0 }
        };
        assert_eq!(detect(home, |_| false), NONE);
        // It is at 0 in one row.
        assert_eq!(detect(|t| t - 5.0, |_| false), NONE);
        // Its zeros are redefined, and it moves on from there.
        assert_eq!(
            detect(|t| if t < 5.0 { swing(t) } else { (t - 6.0).max(0.0).powi(2) }, |_| false),
            NONE
        );
        // It is commanded.
        assert_eq!(detect(|t| if (4.0..6.0).contains(&t) { 0.0 } else { 1.0 }, |_| false), NONE);
    }
}
