//! Monte Carlo benchmark: how often the audit is right on unseen logs.
//!
//! Covers arms, motions, rates, noise and planted faults. Every case depends only on the seed and its
//! number, so single cases can be reproduced:
//!
//! ```sh
//! cargo bench --bench verdicts                                  # the table
//! cargo bench --bench verdicts -- --logs 5000 --seed 7
//! cargo bench --bench verdicts -- --verbose --keep /tmp/logs    # and what went wrong, with the logs
//! cargo bench --bench verdicts -- --only 812 --keep /tmp/logs   # one log with its complete result
//! cargo bench --bench verdicts -- --keep /tmp/logs --all         # every log, and the list for `examples/corpus.rs`
//! ```
//!
//! Motion is usual (random and wide), industrial (most of it excites only some directions) or short
//! (demonstrations by uncalibrated arms). For the latter two, a fault must be found if its Fisher
//! information suffices despite link deviations (`observability.rs`); otherwise *inconclusive* is right.
//!
//! A case has a *scene* (structure of the log: rails, namespaces, wrapped joints, second publishers,
//! leaders …; see `scenes.rs`), a *background* (normal imperfections; see `backgrounds.rs`) and *faults*
//! (see `fault_kinds.rs`). Faults are selected from the registry: a rule with a kind of fault is included
//! automatically. A seed gives different logs when a rule or a scene is added. Lost samples are not
//! simulated.

mod backgrounds;
mod cases;
mod fault_kinds;
mod grading;
mod observability;
mod results;
mod scenes;

use std::fmt::Write as _;
use std::fs;
use std::io::{BufWriter, Write as _};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use cases::Case;
use grading::{AuditFailure, Outcome, grade};
use poseaudit::run::RunOptions;
use poseaudit::{Audited, synth};
use results::ResultTable;

fn main() {
    let options = Options::from_args();
    let started = Instant::now();
    let results = run(&options);
    if options.only.is_none() {
        print!("{results}");
    }
    eprintln!("{} logs in {:.0} s", results.logs, started.elapsed().as_secs_f64());
}

pub struct Options {
    pub logs: usize,
    pub seed: u64,
    pub threads: usize,
    /// Folder for logs with wrong outcomes; with `only`, for that log.
    pub keep: Option<PathBuf>,
    /// Keeps all logs, not only those with a wrong answer.
    pub all: bool,
    pub only: Option<usize>,
    /// Numbers of faults to plant, used in turn.
    pub faults: Option<Vec<usize>>,
    /// Kinds of fault to choose from, as prefixes of rule codes.
    pub kinds: Vec<String>,
    pub arms: Vec<String>,
    /// Scenes to choose from, as prefixes of names.
    pub scenes: Vec<String>,
    /// Backgrounds to choose from, as prefixes of names.
    pub backgrounds: Vec<String>,
    /// Kinds of motion to choose from, as prefixes of names.
    pub motions: Vec<String>,
    /// Time after which no further log is started, s.
    pub max_run_s: f64,
    /// Whether to list every wrong outcome, immediately and at the end.
    pub verbose: bool,
}

impl Options {
    fn from_args() -> Self {
        // `cargo test --benches` runs this without `--bench`, as a smoke test.
        let logs = if std::env::args().any(|arg| arg == "--bench") { 1000 } else { 12 };
        let mut options = Self {
            logs,
            seed: 1,
            threads: 2,
            keep: None,
            all: false,
            only: None,
            faults: None,
            kinds: Vec::new(),
            arms: Vec::new(),
            scenes: Vec::new(),
            backgrounds: Vec::new(),
            motions: Vec::new(),
            max_run_s: f64::INFINITY,
            verbose: false,
        };
        let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
        while let Some(name) = args.next() {
            let mut value = || args.next().unwrap_or_else(|| misuse(&name));
            let list = |text: String| text.split(',').map(str::to_owned).collect::<Vec<_>>();
            match name.as_str() {
                "--logs" => options.logs = number(&name, &value()),
                "--seed" => options.seed = number(&name, &value()),
                "--threads" => options.threads = number(&name, &value()),
                "--keep" => options.keep = Some(value().into()),
                "--all" => options.all = true,
                "--only" => options.only = Some(number(&name, &value())),
                "--faults" => {
                    let counts = list(value());
                    options.faults = Some(counts.iter().map(|text| number(&name, text)).collect());
                }
                "--kinds" => options.kinds = list(value()),
                "--verbose" => options.verbose = true,
                "--arms" => options.arms = list(value()),
                "--minutes" => options.max_run_s = 60.0 * number::<f64>(&name, &value()),
                "--backgrounds" => options.backgrounds = list(value()),
                "--motions" => options.motions = list(value()),
                "--scenes" => options.scenes = list(value()),
                _ => misuse(&name),
            }
        }
        options
    }
}

fn number<T: std::str::FromStr>(name: &str, text: &str) -> T {
    text.parse().unwrap_or_else(|_| misuse(name))
}

fn misuse(name: &str) -> ! {
    eprintln!(
        "{name}: not understood; options are --logs N --seed N --threads N --keep DIR --all --only CASE \
         --faults 0,1,2,4 --kinds LAT,ZER001 --arms ur5e,rail --scenes rail --backgrounds links --motions industrial,short --minutes N --verbose"
    );
    std::process::exit(2)
}

fn run(options: &Options) -> ResultTable {
    let cases: Vec<usize> = match options.only {
        Some(only) => vec![only],
        None => (0..options.logs).collect(),
    };
    let started = Instant::now();
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let dir = std::env::temp_dir().join(format!("poseaudit-verdicts-{}", std::process::id()));
    fs::create_dir_all(&dir).expect("a folder for the logs");
    std::thread::scope(|scope| {
        for _ in 0..options.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let at = next.fetch_add(1, Ordering::Relaxed);
                    let Some(&index) = cases.get(at) else { break };
                    if started.elapsed().as_secs_f64() > options.max_run_s {
                        break;
                    }
                    let case = Case::new(options, index);
                    let outcome = audit_case(&case, &dir, options);
                    if let (true, Ok(verdict)) = (options.verbose, &outcome) {
                        for (kind, what) in &verdict.wrong_outcomes {
                            eprintln!("{kind}\n  {case}\n  {what}");
                        }
                    }
                    if at % 100 == 99 {
                        eprintln!("{} of {}", at + 1, cases.len());
                    }
                    results.lock().expect("no thread panics").push((case, outcome));
                }
            });
        }
    });
    fs::remove_dir_all(&dir).expect("the folder of the logs can be removed");
    let mut outcomes = results.into_inner().expect("no thread panics");
    outcomes.sort_by_key(|(case, _)| case.index);
    ResultTable::new(options, &outcomes)
}

fn audit_case(case: &Case, dir: &Path, options: &Options) -> Outcome {
    let log = dir.join(format!("{}.mcap", case.index));
    write(case, &log);
    let audit_options = poseaudit::Options {
        logs: vec![log.clone()],
        run: RunOptions {
            tip: case.names_tip.then(|| case.scenario.tip.clone()),
            robots: case.named_robot.iter().map(|name| name.as_str().into()).collect(),
            ..Default::default()
        },
        ..Default::default()
    };
    let audited = || poseaudit::audit(&audit_options).map(Audited::into_report);
    let audited = catch_unwind(AssertUnwindSafe(audited));
    let outcome = match &audited {
        Err(_) => Err(AuditFailure::Panic),
        Ok(Err(trouble)) => Err(AuditFailure::Refused(trouble.what.clone())),
        Ok(Ok(report)) => match &report.error {
            Some(trouble) => Err(AuditFailure::Refused(trouble.what.clone())),
            None => Ok(grade(case, report)),
        },
    };
    let is_wrong = outcome.as_ref().map_or(true, |verdict| !verdict.wrong_outcomes.is_empty());
    if options.only.is_some() {
        println!("{case}");
        if let Ok(Ok(report)) = &audited {
            for row in &report.checks {
                println!(
                    "{row:?}",
                    row = (
                        row.code,
                        row.subject.label(),
                        row.status,
                        row.reason.as_deref().unwrap_or(""),
                        &row.estimate
                    )
                );
            }
        }
        match &outcome {
            Ok(verdict) => {
                println!("fates: {:?}", verdict.fault_outcomes);
                for (kind, what) in &verdict.wrong_outcomes {
                    println!("{kind}: {what}");
                }
            }
            Err(trouble) => println!("{trouble:?}"),
        }
    }
    if let Some(keep) = &options.keep
        && (is_wrong || options.all || options.only.is_some())
    {
        fs::create_dir_all(keep).expect("the folder to keep logs in");
        let name = format!("s{}-{}", options.seed, case.index);
        fs::copy(&log, keep.join(format!("{name}.mcap"))).expect("the log can be kept");
        let tip =
            if case.names_tip { format!(" --tip {}", case.scenario.tip) } else { String::new() };
        let robot = case.named_robot.iter().map(|name| format!(" --robot {name}"));
        let robot: String = robot.collect();
        let audit = format!("{name}.mcap{tip}{robot}");
        let list = fs::File::options().create(true).append(true).open(keep.join("audits.txt"));
        list.and_then(|mut list| list.write_all(format!("{audit}\n").as_bytes()))
            .expect("the list can be written");
        let mut text = format!("{case}\nBIN audit {audit}\n");
        if let Ok(verdict) = &outcome {
            for (kind, what) in &verdict.wrong_outcomes {
                writeln!(text, "{kind}: {what}").expect("text takes text");
            }
        }
        fs::write(keep.join(format!("{name}.txt")), text).expect("the truth can be kept");
    }
    fs::remove_file(&log).expect("the log can be removed");
    outcome
}

fn write(case: &Case, log: &Path) {
    let out = BufWriter::new(fs::File::create(log).expect("a log can be made"));
    synth::write_cell(&case.arms(), out, None).expect("a log can be written");
}
