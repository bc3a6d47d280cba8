//! Where output goes: stdout with colours only where somebody sees them, files without.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, Write};
use std::path::Path;

use anstream::{AutoStream, StripStream};
use anstyle::{AnsiColor, Style};
use clap::ValueEnum;
use comfy_table::{Table, presets};
use poseaudit::report::{Trouble, tame, upright, write_whole};

use super::say;

/// How an answer that is no report is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For people
    Text,
    /// For programs, in SI units
    Json,
}

/// The option that names the file for an answer.
pub const OUTPUT: &str = "--output";

const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const ERROR: Style = AnsiColor::Red.on_default().bold();

/// One line on stderr that says what is wrong.
pub fn error(what: impl Display) {
    anstream::eprintln!("{ERROR}error:{ERROR:#} {}", tame(&what.to_string()));
}

/// One line on stderr that says what to heed.
pub fn warning(what: impl Display) {
    if say::is_quiet() {
        return;
    }
    anstream::eprintln!("{WARNING}warning:{WARNING:#} {}", tame(&what.to_string()));
}

/// A table without lines around its cells.
pub fn table<'a>(header: impl IntoIterator<Item = &'a str>) -> Table {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING).set_header(header);
    for column in table.column_iter_mut() {
        column.set_padding((0, 2));
    }
    table
}

/// How wide the terminal is that stdout leads to, if it leads to one.
pub fn columns() -> Option<usize> {
    let (width, _) = terminal_size::terminal_size_of(io::stdout())?;
    Some(usize::from(width.0))
}

/// Hands what `write` writes to the file at `path`, whose parents are made, else to stdout. Characters that
/// turn the direction of writing are escapes there.
///
/// A reader of stdout who has seen enough is no error.
pub fn emit(
    path: Option<&Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Trouble> {
    exactly(path, |out| {
        let mut text = Vec::new();
        write(&mut text)?;
        match std::str::from_utf8(&text) {
            Ok(text) => out.write_all(upright(text).as_bytes()),
            Err(_) => out.write_all(&text),
        }
    })
}

/// The same, with every byte as it is.
pub fn exactly(
    path: Option<&Path>,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Trouble> {
    let mut text = Vec::new();
    match path {
        None => match write(&mut text).and_then(|()| to_stdout(&text)) {
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
                let remedy = "see where stdout goes, or use --output PATH";
                Err(super::misuse("stdout", format!("cannot be written: {error}"), remedy))
            }
            _ => Ok(()),
        },
        Some(path) => write(&mut text).and_then(|()| to_file(path, &text)).map_err(|error| {
            let place = path.display().to_string();
            super::misuse(place, format!("cannot be written: {error}"), "name another --output")
        }),
    }
}

fn to_stdout(text: &[u8]) -> io::Result<()> {
    let mut stdout = AutoStream::auto(io::stdout().lock());
    stdout.write_all(text)?;
    stdout.flush()
}

fn to_file(path: &Path, text: &[u8]) -> io::Result<()> {
    write_whole(path, |staged| StripStream::new(File::create(staged)?).write_all(text))?;
    say::wrote(path);
    Ok(())
}
