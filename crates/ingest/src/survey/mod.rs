//! Summarizes a drive: the content of its topics, and the damage.

pub(crate) mod gather;
pub(crate) mod poses;
pub(crate) mod report;
