//! Styles and labels of texts for a terminal.

use std::io::{self, Write};

use anstyle::{AnsiColor, Style};

use super::{Verdict, sanitize};
use crate::finding::Severity;

pub(crate) const ERROR: Style = AnsiColor::Red.on_default().bold();
pub(crate) const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const INFO: Style = AnsiColor::Cyan.on_default().bold();
pub(crate) const GOOD: Style = AnsiColor::Green.on_default().bold();
pub(crate) const STRONG: Style = Style::new().bold();
pub(crate) const QUIET: Style = Style::new().dimmed();

/// Characters before the texts.
pub(crate) const LABEL_WIDTH: usize = 16;

pub(crate) const fn severity_style(severity: Severity) -> Style {
    match severity {
        Severity::Error => ERROR,
        Severity::Warning => WARNING,
        Severity::Info => INFO,
    }
}

pub(crate) const fn verdict_style(verdict: Verdict) -> Style {
    match verdict {
        Verdict::Fail => ERROR,
        Verdict::Pass => GOOD,
        Verdict::Inconclusive => WARNING,
    }
}

/// One line: the label, and the sanitized text.
pub(crate) fn write_line(
    out: &mut dyn Write,
    style: Style,
    label: &str,
    text: &str,
) -> io::Result<()> {
    let blanks = LABEL_WIDTH.saturating_sub(label.chars().count()).max(1);
    writeln!(out, "{style}{label}{style:#}{:blanks$}{}", "", sanitize(text))
}
