//! `rilievo man`: man pages, from the definition of the command line.

use super::output_files;
use crate::cli::{ManArgs, visible};
use crate::system::PROGRAM;
use clap_mangen::Man;
use rilievo_io::OutputFile;

/// Runs the command.
///
/// # Errors
/// When stdout or the folder cannot be written, or holds other pages that may not be overwritten.
pub fn man(args: &ManArgs) -> anyhow::Result<()> {
    // `help` has no options of its own to describe. Built, commands know that they are the program's.
    let mut program = visible().disable_help_subcommand(true);
    program.build();
    let Some(folder) = &args.output else {
        say!("{}", String::from_utf8(page(program)?.content)?.trim_end())?;
        return Ok(());
    };
    let commands: Vec<_> = program.get_subcommands().cloned().collect();
    let mut pages = Vec::new();
    for command in [program].into_iter().chain(commands) {
        let page = page(command)?;
        pages.push(OutputFile {
            path: folder.join(page.path),
            ..page
        });
    }
    output_files::write(&pages, args.overwrite)?;
    say!("{} man pages are in {}", pages.len(), folder.display())?;
    Ok(())
}

/// An empty argument in words: without quotes the next one, the program's name, would stand in its place.
const NO_DATE: &str = "\"\"";

/// The page of a command, with its name.
fn page(command: clap::Command) -> std::io::Result<OutputFile> {
    let page = Man::new(command).date(NO_DATE).source(PROGRAM);
    let mut content = Vec::new();
    page.render(&mut content)?;
    Ok(OutputFile {
        path: page.get_filename().into(),
        content,
    })
}
