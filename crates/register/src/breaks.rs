//! Scans that show another place than the odometry says: the robot was carried, or logs were joined.

use dataset::Pose2;

use crate::align::near_share;
use crate::points::Points;
use crate::source::ScanSource;
use crate::target::Target;

/// The scans of this path before a break are compared with those of the path after it \[m\].
const BEFORE_M: f64 = 8.0;
const AFTER_M: f64 = 4.0;
/// The longest path between the scans before and after a break \[m\].
const MAX_STEP_M: f64 = 1.0;
/// The least number of scans before and after a break.
const MIN_SCANS: usize = 3;
/// At least this share of them agree with each other.
const MIN_AGREE: f64 = 0.75;
/// Scans with fewer points say nothing.
const MIN_POINTS: usize = 60;
/// Scans that share less than this with those before show another place. On recorded drives, all but single scans
/// share 0.46 and more: the least where a scanner of 180 deg turns into a corridor. Where logs of two buildings were
/// joined, it is 0.12 and 0.18.
const OTHER_SHARE: f64 = 0.3;
/// Scans that share more than this with those before agree with them.
const AGREE_SHARE: f64 = 0.5;
/// A point is compared with points up to this far from it \[m\].
const REACH_M: f64 = 0.5;

/// Registered scans of a drive. All slices have one entry per scan.
pub(crate) struct Scans<'a> {
    pub(crate) source: &'a dyn ScanSource,
    /// Whether the points of a scan count.
    pub(crate) is_used: &'a [bool],
    pub(crate) poses: &'a [Pose2],
    /// Path length by odometry \[m\].
    pub(crate) path_m: &'a [f64],
    /// Share of the points that are near those of the last metres.
    pub(crate) near_shares: &'a [f64],
}

impl Scans<'_> {
    /// The scans from which on nothing is left of what the scans before show, although the scans on both sides agree
    /// with each other. A single scan that agrees with nothing is none: a robot that tilts, or people around it. A
    /// robot that is carried back within 4 m is not noticed.
    pub(crate) fn breaks(&self) -> Vec<usize> {
        (1..self.poses.len()).filter(|&scan| self.is_break(scan)).collect()
    }

    fn is_break(&self, scan: usize) -> bool {
        let says_something =
            |k: &usize| self.is_used[*k] && MIN_POINTS <= self.source.scan(*k).points().len();
        if OTHER_SHARE <= self.near_shares[scan] || !says_something(&scan) {
            return false;
        }
        let at_m = self.path_m[scan];
        let start = self.path_m.partition_point(|&m| m < at_m - BEFORE_M);
        let end = self.path_m.partition_point(|&m| m <= at_m + AFTER_M);
        let before: Vec<usize> = (start..scan).filter(says_something).collect();
        let after: Vec<usize> = (scan + 1..end).filter(says_something).collect();
        // After a gap, the robot has simply driven on.
        let is_sudden = before.last().is_some_and(|&k| at_m - self.path_m[k] <= MAX_STEP_M);
        if !is_sudden || ![&before, &after].into_iter().all(|scans| self.agree(scans)) {
            return false;
        }
        let mut points = Points::default();
        for k in before {
            points.extend_from(&self.poses[k], self.source.scan(k).points());
        }
        let target = Target::new(points, REACH_M);
        after.iter().all(|&k| {
            let scan = self.source.scan(k);
            near_share(scan.points(), &target, &self.poses[k], REACH_M) < OTHER_SHARE
        })
    }

    /// Whether most scans agree with those before them.
    fn agree(&self, scans: &[usize]) -> bool {
        let n = scans.iter().filter(|&&k| AGREE_SHARE < self.near_shares[k]).count();
        MIN_SCANS <= scans.len() && MIN_AGREE * scans.len() as f64 <= n as f64
    }
}
