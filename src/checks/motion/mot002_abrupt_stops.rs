use crate::checks::motion::mot003_limits_exceeded::doubt_of_joint;
use crate::checks::{Case, Grade, Limit, SubjectResult};
use crate::diagnosis::PeakAcceleration;
use crate::evidence::{ArmEvidence, JointEvidence};
use crate::finding::{
    Cause, Estimate, Evidence, Fault, JointRelation, Outcome, Picture, Severity, Unit,
};

rule! {
    /// A joint stops or starts abruptly.
    ///
    /// ## What it means
    /// A joint accelerates by more than 20 rad/s² (5 m/s² if prismatic). The acceleration is the slope of
    /// the logged velocities if they agree with the positions, otherwise the second derivative of the
    /// positions. Both are fitted over windows of 3 to 33 samples, once as stamped and once evenly spaced;
    /// the smaller value counts. The speed must change by at least 20 %, and for longer than the window: ripple is not
    /// reported. The window most significant beyond noise is reported.
    ///
    /// ## Why it matters
    /// Such stops shake the arm and its payload and wear the gears. They are typical of protective stops,
    /// emergency stops and commands without a velocity profile. Do not calibrate with data recorded during
    /// one.
    ///
    /// ## Evidence
    /// - `at_ns`: time; `window_s`: duration of the fitted window.
    /// - `jerk`: rate of change of the acceleration there.
    /// - `noise`: six standard deviations of the acceleration from noise alone.
    /// - `resolved`: smallest acceleration that a stop of 0.1 s would show.
    ///
    /// ## How to fix
    /// Use command profiles with bounded acceleration and jerk, blend waypoints instead of stopping at
    /// them, and look for a protective stop in the controller's log at that time.
    ///
    /// ## When it misleads
    /// A stop between two samples is averaged over them: record at 100 Hz or more. The result is
    /// inconclusive if noise or stamp jitter hides such an acceleration, or if samples are more than 50 ms
    /// apart. Gaps (TIM002) are skipped, and repeated samples (TIM008) count once. If rows repeat others
    /// while the arm moves, the age of the positions varies, and accelerations that this can produce are not
    /// reported. A value that no arm can reach is reported as wrong data.
    MOT002 {
        limits: &[MAX_REVOLUTE_ACCELERATION, MAX_PRISMATIC_ACCELERATION],
        name: "abrupt-stops",
        grade: Grade::Fixed(Severity::Warning),
        headline: false,
        needs_model: true,
        missing: "no joint states",
        check: check,
    }
}

/// Thresholds of a revolute joint.
const MAX_REVOLUTE_ACCELERATION: Limit = Limit {
    key: "turning",
    unit: Unit::RadianPerSecondSquared,
    value: 20.0,
    what: "acceleration above which a revolute joint stops abruptly",
};
/// Thresholds of a prismatic joint.
const MAX_PRISMATIC_ACCELERATION: Limit = Limit {
    key: "sliding",
    unit: Unit::MetrePerSecondSquared,
    value: 5.0,
    what: "acceleration above which a prismatic joint stops abruptly",
};
const UNKNOWN_UNITS: &str = "the unit of its columns is unknown without a model";
const SETTLE: &str = "log joint velocities at 100 Hz or more, evenly stamped";

fn check(case: &Case) -> Vec<SubjectResult> {
    let of_arm = |arm: &ArmEvidence| -> Vec<SubjectResult> {
        if arm.has_unknown_units {
            let why = Outcome::Skipped(UNKNOWN_UNITS.to_owned());
            return vec![SubjectResult::new(arm.topic(&arm.joints_topic), why)];
        }
        arm.joints.iter().enumerate().map(|(index, joint)| judge(case, arm, index, joint)).collect()
    };
    case.evidence.arms_with_or_without_model().flat_map(of_arm).collect()
}

fn judge(case: &Case, arm: &ArmEvidence, index: usize, joint: &JointEvidence) -> SubjectResult {
    let subject = arm.joint(index);
    let judged = |outcome| SubjectResult::new(subject.clone(), outcome).within(arm.span);
    if let Some(why) = doubt_of_joint(case, arm, index) {
        return judged(Outcome::Inconclusive(why));
    }
    let Some(found) = &joint.motion.abruptness else {
        let why = "too few or unevenly spaced samples";
        return judged(Outcome::Inconclusive(format!("{why}; {SETTLE}")));
    };
    let limit =
        if joint.is_prismatic { MAX_PRISMATIC_ACCELERATION } else { MAX_REVOLUTE_ACCELERATION };
    let (unit, limit) = (limit.unit.symbol(), case.thresholds.limit(&MOT002, &limit));
    let PeakAcceleration { acceleration, noise, resolved, .. } = *found;
    let outcome = if acceleration - noise >= limit {
        Outcome::fail(fault(case, found, limit, unit))
    } else if acceleration >= limit {
        let seen = format!("{acceleration:.0} {unit}, beyond the limit of {limit} {unit}");
        let noise = format!("noise may account for {noise:.0}");
        Outcome::Inconclusive(format!("{seen}, but {noise}; {SETTLE}"))
    } else if resolved > limit {
        let hidden = match resolved.is_finite() {
            true => {
                format!("sampling is too coarse to show accelerations below {resolved:.0} {unit}")
            }
            false => "samples are more than 50 ms apart: an abrupt stop would not show".to_owned(),
        };
        Outcome::Inconclusive(format!("{hidden} (limit {limit} {unit}); {SETTLE}"))
    } else {
        Outcome::pass()
    };
    judged(outcome)
        .estimated(estimate(found, if joint.is_prismatic { "m/s^2" } else { "rad/s^2" }))
        .with_evidence("at_ns", case.evidence.origin.shifted(found.at_s).to_string())
        .with_evidence("window_s", found.window_s)
        .with_evidence("jerk", found.jerk)
        .with_evidence("noise", noise)
        .with_evidence("resolved", resolved.is_finite().then_some(resolved))
}

/// The half-width is two of the six standard deviations in `noise`, and at least 1 %, the error of a fit
/// over a few samples.
fn estimate(found: &PeakAcceleration, unit: &'static str) -> Estimate {
    let half = (found.noise / 3.0).max(0.01 * found.acceleration);
    let ci95 = Some([found.acceleration - half, found.acceleration + half]);
    Estimate::Scalar {
        name: "joint acceleration",
        value: found.acceleration,
        unit,
        ci95,
        change: None,
        joint: JointRelation::default(),
    }
}

/// No arm accelerates more, rad/s² or m/s².
const MIN_IMPOSSIBLE_ACCELERATION: f64 = 1e4;

fn fault(case: &Case, found: &PeakAcceleration, limit: f64, unit: &str) -> Fault {
    if found.acceleration >= MIN_IMPOSSIBLE_ACCELERATION {
        return Fault {
            cause: Cause::Pictured(Picture::Joint),
            severity: Severity::Warning,
            title: "impossible acceleration",
            message: format!(
                "{:.0e} {unit} at {}: impossible for an arm; the positions or their stamps are wrong there",
                found.acceleration,
                case.evidence.moment_at(found.at_s),
            ),
            evidence: Evidence::default(),
            fix:
                "check the joint's positions there for a unit change, a whole-turn error, a second \
                publisher or wrong stamps"
                    .to_owned(),
        };
    }
    Fault {
        cause: Cause::Pictured(Picture::Joint),
        severity: Severity::Warning,
        title: "abrupt stop or start",
        message: format!(
            "abrupt stop or start: {:.0} {unit} at {}, over {} (limit {limit} {unit})",
            found.acceleration,
            case.evidence.moment_at(found.at_s),
            Unit::Second.show(found.window_s),
        ),
        evidence: Evidence::default(),
        fix: "limit acceleration and jerk of the commands; check for a protective stop there"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{clean_run, evaluate_rule};
    use crate::finding::Status;

    #[test]
    fn noise_that_hides_a_stop_is_inconclusive() {
        for (acceleration, noise, resolved, status) in [
            (30.0, 2.0, 2.0, Status::Fail),
            (30.0, 15.0, 15.0, Status::Inconclusive),
            (8.0, 2.0, 2.0, Status::Pass),
            (8.0, 2.0, 40.0, Status::Inconclusive),
            (8.0, 2.0, f64::INFINITY, Status::Inconclusive),
        ] {
            let mut run = clean_run();
            let stop = PeakAcceleration {
                acceleration,
                noise,
                window_s: 0.05,
                at_s: 1.0,
                jerk: 9.0,
                resolved,
            };
            run.robots[0].joints[0].motion.abruptness = Some(stop);
            let (rows, _) = evaluate_rule(&MOT002, &run);
            assert_eq!(rows[0].status, status, "{:?}", rows[0]);
        }
    }
}
