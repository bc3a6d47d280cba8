//! The command line: what is asked, and how that ended.
//!
//! Reports go to stdout or to `--output`; messages go to stderr.

mod audit;
mod calibrate;
mod compare;
mod completions;
mod demo;
mod explain;
mod fk;
mod fleet;
mod fleet_report;
mod how;
mod info;
mod init;
mod man;
mod output;
mod plan;
mod pose;
mod progress;
mod record_list;
mod reports;
mod robots;
mod rules;
mod say;
mod statistics;
mod tf;
mod view;
mod watch;

use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};
use poseaudit::report::{Report, Trouble, TroubleKind, Verdict};

/// How a command ended, as its exit status tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Nothing at or above `--fail-on`.
    Clean,
    /// A finding, or a required rule that could not conclude.
    Findings,
    /// The call cannot be followed.
    Misuse,
    /// The log cannot be audited.
    Unusable,
    /// This program failed.
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
        match (&report.error, report.verdict) {
            (Some(trouble), _) => trouble.kind.into(),
            (None, Verdict::Fail) => Outcome::Findings,
            (None, Verdict::Inconclusive) if report.fails_open => Outcome::Findings,
            (None, Verdict::Pass | Verdict::Inconclusive) => Outcome::Clean,
        }
    }
}

/// Finds wrong poses, timestamps and conventions in a robot arm's recordings.
///
/// Reads one recorded run, recomputes where the arm must have been, and names the cause, by how
/// much, and how sure it is.
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
    say: say::Say,

    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Audit(Box<audit::Args>),
    Calibrate(Box<calibrate::Args>),
    Compare(Box<compare::Args>),
    Fleet(Box<fleet::Args>),
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

/// Follows the command line. What is wrong with the call itself is said by `clap`, which ends the
/// process with status 2.
pub fn run() -> Outcome {
    let result = Cli::try_parse().map_err(refused).and_then(|cli| {
        cli.say.apply();
        follow(cli.command)
    });
    result.unwrap_or_else(|trouble| {
        output::error(&trouble);
        trouble.kind.into()
    })
}

fn follow(command: Command) -> Result<Outcome, Trouble> {
    match command {
        Command::Audit(args) => audit::run(*args),
        Command::Calibrate(args) => calibrate::run(*args),
        Command::Compare(args) => compare::run(*args),
        Command::Fleet(args) => fleet::run(*args),
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

/// What is wrong where a log stands in the place of a command. All else is said by `clap`, which ends the
/// process.
fn refused(error: clap::Error) -> Trouble {
    let first = std::env::args_os().nth(1).map(PathBuf::from);
    match first.filter(|path| error.kind() == ErrorKind::InvalidSubcommand && path.exists()) {
        Some(path) => {
            let path = path.display().to_string();
            misuse(&path, "it is no command", format!("audit it with `poseaudit audit {path}`"))
        }
        None => error.exit(),
    }
}

/// Has the process leave no file behind that is not whole where it is interrupted or terminated.
pub fn end_on_signals() {
    #[cfg(unix)]
    {
        use signal_hook::consts::{SIGINT, SIGTERM};
        // A shell has what runs in the background pass over the key that interrupts.
        let wanted = [SIGINT, SIGTERM].into_iter().filter(|&signal| !is_passed_over(signal));
        // Where signals cannot be heard, they end the process as they always do.
        let Ok(mut signals) = signal_hook::iterator::Signals::new(wanted) else { return };
        let handle = signals.handle();
        let heard = std::thread::Builder::new().spawn(move || {
            if let Some(signal) = signals.forever().next() {
                poseaudit::boundary::forget_staged();
                // What was asked for: the process dies of it.
                let _ = signal_hook::low_level::emulate_default_handler(signal);
            }
        });
        if heard.is_err() {
            handle.close();
        }
    }
}

/// Whether who called this program has it pass over a signal.
#[cfg(unix)]
#[allow(unsafe_code, reason = "a signal is asked for")]
fn is_passed_over(signal: i32) -> bool {
    // SAFETY: the call writes to the struct, which outlives it, and changes nothing.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &mut action) == 0
            && action.sa_sigaction == libc::SIG_IGN
    }
}

/// Says in one line that this program failed, and what is to be done.
pub fn fault(what: &str) -> Outcome {
    // The libraries that start threads say no more than that where the system refuses one.
    match what.contains("spawn") || what.contains("ThreadPoolBuildError") {
        true => output::error(
            "out of memory: the system starts no more threads; allow more memory (ulimit -v) or more \
             processes (ulimit -u)",
        ),
        false => output::error(fault_line(what)),
    }
    Outcome::Fault
}

fn fault_line(what: &str) -> String {
    format!(
        "poseaudit {} failed, which is a fault of its own: {what}; please report this line, with the \
         log if you can",
        env!("CARGO_PKG_VERSION")
    )
}

/// A trouble with the option `place`.
fn misuse(place: impl Into<String>, what: impl Into<String>, remedy: impl Into<String>) -> Trouble {
    let kind = TroubleKind::Call;
    Trouble { kind, what: what.into(), place: place.into(), remedy: remedy.into() }
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
        let told = poseaudit::boundary::caught(|| -> Outcome { panic!("no such column\nmore") });
        let line = fault_line(&told.expect_err("a panic"));
        assert!(line.contains(": no such column (") && line.contains("please report"), "{line}");
        assert!(line.contains("cli/mod.rs:") && !line.contains('\n'), "{line}");
    }

    /// The calls of poseaudit among the examples of a command.
    fn examples(command: &clap::Command) -> Vec<Vec<String>> {
        let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
        let whole = help.replace("\\\n", " ");
        let calls = whole.lines().filter_map(|line| line.find("poseaudit ").map(|at| &line[at..]));
        calls.map(|call| words(call.split(['|', '>']).next().unwrap_or_default())).collect()
    }

    /// The words of a line as a shell splits it, as far as the examples need it.
    fn words(line: &str) -> Vec<String> {
        let parts = line.split('"').enumerate();
        let words = parts.flat_map(|(index, part)| match index % 2 {
            0 => part.split_whitespace().map(str::to_owned).collect(),
            _ => vec![part.to_owned()],
        });
        words.collect()
    }

    #[test]
    fn every_command_has_examples_and_they_can_be_followed() {
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
