//! `featurize`: a scan -> features, a pair -> their absolute differences.
//!
//! Everything here also runs on a robot: no Arrow, no Parquet, no MCAP.

mod paper16;

use serde::{Deserialize, Serialize};

pub use paper16::{PAPER16_NAMES, Paper16};

/// The section `[featurize]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "FeaturizeOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Which features.
    pub set: FeatureSet,
    /// A step between neighbouring returns longer than this separates two groups \[m\]
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
}

impl FeatureSet {
    /// The name in options and models.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper16 => "paper16",
        }
    }

    /// Version of the definitions; a model of another version does not fit.
    pub fn version(self) -> u32 {
        match self {
            Self::Paper16 => 1,
        }
    }

    /// Names of the features, in order.
    pub fn feature_names(self) -> &'static [&'static str] {
        match self {
            Self::Paper16 => &PAPER16_NAMES,
        }
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
