//! What robot logs hold: the HDL-32E data packet ([`hdl32e`]) and the messages around it, of ROS 2
//! and ROS 1 ([`ros`]) and of Foxglove ([`foxglove`]), read and written.
//!
//! A [`Source`] says what a channel's messages are; one reader per noun turns a message's bytes into
//! it: [`read_velodyne`], [`read_laser_scan`], [`read_point_cloud`], [`read_pose`],
//! [`read_odometry`], [`read_imu`], [`read_joint_state`], [`read_nav_sat_fix`],
//! [`read_transforms`]. [`is_plausible_message`] tells what a channel without a schema holds.
//!
//! Invariant: this crate knows neither files nor MCAP; it sees one message's bytes at a time. No
//! bytes make a reader panic, and none makes it allocate more than a small multiple of their number.

mod error;
pub mod foxglove;
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
pub use point_cloud::{Column, PointCloud, PointField, Scalar};
pub use read::{
    read_imu, read_joint_state, read_laser_scan, read_nav_sat_fix, read_odometry, read_point_cloud,
    read_pose, read_pose_and_covariance, read_transforms, read_velodyne,
};
pub use ros::VelodyneScan;
pub use sniff::is_plausible_message;
pub use source::{Encoding, MessageType, Source};
pub use types::{Imu, JointState, LaserScan, NavSatFix, Odometry, StampedPose3, Transform};
