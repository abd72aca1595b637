//! Makes scans from lidar messages.

pub(crate) mod assemble;
pub(crate) mod beam;
pub(crate) mod cloud;
pub(crate) mod decode;
pub(crate) mod planar;
