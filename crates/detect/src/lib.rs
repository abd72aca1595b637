//! `detect`: places that may be the same.

mod descriptor;
mod fft;
mod retrieval;

use dataset::Pose2;
use model::{Detector, Evidence};
use nalgebra::Matrix3;
use register::{Drive, Node};

/// The places of a drive that are compared: keyframes a few metres apart, each with the scans around
/// it.
pub struct Places {
    /// Indices of the keyframes in the drive.
    pub scans: Vec<usize>,
    /// The scans around each, joined.
    pub nodes: Vec<Node>,
}

impl Places {
    /// One place per `step_m` of path, each with the scans up to `half_m` of path before and after it.
    /// The poses of the scans within a node are those of `poses`.
    pub fn new(drive: &Drive<'_>, poses: &[Pose2], step_m: f64, half_m: f64) -> Self {
        let _ = (drive, poses, step_m, half_m);
        todo!()
    }
}

/// Two places that may be the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Index of the later keyframe in the drive.
    pub query: usize,
    /// Index of the earlier keyframe in the drive.
    pub reference: usize,
    /// Pose of the lidar at the query in the frame of the lidar at the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose, in the frame of the reference.
    pub covariance: Matrix3<f64>,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
    /// Rank of the reference among the places that are most similar to the query, from 0.
    pub rank: u32,
}

/// Confidence of the classifier for two keyframes of a drive (indices in the drive).
pub type Classify<'a> = &'a (dyn Fn(usize, usize) -> f64 + Sync);

/// Finds candidates among the places of a drive: for each place, the most similar earlier places at
/// least `min_path_m` of path before it; for each of these, relative poses by correlation, aligned and
/// checked in both directions. At most one candidate per pair of places.
pub fn find_candidates(
    drive: &Drive<'_>,
    places: &Places,
    detector: &Detector,
    min_path_m: f64,
    classify: Option<Classify<'_>>,
) -> Vec<Candidate> {
    let _ = (drive, places, detector, min_path_m, classify);
    todo!()
}
