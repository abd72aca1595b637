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
    pub reason: String,
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
    /// True poses that contradict scan matching. Closures and revisits are not compared with them, but
    /// trajectories are.
    pub n_doubtful: usize,
    /// Accepted closures that are false if doubtful true poses are used as well.
    pub n_false_with_doubtful: usize,
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
    let mut rejected: BTreeMap<&str, usize> = BTreeMap::new();
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
        rejected: rejected
            .into_iter()
            .map(|(reason, n)| Rejected { reason: reason.to_owned(), n })
            .collect(),
        truth: drive.truth.and_then(|truth| against_truth(drive, &Truth::new(truth, drive.scans))),
    }
}

/// `None` if no keyframe has a true pose.
fn against_truth(drive: &Drive<'_>, truth: &Truth) -> Option<AgainstTruth> {
    let poses = known_poses(drive, truth);
    let n_known = poses.iter().flatten().count();
    if n_known == 0 {
        return None;
    }
    let judged = judge_closures(&poses, drive.closures);
    let with_doubtful = known_poses(drive, &truth.with_doubtful());
    let n_false_with_doubtful = drive
        .closures
        .iter()
        .zip(judge_closures(&with_doubtful, drive.closures))
        .filter(|(closure, judged)| {
            closure.rejected.is_none() && judged.is_some_and(|j| j.verdict == Verdict::False)
        })
        .count();
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
        n_doubtful: truth.n_doubtful(),
        n_false_with_doubtful,
        closures: ClosureErrors::new(&accepted),
        revisits: Revisits::new(&revisit),
        candidates: CandidateErrors::new(&candidates),
        trajectories: PoseSource::ALL.map(|source| trajectory_errors(drive, truth, source)).into(),
        closure_calibration: calibration(drive, &poses),
        keyframe_calibration: keyframe_calibration(drive.keyframes, &poses),
        revisit,
        curve: curve(drive, &candidates),
        judged,
        poses,
    })
}

/// The true poses of the keyframes.
pub(super) fn known_poses(drive: &Drive<'_>, truth: &Truth) -> Vec<Option<TruePose>> {
    drive.keyframes.iter().map(|k| truth.at(k.stamp_ns)).collect()
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

/// The differences of relative poses from those of the optimized trajectory, at the stamps of a source:
/// an estimate of its drift without ground truth.
pub fn differences(drive: &Drive<'_>, source: PoseSource) -> Vec<Drift> {
    let optimized: BTreeMap<i64, Pose2> =
        drive.scans.iter().map(|scan| (scan.stamp_ns, scan.optimized)).collect();
    let (optimized, estimate): (Vec<Pose2>, Vec<Pose2>) = source
        .poses(drive)
        .into_iter()
        .filter_map(|(stamp_ns, pose)| Some((*optimized.get(&stamp_ns)?, pose)))
        .unzip();
    DRIFT_PATHS_M
        .into_iter()
        .filter_map(|path_m| relative_errors(&optimized, &estimate, path_m))
        .collect()
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

#[cfg(test)]
mod tests {
    use dataset::{StampedPose, Trajectory};

    use super::*;
    use crate::detection::input::{Evidence, FoundCandidate, FoundClosure, ScanPoses};

    const SECOND: i64 = 1_000_000_000;

    fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
    }

    /// A circle of 20 m radius, driven twice, with a scan every half metre and a keyframe every metre.
    /// The truth is in a frame that is moved by 100 m and turned by 30 deg.
    struct Circle {
        keyframes: Vec<KeyframePoses>,
        scans: Vec<ScanPoses>,
        truth: Trajectory,
    }

    /// Radius of the circle \[m\].
    const RADIUS_M: f64 = 20.0;

    fn on_circle(k: usize) -> Pose2 {
        let angle = k as f64 * 0.5 / RADIUS_M;
        Pose2 {
            x_m: RADIUS_M * angle.sin(),
            y_m: RADIUS_M * (1.0 - angle.cos()),
            heading_rad: dataset::wrap_angle(angle),
        }
    }

    /// `every`: one true pose for this many scans.
    fn circle(every: usize) -> Circle {
        let truth_from_map = at(100.0, 0.0, 30.0);
        let n = 500;
        let scans: Vec<ScanPoses> = (0..n)
            .map(|k| {
                // Odometry measures 1 % too much.
                let pose = on_circle(k);
                let odometry = Pose2 { x_m: 1.01 * pose.x_m, y_m: 1.01 * pose.y_m, ..pose };
                let scan_matched = (k % 2 == 0).then_some(pose);
                ScanPoses { stamp_ns: k as i64 * SECOND, odometry, scan_matched, optimized: pose }
            })
            .collect();
        let keyframes = (0..n / 2)
            .map(|k| KeyframePoses {
                scan: 2 * k as u32,
                stamp_ns: scans[2 * k].stamp_ns,
                path_m: k as f64,
                odometry: scans[2 * k].odometry,
                scan_matched: on_circle(2 * k),
                // Every optimized keyframe after the first is 0.2 m too far to the north.
                optimized: at(0.0, if k == 0 { 0.0 } else { 0.2 }, 0.0) * on_circle(2 * k),
                covariance: Some([0.04, 0.0, 0.0, 0.04, 0.0, 0.01]),
            })
            .collect();
        let poses = (0..n)
            .step_by(every)
            .map(|k| StampedPose::new(k as i64 * SECOND, truth_from_map * on_circle(k)));
        Circle { keyframes, scans, truth: Trajectory::new(poses.collect()).0 }
    }

    fn drive<'a>(
        circle: &'a Circle,
        candidates: &'a [FoundCandidate],
        closures: &'a [FoundClosure<'a>],
    ) -> Drive<'a> {
        Drive {
            log: "circle",
            segment: 2,
            map: Some(0),
            keyframes: &circle.keyframes,
            scans: &circle.scans,
            candidates,
            closures,
            truth: Some(&circle.truth),
            base_from_lidar: Pose2::default(),
        }
    }

    /// The pose of keyframe `query` in the frame of keyframe `reference`, moved by `dx_m`.
    fn closure(
        query: usize,
        reference: usize,
        dx_m: f64,
        rejected: Option<&'static str>,
    ) -> FoundClosure<'static> {
        FoundClosure {
            query,
            reference,
            reference_from_query: at(dx_m, 0.0, 0.0)
                * (on_circle(2 * reference).inverse() * on_circle(2 * query)),
            covariance: [0.01, 0.0, 0.0, 0.01, 0.0, 1.0],
            confidence: 0.9,
            rejected,
            evidence: Evidence::default(),
        }
    }

    /// The circle is 125.66 m long, so keyframe 126 + k is 0.34 m after keyframe k: all keyframes from 123
    /// on, which are within 3 m of keyframe 0, are revisits: 250 - 123 = 127.
    #[test]
    fn a_circle_driven_twice() {
        let circle = circle(1);
        let candidates = [(130, 4, 0.0, 0.9), (150, 24, 5.0, 0.8), (160, 34, 0.0, 0.7)].map(
            |(query, reference, dx_m, confidence)| FoundCandidate {
                query,
                reference,
                reference_from_query: closure(query, reference, dx_m, None).reference_from_query,
                confidence,
            },
        );
        let closures = [
            closure(130, 4, 0.1, None),
            closure(140, 14, 0.3, None),
            closure(150, 24, 5.0, Some("inconsistent")),
        ];
        let found = measure(&drive(&circle, &candidates, &closures));
        assert_eq!((found.n_accepted, found.n_candidates, found.segment), (2, 3, 2));
        assert_eq!(found.rejected, [Rejected { reason: "inconsistent".to_owned(), n: 1 }]);
        let truth = found.truth.unwrap();
        assert_eq!((truth.n_known, truth.n_measured), (250, 250));
        assert_eq!((truth.closures.n_judged, truth.closures.n_false_by_pose), (2, 0));
        assert!((truth.closures.median_m.unwrap() - 0.2).abs() < 1e-9);
        assert_eq!((truth.revisits.all.n, truth.revisits.opposite_direction.n), (127, 0));
        assert_eq!(truth.revisits.all.n_closed, 2);
        assert_eq!(
            truth.candidates,
            CandidateErrors { n_right: 2, n_inexact: 0, n_false: 1, n_unknown: 0 }
        );
        // Over falling confidence: right, false, right.
        let precisions: Vec<_> = truth.curve.iter().map(|p| p.confusion.precision()).collect();
        assert_eq!(precisions, [Some(1.0), Some(0.5), Some(2.0 / 3.0)]);
        // Normalized errors 0.1^2 / 0.01 = 1 and 0.3^2 / 0.01 = 9: their mean is 5.
        assert!((truth.closure_calibration.unwrap().mean - 5.0).abs() < 1e-6);
        // 0.2^2 / 0.04 = 1 for each keyframe after the first, in the frame of the map.
        let keyframes = truth.keyframe_calibration.unwrap();
        assert!((keyframes.mean - 1.0).abs() < 1e-6 && keyframes.n == 249, "{keyframes:?}");
    }

    /// The aligned odometry is a circle of 20.2 m around the same centre: 0.2 m error everywhere.
    #[test]
    fn each_trajectory_is_measured_at_its_own_stamps() {
        let circle = circle(1);
        let truth = measure(&drive(&circle, &[], &[])).truth.unwrap();
        let of = |source| truth.trajectories.iter().find(|t| t.source == source).unwrap();
        assert_eq!(PoseSource::ALL.map(|source| of(source).n_poses), [500, 250, 250, 500]);
        // Two rounds are 1.99 times around, so the alignment can move the centre slightly.
        let odometry = of(PoseSource::Odometry).ate_rmse_m.unwrap();
        assert!((odometry - 0.2).abs() < 0.002, "{odometry}");
        assert!(of(PoseSource::ScanMatched).ate_rmse_m.unwrap() < 1e-9);
        assert!(of(PoseSource::Optimized).drift.iter().all(|d| d.rmse_m < 1e-9));
        assert_eq!(of(PoseSource::Optimized).drift.len(), 6);
        assert_eq!(truth.closures.median_m, None);
        assert_eq!(truth.closure_calibration, None);
    }

    /// A true pose at every third scan, 3 s apart: all keyframes are known, a third of them is measured.
    /// Keyframe 125 (scan 250) has none, its neighbour scan 249 has one. The true poses of keyframes are
    /// carried by the full trajectory, whose offset of the keyframes does not count twice.
    #[test]
    fn sparse_truth_is_carried_to_the_keyframes() {
        let circle = circle(3);
        let truth = measure(&drive(&circle, &[], &[])).truth.unwrap();
        assert_eq!((truth.n_known, truth.n_measured), (250, 84));
        let of = |source| truth.trajectories.iter().find(|t| t.source == source).unwrap();
        assert_eq!(of(PoseSource::Optimized).n_poses, 167);
        assert_eq!(of(PoseSource::OptimizedKeyframes).n_poses, 84);
        // Without truth there are counts, but no errors.
        let without = Drive { truth: None, ..drive(&circle, &[], &[]) };
        assert_eq!(measure(&without).truth, None);
        let elsewhere = Trajectory::new(vec![StampedPose::new(-SECOND * 100, at(0.0, 0.0, 0.0))]).0;
        let without = Drive { truth: Some(&elsewhere), ..drive(&circle, &[], &[]) };
        assert_eq!(measure(&without).truth, None);
    }
}
