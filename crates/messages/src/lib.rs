//! The message formats in robot logs: the HDL-32E data packet ([`hdl32e`]), the messages of ROS 2 and
//! ROS 1 ([`ros`]), and the messages of Foxglove ([`foxglove`]). This crate reads and writes them.
//!
//! A [`Source`] is the type and the encoding of the messages of a channel. There is one reader per
//! type of data: [`read_velodyne`], [`read_laser_scan`], [`read_point_cloud`], [`read_pose`],
//! [`read_odometry`], [`read_imu`], [`read_joint_state`], [`read_nav_sat_fix`] and
//! [`read_transforms`]. For a channel without a schema, [`is_plausible_message`] checks whether a
//! message could be of a given type.
//!
//! This crate knows neither files nor MCAP; it works on the bytes of one message at a time. No bytes
//! make a reader panic, and a reader allocates at most a small multiple of the number of bytes.
//!
//! ```
//! use messages::{Source, StampedPose3, read_pose, ros};
//!
//! let pose = StampedPose3 {
//!     stamp_ns: 1_000_000_000,
//!     position: [1.0, 2.0, 0.0],
//!     orientation: [0.0, 0.0, 0.0, 1.0],
//! };
//! // The schema name and the message encoding, as in an MCAP channel.
//! let source = Source::new("geometry_msgs/msg/PoseStamped", "cdr").unwrap();
//! let bytes = ros::write_pose_stamped(source.encoding, "map", &pose);
//! assert_eq!(read_pose(source, &bytes)?, pose);
//! # Ok::<(), messages::MessageError>(())
//! ```

mod error;
pub mod foxglove;
mod frame_ids;
pub mod hdl32e;
mod point_cloud;
mod read;
pub mod ros;
pub mod schemas;
mod sniff;
mod source;
mod types;
mod wire;

pub use error::{MessageError, Result};
pub use frame_ids::{FrameIds, read_frame_ids};
pub use point_cloud::{Column, PointCloud, PointField, Scalar};
pub use read::{
    read_imu, read_joint_state, read_laser_scan, read_nav_sat_fix, read_odometry, read_point_cloud,
    read_pose, read_pose_and_covariance, read_stamp_ns, read_transforms, read_velodyne,
};
pub use ros::VelodyneScan;
pub use sniff::is_plausible_message;
pub use source::{Encoding, MessageType, Source};
pub use types::{Imu, JointState, LaserScan, NavSatFix, Odometry, StampedPose3, Transform};
