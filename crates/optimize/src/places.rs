//! The vertices of the pose graph: places along a drive, with their submaps.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use dataset::Pose2;
use model::Drift;
use register::{BlurredMap, Drive, Kept, Node, Points, SubmapOptions};

use crate::graph::Edge;

/// A place joins the scans up to this far along the path before and after it \[m\].
const HALF_M: f64 = 5.0;
/// A square of the blurred walls of a node \[m\], and their standard deviation \[m\].
const MAP_SQUARE_M: f64 = 0.1;
const MAP_BLUR_M: f64 = 0.15;

/// What comparisons with other places need.
pub(crate) struct Place {
    pub(crate) node: Node,
    pub(crate) walls: BlurredMap,
    /// Some points of the sample of the node, for searches.
    pub(crate) few_points: Points,
}

/// One of the points for searches per square of this size \[m\]. A search gives only the start of an alignment.
const SEARCH_VOXEL_M: f64 = 0.5;

/// The most places that are kept. Each needs about 1 MB.
const MAX_KEPT: usize = 256;

/// Places along drives. Each joins the scans around it, rigidly.
pub(crate) struct Places<'a> {
    drive: &'a Drive,
    /// The poses of all scans.
    poses: Vec<Pose2>,
    /// The scan of each place, ascending.
    pub(crate) scans: Vec<usize>,
    /// Path length at each place \[m\].
    pub(crate) path_m: Vec<f64>,
    /// Places are made when they are compared, because those of a long drive do not fit into the memory.
    kept: Kept<Place>,
}

impl<'a> Places<'a> {
    pub(crate) fn new(drive: &'a Drive, poses: &[Pose2], scans: Vec<usize>) -> Self {
        let path_m = scans.iter().map(|&scan| drive.path_m[scan]).collect();
        Self { drive, poses: poses.to_vec(), scans, path_m, kept: Kept::new(MAX_KEPT) }
    }

    /// Number of places.
    pub(crate) fn n(&self) -> usize {
        self.scans.len()
    }

    /// The pose of a place.
    pub(crate) fn pose(&self, place: usize) -> Pose2 {
        self.poses[self.scans[place]]
    }

    /// The place of a scan.
    pub(crate) fn of_scan(&self, scan: usize) -> Option<usize> {
        self.scans.binary_search(&scan).ok()
    }

    /// Some of the places.
    pub(crate) fn get(&self, wanted: &BTreeSet<usize>) -> BTreeMap<usize, Arc<Place>> {
        self.kept.get(wanted, |place| self.make(place))
    }

    fn make(&self, place: usize) -> Place {
        let options = SubmapOptions::default();
        let node = Node::around(self.drive, &self.poses, self.scans[place], HALF_M, &options);
        let walls = BlurredMap::new(node.target().points(), MAP_SQUARE_M, MAP_BLUR_M);
        let few_points = node.sample().thin(SEARCH_VOXEL_M);
        Place { node, walls, few_points }
    }
}

/// Path that counts for the drift between two places at least \[m\].
const MIN_STEP_M: f64 = 0.2;

/// The edges between consecutive places of a drive: relative poses by scan matching, with errors that grow
/// with the square root of the path. `poses` are those of all scans.
pub(crate) fn chain(drive: &Drive, poses: &[Pose2], scans: &[usize], drift: &Drift) -> Vec<Edge> {
    let edge = |(k, pair): (usize, &[usize])| {
        let [from, to] = [pair[0], pair[1]];
        if drive.part_of(from) != drive.part_of(to) {
            return None;
        }
        let step = poses[from].inverse() * poses[to];
        let root = (drive.path_m[to] - drive.path_m[from]).max(MIN_STEP_M).sqrt();
        let (std_m, std_rad) = (drift.std_m_per_sqrt_m * root, drift.std_rad_per_sqrt_m * root);
        Some(Edge::independent(k, k + 1, step, std_m, std_rad))
    };
    scans.windows(2).enumerate().filter_map(edge).collect()
}

/// Carries the poses of places to all scans of their drives: each scan keeps its relative pose to the place
/// before and to the place after it, weighted by its position between them. Scans of drives without a
/// place stay.
///
/// `before` are the poses of all scans, `places` the ascending indices of the places, and `after` their
/// new poses.
pub(crate) fn carry(
    drive: &Drive,
    before: &[Pose2],
    places: &[usize],
    after: &[Pose2],
) -> Vec<Pose2> {
    let carried = |scan: usize, of_part: Range<usize>| {
        let from = |k: usize| after[k] * (before[places[k]].inverse() * before[scan]);
        let next = places.partition_point(|&place| place <= scan);
        let last = next.checked_sub(1).filter(|last| of_part.contains(last));
        match (last, Some(next).filter(|next| of_part.contains(next))) {
            (Some(last), Some(next)) => {
                let weight = (scan - places[last]) as f64 / (places[next] - places[last]) as f64;
                from(last).towards(&from(next), weight)
            }
            (Some(one), None) | (None, Some(one)) => from(one),
            (None, None) => before[scan],
        }
    };
    let mut poses = Vec::with_capacity(before.len());
    for part in drive.parts() {
        let at = |scan: usize| places.partition_point(|&place| place < scan);
        let of_part = at(part.start)..at(part.end);
        poses.extend(part.map(|scan| carried(scan, of_part.clone())));
    }
    poses
}
