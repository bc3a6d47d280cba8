//! Cost of a fleet audit: parallel efficiency on two cores, a call with nothing left to do, and memory.
//!
//! `cargo bench --bench fleet` generates a thousand short logs and audits them on one core and on two, into
//! separate folders. It then calls the program again when all are done. Environment variables:
//! `POSEAUDIT_FLEET_LOGS` (number of logs), `POSEAUDIT_FLEET_BIN` (program), `POSEAUDIT_FLEET_SECONDS`
//! (duration of each log), `POSEAUDIT_FLEET_KEEP` (folder in which to keep the logs).

use std::env;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Result, ensure};
use poseaudit::synth::{Motion, Scenario};

fn main() -> Result<()> {
    let number = |name: &str, default: f64| {
        env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
    };
    let logs = number("POSEAUDIT_FLEET_LOGS", 1000.0) as u64;
    let duration_s = number("POSEAUDIT_FLEET_SECONDS", 10.0);
    let binary = env::var_os("POSEAUDIT_FLEET_BIN").map(PathBuf::from);
    let binary = binary.unwrap_or_else(|| env!("CARGO_BIN_EXE_poseaudit").into());
    let folder = tempfile::tempdir()?;
    let kept_folder = env::var_os("POSEAUDIT_FLEET_KEEP").map(PathBuf::from);
    let log_folder = kept_folder.unwrap_or_else(|| folder.path().join("logs"));
    let bytes = write_logs(&log_folder, logs, duration_s)?;
    let megabytes = bytes as f64 / 1e6;
    println!("{logs} logs of {duration_s} s, {megabytes:.0} MB, by {}", binary.display());

    let call = |jobs: usize, out: &str| {
        measure_call(&binary, &log_folder, &folder.path().join(out), jobs, logs)
    };
    // A first call to load files and program into memory.
    let first = call(2, "two")?;
    let one = call(1, "one")?;
    let again = call(2, "two again")?;
    let two = if again.wall < first.wall { again } else { first };
    let done = call(2, "two")?;
    let efficiency = one.wall.as_secs_f64() / (2.0 * two.wall.as_secs_f64());
    println!("| | wall | logs/s | memory of the leader | of all its processes |");
    println!("|---|---|---|---|---|");
    for (name, cost) in [("one core", &one), ("two cores", &two), ("all done", &done)] {
        let wall_s = cost.wall.as_secs_f64();
        println!(
            "| {name} | {wall_s:.2} s | {:.1} | {:.0} MiB | {:.0} MiB |",
            logs as f64 / wall_s,
            cost.leader_kib as f64 / 1024.0,
            cost.all_kib as f64 / 1024.0
        );
    }
    println!("two-core efficiency {efficiency:.2}");
    Ok(())
}

/// Writes distinct logs, and returns their size.
fn write_logs(folder: &Path, count: u64, duration_s: f64) -> Result<u64> {
    fs::create_dir_all(folder)?;
    let mut bytes = 0;
    for seed in 0..count {
        let mut run = Scenario::ur5e();
        (run.seed, run.duration_s, run.motion) = (seed + 1, duration_s, Motion::Continuous);
        run.imu.timing.rate_hz = 0.0;
        // One log in ten has a fault.
        run.pose.timing.latency_s = if seed % 10 == 0 { 0.015 } else { 0.0 };
        let path = folder.join(format!("{seed:05}.mcap"));
        run.write_mcap(BufWriter::new(File::create(&path)?), Some(mcap::Compression::Zstd))?;
        bytes += fs::metadata(&path)?.len();
    }
    Ok(bytes)
}

/// Cost of a call.
struct Cost {
    wall: Duration,
    /// Peak anonymous memory of the parent process.
    leader_kib: u64,
    /// Peak anonymous memory of the parent and all log processes.
    all_kib: u64,
}

fn measure_call(
    binary: &Path,
    log_folder: &Path,
    out: &Path,
    jobs: usize,
    logs: u64,
) -> Result<Cost> {
    let started = Instant::now();
    let mut child = Command::new(binary)
        .arg("fleet")
        .args([log_folder, Path::new("--out"), out])
        .args(["--jobs", &jobs.to_string(), "--format", "json", "--fail-on", "never"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()?;
    let (leader_kib, all_kib) = peak_memory_kib(&mut child)?;
    let wall = started.elapsed();
    let output = child.wait_with_output()?;
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    ensure!(summary["statuses"]["audited"] == logs, "not all logs were audited: {summary}");
    Ok(Cost { wall, leader_kib, all_kib })
}

/// Peak memory of a process, and of it with its children, until it exits, KiB. May miss processes of a few
/// milliseconds.
fn peak_memory_kib(child: &mut Child) -> Result<(u64, u64)> {
    let (mut leader, mut all) = (0, 0);
    let id = child.id();
    while child.try_wait()?.is_none() {
        let own = anonymous_kib(id).unwrap_or(0);
        let others: u64 = children(id).into_iter().filter_map(anonymous_kib).sum();
        leader = leader.max(own);
        all = all.max(own + others);
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok((leader, all))
}

fn anonymous_kib(id: u32) -> Option<u64> {
    let status = fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    line.split_whitespace().next()?.parse().ok()
}

fn children(id: u32) -> Vec<u32> {
    let tasks = fs::read_dir(format!("/proc/{id}/task")).into_iter().flatten().flatten();
    let lists = tasks.filter_map(|task| fs::read_to_string(task.path().join("children")).ok());
    let lists: Vec<String> = lists.collect();
    lists.iter().flat_map(|list| list.split_whitespace()).filter_map(|id| id.parse().ok()).collect()
}
