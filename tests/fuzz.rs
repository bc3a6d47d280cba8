//! The seeds of the fuzz targets, complete and damaged: nothing panics, and readers keep their invariants.

use std::fs;
use std::path::Path;

use rand::{Rng, RngExt, SeedableRng};

#[path = "../fuzz/feed.rs"]
mod feed;

#[test]
fn complete_truncated_and_overwritten_seeds_do_not_panic() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    let mut random = rand_pcg::Pcg64::seed_from_u64(4);
    for (target, _) in feed::TARGETS {
        let seeds = fs::read_dir(folder.join(target)).unwrap().map(|entry| entry.unwrap().path());
        let mut seeds: Vec<_> = seeds.collect();
        seeds.sort();
        assert!(!seeds.is_empty(), "{target} has no seed");
        for seed in seeds {
            let bytes = fs::read(seed).unwrap();
            feed::feed(target, &bytes);
            for percent in 1..100 {
                feed::feed(target, &bytes[..bytes.len() * percent / 100]);
                let mut overwritten = bytes.clone();
                let length = bytes.len().min(64);
                let start = random.random_range(0..=bytes.len() - length);
                random.fill_bytes(&mut overwritten[start..start + length]);
                feed::feed(target, &overwritten);
            }
        }
    }
}

#[path = "../fuzz/audits.rs"]
mod audits;

#[test]
fn audits_of_all_seeds_keep_the_invariants_of_reports() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds/audits");
    let mut seeds: Vec<_> =
        fs::read_dir(folder).unwrap().map(|seed| seed.unwrap().path()).collect();
    seeds.sort();
    assert!(!seeds.is_empty());
    let mut answers = std::collections::BTreeSet::new();
    for seed in seeds {
        answers.extend(audits::audit_and_check(&fs::read(seed).unwrap()));
    }
    // The results must vary, or this test shows nothing.
    for code in ["0", "1", "ING003 Warning", "ING003 Pass"] {
        assert!(answers.iter().any(|answer| answer.starts_with(code)), "{code}: {answers:?}");
    }
}
