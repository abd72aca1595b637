//! A summary of a whole drive: what its topics contain, and what is wrong with them.

pub(crate) mod gather;
pub(crate) mod report;
