//! The tables of a run folder (Parquet, zstd). `docs/tables.md` lists names and columns.
//!
//! ```text
//! <out>/
//!   scans/<log>.parquet      one row per planar scan           (streamed, see [`scans`])
//!   poses/<log>.parquet      one row per pose
//!   keyframes.parquet        one row per scan that was kept
//!   pairs.parquet            one row per labelled pair
//!   features.parquet         one row per keyframe
//!   feature_stability.parquet    one row per feature
//!   scores.parquet           one row per pair and learner: cross-validated confidences
//!   rounds.parquet           one row per round of boosting
//!   retrieval.parquet        one row per learner and log: all pairs at their natural prevalence
//!   grid.parquet             one row per learner and label rule
//!   feature_usefulness.parquet   one row per feature
//!   evaluation/*.parquet     the measures
//! ```
//!
//! Every table carries its [`Provenance`]. A table is complete or absent: it is written to a
//! temporary file in the same folder and renamed when it is complete.

mod columns;
mod evidence;
mod file;
mod provenance;
pub mod scans;
mod scores;
mod types;
mod usefulness;

use std::path::{Path, PathBuf};

pub use evidence::{
    grid_batch, read_grid, read_retrieval, retrieval_batch, write_grid, write_retrieval,
};
pub use file::{
    digest_file, is_partial, read_provenance, read_table, write_atomically, write_file, write_table,
};
pub use provenance::{FORMAT_VERSION, Provenance};
pub use scores::{read_rounds, read_scores, write_rounds, write_scores};
pub use types::{
    FeatureTable, batch, floats, read_features, read_keyframes, read_pairs, read_poses, strings,
    write_features, write_keyframes, write_pairs, write_poses,
};
pub use usefulness::{
    feature_usefulness_batch, read_feature_stability, read_feature_usefulness,
    write_feature_stability, write_feature_usefulness,
};

/// What can be wrong with a table.
///
/// The messages name no remedy: which command makes a table is known to the program, not here.
/// [`TableError::path`] names the file.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file does not exist.
    #[error("{path} does not exist")]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// The operating system reports an error.
    #[error("cannot {action} {path}")]
    Io {
        /// "read", "write", ...
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system reports.
        source: std::io::Error,
    },
    /// The bytes are not a Parquet table, or the table is damaged.
    #[error("{path} is not a readable Parquet table: {detail}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the decoder reports.
        detail: String,
    },
    /// A Parquet file that loopboost did not write, or a table of another kind.
    #[error("{path} is {found}, expected a loopboost table of kind `{expected}`")]
    Kind {
        /// The file.
        path: PathBuf,
        /// The kind that was expected.
        expected: &'static str,
        /// What it is instead.
        found: String,
    },
    /// A table of another format version.
    #[error("{path} has format version {found}, this program reads version {expected}")]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
        /// The version that this program reads.
        expected: u32,
    },
    /// A column is missing, has another type, or has nulls that are not allowed.
    #[error("{path}: column `{column}`: expected {expected}, found {found}")]
    Column {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What it must be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// A row that contradicts the table's contract or another table.
    #[error("{path}: row {row}: {detail}")]
    Row {
        /// The file.
        path: PathBuf,
        /// Row, from 0.
        row: usize,
        /// What is wrong.
        detail: String,
    },
}

impl TableError {
    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            Self::Missing { path }
            | Self::Io { path, .. }
            | Self::Unreadable { path, .. }
            | Self::Kind { path, .. }
            | Self::Version { path, .. }
            | Self::Column { path, .. }
            | Self::Row { path, .. } => path,
        }
    }

    /// Whether the file has to be made again before it can be read.
    pub fn is_cured_by_making_it_again(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// `Result` of this module.
pub type Result<T> = std::result::Result<T, TableError>;
