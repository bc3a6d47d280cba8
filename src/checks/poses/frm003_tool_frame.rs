use crate::checks::frames::{self, FrameRule, THRESHOLDS, show, show_pose};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{Confounder, FrameEstimate, SwitchedTool};
use crate::evidence::{ArmEvidence, JointAxes, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::run::PoseSourceKind;

rule! {
    /// The tool frame of a stream is off by a constant.
    ///
    /// ## What it means
    /// The poses describe another point on the last link than the named tip: the flange instead of tool0,
    /// or a TCP active in the controller.
    ///
    /// ## Why it matters
    /// The error rotates with the wrist: correcting a few taught points does not remove it.
    ///
    /// ## Evidence
    /// - `pose`: `tip_from_stream`, the stream's point in the tip frame. The value is its distance,
    ///   `rotation` its angle; all six components are tested jointly.
    /// - `changes`: times and offsets of changes. The value is then the size of the change (`from`, `to`,
    ///   `change_ns`). `is_gradual` marks a drift: at a constant rate from one time to another, or with
    ///   `time_constant_s` as `1 − exp(−t/τ)` over the run. The value is then its whole size.
    ///
    /// The poses may alternate between rigid bodies on one tool (a tracker confuses markers, or the TCP is
    /// switched). Each but the most frequent one has a finding with its offset from that (`pose` is
    /// `usual_from_other`), its times (`spans_ns`, from `change_ns` on) and number of `samples`. All other
    /// rules use poses converted to the most frequent body.
    ///
    /// If the links deviate from the model (MDL001), the interval includes their effect.
    ///
    /// ## How to fix
    /// Set the controller's active TCP to the intended one, or name the stream's link with `--tip`. If the stream's
    /// child frame names the link, rename that frame, or correct the link's joint in the description.
    ///
    /// ## When it misleads
    /// If the tip is not named (`--tip`, or the stream's child frame), an offset is probably the active
    /// TCP: `info`. So is an external tracker's offset, the position of its marker. A rotation about the
    /// last joint's axis is indistinguishable from that joint's zero offset; `indistinguishable` lists the
    /// alternative.
    FRM003 {
        name: "tool-frame",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<SubjectResult> {
    let tool = FrameRule {
        rule: &FRM003,
        name: "tool frame",
        estimate: |diagnosis| &diagnosis.tool,
        frame: |stream| &stream.tip,
        not_judged: |arm, stream| {
            let why = || format!("nothing ties its body to that of {}", arm.joints_topic);
            (arm.is_trajectory && !stream.is_tip_declared).then(why)
        },
        changes: |diagnosis| &diagnosis.tool_changes,
        is_confounder: |confounder, index| matches!(confounder, Confounder::Tool(stream, _) if *stream == index),
        zero: JointAxes::zero_from_tool,
        next_joint: JointAxes::last_column,
        fault,
    };
    let mut judged = frames::judge(case, &tool);
    for arm in &case.evidence.robots {
        for stream in &arm.poses {
            let others = stream.alternation.iter().flat_map(|all| &all.others);
            judged.extend(others.map(|other| alternates(case, arm, stream, other)));
        }
    }
    judged
}

fn alternates(
    case: &Case,
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    other: &SwitchedTool,
) -> SubjectResult {
    /// Time spans in the message.
    const NAMED: usize = 3;
    let thresholds = case.thresholds.frame_thresholds(&FRM003, THRESHOLDS);
    let (length, angle) = (&other.length_m, &other.angle_rad);
    let severity = thresholds
        .length
        .severity(length.value)
        .max(thresholds.angle.severity(angle.value))
        .unwrap_or(Severity::Info);
    let samples = stream.alternation.as_ref().map_or(0, |all| all.samples);
    let stamp = |at_s: f64| case.evidence.origin.shifted(at_s);
    let spans: Vec<[String; 2]> = other
        .spans_s
        .iter()
        .map(|span| span.map(|at_s| case.evidence.moment(stamp(at_s))))
        .collect();
    let named: Vec<String> =
        spans.iter().take(NAMED).map(|[from, to]| format!("{from} to {to}")).collect();
    let more = match spans.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more times"),
    };
    let (what, fix) = match stream.source_kind {
        PoseSourceKind::External => (
            "the tracker confuses the body with another marker or a rotated constellation",
            "use an asymmetric marker constellation and keep bodies apart; exclude the poses at these times",
        ),
        _ => (
            "another tool frame is active",
            "keep one active TCP, or record the frame of each pose in its header",
        ),
    };
    let effect_m = length.value + angle.value * length.value;
    let fault = Fault {
        severity,
        cause: Cause::Pictured(Picture::Stream),
        title: "tool frame alternates",
        message: format!(
            "{:.0} % of the poses belong to a second body, {} and {} from the first ({}{more}): {what}",
            100.0 * other.samples as f64 / samples.max(1) as f64,
            Unit::Metre.show_measured(length),
            Unit::Radian.show_measured(angle),
            named.join(", "),
        ),
        evidence: Evidence { effect_m: Some(effect_m), ..Evidence::default() },
        fix: fix.to_owned(),
    };
    let ns = |span: &[f64; 2]| span.map(|at_s| stamp(at_s).to_string());
    let spans_ns: Vec<[String; 2]> = other.spans_s.iter().map(ns).collect();
    let change_ns = other.spans_s.first().map(|[from_s, _]| stamp(*from_s).to_string());
    SubjectResult::new(arm.frame(stream.topic(), &stream.tip), Outcome::fail(fault))
        .within(stream.span)
        .estimated(Estimate::frame("tool frame changes", length, angle))
        .with_evidence("pose", frames::pose_json(&other.pose))
        .with_evidence("change_ns", change_ns)
        .with_evidence(
            "clusters",
            stream.alternation.as_ref().map_or(0, |all| all.others.len() + 1),
        )
        .with_evidence("spans_ns", serde_json::json!(spans_ns))
        .with_evidence("samples", other.samples)
}

fn fault(
    arm: &ArmEvidence,
    stream: &StreamEvidence<PoseEvidence>,
    frame: &FrameEstimate,
    severity: Severity,
) -> Fault {
    if arm.is_trajectory {
        let severity = if stream.is_tip_declared { severity } else { Severity::Info };
        return Fault {
            severity,
            cause: Cause::ToolFrame(frame.pose),
            title: "body frames differ",
            message: format!("its body is {} from that of {}", show(frame), arm.joints_topic),
            evidence: Evidence { effect_m: Some(frame.translation_m.value), ..Evidence::default() },
            fix: format!(
                "to get poses of that body, multiply its poses from the right by the inverse of {}",
                show_pose(&frame.pose)
            ),
        };
    }
    let tip = &stream.tip;
    let (severity, likely_cause) = match (stream.source_kind, stream.is_tip_declared) {
        (PoseSourceKind::External, _) => (Severity::Info, ", the position of its marker"),
        (_, true) => (severity, ""),
        (_, false) => (Severity::Info, ", probably the active TCP"),
    };
    let (offset, pose) = (Unit::Metre.show(frame.translation_m.value), show_pose(&frame.pose));
    Fault {
        severity,
        cause: Cause::ToolFrame(frame.pose),
        title: "tool frame offset",
        message: format!("poses are {} from {tip}{likely_cause}", show(frame)),
        evidence: Evidence {
            effect: Some(format!("{offset} at the tip, turning with the wrist")),
            effect_m: Some(frame.translation_m.value),
            ..Evidence::default()
        },
        fix: match (stream.source_kind, stream.is_tip_of_child_frame) {
            (PoseSourceKind::External, _) => format!(
                "the marker is at {tip} + {pose}: to compare further logs with it, add that frame to the model and pass \
                 it as --tip"
            ),
            (_, true) => format!(
                "{} places {tip} at {tip} + {pose} of the model: rename its child_frame_id, or correct the joint of \
                 {tip} in the description",
                stream.topic()
            ),
            (_, false) => format!(
                "the stream reports a TCP at {tip} + {pose}: add that frame to the model and pass it as --tip, or \
                 set the controller's TCP to zero"
            ),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, frame, precise};
    use crate::finding::Status;

    fn severity_of(tip_named: bool) -> Option<Severity> {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.poses[0].is_tip_declared = tip_named;
        arm.poses[0].diagnosis.tool = Ok(FrameEstimate { is_chosen: true, ..frame(0.14) });
        evaluate_rule(&FRM003, &run).1.first().map(|finding| finding.severity)
    }

    #[test]
    fn the_fix_can_be_applied_to_the_source_of_the_tip() {
        let fix = |source_kind: PoseSourceKind, is_tip_of_child_frame: bool| {
            let mut run = clean_run();
            let pose = &mut run.robots[0].poses[0];
            (pose.source_kind, pose.is_tip_of_child_frame) = (source_kind, is_tip_of_child_frame);
            pose.diagnosis.tool = Ok(FrameEstimate { is_chosen: true, ..frame(0.14) });
            evaluate_rule(&FRM003, &run)
                .1
                .first()
                .map(|found| found.fix.clone())
                .unwrap_or_default()
        };
        let of_controller = fix(PoseSourceKind::Controller, false);
        assert!(of_controller.ends_with("or set the controller's TCP to zero"), "{of_controller}");
        let of_tracker = fix(PoseSourceKind::External, false);
        assert!(of_tracker.ends_with("pass it as --tip"), "{of_tracker}");
        let of_transform = fix(PoseSourceKind::Controller, true);
        assert!(of_transform.contains("rename its child_frame_id"), "{of_transform}");
        assert!(!of_transform.contains("--tip"), "{of_transform}");
    }

    #[test]
    fn a_rotation_whose_convention_is_undetermined_is_not_judged() {
        let statuses = |is_determined: bool| {
            let mut run = clean_run();
            let pose = &mut run.robots[0].poses[0];
            pose.is_tip_declared = true;
            pose.is_undeclared = true;
            pose.diagnosis.tool = Ok(FrameEstimate {
                rotation_rad: precise(2.0),
                p_value: 0.0,
                is_chosen: true,
                ..frame(0.0)
            });
            pose.diagnosis.encoding.as_mut().unwrap().is_determined = is_determined;
            evaluate_rule(&FRM003, &run).0[0].status
        };
        assert_eq!([true, false].map(statuses), [Status::Fail, Status::Inconclusive]);
    }

    #[test]
    fn a_tool_offset_is_a_fault_only_if_the_tip_is_named() {
        assert_eq!(severity_of(true), Some(Severity::Error));
        assert_eq!(severity_of(false), Some(Severity::Info));
    }
}
