//! Links the programs at a fixed address on Linux. A position-independent executable relocates 200,000 addresses at each
//! start, which takes longer than printing the version.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let target = |key: &str| std::env::var(format!("CARGO_CFG_TARGET_{key}")).unwrap_or_default();
    let is_glibc = target("OS") == "linux" && target("ENV") == "gnu";
    let is_static = target("FEATURE").split(',').any(|feature| feature == "crt-static");
    if is_glibc && !is_static {
        println!("cargo::rustc-link-arg-bins=-no-pie");
    }
}
