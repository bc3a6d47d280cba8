//! Output with colours on a terminal, without in files.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, IsTerminal, Write};
use std::path::Path;

use anstream::{AutoStream, StripStream};
use anstyle::{AnsiColor, Style};
use clap::ValueEnum;
use comfy_table::{Table, presets};
use poseaudit::report::{Trouble, escape_direction, sanitize, write_whole};
use serde::Serialize;

use super::messages;

/// Output format of commands that do not print a report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people
    Text,
    /// For programs, in SI units
    Json,
}

pub const OUTPUT_OPTION: &str = "--output";

const ESCAPE: u8 = 0x1b;
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const ERROR: Style = AnsiColor::Red.on_default().bold();

pub fn error(what: impl Display) {
    anstream::eprintln!("{ERROR}error:{ERROR:#} {}", sanitize(&what.to_string()));
}

pub fn warning(what: impl Display) {
    if messages::is_quiet() {
        return;
    }
    anstream::eprintln!("{WARNING}warning:{WARNING:#} {}", sanitize(&what.to_string()));
}

/// Table without borders.
pub fn table<'a>(header: impl IntoIterator<Item = &'a str>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING).set_header(header);
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table
}

/// Terminal width: `COLUMNS` or its own. `None` for a pipe or file, whose statements stay on one line for
/// grep.
pub fn columns() -> Option<usize> {
    /// Unknown width.
    const DEFAULT_COLUMNS: usize = 100;
    if !io::stdout().is_terminal() {
        return None;
    }
    let set = std::env::var("COLUMNS").ok().and_then(|text| text.parse().ok());
    let own = || terminal_size::terminal_size_of(io::stdout()).map(|(width, _)| width.0.into());
    set.filter(|&columns: &usize| columns > 0).or_else(own).or(Some(DEFAULT_COLUMNS))
}

/// Indented, with a final newline.
pub fn write_json(out: &mut dyn Write, value: &impl Serialize) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, value)?;
    writeln!(out)
}

/// Writes to the file at `path`, creating its parents, or to stdout, with bidirectional control characters
/// escaped. A closed pipe is not an error.
pub fn emit(
    path: Option<&Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Trouble> {
    emit_unescaped(path, |out| {
        let mut text = Vec::new();
        write(&mut text)?;
        match std::str::from_utf8(&text) {
            Ok(text) => out.write_all(escape_direction(text).as_bytes()),
            Err(_) => out.write_all(&text),
        }
    })
}

/// [`emit`] without escaping.
pub fn emit_unescaped(
    path: Option<&Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Trouble> {
    let mut text = Vec::new();
    match path {
        None => match write(&mut text).and_then(|()| to_stdout(&text)) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                let remedy = "check where stdout leads, or use --output PATH";
                Err(super::misuse("stdout", format!("cannot be written: {error}"), remedy))
            }
            _ => Ok(()),
        },
        Some(path) => write(&mut text).and_then(|()| to_file(path, &text)).map_err(|error| {
            let what = format!("cannot be written: {error}");
            super::misuse(path.display(), what, "name another --output")
        }),
    }
}

fn to_stdout(text: &[u8]) -> io::Result<()> {
    let mut stdout = io::stdout().lock();
    // Text without styles, like JSON, needs no pass over its bytes.
    match text.contains(&ESCAPE) {
        true => AutoStream::auto(&mut stdout).write_all(text)?,
        false => stdout.write_all(text)?,
    }
    stdout.flush()
}

fn to_file(path: &Path, text: &[u8]) -> io::Result<()> {
    write_whole(path, |staged| {
        let mut file = File::create(staged)?;
        match text.contains(&ESCAPE) {
            true => StripStream::new(file).write_all(text),
            false => file.write_all(text),
        }
    })?;
    messages::print_written(path);
    Ok(())
}
