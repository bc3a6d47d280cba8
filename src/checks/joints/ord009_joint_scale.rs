use super::{coupling, turns};
use crate::checks::decision::not_observable;
use crate::checks::{Case, Grade, SubjectResult, Threshold, changes};
use crate::diagnosis::{JointScale, Measured, UnitResiduals};
use crate::evidence::ArmEvidence;
use crate::finding::{
    Cause, Estimate, Evidence, Fault, JointScaleCorrection, Outcome, Severity, Unit,
};
use serde_json::json;
use std::f64::consts::TAU;

rule! {
    /// A joint's direction or scale is wrong.
    ///
    /// ## What it means
    /// The joint's numbers must be scaled to rad or m: `q_true = factor · q_reported + offset`. −1 is a
    /// reversed joint; 2, 0.5 or 100 a gear ratio applied twice or not at all; 0.00153 a tick of an encoder
    /// with 4096 per turn; half the joint's range divided by 100 a number from −100 to 100. One finding per
    /// joint, or on the topic if all joints share the factor.
    ///
    /// ## Why it matters
    /// FK is wrong everywhere except at zero, by up to the length of the arm, and so is everything computed
    /// from it. All other rules use the corrected joint.
    ///
    /// ## Evidence
    /// - `factor`: estimated with all other causes on the arm's pose streams, with an interval.
    /// - `as_logged_m`, `corrected_m`: pose residuals as logged and corrected. A factor with a large
    ///   residual is not reported.
    /// - `offset`: added after scaling, if the numbers are neither rad nor m and have their own zero. The
    ///   offset of any other joint is ZER001.
    /// - `joints`: those of a finding on all joints.
    /// - `with`, `factor`: a joint that moves with another, `q_true = q_reported + factor · q_with`. FANUC
    ///   controllers measure J3 from the horizon, so a model that measures it from the upper arm needs J2
    ///   added. In some wrists, one joint's gear rotates the next joint by a few percent.
    /// - `turns`: of a joint off by a quarter, half or whole turn. Only the model's limits, exceeded
    ///   throughout the run, show a whole turn, if the unit of the positions is known; the poses show the
    ///   others, and `indistinguishable` lists the joint's zero offset (ZER001), which is the same there.
    /// - `changes`: times and scales of changes. The value is then the size of the change (`from`, `to`,
    ///   `change_ns`).
    ///
    /// ## How to fix
    /// Scale the numbers where the joint states are filled, or correct the driver's `direction`, gear ratio
    /// or encoder resolution. Compute a coupled joint from both positions. `--fix` writes the factors and
    /// couplings, and `--corrections` applies them. If the numbers are right, the axis in the robot's
    /// description is reversed; the log cannot distinguish the two.
    ///
    /// ## When it misleads
    /// A joint that barely moves shows neither sign nor scale. Only orientations show the last joint's
    /// sign. Reversing all joints of a mirror-symmetric arm has the same effect as poses in mirrored axes.
    ORD009 {
        name: "joint-scale",
        grade: Grade::Fixed(Severity::Error),
        headline: false,
        needs_model: true,
        missing: "no joint states with a stream to compare them with",
        check: check,
    }
}

/// Relative.
const MAX_FACTOR_DIFFERENCE: f64 = 2e-3;

fn check(case: &Case) -> Vec<SubjectResult> {
    let judged = |arm| {
        let of_joints = turns::judge(case, arm).into_iter().chain(coupling::judge(arm));
        let of_joints: Vec<SubjectResult> = of_joints.chain(judge_changes(case, arm)).collect();
        // Omit the topic's pass row if a joint has a finding.
        let of_scales = judge_arm(arm);
        let is_sound = arm.diagnosis.encoding.is_ok() && arm.diagnosis.scales.is_empty();
        if is_sound && !of_joints.is_empty() { of_joints } else { [of_scales, of_joints].concat() }
    };
    case.evidence.robots.iter().flat_map(judged).collect()
}

fn judge_arm(arm: &ArmEvidence) -> Vec<SubjectResult> {
    let topic = arm.topic(&arm.joints_topic);
    let (scales, reading) = match &arm.diagnosis.encoding {
        Ok(reading) => {
            let mut scales = arm.diagnosis.scales.clone();
            scales.retain(|scale| arm.diagnosis.factor_changes(scale.column).is_empty());
            // ORD004 reports the unit.
            if arm.radians_as_degrees().is_some() {
                scales.clear();
            }
            (scales, reading)
        }
        Err(why) => {
            let outcome = not_observable(why, "also log a pose that does not come from /tf");
            return vec![SubjectResult::new(topic, outcome).within(arm.span)];
        }
    };
    let residual = reading.residual.unwrap_or(UnitResiduals { as_logged: 0.0, corrected: 0.0 });
    let judged = |scale: &JointScale, joints: &[JointScale]| {
        let is_all = joints.len() > 1;
        let subject = match is_all {
            true => topic.clone(),
            false => arm.joint_states(scale.column),
        };
        let names = joints.iter().filter_map(|other| arm.joints.get(other.column));
        let names: Vec<&str> = names.map(|joint| joint.name.as_str()).collect();
        let fault = fault(arm, scale, joints, &residual);
        SubjectResult::new(subject, Outcome::fail(fault))
            .within(arm.span)
            .estimated(Estimate::scalar("joint scale", Unit::One, &as_logged(arm, scale.factor)))
            .with_evidence(
                "offset",
                if scale.is_coded() { json!(scale.offset) } else { json!(null) },
            )
            .with_evidence("joints", if is_all { json!(names) } else { json!(null) })
            .with_evidence("as_logged_m", residual.as_logged)
            .with_evidence("corrected_m", residual.corrected)
    };
    match scales.as_slice() {
        [] => vec![SubjectResult::new(topic, Outcome::pass()).within(arm.span)],
        [first, rest @ ..] if rest.len() > 1 && rest.iter().all(|other| is_same(first, other)) => {
            vec![judged(first, &scales)]
        }
        scales => scales.iter().map(|scale| judged(scale, &[*scale])).collect(),
    }
}

fn judge_changes(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    const THRESHOLD: Threshold = Threshold { unit: Unit::One, warning: 1e-3, error: 1e-3 };
    let columns = 0..arm.joints.len();
    let judged = columns.filter_map(|column| {
        let lever_m = arm.diagnosis.offsets.get(column).map_or(0.0, |offset| offset.lever_m);
        let (outcome, estimate) = changes::judge_scalar_change(
            case,
            "joint scale",
            ["joint scale changes mid-run", "joint scale drifts"],
            &arm.diagnosis.factor_changes(column),
            &THRESHOLD,
            |change| lever_m * change.size.value.abs(),
        )?;
        let subject = arm.joint_states(column);
        Some(SubjectResult::new(subject, outcome).within(arm.span).estimated(estimate))
    });
    judged.collect()
}

/// In rad per logged unit, if the numbers were interpreted as degrees. A reversed joint's are degrees.
fn as_logged(arm: &ArmEvidence, factor: Measured) -> Measured {
    match arm.is_in_degrees_by_magnitude && !is_same_factor(factor.value, -1.0) {
        true => factor.scaled(1f64.to_radians()),
        false => factor,
    }
}

fn is_same(a: &JointScale, b: &JointScale) -> bool {
    let difference = (a.factor.value - b.factor.value).abs();
    let known = a.factor.std_error.hypot(b.factor.std_error);
    difference < (MAX_FACTOR_DIFFERENCE * a.factor.value.abs()).max(4.0 * known)
}

fn fault(
    arm: &ArmEvidence,
    scale: &JointScale,
    joints: &[JointScale],
    residual: &UnitResiduals,
) -> Fault {
    let factor = as_logged(arm, scale.factor).value;
    let is_reversed =
        is_same_factor(factor, -1.0) || (factor + 1.0).abs() < scale.factor.half_width(0.95);
    let (title, what) = if is_reversed {
        ("joint is reversed", "the positions have the wrong sign".to_owned())
    } else {
        ("joint scale is wrong", describe_scale(arm, scale))
    };
    let who = if joints.len() > 1 { "all joints: " } else { "" };
    let offset = match scale.offset {
        offset if offset == 0.0 || !scale.is_coded() => String::new(),
        offset if offset < 0.0 => format!(" - {:.5}", -offset),
        offset => format!(" + {offset:.5}"),
    };
    let by = if is_reversed { "-1".to_owned() } else { show_factor(factor) };
    let (before, after) =
        (Unit::Metre.show(residual.as_logged), Unit::Metre.show(residual.corrected));
    // Only rotations show the last joint.
    let is_in_positions = residual.corrected < residual.as_logged;
    let seen = match is_in_positions {
        true => format!("{before} off as logged"),
        false => "seen in the rotations, as this joint does not move the position".to_owned(),
    };
    Fault {
        severity: Severity::Error,
        cause: Cause::JointScale(
            joints.iter().filter_map(|scale| correction(arm, scale)).collect(),
        ),
        title,
        message: format!("{who}{what}, {seen}"),
        evidence: Evidence {
            effect: is_in_positions.then(|| format!("{after} once multiplied by {by}")),
            effect_m: is_in_positions.then_some(residual.as_logged),
            ..Evidence::default()
        },
        fix: match is_reversed {
            true => format!(
                "q_true = {by} · q_reported{offset}, or reverse the joint's axis in the description"
            ),
            false => format!("q_true = {by} · q_reported{offset}"),
        },
    }
}

fn correction(arm: &ArmEvidence, scale: &JointScale) -> Option<JointScaleCorrection> {
    let joint = arm.joints.get(scale.column)?;
    Some(JointScaleCorrection {
        joint: joint.name.clone(),
        factor: scale.factor,
        offset: Some(scale.offset).filter(|offset| scale.is_coded() && *offset != 0.0),
        is_prismatic: joint.is_prismatic,
    })
}

fn describe_scale(arm: &ArmEvidence, scale: &JointScale) -> String {
    let factor = as_logged(arm, scale.factor).value.abs();
    let reversed = if scale.factor.value < 0.0 { ", counted backwards" } else { "" };
    let ticks = TAU / factor;
    let bits = ticks.log2().round();
    if (8.0..=24.0).contains(&bits) && is_same_factor(ticks, bits.exp2()) {
        return format!("the positions are ticks, {:.0} per turn{reversed}", bits.exp2());
    }
    let limits = arm.joints.get(scale.column).map(|joint| joint.limits);
    let range = limits.and_then(|limits| Some(limits.upper? - limits.lower?));
    let is_share = |of: f64| range.is_some_and(|range| is_same_factor(range / factor, of));
    if is_share(200.0) {
        return format!("the positions run from -100 to 100 over the range{reversed}");
    }
    if is_share(100.0) {
        return format!("the positions are a percentage of the range{reversed}");
    }
    format!(
        "the joint moves {} times its reported positions",
        show_factor(as_logged(arm, scale.factor).value)
    )
}

fn is_same_factor(value: f64, other: f64) -> bool {
    (value - other).abs() < MAX_FACTOR_DIFFERENCE * other.abs()
}

fn show_factor(factor: f64) -> String {
    match factor.abs() {
        // Factors near 1 need all digits.
        size if is_same_factor(size, size.round()) && size >= 1.0 && factor.round() != 1.0 => {
            format!("{factor:.0}")
        }
        size if size < 0.1 => format!("{factor:.4e}"),
        _ => format!("{factor:.4}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{JOINTS, clean_run, evaluate_rule, precise};
    use crate::diagnosis::{JointEncoding, JointUnit, JointUnitError};
    use crate::evidence::RunEvidence;

    fn scaled(scales: &[(usize, f64)]) -> RunEvidence {
        let mut run = clean_run();
        let arm = &mut run.robots[0];
        let scale = |&(column, factor): &(usize, f64)| JointScale {
            column,
            factor: precise(factor),
            offset: 0.25,
        };
        arm.diagnosis.scales = scales.iter().map(scale).collect();
        let slip = |scale: &JointScale| JointUnitError {
            column: scale.column,
            unit: JointUnit::Scaled,
            factor: scale.factor.value,
        };
        arm.diagnosis.encoding = Ok(JointEncoding {
            unit_errors: arm.diagnosis.scales.iter().map(slip).collect(),
            residual: Some(UnitResiduals { as_logged: 0.4, corrected: 2e-4 }),
            ..JointEncoding::default()
        });
        run
    }

    #[test]
    fn a_joint_scale_is_reported_with_its_factor() {
        let (_, findings) = evaluate_rule(&ORD009, &scaled(&[(1, -1.0)]));
        let [finding] = findings.as_slice() else { panic!("{findings:?}") };
        assert_eq!(finding.subject.joint.as_deref(), Some("lift"));
        assert_eq!(finding.subject.topic.as_deref(), Some(JOINTS));
        assert_eq!(finding.message, "the positions have the wrong sign, 400 mm off as logged");
        assert_eq!(
            finding.fix,
            "q_true = -1 · q_reported, or reverse the joint's axis in the description"
        );
        assert_eq!(finding.estimate.as_ref().and_then(Estimate::value), Some(-1.0));
    }

    #[test]
    fn a_common_factor_is_one_finding_and_two_factors_are_two() {
        let tick = TAU / 4096.0;
        let (_, findings) = evaluate_rule(&ORD009, &scaled(&[(0, tick), (1, tick), (2, tick)]));
        let [finding] = findings.as_slice() else { panic!("{findings:?}") };
        assert!(finding.subject.joint.is_none(), "{finding:?}");
        assert!(finding.message.contains("ticks, 4096 per turn"), "{}", finding.message);
        assert!(finding.fix.ends_with("+ 0.25000"), "{}", finding.fix);
        let (_, findings) = evaluate_rule(&ORD009, &scaled(&[(0, 2.0), (1, 0.5)]));
        assert_eq!(findings.len(), 2);
    }

    #[test]
    fn percentages_of_the_range_are_named() {
        // Limits of the clean run: ±3.
        let (_, findings) = evaluate_rule(&ORD009, &scaled(&[(0, 0.03)]));
        assert!(findings[0].message.contains("from -100 to 100"), "{}", findings[0].message);
        let (_, findings) = evaluate_rule(&ORD009, &scaled(&[(0, 0.06)]));
        assert!(findings[0].message.contains("a percentage"), "{}", findings[0].message);
    }
}
