//! The motion of the lidar during one scan.
//!
//! A return at time `t` is measured in the lidar frame at `t`. With `map_from_lidar(t)` as the pose
//! of the lidar, its position in the lidar frame at the stamp of the scan is
//! `map_from_lidar(stamp)^-1 * map_from_lidar(t) * p`. Only the motion during the scan matters.
//! Therefore the poses can be in any frame in which they do not jump.

use dataset::{StampedPose, wrap_angle};

/// The speed of a lidar during a scan, in its frame at the stamp of the scan.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LidarSpeed {
    /// Along x \[m/s\].
    pub x_m_s: f64,
    /// Along y \[m/s\].
    pub y_m_s: f64,
    /// Change of the heading \[rad/s\].
    pub heading_rad_s: f64,
}

/// The motion of the lidar during a scan, at constant speed between the known poses.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ScanMotion {
    /// In order of time, from before the first return to after the last. There is at least one.
    segments: Vec<Segment>,
}

/// A motion at constant speed, in the lidar frame at the stamp of the scan.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Segment {
    /// Start time relative to the stamp of the scan \[ns\].
    from_ns: i64,
    /// x, y \[m\] and heading \[rad\] at the start. The heading is not wrapped.
    start: [f64; 3],
    /// Change of x, y and heading per nanosecond.
    rate: [f64; 3],
}

impl ScanMotion {
    /// The motion between poses in order of time. There must be at least one pose.
    pub(crate) fn new(poses: &[&StampedPose], stamp_ns: i64) -> Self {
        let mut segments: Vec<Segment> = Vec::with_capacity(poses.len());
        let mut heading_rad = poses[0].pose.heading_rad;
        for (k, p) in poses.iter().enumerate() {
            let next = poses.get(k + 1).unwrap_or(p);
            let step_rad = wrap_angle(next.pose.heading_rad - p.pose.heading_rad);
            let step = [next.pose.x_m - p.pose.x_m, next.pose.y_m - p.pose.y_m, step_rad];
            let per_ns = match next.stamp_ns.saturating_sub(p.stamp_ns) {
                0 => 0.0,
                gap_ns => 1.0 / gap_ns as f64,
            };
            segments.push(Segment {
                from_ns: p.stamp_ns.saturating_sub(stamp_ns),
                start: [p.pose.x_m, p.pose.y_m, heading_rad],
                rate: step.map(|v| v * per_ns),
            });
            heading_rad += step_rad;
        }
        if 1 < segments.len() {
            // No segment starts at the last pose.
            segments.pop();
        }
        // Transform the segments to the lidar frame at the stamp.
        let in_map = Self { segments };
        let [x0, y0, heading0] = in_map.at(0);
        let mut segments = in_map.segments;
        let (sin, cos) = libm::sincos(heading0);
        let rotated = |[x, y]: [f64; 2]| [cos * x + sin * y, cos * y - sin * x];
        for Segment { start, rate, .. } in &mut segments {
            let [x, y] = rotated([start[0] - x0, start[1] - y0]);
            *start = [x, y, start[2] - heading0];
            let [x, y] = rotated([rate[0], rate[1]]);
            *rate = [x, y, rate[2]];
        }
        Self { segments }
    }

    /// The motion at a constant speed.
    pub(crate) fn constant(speed: &LidarSpeed) -> Self {
        let rate = [speed.x_m_s, speed.y_m_s, speed.heading_rad_s].map(|per_s| 1e-9 * per_s);
        Self { segments: vec![Segment { from_ns: 0, start: [0.0; 3], rate }] }
    }

    /// The pose of the lidar at a time relative to the stamp of the scan, in the lidar frame at the
    /// stamp: x, y \[m\] and heading \[rad\].
    #[inline]
    pub(crate) fn at(&self, ns: i64) -> [f64; 3] {
        let later = self.segments.iter().rev().find(|segment| segment.from_ns <= ns);
        later.unwrap_or(&self.segments[0]).at(ns)
    }
}

impl Segment {
    #[inline]
    fn at(&self, ns: i64) -> [f64; 3] {
        let since = (ns - self.from_ns) as f64;
        std::array::from_fn(|k| self.start[k] + since * self.rate[k])
    }
}
