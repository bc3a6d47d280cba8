use crate::checks::frames::{self, End, THRESHOLDS, show, show_pose};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{FrameEstimate, Other, Twin};
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Severity, Unit};
use crate::run::Witness;

rule! {
    /// The tool frame of a stream is off by a constant.
    ///
    /// ## What it means
    /// The poses are those of another point on the last link than the tip that was named: flange
    /// against tool0, or a TCP that is active in the controller.
    ///
    /// ## Why it matters
    /// Seen from the tool the error is always the same, seen from the base it turns with the wrist,
    /// so that no correction of a few taught points takes it off.
    ///
    /// ## Evidence
    /// `pose` is `tip_from_stream`: where the stream's point is, seen from the tip. The amount is
    /// the norm of its translation; the angle stands in `rotation`. The test is joint on all six
    /// numbers. Where the poses alternate between rigid bodies on one tool (a tracker that takes one
    /// marker for another, a TCP that is switched), a finding for each body beside the usual one says how
    /// far it is from that (`pose` is `usual_from_other`) and when it is seen (`spans_ns`, the first from
    /// `change_ns` on, of `samples`); everything else is judged with all poses as those of the usual one.
    ///
    /// `changes` lists when it is another from some moment on, with its amounts before and after;
    /// the amount is then the size of the change (`from`, `to`, `change_ns`).
    ///
    /// ## How to fix
    /// Set the controller's active TCP to the one meant, or name with `--tip` the link that the
    /// stream speaks of.
    ///
    /// ## When it misleads
    /// Where nobody named the tip (`--tip`, the stream's child frame) an offset is most likely the
    /// active TCP and is reported as `info`; of an outside witness it is where its marker sits, which is
    /// `info`, too. A twist about the last joint's axis is the same to any
    /// log as an offset of that joint's zero; the other stands in `indistinguishable`.
    FRM003 {
        name: "tool-frame",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

fn check(case: &Case) -> Vec<Judged> {
    let tool = End {
        rule: &FRM003,
        name: "tool frame",
        estimate: |diagnosis| &diagnosis.tool,
        frame: |stream| &stream.tip,
        not_judged: |_| None,
        changes: |diagnosis| &diagnosis.tool_changes,
        is_twin: |twin, index| matches!(twin, Twin::Tool(stream, _) if *stream == index),
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

/// Poses that are of another body on the tool for some of the time.
fn alternates(case: &Case, arm: &ArmEvidence, stream: &Of<PoseEvidence>, other: &Other) -> Judged {
    /// Times that are named.
    const NAMED: usize = 3;
    let thresholds = case.thresholds.of_frames(&FRM003, THRESHOLDS);
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
        more => format!(" and {more} times more"),
    };
    let (what, fix) = match stream.witness {
        Witness::External => (
            "the tracker mistakes another marker, or a rotated constellation, for the body",
            "make the constellation of markers asymmetric and keep bodies apart; leave out the poses of \
             these times",
        ),
        _ => (
            "another tool frame is active",
            "keep one active TCP, or put the frame of each pose into its header",
        ),
    };
    let effect_m = length.value + angle.value * length.value;
    let fault = Fault {
        severity,
        cause: Cause::Other,
        title: "tool frame alternates",
        message: format!(
            "{:.0} % of the poses are of a second body, {} and {} from the first ({}{more}): {what}",
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
    Judged::new(arm.frame(stream.topic(), &stream.tip), Outcome::faulty(fault))
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
    _: &ArmEvidence,
    stream: &Of<PoseEvidence>,
    frame: &FrameEstimate,
    severity: Severity,
) -> Fault {
    let tip = &stream.tip;
    let (severity, guess) = match (stream.witness, stream.tip_named) {
        (Witness::External, _) => (Severity::Info, ": where its marker sits"),
        (_, true) => (severity, ""),
        (_, false) => (Severity::Info, ", probably the active TCP"),
    };
    let (offset, pose) = (Unit::Metre.show(frame.translation_m.value), show_pose(&frame.pose));
    Fault {
        severity,
        cause: Cause::Tool(frame.pose),
        title: "tool frame offset",
        message: format!("poses are {} from {tip}{guess}", show(frame)),
        evidence: Evidence {
            effect: Some(format!("{offset} at the tip, turning with the wrist")),
            effect_m: Some(frame.translation_m.value),
            ..Evidence::default()
        },
        fix: format!(
            "the stream reports a TCP at {tip} + {pose}: add that frame to the model and pass it as --tip, or set the \
             controller's TCP to zero"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, frame};

    fn severity_of(tip_named: bool) -> Option<Severity> {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.poses[0].tip_named = tip_named;
        arm.poses[0].diagnosis.tool = Ok(FrameEstimate { chosen: true, ..frame(0.14) });
        ask(&FRM003, &run).1.first().map(|finding| finding.severity)
    }

    #[test]
    fn an_offset_is_a_fault_only_from_a_tip_that_was_named() {
        assert_eq!(severity_of(true), Some(Severity::Error));
        assert_eq!(severity_of(false), Some(Severity::Info));
    }
}
