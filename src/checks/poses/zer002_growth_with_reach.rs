use crate::checks::decision::Threshold;
use crate::checks::scalar_rule::{ScalarRule, StreamEstimate};
use crate::checks::{Case, Grade, SubjectResult, changes, residual_attribution};
use crate::diagnosis::Measured;
use crate::evidence::{ArmEvidence, PoseEvidence, StreamEvidence};
use crate::finding::{Cause, Evidence, Fault, Severity, Unit};

rule! {
    /// The position error grows with reach, and no joint offset explains it.
    ///
    /// ## What it means
    /// Positions are too far from the base's origin (positive) or too near, by a fraction of their
    /// distance.
    ///
    /// ## Why it matters
    /// At 1 %, a stretched-out arm of 0.85 m misses by 8.5 mm, but by nothing near its base. It looks like
    /// a bent joint.
    ///
    /// ## Evidence
    /// The radial scale of logged over computed positions from the base's origin, minus 1, estimated with
    /// all other parameters. It is reported only if joint zeros and frames do not explain the log without
    /// it. If it changes during the run: `from`, `to` and `change_ns`.
    ///
    /// ## How to fix
    /// Look for a unit or scale factor in the driver, or a description of another size or variant of the
    /// arm.
    ///
    /// ## When it misleads
    /// A description with all links 1 % too long has the same effect, as does a tracker with a wrong scale;
    /// the arm is then right.
    ZER002 {
        name: "growth-with-reach",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::MetrePerMetre, warning: 1e-3, error: 5e-3 };

const RADIAL_SCALE: ScalarRule = ScalarRule {
    name: "growth with reach",
    threshold: THRESHOLD,
    settle: "reach far out and close in, with every joint moving",
    fault: |arm, _, radial_scale, severity| fault(arm, radial_scale, severity),
};

/// In the place of [`RADIAL_SCALE`] between poses.
const SCALE: ScalarRule =
    ScalarRule { name: "scale", settle: "move over larger distances", ..RADIAL_SCALE };

fn check(case: &Case) -> Vec<SubjectResult> {
    let judge = |arm: &ArmEvidence, stream: &StreamEvidence<PoseEvidence>| {
        let threshold = case.thresholds.threshold(&ZER002, THRESHOLD);
        let change = changes::judge_scalar_change(
            case,
            RADIAL_SCALE.name,
            ["growth with reach changes mid-run", "growth with reach drifts"],
            &Vec::from_iter(&stream.diagnosis.radial_scale_changes),
            &threshold,
            |change| change.size.value.abs() * arm.reach_m,
        );
        let radial_scale = stream.with_value(StreamEstimate {
            estimate: &stream.diagnosis.radial_scale,
            is_chosen: stream.diagnosis.is_radial_scale_chosen,
            doubt: doubt(stream),
        });
        let constant = arm.arm_or_body(RADIAL_SCALE, SCALE);
        changes::judge_with_change(stream.subject.clone(), change, |_| {
            constant.judge(&ZER002, case, arm, &radial_scale)
        })
        .within(stream.span)
    };
    let judged = case
        .evidence
        .robots
        .iter()
        .flat_map(|arm| arm.poses.iter().map(move |stream| judge(arm, stream)));
    judged.collect()
}

fn doubt(stream: &StreamEvidence<PoseEvidence>) -> Option<String> {
    if stream.diagnosis.is_periodic() {
        let why = "depends on a latency that fits at several lags; record non-periodic motion";
        return Some(why.to_owned());
    }
    // Two arms differ mainly in size.
    residual_attribution::residual_doubt(residual_attribution::residual_m(stream), 0.0)
}

fn fault(arm: &ArmEvidence, radial_scale: &Measured, severity: Severity) -> Fault {
    let (reach, moved_m) = (arm.reach_m, radial_scale.value.abs() * arm.reach_m);
    let moved = Unit::Metre.show(moved_m);
    if arm.is_trajectory {
        return Fault {
            cause: Cause::RadialScale,
            severity,
            title: "scales differ",
            message: format!(
                "distances are {} longer than those of {}",
                THRESHOLD.unit.show_signed(radial_scale),
                arm.joints_topic
            ),
            evidence: Evidence {
                effect: Some(format!("{moved} at the ends of the motion")),
                effect_m: Some(moved_m),
                ..Evidence::default()
            },
            fix: format!(
                "check the scale of both, as of a monocular camera or a tracker's calibration: their ratio is {:.4}",
                1.0 + radial_scale.value
            ),
        };
    }
    Fault {
        cause: Cause::RadialScale,
        severity,
        title: "error grows with reach",
        message: format!(
            "positions are off by {} of reach",
            THRESHOLD.unit.show_signed(radial_scale)
        ),
        evidence: Evidence {
            effect: Some(format!("{moved} at full reach ({reach:.2} m)")),
            effect_m: Some(moved_m),
            ..Evidence::default()
        },
        fix: format!(
            "look for a scale of {:.4} in the driver, or for a description of a different size",
            1.0 + radial_scale.value
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule, precise};

    #[test]
    fn a_selected_radial_scale_is_a_finding_with_its_effect_at_reach() {
        let mut run = clean_run();
        let stream = &mut run.robots[0].poses[0].diagnosis;
        (stream.radial_scale, stream.is_radial_scale_chosen) = (Ok(precise(0.01)), true);
        let (_, findings) = evaluate_rule(&ZER002, &run);
        assert_eq!(findings[0].evidence.effect.as_deref(), Some("8.5 mm at full reach (0.85 m)"));
        assert_eq!(findings[0].severity, Severity::Error);
    }
}
