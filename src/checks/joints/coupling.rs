//! Coupled joints, for ORD009.

use crate::checks::SubjectResult;
use crate::diagnosis::JointCoupling;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};

/// J3 and J2.
const FANUC_COUPLING: (usize, usize) = (2, 1);

pub(super) fn judge(arm: &ArmEvidence) -> Vec<SubjectResult> {
    let couplings = arm.diagnosis.encoding.iter().flat_map(|reading| &reading.couplings);
    couplings.filter_map(|coupling| judge_pair(arm, coupling)).collect()
}

fn judge_pair(arm: &ArmEvidence, coupling: &JointCoupling) -> Option<SubjectResult> {
    let (joint, driver) = (arm.joints.get(coupling.column)?, arm.joints.get(coupling.by)?);
    let (own, with, factor) = (&joint.name, &driver.name, coupling.factor.value);
    let residuals = arm.diagnosis.encoding.as_ref().ok()?.residual?;
    let (before, after) =
        (Unit::Metre.show(residuals.as_logged), Unit::Metre.show(residuals.corrected));
    let size = factor.abs();
    let term = if coupling.is_round() && size.round() == 1.0 {
        with.clone()
    } else {
        format!("{size:.5} · {with}")
    };
    let sign = if factor < 0.0 { "-" } else { "+" };
    let is_fanuc = arm.name.to_lowercase().contains("fanuc")
        && (coupling.column, coupling.by) == FANUC_COUPLING;
    let vendor = if is_fanuc { " (FANUC controllers measure J3 from the horizon)" } else { "" };
    let message = if coupling.is_round() {
        format!(
            "{own} is measured from a different link{vendor}: {with} must be {} it",
            sign_word(factor)
        )
    } else {
        format!("{own} moves by {:.2} % of {with}'s motion in addition to its own", 100.0 * factor)
    };
    let fault = Fault {
        severity: Severity::Error,
        cause: Cause::JointCoupling { with: with.clone(), factor: coupling.factor },
        title: "joints are coupled",
        message,
        evidence: Evidence {
            effect: Some(format!("{before} off as logged, {after} with the coupling")),
            effect_m: Some(residuals.as_logged),
            ..Evidence::default()
        },
        fix: format!(
            "{own}_true = {own} {sign} {term} (measured factor {}): compute it where the joint states are filled",
            Unit::One.show_measured(&coupling.factor)
        ),
    };
    let estimate = Estimate::scalar("joint coupling", Unit::One, &coupling.factor);
    let judged = SubjectResult::new(arm.joint_states(coupling.column), Outcome::fail(fault));
    Some(judged.within(arm.span).estimated(estimate.with_coupling(with, factor)))
}

fn sign_word(factor: f64) -> &'static str {
    if factor < 0.0 { "subtracted from" } else { "added to" }
}

#[cfg(test)]
mod tests {
    use crate::checks::joints::ord009_joint_scale::ORD009;
    use crate::checks::testing::{clean_run, evaluate_rule, precise};
    use crate::diagnosis::{JointCoupling, JointEncoding, UnitResiduals};
    use crate::finding::Estimate;

    #[test]
    fn a_coupled_joint_is_reported_with_its_driver() {
        for (factor, fix) in
            [(1.0, "lift_true = lift + pan"), (-0.03, "lift_true = lift - 0.03000 · pan")]
        {
            let mut run = clean_run();
            run.robots[0].diagnosis.encoding = Ok(JointEncoding {
                couplings: vec![JointCoupling { column: 1, by: 0, factor: precise(factor) }],
                residual: Some(UnitResiduals { as_logged: 0.6, corrected: 1e-5 }),
                ..JointEncoding::default()
            });
            let (_, findings) = evaluate_rule(&ORD009, &run);
            let [finding] = findings.as_slice() else { panic!("{findings:?}") };
            assert_eq!(finding.subject.joint.as_deref(), Some("lift"));
            assert!(
                finding.fix.starts_with(&format!("{fix} (measured factor ")),
                "{}",
                finding.fix
            );
            assert!(finding.cause.has_correction());
            let Some(Estimate::Scalar { value, joint, .. }) = &finding.estimate else {
                panic!("{finding:?}")
            };
            assert_eq!((*value, joint.factor), (factor, Some(factor)));
            assert_eq!(joint.with.as_deref(), Some("pan"));
        }
    }
}
