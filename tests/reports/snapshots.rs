//! Snapshots of the formats. After an intended change, run `INSTA_UPDATE=always cargo test --test main
//! reports` and review the diff.

use serde_json::Value;

use super::cases::{FAULTS, written};

#[test]
fn snapshots_of_the_readable_formats() {
    insta::assert_snapshot!("faulty.md", written("markdown", &FAULTS));
    insta::assert_snapshot!("faulty.junit", written("junit", &FAULTS));
    insta::assert_snapshot!("faulty.github", written("github", &FAULTS));
}

/// Without the texts of the rules, which have their own files, and with rounded numbers.
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
