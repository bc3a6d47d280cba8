//! Logs with planted faults, audited and compared with them.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::Options;
use crate::finding::{Cause, Estimate, Finding};
use crate::geometry::{Convention, Misinterpretation, RotationError};
use crate::report::{Report, Trouble, write_whole};
use crate::synth::{self, Scenario};

/// File name of the log of [`demo`].
pub const DEMO_LOG: &str = "demo.mcap";
/// File name of the log of [`demo_pair`].
pub const DEMO_PAIR_LOG: &str = "pair.mcap";

/// A demo run.
#[derive(Clone, Debug)]
pub struct Demo {
    /// Report on the log.
    pub report: Report,
    /// Planted faults.
    pub planted: Vec<PlantedFault>,
}

/// A planted fault.
#[derive(Clone, Debug)]
pub struct PlantedFault {
    /// The fault with its value.
    pub what: String,
    /// Found at the right size.
    pub recovered: bool,
}

/// Writes a faulty log of a UR5e to `dir` as [`DEMO_LOG`] and audits it.
///
/// # Errors
/// If the log cannot be written, or the audit fails.
pub fn demo(dir: &Path) -> Result<Demo, Trouble> {
    audit_scenario(dir.join(DEMO_LOG), &synth::demo(), check_planted)
}

/// Writes the poses of a controller and of a faulty tracker to `dir` as [`DEMO_PAIR_LOG`] and audits them.
///
/// # Errors
/// As [`demo`].
pub fn demo_pair(dir: &Path) -> Result<Demo, Trouble> {
    audit_scenario(dir.join(DEMO_PAIR_LOG), &synth::pair(), check_planted_in_pair)
}

fn audit_scenario(
    log: PathBuf,
    scenario: &Scenario,
    check: fn(&[Finding], &Scenario) -> Vec<PlantedFault>,
) -> Result<Demo, Trouble> {
    write(&log, scenario).map_err(|error| {
        Trouble::call(log.display(), innermost_cause(&*error), "name a writable folder")
    })?;
    let audited = crate::audit(&Options { logs: vec![log], ..Options::default() })?;
    let report = audited.with_figures().into_report();
    let planted = check(&report.findings, scenario);
    Ok(Demo { report, planted })
}

fn write(log: &Path, scenario: &Scenario) -> Result<(), Box<dyn Error>> {
    write_whole(log, |staged| {
        let out = BufWriter::new(File::create(staged)?);
        scenario.write_mcap(out, Some(mcap::Compression::Zstd))?;
        Ok(())
    })
}

fn innermost_cause<'a>(error: &'a (dyn Error + 'static)) -> &'a (dyn Error + 'static) {
    error.source().map_or(error, innermost_cause)
}

fn check_planted(findings: &[Finding], run: &Scenario) -> Vec<PlantedFault> {
    let has = |topic: Option<&str>, joint: Option<&str>, is_it: &dyn Fn(&Cause) -> bool| {
        findings.iter().any(|finding| {
            finding.subject.topic.as_deref() == topic
                && finding.subject.joint.as_deref() == joint
                && is_it(&finding.cause)
        })
    };
    let latency_s = run.pose.timing.latency_s;
    let (lift, zero_rad) = ("shoulder_lift_joint", run.joints.zero_offsets[1]);
    let drift_rad_s = run.imu.yaw_drift_rad_s;
    let degrees_a_minute = |rad_s: f64| rad_s.to_degrees() * 60.0;
    let misreading = Misinterpretation { is: Convention::RotVec, read_as: Convention::RPY };
    let misread = Cause::Rotation(RotationError::Misread(misreading));
    let pose = synth::POSE;
    vec![
        PlantedFault {
            what: format!("rotation vector read as roll-pitch-yaw on {pose}"),
            recovered: has(Some(pose), None, &|cause| *cause == misread),
        },
        PlantedFault {
            what: format!("{pose} {:.0} ms late", latency_s * 1e3),
            recovered: has(
                Some(pose),
                None,
                &|cause| matches!(cause, Cause::Latency(found) if is_near(found.value, latency_s, 1e-3)),
            ),
        },
        PlantedFault {
            what: format!("zero of {lift} off by {:+.1}°", zero_rad.to_degrees()),
            recovered: has(None, Some(lift), &|cause| {
                let tolerance = 0.05_f64.to_radians();
                matches!(cause, Cause::JointZero { offset, .. } if is_near(offset.value, zero_rad, tolerance))
            }),
        },
        PlantedFault {
            what: format!(
                "yaw of {} drifting {:+.1} °/min",
                synth::IMU,
                degrees_a_minute(drift_rad_s)
            ),
            recovered: has(Some(synth::IMU), None, &|cause| {
                let tolerance = 0.15_f64.to_radians() / 60.0;
                matches!(cause, Cause::YawDrift(found) if is_near(found.value, drift_rad_s, tolerance))
            }),
        },
    ]
}

fn check_planted_in_pair(findings: &[Finding], run: &Scenario) -> Vec<PlantedFault> {
    let tracker = &run.tracker;
    let of_tracker =
        findings.iter().filter(|finding| finding.subject.topic.as_ref() == Some(&tracker.topic));
    let latency_s = tracker.timing.latency_s;
    let is_late = |finding: &Finding| matches!(&finding.cause, Cause::Latency(found) if is_near(found.value, latency_s, 1e-3));
    let slip = tracker.slip.as_ref().expect("the marker slips");
    let slip_m = slip.tool_from_slipped.translation.vector.norm();
    let is_slip = |finding: &Finding| {
        let Some(Estimate::Frame { name: "tool frame", value, change: Some(change), .. }) =
            &finding.estimate
        else {
            return false;
        };
        let at_s = change.change_ns.seconds_since(run.start);
        is_near(*value, slip_m, 3e-4) && is_near(at_s, slip.from_s, 0.5)
    };
    vec![
        PlantedFault {
            what: format!("{} {:.0} ms late", tracker.topic, latency_s * 1e3),
            recovered: of_tracker.clone().any(is_late),
        },
        PlantedFault {
            what: format!(
                "marker of {} slips by {:.0} mm at {:+.0} s",
                tracker.topic,
                slip_m * 1e3,
                slip.from_s
            ),
            recovered: of_tracker.clone().any(is_slip),
        },
    ]
}

fn is_near(found: f64, planted: f64, tolerance: f64) -> bool {
    (found - planted).abs() <= tolerance
}
