//! The report for a person at a bench: the verdict, the causes, what passed and what could not be
//! told.
//!
//! Styles are written as ANSI sequences; whoever opens `out` strips them where nobody would see
//! colours.

use std::collections::BTreeSet;
use std::io::{self, Write};

use anstyle::{AnsiColor, Style};

use super::{JointCoverage, Report, Verdict};
use crate::finding::{
    Alternative, CheckRow, Estimate, Finding, Ignored, Severity, Status, Subject, Unit,
};

/// Width of the column of labels.
const LABEL: usize = 16;

/// Lists are broken before this column.
const WIDTH: usize = 100;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const INFO: Style = AnsiColor::Cyan.on_default().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const STRONG: Style = Style::new().bold();
const QUIET: Style = Style::new().dimmed();

/// Writes the report.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    let page = Page { report, robots: report.robots.len() > 1 };
    page.header(out)?;
    page.verdict(out)?;
    for finding in &report.findings {
        writeln!(out)?;
        page.finding(finding, out)?;
    }
    if !report.checks.is_empty() {
        writeln!(out)?;
    }
    page.ignored(out)?;
    page.passed(out)?;
    page.could_not_tell(out)?;
    page.cannot_show(out)?;
    page.workspace(out)?;
    page.skipped(out)?;
    page.hints(out)
}

struct Page<'a> {
    report: &'a Report,
    /// Whether there are several robots, so that subjects must say which.
    robots: bool,
}

impl Page<'_> {
    fn header(&self, out: &mut dyn Write) -> io::Result<()> {
        let log = &self.report.log;
        for file in &log.files {
            line(out, STRONG, "log", &file.path.display().to_string())?;
        }
        for note in &log.notes {
            line(out, WARNING, "note", &format!("{}: {}", note.path.display(), note.note))?;
        }
        if let Some(duration_s) = log.duration_s {
            let (messages, topics) = (grouped(log.messages), self.topics());
            line(
                out,
                STRONG,
                "",
                &format!("{duration_s:.1} s, {messages} messages, {topics} topics"),
            )?;
        }
        for robot in &self.report.robots {
            let (name, source) = (&robot.name, &robot.source);
            let (base, tip) = (&robot.base, &robot.tip);
            line(out, STRONG, "robot", &format!("{name}, {base} → {tip}, from {source}"))?;
        }
        if !log.files.is_empty() || !self.report.robots.is_empty() {
            writeln!(out)?;
        }
        Ok(())
    }

    fn topics(&self) -> usize {
        let topics = self.report.streams.iter().map(|stream| stream.topic.as_str());
        topics.collect::<BTreeSet<_>>().len()
    }

    fn verdict(&self, out: &mut dyn Write) -> io::Result<()> {
        if let Some(trouble) = &self.report.error {
            line(out, ERROR, "NO AUDIT", &format!("{}: {}", trouble.place, trouble.what))?;
            return line(out, STRONG, "", &fix(&trouble.remedy));
        }
        let (style, words) = match self.report.verdict {
            Verdict::Fail => (ERROR, self.counts()),
            Verdict::Pass if self.report.findings.is_empty() => (GOOD, "nothing wrong".to_owned()),
            Verdict::Pass => (GOOD, self.counts()),
            Verdict::Inconclusive => (WARNING, format!("could not tell {}", self.undecided())),
        };
        line(out, style, &self.report.verdict.to_string(), &words)
    }

    /// `3 errors, 1 warning`.
    fn counts(&self) -> String {
        let severities = [Severity::Error, Severity::Warning, Severity::Info];
        let counts = severities.into_iter().filter_map(|severity| {
            let findings = self.report.findings.iter();
            match findings.filter(|finding| finding.severity == severity).count() {
                0 => None,
                1 => Some(format!("1 {}", severity.name())),
                many if severity == Severity::Info => Some(format!("{many} {}", severity.name())),
                many => Some(format!("{many} {}s", severity.name())),
            }
        });
        counts.collect::<Vec<_>>().join(", ")
    }

    /// The headline rules that decided nothing.
    fn undecided(&self) -> String {
        let rules = crate::checks::registry().iter().filter(|rule| rule.headline);
        let undecided = rules.filter(|rule| {
            let rows: Vec<_> = self.rows(rule.code).collect();
            rows.iter().any(|row| row.status == Status::Inconclusive)
                && !rows.iter().any(|row| row.status.is_decided())
        });
        let named = undecided.map(|rule| format!("{} ({})", rule.code, rule.name));
        named.collect::<Vec<_>>().join(", ")
    }

    fn rows(&self, code: &str) -> impl Iterator<Item = &CheckRow> {
        self.report.checks.iter().filter(move |row| row.code == code)
    }

    fn finding(&self, finding: &Finding, out: &mut dyn Write) -> io::Result<()> {
        let style = match finding.severity {
            Severity::Error => ERROR,
            Severity::Warning => WARNING,
            Severity::Info => INFO,
        };
        let subject = self.subject(&finding.subject);
        let subject =
            if subject.is_empty() { subject } else { format!("{STRONG}{subject}{STRONG:#}: ") };
        let label = format!("{} {}", finding.severity.name(), finding.code);
        line(out, style, &label, &format!("{subject}{}", finding.message))?;
        if let Some(effect) = &finding.evidence.effect {
            line(out, STRONG, "", effect)?;
        }
        if let Some(meaning) = finding.evidence.more.get("meaning").and_then(|it| it.as_str()) {
            line(out, STRONG, "", meaning)?;
        }
        let others = &finding.evidence.indistinguishable;
        if !others.is_empty() {
            let others: Vec<String> = others.iter().map(|other| self.alternative(other)).collect();
            line(out, STRONG, "", &format!("cannot be told from {}", others.join(", ")))?;
        }
        line(out, STRONG, "", &fix(&finding.fix))
    }

    fn alternative(&self, other: &Alternative) -> String {
        let amount = match &other.estimate {
            Some(Estimate::Amount { value, unit, .. }) => {
                let unit = [Unit::Metre, Unit::Radian, Unit::Second]
                    .into_iter()
                    .find(|u| u.symbol() == *unit);
                unit.map_or(String::new(), |unit| format!(" ({})", unit.show(*value)))
            }
            _ => String::new(),
        };
        format!("{} on {}{amount}", other.code, self.subject(&other.subject))
    }

    fn subject(&self, subject: &Subject) -> String {
        match &subject.robot {
            Some(robot) if self.robots => format!("{robot} {}", subject.label()),
            _ => subject.label().to_owned(),
        }
    }

    /// What the caller knows and does not want counted.
    fn ignored(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut label = "ignored";
        for Ignored { finding, reason, place } in &self.report.ignored {
            let (code, subject) = (finding.code, self.subject(&finding.subject));
            let on = if subject.is_empty() { String::new() } else { format!(" on {subject}") };
            let message = &finding.message;
            line(out, WARNING, label, &format!("{code}{on}: {message} ({reason}; {place})"))?;
            label = "";
        }
        Ok(())
    }

    fn passed(&self, out: &mut dyn Write) -> io::Result<()> {
        let (mut whole, mut parts, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
        for code in self.codes() {
            let asked = self.rows(code).filter(|row| row.status != Status::Skipped);
            let passed: Vec<&CheckRow> =
                self.rows(code).filter(|row| row.status == Status::Pass).collect();
            if passed.is_empty() {
                continue;
            }
            let (plain, remarked): (Vec<&CheckRow>, Vec<&CheckRow>) =
                passed.iter().copied().partition(|row| row.reason.is_none());
            if plain.len() == asked.count() {
                whole.push(code);
            } else if !plain.is_empty() {
                parts.push(format!("{code} on {}", self.subjects(&plain)));
            }
            remarks.extend(remarked.iter().filter_map(|row| {
                Some(format!("{code} on {}: {}", self.subject(&row.subject), row.reason.as_ref()?))
            }));
        }
        let mut label = "passed";
        let lists = wrapped(&ranges(&whole), ", ").into_iter().chain(wrapped(&parts, "; "));
        for text in lists.chain(remarks) {
            line(out, GOOD, label, &text)?;
            label = "";
        }
        Ok(())
    }

    fn could_not_tell(&self, out: &mut dyn Write) -> io::Result<()> {
        let rows = self.report.checks.iter().filter(|row| row.status == Status::Inconclusive);
        let groups = grouped_by(rows, |row| (row.code, row.reason.as_deref()));
        let mut label = "could not tell";
        for ((code, reason), rows) in groups {
            let text =
                format!("{code} on {}: {}", self.subjects(&rows), reason.unwrap_or_default());
            line(out, WARNING, label, &text)?;
            label = "";
        }
        Ok(())
    }

    /// What the motion shows only together, a line for what would be told apart together.
    fn cannot_show(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut label = "cannot show";
        for stream in &self.report.observability {
            for blind in &stream.together {
                line(out, WARNING, label, &blind.sentence(&stream.topic))?;
                label = "";
            }
        }
        Ok(())
    }

    /// How far the joints and the tip moved, a line an arm.
    fn workspace(&self, out: &mut dyn Write) -> io::Result<()> {
        for arm in &self.report.workspace {
            let of = if self.robots { format!("{}: ", arm.robot) } else { String::new() };
            let visited = |joint: &&JointCoverage| joint.visited.is_some();
            let share = |joint: &JointCoverage| joint.visited.unwrap_or(0.0);
            let mut joints: Vec<&JointCoverage> = arm.joints.iter().filter(visited).collect();
            joints.sort_by(|a, b| share(a).total_cmp(&share(b)));
            let [least_m, most_m] = arm.reach_m;
            let tip = format!(
                "tip {least_m:.2}–{most_m:.2} m from the base, which reaches {:.2} m",
                arm.max_reach_m
            );
            let text = match joints.as_slice() {
                [least, .., most] => format!(
                    "{of}joints moved over {:.0} % ({}) to {:.0} % ({}) of their ranges; {tip}",
                    100.0 * share(least),
                    least.joint,
                    100.0 * share(most),
                    most.joint
                ),
                _ => format!("{of}{tip}"),
            };
            line(out, QUIET, "workspace", &text)?;
        }
        Ok(())
    }

    fn skipped(&self, out: &mut dyn Write) -> io::Result<()> {
        let is_said = |row: &&CheckRow| {
            let known = self.report.ignored.iter().map(|known| &known.finding);
            known.into_iter().any(|it| it.code == row.code && it.subject == row.subject)
        };
        let skipped = self.report.checks.iter().filter(|row| row.status == Status::Skipped);
        let rows = skipped.filter(|row| !is_said(row));
        let mut label = "skipped";
        for (reason, rows) in grouped_by(rows, |row| row.reason.as_deref()) {
            let mut codes: Vec<&str> = rows.iter().map(|row| row.code).collect();
            codes.dedup();
            let said = self.report.error.as_ref().map(|trouble| trouble.what.as_str());
            let reason = if reason == said { "as said above" } else { reason.unwrap_or_default() };
            line(out, QUIET, label, &format!("{}: {reason}", ranges(&codes).join(", ")))?;
            label = "";
        }
        Ok(())
    }

    fn hints(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(first) = self.report.findings.first() else {
            return Ok(());
        };
        let explain = format!("poseaudit explain {}", first.code);
        let replay = "poseaudit audit … --rrd run.rrd";
        let width = replay.chars().count();
        writeln!(out)?;
        writeln!(out, "{QUIET}{explain:<width$}    what it means, when it misleads{QUIET:#}")?;
        writeln!(out, "{QUIET}{replay:<width$}    replay it in the viewer{QUIET:#}")
    }

    /// The codes of all rows, in their order.
    fn codes(&self) -> Vec<&'static str> {
        let mut codes: Vec<&str> = self.report.checks.iter().map(|row| row.code).collect();
        codes.dedup();
        codes
    }

    fn subjects(&self, rows: &[&CheckRow]) -> String {
        let subjects = rows.iter().map(|row| self.subject(&row.subject));
        subjects.collect::<Vec<_>>().join(", ")
    }
}

/// Writes one line with its label, which may be empty.
fn line(out: &mut dyn Write, style: Style, label: &str, text: &str) -> io::Result<()> {
    let blanks = LABEL.saturating_sub(label.chars().count()).max(1);
    match label {
        "" => writeln!(out, "{:blanks$}{text}", ""),
        _ => writeln!(out, "{style}{label}{style:#}{:blanks$}{text}", ""),
    }
}

fn fix(text: &str) -> String {
    format!("{GOOD}fix{GOOD:#}  {text}")
}

/// A count with its digits in groups of three.
fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (place, digit) in digits.chars().enumerate() {
        if place > 0 && (digits.len() - place).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    text
}

/// Rows in groups of equal key, in the order in which keys first come.
fn grouped_by<'a, K: PartialEq>(
    rows: impl Iterator<Item = &'a CheckRow>,
    key: impl Fn(&'a CheckRow) -> K,
) -> Vec<(K, Vec<&'a CheckRow>)> {
    let mut groups: Vec<(K, Vec<&CheckRow>)> = Vec::new();
    for row in rows {
        let key = key(row);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, rows)) => rows.push(row),
            None => groups.push((key, vec![row])),
        }
    }
    groups
}

/// Codes with runs of three and more written as `ORD002–005`.
fn ranges(codes: &[&str]) -> Vec<String> {
    let split = |code: &str| -> Option<(String, u32)> {
        let (family, number) = code.split_at_checked(3)?;
        Some((family.to_owned(), number.parse().ok()?))
    };
    let follows = |a: &&str, b: &&str| match (split(a), split(b)) {
        (Some((a_family, a)), Some((b_family, b))) => a_family == b_family && b == a + 1,
        _ => false,
    };
    let mut texts = Vec::new();
    for run in codes.chunk_by(follows) {
        match run {
            [first, _, .., last] => texts.push(format!("{first}–{}", &last[3..])),
            run => texts.extend(run.iter().map(|&code| code.to_owned())),
        }
    }
    texts
}

/// `items` joined by `separator`, broken into lines that fit beside the labels.
fn wrapped(items: &[String], separator: &str) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for item in items {
        match lines.last_mut() {
            Some(last)
                if LABEL + last.chars().count() + separator.len() + item.chars().count()
                    < WIDTH =>
            {
                last.push_str(separator);
                last.push_str(item);
            }
            _ => lines.push(item.clone()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_read_in_threes() {
        assert_eq!(["1", "999", "20 001", "1 234 567"], [1, 999, 20_001, 1_234_567].map(grouped));
    }

    #[test]
    fn runs_of_codes_are_short() {
        let codes = ["FRM001", "FRM002", "ORD002", "ORD003", "ORD004", "ORD005", "ORD008"];
        assert_eq!(ranges(&codes), ["FRM001", "FRM002", "ORD002–005", "ORD008"]);
    }
}
