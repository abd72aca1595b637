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
        let last = live.last.replace(reading.clone());
        if live.has_velocities || reading.positions.is_empty() {
            return reading.speeds(self.scale);
        }
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
