//! Messages on stderr except errors, and the colour mode.

use std::path::Path;
use std::sync::atomic::{AtomicU8, Ordering};

use anstream::ColorChoice;
use anstyle::Style;
use clap::ValueEnum;
use poseaudit::report::sanitize;

/// Below the command's own options in `--help`.
const HEADING: &str = "Messages";

/// Options for verbosity and colour, shared by all commands.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct VerbosityOptions {
    /// Print only the result and errors: no progress, warnings or names of written files on stderr
    #[arg(short, long, global = true, help_heading = HEADING, conflicts_with = "verbose")]
    quiet: bool,

    /// List passed and skipped checks in a text report, and print on stderr which files are read, how much
    /// data and how long it takes
    #[arg(short, long, global = true, help_heading = HEADING)]
    verbose: bool,

    /// When to use colours; auto: on a terminal unless NO_COLOR is set, or if CLICOLOR_FORCE is set
    #[arg(
        long,
        global = true,
        help_heading = HEADING,
        value_enum,
        value_name = "WHEN",
        default_value_t = Colour::Auto
    )]
    color: Colour,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Colour {
    /// On a terminal
    Auto,
    /// Everywhere except in files
    Always,
    /// Never
    Never,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
enum Level {
    Quiet,
    Normal,
    Verbose,
}

static LEVEL: AtomicU8 = AtomicU8::new(Level::Normal as u8);

const LABEL: Style = Style::new().dimmed();

impl VerbosityOptions {
    pub fn apply(self) {
        let level = match (self.quiet, self.verbose) {
            (true, _) => Level::Quiet,
            (_, true) => Level::Verbose,
            _ => Level::Normal,
        };
        LEVEL.store(level as u8, Ordering::Relaxed);
        match self.color {
            Colour::Auto => ColorChoice::Auto,
            Colour::Always => ColorChoice::Always,
            Colour::Never => ColorChoice::Never,
        }
        .write_global();
    }
}

fn is_shown(level: Level) -> bool {
    LEVEL.load(Ordering::Relaxed) >= level as u8
}

/// Whether only errors are printed.
pub fn is_quiet() -> bool {
    !is_shown(Level::Normal)
}

/// Whether details are printed.
pub fn is_verbose() -> bool {
    is_shown(Level::Verbose)
}

pub fn print_written(path: &Path) {
    // Not for devices and pipes.
    if is_shown(Level::Normal) && (path.is_file() || path.is_dir()) {
        print_line("wrote", &path.display().to_string());
    }
}

pub fn print_waiting(what: &str) {
    if is_shown(Level::Normal) {
        print_line("waiting", what);
    }
}

/// Printed in verbose mode.
pub fn print_detail(label: &str, what: impl FnOnce() -> String) {
    if is_shown(Level::Verbose) {
        print_line(label, &what());
    }
}

fn print_line(label: &str, what: &str) {
    anstream::eprintln!("{LABEL}{label}{LABEL:#} {}", sanitize(what));
}
