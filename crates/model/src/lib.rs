//! A trained classifier: score pairs of scans, save the model, and load it again.
//!
//! This crate also runs on a robot, so it uses neither Arrow nor Parquet nor MCAP. The example
//! `two_scans` shows a complete program for a robot.
//!
//! ```
//! use model::{Classifier, Learner, WeakLearner};
//!
//! // Two regression stumps on two features.
//! let classifier = Classifier {
//!     learner: Learner::GentleStump,
//!     rounds: vec![
//!         WeakLearner::Step { feature: 0, threshold: 1.0, below: 0.5, above: -0.5 },
//!         WeakLearner::Step { feature: 1, threshold: 4.0, below: 0.25, above: -0.75 },
//!     ],
//! };
//!
//! // The feature differences |f_a - f_b| of two pairs of scans.
//! assert_eq!(classifier.confidence(&[0.2, 3.0]), 0.75);
//! assert_eq!(classifier.confidence(&[2.0, 5.0]), -1.25);
//! ```

mod batch;
mod card;
mod classifier;
mod detector;
mod detector_card;
mod detector_check;
mod file;
#[cfg(feature = "onnx")]
mod onnx;
mod tree;

use std::collections::BTreeMap;

use semver::Version;
use serde::{Deserialize, Serialize};

pub use card::card;
pub use classifier::{Classifier, Learner, Split, WeakLearner};
pub use detector::{
    ClosureNoise, DETECTOR_VERSION, Detector, DetectorLog, DetectorPart, Drift, Evidence,
    OdometryNoise, StrongLimits, Verifier, VerifierMeasures,
};
#[cfg(feature = "schema")]
pub use file::schema;
pub use file::{ModelError, Saved, load, save};
#[cfg(feature = "onnx")]
pub use onnx::to_onnx;
pub use tree::{MAX_DEPTH, Node, Tree};

/// Format version of `model.json`. A file with another version cannot be loaded.
pub const FORMAT_VERSION: u32 = 1;

/// A classifier and everything needed to use it correctly.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Name of the model, and of the folder that contains its versions.
    pub name: String,
    /// Version. The major version changes with the features, the kind of scans or the learner, the
    /// minor version with each new training, and the patch version with the metadata.
    pub version: Version,
    /// Version of the program that trained it.
    pub program_version: String,
    /// The run's seed.
    pub seed: u64,
    /// The features that the classifier needs, in order.
    pub features: FeatureSpec,
    /// The kind of scans that the model was trained on.
    pub scans: ScanSpec,
    /// The options of the stage `label`, as JSON.
    pub label_options: serde_json::Value,
    /// The training data.
    pub training: Training,
    /// Cross-validated errors at the last round.
    pub measured: Vec<Measured>,
    /// Named thresholds.
    pub operating_points: Vec<OperatingPoint>,
    /// What loop detection has learned. `None` if the model was not trained for it.
    pub detector: Option<Detector>,
    /// The classifier. Its features are indices into [`FeatureSpec::names`].
    pub classifier: Classifier,
}

/// The features that a model needs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FeatureSpec {
    /// Name of the feature set.
    pub set: String,
    /// Version of its definitions.
    pub version: u32,
    /// Gate between groups, for the set `paper16` \[m\].
    pub gate_m: f64,
    /// Names of the features, in order, `(n_features,)`.
    pub names: Vec<String>,
}

/// The kind of scans that a model was trained on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ScanSpec {
    /// Whether the scans are closed rings (355 deg or more).
    pub is_ring: bool,
    /// Smallest angle covered by a training scan \[deg\].
    pub coverage_min_deg: f32,
    /// Largest angle covered by a training scan \[deg\].
    pub coverage_max_deg: f32,
    /// Nearest return kept \[m\].
    pub range_min_m: f64,
    /// Farthest return kept \[m\].
    pub range_max_m: f64,
}

/// The data that a model was trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Training {
    /// Number of positive pairs.
    pub n_positive: usize,
    /// Number of negative pairs.
    pub n_negative: usize,
    /// BLAKE3 digests of the training tables and of the logs, in hex, by name.
    pub digests: BTreeMap<String, String>,
    /// Warnings about the training data: code and count. `docs/messages.md` explains the codes.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub warnings: BTreeMap<String, u64>,
}

/// Cross-validated errors at the model's last round and threshold 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// What was kept in one fold: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// Number of folds.
    pub folds: u32,
    /// Boosting rounds.
    pub rounds: u32,
    /// Share of the pairs with a wrong label.
    pub error: f64,
    /// Share of positive pairs among those classified as positive. Null if there are none.
    #[serde(deserialize_with = "Option::deserialize")]
    pub precision: Option<f64>,
    /// Share of the positive pairs that are classified as positive.
    pub recall: f64,
}

/// A named threshold and its cross-validated results.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OperatingPoint {
    /// What the threshold is chosen for, such as `recall at 100 % precision`.
    pub name: String,
    /// What was kept in one fold: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// A pair is classified as positive if its confidence is at least this.
    pub threshold: f64,
    /// Share of positive pairs among those classified as positive.
    pub precision: f64,
    /// Share of the positive pairs that are classified as positive.
    pub recall: f64,
    /// Share of the negative pairs that are classified as positive.
    pub false_alarm: f64,
}

impl Model {
    /// Whether `other` has the same features, kind of scans and learner, and so is the same model
    /// trained again.
    fn is_retrained_as(&self, other: &Self) -> bool {
        self.features == other.features
            && self.scans.is_same_kind(&other.scans)
            && self.classifier.learner == other.classifier.learner
    }
}

impl ScanSpec {
    /// Whether features of both kinds of scans can be compared.
    fn is_same_kind(&self, other: &Self) -> bool {
        self.is_ring == other.is_ring
            && self.range_min_m.total_cmp(&other.range_min_m).is_eq()
            && self.range_max_m.total_cmp(&other.range_max_m).is_eq()
    }

    /// Checks that a scan is of the kind that the model was trained on. The error names both kinds.
    pub fn check(&self, coverage_deg: f32, is_ring: bool) -> Result<(), ModelError> {
        if is_ring == self.is_ring {
            return Ok(());
        }
        Err(ModelError::ScanSpec {
            trained_deg: self.coverage_min_deg,
            trained_on: scan_kind(self.is_ring),
            found_deg: coverage_deg,
            found: scan_kind(is_ring),
        })
    }
}

fn scan_kind(is_ring: bool) -> &'static str {
    if is_ring { "the full circle" } else { "part of the circle" }
}
