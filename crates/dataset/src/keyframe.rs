use std::sync::Arc;

use crate::Pose2;

/// Names one scan of a run: the log's file stem and the scan's row in `scans/<log>.parquet`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScanId {
    /// File stem of the log.
    pub log: Arc<str>,
    /// Number of the scan in its log, from 0.
    pub scan: u32,
}

/// A scan that is kept because the robot has moved on since the last one kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Which scan.
    pub id: ScanId,
    /// The map frame that the pose is in; logs of one site share it.
    pub site: Arc<str>,
    /// When the scan's first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Where the robot was then.
    pub pose: Pose2,
    /// How well that is known, where the poses tell, as in
    /// [`StampedPose`](crate::StampedPose::covariance).
    pub covariance: Option<[f64; 6]>,
    /// Sum of the straight-line distances between the keyframes of this log so far \[m\].
    pub travel_m: f64,
    /// Angle swept by the scan \[deg\].
    pub coverage_deg: f32,
}
