//! Adds to a finding how well its cause predicts samples that were not fitted.
//!
//! A cause with an amount is fitted to one half of the run, with everything else, and predicts the other half. An
//! encoding has no amount; only constant frames are fitted. The error of a change within the run is not computed.

use serde_json::{Value, json};

use super::{Case, Rule, SubjectResult};
use crate::checks::joints::zer001_joint_zero::ZER001;
use crate::checks::latency::lat001_latency::LAT001;
use crate::checks::latency::lat002_clock_skew::LAT002;
use crate::checks::poses::frm002_reference_frame::FRM002;
use crate::checks::poses::frm003_tool_frame::FRM003;
use crate::checks::poses::zer002_growth_with_reach::ZER002;
use crate::diagnosis::{HeldOutResidual, StreamHeldOut};
use crate::finding::{Outcome, Ruling, Subject};

/// Evidence key.
pub(crate) const HELD_OUT: &str = "held_out";

/// Of a residual: a share that shows in three digits, and rounding, m or rad.
const MIN_CHANGE: (f64, f64) = (1e-3, 1e-9);

/// Rules whose cause has no amount: rotations, units, axes, and the order and scale of joints.
const ENCODINGS: [&str; 8] =
    ["ORD001", "ORD002", "ORD003", "ORD004", "ORD005", "ORD008", "ORD009", "ORD010"];

/// Sets `held_out`: rms residual (m, rad) in each half of the run, `before` and `after` correcting this cause, with
/// everything else fitted to the other half.
pub(super) fn with_held_out(case: &Case, rule: &Rule, judged: SubjectResult) -> SubjectResult {
    if !matches!(judged.outcome, Outcome::Evaluated(Ruling::Fail(_))) {
        return judged;
    }
    // A whole turn of a joint changes no pose beyond rounding.
    let changes_poses = |residual: &HeldOutResidual| {
        let mut both = residual.with.into_iter().zip(residual.without);
        both.any(|(with, without)| {
            (with - without).abs() > (MIN_CHANGE.0 * without).max(MIN_CHANGE.1)
        })
    };
    match held_out(case, rule, &judged.subject).filter(changes_poses) {
        Some(residual) => judged.with_evidence(HELD_OUT, as_json(&residual)),
        None => judged,
    }
}

fn held_out(case: &Case, rule: &Rule, subject: &Subject) -> Option<HeldOutResidual> {
    if rule.code == ZER001.code {
        let of_arm = case.evidence.robots.iter().flat_map(|arm| {
            let offsets = arm.diagnosis.offsets.iter().enumerate();
            offsets.map(move |(joint, offset)| {
                let changes = !arm.diagnosis.zero_changes(joint).is_empty();
                (arm.joint(joint), offset.held_out.filter(|_| !changes))
            })
        });
        return of_arm.into_iter().find(|(joint, _)| joint == subject)?.1;
    }
    if ENCODINGS.contains(&rule.code) {
        let mut arms = case.evidence.robots.iter();
        let arm = arms.find(|arm| subject.arm() == Some(&arm.name))?;
        // Encodings of the joint states are judged by the first stream.
        let of_joints = |topic: &String| *topic == arm.joints_topic;
        let is_of_joints = subject.topic.as_ref().is_none_or(of_joints);
        let is_own = |topic: &str| subject.topic.as_deref() == Some(topic);
        let own = arm.poses.iter().find(|stream| is_of_joints || is_own(stream.topic()))?;
        return own.diagnosis.held_out_encoding();
    }
    let streams = case.evidence.poses().map(|(_, stream)| stream);
    let is_of = |own: &Subject| own.arm() == subject.arm() && own.topic == subject.topic;
    let mut streams = streams.filter(|stream| is_of(&stream.subject));
    let diagnosis = &streams.next()?.diagnosis;
    let StreamHeldOut { latency, skew, radial_scale, reference, tool } = diagnosis.held_out;
    // Several streams may share a topic, such as /tf.
    if streams.next().is_some() {
        return None;
    }
    match rule.code {
        code if code == LAT001.code => latency,
        code if code == LAT002.code => skew,
        code if code == ZER002.code => {
            radial_scale.filter(|_| diagnosis.radial_scale_changes.is_empty())
        }
        code if code == FRM002.code => reference.filter(|_| diagnosis.reference_changes.is_empty()),
        code if code == FRM003.code => tool.filter(|_| diagnosis.tool_changes.is_empty()),
        _ => None,
    }
}

fn as_json(residual: &HeldOutResidual) -> Value {
    let of = |[m, rad]: [f64; 2]| json!({ "m": m, "rad": rad });
    json!({ "before": of(residual.without), "after": of(residual.with) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{as_case, clean_run, evaluate_rule, precise};
    use crate::diagnosis::{Course, ScalarChange};

    #[test]
    fn a_joint_zero_shows_the_error_on_held_out_samples() {
        let mut run = clean_run();
        let offset = &mut run.robots[0].diagnosis.offsets[2];
        (offset.offset, offset.is_chosen) = (Ok(precise(0.02)), true);
        offset.held_out = Some(HeldOutResidual { without: [4e-3, 0.02], with: [1e-4, 2e-4] });
        let (_, findings) = evaluate_rule(&ZER001, &run);
        let held_out = &findings[0].evidence.more[HELD_OUT];
        assert_eq!(held_out["before"]["m"], 4e-3);
        assert_eq!(held_out["after"]["rad"], 2e-4);
    }

    #[test]
    fn a_change_does_not_show_the_error_of_a_constant_cause() {
        let mut run = clean_run();
        let subject = run.robots[0].poses[0].subject.clone();
        let diagnosis = &mut run.robots[0].poses[0].diagnosis;
        let residual = HeldOutResidual { without: [4e-3, 0.02], with: [1e-4, 2e-4] };
        diagnosis.held_out.radial_scale = Some(residual);
        assert_eq!(held_out(&as_case(&run), &ZER002, &subject), Some(residual));
        run.robots[0].poses[0].diagnosis.radial_scale_changes = vec![ScalarChange {
            at_s: 5.0,
            within_s: 0.1,
            course: Course::Step,
            from: 0.0,
            to: 0.01,
            size: precise(0.01),
        }];
        assert_eq!(held_out(&as_case(&run), &ZER002, &subject), None);
    }
}
