//! Reports on the fixture logs, compared with `snapshots/`.
//!
//! Numbers are rounded to three digits, to be independent of the platform. After an intended change, run
//! `INSTA_UPDATE=always cargo test --test main checks::reports` and review the diff.

use std::path::Path;

use poseaudit::report::{Report, json, text};
use poseaudit::{Options, audit};
use serde_json::{Number, Value};

fn report(fixture: &str) -> Report {
    let path = Path::new("fixtures").join(fixture);
    assert!(path.exists(), "tests run in the folder of the crate");
    let audited = audit(&Options { logs: vec![path], ..Options::default() }).expect("a report");
    audited.with_figures().report
}

/// The text report, without the version.
fn text_of(report: &Report) -> String {
    let mut out = Vec::new();
    text::write(report, &mut out).expect("a text");
    let text = String::from_utf8(out).expect("UTF-8");
    without_version(&without_styles(&text)).replace('\\', "/")
}

#[test]
fn findings_with_an_amount_or_an_encoding_show_the_error_on_held_out_samples() {
    let fixtures = ["faulty.mcap", "growth.mcap", "convention.mcap", "order.mcap"];
    let mut codes: Vec<&str> = Vec::new();
    for finding in fixtures.iter().flat_map(|fixture| report(fixture).findings) {
        let held_out = &finding.evidence.more["held_out"];
        assert!(held_out["after"]["m"].as_f64() < Some(1e-4), "{} {held_out}", finding.code);
        codes.push(finding.code);
    }
    assert_eq!(codes, ["LAT001", "ZER001", "ZER002", "ORD001", "ORD005"]);
}

/// The JSON report, with rounded numbers.
fn json_of(report: &Report) -> String {
    let mut out = Vec::new();
    json::write(report, &mut out).expect("a text");
    let mut value: Value = serde_json::from_slice(&out).expect("JSON");
    round(&mut value);
    value["tool"]["version"] = "[version]".into();
    without_version(&serde_json::to_string_pretty(&value).expect("JSON")).replace("\\\\", "/")
}

fn without_version(text: &str) -> String {
    text.replace(concat!("poseaudit ", env!("CARGO_PKG_VERSION")), "poseaudit [version]")
}

/// Removes colour escape sequences.
fn without_styles(text: &str) -> String {
    let mut plain = String::new();
    let mut parts = text.split("\u{1b}[");
    plain.extend(parts.next());
    for part in parts {
        plain.extend(part.split_once('m').map(|(_, rest)| rest));
    }
    plain
}

/// Rounds numbers other than counts to three significant digits.
fn round(value: &mut Value) {
    match value {
        Value::Number(number) if number.is_f64() => {
            let short = number.as_f64().map(|number| format!("{number:.2e}"));
            let short = short.and_then(|text| text.parse().ok()).and_then(Number::from_f64);
            *number = short.expect("a number in JSON is finite");
        }
        Value::Array(values) => values.iter_mut().for_each(round),
        Value::Object(fields) => fields.values_mut().for_each(round),
        _ => {}
    }
}

#[test]
fn the_clean_log() {
    let report = report("clean.mcap");
    insta::assert_snapshot!("clean.txt", text_of(&report));
    insta::assert_snapshot!("clean.json", json_of(&report));
}

#[test]
fn the_faulty_log() {
    let report = report("faulty.mcap");
    insta::assert_snapshot!("faulty.txt", text_of(&report));
    insta::assert_snapshot!("faulty.json", json_of(&report));
}
