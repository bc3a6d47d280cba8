//! `poseaudit explain`.

use std::io::{self, Write};

use anstyle::Style;
use poseaudit::checks::{self, Rule};
use poseaudit::report::Trouble;

use super::{Outcome, misuse, output};

const HEADING: Style = Style::new().bold();

/// Explain a rule: its meaning, its importance, the fix, and when it misleads
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit explain LAT001
  poseaudit explain joint-zero")]
pub struct Args {
    /// Code or name of the rule, such as LAT001 or latency
    #[arg(value_name = "CODE|NAME")]
    rule: String,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let rule = find(&args.rule)?;
    output::emit(None, |out| write(rule, out))?;
    Ok(Outcome::Clean)
}

/// Finds a rule by code, by name, or by a part of exactly one name.
fn find(wanted: &str) -> Result<&'static Rule, Trouble> {
    let name = wanted.trim().to_ascii_lowercase();
    let rules = checks::registry();
    let similar: Vec<&Rule> =
        rules.iter().copied().filter(|rule| rule.name.contains(&name)).collect();
    let named = rules.iter().copied().find(|rule| rule.name == name);
    checks::find(wanted).or_else(|unknown| match (named, similar.as_slice()) {
        (Some(rule), _) => Ok(rule),
        (None, [only]) => Ok(*only),
        (None, several) => {
            let names: Vec<String> =
                several.iter().map(|rule| format!("{} ({})", rule.code, rule.name)).collect();
            let remedy = match names.is_empty() {
                true => unknown.remedy(),
                false => format!("did you mean {}?", names.join(", ")),
            };
            Err(misuse("explain", format!("unknown rule `{}`", unknown.code), remedy))
        }
    })
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
