//! Regenerates the logs in `fixtures/`: `cargo run --example fixtures`.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

#[path = "../fixtures/scenarios.rs"]
mod scenarios;

fn main() -> anyhow::Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures");
    for (name, run) in scenarios::all()? {
        let file = File::create(folder.join(name))?;
        run.write_mcap(BufWriter::new(file), Some(mcap::Compression::Zstd))?;
    }
    Ok(())
}
