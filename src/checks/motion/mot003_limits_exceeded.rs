use std::f64::consts::TAU;

use serde_json::{Value, json};

use crate::checks::joints::zer001_joint_zero;
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{LimitViolation, NotObservable};
use crate::evidence::{ArmEvidence, JointEvidence, WrappedRange};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::run::NotAuditedReason;

rule! {
    /// A joint exceeds its position or speed limits.
    ///
    /// ## What it means
    /// A joint exceeded a limit of the model (`<limit lower upper velocity>` in the URDF, or the
    /// catalogue's). All joint states of the run are checked. The finding is `info` if the excess is within
    /// 1 % of the range or of the speed limit, and up to twice the speed limit for a continuous joint.
    ///
    /// ## Why it matters
    /// An arm cannot exceed its limits. Either the model's limits and the plans made with them are wrong,
    /// or the positions: a different unit, another joint, or a whole-turn error.
    ///
    /// ## Evidence
    /// `position` and `speed`, if exceeded: `limit`, the farthest `value` beyond it, `at_ns`, and the total
    /// `seconds` beyond it. The estimate is the excess; if both limits are exceeded, the more severe one.
    ///
    /// ## How to fix
    /// Copy the limits of the arm's own configuration into the model. If a joint counts turns, declare it
    /// continuous, or unwind it before the driver publishes it. If three or more joints leap in one sample, another node
    /// or a restarted driver published the values from then on.
    ///
    /// ## When it misleads
    /// - A continuous joint has no position limits. A joint logged within one turn that wraps around is
    ///   treated as continuous, unless the turn is beyond its limits, such as 0 to 360° of a joint from -180° to 180°
    ///   (`info` in a table, whose numbers declare no convention).
    ///   Speed limits of such joints often depend on the control mode.
    /// - Speeds are the logged ones if they agree with the positions, otherwise the slope of the positions.
    ///   A single sample beyond a speed limit is ignored as an outlier.
    /// - If the motion does not distinguish the arm from others with the same joint names, which may have other
    ///   limits, an excess is no finding: name the arm with `--robot`.
    /// - Some models deliberately use narrower limits than the arm's.
    /// - Positions are checked as logged, in the detected unit, without the zero offsets of ZER001.
    MOT003 {
        name: "limits-exceeded",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "no joint states",
        check: check,
    }
}

/// Share of the range or limit; a smaller excess is `info`.
const MAX_SLIGHT_EXCESS: f64 = 0.01;
/// The same for the speed of a continuous joint.
const MAX_ENDLESS_SPEED_EXCESS: f64 = 1.0;
/// Encoder noise at a stop, rad or m, or rad/s or m/s.
const MIN_EXCESS: f64 = 1e-4;

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        arm.joints.iter().enumerate().map(|(index, joint)| judge(case, arm, index, joint)).collect()
    };
    case.evidence.robots.iter().flat_map(of_arm).collect()
}

/// Reason why joint states cannot be compared with limits or used as motion.
pub(in crate::checks) fn doubt(arm: &ArmEvidence) -> Option<String> {
    let why = match &arm.diagnosis.encoding {
        Ok(reading) if reading.is_in_degrees || reading.permutation.is_some() => {
            "joint names or units are wrong; correct them first (ORD004, ORD005)"
        }
        Err(NotObservable::NotExcited) => {
            "poses and joint states disagree for every joint order and unit (MDL001), so order and unit are \
             undetermined"
        }
        _ => return None,
    };
    Some(why.to_owned())
}

/// The same for one joint.
pub(in crate::checks) fn doubt_of_joint(
    case: &Case,
    arm: &ArmEvidence,
    joint: usize,
) -> Option<String> {
    let mut couplings = arm.diagnosis.encoding.iter().flat_map(|reading| &reading.couplings);
    let why = if couplings.any(|coupling| coupling.column == joint) {
        "its positions contain another joint's (ORD009)"
    } else if !arm.diagnosis.factor_changes(joint).is_empty() {
        "its positions jump without motion where its scale changes (ORD009)"
    } else if zer001_joint_zero::changes_much(case, arm, joint) {
        "its positions jump without motion where its zero changes (ZER001)"
    } else {
        return motion_doubt(arm);
    };
    Some(motion_doubt(arm).unwrap_or_else(|| why.to_owned()))
}

/// Reason why joint states are not motion in a known unit.
pub(in crate::checks) fn motion_doubt(arm: &ArmEvidence) -> Option<String> {
    // Between two poses, either may be the inverted one.
    if arm.is_trajectory && arm.poses.iter().any(|stream| stream.diagnosis.is_inverted) {
        return Some("its poses or those of another stream are inverted (ORD003)".to_owned());
    }
    let open = || arm.is_unit_undetermined().then(|| UNIT_UNDETERMINED.to_owned());
    doubt(arm).or_else(open)
}

/// The unit is inferred only from the size of the positions.
pub(in crate::checks) const UNIT_UNDETERMINED: &str = "the joint positions are too large for rad, and without \
    poses they may be degrees, ticks or fractions of the range; log the tool pose too";

struct ExceededLimit<'a> {
    what: &'static str,
    excess: &'a LimitViolation,
    severity: Severity,
}

impl<'a> ExceededLimit<'a> {
    /// `None` if the excess is within noise. `range` scales the `info` fraction.
    fn detect(what: &'static str, excess: Option<&'a LimitViolation>, range: f64) -> Option<Self> {
        let excess = excess.filter(|excess| excess.excess() > MIN_EXCESS)?;
        let is_slight = excess.excess() <= MAX_SLIGHT_EXCESS * range;
        let severity = if is_slight { Severity::Info } else { Severity::Warning };
        Some(Self { what, excess, severity })
    }
}

fn judge(case: &Case, arm: &ArmEvidence, index: usize, joint: &JointEvidence) -> SubjectResult {
    let subject = arm.joint(index);
    let judged = |outcome| SubjectResult::new(subject.clone(), outcome).within(arm.span);
    let limits = &joint.limits;
    if limits.lower.or(limits.upper).or(limits.velocity).is_none() {
        return judged(Outcome::Skipped("the model has no limits for this joint".to_owned()));
    }
    if let Some(why) = doubt_of_joint(case, arm, index) {
        return judged(Outcome::Inconclusive(why));
    }
    let motion = &joint.motion;
    if motion.turns_beyond.is_some() {
        return judged(Outcome::Inconclusive(
            "its positions are off by whole turns (ORD009)".to_owned(),
        ));
    }
    let range = limits.lower.zip(limits.upper).map_or(0.0, |(lower, upper)| upper - lower);
    let position = ExceededLimit::detect("position", motion.positions.as_ref(), range);
    if position.is_some() && zero_is_off(arm, index) {
        let why =
            "its positions exceed the limits, but its zero is off (ZER001, ORD009)".to_owned();
        return judged(Outcome::Inconclusive(why));
    }
    if position.is_some() && is_never_set(case, arm) {
        return judged(Outcome::Inconclusive("all joint positions are 0 (FRM007)".to_owned()));
    }
    let top_speed = limits.velocity.unwrap_or(0.0);
    let slight_from =
        if motion.is_endless { MAX_ENDLESS_SPEED_EXCESS / MAX_SLIGHT_EXCESS } else { 1.0 };
    let speed = ExceededLimit::detect("speed", motion.speeds.as_ref(), slight_from * top_speed);
    if let Some((fault, excess)) = wrapped_beyond(joint)
        && !zero_is_off(arm, index)
        && arm.indistinguishable_models.is_empty()
        && speed.as_ref().is_none_or(|speed| speed.severity <= fault.severity)
    {
        let estimate = Estimate::exact("beyond position limit", Unit::Radian.symbol(), excess);
        return judged(Outcome::fail(fault)).estimated(estimate);
    }
    let exceeded: Vec<&ExceededLimit<'_>> = [&position, &speed].into_iter().flatten().collect();
    let Some(worst) = exceeded.iter().rev().max_by_key(|exceeded| exceeded.severity) else {
        return judged(Outcome::pass());
    };
    let unit = arm.joint_unit(index);
    let told: Vec<String> =
        exceeded.iter().map(|exceeded| describe(case, exceeded, unit)).collect();
    if !arm.indistinguishable_models.is_empty() {
        return judged(Outcome::Inconclusive(format!(
            "{}; but this motion does not distinguish {} from {}: name your arm with --robot",
            told.join("; "),
            arm.name,
            arm.indistinguishable_models.join(", ")
        )));
    }
    let (title, fix) = match motion.leap.as_ref().filter(|_| worst.what == "speed") {
        Some(leap) => (
            "joint states leap",
            format!(
                "check what published {} from {} on, where {} joints leap in one sample: defaults of another node, or a \
                 driver that was restarted",
                arm.joints_topic,
                case.evidence.moment(leap.at),
                leap.joints
            ),
        ),
        None => (
            "joint limit exceeded",
            "compare the model's limits with the arm's own configuration".to_owned(),
        ),
    };
    let fault = Fault {
        cause: Cause::Pictured(Picture::Joint),
        severity: worst.severity,
        title,
        message: told.join("; "),
        evidence: Evidence::default(),
        fix,
    };
    let (name, symbol) = match (worst.what, unit) {
        ("position", unit) => ("beyond position limit", unit.symbol()),
        (_, Unit::Metre) => ("beyond speed limit", "m/s"),
        _ => ("beyond speed limit", "rad/s"),
    };
    let mut judged = judged(Outcome::fail(fault)).estimated(Estimate::exact(
        name,
        symbol,
        worst.excess.excess(),
    ));
    for exceeded in exceeded {
        judged = judged.with_evidence(exceeded.what, evidence(case, exceeded.excess));
    }
    judged
}

/// Finding on a joint that is logged modulo one turn, and its excess, if that turn is beyond the limits.
fn wrapped_beyond(joint: &JointEvidence) -> Option<(Fault, f64)> {
    let WrappedRange { ends_rad: [low, high], is_of_table } = joint.motion.wrapped?;
    let (lower, upper) = joint.limits.lower.zip(joint.limits.upper)?;
    let excess = (lower - low).max(high - upper);
    let [low, high, lower, upper] = [low, high, lower, upper].map(|end| Unit::Radian.show(end));
    let name = &joint.name;
    let fault = Fault {
        cause: Cause::Pictured(Picture::Joint),
        severity: if is_of_table { Severity::Info } else { Severity::Warning },
        title: "joint wraps beyond its limits",
        message: format!(
            "positions are logged modulo one turn, from {low} to {high}, beyond the limits of {lower} and {upper}, \
             and jump by a turn"
        ),
        evidence: Evidence::default(),
        fix: format!(
            "publish the positions of {name} between its limits, without jumps; unwrap them in consumers of this log"
        ),
    };
    (excess > MAX_SLIGHT_EXCESS * TAU).then_some((fault, excess))
}

fn is_never_set(case: &Case, arm: &ArmEvidence) -> bool {
    let mut streams = case.evidence.not_audited.iter();
    streams.any(|stream| {
        stream.topic() == arm.joints_topic
            && stream.iter().any(|why| matches!(why, NotAuditedReason::NeverSet { .. }))
    })
}

/// Whether the zero offset is too large to compare positions with limits.
fn zero_is_off(arm: &ArmEvidence, joint: usize) -> bool {
    /// Smaller offsets barely change the excess, rad.
    const MIN_FAR_ZERO_RAD: f64 = 0.1;
    let named = arm.diagnosis.offsets.get(joint).filter(|offset| offset.is_chosen);
    let offset = named.and_then(|offset| offset.offset.as_ref().ok());
    offset.is_some_and(|offset| offset.value.abs() > MIN_FAR_ZERO_RAD)
}

fn describe(case: &Case, exceeded: &ExceededLimit<'_>, unit: Unit) -> String {
    let LimitViolation { limit, value, at_s, seconds } = *exceeded.excess;
    let per = if exceeded.what == "speed" { "/s" } else { "" };
    let shown = |amount: f64| match unit {
        // Not in mm, as in the model.
        Unit::Metre => format!("{amount:.3} m{per}"),
        unit => format!("{}{per}", unit.show(amount)),
    };
    format!(
        "{} reaches {}, {} beyond the limit of {}, at {}, for {} in total",
        exceeded.what,
        shown(value),
        shown(exceeded.excess.excess()),
        shown(limit),
        case.evidence.moment_at(at_s),
        Unit::Second.show(seconds),
    )
}

fn evidence(case: &Case, excess: &LimitViolation) -> Value {
    json!({
        "limit": excess.limit,
        "value": excess.value,
        "at_ns": case.evidence.origin.shifted(excess.at_s).to_string(),
        "seconds": excess.seconds,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::diagnosis::{Course, JointChange, JointParameter, ScalarChange};
    use crate::run::JointLeap;

    #[test]
    fn limits_are_not_judged_for_a_joint_with_a_large_zero_offset() {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.joints[1].motion.positions =
            Some(LimitViolation { limit: 3.0, value: 3.5, at_s: 1.0, seconds: 0.25 });
        let lift = &mut arm.diagnosis.offsets[1];
        (lift.offset, lift.is_chosen) = (Ok(crate::checks::testing::precise(-1.2)), true);
        assert!(evaluate_rule(&MOT003, &run).1.is_empty());
    }

    #[test]
    fn a_zero_that_changes_less_than_its_threshold_does_not_prevent_the_comparison_with_limits() {
        let joint_changes = |size_rad: f64| {
            let change = ScalarChange {
                at_s: 5.0,
                within_s: 0.1,
                course: Course::Step,
                from: 0.0,
                to: size_rad,
                size: crate::checks::testing::precise(size_rad),
            };
            vec![JointChange { column: 1, parameter: JointParameter::Zero, change }]
        };
        for (size_rad, judged) in [(5e-4, 1), (5e-2, 0)] {
            let mut run = clean_run();
            let arm = &mut run.robots[0];
            arm.diagnosis.changes = joint_changes(size_rad);
            arm.joints[1].motion.positions =
                Some(LimitViolation { limit: 3.0, value: 3.5, at_s: 1.0, seconds: 0.25 });
            let (_, findings) = evaluate_rule(&MOT003, &run);
            assert_eq!(findings.len(), judged, "{findings:?}");
        }
    }

    #[test]
    fn the_limits_of_an_arm_that_the_motion_does_not_distinguish_are_not_judged() {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        arm.indistinguishable_models = vec!["ur16e".to_owned()];
        arm.joints[1].motion.positions =
            Some(LimitViolation { limit: 3.0, value: 3.5, at_s: 1.0, seconds: 0.25 });
        let (rows, findings) = evaluate_rule(&MOT003, &run);
        assert!(findings.is_empty(), "{findings:?}");
        let why = rows.iter().find_map(|row| row.reason.as_deref()).unwrap();
        assert!(why.contains("does not distinguish") && why.contains("ur16e"), "{why}");
    }

    #[test]
    fn joints_that_leap_together_are_of_another_source() {
        let mut run = clean_run();
        let at = run.origin.shifted(1.0);
        let motion = &mut run.robots[0].joints[1].motion;
        motion.speeds = Some(LimitViolation { limit: 2.0, value: 9.0, at_s: 1.0, seconds: 0.02 });
        motion.leap = Some(JointLeap { stream: 0, at, joints: 3 });
        let (_, findings) = evaluate_rule(&MOT003, &run);
        assert_eq!(findings[0].title, "joint states leap");
        assert!(findings[0].fix.contains("3 joints leap in one sample"), "{findings:?}");
    }

    #[test]
    fn a_joint_that_wraps_beyond_its_limits_is_reported() {
        for (range, is_beyond) in [([0.0, 6.2], true), ([-3.1, 3.1], false)] {
            let mut run = clean_run();
            let joint = &mut run.robots[0].joints[1];
            (joint.limits.lower, joint.limits.upper) = (Some(-3.1), Some(3.1));
            joint.motion.wrapped = Some(WrappedRange { ends_rad: range, is_of_table: false });
            let (_, findings) = evaluate_rule(&MOT003, &run);
            assert_eq!(findings.len(), usize::from(is_beyond), "{findings:?}");
        }
    }

    #[test]
    fn a_speed_that_is_worse_than_a_wrap_is_reported_instead() {
        for (is_of_table, title) in
            [(true, "joint limit exceeded"), (false, "joint wraps beyond its limits")]
        {
            let mut run = clean_run();
            let joint = &mut run.robots[0].joints[1];
            (joint.limits.lower, joint.limits.upper) = (Some(-3.1), Some(3.1));
            joint.limits.velocity = Some(2.0);
            joint.motion.wrapped = Some(WrappedRange { ends_rad: [0.0, 6.2], is_of_table });
            joint.motion.speeds =
                Some(LimitViolation { limit: 2.0, value: 9.0, at_s: 1.0, seconds: 0.02 });
            let (_, findings) = evaluate_rule(&MOT003, &run);
            let [finding] = findings.as_slice() else { panic!("{findings:?}") };
            assert_eq!((finding.title, finding.severity), (title, Severity::Warning));
        }
    }

    #[test]
    fn a_slight_excess_is_reported_and_noise_is_not() {
        for (over, severity) in
            [(0.5, Some(Severity::Warning)), (0.05, Some(Severity::Info)), (5e-5, None)]
        {
            let mut run = clean_run();
            let motion = &mut run.robots[0].joints[1].motion;
            motion.positions =
                Some(LimitViolation { limit: 3.0, value: 3.0 + over, at_s: 1.0, seconds: 0.25 });
            let (_, findings) = evaluate_rule(&MOT003, &run);
            assert_eq!(findings.first().map(|found| found.severity), severity, "{findings:?}");
        }
    }
}
