//! Distinguishes two sensors on one topic by their device clocks.
//!
//! The device clock of a sensor without GPS starts when the sensor is switched on. Two sensors
//! therefore differ in the time from device clock to stamp, and their packets alternate.

use messages::hdl32e::HOUR_US;

use crate::velodyne::packet::RingPacket;

/// Packets of one sensor differ by less than this in the time from device clock to stamp \[us\]. It
/// includes delays of the network, and a drift since the last packet.
const MAX_DIFFERENCE_US: i64 = 500_000;
/// A single sensor changes its clock a few times: at a start, or when it finds a GPS signal.
const MIN_ALTERNATIONS: u64 = 8;
/// Each of two sensors sends about half of the packets, and at least this share.
const MIN_SHARE: f64 = 0.2;

/// Counts the packets of each device clock.
#[derive(Debug, Default)]
pub(crate) struct SensorClocks {
    clocks: [Option<SensorClock>; 2],
    /// The clock of the last packet.
    last: usize,
    n_alternations: u64,
}

#[derive(Debug, Clone, Copy)]
struct SensorClock {
    /// Stamp minus device clock, past the hour \[us\].
    offset_us: i64,
    n_packets: u64,
}

impl SensorClocks {
    /// Adds the next packet. Packets without a stamp show nothing.
    pub(crate) fn add(&mut self, packet: &RingPacket) {
        if packet.end_ns == 0 {
            return;
        }
        let hour_us = i64::from(HOUR_US);
        let offset_us = (packet.end_ns / 1000 - i64::from(packet.device_us)).rem_euclid(hour_us);
        let is_near = |clock: &SensorClock| {
            let apart = (offset_us - clock.offset_us).rem_euclid(hour_us);
            apart.min(hour_us - apart) < MAX_DIFFERENCE_US
        };
        let known = self.clocks.iter().position(|clock| clock.as_ref().is_some_and(is_near));
        let index = match (known, self.clocks) {
            (Some(index), _) => index,
            (None, [None, _]) => 0,
            // A new clock replaces the one that was not used last.
            (None, [Some(_), _]) => 1 - self.last,
        };
        let n_packets = match (known, self.clocks[index]) {
            (Some(_), Some(clock)) => clock.n_packets,
            _ => 0,
        };
        self.clocks[index] = Some(SensorClock { offset_us, n_packets: n_packets + 1 });
        self.n_alternations += u64::from(known.is_some() && index != self.last);
        self.last = index;
    }

    /// The two clocks, if the packets come from two sensors.
    pub(crate) fn two_sensors(&self) -> Option<String> {
        let [Some(a), Some(b)] = self.clocks else { return None };
        let n = (a.n_packets + b.n_packets) as f64;
        let is_shared = MIN_SHARE * n <= a.n_packets.min(b.n_packets) as f64;
        (MIN_ALTERNATIONS <= self.n_alternations && is_shared).then(|| {
            let describe = |clock: SensorClock| {
                let offset_s = clock.offset_us as f64 * 1e-6;
                format!(
                    "{} packets with a device clock {offset_s:.1} s before the stamps",
                    clock.n_packets
                )
            };
            format!("{}, {} past the hour", describe(a), describe(b))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velodyne::packet::tests::packets;

    /// Messages of 10 packets. Every second one has a clock that is ahead by `ahead_us`.
    fn clocks(ahead_us: u32) -> SensorClocks {
        let mut clocks = SensorClocks::default();
        for (k, packet) in packets(400, 0, 20).iter().enumerate() {
            let ahead_us = if k / 10 % 2 == 0 { 0 } else { ahead_us };
            clocks
                .add(&RingPacket { device_us: (packet.device_us + ahead_us) % HOUR_US, ..*packet });
        }
        clocks
    }

    #[test]
    fn alternating_clocks_are_two_sensors() {
        let text = clocks(700_000_000).two_sensors().unwrap();
        assert!(text.starts_with("200 packets with a device clock"), "{text}");
        assert_eq!(clocks(0).two_sensors(), None);
        assert_eq!(clocks(400_000).two_sensors(), None, "a late packet");
    }

    #[test]
    fn a_clock_that_jumps_is_one_sensor() {
        let mut clocks = SensorClocks::default();
        for (k, packet) in packets(400, 0, 20).iter().enumerate() {
            let ahead_us = (k as u32 / 60) * 100_000_000;
            clocks
                .add(&RingPacket { device_us: (packet.device_us + ahead_us) % HOUR_US, ..*packet });
        }
        assert_eq!(clocks.two_sensors(), None);
    }
}
