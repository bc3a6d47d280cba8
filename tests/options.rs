//! Options shared by commands: messages on stderr, colours, config search, counts, baselines.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::TempDir;

use crate::program::{CLEAN, FAULTY, poseaudit, status, stderr, stdout};

fn path(folder: &TempDir, name: &str) -> String {
    folder.path().join(name).display().to_string()
}

fn with_env(args: &[&str], env: &[(&str, &str)]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_poseaudit"))
        .args(args)
        .env_remove("NO_COLOR")
        .env_remove("CLICOLOR_FORCE")
        .envs(env.iter().copied())
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the binary runs")
}

#[test]
fn written_files_are_listed_on_stderr_unless_quiet() {
    let folder = TempDir::new().expect("a folder");
    let [page, tables, fixes] = ["run.html", "tables", "fixes"].map(|name| path(&folder, name));
    let call =
        ["audit", FAULTY, "--format", "html", "-o", &page, "--parquet", &tables, "--fix", &fixes];
    let output = poseaudit(&call);
    let lines: Vec<&str> = stderr(&output).lines().collect();
    assert_eq!(lines.len(), 3, "{lines:?}");
    for written in [&page, &tables, &fixes] {
        assert!(lines.contains(&format!("wrote {written}").as_str()), "{lines:?}");
        assert!(Path::new(written).exists(), "{written}");
    }
    let quiet = poseaudit(&[&call[..], &["-q"]].concat());
    assert_eq!((status(&quiet), stderr(&quiet)), (1, ""));
    let verbose = poseaudit(&["-v", "audit", CLEAN, "--select", "ING"]);
    assert!(stderr(&verbose).contains("read ") && stderr(&verbose).contains(" s\n"));
    assert_eq!(status(&poseaudit(&["audit", CLEAN, "-q", "-v"])), 2);
}

#[test]
fn colours_follow_the_option_and_the_environment() {
    let call = |args: &[&str], env: &[(&str, &str)]| {
        let output = with_env(&[&["audit", CLEAN, "--select", "ING"], args].concat(), env);
        stdout(&output).contains('\u{1b}')
    };
    assert!(!call(&[], &[]));
    assert!(call(&["--color", "always"], &[]));
    assert!(call(&["--color=always"], &[("NO_COLOR", "1")]));
    assert!(call(&[], &[("CLICOLOR_FORCE", "1")]));
    assert!(!call(&["--color", "never"], &[("CLICOLOR_FORCE", "1")]));
}

#[test]
fn a_config_is_searched_only_with_config_auto() {
    let folder = TempDir::new().expect("a folder");
    let below = folder.path().join("runs/monday");
    fs::create_dir_all(&below).expect("a folder");
    let log = below.join("run.mcap").display().to_string();
    fs::copy(FAULTY, &log).expect("a log");
    fs::write(folder.path().join("poseaudit.toml"), "select = [\"LAT001\"]\nfail_on = \"never\"\n")
        .expect("a config");
    assert_eq!(status(&poseaudit(&["audit", &log])), 1);
    let found = poseaudit(&["audit", &log, "--config", "auto", "-v"]);
    assert_eq!(status(&found), 0, "{}", stderr(&found));
    assert!(stderr(&found).contains("config ") && stdout(&found).contains("poseaudit.toml"));
    // The nearest config applies.
    fs::write(below.join("poseaudit.toml"), "select = [\"ZER001\"]\n").expect("a config");
    assert_eq!(status(&poseaudit(&["audit", &log, "--config", "auto"])), 1);
    let two = [log.as_str(), &path(&folder, "other.mcap")].map(str::to_owned);
    fs::copy(CLEAN, &two[1]).expect("a log");
    for (call, part) in [
        (["audit", &two[0], &two[1], "--config", "auto"], "the logs have different configs"),
        (["audit", "s3://bucket/run.mcap", "-q", "--config", "auto"], "has no folder"),
    ] {
        let refused = poseaudit(&call);
        assert_eq!(status(&refused), 2, "{}", stderr(&refused));
        assert!(stderr(&refused).contains(part), "{}", stderr(&refused));
    }
}

#[test]
fn findings_are_counted_by_rule() {
    let counted = poseaudit(&["audit", FAULTY, "--statistics", "--format", "json"]);
    let rows: Value = serde_json::from_slice(&counted.stdout).expect("JSON");
    let codes = ["LAT001", "ZER001"];
    for (row, code) in rows.as_array().expect("rows").iter().zip(codes) {
        assert_eq!((row["code"].as_str(), row["count"].as_u64()), (Some(code), Some(1)));
    }
    let text = poseaudit(&["audit", FAULTY, "--statistics"]);
    assert_eq!(status(&text), 1);
    assert!(stdout(&text).starts_with("count") && stdout(&text).ends_with("FAIL\n"));
    assert_eq!(stdout(&poseaudit(&["audit", CLEAN, "--statistics"])), "PASS\n");
    assert_eq!(status(&poseaudit(&["audit", CLEAN, "--statistics", "--format", "html"])), 2);
}

#[test]
fn rules_are_listed_for_programs() {
    let listed: Value =
        serde_json::from_slice(&poseaudit(&["rules", "--format", "json"]).stdout).expect("JSON");
    let rules = listed.as_array().expect("a list");
    let latency = rules.iter().find(|rule| rule["code"] == "LAT001").expect("LAT001");
    assert_eq!(latency["thresholds"][0]["warning"], 0.002);
    assert_eq!(latency["thresholds"][0]["unit"], "s");
    assert_eq!(rules.len(), poseaudit::checks::registry().len());
}

#[test]
fn a_baseline_is_written_and_compare_takes_the_options_of_audit() {
    let folder = TempDir::new().expect("a folder");
    let baseline = path(&folder, "baseline.json");
    let written_baseline = poseaudit(&["audit", CLEAN, "-q", "--write-baseline", &baseline]);
    assert_eq!(status(&written_baseline), 0, "{}", stderr(&written_baseline));
    let json = poseaudit(&["audit", CLEAN, "--format", "json"]);
    assert_eq!(fs::read(&baseline).expect("the baseline"), json.stdout);
    assert_eq!(status(&poseaudit(&["compare", &baseline, FAULTY])), 1);
    assert_eq!(status(&poseaudit(&["compare", CLEAN, FAULTY, "--select", "ING,TIM"])), 0);
    assert_eq!(status(&poseaudit(&["compare", CLEAN, FAULTY, "--robot", "ur5f"])), 2);
    let open = "fixtures/gimbal.mcap";
    assert_eq!(status(&poseaudit(&["compare", open, open])), 0);
    assert_eq!(status(&poseaudit(&["compare", open, open, "--fail-on", "inconclusive"])), 1);
    let text = path(&folder, "notes.txt");
    fs::write(&text, "no log\n").expect("a file");
    let refused = poseaudit(&["audit", &text, "--write-baseline", &path(&folder, "none.json")]);
    assert_eq!(status(&refused), 3);
    assert!(!folder.path().join("none.json").exists());
}
