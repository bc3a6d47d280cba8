//! The start of the program, audits of short runs, a dataset of episodes, and a long text table.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;
use std::process::Command;

use anyhow::Result;
use poseaudit::synth::Scenario;

use crate::process::{Cost, PairedCosts, Spread, measure_cost, run_checked};

const RUNS: usize = 9;
const TABLE_ROWS: usize = 5_000_000;

/// Prints costs of the start and of short runs, and the table's ratio to the `csv` crate that reads it.
pub fn print_costs(folder: &Path, pairs: usize) -> Result<()> {
    println!("\nShort runs, {RUNS} runs each:");
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
    println!("\ninfo of a table of {TABLE_ROWS} rows, relative to the csv crate that reads it:");
    println!("{} wall, {} cpu", table.wall, table.cpu);
    fs::remove_file(path)?;
    Ok(())
}

fn print_cost(what: &str, arguments: &[&Path]) -> Result<()> {
    let run = |_| -> Result<Cost> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
        Ok(measure_cost(command.args(arguments))?.0)
    };
    let costs: Vec<Cost> = (0..RUNS).map(run).collect::<Result<_>>()?;
    let spread = |of: fn(&Cost) -> f64| Spread::from_runs(costs.iter().map(|cost| 1e3 * of(cost)));
    let (cpu, wall) = (spread(|cost| cost.cpu_s), spread(|cost| cost.wall_s));
    println!("{what:34} {cpu:>20} ms cpu {wall:>20} ms wall");
    Ok(())
}

/// Prints the cost of `fleet` over a LeRobot dataset that pyarrow wrote, and of reading its columns with pyarrow.
pub fn print_dataset_costs(folder: &Path, python: &str, episodes: usize) -> Result<()> {
    const JOBS: &str = "2";
    let dataset = folder.join(format!("lerobot-{episodes}"));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/speed/lerobot.py");
    let python = |mode: &str| {
        let mut command = Command::new(python);
        command.arg(&script).arg(mode).arg(&dataset);
        command
    };
    if !dataset.exists() {
        run_checked(python("write").arg(episodes.to_string()))?;
    }
    let out = tempfile::tempdir()?;
    let mut fleet = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
    fleet.arg("fleet").arg(&dataset).arg("--out").arg(out.path());
    let audited = run_checked(fleet.args(["--jobs", JOBS, "--fail-on", "never"]))?;
    let read = run_checked(&mut python("read"))?;
    println!("\nA LeRobot dataset of {episodes} episodes of 300 frames, one run:");
    for (what, cost) in
        [("fleet with two jobs", audited), ("pyarrow: reading the same columns", read)]
    {
        let each = |seconds: f64| 1e3 * seconds / episodes as f64;
        println!(
            "{what:34} {:>8.1} s wall {:>8.1} s cpu, {:.2} and {:.2} ms per episode",
            cost.wall_s,
            cost.cpu_s,
            each(cost.wall_s),
            each(cost.cpu_s)
        );
    }
    Ok(())
}
