use crate::checks::decision::{Decision, decide_both, decide_frame, not_observable};
use crate::checks::frames::THRESHOLDS;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{Measured, NotObservable, PoseDiagnosis};
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Unit};

rule! {
    /// /tf disagrees with forward kinematics of the joint states.
    ///
    /// ## What it means
    /// The tip pose in /tf differs from FK of the joint positions, after compensating its latency (LAT001).
    ///
    /// ## Why it matters
    /// Users of tf2 and nodes that compute FK have different kinematics.
    ///
    /// ## Evidence
    /// The constant offset, otherwise the rms residual beyond the noise. `before_m`: residual without
    /// latency compensation. The joint states are used as recorded: an error inherited from a joint fault
    /// is listed with that fault.
    ///
    /// ## How to fix
    /// Use one description (calibration, variant, tool) for the state publisher and the audit. Check for a
    /// second publisher of the frames.
    ///
    /// ## When it misleads
    /// A `--robot` description other than the publisher's causes this finding. The model supplies fixed
    /// transforms missing from /tf.
    FRM001 {
        name: "tf-against-kinematics",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no /tf of the arm in this log",
        check: check,
    }
}

const SETTLE: &str = "record /tf together with the joint states while the arm moves";

struct Disagreement {
    length: Measured,
    angle: Measured,
    constant: bool,
    decision: Decision,
}

impl Disagreement {
    /// The constant offset if it explains the disagreement, else the residual.
    fn estimate<'a>(case: &Case, tf: &'a PoseDiagnosis) -> Result<Self, &'a NotObservable> {
        let (thresholds, subjects) =
            (case.thresholds.frame_thresholds(&FRM001, THRESHOLDS), case.evidence.subjects());
        let offset = [&tf.reference, &tf.tool].into_iter().flatten().find(|frame| frame.is_chosen);
        if let Some(offset) = offset {
            let (length, angle) = (offset.translation_m, offset.rotation_rad);
            let decision = decide_frame(offset, &thresholds, subjects);
            return Ok(Self { length, angle, constant: true, decision });
        }
        let residual = tf.residual.as_ref()?;
        let (length, angle) = (residual.excess_m, residual.excess_rad);
        let decision = decide_both(&length, &angle, &thresholds, subjects);
        Ok(Self { length, angle, constant: false, decision })
    }
}

/// Whether /tf matches the recorded joint states, and so inherits their faults.
pub(in crate::checks) fn agrees(case: &Case, tf: &PoseDiagnosis) -> bool {
    Disagreement::estimate(case, tf).is_ok_and(|found| found.decision == Decision::Pass)
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let streams =
        case.evidence.robots.iter().flat_map(|arm| arm.tf.iter().map(move |tf| (arm, tf)));
    let judged = streams.map(|(arm, stream)| {
        let diagnosis = &stream.diagnosis;
        let subject = arm.frame(stream.topic(), &stream.tip);
        let judged = |outcome| SubjectResult::new(subject, outcome).within(stream.span);
        let found = match Disagreement::estimate(case, diagnosis) {
            Ok(found) => found,
            Err(why) => return judged(not_observable(why, SETTLE)),
        };
        if let (Decision::Fail(_), Some(what)) = (&found.decision, misread(arm)) {
            let why = format!("computed from the joint states, whose {what}");
            return judged(Outcome::Inconclusive(why));
        }
        let estimate = Estimate::frame("disagreement", &found.length, &found.angle);
        let before = diagnosis.residual.as_ref().ok().map(|residual| residual.before_m);
        judged(outcome(found, stream.is_uncorrected))
            .estimated(estimate)
            .with_evidence("before_m", before)
    });
    judged.collect()
}

/// Fault of the recorded joint states that invalidates everything computed from them.
fn misread(arm: &ArmEvidence) -> Option<&'static str> {
    let joints = arm.diagnosis.encoding.as_ref().ok()?;
    match joints {
        joints if joints.is_in_degrees => Some("units are wrong (ORD004)"),
        joints if joints.permutation.is_some() => Some("names are mixed up (ORD005)"),
        joints if !joints.is_as_logged() => {
            Some("units or scales are wrong (ORD004, ORD008, ORD009)")
        }
        _ => None,
    }
}

/// `is_uncorrected` if it is compared with the joint states before their correction.
fn outcome(found: Disagreement, is_uncorrected: bool) -> Outcome {
    let (length, angle) =
        (Unit::Metre.show(found.length.value), Unit::Radian.show(found.angle.value));
    let severity = match found.decision {
        Decision::Pass => {
            let of =
                if is_uncorrected { " of the joint states before their correction" } else { "" };
            return Outcome::pass_with_remark(format!("matches FK{of} ({length}, {angle})"));
        }
        Decision::Undecided(why) => return Outcome::Inconclusive(format!("{why}; {SETTLE}")),
        Decision::Fail(severity) => severity,
    };
    let kind = if found.constant { "everywhere" } else { "rms" };
    Outcome::fail(Fault {
        cause: Cause::TfDisagrees,
        severity,
        title: "/tf disagrees with kinematics",
        message: format!("differs from FK of the joint states by {length} and {angle} {kind}"),
        evidence: Evidence { effect_m: Some(found.length.value), ..Evidence::default() },
        fix: "use the same robot description for the state publisher and the audit".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, frame, precise};
    use crate::diagnosis::FrameEstimate;

    #[test]
    fn a_constant_offset_and_a_residual_both_count_as_disagreement() {
        let mut run = clean_run();
        run.robots[0].tf.as_mut().unwrap().diagnosis.tool =
            Ok(FrameEstimate { is_chosen: true, ..frame(0.003) });
        let constant = evaluate_rule(&FRM001, &run).1;
        assert_eq!(
            constant[0].message,
            "differs from FK of the joint states by 3 mm and 0° everywhere"
        );

        let mut run = clean_run();
        let residual = run.robots[0].tf.as_mut().unwrap().diagnosis.residual.as_mut();
        residual.expect("a residual").excess_m = precise(0.02);
        let varying = evaluate_rule(&FRM001, &run).1;
        assert_eq!(varying[0].message, "differs from FK of the joint states by 20 mm and 0° rms");
    }
}
