//! `poseaudit rules`.

use poseaudit::checks;
use poseaudit::report::Trouble;

use super::{Outcome, output};

/// List rules and their thresholds
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit rules")]
pub struct Args {}

pub fn run(_: &Args) -> Result<Outcome, Trouble> {
    let mut table = output::table(["code", "name", "severity", "what is wrong"]);
    for rule in checks::registry() {
        table.add_row([rule.code, rule.name, &rule.grade.to_string(), rule.summary()]);
    }
    output::emit(None, |out| writeln!(out, "{}", table.trim_fmt()))?;
    Ok(Outcome::Clean)
}
