//! How the lidar moves, told while the log is being read: what straightens its scans.

use dataset::{Pose2, StampedPose};
use fuse::WheelSample;

use crate::deskew::dead_reckoning::DeadReckoning;
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
    /// By wheels, with the last positions of theirs, and the sum of the accelerations so far.
    Wheels { reckoning: DeadReckoning, position: Option<(i64, f64, f64)>, sum: [f64; 3], n: u32 },
}

impl Follower {
    pub(crate) fn new(options: &PoseOptions, mount: Pose2) -> Self {
        let how = match (&options.frames, &options.wheels) {
            (Some(frames), _) => How::Frames(frames.clone(), i64::MIN),
            (None, Some(_)) => How::Wheels {
                reckoning: DeadReckoning::new(options.track_m.filter(|_| options.imu.is_none())),
                position: None,
                sum: [0.0; 3],
                n: 0,
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
            How::Wheels { reckoning, position, sum, n } => {
                let positions: Vec<_> = position.iter().chain(&next.positions).copied().collect();
                *position = positions.last().copied();
                let speeds = WheelSample::from_positions(&positions);
                next.speeds.iter().chain(&speeds).for_each(|&wheels| reckoning.add_wheels(wheels));
                for reading in &next.imu {
                    if let Some(acceleration) = reading.acceleration {
                        *n += 1;
                        *sum = std::array::from_fn(|axis| sum[axis] + acceleration[axis]);
                    }
                    let up = up(sum.map(|v| v / f64::from((*n).max(1))));
                    let rates = reading.angular_velocity.iter().zip(up);
                    reckoning
                        .add_yaw_rate(reading.stamp_ns, rates.map(|(rate, up)| rate * up).sum());
                }
                reckoning.advance().iter().for_each(push);
            }
        }
    }
}

/// Standard gravity \[m/s^2\], and how far a mean acceleration may be from it to be it.
const GRAVITY_M_S2: f64 = 9.80665;
const GRAVITY_TOLERANCE: f64 = 0.1;

/// The direction up in the IMU's frame, of length 1: that of the mean acceleration where this is
/// gravity, else, for drivers that take it out, the z axis.
fn up(mean: [f64; 3]) -> [f64; 3] {
    let norm = mean.iter().map(|v| v * v).sum::<f64>().sqrt();
    match (norm / GRAVITY_M_S2 - 1.0).abs() < GRAVITY_TOLERANCE {
        true => mean.map(|v| v / norm),
        false => [0.0, 0.0, 1.0],
    }
}
