//! JUnit XML according to the schema shared by CI systems: suites with counts, cases with at most one
//! outcome, and the printed output.

use std::collections::BTreeSet;

use poseaudit::finding::{Severity, Status};
use poseaudit::report::{Report, Trouble, TroubleKind};
use roxmltree::{Document, Node};

use super::sample_reports::{FAULTY_REPORT, HOSTILE_NAME, hostile_report, render};

fn children<'a>(node: Node<'a, 'a>, name: &str) -> Vec<Node<'a, 'a>> {
    node.children().filter(|child| child.has_tag_name(name)).collect()
}

fn count(node: Node, name: &str) -> usize {
    node.attribute(name).and_then(|text| text.parse().ok()).expect("a count")
}

/// Whether an XML attribute preserves a text, except control characters and with blanks for line ends.
fn preserves_text(found: Option<&str>, text: &str) -> bool {
    let plain = |text: &str| text.split(['\n', '\u{1b}']).map(str::to_owned).collect::<Vec<_>>();
    let found = found.unwrap_or_default();
    plain(text).iter().all(|part| found.contains(part.strip_prefix("[31m").unwrap_or(part)))
}

#[test]
fn junit_suites_and_cases_follow_the_schema_and_add_up() {
    for report in [&*FAULTY_REPORT, &hostile_report(Some(Severity::Warning)), &hostile_report(None)]
    {
        let text = render("junit", report);
        let document = Document::parse(&text).expect("XML");
        let root = document.root_element();
        assert!(root.has_tag_name("testsuites"));
        let suites = children(root, "testsuite");
        let mut names = BTreeSet::new();
        for suite in &suites {
            assert!(names.insert(suite.attribute("name").expect("a name").to_owned()));
            let cases = children(*suite, "testcase");
            let with =
                |name: &str| cases.iter().filter(|case| !children(**case, name).is_empty()).count();
            assert_eq!(count(*suite, "tests"), cases.len());
            assert_eq!(count(*suite, "failures"), with("failure"));
            assert_eq!(count(*suite, "skipped"), with("skipped"));
            for case in &cases {
                assert!(case.attribute("name").is_some() && case.attribute("classname").is_some());
                let inside: Vec<&str> = case
                    .children()
                    .filter(Node::is_element)
                    .map(|child| child.tag_name().name())
                    .collect();
                let expected = [&[][..], &["failure"], &["skipped"], &["error"], &["system-out"]];
                assert!(expected.contains(&&inside[..]), "{inside:?}");
            }
        }
        let sum = |name: &str| suites.iter().map(|suite| count(*suite, name)).sum::<usize>();
        for name in ["tests", "failures", "errors"] {
            assert_eq!(count(root, name), sum(name), "{name}");
        }
        assert_eq!(root.attribute("skipped"), None, "is not in the schema");
        assert_eq!(count(root, "tests"), report.checks.len());
        let open = |row: &&poseaudit::finding::CheckRow| !row.status.is_decided();
        assert_eq!(sum("skipped"), report.checks.iter().filter(open).count());
    }
}

#[test]
fn a_junit_case_fails_if_the_audit_fails() {
    let outcome_of = |report: &Report| {
        let text = render("junit", report);
        let document = Document::parse(&text).expect("XML");
        let case = document
            .descendants()
            .find(|node| node.attribute("classname") == Some("poseaudit.LAT001"));
        let case = case.expect("a case");
        assert!(preserves_text(case.attribute("name"), HOSTILE_NAME), "{text}");
        let outcome = case.children().find(Node::is_element).expect("an outcome");
        assert!(outcome.text().is_some_and(|text| text.contains("fix: shift /a|b")), "{text}");
        outcome.tag_name().name().to_owned()
    };
    assert_eq!(outcome_of(&hostile_report(Some(Severity::Warning))), "failure");
    assert_eq!(outcome_of(&hostile_report(Some(Severity::Error))), "system-out");
    assert_eq!(outcome_of(&hostile_report(None)), "system-out");
}

#[test]
fn undecided_checks_are_skipped_with_their_reason() {
    let text = render("junit", &FAULTY_REPORT);
    let document = Document::parse(&text).expect("XML");
    let reasons: Vec<&str> = document
        .descendants()
        .filter(|node| node.has_tag_name("skipped"))
        .filter_map(|node| node.attribute("message"))
        .collect();
    for row in FAULTY_REPORT.checks.iter().filter(|row| !row.status.is_decided()) {
        let how = if row.status == Status::Skipped { "skipped" } else { "inconclusive" };
        let reason = format!("{how}: {}", row.reason.as_deref().expect("a reason"));
        assert!(reasons.contains(&reason.as_str()), "{reason}");
    }
}

#[test]
fn an_unaudited_log_is_a_junit_error() {
    let report = Report::from_trouble(Trouble {
        kind: TroubleKind::Log,
        what: "the file is empty (0 bytes)".to_owned(),
        place: "empty.mcap".to_owned(),
        remedy: "check whether the recorder wrote it".to_owned(),
    });
    let text = render("junit", &report);
    let document = Document::parse(&text).expect("XML");
    let error = document.descendants().find(|node| node.has_tag_name("error")).expect("an error");
    assert_eq!(error.attribute("message"), Some("the file is empty (0 bytes)"));
    assert_eq!(count(document.root_element(), "errors"), 1);
}
