//! A log with four planted faults, audited and compared with them.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use super::Options;
use crate::finding::{Cause, Finding};
use crate::geometry::{Convention, Misinterpretation, RotationError};
use crate::report::{Report, Trouble, TroubleKind, write_whole};
use crate::stats::Measured;
use crate::synth;

/// File name of the log.
pub const DEMO_LOG: &str = "demo.mcap";

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
    let log = dir.join(DEMO_LOG);
    write(&log).map_err(|error| Trouble {
        kind: TroubleKind::Call,
        what: innermost_cause(&*error).to_string(),
        place: log.display().to_string(),
        remedy: "name a writable folder".to_owned(),
    })?;
    let audited = crate::audit(&Options { logs: vec![log], ..Options::default() })?;
    let report = audited.with_figures().into_report();
    let planted = check_planted(&report.findings);
    Ok(Demo { report, planted })
}

fn write(log: &Path) -> Result<(), Box<dyn Error>> {
    write_whole(log, |staged| {
        let out = BufWriter::new(File::create(staged)?);
        synth::demo().write_mcap(out, Some(mcap::Compression::Zstd))?;
        Ok(())
    })
}

fn innermost_cause<'a>(error: &'a (dyn Error + 'static)) -> &'a (dyn Error + 'static) {
    error.source().map_or(error, innermost_cause)
}

fn check_planted(findings: &[Finding]) -> Vec<PlantedFault> {
    let has = |topic: Option<&str>, joint: Option<&str>, is_it: &dyn Fn(&Cause) -> bool| {
        findings.iter().any(|finding| {
            finding.subject.topic.as_deref() == topic
                && finding.subject.joint.as_deref() == joint
                && is_it(&finding.cause)
        })
    };
    let near =
        |found: &Measured, value: f64, tolerance: f64| (found.value - value).abs() <= tolerance;
    let run = synth::demo();
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
                &|cause| matches!(cause, Cause::Latency(found) if near(found, latency_s, 1e-3)),
            ),
        },
        PlantedFault {
            what: format!("zero of {lift} off by {:+.1}°", zero_rad.to_degrees()),
            recovered: has(None, Some(lift), &|cause| {
                let tolerance = 0.05_f64.to_radians();
                matches!(cause, Cause::JointZero { offset, .. } if near(offset, zero_rad, tolerance))
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
                matches!(cause, Cause::YawDrift(found) if near(found, drift_rad_s, tolerance))
            }),
        },
    ]
}
