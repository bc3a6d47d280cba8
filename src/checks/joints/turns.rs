//! Joints off by whole, half or quarter turns, for ORD009.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::zer001_joint_zero::{self, ZER001};
use crate::checks::confounders::{confounder_alternative, joint_zero_alternative};
use crate::checks::decision::{Decision, decide};
use crate::checks::{Case, SubjectResult, residual_attribution};
use crate::diagnosis::Measured;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};

pub(super) fn judge(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    let of_joint = |joint: usize| match part_of_turn(case, arm, joint) {
        Some((turns, offset)) => {
            Some(turn_result(arm, joint, turns, &offset, TurnEvidence::InPoses))
        }
        None => judge_whole_turns(arm, joint),
    };
    (0..arm.joints.len()).filter_map(of_joint).collect()
}

#[derive(Clone, Copy)]
enum TurnEvidence {
    InPoses,
    InLimits,
}

/// A joint beyond its limits throughout the run, but within them if shifted by whole turns. In an unknown unit, positions are
/// not comparable with limits.
fn judge_whole_turns(arm: &ArmEvidence, joint: usize) -> Option<SubjectResult> {
    let turns = arm.joints.get(joint)?.motion.turns_beyond?;
    let has_zero_offset = arm.diagnosis.offsets.get(joint).is_some_and(|offset| offset.is_chosen);
    if has_zero_offset || arm.is_unit_undetermined() {
        return None;
    }
    let offset = Measured { value: -TAU * turns, std_error: 0.0, dof: 1.0 };
    Some(turn_result(arm, joint, turns.abs(), &offset, TurnEvidence::InLimits))
}

/// Turns and offset of a joint whose zero offset is a multiple of a quarter turn, to within ZER001's
/// threshold. `None` for the first joint if the base frame is reported instead.
pub(super) fn part_of_turn(
    case: &Case,
    arm: &ArmEvidence,
    joint: usize,
) -> Option<(f64, Measured)> {
    let offset = arm.diagnosis.offsets.get(joint).filter(|offset| offset.is_chosen)?;
    let measured = *offset.offset.as_ref().ok()?;
    let unit = arm.joint_unit(joint);
    let quarters = (measured.value / FRAC_PI_2).round();
    if unit != Unit::Radian || quarters == 0.0 || arm.scale(joint).is_some() {
        return None;
    }
    let threshold = case.thresholds.threshold(&ZER001, zer001_joint_zero::threshold(unit));
    let rest = Measured { value: measured.value - quarters * FRAC_PI_2, ..measured };
    let is_round =
        !matches!(decide(&rest, &threshold, case.evidence.subjects()), Decision::Fail(_));
    let is_model_credible = residual_attribution::model_doubt(arm, 0.0).is_none();
    (is_round && is_model_credible).then_some((quarters.abs() / 4.0, measured))
}

fn turn_result(
    arm: &ArmEvidence,
    joint: usize,
    turns: f64,
    offset: &Measured,
    evidence: TurnEvidence,
) -> SubjectResult {
    let (amount, name) = match turns {
        0.25 => ("a quarter turn", "its zero is set a quarter turn off"),
        0.5 => ("half a turn", "its zero is set half a turn off"),
        1.0 => ("one turn", "the encoder lost its count"),
        _ => ("several turns", "the encoder lost its count"),
    };
    let direction = if offset.value > 0.0 { "too few" } else { "too many" };
    let sign = if offset.value < 0.0 { "-" } else { "+" };
    let shown = Unit::Radian.show(offset.value.abs());
    let message = match evidence {
        TurnEvidence::InLimits => format!(
            "{amount} {direction}: {name}. Its positions exceed the limits throughout the run, and are \
             within them if shifted by {shown}"
        ),
        TurnEvidence::InPoses => format!("{amount} ({shown}) {direction}: {name}"),
    };
    let in_poses = match evidence {
        TurnEvidence::InPoses => arm.diagnosis.offsets.get(joint),
        TurnEvidence::InLimits => None,
    };
    let effect_m = in_poses.map(|found| found.effect_m);
    // A zero of this amount is the same numbers.
    let as_zero = in_poses.map(|_| joint_zero_alternative(arm, joint, offset.value));
    let confounders = in_poses.into_iter().flat_map(|found| &found.confounders);
    let confounders = confounders.map(|it| confounder_alternative(arm, it, Unit::Radian));
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::JointZero { offset: *offset, is_prismatic: false },
        title: "joint is off by turns",
        message,
        evidence: Evidence {
            indistinguishable: as_zero.into_iter().chain(confounders).collect(),
            effect: effect_m.map(|m| format!("{} at full reach", Unit::Metre.show(m))),
            effect_m,
            ..Evidence::default()
        },
        fix: format!(
            "q_true = q_reported {sign} {:.5} rad, or re-home the joint",
            offset.value.abs()
        ),
    };
    let estimate = Estimate::scalar("joint offset", Unit::Radian, offset).with_turns(turns);
    SubjectResult::new(arm.joint_states(joint), Outcome::fail(fault))
        .within(arm.span)
        .estimated(estimate)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use crate::checks::joints::{ord009_joint_scale::ORD009, zer001_joint_zero::ZER001};
    use crate::checks::testing::{clean_run, evaluate_rule, precise};
    use crate::diagnosis::NotObservable;
    use crate::finding::Estimate;

    #[test]
    fn a_zero_of_a_fraction_of_a_turn_is_reported_as_turns() {
        for (offset, turns) in [(FRAC_PI_2, 0.25), (-PI, 0.5), (PI + 1e-4, 0.5)] {
            let mut run = clean_run();
            let lift = &mut run.robots[0].diagnosis.offsets[1];
            (lift.offset, lift.is_chosen) = (Ok(precise(offset)), true);
            let (_, findings) = evaluate_rule(&ORD009, &run);
            let [finding] = findings.as_slice() else { panic!("{findings:?}") };
            let Some(Estimate::Scalar { joint, .. }) = &finding.estimate else {
                panic!("{finding:?}")
            };
            assert_eq!(joint.turns, Some(turns));
            let [zero] = finding.evidence.indistinguishable.as_slice() else {
                panic!("{finding:?}")
            };
            assert_eq!((zero.code, zero.subject.joint.as_deref()), ("ZER001", Some("lift")));
            assert_eq!(zero.estimate.as_ref().and_then(Estimate::value), Some(offset));
            assert!(evaluate_rule(&ZER001, &run).1.is_empty());
        }
        // Two degrees off a quarter turn is a zero offset.
        let mut run = clean_run();
        let lift = &mut run.robots[0].diagnosis.offsets[1];
        (lift.offset, lift.is_chosen) = (Ok(precise(FRAC_PI_2 + 0.035)), true);
        assert!(evaluate_rule(&ORD009, &run).1.is_empty());
        assert_eq!(evaluate_rule(&ZER001, &run).1.len(), 1);
    }

    #[test]
    fn a_whole_turn_violates_the_joint_limits() {
        let mut run = clean_run();
        run.robots[0].joints[1].motion.turns_beyond = Some(1.0);
        let (_, findings) = evaluate_rule(&ORD009, &run);
        let [finding] = findings.as_slice() else { panic!("{findings:?}") };
        assert!(finding.message.starts_with("one turn too many"), "{}", finding.message);
        assert_eq!(finding.fix, "q_true = q_reported - 6.28319 rad, or re-home the joint");
        // The numbers may be ticks.
        run.robots[0].is_in_degrees_by_magnitude = true;
        run.robots[0].diagnosis.encoding = Err(NotObservable::AtRest);
        assert!(evaluate_rule(&ORD009, &run).1.is_empty());
    }
}
