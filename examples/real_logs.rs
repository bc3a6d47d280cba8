//! Audits public recordings of real arms and compares the answers with `tests/real/expected.toml`:
//!
//! ```sh
//! cargo run --release --example real_logs -- FOLDER           # FOLDER/OWNER/NAME, as cloned by git
//! cargo run --example real_logs -- --markdown > docs/real-logs.md
//! ```
//!
//! Options: `--bin PROGRAM` (default: builds it), `--only TEXT` (part of the repository's name), `--threads
//! N`, `--limit SECONDS` for one audit, `--verbose` to also print known differences. Absent sources are
//! skipped. The exit status is 1 if there are differences that are not listed as open.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use anyhow::{Context, Result, bail, ensure};
#[path = "../tests/real/table.rs"]
mod table;

use table::{Expectation, arguments_of, markdown};

/// Answer of the program.
struct Answer {
    verdict: String,
    arm: Option<String>,
    /// Warnings and errors: code and message.
    findings: Vec<(String, String)>,
    /// Of `calibrate`.
    max_held_out_mm: Option<f64>,
    text: String,
}

/// An audit to run.
struct Job<'a> {
    expectation: &'a Expectation,
    logs: Vec<PathBuf>,
}

struct Options {
    folder: PathBuf,
    program: PathBuf,
    only: String,
    threads: usize,
    limit: Duration,
    verbose: bool,
}

fn main() -> Result<ExitCode> {
    let sources = table::sources().context("tests/real/expected.toml")?;
    if env::args().any(|arg| arg == "--markdown") {
        print!("{}", markdown(&sources));
        return Ok(ExitCode::SUCCESS);
    }
    let options = options()?;
    let mut jobs = Vec::new();
    for source in sources.iter().filter(|source| source.repository.contains(&options.only)) {
        let folder = options.folder.join(&source.repository);
        if !folder.is_dir() {
            println!("{}: absent", source.repository);
            continue;
        }
        for expectation in &source.audit {
            let logs = files(&folder, expectation)?;
            ensure!(!logs.is_empty(), "{}: no file {:?}", source.repository, expectation.logs);
            let runs = if expectation.one_run {
                vec![logs]
            } else {
                logs.into_iter().map(|log| vec![log]).collect()
            };
            jobs.extend(runs.into_iter().map(|logs| Job { expectation, logs }));
        }
    }
    let differences = run(&jobs, &options)?;
    let mut failed = false;
    for source in &sources {
        for expectation in &source.audit {
            let pairs = jobs.iter().zip(&differences);
            let line: Vec<_> =
                pairs.filter(|(job, _)| std::ptr::eq(job.expectation, expectation)).collect();
            if line.is_empty() {
                continue;
            }
            let differing: Vec<_> =
                line.iter().copied().filter(|(_, differences)| !differences.is_empty()).collect();
            let right = line.len() - differing.len();
            let logs = &expectation.logs[0];
            let (name, call) = (&source.repository, arguments_of(expectation));
            print!("{name}, {logs}, {call}: {right} of {} right", line.len());
            match &expectation.open {
                Some(_) if differing.is_empty() => println!("; no longer open: delete `open`"),
                Some(reason) => println!("; open: {reason}"),
                None => println!(),
            }
            failed |= expectation.open.is_none() && !differing.is_empty();
            if expectation.open.is_none() || options.verbose {
                print_differing(&differing);
            }
        }
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Prints equal differences once, with their logs.
fn print_differing(differing: &[(&Job, &Vec<String>)]) {
    let mut logs: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (job, differences) in differing {
        let name = job.logs[0].file_name().unwrap_or_default().to_string_lossy().into_owned();
        logs.entry(differences.join("; ")).or_default().push(name);
    }
    for (differences, logs) in logs {
        println!("    {differences}: {}", logs.join(", "));
    }
}

fn options() -> Result<Options> {
    let mut folder = None;
    let (mut program, mut only, mut threads, mut limit_s, mut verbose) =
        (None, String::new(), 2, 60, false);
    let mut args = env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().with_context(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--bin" => program = Some(PathBuf::from(value()?)),
            "--only" => only = value()?,
            "--threads" => threads = value()?.parse()?,
            "--limit" => limit_s = value()?.parse()?,
            "--verbose" => verbose = true,
            _ if folder.is_none() && !arg.starts_with('-') => folder = Some(PathBuf::from(arg)),
            _ => bail!(
                "{arg}: not understood; usage: real_logs FOLDER [--bin PROGRAM] [--only TEXT] [--threads N] [--limit SECONDS] [--verbose], or real_logs --markdown"
            ),
        }
    }
    let folder = folder.context("the folder of the recordings is missing")?;
    let program = program.map_or_else(build_program, Ok)?;
    let limit = Duration::from_secs(limit_s);
    Ok(Options { folder, program, only, threads, limit, verbose })
}

/// Builds the program in the profile of this example and returns its path.
fn build_program() -> Result<PathBuf> {
    let mut build = Command::new(env!("CARGO"));
    build.args(["build", "--quiet", "--bin", "poseaudit"]).current_dir(env!("CARGO_MANIFEST_DIR"));
    if !cfg!(debug_assertions) {
        build.arg("--release");
    }
    ensure!(build.status()?.success(), "the program does not build");
    let example = env::current_exe()?;
    let profile = example.ancestors().nth(2).context("the example is not in a build folder")?;
    Ok(profile.join(format!("poseaudit{}", env::consts::EXE_SUFFIX)))
}

/// Sorted non-empty files below `folder` that match an expectation.
fn files(folder: &Path, expectation: &Expectation) -> Result<Vec<PathBuf>> {
    let mut found = BTreeSet::new();
    for pattern in &expectation.logs {
        let folder = glob::Pattern::escape(&folder.to_string_lossy());
        for file in glob::glob(&format!("{folder}/{pattern}"))? {
            let file = file?;
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            if file.metadata()?.len() > 0 && !expectation.except.iter().any(|other| *other == name)
            {
                found.insert(file);
            }
        }
    }
    Ok(found.into_iter().collect())
}

/// Runs all jobs and returns the differences of each, in order.
fn run(jobs: &[Job], options: &Options) -> Result<Vec<Vec<String>>> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..options.threads.max(1) {
            scope.spawn(|| {
                while let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let differences = match audit(job, options) {
                        Ok(answer) => differences(job.expectation, &answer),
                        Err(error) => vec![format!("{error:#}")],
                    };
                    results
                        .lock()
                        .expect("no thread panics")
                        .push((std::ptr::from_ref(job) as usize, differences));
                }
            });
        }
    });
    let mut results = results.into_inner()?;
    results.sort_by_key(|(job, _)| *job);
    Ok(results.into_iter().map(|(_, differences)| differences).collect())
}

/// Audits the logs of a job like a user.
fn audit(job: &Job, options: &Options) -> Result<Answer> {
    let dir = tempfile::tempdir()?;
    let mut command = Command::new(&options.program);
    command.arg(job.expectation.command.as_deref().unwrap_or("audit"));
    if job.expectation.command.as_deref() == Some("calibrate") {
        command.arg("--out").arg(dir.path().join("calibrated"));
    }
    for log in &job.logs {
        match &job.expectation.header {
            None => command.arg(log),
            Some(header) => {
                let copy = dir.path().join(log.file_name().context("a log is a file")?);
                fs::write(&copy, format!("{header}\n{}", fs::read_to_string(log)?))?;
                command.arg(copy)
            }
        };
    }
    command.args(&job.expectation.args);
    if let Some(config) = &job.expectation.config {
        let file = dir.path().join("poseaudit.toml");
        fs::write(&file, config)?;
        command.arg("--config").arg(file);
    }
    // Files, because a full pipe would block the program.
    let (out, err) = (dir.path().join("report.json"), dir.path().join("messages"));
    command.args(["--format", "json"]).stdin(Stdio::null());
    command.stdout(fs::File::create(&out)?).stderr(fs::File::create(&err)?);
    let mut child = command.spawn().with_context(|| options.program.display().to_string())?;
    let started = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if started.elapsed() > options.limit {
            child.kill()?;
            child.wait()?;
            bail!("no answer within {} s", options.limit.as_secs());
        }
        thread::sleep(Duration::from_millis(20));
    };
    let report = fs::read_to_string(&out)?;
    let text = format!("{report}{}", fs::read_to_string(&err)?);
    let Ok(report) = serde_json::from_str::<serde_json::Value>(&report) else {
        ensure!(status.code() != Some(70), "it panicked: {text}");
        return Ok(Answer {
            verdict: "refused".to_owned(),
            arm: None,
            findings: Vec::new(),
            max_held_out_mm: None,
            text,
        });
    };
    if report["schema"] == "poseaudit.calibration/1" {
        return Ok(calibration(&report, text));
    }
    let audited = report["error"].is_null();
    let findings = report["findings"].as_array().into_iter().flatten();
    let findings = findings.filter(|finding| finding["severity"] != "info");
    let findings = findings.map(|finding| {
        let [code, message] =
            ["code", "message"].map(|field| finding[field].as_str().unwrap_or_default().to_owned());
        (code, message)
    });
    Ok(Answer {
        verdict: if audited {
            report["verdict"].as_str().unwrap_or_default()
        } else {
            "not audited"
        }
        .to_owned(),
        arm: report["robots"][0]["name"].as_str().map(str::to_owned),
        findings: findings.collect(),
        max_held_out_mm: None,
        text,
    })
}

/// Answer of `calibrate`.
fn calibration(report: &serde_json::Value, text: String) -> Answer {
    let verdict = match (&report["refused"], report["equals_model"] == true) {
        (why, _) if !why.is_null() => "rejected",
        (_, true) => "unchanged",
        _ => "calibrated",
    };
    let streams = report["streams"].as_array().into_iter().flatten();
    let residuals = streams.filter_map(|stream| stream["held_out"]["after"]["m"].as_f64());
    Answer {
        verdict: verdict.to_owned(),
        arm: report["arm"].as_str().map(str::to_owned),
        findings: Vec::new(),
        max_held_out_mm: residuals.map(|m| 1e3 * m).reduce(f64::max),
        text,
    }
}

/// Differences between an answer and the expectation.
fn differences(expected: &Expectation, answer: &Answer) -> Vec<String> {
    let mut differences = Vec::new();
    if !expected.verdict.contains(&answer.verdict) {
        let message = if answer.verdict == "refused" {
            answer.text.lines().next().unwrap_or_default()
        } else {
            ""
        };
        differences.push(format!(
            "{}, not {} {message}",
            answer.verdict,
            expected.verdict.join(" or ")
        ));
    }
    let is_audited = !["refused", "not audited"].contains(&answer.verdict.as_str());
    if is_audited
        && !expected.arm.is_empty()
        && !answer.arm.as_ref().is_some_and(|arm| expected.arm.contains(arm))
    {
        let arm = answer.arm.as_deref().unwrap_or("no arm");
        differences.push(format!("{arm}, not {}", expected.arm.join(" or ")));
    }
    let is_found = |code: &&String| answer.findings.iter().any(|(found, _)| found == *code);
    for code in expected.must.iter().filter(|code| !is_found(code)) {
        differences.push(format!("{code} is missing"));
    }
    let wrong = answer.findings.iter();
    let wrong =
        wrong.filter(|(code, _)| !expected.must.contains(code) && !expected.may.contains(code));
    differences.extend(wrong.map(|(code, message)| format!("false {code} '{message}'")));
    if let Some(most) = expected.max_held_out_mm
        && !answer.max_held_out_mm.is_some_and(|found| found <= most)
    {
        differences.push(format!("held-out residual {:?} mm, not {most}", answer.max_held_out_mm));
    }
    let missing = expected.says.iter().filter(|text| !answer.text.contains(text.as_str()));
    differences.extend(missing.map(|text| format!("'{text}' is missing")));
    differences
}
