//! The container: an MCAP file -> its records and messages.

pub(crate) mod chunk;
pub(crate) mod framing;
pub(crate) mod log;
pub(crate) mod record;
