//! Runs the program like a user.

use std::process::{Command, Output};

pub const CLEAN: &str = "fixtures/clean.mcap";
pub const FAULTY: &str = "fixtures/faulty.mcap";

pub fn poseaudit(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_poseaudit"))
        .args(args)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the binary runs")
}

pub fn status(output: &Output) -> i32 {
    output.status.code().expect("the binary exits by itself")
}

pub fn stdout(output: &Output) -> &str {
    std::str::from_utf8(&output.stdout).expect("stdout is UTF-8")
}

pub fn stderr(output: &Output) -> &str {
    std::str::from_utf8(&output.stderr).expect("stderr is UTF-8")
}
