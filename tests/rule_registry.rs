//! Invariants of every rule in the registry.

use std::collections::BTreeSet;

use poseaudit::checks::{FAMILIES, Grade, find, registry};

const SECTIONS: [&str; 5] =
    ["What it means", "Why it matters", "Evidence", "How to fix", "When it misleads"];

#[test]
fn codes_are_unique_and_in_order() {
    let codes: Vec<&str> = registry().iter().map(|rule| rule.code).collect();
    assert!(codes.is_sorted_by(|a, b| a < b), "{codes:?}");
    for code in codes {
        let (family, number) = code.split_at(code.len().saturating_sub(3));
        assert!(family.bytes().all(|byte| byte.is_ascii_uppercase()), "{code}");
        assert!(number.len() == 3 && number.bytes().all(|byte| byte.is_ascii_digit()), "{code}");
    }
}

#[test]
fn names_are_unique_and_kebab_case() {
    let names: BTreeSet<&str> = registry().iter().map(|rule| rule.name).collect();
    assert_eq!(names.len(), registry().len());
    for name in names {
        let words_are_plain = name
            .split('-')
            .all(|word| !word.is_empty() && word.bytes().all(|byte| byte.is_ascii_lowercase()));
        assert!(words_are_plain, "{name}");
    }
}

#[test]
fn every_rule_is_documented_in_all_sections() {
    for rule in registry() {
        let doc = rule.doc();
        let headings: Vec<&str> = doc.lines().filter_map(|line| line.strip_prefix("## ")).collect();
        assert_eq!(headings, SECTIONS, "{}", rule.code);
        for section in doc.split("## ").skip(1) {
            let (heading, text) = section.split_once('\n').unwrap_or_default();
            assert!(text.trim().len() > 40, "{}: too little text in section: {heading}", rule.code);
            assert!(text.trim().ends_with('.'), "{} breaks off in: {heading}", rule.code);
        }
    }
}

#[test]
fn the_readme_lists_every_family_with_its_rules() {
    let readme = include_str!("../README.md");
    for family in FAMILIES {
        let codes: Vec<&str> = family.rules.iter().map(|rule| rule.code).collect();
        let row = format!("\n| {} | {} |\n", family.examines, codes.join(", "));
        assert!(readme.contains(&row), "{row}");
    }
}

#[test]
fn a_summary_is_one_sentence() {
    for rule in registry() {
        let first = rule.doc().lines().next().unwrap_or_default().to_owned();
        assert!(first.starts_with(char::is_uppercase) || first.starts_with('/'), "{first}");
        assert_eq!(first, format!("{}.", rule.summary()));
        assert!(first.chars().count() <= 80, "{first}");
    }
}

#[test]
fn a_warning_comes_before_an_error() {
    for rule in registry() {
        if let Grade::From(thresholds) = rule.grade {
            assert!(!thresholds.is_empty(), "{}", rule.code);
            for threshold in thresholds {
                assert!(
                    0.0 < threshold.warning && threshold.warning < threshold.error,
                    "{}",
                    rule.code
                );
            }
        }
    }
}

#[test]
fn limits_have_keys_different_from_each_other_and_from_thresholds() {
    for rule in registry() {
        let mut keys = BTreeSet::from(["warning", "error", "severity"]);
        for limit in rule.limits {
            let is_plain = limit.key.bytes().all(|b| b.is_ascii_lowercase() || b == b'_');
            assert!(is_plain && keys.insert(limit.key), "{} {}", rule.code, limit.key);
            assert!(limit.value > 0.0 && !limit.what.ends_with('.'), "{} {}", rule.code, limit.key);
        }
    }
}

#[test]
fn the_headline_rules_are_the_documented_ones() {
    let headline = registry().iter().filter(|rule| rule.headline).map(|rule| rule.code);
    assert_eq!(headline.collect::<Vec<_>>(), ["LAT001", "MDL001", "ORD001", "YAW001", "ZER001"]);
}

#[test]
fn rules_are_found_in_any_case() {
    assert_eq!(find(" lat001 ").map(|rule| rule.code), Ok("LAT001"));
}
