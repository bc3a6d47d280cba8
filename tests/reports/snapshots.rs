//! Snapshots of the formats. After an intended change, run `INSTA_UPDATE=always cargo test --test main
//! reports` and review the diff.

use serde_json::Value;

use super::sample_reports::{FAULTY_REPORT, render};

#[test]
fn snapshots_of_the_readable_formats() {
    insta::assert_snapshot!("faulty.md", render("markdown", &FAULTY_REPORT));
    insta::assert_snapshot!("faulty.junit", render("junit", &FAULTY_REPORT));
    insta::assert_snapshot!("faulty.github", render("github", &FAULTY_REPORT));
}

/// Without the texts of the rules, which have their own files, and with rounded numbers.
#[test]
fn sarif() {
    let mut log: Value = serde_json::from_str(&render("sarif", &FAULTY_REPORT)).expect("JSON");
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
