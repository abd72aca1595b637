//! What is trusted when a finished map is moved: the shape of its drives and its closures.

use dataset::Pose2;
use model::Detector;
use register::Drive;

use crate::graph::Edge;
use crate::places::chain;
use crate::support::Link;

/// The edges within a map: the shape of each drive, and the closures. Vertex 0 is another frame, and the
/// others are the `scans`, ascending. `joined` are pairs of scans that closures join. Those of other
/// drives than the ones of `scans` are left out.
pub(crate) fn trusted(
    drive: &Drive,
    poses: &[Pose2],
    scans: &[usize],
    joined: &[[usize; 2]],
    detector: &Detector,
) -> Vec<Edge> {
    let mut edges = chain(drive, poses, scans, &detector.drift);
    let nearest = |scan: usize| nearest_scan(drive, scans, scan);
    let mut pairs: Vec<[usize; 2]> = joined
        .iter()
        .filter_map(|&[reference, query]| Some([nearest(reference)?, nearest(query)?]))
        .filter(|[reference, query]| reference != query)
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    edges.extend(pairs.into_iter().map(|[reference, query]| {
        let [a, b] = [reference, query].map(|k| poses[scans[k]]);
        let link = Link { reference, query, reference_from_query: a.inverse() * b };
        link.edge(&detector.closure)
    }));
    for edge in &mut edges {
        (edge.a, edge.b) = (edge.a + 1, edge.b + 1);
    }
    edges
}

/// The position in `scans` of the one that is nearest along the drive of a scan; `None` if none of them is
/// of this drive.
pub(crate) fn nearest_scan(drive: &Drive, scans: &[usize], scan: usize) -> Option<usize> {
    let part = drive.part_of(scan);
    let of_part = |k: &usize| drive.part_of(scans[*k]) == part;
    let next = scans.partition_point(|&other| other < scan);
    let near = [next.checked_sub(1), Some(next).filter(|&next| next < scans.len())];
    near.into_iter().flatten().filter(of_part).min_by_key(|&k| scans[k].abs_diff(scan))
}
