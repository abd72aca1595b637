//! Wheel messages -> wheel speeds, while a log is being read.
//!
//! The decisions that need the whole drive are made from the messages so far. The speeds are used to
//! deskew scans.

use std::sync::Arc;

use fuse::WheelSample;

use crate::pose::joint_speeds::{JointReading, JointSet, is_wrap};
use crate::pose::joints::Naming;
use crate::pose::readings::MotionReadings;
use crate::pose::twist::{OdometryReading, TwistEvidence};
use crate::pose_options::PoseOptions;

/// Positions within this time of the last ones are left out \[ns\]: messages that are stamped on arrival
/// can come in bursts. The speed of a robot changes more slowly.
const MIN_STEP_NS: i64 = 10_000_000;

/// Computes wheel speeds message by message.
#[derive(Debug)]
pub(crate) struct LiveWheels {
    /// From joint values to metres.
    scale: f64,
    are_angles: bool,
    max_speed_m_s: f64,
    track_m: f64,
    best: Option<Naming>,
    joints: Vec<LiveJoints>,
    twist: TwistEvidence,
    last_odometry: Option<OdometryReading>,
}

/// The joints of one publisher.
#[derive(Debug)]
struct LiveJoints {
    joints: Arc<JointSet>,
    last: Option<JointReading>,
    /// Whether any velocity was not 0.
    has_velocities: bool,
}

impl LiveWheels {
    pub(crate) fn new(options: &PoseOptions) -> Self {
        Self {
            scale: options.wheel_radius_m.unwrap_or(1.0),
            are_angles: options.wheel_speed_unit.is_none(),
            max_speed_m_s: options.max_speed_m_s,
            track_m: options.track_m.unwrap_or_default(),
            best: None,
            joints: Vec::new(),
            twist: TwistEvidence::default(),
            last_odometry: None,
        }
    }

    /// The speeds in the next part of the log.
    pub(crate) fn advance(&mut self, next: &MotionReadings) -> Vec<WheelSample> {
        let mut samples: Vec<WheelSample> =
            next.joints.iter().filter_map(|reading| self.add_joints(reading)).collect();
        for reading in &next.odometry {
            self.twist.add(reading, self.max_speed_m_s);
            let last = self.last_odometry.replace(*reading);
            samples.extend(self.twist.speeds(last.as_ref(), reading, self.track_m));
        }
        samples
    }

    fn add_joints(&mut self, reading: &JointReading) -> Option<WheelSample> {
        let naming = reading.joints.naming;
        if self.best.is_some_and(|best| best < naming) {
            return None;
        }
        self.best = Some(naming);
        let known = self.joints.iter().position(|live| live.joints == reading.joints);
        let at = known.unwrap_or_else(|| {
            let joints = Arc::clone(&reading.joints);
            self.joints.push(LiveJoints { joints, last: None, has_velocities: false });
            self.joints.len() - 1
        });
        let live = &mut self.joints[at];
        live.has_velocities |= reading.velocities.iter().any(|v| v.is_finite() && *v != 0.0);
        if live.has_velocities || reading.positions.is_empty() {
            return reading.speeds(self.scale);
        }
        let since_ns = |last: &JointReading| reading.stamp_ns.saturating_sub(last.stamp_ns);
        if live.last.as_ref().is_some_and(|last| (0..MIN_STEP_NS).contains(&since_ns(last))) {
            return None;
        }
        let last = live.last.replace(reading.clone());
        let last = last.filter(|last| last.positions.len() == reading.positions.len())?;
        let dt_ns = reading.stamp_ns.saturating_sub(last.stamp_ns);
        let steps = last.positions.iter().zip(&reading.positions).map(|(&from, &to)| {
            match self.are_angles && is_wrap(from, to) {
                true => dataset::wrap_angle(to - from),
                false => to - from,
            }
        });
        let stepped = JointReading {
            stamp_ns: last.stamp_ns.saturating_add(dt_ns / 2),
            velocities: steps.map(|step| step / (dt_ns as f64 * 1e-9)).collect(),
            positions: Vec::new(),
            joints: Arc::clone(&reading.joints),
        };
        let speeds = stepped.speeds(self.scale).filter(|_| 0 < dt_ns)?;
        let is_possible = |m_s: f64| m_s.abs() <= self.max_speed_m_s;
        (is_possible(speeds.left_m_s) && is_possible(speeds.right_m_s)).then_some(speeds)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(ms: i64, positions: &[f64], velocities: &[f64]) -> JointReading {
        JointReading {
            stamp_ns: ms * 1_000_000,
            joints: Arc::new(JointSet {
                naming: Naming::Wheel,
                left: vec!["left".to_owned()],
                right: vec!["right".to_owned()],
            }),
            positions: positions.to_vec(),
            velocities: velocities.to_vec(),
        }
    }

    fn speeds(readings: Vec<JointReading>) -> Vec<(i64, f64, f64)> {
        let options = PoseOptions { wheel_radius_m: Some(0.1), ..PoseOptions::default() };
        let mut live = LiveWheels::new(&options);
        // Message by message, as from pieces of a log.
        let samples = readings.into_iter().flat_map(|reading| {
            live.advance(&MotionReadings { joints: vec![reading], ..MotionReadings::default() })
        });
        samples.map(|s| (s.stamp_ns / 1_000_000, s.left_m_s, s.right_m_s)).collect()
    }

    fn check(readings: Vec<JointReading>, expected: &[(i64, f64, f64)]) {
        let found = speeds(readings);
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!(found.0, expected.0);
            let error = (found.1 - expected.1).abs().max((found.2 - expected.2).abs());
            assert!(error < 1e-9, "{found:?}, expected {expected:?}");
        }
    }

    #[test]
    fn velocities_are_used_once_one_is_not_zero() {
        let moving = vec![reading(0, &[], &[0.0, 0.0]), reading(20, &[], &[10.0, 5.0])];
        check(moving, &[(0, 0.0, 0.0), (20, 1.0, 0.5)]);
        let both = vec![
            reading(0, &[1.0, 1.0], &[0.0, 0.0]),
            reading(20, &[1.0, 1.0], &[0.0, 0.0]),
            reading(40, &[1.2, 1.1], &[10.0, 5.0]),
        ];
        check(both, &[(10, 0.0, 0.0), (40, 1.0, 0.5)]);
    }

    /// Two messages at a time, 1 ms apart: the wheels turn by 0.2 and 0.1 rad in 100 ms.
    #[test]
    fn positions_that_arrive_in_bursts_are_used() {
        let bursts = vec![
            reading(0, &[0.1, 0.05], &[]),
            reading(1, &[0.2, 0.1], &[]),
            reading(100, &[0.3, 0.15], &[]),
            reading(101, &[0.4, 0.2], &[]),
            reading(200, &[0.5, 0.25], &[]),
        ];
        check(bursts, &[(50, 0.2, 0.1), (150, 0.2, 0.1)]);
    }

    /// From 3 rad to -3 rad the left wheel turned by 2 pi - 6 rad. A step that is faster than 15 m/s is
    /// left out.
    #[test]
    fn positions_are_unwrapped_and_jumps_left_out() {
        let pi = std::f64::consts::PI;
        let turned = (2.0 * pi - 6.0) * 0.1 / 0.1;
        let wrapped = vec![
            reading(0, &[3.0, 0.0], &[]),
            reading(100, &[-3.0, 0.1], &[]),
            reading(200, &[-2.9, 100.0], &[]),
        ];
        check(wrapped, &[(50, turned, 0.1)]);
    }
}
