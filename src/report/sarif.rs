//! Report as SARIF 2.1.0 for code scanning.
//!
//! Findings are results; ignored ones are suppressed. Inconclusive checks are notifications of the
//! invocation: they are neither results nor passes.

use std::io::{self, Write};
use std::path::Path;

use percent_encoding::utf8_percent_encode;
use serde_json::{Map, Value, json};

use super::Report;
use super::outline::Outline;
use crate::checks::{self, Grade, Rule};
use crate::finding::{Finding, IgnoredFinding, Severity, Status, Subject};
use crate::log::{ESCAPED, is_url};

const SCHEMA: &str =
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json";

/// Writes the report.
pub fn write(report: &Report, out: &mut dyn Write) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, &log(report))?;
    writeln!(out)
}

fn log(report: &Report) -> Value {
    let rules = checks::registry();
    let artifacts = report.log.files.iter().map(|file| {
        json!({
            "location": { "uri": uri(&file.path) },
            "length": file.bytes,
            "roles": ["analysisTarget"],
        })
    });
    let found = report.findings.iter().map(|finding| result(report, finding));
    let results = found.chain(report.ignored.iter().map(|known| suppressed_result(report, known)));
    json!({
        "$schema": SCHEMA,
        "version": "2.1.0",
        "runs": [{
            // The part before the last slash distinguishes the logs of one commit.
            "automationDetails": { "id": format!("poseaudit/{}/", artifact(report)) },
            "tool": {
                "driver": {
                    "name": env!("CARGO_PKG_NAME"),
                    "semanticVersion": env!("CARGO_PKG_VERSION"),
                    "shortDescription": { "text": env!("CARGO_PKG_DESCRIPTION") },
                    "rules": rules.iter().map(|rule| descriptor(rule)).collect::<Vec<_>>(),
                },
            },
            "invocations": [{
                "executionSuccessful": report.error.is_none(),
                "toolExecutionNotifications": notifications(report),
            }],
            "artifacts": artifacts.collect::<Vec<_>>(),
            "results": results.collect::<Vec<_>>(),
            "properties": { "verdict": report.verdict },
        }],
    })
}

fn artifact(report: &Report) -> String {
    report.log.files.first().map_or_else(String::new, |file| uri(&file.path))
}

fn descriptor(rule: &Rule) -> Value {
    let gravest = match rule.grade {
        Grade::Fixed(severity) => severity,
        Grade::From(_) => Severity::Warning,
    };
    let doc = rule.doc();
    let plain: Vec<&str> =
        doc.lines().map(|line| line.strip_prefix("## ").unwrap_or(line)).collect();
    json!({
        "id": rule.code,
        "name": rule.name,
        "shortDescription": escaped_message(&format!("{}.", rule.summary())),
        "fullDescription": escaped_message(&format!("{}. Severity: {}.", rule.summary(), rule.grade)),
        "help": { "text": plain.join("\n"), "markdown": doc },
        "defaultConfiguration": { "level": level(gravest) },
        "properties": { "tags": ["robotics", rule.family()] },
    })
}

/// Inconclusive checks, and an error that limited the audit.
fn notifications(report: &Report) -> Vec<Value> {
    let trouble = report.error.iter().map(|trouble| {
        let locations =
            report.main_file().map(|file| json!({ "physicalLocation": physical_location(file) }));
        json!({
            "level": "error",
            "message": escaped_message(&trouble.to_string()),
            "locations": locations.into_iter().collect::<Vec<_>>(),
        })
    });
    let outline = Outline::new(report);
    let open = report.checks.iter().filter(|row| row.status == Status::Inconclusive);
    let open = open.map(|row| {
        let subject = outline.subject(&row.subject);
        let reason = row.reason.as_deref().unwrap_or_default();
        let text = format!("{} on {subject} is inconclusive: {reason}", row.code);
        json!({
            "level": "note",
            "message": escaped_message(&text),
            "associatedRule": { "id": row.code, "index": rule_index(row.code) },
        })
    });
    trouble.chain(open).collect()
}

fn result(report: &Report, finding: &Finding) -> Value {
    let cause = fingerprint(report, finding);
    let mut location = Map::new();
    if let Some(file) = report.log.files.first() {
        location.insert("physicalLocation".to_owned(), physical_location(&file.path));
    }
    let logical = logical_locations(&finding.subject);
    if !logical.is_empty() {
        location.insert("logicalLocations".to_owned(), logical.into());
    }
    let locations: Vec<_> = (!location.is_empty()).then_some(location).into_iter().collect();
    let stamp = |stamp: Option<crate::time::Stamp>| stamp.map(|stamp| stamp.to_string());
    json!({
        "ruleId": finding.code,
        "ruleIndex": rule_index(finding.code),
        "level": level(finding.severity),
        "message": escaped_message(&message(report, finding)),
        "locations": locations,
        // GitHub uses the second one.
        "partialFingerprints": { "cause/v1": cause, "primaryLocationLineHash": cause },
        "properties": {
            "estimate": finding.estimate,
            "evidence": finding.evidence,
            "fix": finding.fix,
            "start_ns": stamp(finding.start_ns),
            "end_ns": stamp(finding.end_ns),
        },
    })
}

fn suppressed_result(report: &Report, known: &IgnoredFinding) -> Value {
    let mut result = result(report, &known.finding);
    let justification = format!("{} ({})", known.reason, known.place);
    result["suppressions"] = json!([{ "kind": "external", "justification": justification }]);
    result
}

fn message(report: &Report, finding: &Finding) -> String {
    let outline = Outline::new(report);
    let subject = outline.subject(&finding.subject);
    let subject = if subject.is_empty() { subject } else { format!("{subject}: ") };
    let about = match outline.finding_lines(finding).as_slice() {
        [] => String::new(),
        lines => format!(" ({})", lines.join("; ")),
    };
    format!("{subject}{}{about}. Fix: {}", finding.message, finding.fix)
}

/// Escapes placeholders and links (SARIF 2.1.0, §3.11.5 and §3.11.6): names in a log may look like either.
fn escaped_message(text: &str) -> Value {
    let mut text = text.replace('{', "{{").replace('}', "}}");
    if text.contains("](") {
        text = text.replace('[', "\\[").replace(']', "\\]");
    }
    json!({ "text": text })
}

fn rule_index(code: &str) -> Option<usize> {
    checks::registry().iter().position(|rule| rule.code == code)
}

/// Stable between runs: rule and subject, without amounts and file names.
fn fingerprint(report: &Report, finding: &Finding) -> String {
    let is_file = |name: &str| report.log.files.iter().any(|file| file.path == Path::new(name));
    let parts = finding.subject.parts().map(|(kind, name)| {
        if is_file(name) { " the log".to_owned() } else { format!(" {kind}={name}") }
    });
    format!("{}{}", finding.code, parts.collect::<String>())
}

/// Logs have no lines, but viewers require one.
fn physical_location(path: &Path) -> Value {
    json!({ "artifactLocation": { "uri": uri(path) }, "region": { "startLine": 1 } })
}

fn logical_locations(subject: &Subject) -> Vec<Value> {
    let places = subject
        .parts()
        .map(|(kind, name)| json!({ "name": name, "fullyQualifiedName": name, "kind": kind }));
    places.collect()
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
        Severity::Info => "note",
    }
}

/// Relative as given, absolute with the scheme `file`, or the URL of an object.
fn uri(path: &Path) -> String {
    if let Some((scheme, rest)) =
        path.to_str().filter(|_| is_url(path)).and_then(|url| url.split_once("://"))
    {
        // Only a web address is already encoded.
        let is_web = matches!(scheme, "http" | "https");
        let rest = if is_web { rest.to_owned() } else { uri(Path::new(rest)) };
        return format!("{scheme}://{rest}");
    }
    let text = path.to_string_lossy().replace('\\', "/");
    let scheme = match path.is_absolute() {
        true if text.starts_with('/') => "file://",
        true => "file:///",
        false => "",
    };
    format!("{scheme}{}", utf8_percent_encode(&text, ESCAPED))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_and_links_are_escaped() {
        assert_eq!(escaped_message("/a{0}/pose is late")["text"], "/a{{0}}/pose is late");
        assert_eq!(escaped_message("/[here](1) is late")["text"], r"/\[here\](1) is late");
        assert_eq!(escaped_message("part [2] (of 3)")["text"], "part [2] (of 3)");
    }

    #[test]
    fn a_path_becomes_a_uri() {
        assert_eq!(uri(Path::new("logs/run 1.mcap")), "logs/run%201.mcap");
        assert_eq!(uri(Path::new("a:b#ü.bag")), "a%3Ab%23%C3%BC.bag");
        assert_eq!(uri(Path::new("s3://logs/a b.mcap")), "s3://logs/a%20b.mcap");
        assert_eq!(uri(Path::new("http://h:80/a%20b.mcap")), "http://h:80/a%20b.mcap");
        #[cfg(unix)]
        assert_eq!(uri(Path::new("/var/run.mcap")), "file:///var/run.mcap");
    }
}
