//! Measures of the closures between the drives of a site, and of the maps that they share.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Pose2, quantile};
use serde::Serialize;

use super::closures::{Judged, Verdict};
use super::input::Drive;
use super::measure::known_poses;
use super::revisits::REVISIT_M;
use super::trajectory::align;
use super::truth::{TruePose, Truth};

/// A keyframe of one of several drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct DriveKeyframe {
    /// Index of the drive.
    pub drive: usize,
    /// Index of the keyframe in the drive.
    pub keyframe: usize,
}

/// A closure between two drives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosureBetween {
    /// The keyframe of the later drive.
    pub query: DriveKeyframe,
    /// The keyframe of the earlier drive.
    pub reference: DriveKeyframe,
    /// Pose of the query in the frame of the reference.
    pub reference_from_query: Pose2,
    /// Whether `optimize` accepts it.
    pub is_accepted: bool,
}

/// The drives of a site. If they have ground truth, all of it is in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct SiteDrives {
    /// Name of the site.
    pub site: String,
    /// Indices of its drives, in the order of the logs, each with the number of its map.
    pub drives: Vec<(usize, u32)>,
    /// The closures between them.
    pub closures: Vec<ClosureBetween>,
}

/// The measures of a site.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SiteMeasures {
    /// Name of the site.
    pub site: String,
    /// Number of drives.
    pub n_drives: usize,
    /// Closures between drives that `optimize` accepts.
    pub n_accepted: usize,
    /// Those that it rejects.
    pub n_rejected: usize,
    /// The maps, in the order of their numbers.
    pub maps: Vec<MapMeasures>,
    /// The errors; `None` if no keyframe of two drives has a true pose.
    pub truth: Option<SiteErrors>,
}

/// A map of one drive or more.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MapMeasures {
    /// Number of the map in `trajectory.parquet`.
    pub map: u32,
    /// Its logs.
    pub logs: Vec<String>,
    /// Keyframes with a measured true pose.
    pub n_poses: usize,
    /// Absolute trajectory error of these keyframes after one alignment for all drives, root mean
    /// square \[m\]. `None` with fewer than two.
    pub ate_rmse_m: Option<f64>,
}

/// The errors of the closures between the drives of a site.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SiteErrors {
    /// Accepted closures between keyframes whose true poses are known.
    pub n_judged: usize,
    /// Those beyond [`FALSE_M`](super::FALSE_M) or [`FALSE_DEG`](super::FALSE_DEG).
    pub n_false: usize,
    /// Median error of their positions \[m\]; `None` without a judged closure.
    pub median_m: Option<f64>,
    /// Keyframes within [`REVISIT_M`] of a keyframe of an earlier drive.
    pub n_revisits: usize,
    /// Those with a right accepted closure to an earlier drive.
    pub n_closed: usize,
}

/// Computes the measures of a site. `drives` are those of all sites.
pub fn measure_site(site: &SiteDrives, drives: &[Drive<'_>]) -> SiteMeasures {
    let poses: Vec<Vec<Option<TruePose>>> = drives
        .iter()
        .enumerate()
        .map(|(k, drive)| {
            match (site.drives.iter().any(|&(of_site, _)| of_site == k), drive.truth) {
                (true, Some(truth)) => known_poses(drive, &Truth::new(truth, drive.scans)),
                _ => vec![None; drive.keyframes.len()],
            }
        })
        .collect();
    let n_accepted = site.closures.iter().filter(|closure| closure.is_accepted).count();
    let mut maps: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for &(drive, map) in &site.drives {
        maps.entry(map).or_default().push(drive);
    }
    SiteMeasures {
        site: site.site.clone(),
        n_drives: site.drives.len(),
        n_accepted,
        n_rejected: site.closures.len() - n_accepted,
        maps: maps.iter().map(|(&map, of_map)| measure_map(map, of_map, drives, &poses)).collect(),
        truth: errors(site, &poses),
    }
}

fn measure_map(
    map: u32,
    of_map: &[usize],
    drives: &[Drive<'_>],
    poses: &[Vec<Option<TruePose>>],
) -> MapMeasures {
    let of_drive = |&drive: &usize| drives[drive].keyframes.iter().zip(&poses[drive]);
    let (truth, estimate): (Vec<Pose2>, Vec<Pose2>) = of_map
        .iter()
        .flat_map(of_drive)
        .filter_map(|(keyframe, truth)| {
            let truth = truth.filter(|truth| truth.is_measured)?;
            Some((truth.pose, keyframe.optimized))
        })
        .unzip();
    let mut logs: Vec<String> = of_map.iter().map(|&drive| drives[drive].log.to_owned()).collect();
    logs.dedup();
    MapMeasures {
        map,
        logs,
        n_poses: truth.len(),
        ate_rmse_m: align(&truth, &estimate).map(|alignment| alignment.rmse_m),
    }
}

fn errors(site: &SiteDrives, poses: &[Vec<Option<TruePose>>]) -> Option<SiteErrors> {
    let is_known = |&&(drive, _): &&(usize, u32)| poses[drive].iter().any(Option::is_some);
    if site.drives.iter().filter(is_known).count() < 2 {
        return None;
    }
    let of = |at: DriveKeyframe| poses[at.drive][at.keyframe].map(|truth| truth.pose);
    let judged: Vec<(DriveKeyframe, Judged)> = site
        .closures
        .iter()
        .filter(|closure| closure.is_accepted)
        .filter_map(|closure| {
            let (query, reference) = (of(closure.query)?, of(closure.reference)?);
            let judged = Judged::new(closure.reference_from_query, query, reference);
            Some((closure.query, judged))
        })
        .collect();
    let mut errors_m: Vec<f64> = judged.iter().map(|(_, judged)| judged.error_m).collect();
    errors_m.sort_by(f64::total_cmp);
    let revisits = revisits(site, poses);
    let is_right = |j: &Judged| j.verdict == Verdict::Right && j.distance_m <= REVISIT_M;
    let closed: BTreeSet<DriveKeyframe> =
        judged.iter().filter(|(_, judged)| is_right(judged)).map(|(query, _)| *query).collect();
    Some(SiteErrors {
        n_judged: judged.len(),
        n_false: judged.iter().filter(|(_, judged)| judged.verdict == Verdict::False).count(),
        median_m: (!errors_m.is_empty()).then(|| quantile(&errors_m, 0.5)),
        n_revisits: revisits.len(),
        n_closed: revisits.iter().filter(|revisit| closed.contains(revisit)).count(),
    })
}

/// The keyframes within [`REVISIT_M`] of a keyframe of an earlier drive of the site.
fn revisits(site: &SiteDrives, poses: &[Vec<Option<TruePose>>]) -> Vec<DriveKeyframe> {
    let cell = |pose: &Pose2| [pose.x_m, pose.y_m].map(|m| libm::floor(m / REVISIT_M) as i64);
    let mut earlier: BTreeMap<[i64; 2], Vec<Pose2>> = BTreeMap::new();
    let mut found = Vec::new();
    for &(drive, _) in &site.drives {
        let known = || {
            let known = poses[drive].iter().enumerate();
            known.filter_map(|(keyframe, truth)| Some((keyframe, (*truth)?.pose)))
        };
        for (keyframe, pose) in known() {
            let [x, y] = cell(&pose);
            let mut around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| [x, y]));
            let is_near = |other: &Pose2| pose.distance_m(other) <= REVISIT_M;
            if around.any(|cell| earlier.get(&cell).is_some_and(|near| near.iter().any(is_near))) {
                found.push(DriveKeyframe { drive, keyframe });
            }
        }
        for (_, pose) in known() {
            earlier.entry(cell(&pose)).or_default().push(pose);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use dataset::{StampedPose, Trajectory};

    use super::*;
    use crate::detection::input::KeyframePoses;

    fn at(x_m: f64, y_m: f64) -> Pose2 {
        Pose2 { x_m, y_m, ..Pose2::default() }
    }

    /// Ten keyframes, one per metre along x at `y_m`. The map is the true one, moved by (5, `off_m`).
    struct Line {
        keyframes: Vec<KeyframePoses>,
        truth: Trajectory,
    }

    fn line(y_m: f64, off_m: f64) -> Line {
        let keyframe = |k: u32| KeyframePoses {
            scan: k,
            stamp_ns: i64::from(k),
            path_m: f64::from(k),
            odometry: at(f64::from(k), y_m),
            scan_matched: at(f64::from(k), y_m),
            optimized: at(f64::from(k) + 5.0, y_m + off_m),
            covariance: None,
        };
        let truth = |k: u32| StampedPose::new(i64::from(k), at(f64::from(k), y_m));
        Line {
            keyframes: (0..10).map(keyframe).collect(),
            truth: Trajectory::new((0..10).map(truth).collect()).0,
        }
    }

    impl Line {
        fn drive<'a>(&'a self, log: &'a str) -> Drive<'a> {
            Drive {
                log,
                segment: 0,
                map: Some(0),
                keyframes: &self.keyframes,
                scans: &[],
                candidates: &[],
                closures: &[],
                truth: Some(&self.truth),
                base_from_lidar: Pose2::default(),
            }
        }
    }

    fn closure(query: [usize; 2], reference: [usize; 2], pose: Pose2) -> ClosureBetween {
        let at = |[drive, keyframe]: [usize; 2]| DriveKeyframe { drive, keyframe };
        let (query, reference) = (at(query), at(reference));
        ClosureBetween { query, reference, reference_from_query: pose, is_accepted: true }
    }

    /// Lines at y = 0, 2 and 100. All ten keyframes of the second one are revisits, none of the third.
    /// One closure is right, one is 1.5 m off, one joins keyframes 3.6 m apart (right, but no revisit).
    #[test]
    fn closures_between_drives_are_judged_in_the_frame_of_the_truth() {
        let lines = [line(0.0, 0.0), line(2.0, 0.0), line(100.0, 3.0)];
        let drives: Vec<Drive<'_>> =
            lines.iter().zip(["a", "b", "c"]).map(|(line, log)| line.drive(log)).collect();
        let rejected =
            ClosureBetween { is_accepted: false, ..closure([2, 0], [0, 0], at(0.0, 0.0)) };
        let site = SiteDrives {
            site: "north".to_owned(),
            drives: vec![(0, 4), (1, 4), (2, 5)],
            closures: vec![
                closure([1, 3], [0, 3], at(0.0, 2.0)),
                closure([1, 5], [0, 5], at(1.5, 2.0)),
                closure([1, 9], [0, 6], at(3.0, 2.0)),
                rejected,
            ],
        };
        let measures = measure_site(&site, &drives);
        assert_eq!((measures.n_accepted, measures.n_rejected), (3, 1));
        let truth = measures.truth.unwrap();
        assert_eq!((truth.n_judged, truth.n_false), (3, 1));
        assert_eq!((truth.n_revisits, truth.n_closed), (10, 1));
        assert!(truth.median_m.unwrap() < 1e-9);
        let maps: Vec<(u32, &[String], usize)> =
            measures.maps.iter().map(|map| (map.map, &map.logs[..], map.n_poses)).collect();
        assert_eq!(
            maps,
            [(4, &["a".to_owned(), "b".to_owned()][..], 20), (5, &["c".to_owned()][..], 10)]
        );
        assert!(measures.maps.iter().all(|map| map.ate_rmse_m.unwrap() < 1e-9));
        // The second drive is 0.4 m too far to the north: the best alignment leaves 0.2 m at each pose.
        let lines = [line(0.0, 0.0), line(2.0, 0.4)];
        let drives = [lines[0].drive("a"), lines[1].drive("b")];
        let site = SiteDrives { drives: vec![(0, 0), (1, 0)], closures: Vec::new(), ..site };
        let map = &measure_site(&site, &drives).maps[0];
        assert!((map.ate_rmse_m.unwrap() - 0.2).abs() < 1e-9, "{map:?}");
    }
}
