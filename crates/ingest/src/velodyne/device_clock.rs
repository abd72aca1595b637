//! Time differences by the device clock of the sensor, which restarts at the top of every hour.

use messages::hdl32e::HOUR_US;

use crate::velodyne::packet::RingPacket;

/// Device time from one packet to another \[us\], negative if the second packet is earlier.
///
/// The clock wraps at the top of the hour. The result is the shorter of the two possible
/// differences.
#[inline]
pub(crate) fn device_gap_us(from: &RingPacket, to: &RingPacket) -> f64 {
    clock_gap_us(from.device_us, to.device_us)
}

/// Device time from one clock reading to another \[us\]; see [`device_gap_us`].
#[inline]
pub(crate) fn clock_gap_us(from_us: u32, to_us: u32) -> f64 {
    let hour = f64::from(HOUR_US);
    let gap = f64::from(to_us) - f64::from(from_us);
    if gap < -hour / 2.0 {
        gap + hour
    } else if hour / 2.0 < gap {
        gap - hour
    } else {
        gap
    }
}
