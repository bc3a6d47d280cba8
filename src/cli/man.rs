//! `poseaudit man`.

use std::io;
use std::path::PathBuf;

use clap::{Command, CommandFactory};
use clap_mangen::Man;
use poseaudit::places::PathRegistry;
use poseaudit::report::Trouble;

use super::{Cli, Outcome, output};

/// Print the man page, or write the pages of all commands
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit man | man -l -
  poseaudit man --output ~/.local/share/man/man1")]
pub struct Args {
    /// Write a page for each command into this folder; created if missing
    #[arg(long, value_name = "DIR")]
    output: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut whole = Cli::command();
    whole.build();
    match &args.output {
        None => output::emit(None, |out| Man::new(whole).render(out))?,
        Some(folder) => {
            let mut places = PathRegistry::default();
            places.add_outputs_in(output::OUTPUT_OPTION, folder, []);
            places.check()?;
            for page in pages(&whole)? {
                let path = folder.join(page.name);
                output::emit(Some(&path), |out| out.write_all(&page.text))?;
            }
        }
    }
    Ok(Outcome::Clean)
}

struct Page {
    /// Such as `poseaudit-audit.1`.
    name: String,
    text: Vec<u8>,
}

fn pages(command: &Command) -> Result<Vec<Page>, Trouble> {
    let man = Man::new(command.clone());
    let mut text = Vec::new();
    man.render(&mut text)
        .map_err(|error: io::Error| super::misuse("man", error, "report this as a bug"))?;
    let mut all = vec![Page { name: man.get_filename(), text }];
    for below in command.get_subcommands() {
        all.extend(pages(below)?);
    }
    Ok(all)
}
