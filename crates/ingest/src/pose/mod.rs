//! Messages that describe the motion of the robot -> its trajectory.

pub(crate) mod chain;
pub(crate) mod clock;
pub(crate) mod file;
pub(crate) mod frame_names;
pub(crate) mod frames;
pub(crate) mod fusion;
pub(crate) mod gnss;
pub(crate) mod joint_speeds;
pub(crate) mod joints;
pub(crate) mod jumps;
pub(crate) mod live_wheels;
pub(crate) mod message;
pub(crate) mod only;
pub(crate) mod readings;
pub(crate) mod recorded;
pub(crate) mod reference;
pub(crate) mod segments;
pub(crate) mod topics;
pub(crate) mod trajectory;
pub(crate) mod twist;
pub(crate) mod wheel_error;
