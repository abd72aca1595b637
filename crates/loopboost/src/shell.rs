//! Shell completions and man pages, made from the definition of the command line.

use std::path::Path;

use anyhow::{Context, Result};
use clap::Command;
use clap_complete::Shell;

/// The name of the program, whatever the file is called that runs.
const NAME: &str = "loopboost";

/// Prints the script that completes commands in a shell.
pub(crate) fn completions(mut command: Command, shell: Shell) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, NAME, &mut script);
    out!("{}", String::from_utf8(script)?.trim_end());
    Ok(())
}

/// Writes a page per command into a folder: loopboost.1, loopboost-run.1, ...
pub(crate) fn man(command: Command, folder: &Path) -> Result<()> {
    let write = || {
        std::fs::create_dir_all(folder)?;
        clap_mangen::generate_to(command.name(NAME), folder)
    };
    write().with_context(|| format!("cannot write man pages into {}", folder.display()))
}
