//! Commands that follow a fleet report.

use super::FleetReport;
use crate::Options;
use crate::checks::suggests_calibration;
use crate::fleet::AuditSettings;
use crate::report::quote_for_shell;

/// Logs of an arm with the finding, before its calibration is proposed.
const MIN_LOGS: usize = 3;
/// Logs in the proposed command.
const MAX_LOGS: usize = 5;

/// A command and its purpose.
pub struct NextCommand {
    pub command: String,
    pub purpose: String,
}

impl FleetReport {
    /// Audit of the worst log, calibration of arms, and the page with the plots.
    pub(super) fn next_commands(&self) -> Vec<NextCommand> {
        let folder = quote_for_shell(&self.folder.display().to_string());
        let page = NextCommand {
            command: format!("poseaudit fleet report {folder} --format html --output fleet.html"),
            purpose: "plots and all logs".to_owned(),
        };
        self.worst_audit().into_iter().chain(self.calibrations()).chain([page]).collect()
    }

    /// Calibration of each arm whose nominal model is wrong in several logs.
    fn calibrations(&self) -> Vec<NextCommand> {
        let repeated = self
            .findings
            .iter()
            .filter(|row| suggests_calibration(&row.code, row.severity) && row.logs >= MIN_LOGS);
        let mut arms: Vec<String> = Vec::new();
        repeated
            .filter_map(|row| {
                let arm = row.subject.arm_label();
                if arms.contains(&arm) {
                    return None;
                }
                arms.push(arm.clone());
                let latest = row.paths.iter().rev().take(MAX_LOGS);
                let logs: Vec<String> = latest.map(|path| quote_for_shell(path)).collect();
                Some(NextCommand {
                    command: format!("poseaudit calibrate {} --out calibrated", logs.join(" ")),
                    purpose: format!(
                        "{} logs of {arm} deviate from the nominal model ({}): calibrate the arm, put \
                         calibration.json next to poseaudit.toml, and audit with --config auto --calibration auto",
                        row.logs, row.code
                    ),
                })
            })
            .collect()
    }

    /// Audits the log with the largest value of the first finding.
    fn worst_audit(&self) -> Option<NextCommand> {
        let first = self.findings.first()?;
        let log = first.worst.as_ref().map_or(&first.path, |worst| &worst.path);
        let defaults = AuditSettings::from_options(&Options::default()).ok()?;
        let options = match self.logs.settings == defaults.hash {
            true => "",
            false => ", with the options of the fleet",
        };
        Some(NextCommand {
            command: format!("poseaudit audit {}", quote_for_shell(log)),
            purpose: format!("worst {}{options}", first.code),
        })
    }
}
