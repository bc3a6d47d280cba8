//! Writes the logs of a small fleet: `cargo run --example fleet_logs -- DIR`.
//!
//! Three arms at two sites, with a log every fourth day for two months. In Berlin's cell1 the elbow's zero
//! offset drifts; in cell2 the poses are late from one day on; Oslo has a constant zero offset. One file is
//! not a log. The picture in `docs/fleet.md` shows them.

use std::env;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use poseaudit::synth::{Motion, START, Scenario};

const LOGS_PER_ARM: u32 = 16;
const DAYS_BETWEEN_LOGS: f64 = 4.0;

fn main() -> Result<()> {
    let folder: PathBuf = env::args_os().nth(1).context("name a folder")?.into();
    for (index, arm) in ["berlin/cell1", "berlin/cell2", "oslo/cell1"].into_iter().enumerate() {
        for run in 0..LOGS_PER_ARM {
            let day = DAYS_BETWEEN_LOGS * f64::from(run);
            let mut log = run_without_faults(1 + u64::from(run) + 100 * index as u64);
            log.start = START.shifted(day * 86_400.0);
            match arm {
                "berlin/cell1" => log.joints.zero_offsets = vec![0.0, 0.0, 3e-4 + 1.6e-5 * day],
                "berlin/cell2" if day > 30.0 => log.pose.timing.latency_s = 0.006,
                "berlin/cell2" => {}
                _ => log.joints.zero_offsets = vec![0.0, 0.0, 0.0, 0.004],
            }
            write(&log, &folder.join(arm).join(format!("run_{run:02}.mcap")))?;
        }
    }
    fs::write(folder.join("oslo/cell1/run_16.mcap"), "disk full")?;
    Ok(())
}

fn run_without_faults(seed: u64) -> Scenario {
    let mut run = Scenario::ur5e();
    (run.seed, run.duration_s, run.motion) = (seed, 6.0, Motion::Continuous);
    run.joints.timing.rate_hz = 50.0;
    run.pose.timing.rate_hz = 50.0;
    run.tf.timing.rate_hz = 0.0;
    run.imu.timing.rate_hz = 0.0;
    run
}

fn write(log: &Scenario, path: &Path) -> Result<()> {
    fs::create_dir_all(path.parent().context("a folder")?)?;
    log.write_mcap(BufWriter::new(File::create(path)?), Some(mcap::Compression::Zstd))?;
    Ok(())
}
