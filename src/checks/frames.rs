//! What FRM002 and FRM003 share: each judges one constant frame of every pose stream.

use serde_json::{Value, json};

use crate::checks::decision::{DEGREE, Decision, FrameThresholds, Threshold, decide_frame, unseen};
use crate::checks::twins::zero_cause;
use crate::checks::{Case, Judged, Rule, changes, standing};
use crate::diagnosis::{FrameChange, FrameEstimate, JointOffset, PoseDiagnosis, Seen, Twin};
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{Alternative, Estimate, Fault, Outcome, Severity, Subject, Unit, rounded};
use crate::geometry::{Pose, rotvec_from_rotation, xyz_of, xyzw_from_rotation};

/// The thresholds of every rule on frames.
pub const THRESHOLDS: FrameThresholds = FrameThresholds {
    length: Threshold { unit: Unit::Metre, warning: 1e-3, error: 5e-3 },
    angle: Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE },
};

/// What would tell where a frame could not be had.
const SETTLE: &str = "turn the wrist through 60° about two axes, at several places";

/// One end of a stream's transform, and how its rule words an offset of it.
pub struct End {
    /// The rule.
    pub rule: &'static Rule,
    /// Name of the estimate.
    pub name: &'static str,
    /// Its estimate.
    pub estimate: fn(&PoseDiagnosis) -> &Seen<FrameEstimate>,
    /// The frame.
    pub frame: fn(&Of<PoseEvidence>) -> &str,
    /// Why the offset of this stream is none to judge, where it is none.
    pub not_judged: fn(&Of<PoseEvidence>) -> Option<String>,
    /// Its changes in mid-run.
    pub changes: fn(&PoseDiagnosis) -> &[FrameChange],
    /// The twin that it is to joint offsets, if it is one.
    pub is_twin: fn(&Twin, usize) -> bool,
    /// The fault.
    pub fault: fn(&ArmEvidence, &Of<PoseEvidence>, &FrameEstimate, Severity) -> Fault,
}

/// Judges one end of every pose stream.
pub fn judge(case: &Case, end: &End) -> Vec<Judged> {
    let streams = case.evidence.robots.iter().flat_map(|arm| {
        arm.poses.iter().enumerate().map(move |(index, stream)| (arm, index, stream))
    });
    let judged = streams.map(|(arm, index, stream)| {
        let subject = arm.frame(stream.topic(), (end.frame)(stream));
        judge_stream(case, arm, index, end, subject).within(stream.span)
    });
    judged.collect()
}

fn judge_stream(
    case: &Case,
    arm: &ArmEvidence,
    index: usize,
    end: &End,
    subject: Subject,
) -> Judged {
    let stream = &arm.poses[index];
    let diagnosis = &stream.diagnosis;
    let thresholds = case.thresholds.of_frames(end.rule, THRESHOLDS);
    if let Some(why) = diagnosis.unread() {
        return Judged::new(subject, unseen(why, SETTLE));
    }
    let moved = (end.changes)(diagnosis);
    if let Some((outcome, estimate)) = changes::frame(case, arm, end.name, moved, &thresholds) {
        return Judged::new(subject, outcome).estimated(estimate);
    }
    let not_judged = (end.not_judged)(stream);
    let twins = twins(arm, end, index);
    let frame = match ((end.estimate)(diagnosis), &not_judged) {
        (Ok(frame), _) => frame,
        (Err(_), Some(why)) => return Judged::new(subject, Outcome::Skipped(why.clone())),
        (Err(why), None) => {
            let outcome = match twins.iter().find(|(offset, _)| offset.chosen) {
                Some((_, cause)) => named_instead(arm, cause),
                None => unseen(why, SETTLE),
            };
            return Judged::new(subject, outcome);
        }
    };
    let effect_m = frame.translation_m.value + frame.rotation_rad.value * arm.reach_m;
    let outcome = match (decide_frame(frame, &thresholds, case.evidence.subjects()), not_judged) {
        (_, Some(why)) => Outcome::sound_because(why),
        (Decision::Fail(severity), None) if frame.chosen => match standing::doubt(arm, effect_m) {
            Some(why) => Outcome::Inconclusive(why),
            None => {
                let mut fault = (end.fault)(arm, stream, frame, severity);
                fault.evidence.indistinguishable.extend(twins.into_iter().map(|(_, cause)| cause));
                Outcome::faulty(fault)
            }
        },
        (Decision::Pass, None) => Outcome::sound(),
        (decision, None) => match twins.iter().find(|(offset, _)| offset.chosen && !frame.chosen) {
            Some((_, cause)) => named_instead(arm, cause),
            None => Outcome::Inconclusive(undecided(&decision, frame)),
        },
    };
    Judged::new(subject, outcome)
        .estimated(Estimate::frame(end.name, &frame.translation_m, &frame.rotation_rad))
        .with_evidence("pose", pose_json(&frame.pose))
}

fn named_instead(arm: &ArmEvidence, cause: &Alternative) -> Outcome {
    if let Some(why) = standing::doubt(arm, 0.0) {
        return Outcome::Inconclusive(why);
    }
    let (code, joint) = (cause.code, cause.subject.label());
    Outcome::Indistinguishable(format!(
        "indistinguishable from {code} on {joint}, which is named instead"
    ))
}

fn undecided(decision: &Decision, frame: &FrameEstimate) -> String {
    match decision {
        Decision::Undecided(why) => format!("{why}; {SETTLE}"),
        _ => format!(
            "{} would fit, but what is found explains the log without it; {SETTLE}",
            show(frame)
        ),
    }
}

/// The joint offsets that do the same as this end of stream `index`.
fn twins<'a>(arm: &'a ArmEvidence, end: &End, index: usize) -> Vec<(&'a JointOffset, Alternative)> {
    let offsets = arm.diagnosis.offsets.iter().enumerate();
    let same =
        offsets.filter(|(_, offset)| offset.twins.iter().any(|twin| (end.is_twin)(twin, index)));
    same.map(|(joint, offset)| (offset, zero_cause(arm, joint))).collect()
}

/// The two norms of a frame error with their intervals.
pub fn show(frame: &FrameEstimate) -> String {
    let length = Unit::Metre.show_measured(&frame.translation_m);
    format!("{length} and {}", Unit::Radian.show_measured(&frame.rotation_rad))
}

/// A pose in words: `xyz (0, 0, 0.14) m, rotation vector (0, 0, 180)°`.
pub fn show_pose(pose: &Pose) -> String {
    let list = |numbers: [f64; 3], decimals: usize| {
        numbers.map(|number| rounded(number, decimals)).join(", ")
    };
    let degrees: [f64; 3] = rotvec_from_rotation(&pose.rotation).map(f64::to_degrees).into();
    format!("xyz ({}) m, rotation vector ({})°", list(xyz_of(pose), 4), list(degrees, 2))
}

/// A pose as reports have it.
pub fn pose_json(pose: &Pose) -> Value {
    json!({ "xyz": xyz_of(pose), "quaternion_xyzw": xyzw_from_rotation(&pose.rotation) })
}
