//! The formats as they are, for the eye. After a change that is meant, run `INSTA_UPDATE=always cargo
//! test --test main reports` and read the diff.

use serde_json::Value;

use super::cases::{FAULTS, written};

#[test]
fn the_formats_for_eyes() {
    insta::assert_snapshot!("faulty.md", written("markdown", &FAULTS));
    insta::assert_snapshot!("faulty.junit", written("junit", &FAULTS));
    insta::assert_snapshot!("faulty.github", written("github", &FAULTS));
}

/// Without the texts of the rules, which stand in their files, and without numbers to their last bit.
#[test]
fn sarif() {
    let mut log: Value = serde_json::from_str(&written("sarif", &FAULTS)).expect("JSON");
    let run = &mut log["runs"][0];
    run["tool"]["driver"]["semanticVersion"] = "[version]".into();
    run["tool"]["driver"]["rules"].as_array_mut().expect("rules").truncate(1);
    for result in run["results"].as_array_mut().expect("results") {
        result["properties"]["estimate"] = "[estimate]".into();
        result["properties"]["evidence"] = "[evidence]".into();
    }
    let text = serde_json::to_string_pretty(&log).expect("JSON");
    insta::assert_snapshot!("faulty.sarif", text);
}
