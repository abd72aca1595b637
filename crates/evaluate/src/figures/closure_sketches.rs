//! The parts of the scans that figures of loop closures show.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Pose2, Scan, ScanId};

use super::ground::Ground;
use crate::detection::{Drive, FoundClosure};

/// Drives whose maps are drawn: those with the longest path. More would make the report too large.
const MAX_DRIVES: usize = 6;
/// Path before and after a keyframe whose scans form its submap \[m\].
const SUBMAP_HALF_M: f64 = 5.0;
/// Returns farther from the robot are not drawn in a submap \[m\].
const SUBMAP_RANGE_M: f64 = 15.0;
/// Width of a square of a submap that holds one point \[m\].
const SUBMAP_CELL_M: f64 = 0.15;

/// Why a closure is drawn as an overlay of its two submaps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum OverlayKind {
    StrongestAccepted,
    WeakestAccepted,
    StrongestRejected,
}

impl OverlayKind {
    /// The first part of the figure's id.
    pub(crate) fn id(self) -> &'static str {
        match self {
            Self::StrongestAccepted => "strongest-accepted",
            Self::WeakestAccepted => "weakest-accepted",
            Self::StrongestRejected => "strongest-rejected",
        }
    }

    pub(crate) fn title(self) -> &'static str {
        match self {
            Self::StrongestAccepted => "strongest accepted closure",
            Self::WeakestAccepted => "weakest accepted closure",
            Self::StrongestRejected => "strongest rejected closure",
        }
    }
}

/// The two submaps of a closure.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Overlay {
    pub(crate) kind: OverlayKind,
    /// Index of the closure in its drive.
    pub(crate) closure: usize,
    pub(crate) reference: Submap,
    pub(crate) query: Submap,
}

/// The points of the scans around a keyframe, joined by their poses from scan matching.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Submap {
    /// Index of the keyframe.
    pub(crate) keyframe: usize,
    /// Squares with points, in the frame of the robot at the keyframe.
    cells: BTreeSet<(i32, i32)>,
}

/// What figures show of one drive.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DriveSketch {
    /// Index of the drive.
    pub(crate) drive: usize,
    /// The scans at the poses of odometry.
    pub(crate) before: Ground,
    /// The scans at the optimized poses.
    pub(crate) after: Ground,
    pub(crate) overlays: Vec<Overlay>,
}

/// A map that several drives lie in.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct MapSketch {
    /// Number of the map.
    pub(crate) map: u32,
    /// Indices of its drives.
    pub(crate) drives: Vec<usize>,
    /// The scans of all drives at the optimized poses.
    pub(crate) ground: Ground,
}

/// Collects what the figures of loop closures show of the scans, one scan at a time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ClosureSketches {
    pub(crate) drives: Vec<DriveSketch>,
    /// By scan: the index of the sketch and of the keyframe.
    keyframes: BTreeMap<ScanId, (usize, usize)>,
    pub(crate) maps: Vec<MapSketch>,
    /// By scan: the index of the map sketch, of the drive and of the keyframe.
    in_maps: BTreeMap<ScanId, [usize; 3]>,
}

impl ClosureSketches {
    /// Selects the drives and closures to draw.
    pub fn new(drives: &[Drive<'_>]) -> Self {
        let mut longest: Vec<usize> =
            (0..drives.len()).filter(|&k| !drives[k].keyframes.is_empty()).collect();
        let path_m = |k: usize| drives[k].keyframes.last().map_or(0.0, |last| last.path_m);
        longest.sort_by(|&a, &b| path_m(b).total_cmp(&path_m(a)).then(a.cmp(&b)));
        longest.truncate(MAX_DRIVES);
        longest.sort_unstable();
        let mut sketches = Self::default();
        for k in longest {
            let drive = &drives[k];
            let of_keyframes = |pose: fn(&crate::detection::KeyframePoses) -> Pose2| {
                let poses: Vec<Pose2> = drive.keyframes.iter().map(pose).collect();
                Ground::new(&poses)
            };
            for (index, keyframe) in drive.keyframes.iter().enumerate() {
                let id = ScanId { log: drive.log.into(), scan: keyframe.scan };
                sketches.keyframes.insert(id, (sketches.drives.len(), index));
            }
            sketches.drives.push(DriveSketch {
                drive: k,
                before: of_keyframes(|keyframe| keyframe.odometry),
                after: of_keyframes(|keyframe| keyframe.optimized),
                overlays: overlays(drive.closures),
            });
        }
        sketches.add_maps(drives);
        sketches
    }

    /// Selects the maps of several drives: those with the most keyframes.
    fn add_maps(&mut self, drives: &[Drive<'_>]) {
        let mut of_maps: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
        for (k, map) in drives.iter().enumerate().filter_map(|(k, drive)| Some((k, drive.map?))) {
            of_maps.entry(map).or_default().push(k);
        }
        let mut maps: Vec<(u32, Vec<usize>)> =
            of_maps.into_iter().filter(|(_, of_map)| 1 < of_map.len()).collect();
        let n_keyframes =
            |of_map: &[usize]| of_map.iter().map(|&k| drives[k].keyframes.len()).sum::<usize>();
        maps.sort_by_key(|(map, of_map)| (std::cmp::Reverse(n_keyframes(of_map)), *map));
        maps.truncate(MAX_DRIVES);
        for (map, of_map) in maps {
            let mut poses = Vec::new();
            for &k in &of_map {
                for (index, keyframe) in drives[k].keyframes.iter().enumerate() {
                    let id = ScanId { log: drives[k].log.into(), scan: keyframe.scan };
                    self.in_maps.insert(id, [self.maps.len(), k, index]);
                    poses.push(keyframe.optimized);
                }
            }
            self.maps.push(MapSketch { map, drives: of_map, ground: Ground::new(&poses) });
        }
    }

    /// Adds the scan of a keyframe. Scans that are not keyframes of the drives are ignored.
    pub fn add(&mut self, drives: &[Drive<'_>], id: &ScanId, scan: &Scan) {
        if let Some(&[map, drive, keyframe]) = self.in_maps.get(id) {
            let drive = &drives[drive];
            let pose = drive.keyframes[keyframe].optimized * drive.base_from_lidar;
            self.maps[map].ground.add(&pose, scan);
        }
        let Some(&(sketch, keyframe)) = self.keyframes.get(id) else { return };
        let sketch = &mut self.drives[sketch];
        let drive = &drives[sketch.drive];
        let poses = &drive.keyframes[keyframe];
        sketch.before.add(&(poses.odometry * drive.base_from_lidar), scan);
        sketch.after.add(&(poses.optimized * drive.base_from_lidar), scan);
        for overlay in &mut sketch.overlays {
            for submap in [&mut overlay.reference, &mut overlay.query] {
                submap.add(drive, keyframe, scan);
            }
        }
    }
}

impl Submap {
    fn new(keyframe: usize) -> Self {
        Self { keyframe, cells: BTreeSet::new() }
    }

    fn add(&mut self, drive: &Drive<'_>, keyframe: usize, scan: &Scan) {
        let (centre, here) = (&drive.keyframes[self.keyframe], &drive.keyframes[keyframe]);
        if SUBMAP_HALF_M < (here.path_m - centre.path_m).abs() {
            return;
        }
        let centre_from_lidar =
            centre.scan_matched.inverse() * here.scan_matched * drive.base_from_lidar;
        let (sin, cos) = libm::sincos(centre_from_lidar.heading_rad);
        for [x, y] in scan.points() {
            if SUBMAP_RANGE_M * SUBMAP_RANGE_M < x * x + y * y {
                continue;
            }
            let cell = |metres: f64| libm::floor(metres / SUBMAP_CELL_M) as i32;
            self.cells.insert((
                cell(centre_from_lidar.x_m + cos * x - sin * y),
                cell(centre_from_lidar.y_m + sin * x + cos * y),
            ));
        }
    }

    /// At most `most` points, in the frame of the robot at the keyframe.
    pub(crate) fn points(&self, most: usize) -> impl Iterator<Item = [f64; 2]> {
        let centre = |cell: i32| (f64::from(cell) + 0.5) * SUBMAP_CELL_M;
        let every = self.cells.len().div_ceil(most).max(1);
        self.cells.iter().step_by(every).map(move |&(x, y)| [centre(x), centre(y)])
    }
}

/// The strongest and the weakest accepted closure and the strongest rejected one, by confidence, then by
/// overlap.
fn overlays(closures: &[FoundClosure<'_>]) -> Vec<Overlay> {
    let strength = |k: usize| (closures[k].confidence, closures[k].evidence.known_overlap);
    let by_strength = |a: &usize, b: &usize| {
        let (a, b) = (strength(*a), strength(*b));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    };
    let of = |is_accepted: bool| {
        let all = 0..closures.len();
        all.filter(move |&k| closures[k].rejected.is_none() == is_accepted)
    };
    let strongest = of(true).max_by(by_strength);
    let weakest = of(true).min_by(by_strength).filter(|&weakest| Some(weakest) != strongest);
    let chosen = [
        (OverlayKind::StrongestAccepted, strongest),
        (OverlayKind::WeakestAccepted, weakest),
        (OverlayKind::StrongestRejected, of(false).max_by(by_strength)),
    ];
    let overlay = |(kind, closure): (OverlayKind, Option<usize>)| {
        let closure = closure?;
        Some(Overlay {
            kind,
            closure,
            reference: Submap::new(closures[closure].reference),
            query: Submap::new(closures[closure].query),
        })
    };
    chosen.into_iter().filter_map(overlay).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detection::KeyframePoses;

    /// Two drives of one map, 1 m apart, see the same two points. Alone, each sees them once, which may be
    /// noise. A third drive is in a map of its own.
    #[test]
    fn a_map_of_several_drives_is_drawn_from_all_their_scans() {
        let keyframe = |x_m| KeyframePoses {
            scan: 0,
            stamp_ns: 0,
            path_m: 0.0,
            odometry: Pose2::default(),
            scan_matched: Pose2::default(),
            optimized: Pose2 { x_m, ..Pose2::default() },
            covariance: None,
        };
        let keyframes = [[keyframe(0.0)], [keyframe(1.0)], [keyframe(0.0)]];
        let drive = |k: usize, map| Drive {
            log: ["monday", "tuesday", "other"][k],
            segment: 0,
            map: Some(map),
            keyframes: &keyframes[k],
            scans: &[],
            candidates: &[],
            closures: &[],
            truth: None,
            base_from_lidar: Pose2::default(),
        };
        let drives = [drive(0, 4), drive(1, 4), drive(2, 5)];
        let mut sketches = ClosureSketches::new(&drives);
        for (k, x_m) in [(0, 5.0), (1, 4.0), (2, 5.0)] {
            let id = ScanId { log: drives[k].log.into(), scan: 0 };
            let scan = Scan { x_m: vec![x_m; 2], y_m: vec![0.0, 2.0], ..Scan::default() };
            sketches.add(&drives, &id, &scan);
        }
        let [map] = &sketches.maps[..] else { panic!("one map of several drives") };
        assert_eq!((map.map, &map.drives[..]), (4, &[0, 1][..]));
        let n_runs = |ground: &Ground| ground.svg("m", "", &[]).into_string().matches('h').count();
        let empty = n_runs(&Ground::new(&[Pose2::default()]));
        assert_eq!(n_runs(&map.ground), empty + 2);
        assert_eq!(n_runs(&sketches.drives[0].after), empty);
    }
}
