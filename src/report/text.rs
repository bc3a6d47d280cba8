//! Report for people: the findings, the untested checks, and the verdict as the last block. In verbose mode also
//! every check.
//!
//! The caller strips ANSI styles if colours are not supported.

mod details;
mod lines;

use std::io::{self, Write};

use self::lines::Lines;
use super::outline::{AmountBound, FIX, FindingGroup, OpenChecks, Outline};
use super::styles::{ERROR, STRONG, severity_style, verdict_style};
use super::{Report, Verdict, sanitize, sparkline};

/// Line width on a terminal.
const MIN_WIDTH: usize = 60;
const MAX_WIDTH: usize = 120;

/// Of `  impact  `.
const NOTE_INDENT: usize = 10;
/// Of `  untested  `.
const VERDICT_INDENT: usize = 12;

/// Without verbose mode.
const MAX_NOTES: usize = 3;
const MAX_SPARKLINES: usize = 3;
const MAX_UNTESTED: usize = 4;
const MAX_UNUSED: usize = 3;

/// Writes one line per statement, so that it can be searched.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    TextReport::new(report).write(&mut Lines { out, columns: None })
}

/// Writes the report for a terminal of this width. Lines wrap between words and are indented to the labels.
pub fn write_within(report: &Report, columns: usize, out: &mut dyn Write) -> io::Result<()> {
    let columns = Some(columns.clamp(MIN_WIDTH, MAX_WIDTH));
    TextReport::new(report).write(&mut Lines { out, columns })
}

struct TextReport<'a> {
    report: &'a Report,
    outline: Outline<'a>,
}

impl<'a> TextReport<'a> {
    fn new(report: &'a Report) -> Self {
        Self { report, outline: Outline::new(report) }
    }

    fn write(&self, out: &mut Lines<'_>) -> io::Result<()> {
        self.header(out)?;
        for group in self.outline.finding_groups() {
            self.finding(&group, out)?;
            out.blank()?;
        }
        let sparklines = sparkline::error_sparklines(self.report);
        if !sparklines.is_empty() {
            self.shortened(out, ("", 2), sparklines, MAX_SPARKLINES)?;
            out.blank()?;
        }
        if self.report.is_verbose {
            self.details(out)?;
        } else {
            for (label, texts) in [
                ("ignored", self.outline.ignored_findings()),
                ("unused", self.outline.unused_streams()),
            ] {
                if !texts.is_empty() {
                    self.shortened(out, (label, VERDICT_INDENT), texts, MAX_UNUSED)?;
                    out.blank()?;
                }
            }
        }
        match &self.report.error {
            Some(trouble) => {
                let text = sanitize(&format!("{}: {}", trouble.place, trouble.what)).into_owned();
                out.line(&format!("{ERROR}NO AUDIT{ERROR:#}  "), 2, &text)?;
                out.note(FIX, NOTE_INDENT, &trouble.remedy)?;
                if self.report.fails_without_arm() {
                    let why = "exit status 1: the findings above need no arm";
                    return out.line("  ", 2, why);
                }
                Ok(())
            }
            None => self.verdict(out),
        }
    }

    fn header(&self, out: &mut Lines<'_>) -> io::Result<()> {
        let log = &self.report.log;
        let extent = self.outline.extent().unwrap_or_default();
        for (index, file) in log.files.iter().enumerate() {
            let fetched = file.fetched().map_or(String::new(), |fetched| format!(", {fetched}"));
            let path = sanitize(&file.path.display().to_string()).into_owned();
            let extent = if index + 1 == log.files.len() { extent.as_str() } else { "" };
            out.line(&format!("{STRONG}{path}{STRONG:#}"), 2, &format!("  {extent}{fetched}"))?;
        }
        for robot in &self.report.robots {
            let (name, source) = (&robot.name, &robot.source);
            let (base, tip) = (&robot.base, &robot.tip);
            out.line("", 2, &sanitize(&format!("{name}, {base} → {tip}, from {source}")))?;
        }
        for row in &self.report.comparisons {
            let (topic, reference) = (&row.topic, &row.reference);
            out.line("", 2, &sanitize(&format!("{topic} compared with {reference}")))?;
            if let Some(errors) = row.errors() {
                out.note("", NOTE_INDENT, &errors)?;
            }
            if self.report.is_verbose {
                out.note("", NOTE_INDENT, &sanitize(&format!("{reference}: {}", row.reason)))?;
            }
        }
        // A note may repeat the error.
        let said = self.report.error.as_ref().map_or("", |trouble| trouble.what.as_str());
        let notes = log.notes.iter().filter(|note| said.is_empty() || note.note != said);
        let notes = notes.map(|note| format!("{}: {}", note.path.display(), note.note));
        self.shortened(out, ("note", NOTE_INDENT), notes.collect(), MAX_NOTES)?;
        match log.files.is_empty() && self.report.robots.is_empty() {
            true => Ok(()),
            false => out.blank(),
        }
    }

    /// At most `most` texts below a label, unless in verbose mode.
    fn shortened(
        &self,
        out: &mut Lines<'_>,
        (label, indent): (&str, usize),
        texts: Vec<String>,
        most: usize,
    ) -> io::Result<()> {
        let shown = if self.report.is_verbose { texts.len() } else { most };
        let more = texts.len().saturating_sub(shown);
        let more = (more > 0).then(|| format!("{more} more (-v lists them)"));
        let labels = [label].into_iter().chain(std::iter::repeat(""));
        let mut lines = labels.zip(texts.iter().take(shown).chain(&more));
        lines.try_for_each(|(label, text)| out.note(label, indent, text))
    }

    fn finding(&self, group: &FindingGroup, out: &mut Lines<'_>) -> io::Result<()> {
        let style = severity_style(group.severity());
        let head = format!("{}[{}]", group.severity().name(), group.findings[0].code);
        let (subject, message) = self.outline.group_title(group);
        let subject = match sanitize(&subject) {
            whole if whole.is_empty() => String::new(),
            subject => format!("{STRONG}{subject}{STRONG:#}: "),
        };
        let text = format!("{subject}{}", sanitize(&message));
        out.line(&format!("{style}{head}{style:#} "), 2, &text)?;
        let (lines, more) = self.outline.group_lines(group);
        for (subject, message) in lines {
            out.line("  ", 4, &sanitize(&format!("{subject}: {message}")))?;
        }
        if more > 0 {
            out.line("  ", 4, &format!("{more} more"))?;
        }
        let notes = self.outline.group_notes(group);
        notes.iter().try_for_each(|note| out.note(note.label, NOTE_INDENT, &note.text))
    }

    fn verdict(&self, out: &mut Lines<'_>) -> io::Result<()> {
        let verdict = self.report.verdict;
        let style = verdict_style(verdict);
        if verdict == Verdict::Pass && !self.report.is_verbose {
            self.key_bounds(out)?;
        }
        let hint = if self.report.is_verbose { "" } else { " (-v lists them)" };
        let reason = match verdict {
            Verdict::Inconclusive => self.outline.undecided_text(),
            Verdict::Pass | Verdict::Fail => format!("{}{hint}", self.outline.verdict_reason()),
        };
        out.line(&format!("{style}{verdict}{style:#}  "), 2, &sanitize(&reason))?;
        if verdict == Verdict::Fail {
            let page = self.report.command_with("--format html -o run.html");
            out.call("see it", VERDICT_INDENT, &page)?;
            let fix = self.report.fix_command();
            fix.iter().try_for_each(|fix| out.call("fix it", VERDICT_INDENT, fix))?;
            let explain = self.report.findings.first().map(|first| first.code).unwrap_or_default();
            out.call("explain", VERDICT_INDENT, &format!("poseaudit explain {explain}"))?;
        }
        let calibrate = self.report.calibrate_command();
        calibrate.iter().try_for_each(|call| out.call("calibrate", VERDICT_INDENT, call))?;
        // Other open checks can wait until the findings are corrected.
        let is_open = verdict != Verdict::Fail || !self.report.undecided().is_empty();
        if is_open && !self.report.is_verbose {
            self.open_checks(out)?;
        }
        if verdict == Verdict::Inconclusive {
            let counts = format!("{}{hint}", self.outline.check_counts());
            out.note("checks", VERDICT_INDENT, &counts)?;
        }
        match self.report.exit_explanation() {
            Some(why) => out.line("  ", 2, &why),
            None => Ok(()),
        }
    }

    /// The values that matter most, with their limits.
    fn key_bounds(&self, out: &mut Lines<'_>) -> io::Result<()> {
        let bounds = self.outline.key_bounds();
        let width = |text: fn(&AmountBound) -> String| {
            bounds.iter().map(|bound| text(bound).chars().count()).max().unwrap_or(0)
        };
        let (label_width, amount_width) =
            (width(AmountBound::label), width(|it| it.amount.clone()));
        for bound in &bounds {
            let (label, amount) = (bound.label(), &bound.amount);
            let limit = match bound.limit.as_str() {
                "" => String::new(),
                limit => format!("  limit {limit}"),
            };
            let text = format!("{label:<label_width$}  {amount:<amount_width$}{limit}");
            out.line("  ", 4, sanitize(&text).trim_end())?;
        }
        if bounds.is_empty() { Ok(()) } else { out.blank() }
    }

    fn open_checks(&self, out: &mut Lines<'_>) -> io::Result<()> {
        let OpenChecks { untested, because, next } = self.outline.open_checks();
        self.shortened(out, ("untested", VERDICT_INDENT), untested, MAX_UNTESTED)?;
        because.iter().try_for_each(|text| out.note("because", VERDICT_INDENT, text))?;
        let Some((text, commands)) = next else { return Ok(()) };
        out.note("next", VERDICT_INDENT, &text)?;
        commands.iter().try_for_each(|command| out.call("", VERDICT_INDENT, command))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::{Cause, Evidence, Finding, Severity, Subject};
    use crate::report::{FileRow, LogSummary, Trouble, TroubleKind};
    use textwrap::core::display_width;

    #[test]
    fn a_report_that_suggests_calibration_prints_the_call() {
        let mut report = Report::from_log(LogSummary::default(), Vec::new(), Vec::new());
        let words = ["poseaudit", "audit", "my run.mcap", "--robot", "ur5e"].map(str::to_owned);
        report = report.with_command_line(&words);
        let text = |report: &Report| {
            let mut out = Vec::new();
            write(report, &mut out).expect("a text");
            String::from_utf8(out).expect("UTF-8")
        };
        assert!(!text(&report).contains("poseaudit calibrate"));
        report.findings = vec![Finding {
            code: "MDL001",
            severity: Severity::Info,
            title: "nominal kinematics",
            message: "residual 2 mm".to_owned(),
            subject: Subject::default(),
            cause: Cause::UnexplainedResidual,
            segment: None,
            estimate: None,
            evidence: Evidence::default(),
            fix: "estimate all links with `poseaudit calibrate LOG --out calibrated`".to_owned(),
            start_ns: None,
            end_ns: None,
        }];
        let call = "poseaudit calibrate 'my run.mcap' --robot ur5e --out calibrated\n";
        assert!(text(&report).contains(call), "{}", text(&report));
        // `calibrate` does not merge the files of one run.
        let file = |path: &str| FileRow {
            path: path.into(),
            container: "csv",
            bytes: 1,
            fetched_bytes: None,
            crc: "none",
        };
        report.log.files = ["q.csv", "p.csv"].map(file).to_vec();
        assert!(!text(&report).contains("poseaudit calibrate '"), "{}", text(&report));
    }

    #[test]
    fn terminal_lines_fit_and_no_word_is_lost() {
        let report = Report::from_trouble(Trouble {
            kind: TroubleKind::Log,
            what: "nothing can be audited in the recording of yesterday ".repeat(6),
            place: "a/folder/with a long name/and another/run.mcap".to_owned(),
            remedy: "record the joint states with a pose, /tf or an IMU ".repeat(4),
        });
        let text = |columns: Option<usize>| {
            let mut out = Vec::new();
            let mut lines = Lines { out: &mut out, columns };
            TextReport::new(&report).write(&mut lines).expect("a text");
            String::from_utf8(out).expect("UTF-8")
        };
        let words =
            |text: &str| -> Vec<String> { text.split_whitespace().map(str::to_owned).collect() };
        let whole = text(None);
        assert_eq!(whole.lines().count(), 2);
        for columns in [72, 97, 120] {
            let broken = text(Some(columns));
            assert!(broken.lines().count() > 5, "{broken}");
            assert!(broken.lines().all(|line| display_width(line) <= columns), "{broken}");
            assert!(broken.lines().skip(1).all(|line| line.starts_with("  ")), "{broken}");
            assert_eq!(words(&broken), words(&whole));
        }
    }
}
