use serde_json::{Value, json};

use crate::checks::decision::{Decision, Threshold, decide, not_observable};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{EstimateResult, LatencyProfile, LatencyShape, Measured, NotObservable};
use crate::evidence::{ArmEvidence, StreamEvidence};
use crate::finding::{Cause, Change, Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// A stream's latency is not constant.
    ///
    /// ## What it means
    /// The stream's latency steps or drifts to another level, varies with the load, or wanders. Typical
    /// causes: a clock that is set, a queue that fills, a busy network, or stamps made on receipt.
    ///
    /// ## Why it matters
    /// No single shift corrects such a latency. A calibration is wrong after a step, and poses scatter by
    /// speed times step. A latency that depends on load is largest when the arm is fastest.
    ///
    /// ## Evidence
    /// Changes above a few hundredths of a second are found first, from the lag between the stream's speed
    /// and the arm's over time. The latency is then estimated in windows of 1 s, from the stream's offset
    /// along the motion behind forward kinematics. An IMU's orientation is used, or its gyro if it has
    /// none. `kind` is:
    ///
    /// - `step`: the estimate is the largest step, positive if the stream becomes later. `jumps` lists the
    ///   times.
    /// - `ramp`: from one level to another; the estimate is signed. `ramp` has the start and end time.
    /// - `load`: it grows with joint or tool speed. The estimate is the difference between the run's
    ///   highest and lowest speed.
    /// - `wander`: the estimate is the difference between maximum and minimum.
    ///
    /// A single step and a ramp also have `from` and `to`. The other rules judge the stream with this
    /// variation removed. The reference is the level that lasts longest, or the lowest level if the steps are
    /// large.
    ///
    /// ## How to fix
    /// Stamp samples at acquisition. Slew clocks instead of setting them. Check which process or traffic
    /// started at the time of a step.
    ///
    /// ## When it misleads
    /// A latency that grows steadily is LAT002. If two or more independent streams vary and are all steady once
    /// a step is removed from the stamps of the joint states, the clock of the joint states stepped, and the only
    /// finding is on them. A single stream cannot show which of the two stepped. At rest a latency has no
    /// effect, so a step is dated to the next motion.
    LAT003 {
        name: "unsteady-latency",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose, /tf or IMU stream besides the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold = Threshold { unit: Unit::Second, warning: 5e-3, error: 20e-3 };

const SETTLE: &str = "record 10 s or more of motion that starts and stops";

struct StreamProfile<'a> {
    profile: EstimateResult<&'a LatencyProfile>,
    /// Latency after removing the profile.
    latency: Option<&'a Measured>,
    /// Several lags fit, so the profile may belong to a wrong one.
    is_periodic: bool,
}

fn check(case: &Case) -> Vec<SubjectResult> {
    case.evidence.robots.iter().flat_map(|arm| judge_arm(case, arm)).collect()
}

fn judge_arm(case: &Case, arm: &ArmEvidence) -> Vec<SubjectResult> {
    let poses = arm.poses_and_tf().map(|stream| {
        let profile = stream.diagnosis.latency_profile.as_ref().map_err(Clone::clone);
        let latency = stream.diagnosis.latency_s.as_ref().ok();
        stream.with_value(StreamProfile {
            profile,
            latency,
            is_periodic: stream.diagnosis.is_periodic(),
        })
    });
    let imus = arm.imus.iter().map(|imu| {
        let profile = imu.diagnosis.latency_profile.as_ref().map_err(Clone::clone);
        let latency = imu.diagnosis.latency_s.as_ref().ok();
        imu.with_value(StreamProfile {
            profile,
            latency,
            is_periodic: matches!(imu.diagnosis.latency_s, Err(NotObservable::Periodic(_))),
        })
    });
    let streams: Vec<StreamEvidence<StreamProfile>> = poses.chain(imus).collect();
    let joints = arm.joint_clock.as_ref().map(|profile| StreamEvidence {
        subject: arm.topic(&arm.joints_topic),
        span: Some(arm.span),
        value: StreamProfile { profile: Ok(profile), latency: None, is_periodic: false },
    });
    joints.iter().chain(&streams).map(|stream| judge(case, arm, stream)).collect()
}

fn estimate(case: &Case, profile: &LatencyProfile, latency: Option<&Measured>) -> Estimate {
    let name = match profile.shape {
        LatencyShape::Steps => "latency jump",
        LatencyShape::Ramp { .. } => "latency ramp",
        LatencyShape::WithLoad => "latency with load",
        LatencyShape::Steady | LatencyShape::Wander => "latency swing",
    };
    let estimate = Estimate::scalar(name, THRESHOLD.unit, &profile.swing_s);
    match levels_around_change(profile, latency) {
        Some((from, to, [begin_s, end_s])) => {
            let at = |at_s: f64| case.evidence.origin.shifted(at_s);
            let change_ci95_ns = (begin_s < end_s).then(|| [at(begin_s), at(end_s)]);
            estimate.with_change(Change { from, to, change_ns: at(begin_s), change_ci95_ns })
        }
        None => estimate,
    }
}

/// Latency before and after a single step or ramp, s, with its start and end, s from the run's origin.
fn levels_around_change(
    profile: &LatencyProfile,
    latency: Option<&Measured>,
) -> Option<(f64, f64, [f64; 2])> {
    let (latency_s, knots) = (latency?.value, &profile.levels.knots);
    let level = |level: Option<&(f64, f64)>| Some(latency_s + level?.1);
    match (profile.shape, profile.steps.as_slice()) {
        (LatencyShape::Steps, [jump]) => {
            Some((level(knots.first())?, level(knots.last())?, [jump.at_s; 2]))
        }
        (LatencyShape::Ramp { from_s, to_s }, _) => {
            let at = |t_s: f64| level(knots.iter().find(|(at_s, _)| *at_s == t_s));
            Some((at(from_s)?, at(to_s)?, [from_s, to_s]))
        }
        _ => None,
    }
}

fn judge(case: &Case, arm: &ArmEvidence, stream: &StreamEvidence<StreamProfile>) -> SubjectResult {
    let profile = match &stream.profile {
        Ok(profile) => *profile,
        Err(why) => return stream.judged(not_observable(why, SETTLE)),
    };
    let outcome = match decide(
        &profile.swing_s,
        &case.thresholds.threshold(&LAT003, THRESHOLD),
        case.evidence.subjects(),
    ) {
        Decision::Pass => Outcome::pass(),
        Decision::Fail(_) if stream.is_periodic => {
            Outcome::Inconclusive(format!("several lags fit a periodic motion; {SETTLE}"))
        }
        Decision::Fail(severity) if profile.is_unsteady => {
            Outcome::fail(fault(case, arm, profile, stream.latency, severity))
        }
        Decision::Fail(_) => {
            let shown = THRESHOLD.unit.show(profile.swing_s.value);
            Outcome::Inconclusive(format!("{shown} scatter, within the noise; {SETTLE}"))
        }
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
    };
    stream.judged(outcome).estimated(estimate(case, profile, stream.latency))
}

fn fault(
    case: &Case,
    arm: &ArmEvidence,
    profile: &LatencyProfile,
    latency: Option<&Measured>,
    severity: Severity,
) -> Fault {
    let swing = &profile.swing_s;
    let at = |at_s: f64| case.evidence.moment_at(at_s);
    let show = |value: f64| THRESHOLD.unit.show(value);
    let from_to = levels_around_change(profile, latency)
        .map(|(from, to, _)| format!(", from {} to {}", show(from), show(to)))
        .unwrap_or_default();
    let (kind, title, message) = match (profile.shape, profile.steps.as_slice()) {
        (_, [jump]) => (
            "step",
            "latency jumps",
            format!(
                "latency jumps by {} at {}{from_to}",
                THRESHOLD.unit.show_signed(swing),
                at(jump.at_s)
            ),
        ),
        (_, jumps @ [_, _, ..]) => (
            "step",
            "latency jumps",
            format!(
                "latency jumps {} times, by up to {}",
                jumps.len(),
                THRESHOLD.unit.show_signed(swing)
            ),
        ),
        (LatencyShape::Ramp { from_s, to_s }, _) => (
            "ramp",
            "latency drifts to another level",
            format!(
                "latency drifts by {} between {} and {}{from_to}",
                THRESHOLD.unit.show_signed(swing),
                at(from_s),
                at(to_s)
            ),
        ),
        (LatencyShape::WithLoad, _) => (
            "load",
            "latency depends on the load",
            format!(
                "latency grows with the arm's speed: {} later at the highest speed than at the lowest",
                THRESHOLD.unit.show_measured(swing)
            ),
        ),
        _ => (
            "wander",
            "latency wanders",
            format!("latency wanders by {} within the run", THRESHOLD.unit.show_measured(swing)),
        ),
    };
    let listed: Vec<Value> = profile
        .steps
        .iter()
        .map(|jump| {
            let at_ns = case.evidence.origin.shifted(jump.at_s).to_string();
            json!({ "at_ns": at_ns, "by_s": jump.size_s.value })
        })
        .collect();
    let effect_m = swing.value.abs() * arm.top_speed_m_s();
    let mut evidence = Evidence {
        effect: Some(format!("{} at this run's top speed", Unit::Metre.show(effect_m))),
        effect_m: Some(effect_m),
        ..Evidence::default()
    };
    evidence.more.insert("kind".to_owned(), kind.into());
    evidence.more.insert("jumps".to_owned(), listed.into());
    if let LatencyShape::Ramp { from_s, to_s } = profile.shape {
        let [from_ns, to_ns] = [from_s, to_s].map(|at_s| case.evidence.origin.shifted(at_s));
        let ramp = json!({ "from_ns": from_ns.to_string(), "to_ns": to_ns.to_string() });
        evidence.more.insert("ramp".to_owned(), ramp);
    }
    Fault {
        cause: Cause::VaryingLatency,
        severity,
        title,
        message,
        evidence,
        fix: match profile.shape {
            LatencyShape::WithLoad => {
                "check for computation, queues or filters whose load grows with speed; stamp at acquisition"
            }
            _ => "stamp at acquisition, and slew clocks instead of setting them",
        }
        .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{JOINTS, clean_run, evaluate_rule, precise, steady};
    use crate::diagnosis::LatencyStep;
    use crate::finding::Status;

    #[test]
    fn scatter_within_the_noise_is_no_finding() {
        let mut run = clean_run();
        let profile = |swing_s, is_unsteady, jumps| {
            Ok(LatencyProfile { swing_s, is_unsteady, steps: jumps, ..steady() })
        };
        run.robots[0].poses[0].diagnosis.latency_profile = profile(precise(0.012), false, vec![]);
        let (rows, findings) = evaluate_rule(&LAT003, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
        let jump = LatencyStep { at_s: 4.0, size_s: precise(0.012) };
        run.robots[0].poses[0].diagnosis.latency_profile =
            profile(precise(0.012), true, vec![jump]);
        let (_, findings) = evaluate_rule(&LAT003, &run);
        assert!(findings[0].message.starts_with("latency jumps by +12.000"), "{findings:?}");
        run.robots[0].poses[0].diagnosis.latency_s = Err(NotObservable::Periodic(vec![0.0, 1.3]));
        let (rows, findings) = evaluate_rule(&LAT003, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
    }

    #[test]
    fn steps_of_the_joint_states_clock_are_reported_on_their_topic() {
        let mut run = clean_run();
        let jump = LatencyStep { at_s: 4.0, size_s: precise(0.02) };
        run.robots[0].joint_clock = Some(LatencyProfile {
            swing_s: precise(0.02),
            is_unsteady: true,
            steps: vec![jump],
            ..steady()
        });
        let (_, findings) = evaluate_rule(&LAT003, &run);
        let subjects = findings.iter().map(|finding| finding.subject.label());
        assert_eq!(subjects.collect::<Vec<_>>(), [JOINTS]);
    }
}
