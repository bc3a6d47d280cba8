//! `poseaudit rules`.

use poseaudit::checks::{self, Rule};
use poseaudit::report::Trouble;
use serde_json::{Value, json};

use super::output::Format;
use super::{Outcome, output};

/// List rules and their thresholds
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit rules
  poseaudit rules --format json")]
pub struct Args {
    /// Output format
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let rules = checks::registry();
    output::emit(None, |out| match args.format {
        Format::Json => {
            let rules: Vec<Value> = rules.iter().map(|rule| as_json(rule)).collect();
            output::write_json(out, &rules)
        }
        Format::Text => {
            let mut table = output::table(["code", "name", "severity", "what is wrong"]);
            for rule in rules {
                table.add_row([rule.code, rule.name, &rule.grade.to_string(), rule.summary()]);
            }
            writeln!(out, "{}", table.trim_fmt())
        }
    })?;
    Ok(Outcome::Clean)
}

/// SI units, text in Markdown.
fn as_json(rule: &Rule) -> Value {
    let thresholds = rule.grade.thresholds().iter().map(|threshold| {
        json!({
            "unit": threshold.unit.symbol(),
            "warning": threshold.warning,
            "error": threshold.error,
        })
    });
    let limits = rule.limits.iter().map(|limit| {
        json!({
            "key": limit.key,
            "unit": limit.unit.symbol(),
            "value": limit.value,
            "what": limit.what,
        })
    });
    json!({
        "code": rule.code,
        "name": rule.name,
        "summary": rule.summary(),
        "severity": rule.grade.max_severity().name(),
        "thresholds": thresholds.collect::<Vec<_>>(),
        "limits": limits.collect::<Vec<_>>(),
        "headline": rule.headline,
        "needs_model": rule.needs_model,
        "doc": rule.doc(),
    })
}
