//! `poseaudit demo`.

use std::path::PathBuf;

use poseaudit::report::{Trouble, text};

use super::{Outcome, output};

/// Write a small faulty log of a UR5e, audit it, and see whether every planted fault is found
///
/// Exit status 0 if and only if every one was, with its amount.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the log, which is made
    #[arg(value_name = "DIR", default_value = "poseaudit-demo")]
    dir: PathBuf,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let demo = poseaudit::demo(&args.dir)?;
    output::emit(None, |out| {
        text::write(&demo.report, out)?;
        writeln!(out)?;
        for planted in &demo.planted {
            let mark = if planted.recovered { "recovered" } else { "missed" };
            writeln!(out, "{mark:<16}{}", planted.what)?;
        }
        Ok(())
    })?;
    let recovered = demo.planted.iter().all(|planted| planted.recovered);
    Ok(if recovered { Outcome::Clean } else { Outcome::Findings })
}
