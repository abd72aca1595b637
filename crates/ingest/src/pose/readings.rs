//! The motion measurements of a log, as its messages contain them.

use dataset::{LossKind, StampedPose};
use fuse::{InertialReading, WheelSample};
use messages::{
    MessageType, NavSatFix, Source, read_imu, read_joint_state, read_nav_sat_fix, read_odometry,
    read_transforms,
};

use crate::pose::frames::TransformHistory;
use crate::pose::gnss;
use crate::pose::message::{stamped_pose, undecodable, yaw_rad};
use crate::pose_options::{Frames, PoseOptions};

/// The motion measurements of a log, in the order of the log.
#[derive(Debug, Default)]
pub(crate) struct MotionReadings {
    pub(crate) poses: Vec<StampedPose>,
    pub(crate) fixes: Vec<NavSatFix>,
    pub(crate) transforms: TransformHistory,
    /// Wheel speeds.
    pub(crate) wheel_speeds: Vec<WheelSample>,
    /// Wheel positions: stamp \[ns\], left and right \[m\].
    pub(crate) wheel_positions: Vec<(i64, f64, f64)>,
    pub(crate) imu: Vec<ImuReading>,
}

/// An IMU message.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ImuReading {
    pub(crate) inertial: InertialReading,
    /// Heading of the orientation, if it is used \[rad\].
    pub(crate) heading_rad: Option<f64>,
}

impl MotionReadings {
    /// Adds a message with its log time. The error is the kind of loss that the message is counted as.
    pub(crate) fn add(
        &mut self,
        topic: &str,
        source: Source,
        log_ns: u64,
        data: &[u8],
        options: &PoseOptions,
    ) -> Result<(), LossKind> {
        let undecodable = |error: messages::MessageError| undecodable(source, &error);
        let selected = |header_ns: i64| options.stamp.select(header_ns, log_ns);
        match (source.message_type, &options.wheels) {
            (MessageType::Imu, _) => {
                let imu = read_imu(source, data).map_err(undecodable)?;
                let inertial = InertialReading {
                    stamp_ns: selected(imu.stamp_ns),
                    angular_velocity_rad_s: imu.angular_velocity,
                    acceleration_m_s2: imu.linear_acceleration,
                };
                let heading_rad = imu.orientation.filter(|_| options.use_heading).map(yaw_rad);
                self.imu.push(ImuReading { inertial, heading_rad });
            }
            (MessageType::NavSatFix, _) => {
                let mut fix = read_nav_sat_fix(source, data).map_err(undecodable)?;
                fix.stamp_ns = selected(fix.stamp_ns);
                gnss::check(&fix)?;
                self.fixes.push(fix);
            }
            (MessageType::Tf | MessageType::FoxgloveFrameTransform, _) => {
                let is_static = topic.ends_with("_static");
                let transforms = read_transforms(source, data).map_err(undecodable)?;
                for mut transform in transforms {
                    transform.stamp_ns = selected(transform.stamp_ns);
                    self.transforms.add(&transform, is_static)?;
                }
            }
            (MessageType::JointState, _) => self.add_joints(source, log_ns, data, options)?,
            (MessageType::Odometry, Some(_)) => {
                let odometry = read_odometry(source, data).map_err(undecodable)?;
                self.wheel_speeds.push(WheelSample::from_twist(
                    selected(odometry.pose.stamp_ns),
                    odometry.linear_velocity[0],
                    odometry.angular_velocity[2],
                    options.track_m.unwrap_or_default(),
                ));
            }
            _ => {
                let mut pose = stamped_pose(source, data)?;
                pose.stamp_ns = selected(pose.stamp_ns);
                self.poses.push(pose);
            }
        }
        Ok(())
    }

    /// Adds the mean speed, or the mean position, of the wheels on each side. A side can have
    /// several wheels.
    fn add_joints(
        &mut self,
        source: Source,
        log_ns: u64,
        data: &[u8],
        options: &PoseOptions,
    ) -> Result<(), LossKind> {
        let joints = read_joint_state(source, data).map_err(|error| undecodable(source, &error))?;
        let mean = |side: &str, values: &[f64]| {
            let is_on_side = |joint: &String| joint.to_ascii_lowercase().contains(side);
            let on_side = joints.names.iter().zip(values).filter(|(joint, _)| is_on_side(joint));
            let (sum, n) = on_side.fold((0.0, 0), |(sum, n), (_, value)| (sum + value, n + 1));
            (n > 0).then(|| sum / f64::from(n) * options.wheel_radius_m.unwrap_or(1.0))
        };
        let stamp_ns = options.stamp.select(joints.stamp_ns, log_ns);
        let both = |values: &[f64]| Some((mean("left", values)?, mean("right", values)?));
        if let Some((left_m_s, right_m_s)) = both(&joints.velocities) {
            self.wheel_speeds.push(WheelSample { stamp_ns, left_m_s, right_m_s });
        } else if let Some((left_m, right_m)) = both(&joints.positions) {
            self.wheel_positions.push((stamp_ns, left_m, right_m));
        } else {
            return Err(LossKind::NoWheelJoints { joints: joints.names.join(", ") });
        }
        Ok(())
    }

    /// Adds the readings of a later part of the log, except the transforms. Returns the number of
    /// poses that are earlier than the previous pose.
    pub(crate) fn extend(&mut self, later: Self) -> u64 {
        let before = self.poses.len().saturating_sub(1);
        self.poses.extend(later.poses);
        self.fixes.extend(later.fixes);
        self.wheel_speeds.extend(later.wheel_speeds);
        self.wheel_positions.extend(later.wheel_positions);
        self.imu.extend(later.imu);
        let steps = self.poses[before.min(self.poses.len())..].windows(2);
        steps.filter(|pair| pair[1].stamp_ns < pair[0].stamp_ns).count() as u64
    }

    /// Whether the poses come from a satellite receiver.
    pub(crate) fn has_fixes(&self) -> bool {
        !self.fixes.is_empty()
    }

    /// Moves the transforms of a later part of the log to this one.
    pub(crate) fn take_transforms(&mut self, later: &mut Self) {
        self.transforms.extend(std::mem::take(&mut later.transforms));
    }

    /// Removes the transforms that are not needed.
    pub(crate) fn prune_transforms(&mut self, options: &PoseOptions) {
        if let Some(Frames { parent, child, .. }) = &options.frames {
            self.transforms.prune(parent, child);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Encoding, JointState, ros};

    fn add_joints(
        readings: &mut MotionReadings,
        names: &[&str],
        velocities: &[f64],
        positions: &[f64],
    ) -> Result<(), LossKind> {
        let joints = JointState {
            stamp_ns: 7,
            names: names.iter().map(|&name| name.to_owned()).collect(),
            positions: positions.to_vec(),
            velocities: velocities.to_vec(),
        };
        let bytes = ros::write_joint_state(Encoding::Cdr, "base", &joints);
        let source = Source { message_type: MessageType::JointState, encoding: Encoding::Cdr };
        let options = PoseOptions { wheel_radius_m: Some(0.5), ..PoseOptions::default() };
        readings.add("/wheels", source, 9, &bytes, &options)
    }

    #[test]
    fn the_speed_of_a_side_is_the_mean_of_its_wheels() {
        let mut readings = MotionReadings::default();
        let names = ["rear_Right", "front_left", "rear_left", "front_Right"];
        add_joints(&mut readings, &names, &[4.0, 1.0, 2.0, 6.0], &[]).unwrap();
        let sample = readings.wheel_speeds[0];
        assert_eq!((sample.stamp_ns, sample.left_m_s, sample.right_m_s), (7, 0.75, 2.5));
    }

    #[test]
    fn positions_are_used_if_there_are_no_velocities() {
        let mut readings = MotionReadings::default();
        add_joints(&mut readings, &["left", "right"], &[], &[1.0, 3.0]).unwrap();
        assert_eq!(readings.wheel_positions, [(7, 0.5, 1.5)]);
        assert!(readings.wheel_speeds.is_empty());
    }

    #[test]
    fn joints_without_a_left_and_a_right_wheel_are_refused() {
        let mut readings = MotionReadings::default();
        let error = add_joints(&mut readings, &["arm", "gripper"], &[1.0, 2.0], &[]).unwrap_err();
        assert_eq!(error, LossKind::NoWheelJoints { joints: "arm, gripper".to_owned() });
    }
}
