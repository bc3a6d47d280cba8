//! Generated documents: the pages of `docs/rules/`, from the rules' own text, and the outputs in
//! [`WITH_OUTPUTS`]. `examples/rule_pages.rs` writes them, `tests/docs.rs` checks.

use std::fmt::Write;
use std::path::Path;
use std::process::Command;

use poseaudit::checks::{self, Rule};

/// Documents with the outputs of their commands.
pub const WITH_OUTPUTS: [&str; 2] = ["tutorial.md", "compare-trajectories.md"];

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

/// `page` with the current outputs of the commands in its `console` blocks, run one after another.
pub fn with_outputs(page: &str, mut run: impl FnMut(&str) -> String) -> String {
    let (mut text, mut is_console) = (String::new(), false);
    for line in page.lines() {
        let command = line.strip_prefix("$ ").filter(|_| is_console);
        if line.starts_with("```") {
            is_console = line == "```console";
        } else if is_console && command.is_none() {
            continue;
        }
        text += line;
        text += "\n";
        for line in command.map(&mut run).unwrap_or_default().lines() {
            text += line.trim_end();
            text += "\n";
        }
    }
    text
}

/// Runs a command line in `folder` with the `programs` first on the path; returns stdout and stderr.
pub fn shell(programs: &Path, folder: &Path) -> impl Fn(&str) -> String {
    let old = std::env::var_os("PATH").unwrap_or_default();
    let folders = [programs.to_owned()].into_iter().chain(std::env::split_paths(&old));
    let path = std::env::join_paths(folders).expect("paths without separators");
    let folder = folder.to_owned();
    move |line| {
        let mut call = Command::new("sh");
        call.args(["-c", &format!("{{ {line}; }} 2>&1")]).env("PATH", &path).current_dir(&folder);
        let output = call.output().expect("a shell");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }
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
        page += &format!("On a log without faults:\n\n```sh\n{}\n```\n", of_a_sound_log(rule));
    } else {
        page += &format!("```sh\n{}\n```\n", calls.join("\n"));
    }
    page
}

/// Command that evaluates a rule on a healthy log.
pub fn of_a_sound_log(rule: &Rule) -> String {
    format!("poseaudit audit fixtures/clean.mcap --select {} -v", rule.code)
}
