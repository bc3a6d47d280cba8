//! The reports as other programs get them: which formats go where, and what each of them holds.

mod cases;
mod ci;
mod compare;
mod formats;
mod junit;
mod markdown;
mod sarif;
mod shell;
mod snapshots;

use std::process::{Command, Output};

const CLEAN: &str = "fixtures/clean.mcap";
const FAULTY: &str = "fixtures/faulty.mcap";

fn poseaudit(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_poseaudit"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the binary runs")
}

fn status(output: &Output) -> i32 {
    output.status.code().expect("the binary exits by itself")
}

fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).expect("stdout is UTF-8")
}

fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).expect("stderr is UTF-8")
}
