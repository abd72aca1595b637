//! The tables of a run folder (Parquet, zstd). `docs/tables.md` lists their names and columns.
//!
//! ```text
//! <out>/
//!   scans/<log>.parquet      one row per planar scan           (streamed, see [`scans`])
//!   poses/<log>.parquet      one row per pose
//!   keyframes/<log>.parquet  one row per keyframe
//!   pairs.parquet            one row per labelled pair
//!   features/<log>.parquet   one row per keyframe
//!   feature_stability.parquet    one row per feature
//!   scores.parquet           one row per pair and learner: cross-validated confidences
//!   rounds.parquet           one row per round of boosting
//!   retrieval.parquet        one row per learner and log: results on all pairs of keyframes
//!   grid.parquet             one row per learner and label rule
//!   feature_usefulness.parquet   one row per feature
//!   truth/<log>.parquet      one row per pose of the ground truth (same columns as poses)
//!   registered/<log>.parquet one row per registered scan
//!   odometry/<log>.parquet   one row per keyframe: pose by scan matching
//!   candidates.parquet       one row per pair of places that may be the same
//!   closures.parquet         one row per accepted or rejected closure
//!   trajectory.parquet       one row per keyframe: optimized pose
//!   graph.parquet            one row per edge of the pose graph
//!   trajectory/<log>.parquet one row per scan: optimized pose (same columns as poses)
//!   evaluation/*.parquet     results of the evaluation
//! ```
//!
//! Every table stores its [`Provenance`]. Writing a table is atomic: the data go to a temporary
//! file in the same folder, which is renamed when it is complete.

mod closures;
mod columns;
mod evidence;
mod file;
mod graph;
mod located;
mod provenance;
mod registered;
mod scan_pairs;
pub mod scans;
mod scores;
mod types;
mod usefulness;

use std::path::{Path, PathBuf};

pub use closures::{read_candidates, read_closures, write_candidates, write_closures};
pub use evidence::{
    grid_batch, read_grid, read_retrieval, retrieval_batch, write_grid, write_retrieval,
};
pub use file::{
    digest_file, is_partial, n_rows, read_provenance, read_table, write_atomically, write_file,
    write_table,
};
pub use graph::{read_graph, write_graph};
pub use located::{read_located, write_located};
pub use provenance::{FORMAT_VERSION, Provenance};
pub use registered::{
    read_odometry, read_registered, read_trajectory, write_odometry, write_registered,
    write_trajectory,
};
pub use scan_pairs::{PairScore, SCAN_PAIR_COLUMNS, read_scan_pairs, write_pair_scores};
pub use scores::{read_rounds, read_scores, write_rounds, write_scores};
pub use types::{
    FeatureTable, batch, floats, pose_batch, read_features, read_keyframes, read_pairs, read_poses,
    strings, write_features, write_keyframes, write_pairs, write_poses,
};
pub use usefulness::{
    feature_usefulness_batch, read_feature_stability, read_feature_usefulness,
    write_feature_stability, write_feature_usefulness,
};

/// An error while a table is read or written.
///
/// The messages do not suggest what to do, because only the program knows which command writes
/// which table. [`TableError::path`] returns the path of the file.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file does not exist.
    #[error("{path} does not exist")]
    Missing {
        /// Path of the file.
        path: PathBuf,
    },
    /// The operating system reported an error.
    #[error("cannot {action} {path}")]
    Io {
        /// "read", "write", ...
        action: &'static str,
        /// Path of the file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not a Parquet table, or it is damaged.
    #[error("{path} is not a readable Parquet table")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the decoder reports, or what is missing.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The Parquet file was not written by loopboost, or it is a table of another kind.
    #[error("{path} is {found}, expected a loopboost table of kind `{expected}`")]
    Kind {
        /// Path of the file.
        path: PathBuf,
        /// The expected kind.
        expected: &'static str,
        /// A description of what the file is.
        found: String,
    },
    /// The table has another format version.
    #[error("{path} has format version {found}, this program reads version {expected}")]
    Version {
        /// Path of the file.
        path: PathBuf,
        /// The version of the table.
        found: String,
        /// The version that this program reads.
        expected: u32,
    },
    /// A column is missing, has another type, or has nulls that are not allowed.
    #[error("{path}: column `{column}`: expected {expected}, found {found}")]
    Column {
        /// Path of the file.
        path: PathBuf,
        /// Name of the column.
        column: String,
        /// What was expected.
        expected: &'static str,
        /// What was found.
        found: String,
    },
    /// A row is invalid, or it contradicts another table.
    #[error("{path}: row {row}: {detail}")]
    Row {
        /// Path of the file.
        path: PathBuf,
        /// Number of the row, from 0.
        row: usize,
        /// What is wrong.
        detail: String,
    },
}

impl TableError {
    /// Path of the file.
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

    /// Whether writing the table again fixes the error.
    pub fn is_fixed_by_rebuilding(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}

/// `Result` of this module.
pub type Result<T> = std::result::Result<T, TableError>;
