//! How the lidar moves, told while the log is being read: what straightens its scans.

use dataset::{Pose2, StampedPose};
use fuse::{DeadReckoning, GravityEstimate, WheelSample};

use crate::deskew::motion::Track;
use crate::pose::frames::TransformHistory;
use crate::pose::readings::Motion;
use crate::pose_options::{Frames, PoseOptions};

/// How the lidar moves, told while the log is being read.
pub(crate) struct Follower {
    how: How,
    mount: Pose2,
}

enum How {
    /// By poses as they come.
    Poses,
    /// By the transforms between frames, which have been followed to a stamp.
    Frames(Frames, i64),
    /// By dead reckoning; `position` is the last one of the wheels.
    Wheels {
        dead_reckoning: DeadReckoning,
        position: Option<(i64, f64, f64)>,
        gravity: GravityEstimate,
    },
}

impl Follower {
    pub(crate) fn new(options: &PoseOptions, mount: Pose2) -> Self {
        let how = match (&options.frames, &options.wheels) {
            (Some(frames), _) => How::Frames(frames.clone(), i64::MIN),
            (None, Some(_)) => How::Wheels {
                dead_reckoning: DeadReckoning::new(
                    options.track_m.filter(|_| options.imu.is_none()),
                ),
                position: None,
                gravity: GravityEstimate::default(),
            },
            (None, None) => How::Poses,
        };
        Self { how, mount }
    }

    /// Goes on with what comes next in the log; `frames` are the transforms so far.
    pub(crate) fn follow(&mut self, next: &Motion, frames: &TransformHistory, track: &mut Track) {
        let mount = self.mount;
        let mut push = |p: &StampedPose| track.push(p.stamp_ns, p.pose * mount);
        match &mut self.how {
            How::Poses => next.poses.iter().for_each(push),
            How::Frames(Frames { parent, child, .. }, followed_ns) => {
                let poses = frames.motion(parent, child, *followed_ns);
                poses.iter().for_each(&mut push);
                *followed_ns = poses.last().map_or(*followed_ns, |pose| pose.stamp_ns);
            }
            How::Wheels { dead_reckoning, position, gravity } => {
                let positions: Vec<_> = position.iter().chain(&next.positions).copied().collect();
                *position = positions.last().copied();
                let speeds = WheelSample::from_positions(&positions);
                (next.speeds.iter().chain(&speeds))
                    .for_each(|&wheels| dead_reckoning.add_wheels(wheels));
                for reading in &next.imu {
                    if let Some(acceleration) = reading.acceleration {
                        gravity.add(acceleration);
                    }
                    let rates = reading.angular_velocity.iter().zip(gravity.up());
                    dead_reckoning
                        .add_yaw_rate(reading.stamp_ns, rates.map(|(rate, up)| rate * up).sum());
                }
                dead_reckoning.advance().iter().for_each(push);
            }
        }
    }
}
