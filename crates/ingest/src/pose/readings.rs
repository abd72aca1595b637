//! Readings of the robot's motion, as a log gives them.

use dataset::{LossKind, StampedPose};
use fuse::{InertialReading, WheelSample};
use messages::{
    MessageType, NavSatFix, Source, read_imu, read_joint_state, read_nav_sat_fix, read_odometry,
    read_transforms,
};

use crate::pose::frames::TransformHistory;
use crate::pose::gnss;
use crate::pose::message::{stamped_pose, yaw_rad};
use crate::pose_options::{Frames, PoseOptions};
use crate::types::undecodable;

/// Readings of sensors of motion, in the order of the log.
#[derive(Debug, Default)]
pub(crate) struct Motion {
    pub(crate) poses: Vec<StampedPose>,
    pub(crate) fixes: Vec<NavSatFix>,
    pub(crate) frames: TransformHistory,
    /// Speeds of the wheels.
    pub(crate) speeds: Vec<WheelSample>,
    /// Positions of the wheels: stamp \[ns\], left and right \[m\].
    pub(crate) positions: Vec<(i64, f64, f64)>,
    pub(crate) imu: Vec<ImuReading>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct ImuReading {
    pub(crate) stamp_ns: i64,
    pub(crate) angular_velocity: [f64; 3],
    pub(crate) acceleration: Option<[f64; 3]>,
    pub(crate) heading_rad: Option<f64>,
}

impl Motion {
    /// Adds a message of one of the topics.
    pub(crate) fn add(
        &mut self,
        topic: &str,
        source: Source,
        data: &[u8],
        options: &PoseOptions,
    ) -> Result<(), LossKind> {
        let undecodable = |error: messages::MessageError| undecodable(source, &error);
        match (source.message_type, &options.wheels) {
            (MessageType::Imu, _) => {
                let imu = read_imu(source, data).map_err(undecodable)?;
                self.imu.push(ImuReading {
                    stamp_ns: imu.stamp_ns,
                    angular_velocity: imu.angular_velocity,
                    acceleration: imu.linear_acceleration,
                    heading_rad: imu.orientation.filter(|_| options.use_heading).map(yaw_rad),
                });
            }
            (MessageType::NavSatFix, _) => {
                let fix = read_nav_sat_fix(source, data).map_err(undecodable)?;
                gnss::check(&fix)?;
                self.fixes.push(fix);
            }
            (MessageType::Tf | MessageType::FoxgloveFrameTransform, _) => {
                let is_static = topic.ends_with("_static");
                let transforms = read_transforms(source, data).map_err(undecodable)?;
                for transform in transforms {
                    self.frames.add(&transform, is_static)?;
                }
            }
            (MessageType::JointState, _) => self.add_joints(source, data, options)?,
            (MessageType::Odometry, Some(_)) => {
                let odometry = read_odometry(source, data).map_err(undecodable)?;
                self.speeds.push(WheelSample::from_twist(
                    odometry.pose.stamp_ns,
                    odometry.linear_velocity[0],
                    odometry.angular_velocity[2],
                    options.track_m.unwrap_or_default(),
                ));
            }
            _ => self.poses.push(stamped_pose(source, data)?),
        }
        Ok(())
    }

    /// Takes the mean of the wheels of each side, of which there may be several.
    fn add_joints(
        &mut self,
        source: Source,
        data: &[u8],
        options: &PoseOptions,
    ) -> Result<(), LossKind> {
        let joints = read_joint_state(source, data)
            .map_err(|error| undecodable(source, &error))?;
        let side = |name: &str, values: &[f64]| {
            let is_side = |joint: &String| joint.to_ascii_lowercase().contains(name);
            let of_side = joints.names.iter().zip(values).filter(|(joint, _)| is_side(joint));
            let (sum, n) = of_side.fold((0.0, 0), |(sum, n), (_, value)| (sum + value, n + 1));
            (n > 0).then(|| sum / f64::from(n) * options.wheel_radius_m.unwrap_or(1.0))
        };
        let both = |values: &[f64]| Some((side("left", values)?, side("right", values)?));
        if let Some((left_m_per_s, right_m_per_s)) = both(&joints.velocities) {
            self.speeds.push(WheelSample {
                stamp_ns: joints.stamp_ns,
                left_m_per_s,
                right_m_per_s,
            });
        } else if let Some((left_m, right_m)) = both(&joints.positions) {
            self.positions.push((joints.stamp_ns, left_m, right_m));
        } else {
            return Err(LossKind::NoWheelJoints { joints: joints.names.join(", ") });
        }
        Ok(())
    }

    /// Adds what comes later in the log, the transforms excepted; returns how many poses are earlier than those before.
    pub(crate) fn extend(&mut self, other: Self) -> u64 {
        let before = self.poses.len().saturating_sub(1);
        self.poses.extend(other.poses);
        self.fixes.extend(other.fixes);
        self.speeds.extend(other.speeds);
        self.positions.extend(other.positions);
        self.imu.extend(other.imu);
        let steps = self.poses[before.min(self.poses.len())..].windows(2);
        steps.filter(|pair| pair[1].stamp_ns < pair[0].stamp_ns).count() as u64
    }

    /// Whether its poses are those of a satellite receiver.
    pub(crate) fn has_fixes(&self) -> bool {
        !self.fixes.is_empty()
    }

    /// Takes over the transforms that come later in the log.
    pub(crate) fn add_frames(&mut self, other: &mut Self) {
        self.frames.extend(std::mem::take(&mut other.frames));
    }

    /// Forgets transforms that are not needed.
    pub(crate) fn cut_down(&mut self, options: &PoseOptions) {
        if let Some(Frames { parent, child, .. }) = &options.frames {
            self.frames.cut_down(parent, child);
        }
    }
}

impl ImuReading {
    pub(crate) fn inertial(&self) -> Inertial {
        let &Self { stamp_ns, angular_velocity, acceleration, .. } = self;
        Inertial { stamp_ns, angular_velocity, acceleration }
    }
}
