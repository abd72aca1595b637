//! Observers: each is fed the messages of a topic in the order of the log, and reports what is wrong.
//! They do not change the data. Ingestion and the survey use the same observers.

pub(crate) mod frames;
pub(crate) mod stamps;
pub(crate) mod topic;
