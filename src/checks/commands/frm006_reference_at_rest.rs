use serde_json::{Value, json};

use crate::checks::commands::joint_maps::{self, MappedJoint};
use crate::checks::commands::sources::{self, following_json, is_fk_different, source_name};
use crate::checks::decision::{Decision, decide_frame};
use crate::checks::frames::{THRESHOLDS, pose_json, show};
use crate::checks::motion::mot003_limits_exceeded::{self, UNIT_UNDETERMINED};
use crate::checks::{Case, FrameThresholds, Grade, SubjectResult};
use crate::diagnosis::{
    CommandDelay, CommandDiagnosis, FrameEstimate, Measured, RestError, RestErrorSpread, range_of,
};
use crate::evidence::{ArmEvidence, ReferenceEvidence, StreamEvidence, TipPoseKind};
use crate::finding::{
    Alternative, Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Subject, Unit,
};

rule! {
    /// Steady-state error between a command and the pose at rest.
    ///
    /// ## What it means
    /// The command (a goal, a streamed pose or commanded joints) is constant and the arm has settled, so
    /// latency and following error have decayed. Yet the tip is off target. Commanded joints are converted
    /// by forward kinematics. Or a joint follows its commands by a constant map: it moves the other way,
    /// moves more or less than commanded, or is off by a constant, such as a quarter or a whole turn.
    ///
    /// ## Why it matters
    /// This is the error of every pick and place. If goal and measured pose come from different chains of
    /// frames, the two chains differ.
    ///
    /// ## Evidence
    /// The distance at the worst rest for streamed commands, and at the median rest for single goals.
    /// `rests` is the number of rests, `exceeding` the number above the thresholds, `at_ns` the time. `pose`
    /// is `tip_from_commanded`. `joints` lists the error of each commanded joint (`q_measured −
    /// q_commanded`). An error that differs between rests is shown as a range.
    ///
    /// `maps` lists the joints that follow by a constant map, `state = gain · command + offset`, fitted over
    /// the run at the delay (LAT004), or over the rests if the commands are goals. The map must leave less
    /// than a fifth of the difference between state and command. It needs no model, no rest and no unit.
    ///
    /// `measured_by` is the pose source nearest to the command, among FK and the pose streams, as logged
    /// and corrected. `others` lists the errors of the other sources; if sources differ, other rules report
    /// the cause. `not_reached` counts the `goals` near which the arm never rested because it was stopped,
    /// redirected or did not try; this is not a fault. `following` describes how a streamed command is
    /// followed: delay, rms error, and residual after compensating the delay.
    ///
    /// ## How to fix
    /// Separate the chains first: express goal and measured pose in one frame, with the same tool and
    /// kinematics. Then check the controller. A joint with a steady-state error lacks integral action, is
    /// overloaded, or is held by a brake. A compliant controller yields to loads by design. Of a leader and
    /// its follower, correct the zero, the direction or the gear ratio of the one that is wrong; the log does
    /// not show which.
    ///
    /// ## When it misleads
    /// An offset that is constant in the tool frame at different orientations is probably a different active
    /// TCP. It is `info` unless the commanded link was named. A single goal at which the arm was stopped
    /// within 20 mm looks like a missed goal. With FK alone, a nominal model of a calibrated arm also differs
    /// by millimetres (MDL001). A whole turn is a warning, because the pose is right.
    FRM006 {
        name: "reference-at-rest",
        grade: Grade::From(&[THRESHOLDS.length, THRESHOLDS.angle]),
        headline: false,
        needs_model: true,
        missing: "no goal and no command to the arm in this log",
        check: check,
    }
}

const SETTLE: &str = "let the arm rest for half a second at its goals";
/// An equal offset above this at all rests may be a tool or base frame, m.
const MIN_FRAME_OFFSET_M: f64 = 0.02;
/// Spread between rests relative to an error that is the same at all of them.
const MAX_RELATIVE_SPREAD: f64 = 0.2;
/// Limit for any arm, m.
const MAX_STEADY_STATE_ERROR_M: f64 = 0.1;
/// Limit for a calibrated arm, m and rad.
const MAX_NOMINAL_RESIDUAL: (f64, f64) = (0.01, THRESHOLDS.angle.error);

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        arm.references.iter().map(|one| judge(case, arm, one)).collect()
    };
    let unmodelled = case.evidence.unmodelled_commands.iter().filter_map(|of| {
        let joint = |joint: usize| Some((of.value.joints.get(joint)?.as_str(), Unit::Radian));
        let mapped = mapped_joints(&of.value.delays, &joint, of.value.is_in_degrees_by_magnitude);
        let outcome = map_fault(&of.subject, &mapped, &[], "")?;
        let judged = SubjectResult::new(of.subject.clone(), outcome).within(of.span);
        Some(judged.with_evidence("maps", maps_json(&mapped)))
    });
    case.evidence.robots.iter().flat_map(of_arm).chain(unmodelled).collect()
}

fn mapped_joints<'a>(
    delays: &'a [CommandDelay],
    joint: &dyn Fn(usize) -> Option<(&'a str, Unit)>,
    is_unit_undetermined: bool,
) -> Vec<MappedJoint<'a>> {
    let mapped = |delay| MappedJoint::new(delay, joint, is_unit_undetermined);
    delays.iter().filter_map(mapped).collect()
}

/// Whether the poses show the same fault in the joint states, which ORD009 or ZER001 reports.
fn is_fault_of_state(arm: &ArmEvidence, mapped: &MappedJoint<'_>) -> bool {
    let is_scaled = arm.diagnosis.scales.iter().any(|scale| scale.column == mapped.joint);
    let zero = arm.diagnosis.offsets.get(mapped.joint).filter(|zero| zero.is_chosen);
    let zero = zero.and_then(|zero| zero.offset.as_ref().ok());
    is_scaled || zero.is_some_and(|zero| mapped.is_zero(zero))
}

/// `None` without mapped joints.
fn map_fault(
    subject: &Subject,
    mapped: &[MappedJoint<'_>],
    rests: &[RestError],
    consequence: &str,
) -> Option<Outcome> {
    if mapped.is_empty() {
        return None;
    }
    // The pose is right, but a controller that follows such a command turns the joint.
    let severity = match mapped.iter().all(MappedJoint::is_whole_turns) {
        true => Severity::Warning,
        false => Severity::Error,
    };
    Some(Outcome::fail(Fault {
        cause: Cause::Pictured(Picture::RestError),
        severity,
        title: "joint moves otherwise than commanded",
        message: format!("{}{consequence}", joint_maps::describe(mapped, rests)),
        evidence: Evidence::default(),
        fix: joint_maps::fix(mapped, subject.topic.as_deref().unwrap_or_default()),
    }))
}

fn maps_json(mapped: &[MappedJoint<'_>]) -> Vec<Value> {
    mapped.iter().map(MappedJoint::json).collect()
}

/// Rests according to one source of poses.
struct RestErrors<'a> {
    /// Source.
    source: usize,
    /// Judged rest.
    rest: &'a RestError,
    estimate: FrameEstimate,
    decision: Decision,
    /// Rests above the thresholds.
    exceeding: usize,
}

impl<'a> RestErrors<'a> {
    fn from_source(case: &Case, diagnosis: &'a CommandDiagnosis, source: usize) -> Option<Self> {
        let thresholds = case.thresholds.frame_thresholds(&FRM006, THRESHOLDS);
        let relative = |rest: &RestError| relative_error(rest, &thresholds);
        let mut rests_of_source: Vec<&RestError> =
            diagnosis.rest_errors.get(source)?.iter().collect();
        rests_of_source.sort_by(|a, b| relative(a).total_cmp(&relative(b)));
        let is_tracked = diagnosis.tracking.is_some();
        // The median, because the arm may have been stopped close to a single goal.
        let at = if is_tracked {
            rests_of_source.len().checked_sub(1)?
        } else {
            rests_of_source.len().checked_sub(1)? / 2
        };
        let rest = *rests_of_source.get(at)?;
        let exceeding = rests_of_source.iter().filter(|rest| relative(rest) >= 1.0).count();
        // Bonferroni correction for the worst of several rests.
        let tests = if is_tracked { 2 * rests_of_source.len() } else { 2 };
        let p_value = rest.distance_m.p_value.min(rest.angle_rad.p_value);
        let estimate = FrameEstimate {
            pose: rest.tip_from_commanded(),
            translation_m: rest.distance_m.norm,
            rotation_rad: rest.angle_rad.norm,
            p_value: (p_value * tests as f64).min(1.0),
            is_chosen: true,
        };
        let decision = decide_frame(&estimate, &thresholds, case.evidence.subjects());
        Some(Self { source, rest, estimate, decision, exceeding })
    }
}

/// Error in units of the warning thresholds.
fn relative_error(rest: &RestError, thresholds: &FrameThresholds) -> f64 {
    let length = rest.distance_m.norm.value / thresholds.length.warning;
    length.max(rest.angle_rad.norm.value / thresholds.angle.warning)
}

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    reference: &StreamEvidence<ReferenceEvidence>,
) -> SubjectResult {
    let thresholds = case.thresholds.frame_thresholds(&FRM006, THRESHOLDS);
    let size = |rest: &RestError| relative_error(rest, &thresholds);
    let diagnosis = sources::reference_diagnosis(arm, reference, SETTLE);
    let joint = |joint: usize| Some((arm.joints.get(joint)?.name.as_str(), arm.joint_unit(joint)));
    let mapped = match mot003_limits_exceeded::doubt(arm) {
        Some(_) => Vec::new(),
        None => mapped_joints(&reference.delays, &joint, arm.is_unit_undetermined())
            .into_iter()
            .filter(|mapped| !is_fault_of_state(arm, mapped))
            .collect(),
    };
    let unless_mapped = |outcome: Outcome, rests: &[RestError]| match map_fault(
        &reference.subject, &mapped, rests, "",
    ) {
        Some(fault) => reference.judged(fault).with_evidence("maps", maps_json(&mapped)),
        None => reference.judged(outcome),
    };
    let found = match diagnosis {
        Ok(found) => found,
        Err(outcome) => return unless_mapped(outcome, &[]),
    };
    let with_commands = |judged: SubjectResult| {
        judged
            .with_evidence("goals", found.goals)
            .with_evidence("not_reached", found.not_reached)
            .with_evidence("following", following_json(found.tracking.as_ref()))
    };
    let all: Vec<RestErrors<'_>> = (0..reference.tip_poses.len())
        .filter_map(|source| RestErrors::from_source(case, found, source))
        .collect();
    let Some(nearest) = all.iter().min_by(|a, b| size(a.rest).total_cmp(&size(b.rest))) else {
        return with_commands(unless_mapped(Outcome::Inconclusive(not_reached(found)), &[]));
    };
    let rests_of_source = &found.rest_errors[nearest.source];
    if arm.is_unit_undetermined() {
        let undetermined =
            format!("{}{UNIT_UNDETERMINED}", joint_error_as_logged(arm, nearest.rest));
        let undetermined = Outcome::Inconclusive(undetermined);
        return with_commands(unless_mapped(undetermined, rests_of_source));
    }
    let name = source_name(reference, nearest.source);
    let consequence = match &nearest.decision {
        Decision::Fail(_) => format!(": {}", at_rest(case, nearest, rests_of_source.len())),
        _ => String::new(),
    };
    let by_maps = map_fault(&reference.subject, &mapped, rests_of_source, &consequence);
    let outcome = by_maps.unwrap_or_else(|| match &nearest.decision {
        Decision::Fail(severity) => fault(case, arm, reference, found, nearest, *severity),
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
        Decision::Pass => sound(arm, reference, nearest, &all, &name),
    });
    let others: Vec<Value> = all
        .iter()
        .filter(|one| one.source != nearest.source)
        .map(|one| {
            json!({
                "measured_by": source_name(reference, one.source),
                "m": one.estimate.translation_m.value,
                "rad": one.estimate.rotation_rad.value,
            })
        })
        .collect();
    let time = case.evidence.origin.shifted(nearest.rest.from_s).to_string();
    let estimate = Estimate::frame(
        "difference",
        &nearest.estimate.translation_m,
        &nearest.estimate.rotation_rad,
    );
    let judged = with_commands(reference.judged(outcome))
        .estimated(estimate)
        .with_evidence("measured_by", name)
        .with_evidence("others", others)
        .with_evidence("rests", rests_of_source.len())
        .with_evidence("beyond", nearest.exceeding)
        .with_evidence("at_ns", time)
        .with_evidence("pose", pose_json(&nearest.estimate.pose));
    let judged = match mapped.as_slice() {
        [] => judged,
        mapped => judged.with_evidence("maps", maps_json(mapped)),
    };
    match nearest.rest.joints.as_slice() {
        [] => judged,
        joints => judged.with_evidence("joints", joints_json(arm, joints)),
    }
}

/// Error at the judged rest, its time, and how many rests have one.
fn at_rest(case: &Case, nearest: &RestErrors<'_>, rests: usize) -> String {
    let (error_shown, exceeding) = (show(&nearest.estimate), nearest.exceeding);
    let time = case.evidence.moment_at(nearest.rest.from_s);
    let of = if rests == 1 { String::new() } else { format!(", at {exceeding} of {rests} rests") };
    format!("steady-state error {error_shown}, at {time}{of}")
}

fn sound(
    arm: &ArmEvidence,
    reference: &StreamEvidence<ReferenceEvidence>,
    nearest: &RestErrors<'_>,
    all: &[RestErrors<'_>],
    name: &str,
) -> Outcome {
    let kind_of = |one: &RestErrors<'_>| reference.tip_poses[one.source].kind;
    let is_disputed = |one: &&RestErrors<'_>| {
        kind_of(one) == TipPoseKind::Corrected && matches!(one.decision, Decision::Fail(_))
    };
    let disputed = all.iter().find(is_disputed);
    if let (TipPoseKind::Kinematics, Some(other), false) =
        (kind_of(nearest), disputed, is_fk_different(arm))
    {
        let (topic, error_shown) = (&reference.tip_poses[other.source].name, show(&other.estimate));
        return Outcome::Inconclusive(format!(
            "it agrees with {name} but differs from {topic} by {error_shown}; record a motion that makes FRM002 and \
             FRM003 observable to show which of the two is right"
        ));
    }
    let [length, angle] = [
        Unit::Metre.show(nearest.estimate.translation_m.value),
        Unit::Radian.show(nearest.estimate.rotation_rad.value),
    ];
    Outcome::pass_with_remark(format!("{name} differs from it by {length} and {angle} at rest"))
}

/// Reason why no rest can be compared.
fn not_reached(diagnosis: &CommandDiagnosis) -> String {
    let why = match (diagnosis.goals, diagnosis.nearest_miss) {
        (0, _) => "the command is never constant".to_owned(),
        (goals, Some((m, rad))) => {
            let (m, rad) = (Unit::Metre.show(m), Unit::Radian.show(rad));
            format!(
                "the arm reached none of {goals} goals: it missed the nearest by {m} and {rad}, which may be \
                 a frame offset, a tool offset or an abandoned goal"
            )
        }
        (goals, None) => format!("the arm comes to rest after none of {goals} goals"),
    };
    format!("{why}; {SETTLE}")
}

fn fault(
    case: &Case,
    arm: &ArmEvidence,
    reference: &StreamEvidence<ReferenceEvidence>,
    diagnosis: &CommandDiagnosis,
    nearest: &RestErrors<'_>,
    severity: Severity,
) -> Outcome {
    let rests_of_source = &diagnosis.rest_errors[nearest.source];
    let error_shown = show(&nearest.estimate);
    let thresholds = &case.thresholds.frame_thresholds(&FRM006, THRESHOLDS);
    let may_be_a_frame = !reference.is_of_joints;
    let (in_tool, in_base) = match RestErrorSpread::from_rests(rests_of_source) {
        Some(constancy) => (
            is_constant(nearest.rest, constancy.in_tool, thresholds),
            is_constant(nearest.rest, constancy.in_base, thresholds),
        ),
        None => (true, true),
    };
    let is_beyond = |m: f64| may_be_a_frame && nearest.estimate.translation_m.value > m;
    let open = match (in_tool, in_base) {
        (true, true)
            if is_beyond(MIN_FRAME_OFFSET_M)
                && !(reference.is_tip_declared && reference.is_frame_declared) =>
        {
            "may be a different TCP or base frame; rest at two goals with different tool orientations"
        }
        (_, true) if is_beyond(MIN_FRAME_OFFSET_M) && !reference.is_frame_declared => {
            "is constant in the base frame, and the command names no frame; name it"
        }
        (false, false) if is_beyond(MAX_STEADY_STATE_ERROR_M) => {
            "is neither a frame nor a tool offset: the command is scaled, or belongs to a different arm"
        }
        _ => "",
    };
    if !open.is_empty() {
        return Outcome::Inconclusive(format!("off by {error_shown}, which {open}"));
    }
    let has_only_fk = reference.tip_poses.len() == 1;
    let is_within_nominal_residual = may_be_a_frame
        && has_only_fk
        && nearest.estimate.translation_m.value <= MAX_NOMINAL_RESIDUAL.0
        && nearest.estimate.rotation_rad.value <= MAX_NOMINAL_RESIDUAL.1;
    let is_a_tool = may_be_a_frame && in_tool && !in_base && !reference.is_tip_declared;
    let mut indistinguishable = Vec::new();
    let estimate = |name| {
        let FrameEstimate { translation_m, rotation_rad, .. } = &nearest.estimate;
        Some(Estimate::frame(name, translation_m, rotation_rad))
    };
    let mut add = |code, name| {
        let subject = reference.subject.clone();
        indistinguishable.push(Alternative { code, subject, estimate: estimate(name) });
    };
    if may_be_a_frame && in_tool {
        add("FRM003", "tool frame");
    }
    if may_be_a_frame && in_base {
        add("FRM002", "reference frame");
    }
    if is_within_nominal_residual {
        add("MDL001", "residual");
    }
    let (severity, likely_cause) = match severity {
        _ if is_a_tool => (Severity::Info, ", constant in the tool frame: probably another TCP"),
        Severity::Error if is_within_nominal_residual => (Severity::Warning, ""),
        severity => (severity, ""),
    };
    let by_joint = worst_joint(arm, nearest.rest, rests_of_source)
        .map_or(String::new(), |description| format!(": {description}"));
    let at_rest = at_rest(case, nearest, rests_of_source.len());
    Outcome::fail(Fault {
        cause: Cause::Pictured(Picture::RestError),
        severity,
        title: "command and pose at rest differ",
        message: format!("{at_rest}{by_joint}{likely_cause}"),
        evidence: Evidence {
            indistinguishable,
            effect_m: Some(nearest.estimate.translation_m.value),
            ..Evidence::default()
        },
        fix: match is_a_tool {
            true => "command the active tool, or name the commanded link".to_owned(),
            false => {
                "express goal and pose through the same chain of frames; then check why the controller keeps \
                 an error"
                .to_owned()
            }
        },
    })
}

/// Whether the error is similar at all rests, relative to its size.
fn is_constant(
    rest: &RestError,
    (spread_m, spread_rad): (f64, f64),
    thresholds: &FrameThresholds,
) -> bool {
    /// In warning thresholds.
    const MIN_SPREAD_THRESHOLDS: f64 = 0.3;
    let allowed = |size: f64, threshold: f64| {
        (MAX_RELATIVE_SPREAD * size).max(MIN_SPREAD_THRESHOLDS * threshold)
    };
    spread_m <= allowed(rest.distance_m.norm.value, thresholds.length.warning)
        && spread_rad <= allowed(rest.angle_rad.norm.value, thresholds.angle.warning)
}

/// Commanded joint with the largest error, and its errors at all `rests`.
fn worst_joint(arm: &ArmEvidence, rest: &RestError, rests: &[RestError]) -> Option<String> {
    let (joint, error) = largest_joint_error(rest)?;
    let name = &arm.joints.get(*joint)?.name;
    let unit = arm.joint_unit(*joint);
    let own = rests.iter().flat_map(|rest| &rest.joints).filter(|(other, _)| other == joint);
    let [low, high] = range_of(own.map(|(_, error)| error.value));
    let is_constant = high - low <= MAX_RELATIVE_SPREAD * error.value.abs();
    Some(match is_constant {
        true => {
            let error = error.with_error(0.5 * (high - low));
            format!("{name} stays off by {}", unit.show_signed(&error))
        }
        false => {
            format!(
                "{name} stays off by {} to {} at different rests",
                unit.show(low),
                unit.show(high)
            )
        }
    })
}

fn largest_joint_error(rest: &RestError) -> Option<&(usize, Measured)> {
    rest.joints.iter().max_by(|a, b| a.1.value.abs().total_cmp(&b.1.value.abs()))
}

/// Largest joint error in logged units, which were read as degrees.
fn joint_error_as_logged(arm: &ArmEvidence, rest: &RestError) -> String {
    let joint = largest_joint_error(rest)
        .and_then(|(joint, error)| Some((arm.joints.get(*joint)?, error.value.to_degrees())));
    joint.map_or(String::new(), |(joint, error)| {
        format!("{} stays off its command by {error:.2} in logged units at rest; ", joint.name)
    })
}

fn joints_json(arm: &ArmEvidence, joints: &[(usize, Measured)]) -> Value {
    let joint = |(index, error): &(usize, Measured)| {
        let unit = arm.joint_unit(*index);
        let name = arm.joints.get(*index).map(|joint| joint.name.as_str());
        json!({
            "joint": name,
            "off": error.value,
            "unit": unit.symbol(),
            "ci95": unit.interval95(error),
        })
    };
    joints.iter().map(joint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{COMMANDS, clean_run, evaluate_rule, precise, rest_error_of};
    use crate::diagnosis::JointMap;
    use crate::evidence::RunEvidence;
    use crate::finding::Status;

    fn planted(change: impl Fn(&mut ReferenceEvidence, &mut CommandDiagnosis)) -> RunEvidence {
        let mut run = clean_run();
        let reference = &mut run.robots[0].references[0];
        let Ok(Ok(mut diagnosis)) = reference.diagnosis.clone() else {
            panic!("a clean reference")
        };
        change(reference, &mut diagnosis);
        reference.diagnosis = Ok(Ok(diagnosis));
        run
    }

    #[test]
    fn an_error_at_one_rest_is_a_finding_that_lists_frames() {
        let run = planted(|_, found| found.rest_errors = vec![vec![rest_error_of(0.003, 0.0)]; 2]);
        let (_, findings) = evaluate_rule(&FRM006, &run);
        assert_eq!(findings[0].severity, Severity::Warning);
        assert_eq!(findings[0].subject.topic.as_deref(), Some(COMMANDS));
        let others = findings[0].evidence.indistinguishable.iter().map(|other| other.code);
        assert_eq!(others.collect::<Vec<_>>(), ["FRM003", "FRM002"]);
    }

    #[test]
    fn one_abandoned_goal_among_several_is_no_fault() {
        let rests_of_source = [0.0, 0.008, 0.0].map(|m| rest_error_of(m, 0.0)).to_vec();
        let run = planted(|_, found| {
            found.rest_errors = vec![rests_of_source.clone(), rests_of_source.clone()]
        });
        assert_eq!(evaluate_rule(&FRM006, &run).0[0].status, Status::Pass);
    }

    #[test]
    fn an_offset_constant_in_the_tool_is_probably_another_tcp() {
        let rests_of_source: Vec<RestError> =
            [0.0, 1.0, 2.0].map(|turn| rest_error_of(0.14, turn)).to_vec();
        let run = planted(|reference, found| {
            reference.is_tip_declared = false;
            found.rest_errors = vec![rests_of_source.clone(), rests_of_source.clone()];
        });
        let (_, findings) = evaluate_rule(&FRM006, &run);
        assert_eq!(findings[0].severity, Severity::Info);
        assert!(findings[0].message.ends_with("probably another TCP"), "{}", findings[0].message);
    }

    #[test]
    fn a_large_offset_at_one_rest_is_inconclusive() {
        let run = planted(|reference, found| {
            reference.is_tip_declared = false;
            found.rest_errors = vec![vec![rest_error_of(0.14, 0.0)]; 2];
        });
        let (rows, findings) = evaluate_rule(&FRM006, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
    }

    #[test]
    fn a_base_offset_is_a_fault_if_the_frame_is_named() {
        for (frame_named, status) in [(true, Status::Fail), (false, Status::Inconclusive)] {
            let rests_of_source = [0.0, 1.0, 2.0].map(|turn| {
                let rest = rest_error_of(0.3, turn);
                let commanded = crate::geometry::Pose::translation(0.3, 0.0, 0.0) * rest.measured;
                RestError { commanded, ..rest }
            });
            let run = planted(|reference, found| {
                reference.is_frame_declared = frame_named;
                found.rest_errors = vec![rests_of_source.to_vec(), rests_of_source.to_vec()];
            });
            let row = &evaluate_rule(&FRM006, &run).0[0];
            assert_eq!(row.status, status, "{row:?}");
        }
    }

    /// The first joint's state over its command, and its errors at rests.
    fn mapped(gain: f64, offset: f64, errors: &[f64]) -> RunEvidence {
        let mut run = planted(|reference, found| {
            reference.is_of_joints = true;
            let rest = |error: &f64| RestError {
                joints: vec![(0, precise(*error))],
                ..rest_error_of(0.05, 0.0)
            };
            found.rest_errors = vec![errors.iter().map(rest).collect(); 2];
        });
        let delay = &mut run.robots[0].references[0].delays[0];
        delay.joint = Some(0);
        delay.map = Some(JointMap { gain: precise(gain), offset: precise(offset) });
        run
    }

    #[test]
    fn a_reversed_scaled_or_displaced_joint_is_reported_as_such() {
        let quarter = std::f64::consts::FRAC_PI_2;
        for (gain, offset, errors, severity, message, fix) in [
            (
                -1.0,
                0.0,
                [0.5, -0.3],
                Severity::Error,
                " moves the other way: ",
                "reverse its direction",
            ),
            (2.02, 0.0, [0.5, 0.1], Severity::Error, " moves 2.02", "gear ratio"),
            (
                1.0,
                -quarter,
                [-quarter; 2],
                Severity::Error,
                "° (a quarter turn) at every rest: steady-state error 50.0",
                "set its zero again",
            ),
            (1.0, -4.0 * quarter, [0.0; 2], Severity::Warning, "(a whole turn): ", "re-home it"),
        ] {
            let (rows, findings) = evaluate_rule(&FRM006, &mapped(gain, offset, &errors));
            let found = &findings[0];
            assert_eq!(found.severity, severity, "{rows:?}");
            assert!(found.message.contains(message), "{}", found.message);
            assert!(found.fix.contains(fix) && found.fix.contains(COMMANDS), "{}", found.fix);
        }
    }

    #[test]
    fn a_map_is_reported_without_a_rest_and_in_an_unknown_unit() {
        let mut run = mapped(1.0, -std::f64::consts::FRAC_PI_2, &[]);
        run.robots[0].is_in_degrees_by_magnitude = true;
        run.robots[0].diagnosis.encoding = Err(crate::diagnosis::NotObservable::AtRest);
        let (rows, findings) = evaluate_rule(&FRM006, &run);
        assert_eq!(findings.len(), 1, "{rows:?}");
        let message = &findings[0].message;
        let shown = "is off by -90.00 in logged units (a quarter turn, if they are degrees)";
        assert!(message.ends_with(shown), "{message}");
    }

    #[test]
    fn a_compliant_joint_has_no_map() {
        let run = mapped(0.9, 0.05, &[-0.05, -0.05]);
        let (_, findings) = evaluate_rule(&FRM006, &run);
        let message = &findings[0].message;
        assert!(message.contains("stays off by -2.86"), "{message}");
    }

    #[test]
    fn an_offset_that_differs_between_rests_is_a_range() {
        let (_, findings) = evaluate_rule(&FRM006, &mapped(1.0, 0.0, &[-0.2, -1.4]));
        let message = &findings[0].message;
        assert!(message.ends_with("stays off by -80.2° to -11.5° at different rests"), "{message}");
    }

    #[test]
    fn missing_rests_are_reported() {
        let run = planted(|_, found| {
            found.rest_errors = vec![Vec::new(); 2];
            (found.goals, found.nearest_miss) = (2, Some((0.3, 0.1)));
        });
        let row = &evaluate_rule(&FRM006, &run).0[0];
        assert!(
            row.reason.as_deref().is_some_and(|why| why.contains("none of 2 goals")),
            "{row:?}"
        );
    }
}
