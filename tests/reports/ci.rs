//! The examples for CI: their commands, run as CI would run them, on the fixture logs.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde::Deserialize;

use super::cases::{FAULTS, written};
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
    run: Option<String>,
    #[serde(default)]
    env: BTreeMap<String, String>,
    uses: Option<String>,
    #[serde(default)]
    with: BTreeMap<String, String>,
}

#[derive(Deserialize)]
struct Workflow {
    jobs: BTreeMap<String, Runs>,
}

#[derive(Deserialize)]
struct Hook {
    entry: String,
    files: String,
}

fn example<T: serde::de::DeserializeOwned>(name: &str) -> T {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/ci").join(name);
    let text = fs::read_to_string(path).expect("the example");
    serde_saphyr::from_str(&text).expect("YAML")
}

/// Runs a script with bash, as CI does, with this build of poseaudit on the PATH.
fn bash(script: &str, args: &[&str], variables: &[(String, String)]) -> Output {
    let built = PathBuf::from(env!("CARGO_BIN_EXE_poseaudit"));
    let folder = built.parent().expect("a folder").to_owned();
    let known = env::var_os("PATH").unwrap_or_default();
    let path = env::join_paths([folder].into_iter().chain(env::split_paths(&known)));
    Command::new("bash")
        .args(["-e", "-o", "pipefail", "-c", script, "script"])
        .args(args)
        .env("PATH", path.expect("a PATH"))
        .envs(variables.iter().map(|(name, value)| (name, value)))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("bash runs")
}

/// What the action leaves of a log.
struct Left {
    output: Output,
    reports: PathBuf,
    summary: String,
}

fn act(folder: &Path, given: &[(&str, &str)]) -> Left {
    let action: Action = example("action.yml");
    let reports = folder.join("reports");
    let summary = folder.join("summary.md");
    let input = |name: &str| {
        let given = given.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
        let default = action.inputs.get(name).expect("an input").default.as_deref();
        given.or(default).expect("a value").to_owned()
    };
    let [step] = action.runs.steps.as_slice() else { panic!("one step is expected") };
    let script = step.run.as_deref().expect("a script");
    assert!(!script.contains("${{"), "an input could be a command");
    let mut variables = vec![("GITHUB_STEP_SUMMARY".to_owned(), summary.display().to_string())];
    variables.extend(step.env.iter().map(|(name, value)| {
        let inner = value.strip_prefix("${{ inputs.").and_then(|it| it.strip_suffix(" }}"));
        (name.clone(), input(inner.expect("an input")))
    }));
    variables.push(("REPORTS".to_owned(), reports.display().to_string()));
    let output = bash(script, &[], &variables);
    let summary = fs::read_to_string(summary).unwrap_or_default();
    Left { output, reports, summary }
}

#[test]
fn the_action_fails_on_a_faulty_log_and_leaves_its_reports() {
    let folder = tempfile::tempdir().expect("a folder");
    let left = act(folder.path(), &[("log", FAULTY)]);
    assert_eq!(status(&left.output), 1, "{}", stderr(&left.output));
    let annotations = stdout(&left.output).lines().filter(|line| line.starts_with("::error "));
    assert_eq!(annotations.count(), FAULTS.findings.len(), "{}", stdout(&left.output));
    assert_eq!(left.summary, written("markdown", &FAULTS));
    for name in ["report.sarif", "junit.xml"] {
        assert!(left.reports.join(name).exists(), "{name}");
    }
}

#[test]
fn with_a_baseline_the_action_fails_only_on_what_is_worse() {
    let folder = tempfile::tempdir().expect("a folder");
    let baseline = folder.path().join("baseline.json");
    fs::write(&baseline, written("json", &FAULTS)).expect("a file");
    let baseline = baseline.display().to_string();
    let left = act(folder.path(), &[("log", FAULTY), ("baseline", &baseline)]);
    assert_eq!(status(&left.output), 0, "{}", stderr(&left.output));
    assert!(left.summary.contains("poseaudit: no regression"), "{}", left.summary);
}

#[test]
fn a_log_that_is_not_there_fails_the_action_and_is_said() {
    let folder = tempfile::tempdir().expect("a folder");
    let left = act(folder.path(), &[("log", "no/such.mcap"), ("baseline", "no/such.json")]);
    assert_eq!(status(&left.output), 2, "{}", stderr(&left.output));
    assert!(stdout(&left.output).contains("::no/such.mcap: no such file"));
}

#[test]
fn the_workflow_gives_the_action_inputs_that_it_has_and_uploads_what_it_leaves() {
    let (action, workflow): (Action, Workflow) = (example("action.yml"), example("workflow.yml"));
    let steps: Vec<Step> = workflow.jobs.into_values().flat_map(|job| job.steps).collect();
    let of = |name: &str| {
        let uses = |step: &&Step| step.uses.as_deref().is_some_and(|uses| uses.contains(name));
        steps.iter().find(uses).expect("a step")
    };
    let with = &of("./.github/actions/poseaudit").with;
    assert!(with.keys().all(|name| action.inputs.contains_key(name)));
    let needed = action.inputs.iter().filter(|(_, input)| input.default.is_none());
    assert!(needed.map(|(name, _)| name).all(|name| with.contains_key(name)));
    let reports = action.inputs["reports"].default.as_deref().expect("a folder");
    let uploaded = &of("upload-sarif").with["sarif_file"];
    assert_eq!(uploaded, &format!("{reports}/report.sarif"));
}

#[test]
fn the_hook_audits_each_log_by_itself() {
    let [hook] = <[Hook; 1]>::try_from(example::<Vec<Hook>>(".pre-commit-hooks.yaml"))
        .unwrap_or_else(|hooks| panic!("{} hooks", hooks.len()));
    assert!(hook.files.contains("mcap"));
    let entry = format!("{} \"$@\"", hook.entry);
    let clean = bash(&entry, &[CLEAN], &[]);
    assert_eq!(status(&clean), 0, "{}", stderr(&clean));
    let both = bash(&entry, &[FAULTY, CLEAN], &[]);
    assert_eq!(status(&both), 1, "{}", stderr(&both));
    let verdicts =
        stdout(&both).lines().filter(|line| line.starts_with("PASS") || line.starts_with("FAIL"));
    assert_eq!(verdicts.count(), 2, "{}", stdout(&both));
}
