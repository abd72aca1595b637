//! `experiment`: measures how well learners classify pairs that they were not trained on.
//!
//! | question | function |
//! |---|---|
//! | What does each learner learn from all pairs? | [`fit`] |
//! | How often is it wrong on ground, scans or logs not seen in training? | [`cross_validate`] |
//! | How well does it find the positives among all pairs of a log? | [`retrieval`] |
//! | How confident is it of given pairs that it was not trained on? | [`held_out_confidences`] |
//! | How does the error change with the label rules? | [`label_grid`] |
//! | Which features are useful? | [`feature_usefulness`] |
//! | Which models are saved, with which evidence? | [`models`] |
//!
//! Invariant: pure computation on slices. This crate reads and writes no files.
//!
//! ```
//! use dataset::Label::{Negative, Positive};
//! use dataset::tables::FeatureTable;
//! use dataset::{Pair, ScanId};
//!
//! // One feature of three scans, and two labelled pairs of them.
//! let features = FeatureTable {
//!     names: vec!["size".to_owned()],
//!     ids: (0..3).map(|scan| ScanId { log: "drive".into(), scan }).collect(),
//!     values: vec![400.0, 410.0, 900.0],
//! };
//! let pair = |query, label| Pair {
//!     query,
//!     reference: 0,
//!     label,
//!     distance_m: 1.0,
//!     distance_std_m: None,
//!     heading_difference_rad: None,
//!     travel_gap_m: 1.0,
//! };
//! let pairs = [pair(1, Positive), pair(2, Negative)];
//!
//! let differences = experiment::differences(&pairs, &features);
//! assert_eq!(differences.column(0), [10.0, 500.0]);
//! let options = train::Options { learners: vec![train::Learner::Discrete], ..Default::default() };
//! let fitted = experiment::fit(&options, &differences)?;
//! assert!(!fitted[0].rounds.is_empty());
//! # Ok::<(), experiment::ExperimentError>(())
//! ```

mod cross_validation;
mod differences;
mod error;
mod fit;
mod held_out;
mod label_grid;
mod models;
mod options;
mod retrieval;
mod usefulness;

use dataset::tables::FeatureTable;
use dataset::{Keyframe, Pair};
use train::Matrix;

pub use cross_validation::{CrossValidation, GroupingResult, LearnerResult, cross_validate};
pub use differences::differences;
pub use error::{ExperimentError, NotEvaluated};
pub use fit::{Fitted, boosting_rounds, fit};
pub use held_out::held_out_confidences;
pub use label_grid::label_grid;
pub use models::{ModelContext, models, scan_spec};
pub use options::{GridOptions, Options};
pub use retrieval::{few_matches, retrieval};
pub use usefulness::feature_usefulness;

/// How the experiment is done.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// Folds, groupings, retrieval and grid.
    pub options: &'a Options,
    /// Learners and rounds.
    pub train: &'a train::Options,
    /// The label rules.
    pub label: &'a label::Options,
    /// The run's seed.
    pub seed: u64,
}

/// What the experiment is done on.
#[derive(Debug, Clone, Copy)]
pub struct Data<'a> {
    /// The keyframes.
    pub keyframes: &'a [Keyframe],
    /// The features of the keyframes, one row for each.
    pub features: &'a FeatureTable,
    /// The labelled pairs of keyframes.
    pub pairs: &'a [Pair],
    /// The feature differences of the pairs, from [`differences`].
    pub differences: &'a Matrix,
}
