//! `poseaudit explain`.

use std::io::{self, Write};

use anstyle::Style;
use poseaudit::checks::{self, Rule};
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};

const HEADING: Style = Style::new().bold();

/// Explain a rule: what it means, why it matters, how to fix it, and when it misleads
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit explain LAT001")]
pub struct Args {
    /// Code of the rule, such as LAT001
    #[arg(value_name = "CODE")]
    code: String,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let rule = checks::find(&args.code).map_err(|unknown| {
        misuse("explain", format!("unknown rule `{}`", unknown.code), unknown.remedy())
    })?;
    output::emit(None, |out| write(rule, out))?;
    Ok(Outcome::Clean)
}

fn write(rule: &Rule, out: &mut dyn Write) -> io::Result<()> {
    writeln!(out, "{HEADING}{} {}{HEADING:#} ({})", rule.code, rule.name, rule.grade)?;
    for line in rule.doc().lines() {
        match line.strip_prefix("## ") {
            Some(heading) => writeln!(out, "{HEADING}{heading}{HEADING:#}")?,
            None => writeln!(out, "{line}")?,
        }
    }
    if !rule.limits.is_empty() {
        writeln!(out, "\n{HEADING}In a config{HEADING:#} ([rules.{}], docs/config.md)", rule.code)?;
    }
    for limit in rule.limits {
        let (key, amount, what) = (limit.key, limit.unit.show(limit.value), limit.what);
        writeln!(out, "{key} ({amount}): {what}")?;
    }
    Ok(())
}
