//! Markdown, as rendered by GitHub.

use poseaudit::finding::Severity;
use pulldown_cmark::{Event, Options, Parser, Tag, TagEnd};

use super::sample_reports::{FAULTY_REPORT, HOSTILE_NAME, hostile_report, render};

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
    let rows = rows(&render("markdown", &FAULTY_REPORT));
    assert_eq!(rows.len(), 1 + FAULTY_REPORT.findings.len());
    for (row, finding) in rows[1..].iter().zip(&FAULTY_REPORT.findings) {
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
    let markdown = render("markdown", &hostile_report(Some(Severity::Warning)));
    let rows = rows(&markdown);
    // Line ends and control characters become blanks; mentions are disabled.
    let kept = HOSTILE_NAME.replace(['\n', '\u{1b}'], " ").replace('@', "@\u{200b}");
    assert_eq!(rows.len(), 2, "{markdown}");
    assert_eq!(rows[1].len(), 5, "{markdown}");
    assert_eq!(rows[1][1], kept);
    assert_eq!(rows[1][4], format!("shift {kept}"));
    let allowed_tags =
        ["<details>", "</details>", "<summary>", "</summary>", "<code>", "</code>", "<br>"];
    let options =
        Options::ENABLE_TABLES | Options::ENABLE_STRIKETHROUGH | Options::ENABLE_FOOTNOTES;
    for event in Parser::new_ext(&markdown, options) {
        match event {
            Event::Html(html) | Event::InlineHtml(html) => {
                let rest =
                    allowed_tags.iter().fold(html.to_string(), |rest, tag| rest.replace(tag, ""));
                let rest = rest.replace("<details open>", "");
                let titles = ["Passed", "Inconclusive", "Skipped"];
                assert!(rest.trim().is_empty() || titles.contains(&rest.trim()), "{html}");
            }
            Event::Start(Tag::Link { .. } | Tag::Image { .. } | Tag::Emphasis) => {
                panic!("{markdown}");
            }
            _ => {}
        }
    }
    assert!(!markdown.contains("@j") && !markdown.contains("://"), "{markdown}");
}
