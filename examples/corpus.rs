//! Records the reports of a list of audits, and prints the differences between two records:
//!
//! ```sh
//! cargo run --release --example corpus -- record FOLDER LIST...   # each line of LIST: arguments of `audit`
//! cargo run --release --example corpus -- compare BEFORE AFTER
//! ```
//!
//! Paths in a list are relative to the list. `cargo bench --bench verdicts -- --keep DIR --all` writes one.
//! Options: `--bin PROGRAM` (default: `poseaudit` in the build folder), `--threads N`, `--sigma N` (estimates
//! that moved by fewer standard errors are equal, default 0.01).

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::Mutex;
use std::{env, fs, thread};

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;

const USAGE: &str = "usage: corpus record FOLDER LIST... | corpus compare BEFORE AFTER";
/// Standard errors in half of a 95 % interval.
const STD_ERRORS_OF_95: f64 = 1.96;

fn main() -> Result<ExitCode> {
    let (mut program, mut threads, mut sigma, mut rest) = (None, 2, 0.01, Vec::new());
    let mut args = env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut value = || args.next().with_context(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--bin" => program = Some(PathBuf::from(value()?)),
            "--threads" => threads = value()?.parse()?,
            "--sigma" => sigma = value()?.parse()?,
            _ => rest.push(arg),
        }
    }
    match rest.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["record", folder, lists @ ..] if !lists.is_empty() => {
            let program = program.map_or_else(built_program, Ok)?;
            record(&program, Path::new(folder), lists, threads)?;
            Ok(ExitCode::SUCCESS)
        }
        ["compare", before, after] => {
            let changed = compare(Path::new(before), Path::new(after), sigma)?;
            Ok(ExitCode::from(u8::from(changed)))
        }
        _ => bail!(USAGE),
    }
}

fn built_program() -> Result<PathBuf> {
    let example = env::current_exe()?;
    let profile = example.ancestors().nth(2).context("the example is not in a build folder")?;
    Ok(profile.join(format!("poseaudit{}", env::consts::EXE_SUFFIX)))
}

/// Writes one report per line of the lists to `folder`.
fn record(program: &Path, folder: &Path, lists: &[&str], threads: usize) -> Result<()> {
    fs::create_dir_all(folder)?;
    let mut audits: Vec<(PathBuf, String)> = Vec::new();
    for list in lists {
        let directory = fs::canonicalize(list)?.parent().context("a list is a file")?.to_owned();
        let lines = fs::read_to_string(list)?;
        audits.extend(lines.lines().map(|line| (directory.clone(), line.to_owned())));
    }
    let count = audits.len();
    let (audits, failures) = (Mutex::new(audits), Mutex::new(Vec::new()));
    let next = || audits.lock().expect("no thread panics").pop();
    thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(|| {
                while let Some((directory, line)) = next() {
                    if let Err(error) = record_one(program, folder, &directory, &line) {
                        let failure = format!("{line}: {error:#}");
                        failures.lock().expect("no thread panics").push(failure);
                    }
                }
            });
        }
    });
    let failures = failures.into_inner()?;
    ensure!(failures.is_empty(), "{}", failures.join("\n"));
    println!("{count} reports in {}", folder.display());
    Ok(())
}

fn record_one(program: &Path, folder: &Path, directory: &Path, line: &str) -> Result<()> {
    let name = format!("{} {line}", directory.display()).replace(['/', ' '], "_");
    let report = folder.join(name + ".json");
    let status = Command::new(program)
        .arg("audit")
        .args(line.split_whitespace())
        .args(["--format", "json"])
        .current_dir(directory)
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .stdout(fs::File::create(&report)?)
        .status()?;
    ensure!(matches!(status.code(), Some(0..=3)), "{status}");
    Ok(())
}

/// Prints the differences between two folders of reports. True if there are any.
fn compare(before: &Path, after: &Path, sigma: f64) -> Result<bool> {
    let names = |folder: &Path| -> Result<BTreeSet<_>> {
        let files = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
        files.map(|file| Ok(file?.file_name())).collect()
    };
    let [old, new] = [names(before)?, names(after)?];
    let mut changed = 0;
    for name in old.union(&new) {
        let [was, is] = [answers(&before.join(name)), answers(&after.join(name))];
        let keys: BTreeSet<&String> = was.keys().chain(is.keys()).collect();
        let lines: Vec<String> = keys
            .into_iter()
            .filter_map(|key| difference(key, was.get(key), is.get(key), sigma))
            .collect();
        if !lines.is_empty() {
            changed += 1;
            println!("{}\n  {}", name.display(), lines.join("\n  "));
        }
    }
    println!("{changed} of {} reports changed", old.union(&new).count());
    Ok(changed > 0)
}

/// Status or severity, value and standard error.
type Answer = (String, Option<(f64, f64)>);

/// Answers of a report: the verdict, and one per check and finding. Empty without a report.
fn answers(report: &Path) -> BTreeMap<String, Answer> {
    let text = fs::read_to_string(report).unwrap_or_default();
    let Ok(report) = serde_json::from_str::<Value>(&text) else { return BTreeMap::new() };
    let mut answers = BTreeMap::new();
    answers.insert("verdict".to_owned(), (report["verdict"].to_string(), None));
    let rows = |key: &str| report[key].as_array().cloned().unwrap_or_default();
    for (row, state) in rows("checks")
        .iter()
        .map(|row| (row, "status"))
        .chain(rows("findings").iter().map(|row| (row, "severity")))
    {
        let subject = ["topic", "joint", "frame"].map(|part| row["subject"][part].as_str());
        let subject: Vec<&str> = subject.into_iter().flatten().collect();
        let mut key =
            format!("{} {} {state}", row["code"].as_str().unwrap_or_default(), subject.join(" "));
        while answers.contains_key(&key) {
            key.push('+');
        }
        let estimate = &row["estimate"];
        let interval = [0, 1].map(|end| estimate["ci95"][end].as_f64());
        let amount = match (estimate["value"].as_f64(), interval) {
            (Some(value), [Some(low), Some(high)]) => {
                Some((value, 0.5 * (high - low) / STD_ERRORS_OF_95))
            }
            (value, _) => value.map(|value| (value, 0.0)),
        };
        answers.insert(key, (row[state].as_str().unwrap_or_default().to_owned(), amount));
    }
    answers
}

fn difference(key: &str, was: Option<&Answer>, is: Option<&Answer>, sigma: f64) -> Option<String> {
    let show = |answer: Option<&Answer>| match answer {
        None => "none".to_owned(),
        Some((state, None)) => state.clone(),
        Some((state, Some((value, std_error)))) => format!("{state} {value:.6} ± {std_error:.6}"),
    };
    let is_same = match (was, is) {
        (Some((old_state, old)), Some((state, new))) if old_state == state => match (old, new) {
            (Some((old, old_error)), Some((new, new_error))) => {
                (old - new).abs() <= sigma * old_error.max(*new_error)
            }
            (old, new) => old == new,
        },
        _ => false,
    };
    (!is_same).then(|| format!("{key}: {} → {}", show(was), show(is)))
}
