//! `poseaudit demo`.

use std::path::PathBuf;

use poseaudit::Planted;
use poseaudit::report::{Format, Trouble};

use super::{Outcome, output, reports};

/// Write a small faulty log of a UR5e, audit it, and see whether every planted fault is found
///
/// Exit status 0 if and only if every one was, with its amount.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the log, which is made
    #[arg(value_name = "DIR", default_value = "poseaudit-demo")]
    dir: PathBuf,

    /// Format of the report
    #[arg(long, value_name = "FORMAT", default_value = "text", value_parser = reports::format())]
    format: &'static Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let demo = poseaudit::demo(&args.dir)?;
    output::emit(None, |out| {
        args.format.write(&demo.report, out)?;
        if args.format.is_text() {
            writeln!(out)?;
            for planted in &demo.planted {
                writeln!(out, "{}", line(planted))?;
            }
        }
        Ok(())
    })?;
    if !args.format.is_text() {
        for planted in &demo.planted {
            eprintln!("{}", line(planted));
        }
    }
    let recovered = demo.planted.iter().all(|planted| planted.recovered);
    Ok(if recovered { Outcome::Clean } else { Outcome::Findings })
}

fn line(planted: &Planted) -> String {
    let mark = if planted.recovered { "recovered" } else { "missed" };
    format!("{mark:<16}{}", planted.what)
}
