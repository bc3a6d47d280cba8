//! Markdown, as rendered by GitHub.

use poseaudit::finding::Severity;
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

use super::cases::{FAULTS, HOSTILE, hostile, written};

/// The cells of all tables, row by row, as rendered.
fn rows(markdown: &str) -> Vec<Vec<String>> {
    let mut rows: Vec<Vec<String>> = Vec::new();
    let mut is_cell = false;
    for event in Parser::new_ext(markdown, Options::ENABLE_TABLES) {
        match event {
            Event::Start(Tag::TableHead | Tag::TableRow) => rows.push(Vec::new()),
            Event::Start(Tag::TableCell) => {
                rows.last_mut().expect("a row").push(String::new());
                is_cell = true;
            }
            Event::End(TagEnd::TableCell) => is_cell = false,
            Event::Text(text) | Event::Code(text) if is_cell => {
                rows.last_mut().and_then(|row| row.last_mut()).expect("a cell").push_str(&text);
            }
            _ => {}
        }
    }
    rows
}

#[test]
fn the_table_lists_every_finding_with_value_and_fix() {
    let rows = rows(&written("markdown", &FAULTS));
    assert_eq!(rows.len(), 1 + FAULTS.findings.len());
    for (row, finding) in rows[1..].iter().zip(&FAULTS.findings) {
        let [rule, subject, what, amount, fix] = row.as_slice() else {
            panic!("{row:?}");
        };
        assert!(rule.contains(finding.code) && rule.contains(finding.severity.name()));
        assert_eq!(subject, finding.subject.label());
        assert!(what.starts_with(&finding.message), "{what}");
        assert!(amount.contains(" ± "), "{amount}");
        assert_eq!(fix, &finding.fix);
    }
}

#[test]
fn no_name_breaks_a_table_starts_html_or_mentions_a_user() {
    let markdown = written("markdown", &hostile(Some(Severity::Warning)));
    let rows = rows(&markdown);
    // Line ends and control characters become blanks; mentions are disabled.
    let kept = HOSTILE.replace(['\n', '\u{1b}'], " ").replace('@', "@\u{200b}");
    assert_eq!(rows.len(), 2, "{markdown}");
    assert_eq!(rows[1].len(), 5, "{markdown}");
    assert_eq!(rows[1][1], kept);
    assert_eq!(rows[1][4], format!("shift {kept}"));
    let ours = ["<details>", "</details>", "<summary>", "</summary>", "<code>", "</code>", "<br>"];
    let options =
        Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH | Options::ENABLE_FOOTNOTES;
    for event in Parser::new_ext(&markdown, options) {
        match event {
            Event::Html(html) | Event::InlineHtml(html) => {
                let left = ours.iter().fold(html.to_string(), |left, tag| left.replace(tag, ""));
                let left = left.replace("<details open>", "");
                let titles = ["Passed", "Inconclusive", "Skipped"];
                assert!(left.trim().is_empty() || titles.contains(&left.trim()), "{html}");
            }
            Event::Start(Tag::Link { .. } | Tag::Image { .. } | Tag::Emphasis) => {
                panic!("{markdown}");
            }
            _ => {}
        }
    }
    assert!(!markdown.contains("@j") && !markdown.contains("://"), "{markdown}");
}
