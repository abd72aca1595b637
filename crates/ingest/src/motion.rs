//! What a log says of the robot's motion -> its trajectory: poses as they are, or fused from wheels
//! and IMU.

use dataset::{Dropped, Pose2, StampedPose, Trajectory};
use fuse::{Fused, ImuSample, Inertial, WheelSample};
use messages::{MessageType, Source, read_imu, read_joint_state, read_odometry};

use crate::error::IngestError;
use crate::options::PoseOptions;
use crate::poses::{stamped_pose, yaw_rad};
use crate::topic::{Drive, Topic};
use crate::{IMU_TYPES, POSE_TYPES, WHEEL_TYPES};

/// The topics that poses come from.
pub(crate) enum PoseTopics {
    /// One that has them.
    Poses(Topic),
    /// Those they are made from.
    Wheels { wheels: Topic, imu: Option<Topic> },
}

impl PoseTopics {
    pub(crate) fn find(drive: &Drive<'_>, options: &PoseOptions) -> Result<Self, IngestError> {
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

    pub(crate) fn all(&self) -> Vec<&Topic> {
        match self {
            Self::Poses(topic) => vec![topic],
            Self::Wheels { wheels, imu } => [wheels].into_iter().chain(imu).collect(),
        }
    }

    /// The topic without which there is no pose.
    fn main(&self) -> &Topic {
        match self {
            Self::Poses(topic) | Self::Wheels { wheels: topic, .. } => topic,
        }
    }
}

/// Readings of sensors of motion, in the order of the log.
#[derive(Debug, Default)]
pub(crate) struct Motion {
    poses: Vec<StampedPose>,
    /// Speeds of the wheels.
    speeds: Vec<WheelSample>,
    /// Positions of the wheels: stamp \[ns\], left and right \[m\].
    positions: Vec<(i64, f64, f64)>,
    imu: Vec<ImuReading>,
}

#[derive(Debug, Clone, Copy)]
struct ImuReading {
    stamp_ns: i64,
    angular_velocity: [f64; 3],
    acceleration: Option<[f64; 3]>,
    heading_rad: Option<f64>,
}

impl Motion {
    /// Adds a message of one of the topics; the error says what is wrong with it ("that ...").
    pub(crate) fn add(
        &mut self,
        source: Source,
        data: &[u8],
        options: &PoseOptions,
    ) -> Result<(), String> {
        let undecodable = |error: messages::MessageError| {
            format!("that do not decode as {} ({})", source.message_type.name(), error.kind())
        };
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
    ) -> Result<(), String> {
        let joints = read_joint_state(source, data)
            .map_err(|error| format!("that do not decode as JointState ({})", error.kind()))?;
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
            return Err(format!(
                "without joints named `left` and `right`, but {}",
                joints.names.join(", ")
            ));
        }
        Ok(())
    }

    /// Adds what comes later in the log; returns how many poses are earlier than those before.
    pub(crate) fn extend(&mut self, other: Self) -> u64 {
        let before = self.poses.len().saturating_sub(1);
        self.poses.extend(other.poses);
        self.speeds.extend(other.speeds);
        self.positions.extend(other.positions);
        self.imu.extend(other.imu);
        let steps = self.poses[before.min(self.poses.len())..].windows(2);
        steps.filter(|pair| pair[1].stamp_ns < pair[0].stamp_ns).count() as u64
    }

    /// The trajectory of the drive; what was left out and what is to be known is added. `path`
    /// stands for the drive in errors.
    pub(crate) fn trajectory(
        self,
        path: &std::path::Path,
        topics: &PoseTopics,
        options: &PoseOptions,
        dropped: &mut Dropped,
        notes: &mut Vec<String>,
    ) -> Result<Trajectory, IngestError> {
        let poses = match topics {
            PoseTopics::Poses(_) => self.poses,
            PoseTopics::Wheels { wheels, .. } => {
                let fused = self.fuse(options).map_err(|source| IngestError::Fuse {
                    path: path.to_owned(),
                    topic: wheels.name.clone(),
                    source,
                })?;
                notes.push(told(&fused));
                dropped.merge(fused.report.dropped.clone());
                let pose = |p: &fuse::FusedPose| StampedPose {
                    stamp_ns: p.stamp_ns,
                    pose: p.pose,
                    covariance: Some(p.covariance),
                };
                fused.poses.iter().map(pose).collect()
            }
        };
        let (trajectory, n_duplicates) = Trajectory::new(poses);
        dropped.add("poses with the stamp of another pose", n_duplicates as u64);
        if trajectory.poses().is_empty() {
            let topic = topics.main().name.clone();
            let detail = match dropped.is_empty() {
                true => String::new(),
                false => format!(" (dropped: {dropped})"),
            };
            return Err(IngestError::NoPoses { path: path.to_owned(), topic, detail });
        }
        Ok(trajectory)
    }

    fn fuse(self, options: &PoseOptions) -> Result<Fused, fuse::FuseError> {
        let mut wheels = self.speeds;
        wheels.extend(WheelSample::from_positions(&self.positions));
        let readings: Vec<Inertial> = self.imu.iter().map(ImuReading::inertial).collect();
        let yaw_rates = fuse::yaw_rates_rad_s(&readings, &wheels);
        let imu: Vec<ImuSample> = (self.imu.iter().zip(yaw_rates))
            .map(|(reading, yaw_rate_rad_s)| ImuSample {
                stamp_ns: reading.stamp_ns,
                yaw_rate_rad_s,
                heading_rad: reading.heading_rad,
            })
            .collect();
        let start = options.start.map(|start| Pose2 {
            x_m: start.x_m,
            y_m: start.y_m,
            heading_rad: start.heading_deg.to_radians(),
        });
        fuse::fuse(&options.fuse_options(), &wheels, &imu, start, None)
    }
}

impl ImuReading {
    fn inertial(&self) -> Inertial {
        let &Self { stamp_ns, angular_velocity, acceleration, .. } = self;
        Inertial { stamp_ns, angular_velocity, acceleration }
    }
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
    use messages::{Encoding, Imu, JointState, ros};

    fn options() -> PoseOptions {
        PoseOptions {
            wheels: Some("/wheels".to_owned()),
            imu: Some("/imu".to_owned()),
            track_m: Some(0.5),
            ..PoseOptions::default()
        }
    }

    fn add(motion: &mut Motion, message_type: MessageType, bytes: &[u8]) -> Result<(), String> {
        motion.add(Source { message_type, encoding: Encoding::Cdr }, bytes, &options())
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
