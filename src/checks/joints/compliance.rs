//! Joint compliance (MOT006, ZER003): observable only if the other causes do not explain the log.

use crate::checks::decision::{Threshold, decide};
use crate::checks::frames::THRESHOLDS;
use crate::checks::{Case, Rule, SubjectResult, changes};
use crate::diagnosis::JointCompliance;
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Estimate, Fault, Outcome, Ruling, Severity, Unit};

pub(super) struct ComplianceRule {
    pub name: &'static str,
    pub threshold: Threshold,
    pub settle: &'static str,
    pub applies: fn(&JointCompliance) -> bool,
    pub fault: fn(&ArmEvidence, &JointCompliance, Severity) -> Fault,
}

impl ComplianceRule {
    /// Judges every joint of this kind, or else the arm.
    pub fn check(&self, rule: &Rule, case: &Case) -> Vec<SubjectResult> {
        let arms = case.evidence.robots.iter().filter(|arm| !arm.poses.is_empty());
        arms.flat_map(|arm| self.judge_arm(rule, case, arm)).collect()
    }

    fn judge_arm(&self, rule: &Rule, case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
        let own: Vec<&JointCompliance> = arm
            .diagnosis
            .compliance
            .iter()
            .filter(|compliance| (self.applies)(compliance))
            .collect();
        if own.is_empty() {
            let outcome = match residual_reason(arm) {
                _ if !has_residual_check_in_motion(arm) => {
                    let why = "the arm barely moves, or no pose can be compared with it";
                    Outcome::Inconclusive(format!("{why}; {}", self.settle))
                }
                None => Outcome::pass(),
                Some(left) => Outcome::Inconclusive(format!("{left}; {}", self.settle)),
            };
            return vec![SubjectResult::new(arm.subject(), outcome).within(arm.span)];
        }
        own.into_iter().map(|compliance| self.judge(rule, case, arm, compliance)).collect()
    }

    fn judge(
        &self,
        rule: &Rule,
        case: &Case,
        arm: &ArmEvidence,
        compliance: &JointCompliance,
    ) -> SubjectResult {
        let threshold = case.thresholds.threshold(rule, self.threshold);
        let subject = arm.joint(compliance.column);
        let change = changes::judge_scalar_change(
            case,
            self.name,
            ["joint compliance changes mid-run", "joint compliance drifts"],
            &Vec::from_iter(&compliance.change()),
            &threshold,
            |change| tip_effect(arm, compliance.column, change.size.value).0,
        );
        if let Some((outcome @ Outcome::Evaluated(Ruling::Fail(_)), estimate)) = change {
            return SubjectResult::new(subject, outcome).within(arm.span).estimated(estimate);
        }
        let size = compliance.value().abs();
        let outcome = decide(&size, &threshold, case.evidence.subjects())
            .into_outcome(self.settle, |severity| (self.fault)(arm, compliance, severity));
        SubjectResult::new(subject, outcome).within(arm.span).estimated(Estimate::scalar(
            self.name,
            Unit::Radian,
            &size,
        ))
    }
}

fn has_residual_check_in_motion(arm: &ArmEvidence) -> bool {
    let moves = |stream: &StreamEvidence<PoseEvidence>| {
        let is_in_motion = stream.proof.as_ref().is_ok_and(|proof| !proof.is_at_rest);
        is_in_motion && stream.diagnosis.residual.is_ok()
    };
    arm.poses.iter().any(moves)
}

/// `None` if below the thresholds.
fn residual_reason(arm: &ArmEvidence) -> Option<String> {
    let streams = arm.poses.iter().map(|stream| &stream.diagnosis);
    let residuals =
        streams.filter(|found| !found.is_nominal).filter_map(|found| found.residual.as_ref().ok());
    let largest = residuals.fold((0.0_f64, 0.0_f64), |largest, residual| {
        (largest.0.max(residual.excess_m.value), largest.1.max(residual.excess_rad.value))
    });
    let is_much = largest.0 > THRESHOLDS.length.warning || largest.1 > THRESHOLDS.angle.warning;
    is_much.then(|| {
        let [length, angle] = [Unit::Metre.show(largest.0), Unit::Radian.show(largest.1)];
        format!("it does not explain the residual of {length} and {angle} (MDL001)")
    })
}

/// Displacement of the tip at full reach, in metres and formatted.
pub(super) fn tip_effect(arm: &ArmEvidence, column: usize, turn_rad: f64) -> (f64, String) {
    let lever_m = arm.diagnosis.offsets.get(column).map_or(0.0, |offset| offset.lever_m);
    let effect_m = lever_m * turn_rad.abs();
    (effect_m, format!("{} at full reach", Unit::Metre.show(effect_m)))
}
