//! `rilievo completions SHELL`: what a shell needs to complete the command line.

use crate::cli::{CompletionsArgs, visible};

/// Runs the command.
pub fn completions(args: &CompletionsArgs) -> anyhow::Result<()> {
    let mut program = visible();
    let name = program.get_name().to_owned();
    // Into memory first: the generator panics where it cannot write, as into a closed pipe.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut program, name, &mut script);
    say!("{}", String::from_utf8(script)?.trim_end())?;
    Ok(())
}
