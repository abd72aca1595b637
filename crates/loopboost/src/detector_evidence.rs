//! What the logs of a run show about loop detection: poses and candidates compared with the ground truth.

use std::collections::HashMap;

use dataset::{CandidateClosure, Pose2, RegisteredScan, StampedPose, Trajectory};
use model::Detector;
use train::detector::{FoundCandidate, KnownPose, LogEvidence, alignment_covariance};

use crate::drives::{evidence, matrix};
use crate::goal::Goal;
use crate::stage::Artifact;

/// Between two true poses at most this far apart, the truth is interpolated \[ns\]. `evaluate` uses the
/// same limit.
const MAX_INTERPOLATION_NS: i64 = 250_000_000;
/// The truth of a keyframe is carried along the scan-matched poses over at most this path \[m\]. Sparse
/// ground truth has a pose every metre.
const MAX_CARRY_M: f64 = 1.0;
/// True poses that are closer together on the path than this are thinned \[m\]. It is the spacing of
/// registered scans.
const SPACING_M: f64 = 0.2;

/// Places that are compared with each place in a run that fits a detector. It is twice the starting
/// value, because a fit cannot choose a larger number than was tried.
const TRIED_CANDIDATES: u32 = 10;

/// The detector of a run without a model.
pub(crate) fn starting_values(goal: Goal) -> Detector {
    let mut detector = Detector::starting_values();
    if goal.trains() && goal.has(Artifact::Truth) {
        detector.n_candidates = TRIED_CANDIDATES;
    }
    detector
}

/// The tables of a log.
pub(crate) struct LogTables<'a> {
    /// Name of the log.
    pub(crate) log: &'a str,
    /// The registered scans, in order of time within each segment.
    pub(crate) registered: &'a [RegisteredScan],
    /// The poses that loop detection uses.
    pub(crate) odometry: &'a Trajectory,
    /// The true poses.
    pub(crate) truth: &'a Trajectory,
    /// The candidates of the log. They were found with the starting values.
    pub(crate) candidates: &'a [CandidateClosure],
}

/// Compares the poses and the candidates of a log with its ground truth.
pub(crate) fn log_evidence(tables: &LogTables<'_>) -> LogEvidence {
    let registered = Registered::new(tables);
    let known = registered.known_poses();
    let scans: HashMap<u32, &RegisteredScan> =
        tables.registered.iter().map(|row| (row.id.scan, row)).collect();
    let true_pose = |scan: u32| scans.get(&scan).and_then(|row| registered.truth_of(row));
    let candidate = |found: &CandidateClosure| {
        let closure = &found.closure;
        let query = true_pose(closure.query.scan);
        let reference = true_pose(closure.reference.scan);
        let truth = query.zip(reference).filter(|(a, b)| a.frame == b.frame);
        FoundCandidate {
            query: u64::from(closure.query.scan),
            rank: found.rank,
            reference_from_query: closure.reference_from_query,
            covariance: alignment_covariance(
                &matrix(closure.covariance),
                &Detector::starting_values(),
            ),
            evidence: evidence(closure),
            truth: truth.map(|(query, reference)| reference.pose.inverse() * query.pose),
        }
    };
    LogEvidence {
        log: tables.log.to_owned(),
        known,
        odometry_has_covariance: tables.odometry.poses().iter().any(|p| p.covariance.is_some()),
        candidates: tables.candidates.iter().map(candidate).collect(),
    }
}

/// A true pose in a frame of the ground truth.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TruePose {
    pose: Pose2,
    frame: u32,
}

/// Scan-matched poses at any stamp: the last registered scan, and the odometry since then.
struct Registered<'a> {
    tables: &'a LogTables<'a>,
    /// Indices of the registered scans, by stamp.
    by_stamp: Vec<usize>,
}

/// The poses at a stamp.
#[derive(Debug, Clone, Copy)]
struct Posed {
    odometry: Pose2,
    matched: Pose2,
    segment: u32,
    path_m: f64,
}

impl<'a> Registered<'a> {
    fn new(tables: &'a LogTables<'a>) -> Self {
        let mut by_stamp: Vec<usize> = (0..tables.registered.len()).collect();
        by_stamp.sort_by_key(|&k| tables.registered[k].stamp_ns);
        Self { tables, by_stamp }
    }

    /// The poses at a stamp, from the registered scan at the stamp or before it. Scans are registered
    /// every 0.2 m, so the odometry since then hardly has an error.
    fn at(&self, stamp_ns: i64) -> Option<Posed> {
        let rows = self.tables.registered;
        let after = self.by_stamp.partition_point(|&k| rows[k].stamp_ns <= stamp_ns);
        let row = &rows[self.by_stamp[after.checked_sub(1)?]];
        let odometry = self.tables.odometry.stamped_pose_at(stamp_ns, MAX_INTERPOLATION_NS).ok()?;
        let step = row.odometry.inverse() * odometry.pose;
        let step_m = step.distance_m(&Pose2::default());
        // `register` can split the segments of the odometry.
        let at_row = self.tables.odometry.stamped_pose_at(row.stamp_ns, i64::MAX).ok()?;
        let is_continuous = odometry.segment == at_row.segment;
        (is_continuous && step_m <= MAX_CARRY_M).then(|| Posed {
            odometry: odometry.pose,
            matched: row.pose * step,
            segment: row.segment,
            path_m: row.travel_m + step_m,
        })
    }

    /// The poses at the stamps of true poses, one per 0.2 m of path.
    fn known_poses(&self) -> Vec<KnownPose> {
        let mut known: Vec<KnownPose> = Vec::new();
        let mut last: Option<[u32; 3]> = None;
        for truth in self.tables.truth.poses() {
            let Some(posed) = self.at(truth.stamp_ns) else { continue };
            let of_piece = [posed.segment, truth.segment, truth.frame];
            let is_new = last != Some(of_piece);
            let piece = known.last().map_or(0, |last| last.piece + u32::from(is_new));
            let is_close = |last: &KnownPose| !is_new && posed.path_m < last.path_m + SPACING_M;
            if known.last().is_some_and(is_close) {
                continue;
            }
            last = Some(of_piece);
            known.push(KnownPose {
                piece,
                path_m: posed.path_m,
                odometry: posed.odometry,
                matched: posed.matched,
                truth: truth.pose,
            });
        }
        known
    }

    /// The true pose of a registered scan: measured, or carried along the scan-matched poses from a true
    /// pose nearby.
    fn truth_of(&self, row: &RegisteredScan) -> Option<TruePose> {
        let truth = self.tables.truth;
        if let Ok(at) = truth.stamped_pose_at(row.stamp_ns, MAX_INTERPOLATION_NS) {
            return Some(TruePose { pose: at.pose, frame: at.frame });
        }
        let poses = truth.poses();
        let after = poses.partition_point(|p| p.stamp_ns < row.stamp_ns);
        let neighbours = [after.checked_sub(1).and_then(|k| poses.get(k)), poses.get(after)];
        let carried = |near: &StampedPose| {
            let posed = self.at(near.stamp_ns).filter(|posed| posed.segment == row.segment)?;
            let near_from_row = posed.matched.inverse() * row.pose;
            let path_m = (posed.path_m - row.travel_m).abs();
            let pose = TruePose { pose: near.pose * near_from_row, frame: near.frame };
            (path_m <= MAX_CARRY_M).then_some((path_m, pose))
        };
        let carried = neighbours.into_iter().flatten().filter_map(carried);
        carried.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, pose)| pose)
    }
}

#[cfg(test)]
mod tests {
    use dataset::{ScanClosure, ScanId};
    use nalgebra::Matrix3;

    use super::*;

    const SECOND: i64 = 1_000_000_000;

    fn at(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad }
    }

    fn trajectory(poses: impl Iterator<Item = (i64, Pose2)>) -> Trajectory {
        Trajectory::new(poses.map(|(stamp_ns, pose)| StampedPose::new(stamp_ns, pose)).collect()).0
    }

    /// A drive of 100 m along x at 1 m/s. The odometry counts 1.1 m per metre; scan matching is exact, in
    /// a frame that starts at the origin. The map has its x axis along the drive's -y axis.
    fn registered() -> (Vec<RegisteredScan>, Trajectory) {
        let rows = (0..500).map(|k: u32| {
            let x_m = 0.2 * f64::from(k);
            RegisteredScan {
                id: ScanId { log: "monday".into(), scan: k },
                stamp_ns: i64::from(k) * SECOND / 5,
                pose: at(x_m, 0.0, 0.0),
                covariance: None,
                odometry: at(1.1 * x_m, 0.0, 0.0),
                near_share: 1.0,
                weakness: None,
                is_degenerate: false,
                is_keyframe: k.is_multiple_of(3),
                segment: 0,
                travel_m: 1.1 * x_m,
            }
        });
        let odometry = (0..1000i64).map(|k| (k * SECOND / 10, at(0.11 * k as f64, 0.0, 0.0)));
        (rows.collect(), trajectory(odometry))
    }

    fn candidate(query: u32, reference: u32) -> CandidateClosure {
        let id = |scan| ScanId { log: "monday".into(), scan };
        let noise = Detector::starting_values().closure;
        let (m2, rad2) = (noise.std_m * noise.std_m, noise.std_rad * noise.std_rad);
        let closure = ScanClosure {
            query: id(query),
            reference: id(reference),
            reference_from_query: at(1.0, 0.0, 0.0),
            covariance: [m2 + 0.25, 0.125, 0.0, m2 + 0.5, 0.0, rad2 + 0.0625],
            confidence: 0.5,
            overlap: 0.75,
            known_overlap: 0.875,
            n_known: 100,
            conflict: 0.125,
            margin: 0.25,
            weakness: 0.5,
            classifier: None,
            is_degenerate: false,
        };
        CandidateClosure { closure, rank: 2 }
    }

    fn evidence_with(truth: &Trajectory, candidates: &[CandidateClosure]) -> LogEvidence {
        let (registered, odometry) = registered();
        let registered = &registered;
        log_evidence(&LogTables {
            log: "monday",
            registered,
            odometry: &odometry,
            truth,
            candidates,
        })
    }

    fn is_near(a: Pose2, b: Pose2) -> bool {
        a.distance_m(&b) < 1e-9 && a.heading_difference_rad(&b) < 1e-9
    }

    /// True poses every 0.05 s, so every 0.055 m of path by odometry: every fourth one is used. Between
    /// two scans, the odometry continues the scan-matched pose: 0.05 s after a scan, by 0.055 m.
    #[test]
    fn dense_truth_gives_a_known_pose_every_0_2_m() {
        let half_turn = |x: f64| at(5.0, -x, -std::f64::consts::FRAC_PI_2);
        let truth = trajectory((0..1900).map(|k| (k * SECOND / 20, half_turn(0.05 * k as f64))));
        let found = evidence_with(&truth, &[candidate(300, 100)]);
        let [first, second, ..] = found.known[..] else { panic!("{}", found.known.len()) };
        assert!((second.path_m - first.path_m - 0.22).abs() < 1e-9);
        assert!((470..=476).contains(&found.known.len()), "{}", found.known.len());
        assert!(found.known.iter().all(|known| known.piece == 0));
        let step = first.matched.inverse() * second.matched;
        assert!(is_near(step, at(0.2, 0.0, 0.0)), "{step:?}");
        // Scan 300 is 40 m ahead of scan 100, whatever the frame of the truth.
        assert!(is_near(found.candidates[0].truth.unwrap(), at(40.0, 0.0, 0.0)));
    }

    #[test]
    fn the_covariance_of_a_candidate_is_that_of_its_alignment() {
        let found = evidence_with(&trajectory(std::iter::empty()), &[candidate(300, 100)]);
        let [found] = &found.candidates[..] else { panic!() };
        let expected = Matrix3::new(0.25, 0.125, 0.0, 0.125, 0.5, 0.0, 0.0, 0.0, 0.0625);
        assert!((found.covariance - expected).norm() < 1e-12);
        assert_eq!((found.rank, found.truth, found.evidence.n_known), (2, None, 100));
    }

    /// One true pose at scan 100 (20 s) and one at scan 300 (60 s), in one frame. Scan 303 is 0.6 m
    /// farther, 0.66 m by odometry; scan 306 is 1.32 m by odometry, which is too far.
    #[test]
    fn sparse_truth_is_carried_over_less_than_a_metre() {
        let truth = trajectory(
            [(20 * SECOND, at(0.0, 0.0, 0.0)), (60 * SECOND, at(0.0, 40.0, 0.0))].into_iter(),
        );
        let candidates = [candidate(300, 100), candidate(303, 100), candidate(306, 100)];
        let found = evidence_with(&truth, &candidates);
        assert!(is_near(found.candidates[0].truth.unwrap(), at(0.0, 40.0, 0.0)));
        assert!(is_near(found.candidates[1].truth.unwrap(), at(0.6, 40.0, 0.0)));
        assert_eq!(found.candidates[2].truth, None);
        assert_eq!(found.known.len(), 2);
    }

    #[test]
    fn two_frames_of_the_truth_are_not_compared() {
        let pose = |k: i64, frame: u32| StampedPose {
            frame,
            segment: frame,
            ..StampedPose::new(k * SECOND, at(k as f64, 0.0, 0.0))
        };
        let truth = Trajectory::new(vec![pose(20, 0), pose(60, 1), pose(61, 1)]).0;
        let found = evidence_with(&truth, &[candidate(300, 100), candidate(305, 300)]);
        assert_eq!(found.candidates[0].truth, None);
        assert!(is_near(found.candidates[1].truth.unwrap(), at(1.0, 0.0, 0.0)));
        let pieces: Vec<u32> = found.known.iter().map(|known| known.piece).collect();
        assert_eq!(pieces, [0, 1, 1]);
    }
}
