//! `poseaudit completions`.

use clap::CommandFactory;
use clap_complete::{Shell, generate};
use poseaudit::report::Trouble;

use super::{Cli, Outcome, output};

/// Generate shell completions
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  poseaudit completions bash > ~/.local/share/bash-completion/completions/poseaudit
  poseaudit completions zsh > ~/.zfunc/_poseaudit
  poseaudit completions fish > ~/.config/fish/completions/poseaudit.fish")]
pub struct Args {
    /// The shell
    #[arg(value_name = "SHELL", value_enum)]
    shell: Shell,
}

pub fn run(args: &Args) -> Result<Outcome, Trouble> {
    let mut script = Vec::new();
    generate(args.shell, &mut Cli::command(), env!("CARGO_PKG_NAME"), &mut script);
    output::emit(None, |out| out.write_all(&script))?;
    Ok(Outcome::Clean)
}
