//! The pages of `docs/rules/`, from the rules' own text; `examples/rule_pages.rs` writes them,
//! `tests/docs.rs` checks.

use std::fmt::Write;

use poseaudit::checks::{self, Rule};

/// The name and the text of every page.
pub fn all(symptoms: &str) -> Vec<(String, String)> {
    let mut index = String::from("# Rules\n\nMade by `cargo run --example rule_pages`.\n\n");
    let mut pages = Vec::new();
    for family in checks::FAMILIES {
        index += &format!("## {}\n\n", family.examines);
        index += "| code | name | severity | what is wrong |\n|---|---|---|---|\n";
        for rule in family.rules {
            let (code, grade) = (rule.code, rule.grade.to_string());
            let _infallible = writeln!(
                index,
                "| [{code}]({code}.md) | {} | {grade} | {} |",
                rule.name,
                rule.summary()
            );
            pages.push((format!("{code}.md"), page(rule, symptoms)));
        }
        index += "\n";
    }
    let index = format!("{}\n", index.trim_end());
    pages.push(("README.md".to_owned(), index));
    pages
}

/// One rule: its text, and the calls of `docs/symptoms.md` that show it.
fn page(rule: &Rule, symptoms: &str) -> String {
    let mut page = format!("# {} {}\n\n{}\n\n", rule.code, rule.name, rule.grade);
    page += rule.doc().trim();
    page += "\n";
    let calls: Vec<&str> = symptoms
        .lines()
        .filter(|line| line.ends_with(&format!("| `{}` |", rule.code)))
        .filter_map(|line| line.split(" | ").nth(2))
        .map(|call| call.trim_matches('`'))
        .collect();
    page += "\n## Example\n\n";
    if calls.is_empty() {
        page += &format!("What it says of a sound log:\n\n```sh\n{}\n```\n", of_a_sound_log(rule));
    } else {
        page += &format!("```sh\n{}\n```\n", calls.join("\n"));
    }
    page
}

/// The call that asks a rule about a log in which nothing is wrong.
pub fn of_a_sound_log(rule: &Rule) -> String {
    format!("poseaudit audit fixtures/clean.mcap --select {}", rule.code)
}
