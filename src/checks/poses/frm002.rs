use crate::checks::decision::DEGREE;
use crate::checks::frames::{self, End, THRESHOLDS, show, show_pose};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{FrameEstimate, Twin};
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{Cause, Change, Evidence, Fault, Outcome, Ruling, Severity};
use crate::geometry::{Pose, rotvec_from_rotation};

rule! {
    /// The reference frame of a stream is off by a constant.
    ///
    /// ## What it means
    /// The poses are expressed in another frame than their `frame_id` says. The usual case: a
    /// Universal Robots controller speaks of `base`, and somebody labelled its poses `base_link`,
    /// which is turned by 180° about z.
    ///
    /// ## Why it matters
    /// Every pose is wrong by the same transform, seen from the base: a half turn sends the arm to
    /// the other side of the table.
    ///
    /// ## Evidence
    /// `pose` is `reference_from_stream`: apply it to a logged pose to have it in the frame that
    /// the log names. The amount is the norm of its translation; the angle stands in `rotation`.
    /// The test is joint on all six numbers.
    ///
    /// Where `frame_id` changes in mid-run and the poses are right under one name and not under the other,
    /// the amount has `from`, `to` and `change_ns`, too.
    ///
    /// `changes` lists when it is another from some moment on, with its amounts before and after;
    /// the amount is then the size of the change (`from`, `to`, `change_ns`).
    ///
    /// ## How to fix
    /// Name the frame that the poses are in, or publish the static transform to it.
    ///
    /// ## When it misleads
    /// A base turned about the first joint's axis is the same to any log as an offset of that
    /// joint's zero: a joint zero is preferred, unless the angle is a round one, and the other
    /// stands in `indistinguishable`. A frame that is not tied to the robot (a tracker's world) is
    /// estimated and never a fault.
    FRM002 {
        name: "reference-frame",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let reference = End {
        rule: &FRM002,
        name: "reference frame",
        estimate: |diagnosis| &diagnosis.reference,
        frame: |stream| &stream.reference,
        not_judged: |stream| {
            let why =
                || format!("{} is not tied to the robot, its pose is estimated", stream.reference);
            (!stream.reference_known).then(why)
        },
        changes: |diagnosis| &diagnosis.reference_changes,
        is_twin: |twin, index| matches!(twin, Twin::Reference(stream, _) if *stream == index),
        fault,
    };
    frames::judge(case, &reference).into_iter().map(|judged| since_label(case, judged)).collect()
}

/// Says of poses that are off in the frame that their frame_id names for a part of the run when that part
/// begins or ends, where under the frame_id of the other part they are right.
fn since_label(case: &Case, mut judged: Judged) -> Judged {
    let Outcome::Evaluated(Ruling::Faulty(fault)) = &mut judged.outcome else { return judged };
    let subject = &judged.subject;
    let arm = case.evidence.robots.iter().find(|arm| subject.robot.as_ref() == Some(&arm.name));
    let parts = || {
        let poses = arm.into_iter().flat_map(|arm| &arm.poses);
        poses.filter(|stream| subject.topic.as_deref() == Some(stream.topic()))
    };
    let is_right = |stream: &Of<PoseEvidence>| {
        let reference = &stream.diagnosis.reference;
        stream.reference_known && reference.as_ref().is_ok_and(|frame| !frame.chosen)
    };
    let other =
        parts().find(|other| Some(&other.reference) != subject.frame.as_ref() && is_right(other));
    let spans = judged.span.zip(other.and_then(|other| other.span));
    let (Some((own, its)), Some(other)) = (spans, other) else { return judged };
    let (value, at) = match &judged.estimate {
        Some(estimate) if its.end <= own.start => (estimate.value(), own.start),
        Some(estimate) if own.end <= its.start => (estimate.value(), its.start),
        _ => return judged,
    };
    let is_after = at == own.start;
    let moment = case.evidence.moment(at);
    let when = if is_after { format!("from {moment} on") } else { format!("until {moment}") };
    let named = subject.frame.as_deref().unwrap_or_default();
    fault.title = "reference frame is off for a part of the run";
    fault.message =
        format!("{when}, where frame_id is {named} and not {}: {}", other.reference, fault.message);
    let value = value.unwrap_or(0.0);
    let (from, to) = if is_after { (0.0, value) } else { (value, 0.0) };
    let change = Change { from, to, change_ns: at, change_ci95_ns: None };
    judged.estimate = judged.estimate.map(|estimate| estimate.changing(change));
    judged
}

fn fault(
    arm: &ArmEvidence,
    stream: &Of<PoseEvidence>,
    frame: &FrameEstimate,
    severity: Severity,
) -> Fault {
    let reference = &stream.reference;
    // Columns of a table are in the base or in the controller's: neither contradicts a declaration.
    let is_either_base = stream.is_of_table && stream.bare && is_half_turn_about_z(&frame.pose);
    let severity = if is_either_base { Severity::Info } else { severity };
    let fix = if is_half_turn_about_z(&frame.pose) {
        format!(
            "the poses are in a frame turned by 180° about z (UR's base against base_link), not in {reference}: correct frame_id"
        )
    } else {
        let pose = show_pose(&frame.pose);
        format!("correct frame_id, or publish {reference}_from_stream = {pose}")
    };
    let effect_m = frame.translation_m.value + frame.rotation_rad.value * arm.reach_m;
    Fault {
        severity,
        cause: Cause::Reference(frame.pose),
        title: "reference frame is off",
        message: format!("poses are {} off from {reference}, everywhere", show(frame)),
        evidence: Evidence { effect_m: Some(effect_m), ..Evidence::default() },
        fix,
    }
}

fn is_half_turn_about_z(pose: &Pose) -> bool {
    let [x, y, z]: [f64; 3] = rotvec_from_rotation(&pose.rotation).into();
    let turned = (z.abs() - std::f64::consts::PI).abs() < DEGREE && x.hypot(y) < DEGREE;
    turned && pose.translation.vector.norm() < THRESHOLDS.length.error
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, frame};
    use crate::finding::Status;

    #[test]
    fn a_frame_that_is_not_tied_to_the_robot_is_estimated_and_not_judged() {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.poses[0].reference_known = false;
        arm.poses[0].diagnosis.reference = Ok(FrameEstimate { chosen: true, ..frame(1.2) });
        let (rows, findings) = ask(&FRM002, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Pass, "{rows:?}");
        assert_eq!(rows[0].evidence["pose"]["xyz"][0], 1.2);
    }
}
