//! What a log says of the robot's motion -> its trajectory: poses as they are, of transforms, of
//! satellite fixes, or fused from wheels and IMU.

use dataset::{Dropped, Pose2, StampedPose, Trajectory};
use fuse::{Fused, ImuSample, InertialReading, WheelSample};

use crate::deskew::motion::is_jump;
use crate::drive::topic::{Drive, Topic};
use crate::error::IngestError;
use crate::pose::frames::{LookupError, TransformHistory};
use crate::pose::gnss;
use crate::pose::readings::{ImuReading, Motion};
use crate::pose_options::{Frames, PoseOptions};
use crate::types::{FRAME_TYPES, IMU_TYPES, POSE_TYPES, WHEEL_TYPES};

/// The topics that poses come from.
pub(crate) enum PoseTopics {
    /// One that has them.
    Poses(Topic),
    /// Those that have transforms, one at least.
    Frames(Vec<Topic>),
    /// Those they are made from.
    Wheels { wheels: Topic, imu: Option<Topic> },
}

impl PoseTopics {
    pub(crate) fn find(drive: &Drive<'_>, options: &PoseOptions) -> Result<Self, IngestError> {
        if let Some(frames) = &options.frames {
            return Self::find_frames(drive, &frames.topics);
        }
        let Some(wheels) = &options.wheels else {
            let topic = options.topic.as_deref().unwrap_or_default();
            return Ok(Self::Poses(drive.topic(topic, "ingest.pose.topic", &POSE_TYPES)?));
        };
        let imu = options.imu.as_ref();
        Ok(Self::Wheels {
            wheels: drive.topic(wheels, "ingest.pose.wheels", &WHEEL_TYPES)?,
            imu: imu.map(|imu| drive.topic(imu, "ingest.pose.imu", &IMU_TYPES)).transpose()?,
        })
    }

    /// A log need not have them all: it may have no static transforms.
    fn find_frames(drive: &Drive<'_>, names: &[String]) -> Result<Self, IngestError> {
        let mut topics = Vec::new();
        let mut missing = None;
        for name in names {
            match drive.topic(name, "ingest.pose.frames.topics", &FRAME_TYPES) {
                Ok(topic) => topics.push(topic),
                Err(error @ IngestError::NoTopic { .. }) => missing = missing.or(Some(error)),
                Err(error) => return Err(error),
            }
        }
        match missing {
            Some(error) if topics.is_empty() => Err(error),
            _ => Ok(Self::Frames(topics)),
        }
    }

    pub(crate) fn all(&self) -> Vec<&Topic> {
        match self {
            Self::Poses(topic) => vec![topic],
            Self::Frames(topics) => topics.iter().collect(),
            Self::Wheels { wheels, imu } => [wheels].into_iter().chain(imu).collect(),
        }
    }

    /// The topic without which there is no pose.
    fn main(&self) -> &Topic {
        match self {
            Self::Poses(topic) | Self::Wheels { wheels: topic, .. } => topic,
            Self::Frames(topics) => &topics[0],
        }
    }
}

impl Motion {
    /// The trajectory of the lidar; what was left out and what is to be known is added.
    pub(crate) fn trajectory(
        self,
        from: &PoseSource<'_>,
        dropped: &mut Dropped,
        notes: &mut Vec<String>,
    ) -> Result<Trajectory, IngestError> {
        let options = from.options;
        let poses = match (from.topics, &options.frames) {
            (PoseTopics::Frames(_), Some(frames)) => {
                let (poses, n_beyond) = self
                    .frames
                    .poses(&frames.parent, &frames.child, from.upside_down)
                    .map_err(|why| from.no_frames(why, frames, &self.frames))?;
                notes.extend(self.frames.forks());
                let reason = "poses at stamps that another transform on the way does not reach, or is silent around";
                dropped.add(reason, n_beyond);
                poses
            }
            (PoseTopics::Wheels { wheels, .. }, _) => {
                let fused = self.fuse(options).map_err(|source| IngestError::Fuse {
                    path: from.path.to_owned(),
                    topic: wheels.name.clone(),
                    source,
                })?;
                notes.push(told(&fused));
                dropped.merge(fused.report.losses.clone().into());
                let pose = |p: &fuse::FusedPose| StampedPose {
                    stamp_ns: p.stamp_ns,
                    pose: p.pose,
                    covariance: Some(p.covariance),
                };
                fused.poses.iter().map(pose).collect()
            }
            _ => {
                match self.fixes.first().map(|first| options.origin.unwrap_or(gnss::origin(first)))
                {
                    Some(origin) => {
                        notes.push(format!(
                        "poses of {} fixes, headings by course, from the origin {{ latitude_deg = {}, longitude_deg = {}, altitude_m = {} }}",
                        self.fixes.len(), origin.latitude_deg, origin.longitude_deg, origin.altitude_m
                    ));
                        gnss::poses(&self.fixes, &origin)
                    }
                    None => self.poses,
                }
            }
        };
        let mount = from.mount;
        let poses = poses.into_iter().map(|pose| mounted(&pose, &mount)).collect();
        let (trajectory, n_duplicates) = Trajectory::new(poses);
        dropped.add("poses with the stamp of another pose", n_duplicates as u64);
        if trajectory.poses().is_empty() {
            return Err(from.no_poses(dropped));
        }
        notes.extend(jumps(&trajectory, options.max_speed_m_s));
        Ok(trajectory)
    }

    fn fuse(self, options: &PoseOptions) -> Result<Fused, fuse::FuseError> {
        let mut wheels = self.speeds;
        wheels.extend(WheelSample::from_positions(&self.positions));
        let readings: Vec<InertialReading> = self.imu.iter().map(ImuReading::inertial).collect();
        let yaw_rates = fuse::yaw_rates_rad_s(&readings, &wheels);
        let imu: Vec<ImuSample> = (self.imu.iter().zip(yaw_rates))
            .map(|(reading, yaw_rate_rad_s)| ImuSample {
                stamp_ns: reading.stamp_ns,
                yaw_rate_rad_s,
                heading_rad: reading.heading_rad,
            })
            .collect();
        let start = options.start.map(|start| start.pose());
        fuse::fuse(&options.fuse_options(), &wheels, &imu, start, None)
    }
}

/// Where the poses of a drive come from.
pub(crate) struct PoseSource<'a> {
    /// Stands for the drive in errors.
    pub(crate) path: &'a std::path::Path,
    pub(crate) topics: &'a PoseTopics,
    pub(crate) options: &'a PoseOptions,
    /// `base_from_lidar`
    pub(crate) mount: Pose2,
    /// Whether the lidar is known to hang.
    pub(crate) upside_down: bool,
}

impl PoseSource<'_> {
    fn no_poses(&self, dropped: &Dropped) -> IngestError {
        let detail = match dropped.is_empty() {
            true => String::new(),
            false => format!(" (dropped: {dropped})"),
        };
        let topic = self.topics.main().name.clone();
        IngestError::NoPoses { path: self.path.to_owned(), topic, detail }
    }

    fn no_frames(
        &self,
        why: LookupError,
        frames: &Frames,
        graph: &TransformHistory,
    ) -> IngestError {
        let names: Vec<String> = graph.names().iter().map(|name| format!("`{name}`")).collect();
        IngestError::NoFrames {
            path: self.path.to_owned(),
            parent: frames.parent.clone(),
            child: frames.child.clone(),
            why: match why {
                LookupError::Unconnected => "no transforms lead from one to the other",
                LookupError::Still => "none of the transforms between them moves",
                LookupError::UpsideDown => {
                    "its z axis points down: if that is the lidar's frame, set `ingest.lidar.upside_down = true`, and if not, name the robot's frame"
                }
            },
            found: match names.as_slice() {
                [] => "the log has no transform that can be read".to_owned(),
                names => format!("the transforms connect the frames {}", names.join(", ")),
            },
        }
    }
}

/// The pose of a sensor on the robot, of that of the robot, with its covariance: of
/// x + c mx - s my, y + s mx + c my and h, to first order.
fn mounted(robot: &StampedPose, mount: &Pose2) -> StampedPose {
    let pose = robot.pose * *mount;
    let [dx, dy] = [pose.x_m - robot.pose.x_m, pose.y_m - robot.pose.y_m];
    // How the sensor's x and y change with the robot's heading.
    let [a, b] = [-dy, dx];
    let covariance = robot.covariance.map(|[xx, xy, xh, yy, yh, hh]| {
        [
            xx + 2.0 * a * xh + a * a * hh,
            xy + b * xh + a * yh + a * b * hh,
            xh + a * hh,
            yy + 2.0 * b * yh + b * b * hh,
            yh + b * hh,
            hh,
        ]
    });
    StampedPose { stamp_ns: robot.stamp_ns, pose, covariance }
}

/// Poses that no robot of this speed gets to from the ones before, in a line.
fn jumps(trajectory: &Trajectory, max_speed_m_s: f64) -> Option<String> {
    let pairs = trajectory.poses().windows(2);
    let jumps: Vec<_> = pairs.filter(|p| is_jump(&p[0], &p[1], max_speed_m_s)).collect();
    let distance_m = |p: &[StampedPose]| p[0].pose.distance_m(&p[1].pose);
    let largest = jumps.iter().rev().max_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
    let secs = largest[1].stamp_ns.saturating_sub(largest[0].stamp_ns) as f64 * 1e-9;
    Some(format!(
        "{} jumps of the poses, faster than {max_speed_m_s} m/s, the largest of {:.2} m in {secs:.3} s at {} ns: poses between are not to be trusted (ingest.pose.max_speed_m_s)",
        jumps.len(),
        distance_m(largest),
        largest[0].stamp_ns
    ))
}
/// What the fusion found, in a line.
fn told(fused: &Fused) -> String {
    let report = &fused.report;
    let mut told = format!(
        "poses fused from {} readings of wheels and {} of the imu: {:.1} m, standing still {:.0} % of the time, track {:.3} +- {:.3} m",
        report.n_wheel_samples,
        report.n_imu_samples,
        report.distance_m,
        report.still_share * 100.0,
        report.track_m.value,
        report.track_m.std
    );
    if let Some(bias) = report.gyro_bias_mean_rad_s {
        told.push_str(&format!(", gyro bias {bias:.5} rad/s"));
    }
    if report.n_headings > 0 {
        told.push_str(&format!(
            ", {} headings used, {} of them outliers",
            report.n_headings, report.n_heading_outliers
        ));
    }
    if report.n_turn_outliers > 0 {
        told.push_str(&format!(", slip in {} s", report.n_turn_outliers));
    }
    for (gaps, of) in [(report.wheel_gaps, "wheels"), (report.imu_gaps, "imu")] {
        if gaps.n > 0 {
            told.push_str(&format!(", {} gaps of {of} of {:.1} s in all", gaps.n, gaps.secs));
        }
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::{Encoding, Imu, JointState, MessageType, Source, ros};

    fn options() -> PoseOptions {
        PoseOptions {
            wheels: Some("/wheels".to_owned()),
            imu: Some("/imu".to_owned()),
            track_m: Some(0.5),
            ..PoseOptions::default()
        }
    }

    fn add(motion: &mut Motion, message_type: MessageType, bytes: &[u8]) -> Result<(), String> {
        motion.add("/topic", Source { message_type, encoding: Encoding::Cdr }, bytes, &options())
    }

    fn joints(stamp_ns: i64, names: &[&str], velocities: &[f64], positions: &[f64]) -> Vec<u8> {
        let joints = JointState {
            stamp_ns,
            names: names.iter().map(|&name| name.to_owned()).collect(),
            positions: positions.to_vec(),
            velocities: velocities.to_vec(),
        };
        ros::write_joint_state(Encoding::Cdr, "base", &joints)
    }

    /// 10 s of a quarter turn: radius 2 m, so that the path ends at (2, 2), heading 90 deg. The IMU
    /// hangs upside down: up is its -z.
    #[test]
    fn wheels_and_an_imu_upside_down_give_the_arc() {
        let yaw_rate = std::f64::consts::FRAC_PI_2 / 10.0;
        let (left, right) = (yaw_rate * 1.75, yaw_rate * 2.25);
        let mut motion = Motion::default();
        for k in 0..=1000i64 {
            let stamp_ns = k * 10_000_000;
            let imu = Imu {
                stamp_ns,
                orientation: None,
                angular_velocity: [0.0, 0.0, -yaw_rate],
                linear_acceleration: Some([0.0, 0.0, -9.81]),
            };
            add(&mut motion, MessageType::Imu, &ros::write_imu(Encoding::Cdr, "imu", &imu))
                .unwrap();
            // Two wheels on each side, whose mean counts, in any order.
            let names = ["rear_Right", "front_left", "rear_left", "front_Right"];
            let speeds = [right + 0.1, left + 0.2, left - 0.2, right - 0.1];
            let bytes = joints(stamp_ns, &names, &speeds, &[]);
            add(&mut motion, MessageType::JointState, &bytes).unwrap();
        }
        let fused = motion.fuse(&options()).unwrap();
        let end = fused.poses.last().unwrap();
        assert!((end.pose.x_m - 2.0).abs() < 0.01 && (end.pose.y_m - 2.0).abs() < 0.01, "{end:?}");
        assert!((end.pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 0.01);
    }

    /// A lidar 2 m ahead of a robot that looks along y: an error of the heading of 0.1 rad moves it
    /// by 0.2 m along -x. With sd 0.3, 0.4 m and 0.1 rad, independent, x has 0.09 + 0.04.
    #[test]
    fn the_covariance_moves_with_the_mount() {
        let heading_rad = std::f64::consts::FRAC_PI_2;
        let robot = StampedPose {
            stamp_ns: 5,
            pose: Pose2 { x_m: 7.0, y_m: 8.0, heading_rad },
            covariance: Some([0.09, 0.0, 0.0, 0.16, 0.0, 0.01]),
        };
        let lidar = mounted(&robot, &Pose2 { x_m: 2.0, y_m: 0.0, heading_rad: 0.0 });
        assert!((lidar.pose.x_m - 7.0).abs() < 1e-12 && (lidar.pose.y_m - 10.0).abs() < 1e-12);
        let expected = [0.13, 0.0, -0.02, 0.16, 0.0, 0.01];
        for (found, expected) in lidar.covariance.unwrap().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{:?}", lidar.covariance);
        }
    }

    #[test]
    fn positions_are_differenced_and_joints_without_sides_named() {
        let mut motion = Motion::default();
        for k in 0..=100i64 {
            let bytes = joints(k * 100_000_000, &["left", "right"], &[], &[0.1 * k as f64; 2]);
            add(&mut motion, MessageType::JointState, &bytes).unwrap();
        }
        let fused = motion.fuse(&options()).unwrap();
        assert!((fused.report.distance_m - 9.9).abs() < 0.01, "{}", fused.report.distance_m);
        let bytes = joints(0, &["arm", "gripper"], &[1.0, 2.0], &[]);
        let reason = add(&mut Motion::default(), MessageType::JointState, &bytes).unwrap_err();
        assert_eq!(reason, "without joints named `left` and `right`, but arm, gripper");
    }
}
