use std::sync::Arc;

use crate::Pose2;

/// Identifies one scan of a run: the file stem of the log and the row in `scans/<log>.parquet`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ScanId {
    /// File stem of the log.
    pub log: Arc<str>,
    /// Number of the scan in its log, from 0.
    pub scan: u32,
}

/// A scan that is kept because the robot has moved since the previous keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// The scan.
    pub id: ScanId,
    /// Name of the map frame of the pose. Logs of the same site share this frame.
    pub site: Arc<str>,
    /// Time at which the first beam of the scan fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Pose of the robot at that time.
    pub pose: Pose2,
    /// Covariance of the pose, if it is known. The entries are the same as in
    /// [`StampedPose::covariance`](crate::StampedPose::covariance).
    pub covariance: Option<[f64; 6]>,
    /// Height, if the source of the poses measures it \[m\].
    pub z_m: Option<f64>,
    /// Number of the continuous piece of the trajectory of the log. See
    /// [`StampedPose::segment`](crate::StampedPose::segment).
    pub segment: u32,
    /// Number of the coordinate frame within the log. See
    /// [`StampedPose::frame`](crate::StampedPose::frame).
    pub frame: u32,
    /// Number of the map that the pose is in, if the poses are those of a finished run. Keyframes with the
    /// same number share a frame, whatever their site; the others do not.
    pub map: Option<u32>,
    /// Distance driven since the first keyframe of this log: the sum of the straight-line distances
    /// between consecutive keyframes \[m\].
    pub travel_m: f64,
    /// Angle covered by the scan \[deg\].
    pub coverage_deg: f32,
}
