//! The motion measurements of a log, as its messages contain them.

use std::collections::BTreeMap;
use std::sync::Arc;

use dataset::{LossKind, Losses, StampedPose};
use fuse::InertialReading;
use messages::{
    MessageType, NavSatFix, Source, read_frame_ids, read_imu, read_joint_state, read_nav_sat_fix,
    read_odometry, read_transforms,
};

use crate::pose::frame_names::FrameNames;
use crate::pose::frames::TransformHistory;
use crate::pose::gnss;
use crate::pose::joint_speeds::{JointReading, JointSet};
use crate::pose::joints::{JointFault, WheelJoints};
use crate::pose::message::{
    check_position, check_rates, check_wheel_positions, stamped_pose, undecodable, yaw_rad,
};
use crate::pose::twist::OdometryReading;
use crate::pose_options::{Frames, PoseOptions};
use crate::wheel_options::WheelsTopic;

/// The motion measurements of a log, in the order of the log.
#[derive(Debug, Default)]
pub(crate) struct MotionReadings {
    /// Poses. Their frames are numbers of `frame_names`.
    pub(crate) poses: Vec<StampedPose>,
    /// Satellite fixes, each with the number of its frame.
    pub(crate) fixes: Vec<(NavSatFix, u32)>,
    /// The frames of the poses and fixes.
    pub(crate) frame_names: FrameNames,
    pub(crate) transforms: TransformHistory,
    /// Joints of the wheels.
    pub(crate) joints: Vec<JointReading>,
    /// Messages without wheels. They are a loss only if no message has wheels: the joints of an arm
    /// often come in messages of their own.
    pub(crate) without_wheels: Losses,
    /// Odometry messages. Their twist is used.
    pub(crate) odometry: Vec<OdometryReading>,
    /// Number of these messages by parent and child frame.
    pub(crate) odometry_frames: BTreeMap<[String; 2], u64>,
    pub(crate) imu: Vec<ImuReading>,
    /// Number of IMU messages by frame.
    pub(crate) imu_frames: BTreeMap<String, u64>,
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
                check_rates(
                    imu.angular_velocity.iter().chain(imu.linear_acceleration.iter().flatten()),
                )?;
                let frames = read_frame_ids(source, data).map_err(undecodable)?.unwrap_or_default();
                let frame_id = frames.frame_id.as_ref();
                if options.imu_frame_id.as_deref().is_some_and(|wanted| !is_frame(wanted, frame_id))
                {
                    return Ok(());
                }
                *self.imu_frames.entry(frame_id.to_owned()).or_default() += 1;
                let inertial = InertialReading {
                    stamp_ns: selected(imu.stamp_ns),
                    // The sign is applied to the yaw rate, after the projection on the vertical.
                    angular_velocity_rad_s: (imu.angular_velocity)
                        .map(|rate| rate * options.gyro_scale.abs()),
                    acceleration_m_s2: imu.linear_acceleration,
                };
                let heading_rad = imu.orientation.filter(|_| options.use_heading).map(yaw_rad);
                self.imu.push(ImuReading { inertial, heading_rad });
            }
            (MessageType::NavSatFix, _) => {
                let mut fix = read_nav_sat_fix(source, data).map_err(undecodable)?;
                fix.stamp_ns = selected(fix.stamp_ns);
                gnss::check(&fix)?;
                if let Some(frame) = self.frame(source, data, options) {
                    self.fixes.push((fix, frame));
                }
            }
            (MessageType::Tf | MessageType::FoxgloveFrameTransform, _) => {
                let is_static = topic.ends_with("_static");
                let transforms = read_transforms(source, data).map_err(undecodable)?;
                for mut transform in transforms {
                    transform.stamp_ns = selected(transform.stamp_ns);
                    self.transforms.add(&transform, is_static);
                }
            }
            (MessageType::JointState, Some(wheels)) => {
                self.add_joints(source, log_ns, data, wheels, options)?;
            }
            (MessageType::Odometry, Some(_)) => {
                let odometry = read_odometry(source, data).map_err(undecodable)?;
                check_rates(odometry.linear_velocity.iter().chain(&odometry.angular_velocity))?;
                if odometry.pose.position.iter().all(|v| v.is_finite()) {
                    check_position(&odometry.pose.position)?;
                }
                let frames = [odometry.frame_id.clone(), odometry.child_frame_id.clone()];
                if options.frame_id.as_deref().is_none_or(|wanted| is_frame(wanted, &frames[0])) {
                    *self.odometry_frames.entry(frames).or_default() += 1;
                    let stamp_ns = selected(odometry.pose.stamp_ns);
                    self.odometry.push(OdometryReading::new(&odometry, stamp_ns));
                }
            }
            _ => {
                let mut pose = stamped_pose(source, data)?;
                pose.stamp_ns = selected(pose.stamp_ns);
                if let Some(frame) = self.frame(source, data, options) {
                    self.poses.push(StampedPose { frame, ..pose });
                }
            }
        }
        Ok(())
    }

    /// Counts the frame of a message. It is `None` if the options select another frame.
    fn frame(&mut self, source: Source, data: &[u8], options: &PoseOptions) -> Option<u32> {
        let ids = read_frame_ids(source, data).ok().flatten().unwrap_or_default();
        self.frame_names.add(&ids, options.frame_id.as_deref())
    }

    /// Adds the wheels among the joints of a message.
    fn add_joints(
        &mut self,
        source: Source,
        log_ns: u64,
        data: &[u8],
        wheels: &WheelsTopic,
        options: &PoseOptions,
    ) -> Result<(), LossKind> {
        let message =
            read_joint_state(source, data).map_err(|error| undecodable(source, &error))?;
        let names = || message.names.join(", ");
        let found = match WheelJoints::find(&message.names, wheels) {
            Ok(found) => found,
            Err(JointFault::None) => {
                self.without_wheels.add(LossKind::NoWheelJoints { joints: names() }, 1);
                return Ok(());
            }
            Err(JointFault::Unequal { n_left, n_right }) => {
                let (n_left, n_right) = (n_left as u64, n_right as u64);
                return Err(LossKind::UnequalWheelJoints { n_left, n_right, joints: names() });
            }
        };
        let of_wheels = |values: &[f64]| -> Vec<f64> {
            let all = found.left.iter().chain(&found.right).map(|&k| values.get(k).copied());
            all.collect::<Option<_>>().unwrap_or_default()
        };
        let (positions, velocities) =
            (of_wheels(&message.positions), of_wheels(&message.velocities));
        check_rates(&velocities)?;
        check_wheel_positions(&positions)?;
        if positions.is_empty() && velocities.is_empty() {
            return Err(LossKind::NoWheelJoints { joints: names() });
        }
        let [left, right] =
            [&found.left, &found.right].map(|side| WheelJoints::names(side, &message.names));
        let set = JointSet { naming: found.naming, left, right };
        let joints = match self.joints.last().filter(|last| *last.joints == set) {
            Some(last) => Arc::clone(&last.joints),
            None => Arc::new(set),
        };
        let stamp_ns = options.stamp.select(message.stamp_ns, log_ns);
        self.joints.push(JointReading { stamp_ns, joints, positions, velocities });
        Ok(())
    }

    /// Adds the readings of a later part of the log, except the transforms.
    pub(crate) fn extend(&mut self, later: Self) {
        let frames = self.frame_names.extend(later.frame_names);
        let of = |frame: u32| frames.get(frame as usize).copied().unwrap_or(frame);
        self.poses.extend(
            later.poses.into_iter().map(|pose| StampedPose { frame: of(pose.frame), ..pose }),
        );
        self.fixes.extend(later.fixes.into_iter().map(|(fix, frame)| (fix, of(frame))));
        self.joints.extend(later.joints);
        self.without_wheels.merge(later.without_wheels);
        self.odometry.extend(later.odometry);
        for (frames, n) in later.odometry_frames {
            *self.odometry_frames.entry(frames).or_default() += n;
        }
        self.imu.extend(later.imu);
        for (frame_id, n) in later.imu_frames {
            *self.imu_frames.entry(frame_id).or_default() += n;
        }
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

/// Whether a frame is the wanted one. ROS 1 allows a leading slash.
fn is_frame(wanted: &str, found: &str) -> bool {
    wanted.trim_start_matches('/') == found.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Encoding, Imu, JointState, Odometry, StampedPose3, ros};

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
        let options = PoseOptions { wheels: Some("/wheels".into()), ..PoseOptions::default() };
        readings.add("/wheels", source, 9, &bytes, &options)
    }

    /// One absurd value of any wheel, gyroscope or twist: the message is not used.
    #[test]
    fn impossible_readings_are_counted() {
        let mut readings = MotionReadings::default();
        let impossible = |max| Err(LossKind::ImpossibleReadings { max });
        let names = ["left_wheel", "right_wheel"];
        let added = add_joints(&mut readings, &names, &[1.0, -1e300], &[]);
        assert_eq!(added, impossible(1_000_000));
        let added = add_joints(&mut readings, &names, &[], &[1e300, 0.0]);
        assert_eq!(added, impossible(1_000_000_000));
        let odometry = Odometry {
            pose: StampedPose3 {
                stamp_ns: 7,
                position: [0.0; 3],
                orientation: [0.0, 0.0, 0.0, 1.0],
            },
            frame_id: "odom".to_owned(),
            child_frame_id: "base".to_owned(),
            pose_covariance: [0.0; 36],
            linear_velocity: [1e300, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        };
        let options = PoseOptions { wheels: Some("/wheels".into()), ..PoseOptions::default() };
        let mut add = |message_type, bytes: &[u8]| {
            let source = Source { message_type, encoding: Encoding::Cdr };
            readings.add("/wheels", source, 9, bytes, &options)
        };
        let bytes = ros::write_odometry(Encoding::Cdr, &odometry);
        assert_eq!(add(MessageType::Odometry, &bytes), impossible(1_000_000));
        let imu = Imu {
            stamp_ns: 7,
            orientation: None,
            angular_velocity: [0.0, 0.0, -1e200],
            linear_acceleration: None,
        };
        let bytes = ros::write_imu(Encoding::Cdr, "imu", &imu);
        assert_eq!(add(MessageType::Imu, &bytes), impossible(1_000_000));
        assert!(
            readings.joints.is_empty() && readings.odometry.is_empty() && readings.imu.is_empty()
        );
    }

    #[test]
    fn the_wheels_of_a_message_are_read() {
        let mut readings = MotionReadings::default();
        let names = ["rear_Right", "front_left", "rear_left", "front_Right"];
        add_joints(&mut readings, &names, &[4.0, 1.0, 2.0, 6.0], &[]).unwrap();
        add_joints(&mut readings, &names, &[], &[4.0, 1.0, 2.0, 6.0]).unwrap();
        let [first, second] = readings.joints.as_slice() else { panic!("{readings:?}") };
        assert_eq!(
            (first.velocities.as_slice(), first.positions.len()),
            (&[1.0, 2.0, 6.0, 4.0][..], 0)
        );
        assert_eq!(second.positions, [1.0, 2.0, 6.0, 4.0]);
        assert_eq!(first.joints.left, ["front_left", "rear_left"]);
        assert_eq!(first.joints.right, ["front_Right", "rear_Right"]);
        assert!(Arc::ptr_eq(&first.joints, &second.joints));
    }

    /// They can be those of an arm, next to the messages of the wheels.
    #[test]
    fn joints_without_wheels_are_counted_apart() {
        let mut readings = MotionReadings::default();
        add_joints(&mut readings, &["arm", "gripper"], &[1.0, 2.0], &[]).unwrap();
        let mut later = MotionReadings::default();
        add_joints(&mut later, &["arm", "gripper"], &[1.0, 2.0], &[]).unwrap();
        readings.extend(later);
        assert!(readings.joints.is_empty());
        let mut expected = Losses::default();
        expected.add(LossKind::NoWheelJoints { joints: "arm, gripper".to_owned() }, 2);
        assert_eq!(readings.without_wheels, expected);
    }
}
