//! The vertices of the pose graph: places along a drive, with their submaps.

use std::ops::Range;

use dataset::Pose2;
use model::Drift;
use rayon::prelude::*;
use register::{BlurredMap, Drive, Node, SubmapOptions};

use crate::graph::Edge;

/// A square of the blurred walls of a node \[m\], and their standard deviation \[m\].
const MAP_SQUARE_M: f64 = 0.1;
const MAP_BLUR_M: f64 = 0.15;

/// A place with what comparisons with other places need.
pub(crate) struct Place {
    pub(crate) path_m: f64,
    pub(crate) node: Node,
    pub(crate) walls: BlurredMap,
}

/// Joins the scans around each of `scans`. Each submap is rigid, with the poses `poses`.
pub(crate) fn make_places(
    drive: &Drive<'_>,
    poses: &[Pose2],
    scans: &[usize],
    half_m: f64,
) -> Vec<Place> {
    let options = SubmapOptions::default();
    let place = |&scan: &usize| {
        let node = Node::around(drive, poses, scan, half_m, &options);
        let walls = BlurredMap::new(node.target().points(), MAP_SQUARE_M, MAP_BLUR_M);
        Place { path_m: drive.path_m[scan], node, walls }
    };
    scans.par_iter().map(place).collect()
}

/// Path that counts for the drift between two places at least \[m\].
const MIN_STEP_M: f64 = 0.2;

/// The edges between consecutive places of a drive: relative poses by scan matching, with errors that grow
/// with the square root of the path. `poses` are those of all scans.
pub(crate) fn chain(
    drive: &Drive<'_>,
    poses: &[Pose2],
    scans: &[usize],
    drift: &Drift,
) -> Vec<Edge> {
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
    drive: &Drive<'_>,
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
