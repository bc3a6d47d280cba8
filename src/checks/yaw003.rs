use crate::checks::decision::{DEGREE, Figure, decide_length, unseen};
use crate::checks::{ArmFacts, Facts, Grade, ImuFacts, Judged};
use crate::diagnosis::{ImuDiagnosis, Length};
use crate::finding::{Estimate, Evidence, Fault, Severity, Unit};
use crate::geometry::xyzw_from_rotation;

rule! {
    /// An IMU is mounted otherwise than the log's frames say.
    ///
    /// ## What it means
    /// The orientation follows the arm, but only with another rotation between the link and the
    /// IMU than the log's transforms give.
    ///
    /// ## Why it matters
    /// Rates and accelerations arrive on the wrong axes: at 90° roll is pitch.
    ///
    /// ## Evidence
    /// The angle between the mount that fits best and the one in the log. `link_from_imu` is the one
    /// that fits, as a quaternion x, y, z, w; where the log has no frame of the IMU there is nothing
    /// to judge, and it is evidence only.
    ///
    /// ## How to fix
    /// Correct the static transform of the IMU's frame, or the axes that its driver reports.
    ///
    /// ## When it misleads
    /// A wrong static transform and a wrongly mounted sensor do the same to the log. Joint zeros of
    /// the wrist turn the mount too; those that were found are taken off.
    YAW003 {
        name: "imu-mount",
        grade: Grade::From(&[FIGURE]),
        headline: false,
        needs_model: true,
        missing: "no IMU on the arm",
        check: check,
    }
}

const FIGURE: Figure = Figure { unit: Unit::Radian, warning: 1.0 * DEGREE, error: 5.0 * DEGREE };

/// What would tell where the mount could not be had.
const SETTLE: &str = "turn the IMU through 60° about two axes";

fn check(facts: &Facts) -> Vec<Judged> {
    let subjects = facts.subjects();
    facts.imus().map(|(arm, imu, diagnosis)| judge(arm, imu, diagnosis, subjects)).collect()
}

fn judge(arm: &ArmFacts, imu: &ImuFacts, diagnosis: &ImuDiagnosis, subjects: usize) -> Judged {
    let subject = arm.topic(&imu.topic);
    let judged = match &diagnosis.mount_rad {
        Err(why) => Judged::new(subject, unseen(why, SETTLE)),
        Ok(mount) => {
            let decision = decide_length(mount, &FIGURE, subjects);
            let outcome = decision.into_outcome(SETTLE, |severity| fault(mount, severity));
            let estimate = Estimate::length("mount error", FIGURE.unit, mount);
            Judged::new(subject, outcome).estimated(estimate)
        }
    };
    let judged = judged.within(imu.span);
    match diagnosis.link_from_imu {
        Some(mount) => judged.with_evidence("link_from_imu", xyzw_from_rotation(&mount).to_vec()),
        None => judged,
    }
}

fn fault(mount: &Length, severity: Severity) -> Fault {
    let shown = FIGURE.unit.show_measured(&mount.norm);
    Fault {
        severity,
        title: "IMU mounted otherwise",
        message: format!("mounted {shown} off the log's frames"),
        evidence: Evidence::default(),
        fix: "correct the IMU's static transform, or its driver's axes".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::{ask, clean_run, length};
    use crate::diagnosis::Unseen;
    use crate::finding::Status;

    #[test]
    fn a_turned_mount_is_an_error_and_no_frame_is_nothing_to_judge() {
        let mut facts = clean_run();
        facts.robots[0].imus[0].1.mount_rad = Ok(length(90.0 * DEGREE));
        let (_, findings) = ask(&YAW003, &facts);
        assert_eq!(findings[0].severity, Severity::Error);
        facts.robots[0].imus[0].1.mount_rad = Err(Unseen::NoFrame);
        let (rows, _) = ask(&YAW003, &facts);
        assert_eq!(rows[0].status, Status::Skipped);
    }
}
