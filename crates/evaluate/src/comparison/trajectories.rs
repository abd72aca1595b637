//! How far the optimized poses of scans differ between two runs.

use std::collections::BTreeMap;

use dataset::{MapPose, Pose2, StampedPose, quantile};
use serde::Serialize;

use super::input::{MappedRun, Tolerances};
use crate::detection::align;

/// The scans of one or more logs that lie in the same map in A, and in the same map in B. The frames of
/// the two maps are arbitrary, so the poses of B are aligned with those of A first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedTrajectory {
    /// The logs. If a map contains several logs, there is an entry for each log and one for all of them.
    pub logs: Vec<String>,
    /// Number of the map in A.
    pub map_a: u32,
    /// Number of the map in B.
    pub map_b: u32,
    /// Scans of both runs, by their stamps.
    pub n_scans: usize,
    /// Transform from the map of B to the map of A: the least squares of the distances between the
    /// positions.
    pub a_from_b: Transform,
    /// Root mean square of the distances between the positions \[m\].
    pub rmse_m: f64,
    /// Median of the distances \[m\].
    pub median_m: f64,
    /// Largest distance \[m\].
    pub max_m: f64,
    /// Median of the angles between the headings \[deg\].
    pub median_deg: f64,
    /// Largest angle \[deg\].
    pub max_deg: f64,
    /// The scan with the largest distance.
    pub farthest: FarthestScan,
}

/// A rigid transform in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Transform {
    /// Shift along x \[m\].
    pub x_m: f64,
    /// Shift along y \[m\].
    pub y_m: f64,
    /// Turn to the left \[rad\].
    pub heading_rad: f64,
}

/// Where two trajectories differ most.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FarthestScan {
    /// The log.
    pub log: String,
    /// Time of the scan \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The last keyframe of A up to this scan, by its number; the first keyframe if there is none.
    pub keyframe: u32,
    /// Path length by odometry at this keyframe, since the start of its segment \[m\].
    pub travel_m: f64,
    /// Position in the map of A \[m\].
    pub x_m: f64,
    /// Position in the map of A \[m\].
    pub y_m: f64,
}

impl ComparedTrajectory {
    /// Whether a scan moved or turned by more than the tolerance.
    pub fn is_beyond(&self, tolerances: &Tolerances) -> bool {
        tolerances.max_shift_m < self.max_m || tolerances.max_turn_deg < self.max_deg
    }

    /// The transform from the map of B to the map of A.
    pub(crate) fn alignment(&self) -> Pose2 {
        let Transform { x_m, y_m, heading_rad } = self.a_from_b;
        Pose2 { x_m, y_m, heading_rad }
    }
}

/// A scan of both runs.
#[derive(Clone, Copy)]
struct BothPoses {
    stamp_ns: i64,
    a: Pose2,
    b: Pose2,
}

/// The scans of a log by the maps of A and B that they lie in.
type OfMaps<'a> = BTreeMap<(u32, u32), BTreeMap<&'a str, Vec<BothPoses>>>;

/// Compares the trajectories of the logs of both runs.
pub(super) fn trajectories(a: &MappedRun<'_>, b: &MappedRun<'_>) -> Vec<ComparedTrajectory> {
    let (maps_a, maps_b) = (maps(a), maps(b));
    let mut of_maps: OfMaps<'_> = BTreeMap::new();
    for (log, trajectory_a) in a.trajectories {
        let Some(trajectory_b) = b.trajectories.get(log) else { continue };
        for (pose_a, pose_b) in common(trajectory_a.poses(), trajectory_b.poses()) {
            let map_a = maps_a.get(&(&**log, pose_a.segment));
            let map_b = maps_b.get(&(&**log, pose_b.segment));
            if let (Some(&map_a), Some(&map_b)) = (map_a, map_b) {
                let both = BothPoses { stamp_ns: pose_a.stamp_ns, a: pose_a.pose, b: pose_b.pose };
                of_maps.entry((map_a, map_b)).or_default().entry(log).or_default().push(both);
            }
        }
    }
    let mut compared = Vec::new();
    for ((map_a, map_b), logs) in &of_maps {
        let each = logs.iter().map(|(log, scans)| vec![(*log, &scans[..])]);
        let all = logs.iter().map(|(log, scans)| (*log, &scans[..])).collect();
        let groups = each.chain((1 < logs.len()).then_some(all));
        compared.extend(groups.filter_map(|group| of_group(&group, [*map_a, *map_b], a.keyframes)));
    }
    compared
}

/// The map of each segment of each log.
fn maps<'a>(run: &MappedRun<'a>) -> BTreeMap<(&'a str, u32), u32> {
    run.keyframes.iter().map(|k: &MapPose| ((&*k.id.log, k.segment), k.map)).collect()
}

/// The poses with the same stamps. Both slices have ascending stamps.
fn common<'a>(
    a: &'a [StampedPose],
    b: &'a [StampedPose],
) -> impl Iterator<Item = (&'a StampedPose, &'a StampedPose)> {
    let mut later_b = b.iter().peekable();
    a.iter().filter_map(move |pose_a| {
        while later_b.next_if(|pose_b| pose_b.stamp_ns < pose_a.stamp_ns).is_some() {}
        Some((pose_a, later_b.next_if(|pose_b| pose_b.stamp_ns == pose_a.stamp_ns)?))
    })
}

/// `None` without scans.
fn of_group(
    logs: &[(&str, &[BothPoses])],
    [map_a, map_b]: [u32; 2],
    keyframes_a: &[MapPose],
) -> Option<ComparedTrajectory> {
    let scans: Vec<BothPoses> = logs.iter().flat_map(|(_, scans)| *scans).copied().collect();
    let a_from_b = alignment(&scans)?;
    let aligned = |scan: &BothPoses| a_from_b * scan.b;
    let distance_m = |scan: &BothPoses| aligned(scan).distance_m(&scan.a);
    let sorted = |of: &dyn Fn(&BothPoses) -> f64| {
        let mut values: Vec<f64> = scans.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let metres = sorted(&distance_m);
    let degrees = sorted(&|scan| aligned(scan).heading_difference_rad(&scan.a).to_degrees());
    let of_logs = logs.iter().flat_map(|(log, scans)| scans.iter().map(move |scan| (*log, scan)));
    let (log, farthest) = of_logs
        .reduce(|best, next| if distance_m(best.1) < distance_m(next.1) { next } else { best })?;
    let n = scans.len() as f64;
    Some(ComparedTrajectory {
        logs: logs.iter().map(|(log, _)| (*log).to_owned()).collect(),
        map_a,
        map_b,
        n_scans: scans.len(),
        a_from_b: Transform {
            x_m: a_from_b.x_m,
            y_m: a_from_b.y_m,
            heading_rad: a_from_b.heading_rad,
        },
        rmse_m: (metres.iter().map(|m| m * m).sum::<f64>() / n).sqrt(),
        median_m: quantile(&metres, 0.5),
        max_m: *metres.last()?,
        median_deg: quantile(&degrees, 0.5),
        max_deg: *degrees.last()?,
        farthest: place(log, farthest, keyframes_a)?,
    })
}

/// The transform from the map of B to the map of A. Equal poses need none: the identity has no rounding
/// errors. If all positions are equal, the first poses are laid over each other. `None` without scans.
fn alignment(scans: &[BothPoses]) -> Option<Pose2> {
    if scans.iter().all(|scan| scan.a == scan.b) {
        return scans.first().map(|_| Pose2::default());
    }
    let [a, b]: [Vec<Pose2>; 2] =
        [scans.iter().map(|scan| scan.a).collect(), scans.iter().map(|scan| scan.b).collect()];
    match align(&a, &b) {
        Some(found) => Some(found.truth_from_estimate),
        None => Some(*a.first()? * b.first()?.inverse()),
    }
}

fn place(log: &str, scan: &BothPoses, keyframes: &[MapPose]) -> Option<FarthestScan> {
    let of_log = || keyframes.iter().filter(|keyframe| *keyframe.id.log == *log);
    let before = of_log().filter(|keyframe| keyframe.stamp_ns <= scan.stamp_ns);
    let keyframe = before.max_by_key(|k| k.stamp_ns).or_else(|| of_log().next())?;
    Some(FarthestScan {
        log: log.to_owned(),
        stamp_ns: scan.stamp_ns,
        keyframe: keyframe.id.scan,
        travel_m: keyframe.travel_m,
        x_m: scan.a.x_m,
        y_m: scan.a.y_m,
    })
}
