//! Words of earlier reports that robot engineers do not use and that must not return.

use std::path::{Path, PathBuf};

use poseaudit::report::Format;
use poseaudit::{Options, audit};

/// Forbidden phrases.
const FORBIDDEN_PHRASES: [&str; 27] = [
    "differ from the controller's by",
    "cannot be told",
    "does not tell",
    "are left beyond",
    "are left when",
    "taken off",
    "leaves the camera open",
    "is needed",
    "does not show it",
    "held against a calibrated",
    "hangs below",
    "are off 1",
    "stand under",
    "jumps or wanders",
    "off what it was told",
    "speak up",
    "whose word",
    "anew",
    "could not tell",
    "the hand turns",
    "no commanded line",
    "others at other times",
    "were looked at",
    "mended",
    "nothing wrong",
    "as noise would",
    "0 µm, 0°",
];

#[test]
fn reports_on_the_fixtures_use_no_forbidden_phrase() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    let entries = folder.read_dir().expect("the fixtures");
    let mut logs: Vec<PathBuf> = entries.map(|entry| entry.expect("a file").path()).collect();
    logs.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    logs.sort();
    assert!(logs.len() > 20, "{logs:?}");
    let mut found = Vec::new();
    for log in logs {
        let report = audit(&Options { logs: vec![log.clone()], ..Options::default() });
        let report = report.expect("a report").report;
        for format in ["text", "html"].map(|name| Format::from_name(name).expect("a format")) {
            let mut out = Vec::new();
            format.write(&report, &mut out).expect("a report");
            let text = String::from_utf8(out).expect("UTF-8");
            let visible_text = remove_sections(
                "<details class=\"values rule\"",
                "</details>",
                &remove_sections("<script", "</script>", &text),
            );
            for phrase in
                FORBIDDEN_PHRASES.into_iter().filter(|phrase| visible_text.contains(phrase))
            {
                let at = visible_text.find(phrase).unwrap_or_default();
                let excerpt: String = visible_text[at..].chars().take(60).collect();
                found.push(format!("{}: {phrase:?} in {excerpt:?}", log.display()));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// A page without the parts from `start` to `end`: its program and data, the texts of the rules.
fn remove_sections(start: &str, end: &str, page: &str) -> String {
    let mut parts = page.split(start);
    let first = parts.next().unwrap_or_default();
    let others = parts.filter_map(|part| Some(part.split_once(end)?.1));
    std::iter::once(first).chain(others).collect()
}
