//! The places of a drive.

use dataset::{Pose2, Scan};
use rayon::prelude::*;
use register::{Drive, Node, NodeMember, SubmapOptions};

/// The places of a drive that are compared: keyframes a few metres apart, each with the scans around
/// it.
pub struct Places {
    /// Indices of the keyframes in the drive.
    pub scans: Vec<usize>,
    /// The scans around each, joined.
    pub nodes: Vec<Node>,
}

/// A scan with fewer returns than this near the sensor takes no part in a node. It says little, and its
/// pose is badly known.
const MIN_RETURNS: usize = 15;

impl Places {
    /// One place per `step_m` of path, each with the scans up to `half_m` of path before and after it.
    /// The poses of the scans within a node are those of `poses`.
    ///
    /// A place is a keyframe: the first one of the drive, then each time the first one that is at least
    /// `step_m` of path after the last place.
    pub fn new(drive: &Drive<'_>, poses: &[Pose2], step_m: f64, half_m: f64) -> Self {
        let options = SubmapOptions::default();
        let is_useful: Vec<bool> =
            drive.scans.iter().map(|scan| is_useful(scan, options.max_range_m)).collect();
        let scans = choose(drive, step_m);
        let node = |&at: &usize| {
            let path_m = drive.path_m[at];
            let from = drive.path_m.partition_point(|&p| p < path_m - half_m);
            let to = drive.path_m.partition_point(|&p| p <= path_m + half_m);
            let node_from_map = poses[at].inverse();
            let member = |k: usize| NodeMember {
                node_from_scan: node_from_map * poses[k],
                scan: drive.scans[k],
                points: &drive.points[k],
            };
            let members: Vec<NodeMember<'_>> =
                (from..to).filter(|&k| is_useful[k]).map(member).collect();
            Node::new(&members, &options)
        };
        let nodes = scans.par_iter().map(node).collect();
        Self { scans, nodes }
    }
}

fn is_useful(scan: &Scan, max_range_m: f64) -> bool {
    let is_near = |p: &[f64; 2]| libm::hypot(p[0], p[1]) < max_range_m;
    MIN_RETURNS <= scan.points().filter(is_near).count()
}

fn choose(drive: &Drive<'_>, step_m: f64) -> Vec<usize> {
    let mut chosen = Vec::new();
    let mut next_m = f64::NEG_INFINITY;
    for (k, &path_m) in drive.path_m.iter().enumerate() {
        if drive.is_keyframe[k] && next_m <= path_m {
            chosen.push(k);
            next_m = path_m + step_m;
        }
    }
    chosen
}
