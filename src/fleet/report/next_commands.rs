//! Commands that follow a fleet report.

use super::FleetReport;
use crate::Options;
use crate::fleet::AuditSettings;
use crate::report::quote_for_shell;

/// A command and its purpose.
pub struct NextCommand {
    pub command: String,
    pub purpose: String,
}

impl FleetReport {
    /// Audit of the worst log, and the page with the plots.
    pub(super) fn next_commands(&self) -> Vec<NextCommand> {
        let folder = quote_for_shell(&self.folder.display().to_string());
        let page = NextCommand {
            command: format!("poseaudit fleet report {folder} --format html --output fleet.html"),
            purpose: "plots and all logs".to_owned(),
        };
        self.worst_audit().into_iter().chain([page]).collect()
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
