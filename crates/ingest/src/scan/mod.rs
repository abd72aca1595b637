//! Makes scans from lidar messages.

pub(crate) mod assemble;
pub(crate) mod beam;
pub(crate) mod cloud;
pub(crate) mod cloud_frame;
pub(crate) mod decode;
pub(crate) mod log_time;
pub(crate) mod observers;
pub(crate) mod planar;
pub(crate) mod planar_faults;
pub(crate) mod point_time;
