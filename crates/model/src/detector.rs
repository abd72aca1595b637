//! What loop detection has learned from logs with ground truth.

use serde::{Deserialize, Serialize};

/// The layout of a [`Detector`]. It changes when a field or its meaning changes.
pub const DETECTOR_VERSION: u32 = 1;

/// The learned numbers of the stages `register`, `detect` and `optimize`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Detector {
    /// [`DETECTOR_VERSION`].
    pub version: u32,
    /// Error of the odometry between two scans, for poses without a covariance.
    pub odometry: OdometryNoise,
    /// Error of the poses from scan matching.
    pub drift: Drift,
    /// Error of the relative pose of a closure.
    pub closure: ClosureNoise,
    /// Turns evidence into a confidence.
    pub verifier: Verifier,
    /// The same without the classifier, for candidates without [`Evidence::classifier`]. Its weight of
    /// the classifier is 0.
    pub verifier_without_classifier: Verifier,
    /// Candidates with a smaller confidence take no part in the optimization.
    pub min_confidence: f64,
    /// No wrong candidate of the training logs has this evidence. A closure that has it can be trusted
    /// on its own. `optimize` does not require it: see docs/detection.md.
    pub strong: StrongLimits,
    /// Number of candidates per place.
    pub n_candidates: u32,
    /// How well the verifiers describe the candidates that they were fitted to. Absent if they were
    /// not fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<VerifierMeasures>,
    /// Parts that keep their starting values, because the logs do not contain enough for a fit. In
    /// ascending order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_fitted: Vec<DetectorPart>,
    /// The logs that the detector was fitted to. Empty for the starting values.
    pub logs: Vec<DetectorLog>,
}

/// Error of the odometry over a step of `d` metres: `std_m_per_m * d + std_m` along and across,
/// `std_rad_per_sqrt_m * sqrt(d) + std_rad` in heading.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OdometryNoise {
    /// Standard deviation of the position per metre of path.
    pub std_m_per_m: f64,
    /// Standard deviation of the position, independent of the path \[m\].
    pub std_m: f64,
    /// Standard deviation of the heading \[rad/sqrt(m)\].
    pub std_rad_per_sqrt_m: f64,
    /// Standard deviation of the heading, independent of the path \[rad\].
    pub std_rad: f64,
}

impl OdometryNoise {
    /// The smallest error of odometry that is believed. The values are guesses: a millimetre per step and
    /// a tenth of a degree would make the prior of scan matching a constraint.
    pub const LEAST: Self = Self {
        std_m_per_m: 0.02,
        std_m: 0.005,
        // 0.3 deg.
        std_rad_per_sqrt_m: 0.005_235_987_755_982_988,
        // 0.1 deg.
        std_rad: 0.001_745_329_251_994_329_5,
    };

    /// Standard deviation of the position along and across after a path \[m\].
    pub fn std_m_over(&self, path_m: f64) -> f64 {
        self.std_m_per_m * path_m + self.std_m
    }

    /// Standard deviation of the heading after a path in metres \[rad\].
    pub fn std_rad_over(&self, path_m: f64) -> f64 {
        self.std_rad_per_sqrt_m * path_m.sqrt() + self.std_rad
    }
}

/// Error of the poses from scan matching over `d` metres of path: both grow with `sqrt(d)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Drift {
    /// Standard deviation of x and of y \[m/sqrt(m)\].
    pub std_m_per_sqrt_m: f64,
    /// Standard deviation of the heading \[rad/sqrt(m)\].
    pub std_rad_per_sqrt_m: f64,
}

/// Error of the relative pose of a closure. Its covariance is that of the alignment times
/// `covariance_factor`, plus the squares of `std_m`, `std_m` and `std_rad` on the diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ClosureNoise {
    /// Smallest standard deviation of x and of y \[m\].
    pub std_m: f64,
    /// Smallest standard deviation of the heading \[rad\].
    pub std_rad: f64,
    /// Factor of the covariance of an alignment, so that its normalized errors have the right size.
    pub covariance_factor: f64,
    /// Standard deviation of x and of y for the choice of closures that agree with each other \[m\]. It is
    /// larger than `std_m`, because a few right closures have large errors, and must be kept.
    pub consistency_std_m: f64,
    /// The same for the heading \[rad\].
    pub consistency_std_rad: f64,
}

/// Logistic regression on evidence, whose weights have a fixed sign: more overlap never lowers the
/// confidence, and more conflict never raises it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Verifier {
    /// The sum without any evidence.
    pub intercept: f64,
    /// Weight of [`Evidence::overlap`], 0 or more.
    pub overlap: f64,
    /// Weight of [`Evidence::known_overlap`], 0 or more.
    pub known_overlap: f64,
    /// Weight of [`Evidence::conflict`], 0 or less.
    pub conflict: f64,
    /// Weight of [`Evidence::margin`], 0 or more.
    pub margin: f64,
    /// Weight of [`Evidence::classifier`], 0 or more.
    pub classifier: f64,
}

/// Limits of evidence that no wrong candidate reaches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct StrongLimits {
    /// Least [`Evidence::known_overlap`].
    pub known_overlap: f64,
    /// Most [`Evidence::conflict`].
    pub conflict: f64,
}

/// How well the verifiers describe the candidates that they were fitted to. The log loss is the mean
/// of `-ln(p)` over candidates, where `p` is the confidence of what a candidate is: right or wrong.
/// Each log has the same weight. 0 is the best value. A verifier that always states the share of right
/// candidates has `log_loss_of_share`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct VerifierMeasures {
    /// Log loss of [`Detector::verifier`].
    pub log_loss: f64,
    /// Log loss of [`Detector::verifier_without_classifier`].
    pub log_loss_without_classifier: f64,
    /// Log loss of the share of right candidates.
    pub log_loss_of_share: f64,
    /// Candidates with a confidence of the classifier. If there are too few for a fit, both verifiers are
    /// the same.
    pub n_with_classifier: u32,
}

/// A part of a [`Detector`] that is fitted on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum DetectorPart {
    /// [`Detector::odometry`].
    Odometry,
    /// [`Detector::drift`].
    Drift,
    /// [`Detector::closure`].
    Closure,
    /// Both verifiers and [`Detector::min_confidence`].
    Verifier,
    /// [`Detector::strong`].
    Strong,
    /// [`Detector::n_candidates`].
    NCandidates,
}

/// A log that a detector was fitted to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DetectorLog {
    /// Name of the log.
    pub log: String,
    /// Candidates whose relative pose agrees with the ground truth.
    pub n_right: u32,
    /// Candidates whose relative pose does not.
    pub n_wrong: u32,
}

/// What speaks for and against a closure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Share of the points that the other submap explains, in the direction with the smaller share.
    pub overlap: f64,
    /// The same share, over the points in space that the other submap knows.
    pub known_overlap: f64,
    /// Number of points in space that the other submap knows, in the direction with the smaller number.
    pub n_known: u32,
    /// Share of the points in known space that lie in the free space of the other submap, in the
    /// direction with the larger share.
    pub conflict: f64,
    /// Score of the best minus score of the second-best pose by correlation, per point. 0 if the
    /// poses were not compared by correlation.
    pub margin: f64,
    /// Smallest over largest information about the position, 0 to 1. Near 0 in a bare corridor.
    pub weakness: f64,
    /// Confidence of the classifier for the two scans, if one was used.
    pub classifier: Option<f64>,
}

impl Detector {
    /// The values that training starts from. They are those of a robot with a planar scanner and bad
    /// wheels.
    pub fn starting_values() -> Self {
        let verifier = Verifier {
            intercept: -2.5,
            overlap: 10.0,
            known_overlap: 0.0,
            conflict: 0.0,
            margin: 0.0,
            classifier: 0.0,
        };
        Self {
            version: DETECTOR_VERSION,
            odometry: OdometryNoise {
                std_m_per_m: 0.15,
                std_m: 0.02,
                std_rad_per_sqrt_m: 5f64.to_radians(),
                std_rad: 0.01,
            },
            drift: Drift { std_m_per_sqrt_m: 0.03, std_rad_per_sqrt_m: 0.4f64.to_radians() },
            closure: ClosureNoise {
                std_m: 0.12,
                std_rad: 2f64.to_radians(),
                covariance_factor: 1.0,
                consistency_std_m: 0.12,
                consistency_std_rad: 2f64.to_radians(),
            },
            verifier,
            verifier_without_classifier: verifier,
            min_confidence: 0.5,
            strong: StrongLimits { known_overlap: 0.5, conflict: 0.2 },
            n_candidates: 5,
            measured: None,
            not_fitted: Vec::new(),
            logs: Vec::new(),
        }
    }

    /// Confidence that a closure is right, 0 to 1.
    pub fn confidence(&self, evidence: &Evidence) -> f64 {
        match evidence.classifier {
            Some(_) => self.verifier.confidence(evidence),
            None => self.verifier_without_classifier.confidence(evidence),
        }
    }
}

impl Verifier {
    /// Confidence that a closure is right, 0 to 1. The classifier counts as 0 where the evidence does
    /// not contain it.
    pub fn confidence(&self, evidence: &Evidence) -> f64 {
        let sum = self.intercept
            + self.overlap * evidence.overlap
            + self.known_overlap * evidence.known_overlap
            + self.conflict * evidence.conflict
            + self.margin * evidence.margin
            + self.classifier * evidence.classifier.unwrap_or(0.0);
        1.0 / (1.0 + libm::exp(-sum))
    }
}

impl StrongLimits {
    /// Whether the evidence is within the limits.
    pub fn accept(&self, evidence: &Evidence) -> bool {
        self.known_overlap <= evidence.known_overlap && evidence.conflict <= self.conflict
    }
}

impl DetectorPart {
    /// The name in `model.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::Drift => "drift",
            Self::Closure => "closure",
            Self::Verifier => "verifier",
            Self::Strong => "strong",
            Self::NCandidates => "n_candidates",
        }
    }
}
