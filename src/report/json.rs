//! The report for programs: one JSON object, in SI units.

use std::io::{self, Write};

use super::Report;

/// Writes the report; numbers that are not finite become `null`.
///
/// # Errors
/// If `out` cannot be written.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, report)?;
    writeln!(out)
}
