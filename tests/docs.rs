//! What the documents promise.

use std::fs;
use std::path::Path;
use std::process::Command;

/// The rows of all tables of a document that have so many columns, without their heads.
fn rows<const N: usize>(document: &str) -> Vec<[String; N]> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(document);
    let text = fs::read_to_string(path).expect("the document");
    let cells = |line: &str| -> Option<[String; N]> {
        let inner = line.strip_prefix("| ")?.strip_suffix(" |")?;
        inner.split(" | ").map(str::to_owned).collect::<Vec<_>>().try_into().ok()
    };
    text.lines().filter_map(cells).filter(|cells| cells[0] != "symptom").collect()
}

/// What stands in backquotes, of a cell that is nothing else.
fn quoted(cell: &str) -> &str {
    let inner = cell.strip_prefix('`').and_then(|cell| cell.strip_suffix('`'));
    inner.unwrap_or_else(|| panic!("not in backquotes: {cell}"))
}

#[test]
fn every_symptom_has_the_answer_that_is_promised() {
    let rows = rows::<4>("symptoms.md");
    assert!(rows.len() >= 30, "only {} rows were read", rows.len());
    for [symptom, _, call, says] in rows {
        let mut words = quoted(&call).split(' ');
        assert_eq!(words.next(), Some("poseaudit"), "{call}");
        let output = Command::new(env!("CARGO_BIN_EXE_poseaudit"))
            .args(words)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .expect("the binary runs");
        let text = String::from_utf8_lossy(&output.stdout);
        let found = match quoted(&says) {
            // Of a fault in a log a finding is promised, not that the rule was asked.
            code if call.contains(" audit ") && is_code(code) => {
                text.lines().any(|line| is_finding(line, code)) || passes(&call, &text, code)
            }
            words => text.contains(words),
        };
        assert!(
            matches!(output.status.code(), Some(0 | 1)) && found,
            "{symptom}\n{call}\n{text}{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
}

fn is_code(word: &str) -> bool {
    word.len() == 6 && word[3..].bytes().all(|byte| byte.is_ascii_digit())
}

fn is_finding(line: &str, code: &str) -> bool {
    ["error", "warning", "info"]
        .iter()
        .any(|severity| line.starts_with(&format!("{severity} {code}")))
}

/// Whether the call asks single rules, of which some are meant to pass.
fn passes(call: &str, text: &str, code: &str) -> bool {
    call.contains("--select") && text.contains(code)
}

#[path = "../docs/pages.rs"]
mod pages;

#[test]
fn the_pages_of_the_rules_are_current() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let symptoms = fs::read_to_string(docs.join("symptoms.md")).expect("the document");
    for (name, text) in pages::all(&symptoms) {
        let kept = fs::read_to_string(docs.join("rules").join(&name)).unwrap_or_default();
        assert!(
            kept.replace("\r\n", "\n") == text,
            "docs/rules/{name} is not current: run `cargo run --example rule_pages`"
        );
    }
}
