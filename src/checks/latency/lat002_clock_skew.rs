use crate::checks::decision::Threshold;
use crate::checks::scalar_rule::{ScalarRule, StreamEstimate};
use crate::checks::{Case, Grade, SubjectResult};
use crate::diagnosis::{EstimateResult, Measured};
use crate::evidence::{ArmEvidence, StreamEvidence};
use crate::finding::{Cause, Evidence, Fault, Outcome, Ruling, Severity, Unit};

rule! {
    /// A stream's latency grows: its clock runs at a different rate.
    ///
    /// ## What it means
    /// The latency of the stream relative to the joint states changes at this rate per second of stamp
    /// time; positive if it grows. The clocks are probably not synchronised.
    ///
    /// ## Why it matters
    /// A latency calibration expires: at 200 ppm a stream is 12 ms later after a minute and 0.7 s later
    /// after an hour.
    ///
    /// ## Evidence
    /// The slope of the latency over the run, estimated together with the latency. `effect` is the total
    /// change over this run. LAT001 reports the latency at mid-run.
    ///
    /// ## How to fix
    /// Synchronise both clocks (NTP, PTP or chrony), or stamp on one host.
    ///
    /// ## When it misleads
    /// A filling buffer looks the same until it drops samples. In less than a minute, a rate is reported
    /// only if the latency grows by 2 ms. A stream with the joint states' stamps shares their clock and is
    /// skipped.
    LAT002 {
        name: "clock-skew",
        grade: Grade::From(&[THRESHOLD]),
        headline: false,
        needs_model: true,
        missing: "no pose or IMU stream besides the joint states",
        check: check,
    }
}

const THRESHOLD: Threshold =
    Threshold { unit: Unit::SecondPerSecond, warning: 50e-6, error: 500e-6 };

const SETTLE: &str = "record a minute or more of motion from start to end";

const SKEW: ScalarRule =
    ScalarRule { name: "clock skew", threshold: THRESHOLD, settle: SETTLE, fault };

fn check(case: &Case) -> Vec<SubjectResult> {
    let poses = case.evidence.poses().map(|(arm, stream)| {
        let (estimate, is_chosen) = (&stream.diagnosis.skew, stream.diagnosis.is_skew_chosen);
        let doubt = doubt(estimate, stream.seconds());
        let skew = stream.with_value(StreamEstimate { estimate, is_chosen, doubt });
        judge(case, arm, stream.has_independent_stamps, &skew)
    });
    let imus = case.evidence.imus().map(|(arm, imu)| {
        let estimate = &imu.diagnosis.skew;
        let doubt = doubt(estimate, imu.seconds());
        let skew = imu.with_value(StreamEstimate { estimate, is_chosen: true, doubt });
        judge(case, arm, imu.has_independent_stamps, &skew)
    });
    poses.chain(imus).collect()
}

/// A shorter stream, s, determines a rate only if the latency changes by `GROWS_S`.
const OWN_MINUTE_S: f64 = 60.0;
const GROWS_S: f64 = 2e-3;

fn judge(
    case: &Case,
    arm: &ArmEvidence,
    has_independent_stamps: bool,
    skew: &StreamEvidence<StreamEstimate<'_>>,
) -> SubjectResult {
    let judged = SKEW.judge(&LAT002, case, arm, skew);
    // Rows of one clock may have been merged from streams of two. Against an arm, small rates are errors of the model.
    let is_fault = matches!(
        &judged.outcome,
        Outcome::Evaluated(Ruling::Fail(fault))
            if arm.is_trajectory || fault.severity == Severity::Error
    );
    if has_independent_stamps || is_fault {
        return judged;
    }
    let why = arm.arm_or_body(
        "same stamps as the joint states: there is only one clock",
        "same stamps as the reference: there is only one clock",
    );
    skew.judged(Outcome::Skipped(why.to_owned()))
}

/// Reason why a rate from a short run is unreliable.
fn doubt(skew: &EstimateResult<Measured>, seconds: f64) -> Option<String> {
    let skew = skew.as_ref().ok()?;
    let moved_s = skew.value.abs() * seconds;
    (seconds < OWN_MINUTE_S && moved_s < GROWS_S).then(|| {
        format!(
            "{} changes the latency by {} in {seconds:.0} s: too short to determine a rate; {SETTLE}",
            THRESHOLD.unit.show_signed(skew),
            Unit::Second.show(moved_s),
        )
    })
}

fn fault(
    arm: &ArmEvidence,
    stream: &StreamEvidence<StreamEstimate<'_>>,
    skew: &Measured,
    severity: Severity,
) -> Fault {
    let seconds = stream.seconds();
    let moved_s = skew.value.abs() * seconds;
    let moved = Unit::Second.show(moved_s);
    Fault {
        severity,
        cause: Cause::ClockSkew(*skew),
        title: "clock runs at a different rate",
        message: format!(
            "latency grows by {} against {}",
            THRESHOLD.unit.show_signed(skew),
            arm.joints_topic
        ),
        evidence: Evidence {
            effect: Some(format!("{moved} over this run of {seconds:.1} s")),
            effect_m: Some(moved_s * arm.top_speed_m_s()),
            ..Evidence::default()
        },
        fix: "synchronise the two clocks (chrony, PTP), or stamp both streams on one host"
            .to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{IMU, clean_run, evaluate_rule, precise};
    use crate::evidence::{ExpectedTiming, StampEvidence};
    use crate::finding::Status;
    use crate::run::{Alignment, Epoch, HeaderStamps, StreamClock};
    use crate::time::Clock;

    #[test]
    fn the_clock_of_an_imu_is_judged() {
        let mut run = clean_run();
        run.robots[0].imus[0].diagnosis.skew = Ok(precise(2e-3));
        let (_, findings) = evaluate_rule(&LAT002, &run);
        assert_eq!(findings[0].subject.topic.as_deref(), Some(IMU));
        assert_eq!(findings[0].severity, Severity::Error);
    }

    #[test]
    fn an_uncertain_alignment_of_the_clocks_does_not_widen_a_rate() {
        let mut run = clean_run();
        let pose = &mut run.robots[0].poses[0];
        pose.diagnosis.skew = Ok(Measured { std_error: 1e-2, ..precise(0.0) });
        let clock = StreamClock {
            stream: 0,
            frame: None,
            clock: Clock::Header,
            stamps: HeaderStamps::Sound,
            rows: 1000,
            zero: 0,
            begins_at_zero: false,
            out_of_range: 0,
            valid_range: i64::MIN..=i64::MAX,
            log_minus_header_s: None,
            soonest_s: None,
            epoch: Epoch::Common,
            alignment: Some(Alignment { offset_nanos: 0, spread_s: 0.1, is_by_motion: false }),
        };
        let stamps = StampEvidence { due: ExpectedTiming::Always, clock, rounded: None };
        run.stamps = vec![pose.with_value(stamps)];
        let (rows, _) = evaluate_rule(&LAT002, &run);
        let why = rows[0].reason.as_deref().unwrap_or_default();
        assert!(why.ends_with(SETTLE), "{why}");
    }

    #[test]
    fn a_skew_is_a_finding_only_if_the_model_contains_it() {
        let mut run = clean_run();
        let stream = &mut run.robots[0].poses[0].diagnosis;
        stream.skew = Ok(Measured { std_error: 1e-7, ..precise(2e-4) });
        let (rows, findings) = evaluate_rule(&LAT002, &run);
        assert!(findings.is_empty() && rows[0].status == Status::Inconclusive, "{rows:?}");
        run.robots[0].poses[0].diagnosis.is_skew_chosen = true;
        let (_, findings) = evaluate_rule(&LAT002, &run);
        assert_eq!(findings[0].message, "latency grows by +200.0 ± 0.2 ppm against /joint_states");
    }
}
