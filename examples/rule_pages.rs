//! Regenerates the pages in `docs/rules/`, the outputs in [`pages::WITH_OUTPUTS`] and the report's schema:
//! `cargo build --features full && cargo run --features full --example rule_pages`.

use std::fs;
use std::path::Path;

use anyhow::Context as _;

#[path = "../docs/pages.rs"]
mod pages;

fn main() -> anyhow::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let folder = docs.join("rules");
    fs::create_dir_all(&folder)?;
    for (name, text) in pages::all(&fs::read_to_string(docs.join("symptoms.md"))?) {
        fs::write(folder.join(name), text)?;
    }
    // The programs are in the parent of the folder of the examples.
    let example = std::env::current_exe()?;
    let programs = example.ancestors().nth(2).context("the programs' folder")?;
    for name in pages::WITH_OUTPUTS {
        let (folder, document) = (tempfile::tempdir()?, docs.join(name));
        let run = pages::shell(programs, folder.path());
        fs::write(&document, pages::with_outputs(&fs::read_to_string(&document)?, run))?;
    }
    fs::write(docs.join("poseaudit.report.schema.json"), poseaudit::report::json::schema())?;
    Ok(())
}
