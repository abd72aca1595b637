//! Converts records to ROS 2 messages.

use messages::ros;
use messages::{
    Encoding, Imu, JointState, LaserScan, MessageType, NavSatFix, Odometry, PointCloud, PointField,
    Scalar, StampedPose3,
};
use nalgebra::Isometry3;

use crate::options::Topic;
use crate::record::{Body, Point, Record, Twist};

const CDR: Encoding = Encoding::Cdr;
/// The size of a point \[bytes\]. The layout is that of `velodyne_pointcloud`.
const POINT_STEP: usize = 22;

/// The type of the messages on a topic.
pub(crate) fn message_type(topic: Topic) -> MessageType {
    match topic {
        Topic::Packets => MessageType::VelodyneScan,
        Topic::Fix | Topic::FixRtk => MessageType::NavSatFix,
        Topic::Points => MessageType::PointCloud2,
        Topic::Imu | Topic::Kvh => MessageType::Imu,
        Topic::Wheels => MessageType::JointState,
        Topic::GroundTruth | Topic::Pose => MessageType::PoseStamped,
        Topic::Odom | Topic::OdomLines => MessageType::Odometry,
        Topic::Scan | Topic::RearScan => MessageType::LaserScan,
    }
}

/// The frame of the messages on a topic.
fn frame_id(topic: Topic) -> &'static str {
    match topic {
        Topic::Packets | Topic::Points => "velodyne",
        Topic::Fix => "gps",
        Topic::FixRtk => "gps_rtk",
        Topic::Imu => "imu_link",
        Topic::Kvh => "kvh",
        Topic::Wheels => BASE_FRAME,
        Topic::GroundTruth | Topic::Pose => "map",
        Topic::Odom | Topic::OdomLines => "odom",
        Topic::Scan => "laser",
        Topic::RearScan => "rear_laser",
    }
}

const BASE_FRAME: &str = "base_link";

/// Encodes a record as CDR.
pub(crate) fn encode(record: &Record) -> Vec<u8> {
    let stamp_ns = record.stamp_ns;
    let frame_id = frame_id(record.topic);
    match &record.body {
        Body::Packets(packets) => ros::write_velodyne_scan(CDR, frame_id, stamp_ns, packets),
        Body::Cloud(points) => ros::write_point_cloud2(CDR, frame_id, &cloud(stamp_ns, points)),
        Body::Imu(imu) => {
            let imu = Imu {
                stamp_ns,
                orientation: imu.orientation.map(|orientation| orientation.coords.into()),
                angular_velocity: imu.angular_velocity,
                linear_acceleration: imu.linear_acceleration,
            };
            ros::write_imu(CDR, frame_id, &imu)
        }
        Body::Wheels { left, right } => {
            let state = JointState {
                stamp_ns,
                names: ["left_wheel", "right_wheel"].map(str::to_owned).into(),
                positions: Vec::new(),
                velocities: vec![*left, *right],
            };
            ros::write_joint_state(CDR, frame_id, &state)
        }
        Body::Pose(pose) => ros::write_pose_stamped(CDR, frame_id, &stamped(stamp_ns, pose)),
        Body::Odometry(pose, twist) => {
            ros::write_odometry(CDR, &odometry(stamp_ns, frame_id, pose, *twist))
        }
        Body::Fix(fix) => {
            let fix = NavSatFix {
                stamp_ns,
                status: 0,
                latitude_deg: fix.latitude,
                longitude_deg: fix.longitude,
                altitude_m: fix.altitude,
                covariance: [0.0; 9],
            };
            ros::write_nav_sat_fix(CDR, frame_id, &fix)
        }
        Body::Scan(scan) => {
            let scan = LaserScan {
                stamp_ns,
                angle_min: scan.angle_min,
                angle_max: None,
                angle_increment: scan.angle_increment,
                time_increment_s: 0.0,
                range_min: 0.0,
                range_max: scan.range_max,
                ranges: scan.ranges.clone(),
            };
            ros::write_laser_scan(CDR, frame_id, &scan)
        }
    }
}

fn stamped(stamp_ns: i64, pose: &Isometry3<f64>) -> StampedPose3 {
    StampedPose3 {
        stamp_ns,
        position: pose.translation.vector.into(),
        orientation: pose.rotation.coords.into(),
    }
}

fn odometry(stamp_ns: i64, frame_id: &str, pose: &Isometry3<f64>, twist: Twist) -> Odometry {
    Odometry {
        pose: stamped(stamp_ns, pose),
        frame_id: frame_id.to_owned(),
        child_frame_id: BASE_FRAME.to_owned(),
        pose_covariance: [0.0; 36],
        linear_velocity: [twist.forward, 0.0, 0.0],
        angular_velocity: [0.0, 0.0, twist.yaw_rate],
    }
}

fn cloud(stamp_ns: i64, points: &[Point]) -> PointCloud<'static> {
    let field = |name: &str, offset, kind| PointField { name: name.to_owned(), offset, kind };
    let mut data = Vec::with_capacity(points.len() * POINT_STEP);
    for point in points {
        let [x, y, z] = point.position;
        for value in [x, y, z, point.intensity] {
            data.extend_from_slice(&value.to_le_bytes());
        }
        data.extend_from_slice(&point.ring.to_le_bytes());
        data.extend_from_slice(&point.time.to_le_bytes());
    }
    PointCloud {
        stamp_ns,
        width: points.len(),
        height: 1,
        point_step: POINT_STEP,
        row_step: points.len() * POINT_STEP,
        big_endian: false,
        fields: vec![
            field("x", 0, Scalar::F32),
            field("y", 4, Scalar::F32),
            field("z", 8, Scalar::F32),
            field("intensity", 12, Scalar::F32),
            field("ring", 16, Scalar::U16),
            field("time", 18, Scalar::F32),
        ],
        data: data.into(),
    }
}
