//! Range of a motion, and limit violations.

use crate::samples::sampling::range_of;
use ground::robot::Chain;
use ground::stream::JointTrack;

/// Limited quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitKind {
    /// Lowest position.
    Lower,
    /// Highest position.
    Upper,
    /// Speed.
    Speed,
    /// Acceleration.
    Acceleration,
}

/// Violation of one limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitViolation {
    /// Index in the chain.
    pub joint: usize,
    /// Limited quantity.
    pub bound: LimitKind,
    /// Time of the largest violation.
    pub t_s: f64,
    /// Value then, SI units.
    pub value: f64,
    /// Its limit.
    pub limit: f64,
}

/// Range of a joint's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointRange {
    /// Position, rad or m.
    pub low: f64,
    /// Position, rad or m.
    pub high: f64,
    /// Maximum, rad/s or m/s.
    pub speed: f64,
    /// Maximum between samples, rad/s² or m/s².
    pub acceleration: f64,
}

/// Time, velocity and acceleration by differences.
fn rates(motion: &JointTrack, joint: usize) -> impl Iterator<Item = (f64, f64, f64)> {
    let (dof, last) = (motion.dof, motion.len().saturating_sub(1));
    (0..last).map(move |row| {
        let step_s = motion.t_s[row + 1] - motion.t_s[row];
        let (a, b) = (row * dof + joint, (row + 1) * dof + joint);
        let speed = (motion.q[b] - motion.q[a]) / step_s;
        (motion.t_s[row], speed, (motion.qd[b] - motion.qd[a]) / step_s)
    })
}

/// Range per joint.
pub fn joint_ranges(motion: &JointTrack) -> Vec<JointRange> {
    let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |a: f64, b| a.max(b.abs()));
    let extent = |joint: usize| {
        let [low, high] = range_of(motion.positions_of(joint));
        let speeds = rates(motion, joint).map(|rate| rate.1);
        let speed = most(&mut motion.velocities_of(joint).chain(speeds));
        let acceleration = most(&mut rates(motion, joint).map(|rate| rate.2));
        JointRange { low, high, speed, acceleration }
    };
    (0..motion.dof).map(extent).collect()
}

/// Limits violated by a motion, each at its largest violation. `speed` and `acceleration` are limits per
/// joint.
pub fn limit_violations(
    chain: &Chain,
    motion: &JointTrack,
    speed: &[f64],
    acceleration: &[f64],
) -> Vec<LimitViolation> {
    /// Rounding in a file.
    const ROUNDING_TOLERANCE: f64 = 1e-6;
    /// For finite differences of rounded values.
    const DIFFERENCE_TOLERANCE: f64 = 1e-2;
    let mut found = Vec::new();
    for (joint, limits) in chain.limits().iter().enumerate() {
        let mut hold = |bound: LimitKind, limit: f64, over: Vec<(f64, f64, f64)>| {
            let worst = over.into_iter().max_by(|a, b| a.2.total_cmp(&b.2));
            if let Some((t_s, value, _)) = worst.filter(|worst| worst.2 > 0.0 || worst.2.is_nan()) {
                found.push(LimitViolation { joint, bound, t_s, value, limit });
            }
        };
        let positions = || motion.t_s.iter().copied().zip(motion.positions_of(joint));
        if let Some(lower) = limits.lower {
            let over = |(t_s, q): (f64, f64)| (t_s, q, lower - q - ROUNDING_TOLERANCE);
            hold(LimitKind::Lower, lower, positions().map(over).collect());
        }
        if let Some(upper) = limits.upper {
            let over = |(t_s, q): (f64, f64)| (t_s, q, q - upper - ROUNDING_TOLERANCE);
            hold(LimitKind::Upper, upper, positions().map(over).collect());
        }
        let most = speed[joint];
        let logged = motion.t_s.iter().zip(motion.velocities_of(joint));
        let logged = logged
            .map(|(t_s, speed)| (*t_s, speed, speed.abs() - most * (1.0 + ROUNDING_TOLERANCE)));
        let between = rates(motion, joint)
            .map(|(t_s, speed, _)| (t_s, speed, speed.abs() - most * (1.0 + DIFFERENCE_TOLERANCE)));
        hold(LimitKind::Speed, most, logged.chain(between).collect());
        let most = acceleration[joint];
        let between = rates(motion, joint)
            .map(|(t_s, _, rate)| (t_s, rate, rate.abs() - most * (1.0 + DIFFERENCE_TOLERANCE)));
        hold(LimitKind::Acceleration, most, between.collect());
    }
    found
}
