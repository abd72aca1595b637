//! `map compare`: commands on the maps of run folders.

mod compare;
mod mapped;
mod table;

use anyhow::Result;
use clap::Subcommand;

use crate::findings::Findings;

/// The commands of `map`.
#[derive(Subcommand)]
pub(crate) enum MapCommand {
    /// Show what changed between two run folders: closures, maps, trajectories, labels
    ///
    /// Logs are matched by their names, and scans by their numbers and stamps. The exit code is 3 if
    /// something changed by more than the tolerances, and 0 otherwise.
    Compare(compare::CompareArgs),
}

impl MapCommand {
    pub(crate) fn execute(&self) -> Result<Findings> {
        match self {
            Self::Compare(args) => args.execute(),
        }
    }
}
