//! Nodes: the scans of a few metres of path as points and as a submap; and how well two nodes fit.

use std::sync::Arc;

use dataset::{Pose2, Scan};

use crate::align::{AlignOptions, Alignment, Prior, align};
use crate::drive::Drive;
use crate::points::{Motion, Points, length};
use crate::source::{DriveScan, ScanSource};
use crate::still::StillSquares;
use crate::submap::{Member, Square, Submap, SubmapOptions};
use crate::target::Target;

/// The scans around one keyframe, in the frame of that keyframe.
#[derive(Debug, Clone)]
pub struct Node {
    target: Target,
    /// Some of the points of the target.
    sample: Points,
    submap: Submap,
}

/// A scan of a node, with its points.
#[derive(Debug, Clone, Copy)]
pub struct NodeMember<'a> {
    /// The pose of the scan in the frame of the node.
    pub node_from_scan: Pose2,
    /// The scan.
    pub scan: &'a Scan,
    /// The points of the scan, with normals.
    pub points: &'a Points,
}

/// One point of the target per square of this size \[m\].
const TARGET_VOXEL_M: f64 = 0.08;
/// One point of the sample per square of this size \[m\].
const SAMPLE_VOXEL_M: f64 = 0.2;
/// Points farther from their sensor than this are left out \[m\].
const MAX_RANGE_M: f64 = 20.0;
/// The longest distance of a search in the target \[m\]: the first gate of a verification.
const REACH_M: f64 = 0.8;
/// A point is explained by a target point within this distance and a similar normal \[m\].
const OVERLAP_M: f64 = 0.12;
/// The smallest cosine of the angle between two similar normals: 45 deg.
const OVERLAP_COS: f64 = 0.7;

/// The members as those of a submap.
fn of_submap<'a>(members: &[NodeMember<'a>]) -> Vec<Member<'a>> {
    let member = |m: &NodeMember<'a>| Member { node_from_scan: m.node_from_scan, scan: m.scan };
    members.iter().map(member).collect()
}

impl Node {
    /// Joins scans.
    pub fn new(members: &[NodeMember<'_>], options: &SubmapOptions) -> Self {
        let mut points = Points::default();
        for member in members {
            let mut near = member.points.clone();
            near.retain(|[x, y]| length([x, y]) < MAX_RANGE_M);
            points.extend_from(&member.node_from_scan, &near);
        }
        let points = points.thin(TARGET_VOXEL_M);
        let sample = points.thin(SAMPLE_VOXEL_M);
        Self {
            target: Target::new(points, REACH_M),
            sample,
            submap: Submap::new(&of_submap(members), options),
        }
    }

    /// Joins scans, without the returns of things that move while the scans are taken.
    ///
    /// A return is kept if at least 0.35 of the scans that look at its position see something there: their nearest
    /// return within 3 deg of its direction is at most 0.5 m nearer or farther. A scan does not count if its
    /// return is nearer than that, because it does not see the position. A scan with a full circle and no return in
    /// that direction sees nothing there, up to 10 m.
    pub fn of_still(members: &[NodeMember<'_>], options: &SubmapOptions) -> Self {
        let mut squares = StillSquares::new(&of_submap(members));
        let still: Vec<(Scan, Points)> = members
            .iter()
            .zip(of_submap(members))
            .map(|(member, joined)| {
                (squares.scan(&joined), squares.points(&member.node_from_scan, member.points))
            })
            .collect();
        let of_still: Vec<NodeMember<'_>> = members
            .iter()
            .zip(&still)
            .map(|(member, (scan, points))| NodeMember {
                node_from_scan: member.node_from_scan,
                scan,
                points,
            })
            .collect();
        Self::new(&of_still, options)
    }

    /// The points, for alignments.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Some of the points: one per square of 0.2 m.
    pub fn sample(&self) -> &Points {
        &self.sample
    }

    /// The submap.
    pub fn submap(&self) -> &Submap {
        &self.submap
    }
}

/// How well two nodes fit at a relative pose. The values of both directions (points of one node in the
/// other node) are combined so that the worse one counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fit {
    /// The pose of the second node in the frame of the first, after the alignment.
    pub a_from_b: Pose2,
    /// The alignment of the points of the second node with those of the first.
    pub alignment: Alignment,
    /// Share of the points that the other node explains: a point within 0.12 m, with a similar normal.
    pub overlap: f64,
    /// The same share, over the points in space that the other node knows.
    pub known_overlap: f64,
    /// Number of points in space that the other node knows.
    pub n_known: usize,
    /// Share of the points in space that the other node knows.
    pub known: f64,
    /// Share of the points that are in the free space of the other node.
    pub conflict: f64,
}

impl Fit {
    /// Share of the points in known space that contradict the other node.
    pub fn known_conflict(&self) -> f64 {
        self.conflict / self.known.max(0.05)
    }
}

/// How two nodes are aligned before their fit is measured.
pub fn fit_options(first_gate_m: f64, max_iterations: u32) -> AlignOptions {
    AlignOptions { max_iterations, first_gate_m, last_gate_m: 0.2, ..AlignOptions::default() }
}

/// Aligns the second node with the first one from a start, and measures how well they fit.
pub fn fit(a: &Node, b: &Node, start: &Pose2, options: &AlignOptions) -> Fit {
    let alignment = align(&b.sample, &a.target, start, &Prior::none(*start), options);
    let a_from_b = alignment.target_from_source;
    let [forward, backward] =
        [one_direction(a, b, &a_from_b), one_direction(b, a, &a_from_b.inverse())];
    Fit {
        a_from_b,
        alignment,
        overlap: forward.overlap.min(backward.overlap),
        known_overlap: forward.known_overlap.min(backward.known_overlap),
        n_known: forward.n_known.min(backward.n_known),
        known: forward.known.min(backward.known),
        conflict: forward.conflict.max(backward.conflict),
    }
}

/// The shares of [`Fit`] in one direction.
struct OneDirection {
    overlap: f64,
    known_overlap: f64,
    n_known: usize,
    known: f64,
    conflict: f64,
}

/// Fewer known points than this say nothing about the overlap.
const MIN_KNOWN: usize = 10;

/// How well node `a` explains the points of node `b`.
fn one_direction(a: &Node, b: &Node, a_from_b: &Pose2) -> OneDirection {
    let motion = Motion::new(a_from_b);
    let [mut n_explained, mut n_known, mut n_known_explained, mut n_conflicts] = [0usize; 4];
    for (&q, normal) in b.sample.positions_m.iter().zip(&b.sample.normals) {
        let p = motion.point(q);
        let is_explained = a.target.nearest(p, OVERLAP_M).is_some_and(|partner| {
            match (normal.map(|n| motion.direction(n)), a.target.points().normals[partner]) {
                // Walls are seen from both sides, so the sign of the normal does not count.
                (Some(m), Some(n)) => OVERLAP_COS <= (m[0] * n[0] + m[1] * n[1]).abs(),
                _ => true,
            }
        });
        let is_near_wall = a.submap.is_near_occupied(p);
        let is_free = !is_near_wall && a.submap.at(p) == Square::Free;
        let is_known = is_near_wall || is_free;
        n_explained += usize::from(is_explained);
        n_known += usize::from(is_known);
        n_known_explained += usize::from(is_known && is_explained);
        n_conflicts += usize::from(is_free);
    }
    let share = |n: usize, of: usize| n as f64 / of.max(1) as f64;
    let n = b.sample.len();
    let is_enough = MIN_KNOWN <= n_known;
    OneDirection {
        overlap: share(n_explained, n),
        known_overlap: if is_enough { share(n_known_explained, n_known) } else { 0.0 },
        n_known: if is_enough { n_known } else { 0 },
        known: share(n_known, n),
        conflict: share(n_conflicts, n),
    }
}

/// A scan of a node has this many points.
const MIN_MEMBER_POINTS: usize = 15;

/// Keyframes at least `step_m` of path apart, from the first one on.
pub fn places(drive: &Drive, step_m: f64) -> Vec<usize> {
    let mut places = Vec::new();
    let mut next_m = f64::NEG_INFINITY;
    for (k, &path_m) in drive.path_m.iter().enumerate() {
        if drive.is_keyframe[k] && next_m <= path_m {
            places.push(k);
            next_m = path_m + step_m;
        }
    }
    places
}

/// The scans of a drive up to `half_m` of path before and after a scan, each with its pose in the frame of that
/// scan. Scans with few points are left out: they say little, and their poses are badly known.
fn scans_around(
    drive: &Drive,
    poses: &[Pose2],
    scan: usize,
    half_m: f64,
) -> Vec<(Pose2, Arc<DriveScan>)> {
    let from_m = drive.path_m[scan] - half_m;
    let to_m = drive.path_m[scan] + half_m;
    // The path never becomes shorter.
    let first = drive.path_m.partition_point(|&m| m < from_m);
    let last = drive.path_m.partition_point(|&m| m <= to_m);
    let node_from_map = poses[scan].inverse();
    (first..last)
        .map(|k| (node_from_map * poses[k], drive.scan(k)))
        .filter(|(_, scan)| MIN_MEMBER_POINTS <= scan.points().len())
        .collect()
}

fn members(scans: &[(Pose2, Arc<DriveScan>)]) -> Vec<NodeMember<'_>> {
    scans
        .iter()
        .map(|(node_from_scan, scan)| NodeMember {
            node_from_scan: *node_from_scan,
            scan: scan.scan(),
            points: scan.points(),
        })
        .collect()
}

impl Node {
    /// Joins the scans of a drive up to `half_m` of path before and after a scan, in the frame of that scan. `poses`
    /// are the poses of all scans of the drive. Scans with fewer than 15 points are left out.
    pub fn around(
        drive: &Drive,
        poses: &[Pose2],
        scan: usize,
        half_m: f64,
        options: &SubmapOptions,
    ) -> Self {
        Self::new(&members(&scans_around(drive, poses, scan, half_m)), options)
    }

    /// The same, without the returns of things that move, see [`Node::of_still`].
    pub fn still_around(
        drive: &Drive,
        poses: &[Pose2],
        scan: usize,
        half_m: f64,
        options: &SubmapOptions,
    ) -> Self {
        Self::of_still(&members(&scans_around(drive, poses, scan, half_m)), options)
    }
}
