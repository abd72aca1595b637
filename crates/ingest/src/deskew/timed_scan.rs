//! A scan with the times of its returns.

use dataset::Scan;

use crate::deskew::motion::ScanMotion;

/// A scan as measured, with the times of its returns.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct TimedScan {
    pub(crate) scan: Scan,
    /// Time of each return relative to the stamp of the scan \[ns\], `(n_returns,)`. Empty if the
    /// message does not contain times.
    pub(crate) times_ns: Vec<i64>,
}

impl TimedScan {
    /// The times of the first and the last return, extended to include the stamp \[ns since the
    /// epoch\]. It is `None` if the times are unknown or all equal.
    pub(crate) fn range_ns(&self) -> Option<(i64, i64)> {
        let (min, max) = (self.times_ns.iter().min()?, self.times_ns.iter().max()?);
        let stamp_ns = self.scan.stamp_ns;
        let are_equal = min == max;
        (!are_equal)
            .then(|| (stamp_ns.saturating_add(*min.min(&0)), stamp_ns.saturating_add(*max.max(&0))))
    }

    /// The scan with its returns in the lidar frame at the stamp.
    pub(crate) fn deskewed(mut self, motion: &ScanMotion) -> Scan {
        let points = self.scan.x_m.iter_mut().zip(&mut self.scan.y_m);
        for ((x_m, y_m), &ns) in points.zip(&self.times_ns) {
            let [dx, dy, turn_rad] = motion.at(ns);
            let (sin, cos) = libm::sincos(turn_rad);
            let (x, y) = (f64::from(*x_m), f64::from(*y_m));
            *x_m = (dx + cos * x - sin * y) as f32;
            *y_m = (dy + sin * x + cos * y) as f32;
        }
        self.scan
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::{Pose2, StampedPose};

    const MS: i64 = 1_000_000;

    /// A wall at x = 5 m, and a lidar that drives toward it with 1 m/s: after 0.1 s it measures 4.9
    /// m.
    #[test]
    fn deskewing_straightens_a_wall() {
        let timed = TimedScan {
            scan: Scan {
                stamp_ns: 0,
                x_m: vec![5.0, 4.95, 4.9],
                y_m: vec![1.0, 0.0, -1.0],
                ..Scan::default()
            },
            times_ns: vec![0, 50 * MS, 100 * MS],
        };
        assert_eq!(timed.range_ns(), Some((0, 100 * MS)));
        let pose =
            |stamp_ns, x_m| StampedPose::new(stamp_ns, Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 });
        let motion = ScanMotion::new(&[&pose(0, 0.0), &pose(100 * MS, 0.1)], 0);
        let scan = timed.deskewed(&motion);
        assert!(scan.x_m.iter().all(|x| (x - 5.0).abs() < 1e-6), "{:?}", scan.x_m);
        assert_eq!(scan.y_m, [1.0, 0.0, -1.0]);
    }
}
