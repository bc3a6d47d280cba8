//! Unwraps continuous joints logged modulo one turn, ±π or 0…2π, in rad or degrees, before differentiation,
//! interpolation and limit checks.

use std::f64::consts::TAU;

use rayon::prelude::*;

use crate::stream::{Columns, JointColumn};

use super::role::Role;
use super::streams::Stream;

/// In rad and degrees.
pub(super) const TURN_LENGTHS: [f64; 2] = [TAU, 360.0];
/// Maximum distance from the ends of the range, turns.
const MIN_END_MARGIN_TURNS: f64 = 0.02;
/// The same in long usual steps; the larger applies.
const END_MARGIN_STEPS: f64 = 4.0;
/// Upper bound of that distance, turns.
const MAX_END_MARGIN_TURNS: f64 = 0.125;
/// Minimum share of values in the range.
const MIN_SHARE_IN_RANGE: f64 = 0.99;

/// A joint that is logged modulo one turn.
#[derive(Clone, Debug, PartialEq)]
pub struct WrappedJoint {
    /// Index of the stream.
    pub stream: usize,
    /// Joint name in the log.
    pub joint: String,
    /// Positions as logged at both sides of the jumps, rad.
    pub range_rad: [f64; 2],
}

pub(super) fn unwrap_joints(streams: &mut [Stream]) -> Vec<WrappedJoint> {
    let of = |(index, stream): (usize, &mut Stream)| {
        let Some(Columns::Joints(joints)) = &mut stream.columns else { return Vec::new() };
        let unfolded = |joint: &mut JointColumn| {
            let range_rad = unwrap_column(&mut joint.position)?;
            Some(WrappedJoint { stream: index, joint: joint.name.clone(), range_rad })
        };
        joints.joints.iter_mut().filter_map(unfolded).collect()
    };
    streams.par_iter_mut().enumerate().flat_map_iter(of).collect()
}

pub(super) fn add_remarks(streams: &mut [Stream], wrapped: &[WrappedJoint]) {
    for (index, stream) in streams.iter_mut().enumerate() {
        let names: Vec<&str> = wrapped
            .iter()
            .filter(|wrapped| wrapped.stream == index)
            .map(|wrapped| wrapped.joint.as_str())
            .collect();
        if stream.role == Role::Joints && !names.is_empty() {
            stream.reason += &format!("; logged modulo one turn, unwrapped: {}", names.join(", "));
        }
    }
}

/// Removes jumps of a turn, and returns the positions at both sides of them, rad. `None`, unchanged, without any.
fn unwrap_column(q: &mut [f64]) -> Option<[f64; 2]> {
    TURN_LENGTHS.into_iter().find_map(|turn| {
        let ends = remove_turns(q, turn)?;
        Some(ends.map(|end| end / turn * TAU))
    })
}

fn remove_turns(q: &mut [f64], turn: f64) -> Option<[f64; 2]> {
    // Most joints do not jump.
    if q.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.5 * turn) {
        return None;
    }
    let known: Vec<usize> = (0..q.len()).filter(|&row| q[row].is_finite()).collect();
    let turns = |pair: &[usize]| ((q[pair[1]] - q[pair[0]]) / turn).round();
    if !known.windows(2).any(|pair| turns(pair) != 0.0) {
        return None;
    }
    let mut usual: Vec<f64> = known
        .windows(2)
        .filter(|pair| turns(pair) == 0.0)
        .map(|pair| (q[pair[1]] - q[pair[0]]).abs())
        .collect();
    let rank = usual.len().checked_sub(1)? * 99 / 100;
    let long = *usual.select_nth_unstable_by(rank, f64::total_cmp).1;
    if long > MAX_END_MARGIN_TURNS * turn {
        return None;
    }
    let near =
        (END_MARGIN_STEPS * long).max(MIN_END_MARGIN_TURNS * turn).min(MAX_END_MARGIN_TURNS * turn);
    // The jump is a turn minus the motion.
    let leaps = |pair: &[usize]| {
        let by = q[pair[1]] - q[pair[0]];
        turns(pair).abs() == 1.0 && (by - turn * turns(pair)).abs() <= near
    };
    let ends = known.windows(2).filter(|pair| leaps(pair)).map(|pair| {
        let (a, b) = (q[pair[0]], q[pair[1]]);
        (a.min(b), a.max(b))
    });
    let (low, high) = ends.reduce(|(low, high), (a, b)| (low.min(a), high.max(b)))?;
    let within = known.iter().filter(|&&row| (low - near..=high + near).contains(&q[row])).count();
    if (within as f64) < MIN_SHARE_IN_RANGE * known.len() as f64 || high - low > turn + near {
        return None;
    }
    let passes = |pair: &[usize]| {
        let (a, b) = (q[pair[0]], q[pair[1]]);
        leaps(pair) && a.min(b) <= low + near && a.max(b) >= high - near
    };
    let steps: Vec<(usize, f64)> = known
        .windows(2)
        .filter(|pair| passes(pair))
        .map(|pair| (pair[1], -turn * turns(pair)))
        .collect();
    let (mut next, mut shift) = (0, 0.0);
    for row in known {
        if let Some((_, by)) = steps.get(next).filter(|(at, _)| *at == row) {
            shift += by;
            next += 1;
        }
        q[row] += shift;
    }
    Some([low, high])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A noisy joint that rotates forwards, then back, at 100 Hz.
    fn turning() -> Vec<f64> {
        let noise = |row: i32| 2e-4 * f64::from((row * 7919) % 13 - 6);
        (0..3000).map(|row| 9.0 * (f64::from(row) * 4e-3).sin() + noise(row)).collect()
    }

    #[test]
    fn wrapped_joints_are_unwrapped_at_any_seam_in_any_unit() {
        for (seam, unit) in [(PI, 1.0), (TAU, 1.0), (PI, 1_f64.to_degrees()), (1.0, 1.0)] {
            let truth: Vec<f64> = turning().into_iter().map(|q| q * unit).collect();
            let turn = TAU * unit;
            let fold = |q: f64| seam * unit - (seam * unit - q).rem_euclid(turn);
            let mut wrapped: Vec<f64> = truth.iter().map(|q| fold(*q)).collect();
            wrapped[100] = f64::NAN;
            let found = unwrap_column(&mut wrapped);
            let offset = wrapped[0] - truth[0];
            let [low, high] = found.expect("wraps");
            assert!((high - seam).abs() < 0.1 && (high - low - TAU).abs() < 0.1, "{low} {high}");
            let is_near =
                |(row, q): (usize, &f64)| row == 100 || (q - truth[row] - offset).abs() < 1e-9;
            assert!(wrapped.iter().enumerate().all(is_near), "{seam} {unit}");
        }
    }

    #[test]
    fn noise_at_the_seam_is_unwrapped() {
        let mut q: Vec<f64> = (0..500)
            .map(|row| PI + 1e-3 * f64::from(row % 3 - 1))
            .map(|q| if q > PI { q - TAU } else { q })
            .collect();
        assert!(unwrap_column(&mut q).is_some());
        assert!(q.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 0.01));
    }

    #[test]
    fn joints_without_wraps_are_unchanged() {
        let mut stray = turning().into_iter().map(|q| q / 9.0).collect::<Vec<f64>>();
        stray[700] += TAU;
        let degrees: Vec<f64> = turning().into_iter().map(|q| 20.0 * q).collect();
        for q in [turning(), stray, degrees, vec![f64::NAN; 9], Vec::new()] {
            let mut same = q.clone();
            assert_eq!(unwrap_column(&mut same), None);
            assert!(same.iter().zip(&q).all(|(a, b)| a == b || a.is_nan()));
        }
    }
}
