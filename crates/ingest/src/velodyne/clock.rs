//! The time of a packet: the host's stamp, or the device clock placed on it.
//!
//! The sensor counts microseconds past the hour: of UTC where a GPS receiver is attached, of its
//! own start-up time otherwise. The host stamps a packet when it has come through the network.

use std::collections::VecDeque;

use messages::hdl32e::HOUR_US;
use serde::{Deserialize, Serialize};

use crate::velodyne::device_clock::clock_gap_us;
use crate::velodyne::packet::RingPacket;

/// Where the time of a scan comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// The stamp that the log gives each packet.
    #[default]
    Host,
    /// The device clock, placed on the host's by the packet that was least delayed in the last 10
    /// s: the steps of the device clock, without the delays of the network.
    Device,
    /// The device clock as it stands, of a sensor that GPS keeps on UTC; the host's stamp tells the
    /// hour.
    Gps,
}

/// How long a packet's delay bears on the packets after it \[ns\]: of two clocks that drift apart
/// by 50 ppm, the drift is 0.5 ms in this time.
const WINDOW_NS: i64 = 10_000_000_000;
/// A sensor on GPS time and a host that are farther apart than this are not on one time \[ns\].
const MAX_GPS_OFFSET_NS: i64 = 60_000_000_000;
const HOUR_NS: i64 = HOUR_US as i64 * 1000;

/// Gives packets their time.
#[derive(Debug)]
pub(crate) struct Stamper {
    clock: Clock,
    last_us: Option<u32>,
    /// Device time since the last reset \[ns\].
    device_ns: i64,
    /// Delays that can still be the least, ascending: device time and host minus device \[ns\].
    delays: VecDeque<(i64, i64)>,
}

impl Stamper {
    pub(crate) fn new(clock: Clock) -> Self {
        Self { clock, last_us: None, device_ns: 0, delays: VecDeque::new() }
    }

    /// Forgets how the clocks stood: one of them has jumped.
    pub(crate) fn reset(&mut self) {
        *self = Self::new(self.clock);
    }

    /// When the packet's last firing ended \[ns\]; none for a sensor that should be on GPS time and
    /// is not. Packets come in order.
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

/// Watches the stamps for steps against the device clock, such as a host makes that is set right.
///
/// Stamps are late by what network and host take, at times by much, but of the packets of a second
/// some are in time: the least delays of two seconds in a row differ by the drift of the clocks.
#[derive(Debug, Default)]
pub(crate) struct HostClock {
    /// The device clock at the last packet.
    last_us: Option<u32>,
    /// Device time since the last reset \[ns\].
    device_ns: i64,
    /// Start of the second \[ns\], and the least of stamp minus device time in it.
    second: Option<(i64, i64)>,
    /// The same of the second before.
    least_before: Option<i64>,
    pub(crate) n_steps: u64,
    /// The largest of them \[s\].
    pub(crate) largest_s: f64,
}

/// A step of the stamps is told from this on \[ns\].
const STEP_NS: i64 = 50_000_000;
const SECOND_NS: i64 = 1_000_000_000;

impl HostClock {
    /// Forgets how the clocks stood.
    pub(crate) fn reset(&mut self) {
        let Self { n_steps, largest_s, .. } = *self;
        *self = Self { n_steps, largest_s, ..Self::default() };
    }

    /// Takes the next packet, in order.
    pub(crate) fn push(&mut self, packet: &RingPacket) {
        if let Some(last_us) = self.last_us.replace(packet.device_us) {
            let gap_us = clock_gap_us(last_us, packet.device_us);
            // A clock that stands still or jumps tells nothing.
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

/// The device clock tells a packet's first firing (manual 63-9113, "Time Stamp"), the host's stamp
/// its end.
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

    /// Packets that leave the sensor every 552.96 us and reach the host `delay_ns(k)` later.
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
    fn the_host_clock_is_the_stamp() {
        let packets = delayed(5, |k| 1_000_000 * (k as i64 % 2));
        assert!(stamps(Clock::Host, &packets).iter().eq(packets.iter().map(|p| &p.end_ns)));
    }

    /// Every tenth packet comes at once, the others up to 9 ms late: the least delay is 0.
    #[test]
    fn the_device_clock_takes_out_the_delays_of_the_network() {
        let on_time = packets(3000, 0, 20);
        let late = delayed(3000, |k| 1_000_000 * (k as i64 % 10));
        for (k, (stamp, packet)) in stamps(Clock::Device, &late).iter().zip(&on_time).enumerate() {
            // The device counts whole microseconds, 553 for 552.96: 0.04 us a packet, of which the
            // last 10 s hold all 3000 here.
            let error_ns = (stamp - packet.end_ns).abs();
            assert!(error_ns <= 40 * k as i64, "packet {k}: {error_ns} ns");
        }
    }

    /// The host is set back by 0.5 s after 5 s, and on again after 10 s.
    #[test]
    fn steps_of_the_host_are_told() {
        let steps = |delay_ns: &dyn Fn(usize) -> i64| {
            let mut host = HostClock::default();
            delayed(30_000, delay_ns).iter().for_each(|packet| host.push(packet));
            (host.n_steps, (host.largest_s * 10.0).round())
        };
        assert_eq!(
            steps(&|k| if (9042..18_084).contains(&k) { -500_000_000 } else { 0 }),
            (2, -5.0)
        );
        // Stamps of whole messages, late by up to 100 ms, are no steps; nor is drift of 50 ppm.
        assert_eq!(steps(&|k| (180 - k as i64 % 181) * 552_960), (0, 0.0));
        assert_eq!(steps(&|k| k as i64 * 28), (0, 0.0));
    }

    #[test]
    fn a_delay_is_forgotten_after_ten_seconds() {
        // 30,000 packets are 16.6 s; the host's clock was set on by 1 s after 100 of them, which is
        // no interruption.
        let packets = delayed(30_000, |k| if k < 100 { 0 } else { 1_000_000_000 });
        let stamps = stamps(Clock::Device, &packets);
        assert!(900_000_000 < packets[10_000].end_ns - stamps[10_000]);
        assert!((packets[29_999].end_ns - stamps[29_999]).abs() < 1_000_000);
    }

    #[test]
    fn on_gps_the_device_clock_is_the_time_and_the_stamp_tells_the_hour() {
        let mut packets = packets(6, 0, 20);
        // The fixture's clock passes the hour after its third packet; the host is 0.2 s late.
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
        assert!(stamps(Clock::Gps, &packets).is_empty(), "free running: 10 minutes off");
    }
}
