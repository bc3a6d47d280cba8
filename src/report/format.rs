use std::fmt;
use std::io::{self, Write};

use super::{Report, github, html, json, junit, markdown, sarif, text};

/// A report format.
#[derive(Clone, Copy)]
pub struct Format {
    /// Name for `--format`.
    pub name: &'static str,
    /// File name in a folder of several formats.
    pub file_name: &'static str,
    /// Intended use.
    pub about: &'static str,
    write: fn(&Report, &mut dyn Write) -> io::Result<()>,
}

/// All formats. To add one, create a file in this folder and an entry here.
pub static FORMATS: &[Format] = &[
    Format { name: "text", file_name: "report.txt", about: "For people", write: text::write },
    Format {
        name: "json",
        file_name: "report.json",
        about: "For programs, in SI units",
        write: json::write,
    },
    Format {
        name: "markdown",
        file_name: "report.md",
        about: "For a comment on a pull request",
        write: markdown::write,
    },
    Format {
        name: "html",
        file_name: "report.html",
        about: "For people: one page with its pictures, which opens in any browser",
        write: html::write,
    },
    Format {
        name: "junit",
        file_name: "junit.xml",
        about: "For CI: a test case per rule and subject",
        write: junit::write,
    },
    Format {
        name: "sarif",
        file_name: "report.sarif",
        about: "For code scanning, as SARIF 2.1.0",
        write: sarif::write,
    },
    Format {
        name: "github",
        file_name: "annotations.txt",
        about: "For the log of a GitHub workflow, which makes annotations of it",
        write: github::write,
    },
];

impl Format {
    /// Terminal format, the first of every list.
    pub fn text() -> &'static Format {
        &FORMATS[0]
    }

    /// Format with this name.
    pub fn from_name(name: &str) -> Option<&'static Format> {
        FORMATS.iter().find(|format| format.name == name)
    }

    /// Its errors go to stderr.
    pub fn is_text(&self) -> bool {
        self.name == Self::text().name
    }

    /// Shows plots of [`Report::figures`].
    pub fn has_plots(&self) -> bool {
        self.name == "html"
    }

    /// Writes `report` in this format.
    ///
    /// # Errors
    /// If `out` cannot be written.
    pub fn write(&self, report: &Report, out: &mut dyn Write) -> io::Result<()> {
        (self.write)(report, out)
    }
}

impl fmt::Debug for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
