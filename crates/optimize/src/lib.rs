//! `optimize`: the poses of a drive and its loop closures, estimated together.

use dataset::{Pose2, RangeLimits};
use model::{Detector, Evidence};
use nalgebra::Matrix3;
use register::{Drive, OdometryScan};

/// A possible closure between two scans of a drive, as `detect` finds it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proposal {
    /// Index of the later scan in the drive.
    pub query: usize,
    /// Index of the earlier scan in the drive.
    pub reference: usize,
    /// Pose of the lidar at the query in the frame of the lidar at the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose.
    pub covariance: Matrix3<f64>,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
}

/// Why a closure was rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Reason {
    /// Its confidence is too low.
    LowConfidence,
    /// It contradicts the odometry and the closures that were kept.
    Inconsistent,
    /// Too few of the pairs of places that it predicts to be the same are confirmed by their scans.
    Unsupported,
    /// Its scans do not confirm the relative pose that the map predicts.
    NotConfirmed,
}

impl Reason {
    /// The code in `closures.parquet`.
    pub fn code(self) -> &'static str {
        match self {
            Self::LowConfidence => "low_confidence",
            Self::Inconsistent => "inconsistent",
            Self::Unsupported => "unsupported",
            Self::NotConfirmed => "not_confirmed",
        }
    }
}

/// A closure, accepted or rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Closure {
    /// The closure.
    pub proposal: Proposal,
    /// Why it was rejected; `None` if it was accepted.
    pub rejected: Option<Reason>,
}

/// An edge of the pose graph, between two scans of the drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Edge {
    /// Index of the first scan (of the vertex, in a [`Solver`](crate)).
    pub a: usize,
    /// Index of the second scan.
    pub b: usize,
    /// The second pose in the frame of the first, as measured.
    pub a_from_b: Pose2,
    /// Inverse covariance of x, y and heading of the measurement, in its own frame, `(3, 3)`.
    pub information: Matrix3<f64>,
}

/// A drive with its closures.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Accepted and rejected closures, ordered by query and reference.
    pub closures: Vec<Closure>,
    /// Optimized pose of the lidar at each scan of the drive.
    pub poses: Vec<Pose2>,
    /// Covariance of x, y and heading of each pose relative to the first one, in the frame of the map.
    pub covariances: Vec<Matrix3<f64>>,
    /// The pose graph of the accepted closures. Its vertices are scans of the drive.
    pub edges: Vec<Edge>,
    /// What happened, for the report.
    pub rounds: Vec<Round>,
}

/// A round of the optimization.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// Closures offered to the pose graph.
    pub n_offered: usize,
    /// Closures that it kept.
    pub n_kept: usize,
    /// Pairs of places that its poses predict to be the same.
    pub n_predicted: usize,
    /// Those that their scans confirm.
    pub n_confirmed: usize,
}

/// Chooses the closures of a drive and optimizes its poses. Without an accepted closure, the poses are
/// those of the drive.
pub fn close_loops(
    drive: &Drive<'_>,
    proposals: &[Proposal],
    detector: &Detector,
    min_path_m: f64,
) -> Solution {
    let _ = (drive, proposals, detector, min_path_m);
    todo!()
}

/// Aligns every scan with the map of the optimized drive. `registered` are the indices of the scans of
/// the drive in `scans`. Returns a pose for each of `scans`.
pub fn align_every_scan(
    drive: &Drive<'_>,
    poses: &[Pose2],
    registered: &[usize],
    scans: &[OdometryScan<'_>],
    limits: RangeLimits,
) -> Vec<Pose2> {
    let _ = (drive, poses, registered, scans, limits);
    todo!()
}
