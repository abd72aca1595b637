//! Packets of a Velodyne HDL-32E, from the bytes to complete revolutions.

pub(crate) mod clock;
pub(crate) mod deduplicate;
pub(crate) mod device_clock;
pub(crate) mod model;
pub(crate) mod packet;
pub(crate) mod packet_gap;
pub(crate) mod reorder;
pub(crate) mod revolution;
pub(crate) mod sensor_clocks;
pub(crate) mod split;
pub(crate) mod stream;
