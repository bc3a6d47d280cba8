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
        println!("{:#?}", audits::audit_of(&bytes));
        return;
    }
    let Some(seconds) = arguments.next().and_then(|seconds| seconds.parse().ok()) else {
        eprintln!("usage: fuzz_audits SECONDS [FOLDER], or fuzz_audits FILE");
        process::exit(2);
    };
    let folder = PathBuf::from(arguments.next().unwrap_or_else(|| "fuzz/found".to_owned()));
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds/audits");
    let mut kept: Vec<Vec<u8>> = fs::read_dir(seeds)
        .map(|seeds| seeds.flatten().filter_map(|seed| fs::read(seed.path()).ok()).collect())
        .unwrap_or_default();
    kept.push(Vec::new());
    let from = Instant::now();
    let mut random = rand_pcg::Pcg64::seed_from_u64(
        env::var("SEED").map_or(1, |seed| seed.parse().unwrap_or(1)),
    );
    let (mut known, mut runs, mut broken) = (BTreeSet::new(), 0_u64, 0_u64);
    while from.elapsed() < Duration::from_secs(seconds) {
        let mut bytes = kept[random.random_range(0..kept.len())].clone();
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
        let begun_s = audits::processor_s();
        match catch_panic(|| audits::audit_of(&bytes)) {
            Ok(answers) => {
                let before = known.len();
                known.extend(answers);
                if known.len() > before {
                    kept.push(bytes);
                }
            }
            Err(what) => {
                broken += 1;
                let hash = blake3::hash(what.as_bytes()).to_hex();
                let path = folder.join(&hash[..12]);
                fs::create_dir_all(&folder)
                    .and_then(|()| fs::write(&path, &bytes))
                    .unwrap_or_default();
                println!("{}: {}", path.display(), what.chars().take(400).collect::<String>());
            }
        }
        let took_s = audits::processor_s() - begun_s;
        if took_s > SLOW_S {
            let path = folder.join(format!("slow-{runs}"));
            let _ = fs::copy(folder.join("last"), &path);
            println!("{}: {took_s:.1} s", path.display());
        }
        if runs.is_multiple_of(20) {
            let (seconds, answers, kept) = (from.elapsed().as_secs(), known.len(), kept.len());
            println!("{seconds} s: {runs} audits, {answers} answers, {kept} kept, {broken} broken");
        }
    }
    let (answers, kept) = (known.len(), kept.len());
    println!("{runs} audits, {answers} answers, {kept} kept, {broken} broken");
    process::exit(i32::from(broken > 0));
}
