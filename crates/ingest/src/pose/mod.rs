//! Messages that describe the motion of the robot -> its trajectory.

pub(crate) mod file;
pub(crate) mod frames;
pub(crate) mod gnss;
pub(crate) mod jumps;
pub(crate) mod message;
pub(crate) mod readings;
pub(crate) mod recorded;
pub(crate) mod topics;
pub(crate) mod trajectory;
