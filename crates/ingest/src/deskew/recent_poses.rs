//! The poses of the lidar around the scans that are being deskewed.

use std::collections::VecDeque;

use dataset::{Pose2, StampedPose};

use crate::deskew::motion::ScanMotion;
use crate::pose::jumps::{MIN_JUMP_M, is_too_fast, secs};

/// Between poses farther apart than this the motion is unknown \[ns\]. A robot that starts to turn
/// with 1 rad/s^2 differs after 0.25 s by 1/8 a t^2 = 0.008 rad from a motion at constant rate.
const MAX_GAP_NS: i64 = 250_000_000;
/// Poses are kept for this time before the last released scan \[ns\].
const KEPT_NS: i64 = 10_000_000_000;

/// A pose that is earlier than the newest one by more than this is not late: the clock stepped back, or
/// the newest one is wrong \[ns\].
const LATE_NS: i64 = 500_000_000;

/// The most recent poses of the lidar, in a frame in which they do not jump.
#[derive(Debug)]
pub(crate) struct RecentPoses {
    /// In order of time.
    poses: VecDeque<StampedPose>,
    max_speed_m_s: f64,
    /// The stamp of the last added pose \[ns\].
    last_ns: i64,
}

impl RecentPoses {
    /// For a robot with this maximum speed.
    pub(crate) fn new(max_speed_m_s: f64) -> Self {
        Self { poses: VecDeque::new(), max_speed_m_s, last_ns: i64::MIN }
    }

    /// Adds a pose, usually the latest. If a pose with the same stamp exists, the new one is
    /// ignored. If the clock has stepped back, the later poses belong to another part of the drive and
    /// are removed.
    pub(crate) fn push(&mut self, stamp_ns: i64, pose: Pose2) {
        self.last_ns = stamp_ns;
        let newest_ns = self.poses.back().map_or(stamp_ns, |back| back.stamp_ns);
        if LATE_NS < newest_ns.saturating_sub(stamp_ns) {
            self.poses.truncate(self.poses.partition_point(|p| p.stamp_ns <= stamp_ns));
        }
        let at = match self.poses.back() {
            Some(back) if stamp_ns <= back.stamp_ns => {
                self.poses.partition_point(|p| p.stamp_ns < stamp_ns)
            }
            _ => self.poses.len(),
        };
        if self.poses.get(at).is_none_or(|p| p.stamp_ns != stamp_ns) {
            self.poses.insert(at, StampedPose::new(stamp_ns, pose));
        }
    }

    /// Whether the last added pose is at or after a stamp. A single pose far in the future counts
    /// only until the next pose is added.
    pub(crate) fn has_reached(&self, stamp_ns: i64) -> bool {
        stamp_ns <= self.last_ns
    }

    /// Removes poses that no scan from this stamp on needs.
    pub(crate) fn forget_before(&mut self, stamp_ns: i64) {
        let needed = stamp_ns.saturating_sub(KEPT_NS);
        while self.poses.front().is_some_and(|pose| pose.stamp_ns < needed) {
            self.poses.pop_front();
        }
    }

    /// The motion of the lidar from one time to another, relative to the stamp of a scan. It is
    /// `None` if poses are missing, too far apart, or jump.
    pub(crate) fn motion(&self, stamp_ns: i64, from_ns: i64, to_ns: i64) -> Option<ScanMotion> {
        // The last pose at or before the start, and the first pose at or after the end.
        let first = self.poses.partition_point(|p| p.stamp_ns <= from_ns).checked_sub(1)?;
        let last = self.poses.partition_point(|p| p.stamp_ns < to_ns);
        self.poses.get(last)?;
        // `last` is before `first` for a scan without duration at the stamp of a pose.
        let last = last.max(first);
        if !(first..last).all(|k| self.is_motion_known(k)) {
            return None;
        }
        let poses: Vec<&StampedPose> = self.poses.range(first..=last).collect();
        Some(ScanMotion::new(&poses, stamp_ns))
    }

    /// Whether the motion from pose `k` to the next one is known.
    fn is_motion_known(&self, k: usize) -> bool {
        let (a, b) = (&self.poses[k], &self.poses[k + 1]);
        b.stamp_ns.saturating_sub(a.stamp_ns) <= MAX_GAP_NS
            && !is_too_fast(a, b, self.max_speed_m_s)
            && !self.jumps(k)
    }

    /// Whether pose `k + 1` jumps: it is more than [`MIN_JUMP_M`] away from where the motion before and
    /// the motion after lead. Between poses that are at most 0.25 s apart, a vehicle that brakes with
    /// 10 m/s^2 is 0.6 m away.
    fn jumps(&self, k: usize) -> bool {
        let (a, b) = (&self.poses[k], &self.poses[k + 1]);
        let [x_m, y_m] = step_m(a, b);
        if a.pose.distance_m(&b.pose) <= MIN_JUMP_M {
            return false;
        }
        let pair = |k: usize| Some((self.poses.get(k)?, self.poses.get(k + 1)?));
        let others = [k.checked_sub(1).and_then(pair), pair(k + 1)].into_iter().flatten();
        let mut deviations_m = others
            .filter(|(c, d)| d.stamp_ns.saturating_sub(c.stamp_ns) <= MAX_GAP_NS)
            .map(|(c, d)| {
                let share = secs(a, b) / secs(c, d);
                let [dx, dy] = step_m(c, d);
                ((x_m - share * dx).powi(2) + (y_m - share * dy).powi(2)).sqrt()
            })
            .peekable();
        deviations_m.peek().is_some() && deviations_m.all(|deviation_m| MIN_JUMP_M < deviation_m)
    }
}

fn step_m(a: &StampedPose, b: &StampedPose) -> [f64; 2] {
    [b.pose.x_m - a.pose.x_m, b.pose.y_m - a.pose.y_m]
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn pose(x_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m: 0.0, heading_rad }
    }

    fn recent_poses(poses: &[(i64, Pose2)]) -> RecentPoses {
        let mut recent_poses = RecentPoses::new(15.0);
        poses.iter().for_each(|&(ms, pose)| recent_poses.push(ms * MS, pose));
        recent_poses
    }

    /// 1 m/s along x and 1 rad/s: after 20 ms the lidar is at x = 0.02 m with heading 0.02 rad.
    #[test]
    fn the_motion_is_relative_to_the_stamp() {
        let poses = [(0, pose(0.0, 0.0)), (50, pose(0.05, 0.05)), (100, pose(0.1, 0.1))];
        let steady = recent_poses(&poses);
        let motion = steady.motion(0, 0, 90 * MS).unwrap();
        for ms in [0, 20, 50, 90] {
            let ([x, y, heading], expected) = (motion.at(ms * MS), ms as f64 * 1e-3);
            assert!((x - expected).abs() < 1e-12 && y.abs() < 1e-12);
            assert!((heading - expected).abs() < 1e-12);
        }
        // At 10 ms the heading is 0.01 rad, so 0.08 m along x become 0.08 m (cos 0.01, -sin 0.01).
        let motion = steady.motion(10 * MS, 10 * MS, 90 * MS).unwrap();
        let [x, y, heading] = motion.at(80 * MS);
        assert!((x - 0.08 * 0.01f64.cos()).abs() < 1e-12);
        assert!((y + 0.08 * 0.01f64.sin()).abs() < 1e-12);
        assert!((heading - 0.08).abs() < 1e-12);
    }

    #[test]
    fn the_motion_is_unknown_in_gaps_outside_of_the_poses_and_across_jumps() {
        let poses = [(0, pose(0.0, 3.1)), (250, pose(0.0, -3.1)), (501, pose(0.0, 3.1))];
        let sparse = recent_poses(&poses);
        // Across pi the heading changes by 0.083 rad, not by 6.2 rad.
        let [_, _, turn] = sparse.motion(0, 0, 250 * MS).unwrap().at(250 * MS);
        assert!((turn - (std::f64::consts::TAU - 6.2)).abs() < 1e-12);
        assert_eq!(sparse.motion(0, 0, 251 * MS), None, "a gap of 251 ms");
        assert_eq!(sparse.motion(0, -1, 100 * MS), None, "before the first pose");
        assert_eq!(sparse.motion(400 * MS, 400 * MS, 502 * MS), None, "after the last pose");
        assert_eq!(sparse.motion(250 * MS, 250 * MS, 250 * MS).unwrap().at(0), [0.0; 3]);
        // With 15 m/s the limit for 50 ms is 0.75 m plus the tolerance of 0.1 m.
        let step = |x_m| {
            let poses = [(0, pose(0.0, 0.0)), (50, pose(x_m, 0.0))];
            recent_poses(&poses).motion(0, 0, 40 * MS)
        };
        assert!(step(0.84).is_some() && step(0.86).is_none());
    }

    /// The clock steps back by 2 s, while the robot drives on with 1 m/s. The motion is the one after
    /// the step.
    #[test]
    fn poses_from_before_a_step_of_the_clock_are_not_used() {
        let mut recent_poses = RecentPoses::new(15.0);
        for k in 0..100 {
            let stamp_ms = if k < 60 { 50 * k } else { 50 * k - 2000 };
            recent_poses.push(stamp_ms * MS, pose(0.05 * k as f64, 0.0));
        }
        // The motion at 1.5 s, half a second after the step, and not that before it.
        let [x, ..] = recent_poses.motion(1500 * MS, 1500 * MS, 1590 * MS).unwrap().at(90 * MS);
        assert!((x - 0.09).abs() < 1e-12, "{x}");
        assert_eq!(recent_poses.poses.len(), 21 + 39);
    }

    /// A robot at 1 m/s and 10 Hz, corrected by 1.3 m: 14 m/s, which is below the maximum speed. A
    /// vehicle at 14 m/s does not jump.
    #[test]
    fn the_motion_is_unknown_across_a_jump_that_is_slower_than_the_maximum_speed() {
        let steps = |step_m: fn(i64) -> f64| {
            let mut x_m = 0.0;
            let poses: Vec<_> = (0..20)
                .map(|k| {
                    x_m += step_m(k);
                    (100 * k, pose(x_m, 0.0))
                })
                .collect();
            recent_poses(&poses)
        };
        let corrected = steps(|k| if k == 10 { 1.4 } else { 0.1 });
        assert_eq!(corrected.motion(910 * MS, 910 * MS, 1000 * MS), None);
        assert!(corrected.motion(810 * MS, 810 * MS, 900 * MS).is_some());
        assert!(corrected.motion(1010 * MS, 1010 * MS, 1100 * MS).is_some());
        assert!(steps(|_| 1.4).motion(910 * MS, 910 * MS, 1000 * MS).is_some());
        // It starts to move: only the motion after explains the step.
        let starts = steps(|k| if k < 10 { 0.0 } else { 1.4 });
        assert!(starts.motion(910 * MS, 910 * MS, 1000 * MS).is_some());
    }

    #[test]
    fn poses_can_be_added_in_any_order() {
        let mut recent_poses = recent_poses(&[(0, pose(0.0, 0.0)), (100, pose(0.1, 0.0))]);
        assert!(recent_poses.has_reached(100 * MS));
        recent_poses.push(50 * MS, pose(0.03, 0.0));
        assert!(!recent_poses.has_reached(100 * MS));
        recent_poses.push(1_000_000 * MS, pose(9.0, 0.0));
        recent_poses.push(150 * MS, pose(0.1, 0.0));
        recent_poses.push(150 * MS, pose(7.0, 0.0));
        let motion = recent_poses.motion(0, 0, 140 * MS).unwrap();
        assert!((motion.at(50 * MS)[0] - 0.03).abs() < 1e-12);
        assert!((motion.at(75 * MS)[0] - 0.065).abs() < 1e-12);
        recent_poses.forget_before(10_100 * MS);
        assert_eq!(recent_poses.motion(0, 0, 140 * MS), None);
        assert!(recent_poses.motion(100 * MS, 100 * MS, 140 * MS).is_some());
    }
}
