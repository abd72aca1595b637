//! One reader per type of data, for all message types and encodings.

use crate::wire::{Cursor, Decoded};
use crate::{
    Imu, JointState, LaserScan, MessageError, MessageType, NavSatFix, Odometry, PointCloud, Result,
    Source, StampedPose3, Transform, VelodyneScan, foxglove, ros,
};

/// Reads the stamp of a message \[ns since the epoch\]. It is `None` for transforms, each of which has
/// its own stamp. Only the start of a ROS message is read.
pub fn read_stamp_ns(source: Source, bytes: &[u8]) -> Result<Option<i64>> {
    let Source { message_type, encoding } = source;
    match message_type {
        MessageType::Tf | MessageType::FoxgloveFrameTransform => Ok(None),
        MessageType::VelodynePacket => Ok(Some(velodyne(source, bytes)?.value.stamp_ns)),
        MessageType::FoxgloveLaserScan
        | MessageType::FoxglovePointCloud
        | MessageType::FoxglovePoseInFrame => {
            foxglove::timestamp_ns(message_type, encoding, bytes).map(Some)
        }
        _ => Cursor::new(message_type, encoding, bytes)?.header_stamp_ns().map(Some),
    }
}

/// Reads the packets of a `VelodyneScan`, or the packet of a `VelodynePacket`.
pub fn read_velodyne(source: Source, bytes: &[u8]) -> Result<VelodyneScan<'_>> {
    velodyne(source, bytes).map(|decoded| decoded.value)
}

/// Reads a planar scan: `sensor_msgs/LaserScan` or `foxglove.LaserScan`.
///
/// A `foxglove.LaserScan` has no range limits; they are set to 0 and infinity. Its pose is ignored: a
/// scan is in the frame of the lidar.
pub fn read_laser_scan(source: Source, bytes: &[u8]) -> Result<LaserScan> {
    laser_scan(source, bytes).map(|decoded| decoded.value)
}

/// Reads a cloud of points: `sensor_msgs/PointCloud2` or `foxglove.PointCloud`.
///
/// The pose of a `foxglove.PointCloud` is ignored: a cloud is in the frame of the lidar.
pub fn read_point_cloud(source: Source, bytes: &[u8]) -> Result<PointCloud<'_>> {
    point_cloud(source, bytes).map(|decoded| decoded.value)
}

/// Reads a pose: `geometry_msgs/PoseStamped`, `geometry_msgs/PoseWithCovarianceStamped`,
/// `foxglove.PoseInFrame`, or the pose of a `nav_msgs/Odometry`.
pub fn read_pose(source: Source, bytes: &[u8]) -> Result<StampedPose3> {
    pose(source, bytes).map(|decoded| decoded.value)
}

/// Reads a pose like [`read_pose`], and its covariance if the message type has one. The covariance is
/// that of (x, y, z, rotation about x, y, z), (6, 6), row by row \[m, rad\].
pub fn read_pose_and_covariance(
    source: Source,
    bytes: &[u8],
) -> Result<(StampedPose3, Option<[f64; 36]>)> {
    pose_and_covariance(source, bytes).map(|decoded| decoded.value)
}

/// Reads a `nav_msgs/Odometry` with its velocities.
pub fn read_odometry(source: Source, bytes: &[u8]) -> Result<Odometry> {
    odometry(source, bytes).map(|decoded| decoded.value)
}

/// Reads a `sensor_msgs/Imu`.
///
/// The orientation is `None` if the first element of its covariance is -1, which means "not
/// measured", or if the quaternion is all zero. The acceleration is `None` if the first element of
/// its covariance is -1.
pub fn read_imu(source: Source, bytes: &[u8]) -> Result<Imu> {
    imu(source, bytes).map(|decoded| decoded.value)
}

/// Reads a `sensor_msgs/JointState`.
pub fn read_joint_state(source: Source, bytes: &[u8]) -> Result<JointState> {
    joint_state(source, bytes).map(|decoded| decoded.value)
}

/// Reads a `sensor_msgs/NavSatFix`.
pub fn read_nav_sat_fix(source: Source, bytes: &[u8]) -> Result<NavSatFix> {
    nav_sat_fix(source, bytes).map(|decoded| decoded.value)
}

/// Reads the transforms of a `tf2_msgs/TFMessage`, or the transform of a `foxglove.FrameTransform`.
pub fn read_transforms(source: Source, bytes: &[u8]) -> Result<Vec<Transform>> {
    transforms(source, bytes).map(|decoded| decoded.value)
}

pub(crate) fn velodyne(source: Source, bytes: &[u8]) -> Result<Decoded<VelodyneScan<'_>>> {
    match source.message_type {
        MessageType::VelodyneScan => VelodyneScan::read(source.encoding, bytes),
        MessageType::VelodynePacket => VelodyneScan::read_packet(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "Velodyne packets", found }),
    }
}

pub(crate) fn laser_scan(source: Source, bytes: &[u8]) -> Result<Decoded<LaserScan>> {
    match source.message_type {
        MessageType::LaserScan => ros::laser_scan(source.encoding, bytes),
        MessageType::FoxgloveLaserScan => foxglove::laser_scan(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "a laser scan", found }),
    }
}

pub(crate) fn point_cloud(source: Source, bytes: &[u8]) -> Result<Decoded<PointCloud<'_>>> {
    match source.message_type {
        MessageType::PointCloud2 => ros::point_cloud(source.encoding, bytes),
        MessageType::FoxglovePointCloud => foxglove::point_cloud(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "a point cloud", found }),
    }
}

pub(crate) fn pose(source: Source, bytes: &[u8]) -> Result<Decoded<StampedPose3>> {
    Ok(pose_and_covariance(source, bytes)?.map(|(pose, _)| pose))
}

fn pose_and_covariance(
    source: Source,
    bytes: &[u8],
) -> Result<Decoded<(StampedPose3, Option<[f64; 36]>)>> {
    let encoding = source.encoding;
    Ok(match source.message_type {
        MessageType::PoseStamped => ros::pose(encoding, bytes)?.map(|pose| (pose, None)),
        MessageType::PoseWithCovarianceStamped => ros::pose_with_covariance(encoding, bytes)?
            .map(|(pose, covariance)| (pose, Some(covariance))),
        MessageType::Odometry => ros::odometry(encoding, bytes)?
            .map(|odometry| (odometry.pose, Some(odometry.pose_covariance))),
        MessageType::FoxglovePoseInFrame => {
            foxglove::pose(encoding, bytes)?.map(|pose| (pose, None))
        }
        found => return Err(MessageError::WrongType { expected: "a pose", found }),
    })
}

fn odometry(source: Source, bytes: &[u8]) -> Result<Decoded<Odometry>> {
    match source.message_type {
        MessageType::Odometry => ros::odometry(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "odometry", found }),
    }
}

pub(crate) fn imu(source: Source, bytes: &[u8]) -> Result<Decoded<Imu>> {
    match source.message_type {
        MessageType::Imu => ros::imu(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "an inertial measurement", found }),
    }
}

pub(crate) fn joint_state(source: Source, bytes: &[u8]) -> Result<Decoded<JointState>> {
    match source.message_type {
        MessageType::JointState => ros::joint_state(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "a joint state", found }),
    }
}

pub(crate) fn nav_sat_fix(source: Source, bytes: &[u8]) -> Result<Decoded<NavSatFix>> {
    match source.message_type {
        MessageType::NavSatFix => ros::nav_sat_fix(source.encoding, bytes),
        found => Err(MessageError::WrongType { expected: "a satellite fix", found }),
    }
}

pub(crate) fn transforms(source: Source, bytes: &[u8]) -> Result<Decoded<Vec<Transform>>> {
    match source.message_type {
        MessageType::Tf => ros::transforms(source.encoding, bytes),
        MessageType::FoxgloveFrameTransform => {
            Ok(foxglove::transform(source.encoding, bytes)?.map(|transform| vec![transform]))
        }
        found => Err(MessageError::WrongType { expected: "transforms", found }),
    }
}
