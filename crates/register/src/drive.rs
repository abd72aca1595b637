//! A drive: scans in the order of time with their poses.

use std::ops::Range;
use std::sync::Arc;

use dataset::{FULL_RING_DEG, Pose2, RangeLimits, Scan};
use model::OdometryNoise;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::align::Weakness;
use crate::breaks::Scans;
use crate::joint::{JointOptions, JointScans, align_jointly, pairs_along_path};
use crate::matcher::{Matched, MatcherOptions, ScanMatcher, is_decided};
use crate::odometry::OdometryModel;
use crate::source::{DriveScan, HeldScans, ScanSource, Stretch};
use crate::stretches::match_drive;

/// How a drive is registered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct RegisterOptions {
    /// A scan that covers less than a full circle is registered when the robot has moved this far
    /// since the last one that was \[m\].
    pub spacing_m: f64,
    /// The same when it has turned by this angle \[deg\].
    pub turn_deg: f64,
    /// The same distance for scans that cover a full circle \[m\]. They share more of what they see.
    pub full_circle_spacing_m: f64,
    /// The same angle for scans that cover a full circle \[deg\].
    pub full_circle_turn_deg: f64,
    /// Returns farther than this are not used \[m\].
    pub max_range_m: f64,
    /// Scan matching.
    pub matcher: MatcherOptions,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self {
            spacing_m: 0.2,
            turn_deg: 8.0,
            full_circle_spacing_m: 0.45,
            full_circle_turn_deg: 20.0,
            max_range_m: 25.0,
            matcher: MatcherOptions::default(),
        }
    }
}

/// What decides whether a scan is registered.
#[derive(Debug, Clone, Copy)]
pub struct OdometryScan {
    /// Pose of the lidar by odometry.
    pub odometry: Pose2,
    /// Angle that the scan covers \[deg\].
    pub coverage_deg: f32,
    /// Whether the scan is a keyframe. A keyframe is always registered.
    pub is_keyframe: bool,
}

/// A registered scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Registered {
    /// Pose of the lidar, in the frame of the odometry of the first scan.
    pub pose: Pose2,
    /// Covariance of x, y and heading relative to the scans of the last metres. `None` for the first
    /// scan.
    pub covariance: Option<Matrix3<f64>>,
    /// Share of the points that are near a point of the last metres.
    pub near_share: f64,
    /// The direction in which the points determine the position worst.
    pub weakness: Option<Weakness>,
    /// Whether the scans from this one on show another place than those before, although the odometry says that they
    /// are near: the robot was carried, or logs were joined. Its pose relative to them is not known.
    pub is_break: bool,
}

impl Registered {
    /// Whether the scan determined its position: its points are near those of the last metres, and lie
    /// along several directions.
    pub fn is_decided(&self) -> bool {
        is_decided(self.near_share, self.weakness.map(|weakness| weakness.ratio))
    }
}

/// Registered scans in the order of time, as the later stages use them. All vectors have one entry
/// per scan. The scans themselves are given by [`Drive::scan`].
#[derive(Clone)]
pub struct Drive {
    /// The scans of each drive.
    sources: Vec<Arc<dyn ScanSource>>,
    /// Pose of the lidar by odometry.
    pub odometry: Vec<Pose2>,
    /// Pose of the lidar by scan matching.
    pub poses: Vec<Pose2>,
    /// Path length by odometry \[m\]. Where another drive begins, it steps by [`NEW_DRIVE_M`].
    pub path_m: Vec<f64>,
    /// The first scan of each drive: `[0]`, or more after [`Drive::joined`].
    pub starts: Vec<usize>,
    /// Whether the scan is a keyframe.
    pub is_keyframe: Vec<bool>,
    /// Whether the scan determined its position, see [`Registered::is_decided`].
    pub is_decided: Vec<bool>,
}

/// Path between the last scan of a drive and the first one of the next drive \[m\]: more than any two
/// scans that count as neighbours along the path.
pub const NEW_DRIVE_M: f64 = 1000.0;

impl Drive {
    /// Computes the path: the sum of the distances between consecutive scans, by odometry.
    ///
    /// # Panics
    /// If the vectors do not have one entry per scan.
    pub fn new(
        scans: Arc<dyn ScanSource>,
        odometry: Vec<Pose2>,
        poses: Vec<Pose2>,
        is_keyframe: Vec<bool>,
        is_decided: Vec<bool>,
    ) -> Self {
        let n = scans.len();
        assert!(odometry.len() == n && poses.len() == n);
        assert!(is_keyframe.len() == n && is_decided.len() == n);
        let path_m = path_m(&odometry);
        let (sources, starts) = (vec![scans], vec![0]);
        Self { sources, odometry, poses, path_m, starts, is_keyframe, is_decided }
    }

    /// The same with scans in memory.
    pub fn of_scans(
        scans: Vec<&Scan>,
        odometry: Vec<Pose2>,
        poses: Vec<Pose2>,
        is_keyframe: Vec<bool>,
        is_decided: Vec<bool>,
        limits: RangeLimits,
    ) -> Self {
        let scans = Arc::new(HeldScans::new(scans.into_iter().cloned(), limits));
        Self::new(scans, odometry, poses, is_keyframe, is_decided)
    }

    /// Number of scans.
    pub fn n_scans(&self) -> usize {
        self.poses.len()
    }

    /// Puts drives one after the other. Nothing is known of the motion between them: their poses need not
    /// be in one frame.
    pub fn joined(drives: Vec<Self>) -> Self {
        let mut joined = Self {
            sources: Vec::new(),
            odometry: Vec::new(),
            poses: Vec::new(),
            path_m: Vec::new(),
            starts: Vec::new(),
            is_keyframe: Vec::new(),
            is_decided: Vec::new(),
        };
        for drive in drives {
            let first = joined.n_scans();
            let from_m = joined.path_m.last().map_or(0.0, |last| last + NEW_DRIVE_M);
            joined.starts.extend(drive.starts.iter().map(|start| first + start));
            joined.path_m.extend(drive.path_m.iter().map(|path_m| from_m + path_m));
            joined.sources.extend(drive.sources);
            joined.odometry.extend(drive.odometry);
            joined.poses.extend(drive.poses);
            joined.is_keyframe.extend(drive.is_keyframe);
            joined.is_decided.extend(drive.is_decided);
        }
        joined
    }

    /// The drives of [`Drive::joined`], one by one.
    pub fn split(mut self) -> Vec<Self> {
        let mut drives = Vec::new();
        while let (Some(start), Some(source)) = (self.starts.pop(), self.sources.pop()) {
            let mut path_m = self.path_m.split_off(start);
            let from_m = path_m.first().copied().unwrap_or_default();
            path_m.iter_mut().for_each(|m| *m -= from_m);
            drives.push(Self {
                sources: vec![source],
                odometry: self.odometry.split_off(start),
                poses: self.poses.split_off(start),
                path_m,
                starts: vec![0],
                is_keyframe: self.is_keyframe.split_off(start),
                is_decided: self.is_decided.split_off(start),
            });
        }
        drives.reverse();
        drives
    }

    /// The scans of each drive.
    pub fn parts(&self) -> Vec<Range<usize>> {
        let ends = self.starts.iter().skip(1).copied().chain([self.n_scans()]);
        self.starts.iter().copied().zip(ends).map(|(start, end)| start..end).collect()
    }

    /// The drive that a scan belongs to.
    pub fn part_of(&self, scan: usize) -> usize {
        self.starts.partition_point(|&start| start <= scan) - 1
    }

    /// Aligns scans with poses jointly, see [`align_jointly`]. Those that are held stay. The steps of the
    /// odometry count without their systematic error, and with the random error that the scans show, see
    /// [`OdometryModel`]. `noise` is the error of odometry in general.
    pub fn align_jointly(
        &self,
        poses: &[Pose2],
        pairs: &[(usize, usize)],
        is_held: &[bool],
        noise: &OdometryNoise,
        options: &JointOptions,
    ) -> Vec<Pose2> {
        let (mut odometry, mut noise_of_steps) = (Vec::new(), Vec::new());
        for part in self.parts() {
            let [by_odometry, matched] = [&self.odometry, &self.poses].map(|p| &p[part.clone()]);
            let is_decided = &self.is_decided[part.clone()];
            let model = OdometryModel::of_drive(by_odometry, matched, is_decided, noise);
            let corrected = model.corrected_poses(by_odometry);
            let of_steps = model.noise_of_steps(&corrected, matched, is_decided, noise);
            noise_of_steps.extend(of_steps.into_iter().zip(part.clone()).map(|(noise, scan)| {
                let is_first = scan == part.start;
                (!is_first).then_some(noise)
            }));
            odometry.extend(corrected);
        }
        let scans = JointScans {
            source: self,
            odometry: &odometry,
            path_m: &self.path_m,
            noise: &noise_of_steps,
            is_held,
        };
        align_jointly(&scans, poses, pairs, options)
    }
}

impl ScanSource for Drive {
    fn len(&self) -> usize {
        self.n_scans()
    }

    fn scan(&self, index: usize) -> Arc<DriveScan> {
        let part = self.part_of(index);
        self.sources[part].scan(index - self.starts[part])
    }
}

/// Path length at each pose: the sum of the distances between consecutive poses \[m\].
fn path_m(poses: &[Pose2]) -> Vec<f64> {
    let mut path_m = vec![0.0; poses.len()];
    for k in 1..poses.len() {
        path_m[k] = path_m[k - 1] + poses[k - 1].distance_m(&poses[k]);
    }
    path_m
}

impl RegisterOptions {
    /// The range limits of registration: those of the lidar, up to `max_range_m`.
    pub fn limits(&self, lidar: RangeLimits) -> RangeLimits {
        RangeLimits { min_m: lidar.min_m, max_m: lidar.max_m.min(self.max_range_m) }
    }
}

/// Registers a drive: learns the error of the odometry from pieces of the drive, matches each scan with
/// those of the last metres, then aligns all of them together. `odometry` has the pose of the lidar at each scan.
/// `noise` is the error of odometry in general; that of the drive is not larger. The result has one entry per scan.
/// Stretches of a long drive are matched in parallel.
///
/// Where the scans suddenly show another place ([`Registered::is_break`]), a new drive begins, which is registered by
/// itself.
///
/// # Panics
/// If there is not one pose per scan.
pub fn register_drive(
    scans: &dyn ScanSource,
    odometry: &[Pose2],
    noise: &OdometryNoise,
    options: &MatcherOptions,
) -> Vec<Registered> {
    let registered = register_continuous(scans, odometry, noise, options);
    let breaks: Vec<usize> = (0..registered.len()).filter(|&k| registered[k].is_break).collect();
    if breaks.is_empty() {
        return registered;
    }
    let starts = [0].into_iter().chain(breaks.iter().copied());
    let ends = breaks.iter().copied().chain([odometry.len()]);
    let of_part = |(start, end): (usize, usize)| {
        let stretch = Stretch { source: scans, first: start, n: end - start };
        let mut part = register_continuous(&stretch, &odometry[start..end], noise, options);
        for (k, scan) in part.iter_mut().enumerate() {
            scan.is_break = k == 0 && 0 < start;
        }
        part
    };
    starts.zip(ends).flat_map(of_part).collect()
}

/// Registers a drive as if it had no breaks, and finds them.
fn register_continuous(
    scans: &dyn ScanSource,
    odometry: &[Pose2],
    noise: &OdometryNoise,
    options: &MatcherOptions,
) -> Vec<Registered> {
    assert_eq!(scans.len(), odometry.len(), "one pose per scan");
    let model = OdometryModel::of_pieces(scans, odometry, noise, options);
    let odometry = model.corrected_poses(odometry);
    let path_m = path_m(&odometry);
    let matcher = || ScanMatcher::new(*options, *noise).with_usual_noise(model.noise);
    let matched = match_drive(scans, &odometry, &path_m, options, &matcher);
    let is_used: Vec<bool> = matched.iter().map(|matched| matched.is_used).collect();
    let mut pairs = pairs_along_path(&path_m);
    pairs.retain(|&(earlier, later)| is_used[earlier] && is_used[later]);
    let poses: Vec<Pose2> = matched.iter().map(|matched| matched.pose).collect();
    let is_decided: Vec<bool> = matched.iter().map(Matched::is_decided).collect();
    let noise = model.noise_of_steps(&odometry, &poses, &is_decided, noise);
    let noise: Vec<_> = noise.into_iter().map(Some).collect();
    let is_held: Vec<bool> = (0..poses.len()).map(|scan| scan == 0).collect();
    let joint = JointScans {
        source: scans,
        odometry: &odometry,
        path_m: &path_m,
        noise: &noise,
        is_held: &is_held,
    };
    let poses = align_jointly(&joint, &poses, &pairs, &JointOptions::default());
    let near_shares: Vec<f64> = matched.iter().map(|matched| matched.near_share).collect();
    let scans = Scans {
        source: scans,
        is_used: &is_used,
        poses: &poses,
        path_m: &path_m,
        near_shares: &near_shares,
    };
    let breaks = scans.breaks();
    let registered = poses.iter().zip(&matched).enumerate();
    registered
        .map(|(k, (&pose, matched))| Registered {
            pose,
            covariance: matched.covariance,
            near_share: matched.near_share,
            weakness: matched.weakness,
            is_break: breaks.contains(&k),
        })
        .collect()
}

/// The indices of the scans that are registered: the first one, keyframes, and those after enough path or
/// turning.
pub fn scans_to_register(scans: &[OdometryScan], options: &RegisterOptions) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    let mut since_m = 0.0;
    for (k, scan) in scans.iter().enumerate() {
        if 0 < k {
            since_m += scans[k - 1].odometry.distance_m(&scan.odometry);
        }
        let is_due = chosen.last().is_none_or(|&last| {
            let turned = scan.odometry.heading_difference_rad(&scans[last].odometry);
            let (spacing_m, turn_deg) = match scan.coverage_deg < FULL_RING_DEG {
                true => (options.spacing_m, options.turn_deg),
                false => (options.full_circle_spacing_m, options.full_circle_turn_deg),
            };
            spacing_m <= since_m || turn_deg.to_radians() <= turned
        });
        if is_due || scan.is_keyframe {
            chosen.push(k);
            since_m = 0.0;
        }
    }
    chosen
}
