//! The command line: parses the call, runs the command, and returns its outcome. Reports go to stdout or
//! `--output`, messages to stderr.

mod audit;
mod audit_options;
mod calibrate;
mod compare;
mod completions;
mod dataset;
mod demo;
mod explain;
mod fk;
mod fleet;
mod fleet_report;
mod info;
mod init;
mod man;
mod messages;
mod output;
mod plan;
mod pose;
mod progress;
mod record_list;
mod reports;
mod robots;
mod rules;
mod statistics;
mod tf;
mod view;
mod watch;

use std::env;
use std::fmt::Display;
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use poseaudit::report::{Report, Trouble, TroubleKind};

/// Determines the exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// No finding at or above `--fail-on`.
    Clean,
    /// A finding, or a required rule is inconclusive.
    Findings,
    Misuse,
    Unusable,
    Fault,
}

impl From<TroubleKind> for Outcome {
    fn from(kind: TroubleKind) -> Self {
        match kind {
            TroubleKind::Call => Outcome::Misuse,
            TroubleKind::Log => Outcome::Unusable,
        }
    }
}

impl From<&Report> for Outcome {
    fn from(report: &Report) -> Self {
        match &report.error {
            Some(trouble) if trouble.kind == TroubleKind::Log && report.fails_without_arm() => {
                Outcome::Findings
            }
            Some(trouble) => trouble.kind.into(),
            None if report.fails() => Outcome::Findings,
            None => Outcome::Clean,
        }
    }
}

/// Finds wrong poses, timestamps and conventions in recordings of a robot arm.
///
/// Reads one recorded run, recomputes the arm's poses by forward kinematics, and reports each cause with
/// its size and uncertainty.
#[derive(Debug, Parser)]
#[command(
    version,
    disable_help_subcommand = true,
    after_help = "\
Examples:
  poseaudit demo
  poseaudit audit run.mcap
  poseaudit explain LAT001"
)]
struct Cli {
    #[command(flatten)]
    verbosity: messages::VerbosityOptions,

    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Audit(Box<audit::Args>),
    Calibrate(Box<calibrate::Args>),
    Compare(Box<compare::Args>),
    Fleet(Box<fleet::Args>),
    Dataset(dataset::Args),
    Info(info::Args),
    Init(init::Args),
    Demo(demo::Args),
    Rules(rules::Args),
    Explain(explain::Args),
    Robots(robots::Args),
    Fk(fk::Args),
    Tf(tf::Args),
    Pose(Box<pose::Args>),
    Plan(Box<plan::Args>),
    RecordList(record_list::Args),
    Watch(Box<watch::Args>),
    Completions(completions::Args),
    Man(man::Args),
}

/// Runs the command. For invalid options `clap` exits with status 2.
pub fn run() -> Outcome {
    let result = Cli::try_parse().map_err(parse_trouble).and_then(|cli| {
        cli.verbosity.apply();
        dispatch(cli.command)
    });
    result.unwrap_or_else(|trouble| {
        output::error(&trouble);
        trouble.kind.into()
    })
}

fn dispatch(command: Command) -> Result<Outcome, Trouble> {
    match command {
        Command::Audit(args) => audit::run(*args),
        Command::Calibrate(args) => calibrate::run(*args),
        Command::Compare(args) => compare::run(*args),
        Command::Fleet(args) => fleet::run(*args),
        Command::Dataset(args) => dataset::run(&args),
        Command::Info(args) => info::run(&args),
        Command::Init(args) => init::run(args),
        Command::Demo(args) => demo::run(&args),
        Command::Rules(args) => rules::run(&args),
        Command::Explain(args) => explain::run(&args),
        Command::Robots(args) => robots::run(&args),
        Command::Fk(args) => fk::run(&args),
        Command::Tf(args) => tf::run(&args),
        Command::Pose(args) => pose::run(&args),
        Command::Plan(args) => plan::run(&args),
        Command::RecordList(args) => record_list::run(&args),
        Command::Watch(args) => watch::run(*args),
        Command::Completions(args) => completions::run(&args),
        Command::Man(args) => man::run(&args),
    }
}

/// Error for a log in place of a command; `clap` reports all others and exits.
fn parse_trouble(error: clap::Error) -> Trouble {
    let first = env::args_os().nth(1).map(PathBuf::from);
    match first.filter(|path| error.kind() == ErrorKind::InvalidSubcommand && path.exists()) {
        Some(path) => {
            let path = path.display().to_string();
            misuse(&path, "unknown command", format!("audit it with `poseaudit audit {path}`"))
        }
        None => error.exit(),
    }
}

/// Deletes partial files on interruption or termination.
pub fn handle_signals() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGINT, SIGTERM};
        // Shells make background jobs ignore SIGINT.
        let wanted = [SIGINT, SIGTERM].into_iter().filter(|&signal| !is_ignored(signal));
        // Otherwise signals keep their default action.
        let Ok(mut signals) = signal_hook::iterator::Signals::new(wanted) else { return };
        let handle = signals.handle();
        let listener = std::thread::Builder::new().spawn(move || {
            if let Some(signal) = signals.forever().next() {
                poseaudit::boundary::delete_staged_files();
                // Ends the process by the signal.
                let _ = signal_hook::low_level::emulate_default_handler(signal);
            }
        });
        if listener.is_err() {
            handle.close();
        }
    }
}

/// Whether the parent process made this one ignore it.
#[cfg(unix)]
#[allow(unsafe_code, reason = "querying the action of a signal")]
fn is_ignored(signal: i32) -> bool {
    // SAFETY: writes only to the struct, which outlives the call, and changes no action.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &mut action) == 0
            && action.sa_sigaction == libc::SIG_IGN
    }
}

pub fn report_fault(what: &str) -> Outcome {
    // Thread libraries report only this for a refused thread.
    match what.contains("spawn") || what.contains("ThreadPoolBuildError") {
        true => output::error(
            "out of memory: the system refuses to start more threads; allow more memory (ulimit -v) or more \
             processes (ulimit -u)",
        ),
        false => output::error(fault_line(what)),
    }
    Outcome::Fault
}

fn fault_line(what: &str) -> String {
    format!(
        "poseaudit {} failed (internal error): {what}; please report this line, with the log if possible",
        env!("CARGO_PKG_VERSION")
    )
}

/// The program `name` in the first folder that has it: `own`, or one on the PATH.
fn find_program(name: &str, own: Option<PathBuf>) -> Option<PathBuf> {
    let name = format!("{name}{}", env::consts::EXE_SUFFIX);
    let folders = env::var_os("PATH").unwrap_or_default();
    let folders = own.into_iter().chain(env::split_paths(&folders));
    let mut programs = folders.map(|folder| folder.join(&name));
    programs.find(|program| program.is_file())
}

fn misuse(place: impl Display, what: impl Display, remedy: impl Display) -> Trouble {
    Trouble::call(place, what, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn a_panic_ends_in_one_line_that_asks_for_a_report() {
        let result =
            poseaudit::boundary::catch_panic(|| -> Outcome { panic!("no such column\nmore") });
        let line = fault_line(&result.expect_err("a panic"));
        assert!(line.contains(": no such column (") && line.contains("please report"), "{line}");
        assert!(line.contains("cli/mod.rs:") && !line.contains('\n'), "{line}");
    }

    fn examples(command: &clap::Command) -> Vec<Vec<String>> {
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let whole = help.replace("\\\n", " ");
        let calls = whole.lines().filter_map(|line| line.find("poseaudit ").map(|at| &line[at..]));
        calls.map(|call| split_words(call.split(['|', '>']).next().unwrap_or_default())).collect()
    }

    /// Splits words like a shell, as far as needed.
    fn split_words(line: &str) -> Vec<String> {
        let parts = line.split('"').enumerate();
        let words = parts.flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect(),
            _ => vec![part.to_owned()],
        });
        words.collect()
    }

    #[test]
    fn every_command_has_examples_that_parse() {
        let whole = Cli::command();
        for command in [&whole].into_iter().chain(whole.get_subcommands()) {
            let examples = examples(command);
            assert!(!examples.is_empty(), "{} has no example", command.get_name());
            for call in examples {
                let parsed = Cli::try_parse_from(&call);
                assert!(parsed.is_ok(), "{call:?}: {}", parsed.unwrap_err());
                let is_its = command.get_name() == "poseaudit" || call[1] == command.get_name();
                assert!(is_its, "{call:?} is an example of {}", command.get_name());
            }
        }
    }
}
