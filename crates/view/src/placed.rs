use dataset::{Pose2, Scan};

/// A scan with its pose in a map.
#[derive(Debug, Clone, Copy)]
pub struct PlacedScan<'a> {
    /// Time of the scan \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Pose of the lidar in the map.
    pub pose: Pose2,
    /// The scan.
    pub scan: &'a Scan,
}
