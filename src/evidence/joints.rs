use std::f64::consts::TAU;

use rayon::prelude::*;

use crate::diagnosis::{
    EstimateResult, JointDiagnosis, JointSampleKind, LimitViolation, PeakAcceleration,
    VelocityDiagnosis, VelocitySamples, diagnose_velocity, encoder_step, peak_acceleration,
    position_violation, range_of, rates, row_blocks, speed_violation,
    speed_violation_from_positions,
};
use crate::robot::{JointKind, Limits};
use crate::run::{Arm, JointLeap, JointSamples, JointStateCorrection, Run, VelocitySource};

/// One joint of a chain.
#[derive(Clone, Debug)]
pub struct JointEvidence {
    /// Name in the log.
    pub name: String,
    /// Prismatic.
    pub is_prismatic: bool,
    /// Limits in the model.
    pub limits: Limits,
    /// Motion over all samples.
    pub motion: JointMotion,
    /// Recorded velocities against positions. `None` without velocities.
    pub velocity: Option<EstimateResult<VelocityDiagnosis>>,
    /// Joint that its positions belong to according to the poses, and a factor.
    pub actual: Option<(usize, f64)>,
}

/// Motion of a joint over the run.
#[derive(Clone, Debug, Default)]
pub struct JointMotion {
    /// Violation of the position limits.
    pub positions: Option<LimitViolation>,
    /// Full turns beyond its limits throughout the run; positive above the upper one.
    pub turns_beyond: Option<f64>,
    /// Turn in which a joint with limits is logged.
    pub wrapped: Option<WrappedRange>,
    /// Violation of the speed limit.
    pub speeds: Option<LimitViolation>,
    /// Jump of several joints at the highest speed.
    pub leap: Option<JointLeap>,
    /// Largest acceleration, if the samples allow an estimate.
    pub abruptness: Option<PeakAcceleration>,
    /// Rotates without limits, according to model or log.
    pub is_endless: bool,
}

/// Positions as logged at both sides of the jumps of a joint that is logged modulo one turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrappedRange {
    /// Lower and upper end, rad.
    pub ends_rad: [f64; 2],
    /// Bare numbers of a table, which violate no convention.
    pub is_of_table: bool,
}

/// Corrections of wrong names or units: motion cannot be judged on wrong numbers.
pub(super) fn mending(arm: &Arm, found: &JointDiagnosis) -> Option<JointStateCorrection> {
    let reading = found.encoding.as_ref().ok()?;
    if reading.is_as_logged() {
        return None;
    }
    // The zero of an encoding such as ticks is part of the unit. Other zeros are estimates, and limits
    // apply to logged positions.
    let coded_zero = |joint: usize| {
        let coded = found.scales.iter().find(|scale| scale.column == joint && scale.is_coded());
        coded.map_or(0.0, |scale| scale.offset)
    };
    let offset: Vec<f64> = (0..found.offsets.len()).map(coded_zero).collect();
    let mut mending =
        JointStateCorrection { offset, ..JointStateCorrection::identity(arm.joint_names.len()) };
    if let Some(really) = &reading.permutation {
        really.iter().enumerate().for_each(|(named, &really)| mending.from[really] = named);
    }
    for (factor, slides) in mending.factor.iter_mut().zip(arm.are_prismatic()) {
        *factor = if reading.is_in_degrees && !slides { 1f64.to_radians() } else { 1.0 };
    }
    reading.unit_errors.iter().for_each(|slip| mending.factor[slip.column] *= slip.factor);
    Some(mending)
}

pub(super) fn joint_evidence(
    run: &Run,
    arm: &Arm,
    joint: usize,
    samples: &JointSamples<'_>,
) -> JointEvidence {
    /// Half the longest window of a speed.
    const MAX_LEAP_DISTANCE_S: f64 = 0.1;
    let name = arm.joint_names[joint].clone();
    let model = arm.robot.joint(&name);
    let limits = model.map(|joint| joint.limits).unwrap_or_default();
    let mut motion = JointMotion::default();
    if let Some(source) = arm.joint_sources.get(joint) {
        let JointSamples { t_s, position, velocity } = samples;
        let mut wrapped = run.wrapped.iter();
        let wrapped =
            wrapped.find(|wrapped| wrapped.stream == source.stream && wrapped.joint == source.name);
        motion.is_endless =
            wrapped.is_some() || model.is_some_and(|joint| joint.kind == JointKind::Continuous);
        let is_revolute = model.is_some_and(|joint| joint.kind == JointKind::Revolute);
        match wrapped {
            // The turns of unwrapped positions are unknown, so only those as logged are compared with limits.
            Some(wrapped) => {
                let is_of_table =
                    run.streams.get(source.stream).is_some_and(|stream| stream.is_from_table);
                let ends_rad = wrapped.range_rad;
                motion.wrapped = is_revolute.then_some(WrappedRange { ends_rad, is_of_table });
            }
            None => {
                motion.positions = position_violation(t_s, position, &limits);
                motion.turns_beyond =
                    is_revolute.then(|| turns_beyond(position, &limits)).flatten();
            }
        }
        (motion.speeds, motion.abruptness) = match source.velocities {
            VelocitySource::Logged | VelocitySource::DerivedLoggedClose => (
                speed_violation(t_s, velocity, &limits),
                peak_acceleration(t_s, velocity, JointSampleKind::Velocities, 0.0),
            ),
            VelocitySource::Derived => {
                let step = position_step(run, source.stream, samples);
                let beyond = speed_violation_from_positions(t_s, position, &limits, step);
                (beyond, peak_acceleration(t_s, position, JointSampleKind::Positions, step))
            }
        };
    }
    motion.leap = motion.speeds.as_ref().and_then(|speeds| {
        let is_there = |leap: &&JointLeap| {
            let since_s = leap.at.seconds_since(run.origin) - speeds.at_s;
            arm.joint_sources.iter().any(|source| source.stream == leap.stream)
                && since_s.abs() < MAX_LEAP_DISTANCE_S
        };
        run.sample_filter.leaps.iter().find(is_there).copied()
    });
    let is_prismatic = model.is_some_and(|joint| joint.kind == JointKind::Prismatic);
    JointEvidence { name, is_prismatic, limits, motion, velocity: None, actual: None }
}

/// Span of the errors of positions: the encoder's step. More if their age varies, because rows are polled while the source
/// sends new values: the highest speed times the interval between new values.
pub(super) fn position_step(run: &Run, stream: usize, samples: &JointSamples<'_>) -> f64 {
    /// For the speed; longer than the age varies.
    const SPEED_WINDOW_S: f64 = 0.1;
    let step = encoder_step(&samples.position);
    let mut repeats = run.sample_filter.repeated.iter();
    let Some(held) = repeats.find(|held| held.stream == stream && held.repeated > 0) else {
        return step;
    };
    let speeds = rates(&samples.t_s, &samples.position, SPEED_WINDOW_S).into_iter();
    let highest = speeds.map(f64::abs).filter(|speed| speed.is_finite()).fold(0.0, f64::max);
    step.max(highest / held.values_hz)
}

/// Whole turns beyond `limits` of all positions (rad), if subtracting them brings every position within.
fn turns_beyond(position: &[f64], limits: &Limits) -> Option<f64> {
    /// Turns an encoder counts.
    const MAX_TURNS: f64 = 4.0;
    /// Excess as a share of the range. At or below it the model's limit may be wrong (MOT003's `info`).
    const MAX_SLIGHT_EXCESS: f64 = 0.01;
    let (lower, upper) = limits.lower.zip(limits.upper)?;
    let [low, high] = range_of(position.iter().copied().filter(|position| position.is_finite()));
    let slight = MAX_SLIGHT_EXCESS * (upper - lower);
    let turns = match () {
        () if low > upper + slight => ((high - upper) / TAU).ceil(),
        () if high < lower - slight => ((low - lower) / TAU).floor(),
        () => return None,
    };
    let is_within = low - TAU * turns >= lower && high - TAU * turns <= upper;
    (is_within && turns.abs() <= MAX_TURNS).then_some(turns)
}

/// Change points of positions, such as a lost zero.
pub(super) fn change_points(found: &JointDiagnosis, joints: usize) -> Vec<Vec<f64>> {
    let mut change_points = vec![Vec::new(); joints];
    for change in &found.changes {
        if let Some(own) = change_points.get_mut(change.column) {
            own.push(change.change.at_s);
        }
    }
    change_points
}

/// Compares recorded velocities with positions, which change at `change_points`. `None` for joints without
/// velocities.
pub(super) fn velocities(
    recorded: &[JointSamples<'_>],
    change_points: &[Vec<f64>],
) -> Vec<Option<EstimateResult<VelocityDiagnosis>>> {
    const MAX_SAMPLES: usize = 24_000;
    let some = |of: &[f64]| -> Vec<f64> {
        row_blocks(of.len(), MAX_SAMPLES).flat_map(|rows| of[rows].iter().copied()).collect()
    };
    let few: Vec<[Vec<f64>; 3]> = recorded
        .iter()
        .map(|JointSamples { t_s, position, velocity }| [some(t_s), some(position), some(velocity)])
        .collect();
    let samples: Vec<VelocitySamples<'_>> = few
        .iter()
        .zip(change_points)
        .map(|([t_s, position, velocity], change_points)| VelocitySamples {
            t_s,
            position,
            velocity,
            breaks: change_points,
        })
        .collect();
    let of = |joint: usize| {
        let has_any = samples[joint].velocity.iter().any(|velocity| velocity.is_finite());
        has_any.then(|| diagnose_velocity(&samples, joint))
    };
    (0..samples.len()).into_par_iter().map(of).collect()
}
