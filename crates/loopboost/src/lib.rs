//! The program: options, files, progress, exit codes.
//!
//! [`main_from`] is the program. The binary and the command of the Python package call it. The other functions are those that
//! the Python package has in common with the program.

/// A line on stdout. Where stdout cannot be written (a full disk), the program says so and fails.
macro_rules! out {
    ($($arg:tt)*) => {{
        use std::io::Write as _;
        if let Err(error) = writeln!(std::io::stdout(), $($arg)*) {
            eprintln!("error: cannot write to stdout: {error}");
            std::panic::resume_unwind(Box::new($crate::NoStdout));
        }
    }};
}

mod cli;
mod config;
mod detection;
mod detector_evidence;
mod disagreement;
mod drives;
mod findings;
mod fit_detector;
mod fleet;
mod found_drives;
mod georeference;
mod goal;
mod import;
mod inspect;
mod inspect_folder;
mod known_map;
mod label_basis;
mod label_choice;
mod label_truth;
mod labelled;
mod lineage;
mod locate;
mod logs;
mod map;
mod map_files;
mod map_run;
mod models;
mod other_run;
mod partitions;
mod pipeline;
mod plot;
mod pose_choice;
mod reference_file;
mod reference_options;
mod references;
mod run;
mod scan_cache;
mod score;
mod scorer;
mod shell;
mod site_drives;
mod site_frames;
mod stage;
mod stages;
mod suggest;
mod summary;
mod transient;
mod trial;
mod usage;
mod used_model;
mod view;

use std::ffi::OsString;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use clap::Parser;

use dataset::Severity;
use dataset::tables::TableError;

use cli::Cli;
use config::UsageError;
use findings::Failure;
use fleet::{Conflict, is_storage_trouble};
use stage::Artifact;

pub use models::file_of as model_file;
pub use used_model::featurize_options;

/// Exit code: done, and nothing needs attention.
const DONE: u8 = 0;
/// Exit code: failed.
const FAILED: u8 = 1;
/// Exit code: the command line or the pipeline file is wrong (clap uses it too).
const USAGE: u8 = 2;
/// Exit code: done, but data was left out or a warning needs attention.
const NEEDS_ATTENTION: u8 = 3;

/// Exit code of `task`: another attempt had another result (EX_SOFTWARE of sysexits.h).
const CONFLICT: u8 = 70;
/// Exit code of `task`: trouble with storage or inputs, another attempt may succeed (EX_TEMPFAIL of sysexits.h).
const TRY_AGAIN: u8 = 75;

/// stdout cannot be written. The program ends with this panic, after a message.
struct NoStdout;

/// Does what the command line asks for, and returns the exit code. `args` starts with the name of the program.
///
/// It prints to stdout and stderr, and never ends the process.
pub fn main_from(args: impl IntoIterator<Item = OsString>) -> u8 {
    match catch_unwind(AssertUnwindSafe(|| exit_code(args))) {
        Ok(code) => code,
        Err(panic) if panic.is::<NoStdout>() => FAILED,
        Err(panic) => resume_unwind(panic),
    }
}

/// The only place that turns an outcome into an exit code.
fn exit_code(args: impl IntoIterator<Item = OsString>) -> u8 {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(help_or_error) => {
            // As `clap::Error::exit` does.
            let _ = help_or_error.print();
            return if help_or_error.use_stderr() { USAGE } else { DONE };
        }
    };
    let is_task = cli.is_task();
    match cli.execute() {
        Ok(findings) => {
            for line in findings.lines() {
                eprintln!("{line}");
            }
            let counts = [
                (findings.count(Severity::Error), "error"),
                (findings.count(Severity::Warning), "warning"),
            ];
            let counts: Vec<String> = counts
                .into_iter()
                .filter(|(n, _)| 0 < *n)
                .map(|(n, name)| format!("{n} {name}{}", if n == 1 { "" } else { "s" }))
                .collect();
            match counts.is_empty() {
                true => DONE,
                false => {
                    let counts = counts.join(" and ");
                    eprintln!("done with {counts}; docs/messages.md explains each code");
                    NEEDS_ATTENTION
                }
            }
        }
        Err(Failure { error, before }) => {
            eprintln!("error: {error:#}");
            if let Some(hint) = hint(&error) {
                eprintln!("hint: {hint}");
            }
            let warnings = before.lines_from(Severity::Warning);
            if !warnings.is_empty() {
                eprintln!("before this error, the earlier stages reported:");
            }
            for line in warnings {
                eprintln!("{line}");
            }
            match (error.is::<UsageError>(), is_task) {
                (true, _) => USAGE,
                (_, true) if error.is::<Conflict>() => CONFLICT,
                (_, true) if is_storage_trouble(&error) => TRY_AGAIN,
                _ => FAILED,
            }
        }
    }
}

/// What to do about an error of a library that does not know the commands.
fn hint(error: &anyhow::Error) -> Option<String> {
    let error = error.chain().find_map(|cause| cause.downcast_ref::<TableError>())?;
    let stage = Artifact::maker_of_path(error.path())?;
    let again = if matches!(error, TableError::Missing { .. }) { "" } else { " again" };
    error.is_fixed_by_rebuilding().then(|| format!("create it{again} with `{}`", stage.command()))
}
