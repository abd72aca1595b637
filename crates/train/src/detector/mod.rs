//! Fits the numbers of loop detection ([`model::Detector`]) to logs with ground truth.
//!
//! Each part is fitted on its own:
//!
//! | part | from | file |
//! |---|---|---|
//! | error of the odometry, drift of scan matching | relative poses over some metres of path | `noise.rs` |
//! | verifier, smallest confidence | evidence of right and wrong candidates | `verifier.rs` |
//! | evidence that no wrong candidate has | the same | `strong.rs` |
//! | error of a closure | errors of right candidates | `closure.rs` |
//! | number of compared places | ranks of right candidates | `ranks.rs` |
//!
//! Logs count equally, whatever their length. Where logs differ in noise, the noisiest one decides. A
//! part without enough evidence keeps its starting values, and [`NotFitted`] says what is missing.

mod closure;
mod logistic;
mod noise;
mod ranks;
mod sample;
mod strong;
mod verifier;

use dataset::{Pose2, wrap_angle};
use model::{Detector, DetectorLog, DetectorPart, Evidence};
use nalgebra::Matrix3;

/// What a log shows about loop detection.
#[derive(Debug, Clone, PartialEq)]
pub struct LogEvidence {
    /// Name of the log.
    pub log: String,
    /// The stamps at which the true pose is known, in order of time.
    pub known: Vec<KnownPose>,
    /// Whether the odometry has covariances. Then its errors are not fitted: the learned noise is for
    /// odometry without.
    pub odometry_has_covariance: bool,
    /// What `detect` found.
    pub candidates: Vec<FoundCandidate>,
}

/// The poses at a stamp at which the true pose is known. All are of the same body: the robot or the
/// lidar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownPose {
    /// Number of the continuous piece: poses of two pieces are not compared. A new piece starts where
    /// the drive or the frame of the ground truth changes.
    pub piece: u32,
    /// Path length by odometry \[m\], ascending within a piece.
    pub path_m: f64,
    /// Pose by odometry.
    pub odometry: Pose2,
    /// Pose by scan matching.
    pub matched: Pose2,
    /// The true pose.
    pub truth: Pose2,
}

/// A candidate that `detect` found with some detector, and the truth about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundCandidate {
    /// Identifies the query: candidates with the same value are of the same place.
    pub query: u64,
    /// Rank of the reference among the places that are most similar to the query, from 0.
    pub rank: u32,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose, by the alignment alone: without
    /// [`model::ClosureNoise`]. See [`alignment_covariance`].
    pub covariance: Matrix3<f64>,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// The true pose of the query in the frame of the reference. `None` if it is not known.
    pub truth: Option<Pose2>,
}

/// A fitted detector.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedDetector {
    /// The detector.
    pub detector: Detector,
    /// The parts that were not fitted, in the order of [`DetectorPart`].
    pub not_fitted: Vec<NotFitted>,
}

/// A part that keeps its starting values.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NotFitted {
    /// The part.
    pub part: DetectorPart,
    /// What the logs contain, such as `3 wrong candidates`.
    pub found: String,
    /// What the fit needs.
    pub expected: String,
}

/// Fits a detector. The order of the logs does not matter, except for the rounding of sums.
///
/// ```
/// // Without logs, every part keeps its starting values.
/// let fitted = train::detector::fit(&[]);
/// assert_eq!(fitted.not_fitted.len(), 6);
/// assert_eq!(fitted.detector.drift, model::Detector::starting_values().drift);
/// ```
pub fn fit(logs: &[LogEvidence]) -> FittedDetector {
    let mut detector = Detector::starting_values();
    let mut not_fitted = Vec::new();
    let judged: Vec<Vec<Judged>> = logs.iter().map(judge).collect();

    keep(noise::fit_odometry(logs), &mut detector.odometry, &mut not_fitted);
    keep(noise::fit_drift(logs), &mut detector.drift, &mut not_fitted);
    keep(closure::fit(&judged), &mut detector.closure, &mut not_fitted);
    match verifier::fit(&judged) {
        Ok(fitted) => {
            detector.verifier = fitted.verifier;
            detector.verifier_without_classifier = fitted.without_classifier;
            detector.measured = Some(fitted.measures);
            detector.min_confidence = verifier::min_confidence(&judged, &detector);
        }
        Err(missing) => not_fitted.push(missing),
    }
    keep(strong::fit(&judged), &mut detector.strong, &mut not_fitted);
    keep(ranks::fit(&judged), &mut detector.n_candidates, &mut not_fitted);

    detector.not_fitted = not_fitted.iter().map(|missing| missing.part).collect();
    detector.logs = logs
        .iter()
        .zip(&judged)
        .map(|(log, judged)| DetectorLog {
            log: log.log.clone(),
            n_right: judged.iter().filter(|c| c.is_right).count() as u32,
            n_wrong: judged.iter().filter(|c| !c.is_right).count() as u32,
        })
        .collect();
    FittedDetector { detector, not_fitted }
}

/// The covariance of an alignment from the covariance of a candidate that was found with `detector`:
/// subtracts what [`model::ClosureNoise`] added.
pub fn alignment_covariance(covariance: &Matrix3<f64>, detector: &Detector) -> Matrix3<f64> {
    let noise = &detector.closure;
    let mut covariance = *covariance;
    for (k, std) in [noise.std_m, noise.std_m, noise.std_rad].into_iter().enumerate() {
        // Rounding can leave a tiny negative number.
        covariance[(k, k)] = (covariance[(k, k)] - std * std).max(0.0);
    }
    covariance / noise.covariance_factor
}

/// The covariance that `detector` gives a candidate, from that of its alignment: the inverse of
/// [`alignment_covariance`].
pub fn closure_covariance(alignment: &Matrix3<f64>, detector: &Detector) -> Matrix3<f64> {
    let noise = &detector.closure;
    let constant = [noise.std_m, noise.std_m, noise.std_rad].map(|std| std * std);
    alignment * noise.covariance_factor + Matrix3::from_diagonal(&constant.into())
}

fn keep<T>(fitted: Result<T, NotFitted>, value: &mut T, not_fitted: &mut Vec<NotFitted>) {
    match fitted {
        Ok(fitted) => *value = fitted,
        Err(missing) => not_fitted.push(missing),
    }
}

/// A candidate closer to the truth than this \[m\] and [`RIGHT_DEG`] is right.
const RIGHT_M: f64 = 0.5;
const RIGHT_DEG: f64 = 5.0;
/// A candidate farther from the truth than this \[m\] or [`WRONG_DEG`] is wrong. Candidates in between
/// are left out: the ground truth is not exact enough for a decision.
const WRONG_M: f64 = 1.0;
const WRONG_DEG: f64 = 8.0;
/// Below this [`Evidence::weakness`], the points do not determine one direction, as in a corridor. It is
/// the limit that `detect` uses.
const WEAK_RATIO: f64 = 0.1;

/// A candidate that is known to be right or wrong.
struct Judged<'a> {
    found: &'a FoundCandidate,
    is_right: bool,
    /// Found minus true relative pose: x, y \[m\], heading \[rad\].
    error: [f64; 3],
    /// Weight, so that each log with such candidates has the same sum.
    weight: f64,
}

impl Judged<'_> {
    /// Whether the points determine the position badly in one direction.
    fn is_degenerate(&self) -> bool {
        self.found.evidence.weakness < WEAK_RATIO
    }
}

/// The candidates of a log that are known to be right or wrong.
fn judge(log: &LogEvidence) -> Vec<Judged<'_>> {
    let judge = |found: &'_ FoundCandidate| {
        let (found_pose, truth) = (found.reference_from_query, found.truth?);
        let error_m = found_pose.distance_m(&truth);
        let error_deg = found_pose.heading_difference_rad(&truth).to_degrees();
        let is_right = error_m < RIGHT_M && error_deg < RIGHT_DEG;
        let is_wrong = WRONG_M < error_m || WRONG_DEG < error_deg;
        (is_right || is_wrong).then(|| {
            let heading = wrap_angle(found_pose.heading_rad - truth.heading_rad);
            (is_right, [found_pose.x_m - truth.x_m, found_pose.y_m - truth.y_m, heading])
        })
    };
    let judged: Vec<_> = log
        .candidates
        .iter()
        .filter_map(|found| judge(found).map(|(is_right, error)| (found, is_right, error)))
        .collect();
    let weight = 1.0 / judged.len().max(1) as f64;
    judged
        .into_iter()
        .map(|(found, is_right, error)| Judged { found, is_right, error, weight })
        .collect()
}
