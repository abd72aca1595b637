//! Scans taken on the move -> scans as if taken at once.
//!
//! A return of time `t` was measured in the lidar frame of that time. With `T(t)` the lidar's pose
//! then, it lies at `T(stamp)^-1 T(t) p` in the lidar frame of the scan's stamp. Only how the lidar
//! moved within the turn counts, so that poses of any frame that does not jump will do.

use std::collections::VecDeque;

use dataset::{Pose2, Scan, StampedPose, wrap_angle};

/// Poses farther apart than this tell too little of the motion between them \[ns\]: over 0.25 s a
/// turn that starts or ends with 1 rad/s^2 departs from a steady one by 1/8 a t^2 = 0.008 rad.
const MAX_GAP_NS: i64 = 250_000_000;
/// A step of up to this is no jump, however short the time \[m\]: poses are rounded, and stamped late.
const STEP_TOLERANCE_M: f64 = 0.1;
/// How long a pose is remembered after the last scan asked for it \[ns\].
const KEPT_NS: i64 = 10_000_000_000;

/// Where the lidar was of late, in a frame that does not jump.
#[derive(Debug)]
pub(crate) struct Track {
    /// In order of time.
    poses: VecDeque<StampedPose>,
    max_speed_m_s: f64,
    /// The stamp of the pose that came last \[ns\].
    last_ns: i64,
}

impl Track {
    /// A robot that is not faster than this.
    pub(crate) fn new(max_speed_m_s: f64) -> Self {
        Self { poses: VecDeque::new(), max_speed_m_s, last_ns: i64::MIN }
    }

    /// Adds a pose, most often the latest; of poses with one stamp the first stays.
    pub(crate) fn push(&mut self, stamp_ns: i64, pose: Pose2) {
        self.last_ns = stamp_ns;
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

    /// Whether the poses have come to a stamp. Of a single pose far ahead no more is heard with the
    /// next.
    pub(crate) fn has_reached(&self, stamp_ns: i64) -> bool {
        stamp_ns <= self.last_ns
    }

    /// Forgets poses that no scan from a stamp on needs.
    pub(crate) fn forget_before(&mut self, stamp_ns: i64) {
        let needed = stamp_ns.saturating_sub(KEPT_NS);
        while self.poses.front().is_some_and(|pose| pose.stamp_ns < needed) {
            self.poses.pop_front();
        }
    }

    /// How the lidar moved from one time to another, around the stamp of a scan; none where poses
    /// are missing, too far apart, or jump.
    pub(crate) fn smear(&self, stamp_ns: i64, from_ns: i64, to_ns: i64) -> Option<Smear> {
        // The last pose at or before the start, and the first at or after the end.
        let first = self.poses.partition_point(|p| p.stamp_ns <= from_ns).checked_sub(1)?;
        let last = self.poses.partition_point(|p| p.stamp_ns < to_ns);
        self.poses.get(last)?;
        // A scan that takes no time, at the stamp of a pose.
        let poses: Vec<&StampedPose> = self.poses.range(first..=last.max(first)).collect();
        if !poses.windows(2).all(|pair| self.follows(pair[0], pair[1])) {
            return None;
        }
        Some(Smear::new(&poses, stamp_ns))
    }

    /// Whether the motion between two poses is known.
    fn follows(&self, a: &StampedPose, b: &StampedPose) -> bool {
        b.stamp_ns.saturating_sub(a.stamp_ns) <= MAX_GAP_NS && !is_jump(a, b, self.max_speed_m_s)
    }
}

/// Whether no robot of this speed gets from one pose to the next.
pub(crate) fn is_jump(a: &StampedPose, b: &StampedPose, max_speed_m_s: f64) -> bool {
    let secs = b.stamp_ns.saturating_sub(a.stamp_ns) as f64 * 1e-9;
    max_speed_m_s * secs + STEP_TOLERANCE_M < a.pose.distance_m(&b.pose)
}

/// How the lidar moved during a scan: steadily between the poses there are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Smear {
    /// In order of time, from before the first return to after the last. At least one.
    stretches: Vec<Stretch>,
}

/// Steady motion, in the lidar frame of the scan's stamp.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stretch {
    /// When it begins, since the scan's stamp \[ns\].
    from_ns: i64,
    /// x, y \[m\] and heading \[rad\] then; headings go on beyond half a turn.
    start: [f64; 3],
    /// What of these is added in a nanosecond.
    rate: [f64; 3],
}

impl Smear {
    /// PacketGap poses in order of time, not none, around the stamp.
    fn new(poses: &[&StampedPose], stamp_ns: i64) -> Self {
        let mut stretches: Vec<Stretch> = Vec::with_capacity(poses.len());
        let mut heading_rad = poses[0].pose.heading_rad;
        for (k, p) in poses.iter().enumerate() {
            let next = poses.get(k + 1).unwrap_or(p);
            let step_rad = wrap_angle(next.pose.heading_rad - p.pose.heading_rad);
            let step = [next.pose.x_m - p.pose.x_m, next.pose.y_m - p.pose.y_m, step_rad];
            let per_ns = match next.stamp_ns.saturating_sub(p.stamp_ns) {
                0 => 0.0,
                gap_ns => 1.0 / gap_ns as f64,
            };
            stretches.push(Stretch {
                from_ns: p.stamp_ns.saturating_sub(stamp_ns),
                start: [p.pose.x_m, p.pose.y_m, heading_rad],
                rate: step.map(|v| v * per_ns),
            });
            heading_rad += step_rad;
        }
        if 1 < stretches.len() {
            // At the last pose no motion begins.
            stretches.pop();
        }
        // Into the frame of the stamp.
        let smear = Self { stretches };
        let [x0, y0, heading0] = smear.at(0);
        let mut stretches = smear.stretches;
        let (sin, cos) = libm::sincos(heading0);
        let turned = |[x, y]: [f64; 2]| [cos * x + sin * y, cos * y - sin * x];
        for Stretch { start, rate, .. } in &mut stretches {
            let [x, y] = turned([start[0] - x0, start[1] - y0]);
            *start = [x, y, start[2] - heading0];
            let [x, y] = turned([rate[0], rate[1]]);
            *rate = [x, y, rate[2]];
        }
        Self { stretches }
    }

    /// x, y \[m\] and heading \[rad\] of the lidar in its frame at the scan's stamp, so long after
    /// that.
    #[inline]
    pub(crate) fn at(&self, ns: i64) -> [f64; 3] {
        let later = self.stretches.iter().rev().find(|stretch| stretch.from_ns <= ns);
        later.unwrap_or(&self.stretches[0]).at(ns)
    }
}

impl Stretch {
    #[inline]
    fn at(&self, ns: i64) -> [f64; 3] {
        let since = (ns - self.from_ns) as f64;
        std::array::from_fn(|k| self.start[k] + since * self.rate[k])
    }
}

/// A scan as its message has it, with the times of its returns.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct TimedScan {
    pub(crate) scan: Scan,
    /// When each return was measured, since the scan's stamp \[ns\], `(n_returns,)`; empty where the
    /// message does not tell.
    pub(crate) times_ns: Vec<i64>,
}

impl TimedScan {
    /// The times of the first and the last return, the stamp included \[ns since the epoch\]; none
    /// where all are of one moment, or not told.
    pub(crate) fn range_ns(&self) -> Option<(i64, i64)> {
        let (min, max) = (self.times_ns.iter().min()?, self.times_ns.iter().max()?);
        let stamp_ns = self.scan.stamp_ns;
        let is_one_moment = min == max;
        (!is_one_moment)
            .then(|| (stamp_ns.saturating_add(*min.min(&0)), stamp_ns.saturating_add(*max.max(&0))))
    }

    /// The scan with its returns where they would have been seen from at the stamp.
    pub(crate) fn deskewed(mut self, smear: &Smear) -> Scan {
        let points = self.scan.x_m.iter_mut().zip(&mut self.scan.y_m);
        for ((x_m, y_m), &ns) in points.zip(&self.times_ns) {
            let [dx, dy, turned] = smear.at(ns);
            let (sin, cos) = libm::sincos(turned);
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

    const MS: i64 = 1_000_000;

    fn pose(x_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m: 0.0, heading_rad }
    }

    fn track(poses: &[(i64, Pose2)]) -> Track {
        let mut track = Track::new(15.0);
        poses.iter().for_each(|&(ms, pose)| track.push(ms * MS, pose));
        track
    }

    /// 1 m/s along x and 1 rad/s: at 20 ms the lidar is 2 cm ahead of where it was at 0 and turned
    /// by 0.02 rad; between poses at 0 and 50, and at 50 and 100 ms, alike.
    #[test]
    fn motion_is_told_from_the_stamp() {
        let steady = track(&[(0, pose(0.0, 0.0)), (50, pose(0.05, 0.05)), (100, pose(0.1, 0.1))]);
        let smear = steady.smear(0, 0, 90 * MS).unwrap();
        for ms in [0, 20, 50, 90] {
            let ([x, y, heading], expected) = (smear.at(ms * MS), ms as f64 * 1e-3);
            assert!((x - expected).abs() < 1e-12 && y.abs() < 1e-12);
            assert!((heading - expected).abs() < 1e-12);
        }
        // From 10 ms on, where the lidar looks along 0.01 rad: 0.08 m (cos 0.01, -sin 0.01).
        let smear = steady.smear(10 * MS, 10 * MS, 90 * MS).unwrap();
        let [x, y, heading] = smear.at(80 * MS);
        assert!((x - 0.08 * 0.01f64.cos()).abs() < 1e-12);
        assert!((y + 0.08 * 0.01f64.sin()).abs() < 1e-12);
        assert!((heading - 0.08).abs() < 1e-12);
    }

    #[test]
    fn where_motion_is_not_known_there_is_none() {
        let poses = [(0, pose(0.0, 3.1)), (250, pose(0.0, -3.1)), (501, pose(0.0, 3.1))];
        let sparse = track(&poses);
        // Over the seam of the heading: 0.083 rad, not 6.2.
        let [_, _, turned] = sparse.smear(0, 0, 250 * MS).unwrap().at(250 * MS);
        assert!((turned - (std::f64::consts::TAU - 6.2)).abs() < 1e-12);
        assert_eq!(sparse.smear(0, 0, 251 * MS), None, "a gap of 251 ms");
        assert_eq!(sparse.smear(0, -1, 100 * MS), None, "before the first");
        assert_eq!(sparse.smear(400 * MS, 400 * MS, 502 * MS), None, "after the last");
        assert_eq!(sparse.smear(250 * MS, 250 * MS, 250 * MS).unwrap().at(0), [0.0; 3]);
        // 0.86 m in 50 ms are more than 15 m/s allow, which is 0.75 m and the tolerance.
        let jump = |x_m| track(&[(0, pose(0.0, 0.0)), (50, pose(x_m, 0.0))]).smear(0, 0, 40 * MS);
        assert!(jump(0.84).is_some() && jump(0.86).is_none());
    }

    #[test]
    fn poses_in_any_order_and_one_far_ahead() {
        let mut late = track(&[(0, pose(0.0, 0.0)), (100, pose(0.1, 0.0))]);
        assert!(late.has_reached(100 * MS));
        late.push(50 * MS, pose(0.03, 0.0));
        assert!(!late.has_reached(100 * MS));
        late.push(1_000_000 * MS, pose(9.0, 0.0));
        late.push(150 * MS, pose(0.1, 0.0));
        late.push(150 * MS, pose(7.0, 0.0));
        let smear = late.smear(0, 0, 140 * MS).unwrap();
        assert!((smear.at(50 * MS)[0] - 0.03).abs() < 1e-12);
        assert!((smear.at(75 * MS)[0] - 0.065).abs() < 1e-12);
        late.forget_before(10_100 * MS);
        assert_eq!(late.smear(0, 0, 140 * MS), None);
        assert!(late.smear(100 * MS, 100 * MS, 140 * MS).is_some());
    }

    /// Ahead lies a wall at x = 5 m. A lidar that drives at it with 1 m/s sees it at 5 m at first and
    /// 0.1 s later at 4.9 m.
    #[test]
    fn a_wall_is_straight_again() {
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
        let smear = track(&[(0, pose(0.0, 0.0)), (100, pose(0.1, 0.0))]).smear(0, 0, 100 * MS);
        let scan = timed.deskewed(&smear.unwrap());
        assert!(scan.x_m.iter().all(|x| (x - 5.0).abs() < 1e-6), "{:?}", scan.x_m);
        assert_eq!(scan.y_m, [1.0, 0.0, -1.0]);
    }
}
