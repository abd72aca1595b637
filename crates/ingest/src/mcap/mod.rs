//! The MCAP container: from the file to records and messages.

pub(crate) mod bytes;
pub(crate) mod chunk;
pub(crate) mod definitions;
pub(crate) mod framing;
pub(crate) mod log;
pub(crate) mod record;
