use crate::checks::frames::{self, End, THRESHOLDS, show, show_pose};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::{FrameEstimate, Twin};
use crate::evidence::{ArmEvidence, Of, PoseEvidence};
use crate::finding::{Cause, Evidence, Fault, Severity, Unit};
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
    /// numbers.
    ///
    /// ## How to fix
    /// Set the controller's active TCP to the one meant, or name with `--tip` the link that the
    /// stream speaks of.
    ///
    /// ## When it misleads
    /// Where nobody named the tip (`--tip`, the stream's child frame) an offset is most likely the
    /// active TCP and is reported as `info`. A twist about the last joint's axis is the same to any
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
        is_twin: |twin, index| matches!(twin, Twin::Tool(stream, _) if *stream == index),
        fault,
    };
    frames::judge(case, &tool)
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
        title: "tool frame is off",
        message: format!("poses are {} off from {tip}{guess}", show(frame)),
        evidence: Evidence {
            effect: Some(format!("{offset} at the tip, turning with the wrist")),
            effect_m: Some(frame.translation_m.value),
            ..Evidence::default()
        },
        fix: format!("set the active TCP, or the tip, so that {tip}_from_stream is not {pose}"),
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
