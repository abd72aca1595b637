//! The tables of a run folder (Parquet, zstd). DESIGN, "Tables", fixes names and columns.
//!
//! ```text
//! <out>/
//!   scans/<log>.parquet      one planar scan a row           (streamed, see [`scans`])
//!   poses/<log>.parquet      one pose a row
//!   keyframes.parquet        a kept scan a row
//!   pairs.parquet            a labelled pair a row
//!   features.parquet         a keyframe's features a row
//!   scores.parquet           a pair under a learner a row: cross-validated confidences
//!   rounds.parquet           a round of boosting a row
//!   retrieval.parquet        a learner on all pairs of a log a row
//!   grid.parquet             a learner under other label rules a row
//!   evaluation/*.parquet     what `evaluate` measured
//! ```
//!
//! Every table carries its [`Provenance`]. A table is complete or absent: it is written beside
//! its place and renamed when whole.

mod columns;
mod evidence;
mod file;
mod nouns;
mod provenance;
pub mod scans;
mod scores;

use std::path::PathBuf;

pub use evidence::{
    grid_batch, read_grid, read_retrieval, retrieval_batch, write_grid, write_retrieval,
};
pub use file::{
    digest_file, is_partial, read_provenance, read_table, write_atomically, write_file, write_table,
};
pub use nouns::{
    FeatureTable, batch, floats, read_features, read_keyframes, read_pairs, read_poses, strings,
    write_features, write_keyframes, write_pairs, write_poses,
};
pub use provenance::{FORMAT_VERSION, Provenance};
pub use scores::{read_rounds, read_scores, write_rounds, write_scores};

/// What can be wrong with a table.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The file is not there.
    #[error("{path} is missing; make it with `{command}`")]
    Missing {
        /// The table's path.
        path: PathBuf,
        /// The command that makes it.
        command: String,
    },
    /// The system refused.
    #[error("cannot {action} {path}")]
    Io {
        /// "read", "write", ...
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The bytes are no Parquet table, or a damaged one.
    #[error("{path} is not a readable Parquet table: {detail}; make it again with `{command}`")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The decoder's word.
        detail: String,
        /// The command that makes it.
        command: String,
    },
    /// A Parquet file that loopboost did not write, or another of its tables.
    #[error("{path} holds {found}, expected a loopboost table of kind `{expected}`")]
    Kind {
        /// The file.
        path: PathBuf,
        /// The kind wanted.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// A table of another format version.
    #[error(
        "{path} has format version {found}, this program reads version {expected}; make it again with `{command}`"
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
        /// The version this program reads.
        expected: u32,
        /// The command that makes it.
        command: String,
    },
    /// A column is absent, of another type, or has nulls where none may be.
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

/// `Result` of this module.
pub type Result<T> = std::result::Result<T, TableError>;

/// The command that makes a table of a kind; the pipeline file is the reader's own.
fn command_for(kind: &str) -> String {
    let stage = match kind {
        "scans" | "poses" => "ingest",
        "keyframes" => "subsample",
        "pairs" => "label",
        "features" => "featurize",
        "scores" | "rounds" | "retrieval" | "grid" => "train",
        "errors" | "summary" | "precision_recall" | "selection" | "mistakes" => "evaluate",
        _ => "run",
    };
    format!("loopboost {stage} PIPELINE.toml --out DIR")
}
