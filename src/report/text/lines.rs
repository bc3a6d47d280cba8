//! Lines with labels, wrapped at the width of the terminal.

use std::io::{self, Write};

use textwrap::{Options, WordSeparator, WordSplitter, WrapAlgorithm};

use crate::report::outline::FIX;
use crate::report::sanitize;
use crate::report::styles::{GOOD, QUIET};

pub(super) struct Lines<'a> {
    pub out: &'a mut dyn Write,
    /// `None` disables wrapping.
    pub columns: Option<usize>,
}

impl Lines<'_> {
    pub fn blank(&mut self) -> io::Result<()> {
        writeln!(self.out)
    }

    /// Both texts are sanitized and may contain styles. Further lines are indented by `indent`.
    pub fn line(&mut self, head: &str, indent: usize, text: &str) -> io::Result<()> {
        let Some(columns) = self.columns else {
            return writeln!(self.out, "{}", format!("{head}{text}").trim_end());
        };
        let indent = " ".repeat(indent);
        let options = Options::new(columns)
            .initial_indent(head)
            .subsequent_indent(&indent)
            .break_words(false)
            .word_separator(WordSeparator::AsciiSpace)
            .word_splitter(WordSplitter::NoHyphenation)
            .wrap_algorithm(WrapAlgorithm::FirstFit);
        textwrap::wrap(text, options).iter().try_for_each(|line| writeln!(self.out, "{line}"))
    }

    /// `  label  text`.
    pub fn note(&mut self, label: &str, indent: usize, text: &str) -> io::Result<()> {
        self.line(&note_head(label, indent), indent, &sanitize(text))
    }

    /// Never wraps, so that it can be copied.
    pub fn call(&mut self, label: &str, indent: usize, call: &str) -> io::Result<()> {
        writeln!(self.out, "{}{}", note_head(label, indent), sanitize(call))
    }
}

/// The label, dimmed except for the fix, in a column of this width.
fn note_head(label: &str, width: usize) -> String {
    let style = if label == FIX { GOOD } else { QUIET };
    let blanks = " ".repeat(width.saturating_sub(2 + label.chars().count()));
    format!("  {style}{label}{style:#}{blanks}")
}
