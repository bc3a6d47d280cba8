//! The joints of an arm, and how they move by all of their samples.

use std::f64::consts::TAU;

use rayon::prelude::*;

use crate::diagnosis::{
    Abruptness, Excess, JointDiagnosis, Seen, Series, VelocityDiagnosis, VelocitySamples,
    abruptness, beyond_positions, beyond_speed, beyond_speed_of_positions, diagnose_velocity,
    encoder_step, stretches,
};
use crate::robot::{JointKind, Limits};
use crate::run::{Arm, JointMending, JointSamples, Run, Velocities};

/// One joint of a chain.
#[derive(Clone, Debug)]
pub struct JointEvidence {
    /// Its name, as the log spells it.
    pub name: String,
    /// Whether it slides.
    pub prismatic: bool,
    /// The limits that the model states.
    pub limits: Limits,
    /// What it does, by all of its samples.
    pub motion: JointMotion,
    /// Its velocities, as recorded, against its positions, as recorded; `None` where there are none.
    pub velocity: Option<Seen<VelocityDiagnosis>>,
    /// What its positions really are, where the arm's pose streams showed that: those that stand under the
    /// joint in this place of the list, times a factor.
    pub really: Option<(usize, f64)>,
}

/// What a joint does over the run.
#[derive(Clone, Debug, Default)]
pub struct JointMotion {
    /// How far it is beyond its positions' limits.
    pub positions: Option<Excess>,
    /// The turns by which it is beyond its limits throughout the run, if it is within them that many
    /// turns away; positive beyond the upper limit.
    pub turns_beyond: Option<f64>,
    /// How far it is beyond its speed limit.
    pub speeds: Option<Excess>,
    /// How abruptly it changes its speed; `None` where its samples do not tell.
    pub abruptness: Option<Abruptness>,
    /// Whether it turns without end, by the model or as the log shows.
    pub is_endless: bool,
}

/// What makes the joint states those that the arm has, where they are far from that: how the arm moves
/// is not told by numbers that are no positions.
pub(super) fn mending(arm: &Arm, found: &JointDiagnosis) -> Option<JointMending> {
    let reading = found.reading.as_ref().ok()?;
    if reading.is_as_logged() {
        return None;
    }
    // The zero of a code such as ticks belongs to the unit. Any other zero is an estimate, and limits are
    // checked on positions that were logged.
    let coded_zero = |joint: usize| {
        let coded = found.scales.iter().find(|scale| scale.column == joint && scale.is_coded());
        coded.map_or(0.0, |scale| scale.offset)
    };
    let offset: Vec<f64> = (0..found.offsets.len()).map(coded_zero).collect();
    let mut mending = JointMending { offset, ..JointMending::none(arm.joint_names.len()) };
    if let Some((really, _)) = &reading.permutation {
        really.iter().enumerate().for_each(|(named, &really)| mending.from[really] = named);
    }
    for (factor, slides) in mending.factor.iter_mut().zip(arm.slides()) {
        *factor = if reading.degrees.is_some() && !slides { 1f64.to_radians() } else { 1.0 };
    }
    reading.slips.iter().for_each(|slip| mending.factor[slip.column] *= slip.factor);
    Some(mending)
}

/// A joint, and what it does by all of its samples.
pub(super) fn joint_evidence(
    run: &Run,
    arm: &Arm,
    joint: usize,
    samples: &JointSamples<'_>,
) -> JointEvidence {
    let name = arm.joint_names[joint].clone();
    let model = arm.robot.joint(&name);
    let limits = model.map(|joint| joint.limits).unwrap_or_default();
    let mut motion = JointMotion::default();
    if let Some(source) = arm.joint_facts.get(joint) {
        let JointSamples { t_s, position, velocity } = samples;
        let is_folded = run
            .folded
            .iter()
            .any(|folded| folded.stream == source.stream && folded.joint == source.name);
        motion.is_endless =
            is_folded || model.is_some_and(|joint| joint.kind == JointKind::Continuous);
        // What is logged within one turn has no place on a longer way.
        if !is_folded {
            motion.positions = beyond_positions(t_s, position, &limits);
            let turns = model.is_some_and(|joint| joint.kind == JointKind::Revolute);
            motion.turns_beyond = if turns { turns_beyond(position, &limits) } else { None };
        }
        (motion.speeds, motion.abruptness) = match source.velocities {
            Velocities::Logged | Velocities::Near => (
                beyond_speed(t_s, velocity, &limits),
                abruptness(t_s, velocity, Series::Velocities, 0.0),
            ),
            Velocities::Derived => {
                let step = encoder_step(position);
                let beyond = beyond_speed_of_positions(t_s, position, &limits, step);
                (beyond, abruptness(t_s, position, Series::Positions, step))
            }
        };
    }
    let prismatic = model.is_some_and(|joint| joint.kind == JointKind::Prismatic);
    JointEvidence { name, prismatic, limits, motion, velocity: None, really: None }
}

/// The turns by which positions, rad, are beyond `limits` throughout, if they are within them that many
/// turns away.
fn turns_beyond(position: &[f64], limits: &Limits) -> Option<f64> {
    /// An encoder counts no more turns than this.
    const MOST: f64 = 4.0;
    /// Within this share of the range beyond a limit the model's limit is as likely wrong (MOT003's `info`).
    const SLIGHT: f64 = 0.01;
    let (lower, upper) = limits.lower.zip(limits.upper)?;
    let finite = position.iter().copied().filter(|position| position.is_finite());
    let (low, high) =
        finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), q| (low.min(q), high.max(q)));
    let slight = SLIGHT * (upper - lower);
    let turns = match () {
        () if low > upper + slight => ((high - upper) / TAU).ceil(),
        () if high < lower - slight => ((low - lower) / TAU).floor(),
        () => return None,
    };
    let is_within = low - TAU * turns >= lower && high - TAU * turns <= upper;
    (is_within && turns.abs() <= MOST).then_some(turns)
}

/// The times from which on the positions of each of so many joints are others than before, as one whose zero is
/// lost.
pub(super) fn breaks(found: &JointDiagnosis, joints: usize) -> Vec<Vec<f64>> {
    let mut breaks = vec![Vec::new(); joints];
    for change in &found.changes {
        let both = [&change.zero, &change.factor].into_iter().flatten();
        if let Some(own) = breaks.get_mut(change.column) {
            own.extend(both.map(|change| change.at_s));
        }
    }
    breaks
}

/// The velocities of each joint against its positions, both as recorded; `None` of one that has none. The
/// positions are others from each of `breaks` on.
pub(super) fn velocities(
    recorded: &[JointSamples<'_>],
    breaks: &[Vec<f64>],
) -> Vec<Option<Seen<VelocityDiagnosis>>> {
    /// More samples tell no more.
    const ENOUGH: usize = 24_000;
    let some = |of: &[f64]| -> Vec<f64> {
        stretches(of.len(), ENOUGH).flat_map(|rows| of[rows].iter().copied()).collect()
    };
    let few: Vec<[Vec<f64>; 3]> = recorded
        .iter()
        .map(|JointSamples { t_s, position, velocity }| [some(t_s), some(position), some(velocity)])
        .collect();
    let samples: Vec<VelocitySamples<'_>> = few
        .iter()
        .zip(breaks)
        .map(|([t_s, position, velocity], breaks)| VelocitySamples {
            t_s,
            position,
            velocity,
            breaks,
        })
        .collect();
    let of = |joint: usize| {
        let has_any = samples[joint].velocity.iter().any(|velocity| velocity.is_finite());
        has_any.then(|| diagnose_velocity(&samples, joint))
    };
    (0..samples.len()).into_par_iter().map(of).collect()
}
