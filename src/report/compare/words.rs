//! Comparison as terminal text and Markdown.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};

use super::{Change, Comparison, Course, Lost};
use crate::finding::{Estimate, Finding, Subject};
use crate::report::{amounts, markdown as md, tame};

const LABEL: usize = 16;

const THE_RUN: &str = "the run";

const BAD: Style = AnsiColor::Red.on_default().bold();
const DOUBTFUL: Style = AnsiColor::Yellow.on_default().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const QUIET: Style = Style::new().dimmed();

impl Course {
    const fn name(self) -> &'static str {
        match self {
            Course::Appeared => "new",
            Course::Grew => "worse",
            Course::Changed => "changed",
            Course::Same => "same",
            Course::Shrank => "smaller",
            Course::Untold => "inconclusive",
            Course::Gone => "fixed",
        }
    }
}

/// Writes the comparison for a terminal.
pub fn text(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let [old, new] = comparison.verdicts;
    line(out, Style::new().bold(), "verdict", &format!("{old} → {new}"))?;
    let (style, label) = match comparison.regression {
        true => (BAD, "REGRESSION"),
        false => (GOOD, "NO REGRESSION"),
    };
    line(out, style, label, &comparison.why())?;
    if !comparison.causes.is_empty() {
        writeln!(out)?;
    }
    for change in &comparison.causes {
        let style = match change.course {
            _ if change.regression => BAD,
            Course::Gone | Course::Shrank => GOOD,
            Course::Same => QUIET,
            _ => DOUBTFUL,
        };
        let whom = comparison.whom(&change.subject);
        let text = format!("{} {whom}: {}", change.code, change.words());
        line(out, style, change.course.name(), &text)?;
    }
    if !comparison.lost.is_empty() {
        writeln!(out)?;
    }
    for lost in &comparison.lost {
        line(out, DOUBTFUL, "inconclusive", &comparison.lost_words(lost))?;
    }
    Ok(())
}

/// Writes the comparison as GitHub Markdown.
pub fn markdown(comparison: &Comparison, out: &mut dyn Write) -> io::Result<()> {
    let title = if comparison.regression { "regression" } else { "no regression" };
    let [old, new] = comparison.verdicts;
    writeln!(out, "### poseaudit: {title}, {}\n", md::prose(&comparison.why()))?;
    writeln!(out, "Verdict: {old} → {new}\n")?;
    if !comparison.causes.is_empty() {
        writeln!(out, "| | rule | where | what |\n|---|---|---|---|")?;
    }
    for change in &comparison.causes {
        let course = change.course.name();
        let course = if change.regression { format!("**{course}**") } else { course.to_owned() };
        let whom = match comparison.whom(&change.subject) {
            whom if whom == THE_RUN => whom,
            name => md::code(&name),
        };
        let what = md::prose(&change.words());
        writeln!(out, "| {course} | {} | {whom} | {what} |", change.code)?;
    }
    if !comparison.causes.is_empty() {
        writeln!(out)?;
    }
    if !comparison.lost.is_empty() {
        writeln!(out, "<details><summary>Passed before, inconclusive now</summary>\n")?;
        for lost in &comparison.lost {
            writeln!(out, "- {}", md::prose(&comparison.lost_words(lost)))?;
        }
        writeln!(out, "\n</details>")?;
    }
    Ok(())
}

impl Comparison {
    /// `1 new, 2 fixed`, with other reasons for a regression.
    fn why(&self) -> String {
        let courses = [
            Course::Appeared,
            Course::Grew,
            Course::Changed,
            Course::Same,
            Course::Shrank,
            Course::Untold,
            Course::Gone,
        ];
        let counts = courses.into_iter().filter_map(|course| {
            let count = self.causes.iter().filter(|change| change.course == course).count();
            (count > 0).then(|| format!("{count} {}", course.name()))
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
    fn whom(&self, subject: &Subject) -> String {
        let causes = self.causes.iter().map(|change| &change.subject);
        let subjects = causes.chain(self.lost.iter().map(|lost| &lost.subject));
        let mut robots = subjects.filter_map(|subject| subject.robot.as_deref());
        let first = robots.next();
        let several = robots.any(|robot| Some(robot) != first);
        match subject.label_among(several) {
            whole if whole.is_empty() => THE_RUN.to_owned(),
            label => label,
        }
    }

    fn lost_words(&self, lost: &Lost) -> String {
        let (code, whom) = (&lost.code, self.whom(&lost.subject));
        let reason = lost.reason.as_deref().unwrap_or_default();
        format!("{code} on {whom} passed, now {}: {reason}", lost.status.name())
    }
}

impl Change {
    fn words(&self) -> String {
        match (&self.old, &self.new) {
            (Some(old), Some(new)) if self.course != Course::Same => {
                format!("{} → {}", short(old), short(new))
            }
            (_, Some(new)) => format!("{} {}", new.severity.name(), new.message),
            (Some(old), None) => {
                let now = match (self.course, &self.reason) {
                    (Course::Gone, _) => "fixed".to_owned(),
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
fn short(finding: &Finding) -> String {
    let is_known = |estimate: &&Estimate| estimate.value().is_none_or(f64::is_finite);
    let amount = finding.estimate.as_ref().filter(is_known);
    let said = amount.map_or_else(|| finding.message.clone(), amounts::shown);
    format!("{} {said}", finding.severity.name())
}

fn line(out: &mut dyn Write, style: Style, label: &str, text: &str) -> io::Result<()> {
    let blanks = LABEL.saturating_sub(label.chars().count()).max(1);
    writeln!(out, "{style}{label}{style:#}{:blanks$}{}", "", tame(text))
}
