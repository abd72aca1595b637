//! The gap between two successive packets, measured by azimuth, device clock and stamps.

use messages::hdl32e::{AZIMUTH_COUNTS, BLOCK_PERIOD_NS};

use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;

/// Packets are missing if the azimuth step between two packets exceeds this many mean steps.
const MAX_STEP_RATIO: f64 = TWICE_MAX_STEP_RATIO as f64 / 2.0;
const TWICE_MAX_STEP_RATIO: u32 = 5;
/// A backward step up to this size is encoder jitter \[0.01 deg\]. An HDL-32E has a few counts of
/// jitter, a worn one slightly more.
const MAX_JITTER: f64 = 100.0;
/// Maximum difference of the stamps of two adjacent packets, including network and host delays
/// \[us\].
const MAX_STAMP_GAP_US: f64 = MAX_STAMP_GAP_NS as f64 / 1000.0;
const MAX_STAMP_GAP_NS: i64 = 20_000_000;
/// If the device clock stands still, only the stamps show that revolutions are missing. They must
/// be late by this share of the time of a revolution. A smaller delay can be a busy host.
const MIN_MISSING_REVOLUTION: f64 = 0.9;
/// The recording was interrupted if more time than this passes between two packets \[us\].
const INTERRUPTED_US: f64 = 2e6;

/// How a packet follows the packet before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Succession {
    /// No packet is missing. Contains the azimuth step between the packets \[0.01 deg\].
    Adjacent(u32),
    /// Packets are missing between the two.
    Missing {
        /// Azimuth that the sensor passed meanwhile \[0.01 deg\].
        azimuth: u64,
        /// Number of missing packets.
        n_packets: u64,
    },
    /// The packet belongs to another recording, or a clock jumped.
    Interrupted,
}

/// Signed azimuth step between two blocks \[0.01 deg\]: the shorter way around the circle, clockwise
/// positive.
fn signed_step(from: u16, to: u16) -> i32 {
    let circle = i32::from(AZIMUTH_COUNTS);
    let step = (i32::from(to) - i32::from(from)).rem_euclid(circle);
    if circle / 2 < step { step - circle } else { step }
}

/// Azimuth step between two blocks of one packet \[0.01 deg\]. The sensor spins in one direction, so
/// a backward step is encoder jitter and counts as 0.
pub(crate) fn step_within(from: u16, to: u16) -> u32 {
    signed_step(from, to).max(0).unsigned_abs()
}

/// Estimate of the azimuth step after the last firing of a packet: the step before it \[0.01 deg\].
pub(crate) fn own_step(packet: &RingPacket) -> u32 {
    let n = usize::from(packet.n_firings);
    step_within(packet.azimuth[n - 2], packet.azimuth[n - 1])
}

/// The azimuth step between two packets if they are clearly adjacent \[0.01 deg\].
///
/// This is a fast path for nearly all packets. Where it returns a step, [`PacketGap::classify`]
/// returns [`Succession::Adjacent`] with the same step.
pub(crate) fn adjacent_step(earlier: &RingPacket, later: &RingPacket) -> Option<u32> {
    let n = usize::from(earlier.n_firings);
    let step = u32::from(later.azimuth[0].checked_sub(earlier.azimuth[n - 1])?);
    let swept = u32::from(earlier.azimuth[n - 1].checked_sub(earlier.azimuth[0])?);
    let gap_us = later.device_us.checked_sub(earlier.device_us)?;
    let stamps_ns = later.end_ns.checked_sub(earlier.end_ns)?;
    let is_adjacent = step * (n as u32 - 1) <= TWICE_MAX_STEP_RATIO * swept / 2
        && (1..earlier.period_ns() * 3 / 2000).contains(&i64::from(gap_us))
        && (0..MAX_STAMP_GAP_NS).contains(&stamps_ns);
    is_adjacent.then_some(step)
}

/// The gap between a packet and the packet fired before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PacketGap {
    /// Azimuth from the last firing of the earlier packet to the first of the later \[0.01 deg\].
    step: i32,
    /// Mean azimuth step within the earlier packet \[0.01 deg\].
    mean_step: f64,
    /// Duration of a packet \[us\].
    period_us: f64,
    /// Gap by the device clock \[us\].
    pub(crate) device_us: f64,
    /// Gap by the stamps \[us\].
    pub(crate) stamps_us: f64,
}

impl PacketGap {
    pub(crate) fn new(earlier: &RingPacket, later: &RingPacket) -> Self {
        let n = usize::from(earlier.n_firings);
        let swept = step_within(earlier.azimuth[0], earlier.azimuth[n - 1]);
        Self {
            step: signed_step(earlier.azimuth[n - 1], later.azimuth[0]),
            mean_step: f64::from(swept) / (n - 1) as f64,
            period_us: earlier.period_ns() as f64 / 1000.0,
            device_us: device_gap_us(earlier, later),
            stamps_us: later.end_ns.saturating_sub(earlier.end_ns) as f64 / 1000.0,
        }
    }

    /// Whether the azimuth step is one that adjacent packets can have.
    fn azimuth_continues(&self) -> bool {
        let max = MAX_STEP_RATIO * self.mean_step.max(1.0);
        (-MAX_JITTER..=max).contains(&f64::from(self.step))
    }

    /// Whether the device clock jumped: azimuth and stamps continue, but the device clock does not.
    /// A device clock that stands still has not jumped.
    pub(crate) fn clock_jumped(&self) -> bool {
        let on_time = (0.0..1.5 * self.period_us).contains(&self.device_us);
        !on_time && self.azimuth_continues() && (0.0..MAX_STAMP_GAP_US).contains(&self.stamps_us)
    }

    /// Duration of a revolution at the current speed \[us\].
    fn revolution_us(&self) -> f64 {
        let n_blocks = f64::from(AZIMUTH_COUNTS) / self.mean_step.max(1.0);
        n_blocks * BLOCK_PERIOD_NS as f64 / 1000.0
    }

    /// Decides how the later packet follows the earlier one.
    ///
    /// `late_us` is the delay of the stamp \[us\]. It is used only if the device clock stands still.
    pub(crate) fn classify(&self, late_us: f64) -> Succession {
        if self.clock_jumped() {
            return Succession::Adjacent(self.forward_step());
        }
        if self.device_us < 0.0 {
            return Succession::Interrupted;
        }
        // The device clock has the finer resolution. If it stands still, the stamps are used. All
        // packets of a message can have the same stamp, so the stamps only show whether whole
        // revolutions are missing.
        let stands_still = self.device_us == 0.0;
        let gap_us = match stands_still {
            true if late_us < MIN_MISSING_REVOLUTION * self.revolution_us() => self.period_us,
            true => self.period_us + late_us,
            false => self.device_us,
        };
        let disagree = !stands_still && INTERRUPTED_US < (self.stamps_us - self.device_us).abs();
        if INTERRUPTED_US < gap_us || disagree {
            return Succession::Interrupted;
        }
        if gap_us < 1.5 * self.period_us && self.azimuth_continues() {
            return Succession::Adjacent(self.forward_step());
        }
        // The azimuth does not show whole revolutions. The elapsed time does.
        let circle = f64::from(AZIMUTH_COUNTS);
        let step = match self.azimuth_continues() {
            true => self.forward_step(),
            false => self.step.rem_euclid(i32::from(AZIMUTH_COUNTS)).unsigned_abs(),
        };
        let block_us = BLOCK_PERIOD_NS as f64 / 1000.0;
        let n_steps = (gap_us - self.period_us) / block_us + 1.0;
        let expected = n_steps.max(0.0) * self.mean_step;
        let n_revolutions = ((expected - f64::from(step)) / circle).round().max(0.0) as u64;
        Succession::Missing {
            azimuth: u64::from(step) + n_revolutions * u64::from(AZIMUTH_COUNTS),
            n_packets: ((gap_us / self.period_us).round() as u64).saturating_sub(1),
        }
    }

    fn forward_step(&self) -> u32 {
        self.step.max(0).unsigned_abs()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{BLOCKS, HOUR_US};
    use proptest::prelude::*;

    /// Two packets in single-return or dual-return mode.
    ///
    /// Values are drawn around the limits of the fast path: the azimuth step around 2.5 mean steps,
    /// the device clock around 1.5 packet periods, the stamps around 20 ms. The azimuth wraps at 360
    /// deg and the device clock at the top of the hour. A packet covers less than half a circle.
    fn two_packets() -> impl Strategy<Value = (RingPacket, RingPacket)> {
        let n_firings = prop_oneof![Just(BLOCKS), Just(BLOCKS / 2)];
        let step = prop_oneof![-3i32..8, 0i32..200, 0i32..1600];
        let next_step = prop_oneof![-120i32..300, 0i32..4000, 0i32..36_000];
        let device_gap_us = prop_oneof![-5i64..5, 400i64..450, 800i64..860, -2000i64..4_000_000];
        let stamp_gap_ns =
            prop_oneof![-10i64..10, 500_000i64..600_000, 19_999_990i64..20_000_010, Just(i64::MAX)];
        let device_us = prop_oneof![0..HOUR_US, HOUR_US - 2000..HOUR_US];
        (n_firings, 0u32..36_000, step, next_step, device_us, device_gap_us, stamp_gap_ns).prop_map(
            |(n, azimuth, step, next_step, device_us, device_gap_us, stamp_gap_ns)| {
                let at = |k: i32, offset: i32| {
                    (azimuth as i32 + k * step + offset).rem_euclid(36_000) as u16
                };
                let packet = |offset: i32, device_us: i64, end_ns: i64| RingPacket {
                    end_ns,
                    device_us: device_us.rem_euclid(i64::from(HOUR_US)) as u32,
                    n_firings: n as u8,
                    product: 0,
                    azimuth: std::array::from_fn(|k| at(k as i32, offset)),
                    distance: [0; BLOCKS],
                };
                let device_us = i64::from(device_us);
                let later_offset = (n as i32 - 1) * step + next_step;
                (
                    packet(0, device_us, 5),
                    packet(later_offset, device_us + device_gap_us, stamp_gap_ns.saturating_add(5)),
                )
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn the_fast_path_agrees_with_the_classification(
            (earlier, later) in two_packets(),
            late_us in -1e5..1e6,
        ) {
            if let Some(step) = adjacent_step(&earlier, &later) {
                let gap = PacketGap::new(&earlier, &later);
                prop_assert_eq!(gap.classify(late_us), Succession::Adjacent(step));
                prop_assert!(!gap.clock_jumped());
            }
        }
    }

    #[test]
    fn the_fast_path_accepts_ordinary_packets() {
        let packets = crate::velodyne::packet::tests::packets(400, 100, 20);
        let n_fast =
            packets.windows(2).filter(|pair| adjacent_step(&pair[0], &pair[1]) == Some(20));
        // One device-clock wrap, and the azimuth wraps within or between a few packets.
        assert!(390 < n_fast.count());
    }
}
