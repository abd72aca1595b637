//! Where scans lie in a map.

use crate::{Pose2, ScanId};

/// What `locate` knows about the position of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LocatedState {
    /// There was no position yet.
    Searching,
    /// The position is known.
    Located,
    /// There was a position, but the scans stopped confirming it. The search has begun again.
    Lost,
}

impl LocatedState {
    /// All states.
    pub const ALL: [Self; 3] = [Self::Searching, Self::Located, Self::Lost];

    /// The name in the table.
    pub fn name(self) -> &'static str {
        match self {
            Self::Searching => "searching",
            Self::Located => "located",
            Self::Lost => "lost",
        }
    }
}

/// A pose in a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocatedPose {
    /// Number of the map in its run.
    pub map: u32,
    /// Pose of the lidar in the frame of the map.
    pub pose: Pose2,
    /// Covariance of x, y and heading: xx, xy, xh, yy, yh, hh. Errors of the map are not in it.
    pub covariance: [f64; 6],
    /// Confidence that the last alignment with the map is right, 0 to 1.
    pub confidence: f64,
}

/// A scan, and where it lies in a map.
#[derive(Debug, Clone, PartialEq)]
pub struct LocatedScan {
    /// The scan.
    pub id: ScanId,
    /// Time at which the first beam of the scan fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Path since the first scan of the log, by scan matching \[m\].
    pub travel_m: f64,
    /// What is known.
    pub state: LocatedState,
    /// The pose, while the state is [`LocatedState::Located`].
    pub position: Option<LocatedPose>,
}
