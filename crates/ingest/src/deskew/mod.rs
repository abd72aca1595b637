//! Corrects scans for the motion of the lidar while it measured them.

pub(crate) mod feed;
pub(crate) mod motion;
pub(crate) mod queue;
