//! What a log says of the robot's motion -> its trajectory: poses as they are, of transforms, of
//! satellite fixes, or fused from wheels and IMU.

use dataset::{LossKind, Losses, Note, NoteKind, Pose2, StampedPose, Trajectory};
use fuse::{Fused, ImuSample, InertialReading, WheelSample};

use crate::deskew::motion::is_jump;
use crate::drive::topic::{Drive, Topic};
use crate::error::IngestError;
use crate::pose::frames::{LookupError, TransformHistory};
use crate::pose::gnss;
use crate::pose::readings::{ImuReading, Motion};
use crate::pose_options::{Frames, Origin, PoseOptions};
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
        losses: &mut Losses,
        notes: &mut Vec<Note>,
    ) -> Result<Trajectory, IngestError> {
        let options = from.options;
        let poses = match (from.topics, &options.frames) {
            (PoseTopics::Frames(_), Some(frames)) => {
                let (poses, n_beyond) = self
                    .frames
                    .poses(&frames.parent, &frames.child, from.upside_down)
                    .map_err(|why| from.no_frames(why, frames, &self.frames))?;
                notes.extend(self.frames.forks());
                losses.add(LossKind::PosesWithoutTransform, n_beyond);
                poses
            }
            (PoseTopics::Wheels { wheels, .. }, _) => {
                let fused = self.fuse(options).map_err(|source| IngestError::Fuse {
                    path: from.path.to_owned(),
                    topic: wheels.name.clone(),
                    source,
                })?;
                notes.extend(fusion_notes(&fused));
                losses.merge(fused.report.losses.clone());
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
                        let Origin { latitude_deg, longitude_deg, altitude_m } = origin;
                        let n_fixes = self.fixes.len() as u64;
                        notes.push(
                            NoteKind::PosesFromFixes {
                                n_fixes,
                                latitude_deg,
                                longitude_deg,
                                altitude_m,
                            }
                            .into(),
                        );
                        gnss::poses(&self.fixes, &origin)
                    }
                    None => self.poses,
                }
            }
        };
        let mount = from.mount;
        let poses = poses.into_iter().map(|pose| mounted(&pose, &mount)).collect();
        let (trajectory, n_duplicates) = Trajectory::new(poses);
        losses.add(LossKind::DuplicatePoseStamps, n_duplicates as u64);
        if trajectory.poses().is_empty() {
            return Err(from.no_poses(losses));
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
    fn no_poses(&self, losses: &Losses) -> IngestError {
        let topic = self.topics.main().name.clone();
        IngestError::NoPoses { path: self.path.to_owned(), topic, losses: losses.clone() }
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

/// Poses that a robot of this speed cannot reach from the pose before.
fn jumps(trajectory: &Trajectory, max_speed_m_s: f64) -> Option<Note> {
    let pairs = trajectory.poses().windows(2);
    let jumps: Vec<_> = pairs.filter(|p| is_jump(&p[0], &p[1], max_speed_m_s)).collect();
    let distance_m = |p: &[StampedPose]| p[0].pose.distance_m(&p[1].pose);
    let largest = jumps.iter().rev().max_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
    Some(
        NoteKind::PoseJumps {
            n_jumps: jumps.len() as u64,
            max_speed_m_s,
            largest_m: distance_m(largest),
            largest_s: largest[1].stamp_ns.saturating_sub(largest[0].stamp_ns) as f64 * 1e-9,
            stamp_ns: largest[0].stamp_ns,
        }
        .into(),
    )
}

/// Notes about the fusion of wheels and IMU.
fn fusion_notes(fused: &Fused) -> Vec<Note> {
    let report = &fused.report;
    let mut notes = vec![NoteKind::PosesFused {
        n_wheel_samples: report.n_wheel_samples as u64,
        n_imu_samples: report.n_imu_samples as u64,
        distance_m: report.distance_m,
        still_share: report.still_share,
        track_m: report.track_m.value,
        track_std_m: report.track_m.std,
        gyro_bias_rad_s: report.gyro_bias_mean_rad_s,
    }];
    if 0 < report.n_headings {
        let (n_headings, n_outliers) = (report.n_headings, report.n_heading_outliers);
        notes.push(NoteKind::HeadingsUsed { n_headings, n_outliers });
    }
    if 0 < report.n_turn_outliers {
        notes.push(NoteKind::WheelSlip { secs: report.n_turn_outliers });
    }
    for (gaps, sensor) in [(report.wheel_gaps, "wheel"), (report.imu_gaps, "imu")] {
        if 0 < gaps.n {
            let (n_gaps, secs) = (gaps.n, gaps.secs);
            notes.push(NoteKind::SampleGaps { sensor: sensor.to_owned(), n_gaps, secs });
        }
    }
    notes.into_iter().map(Note::from).collect()
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

    fn add(motion: &mut Motion, message_type: MessageType, bytes: &[u8]) -> Result<(), LossKind> {
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
        assert_eq!(reason, LossKind::NoWheelJoints { joints: "arm, gripper".to_owned() });
    }
}
