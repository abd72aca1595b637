//! The poses of the lidar while the log is being read. They are used for deskewing.

use dataset::{Pose2, StampedPose};
use fuse::{DeadReckoning, GravityEstimate};

use crate::deskew::recent_poses::RecentPoses;
use crate::pose::frames::TransformHistory;
use crate::pose::live_wheels::LiveWheels;
use crate::pose::readings::MotionReadings;
use crate::pose_options::{Frames, PoseOptions};

/// Computes the poses of the lidar from the readings, as they are read from the log.
pub(crate) struct PoseFeed {
    source: FeedSource,
    base_from_lidar: Pose2,
}

enum FeedSource {
    /// Poses from a topic.
    Poses,
    /// Transforms, used up to a stamp.
    Frames(Frames, i64),
    /// Wheels, with or without an IMU.
    Wheels {
        dead_reckoning: Box<DeadReckoning>,
        wheels: Box<LiveWheels>,
        gravity: GravityEstimate,
        /// 1, or -1 for a gyroscope that turns clockwise.
        gyro_sign: f64,
    },
}

impl PoseFeed {
    pub(crate) fn new(options: &PoseOptions, base_from_lidar: Pose2) -> Self {
        let source = match (&options.frames, &options.wheels) {
            (Some(frames), _) => FeedSource::Frames(frames.clone(), i64::MIN),
            (None, Some(_)) => FeedSource::Wheels {
                dead_reckoning: Box::new(DeadReckoning::new(
                    options.track_m.filter(|_| options.imu.is_none()),
                )),
                wheels: Box::new(LiveWheels::new(options)),
                gravity: GravityEstimate::default(),
                gyro_sign: 1f64.copysign(options.gyro_scale),
            },
            (None, None) => FeedSource::Poses,
        };
        Self { source, base_from_lidar }
    }

    /// Adds the poses from the next part of the log to `recent_poses`. `transforms` contains all
    /// transforms so far.
    pub(crate) fn advance(
        &mut self,
        next: &MotionReadings,
        transforms: &TransformHistory,
        recent_poses: &mut RecentPoses,
    ) {
        let base_from_lidar = self.base_from_lidar;
        let mut push = |p: &StampedPose| recent_poses.push(p.stamp_ns, p.pose * base_from_lidar);
        match &mut self.source {
            FeedSource::Poses => next.poses.iter().for_each(push),
            FeedSource::Frames(Frames { parent, child, .. }, used_up_to_ns) => {
                let poses = transforms.motion(parent, child, *used_up_to_ns);
                poses.iter().for_each(&mut push);
                *used_up_to_ns = poses.last().map_or(*used_up_to_ns, |pose| pose.stamp_ns);
            }
            FeedSource::Wheels { dead_reckoning, wheels, gravity, gyro_sign } => {
                wheels
                    .advance(next)
                    .into_iter()
                    .for_each(|sample| dead_reckoning.add_wheels(sample));
                for inertial in next.imu.iter().map(|reading| reading.inertial) {
                    if let Some(acceleration) = inertial.acceleration_m_s2 {
                        gravity.add(acceleration);
                    }
                    let rates = inertial.angular_velocity_rad_s.iter().zip(gravity.up());
                    let yaw_rate_rad_s: f64 = rates.map(|(rate, up)| rate * up).sum();
                    dead_reckoning.add_yaw_rate(inertial.stamp_ns, *gyro_sign * yaw_rate_rad_s);
                }
                dead_reckoning.advance().iter().for_each(push);
            }
        }
    }
}
