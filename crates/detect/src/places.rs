//! The places of a drive.

use dataset::Pose2;
use rayon::prelude::*;
use register::{Drive, Node, SubmapOptions, places};

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
    ///
    /// A place is a keyframe: the first one of the drive, then each time the first one that is at least
    /// `step_m` of path after the last place.
    pub fn new(drive: &Drive<'_>, poses: &[Pose2], step_m: f64, half_m: f64) -> Self {
        let options = SubmapOptions::default();
        let scans = places(drive, step_m);
        let node = |&at: &usize| Node::around(drive, poses, at, half_m, &options);
        let nodes = scans.par_iter().map(node).collect();
        Self { scans, nodes }
    }

    /// The places of several drives, for [`Drive::joined`]. `starts` are the first scans of the drives.
    ///
    /// # Panics
    /// If there is not one start per drive.
    pub fn joined(places: Vec<Self>, starts: &[usize]) -> Self {
        assert_eq!(places.len(), starts.len(), "one start per drive");
        let mut joined = Self { scans: Vec::new(), nodes: Vec::new() };
        for (of_drive, start) in places.into_iter().zip(starts) {
            joined.scans.extend(of_drive.scans.iter().map(|scan| start + scan));
            joined.nodes.extend(of_drive.nodes);
        }
        joined
    }
}
