//! Shared by FRM002 and FRM003, which judge a constant frame of every pose stream.

use serde_json::{Value, json};

use crate::checks::confounders::joint_zero_alternative;
use crate::checks::decision::{
    DEGREE, Decision, FrameThresholds, Threshold, decide_frame, not_observable,
};
use crate::checks::{Case, Rule, SubjectResult, changes, residual_attribution};
use crate::diagnosis::{
    Confounder, EstimateResult, FrameChange, FrameEstimate, JointOffset, NotObservable,
    PoseDiagnosis,
};
use crate::evidence::{ArmEvidence, JointAxes, PoseEvidence, StreamEvidence, Tolerance};
use crate::finding::{Estimate, Fault, Outcome, Severity, Subject, Unit, rounded};
use crate::geometry::{Pose, rotvec_from_rotation, xyz_of, xyzw_from_rotation};

pub const THRESHOLDS: FrameThresholds = FrameThresholds {
    length: Threshold { unit: Unit::Metre, warning: 1e-3, error: 5e-3 },
    angle: Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE },
};

const SETTLE: [&str; 2] = [
    "turn the wrist through 60° about two axes, at several places",
    "turn the body through 60° about two axes, at several places",
];

fn settle(arm: &ArmEvidence) -> &'static str {
    let [of_arm, of_body] = SETTLE;
    arm.arm_or_body(of_arm, of_body)
}

/// One end of a stream's transform, with its rule.
pub struct FrameRule {
    pub rule: &'static Rule,
    /// Name of the estimate.
    pub name: &'static str,
    pub estimate: fn(&PoseDiagnosis) -> &EstimateResult<FrameEstimate>,
    /// Name of the frame.
    pub frame: fn(&StreamEvidence<PoseEvidence>) -> &str,
    /// Reason for not judging this stream.
    pub not_judged: fn(&ArmEvidence, &StreamEvidence<PoseEvidence>) -> Option<String>,
    /// Changes during the run.
    pub changes: fn(&PoseDiagnosis) -> &[FrameChange],
    /// Whether a joint offset's confounder is this end of the stream with this index.
    pub is_confounder: fn(&Confounder, usize) -> bool,
    /// Zero offset of a joint with the same effect as a wrong frame, if there is one.
    pub zero: fn(&JointAxes, usize, &Pose, Tolerance) -> Option<f64>,
    /// The joint next to the frame. If one stream alone shows the frame, the joint's zero may be wrong instead.
    pub next_joint: fn(&JointAxes) -> Option<usize>,
    pub fault: fn(&ArmEvidence, &StreamEvidence<PoseEvidence>, &FrameEstimate, Severity) -> Fault,
}

pub fn judge(case: &Case, end: &FrameRule) -> Vec<SubjectResult> {
    let judged = case.evidence.robots.iter().flat_map(|arm| {
        arm.poses.iter().enumerate().map(move |(index, stream)| {
            let subject = arm.frame(stream.topic(), (end.frame)(stream));
            judge_stream(case, arm, index, end, subject).within(stream.span)
        })
    });
    judged.collect()
}

fn judge_stream(
    case: &Case,
    arm: &ArmEvidence,
    index: usize,
    end: &FrameRule,
    subject: Subject,
) -> SubjectResult {
    let diagnosis = &arm.poses[index].diagnosis;
    if let Some(why) = diagnosis.unusable_reason() {
        return SubjectResult::new(subject, not_observable(why, settle(arm)));
    }
    let thresholds = case.thresholds.frame_thresholds(end.rule, THRESHOLDS);
    let moved = (end.changes)(diagnosis);
    let change = changes::judge_frame_change(case, arm, end.name, moved, &thresholds);
    changes::judge_with_change(subject, change, |subject| {
        judge_constant(case, arm, index, end, subject)
    })
}

/// Whether the motion determines no convention of undeclared rotation numbers.
fn rests_on_convention(stream: &PoseEvidence) -> bool {
    let encoding = stream.diagnosis.encoding.as_ref();
    stream.is_undeclared && encoding.is_ok_and(|encoding| !encoding.is_determined)
}

fn judge_constant(
    case: &Case,
    arm: &ArmEvidence,
    index: usize,
    end: &FrameRule,
    subject: Subject,
) -> SubjectResult {
    let stream = &arm.poses[index];
    let diagnosis = &stream.diagnosis;
    let thresholds = case.thresholds.frame_thresholds(end.rule, THRESHOLDS);
    let not_judged = (end.not_judged)(arm, stream);
    let confounders = confounders(arm, end, index);
    let reported = || confounders.iter().find(|(_, offset)| offset.is_chosen);
    let frame = match ((end.estimate)(diagnosis), &not_judged) {
        (Ok(frame), _) => frame,
        (Err(_), Some(why)) => return SubjectResult::new(subject, unjudged(arm, why)),
        (Err(why), None) => {
            let outcome = match reported() {
                Some((joint, _)) => reported_instead(arm, stream, *joint),
                None => not_observable(why, settle(arm)),
            };
            return SubjectResult::new(subject, outcome);
        }
    };
    let effect_m = frame.translation_m.value + frame.rotation_rad.value * arm.reach_m;
    let residual_m = residual_attribution::residual_m(stream);
    let outcome = match (decide_frame(frame, &thresholds, case.evidence.subjects()), not_judged) {
        (Decision::Fail(_), Some(_)) if arm.is_trajectory => {
            Outcome::fail((end.fault)(arm, stream, frame, Severity::Info))
        }
        (Decision::Undecided(_), Some(why)) if arm.is_trajectory => unjudged(arm, &why),
        (_, Some(why)) => Outcome::pass_with_remark(why),
        (Decision::Fail(_), None)
            if rests_on_convention(stream)
                && frame.translation_m.value < thresholds.length.warning =>
        {
            let what = "the convention of the rotation numbers (ORD001)";
            not_observable(&NotObservable::RestsOn(what), settle(arm))
        }
        (Decision::Fail(severity), None) if frame.is_chosen => {
            match residual_attribution::residual_doubt(residual_m, effect_m) {
                Some(why) => Outcome::Inconclusive(why),
                None => {
                    let mut fault = (end.fault)(arm, stream, frame, severity);
                    let next =
                        (end.next_joint)(&stream.joint_axes).filter(|_| arm.poses.len() == 1);
                    let mut joints: Vec<usize> = confounders.iter().map(|it| it.0).collect();
                    joints.extend(next.filter(|next| !joints.contains(next)));
                    let zeros = joints.into_iter().filter_map(|joint| {
                        let tolerance = (
                            thresholds.length.warning.max(frame.translation_m.half_width(0.95)),
                            thresholds.angle.warning.max(frame.rotation_rad.half_width(0.95)),
                        );
                        let zero = (end.zero)(&stream.joint_axes, joint, &frame.pose, tolerance)?;
                        Some(joint_zero_alternative(arm, joint, zero))
                    });
                    fault.evidence.indistinguishable.extend(zeros);
                    Outcome::fail(fault)
                }
            }
        }
        (Decision::Pass, None) => Outcome::pass(),
        (decision, None) => match reported().filter(|_| !frame.is_chosen) {
            Some((joint, _)) => reported_instead(arm, stream, *joint),
            None => Outcome::Inconclusive(undecided_reason(arm, &decision, frame)),
        },
    };
    SubjectResult::new(subject, outcome)
        .estimated(Estimate::frame(end.name, &frame.translation_m, &frame.rotation_rad))
        .with_evidence("pose", pose_json(&frame.pose))
}

/// A frame that is not judged, and not determined.
fn unjudged(arm: &ArmEvidence, why: &str) -> Outcome {
    let to_settle = format!("{why}, and this motion does not determine it; {}", settle(arm));
    Outcome::Skipped(arm.arm_or_body(why.to_owned(), to_settle))
}

fn reported_instead(
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    joint: usize,
) -> Outcome {
    if let Some(why) =
        residual_attribution::residual_doubt(residual_attribution::residual_m(stream), 0.0)
    {
        return Outcome::Inconclusive(why);
    }
    let subject = arm.joint(joint);
    Outcome::Indistinguishable(format!(
        "indistinguishable from ZER001 on {}, which is reported instead",
        subject.label()
    ))
}

fn undecided_reason(arm: &ArmEvidence, decision: &Decision, frame: &FrameEstimate) -> String {
    let settle = settle(arm);
    match decision {
        Decision::Undecided(why) => format!("{why}; {settle}"),
        _ => format!(
            "{} would fit, but the reported causes already explain the log; {settle}",
            show(frame)
        ),
    }
}

/// Joints whose zeros are confounded with this end of stream `index`.
fn confounders<'a>(
    arm: &'a ArmEvidence,
    end: &FrameRule,
    index: usize,
) -> Vec<(usize, &'a JointOffset)> {
    let offsets = arm.diagnosis.offsets.iter().enumerate();
    let mutual = offsets.filter(|(_, offset)| {
        offset.confounders.iter().any(|confounder| (end.is_confounder)(confounder, index))
    });
    mutual.collect()
}

pub fn show(frame: &FrameEstimate) -> String {
    let length = Unit::Metre.show_measured(&frame.translation_m);
    match frame.rotation_rad.std_error.is_finite() {
        true => format!("{length} and {}", Unit::Radian.show_measured(&frame.rotation_rad)),
        // Points have no rotation.
        false => length,
    }
}

/// `xyz (0, 0, 0.14) m, rotation vector (0, 0, 180)°`.
pub fn show_pose(pose: &Pose) -> String {
    let list = |numbers: [f64; 3], decimals: usize| {
        numbers.map(|number| rounded(number, decimals)).join(", ")
    };
    let degrees: [f64; 3] = rotvec_from_rotation(&pose.rotation).map(f64::to_degrees).into();
    format!("xyz ({}) m, rotation vector ({})°", list(xyz_of(pose), 4), list(degrees, 2))
}

pub fn pose_json(pose: &Pose) -> Value {
    json!({ "xyz": xyz_of(pose), "quaternion_xyzw": xyzw_from_rotation(&pose.rotation) })
}
