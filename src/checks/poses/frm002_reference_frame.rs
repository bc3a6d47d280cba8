use crate::checks::decision::DEGREE;
use crate::checks::frames::{self, FrameRule, THRESHOLDS, show, show_pose};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{Confounder, FrameEstimate};
use crate::evidence::{ArmEvidence, JointAxes, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Change, Evidence, Fault, Outcome, Ruling, Severity};
use crate::geometry::{Pose, rotvec_from_rotation};

rule! {
    /// The reference frame of a stream is off by a constant.
    ///
    /// ## What it means
    /// The poses are in another frame than their `frame_id`. Commonly, a Universal Robots controller
    /// reports poses in `base`, and the driver labels them `base_link`, rotated by 180° about z.
    ///
    /// ## Why it matters
    /// Every pose is wrong by one transform; a half turn sends the arm to the other side of the table.
    ///
    /// ## Evidence
    /// - `pose`: `reference_from_stream`, which converts a logged pose to the named frame. The value is its
    ///   distance, `rotation` its angle; all six components are tested jointly.
    /// - `changes`: times and offsets of changes. The value is then the size of the change (`from`, `to`,
    ///   `change_ns`).
    /// - In `changes`, `is_gradual` marks a drift: at a constant rate from one time to another, or with
    ///   `time_constant_s` as `1 − exp(−t/τ)` over the run. The value is then its whole size, at the middle of the
    ///   motion.
    /// - `from`, `to`, `change_ns` also if `frame_id` changes during the run and the poses are right under
    ///   only one of the names.
    ///
    /// If the links deviate from the model (MDL001), the interval includes their effect.
    ///
    /// ## How to fix
    /// Set `frame_id` to the frame of the poses, or publish the static transform to it.
    ///
    /// ## When it misleads
    /// Columns of a table name no frame: half a turn about z is then `info`, because a UR has two bases.
    ///
    /// A base rotated about the first joint's axis is indistinguishable from that joint's zero offset, which
    /// is preferred unless the angle is round; `indistinguishable` lists the alternative. A frame not fixed
    /// to the robot (a tracker's world) is estimated, never a fault. If the tool is also off and the tip
    /// keeps its orientation, only the usual length of a tool (0.5 m) limits the distance. The interval is
    /// that wide. Between two pose streams, unrelated frames are estimated as `info`, and a change may be one
    /// of either stream.
    FRM002 {
        name: "reference-frame",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let reference = FrameRule {
        rule: &FRM002,
        name: "reference frame",
        estimate: |diagnosis| &diagnosis.reference,
        frame: |stream| &stream.reference,
        not_judged: |arm, stream| {
            let to = arm.arm_or_body("the robot", &arm.joints_topic);
            let why =
                || format!("{} is not fixed to {to}; its pose is estimated", stream.reference);
            (!stream.reference_known).then(why)
        },
        changes: |diagnosis| &diagnosis.reference_changes,
        is_confounder: |confounder, index| matches!(confounder, Confounder::Reference(stream, _) if *stream == index),
        zero: JointAxes::zero_from_reference,
        next_joint: JointAxes::first_column,
        fault,
    };
    frames::judge(case, &reference).into_iter().map(|judged| since_label(case, judged)).collect()
}

/// Adds the start or end time if the poses are right under the `frame_id` of the other part of the run.
fn since_label(case: &Case, mut judged: SubjectResult) -> SubjectResult {
    let Outcome::Evaluated(Ruling::Fail(fault)) = &mut judged.outcome else { return judged };
    let subject = &judged.subject;
    let arm = case.evidence.robots.iter().find(|arm| subject.arm() == Some(&arm.name));
    let segments = || {
        let poses = arm.into_iter().flat_map(|arm| &arm.poses);
        poses.filter(|stream| subject.topic.as_deref() == Some(stream.topic()))
    };
    let is_right = |stream: &StreamEvidence<PoseEvidence>| {
        let reference = &stream.diagnosis.reference;
        stream.reference_known && reference.as_ref().is_ok_and(|frame| !frame.is_chosen)
    };
    let other = segments()
        .find(|other| Some(&other.reference) != subject.frame.as_ref() && is_right(other));
    let spans = judged.span.zip(other.and_then(|other| other.span));
    let (Some((span, next_span)), Some(other)) = (spans, other) else { return judged };
    let (value, at) = match &judged.estimate {
        Some(estimate) if next_span.end <= span.start => (estimate.value(), span.start),
        Some(estimate) if span.end <= next_span.start => (estimate.value(), next_span.start),
        _ => return judged,
    };
    let is_after = at == span.start;
    let time = case.evidence.moment(at);
    let when = if is_after { format!("from {time} on") } else { format!("until {time}") };
    let named = subject.frame.as_deref().unwrap_or_default();
    fault.title = "reference frame is off for part of the run";
    fault.message =
        format!("{when}, with frame_id {named} instead of {}: {}", other.reference, fault.message);
    let value = value.unwrap_or(0.0);
    let (from, to) = if is_after { (0.0, value) } else { (value, 0.0) };
    let change = Change { from, to, change_ns: at, change_ci95_ns: None };
    judged.estimate = judged.estimate.map(|estimate| estimate.with_change(change));
    judged
}

fn fault(
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    frame: &FrameEstimate,
    severity: Severity,
) -> Fault {
    let reference = &stream.reference;
    if !stream.reference_known {
        return Fault {
            severity: Severity::Info,
            cause: Cause::ReferenceFrame(frame.pose),
            title: "reference frames differ",
            message: format!("its frame is {} from that of {}", show(frame), arm.joints_topic),
            evidence: Evidence::default(),
            fix: format!(
                "to express its poses there, multiply them from the left by {}",
                show_pose(&frame.pose)
            ),
        };
    }
    // Table columns may be in either base frame, whether or not their encoding is declared.
    let is_either_base = stream.names_no_frame && is_half_turn_about_z(&frame.pose);
    let severity = if is_either_base { Severity::Info } else { severity };
    let fix = if is_half_turn_about_z(&frame.pose) {
        format!(
            "the poses are in a frame rotated by 180° about z (UR: base instead of base_link), not in \
             {reference}: correct frame_id"
        )
    } else {
        let pose = show_pose(&frame.pose);
        format!("correct frame_id, or publish {reference}_from_stream = {pose}")
    };
    let effect_m = frame.translation_m.value + frame.rotation_rad.value * arm.reach_m;
    Fault {
        severity,
        cause: Cause::ReferenceFrame(frame.pose),
        title: "reference frame is off",
        message: format!("poses have a constant offset of {} from {reference}", show(frame)),
        evidence: Evidence { effect_m: Some(effect_m), ..Evidence::default() },
        fix,
    }
}

fn is_half_turn_about_z(pose: &Pose) -> bool {
    let [x, y, z]: [f64; 3] = rotvec_from_rotation(&pose.rotation).into();
    let is_half_turn = (z.abs() - std::f64::consts::PI).abs() < DEGREE && x.hypot(y) < DEGREE;
    is_half_turn && pose.translation.vector.norm() < THRESHOLDS.length.error
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, frame, precise};
    use crate::finding::Status;
    use crate::geometry::{Vec3, rotation_from_rotvec};
    use std::f64::consts::PI;

    #[test]
    fn half_a_turn_is_a_fault_only_of_a_named_frame() {
        let severity = |names_no_frame: bool| {
            let mut run = clean_run();
            let pose = &mut run.robots[0].poses[0];
            pose.names_no_frame = names_no_frame;
            let half_turn = rotation_from_rotvec(Vec3::z() * PI);
            pose.diagnosis.reference = Ok(FrameEstimate {
                pose: Pose::from_parts(Vec3::zeros().into(), half_turn),
                rotation_rad: precise(PI),
                p_value: 0.0,
                is_chosen: true,
                ..frame(0.0)
            });
            let (_, findings) = evaluate_rule(&FRM002, &run);
            findings.first().map(|finding| finding.severity)
        };
        assert_eq!(severity(true), Some(Severity::Info));
        assert_eq!(severity(false), Some(Severity::Error));
    }

    #[test]
    fn a_frame_not_connected_to_the_robot_is_not_judged() {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.poses[0].reference_known = false;
        arm.poses[0].diagnosis.reference = Ok(FrameEstimate { is_chosen: true, ..frame(1.2) });
        let (rows, findings) = evaluate_rule(&FRM002, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Pass, "{rows:?}");
        assert_eq!(rows[0].evidence["pose"]["xyz"][0], 1.2);
    }
}
