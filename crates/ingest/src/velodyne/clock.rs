//! Assigns a time to each packet, from the stamp of the host or from the device clock.
//!
//! The sensor counts microseconds past the hour: UTC if a GPS receiver is attached, the time since
//! start-up otherwise. The host stamps a packet when it arrives from the network.

use std::collections::VecDeque;

use messages::hdl32e::HOUR_US;
use serde::{Deserialize, Serialize};

use crate::velodyne::device_clock::clock_gap_us;
use crate::velodyne::packet::RingPacket;

/// The clock that gives the time of a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// The stamp of each packet in the log.
    #[default]
    Host,
    /// The device clock, aligned to the host clock by the packet with the least delay in the last
    /// 10 s. This removes the network delays.
    Device,
    /// The device clock of a sensor that GPS keeps on UTC. The stamp of the host gives the hour.
    Gps,
}

/// Time window for the least delay \[ns\]. A drift of 50 ppm between the two clocks is 0.5 ms in this
/// time.
const WINDOW_NS: i64 = 10_000_000_000;
/// Maximum difference between GPS time and the host clock \[ns\]. Above it, the sensor is taken not to
/// be on GPS time.
const MAX_GPS_OFFSET_NS: i64 = 60_000_000_000;
const HOUR_NS: i64 = HOUR_US as i64 * 1000;

/// Assigns a time to each packet.
#[derive(Debug, Clone)]
pub(crate) struct Stamper {
    clock: Clock,
    last_us: Option<u32>,
    /// Device time since the last reset \[ns\].
    device_ns: i64,
    /// Candidates for the least delay, ascending: device time, and host minus device time \[ns\].
    delays: VecDeque<(i64, i64)>,
}

impl Stamper {
    pub(crate) fn new(clock: Clock) -> Self {
        Self { clock, last_us: None, device_ns: 0, delays: VecDeque::new() }
    }

    /// Forgets the offset of the clocks, because one of them jumped.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.clock);
    }

    /// The end of the last firing of a packet \[ns\]. `None` if the sensor is not on GPS time although
    /// the options say so. Packets must be in firing order.
    pub(crate) fn end_ns(&mut self, packet: &RingPacket) -> Option<i64> {
        match self.clock {
            Clock::Host => Some(packet.end_ns),
            Clock::Gps => gps_ns(packet),
            Clock::Device => Some(self.device_time(packet)),
        }
    }

    fn device_time(&mut self, packet: &RingPacket) -> i64 {
        if let Some(last_us) = self.last_us.replace(packet.device_us) {
            self.device_ns += (clock_gap_us(last_us, packet.device_us) * 1000.0) as i64;
        }
        let delay = packet.end_ns - self.device_ns;
        while self.delays.back().is_some_and(|&(_, other)| delay <= other) {
            self.delays.pop_back();
        }
        self.delays.push_back((self.device_ns, delay));
        while self.delays.front().is_some_and(|&(at, _)| at + WINDOW_NS < self.device_ns) {
            self.delays.pop_front();
        }
        let least = self.delays.front().map_or(delay, |&(_, least)| least);
        self.device_ns + least
    }
}

/// Detects steps of the stamps against the device clock. They occur when the host clock is set.
///
/// Network and host delay the stamps, sometimes by much, but every second has some packets without
/// delay. The least delays of two successive seconds therefore differ only by the drift of the
/// clocks.
#[derive(Debug, Clone, Default)]
pub(crate) struct HostClock {
    /// Device clock of the last packet \[us\].
    last_us: Option<u32>,
    /// Device time since the last reset \[ns\].
    device_ns: i64,
    /// Start of the current second \[ns\], and the least delay (stamp minus device time) in it.
    second: Option<(i64, i64)>,
    /// The least delay of the second before.
    least_before: Option<i64>,
    /// Number of steps.
    pub(crate) n_steps: u64,
    /// The largest step \[s\].
    pub(crate) largest_s: f64,
}

/// Minimum size of a step \[ns\].
const STEP_NS: i64 = 50_000_000;
const SECOND_NS: i64 = 1_000_000_000;

impl HostClock {
    /// Forgets the offset of the clocks, but keeps the counts.
    pub(crate) fn reset(&mut self) {
        let Self { n_steps, largest_s, .. } = *self;
        *self = Self { n_steps, largest_s, ..Self::default() };
    }

    /// Takes the next packet. Packets must be in firing order.
    pub(crate) fn push(&mut self, packet: &RingPacket) {
        if let Some(last_us) = self.last_us.replace(packet.device_us) {
            let gap_us = clock_gap_us(last_us, packet.device_us);
            // If the device clock stands still or jumps, start again.
            if gap_us <= 0.0 || 1e6 < gap_us {
                self.reset();
                return;
            }
            self.device_ns += (gap_us * 1000.0) as i64;
        }
        let delay = packet.end_ns.saturating_sub(self.device_ns);
        let (start, least) = self.second.get_or_insert((self.device_ns, delay));
        *least = delay.min(*least);
        if *start + SECOND_NS <= self.device_ns {
            let least = *least;
            if let Some(before) = self.least_before.replace(least) {
                let step_ns = least - before;
                if STEP_NS < step_ns.abs() {
                    self.n_steps += 1;
                    let step_s = step_ns as f64 * 1e-9;
                    if self.largest_s.abs() < step_s.abs() {
                        self.largest_s = step_s;
                    }
                }
            }
            self.second = None;
        }
    }
}

/// The end of a packet in GPS time \[ns\]. The device clock is read at the first firing of a packet
/// (manual 63-9113, "Time Stamp").
fn gps_ns(packet: &RingPacket) -> Option<i64> {
    let past_the_hour = i64::from(packet.device_us) * 1000 + packet.period_ns();
    let hour = packet.end_ns.div_euclid(HOUR_NS) * HOUR_NS;
    let around = [-1, 0, 1].map(|k| hour + k * HOUR_NS + past_the_hour);
    let nearest = around.into_iter().min_by_key(|ns| (ns - packet.end_ns).abs())?;
    ((nearest - packet.end_ns).abs() <= MAX_GPS_OFFSET_NS).then_some(nearest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velodyne::packet::tests::packets;

    /// Packets that leave the sensor every 552.96 us and arrive at the host `delay_ns(k)` later.
    fn delayed(n: usize, delay_ns: impl Fn(usize) -> i64) -> Vec<RingPacket> {
        let mut packets = packets(n, 0, 20);
        for (k, packet) in packets.iter_mut().enumerate() {
            packet.end_ns += delay_ns(k);
        }
        packets
    }

    fn stamps(clock: Clock, packets: &[RingPacket]) -> Vec<i64> {
        let mut stamper = Stamper::new(clock);
        packets.iter().filter_map(|packet| stamper.end_ns(packet)).collect()
    }

    #[test]
    fn the_host_clock_uses_the_stamps() {
        let packets = delayed(5, |k| 1_000_000 * (k as i64 % 2));
        assert!(stamps(Clock::Host, &packets).iter().eq(packets.iter().map(|p| &p.end_ns)));
    }

    /// Every tenth packet has no delay, the others up to 9 ms, so the least delay is 0.
    #[test]
    fn the_device_clock_removes_network_delays() {
        let on_time = packets(3000, 0, 20);
        let late = delayed(3000, |k| 1_000_000 * (k as i64 % 10));
        for (k, (stamp, packet)) in stamps(Clock::Device, &late).iter().zip(&on_time).enumerate() {
            // The device counts whole microseconds, 553 for 552.96. The error is 0.04 us per packet
            // over the window of 10 s, which contains all 3000 packets.
            let error_ns = (stamp - packet.end_ns).abs();
            assert!(error_ns <= 40 * k as i64, "packet {k}: {error_ns} ns");
        }
    }

    /// The host clock is set back by 0.5 s after 5 s, and forward again after 10 s.
    #[test]
    fn steps_of_the_host_clock_are_detected() {
        let steps = |delay_ns: &dyn Fn(usize) -> i64| {
            let mut host = HostClock::default();
            delayed(30_000, delay_ns).iter().for_each(|packet| host.push(packet));
            (host.n_steps, (host.largest_s * 10.0).round())
        };
        assert_eq!(
            steps(&|k| if (9042..18_084).contains(&k) { -500_000_000 } else { 0 }),
            (2, -5.0)
        );
        // One stamp per message (delays up to 100 ms) is not a step, nor is a drift of 50 ppm.
        assert_eq!(steps(&|k| (180 - k as i64 % 181) * 552_960), (0, 0.0));
        assert_eq!(steps(&|k| k as i64 * 28), (0, 0.0));
    }

    #[test]
    fn a_delay_is_forgotten_after_ten_seconds() {
        // 30,000 packets take 16.6 s. The host clock is set forward by 1 s after 100 packets, which
        // is not an interruption.
        let packets = delayed(30_000, |k| if k < 100 { 0 } else { 1_000_000_000 });
        let stamps = stamps(Clock::Device, &packets);
        assert!(900_000_000 < packets[10_000].end_ns - stamps[10_000]);
        assert!((packets[29_999].end_ns - stamps[29_999]).abs() < 1_000_000);
    }

    #[test]
    fn on_gps_time_the_device_clock_gives_the_time_and_the_stamp_the_hour() {
        let mut packets = packets(6, 0, 20);
        // The device clock wraps after the third packet. The host is 0.2 s late.
        let hour_ns = 500_000 * HOUR_NS;
        for packet in &mut packets {
            let us = i64::from(packet.device_us);
            let since_hour = if us < 1_000_000 { us } else { us - i64::from(HOUR_US) };
            packet.end_ns = hour_ns + since_hour * 1000 + 200_000_000;
        }
        for (stamp, packet) in stamps(Clock::Gps, &packets).iter().zip(&packets) {
            assert_eq!(stamp - 552_960 + 200_000_000, packet.end_ns);
        }
        packets.iter_mut().for_each(|packet| packet.end_ns += 600_000_000_000);
        assert!(
            stamps(Clock::Gps, &packets).is_empty(),
            "a free-running clock is off by 10 minutes"
        );
    }
}
