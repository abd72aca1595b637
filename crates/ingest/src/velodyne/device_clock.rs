//! Time by the device clock of the sensor, which starts again at the top of the hour.

use messages::hdl32e::HOUR_US;

use crate::velodyne::packet::RingPacket;

/// Device time from one packet to another \[us\], negative where the other was earlier. The clock
/// starts again at the top of the hour: of the two ways around, the shorter.
#[inline]
pub(crate) fn device_gap_us(from: &RingPacket, to: &RingPacket) -> f64 {
    clock_gap_us(from.device_us, to.device_us)
}

/// The same from one reading of the clock to another.
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
