//! Messages that describe the motion of the robot -> its trajectory.

pub(crate) mod frames;
pub(crate) mod gnss;
pub(crate) mod message;
pub(crate) mod readings;
pub(crate) mod trajectory;
