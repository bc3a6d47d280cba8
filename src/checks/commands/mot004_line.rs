use serde_json::{Value, json};

use crate::checks::commands::sources::{self, source_name};
use crate::checks::decision::{DEGREE, Decision, FrameThresholds, Threshold, decide_length};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{CommandedLine, LineDeviation, Measured};
use crate::evidence::{ArmEvidence, ReferenceEvidence, StreamEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};

rule! {
    /// A commanded straight line is not straight, or its orientation is not a slerp.
    ///
    /// ## What it means
    /// Streamed poses lead the tip along a straight line between two stops, and the tip deviates from it.
    /// Or the orientation along the line is not a slerp: a rotation about one axis, in step with the
    /// translation. The command itself may already deviate from the slerp.
    ///
    /// ## Why it matters
    /// Gluing, welding, cutting and insertion follow the actual path of the tip. If Euler angles,
    /// quaternion components or matrix elements are interpolated, the orientation swings out along the way
    /// although both ends are right.
    ///
    /// ## Evidence
    /// The largest distance from the line and the largest angle from the slerp, beyond the noise, on the
    /// worst line. The reference is the line between the tip's rests before and after it, so delay and
    /// offset do not count. `measured_by` is the source of poses with the smallest deviation. `command_rad`
    /// is the command's own deviation from the slerp, `command_off_axis_rad` its component off the axis.
    /// `interpolated` names the components that were interpolated instead, if identified. `lines` is the
    /// number of lines; `length_m`, `turn_rad` and the start `at_ns` describe the worst one.
    ///
    /// ## How to fix
    /// Interpolate positions linearly and rotations by slerp, both with the same path parameter, and solve
    /// inverse kinematics in small steps. If the command is right, compare the joints' delays and following
    /// errors, and slow down.
    ///
    /// ## When it misleads
    /// Only lines in streamed poses are judged; joint moves follow arcs. A planner that rotates about one
    /// axis with its own timing is `info`. A path that happens to be straight is treated as a line.
    MOT004 {
        name: "line",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "line accuracy: no commanded poses in this log",
        check: check,
    }
}

const THRESHOLDS: FrameThresholds = FrameThresholds {
    length: Threshold { unit: Unit::Metre, warning: 1e-3, error: 5e-3 },
    angle: Threshold { unit: Unit::Radian, warning: 0.5 * DEGREE, error: 2.0 * DEGREE },
};

const SETTLE: &str =
    "log the tool pose or the joint states at 50 Hz or more, with a rest at both ends";

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        let of_poses = arm.references.iter().filter(|reference| !reference.is_of_joints);
        of_poses.map(|reference| judge(case, arm, reference)).collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

/// In units of the warning thresholds, without the angle if the command itself deviates.
fn relative_deviation(
    line: &CommandedLine,
    deviation: &LineDeviation,
    thresholds: &FrameThresholds,
) -> f64 {
    let length = deviation.distance_m.norm.value / thresholds.length.warning;
    match is_command_deviating(line, thresholds) {
        true => length,
        false => length.max(deviation.angle_rad.norm.value / thresholds.angle.warning),
    }
}

fn is_command_deviating(line: &CommandedLine, thresholds: &FrameThresholds) -> bool {
    thresholds.angle.severity(line.command_rad).is_some()
}

/// According to one source of poses.
fn worst_line<'a>(
    lines: &'a [CommandedLine],
    source: usize,
    thresholds: &FrameThresholds,
) -> Option<(&'a CommandedLine, &'a LineDeviation)> {
    let followed =
        lines.iter().filter_map(|line| Some((line, line.deviations.get(source)?.as_ref()?)));
    followed.max_by(|a, b| {
        relative_deviation(a.0, a.1, thresholds)
            .total_cmp(&relative_deviation(b.0, b.1, thresholds))
    })
}

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    reference: &StreamEvidence<ReferenceEvidence>,
) -> SubjectResult {
    let thresholds = &case.thresholds.frame_thresholds(&MOT004, THRESHOLDS);
    let found = match sources::reference_diagnosis(arm, reference, SETTLE) {
        Ok(found) => found,
        Err(outcome) => return reference.judged(outcome),
    };
    let lines = &found.lines;
    let commanded = lines.iter().max_by(|a, b| a.command_rad.total_cmp(&b.command_rad));
    let Some(commanded) = commanded else {
        let why = match found.is_streamed {
            true => "line accuracy: no commanded path in this log is straight",
            false => "line accuracy: the commands in this log are goals, not a streamed path",
        };
        return reference.judged(Outcome::Skipped(why.to_owned()));
    };
    let worst_lines = (0..reference.tip_poses.len())
        .filter_map(|source| Some((source, worst_line(lines, source, thresholds)?)));
    let worst = worst_lines.min_by(|(_, a), (_, b)| {
        relative_deviation(a.0, a.1, thresholds)
            .total_cmp(&relative_deviation(b.0, b.1, thresholds))
    });
    let is_deviating = is_command_deviating(commanded, thresholds);
    let outcome = match worst {
        // A fault of the command must not hide that the tip leaves the line.
        Some((_, (line, measured))) if is_deviating => {
            with_distance(case, commanded, line, measured, lines.len())
        }
        None if is_deviating => Outcome::fail(command_fault(commanded, thresholds)),
        Some((_, (line, measured))) => tip_outcome(case, line, measured, lines.len()),
        None => {
            Outcome::Inconclusive(format!("no source of poses covers any of the lines; {SETTLE}"))
        }
    };
    let unknown = Measured { value: f64::NAN, std_error: f64::INFINITY, dof: 1.0 };
    let (distance, angle) = worst.map_or((unknown, unknown), |(_, (_, measured))| {
        (measured.distance_m.norm, measured.angle_rad.norm)
    });
    let (line, angle) = match worst {
        _ if is_deviating => {
            let angle =
                Measured { value: commanded.command_rad, std_error: 0.0, dof: f64::INFINITY };
            (commanded, angle)
        }
        Some((_, (line, _))) => (line, angle),
        None => (commanded, angle),
    };
    let measured_by: Value = worst.map(|(source, _)| source_name(reference, source)).into();
    reference
        .judged(outcome)
        .estimated(Estimate::frame("line deviation", &distance, &angle))
        .with_evidence("lines", lines.len())
        .with_evidence("at_ns", case.evidence.origin.shifted(line.from_s).to_string())
        .with_evidence("length_m", line.length_m)
        .with_evidence("turn_rad", line.turn_rad)
        .with_evidence("command_rad", commanded.command_rad)
        .with_evidence("command_off_axis_rad", commanded.command_off_axis_rad)
        .with_evidence("interpolated", json!(commanded.interpolated))
        .with_evidence("measured_by", measured_by)
}

fn decide(case: &Case, line: &CommandedLine, measured: &LineDeviation, lines: usize) -> Decision {
    let (thresholds, subjects) =
        (case.thresholds.frame_thresholds(&MOT004, THRESHOLDS), case.evidence.subjects() * lines);
    let by_length = decide_length(&measured.distance_m, &thresholds.length, subjects);
    by_length.and(match is_command_deviating(line, &thresholds) {
        true => Decision::Pass,
        false => decide_length(&measured.angle_rad, &thresholds.angle, subjects),
    })
}

/// Outcome at the tip if the command is a slerp.
fn tip_outcome(
    case: &Case,
    line: &CommandedLine,
    measured: &LineDeviation,
    lines: usize,
) -> Outcome {
    let distance = Unit::Metre.show_measured(&measured.distance_m.norm);
    let angle = Unit::Radian.show_measured(&measured.angle_rad.norm);
    match decide(case, line, measured, lines) {
        Decision::Pass => {
            Outcome::pass_with_remark(format!("the tip deviates from its lines by at most {distance} and \
                {angle}"))
        }
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
        Decision::Fail(severity) => Outcome::fail(Fault {
            cause: Cause::Pictured(Picture::Line),
            severity,
            title: "commanded line is not straight",
            message: format!(
                "the tip is {distance} off the line of {} and {angle} off its slerp, from {} on",
                Unit::Metre.show(line.length_m),
                case.evidence.moment_at(line.from_s),
            ),
            evidence: Evidence {
                effect_m: Some(measured.distance_m.norm.value),
                ..Evidence::default()
            },
            fix: "the command is straight: solve inverse kinematics in smaller steps along the line, or slow \
                down"
                .to_owned(),
        }),
    }
}

/// If the command is not a slerp.
fn command_fault(line: &CommandedLine, thresholds: &FrameThresholds) -> Fault {
    let (deviation, rotation) =
        (Unit::Radian.show(line.command_rad), Unit::Radian.show(line.turn_rad));
    let across = Unit::Radian.show(line.command_off_axis_rad);
    let is_pace = thresholds.angle.severity(line.command_off_axis_rad).is_none();
    let (severity, as_if) = match &line.interpolated {
        Some(name) => (
            thresholds.angle.severity(line.command_rad),
            format!(", as if {name} were interpolated"),
        ),
        None if is_pace => {
            (Some(Severity::Info), ": rotation and translation are not in step".to_owned())
        }
        None => (thresholds.angle.severity(line.command_rad), format!(", {across} off the axis")),
    };
    Fault {
        cause: Cause::Pictured(Picture::Line),
        severity: severity.unwrap_or(Severity::Info),
        title: "orientation along the line is not a slerp",
        message: format!(
            "the commanded orientation deviates {deviation} from the slerp over {rotation}{as_if}"
        ),
        evidence: Evidence::default(),
        fix: "interpolate rotations by slerp, in step with the positions".to_owned(),
    }
}

/// Adds the distance of the tip from the line if that also fails; the severity is the higher one.
fn with_distance(
    case: &Case,
    commanded: &CommandedLine,
    line: &CommandedLine,
    measured: &LineDeviation,
    lines: usize,
) -> Outcome {
    let off_line = CommandedLine { command_rad: f64::INFINITY, ..line.clone() };
    let distance = Unit::Metre.show_measured(&measured.distance_m.norm);
    let fault = command_fault(commanded, &case.thresholds.frame_thresholds(&MOT004, THRESHOLDS));
    Outcome::fail(match decide(case, &off_line, measured, lines) {
        Decision::Fail(severity) => Fault {
            severity: severity.max(fault.severity),
            message: format!("{}, and the tip is {distance} off the line", fault.message),
            ..fault
        },
        _ => fault,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, length};
    use crate::evidence::RunEvidence;
    use crate::finding::Status;

    fn planted(change: impl Fn(&mut CommandedLine)) -> RunEvidence {
        let mut run = clean_run();
        if let Ok(Ok(found)) = &mut run.robots[0].references[0].diagnosis {
            change(&mut found.lines[0]);
        }
        run
    }

    #[test]
    fn a_line_deviation_must_show_in_all_pose_streams() {
        let bowed = LineDeviation { distance_m: length(0.003), angle_rad: length(0.0) };
        let by_one = planted(|line| line.deviations[0] = Some(bowed));
        assert_eq!(evaluate_rule(&MOT004, &by_one).0[0].status, Status::Pass);
        let by_all = planted(|line| line.deviations = vec![Some(bowed); 2]);
        let (_, findings) = evaluate_rule(&MOT004, &by_all);
        assert_eq!(findings[0].severity, Severity::Warning);
        assert!(findings[0].message.starts_with("the tip is 3.0"), "{}", findings[0].message);
    }

    #[test]
    fn another_speed_profile_is_information_and_another_interpolation_is_a_fault() {
        let off = 3.0 * DEGREE;
        for (across, interpolated, severity) in [
            (0.0, None, Severity::Info),
            (0.0, Some("matrix elements".to_owned()), Severity::Error),
            (off, Some("euler:xyz".to_owned()), Severity::Error),
            (off, None, Severity::Error),
        ] {
            let run = planted(|line| {
                (line.command_rad, line.command_off_axis_rad) = (off, across);
                line.interpolated.clone_from(&interpolated);
            });
            let (_, findings) = evaluate_rule(&MOT004, &run);
            assert_eq!(findings[0].severity, severity, "{}", findings[0].message);
        }
    }

    #[test]
    fn without_a_pose_stream_the_line_is_inconclusive() {
        let run = planted(|line| line.deviations = vec![None; 2]);
        assert_eq!(evaluate_rule(&MOT004, &run).0[0].status, Status::Inconclusive);
    }
}
