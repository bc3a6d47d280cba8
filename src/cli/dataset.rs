//! `poseaudit dataset`: a command of the Python package.

use std::env;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::Command;

use poseaudit::report::Trouble;

use super::{Outcome, messages, misuse};

/// Program of the Python package.
const PROGRAM: &str = "poseaudit-dataset";

/// Audit each episode of a LeRobot dataset, and write the result into its card
///
/// Part of the Python package (pip install poseaudit), whose program poseaudit-dataset it runs;
/// `poseaudit-dataset --help` lists the options.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit dataset ~/.cache/huggingface/lerobot/me/pick_cube --robot so101
  poseaudit dataset hf://datasets/me/pick_cube --out pick_cube")]
pub struct Args {
    /// The folder of the dataset, or OWNER/NAME on the hub, and the options
    #[arg(
        value_name = "DATASET",
        required = true,
        trailing_var_arg = true,
        allow_hyphen_values = true
    )]
    arguments: Vec<OsString>,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let program = find_program()?;
    let mut command = Command::new(&program);
    command.args(&args.arguments);
    // A global option before the dataset is not among the arguments.
    if messages::is_quiet() {
        command.arg("--quiet");
    }
    let status = command.status().map_err(|error| {
        let what = format!("cannot be started: {error}");
        misuse(program.display(), what, "install the package again")
    })?;
    Ok(match status.code() {
        Some(0) => Outcome::Clean,
        Some(1) => Outcome::Findings,
        Some(2) => Outcome::Misuse,
        Some(3) => Outcome::Unusable,
        _ => Outcome::Fault,
    })
}

/// Next to this program, as in a Python environment, else on the PATH.
fn find_program() -> Result<PathBuf, Trouble> {
    let own = env::current_exe().ok().and_then(|path| Some(path.parent()?.to_owned()));
    super::find_program(PROGRAM, own).ok_or_else(|| {
        let what = format!("{PROGRAM} is not installed: the command is part of the Python package");
        misuse("dataset", what, "run `python -m poseaudit dataset` after `pip install poseaudit`")
    })
}
