//! Steps of the joint states' clock. All other streams appear to step in the opposite direction at the same time.

use super::estimate::ArmStreamsDiagnosis;
use crate::diagnosis::{
    LatencyProfile, LatencyShape, LatencyStep, Measured, PiecewiseLatency, monotonic_rows,
};
use crate::run::{Arm, JointSamples};
use crate::stats::{STD_DEV_PER_MEDIAN, median};
use crate::stream::JointTrack;

/// Standard errors of a significant clock skew.
const MIN_STD_ERRORS: f64 = 6.0;

/// Stream whose stamps are independent of the joint states'.
struct OtherClock<'a> {
    latency_s: f64,
    profile: &'a LatencyProfile,
    is_skewed: bool,
}

/// The arm with corrected stamps of the joint states, and their latency profile. `None` unless all streams with
/// independent stamps vary, and at least one has latency steps. A single stream may have stepped itself, so the steps must
/// also show in the joint states.
pub(super) fn with_corrected_joint_stamps(
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
) -> Option<(Arm, LatencyProfile)> {
    let clocks = other_clocks(arm, found);
    let deviates = |clock: &OtherClock| clock.profile.is_unsteady || clock.is_skewed;
    if arm.trajectory.is_some() || !clocks.iter().all(deviates) {
        return None;
    }
    let stepped = clocks.iter().filter(|clock| !clock.steps().is_empty());
    let std_error = |clock: &&OtherClock| clock.profile.swing_s.std_error;
    let stepped = stepped.min_by(|a, b| std_error(a).total_cmp(&std_error(b)))?;
    let dated: Vec<(LatencyStep, Option<f64>)> =
        stepped.steps().into_iter().map(|step| (step, jump_at_s(&arm.joints, &step))).collect();
    if clocks.len() < 2 && dated.iter().any(|(_, at_s)| at_s.is_none()) {
        return None;
    }
    let dated = dated.into_iter();
    let steps: Vec<LatencyStep> =
        dated.map(|(step, at_s)| LatencyStep { at_s: at_s.unwrap_or(step.at_s), ..step }).collect();
    let profile = stepped.profile_of_joints(&steps)?;
    let mut corrected = arm.clone();
    corrected.replace_joints(with_true_stamps(&arm.joints, &profile));
    Some((corrected, profile))
}

/// Whether streams with independent stamps remain comparable, and no latency varies by more than a small share of the
/// steps in `removed`.
pub(super) fn are_others_steady(
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
    removed: &LatencyProfile,
) -> bool {
    /// Larger variations remain if the steps are not the joint states'.
    const MAX_REMAINING_SHARE: f64 = 0.1;
    let max_s = MAX_REMAINING_SHARE * removed.swing_s.value.abs();
    let is_steady = |clock: &OtherClock| {
        !clock.profile.is_unsteady || clock.profile.swing_s.value.abs() < max_s
    };
    let clocks = other_clocks(arm, found);
    !clocks.is_empty() && clocks.iter().all(is_steady)
}

fn other_clocks<'a>(arm: &Arm, found: &'a ArmStreamsDiagnosis) -> Vec<OtherClock<'a>> {
    let poses = arm.poses.iter().zip(&found.arm.streams).enumerate();
    let poses = poses.filter(|(index, (source, _))| {
        !source.stamps_copied && !arm.poses[..*index].iter().any(|other| source.is_copy_of(other))
    });
    let poses = poses.filter_map(|(_, (_, stream))| {
        Some(OtherClock {
            latency_s: stream.latency_s.as_ref().ok()?.value,
            profile: stream.latency_profile.as_ref().ok()?,
            is_skewed: stream.is_skew_chosen,
        })
    });
    let is_significant =
        |skew: &Measured| skew.value.abs() > MIN_STD_ERRORS * skew.std_error.max(f64::MIN_POSITIVE);
    let imus = arm.imus.iter().zip(&found.imus).filter(|(source, _)| !source.stamps_copied);
    let imus = imus.filter_map(|(_, imu)| {
        Some(OtherClock {
            latency_s: imu.latency_s.as_ref().ok()?.value,
            profile: imu.latency_profile.as_ref().ok()?,
            is_skewed: imu.skew.as_ref().is_ok_and(is_significant),
        })
    });
    poses.chain(imus).collect()
}

impl OtherClock<'_> {
    /// Steps of the latency. A short ramp is a step near which rows were lost.
    fn steps(&self) -> Vec<LatencyStep> {
        /// A window of the profile, which resolves no more.
        const MAX_STEP_S: f64 = 1.0;
        match self.profile.shape {
            _ if !self.profile.is_unsteady => Vec::new(),
            LatencyShape::Ramp { from_s, to_s } if to_s - from_s < MAX_STEP_S => {
                vec![LatencyStep { at_s: 0.5 * (from_s + to_s), size_s: self.profile.swing_s }]
            }
            _ => self.profile.steps.clone(),
        }
    }

    /// Profile of the joint states with `steps` of this stream, relative to their smallest latency.
    fn profile_of_joints(&self, steps: &[LatencyStep]) -> Option<LatencyProfile> {
        let (_, mut level_s) = *self.profile.levels.knots.first()?;
        let mut levels = vec![(f64::NEG_INFINITY, level_s)];
        for step in steps {
            level_s += step.size_s.value;
            levels.push((step.at_s, level_s));
        }
        let latency_s = |level: &&(f64, f64)| (self.latency_s + level.1).abs();
        let least = levels.iter().min_by(|a, b| latency_s(a).total_cmp(&latency_s(b)));
        let least_s = least.map_or(0.0, |level| level.1);
        levels.iter_mut().for_each(|(_, level_s)| *level_s = least_s - *level_s);
        let opposite =
            |step: &LatencyStep| LatencyStep { size_s: step.size_s.scaled(-1.0), ..*step };
        let windows = self.profile.windows.iter();
        Some(LatencyProfile {
            swing_s: self.profile.swing_s.scaled(-1.0),
            is_unsteady: true,
            shape: LatencyShape::Steps,
            steps: steps.iter().map(opposite).collect(),
            levels: PiecewiseLatency::with_steps(&levels),
            windows: windows.map(|&(t_s, one)| (t_s, one.scaled(-1.0))).collect(),
            parameters: self.profile.parameters,
            ..LatencyProfile::default()
        })
    }
}

/// Time when the joints jump by as much as they move during `step` of another stream's latency. `None` if they do not
/// jump near the step.
fn jump_at_s(joints: &JointTrack, step: &LatencyStep) -> Option<f64> {
    /// A profile dates a step to a window or to the next motion.
    const MAX_ERROR_S: f64 = 1.5;
    /// Of the step's size.
    const MAX_DIFFERENCE_SHARE: f64 = 0.3;
    let moved =
        |from: usize, column: usize| joints.row(from + 1)[column] - joints.row(from)[column];
    let slope = |from: usize, column: usize| {
        moved(from, column) / (joints.t_s[from + 1] - joints.t_s[from])
    };
    // Per interval: its middle, the time that its stamps have too much, and the joints' speed.
    let intervals = (1..joints.t_s.len().saturating_sub(2)).map(|from| {
        let interval_s = joints.t_s[from + 1] - joints.t_s[from];
        let (mut along, mut squares) = (0.0, 0.0);
        for column in 0..joints.dof {
            let speed = 0.5 * (slope(from - 1, column) + slope(from + 1, column));
            along += speed * moved(from, column);
            squares += speed * speed;
        }
        (joints.t_s[from] + 0.5 * interval_s, interval_s - along / squares, squares.sqrt())
    });
    let moving = intervals.filter(|interval| interval.1.is_finite());
    let near: Vec<_> =
        moving.filter(|interval| (interval.0 - step.at_s).abs() < MAX_ERROR_S).collect();
    let mut errors: Vec<f64> =
        near.iter().map(|interval| (interval.1 * interval.2).abs()).collect();
    let noise = STD_DEV_PER_MEDIAN * median(&mut errors)?;
    let size_s = -step.size_s.value;
    let difference = |interval: &(f64, f64, f64)| (interval.1 - size_s).abs();
    let visible = near.iter().filter(|interval| interval.2 * size_s.abs() > MIN_STD_ERRORS * noise);
    let best = visible.min_by(|a, b| difference(a).total_cmp(&difference(b)))?;
    (difference(best) < MAX_DIFFERENCE_SHARE * size_s.abs()).then_some(best.0)
}

/// Subtracts the latency in `profile` from the stamps of joint states, and drops rows that are then out of order.
fn with_true_stamps(joints: &JointTrack, profile: &LatencyProfile) -> JointTrack {
    let rows = rows_in_true_order(&joints.t_s, profile);
    let t_s = rows.iter().map(|(_, t_s)| *t_s).collect();
    JointTrack { t_s, ..joints.at_rows(rows.iter().map(|(row, _)| *row)) }
}

/// The same for the samples of one joint.
pub(super) fn samples_with_true_stamps<'a>(
    samples: &JointSamples<'a>,
    profile: &LatencyProfile,
) -> JointSamples<'a> {
    let rows = rows_in_true_order(&samples.t_s, profile);
    let values = |all: &[f64]| rows.iter().filter_map(|(row, _)| all.get(*row).copied()).collect();
    JointSamples {
        t_s: rows.iter().map(|(_, t_s)| *t_s).collect(),
        position: values(&samples.position),
        velocity: values(&samples.velocity),
    }
}

/// Rows with their true stamps.
fn rows_in_true_order(t_s: &[f64], profile: &LatencyProfile) -> Vec<(usize, f64)> {
    let latency_s = |t_s: f64| {
        let knots = &profile.levels.knots;
        let level = knots.partition_point(|knot| knot.0 < t_s).saturating_sub(1);
        knots.get(level).map_or(0.0, |knot| knot.1)
    };
    monotonic_rows(t_s.iter().map(|t_s| t_s - latency_s(*t_s)).enumerate())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(at_s: f64, levels: [f64; 2]) -> LatencyProfile {
        let size_s = Measured { value: levels[1] - levels[0], std_error: 1e-4, dof: 100.0 };
        LatencyProfile {
            swing_s: size_s,
            is_unsteady: true,
            shape: LatencyShape::Steps,
            steps: vec![LatencyStep { at_s, size_s }],
            levels: PiecewiseLatency::with_steps(&[(0.0, levels[0]), (at_s, levels[1])]),
            parameters: 2,
            ..LatencyProfile::default()
        }
    }

    /// 10 s at 100 Hz, late by `late_s` from `from_s` on: the stamps step, or the positions. Each position is its true
    /// time.
    fn joints(from_s: f64, late_s: f64, do_stamps_step: bool) -> JointTrack {
        let regular: Vec<f64> = (0..1000).map(|k| 0.01 * f64::from(k)).collect();
        let late_by = |t_s: f64| if t_s < from_s { 0.0 } else { late_s };
        let (t_s, q) = match do_stamps_step {
            true => (regular.iter().map(|t_s| t_s + late_by(*t_s)).collect(), regular),
            false => (regular.clone(), regular.iter().map(|t_s| t_s - late_by(*t_s)).collect()),
        };
        JointTrack { t_s, dof: 1, qd: vec![1.0; 1000], q, noise: Vec::new() }
    }

    #[test]
    fn stamps_after_or_before_a_step_are_corrected() {
        for (latency_s, levels, do_stamps_step) in [
            // The stream is in time before the step, or after it.
            (0.0, [0.0, -0.03], true),
            (0.0, [0.03, 0.0], true),
            (0.005, [0.0, -0.03], true),
            // Positions of the last 30 ms are repeated.
            (0.0, [0.0, -0.03], false),
        ] {
            let late_s = levels[0] - levels[1];
            // Dated half a second late.
            let profile = steps(5.5, levels);
            let by = OtherClock { latency_s, profile: &profile, is_skewed: false };
            let joints = joints(5.0, late_s, do_stamps_step);
            let step = by.steps()[0];
            let at_s = jump_at_s(&joints, &step).expect("a jump");
            let profile = by.profile_of_joints(&[LatencyStep { at_s, ..step }]).expect("levels");
            let corrected = with_true_stamps(&joints, &profile);
            let offset_s = if levels[0] == 0.0 { 0.0 } else { late_s };
            let pairs = corrected.t_s.iter().zip(&corrected.q);
            let worst = pairs.map(|(t_s, true_s)| (t_s - true_s - offset_s).abs());
            assert!(worst.fold(0.0, f64::max) < 1e-9, "{levels:?} {do_stamps_step}");
            assert!(corrected.t_s.len() > 990);
        }
    }

    #[test]
    fn gaps_are_no_steps_of_the_clock() {
        let mut joints = joints(20.0, 0.0, true);
        for values in [&mut joints.t_s, &mut joints.q, &mut joints.qd] {
            values.drain(500..503);
        }
        assert_eq!(jump_at_s(&joints, &steps(5.0, [0.0, -0.03]).steps[0]), None);
    }
}
