//! The program: options, files, progress, exit codes.

/// A line on stdout. Where stdout cannot be written (a full disk), the program says so and fails.
macro_rules! out {
    ($($arg:tt)*) => {{
        use std::io::Write as _;
        if let Err(error) = writeln!(std::io::stdout(), $($arg)*) {
            eprintln!("error: cannot write to stdout: {error}");
            std::process::exit(1);
        }
    }};
}

mod cli;
mod config;
mod fit;
mod import;
mod inspect;
mod lineage;
mod logs;
mod manifest;
mod models;
mod options;
mod pipeline;
mod plot;
mod run;
mod stages;

use std::process::ExitCode;

use clap::Parser;

use cli::Cli;
use config::UsageError;

/// Exit code: everything that was asked for was done.
const DONE: u8 = 0;
/// Exit code: it could not be done.
const FAILED: u8 = 1;
/// Exit code: the command line or the pipeline file is not understood (clap uses it too).
const USAGE: u8 = 2;
/// Exit code: done, but some of the data could not be used; stderr says how much and why.
const DONE_WITH_LOSSES: u8 = 3;

/// The only place that turns an outcome into an exit code.
fn main() -> ExitCode {
    // `loopboost log X | head` ends quietly, as other programs do.
    sigpipe::reset();
    let cli = Cli::parse();
    let code = match cli.execute() {
        Ok(dropped) if dropped.is_empty() => DONE,
        Ok(dropped) => {
            eprintln!("warning: some data could not be used:");
            for (reason, n) in dropped.iter() {
                eprintln!("  {n} {reason}");
            }
            DONE_WITH_LOSSES
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            if error.is::<UsageError>() { USAGE } else { FAILED }
        }
    };
    ExitCode::from(code)
}
