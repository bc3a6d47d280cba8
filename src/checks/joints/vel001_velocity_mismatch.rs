use crate::checks::decision::{Decision, Threshold, decide};
use crate::checks::joint_groups::{group_equal, group_prefix, group_subject, with_joint_names};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{Measured, NotObservable, Response, VelocityDiagnosis, VelocityShape};
use crate::evidence::{ArmEvidence, HiddenPauses, JointEvidence};
use crate::finding::{Cause, Estimate, Evidence, Fault, Outcome, Picture, Severity, Unit};
use crate::stats::median;

rule! {
    /// Recorded velocities are not the rates of the recorded positions.
    ///
    /// ## What it means
    /// The joint states' velocities have a different unit, the wrong sign, another joint's values, a delay
    /// or a filter, or are zero in motion. One finding per joint, or on the topic for joints with the same
    /// fault.
    ///
    /// ## Why it matters
    /// A wrong sign or unit makes a controller unstable; a filter makes it late. Interpolation, collision
    /// detection and training data also use velocities.
    ///
    /// ## Evidence
    /// Velocities integrated over windows (`window_s`) are compared with the change of position, so no
    /// signal is differentiated. The value is the rms error divided by the rms rate, beyond `noise`.
    ///
    /// - `noise`: effect of encoder resolution, noise and stamp jitter.
    /// - `rate`: rms rate of the positions.
    /// - `kind`: `zero`, `constant`, `scaled`, `other-joint`, `filtered` or `unlike`.
    ///   A cause is named if it explains at least 80 % of the squared velocities. `unlike`: no cause does.
    /// - `gain`: velocity at a rate of 1.
    /// - `delay_s`: delay of the velocities (negative: early), with its interval.
    /// - `low_pass_hz`: corner of a first-order low-pass, if it explains more than a delay.
    /// - `pauses`, `pause_s`: number and median length of the recorder's pauses that its stamps do not show:
    ///   the joints move between two rows as far as their velocities take them in many rows. The comparison
    ///   then uses times that include the pauses.
    /// - If values were sampled and stamped anew (TIM008), the comparison uses the times that the velocities
    ///   of all joints give. An error that remains without another cause is inconclusive.
    /// - `rows_per_s`, `stamped_rows_per_s`: rate of the rows by the velocities, and by the stamps. Given if the
    ///   velocities of all joints have the same unusual factor, and the stamps are an even grid.
    ///
    /// ## How to fix
    /// Fill `velocity` from the same reading as `position`, in rad/s (m/s for prismatic joints), in the
    /// order of `name`. Without velocities, leave it empty: zeros mean rest. Filter less, or delay the
    /// positions equally. If the rate of the rows is wrong, state the true one. If the recorder pauses, stamp
    /// each row when it is read.
    ///
    /// ## When it misleads
    /// The positions may be wrong instead, for example in degrees. Tool poses show this (ORD004, ORD009),
    /// and velocities that match the corrected positions are accepted. White noise on velocities is not a
    /// fault. The delay of a velocity from two samples, half a period, is not counted. A joint that barely
    /// moves shows nothing: an unexplained error in rad/s that the other joints may also have is no finding.
    VEL001 {
        name: "velocity-mismatch",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no joint states",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::One, warning: 0.05, error: 0.2 };
const SETTLE: &str = "move each joint by 30° or more, at 0.2 rad/s or more";
/// Relative.
const MAX_FACTOR_DIFFERENCE: f64 = 0.03;

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.arms_with_or_without_model().flat_map(|arm| judge_arm(case, arm)).collect()
}

fn judge_arm(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    if arm.joints.iter().all(|joint| joint.velocity.is_none()) {
        let why = "the joint states hold no velocities".to_owned();
        let topic = arm.topic(&arm.joints_topic);
        return vec![SubjectResult::new(topic, Outcome::Skipped(why)).within(arm.span)];
    }
    let mut rows = Vec::new();
    let mut faults: Vec<(usize, (VelocityDiagnosis, Severity))> = Vec::new();
    let least_errors = [false, true].map(|prismatic| least_sound_error(case, arm, prismatic));
    for (index, joint) in arm.joints.iter().enumerate() {
        let judged =
            |outcome| SubjectResult::new(arm.joint_states(index), outcome).within(arm.span);
        let found = match &joint.velocity {
            None => {
                rows.push(judged(Outcome::Skipped("it has no velocities".to_owned())));
                continue;
            }
            Some(Err(why)) => {
                rows.push(judged(Outcome::Inconclusive(format!(
                    "{}; {SETTLE}",
                    not_observable_reason(why)
                ))));
                continue;
            }
            Some(Ok(found)) => found,
        };
        let threshold = case.thresholds.threshold(&VEL001, THRESHOLD);
        let outcome = match decide(&found.error, &threshold, case.evidence.subjects()) {
            Decision::Fail(_)
                if found.shape == VelocityShape::Unrelated
                    && found.error.value * found.rate
                        < least_errors[usize::from(joint.is_prismatic)] =>
            {
                Outcome::Inconclusive(format!(
                    "error {} of a rate of only {} {} rms, no more than the other joints' in {2}; {SETTLE}",
                    percent(found.error.value),
                    show_rate(found.rate),
                    per_second(arm, index),
                ))
            }
            Decision::Fail(_)
                if found.shape == VelocityShape::Unrelated && arm.stamps.resampling.is_some() =>
            {
                Outcome::Inconclusive(format!(
                    "error {} at the times that the velocities of all joints give: the stamps are not those of \
                     the values (TIM008)",
                    percent(found.error.value)
                ))
            }
            Decision::Fail(severity) => match explained_by_correction(joint, index, &found.shape) {
                None => {
                    faults.push((index, (found.clone(), severity)));
                    continue;
                }
                Some(why) => Outcome::pass_with_remark(why.to_owned()),
            },
            Decision::Pass => Outcome::pass(),
            Decision::Undecided(_) => Outcome::Inconclusive(format!(
                "noise and resolution of the positions are {} of the rate (limit {}); {SETTLE}",
                percent(found.noise),
                percent(threshold.warning),
            )),
        };
        rows.push(with_numbers(judged(outcome), found));
    }
    let groups = group_equal(faults, |(a, _), (b, _)| is_same(&a.shape, &b.shape));
    rows.extend(groups.iter().map(|group| report_group(case, arm, group)));
    rows.extend(arm.stamps.pauses.map(|pauses| report_pauses(arm, pauses)));
    rows
}

fn report_pauses(arm: &ArmEvidence, pauses: HiddenPauses) -> SubjectResult {
    let HiddenPauses { count, typical_s } = pauses;
    let fault = Fault {
        severity: Severity::Warning,
        cause: Cause::Pictured(Picture::Joint),
        title: "stamps hide pauses of the recorder",
        message: format!(
            "by their velocities the joints move on for {} between two rows, {count} times: the recorder paused, \
             and the stamps do not show it",
            Unit::Second.show(typical_s)
        ),
        evidence: Evidence::default(),
        fix: format!(
            "stamp each row of {} when it is read; delays and speeds of this log are in the wrong time",
            arm.joints_topic
        ),
    };
    SubjectResult::new(arm.topic(&arm.joints_topic), Outcome::fail(fault))
        .within(arm.span)
        .with_evidence("pauses", count)
        .with_evidence("pause_s", typical_s)
}

/// Rates of the rows by the velocities and by the stamps. `None` unless the velocities of all joints have the same factor,
/// other than a usual unit, and the stamps are an even grid.
fn rates_of_rows(
    arm: &ArmEvidence,
    group: &[(usize, (VelocityDiagnosis, Severity))],
) -> Option<[f64; 2]> {
    /// Fewer may have one wrong gear or unit.
    const MIN_JOINTS: usize = 3;
    let stamped_hz = arm.stamps.even_rate_hz?;
    let is_known = |joint: &&JointEvidence| matches!(joint.velocity, Some(Ok(_)));
    let gain_of = |(_, (found, _)): &(usize, (VelocityDiagnosis, Severity))| match found.shape {
        VelocityShape::Scaled(gain) => Some(gain),
        _ => None,
    };
    let gain = median(&mut group.iter().map(gain_of).collect::<Option<Vec<f64>>>()?)?;
    let (joint, _) = group.first()?;
    let is_all =
        group.len() >= MIN_JOINTS && group.len() == arm.joints.iter().filter(is_known).count();
    (is_all && gain > 0.0 && usual_scale(arm, *joint, gain).is_none())
        .then_some([gain * stamped_hz, stamped_hz])
}

/// Whether velocities with this error are reported.
pub(in crate::checks) fn is_error_reported(case: &Case, error: &Measured) -> bool {
    let threshold = case.thresholds.threshold(&VEL001, THRESHOLD);
    matches!(decide(error, &threshold, case.evidence.subjects()), Decision::Fail(_))
}

/// Least error that velocities of joints without a fault may have, rad/s or m/s; 0 without such a joint. The
/// driver's filter has the same noise for a joint that hardly moves.
fn least_sound_error(case: &Case, arm: &ArmEvidence, is_prismatic: bool) -> f64 {
    let threshold = case.thresholds.threshold(&VEL001, THRESHOLD);
    let own = arm.joints.iter().filter(|joint| joint.is_prismatic == is_prismatic);
    let sound = own.filter_map(|joint| joint.velocity.as_ref()?.as_ref().ok()).filter(|found| {
        decide(&found.error, &threshold, case.evidence.subjects()) == Decision::Pass
    });
    let errors = sound.map(|found| (found.error.value + found.error.half_width(0.95)) * found.rate);
    errors.min_by(f64::total_cmp).unwrap_or(0.0)
}

fn not_observable_reason(why: &NotObservable) -> String {
    match why {
        NotObservable::TooFewSamples { have, need } => {
            format!("it has {have} samples with a velocity, {need} are needed")
        }
        _ => "the joint barely moves".to_owned(),
    }
}

/// Velocities that contradict the recorded positions are right if they match the corrected positions.
fn explained_by_correction(
    joint: &JointEvidence,
    index: usize,
    shape: &VelocityShape,
) -> Option<&'static str> {
    let (from, factor) = joint.actual?;
    let (of, gain) = match *shape {
        VelocityShape::Scaled(gain) => (index, gain),
        VelocityShape::OfJoint(other, gain) => (other, gain),
        _ => return None,
    };
    let matches_correction = of == from && is_same_factor(gain, factor);
    matches_correction.then_some("they match the corrected positions (ORD004, ORD005, ORD009)")
}

fn is_same_factor(value: f64, other: f64) -> bool {
    (value - other).abs() < MAX_FACTOR_DIFFERENCE * other.abs()
}

fn is_same(a: &VelocityShape, b: &VelocityShape) -> bool {
    /// Equal delays differ by less, s or relative.
    const MAX_DELAY_DIFFERENCE_S: f64 = 2e-3;
    const MAX_RELATIVE_DIFFERENCE: f64 = 0.2;
    match (a, b) {
        (VelocityShape::Zero, VelocityShape::Zero)
        | (VelocityShape::Constant(_), VelocityShape::Constant(_))
        | (VelocityShape::Unrelated, VelocityShape::Unrelated) => true,
        (VelocityShape::Scaled(a), VelocityShape::Scaled(b)) => is_same_factor(*a, *b),
        (VelocityShape::Filtered(a), VelocityShape::Filtered(b)) => {
            let difference_s = (a.delay_s.value - b.delay_s.value).abs();
            let is_same = difference_s
                < MAX_DELAY_DIFFERENCE_S.max(MAX_RELATIVE_DIFFERENCE * a.delay_s.value.abs());
            is_same && (a.gain - b.gain).abs() < 0.1 * a.gain.abs()
        }
        _ => false,
    }
}

fn percent(share: f64) -> String {
    let text = match 100.0 * share {
        much if much >= 9.95 => format!("{much:.0}"),
        little => format!("{little:.1}"),
    };
    format!("{} %", text.strip_suffix(".0").unwrap_or(&text))
}

fn show_rate(rate: f64) -> String {
    match rate {
        slow if slow < 0.01 => format!("{slow:.4}"),
        rate => format!("{rate:.2}"),
    }
}

fn report_group(
    case: &Case,
    arm: &ArmEvidence,
    group: &[(usize, (VelocityDiagnosis, Severity))],
) -> SubjectResult {
    let joints: Vec<usize> = group.iter().map(|(joint, _)| *joint).collect();
    let names: Vec<&str> = arm.joints.iter().map(|joint| joint.name.as_str()).collect();
    let by_error = |a: &&(usize, (VelocityDiagnosis, Severity)),
                    b: &&(usize, (VelocityDiagnosis, Severity))| {
        a.1.0.error.value.total_cmp(&b.1.0.error.value)
    };
    let (worst, (found, severity)) = group.iter().max_by(by_error).unwrap_or(&group[0]);
    let limit = percent(case.thresholds.threshold(&VEL001, THRESHOLD).warning);
    let rates = rates_of_rows(arm, group);
    let (what, fix) = match rates.map(|rates| rates.map(show_factor)) {
        Some([own, stamped]) => (
            format!(
                "velocities give {own} rows per second, but the stamps are a grid of {stamped}"
            ),
            format!("if {own} is the true rate, end --columns with @{own}, or correct the stamps"),
        ),
        None => describe(arm, *worst, found),
    };
    let fault = Fault {
        severity: *severity,
        cause: Cause::Pictured(Picture::Joint),
        title: match found.shape {
            _ if rates.is_some() => "rate of the rows contradicts the velocities",
            VelocityShape::Zero => "velocities are zero in motion",
            VelocityShape::Filtered(_) => "velocities are late or filtered",
            _ => "velocities do not match the positions",
        },
        message: format!(
            "{}{what}: error {} of the rate (limit {limit})",
            group_prefix(&names, &joints),
            percent(found.error.value),
        ),
        evidence: Evidence::default(),
        fix,
    };
    let subject = group_subject(&arm.topic(&arm.joints_topic), &names, &joints);
    let mut judged = SubjectResult::new(subject, Outcome::fail(fault)).within(arm.span);
    if let Some([own, stamped]) = rates {
        judged =
            judged.with_evidence("rows_per_s", own).with_evidence("stamped_rows_per_s", stamped);
    }
    with_joint_names(with_numbers(judged, found), &names, &joints)
}

/// A clause and the fix.
fn describe(arm: &ArmEvidence, joint: usize, found: &VelocityDiagnosis) -> (String, String) {
    let fill = |what: &str| format!("{what} where {} is filled", arm.joints_topic);
    match found.shape {
        VelocityShape::Zero => (
            format!(
                "velocities are zero while the joint moves at {} {} rms",
                show_rate(found.rate),
                per_second(arm, joint)
            ),
            "fill the velocities from the drive, or leave the field empty".to_owned(),
        ),
        VelocityShape::Constant(value) => (
            format!(
                "velocities stay at {} {} while the joint moves",
                show_rate(value),
                per_second(arm, joint)
            ),
            "fill the velocities from the drive, or leave the field empty".to_owned(),
        ),
        VelocityShape::Scaled(gain) => (
            describe_scale(arm, joint, gain),
            fill(&match is_same_factor(gain, -1.0) {
                true => "reverse the sign of the velocities".to_owned(),
                false => format!("divide the velocities by {}", show_factor(gain)),
            }),
        ),
        VelocityShape::OfJoint(other, gain) => {
            let name = arm.joints.get(other).map_or("", |joint| joint.name.as_str());
            let times = if is_same_factor(gain, 1.0) {
                String::new()
            } else {
                format!(" times {}", show_factor(gain))
            };
            (
                format!("velocities are those of {name}{times}"),
                fill("put the velocities in the order of the names"),
            )
        }
        VelocityShape::Filtered(response) => {
            let gain = match is_same_factor(response.gain, 1.0) || (response.gain - 1.0).abs() < 0.1
            {
                true => String::new(),
                false => format!(", {}", describe_scale(arm, joint, response.gain)),
            };
            (
                format!("{}{gain}", describe_response(&response)),
                fill("filter the velocities less, or stamp them with their own time"),
            )
        }
        VelocityShape::Rates | VelocityShape::Unrelated => (
            "velocities do not follow the positions".to_owned(),
            fill("take velocity and position from the same reading"),
        ),
    }
}

fn describe_response(response: &Response) -> String {
    let delay = &response.delay_s;
    let shown = Unit::Second.show_measured(&delay.abs());
    match (response.corner_hz(), delay.value < 0.0) {
        (Some(hz), _) => {
            format!("velocities are low-pass filtered at {} Hz ({shown} late)", show_factor(hz))
        }
        (None, true) => format!("velocities lead the positions by {shown}"),
        (None, false) => format!("velocities lag the positions by {shown}"),
    }
}

fn per_second(arm: &ArmEvidence, joint: usize) -> &'static str {
    match arm.joint_unit(joint) {
        Unit::Metre => "m/s",
        _ => "rad/s",
    }
}

/// A usual confusion of units, by its factor.
fn usual_scale(arm: &ArmEvidence, joint: usize, gain: f64) -> Option<&'static str> {
    const DEGREES_PER_RADIAN: f64 = 180.0 / std::f64::consts::PI;
    const TURNS_PER_RADIAN: f64 = 1.0 / std::f64::consts::TAU;
    let slides = arm.joint_unit(joint) == Unit::Metre;
    let known: &[(f64, &str)] = match slides {
        true => &[(1e3, "millimetres per second"), (1e-3, "m/s with positions in millimetres")],
        false => &[
            (DEGREES_PER_RADIAN, "degrees per second"),
            (1.0 / DEGREES_PER_RADIAN, "rad/s with positions in degrees"),
            (60.0 * TURNS_PER_RADIAN, "revolutions per minute"),
            (TURNS_PER_RADIAN, "revolutions per second"),
        ],
    };
    let unit = known.iter().find(|(factor, _)| is_same_factor(gain.abs(), *factor));
    unit.map(|(_, unit)| *unit)
}

fn describe_scale(arm: &ArmEvidence, joint: usize, gain: f64) -> String {
    if is_same_factor(gain, -1.0) {
        return "velocities have the wrong sign".to_owned();
    }
    let sign = if gain < 0.0 { ", with the wrong sign" } else { "" };
    match usual_scale(arm, joint, gain) {
        Some(unit) => {
            format!("velocities are {} times the rate ({unit}{sign})", show_factor(gain))
        }
        None => format!("velocities are {} times the rate", show_factor(gain)),
    }
}

fn show_factor(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 0.1 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

fn with_numbers(judged: SubjectResult, found: &VelocityDiagnosis) -> SubjectResult {
    let judged = judged
        .estimated(Estimate::scalar("velocity error", Unit::One, &found.error))
        .with_evidence("noise", found.noise)
        .with_evidence("rate", found.rate)
        .with_evidence("window_s", found.window_s);
    match found.shape {
        VelocityShape::Rates => judged,
        VelocityShape::Zero => judged.with_evidence("kind", "zero"),
        VelocityShape::Constant(_) => judged.with_evidence("kind", "constant"),
        VelocityShape::Unrelated => judged.with_evidence("kind", "unlike"),
        VelocityShape::Scaled(gain) => {
            judged.with_evidence("kind", "scaled").with_evidence("gain", gain)
        }
        VelocityShape::OfJoint(_, gain) => {
            judged.with_evidence("kind", "other-joint").with_evidence("gain", gain)
        }
        VelocityShape::Filtered(response) => judged
            .with_evidence("kind", "filtered")
            .with_evidence("gain", response.gain)
            .with_evidence("delay_s", response.delay_s.value)
            .with_evidence("delay_ci95", Unit::Second.interval95(&response.delay_s).map(Vec::from))
            .with_evidence("low_pass_hz", response.corner_hz()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, precise};
    use crate::evidence::{Resampling, RunEvidence};
    use crate::finding::Status;

    fn planted(shapes: &[(usize, VelocityShape)]) -> RunEvidence {
        let mut run = clean_run();
        for &(joint, shape) in shapes {
            let found = VelocityDiagnosis {
                error: precise(2.0),
                noise: 1e-3,
                rate: 0.5,
                window_s: 0.1,
                shape,
            };
            run.robots[0].joints[joint].velocity = Some(Ok(found));
        }
        run
    }

    #[test]
    fn joints_with_equal_faults_are_one_finding() {
        let degrees = VelocityShape::Scaled(57.3);
        let (rows, findings) = evaluate_rule(
            &VEL001,
            &planted(&[(0, degrees), (2, degrees), (1, VelocityShape::Zero)]),
        );
        assert_eq!(rows.len(), 2);
        let messages: Vec<&str> = findings.iter().map(|found| found.message.as_str()).collect();
        assert_eq!(findings.len(), 2, "{messages:?}");
        let both = findings.iter().find(|found| found.subject.joint.is_none()).unwrap();
        assert!(both.message.starts_with("2 joints: velocities are 57.3 times"), "{messages:?}");
        assert!(both.message.contains("degrees per second"), "{messages:?}");
        assert_eq!(both.evidence.more["joints"], serde_json::json!(["pan", "elbow"]));
    }

    #[test]
    fn one_factor_of_all_joints_is_the_rate_of_generated_stamps() {
        let of_all = |gain: f64| [0, 1, 2].map(|joint| (joint, VelocityShape::Scaled(gain)));
        let message = |gain: f64, even_rate_hz: Option<f64>, joints: usize| {
            let mut run = planted(&of_all(gain)[..joints]);
            run.robots[0].stamps.even_rate_hz = even_rate_hz;
            evaluate_rule(&VEL001, &run).1[0].message.clone()
        };
        let rate = message(0.667, Some(30.0), 3);
        assert!(
            rate.starts_with(
                "all joints: velocities give 20.0 rows per second, but the stamps are a grid of 30.0"
            ),
            "{rate}"
        );
        for (gain, even_rate_hz, joints) in [
            (0.667, None, 3),
            (57.3, Some(30.0), 3),
            (-0.667, Some(30.0), 3),
            (0.667, Some(30.0), 2),
        ] {
            let scale = message(gain, even_rate_hz, joints);
            assert!(scale.contains("times the rate"), "{scale}");
        }
    }

    #[test]
    fn pauses_that_the_stamps_hide_are_a_finding() {
        let mut run = planted(&[(0, VelocityShape::Rates)]);
        run.robots[0].joints[0].velocity = None;
        run.robots[0].joints[1].velocity = Some(Err(NotObservable::AtRest));
        run.robots[0].stamps.pauses = Some(HiddenPauses { count: 442, typical_s: 0.044 });
        let (_, findings) = evaluate_rule(&VEL001, &run);
        let [found] = findings.as_slice() else { panic!("{findings:?}") };
        assert!(found.message.contains("move on for 44 ms between two rows, 442 times"));
        assert_eq!(found.severity, Severity::Warning);
    }

    #[test]
    fn an_error_beside_stamps_of_other_times_is_inconclusive_and_a_scale_is_not() {
        for (shape, status) in [
            (VelocityShape::Unrelated, Status::Inconclusive),
            (VelocityShape::Scaled(2.0), Status::Fail),
        ] {
            let mut run = planted(&[(1, shape)]);
            run.robots[0].stamps.resampling = Some(Resampling::default());
            let (rows, _) = evaluate_rule(&VEL001, &run);
            let own = rows.iter().find(|row| row.subject.joint.as_deref() == Some("lift")).unwrap();
            assert_eq!(own.status, status, "{own:?}");
        }
    }

    #[test]
    fn velocities_confirm_a_position_scale_error() {
        let mut run = planted(&[(1, VelocityShape::Scaled(-1.0))]);
        assert!(
            evaluate_rule(&VEL001, &run).1[0].message.starts_with("velocities have the wrong sign")
        );
        run.robots[0].joints[1].actual = Some((1, -1.0));
        let (rows, findings) = evaluate_rule(&VEL001, &run);
        assert!(findings.is_empty() && rows.iter().all(|row| row.status == Status::Pass));
    }

    #[test]
    fn the_noise_of_a_joint_near_rest_is_no_fault() {
        let found = |value: f64, rate: f64| VelocityDiagnosis {
            error: Measured { std_error: 0.001, ..precise(value) },
            noise: 1e-3,
            rate,
            window_s: 0.1,
            shape: VelocityShape::Unrelated,
        };
        for (rate, status) in [(0.009, Status::Inconclusive), (0.09, Status::Fail)] {
            let mut run = clean_run();
            run.robots[0].joints.iter_mut().for_each(|it| it.velocity = Some(Ok(found(0.0, 0.5))));
            run.robots[0].joints[1].velocity = Some(Ok(found(0.06, rate)));
            let (rows, findings) = evaluate_rule(&VEL001, &run);
            let own = rows.iter().find(|row| row.subject.joint.as_deref() == Some("lift")).unwrap();
            assert_eq!((own.status, findings.len()), (status, usize::from(status == Status::Fail)));
        }
    }

    #[test]
    fn a_resting_joint_is_inconclusive_and_missing_velocities_are_skipped() {
        let mut run = clean_run();
        run.robots[0].joints[0].velocity = Some(Err(NotObservable::AtRest));
        assert_eq!(evaluate_rule(&VEL001, &run).0[0].status, Status::Inconclusive);
        run.robots[0].joints.iter_mut().for_each(|joint| joint.velocity = None);
        let (rows, _) = evaluate_rule(&VEL001, &run);
        assert!(rows.len() == 1 && rows[0].status == Status::Skipped, "{rows:?}");
    }
}
