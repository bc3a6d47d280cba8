use super::compliance::{ComplianceRule, tip_effect};
use crate::checks::decision::{DEGREE, Threshold};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::JointCompliance;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Evidence, Fault, Severity, Unit};

rule! {
    /// A joint sags under gravity.
    ///
    /// ## What it means
    /// The link hangs lower than the encoder reports, in proportion to the gravity torque: compliant gears,
    /// belts and links. The value is the largest sag. One finding per joint.
    ///
    /// ## Why it matters
    /// Sag is largest when the arm is stretched out and loaded, and zero when it hangs. A zero corrected
    /// for one configuration is wrong in the others.
    ///
    /// ## Evidence
    /// Unless the other rules' causes explain the log to within the noise, each joint is tested for a
    /// deflection proportional to its gravity torque, with backlash (MOT006) and eccentricity; latencies,
    /// zeros and frames are free. Gravity points along −z of the chain's base. Link masses lie halfway
    /// between the joints and decrease outwards at the ratio that fits best; only ratios matter. Sag is
    /// reported if it reduces the residual substantially. Zeros are then judged on corrected joint states.
    ///
    /// If a load is picked up or put down, the value is the size of the change (`from`, `to`, `change_ns`).
    ///
    /// ## How to fix
    /// Configure payload, centre of mass and, if supported, joint compliance in the controller. Otherwise
    /// correct each target by the sag in its configuration.
    ///
    /// ## When it misleads
    /// The assumed gravity is wrong if the base frame is not upright (wall, ceiling). In few
    /// configurations, sag is indistinguishable from a zero offset. A base that tilts under the arm has
    /// nearly the same effect. If the load changes twice, neither change is reported.
    ZER003 {
        name: "sag",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose stream to compare with the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE };

const SAG: ComplianceRule = ComplianceRule {
    name: "sag",
    threshold: THRESHOLD,
    settle: "stretch the arm out and fold it, with every joint moving",
    applies: JointCompliance::is_sag,
    fault,
};

fn check(case: &Case) -> Vec<SubjectResult> {
    SAG.check(&ZER003, case)
}

fn fault(arm: &ArmEvidence, compliance: &JointCompliance, severity: Severity) -> Fault {
    let size = compliance.value();
    let (effect_m, moved) = tip_effect(arm, compliance.column, size.value);
    Fault {
        severity,
        cause: Cause::Compliance,
        title: "joint sags under gravity",
        message: format!("sags by up to {} under gravity", Unit::Radian.show_measured(&size)),
        evidence: Evidence {
            effect: Some(moved),
            effect_m: Some(effect_m),
            ..Evidence::default()
        },
        fix: "configure the payload, its centre of mass or the joint's compliance in the controller; \
            otherwise correct each target by the sag in its configuration"
            .to_owned(),
    }
}
