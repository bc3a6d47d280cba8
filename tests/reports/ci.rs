//! The CI examples: runs their commands on the fixture logs like CI.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde::Deserialize;

use super::sample_reports::{FAULTY_REPORT, render};
use super::{CLEAN, FAULTY, status, stderr, stdout};

#[derive(Deserialize)]
struct Action {
    inputs: BTreeMap<String, Input>,
    runs: Runs,
}

#[derive(Deserialize)]
struct Input {
    default: Option<String>,
}

#[derive(Deserialize)]
struct Runs {
    steps: Vec<Step>,
}

#[derive(Deserialize)]
struct Step {
    name: Option<String>,
    run: Option<String>,
    #[serde(default)]
    env: BTreeMap<String, String>,
    uses: Option<String>,
    #[serde(default)]
    with: BTreeMap<String, serde_json::Value>,
}

#[derive(Deserialize)]
struct Workflow {
    jobs: BTreeMap<String, Runs>,
}

#[derive(Deserialize)]
struct Job {
    script: Vec<String>,
}

#[derive(Deserialize)]
struct Hook {
    entry: String,
    args: Vec<String>,
    files: String,
}

const ROOT: &str = env!("CARGO_MANIFEST_DIR");

fn text(name: &str) -> String {
    fs::read_to_string(Path::new(ROOT).join(name)).expect("the file")
}

fn yaml<T: serde::de::DeserializeOwned>(name: &str) -> T {
    serde_saphyr::from_str(&text(name)).expect("YAML")
}

/// Runs a script with bash, like CI, with this build of poseaudit on the PATH.
fn run_bash(script: &str, folder: &str, variables: &[(String, String)]) -> Output {
    let built = PathBuf::from(env!("CARGO_BIN_EXE_poseaudit"));
    let programs = built.parent().expect("a folder").to_owned();
    let known = env::var_os("PATH").unwrap_or_default();
    let path = env::join_paths([programs].into_iter().chain(env::split_paths(&known)));
    Command::new("bash")
        .args(["-e", "-o", "pipefail", "-c", script])
        .env("PATH", path.expect("a PATH"))
        .envs(variables.iter().map(|(name, value)| (name, value)))
        .current_dir(folder)
        .output()
        .expect("bash runs")
}

/// Output of the action.
struct ActionRun {
    output: Output,
    reports: PathBuf,
    summary: String,
}

/// Runs the action's audit step with these inputs.
fn run_action(folder: &Path, inputs: &[(&str, &str)]) -> ActionRun {
    let action: Action = yaml("action.yml");
    let reports = folder.join("reports");
    let summary = folder.join("summary.md");
    let input = |name: &str| {
        let value = inputs.iter().find(|(input, _)| *input == name).map(|(_, value)| *value);
        let default = action.inputs.get(name).expect("an input").default.as_deref();
        value.or(default).expect("a value").to_owned()
    };
    let audits = |step: &&Step| step.name.as_deref() == Some("Audit");
    let step = action.runs.steps.iter().find(audits).expect("a step");
    let script = step.run.as_deref().expect("a script");
    assert!(!script.contains("${{"), "an input could be a command");
    let mut variables = vec![
        ("GITHUB_STEP_SUMMARY".to_owned(), summary.display().to_string()),
        ("GITHUB_ACTION_PATH".to_owned(), ROOT.to_owned()),
    ];
    variables.extend(step.env.iter().map(|(name, value)| {
        let inner = value.strip_prefix("${{ inputs.").and_then(|it| it.strip_suffix(" }}"));
        (name.clone(), input(inner.expect("an input")))
    }));
    variables.push(("REPORTS".to_owned(), reports.display().to_string()));
    let output = run_bash(script, ROOT, &variables);
    let summary = fs::read_to_string(summary).unwrap_or_default();
    ActionRun { output, reports, summary }
}

#[test]
fn the_action_fails_on_a_faulty_log_and_writes_its_reports() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = run_action(folder.path(), &[("logs", FAULTY)]);
    assert_eq!(status(&run.output), 1, "{}", stderr(&run.output));
    let annotations = stdout(&run.output).lines().filter(|line| line.starts_with("::error "));
    assert_eq!(annotations.count(), FAULTY_REPORT.findings.len(), "{}", stdout(&run.output));
    assert_eq!(run.summary, render("markdown", &FAULTY_REPORT));
    for name in ["report.sarif", "junit.xml", "report.html"] {
        assert!(run.reports.join("fixtures_faulty.mcap").join(name).exists(), "{name}");
    }
}

#[test]
fn the_action_audits_each_matching_log_and_exits_with_the_worst_status() {
    let folder = tempfile::tempdir().expect("a folder");
    let logs = "fixtures/fault*.mcap\n\nfixtures/clean.mcap\n";
    let run = run_action(folder.path(), &[("logs", logs)]);
    assert_eq!(status(&run.output), 1, "{}", stderr(&run.output));
    let mut names: Vec<String> = fs::read_dir(&run.reports)
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().display().to_string())
        .collect();
    names.sort();
    assert_eq!(names, ["fixtures_clean.mcap", "fixtures_faulty.mcap"]);
    let run = run_action(folder.path(), &[("logs", CLEAN), ("fail-on", "inconclusive")]);
    assert_eq!(status(&run.output), 0, "{}", stdout(&run.output));
    let run = run_action(folder.path(), &[("logs", "fixtures/no*such.mcap")]);
    assert_eq!(status(&run.output), 2, "{}", stdout(&run.output));
    assert!(stdout(&run.output).contains("fixtures/no*such.mcap: no log is called so"));
}

#[test]
fn with_a_baseline_the_action_fails_only_on_regressions() {
    let folder = tempfile::tempdir().expect("a folder");
    let before = folder.path().join("before/fixtures_faulty.mcap");
    fs::create_dir_all(&before).expect("a folder");
    let report = before.join("report.json");
    fs::write(&report, render("json", &FAULTY_REPORT)).expect("a file");
    for baseline in [report.as_path(), &folder.path().join("before")] {
        let baseline = baseline.display().to_string();
        let run = run_action(folder.path(), &[("logs", FAULTY), ("baseline", &baseline)]);
        assert_eq!(status(&run.output), 0, "{}", stderr(&run.output));
        assert!(run.summary.contains("poseaudit: no regression"), "{}", run.summary);
    }
}

#[test]
fn a_missing_log_fails_the_action_and_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = run_action(folder.path(), &[("logs", "no/such.mcap"), ("baseline", "no/such.json")]);
    assert_eq!(status(&run.output), 2, "{}", stderr(&run.output));
    assert!(stdout(&run.output).contains("::no/such.mcap: no such file"));
}

#[test]
fn the_example_workflow_uses_existing_inputs_of_the_action() {
    let (action, workflow): (Action, Workflow) =
        (yaml("action.yml"), yaml("examples/ci/github.yml"));
    let steps: Vec<Step> = workflow.jobs.into_values().flat_map(|job| job.steps).collect();
    let step_that_uses = |name: &str| {
        let uses = |step: &&Step| step.uses.as_deref().is_some_and(|uses| uses.contains(name));
        steps.iter().find(uses).expect("a step")
    };
    let with = &step_that_uses("OWNER/poseaudit@").with;
    assert!(with.keys().all(|name| action.inputs.contains_key(name)));
    let needed = action.inputs.iter().filter(|(_, input)| input.default.is_none());
    assert!(needed.map(|(name, _)| name).all(|name| with.contains_key(name)));
    let kept = step_that_uses("upload-artifact").with["path"].as_str();
    assert_eq!(kept, action.inputs["reports"].default.as_deref());
}

/// A repository with one sound and one faulty log.
fn repository() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("logs")).expect("a folder");
    for log in [CLEAN, FAULTY] {
        let name = Path::new(log).file_name().expect("a name");
        fs::copy(Path::new(ROOT).join(log), folder.path().join("logs").join(name)).expect("a log");
    }
    folder
}

#[test]
fn the_scripts_for_gitlab_and_jenkins_write_junit_for_every_log() {
    let jobs: BTreeMap<String, Job> = yaml("examples/ci/gitlab.yml");
    let pipeline = text("examples/ci/Jenkinsfile");
    let jenkins = pipeline.split("'''").nth(1).expect("a script").replace("\\\\", "\\");
    for script in [jobs["poseaudit"].script.join("\n"), jenkins] {
        let folder = repository();
        let output = run_bash(&script, &folder.path().display().to_string(), &[]);
        assert_eq!(status(&output), 1, "{}", stderr(&output));
        for log in ["clean.mcap", "faulty.mcap"] {
            let junit = folder.path().join("reports").join(log).join("junit.xml");
            assert!(junit.exists(), "{}", junit.display());
        }
    }
}

#[test]
fn the_hook_audits_each_log_separately() {
    let [hook] = <[Hook; 1]>::try_from(yaml::<Vec<Hook>>(".pre-commit-hooks.yaml"))
        .unwrap_or_else(|hooks| panic!("{} hooks", hooks.len()));
    assert!(hook.files.contains("mcap"));
    let program = ("POSEAUDIT_BIN".to_owned(), env!("CARGO_BIN_EXE_poseaudit").to_owned());
    let run = |logs: &[&str]| {
        let call = format!("{} {} {}", hook.entry, hook.args.join(" "), logs.join(" "));
        run_bash(&call, ROOT, std::slice::from_ref(&program))
    };
    let clean = run(&[CLEAN]);
    assert_eq!(status(&clean), 0, "{}", stderr(&clean));
    let both = run(&[FAULTY, CLEAN]);
    assert_eq!(status(&both), 1, "{}", stderr(&both));
    let verdicts =
        stdout(&both).lines().filter(|line| line.starts_with("PASS") || line.starts_with("FAIL"));
    assert_eq!(verdicts.count(), 2, "{}", stdout(&both));
}
