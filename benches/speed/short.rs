//! The start of the program, audits of short runs, and a long text table.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use std::process::Command;

use anyhow::Result;
use poseaudit::synth::Scenario;

use crate::process::{Cost, PairedCosts, measure_cost};

const RUNS: usize = 9;
const TABLE_ROWS: usize = 5_000_000;

/// Prints processor times, and the table's ratio to the `csv` crate that reads it.
pub fn print_costs(folder: &Path, pairs: usize) -> Result<()> {
    println!("\nShort runs, medians of {RUNS}:");
    print_cost("start (--version)", &["--version".as_ref()])?;
    for duration_s in [1.0, 40.0] {
        let path = folder.join(format!("{duration_s} s.mcap"));
        let scenario = Scenario { duration_s, ..Scenario::ur5e() };
        scenario.write_mcap(BufWriter::new(File::create(&path)?), Some(mcap::Compression::Zstd))?;
        let arguments = ["audit", "--fail-on", "never"].map(Path::new);
        print_cost(&format!("audit of {duration_s} s"), &[&arguments[..], &[&path]].concat())?;
    }
    let path = folder.join("table.csv");
    fs::write(&path, super::csv_table(TABLE_ROWS, 6))?;
    let table = PairedCosts::measure(&["info", "--robot", "ur5e"], &path, pairs)?;
    println!("info of a table of {TABLE_ROWS} rows: {} wall, {} cpu", table.wall, table.cpu);
    fs::remove_file(path)?;
    Ok(())
}

fn print_cost(what: &str, arguments: &[&Path]) -> Result<()> {
    let run = |_| -> Result<Cost> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
        Ok(measure_cost(command.args(arguments))?.0)
    };
    let mut costs: Vec<Cost> = (0..RUNS).map(run).collect::<Result<_>>()?;
    costs.sort_by(|a, b| a.cpu_s.total_cmp(&b.cpu_s));
    let Cost { wall_s, cpu_s, .. } = costs[RUNS / 2];
    println!("{what:34} {:>6.1} ms cpu {:>6.1} ms wall", 1e3 * cpu_s, 1e3 * wall_s);
    Ok(())
}
