//! Text from files on a terminal: a name cannot start a line, set colours or change the writing direction.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FAULTY, poseaudit, stderr, stdout};

/// Starts a line that GitHub interprets as a command, sets a colour and changes the writing direction.
const HOSTILE_FILE_NAME: &str = "x\n::error::evil\u{1b}[31m\u{202e}.mcap";

#[cfg(unix)]
#[test]
fn no_file_name_is_printed_unescaped() {
    let folder = tempfile::tempdir().expect("a folder");
    let log = folder.path().join(HOSTILE_FILE_NAME);
    fs::copy(FAULTY, &log).expect("a copy");
    let (log, out) = (log.display().to_string(), folder.path().join("out").display().to_string());
    for args in [
        vec!["audit", &log],
        vec!["audit", &log, "-v"],
        vec!["audit", &log, "--format", "github"],
        vec!["audit", &log, "--format", "markdown"],
        vec!["info", &log],
        vec!["tf", &log, "base_link", "tool0"],
        vec!["compare", &log, FAULTY],
        vec!["calibrate", &log, "--out", &out],
        vec!["fleet", &log, "--out", &out],
        vec!["fleet", "report", &out],
    ] {
        let output = poseaudit(&args);
        let printed = format!("{}{}", stdout(&output), stderr(&output));
        assert!(!printed.is_empty(), "{args:?}");
        for what in ["\n::error::evil", "\u{1b}[31m", "\u{202e}"] {
            assert!(!printed.contains(what), "{args:?}: {printed}");
        }
    }
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() { paths.extend(sources(&path)) } else { paths.push(path) }
    }
    paths
}

/// Print statements pass paths and names through `foreign` or `tame`.
#[test]
fn statements_that_print_names_escape_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut unescaped = Vec::new();
    for file in ["cli", "output/calibration"].iter().flat_map(|folder| sources(&root.join(folder)))
    {
        let text = fs::read_to_string(&file).expect("a source");
        for (at, _) in text.match_indices("writeln!(") {
            let ends =
                [";\n", ")\n    }", ",\n    }"].iter().filter_map(|end| text[at..].find(end));
            let statement = &text[at..ends.min().map_or(text.len(), |length| at + length)];
            let names = [".display()", "robot.name", ".topic,", "note.note"];
            let prints = names.iter().any(|name| statement.contains(name));
            if prints && !statement.contains("sanitize") {
                unescaped.push(format!(
                    "{}: {}",
                    file.display(),
                    statement.lines().next().unwrap_or("")
                ));
            }
        }
    }
    assert_eq!(unescaped, Vec::<String>::new());
}
