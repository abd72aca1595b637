//! Dead reckoning: wheels and yaw rates -> poses, while a log is being read.

use std::collections::VecDeque;

use dataset::{Pose2, StampedPose, wrap_angle};

use crate::samples::WheelSample;

/// Between wheel samples farther apart than this the motion is unknown \[ns\].
const MAX_GAP_NS: i64 = 1_000_000_000;

/// Integrates wheel speeds and yaw rates to poses, sample by sample.
///
/// The robot moves with the mean speed of its wheels in the direction of its heading. The heading
/// is the integral of the yaw rate. The yaw rate comes from an IMU, or, without an IMU, from the
/// difference of the wheel speeds over the track width.
///
/// The errors are not estimated. They are small over one revolution of a lidar, 0.05 to 0.2 s. For
/// the poses of a whole drive use [`fuse`](crate::fuse).
///
/// ```
/// use fuse::{DeadReckoning, WheelSample};
///
/// let mut dead_reckoning = DeadReckoning::new(Some(0.5));
/// for stamp_ns in [0, 1_000_000_000] {
///     let sample = WheelSample { stamp_ns, left_m_s: 2.0, right_m_s: 2.0 };
///     dead_reckoning.add_wheels(sample);
/// }
/// let poses = dead_reckoning.advance();
/// assert_eq!(poses[1].pose.x_m, 2.0);
/// ```
#[derive(Debug, Default)]
pub struct DeadReckoning {
    /// Distance between the wheels \[m\]; `None` if yaw rates come from an IMU.
    track_m: Option<f64>,
    /// The wheel samples that are still needed.
    wheels: VecDeque<WheelSample>,
    /// Stamps and yaw rates that are later than the pose.
    yaw_rates: VecDeque<(i64, f64)>,
    pose: Pose2,
    /// Stamp of the pose, and the yaw rate there.
    last: Option<(i64, f64)>,
}

impl DeadReckoning {
    /// Starts at the origin with heading 0. With `track_m`, the yaw rates are computed from the
    /// wheel speeds; without, they must be added with [`add_yaw_rate`](Self::add_yaw_rate).
    pub fn new(track_m: Option<f64>) -> Self {
        Self { track_m, ..Self::default() }
    }

    /// Adds a wheel sample. Samples that are not finite, or not later than the previous one, are
    /// ignored.
    pub fn add_wheels(&mut self, sample: WheelSample) {
        let is_later = |stamp_ns: i64| self.wheels.back().is_none_or(|w| w.stamp_ns < stamp_ns);
        let is_finite = (sample.left_m_s + sample.right_m_s).is_finite();
        if is_finite && is_later(sample.stamp_ns) {
            self.wheels.push_back(sample);
            if let Some(track_m) = self.track_m {
                let yaw_rate = (sample.right_m_s - sample.left_m_s) / track_m;
                self.yaw_rates.push_back((sample.stamp_ns, yaw_rate));
            }
        }
    }

    /// Adds a yaw rate. Rates that are not finite, or not later than the previous one, are ignored.
    pub fn add_yaw_rate(&mut self, stamp_ns: i64, yaw_rate_rad_s: f64) {
        let newest = self.yaw_rates.back().or(self.last.as_ref());
        if yaw_rate_rad_s.is_finite() && newest.is_none_or(|(ns, _)| *ns < stamp_ns) {
            self.yaw_rates.push_back((stamp_ns, yaw_rate_rad_s));
        }
    }

    /// Moves the pose to the newest wheel sample and returns the poses on the way, one at each yaw
    /// rate. Yaw rates without wheel samples around them give no pose.
    pub fn advance(&mut self) -> Vec<StampedPose> {
        let mut poses = Vec::new();
        let Some(newest) = self.wheels.back().map(|wheels| wheels.stamp_ns) else { return poses };
        while let Some(&(stamp_ns, rate)) = self.yaw_rates.front() {
            if newest < stamp_ns {
                break;
            }
            self.yaw_rates.pop_front();
            while self.wheels.get(1).is_some_and(|next| next.stamp_ns <= stamp_ns) {
                self.wheels.pop_front();
            }
            let speed = self.speed_m_s(stamp_ns);
            if let (Some((last_ns, last_rate)), Some(speed)) = (self.last, speed) {
                let secs = (stamp_ns - last_ns) as f64 * 1e-9;
                let turn_rad = 0.5 * (last_rate + rate) * secs;
                let (sin, cos) = libm::sincos(self.pose.heading_rad + 0.5 * turn_rad);
                self.pose = Pose2 {
                    x_m: self.pose.x_m + speed * secs * cos,
                    y_m: self.pose.y_m + speed * secs * sin,
                    heading_rad: wrap_angle(self.pose.heading_rad + turn_rad),
                };
            }
            self.last = Some((stamp_ns, rate));
            if speed.is_some() {
                poses.push(StampedPose::new(stamp_ns, self.pose));
            }
        }
        poses
    }

    /// Speed of the midpoint between the wheels \[m/s\], interpolated between the first two kept
    /// samples. `None` before the first sample and inside a gap.
    fn speed_m_s(&self, stamp_ns: i64) -> Option<f64> {
        let mean = |wheels: &WheelSample| 0.5 * (wheels.left_m_s + wheels.right_m_s);
        let first = self.wheels.front()?;
        if stamp_ns <= first.stamp_ns {
            return (stamp_ns == first.stamp_ns).then(|| mean(first));
        }
        let next = self.wheels.get(1)?;
        let gap_ns = next.stamp_ns.saturating_sub(first.stamp_ns);
        let share = (stamp_ns - first.stamp_ns) as f64 / gap_ns as f64;
        (gap_ns <= MAX_GAP_NS).then(|| mean(first) + share * (mean(next) - mean(first)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wheels(ms: i64, left_m_s: f64, right_m_s: f64) -> WheelSample {
        WheelSample { stamp_ns: ms * 1_000_000, left_m_s, right_m_s }
    }

    /// 1 m/s and 1 rad/s: a circle of radius 1 m. After 0.5 s the robot is at
    /// (sin 0.5, 1 - cos 0.5). Once with wheels only (0.75 and 1.25 m/s, 0.5 m apart), once with an
    /// IMU and wheels that only measure the speed.
    #[test]
    fn wheels_with_or_without_an_imu_follow_a_circle() {
        for track_m in [Some(0.5), None] {
            let mut dead_reckoning = DeadReckoning::new(track_m);
            let mut poses = Vec::new();
            for ms in (0..=500).step_by(10) {
                if ms % 20 == 0 {
                    let half_difference = if track_m.is_some() { 0.25 } else { 0.0 };
                    let sample = wheels(ms, 1.0 - half_difference, 1.0 + half_difference);
                    dead_reckoning.add_wheels(sample);
                }
                if track_m.is_none() {
                    dead_reckoning.add_yaw_rate(ms * 1_000_000, 1.0);
                }
                // Advancing in several parts gives the same poses as advancing once.
                if ms % 50 == 0 {
                    poses.extend(dead_reckoning.advance());
                }
            }
            assert_eq!(poses.len(), if track_m.is_some() { 26 } else { 51 });
            let end = poses.last().unwrap();
            assert_eq!(end.stamp_ns, 500_000_000);
            let (sin, cos) = 0.5f64.sin_cos();
            assert!((end.pose.x_m - sin).abs() < 1e-4, "{:?}", end.pose);
            assert!((end.pose.y_m - (1.0 - cos)).abs() < 1e-4);
            assert!((end.pose.heading_rad - 0.5).abs() < 1e-12);
        }
    }

    #[test]
    fn late_and_invalid_samples_are_ignored() {
        let mut dead_reckoning = DeadReckoning::new(None);
        for (ms, speed) in [(0, 1.0), (100, f64::NAN), (50, 1.0), (40, 9.0)] {
            dead_reckoning.add_wheels(wheels(ms, speed, speed));
        }
        for (ms, rate) in [(0, 0.0), (20, f64::NAN), (50, 0.0), (30, 9.0)] {
            dead_reckoning.add_yaw_rate(ms * 1_000_000, rate);
        }
        let poses = dead_reckoning.advance();
        assert_eq!(poses.iter().map(|p| p.stamp_ns / 1_000_000).collect::<Vec<_>>(), [0, 50]);
        assert!((poses[1].pose.x_m - poses[0].pose.x_m - 0.05).abs() < 1e-12);
    }

    #[test]
    fn a_gap_between_wheel_samples_gives_no_pose() {
        let mut dead_reckoning = DeadReckoning::new(None);
        for (ms, speed) in [(0, 1.0), (50, 1.0), (1100, 1.0), (1120, 3.0)] {
            dead_reckoning.add_wheels(wheels(ms, speed, speed));
        }
        for ms in [-10, 0, 50, 600, 1110] {
            dead_reckoning.add_yaw_rate(ms * 1_000_000, 0.0);
        }
        let stamps: Vec<_> =
            dead_reckoning.advance().iter().map(|p| p.stamp_ns / 1_000_000).collect();
        assert_eq!(
            stamps,
            [0, 50, 1110],
            "no pose at -10 (before the wheels) and 600 (in the gap)"
        );
    }
}
