//! Shell completions and man pages, generated from the command definitions.

use std::fs;
use std::process::Command;

use super::{poseaudit, status, stderr, stdout};

#[test]
fn every_shell_has_completions_of_all_commands() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = poseaudit(&["completions", shell]);
        assert_eq!(status(&output), 0, "{}", stderr(&output));
        for word in ["audit", "compare", "fail-on", "output"] {
            assert!(stdout(&output).contains(word), "{shell} does not know {word}");
        }
    }
    assert_eq!(status(&poseaudit(&["completions", "tcsh"])), 2);
}

/// Completions that bash offers for the last of `words`.
#[cfg(unix)]
fn complete_in_bash(words: &[&str]) -> Vec<String> {
    let script = poseaudit(&["completions", "bash"]);
    let line = words.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(" ");
    let last = words.len() - 1;
    let ask = format!(
        "{}\nCOMP_WORDS=({line}); COMP_CWORD={last}; COMPREPLY=()\n\
         _poseaudit poseaudit '{}' '{}'\nprintf '%s\\n' \"${{COMPREPLY[@]}}\"",
        stdout(&script),
        words[last],
        words[last - 1],
    );
    let output = Command::new("bash").args(["-c", &ask]).output().expect("bash runs");
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    stdout(&output).lines().map(str::to_owned).collect()
}

#[cfg(unix)]
#[test]
fn bash_completes_commands_options_and_values() {
    assert_eq!(complete_in_bash(&["poseaudit", "comp"]), ["compare", "completions"]);
    assert_eq!(
        complete_in_bash(&["poseaudit", "audit", "--max"]),
        ["--max-latency", "--max-unpacked"]
    );
    let formats = complete_in_bash(&["poseaudit", "audit", "--format", ""]);
    let known = poseaudit::report::FORMATS.iter().map(|format| format.name.to_owned());
    assert_eq!(formats, known.collect::<Vec<_>>());
}

#[test]
fn every_command_has_a_man_page_with_its_options_and_examples() {
    let folder = tempfile::tempdir().expect("a folder");
    let pages = folder.path().join("man/man1");
    let output = poseaudit(&["man", "--output", &pages.display().to_string()]);
    assert_eq!(status(&output), 0, "{}", stderr(&output));
    let page = |name: &str| fs::read_to_string(pages.join(name)).expect(name);
    assert_eq!(stdout(&poseaudit(&["man"])), page("poseaudit.1"));
    let help = poseaudit(&["--help"]);
    let commands = stdout(&help).lines().skip_while(|line| !line.starts_with("Commands:")).skip(1);
    let commands = commands.take_while(|line| !line.is_empty());
    let commands: Vec<&str> =
        commands.filter_map(|line| line.strip_prefix("  ")?.split(' ').next()).collect();
    let commands: Vec<&str> = commands.into_iter().filter(|name| !name.is_empty()).collect();
    assert!(commands.len() > 10, "{commands:?}");
    // A subcommand such as `fleet report` has a separate page.
    let names = fs::read_dir(&pages).expect("the folder").flatten().map(|page| page.file_name());
    let is_of_command =
        |name: &String| commands.iter().any(|command| *name == format!("poseaudit-{command}.1"));
    let names: Vec<String> = names.map(|name| name.to_string_lossy().into_owned()).collect();
    assert_eq!(names.iter().filter(|name| is_of_command(name)).count(), commands.len());
    assert!(names.iter().any(|name| name == "poseaudit-fleet-report.1"), "{names:?}");
    for command in commands {
        let text = page(&format!("poseaudit-{command}.1"));
        assert!(text.starts_with(".ie") && text.contains("Examples:"), "{text}");
        // A man page writes a hyphen as `\-`.
        let unescaped = text.replace("\\-", "-");
        assert!(unescaped.contains(&format!("poseaudit {command}")), "{text}");
    }
    assert!(page("poseaudit-audit.1").contains("\\-\\-fail\\-on"));
}
