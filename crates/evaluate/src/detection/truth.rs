//! The ground truth at the stamps of scans.

use std::collections::BTreeMap;

use dataset::{Pose2, StampedPose, Trajectory};

use super::input::ScanPoses;

/// Between two true poses at most this far apart, the truth is interpolated \[ns\]. At 2 m/s, a change of
/// speed by 1 m/s^2 moves the middle of 0.25 s by 8 mm.
pub const MAX_INTERPOLATION_NS: i64 = 250_000_000;
/// The truth is carried along the optimized trajectory over at most this time \[ns\].
pub const MAX_CARRY_NS: i64 = 4_000_000_000;
/// Two scans farther apart give no optimized pose in between \[ns\].
const MAX_SCAN_GAP_NS: i64 = 2_000_000_000;

/// A true pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruePose {
    /// The pose.
    pub pose: Pose2,
    /// Whether the truth has this stamp, or poses close before and after it. Otherwise the pose is
    /// carried from the nearest true pose along the optimized trajectory, and its error contains the
    /// error of that trajectory over a few seconds.
    pub is_measured: bool,
}

/// The ground truth of a drive.
#[derive(Debug, Clone)]
pub struct Truth {
    /// The true poses in the frame that has most of them.
    poses: Trajectory,
    /// The optimized trajectory.
    optimized: Trajectory,
}

impl Truth {
    /// The truth of a log and the optimized poses of a drive in it. If the true poses are in several
    /// frames, only those in the frame with the most poses are used.
    pub fn new(truth: &Trajectory, scans: &[ScanPoses]) -> Self {
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        for pose in truth.poses() {
            *counts.entry(pose.frame).or_default() += 1;
        }
        let most = counts.values().max().copied();
        let frame = counts.iter().find(|(_, n)| Some(**n) == most).map_or(0, |(frame, _)| *frame);
        let of_frame = truth.poses().iter().filter(|p| p.frame == frame).copied().collect();
        let optimized =
            scans.iter().map(|scan| StampedPose::new(scan.stamp_ns, scan.optimized)).collect();
        Self { poses: Trajectory::new(of_frame).0, optimized: Trajectory::new(optimized).0 }
    }

    /// The truth at a stamp, if it is measured there. See [`TruePose::is_measured`].
    pub fn measured_at(&self, stamp_ns: i64) -> Option<Pose2> {
        self.poses.pose_at(stamp_ns, MAX_INTERPOLATION_NS).ok()
    }

    /// The truth at the stamp of a scan.
    pub fn at(&self, stamp_ns: i64) -> Option<TruePose> {
        if let Some(pose) = self.measured_at(stamp_ns) {
            return Some(TruePose { pose, is_measured: true });
        }
        let nearest = self.nearest(stamp_ns)?;
        let optimized = |stamp_ns| self.optimized.pose_at(stamp_ns, MAX_SCAN_GAP_NS).ok();
        let nearest_from_here = optimized(nearest.stamp_ns)?.inverse() * optimized(stamp_ns)?;
        let pose = nearest.pose * nearest_from_here;
        Some(TruePose { pose, is_measured: false })
    }

    /// The true pose nearest in time; the earlier one of two.
    fn nearest(&self, stamp_ns: i64) -> Option<StampedPose> {
        let poses = self.poses.poses();
        let after = poses.partition_point(|p| p.stamp_ns < stamp_ns);
        let gap = |p: &&StampedPose| p.stamp_ns.abs_diff(stamp_ns);
        let neighbours = [after.checked_sub(1).and_then(|k| poses.get(k)), poses.get(after)];
        let nearest = neighbours.into_iter().flatten().min_by_key(gap)?;
        (gap(&nearest) <= MAX_CARRY_NS.unsigned_abs()).then_some(*nearest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: i64 = 1_000_000_000;

    fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
    }

    fn scan(stamp_ns: i64, optimized: Pose2) -> ScanPoses {
        ScanPoses { stamp_ns, odometry: at(9.0, 9.0, 9.0), scan_matched: None, optimized }
    }

    fn is_near(a: Pose2, b: Pose2) -> bool {
        a.distance_m(&b) < 1e-12 && a.heading_difference_rad(&b) < 1e-12
    }

    /// The optimized trajectory drives 1 m/s along x. The truth at 2 s faces along y, so 1 s later the
    /// robot is 1 m farther along y, and 1 s earlier 1 m back.
    #[test]
    fn the_truth_is_carried_along_the_optimized_trajectory() {
        let scans: Vec<ScanPoses> =
            (0..20).map(|k| scan(k * SECOND, at(k as f64, 0.0, 0.0))).collect();
        let (trajectory, _) =
            Trajectory::new(vec![StampedPose::new(2 * SECOND, at(10.0, 20.0, 90.0))]);
        let truth = Truth::new(&trajectory, &scans);
        let found = |k: usize| truth.at(scans[k].stamp_ns);
        let exact = TruePose { pose: at(10.0, 20.0, 90.0), is_measured: true };
        assert_eq!(found(2), Some(exact));
        let later = found(3).unwrap();
        assert!(is_near(later.pose, at(10.0, 21.0, 90.0)) && !later.is_measured);
        assert!(is_near(found(1).unwrap().pose, at(10.0, 19.0, 90.0)));
        // 4 s after the only true pose, and 5 s after it.
        assert!(found(6).is_some() && found(7).is_none());
    }

    /// 20 ms beside a true pose, the truth is not that pose: the robot has driven 20 mm.
    #[test]
    fn a_stamp_close_to_a_true_pose_does_not_get_that_pose() {
        let ms = SECOND / 1000;
        let scans = [scan(0, at(0.0, 0.0, 0.0)), scan(20 * ms, at(0.02, 0.0, 0.0))];
        let (trajectory, _) = Trajectory::new(vec![StampedPose::new(0, at(5.0, 0.0, 0.0))]);
        let truth = Truth::new(&trajectory, &scans);
        let found = truth.at(20 * ms).unwrap();
        assert!(is_near(found.pose, at(5.02, 0.0, 0.0)) && !found.is_measured);
        assert_eq!(truth.measured_at(20 * ms), None);
    }

    /// Two poses 0.2 s apart: the middle is measured. In another frame there is only one pose.
    #[test]
    fn dense_truth_is_interpolated_in_its_main_frame() {
        let pose = |stamp_ns, x_m, frame| StampedPose {
            frame,
            segment: frame,
            ..StampedPose::new(stamp_ns, at(x_m, 0.0, 0.0))
        };
        let poses = vec![pose(0, 1.0, 3), pose(SECOND / 5, 2.0, 3), pose(2 * SECOND, 50.0, 0)];
        let truth = Truth::new(&Trajectory::new(poses).0, &[]);
        assert_eq!(truth.measured_at(SECOND / 10), Some(at(1.5, 0.0, 0.0)));
        assert_eq!(truth.measured_at(2 * SECOND), None);
    }
}
