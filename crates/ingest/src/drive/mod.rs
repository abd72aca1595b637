//! The files of one drive and their topics.

pub(crate) mod topic;
pub(crate) mod window;
