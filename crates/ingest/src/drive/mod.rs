//! The files of a drive, their topics, and the reading order.

pub(crate) mod split;
pub(crate) mod structure;
pub(crate) mod topic;
pub(crate) mod window;
