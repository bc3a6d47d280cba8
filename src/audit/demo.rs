//! The demo: a log with four faults planted together, audited, and held against what was planted.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use super::Options;
use crate::finding::{Cause, Finding};
use crate::geometry::{Convention, Misreading, RotationSlip};
use crate::report::{Report, Trouble, TroubleKind, write_whole};
use crate::stats::Measured;
use crate::synth;

/// The file that the log of the demo is written to.
pub const DEMO_LOG: &str = "demo.mcap";

/// A demo run: what was planted, and what the audit made of it.
#[derive(Clone, Debug)]
pub struct Demo {
    /// The report on the log.
    pub report: Report,
    /// The faults.
    pub planted: Vec<Planted>,
}

/// A planted fault.
#[derive(Clone, Debug)]
pub struct Planted {
    /// The fault, in words, with its amount.
    pub what: String,
    /// Whether the audit named it with its amount.
    pub recovered: bool,
}

/// Writes a faulty log of a UR5e into `dir` as [`DEMO_LOG`], and audits it.
///
/// # Errors
/// Where the log cannot be written, or the audit has trouble with it.
pub fn demo(dir: &Path) -> Result<Demo, Trouble> {
    let log = dir.join(DEMO_LOG);
    write(&log).map_err(|error| Trouble {
        kind: TroubleKind::Call,
        what: cause(&*error).to_string(),
        place: log.display().to_string(),
        remedy: "name a folder that can be written to".to_owned(),
    })?;
    let audited = crate::audit(&Options { logs: vec![log], ..Options::default() })?;
    let report = audited.with_figures().into_report();
    let planted = planted(&report.findings);
    Ok(Demo { report, planted })
}

fn write(log: &Path) -> Result<(), Box<dyn Error>> {
    write_whole(log, |staged| {
        let out = BufWriter::new(File::create(staged)?);
        synth::demo().write_mcap(out, Some(mcap::Compression::Zstd))?;
        Ok(())
    })
}

/// The innermost cause of an error: why the file cannot be written.
fn cause<'a>(error: &'a (dyn Error + 'static)) -> &'a (dyn Error + 'static) {
    error.source().map_or(error, cause)
}

/// Each fault of [`synth::demo`], and whether a finding names it with its amount.
fn planted(findings: &[Finding]) -> Vec<Planted> {
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
    let misreading = Misreading { is: Convention::RotVec, read_as: Convention::RPY };
    let misread = Cause::Rotation(RotationSlip::Misread(misreading));
    let pose = synth::POSE;
    vec![
        Planted {
            what: format!("rotation vector read as roll-pitch-yaw on {pose}"),
            recovered: has(Some(pose), None, &|cause| *cause == misread),
        },
        Planted {
            what: format!("{pose} {:.0} ms late", latency_s * 1e3),
            recovered: has(
                Some(pose),
                None,
                &|cause| matches!(cause, Cause::Latency(found) if near(found, latency_s, 1e-3)),
            ),
        },
        Planted {
            what: format!("zero of {lift} off by {:+.1}°", zero_rad.to_degrees()),
            recovered: has(None, Some(lift), &|cause| {
                let tolerance = 0.05_f64.to_radians();
                matches!(cause, Cause::JointZero { offset, .. } if near(offset, zero_rad, tolerance))
            }),
        },
        Planted {
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
