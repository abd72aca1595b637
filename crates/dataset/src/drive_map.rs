//! What the stages `register`, `detect` and `optimize` exchange: registered scans, closures, and poses
//! in a map.

use crate::{Pose2, ScanId};

/// A scan whose pose was found by scan matching.
#[derive(Debug, Clone, PartialEq)]
pub struct RegisteredScan {
    /// The scan.
    pub id: ScanId,
    /// Time at which the first beam of the scan fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Pose by scan matching, in the frame of the odometry at the start of the segment.
    pub pose: Pose2,
    /// Covariance of x, y and heading relative to the scans of the last metres. The entries are the same
    /// as in [`StampedPose::covariance`](crate::StampedPose::covariance). `None` for the first scan of a
    /// segment.
    pub covariance: Option<[f64; 6]>,
    /// Pose by odometry.
    pub odometry: Pose2,
    /// Share of the points that are near a point of the last metres, 0 to 1.
    pub near_share: f64,
    /// Smallest over largest information about the position, 0 to 1. Near 0 in a bare corridor. `None`
    /// for the first scan of a segment.
    pub weakness: Option<f64>,
    /// Whether the points do not determine the position in one direction.
    pub is_degenerate: bool,
    /// Whether the scan is a keyframe.
    pub is_keyframe: bool,
    /// Number of the continuous piece of the trajectory. See
    /// [`StampedPose::segment`](crate::StampedPose::segment).
    pub segment: u32,
    /// Path length by odometry since the first registered scan of the segment \[m\].
    pub travel_m: f64,
}

/// Two keyframes that may show the same place, with their relative pose.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanClosure {
    /// The later scan.
    pub query: ScanId,
    /// The earlier scan.
    pub reference: ScanId,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose. The entries are the same as in
    /// [`StampedPose::covariance`](crate::StampedPose::covariance).
    pub covariance: [f64; 6],
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
    /// Share of the points that the other place explains, in the direction with the smaller share.
    pub overlap: f64,
    /// The same share, over the points in space that the other place knows.
    pub known_overlap: f64,
    /// Number of points in known space, in the direction with the smaller number.
    pub n_known: u32,
    /// Share of the points in known space that lie in free space of the other place, in the direction
    /// with the larger share.
    pub conflict: f64,
    /// Score of the best pose minus the score of the second-best one.
    pub margin: f64,
    /// Smallest over largest information about the position, 0 to 1.
    pub weakness: f64,
    /// Confidence of the classifier for the two scans, if one was used.
    pub classifier: Option<f64>,
    /// Whether the points do not determine the position in one direction.
    pub is_degenerate: bool,
}

/// A closure that `detect` found.
#[derive(Debug, Clone, PartialEq)]
pub struct CandidateClosure {
    /// The closure.
    pub closure: ScanClosure,
    /// Rank of the reference among the places that are most similar to the query, from 0.
    pub rank: u32,
}

/// A closure that `optimize` accepted or rejected.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedClosure {
    /// The closure.
    pub closure: ScanClosure,
    /// The code of the reason why it was rejected. `None` if it was accepted.
    pub rejected: Option<String>,
}

/// The pose of a keyframe in a map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapPose {
    /// The scan.
    pub id: ScanId,
    /// Time at which the first beam of the scan fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The pose in the frame of the map.
    pub pose: Pose2,
    /// Covariance of x, y and heading relative to the first pose of the map, or, for a map in the frame of
    /// absolute references, in that frame. The entries are the same as
    /// in [`StampedPose::covariance`](crate::StampedPose::covariance).
    pub covariance: Option<[f64; 6]>,
    /// Whether the points do not determine the position in one direction.
    pub is_degenerate: bool,
    /// Number of the continuous piece of the trajectory.
    pub segment: u32,
    /// Path length by odometry since the start of the segment \[m\].
    pub travel_m: f64,
    /// Number of the map in the run, from 0. Poses in different maps have no known relation.
    pub map: u32,
}

/// A measured relative pose of two scans: an edge of a pose graph.
#[derive(Debug, Clone, PartialEq)]
pub struct GraphEdge {
    /// The scan in whose frame the pose is.
    pub reference: ScanId,
    /// The scan whose pose it is.
    pub query: ScanId,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of the query, in the frame of the query. The entries are the same as
    /// in [`StampedPose::covariance`](crate::StampedPose::covariance).
    pub covariance: [f64; 6],
}

impl JudgedClosure {
    /// Whether the closure was accepted.
    pub fn is_accepted(&self) -> bool {
        self.rejected.is_none()
    }
}
