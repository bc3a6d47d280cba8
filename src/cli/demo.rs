//! `poseaudit demo`.

use std::path::PathBuf;

use poseaudit::PlantedFault;
use poseaudit::places::PathRegistry;
use poseaudit::report::{Format, Trouble};

use super::{Outcome, output, reports};

/// Write a small faulty log of a UR5e, audit it, and check that every planted fault is found
///
/// With --pair, the log holds the poses of a controller and of a tracker, without joint states. Exits with 0
/// only if all faults are found at the right size.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit demo
  poseaudit demo --pair
  poseaudit demo /tmp/demo --format json")]
pub struct Args {
    /// Folder for the log; created if missing
    #[arg(value_name = "DIR", default_value = "poseaudit-demo")]
    dir: PathBuf,

    /// Write the poses of a controller and of a late tracker whose marker slips
    #[arg(long)]
    pair: bool,

    /// Format of the report
    #[arg(long, value_name = "FORMAT", default_value = "text", value_parser = reports::format())]
    format: &'static Format,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut places = PathRegistry::default();
    let log = if args.pair { poseaudit::DEMO_PAIR_LOG } else { poseaudit::DEMO_LOG };
    places.add_outputs_in("DIR", &args.dir, [log.to_owned()]);
    places.check()?;
    let demo = match args.pair {
        true => poseaudit::demo_pair(&args.dir)?,
        false => poseaudit::demo(&args.dir)?,
    };
    reports::emit(args.format, &demo.report, None)?;
    let lines: Vec<String> = demo.planted.iter().map(planted_text).collect();
    if args.format.is_text() {
        output::emit(None, |out| writeln!(out, "\n{}", lines.join("\n")))?;
    } else {
        lines.iter().for_each(|line| eprintln!("{line}"));
    }
    let recovered = demo.planted.iter().all(|planted| planted.recovered);
    Ok(if recovered { Outcome::Clean } else { Outcome::Findings })
}

fn planted_text(planted: &PlantedFault) -> String {
    let mark = if planted.recovered { "recovered" } else { "missed" };
    format!("{mark:<16}{}", planted.what)
}
