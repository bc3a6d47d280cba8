//! Report formats and their output files.

use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use poseaudit::places::PathRegistry;
use poseaudit::report::{FORMATS, Format, Report, Trouble, text};

use super::output::OUTPUT_OPTION;
use super::{misuse, output};

/// Options for the format and the place of a report.
#[derive(Clone, Debug, clap::Args)]
pub struct ReportOptions {
    /// Format of the report; if repeated, --output names a folder
    #[arg(
        long = "format",
        value_name = "FORMAT",
        default_value = "text",
        value_parser = format()
    )]
    formats: Vec<&'static Format>,

    /// Write the report to this file instead of stdout; for several formats, into this folder
    #[arg(short, long, value_name = "PATH")]
    output: Option<PathBuf>,
}

pub fn format() -> impl TypedValueParser<Value = &'static Format> {
    let names = FORMATS.iter().map(|format| PossibleValue::new(format.name).help(format.about));
    PossibleValuesParser::new(names)
        .try_map(|name| Format::from_name(&name).ok_or("no such format"))
}

/// Writes to the file at `path`, or to stdout.
pub fn emit(format: &Format, report: &Report, path: Option<&Path>) -> Result<(), Trouble> {
    let columns = output::columns().filter(|_| format.is_text() && path.is_none());
    output::emit(path, |out| match columns {
        Some(columns) => text::write_within(report, columns, out),
        None => format.write(report, out),
    })
}

impl ReportOptions {
    /// Fails for several formats without a folder.
    pub fn check_destination(&self) -> Result<(), Trouble> {
        match (&self.output, self.distinct_formats().as_slice()) {
            (_, [_]) => Ok(()),
            (None, formats) => {
                let what = format!("{} formats cannot go to stdout together", formats.len());
                Err(misuse("--format", what, "name a folder with --output DIR"))
            }
            (Some(path), _) if path.exists() && !path.is_dir() => {
                let what = "several formats need a folder, and this is a file";
                Err(misuse(path.display(), what, "name a folder with --output, or one --format"))
            }
            (Some(_), _) => Ok(()),
        }
    }

    /// Adds the report files to `places`.
    pub fn register_outputs(&self, places: &mut PathRegistry) {
        match (&self.output, self.distinct_formats().as_slice()) {
            (Some(folder), formats @ [_, _, ..]) => {
                let names = formats.iter().map(|format| format.file_name.to_owned());
                places.add_outputs_in(OUTPUT_OPTION, folder, names);
            }
            (output, _) => output.iter().for_each(|path| places.add_output(OUTPUT_OPTION, path)),
        }
    }

    /// Format, if there is only one.
    pub fn single_format(&self) -> Option<(&'static Format, Option<&Path>)> {
        <[_; 1]>::try_from(self.distinct_formats())
            .ok()
            .map(|[format]| (format, self.output.as_deref()))
    }

    /// Whether the report must contain a trouble. For text, stderr does.
    pub fn has_trouble_format(&self) -> bool {
        self.formats.iter().any(|format| !format.is_text())
    }

    /// Whether the report on stdout is for people.
    pub fn prints_text(&self) -> bool {
        self.output.is_none() && self.formats.iter().any(|format| format.is_text())
    }

    /// Whether a format has plots.
    pub fn has_plots(&self) -> bool {
        self.formats.iter().any(|format| format.has_plots())
    }

    pub fn has_text(&self) -> bool {
        self.formats.iter().any(|format| format.is_text())
    }

    /// Writes every format.
    pub fn emit(&self, report: &Report) -> Result<(), Trouble> {
        match (&self.output, self.distinct_formats().as_slice()) {
            (Some(folder), formats @ [_, _, ..]) => {
                let path = |format: &Format| folder.join(format.file_name);
                let written =
                    formats.iter().map(|format| emit(format, report, Some(&path(format))));
                // One error does not prevent the others.
                written.fold(Ok(()), Result::and)
            }
            (path, formats) => {
                formats.iter().try_for_each(|format| emit(format, report, path.as_deref()))
            }
        }
    }

    fn distinct_formats(&self) -> Vec<&'static Format> {
        let wanted = |format: &&Format| self.formats.iter().any(|one| one.name == format.name);
        FORMATS.iter().filter(wanted).collect()
    }
}
