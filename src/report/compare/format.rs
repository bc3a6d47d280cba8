//! Comparison as terminal text and Markdown.

use std::io::{self, Write};

use super::{Change, ChangeKind, Comparison, LostCheck};
use crate::finding::{Estimate, Finding, Subject};
use crate::report::styles::{ERROR, GOOD, QUIET, STRONG, WARNING, write_line};
use crate::report::{amounts, markdown as md};

const WHOLE_RUN: &str = "the run";

impl ChangeKind {
    const fn name(self) -> &'static str {
        match self {
            ChangeKind::Appeared => "new",
            ChangeKind::Grew => "worse",
            ChangeKind::Changed => "changed",
            ChangeKind::Same => "same",
            ChangeKind::Shrank => "smaller",
            ChangeKind::Undetermined => "inconclusive",
            ChangeKind::Gone => "fixed",
        }
    }
}

/// Writes the comparison for a terminal.
pub fn text(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let [old, new] = comparison.verdicts;
    write_line(out, STRONG, "verdict", &format!("{old} → {new}"))?;
    let (style, label) = match comparison.regression {
        true => (ERROR, "REGRESSION"),
        false => (GOOD, "NO REGRESSION"),
    };
    write_line(out, style, label, &comparison.summary())?;
    if !comparison.causes.is_empty() {
        writeln!(out)?;
    }
    for change in &comparison.causes {
        let style = match change.kind {
            _ if change.regression => ERROR,
            ChangeKind::Gone | ChangeKind::Shrank => GOOD,
            ChangeKind::Same => QUIET,
            _ => WARNING,
        };
        let subject = comparison.subject_text(&change.subject);
        let text = format!("{} {subject}: {}", change.code, change.text());
        write_line(out, style, change.kind.name(), &text)?;
    }
    if !comparison.lost.is_empty() {
        writeln!(out)?;
    }
    for lost in &comparison.lost {
        write_line(out, WARNING, "inconclusive", &comparison.lost_text(lost))?;
    }
    Ok(())
}

/// Writes the comparison as GitHub Markdown.
pub fn markdown(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let title = if comparison.regression { "regression" } else { "no regression" };
    let [old, new] = comparison.verdicts;
    writeln!(out, "### poseaudit: {title}, {}\n", md::escape_prose(&comparison.summary()))?;
    writeln!(out, "Verdict: {old} → {new}\n")?;
    if !comparison.causes.is_empty() {
        writeln!(out, "| | rule | where | what |\n|---|---|---|---|")?;
    }
    for change in &comparison.causes {
        let kind = change.kind.name();
        let kind = if change.regression { format!("**{kind}**") } else { kind.to_owned() };
        let subject = match comparison.subject_text(&change.subject) {
            subject if subject == WHOLE_RUN => subject,
            name => md::inline_code(&name),
        };
        let what = md::escape_prose(&change.text());
        writeln!(out, "| {kind} | {} | {subject} | {what} |", change.code)?;
    }
    if !comparison.causes.is_empty() {
        writeln!(out)?;
    }
    if !comparison.lost.is_empty() {
        writeln!(out, "<details><summary>Passed before, inconclusive now</summary>\n")?;
        for lost in &comparison.lost {
            writeln!(out, "- {}", md::escape_prose(&comparison.lost_text(lost)))?;
        }
        writeln!(out, "\n</details>")?;
    }
    Ok(())
}

impl Comparison {
    /// `1 new, 2 fixed`, with other reasons for a regression.
    fn summary(&self) -> String {
        let courses = [
            ChangeKind::Appeared,
            ChangeKind::Grew,
            ChangeKind::Changed,
            ChangeKind::Same,
            ChangeKind::Shrank,
            ChangeKind::Undetermined,
            ChangeKind::Gone,
        ];
        let counts = courses.into_iter().filter_map(|kind| {
            let count = self.causes.iter().filter(|change| change.kind == kind).count();
            (count > 0).then(|| format!("{count} {}", kind.name()))
        });
        let error = self.error.iter().map(|what| format!("the new log was not audited: {what}"));
        let lost = match self.lost.len() {
            0 => None,
            1 => Some("1 check that passed is inconclusive now".to_owned()),
            many => Some(format!("{many} checks that passed are inconclusive now")),
        };
        let all: Vec<String> = error.chain(counts).chain(lost).collect();
        if all.is_empty() { "no problems before or now".to_owned() } else { all.join(", ") }
    }

    /// With the robot if there are several.
    fn subject_text(&self, subject: &Subject) -> String {
        let causes = self.causes.iter().map(|change| &change.subject);
        let subjects = causes.chain(self.lost.iter().map(|lost| &lost.subject));
        let mut robots = subjects.filter_map(|subject| subject.robot.as_deref());
        let first = robots.next();
        let several = robots.any(|robot| Some(robot) != first);
        match subject.label_among(several) {
            whole if whole.is_empty() => WHOLE_RUN.to_owned(),
            label => label,
        }
    }

    fn lost_text(&self, lost: &LostCheck) -> String {
        let (code, subject) = (&lost.code, self.subject_text(&lost.subject));
        let reason = lost.reason.as_deref().unwrap_or_default();
        format!("{code} on {subject} passed, now {}: {reason}", lost.status.name())
    }
}

impl Change {
    fn text(&self) -> String {
        match (&self.old, &self.new) {
            (Some(old), Some(new)) if self.kind != ChangeKind::Same => {
                format!("{} → {}", amount_or_message(old), amount_or_message(new))
            }
            (_, Some(new)) => format!("{} {}", new.severity.name(), new.message),
            (Some(old), None) => {
                let now = match (self.kind, &self.reason) {
                    (ChangeKind::Gone, _) => "fixed".to_owned(),
                    (_, Some(reason)) => format!("now inconclusive: {reason}"),
                    (_, None) => "now inconclusive".to_owned(),
                };
                format!("{} {}; {now}", old.severity.name(), old.message)
            }
            (None, None) => String::new(),
        }
    }
}

/// Amount of the finding, or else its message.
fn amount_or_message(finding: &Finding) -> String {
    let is_known = |estimate: &&Estimate| estimate.value().is_none_or(f64::is_finite);
    let amount = finding.estimate.as_ref().filter(is_known);
    let said = amount.map_or_else(|| finding.message.clone(), amounts::format_estimate);
    format!("{} {said}", finding.severity.name())
}
