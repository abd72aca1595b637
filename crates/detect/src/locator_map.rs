//! The map that a [`Locator`](crate::Locator) searches.

use dataset::Pose2;
use rayon::prelude::*;
use register::{Drive, Node, SubmapOptions, places};

use crate::descriptor::Describer;
use crate::retrieval::Descriptors;

/// A drive of a map.
pub struct MapDrive<'a> {
    /// The registered scans.
    pub drive: &'a Drive,
    /// The pose of each scan in the map.
    pub poses: &'a [Pose2],
    /// Number of the map. Drives with different numbers have unrelated frames.
    pub map: u32,
}

/// The places of one or several maps, ready to be compared with scans. Its size grows with the path of
/// the drives, and does not change while scans are located in it.
pub struct LocatorMap {
    pub(crate) nodes: Vec<Node>,
    /// The pose of each place.
    pub(crate) poses: Vec<Pose2>,
    /// The map of each place.
    pub(crate) maps: Vec<u32>,
    pub(crate) descriptors: Descriptors,
}

/// A place in another direction is this much farther away for each radian \[m\]: a scanner with a limited
/// view sees another part of it.
const TURN_M: f64 = 2.0;

impl LocatorMap {
    /// Makes the places of drives: one per `step_m` of path, each with the scans up to `half_m` before and
    /// after it, as [`Places::new`](crate::Places::new) does, but without what moved while the robot drove past.
    pub fn new(drives: &[MapDrive<'_>], step_m: f64, half_m: f64) -> Self {
        let (mut nodes, mut poses, mut maps) = (Vec::new(), Vec::new(), Vec::new());
        for MapDrive { drive, poses: of_drive, map } in drives {
            let scans = places(drive, step_m);
            let options = SubmapOptions::default();
            let node = |&scan: &usize| Node::still_around(drive, of_drive, scan, half_m, &options);
            poses.extend(scans.iter().map(|&scan| of_drive[scan]));
            maps.extend(scans.iter().map(|_| *map));
            nodes.par_extend(scans.par_iter().map(node));
        }
        let rows: Vec<Vec<f32>> = match nodes.first() {
            Some(first) => {
                let describer = Describer::new(Node::submap(first).n_squares());
                nodes.par_iter().map(|node| describer.describe(node.submap())).collect()
            }
            None => Vec::new(),
        };
        Self { nodes, poses, maps, descriptors: Descriptors::new(&rows) }
    }

    /// Number of places.
    pub fn n_places(&self) -> usize {
        self.nodes.len()
    }

    /// The `n` places of a map that are nearest to a pose, the nearest one first.
    pub(crate) fn nearest(&self, map: u32, pose: &Pose2, within_m: f64, n: usize) -> Vec<usize> {
        let distance_m = |k: usize| {
            pose.distance_m(&self.poses[k]) + TURN_M * pose.heading_difference_rad(&self.poses[k])
        };
        let is_near =
            |k: &usize| self.maps[*k] == map && pose.distance_m(&self.poses[*k]) < within_m;
        let mut near: Vec<usize> = (0..self.nodes.len()).filter(is_near).collect();
        near.sort_by(|&a, &b| distance_m(a).total_cmp(&distance_m(b)));
        near.truncate(n);
        near
    }
}
