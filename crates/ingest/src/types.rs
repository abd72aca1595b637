//! The message types that each kind of topic can have.

use messages::MessageType;

/// The message types a scan can come from.
pub const LIDAR_TYPES: [MessageType; 6] = [
    MessageType::VelodyneScan,
    MessageType::VelodynePacket,
    MessageType::PointCloud2,
    MessageType::LaserScan,
    MessageType::FoxglovePointCloud,
    MessageType::FoxgloveLaserScan,
];
/// The message types a pose can come from.
pub const POSE_TYPES: [MessageType; 5] = [
    MessageType::PoseStamped,
    MessageType::PoseWithCovarianceStamped,
    MessageType::Odometry,
    MessageType::FoxglovePoseInFrame,
    MessageType::NavSatFix,
];
/// The message types that transforms between frames can come from.
pub const FRAME_TYPES: [MessageType; 2] = [MessageType::Tf, MessageType::FoxgloveFrameTransform];

/// The message types that the speeds of the wheels can come from.
pub const WHEEL_TYPES: [MessageType; 2] = [MessageType::JointState, MessageType::Odometry];
/// The message types that yaw rates can come from.
pub const IMU_TYPES: [MessageType; 1] = [MessageType::Imu];
