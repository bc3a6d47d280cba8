use super::compliance::{ComplianceRule, tip_effect};
use crate::checks::decision::{DEGREE, Threshold};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::JointCompliance;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Evidence, Fault, Severity, Unit};

rule! {
    /// A joint has backlash.
    ///
    /// ## What it means
    /// After each reversal, the encoder moves by the backlash before the link follows: gear play, a loose
    /// coupling or a slack belt. The value is the full backlash.
    ///
    /// ## Why it matters
    /// The tool reaches a different place from either side: 0.5° at the shoulder of an arm of 0.85 m is 7
    /// mm. Against poses it resembles a latency of a few milliseconds, which no shift of stamps corrects.
    ///
    /// ## Evidence
    /// Unless the other rules' causes explain the log to within the noise, each joint is tested for
    /// hysteresis, sag (ZER003) and eccentricity. Latencies, zeros and frames are free. The link may wait
    /// while its encoder crosses the backlash, or be pushed through it at the reversal. It is reported if it
    /// reduces the residual substantially, and preferred to changing zeros or frames if fewer causes are then
    /// needed. Latency and zeros are then judged on corrected joint states.
    ///
    /// `leads`: the poses, computed from the motor's encoder, lead this joint's encoder, which is on the
    /// link side.
    ///
    /// ## How to fix
    /// Adjust the gear's preload, or tighten the coupling or belt. Until then, approach each target from
    /// the same side.
    ///
    /// ## When it misleads
    /// Dry friction that winds up a compliant gear also depends on direction. A joint always loaded from
    /// the same side never shows its backlash. The controller's own poses show it only with encoders on
    /// both sides of the gear.
    MOT006 {
        name: "backlash",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE };

const BACKLASH: ComplianceRule = ComplianceRule {
    name: "play",
    threshold: THRESHOLD,
    settle: "move the joints back and forth, one at a time",
    applies: JointCompliance::is_backlash,
    fault,
};

fn check(case: &Case) -> Vec<SubjectResult> {
    BACKLASH.check(&MOT006, case)
}

fn fault(arm: &ArmEvidence, compliance: &JointCompliance, severity: Severity) -> Fault {
    let size = compliance.value().abs();
    let leads = compliance.value().value < 0.0;
    let (effect_m, moved) = tip_effect(arm, compliance.column, size.value);
    let how = match leads {
        true => "the poses lead the encoder",
        false => "the link follows the encoder only beyond it",
    };
    let mut evidence =
        Evidence { effect: Some(moved), effect_m: Some(effect_m), ..Evidence::default() };
    evidence.more.insert("leads".to_owned(), leads.into());
    Fault {
        severity,
        cause: Cause::Compliance,
        title: "joint has backlash",
        message: format!("backlash of {}: {how}", Unit::Radian.show_measured(&size)),
        evidence,
        fix: "adjust the gear's preload, or tighten its coupling or belt; until then approach each target \
            from the same side"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, precise};
    use crate::diagnosis::{BacklashCrossing, ComplianceShape};
    use crate::finding::Status;

    #[test]
    fn backlash_above_the_threshold_is_a_finding() {
        for (amount, status) in
            [(0.02, Status::Fail), (-0.003, Status::Fail), (0.0012, Status::Pass)]
        {
            let mut run = clean_run();
            let backlash = JointCompliance {
                column: 1,
                shape: ComplianceShape::Backlash(BacklashCrossing::Gradual),
                amounts: [amount, 0.0],
                std_error: precise(amount).std_error,
                dof: precise(amount).dof,
            };
            run.robots[0].diagnosis.compliance.push(backlash);
            let (rows, findings) = evaluate_rule(&MOT006, &run);
            assert_eq!(rows[0].status, status, "{rows:?}");
            for finding in findings {
                assert_eq!(finding.subject.joint.as_deref(), Some("lift"));
                assert_eq!(finding.evidence.more["leads"], amount < 0.0);
            }
        }
    }

    #[test]
    fn a_small_residual_rules_out_backlash_and_a_large_one_does_not() {
        let mut run = clean_run();
        assert_eq!(evaluate_rule(&MOT006, &run).0[0].status, Status::Pass);
        let residual = run.robots[0].poses[0].diagnosis.residual.as_mut();
        residual.expect("clean").excess_m.value = 3e-3;
        assert_eq!(evaluate_rule(&MOT006, &run).0[0].status, Status::Inconclusive);
    }
}
