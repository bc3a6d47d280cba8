//! Speed of reading and auditing logs, relative to the minimum cost of reading.
//!
//! The floor is the `mcap` crate's message stream over the same mapped file: it unpacks every chunk and
//! verifies its checksum on one thread, without decoding. For a text table, it is the `csv` crate's reader.
//! Floor and audit run alternately as separate processes, and ratios are computed per pair, to be independent
//! of slow changes of the machine's speed.
//!
//! ```sh
//! cargo bench --bench speed                        # the whole table, with logs of 2.5 million messages
//! cargo bench --bench speed -- --messages 250000   # the same with smaller logs
//! cargo bench --bench speed -- --keep /tmp/logs    # and keeps them
//! cargo bench --bench speed -- --sizes             # only time over size
//! cargo bench --bench speed -- --short             # only short runs, a dataset and a long text table
//! cargo bench --bench speed -- --python python3    # also a dataset, and scripts that users might run instead
//! cargo bench --bench speed -- --python python3 --episodes 10000   # with a larger dataset
//! ```

mod logs;
mod process;
mod short;
mod sizes;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result};
use mcap::read::{Options, RawMessageStream};
use poseaudit::log::{self, ReadOptions};
use poseaudit::robot::catalogue;
use poseaudit::run::{Run, RunOptions};

use logs::Logs;
use process::{Cost, PairedCosts};

/// Default number of messages of the largest log.
const DEFAULT_MESSAGES: u64 = 2_500_000;
/// Default number of episodes of the dataset.
const DEFAULT_EPISODES: usize = 1000;
/// Number of pairs of runs; ratios are medians.
const PAIRS: usize = 5;

fn main() -> Result<()> {
    let arguments: Vec<String> =
        std::env::args().skip(1).filter(|word| word != "--bench").collect();
    if let [mode, path] = arguments.as_slice()
        && mode == "--floor"
    {
        return run_floor(Path::new(path));
    }
    let value = |name: &str| {
        let at = arguments.iter().position(|word| word == name)?;
        arguments.get(at + 1)
    };
    let messages = value("--messages").map_or(Ok(DEFAULT_MESSAGES), |text| text.parse())?;
    let scratch = tempfile::tempdir()?;
    let folder = value("--keep").map_or(scratch.path().to_owned(), PathBuf::from);
    std::fs::create_dir_all(&folder)?;
    if arguments.iter().any(|word| word == "--sizes") {
        return sizes::print_growth(&folder);
    }
    let episodes = value("--episodes").map_or(Ok(DEFAULT_EPISODES), |text| text.parse())?;
    let print_short_runs = || {
        short::print_costs(&folder, PAIRS)?;
        match value("--python") {
            Some(python) => short::print_dataset_costs(&folder, python, episodes),
            None => Ok(()),
        }
    };
    if arguments.iter().any(|word| word == "--short") {
        return print_short_runs();
    }
    let logs = Logs::generate(&folder, messages)?;

    println!(
        "Whole processes; ratios to the floor are medians of {PAIRS} pairs, with their quartiles.\n"
    );
    println!(
        "{:27} {:>9} {:>6} {:>17} {:>17} {:>17} {:>17} {:>7} {:>8}",
        "log", "messages", "MB", "info", "audit", "cpu", "verify", "Mmsg/s", "RssAnon"
    );
    for log in &logs.mcap {
        let pairs = |command: &[&str]| PairedCosts::measure(command, &log.path, PAIRS);
        let info = pairs(&["info"])?;
        let audit = pairs(&["audit", "--format", "json", "--fail-on", "never"])?;
        let verify = pairs(&["audit", "--format", "json", "--fail-on", "never", "--verify"])?;
        println!(
            "{:27} {:>9} {:>6.0} {:>17} {:>17} {:>17} {:>17} {:>7.2} {:>4.0} MiB",
            log.name,
            log.messages,
            log.bytes as f64 / 1e6,
            info.wall,
            audit.wall,
            audit.cpu,
            verify.wall,
            log.messages as f64 / audit.cost.wall_s / 1e6,
            audit.cost.anonymous_mib,
        );
    }

    println!("\nThe same arm in other containers, whole audit, against its MCAP's floor:");
    for log in &logs.others {
        let audit = PairedCosts::measure_against(
            &["audit", "--format", "json", "--fail-on", "never", "--robot", "ur5e"],
            &log.path,
            &logs.reference_log().path,
            PAIRS,
        )?;
        println!(
            "{:27} {:>9} {:>6.0} {:>17} {:>17} cpu",
            log.name,
            log.messages,
            log.bytes as f64 / 1e6,
            audit.wall,
            audit.cpu
        );
    }

    if let Some(python) = value("--python") {
        time_user_scripts(python, &logs.reference_log().path)?;
    }

    println!("\nGrowth with length, whole audit:");
    let mut last: Option<(u64, Cost)> = None;
    for log in &logs.lengths {
        let cost = PairedCosts::measure(&["audit", "--format", "json"], &log.path, PAIRS)?.cost;
        let exponent = last.map(|(messages, before)| {
            let length_ratio = log.messages as f64 / messages as f64;
            (cost.cpu_s / before.cpu_s).ln() / length_ratio.ln()
        });
        let exponent = exponent.map_or(String::new(), |exponent| format!("exponent {exponent:.2}"));
        println!("{:34} {:>9} {:>8.2} s cpu  {exponent}", log.name, log.messages, cost.cpu_s);
        last = Some((log.messages, cost));
    }

    print_short_runs()?;
    sizes::print_growth(&folder)?;
    print_stages(&logs.reference_log().path)?;
    print_fk_rate()
}

/// A table of evenly stamped rows of varying numbers.
fn csv_table(rows: usize, columns: usize) -> String {
    let mut text = "timestamp".to_owned();
    (1..=columns).for_each(|column| text += &format!(",q{column}"));
    for row in 0..rows {
        let t_s = 0.002 * row as f64;
        text += &format!("\n{t_s:.3}");
        for column in 0..columns {
            let rate = 0.3 + 0.1 * column as f64;
            text += &format!(",{:.6}", (rate * t_s + column as f64).sin());
        }
    }
    text + "\n"
}

/// Times equivalent user scripts, if their packages are installed.
fn time_user_scripts(python: &str, log: &Path) -> Result<()> {
    println!("\nScripts, against the same floor:");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/speed/users.py");
    for (mode, what) in [
        ("fk", "rosbags and Pinocchio, FK of two topics"),
        ("count", "mcap, messages counted"),
        ("info", "pymcap-cli info"),
    ] {
        let mut command = Command::new(python);
        match PairedCosts::run(command.arg(&script).arg(mode).arg(log), log, 1) {
            Ok(PairedCosts { wall, cpu, .. }) => println!("{what:42} {wall:>17} {cpu:>17} cpu"),
            Err(error) => println!("{what:42} {error}"),
        }
    }
    Ok(())
}

/// Reads a log with the `mcap` crate, a text table with the `csv` crate.
#[allow(unsafe_code, reason = "the floor maps a file")]
fn run_floor(path: &Path) -> Result<()> {
    if path.extension().is_some_and(|extension| extension == "csv") {
        let (mut reader, mut record) = (csv::Reader::from_path(path)?, csv::ByteRecord::new());
        let mut cells = 0;
        while reader.read_byte_record(&mut record)? {
            cells += record.len();
        }
        println!("{cells} cells");
        return Ok(());
    }
    let file = std::fs::File::open(path)?;
    // SAFETY: nobody else writes the benchmark's own log.
    let map = unsafe { memmap2::Mmap::map(&file) }?;
    let stream = RawMessageStream::new_with_options(&map, Options::ValidateChunkCrcs.into())?;
    let (mut messages, mut bytes) = (0_u64, 0);
    for message in stream {
        bytes += message?.data.len();
        messages += 1;
    }
    println!("{messages} messages of {bytes} bytes");
    Ok(())
}

/// Wall time of each stage of an audit in one process.
fn print_stages(path: &Path) -> Result<()> {
    let paths = [path.to_owned()];
    let started = Instant::now();
    let log = log::open(&paths, &ReadOptions::default())?;
    let read_s = started.elapsed().as_secs_f64();
    let run = Run::assemble(log, &RunOptions::default())?;
    let assembled_s = started.elapsed().as_secs_f64() - read_s;
    drop(run);
    let started = Instant::now();
    let options = poseaudit::Options { logs: paths.to_vec(), ..Default::default() };
    poseaudit::audit(&options).map_err(|trouble| anyhow::anyhow!("{trouble:?}"))?;
    let all_s = started.elapsed().as_secs_f64();
    println!("\nStages of an audit, wall time:");
    for (stage, seconds) in [
        ("read and decode", read_s),
        ("assemble: clocks, roles, rhythms", assembled_s),
        ("diagnose, rules, report", all_s - read_s - assembled_s),
    ] {
        println!("{stage:34} {:>6.3} s {:>5.0} %", seconds, 100.0 * seconds / all_s);
    }
    Ok(())
}

/// FK poses per second on one core.
fn print_fk_rate() -> Result<()> {
    const POSES: usize = 1_000_000;
    let robot = catalogue::find("ur5e").context("the catalogue has a UR5e")?;
    let link = |name: &str| robot.link(name).context("a UR5e has that link");
    let chain = robot.chain(link("base_link")?, link("tool0")?)?;
    let mut jacobian = vec![[0.0; 6]; chain.dof()];
    println!("\nForward kinematics of a UR5e, one core:");
    let rows: Vec<f64> = (0..POSES * chain.dof()).map(|at| 0.3 + 1e-3 * at as f64).collect();
    let time_run = |what: &str, run: &mut dyn FnMut() -> f64| {
        let started = Instant::now();
        std::hint::black_box(run());
        let rate = POSES as f64 / started.elapsed().as_secs_f64();
        println!("{what:34} {:>6.2} million/s", rate / 1e6);
    };
    let each = || rows.chunks_exact(chain.dof());
    time_run("one pose at a time", &mut || each().map(|q| chain.forward(q).translation.x).sum());
    time_run("pose and Jacobian", &mut || {
        each().map(|q| chain.forward_with_jacobian(q, &mut jacobian).translation.x).sum()
    });
    let mut poses = Vec::new();
    time_run("many poses at once", &mut || {
        let thousands = rows.chunks(1000 * chain.dof());
        thousands
            .map(|rows| {
                chain.forward_batch(rows, &mut poses);
                poses.iter().map(|pose| pose.translation.x).sum::<f64>()
            })
            .sum()
    });
    Ok(())
}
