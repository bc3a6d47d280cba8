//! Regenerates the pages in `docs/rules/` and the report's schema: `cargo run --example rule_pages`.

use std::fs;
use std::path::Path;

#[path = "../docs/pages.rs"]
mod pages;

fn main() -> anyhow::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let folder = docs.join("rules");
    fs::create_dir_all(&folder)?;
    for (name, text) in pages::all(&fs::read_to_string(docs.join("symptoms.md"))?) {
        fs::write(folder.join(name), text)?;
    }
    fs::write(docs.join("poseaudit.report.schema.json"), poseaudit::report::json::schema())?;
    Ok(())
}
