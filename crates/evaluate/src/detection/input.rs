//! What the stages `register`, `detect` and `optimize` found, as plain values.

use dataset::{Pose2, Trajectory};

/// A drive: one continuous piece of the trajectory of a log. Poses are those of the robot.
#[derive(Debug, Clone, Copy)]
pub struct Drive<'a> {
    /// Name of the log.
    pub log: &'a str,
    /// Number of the piece. See [`dataset::StampedPose::segment`].
    pub segment: u32,
    /// Number of the map that the drive lies in. `None` without keyframes.
    pub map: Option<u32>,
    /// The keyframes, with ascending stamps.
    pub keyframes: &'a [KeyframePoses],
    /// All scans, with ascending stamps.
    pub scans: &'a [ScanPoses],
    /// What `detect` proposes.
    pub candidates: &'a [FoundCandidate],
    /// What `optimize` accepts and rejects.
    pub closures: &'a [FoundClosure<'a>],
    /// The ground truth of the log, if it is known.
    pub truth: Option<&'a Trajectory>,
    /// Pose of the lidar on the robot.
    pub base_from_lidar: Pose2,
}

/// A keyframe and where each stage says the robot was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeyframePoses {
    /// Number of the scan in its log.
    pub scan: u32,
    /// Time of the scan \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Path length by odometry since the start of the drive \[m\].
    pub path_m: f64,
    /// Pose by odometry.
    pub odometry: Pose2,
    /// Pose by scan matching.
    pub scan_matched: Pose2,
    /// Pose after the optimization.
    pub optimized: Pose2,
    /// Covariance of the optimized pose relative to the first keyframe, in the frame of the map, with
    /// the entries of [`dataset::StampedPose::covariance`].
    pub covariance: Option<[f64; 6]>,
}

/// A scan and where each stage says the robot was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScanPoses {
    /// Time of the scan \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Pose by odometry.
    pub odometry: Pose2,
    /// Pose by scan matching, if the scan was registered.
    pub scan_matched: Option<Pose2>,
    /// Pose after the alignment with the map.
    pub optimized: Pose2,
}

/// A relative pose that `detect` proposes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundCandidate {
    /// Index of the later keyframe in [`Drive::keyframes`].
    pub query: usize,
    /// Index of the earlier keyframe in [`Drive::keyframes`].
    pub reference: usize,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
}

/// A closure that `optimize` accepted or rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundClosure<'a> {
    /// Index of the later keyframe in [`Drive::keyframes`].
    pub query: usize,
    /// Index of the earlier keyframe in [`Drive::keyframes`].
    pub reference: usize,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose, with the entries of
    /// [`dataset::StampedPose::covariance`].
    pub covariance: [f64; 6],
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
    /// The code of the reason for which it was rejected; `None` if it was accepted.
    pub rejected: Option<&'a str>,
    /// What speaks for and against it.
    pub evidence: Evidence,
}

/// What speaks for and against a closure. `docs/detection.md` explains the values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Evidence {
    /// Share of the points that the other submap explains.
    pub overlap: f64,
    /// The same, over the points in space that the other submap knows.
    pub known_overlap: f64,
    /// Share of the points in the free space of the other submap.
    pub conflict: f64,
    /// Score of the best minus score of the second-best pose by correlation.
    pub margin: f64,
    /// Confidence of the classifier for the two scans, if one was used.
    pub classifier: Option<f64>,
    /// Whether the points determine the position badly in one direction.
    pub is_degenerate: bool,
}
