//! Errors of tasks, by what a batch system should do about them.

use std::path::PathBuf;

use dataset::tables::TableError;
use ingest::IngestError;

/// Two attempts of a task made different records.
#[derive(Debug, thiserror::Error)]
#[error(
    "{} exists with other bytes, and this attempt was kept as {}; the same task must always give the same bytes: compare the two, remove the wrong one, and report this",
    path.display(),
    other.display()
)]
pub(crate) struct Conflict {
    /// The record that was there.
    pub(crate) path: PathBuf,
    /// The record of this attempt.
    pub(crate) other: PathBuf,
}

/// An input is missing, or is not the one in the plan.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct InputTrouble(pub(crate) String);

/// Whether storage or an input is the cause, so that another attempt, perhaps on another machine, may succeed.
pub(crate) fn is_storage_trouble(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let of_table = cause.downcast_ref::<TableError>();
        cause.is::<InputTrouble>()
            || cause.is::<std::io::Error>()
            || of_table
                .is_some_and(|e| matches!(e, TableError::Io { .. } | TableError::Missing { .. }))
            || matches!(cause.downcast_ref(), Some(IngestError::Changed { .. }))
    })
}
