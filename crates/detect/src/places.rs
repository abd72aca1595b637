//! The places of a drive.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use dataset::Pose2;
use register::{Drive, Kept, Node, Submap, SubmapOptions, places};

/// The most nodes that are kept. Each needs about 0.5 MB.
const MAX_KEPT: usize = 512;
/// Nodes that are made at once.
const AT_ONCE: usize = 64;

/// The places of a drive that are compared: keyframes a few metres apart, each with the scans around
/// it.
pub struct Places<'a> {
    drive: &'a Drive,
    /// The poses of all scans of the drive.
    poses: Vec<Pose2>,
    half_m: f64,
    /// Indices of the keyframes in the drive.
    pub scans: Vec<usize>,
    /// The submap of each.
    pub submaps: Vec<Submap>,
    /// The nodes of a long drive do not fit into memory.
    nodes: Kept<Node>,
}

impl<'a> Places<'a> {
    /// One place per `step_m` of path, each with the scans up to `half_m` of path before and after it.
    /// The poses of the scans within a node are those of `poses`.
    ///
    /// A place is a keyframe: the first one of the drive, then each time the first one that is at least
    /// `step_m` of path after the last place.
    pub fn new(drive: &'a Drive, poses: &[Pose2], step_m: f64, half_m: f64) -> Self {
        Self::at(drive, poses, places(drive, step_m), half_m)
    }

    /// A place at each of some scans, see [`Places::new`].
    pub fn at(drive: &'a Drive, poses: &[Pose2], scans: Vec<usize>, half_m: f64) -> Self {
        let (poses, nodes) = (poses.to_vec(), Kept::new(MAX_KEPT));
        let mut places = Self { drive, poses, half_m, scans, submaps: Vec::new(), nodes };
        for first in (0..places.scans.len()).step_by(AT_ONCE) {
            let block = first..(first + AT_ONCE).min(places.scans.len());
            let nodes = places.nodes(&block.collect());
            places.submaps.extend(nodes.values().map(|node| node.submap().clone()));
        }
        places
    }

    /// The places of several drives. `drive` is [`Drive::joined`] of their drives, in the same order.
    ///
    /// # Panics
    /// If the drive does not have one start per part.
    pub fn joined(drive: &'a Drive, parts: Vec<PlacesOfDrive>) -> Self {
        assert_eq!(parts.len(), drive.starts.len(), "one start per drive");
        let mut joined = Self {
            drive,
            poses: Vec::new(),
            half_m: parts.first().map_or(0.0, |part| part.half_m),
            scans: Vec::new(),
            submaps: Vec::new(),
            nodes: Kept::new(MAX_KEPT),
        };
        for (part, start) in parts.into_iter().zip(&drive.starts) {
            joined.poses.extend(part.poses);
            joined.scans.extend(part.scans.iter().map(|scan| start + scan));
            joined.submaps.extend(part.submaps);
        }
        joined
    }

    /// The places without their drive, for [`Places::joined`].
    pub fn into_part(self) -> PlacesOfDrive {
        let Self { poses, half_m, scans, submaps, .. } = self;
        PlacesOfDrive { poses, half_m, scans, submaps }
    }

    /// The scans around some of the places, joined.
    pub(crate) fn nodes(&self, wanted: &BTreeSet<usize>) -> BTreeMap<usize, Arc<Node>> {
        let options = SubmapOptions::default();
        self.nodes.get(wanted, |place| {
            Node::around(self.drive, &self.poses, self.scans[place], self.half_m, &options)
        })
    }
}

/// The places of one of several drives.
pub struct PlacesOfDrive {
    poses: Vec<Pose2>,
    half_m: f64,
    scans: Vec<usize>,
    submaps: Vec<Submap>,
}
