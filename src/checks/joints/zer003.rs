use super::bends::{Giving, effect};
use crate::checks::decision::{DEGREE, Threshold};
use crate::checks::{Case, Grade, Judged};
use crate::diagnosis::JointBend;
use crate::evidence::ArmEvidence;
use crate::finding::{Cause, Evidence, Fault, Severity, Unit};

rule! {
    /// A joint sags under gravity.
    ///
    /// ## What it means
    /// The link hangs lower than the joint's encoder says, by as much as gravity turns at the joint: gears,
    /// belts and links that yield. The amount is the largest sag over the run. One finding a joint.
    ///
    /// ## Why it matters
    /// It is most when the arm is stretched out and loaded, and none when it hangs. It looks like a zero
    /// that is off, but a zero that is set for one posture is wrong in the others.
    ///
    /// ## Evidence
    /// Where the causes of the other rules leave more than noise, it is asked of each joint what goes with
    /// the torque of gravity about it, beside play (MOT006) and eccentricity, with every latency, zero and
    /// frame free. Gravity points along −z of the chain's base. The masses of links are taken to lie in the
    /// middle between joints and to go down outwards, at the ratio that fits best; only their ratios
    /// matter. It is named where far less is left with it. Zeros are then judged with the sag taken off.
    ///
    /// A load that is taken up or put down in mid-run makes the sag another from then on: the amount is then
    /// the size of the change (`from`, `to`, `change_ns`).
    ///
    /// ## How to fix
    /// Tell the controller the payload and its centre of mass; where it has a compliance of its joints,
    /// enter that. Else correct targets by the sag of their posture.
    ///
    /// ## When it misleads
    /// An arm on a wall or a ceiling whose base frame is not upright has gravity elsewhere. In few postures
    /// sag cannot be told from a zero. A base that tilts under the arm does nearly the same. Of two changes
    /// of the load in one run neither is told.
    ZER003 {
        name: "sag",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose stream beside the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::Radian, warning: 0.1 * DEGREE, error: 0.5 * DEGREE };

const SAG: Giving = Giving {
    name: "sag",
    threshold: THRESHOLD,
    settle: "stretch the arm out and fold it, with every joint moving",
    is_it: JointBend::is_sag,
    fault,
};

fn check(case: &Case) -> Vec<Judged> {
    SAG.check(&ZER003, case)
}

fn fault(arm: &ArmEvidence, bend: &JointBend, severity: Severity) -> Fault {
    let (effect_m, moved) = effect(arm, bend.column, bend.amount.value);
    Fault {
        severity,
        cause: Cause::Bend,
        title: "joint sags under gravity",
        message: format!("sags by up to {} under gravity", Unit::Radian.show_measured(&bend.amount)),
        evidence: Evidence {
            effect: Some(moved),
            effect_m: Some(effect_m),
            ..Evidence::default()
        },
        fix: "tell the controller the payload and its centre of mass, or the joint's compliance; else \
              correct each target by the sag of its posture"
            .to_owned(),
    }
}
