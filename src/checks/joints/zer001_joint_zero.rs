use super::turns;
use crate::checks::confounders::{confounder_alternative, joint_zero_estimate};
use crate::checks::decision::{DEGREE, Decision, Threshold, decide, not_observable};
use crate::checks::frames::THRESHOLDS;
use crate::checks::poses::frm001_tf_against_kinematics;
use crate::checks::poses::mdl001_unexplained_residual::MDL001;
use crate::checks::{Case, Grade, SubjectResult, UNKNOWN_WORLD, changes, residual_attribution};
use crate::diagnosis::{
    Confounder, EstimateResult, FrameEstimate, JointOffset, Measured, NotObservable,
};
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Ruling, Severity, Subject, Unit};
use crate::run::PoseSourceKind;

rule! {
    /// A joint's zero is off.
    ///
    /// ## What it means
    /// The joint's position has a constant error: `q_true = q_reported + offset`. One finding per joint,
    /// from all pose streams together.
    ///
    /// ## Why it matters
    /// The arm repeats perfectly but is wrong everywhere: 0.5° at the shoulder of an arm of 0.85 m moves
    /// the tip by 7 mm. Taught programs hide it; everything computed from kinematics shows it.
    ///
    /// ## Evidence
    /// The smallest set of causes (joint zeros, frames) that explains all streams, with their latencies.
    ///
    /// - `effect_m`: displacement of the tip at full reach.
    /// - `inherited_by`: streams computed from the faulty joint states.
    /// - `indistinguishable`: causes with the same effect on this log: first joint's zero and base yaw,
    ///   last joint's zero and tool rotation, a rail's zero and a shift of the base.
    /// - `source_kind`: source of the poses (`controller`, `external`, `unknown`); `meaning`: what the offset
    ///   then implies.
    /// - `changes`: times and offsets of changes. The value is then the size of the change (`from`, `to`,
    ///   `change_ns`). `is_gradual` marks a drift: at a constant rate from one time to another, or with
    ///   `time_constant_s` as `1 − exp(−t/τ)` over the run (warm-up).
    ///
    /// If an inaccurate nominal model could explain several causes or the residual, all link deviations are
    /// estimated too, each with its own standard deviation. A zero must then make the log fifty times as
    /// likely; its interval includes the deviations. `indistinguishable` lists other joints' significant zeros
    /// at least a twentieth as likely. If the links fit, the interval includes deviations that the noise may
    /// hide.
    ///
    /// A controller's poses are FK of the same encoders. If they agree with the joint states and an external
    /// stream shows a zero, that stream alone decides.
    ///
    /// With an unexplained residual (MDL001), a zero must move the tip at least 30 times as far, or turn it at least ten times
    /// as far as the angle that remains: wrong lengths of links do not turn the tool. If the
    /// motion cannot locate the tracker's marker, it is never reported.
    ///
    /// ## How to fix
    /// Check the robot's description first: another variant of the arm has the same effect. Then re-home or
    /// re-master the joint, or add the offset to the driver's calibration file.
    ///
    /// ## When it misleads
    /// A controller's pose is computed from the same encoders. Against it, an offset means that this model
    /// or these joint states differ from the controller's; only an independent source (tracker, camera,
    /// IMU) shows a mechanical zero error. An offset required by only one of several explanations is never
    /// a finding. In few configurations, sag has the same effect; `indistinguishable` then lists ZER003.
    ZER001 {
        name: "joint-zero",
        grade: Grade::From(&[ROTARY, PRISMATIC]),
        headline: true,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

const ROTARY: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE };
const PRISMATIC: Threshold = Threshold { unit: Unit::Metre, warning: 0.2e-3, error: 1e-3 };

const SETTLE: &str = "move each joint by 30° or more, one after another";

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.robots.iter().flat_map(|arm| judge_arm(case, arm)).collect()
}

fn judge_arm(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    if arm.poses.is_empty() {
        return Vec::new();
    }
    let offsets = arm.diagnosis.offsets.iter().enumerate();
    // An unknown world frame may absorb an unobservable fault.
    let is_world_unknown = arm.poses.iter().all(|stream| !stream.reference_known);
    let judged = offsets.map(|(joint, offset)| judge(case, arm, joint, offset));
    judged
        .map(|judged| match &judged.outcome {
            Outcome::Inconclusive(_) if is_world_unknown => {
                judged.with_evidence(UNKNOWN_WORLD, true)
            }
            _ => judged,
        })
        .collect()
}

fn judge(case: &Case, arm: &ArmEvidence, joint: usize, offset: &JointOffset) -> SubjectResult {
    let subject = arm.joint(joint);
    if let Some(scale) = arm.scale(joint).filter(|scale| scale.is_coded()) {
        let why = format!("the offset belongs to its scale, {:.5} (ORD009)", scale.offset);
        return SubjectResult::new(subject, Outcome::pass_with_remark(why)).within(arm.span);
    }
    let threshold = case.thresholds.threshold(&ZER001, threshold(arm.joint_unit(joint)));
    let change = changes::judge_scalar_change(
        case,
        "joint offset",
        ["joint zero changes mid-run", "joint zero drifts"],
        &arm.diagnosis.zero_changes(joint),
        &threshold,
        |change| offset.lever_m * change.size.value.abs(),
    );
    let change = change.map(|(mut outcome, estimate)| {
        if let Outcome::Evaluated(Ruling::Fail(fault)) = &mut outcome {
            let confounders = offset
                .confounders
                .iter()
                .map(|confounder| confounder_alternative(arm, confounder, threshold.unit));
            fault.evidence.indistinguishable.extend(confounders);
        }
        (outcome, estimate)
    });
    let judged = changes::judge_with_change(subject, change, |subject| {
        judge_constant(case, (arm, subject), joint, offset, &threshold)
    });
    judged.within(arm.span)
}

/// Whether a joint's zero changes by at least the warning threshold.
pub(in crate::checks) fn changes_much(case: &Case, arm: &ArmEvidence, joint: usize) -> bool {
    let threshold = case.thresholds.threshold(&ZER001, threshold(arm.joint_unit(joint)));
    let changes = arm.diagnosis.zero_changes(joint);
    changes.iter().any(|change| threshold.severity(change.size.value.abs()).is_some())
}

fn judge_constant(
    case: &Case,
    (arm, subject): (&ArmEvidence, Subject),
    joint: usize,
    offset: &JointOffset,
    threshold: &Threshold,
) -> SubjectResult {
    if turns::part_of_turn(case, arm, joint).is_some() {
        let why = "off by a half or quarter turn (ORD009)".to_owned();
        return SubjectResult::new(subject, Outcome::pass_with_remark(why));
    }
    let measured = match &offset.offset {
        Ok(measured) => measured,
        Err(why) => {
            let outcome = match reported_confounder(arm, offset) {
                Some(confounder) => indistinguishable_outcome(arm, &confounder),
                None => not_observable(why, SETTLE),
            };
            return SubjectResult::new(subject, outcome);
        }
    };
    let turn_rad = if threshold.unit == Unit::Radian { measured.value } else { 0.0 };
    let outcome = match (
        decide(measured, threshold, case.evidence.subjects()),
        reported_confounder(arm, offset),
    ) {
        (Decision::Fail(_), _)
            if offset.is_chosen && arm.poses.iter().any(|s| s.diagnosis.is_periodic()) =>
        {
            Outcome::Inconclusive(format!(
                "depends on a latency that fits at several lags; {SETTLE}"
            ))
        }
        (Decision::Fail(severity), _) if offset.is_chosen => {
            match residual_attribution::zero_doubt(arm, turn_rad)
                .or_else(|| unobservable_tool_reason(arm))
                .or_else(|| wrong_model_reason(case, arm, offset, turn_rad))
            {
                Some(why) => Outcome::Inconclusive(why),
                None => Outcome::fail(fault(case, arm, joint, measured, severity)),
            }
        }
        (Decision::Pass, _) => Outcome::pass(),
        (_, Some(confounder)) if !offset.is_chosen => indistinguishable_outcome(arm, &confounder),
        (Decision::Fail(_), _) if arm.poses.iter().any(|s| s.diagnosis.is_nominal) => {
            not_observable(&NotObservable::NominalKinematics, SETTLE)
        }
        (Decision::Fail(_), _) => {
            let shown = threshold.unit.show_signed(measured);
            let why = format!("{shown} would fit, but the reported causes already explain the log");
            Outcome::Inconclusive(format!("{why}; {SETTLE}"))
        }
        (Decision::Undecided(_), _) if arm.poses.iter().any(|s| s.diagnosis.is_nominal) => {
            not_observable(&NotObservable::NominalKinematics, SETTLE)
        }
        (Decision::Undecided(why), _) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
    };
    SubjectResult::new(subject, outcome).estimated(joint_zero_estimate(threshold.unit, measured))
}

/// If the motion does not locate an external marker and a residual above the noise remains, the zero may be
/// the effect of the unknown tool frame.
fn unobservable_tool_reason(arm: &ArmEvidence) -> Option<String> {
    /// Standard error, m.
    const MIN_UNKNOWN_TOOL_ERROR_M: f64 = 0.01;
    const MAX_HEALTHY_RESIDUAL_M: f64 = 0.3e-3;
    let is_hidden = |stream: &&StreamEvidence<PoseEvidence>| {
        let diagnosis = &stream.diagnosis;
        let is_tool_unknown = diagnosis
            .tool
            .as_ref()
            .is_ok_and(|tool| tool.translation_m.std_error > MIN_UNKNOWN_TOOL_ERROR_M);
        let residual = diagnosis.residual.as_ref().ok().map(|residual| &residual.excess_m);
        let is_significant = residual.is_some_and(|residual| {
            residual.value - residual.half_width(0.95) > MAX_HEALTHY_RESIDUAL_M
        });
        stream.source_kind != PoseSourceKind::Controller && is_tool_unknown && is_significant
    };
    let stream = arm.poses.iter().find(is_hidden)?;
    let residual = stream.diagnosis.residual.as_ref().ok()?.excess_m.value;
    Some(format!(
        "the tool frame of {} is not observable in this motion, and a residual of {} is unexplained; \
         {SETTLE}",
        stream.topic(),
        Unit::Metre.show(residual)
    ))
}

/// If the residual of each stream exceeds the thresholds of MDL001, the zero may be the effect of a wrong model.
fn wrong_model_reason(
    case: &Case,
    arm: &ArmEvidence,
    offset: &JointOffset,
    zero_rad: f64,
) -> Option<String> {
    /// Link deviations do not give a zero's effect a larger ratio to the residual.
    const MIN_EFFECT_RATIO: f64 = 30.0;
    let limits = case.thresholds.frame_thresholds(&MDL001, THRESHOLDS);
    let lower_bound = |amount: &Measured| amount.value - amount.half_width(0.95);
    let unexplained = arm
        .poses
        .iter()
        .filter(|stream| !stream.diagnosis.is_nominal && !stream.diagnosis.is_derived);
    let residuals = unexplained.filter_map(|stream| stream.diagnosis.residual.as_ref().ok());
    let smallest = residuals.min_by(|a, b| a.excess_m.value.total_cmp(&b.excess_m.value));
    let residual = smallest.filter(|residual| {
        let is_long = lower_bound(&residual.excess_m) > limits.length.warning;
        let has_large_rotation = lower_bound(&residual.excess_rad) > limits.angle.warning;
        (is_long || has_large_rotation)
            && offset.effect_m < MIN_EFFECT_RATIO * residual.excess_m.value
            && !residual_attribution::rotations_show_zero(arm, zero_rad)
    })?;
    Some(format!(
        "a residual of {} and {} is unexplained (MDL001); use the arm's own calibration, or {SETTLE}",
        Unit::Metre.show(residual.excess_m.value),
        Unit::Radian.show(residual.excess_rad.value)
    ))
}

fn indistinguishable_outcome(arm: &ArmEvidence, confounder: &str) -> Outcome {
    match residual_attribution::model_doubt(arm, 0.0) {
        Some(why) => Outcome::Inconclusive(why),
        None => Outcome::Indistinguishable(format!("indistinguishable from {confounder}")),
    }
}

pub(super) fn threshold(unit: Unit) -> Threshold {
    match unit {
        Unit::Metre => PRISMATIC,
        _ => ROTARY,
    }
}

fn fault(
    case: &Case,
    arm: &ArmEvidence,
    joint: usize,
    measured: &Measured,
    severity: Severity,
) -> Fault {
    let (offset, unit) = (&arm.diagnosis.offsets[joint], arm.joint_unit(joint));
    let moved = Unit::Metre.show(offset.effect_m);
    let mut evidence = Evidence {
        indistinguishable: offset
            .confounders
            .iter()
            .map(|confounder| confounder_alternative(arm, confounder, unit))
            .collect(),
        effect: Some(format!("{moved} at full reach")),
        effect_m: Some(offset.effect_m),
        ..Evidence::default()
    };
    let inheriting_topics =
        arm.tf.iter().filter(|tf| frm001_tf_against_kinematics::agrees(case, &tf.diagnosis));
    let inheriting_topics: Vec<&str> = inheriting_topics.map(|tf| tf.topic()).collect();
    if !inheriting_topics.is_empty() {
        evidence.more.insert("inherited_by".to_owned(), inheriting_topics.into());
    }
    let source_kind = arm.pose_source_kind();
    evidence.more.insert("witness".to_owned(), source_kind.name().into());
    evidence.more.insert("meaning".to_owned(), meaning(source_kind).into());
    let sign = if measured.value < 0.0 { "-" } else { "+" };
    let (size, symbol, shown) = (measured.value.abs(), unit.symbol(), unit.show_signed(measured));
    let factor = arm.scale(joint).map_or(String::new(), |s| format!("{:.5} · ", s.factor.value));
    let (message, fix) = match source_kind {
        PoseSourceKind::Controller => (
            format!("zero offset {shown} (controller's poses against FK of the joint states)"),
            format!(
                "first audit with the robot's own calibration (--calibration FILE); if it stays, \
                 q = {factor}q_reported {sign} {size:.5} {symbol}"
            ),
        ),
        PoseSourceKind::External | PoseSourceKind::Unknown => (
            format!("zero offset {shown}"),
            format!("q_true = {factor}q_reported {sign} {size:.5} {symbol}, or re-home the joint"),
        ),
    };
    let cause = Cause::JointZero { offset: *measured, is_prismatic: unit == Unit::Metre };
    Fault { severity, cause, title: "joint zero is off", message, evidence, fix }
}

fn meaning(source_kind: PoseSourceKind) -> &'static str {
    match source_kind {
        PoseSourceKind::Controller => {
            "the controller's poses use the same encoders, so a mechanical zero error is invisible here: \
             check with a tracker, a camera or an IMU"
        }
        PoseSourceKind::External => "measured independently: the joint itself is off, or the model",
        PoseSourceKind::Unknown => {
            "if the poses are the controller's own, the model or the joint states differ from the \
             controller's; if they are from a tracker or camera, the joint itself is off"
        }
    }
}

/// The confounder that is in the selected model.
fn reported_confounder(arm: &ArmEvidence, offset: &JointOffset) -> Option<String> {
    let chosen =
        |frame: &EstimateResult<FrameEstimate>| frame.as_ref().is_ok_and(|frame| frame.is_chosen);
    let named = offset.confounders.iter().find(|confounder| match **confounder {
        Confounder::JointZero(joint, _) => {
            arm.diagnosis.offsets.get(joint).is_some_and(|other| other.is_chosen)
        }
        Confounder::Reference(stream, _) => arm
            .poses
            .get(stream)
            .is_some_and(|stream| !stream.reference_known || chosen(&stream.diagnosis.reference)),
        Confounder::Tool(stream, _) => {
            arm.poses.get(stream).is_some_and(|stream| chosen(&stream.diagnosis.tool))
        }
        Confounder::Sag(..) => false,
    })?;
    let cause = confounder_alternative(arm, named, Unit::Radian);
    let is_unknown = match *named {
        Confounder::Reference(stream, _) => !arm.poses[stream].reference_known,
        _ => false,
    };
    let why = if is_unknown { "whose frame is unknown" } else { "which is reported instead" };
    Some(format!("{} on {}, {why}", cause.code, cause.subject.label()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{TF, clean_run, evaluate_rule, frame, precise};
    use crate::finding::Status;

    #[test]
    fn a_selected_offset_is_a_finding_that_lists_confounders() {
        let mut run = clean_run();
        let pan = &mut run.robots[0].diagnosis.offsets[0];
        (pan.offset, pan.is_chosen) = (Ok(precise(-0.01)), true);
        pan.confounders = vec![Confounder::Reference(0, -0.01)];
        let (_, findings) = evaluate_rule(&ZER001, &run);
        let [finding] = findings.as_slice() else { panic!("{findings:?}") };
        assert_eq!(finding.subject.joint.as_deref(), Some("pan"));
        assert_eq!(finding.message, "zero offset -0.573 ± 0.001°");
        assert_eq!(finding.fix, "q_true = q_reported - 0.01000 rad, or re-home the joint");
        let confounders =
            finding.evidence.indistinguishable.iter().map(|confounder| confounder.code);
        assert_eq!(confounders.collect::<Vec<_>>(), ["FRM002"]);
        assert_eq!(finding.evidence.more["inherited_by"], serde_json::json!([TF]));
    }

    #[test]
    fn the_meaning_of_an_offset_depends_on_the_pose_source() {
        let said = |source_kind: PoseSourceKind| {
            let mut run = clean_run();
            let arm = &mut run.robots[0];
            let pan = &mut arm.diagnosis.offsets[0];
            (pan.offset, pan.is_chosen) = (Ok(precise(-0.01)), true);
            arm.poses[0].source_kind = source_kind;
            let finding = evaluate_rule(&ZER001, &run).1.remove(0);
            assert_eq!(finding.evidence.more["witness"], source_kind.name());
            (finding.message, finding.evidence.more["meaning"].as_str().unwrap().to_owned())
        };
        let (message, meaning) = said(PoseSourceKind::Controller);
        assert!(message.contains("zero offset -0.573"), "{message}");
        assert!(meaning.contains("mechanical zero error is invisible"), "{meaning}");
        let (message, meaning) = said(PoseSourceKind::External);
        assert!(
            message.starts_with("zero offset") && meaning.contains("joint itself"),
            "{meaning}"
        );
        let (_, meaning) = said(PoseSourceKind::Unknown);
        assert!(meaning.contains("controller's own") && meaning.contains("tracker"), "{meaning}");
    }

    #[test]
    fn an_offset_that_is_not_selected_never_fails() {
        let mut run = clean_run();
        run.robots[0].diagnosis.offsets[0].offset = Ok(precise(-0.01));
        let (rows, findings) = evaluate_rule(&ZER001, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
    }

    #[test]
    fn a_zero_that_an_unknown_tool_may_cause_is_inconclusive_next_to_a_residual() {
        let status = |tool_error_m: f64, left_m: f64, left_rad: f64, effect_m: f64| {
            let mut run = clean_run();
            let arm = &mut run.robots[0];
            let pan = &mut arm.diagnosis.offsets[0];
            (pan.offset, pan.is_chosen, pan.effect_m) = (Ok(precise(-0.01)), true, effect_m);
            arm.poses[0].source_kind = PoseSourceKind::External;
            let stream = &mut arm.poses[0].diagnosis;
            let mut tool = frame(0.0);
            tool.translation_m.std_error = tool_error_m;
            stream.tool = Ok(tool);
            let residual = stream.residual.as_mut().expect("a residual");
            (residual.excess_m, residual.excess_rad) = (precise(left_m), precise(left_rad));
            evaluate_rule(&ZER001, &run).0[0].status
        };
        assert_eq!(status(1e-4, 0.0, 0.0, 0.01), Status::Fail);
        // Unknown tool.
        assert_eq!(status(1.0, 0.0, 0.0, 0.01), Status::Fail);
        assert_eq!(status(1.0, 0.8e-3, 2e-3, 0.01), Status::Inconclusive);
        // Residual above MDL001's threshold.
        assert_eq!(status(1e-4, 2e-3, 2e-3, 0.01), Status::Inconclusive);
        assert_eq!(status(1e-4, 2e-3, 2e-3, 0.2), Status::Fail);
        // Rotations show a zero beside wrong lengths, also from 5 mm on.
        assert_eq!(status(1e-4, 8e-3, 2e-3, 0.01), Status::Inconclusive);
        assert_eq!(status(1e-4, 8e-3, 1e-4, 0.01), Status::Fail);
    }

    #[test]
    fn a_zero_with_a_reported_confounder_does_not_count() {
        let mut run = clean_run();
        let diagnosis = &mut run.robots[0].diagnosis;
        diagnosis.offsets[0].offset = Ok(precise(-0.01));
        diagnosis.offsets[0].confounders = vec![Confounder::Reference(0, -0.01)];
        run.robots[0].poses[0].diagnosis.reference =
            Ok(FrameEstimate { is_chosen: true, ..frame(0.1) });
        let (rows, findings) = evaluate_rule(&ZER001, &run);
        assert!(findings.is_empty() && rows[0].is_indistinguishable, "{rows:?}");
    }
}
