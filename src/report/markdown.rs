//! Report as GitHub Markdown for a pull request comment: verdict and causes first, the rest folded.
//!
//! Names from the log are escaped: they cannot end a table cell, start an HTML element or mention a user.

use std::io::{self, Write};

use super::amounts::shown;
use super::outline::Outline;
use super::{Report, Verdict, upright};
use crate::finding::Finding;

/// Writes the report.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let says = Outline::of(report);
    match &report.error {
        Some(trouble) => {
            writeln!(out, "### poseaudit: no audit\n")?;
            writeln!(out, "{}: {}\n", code(&trouble.place), prose(&trouble.what))?;
            writeln!(out, "**Fix**: {}\n", prose(&trouble.remedy))?;
        }
        None => writeln!(out, "### poseaudit: {}, {}\n", report.verdict, prose(&says.why()))?,
    }
    header(report, &says, out)?;
    findings(report, &says, out)?;
    // Without findings, the inconclusive checks matter most.
    folded("Inconclusive", says.open_lines(), report.verdict == Verdict::Inconclusive, out)?;
    folded("Ignored", says.ignored(), true, out)?;
    folded("Passed", says.passed().lines(), false, out)?;
    folded("Skipped", says.skipped(), false, out)
}

fn header(report: &Report, says: &Outline, out: &mut dyn Write) -> io::Result<()> {
    let files = report.log.files.iter().map(|file| code(&file.path.display().to_string()));
    let files: Vec<String> = files.collect();
    let robots = report.robots.iter().map(|robot| {
        format!("{}, {} → {}", code(&robot.name), code(&robot.base), code(&robot.tip))
    });
    let line: Vec<String> = files.into_iter().chain(says.extent()).chain(robots).collect();
    if !line.is_empty() {
        writeln!(out, "{}\n", line.join(" · "))?;
    }
    for note in &report.log.notes {
        let path = code(&note.path.display().to_string());
        writeln!(out, "> {path}: {}\n", prose(&note.note))?;
    }
    Ok(())
}

fn findings(report: &Report, says: &Outline, out: &mut dyn Write) -> io::Result<()> {
    if report.findings.is_empty() {
        return Ok(());
    }
    writeln!(out, "| | where | what | amount ± 95 % | fix |")?;
    writeln!(out, "|---|---|---|---|---|")?;
    for finding in &report.findings {
        let subject = says.subject(&finding.subject);
        let subject = if subject.is_empty() { "the run".to_owned() } else { code(&subject) };
        let amount = finding.estimate.as_ref().map_or(String::new(), |it| prose(&shown(it)));
        let what = what(finding, says);
        let (level, rule, fix) = (finding.severity.name(), finding.code, prose(&finding.fix));
        writeln!(out, "| **{level}** {rule} | {subject} | {what} | {amount} | {fix} |")?;
    }
    writeln!(out)
}

/// Message with effect and confounders.
fn what(finding: &Finding, says: &Outline) -> String {
    let lines = std::iter::once(finding.message.clone()).chain(says.about(finding));
    lines.map(|line| prose(&line)).collect::<Vec<_>>().join("<br>")
}

/// Collapsible section.
fn folded(title: &str, lines: Vec<String>, open: bool, out: &mut dyn Write) -> io::Result<()> {
    if lines.is_empty() {
        return Ok(());
    }
    let open = if open { " open" } else { "" };
    writeln!(out, "<details{open}><summary>{title}</summary>\n")?;
    for line in lines {
        writeln!(out, "- {}", prose(&line))?;
    }
    writeln!(out, "\n</details>\n")
}

/// Inline code.
pub(crate) fn code(name: &str) -> String {
    let is_tame = |c: char| c.is_ascii_alphanumeric() || "/_-. :,+=()".contains(c);
    let is_padded = name.starts_with(' ') || name.ends_with(' ');
    if !name.is_empty() && !is_padded && name.chars().all(is_tame) {
        return format!("`{name}`");
    }
    format!("<code>{}</code>", prose(name))
}

/// No character keeps a meaning in Markdown or HTML.
pub(crate) fn prose(text: &str) -> String {
    let text = upright(text);
    let mut escaped = String::with_capacity(text.len());
    let mut before = ' ';
    let mut rest = text.chars().peekable();
    while let Some(c) = rest.next() {
        let is_between_words =
            before.is_alphanumeric() && rest.peek().is_some_and(|after| after.is_alphanumeric());
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            // References are safe in a table cell even after backslashes.
            '|' => escaped.push_str("&#124;"),
            '\\' => escaped.push_str("&#92;"),
            // Breaks a mention or the start of a link.
            '@' => escaped.push_str("@\u{200b}"),
            ':' if rest.peek() == Some(&'/') => escaped.push_str("&#58;"),
            '_' if is_between_words => escaped.push('_'),
            '`' | '*' | '_' | '[' | ']' | '~' | '#' | '$' | '!' => escaped.extend(['\\', c]),
            c if c.is_control() => escaped.push(' '),
            c => escaped.push(c),
        }
        before = c;
    }
    escaped
}
