use crate::checks::decision::{DEGREE, Decision, Figure, decide, unseen};
use crate::checks::{ArmFacts, Facts, Grade, ImuFacts, Judged};
use crate::diagnosis::{ImuDiagnosis, Measured};
use crate::finding::{Estimate, Evidence, Fault, Outcome, Severity, Unit};

rule! {
    /// The yaw of an IMU drifts against the arm.
    ///
    /// ## What it means
    /// The IMU's heading turns about gravity while the arm's kinematics say that it did not. The
    /// figure is the rate, d/dt of (IMU yaw − FK yaw). A constant yaw between the IMU's world and
    /// the robot's base is no fault.
    ///
    /// ## Why it matters
    /// Roll and pitch are held by gravity, yaw is held by nothing unless a magnetometer or another
    /// reference is there: what is fused with it turns slowly away, a degree in 20 s at 3 °/min.
    ///
    /// ## Evidence
    /// The slope of the yaw error over the run, with the joint offsets that were found taken into
    /// account and an interval that allows for correlated noise. `effect` says what it adds up to.
    ///
    /// ## How to fix
    /// Take yaw from kinematics, or give the filter a heading reference; calibrate the gyro's bias
    /// while the arm stands.
    ///
    /// ## When it misleads
    /// It needs orientation in the log (`orientation_covariance[0]` not −1). Short runs leave it
    /// open: a run of 1 s knows a drift to half a degree a minute at best. A magnetometer near
    /// motors makes errors that depend on the pose and not on time.
    YAW001 {
        name: "yaw-drift",
        grade: Grade::From(&[FIGURE]),
        headline: true,
        needs_model: true,
        missing: "no IMU with orientation on the arm",
        check: check,
    }
}

const FIGURE: Figure = Figure {
    unit: Unit::RadianPerSecond,
    warning: 0.2 * DEGREE / 60.0,
    error: 2.0 * DEGREE / 60.0,
};

/// What would tell where the drift could not be had.
const SETTLE: &str = "record a minute or more, with rests";

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    let imus = facts.robots.iter().flat_map(|arm| arm.imus.iter().map(move |imu| (arm, imu)));
    imus.map(|(arm, (imu, diagnosis))| judge(arm, imu, diagnosis, subjects)).collect()
}

fn judge(arm: &ArmFacts, imu: &ImuFacts, diagnosis: &ImuDiagnosis, subjects: usize) -> Judged {
    let subject = arm.topic(&imu.topic);
    let drift = match &diagnosis.yaw_drift_rad_s {
        Ok(drift) => drift,
        Err(why) => return Judged::new(subject, unseen(why, SETTLE)).within(imu.span),
    };
    let outcome = match decide(drift, &FIGURE, subjects) {
        Decision::Pass => Outcome::sound(),
        Decision::Undecided(why) => Outcome::Inconclusive(format!("{why}; {SETTLE}")),
        Decision::Fail(severity) => Outcome::faulty(fault(imu, drift, severity)),
    };
    Judged::new(subject, outcome).within(imu.span).estimated(Estimate::amount(
        "yaw drift",
        FIGURE.unit,
        drift,
    ))
}

fn fault(imu: &ImuFacts, drift: &Measured, severity: Severity) -> Fault {
    let seconds = imu.span.seconds();
    let turned = Unit::Radian.show(drift.value.abs() * seconds);
    Fault {
        severity,
        title: "IMU yaw drifts",
        message: format!("yaw drifts {} against the arm", FIGURE.unit.show_signed(drift)),
        evidence: Evidence {
            effect: Some(format!("{turned} over this run of {seconds:.1} s")),
            ..Evidence::default()
        },
        fix: "use FK's yaw, or give the filter a heading reference".to_owned(),
    }
}
