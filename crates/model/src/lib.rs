//! A fitted classifier: score a pair, save, load, check.
//!
//! Invariant: no Arrow, no Parquet, no MCAP; this crate also runs on a robot.

mod batch;
mod card;
mod classifier;
mod file;
#[cfg(feature = "onnx")]
mod onnx;
mod tree;

use std::collections::BTreeMap;

use semver::Version;
use serde::{Deserialize, Serialize};

pub use card::card;
pub use classifier::{Classifier, Learner, Split, WeakLearner};
#[cfg(feature = "schema")]
pub use file::schema;
pub use file::{ModelError, Saved, load, save};
#[cfg(feature = "onnx")]
pub use onnx::to_onnx;
pub use tree::{MAX_DEPTH, Node, Tree};

/// Version of the layout of `model.json`; a file of another version is not read.
pub const FORMAT_VERSION: u32 = 1;

/// A classifier with all that is needed to use it rightly.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Name, the folder above the version's.
    pub name: String,
    /// Major: other features, scans or another learner; minor: trained again; patch: metadata.
    pub version: Version,
    /// Version of the program that trained it.
    pub program_version: String,
    /// The run's seed.
    pub seed: u64,
    /// The features it wants, in order.
    pub features: FeatureSpec,
    /// The scans it was trained on.
    pub scans: ScanSpec,
    /// The options of `label`, as JSON.
    pub label_options: serde_json::Value,
    /// What it was trained on.
    pub training: Training,
    /// What cross-validation measured, at the last round.
    pub measured: Vec<Measured>,
    /// Named thresholds.
    pub operating_points: Vec<OperatingPoint>,
    /// The classifier; features by their index in [`FeatureSpec::names`].
    pub classifier: Classifier,
}

/// The features that a model wants.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FeatureSpec {
    /// Name of the feature set.
    pub set: String,
    /// Version of its definitions.
    pub version: u32,
    /// The gate between groups \[m\].
    pub gate_m: f64,
    /// Names of the features, in order, `(n_features,)`.
    pub names: Vec<String>,
}

/// The scans that a model was trained on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScanSpec {
    /// Whether the scans are closed rings (355 deg or more).
    pub is_ring: bool,
    /// Least angle swept by a training scan \[deg\].
    pub coverage_min_deg: f32,
    /// Greatest angle swept by a training scan \[deg\].
    pub coverage_max_deg: f32,
    /// Nearest return kept \[m\].
    pub range_min_m: f64,
    /// Farthest return kept \[m\].
    pub range_max_m: f64,
}

/// What a model was trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// Positive pairs.
    pub n_positive: usize,
    /// Negative pairs.
    pub n_negative: usize,
    /// BLAKE3 digests, hex, of the training tables and of the logs, by name.
    pub digests: BTreeMap<String, String>,
}

/// Cross-validated errors at the model's last round and threshold 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Number of folds.
    pub folds: u32,
    /// Boosting rounds.
    pub rounds: u32,
    /// Share of the pairs given the wrong label.
    pub error: f64,
    /// Share of positives among the pairs called positive; none where no pair is called so.
    #[serde(deserialize_with = "Option::deserialize")]
    pub precision: Option<f64>,
    /// Share of the positives that are called positive.
    pub recall: f64,
}

/// A threshold with a name, and what cross-validation measured there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OperatingPoint {
    /// What the threshold is chosen for, such as `recall at 100 % precision`.
    pub name: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// A pair is called positive where its confidence is not less than this.
    pub threshold: f64,
    /// Share of positives among the pairs called positive.
    pub precision: f64,
    /// Share of the positives that are called positive.
    pub recall: f64,
    /// Share of the negatives that are called positive.
    pub false_alarm: f64,
}

impl Model {
    /// Whether `other` is this model trained again: the same features, kind of scans and learner.
    fn is_retrained_as(&self, other: &Self) -> bool {
        self.features == other.features
            && self.scans.is_same_kind(&other.scans)
            && self.classifier.learner == other.classifier.learner
    }
}

impl ScanSpec {
    /// Whether features of the two kinds of scans compare.
    fn is_same_kind(&self, other: &Self) -> bool {
        self.is_ring == other.is_ring
            && self.range_min_m.total_cmp(&other.range_min_m).is_eq()
            && self.range_max_m.total_cmp(&other.range_max_m).is_eq()
    }

    /// Refuses a scan that the model was not made for, saying which.
    pub fn check(&self, coverage_deg: f32, is_ring: bool) -> Result<(), ModelError> {
        if is_ring == self.is_ring {
            return Ok(());
        }
        Err(ModelError::ScanSpec {
            trained_deg: self.coverage_min_deg,
            trained_on: ring_or_not(self.is_ring),
            found_deg: coverage_deg,
            found: ring_or_not(is_ring),
        })
    }
}

fn ring_or_not(is_ring: bool) -> &'static str {
    if is_ring { "full rings" } else { "scans of a part of the circle" }
}
