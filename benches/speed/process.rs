//! Measures the cost of whole processes.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{fmt, fs};

use anyhow::{Context, Result, ensure};

/// Cost of one process.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cost {
    /// Time from start to exit, s.
    pub wall_s: f64,
    /// User and system time of all its threads, s.
    pub cpu_s: f64,
    /// Peak anonymous memory, without mapped files, MiB; 0 if the system does not provide it.
    pub anonymous_mib: f64,
}

/// Median and quartiles of several runs: a ratio of costs, or a cost.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    pub median: f64,
    /// Lower and upper quartile.
    pub quartiles: (f64, f64),
}

impl Spread {
    pub fn from_runs(runs: impl IntoIterator<Item = f64>) -> Self {
        let mut runs: Vec<f64> = runs.into_iter().collect();
        runs.sort_by(f64::total_cmp);
        let at = |share: f64| runs[((runs.len() - 1) as f64 * share).round() as usize];
        Self { median: at(0.5), quartiles: (at(0.25), at(0.75)) }
    }
}

impl fmt::Display for Spread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (low, high) = self.quartiles;
        let decimals = match self.median {
            ..10.0 => 2,
            10.0..100.0 => 1,
            _ => 0,
        };
        f.pad(&format!("{:.decimals$} ({low:.decimals$}–{high:.decimals$})", self.median))
    }
}

/// A command compared with the floor.
pub struct PairedCosts {
    /// Ratio of wall time.
    pub wall: Spread,
    /// Ratio of processor time.
    pub cpu: Spread,
    /// Median cost of the command.
    pub cost: Cost,
}

impl PairedCosts {
    /// Runs `poseaudit COMMAND LOG` and the floor alternately.
    pub fn measure(command: &[&str], log: &Path, pairs: usize) -> Result<Self> {
        Self::measure_against(command, log, log, pairs)
    }

    /// The same with the floor on another file.
    pub fn measure_against(
        command: &[&str],
        log: &Path,
        floor: &Path,
        pairs: usize,
    ) -> Result<Self> {
        let mut command_to_measure = Command::new(env!("CARGO_BIN_EXE_poseaudit"));
        Self::run(command_to_measure.args(command).arg(log), floor, pairs)
    }

    /// Runs any command and the floor alternately.
    pub fn run(command: &mut Command, floor: &Path, pairs: usize) -> Result<Self> {
        let bench = std::env::current_exe()?;
        let mut costs = Vec::new();
        for _ in 0..=pairs {
            let mut floor_of = Command::new(&bench);
            costs.push((run_checked(command)?, run_checked(floor_of.arg("--floor").arg(floor))?));
        }
        // In the first pair, the file is not cached yet.
        costs.remove(0);
        let median = |of: &dyn Fn(&Cost) -> f64| {
            Spread::from_runs(costs.iter().map(|(own, _)| of(own))).median
        };
        let ratio = |of: &dyn Fn(&Cost) -> f64| {
            Spread::from_runs(costs.iter().map(|(own, floor)| of(own) / of(floor)))
        };
        Ok(Self {
            wall: ratio(&|cost| cost.wall_s),
            cpu: ratio(&|cost| cost.cpu_s),
            cost: Cost {
                wall_s: median(&|own| own.wall_s),
                cpu_s: median(&|own| own.cpu_s),
                anonymous_mib: median(&|own| own.anonymous_mib),
            },
        })
    }
}

/// Runs a command; a status other than 0 is an error.
pub fn run_checked(command: &mut Command) -> Result<Cost> {
    let (cost, code) = measure_cost(command)?;
    ensure!(code == Some(0), "{command:?} ended with {code:?}");
    Ok(cost)
}

/// Runs a command, and returns its cost and status.
pub fn measure_cost(command: &mut Command) -> Result<(Cost, Option<i32>)> {
    let before = children_cpu_s();
    let started = Instant::now();
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let (mut anonymous_mib, mut status) = (0.0_f64, None);
    while status.is_none() {
        std::thread::sleep(Duration::from_millis(2));
        anonymous_mib = anonymous_mib.max(anonymous_memory_mib(&child).unwrap_or(0.0));
        status = child.try_wait()?;
    }
    let wall_s = started.elapsed().as_secs_f64();
    let code = status.and_then(|status| status.code());
    Ok((Cost { wall_s, cpu_s: children_cpu_s() - before, anonymous_mib }, code))
}

/// Anonymous memory of a process, MiB.
fn anonymous_memory_mib(child: &Child) -> Result<f64> {
    let status = fs::read_to_string(format!("/proc/{}/status", child.id()))?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"));
    let kilobytes: f64 = line
        .and_then(|line| line.split_whitespace().next())
        .context("not provided by the system")?
        .parse()?;
    Ok(kilobytes / 1024.0)
}

/// Processor time of all finished children, s.
#[allow(unsafe_code, reason = "reads the processor time of a process from the kernel")]
fn children_cpu_s() -> f64 {
    // SAFETY: an all-zero `rusage` is a valid one, and the call writes nothing else.
    let usage = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        libc::getrusage(libc::RUSAGE_CHILDREN, &mut usage);
        usage
    };
    let seconds = |time: libc::timeval| time.tv_sec as f64 + time.tv_usec as f64 * 1e-6;
    seconds(usage.ru_utime) + seconds(usage.ru_stime)
}
