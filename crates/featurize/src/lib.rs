//! `featurize`: a scan -> features, a pair of scans -> the absolute differences of their features.
//!
//! There are two feature sets, [`FeatureSet::Paper16`] and [`FeatureSet::Campus`]. docs/features.md
//! defines each feature and gives the decisions behind it. This crate also runs on a robot, so it
//! uses neither Arrow nor Parquet nor MCAP.
//!
//! ```
//! use dataset::Scan;
//! use featurize::{FeatureSet, Featurizer, Options, difference};
//!
//! // 720 returns on a circle around the sensor, 0.5 deg apart.
//! let circle = |radius_m: f32| {
//!     let angles = (0..720).map(|k| (0.5 * k as f32).to_radians());
//!     let (x_m, y_m) = angles.map(|a| (radius_m * a.cos(), radius_m * a.sin())).unzip();
//!     Scan { x_m, y_m, coverage_deg: 360.0, ..Scan::default() }
//! };
//!
//! let options = Options { set: FeatureSet::Paper16, ..Options::default() };
//! options.check()?;
//! let names = options.set.feature_names();
//! let mut featurizer = Featurizer::new(&options);
//! let (mut a, mut b, mut a_minus_b) = (vec![0.0; 16], vec![0.0; 16], vec![0.0; 16]);
//! featurizer.features(&circle(5.0), &mut a)?;
//! featurizer.features(&circle(7.0), &mut b)?;
//! difference(&a, &b, &mut a_minus_b);
//!
//! let radius = names.iter().position(|name| *name == "circle_radius").unwrap();
//! assert!((a_minus_b[radius] - 2.0).abs() < 1e-5);
//! let size = names.iter().position(|name| *name == "size").unwrap();
//! assert_eq!(a_minus_b[size], 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod campus;
mod lanes;
mod paper16;
mod stability;

use dataset::{OutOfRange, Scan, Unusable};
use serde::{Deserialize, Serialize};

pub use campus::{CAMPUS_NAMES, Campus};
pub use paper16::{PAPER16_NAMES, Paper16};
pub use stability::{stability, thinned};

/// The section `[featurize]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "FeaturizeOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The feature set.
    pub set: FeatureSet,
    /// For `paper16`: two neighbouring returns more than this far apart belong to different groups
    /// \[m\]. Granstroem et al. 2009, "Learning to detect loop closure from range data", use 2.5 m.
    pub gate_m: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { set: FeatureSet::Paper16, gate_m: 2.5 }
    }
}

impl Options {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        if self.gate_m.is_finite() && 0.0 < self.gate_m {
            Ok(())
        } else {
            Err(OutOfRange::new("featurize.gate_m", self.gate_m, "more than 0"))
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
    /// Walls, gaps and openings around the sensor, independent of the direction it faces.
    Campus,
}

impl FeatureSet {
    /// Every set.
    pub const ALL: [Self; 2] = [Self::Paper16, Self::Campus];

    /// The name in options and models.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper16 => "paper16",
            Self::Campus => "campus",
        }
    }

    /// Version of the definitions. A model trained with another version cannot be used.
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

/// Computes the features of a set for one scan after another. It reuses its memory.
#[derive(Debug, Clone)]
pub enum Featurizer {
    /// Computes [`FeatureSet::Paper16`].
    Paper16(Paper16),
    /// Computes [`FeatureSet::Campus`].
    Campus(Box<Campus>),
}

impl Featurizer {
    /// Uses the set and the gate of the options.
    pub fn new(options: &Options) -> Self {
        match options.set {
            FeatureSet::Paper16 => Self::Paper16(Paper16::new(options.gate_m)),
            FeatureSet::Campus => Self::Campus(Box::default()),
        }
    }

    /// Writes the features of a scan to `features`, in the order of [`FeatureSet::feature_names`].
    /// They are always finite.
    ///
    /// # Panics
    /// Panics if `features` does not have one element per feature of the set.
    pub fn features(&mut self, scan: &Scan, features: &mut [f64]) -> Result<(), Unusable> {
        match self {
            Self::Paper16(paper16) => features.copy_from_slice(&paper16.features(scan)?),
            Self::Campus(campus) => features.copy_from_slice(&campus.features(scan)?),
        }
        Ok(())
    }
}

/// Writes `|a - b|`, feature by feature, to `difference`. All three slices must have one element
/// per feature of the set.
pub fn difference(a: &[f64], b: &[f64], difference: &mut [f64]) {
    for ((difference, a), b) in difference.iter_mut().zip(a).zip(b) {
        *difference = (a - b).abs();
    }
}
