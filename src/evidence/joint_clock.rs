//! Steps of the joint states' clock. All other streams appear to step in the opposite direction at the same time.

use std::sync::Arc;

use super::estimate::ArmStreamsDiagnosis;
use crate::diagnosis::{LatencyProfile, LatencyShape, LatencyStep, Measured};
use crate::run::Arm;
use crate::stats::median;
use crate::stream::JointTrack;

/// Standard errors of a significant clock skew.
const MIN_STD_ERRORS: f64 = 6.0;

/// Stream whose stamps are independent of the joint states'.
struct OtherClock<'a> {
    latency_s: f64,
    profile: &'a LatencyProfile,
    is_skewed: bool,
}

/// The arm with corrected stamps of the joint states, and the latency profile of the joint states. `None` unless at
/// least two streams have independent stamps, all of them vary, and one of them has latency steps.
pub(super) fn with_corrected_joint_stamps(
    arm: &Arm,
    found: &ArmStreamsDiagnosis,
) -> Option<(Arm, LatencyProfile)> {
    let clocks = other_clocks(arm, found);
    let deviates = |clock: &OtherClock| clock.profile.is_unsteady || clock.is_skewed;
    if arm.trajectory.is_some() || clocks.len() < 2 || !clocks.iter().all(deviates) {
        return None;
    }
    let stepped = clocks.iter().filter(|clock| !clock.steps().is_empty());
    let std_error = |clock: &&OtherClock| clock.profile.swing_s.std_error;
    let stepped = stepped.min_by(|a, b| std_error(a).total_cmp(&std_error(b)))?;
    let steps = stepped.steps_in_stamps(&arm.joints.t_s);
    let mut corrected = arm.clone();
    corrected.joints = Arc::new(corrected_stamps(&arm.joints, stepped, &steps)?);
    Some((corrected, joint_profile(stepped.profile, &steps)))
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

    /// Steps, dated by the stamps `t_s` of the joint states: each moves to the interval that is longer by its size, if
    /// there is one nearby.
    fn steps_in_stamps(&self, t_s: &[f64]) -> Vec<LatencyStep> {
        /// A profile dates a step to a window or to the next motion.
        const MAX_ERROR_S: f64 = 1.5;
        /// Of the step's size.
        const MAX_DIFFERENCE_SHARE: f64 = 0.3;
        let mut intervals: Vec<f64> = t_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let period_s = median(&mut intervals).unwrap_or(0.0);
        let in_stamps = |step: LatencyStep| {
            let size_s = step.size_s.value;
            let near = t_s.windows(2).filter(|pair| (pair[0] - step.at_s).abs() < MAX_ERROR_S);
            let difference = |pair: &[f64]| (pair[1] - pair[0] - period_s + size_s).abs();
            let interval = near.min_by(|a, b| difference(a).total_cmp(&difference(b)));
            let interval =
                interval.filter(|pair| difference(pair) < MAX_DIFFERENCE_SHARE * size_s.abs());
            let at_s = interval.map_or(step.at_s, |pair| 0.5 * (pair[0] + pair[1]));
            LatencyStep { at_s, ..step }
        };
        self.steps().into_iter().map(in_stamps).collect()
    }
}

/// Assumes that the smallest latency is correct.
fn corrected_stamps(
    joints: &JointTrack,
    by: &OtherClock,
    steps: &[LatencyStep],
) -> Option<JointTrack> {
    let levels: Vec<f64> = levels(by.profile, steps).into_iter().map(|level| level.1).collect();
    let latency = |level_s: &&f64| (by.latency_s + **level_s).abs();
    let correct_s = *levels.iter().min_by(|a, b| latency(a).total_cmp(&latency(b)))?;
    let corrected = |t_s: f64| {
        let level = steps.partition_point(|step| step.at_s < t_s);
        t_s + levels[level] - correct_s
    };
    let mut rows: Vec<(f64, usize)> =
        joints.t_s.iter().enumerate().map(|(row, t_s)| (corrected(*t_s), row)).collect();
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.dedup_by(|next, kept| next.0 <= kept.0);
    let values = |all: &[f64]| {
        let rows = rows.iter().flat_map(|(_, row)| &all[row * joints.dof..(row + 1) * joints.dof]);
        rows.copied().collect()
    };
    Some(JointTrack {
        t_s: rows.iter().map(|(t_s, _)| *t_s).collect(),
        q: values(&joints.q),
        qd: values(&joints.qd),
        ..joints.clone()
    })
}

/// Levels of a profile with these steps. Those of a ramp contain its slope.
fn levels(profile: &LatencyProfile, steps: &[LatencyStep]) -> Vec<(f64, f64)> {
    let Some(first) = profile.levels.first().copied() else { return Vec::new() };
    let later = steps.iter().scan(first.1, |level_s, step| {
        *level_s += step.size_s.value;
        Some((step.at_s, *level_s))
    });
    std::iter::once(first).chain(later).collect()
}

/// Profile of the joint states against a stream with this profile and these steps.
fn joint_profile(other: &LatencyProfile, steps: &[LatencyStep]) -> LatencyProfile {
    let step = |step: &LatencyStep| LatencyStep { size_s: step.size_s.scaled(-1.0), ..*step };
    LatencyProfile {
        swing_s: other.swing_s.scaled(-1.0),
        is_unsteady: true,
        shape: LatencyShape::Steps,
        steps: steps.iter().map(step).collect(),
        levels: levels(other, steps).into_iter().map(|(at_s, level_s)| (at_s, -level_s)).collect(),
        windows: other.windows.iter().map(|&(t_s, one)| (t_s, one.scaled(-1.0))).collect(),
    }
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
            levels: vec![(0.0, levels[0]), (at_s, levels[1])],
            windows: Vec::new(),
        }
    }

    /// 10 s at 100 Hz; stamps from `from_s` on are late by `late_s`. Each position is its true time.
    fn joints(from_s: f64, late_s: f64) -> JointTrack {
        let true_s: Vec<f64> = (0..1000).map(|k| 0.01 * f64::from(k)).collect();
        let stamp = |t_s: &f64| if *t_s < from_s { *t_s } else { t_s + late_s };
        let t_s = true_s.iter().map(stamp).collect();
        JointTrack { t_s, dof: 1, qd: vec![1.0; 1000], q: true_s, noise: Vec::new() }
    }

    #[test]
    fn stamps_after_or_before_a_step_are_corrected() {
        for (late_s, latency_s, levels) in [
            // The stream is in time before the step, or after it.
            (0.03, 0.0, [0.0, -0.03]),
            (0.03, 0.0, [0.03, 0.0]),
            (0.03, 0.005, [0.0, -0.03]),
        ] {
            // Dated half a second late.
            let profile = steps(5.5, levels);
            let by = OtherClock { latency_s, profile: &profile, is_skewed: false };
            let joints = joints(5.0, late_s);
            let steps = by.steps_in_stamps(&joints.t_s);
            let corrected = corrected_stamps(&joints, &by, &steps).expect("levels");
            let offset_s = if levels[0] == 0.0 { 0.0 } else { late_s };
            let pairs = corrected.t_s.iter().zip(&corrected.q);
            let worst = pairs.map(|(t_s, true_s)| (t_s - true_s - offset_s).abs());
            assert!(worst.fold(0.0, f64::max) < 1e-9, "{late_s} {levels:?}");
        }
    }
}
