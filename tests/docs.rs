//! Checks the documentation against the program.

use std::fs;
use std::path::Path;
use std::process::Command;

/// Rows of all tables with this many columns in a document, without headers.
fn table_rows<const N: usize>(document: &str) -> Vec<[String; N]> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(document);
    let text = fs::read_to_string(path).expect("the document");
    let cells = |line: &str| -> Option<[String; N]> {
        let inner = line.strip_prefix("| ")?.strip_suffix(" |")?;
        inner.split(" | ").map(str::to_owned).collect::<Vec<_>>().try_into().ok()
    };
    text.lines().filter_map(cells).filter(|cells| cells[0] != "symptom").collect()
}

/// The text in backquotes of a cell with nothing else.
fn unquote(cell: &str) -> &str {
    let inner = cell.strip_prefix('`').and_then(|cell| cell.strip_suffix('`'));
    inner.unwrap_or_else(|| panic!("not in backquotes: {cell}"))
}

#[test]
fn every_documented_symptom_gives_its_documented_finding() {
    let rows = table_rows::<4>("symptoms.md");
    assert!(rows.len() >= 30, "only {} rows were read", rows.len());
    for [symptom, _, call, says] in rows {
        let mut words = unquote(&call).split(' ');
        assert_eq!(words.next(), Some("poseaudit"), "{call}");
        let output = Command::new(env!("CARGO_BIN_EXE_poseaudit"))
            .args(words)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .expect("the binary runs");
        let text = String::from_utf8_lossy(&output.stdout);
        let found = match unquote(&says) {
            // For a fault, the document promises a finding, not only that the rule ran.
            code if call.contains(" audit ") && is_code(code) => {
                text.lines().any(|line| is_finding(line, code))
                    || is_selected_rule(&call, &text, code)
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
    let letters = word.trim_end_matches(|c: char| c.is_ascii_digit());
    matches!(letters.len(), 3 | 4) && word.len() == letters.len() + 3
}

fn is_finding(line: &str, code: &str) -> bool {
    ["error", "warning", "info"]
        .iter()
        .any(|severity| line.starts_with(&format!("{severity}[{code}]")))
}

/// Whether the call selects single rules, so some may pass.
fn is_selected_rule(call: &str, text: &str, code: &str) -> bool {
    call.contains("--select") && text.contains(code)
}

#[path = "../docs/pages.rs"]
mod pages;

#[test]
fn the_rule_pages_are_current() {
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

#[cfg(unix)]
#[test]
fn documents_show_what_their_commands_print() {
    for name in pages::WITH_OUTPUTS {
        let outputs = check_outputs(name);
        let verdict = |word: &str| outputs.iter().any(|text| text.contains(word));
        let passes_at_last = name != "tutorial.md" || verdict("PASS");
        assert!(outputs.len() > 2 && verdict("FAIL") && passes_at_last, "{name}: {outputs:?}");
    }
}

/// Compares the outputs in a document with its commands' outputs, and returns them.
#[cfg(unix)]
fn check_outputs(name: &str) -> Vec<String> {
    let folder = tempfile::tempdir().expect("a folder");
    let programs = Path::new(env!("CARGO_BIN_EXE_poseaudit")).parent().expect("a folder");
    let (page, run) = (document(name), pages::shell(programs, folder.path()));
    let mut outputs = Vec::new();
    let current = pages::with_outputs(&page, |line| {
        outputs.push(run(line));
        outputs[outputs.len() - 1].clone()
    });
    assert!(
        page == current,
        "docs/{name} is not current: run `cargo run --features full --example rule_pages`\n{current}"
    );
    outputs
}

#[test]
fn the_calls_of_the_rule_pages_pass_on_a_fault_free_log() {
    let symptoms = document("symptoms.md");
    for rule in poseaudit::checks::registry() {
        let call = pages::of_a_sound_log(rule);
        let page = pages::all(&symptoms)
            .into_iter()
            .find(|(name, _)| *name == format!("{}.md", rule.code));
        if !page.is_some_and(|(_, text)| text.contains(&call)) {
            continue;
        }
        let output = Command::new(env!("CARGO_BIN_EXE_poseaudit"))
            .args(call.split(' ').skip(1))
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .expect("the binary runs");
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && text.contains(rule.code), "{call}\n{text}");
        assert!(!text.lines().any(|line| is_finding(line, rule.code)), "{call}\n{text}");
    }
}

#[test]
fn concepts_name_existing_modules_and_rules() {
    let rows = table_rows::<5>("concepts.md");
    assert!(rows.len() >= 60, "only {} rows were read", rows.len());
    for [term, meaning, _, rules, module] in rows.into_iter().filter(|row| row[0] != "term") {
        assert!(meaning.split_whitespace().count() <= 25, "{term}: too long");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(unquote(&module));
        assert!(path.exists(), "{term}: no {module}");
        for code in rules.split([',', ' ']).filter(|word| is_code(word)) {
            assert!(poseaudit::checks::find(code).is_ok(), "{term}: no rule {code}");
        }
    }
}

/// The text of a document.
fn document(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(name);
    fs::read_to_string(path).expect("the document").replace("\r\n", "\n")
}

#[test]
fn the_schema_of_the_config_is_current() {
    assert!(
        document("poseaudit.schema.json") == poseaudit::config::schema(),
        "run `cargo run -- init --schema > docs/poseaudit.schema.json`"
    );
}

#[test]
fn the_schema_of_the_report_is_current() {
    assert!(
        document("poseaudit.report.schema.json") == poseaudit::report::json::schema(),
        "run `cargo run --example rule_pages`"
    );
}

/// The TOML blocks of a document.
fn toml_blocks(document: &str) -> Vec<&str> {
    let blocks = document.split("```toml\n").skip(1);
    blocks.filter_map(|rest| rest.split("```").next()).collect()
}

#[test]
fn the_documented_models_and_thresholds_can_be_read() {
    use poseaudit::robot::Robot;
    let text = document("own-arm.md");
    let [table, joints] = toml_blocks(&text)[..] else { panic!("two models") };
    let joint_counts = [table, joints].map(|model| {
        let robot = Robot::from_toml(model, "arm.toml").expect("a robot");
        robot.joints().iter().filter(|joint| joint.kind.has_position()).count()
    });
    assert_eq!(joint_counts, [6, 2]);
    let text = document("unexplained-residual.md");
    let config = toml_blocks(&text)[0].to_owned();
    let config = poseaudit::config::Config::from_text(config, Path::new("poseaudit.toml"));
    let options = config.expect("a config").options();
    let rule = poseaudit::checks::find("MDL001").expect("a rule");
    let usual = rule.grade.thresholds()[0];
    let set = options.policy.rules.thresholds.threshold(rule, usual);
    assert!((set.warning - 3e-3).abs() < 1e-9 && usual.warning < set.warning, "{set:?}");
}

#[test]
fn the_documented_config_can_be_read_and_is_valid() {
    let text = document("config.md");
    let example = *toml_blocks(&text).first().expect("an example");
    let path = Path::new("poseaudit.toml");
    let options =
        poseaudit::config::Config::from_text(example.to_owned(), path).expect("a config").options();
    assert_eq!((options.run.topics.len(), options.policy.rules.exemptions.len()), (2, 1));
    let schema: serde_json::Value =
        serde_json::from_str(&document("poseaudit.schema.json")).expect("JSON");
    let table: toml::Table = example.parse().expect("TOML");
    for key in table.keys() {
        assert!(schema["properties"][key].is_object(), "{key}");
    }
    for (topic, keys) in table["stream"].as_table().expect("streams") {
        for key in keys.as_table().expect("a stream").keys() {
            let known = &schema["definitions"]["Stream"]["properties"][key];
            assert!(known.is_object(), "{topic} {key}");
        }
    }
    for rule in poseaudit::checks::registry() {
        let keys = &schema["definitions"]["Rules"]["properties"][rule.code]["properties"];
        assert!(keys["severity"].is_object(), "{}", rule.code);
        assert_eq!(
            keys["warning"].is_object(),
            !rule.grade.thresholds().is_empty(),
            "{}",
            rule.code
        );
    }
}

#[test]
fn every_limit_of_a_rule_is_listed_with_its_default() {
    use poseaudit::finding::Unit;
    let text = document("config.md");
    for rule in poseaudit::checks::registry() {
        for limit in rule.limits {
            let value = match limit.unit {
                Unit::One => limit.value.to_string(),
                unit => format!("\"{}\"", unit.show(limit.value)),
            };
            let row = format!("| `{}.{}` | `{value}` | {} |", rule.code, limit.key, limit.what);
            assert!(text.contains(&row), "docs/config.md lacks {row}");
        }
    }
}

#[test]
fn every_command_is_listed() {
    let help = Command::new(env!("CARGO_BIN_EXE_poseaudit")).arg("--help").output();
    let help = String::from_utf8(help.expect("the binary runs").stdout).expect("UTF-8");
    let commands = help.split("Commands:").nth(1).and_then(|rest| rest.split("\n\n").next());
    let names: Vec<&str> = commands
        .expect("commands")
        .lines()
        .filter_map(|line| line.strip_prefix("  "))
        .filter_map(|line| line.split(' ').next().filter(|name| !name.is_empty()))
        .collect();
    assert!(names.contains(&"audit") && names.len() > 10, "{names:?}");
    for name in names {
        assert!(document("commands.md").contains(&format!("poseaudit {name}")), "{name}");
    }
}

/// Text of all sources in a folder.
fn sources(folder: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let files = walkdir::WalkDir::new(folder).into_iter().flatten();
    let sources = files.filter(|file| file.path().extension().is_some_and(|own| own == "rs"));
    sources.map(|file| fs::read_to_string(file.path()).expect("a source")).collect()
}

#[test]
fn every_documented_limit_names_an_existing_test() {
    let sources = sources("src") + &sources("tests");
    let mut count = 0;
    for [what, _, _, tests] in table_rows::<4>("../SECURITY.md") {
        for name in tests.split('`').skip(1).step_by(2) {
            let at = sources.find(&format!("fn {name}("));
            let before = at.map(|at| sources[..at].trim_end());
            assert!(before.is_some_and(|text| text.ends_with("#[test]")), "{what}: no test {name}");
            count += 1;
        }
    }
    assert!(count >= 20, "only {count} names were read");
}
