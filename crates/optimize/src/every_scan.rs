//! A pose for every scan, also those between the scans of the drive.

use dataset::Pose2;
use rayon::prelude::*;
use register::{AlignOptions, Drive, Points, Prior, ScanSource, Target, align};

use crate::guided::NearPoses;

/// The map of a scan consists of the scans of the drive up to this far from it \[m\].
const NEAR_M: f64 = 2.5;
/// The most scans in that map, those with a similar position and heading first.
const MAX_SCANS: usize = 16;
/// A difference of one radian of heading counts as much as this distance \[m\].
const M_PER_RAD: f64 = 1.0;
/// One point per square of this size is aligned \[m\].
const SOURCE_VOXEL_M: f64 = 0.1;
/// Scans with fewer points keep the pose by odometry.
const MIN_POINTS: usize = 20;
/// Standard deviation of the pose carried by odometry from the nearest scans of the drive.
const PRIOR_STD_M: f64 = 0.1;
const PRIOR_STD_DEG: f64 = 6.0;
/// Path that a turn by one radian counts as, between two scans \[m\].
const PATH_PER_RAD: f64 = 0.3;

/// Aligns every scan with the map of the optimized drive. `odometry` is the pose of the lidar at each of `scans`
/// by odometry. `registered` are the ascending indices of the scans of the drive in `scans`; `poses` are
/// their optimized poses. Returns a pose of the lidar for each of `scans`.
///
/// The start and the prior of a scan between two scans of the drive are their poses, carried by the
/// odometry, where the difference at the end is spread over the path.
///
/// # Panics
/// If `poses` and `registered` do not have one entry per scan of the drive, or `odometry` one per scan.
pub fn align_every_scan(
    drive: &Drive,
    poses: &[Pose2],
    registered: &[usize],
    scans: &dyn ScanSource,
    odometry: &[Pose2],
) -> Vec<Pose2> {
    assert!(poses.len() == drive.n_scans() && registered.len() == poses.len());
    assert_eq!(scans.len(), odometry.len(), "one pose per scan");
    let mut every = carried(poses, registered, odometry);
    let near_poses = NearPoses::new(poses, NEAR_M);
    let pieces: Vec<Vec<(usize, Pose2)>> = (0..registered.len())
        .into_par_iter()
        .map(|k| {
            let next = registered.get(k + 1).copied().unwrap_or(scans.len());
            let between = registered[k] + 1..next;
            if between.is_empty() {
                return Vec::new();
            }
            let target = local_map(drive, poses, &near_poses, k);
            let node_from_map = poses[k].inverse();
            between
                .filter_map(|scan| {
                    let points = scans.scan(scan).points().thin(SOURCE_VOXEL_M);
                    let start = node_from_map * every[scan];
                    let pose = aligned(&points, &target, &start)?;
                    Some((scan, poses[k] * pose))
                })
                .collect()
        })
        .collect();
    for (scan, pose) in pieces.into_iter().flatten() {
        every[scan] = pose;
    }
    every
}

/// The points around scan `k` of the drive, in its frame.
fn local_map(drive: &Drive, poses: &[Pose2], near_poses: &NearPoses, k: usize) -> Target {
    let mut near: Vec<(f64, usize)> = near_poses
        .around(&poses[k])
        .filter(|&other| poses[other].distance_m(&poses[k]) <= NEAR_M)
        .map(|other| {
            let turn_rad = poses[other].heading_difference_rad(&poses[k]);
            (poses[other].distance_m(&poses[k]) + M_PER_RAD * turn_rad, other)
        })
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.truncate(MAX_SCANS);
    let mut members: Vec<usize> = near.into_iter().map(|(_, other)| other).collect();
    members.extend([k.saturating_sub(1), k, (k + 1).min(poses.len() - 1)]);
    members.sort_unstable();
    members.dedup();
    let mut points = Points::default();
    for other in members {
        points.extend_from(&(poses[k].inverse() * poses[other]), drive.scan(other).points());
    }
    Target::new(points, OPTIONS_REACH_M)
}

/// The first gate of the alignment \[m\].
const OPTIONS_REACH_M: f64 = 0.3;

fn aligned(points: &Points, target: &Target, start: &Pose2) -> Option<Pose2> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let options = AlignOptions {
        first_gate_m: OPTIONS_REACH_M,
        last_gate_m: 0.15,
        ..AlignOptions::default()
    };
    let prior = Prior::independent(*start, PRIOR_STD_M, PRIOR_STD_M, PRIOR_STD_DEG.to_radians());
    Some(align(points, target, start, &prior, &options).target_from_source)
}

/// The poses of the scans of the drive, carried to all scans by the odometry.
fn carried(poses: &[Pose2], registered: &[usize], odometry: &[Pose2]) -> Vec<Pose2> {
    let mut path = vec![0.0; odometry.len()];
    for k in 1..odometry.len() {
        let (a, b) = (&odometry[k - 1], &odometry[k]);
        let turn = PATH_PER_RAD * a.heading_difference_rad(b);
        path[k] = path[k - 1] + a.distance_m(b) + turn + f64::EPSILON;
    }
    (0..odometry.len())
        .map(|scan| {
            let k = registered.partition_point(|&r| r <= scan).saturating_sub(1);
            let next = (k + 1).min(registered.len() - 1);
            let from = |k: usize| poses[k] * (odometry[registered[k]].inverse() * odometry[scan]);
            let (start, end) = (path[registered[k]], path[registered[next]]);
            let weight = match scan <= registered[k] || end <= start {
                true => 0.0,
                false => ((path[scan] - start) / (end - start)).min(1.0),
            };
            from(k).towards(&from(next), weight)
        })
        .collect()
}
