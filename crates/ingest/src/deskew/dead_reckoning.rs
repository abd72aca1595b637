//! Wheels and IMU -> how the robot moves from one moment to the next, while the log is being read.
//!
//! Dead reckoning: the mean speed of the wheels along the heading, which the yaw rate of the IMU
//! turns, or without an IMU the difference of the wheels over the track. What a turn of the lidar
//! takes, 0.05 to 0.2 s, is too short for its errors to count; the poses of the drive are fused from
//! the whole of it.

use std::collections::VecDeque;

use dataset::{Pose2, StampedPose, wrap_angle};
use fuse::WheelSample;

/// Readings farther apart than this tell too little of the motion between them \[ns\].
const MAX_GAP_NS: i64 = 1_000_000_000;

/// What has been read and where it has led.
#[derive(Debug, Default)]
pub(crate) struct DeadReckoning {
    /// Distance between the wheels \[m\]; with an IMU, none.
    track_m: Option<f64>,
    /// Wheels from the last one passed on.
    wheels: VecDeque<WheelSample>,
    /// Stamp and yaw rate, later than the pose.
    yaw_rates: VecDeque<(i64, f64)>,
    pose: Pose2,
    /// The last stamp the pose was moved to, with the yaw rate there.
    last: Option<(i64, f64)>,
}

impl DeadReckoning {
    /// By wheels with this track, or by wheels and IMU without.
    pub(crate) fn new(track_m: Option<f64>) -> Self {
        Self { track_m, ..Self::default() }
    }

    pub(crate) fn add_wheels(&mut self, sample: WheelSample) {
        let is_later = |stamp_ns: i64| self.wheels.back().is_none_or(|w| w.stamp_ns < stamp_ns);
        let is_finite = (sample.left_m_per_s + sample.right_m_per_s).is_finite();
        if is_finite && is_later(sample.stamp_ns) {
            self.wheels.push_back(sample);
            if let Some(track_m) = self.track_m {
                let yaw_rate = (sample.right_m_per_s - sample.left_m_per_s) / track_m;
                self.yaw_rates.push_back((sample.stamp_ns, yaw_rate));
            }
        }
    }

    pub(crate) fn add_yaw_rate(&mut self, stamp_ns: i64, rad_s: f64) {
        let newest = self.yaw_rates.back().or(self.last.as_ref());
        if rad_s.is_finite() && newest.is_none_or(|(ns, _)| *ns < stamp_ns) {
            self.yaw_rates.push_back((stamp_ns, rad_s));
        }
    }

    /// The poses that what was read leads on to.
    pub(crate) fn advance(&mut self) -> Vec<StampedPose> {
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
            let speed = self.speed_at(stamp_ns);
            if let (Some((last_ns, last_rate)), Some(speed)) = (self.last, speed) {
                let secs = (stamp_ns - last_ns) as f64 * 1e-9;
                let turned = 0.5 * (last_rate + rate) * secs;
                let (sin, cos) = libm::sincos(self.pose.heading_rad + 0.5 * turned);
                self.pose = Pose2 {
                    x_m: self.pose.x_m + speed * secs * cos,
                    y_m: self.pose.y_m + speed * secs * sin,
                    heading_rad: wrap_angle(self.pose.heading_rad + turned),
                };
            }
            self.last = Some((stamp_ns, rate));
            if speed.is_some() {
                poses.push(StampedPose::new(stamp_ns, self.pose));
            }
        }
        poses
    }

    /// Speed of the middle between the wheels \[m/s\], between the first two samples; none before the
    /// first and in a gap.
    fn speed_at(&self, stamp_ns: i64) -> Option<f64> {
        let of = |wheels: &WheelSample| 0.5 * (wheels.left_m_per_s + wheels.right_m_per_s);
        let first = self.wheels.front()?;
        if stamp_ns <= first.stamp_ns {
            return (stamp_ns == first.stamp_ns).then(|| of(first));
        }
        let next = self.wheels.get(1)?;
        let gap_ns = next.stamp_ns.saturating_sub(first.stamp_ns);
        let share = (stamp_ns - first.stamp_ns) as f64 / gap_ns as f64;
        (gap_ns <= MAX_GAP_NS).then(|| of(first) + share * (of(next) - of(first)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wheels(ms: i64, left_m_per_s: f64, right_m_per_s: f64) -> WheelSample {
        WheelSample { stamp_ns: ms * 1_000_000, left_m_per_s, right_m_per_s }
    }

    /// 1 m/s and 1 rad/s: a circle of radius 1 m, at 0.5 s at (sin 0.5, 1 - cos 0.5); by the wheels
    /// alone (0.75 and 1.25 m/s, 0.5 m apart) and by the IMU with wheels that only tell the speed.
    #[test]
    fn a_circle_by_wheels_alone_and_with_an_imu() {
        for track_m in [Some(0.5), None] {
            let mut reckoning = DeadReckoning::new(track_m);
            let mut poses = Vec::new();
            for ms in (0..=500).step_by(10) {
                if ms % 20 == 0 {
                    let half_difference = if track_m.is_some() { 0.25 } else { 0.0 };
                    reckoning.add_wheels(wheels(ms, 1.0 - half_difference, 1.0 + half_difference));
                }
                if track_m.is_none() {
                    reckoning.add_yaw_rate(ms * 1_000_000, 1.0);
                }
                // In parts or at once: what is not settled waits.
                if ms % 50 == 0 {
                    poses.extend(reckoning.advance());
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
    fn what_is_late_or_no_number_is_passed_over_and_a_gap_gives_no_pose() {
        let mut reckoning = DeadReckoning::new(None);
        for (ms, speed) in [(0, 1.0), (100, f64::NAN), (50, 1.0), (1100, 1.0), (1120, 3.0)] {
            reckoning.add_wheels(wheels(ms, speed, speed));
        }
        for (ms, rate) in [(-10, 0.0), (0, 0.0), (20, f64::NAN), (50, 0.0), (600, 0.0), (1110, 0.0)]
        {
            reckoning.add_yaw_rate(ms * 1_000_000, rate);
        }
        let poses = reckoning.advance();
        let stamps: Vec<i64> = poses.iter().map(|p| p.stamp_ns / 1_000_000).collect();
        assert_eq!(stamps, [0, 50, 1110], "none at -10, before the wheels, none in the gap");
        assert!((poses[1].pose.x_m - poses[0].pose.x_m - 0.05).abs() < 1e-12);
    }
}
