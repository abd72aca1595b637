//! The message types that a topic of each kind can have.

use messages::MessageType;

/// The message types of lidar topics.
pub const LIDAR_TYPES: [MessageType; 6] = [
    MessageType::VelodyneScan,
    MessageType::VelodynePacket,
    MessageType::PointCloud2,
    MessageType::LaserScan,
    MessageType::FoxglovePointCloud,
    MessageType::FoxgloveLaserScan,
];
/// The message types of pose topics.
pub const POSE_TYPES: [MessageType; 5] = [
    MessageType::PoseStamped,
    MessageType::PoseWithCovarianceStamped,
    MessageType::Odometry,
    MessageType::FoxglovePoseInFrame,
    MessageType::NavSatFix,
];
/// The message types of transform topics.
pub const FRAME_TYPES: [MessageType; 2] = [MessageType::Tf, MessageType::FoxgloveFrameTransform];

/// The message types of wheel topics.
pub const WHEEL_TYPES: [MessageType; 2] = [MessageType::JointState, MessageType::Odometry];
/// The message types of IMU topics.
pub const IMU_TYPES: [MessageType; 1] = [MessageType::Imu];
