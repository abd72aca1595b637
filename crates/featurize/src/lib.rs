//! `featurize`: a scan -> features, a pair -> their absolute differences.
//!
//! Everything here also runs on a robot: no Arrow, no Parquet, no MCAP.

mod campus;
mod lanes;
mod paper16;
mod stability;

use dataset::{Scan, Unusable};
use serde::{Deserialize, Serialize};

pub use campus::{CAMPUS_NAMES, Campus};
pub use paper16::{PAPER16_NAMES, Paper16};
pub use stability::{stability, thinned};

/// The section `[featurize]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "FeaturizeOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Which features.
    pub set: FeatureSet,
    /// Of `paper16`: a step between neighbouring returns longer than this separates two groups \[m\]
    /// (Granstroem et al. 2009, "Learning to detect loop closure from range data": 2.5 m).
    pub gate_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { set: FeatureSet::Paper16, gate_m: 2.5 }
    }
}

/// An option out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`featurize.gate_m` is {gate_m}, expected more than 0")]
pub struct OptionError {
    /// The gate given.
    pub gate_m: f64,
}

impl Options {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionError> {
        if self.gate_m.is_finite() && 0.0 < self.gate_m {
            Ok(())
        } else {
            Err(OptionError { gate_m: self.gate_m })
        }
    }
}

/// A named, versioned list of features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum FeatureSet {
    /// The 16 features of the paper's Appendix A.
    Paper16,
    /// What walls, gaps and openings look like from about a place, whichever way the scanner looks.
    Campus,
}

impl FeatureSet {
    /// The name in options and models.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper16 => "paper16",
            Self::Campus => "campus",
        }
    }

    /// Version of the definitions; a model of another version does not fit.
    pub fn version(self) -> u32 {
        match self {
            Self::Paper16 | Self::Campus => 1,
        }
    }

    /// Names of the features, in order.
    pub fn feature_names(self) -> &'static [&'static str] {
        match self {
            Self::Paper16 => &PAPER16_NAMES,
            Self::Campus => &CAMPUS_NAMES,
        }
    }
}

/// Computes the features of a set, of one scan after another, reusing its memory.
#[derive(Debug, Clone)]
pub enum Featurizer {
    /// Those of [`FeatureSet::Paper16`].
    Paper16(Paper16),
    /// Those of [`FeatureSet::Campus`].
    Campus(Box<Campus>),
}

impl Featurizer {
    /// For the set and the gate of the options.
    pub fn new(options: &Options) -> Self {
        match options.set {
            FeatureSet::Paper16 => Self::Paper16(Paper16::new(options.gate_m)),
            FeatureSet::Campus => Self::Campus(Box::default()),
        }
    }

    /// Writes the features of a scan, in the order of [`FeatureSet::feature_names`]; always finite.
    ///
    /// # Panics
    /// If `features` does not have the set's length.
    pub fn features(&mut self, scan: &Scan, features: &mut [f64]) -> Result<(), Unusable> {
        match self {
            Self::Paper16(paper16) => features.copy_from_slice(&paper16.features(scan)?),
            Self::Campus(campus) => features.copy_from_slice(&campus.features(scan)?),
        }
        Ok(())
    }
}

/// Writes `|a - b|`, feature by feature, to `difference`.
///
/// All three have the set's length.
pub fn difference(a: &[f64], b: &[f64], difference: &mut [f64]) {
    for ((difference, a), b) in difference.iter_mut().zip(a).zip(b) {
        *difference = (a - b).abs();
    }
}
