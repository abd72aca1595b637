//! The ground truth at the stamps of scans.

use std::collections::BTreeMap;

use dataset::{Pose2, StampedPose, Trajectory};

use super::input::ScanPoses;

/// Between two true poses at most this far apart, the truth is interpolated, if the median distance of
/// true poses is not more \[ns\]. With an acceleration of 1 m/s^2, the middle of 0.25 s is off by 8 mm.
///
/// Truth with a larger median is sparse: poses that are near in time are then an exception, and often
/// the stamps are wrong.
pub const MAX_INTERPOLATION_NS: i64 = 250_000_000;
/// The truth is carried along the optimized trajectory over at most this time \[ns\].
pub const MAX_CARRY_NS: i64 = 4_000_000_000;
/// A true pose is doubtful if the truth contradicts scan matching by more than this before and after it
/// \[m\], or by more than [`DOUBTFUL_DEG`]. Over the step between two true poses, scan matching is an
/// order of magnitude better.
pub const DOUBTFUL_M: f64 = 0.5;
/// See [`DOUBTFUL_M`] \[deg\].
pub const DOUBTFUL_DEG: f64 = 5.0;
/// Over a longer step, scan matching says nothing about the truth \[m\].
const MAX_STEP_M: f64 = 5.0;
/// Most doubtful true poses in a row. More would be a stretch of its own.
const MAX_DOUBTFUL: usize = 5;
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
    /// Those of them that are not doubtful.
    trusted: Trajectory,
    /// The optimized trajectory.
    optimized: Trajectory,
    /// Longest time between two true poses for an interpolation \[ns\]; 0 if the truth is sparse.
    max_gap_ns: i64,
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
        let of_frame: Vec<StampedPose> =
            truth.poses().iter().filter(|p| p.frame == frame).copied().collect();
        let trajectory = |poses: Vec<StampedPose>| Trajectory::new(poses).0;
        let optimized = scans.iter().map(|s| StampedPose::new(s.stamp_ns, s.optimized));
        let doubtful = doubtful(&of_frame, &trajectory(matched_at_every_scan(scans)));
        let trusted = of_frame.iter().zip(doubtful).filter(|(_, doubtful)| !doubtful);
        Self {
            trusted: trajectory(trusted.map(|(pose, _)| *pose).collect()),
            optimized: trajectory(optimized.collect()),
            max_gap_ns: max_gap_ns(&of_frame),
            poses: trajectory(of_frame),
        }
    }

    /// Number of true poses that contradict scan matching, in the time of the drive.
    pub fn n_doubtful(&self) -> usize {
        self.poses.poses().len() - self.trusted.poses().len()
    }

    /// The same truth with the doubtful poses.
    #[must_use]
    pub fn with_doubtful(&self) -> Self {
        Self { trusted: self.poses.clone(), ..self.clone() }
    }

    /// The truth at a stamp, if it is measured there, doubtful or not. See [`TruePose::is_measured`].
    pub fn measured_at(&self, stamp_ns: i64) -> Option<Pose2> {
        self.poses.pose_at(stamp_ns, self.max_gap_ns).ok()
    }

    /// The truth at the stamp of a scan, by the true poses that are not doubtful.
    pub fn at(&self, stamp_ns: i64) -> Option<TruePose> {
        if let Ok(pose) = self.trusted.pose_at(stamp_ns, self.max_gap_ns) {
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
        let poses = self.trusted.poses();
        let after = poses.partition_point(|p| p.stamp_ns < stamp_ns);
        let gap = |p: &&StampedPose| p.stamp_ns.abs_diff(stamp_ns);
        let neighbours = [after.checked_sub(1).and_then(|k| poses.get(k)), poses.get(after)];
        let nearest = neighbours.into_iter().flatten().min_by_key(gap)?;
        (gap(&nearest) <= MAX_CARRY_NS.unsigned_abs()).then_some(*nearest)
    }
}

/// [`MAX_INTERPOLATION_NS`], or 0 if the truth is sparse.
fn max_gap_ns(truth: &[StampedPose]) -> i64 {
    let mut gaps: Vec<i64> =
        truth.windows(2).map(|w| w[1].stamp_ns.saturating_sub(w[0].stamp_ns)).collect();
    gaps.sort_unstable();
    match gaps.get(gaps.len() / 2) {
        Some(&median) if median <= MAX_INTERPOLATION_NS => MAX_INTERPOLATION_NS,
        _ => 0,
    }
}

/// The poses by scan matching at all scans. Since the last registered scan, the robot has moved by a
/// few decimetres at most: this step is taken from the optimized trajectory.
fn matched_at_every_scan(scans: &[ScanPoses]) -> Vec<StampedPose> {
    let mut last: Option<(Pose2, Pose2)> = None;
    let matched = scans.iter().filter_map(|scan| {
        if let Some(matched) = scan.scan_matched {
            last = Some((matched, scan.optimized));
        }
        let (matched, optimized) = last?;
        let pose = matched * (optimized.inverse() * scan.optimized);
        Some(StampedPose::new(scan.stamp_ns, pose))
    });
    matched.collect()
}

/// Which true poses are doubtful: the step to them contradicts scan matching, and without them the
/// truth before and after agrees with it.
fn doubtful(truth: &[StampedPose], matched: &Trajectory) -> Vec<bool> {
    let agrees = |a: usize, b: usize| -> Option<bool> {
        let (a, b) = (&truth[a], &truth[b]);
        let matched = |of: &StampedPose| matched.pose_at(of.stamp_ns, MAX_SCAN_GAP_NS).ok();
        let (from, to) = (matched(a)?, matched(b)?);
        if MAX_STEP_M < a.pose.distance_m(&b.pose) || a.segment != b.segment {
            return None;
        }
        let (step, expected) = (a.pose.inverse() * b.pose, from.inverse() * to);
        let is_turned = DOUBTFUL_DEG < step.heading_difference_rad(&expected).to_degrees();
        Some(step.distance_m(&expected) <= DOUBTFUL_M && !is_turned)
    };
    let mut doubtful = vec![false; truth.len()];
    let mut k = 0;
    while k + 1 < truth.len() {
        let mut next = k + 1;
        if agrees(k, next) == Some(false) {
            let last = (k + 1 + MAX_DOUBTFUL).min(truth.len() - 1);
            if let Some(after) = (k + 2..=last).find(|&after| agrees(k, after) == Some(true)) {
                doubtful[k + 1..after].fill(true);
                next = after;
            }
        }
        k = next;
    }
    doubtful
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

    /// Two poses 0.1 s apart in a truth with a pose each second: nothing is interpolated.
    #[test]
    fn sparse_truth_is_not_interpolated() {
        let pose = |stamp_ns| StampedPose::new(stamp_ns, at(1.0, 0.0, 0.0));
        let stamps = [0, SECOND, 2 * SECOND, 2 * SECOND + SECOND / 10, 3 * SECOND, 4 * SECOND];
        let truth = Truth::new(&Trajectory::new(stamps.map(pose).into()).0, &[]);
        assert_eq!(truth.measured_at(2 * SECOND + SECOND / 20), None);
        assert!(truth.measured_at(2 * SECOND + SECOND / 10).is_some());
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

    /// A true pose each second while the robot drives 1 m/s along x, and every other scan is registered.
    /// Those at 4 and 5 s are turned by
    /// 11 deg, and that at 12 s is 0.6 m to the left. From 16 s on, the truth jumps by 2 m for good.
    #[test]
    fn true_poses_that_contradict_scan_matching_are_doubtful() {
        let on_line = |k: usize| at(k as f64, 0.0, 0.0);
        let scans: Vec<ScanPoses> = (0..20)
            .map(|k| ScanPoses {
                scan_matched: (k % 2 == 0).then(|| on_line(k)),
                ..scan(k as i64 * SECOND, on_line(k))
            })
            .collect();
        let measured = |k: usize| match k {
            4 | 5 => at(k as f64, 0.0, 11.0),
            12 => at(12.0, 0.6, 0.0),
            16.. => at(k as f64, 2.0, 0.0),
            _ => on_line(k),
        };
        let poses = (0..20).map(|k| StampedPose::new(k as i64 * SECOND, measured(k))).collect();
        let truth = Truth::new(&Trajectory::new(poses).0, &scans);
        assert_eq!(truth.n_doubtful(), 3);
        for (k, &ScanPoses { stamp_ns, .. }) in scans.iter().enumerate() {
            let found = truth.at(stamp_ns).unwrap();
            let is_doubtful = [4, 5, 12].contains(&k);
            let expected = if is_doubtful { on_line(k) } else { measured(k) };
            assert!(is_near(found.pose, expected) && found.is_measured != is_doubtful, "{k}");
            assert_eq!(truth.measured_at(stamp_ns), Some(measured(k)));
            assert_eq!(truth.with_doubtful().at(stamp_ns).unwrap().pose, measured(k));
        }
    }
}
