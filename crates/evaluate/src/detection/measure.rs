//! All measures of a drive.

use std::collections::BTreeMap;

use dataset::{Label, Pose2};
use serde::Serialize;

use super::calibration::{Calibration, normalized_error};
use super::closures::{
    CandidateErrors, ClosureErrors, Judged, Verdict, calibration, judge_candidates, judge_closures,
};
use super::input::{Drive, KeyframePoses};
use super::revisits::{Revisit, Revisits, revisits};
use super::trajectory::{DRIFT_PATHS_M, Drift, align, relative_errors};
use super::truth::{TruePose, Truth};
use crate::metrics::{PrPoint, precision_recall};

/// The measures of a drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveMeasures {
    /// Name of the log.
    pub log: String,
    /// Number of the piece of the log.
    pub segment: u32,
    /// Number of scans.
    pub n_scans: usize,
    /// Number of keyframes.
    pub n_keyframes: usize,
    /// Path length by odometry \[m\].
    pub path_m: f64,
    /// What `detect` proposes.
    pub n_candidates: usize,
    /// Closures that `optimize` accepts.
    pub n_accepted: usize,
    /// Closures that it rejects, by reason.
    pub rejected: Vec<Rejected>,
    /// The errors; `None` if the log has no ground truth for this drive.
    pub truth: Option<AgainstTruth>,
}

/// The number of closures that were rejected for a reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Rejected {
    /// The code of the reason.
    pub reason: &'static str,
    /// Number of closures.
    pub n: usize,
}

/// The errors of a drive with ground truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AgainstTruth {
    /// Keyframes whose true pose is known.
    pub n_known: usize,
    /// Those of them whose true pose is measured. See [`TruePose::is_measured`].
    pub n_measured: usize,
    /// Accepted closures.
    pub closures: ClosureErrors,
    /// Revisits by keyframe.
    pub revisits: Revisits,
    /// Candidates of `detect`.
    pub candidates: CandidateErrors,
    /// Errors of the trajectories.
    pub trajectories: Vec<TrajectoryErrors>,
    /// Whether the covariances of accepted closures are right.
    pub closure_calibration: Option<Calibration>,
    /// Whether the covariances of the optimized keyframes are right.
    pub keyframe_calibration: Option<Calibration>,
    /// The revisits.
    #[serde(skip)]
    pub revisit: Vec<Revisit>,
    /// Each closure compared with the truth, where it is known, `(n_closures,)`.
    #[serde(skip)]
    pub judged: Vec<Option<Judged>>,
    /// Precision and recall over the confidence of the candidates that are right or false.
    #[serde(skip)]
    pub curve: Vec<PrPoint>,
    /// The true poses of the keyframes, `(n_keyframes,)`.
    #[serde(skip)]
    pub poses: Vec<Option<TruePose>>,
}

/// Where poses come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// Odometry at every scan.
    Odometry,
    /// Scan matching at the registered scans.
    ScanMatched,
    /// The optimized poses of the keyframes.
    OptimizedKeyframes,
    /// The optimized poses of all scans.
    Optimized,
}

impl PoseSource {
    /// All of them, in the order of the stages.
    pub const ALL: [Self; 4] =
        [Self::Odometry, Self::ScanMatched, Self::OptimizedKeyframes, Self::Optimized];

    /// The name in tables and of files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry => "odometry",
            Self::ScanMatched => "scan_matched",
            Self::OptimizedKeyframes => "optimized_keyframes",
            Self::Optimized => "optimized",
        }
    }

    /// Stamps and poses of a drive.
    pub fn poses(self, drive: &Drive<'_>) -> Vec<(i64, Pose2)> {
        let scans = drive.scans.iter();
        match self {
            Self::Odometry => scans.map(|s| (s.stamp_ns, s.odometry)).collect(),
            Self::ScanMatched => {
                scans.filter_map(|s| Some((s.stamp_ns, s.scan_matched?))).collect()
            }
            Self::OptimizedKeyframes => {
                drive.keyframes.iter().map(|k| (k.stamp_ns, k.optimized)).collect()
            }
            Self::Optimized => scans.map(|s| (s.stamp_ns, s.optimized)).collect(),
        }
    }
}

/// The errors of a trajectory, at the stamps where the truth is measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrajectoryErrors {
    /// Where the poses come from.
    pub source: PoseSource,
    /// Number of poses with a measured true pose.
    pub n_poses: usize,
    /// Absolute trajectory error after alignment, root mean square \[m\]. `None` with fewer than two
    /// poses.
    pub ate_rmse_m: Option<f64>,
    /// Errors of relative poses over several path lengths: evo's RPE.
    pub drift: Vec<Drift>,
}

/// Computes the measures of a drive.
pub fn measure(drive: &Drive<'_>) -> DriveMeasures {
    let mut rejected: BTreeMap<&'static str, usize> = BTreeMap::new();
    for reason in drive.closures.iter().filter_map(|closure| closure.rejected) {
        *rejected.entry(reason).or_default() += 1;
    }
    let n_rejected: usize = rejected.values().sum();
    DriveMeasures {
        log: drive.log.to_owned(),
        segment: drive.segment,
        n_scans: drive.scans.len(),
        n_keyframes: drive.keyframes.len(),
        path_m: drive.keyframes.last().map_or(0.0, |k| k.path_m),
        n_candidates: drive.candidates.len(),
        n_accepted: drive.closures.len() - n_rejected,
        rejected: rejected.into_iter().map(|(reason, n)| Rejected { reason, n }).collect(),
        truth: drive.truth.and_then(|truth| {
            against_truth(drive, &Truth::new(truth, drive.scans))
        }),
    }
}

/// `None` if no keyframe has a true pose.
fn against_truth(drive: &Drive<'_>, truth: &Truth) -> Option<AgainstTruth> {
    let poses: Vec<Option<TruePose>> =
        drive.keyframes.iter().map(|k| truth.at(k.stamp_ns, k.optimized)).collect();
    let n_known = poses.iter().flatten().count();
    if n_known == 0 {
        return None;
    }
    let judged = judge_closures(&poses, drive.closures);
    let candidates = judge_candidates(&poses, drive.candidates);
    let accepted: Vec<Option<Judged>> = drive
        .closures
        .iter()
        .zip(&judged)
        .filter(|(closure, _)| closure.rejected.is_none())
        .map(|(_, judged)| *judged)
        .collect();
    let revisit = revisits(drive, &poses, &candidates, &judged);
    Some(AgainstTruth {
        n_known,
        n_measured: poses.iter().flatten().filter(|t| t.is_measured).count(),
        closures: ClosureErrors::new(&accepted),
        revisits: Revisits::new(&revisit),
        candidates: CandidateErrors::new(&candidates),
        trajectories: PoseSource::ALL
            .map(|source| trajectory_errors(drive, truth, source))
            .into(),
        closure_calibration: calibration(drive, &poses),
        keyframe_calibration: keyframe_calibration(drive.keyframes, &poses),
        revisit,
        curve: curve(drive, &candidates),
        judged,
        poses,
    })
}

fn trajectory_errors(drive: &Drive<'_>, truth: &Truth, source: PoseSource) -> TrajectoryErrors {
    let (truth, estimate): (Vec<Pose2>, Vec<Pose2>) = source
        .poses(drive)
        .into_iter()
        .filter_map(|(stamp_ns, pose)| Some((truth.measured_at(stamp_ns)?, pose)))
        .unzip();
    let drift = |path_m| relative_errors(&truth, &estimate, path_m);
    TrajectoryErrors {
        source,
        n_poses: truth.len(),
        ate_rmse_m: align(&truth, &estimate).map(|alignment| alignment.rmse_m),
        drift: DRIFT_PATHS_M.into_iter().filter_map(drift).collect(),
    }
}

/// Precision and recall of the candidates that are right or false.
fn curve(drive: &Drive<'_>, judged: &[Option<Judged>]) -> Vec<PrPoint> {
    let label = |judged: &Judged| match judged.verdict {
        Verdict::Right => Some(Label::Positive),
        Verdict::Inexact => None,
        Verdict::False => Some(Label::Negative),
    };
    let (labels, confidences): (Vec<Label>, Vec<f64>) = drive
        .candidates
        .iter()
        .zip(judged)
        .filter_map(|(candidate, judged)| {
            Some((judged.as_ref().and_then(label)?, candidate.confidence))
        })
        .unzip();
    precision_recall(&labels, &confidences)
}

/// The errors of the optimized keyframes relative to the first one with a true pose, in the frame of the
/// map, compared with their covariances.
fn keyframe_calibration(
    keyframes: &[KeyframePoses],
    truth: &[Option<TruePose>],
) -> Option<Calibration> {
    let mut known = keyframes.iter().zip(truth).filter_map(|(k, truth)| Some((k, (*truth)?.pose)));
    let (first, true_first) = known.next()?;
    let map_from_truth = first.optimized * true_first.inverse();
    Calibration::new(known.map(|(keyframe, truth)| {
        normalized_error(keyframe.optimized, map_from_truth * truth, &keyframe.covariance?)
    }))
}
