//! Report as GitHub Markdown for a pull request comment: verdict and causes first, the rest folded.
//!
//! Names from the log are escaped: they cannot end a table cell, start an HTML element or mention a user.

use std::io::{self, Write};

use super::amounts::format_estimate;
use super::outline::{FIX, Outline};
use super::{Report, Verdict, escape_direction};

/// Writes the report.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let outline = Outline::new(report);
    match &report.error {
        Some(trouble) => {
            writeln!(out, "### poseaudit: no audit\n")?;
            writeln!(out, "{}: {}\n", inline_code(&trouble.place), escape_prose(&trouble.what))?;
            writeln!(out, "**Fix**: {}\n", escape_prose(&trouble.remedy))?;
        }
        None => writeln!(
            out,
            "### poseaudit: {}, {}\n",
            report.verdict,
            escape_prose(&outline.verdict_reason())
        )?,
    }
    header(report, &outline, out)?;
    findings(report, &outline, out)?;
    // Without findings, the inconclusive checks matter most.
    write_details(
        "Inconclusive",
        outline.inconclusive_lines(),
        report.verdict == Verdict::Inconclusive,
        out,
    )?;
    write_details("Ignored", outline.ignored_findings(), true, out)?;
    write_details("Not used", outline.unused_streams(), false, out)?;
    write_details("Passed", outline.passed_checks().lines(), false, out)?;
    write_details("Skipped", outline.skipped_checks(), false, out)
}

fn header(report: &Report, outline: &Outline, out: &mut dyn Write) -> io::Result<()> {
    let files = report.log.files.iter().map(|file| inline_code(&file.path.display().to_string()));
    let files: Vec<String> = files.collect();
    let robots = report.robots.iter().map(|robot| {
        format!(
            "{}, {} → {}",
            inline_code(&robot.name),
            inline_code(&robot.base),
            inline_code(&robot.tip)
        )
    });
    let comparisons = report.comparisons.iter().map(|row| {
        format!("{} compared with {}", inline_code(&row.topic), inline_code(&row.reference))
    });
    let line = files.into_iter().chain(outline.extent()).chain(robots).chain(comparisons);
    let line: Vec<String> = line.collect();
    if !line.is_empty() {
        writeln!(out, "{}\n", line.join(" · "))?;
    }
    for note in &report.log.notes {
        let path = inline_code(&note.path.display().to_string());
        writeln!(out, "> {path}: {}\n", escape_prose(&note.note))?;
    }
    Ok(())
}

fn findings(report: &Report, outline: &Outline, out: &mut dyn Write) -> io::Result<()> {
    if report.findings.is_empty() {
        return Ok(());
    }
    writeln!(out, "| | where | what | amount ± 95 % | fix |")?;
    writeln!(out, "|---|---|---|---|---|")?;
    for group in outline.finding_groups() {
        let worst = group.findings[0];
        let (subject, message) = outline.group_title(&group);
        let subject = if subject.is_empty() { "the run".to_owned() } else { inline_code(&subject) };
        let amount = match (&worst.estimate, group.findings.len()) {
            (Some(estimate), 1) => escape_prose(&format_estimate(estimate)),
            _ => String::new(),
        };
        let (statements, more) = outline.group_lines(&group);
        let statements =
            statements.iter().map(|(subject, message)| format!("{subject}: {message}"));
        let more = (more > 0).then(|| format!("{more} more"));
        let notes = outline.group_notes(&group).into_iter();
        let (fixes, notes): (Vec<_>, Vec<_>) = notes.partition(|note| note.label == FIX);
        let lines = std::iter::once(message).chain(statements).chain(more);
        let lines = lines.chain(notes.into_iter().map(|note| note.text));
        let what = lines.map(|line| escape_prose(&line)).collect::<Vec<_>>().join("<br>");
        let fix =
            fixes.iter().map(|note| escape_prose(&note.text)).collect::<Vec<_>>().join("<br>");
        let (level, rule) = (worst.severity.name(), worst.code);
        writeln!(out, "| **{level}** {rule} | {subject} | {what} | {amount} | {fix} |")?;
    }
    writeln!(out)
}

fn write_details(
    title: &str,
    lines: Vec<String>,
    open: bool,
    out: &mut dyn Write,
) -> io::Result<()> {
    if lines.is_empty() {
        return Ok(());
    }
    let open = if open { " open" } else { "" };
    writeln!(out, "<details{open}><summary>{title}</summary>\n")?;
    for line in lines {
        writeln!(out, "- {}", escape_prose(&line))?;
    }
    writeln!(out, "\n</details>\n")
}

pub(crate) fn inline_code(name: &str) -> String {
    let is_tame = |c: char| c.is_ascii_alphanumeric() || "/_-. :,+=()".contains(c);
    let is_padded = name.starts_with(' ') || name.ends_with(' ');
    if !name.is_empty() && !is_padded && name.chars().all(is_tame) {
        return format!("`{name}`");
    }
    format!("<code>{}</code>", escape_prose(name))
}

/// No character keeps a meaning in Markdown or HTML.
pub(crate) fn escape_prose(text: &str) -> String {
    let text = escape_direction(text);
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
