//! Withdraws findings of other rules that an unexplained residual (MDL001) could produce.

use crate::checks::{Case, Evaluation};
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, CheckRow, Estimate, Finding, Severity, Status, Subject, Unit};

/// Minimum ratio of a cause's effect to the unexplained residual. `None` if the residual does not affect
/// it.
///
/// An unmodelled error resembles a bit of every cause. A latency follows the motion, so it only has to
/// exceed the residual, but backlash can resemble a few milliseconds of it.
fn min_effect_ratio(cause: &Cause) -> Option<f64> {
    match cause {
        Cause::Latency(_) | Cause::ClockSkew(_) => Some(1.0),
        Cause::JointZero { .. } | Cause::RadialScale | Cause::ReferenceFrame(_) => Some(10.0),
        _ => None,
    }
}

/// Ratio of a joint's zero offset to the unexplained angle.
const MIN_ZERO_ANGLE_RATIO: f64 = 5.0;

struct UnexplainedResidual {
    subject: Subject,
    length_m: f64,
    angle_rad: f64,
}

impl UnexplainedResidual {
    fn from_finding(finding: &Finding) -> Option<Self> {
        let is_unexplained =
            matches!(finding.cause, Cause::UnexplainedResidual | Cause::Disagreement { .. });
        let is_grave = finding.severity > Severity::Info;
        match finding.estimate.as_ref().filter(|_| is_unexplained && is_grave)? {
            Estimate::Frame { value, rotation, .. } => Some(Self {
                subject: finding.subject.clone(),
                length_m: *value,
                // NaN without rotations.
                angle_rad: rotation.value.max(0.0),
            }),
            _ => None,
        }
    }

    /// Whether the residual could produce this finding on its stream, or on a joint of `arm` unless another stream shows it.
    fn could_cause(&self, finding: &Finding, arm: Option<&ArmEvidence>) -> bool {
        let Subject { robot, topic, .. } = &finding.subject;
        let is_same_subject =
            self.subject.robot == *robot && (topic.is_none() || self.subject.topic == *topic);
        let (Some(times), Some(effect_m)) =
            (min_effect_ratio(&finding.cause), finding.evidence.effect_m)
        else {
            return false;
        };
        let turn_rad = match &finding.cause {
            Cause::JointZero { offset, is_prismatic: false } => offset.value.abs(),
            _ => f64::INFINITY,
        };
        let poses = || arm.into_iter().flat_map(|arm| &arm.poses);
        let has_rotations = poses().any(|stream| {
            self.subject.topic.as_deref() == Some(stream.topic())
                && stream.diagnosis.encoding.is_ok()
        });
        let is_within = |length_m: f64, angle_rad: f64| {
            let is_shown_by_rotations =
                turn_rad.is_finite() && has_rotations && turn_rad > times * angle_rad;
            !is_shown_by_rotations
                && (effect_m < times * length_m || turn_rad < MIN_ZERO_ANGLE_RATIO * angle_rad)
        };
        let is_shown_by_another = || {
            let mut others = poses().filter(|stream| {
                self.subject.topic.as_deref() != Some(stream.topic())
                    && !stream.diagnosis.is_derived
            });
            others.any(|stream| {
                let residual = stream.diagnosis.residual.as_ref();
                residual.is_ok_and(|it| !is_within(it.excess_m.value, it.excess_rad.value))
            })
        };
        is_same_subject
            && is_within(self.length_m, self.angle_rad)
            && !(topic.is_none() && is_shown_by_another())
    }
}

/// Makes findings inconclusive if their effect is small next to an unexplained residual.
pub(super) fn withdraw_findings_within_residual(case: &Case, evaluation: &mut Evaluation) {
    let Evaluation { checks, findings, .. } = evaluation;
    let unexplained: Vec<UnexplainedResidual> =
        findings.iter().filter_map(UnexplainedResidual::from_finding).collect();
    findings.retain(|finding| {
        let arm = case.evidence.robots.iter().find(|arm| Some(&arm.name) == finding.subject.arm());
        let Some(unexplained) =
            unexplained.iter().find(|unexplained| unexplained.could_cause(finding, arm))
        else {
            return true;
        };
        let (length, angle) =
            (Unit::Metre.show(unexplained.length_m), Unit::Radian.show(unexplained.angle_rad));
        let why = format!(
            "{}, but a residual of {length} and {angle} is unexplained (MDL001)",
            finding.message
        );
        let is_explained =
            |row: &&mut CheckRow| row.code == finding.code && row.subject == finding.subject;
        for row in checks.iter_mut().filter(is_explained) {
            (row.status, row.reason) = (Status::Inconclusive, Some(why.clone()));
        }
        false
    });
}

/// Rules that compare poses with joint states.
const RULES_ON_POSES_AND_JOINTS: [&str; 7] =
    ["FRM001", "FRM002", "FRM003", "LAT", "ORD", "YAW", "ZER"];

/// Makes those rules inconclusive if poses and joint states disagree for no known reason or because of a
/// wrong model.
pub(super) fn withdraw_findings_on_disagreement(case: &Case, evaluation: &mut Evaluation) {
    let Evaluation { checks, findings, .. } = evaluation;
    let disagreeing = findings.iter().filter_map(|finding| match &finding.cause {
        Cause::Disagreement { description: said } => {
            Some((finding.subject.clone(), format!("{said} (MDL001)")))
        }
        Cause::OtherRobot(_) => {
            Some((finding.subject.clone(), format!("{} (MDL001)", finding.message)))
        }
        _ => None,
    });
    let disagreeing: Vec<(Subject, String)> = disagreeing.collect();
    for arm in &case.evidence.robots {
        let of_arm = |subject: &Subject| subject.arm() == Some(&arm.name);
        let disagreements: Vec<&(Subject, String)> =
            disagreeing.iter().filter(|(subject, _)| of_arm(subject)).collect();
        let Some((_, first)) = disagreements.first() else { continue };
        let on = |topic: &str| {
            disagreements.iter().find(|(said, _)| said.topic.as_deref() == Some(topic))
        };
        let is_all = arm.poses.iter().all(|stream| on(stream.topic()).is_some());
        let why = |subject: &Subject| {
            let disagreements = subject.topic.as_deref().and_then(&on).map(|(_, why)| why);
            disagreements.or(is_all.then_some(first))
        };
        let compares_poses_and_joints =
            |code: &str| RULES_ON_POSES_AND_JOINTS.iter().any(|prefix| code.starts_with(prefix));
        for row in checks
            .iter_mut()
            .filter(|row| compares_poses_and_joints(row.code) && of_arm(&row.subject))
        {
            if !matches!(row.status, Status::Inconclusive | Status::Fail) {
                continue;
            }
            let Some(why) = why(&row.subject) else { continue };
            (row.status, row.reason) = (Status::Inconclusive, Some(why.clone()));
            (row.estimate, row.is_indistinguishable) = (None, false);
        }
        findings.retain(|finding| {
            !(compares_poses_and_joints(finding.code)
                && of_arm(&finding.subject)
                && why(&finding.subject).is_some())
        });
    }
}
