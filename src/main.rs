//! `poseaudit`: the outcome of a command becomes the exit status of the process.

mod cli;

use std::process::ExitCode;

use cli::Outcome;

fn main() -> ExitCode {
    ExitCode::from(match cli::run() {
        Outcome::Clean => 0,
        Outcome::Findings => 1,
        Outcome::Misuse => 2,
        Outcome::Unusable => 3,
    })
}
