//! Results of an audit as the problems that Foxglove lists for a data source.

use super::{finding_text, verdict_text};
use crate::finding::Severity;
use crate::report::outline::Outline;
use crate::report::{Report, Trouble};

/// One problem of a data source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Severity.
    pub severity: Severity,
    /// The problem.
    pub message: String,
    /// The fix.
    pub tip: Option<String>,
}

/// The verdict or the error, the findings, then remarks on the files and unused content.
pub fn problems(report: &Report) -> Vec<Problem> {
    let outline = Outline::new(report);
    let info = |message| Problem { severity: Severity::Info, message, tip: None };
    let first = match &report.error {
        Some(trouble) => trouble.into(),
        None => info(verdict_text(report, &outline)),
    };
    let findings = report.findings.iter().map(|finding| Problem {
        severity: finding.severity,
        message: finding_text(finding, &outline),
        tip: Some(finding.fix.clone()),
    });
    let notes = report.log.notes.iter().map(|row| format!("{}: {}", row.path.display(), row.note));
    let unused = outline.unused_streams().into_iter().map(|line| format!("not used: {line}"));
    let remarks = notes.chain(unused).map(info);
    std::iter::once(first).chain(findings).chain(remarks).collect()
}

impl From<&Trouble> for Problem {
    fn from(trouble: &Trouble) -> Self {
        let Trouble { place, what, remedy, .. } = trouble;
        Self {
            severity: Severity::Error,
            message: format!("{place}: {what}"),
            tip: Some(remedy.clone()),
        }
    }
}
