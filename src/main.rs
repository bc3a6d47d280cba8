//! `poseaudit`: maps the outcome of a command to the exit status of the process.

mod cli;

use std::process::ExitCode;

use cli::Outcome;
use poseaudit::boundary::{ReportingAllocator, catch_panic};

#[global_allocator]
static MEMORY: ReportingAllocator = ReportingAllocator;

fn main() -> ExitCode {
    cli::handle_signals();
    let outcome = catch_panic(cli::run).unwrap_or_else(|what| cli::report_fault(&what));
    ExitCode::from(match outcome {
        Outcome::Clean => 0,
        Outcome::Findings => 1,
        Outcome::Misuse => 2,
        Outcome::Unusable => 3,
        Outcome::Fault => 70,
    })
}
