//! Audits random logs for some time, and keeps those that fail: `cargo run --example fuzz_audits -- SECONDS
//! [FOLDER]`. Replays a kept one with `… -- FILE`.
//!
//! Strings whose audits give new kinds of answers are kept and mutated.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{env, fs, process};

use poseaudit::boundary::catch_panic;
use rand::{Rng, RngExt, SeedableRng};

#[path = "../fuzz/audits.rs"]
mod audits;

/// Minimum processor time of an audit to be kept as slow, s.
const SLOW_S: f64 = 20.0;

fn main() {
    let mut arguments = env::args().skip(1).peekable();
    if let Some(found) = arguments.peek().filter(|found| Path::new(found).is_file()) {
        let bytes = fs::read(found).unwrap_or_default();
        println!("{:#?}", audits::audit_and_check(&bytes));
        return;
    }
    let Some(seconds) = arguments.next().and_then(|seconds| seconds.parse().ok()) else {
        eprintln!("usage: fuzz_audits SECONDS [FOLDER], or fuzz_audits FILE");
        process::exit(2);
    };
    let folder = PathBuf::from(arguments.next().unwrap_or_else(|| "fuzz/found".to_owned()));
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds/audits");
    let mut corpus: Vec<Vec<u8>> = fs::read_dir(seeds)
        .map(|seeds| seeds.flatten().filter_map(|seed| fs::read(seed.path()).ok()).collect())
        .unwrap_or_default();
    corpus.push(Vec::new());
    let started = Instant::now();
    let mut random = rand_pcg::Pcg64::seed_from_u64(
        env::var("SEED").map_or(1, |seed| seed.parse().unwrap_or(1)),
    );
    let (mut known_answers, mut runs, mut failures) = (BTreeSet::new(), 0_u64, 0_u64);
    while started.elapsed() < Duration::from_secs(seconds) {
        let mut bytes = corpus[random.random_range(0..corpus.len())].clone();
        for _ in 0..random.random_range(1..8) {
            let at = random.random_range(0..=bytes.len());
            match random.random_range(0..4) {
                0 if at < bytes.len() => bytes[at] = random.random(),
                1 if at < bytes.len() => drop(bytes.remove(at)),
                2 if bytes.len() < 120 => bytes.insert(at, random.random()),
                _ => {
                    let mut more = vec![0; random.random_range(1..24)];
                    random.fill_bytes(&mut more);
                    bytes.truncate(100);
                    bytes.extend(more);
                }
            }
        }
        runs += 1;
        // Keeps the current string, in case the audit never ends.
        let _ = fs::create_dir_all(&folder).and_then(|()| fs::write(folder.join("last"), &bytes));
        let started_s = audits::processor_time_s();
        match catch_panic(|| audits::audit_and_check(&bytes)) {
            Ok(answers) => {
                let before = known_answers.len();
                known_answers.extend(answers);
                if known_answers.len() > before {
                    corpus.push(bytes);
                }
            }
            Err(what) => {
                failures += 1;
                let hash = blake3::hash(what.as_bytes()).to_hex();
                let path = folder.join(&hash[..12]);
                fs::create_dir_all(&folder)
                    .and_then(|()| fs::write(&path, &bytes))
                    .unwrap_or_default();
                println!("{}: {}", path.display(), what.chars().take(400).collect::<String>());
            }
        }
        let elapsed_s = audits::processor_time_s() - started_s;
        if elapsed_s > SLOW_S {
            let path = folder.join(format!("slow-{runs}"));
            let _ = fs::copy(folder.join("last"), &path);
            println!("{}: {elapsed_s:.1} s", path.display());
        }
        if runs.is_multiple_of(20) {
            let (seconds, answers, corpus) =
                (started.elapsed().as_secs(), known_answers.len(), corpus.len());
            println!(
                "{seconds} s: {runs} audits, {answers} answers, {corpus} kept, {failures} broken"
            );
        }
    }
    let (answers, corpus) = (known_answers.len(), corpus.len());
    println!("{runs} audits, {answers} answers, {corpus} kept, {failures} broken");
    process::exit(i32::from(failures > 0));
}
