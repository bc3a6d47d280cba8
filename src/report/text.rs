//! Report for people: the verdict, the causes, passed checks and inconclusive checks.
//!
//! The caller strips ANSI styles if colours are not supported.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};
use textwrap::{Options, WordSeparator, WordSplitter, WrapAlgorithm};

use super::outline::{AmountBound, Outline};
use super::{JointCoverage, Report, Verdict, WorkspaceRow, sanitize, sparkline};
use crate::finding::{Finding, Severity};

const LABEL_WIDTH: usize = 16;

/// Line width on a terminal.
const MIN_WIDTH: usize = 60;
const MAX_WIDTH: usize = 120;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const INFO: Style = AnsiColor::Cyan.on_default().bold();
const GOOD: Style = AnsiColor::Green.on_default().bold();
const STRONG: Style = Style::new().bold();
const QUIET: Style = Style::new().dimmed();

/// Writes one line per statement, so that it can be searched.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    TextReport::new(report, None).write(out)
}

/// Writes the report for a terminal of this width. Lines wrap between words and are indented to the labels.
pub fn write_within(report: &Report, columns: usize, out: &mut dyn Write) -> io::Result<()> {
    TextReport::new(report, Some(columns.clamp(MIN_WIDTH, MAX_WIDTH))).write(out)
}

struct TextReport<'a> {
    report: &'a Report,
    outline: Outline<'a>,
    /// `None` disables wrapping.
    columns: Option<usize>,
}

impl<'a> TextReport<'a> {
    fn new(report: &'a Report, columns: Option<usize>) -> Self {
        Self { report, outline: Outline::new(report), columns }
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        self.header(out)?;
        self.verdict(out)?;
        self.block(out, QUIET, "over time", sparkline::error_sparklines(self.report))?;
        for finding in &self.report.findings {
            writeln!(out)?;
            self.finding(finding, out)?;
        }
        if !self.report.checks.is_empty() {
            writeln!(out)?;
        }
        self.block(out, WARNING, "inconclusive", self.outline.inconclusive_by_action())?;
        self.block(out, WARNING, "", self.outline.unobservable_parameters())?;
        self.block(
            out,
            WARNING,
            "to settle",
            self.outline.recommended_motion().into_iter().collect(),
        )?;
        for plan in self.outline.plan_commands() {
            self.call(out, "", plan)?;
        }
        self.block(out, WARNING, "ignored", self.outline.ignored_findings())?;
        self.passed(out)?;
        let arms = self.report.workspace.iter().map(|arm| self.workspace(arm));
        self.block(out, QUIET, "workspace", arms.collect())?;
        self.block(out, QUIET, "unused", self.outline.unused_columns())?;
        self.block(out, QUIET, "skipped", self.outline.skipped_checks())?;
        self.hints(out)
    }

    fn header(&self, out: &mut dyn Write) -> io::Result<()> {
        let log = &self.report.log;
        for file in &log.files {
            let fetched = file.fetched().map_or(String::new(), |fetched| format!(", {fetched}"));
            self.line(out, STRONG, "log", &format!("{}{fetched}", file.path.display()))?;
        }
        // A note may repeat the error.
        let said = self.report.error.as_ref().map_or("", |trouble| trouble.what.as_str());
        for note in log.notes.iter().filter(|note| said.is_empty() || note.note != said) {
            let text = format!("{}: {}", note.path.display(), note.note);
            self.line(out, WARNING, "note", &text)?;
        }
        if let Some(extent) = self.outline.extent() {
            self.line(out, STRONG, "", &extent)?;
        }
        for robot in &self.report.robots {
            let (name, source) = (&robot.name, &robot.source);
            let (base, tip) = (&robot.base, &robot.tip);
            self.line(out, STRONG, "robot", &format!("{name}, {base} → {tip}, from {source}"))?;
        }
        if !log.files.is_empty() || !self.report.robots.is_empty() {
            writeln!(out)?;
        }
        Ok(())
    }

    fn verdict(&self, out: &mut dyn Write) -> io::Result<()> {
        if let Some(trouble) = &self.report.error {
            self.line(out, ERROR, "NO AUDIT", &format!("{}: {}", trouble.place, trouble.what))?;
            return self.styled(out, STRONG, "", &fix(&trouble.remedy));
        }
        let style = match self.report.verdict {
            Verdict::Fail => ERROR,
            Verdict::Pass => GOOD,
            Verdict::Inconclusive => WARNING,
        };
        self.line(out, style, &self.report.verdict.to_string(), &self.outline.verdict_reason())
    }

    fn finding(&self, finding: &Finding, out: &mut dyn Write) -> io::Result<()> {
        let style = match finding.severity {
            Severity::Error => ERROR,
            Severity::Warning => WARNING,
            Severity::Info => INFO,
        };
        let subject = self.outline.subject(&finding.subject);
        let subject = match sanitize(&subject) {
            whole if whole.is_empty() => String::new(),
            subject => format!("{STRONG}{subject}{STRONG:#}: "),
        };
        let label = format!("{} {}", finding.severity.name(), finding.code);
        self.styled(out, style, &label, &format!("{subject}{}", sanitize(&finding.message)))?;
        for line in self.outline.finding_notes(finding) {
            self.line(out, STRONG, "", &line)?;
        }
        self.styled(out, STRONG, "", &fix(&finding.fix))
    }

    fn passed(&self, out: &mut dyn Write) -> io::Result<()> {
        let passed = self.outline.passed_checks();
        let bounds: Vec<String> = passed.bounds.iter().map(AmountBound::sentence).collect();
        // Without wrapping, grep finds one line per item.
        let bounds = if self.columns.is_some() { self.lists(&bounds, "; ") } else { bounds };
        let lists = bounds.into_iter().chain(self.lists(&passed.whole, ", "));
        let texts = lists.chain(self.lists(&passed.partial, "; ")).chain(passed.remarks);
        self.block(out, GOOD, "passed", texts.collect())
    }

    fn workspace(&self, arm: &WorkspaceRow) -> String {
        let several = self.report.robots.len() > 1;
        let of = if several { format!("{}: ", arm.robot) } else { String::new() };
        let visited = |joint: &&JointCoverage| joint.visited.is_some();
        let share = |joint: &JointCoverage| joint.visited.unwrap_or(0.0);
        let mut joints: Vec<&JointCoverage> = arm.joints.iter().filter(visited).collect();
        joints.sort_by(|a, b| share(a).total_cmp(&share(b)));
        let [least_m, most_m] = arm.reach_m;
        let tip = format!(
            "tip {least_m:.2}–{most_m:.2} m from the base, which reaches {:.2} m",
            arm.max_reach_m
        );
        match joints.as_slice() {
            [least, .., most] => format!(
                "{of}joints moved over {:.0} % ({}) to {:.0} % ({}) of their ranges; {tip}",
                100.0 * share(least),
                least.joint,
                100.0 * share(most),
                most.joint
            ),
            _ => format!("{of}{tip}"),
        }
    }

    fn hints(&self, out: &mut dyn Write) -> io::Result<()> {
        let Some(first) = self.report.findings.first() else {
            return Ok(());
        };
        writeln!(out)?;
        self.call(out, "explain", &format!("poseaudit explain {}", first.code))?;
        self.call(out, "replay", &self.report.replay_command())
    }

    /// Never wraps, so that it can be copied.
    fn call(&self, out: &mut dyn Write, label: &str, call: &str) -> io::Result<()> {
        let blanks = " ".repeat(LABEL_WIDTH.saturating_sub(label.chars().count()).max(1));
        writeln!(out, "{QUIET}{label}{QUIET:#}{blanks}{}", sanitize(call))
    }

    fn block(
        &self,
        out: &mut dyn Write,
        style: Style,
        label: &str,
        texts: Vec<String>,
    ) -> io::Result<()> {
        let labels = [label].into_iter().chain(std::iter::repeat(""));
        labels.zip(&texts).try_for_each(|(label, text)| self.line(out, style, label, text))
    }

    fn line(&self, out: &mut dyn Write, style: Style, label: &str, text: &str) -> io::Result<()> {
        self.styled(out, style, label, &sanitize(text))
    }

    /// Like [`TextReport::line`] for a sanitized text with styles.
    fn styled(&self, out: &mut dyn Write, style: Style, label: &str, text: &str) -> io::Result<()> {
        let blanks = LABEL_WIDTH.saturating_sub(label.chars().count()).max(1);
        let head = match label {
            "" => " ".repeat(blanks),
            _ => format!("{style}{label}{style:#}{}", " ".repeat(blanks)),
        };
        let Some(columns) = self.columns else {
            return writeln!(out, "{head}{text}");
        };
        let indent = " ".repeat(LABEL_WIDTH);
        let options = Options::new(columns)
            .initial_indent(&head)
            .subsequent_indent(&indent)
            .break_words(false)
            .word_separator(WordSeparator::AsciiSpace)
            .word_splitter(WordSplitter::NoHyphenation)
            .wrap_algorithm(WrapAlgorithm::FirstFit);
        textwrap::wrap(text, options).iter().try_for_each(|line| writeln!(out, "{line}"))
    }

    fn lists(&self, items: &[String], separator: &str) -> Vec<String> {
        let width = self.columns.unwrap_or(usize::MAX);
        let mut lines: Vec<String> = Vec::new();
        for item in items {
            match lines.last_mut() {
                Some(last)
                    if LABEL_WIDTH
                        + last.chars().count()
                        + separator.len()
                        + item.chars().count()
                        < width =>
                {
                    last.push_str(separator);
                    last.push_str(item);
                }
                _ => lines.push(item.clone()),
            }
        }
        lines
    }
}

fn fix(text: &str) -> String {
    format!("{GOOD}fix{GOOD:#}  {}", sanitize(text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Trouble, TroubleKind};
    use textwrap::core::display_width;

    #[test]
    fn terminal_lines_fit_and_no_word_is_lost() {
        let report = Report::from_trouble(Trouble {
            kind: TroubleKind::Log,
            what: "nothing can be audited of what was recorded over there ".repeat(6),
            place: "a/folder/with a long name/and another/run.mcap".to_owned(),
            remedy: "record the joint states with a pose, /tf or an IMU ".repeat(4),
        });
        let text = |columns: Option<usize>| {
            let mut out = Vec::new();
            TextReport::new(&report, columns).write(&mut out).expect("a text");
            String::from_utf8(out).expect("UTF-8")
        };
        let words =
            |text: &str| -> Vec<String> { text.split_whitespace().map(str::to_owned).collect() };
        let whole = text(None);
        assert_eq!(whole.lines().count(), 2);
        for columns in [72, 97, 120] {
            let broken = text(Some(columns));
            assert!(broken.lines().count() > 6, "{broken}");
            assert!(broken.lines().all(|line| display_width(line) <= columns), "{broken}");
            assert!(broken.lines().skip(1).all(|line| line.starts_with(&" ".repeat(LABEL_WIDTH))));
            assert_eq!(words(&broken), words(&whole));
        }
    }
}
