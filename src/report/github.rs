//! Report as workflow commands, which GitHub shows as annotations: the first ten of each level, so they are
//! sorted by severity.

use std::io::{self, Write};

use super::Report;
use super::outline::Outline;
use crate::finding::{Finding, Severity};

/// Writes an annotation per finding, and one for the verdict.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let outline = Outline::new(report);
    let file = report.log.files.first().map(|file| file.path.display().to_string());
    for finding in &report.findings {
        let subject = outline.subject(&finding.subject);
        let title = match subject.as_str() {
            "" => format!("{} {}", finding.code, finding.title),
            subject => format!("{} {subject}: {}", finding.code, finding.title),
        };
        command(
            out,
            level(finding.severity),
            file.as_deref(),
            &title,
            &message(&outline, finding),
        )?;
    }
    if let Some(trouble) = &report.error {
        let text = format!("{}: {}\nfix: {}", trouble.place, trouble.what, trouble.remedy);
        let file = report.main_file().map(|file| file.display().to_string());
        return command(out, "error", file.as_deref(), "poseaudit: no audit", &text);
    }
    let verdict = format!("poseaudit: {}", report.verdict);
    let ignored =
        outline.ignored_findings().into_iter().map(|known| format!("ignored: {known}")).collect();
    let lines = [vec![outline.verdict_reason()], outline.inconclusive_lines(), ignored].concat();
    command(out, "notice", file.as_deref(), &verdict, &lines.join("\n"))
}

fn message(outline: &Outline, finding: &Finding) -> String {
    let fix = format!("fix: {}", finding.fix);
    [vec![finding.message.clone()], outline.finding_lines(finding), vec![fix]].concat().join("\n")
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
        Severity::Info => "notice",
    }
}

/// Writes `::level file=…,title=…::message`.
fn command(
    out: &mut dyn Write,
    level: &str,
    file: Option<&str>,
    title: &str,
    message: &str,
) -> io::Result<()> {
    let file = file.map_or(String::new(), |file| format!("file={},", property(file)));
    writeln!(out, "::{level} {file}title={}::{}", property(title), data(message))
}

/// A message ends at a line break.
fn data(text: &str) -> String {
    text.replace('%', "%25").replace('\r', "%0D").replace('\n', "%0A")
}

/// A value also ends at a colon or a comma.
fn property(text: &str) -> String {
    data(text).replace(':', "%3A").replace(',', "%2C")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_escaped_in_properties_and_commands() {
        let hostile = "50 %, a:b\r\n::error::no";
        let mut out = Vec::new();
        command(&mut out, "warning", Some("a,b.mcap"), hostile, hostile).expect("a text");
        let text = String::from_utf8(out).expect("UTF-8");
        assert_eq!(
            text,
            "::warning file=a%2Cb.mcap,title=50 %25%2C a%3Ab%0D%0A%3A%3Aerror%3A%3Ano::\
             50 %25, a:b%0D%0A::error::no\n"
        );
    }
}
