//! Scans that show another place than the odometry says: the robot was carried, or logs were joined.

use dataset::Pose2;

use crate::align::near_share;
use crate::points::Points;
use crate::target::Target;

/// The scans of this path before a break are compared with those of the path after it \[m\].
const BEFORE_M: f64 = 8.0;
const AFTER_M: f64 = 4.0;
/// The least number of scans after a break.
const MIN_AFTER: usize = 3;
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
    pub(crate) points: &'a [Points],
    pub(crate) poses: &'a [Pose2],
    /// Path length by odometry \[m\].
    pub(crate) path_m: &'a [f64],
    /// Share of the points that are near those of the last metres.
    pub(crate) near_shares: &'a [f64],
}

impl Scans<'_> {
    /// The scans from which on nothing is left of what the scans before show, although the scans after them agree
    /// with each other. A single scan that agrees with nothing is none: a robot that tilts, or people around it.
    pub(crate) fn breaks(&self) -> Vec<usize> {
        (1..self.points.len()).filter(|&scan| self.is_break(scan)).collect()
    }

    fn is_break(&self, scan: usize) -> bool {
        let says_something = |k: usize| MIN_POINTS <= self.points[k].len();
        if OTHER_SHARE <= self.near_shares[scan] || !says_something(scan) {
            return false;
        }
        let at_m = self.path_m[scan];
        let end = self.path_m.partition_point(|&m| m <= at_m + AFTER_M);
        let after: Vec<usize> = (scan + 1..end).filter(|&k| says_something(k)).collect();
        let agree = after.iter().filter(|&&k| AGREE_SHARE < self.near_shares[k]).count();
        if after.len() < MIN_AFTER || (agree as f64) < MIN_AGREE * after.len() as f64 {
            return false;
        }
        let start = self.path_m.partition_point(|&m| m < at_m - BEFORE_M);
        let mut before = Points::default();
        for k in start..scan {
            before.extend_from(&self.poses[k], &self.points[k]);
        }
        if before.len() < MIN_POINTS {
            return false;
        }
        let target = Target::new(before, REACH_M);
        after
            .iter()
            .all(|&k| near_share(&self.points[k], &target, &self.poses[k], REACH_M) < OTHER_SHARE)
    }
}
