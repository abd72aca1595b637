//! Splits the packet stream into revolutions at azimuth 0.

use dataset::{LossKind, Losses};
use messages::hdl32e::{AZIMUTH_COUNTS, BLOCK_PERIOD_NS, LASER_PERIOD_NS};

use crate::options::LidarOptions;
use crate::velodyne::clock::{HostClock, Stamper};
use crate::velodyne::model::Laser;
use crate::velodyne::packet::RingPacket;
use crate::velodyne::packet_gap::{PacketGap, Succession, adjacent_step, own_step, step_within};
use crate::velodyne::revolution::{FINE_PER_COUNT, FINE_PER_REVOLUTION, Firing, Revolution};

/// If a revolution has more firings than this, the sensor has stalled. The firings take 0.46 s,
/// while the slowest revolution, at 5 Hz, takes 0.2 s.
const MAX_FIRINGS: usize = 10_000;
/// One packet in this many is compared with the host clock.
const HOST_CLOCK_INTERVAL: u64 = 8;

/// Splits packets into revolutions. The packets must be in firing order.
#[derive(Debug, Clone)]
pub(crate) struct RevolutionSplitter {
    laser: Laser,
    max_missing_share: f64,
    stamper: Stamper,
    host: HostClock,
    n_pushed: u64,
    /// The last packet. The next packet determines the azimuth step after its last firing.
    pending: Option<RingPacket>,
    /// The expected end of the pending packet \[ns\], counted in packets from the last stamp that was
    /// later than expected.
    due_ns: i64,
    revolution: Revolution,
    summary: SplitSummary,
}

/// Counts of what the splitter found.
#[derive(Debug, Clone, Default)]
pub(crate) struct SplitSummary {
    /// Partial revolutions at the start and end of the log and at interruptions.
    pub(crate) n_partial: usize,
    /// Number of missing packets.
    pub(crate) n_missing_packets: u64,
    /// Number of jumps of the device clock that azimuth and stamps do not share.
    pub(crate) n_clock_jumps: u64,
    /// Number of packets with the same stamp as the packet before, although the device clock
    /// advanced.
    pub(crate) n_same_stamp: u64,
    /// Number of steps of the stamps against the device clock.
    pub(crate) n_stamp_steps: u64,
    /// The largest of these steps \[s\].
    pub(crate) largest_stamp_step_s: f64,
    /// Revolutions and packets that were dropped.
    pub(crate) losses: Losses,
}

impl RevolutionSplitter {
    pub(crate) fn new(options: &LidarOptions, laser: Laser) -> Self {
        Self {
            laser,
            max_missing_share: options.max_missing_share,
            stamper: Stamper::new(options.clock),
            host: HostClock::default(),
            n_pushed: 0,
            pending: None,
            due_ns: i64::MIN,
            revolution: Revolution::default(),
            summary: SplitSummary::default(),
        }
    }

    /// Adds the next packet. Appends complete revolutions to `revolutions`.
    pub(crate) fn push(&mut self, packet: &RingPacket, revolutions: &mut Vec<Revolution>) {
        // A few packets per second are enough to compare the clocks.
        self.n_pushed += 1;
        if self.n_pushed.is_multiple_of(HOST_CLOCK_INTERVAL) {
            self.host.push(packet);
        }
        let due_ns = self.due_ns.saturating_add(packet.period_ns());
        self.due_ns = due_ns.max(packet.end_ns);
        let Some(pending) = self.pending.replace(*packet) else { return };
        if let Some(step) = adjacent_step(&pending, packet) {
            self.summary.n_same_stamp += u64::from(pending.end_ns == packet.end_ns);
            self.add(&pending, step, revolutions);
            return;
        }
        let gap = PacketGap::new(&pending, packet);
        self.summary.n_same_stamp += u64::from(gap.stamps_us == 0.0 && gap.device_us != 0.0);
        self.summary.n_clock_jumps += u64::from(gap.clock_jumped());
        let late_us = (packet.end_ns - due_ns.min(packet.end_ns)) as f64 / 1000.0;
        match gap.classify(late_us) {
            Succession::Adjacent(step) => self.add(&pending, step, revolutions),
            Succession::Missing { azimuth, n_packets } => {
                self.add(&pending, own_step(&pending), revolutions);
                self.skip(azimuth, revolutions);
                let n_firings = n_packets.saturating_mul(u64::from(pending.n_firings));
                self.revolution.skip_slots(n_firings);
                self.summary.n_missing_packets += n_packets;
            }
            Succession::Interrupted => {
                self.add(&pending, own_step(&pending), revolutions);
                self.summary.losses.add(LossKind::PacketStreamInterruptions, 1);
                self.interrupt(revolutions);
                self.stamper.reset();
                self.host.reset();
                self.due_ns = packet.end_ns;
            }
        }
    }

    /// Adds the pending packet, ends the last revolution and returns the counts.
    pub(crate) fn finish(&mut self, revolutions: &mut Vec<Revolution>) -> SplitSummary {
        if let Some(pending) = self.pending.take() {
            self.add(&pending, own_step(&pending), revolutions);
        }
        self.interrupt(revolutions);
        SplitSummary {
            n_stamp_steps: self.host.n_steps,
            largest_stamp_step_s: self.host.largest_s,
            ..std::mem::take(&mut self.summary)
        }
    }

    /// Adds the firings of a packet. `last_step` is the azimuth step after its last firing.
    fn add(&mut self, packet: &RingPacket, last_step: u32, revolutions: &mut Vec<Revolution>) {
        let Some(end_ns) = self.stamper.end_ns(packet) else {
            self.summary.losses.add(LossKind::PacketsOffGpsTime, 1);
            return;
        };
        if self.is_within_revolution(packet, last_step) {
            self.append_packet(packet, last_step);
        } else {
            self.append_firings(packet, last_step, end_ns, revolutions);
        }
    }

    /// Whether a packet continues the current revolution: no step back, azimuth 0 not reached, no
    /// special case. This is true for nearly all packets.
    fn is_within_revolution(&self, packet: &RingPacket, last_step: u32) -> bool {
        let azimuth = &packet.azimuth[..usize::from(packet.n_firings)];
        let n_firings = self.revolution.firings.len();
        0 < n_firings
            && n_firings + azimuth.len() <= MAX_FIRINGS
            && azimuth.is_sorted()
            && self.revolution.reached <= u32::from(azimuth[0]) * FINE_PER_COUNT
            && u32::from(azimuth[azimuth.len() - 1]) + last_step < u32::from(AZIMUTH_COUNTS)
            // Steps of half a revolution are special cases. With these limits, a step between two
            // firings is shorter, also for lasers that fire late in their block.
            && u32::from(azimuth[azimuth.len() - 1] - azimuth[0]) < u32::from(AZIMUTH_COUNTS) / 4
            && u32::from(azimuth[0]) * FINE_PER_COUNT
                < self.revolution.reached + FINE_PER_REVOLUTION / 4
    }

    /// Appends all firings of a packet to the current revolution. This is the fast path of
    /// [`Self::append_firings`] for packets within a revolution.
    #[inline]
    fn append_packet(&mut self, packet: &RingPacket, last_step: u32) {
        let n = usize::from(packet.n_firings);
        let laser = self.laser.index as u32;
        let steps = (0..n).map(|k| match packet.azimuth[..n].get(k + 1) {
            Some(next) => u32::from(next - packet.azimuth[k]),
            None => last_step,
        });
        let first_slot = self.revolution.next_slot;
        self.revolution.firings.extend(steps.enumerate().map(|(k, step)| Firing {
            fine_azimuth: u32::from(packet.azimuth[k]) * FINE_PER_COUNT + laser * step,
            distance: packet.distance[k],
            slot: first_slot.saturating_add(k as u16),
        }));
        self.revolution.next_slot = first_slot.saturating_add(n as u16);
        let swept = u32::from(packet.azimuth[n - 1] - packet.azimuth[0]);
        self.revolution.swept += u64::from(swept + last_step);
        self.revolution.last_step = last_step;
        self.revolution.reached =
            self.revolution.firings.last().map_or(0, |last| last.fine_azimuth);
    }

    /// Appends the firings of a packet one by one, and starts a new revolution at azimuth 0.
    fn append_firings(
        &mut self,
        packet: &RingPacket,
        last_step: u32,
        end_ns: i64,
        revolutions: &mut Vec<Revolution>,
    ) {
        let n = usize::from(packet.n_firings);
        let laser = self.laser.index;
        let first_ns = end_ns - packet.period_ns() + laser as i64 * LASER_PERIOD_NS;
        for k in 0..n {
            let azimuth = packet.azimuth[k];
            let step =
                if k + 1 < n { step_within(azimuth, packet.azimuth[k + 1]) } else { last_step };
            let fine = u32::from(azimuth) * FINE_PER_COUNT + laser as u32 * step;
            let fine_azimuth =
                if fine < FINE_PER_REVOLUTION { fine } else { fine - FINE_PER_REVOLUTION };
            if self.revolution.firings.is_empty() && !self.revolution.starts_at_zero {
                self.revolution.reached = fine_azimuth;
            }
            // A step back by more than half a revolution means that azimuth 0 was passed. A smaller
            // step back, also one across azimuth 0, is jitter.
            if fine_azimuth + FINE_PER_REVOLUTION / 2 < self.revolution.reached {
                self.end_at_zero(revolutions);
            }
            if fine_azimuth < self.revolution.reached + FINE_PER_REVOLUTION / 2 {
                self.revolution.reached = self.revolution.reached.max(fine_azimuth);
            }
            if self.revolution.firings.is_empty() {
                self.revolution.stamp_ns = first_ns + k as i64 * BLOCK_PERIOD_NS;
                self.revolution.next_slot = 0;
                // If the first firing of a log lies less than one step after azimuth 0, the firing
                // before it lies in another revolution.
                self.revolution.starts_at_zero |= fine_azimuth < step * FINE_PER_COUNT;
            }
            if self.revolution.firings.len() == MAX_FIRINGS {
                self.summary.losses.add(LossKind::StalledRevolutions, 1);
                self.revolution = Revolution::default();
            }
            let slot = self.revolution.next_slot;
            let distance = packet.distance[k];
            self.revolution.firings.push(Firing { fine_azimuth, distance, slot });
            self.revolution.next_slot = slot.saturating_add(1);
            self.revolution.swept += u64::from(step);
            self.revolution.last_step = step;
        }
    }

    /// Skips the azimuth of missing packets \[0.01 deg\]. It counts as missing in the current
    /// revolution and in those that follow.
    fn skip(&mut self, azimuth: u64, revolutions: &mut Vec<Revolution>) {
        let circle = u64::from(AZIMUTH_COUNTS);
        let from = u64::from(self.revolution.reached / FINE_PER_COUNT);
        // The step after the last firing is already counted as swept.
        let missed = azimuth.saturating_sub(u64::from(self.revolution.last_step));
        let n_passed = (from + azimuth) / circle;
        let to = (from + azimuth) % circle;
        if n_passed == 0 {
            self.revolution.add_gap(missed);
        } else {
            self.revolution.add_gap(missed.min(circle.saturating_sub(from)));
            self.end_at_zero(revolutions);
            self.revolution.add_gap(to);
        }
        self.revolution.reached = to as u32 * FINE_PER_COUNT;
        if n_passed > 1 {
            self.summary.losses.add(LossKind::MissingRevolutions, n_passed - 1);
        }
    }

    /// Ends the current revolution at azimuth 0.
    fn end_at_zero(&mut self, revolutions: &mut Vec<Revolution>) {
        let revolution = std::mem::take(&mut self.revolution);
        self.revolution.firings.reserve(revolution.firings.len() + 8);
        self.revolution.starts_at_zero = true;
        if !revolution.starts_at_zero {
            self.summary.n_partial += 1;
        } else {
            self.keep(revolution, revolutions);
        }
    }

    /// Ends the current revolution where the packet stream ends.
    fn interrupt(&mut self, revolutions: &mut Vec<Revolution>) {
        let revolution = std::mem::take(&mut self.revolution);
        let Some(last) = revolution.firings.last() else { return };
        let ends_at_zero =
            FINE_PER_REVOLUTION <= last.fine_azimuth + revolution.last_step * FINE_PER_COUNT;
        if revolution.starts_at_zero && ends_at_zero {
            self.keep(revolution, revolutions);
        } else {
            self.summary.n_partial += 1;
        }
    }

    /// Keeps a revolution unless too many of its packets are missing.
    fn keep(&mut self, revolution: Revolution, revolutions: &mut Vec<Revolution>) {
        if self.max_missing_share < revolution.missing_share() {
            let max_missing_percent = (self.max_missing_share * 100.0).to_string();
            self.summary.losses.add(LossKind::IncompleteRevolutions { max_missing_percent }, 1);
        } else {
            revolutions.push(revolution);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{BLOCKS, HOUR_US, PACKET_PERIOD_NS};
    use proptest::prelude::*;

    use crate::velodyne::packet::tests::packets;
    use crate::velodyne::revolution::ScanBuilder;

    fn split(packets: &[RingPacket]) -> (Vec<Revolution>, SplitSummary) {
        let mut splitter = RevolutionSplitter::new(&LidarOptions::default(), Laser::HORIZONTAL);
        let mut revolutions = Vec::new();
        for packet in packets {
            splitter.push(packet, &mut revolutions);
        }
        let summary = splitter.finish(&mut revolutions);
        (revolutions, summary)
    }

    fn losses(summary: &SplitSummary) -> Vec<(&'static str, u64)> {
        summary.losses.iter().map(|(loss, n)| (loss.kind.code(), n)).collect()
    }

    fn scan(revolution: &Revolution) -> dataset::Scan {
        ScanBuilder::new(&LidarOptions::default(), Laser::HORIZONTAL).scan(revolution, None)
    }

    /// With steps of 0.2 deg, laser 15 fires 0.075 deg after the azimuth of its block. Blocks at
    /// 359.8, 0.0, 0.2 deg give 359.875, 0.075, 0.275 deg, so a revolution has 1800 firings and
    /// starts at 0.075 deg.
    #[test]
    fn a_revolution_starts_at_the_first_firing_past_zero() {
        let (revolutions, summary) = split(&packets(400, 35_000, 20));
        // 4800 firings: 50 before azimuth 0 (350.0 to 359.8 deg), two revolutions, the rest.
        assert_eq!((revolutions.len(), summary.n_partial), (2, 2));
        assert!(summary.losses.is_empty());
        for (k, revolution) in revolutions.iter().enumerate() {
            assert_eq!(revolution.firings.len(), 1800);
            assert_eq!(revolution.firings[0].fine_azimuth, 15 * 20);
            assert_eq!(revolution.firings[1].fine_azimuth, 55 * 20);
            // Block 50 of the log, then every 1800 blocks. Laser 15 fires 17.28 us into its block.
            let block = 50 + 1800 * k as i64;
            assert_eq!(revolution.stamp_ns, 1_000_000_000 + block * 46_080 + 17_280);
        }
        let scan = scan(&revolutions[0]);
        assert!((scan.coverage_deg - 359.8).abs() < 1e-4);
        assert!(scan.is_ring());
    }

    /// The step from 359.99 to 0.19 deg is 0.2 deg, not -359.8 deg. 3/8 of it is 0.075 deg.
    #[test]
    fn azimuth_is_interpolated_across_zero() {
        let (revolutions, _) = split(&packets(400, 35_999, 20));
        // Blocks at 359.99 + 0.2 k: laser 15 of the first block fires at 0.065 deg, so the log starts
        // at azimuth 0 and its first revolution is complete.
        assert_eq!(revolutions[0].firings[0].fine_azimuth, 65 * 4);
        assert_eq!(revolutions[0].stamp_ns, 1_000_000_000 + 17_280);
        assert_eq!(revolutions.len(), 2);
    }

    /// Each packet covers 2.4 deg including the step after it, so three missing packets remove 36
    /// firings and leave 7.2 deg without packets.
    #[test]
    fn a_gap_is_measured_and_a_revolution_with_too_large_gaps_is_dropped() {
        let all = packets(600, 35_000, 20);
        let mut one_gap = all.clone();
        one_gap.drain(100..103);
        let (revolutions, summary) = split(&one_gap);
        assert_eq!((revolutions.len(), summary.n_missing_packets), (3, 3));
        assert_eq!(losses(&summary), []);
        assert_eq!(revolutions[0].firings.len(), 1800 - 36);
        let scans: Vec<_> = revolutions.iter().map(scan).collect();
        assert!((scans[0].coverage_deg - 359.8).abs() < 1e-4, "a gap does not reduce the coverage");
        assert!((scans[0].hole_deg - 7.2).abs() < 1e-4, "{}", scans[0].hole_deg);
        assert_eq!((scans[1].hole_deg, scans[2].hole_deg), (0.0, 0.0));
        // Of two gaps the wider one is reported.
        let mut two_gaps = one_gap.clone();
        two_gaps.remove(50);
        let (revolutions, _) = split(&two_gaps);
        assert!((scan(&revolutions[0]).hole_deg - 7.2).abs() < 1e-4);
        // A quarter of a revolution is 37.5 packets: 37 are within the limit, 38 are not.
        for (n, expected) in [(37, 3), (38, 2)] {
            let mut large = all.clone();
            large.drain(30..30 + n);
            let (revolutions, summary) = split(&large);
            assert_eq!((revolutions.len(), summary.n_missing_packets), (expected, n as u64));
        }
    }

    /// Azimuth 0 of the second revolution lies 370 deg after the start of the log, in packet 154.
    /// Packets 150 to 159 cover 10 x 2.4 deg: 10 deg before azimuth 0 and 14 deg after it.
    #[test]
    fn a_gap_across_zero_is_shared_between_two_revolutions() {
        let mut packets = packets(600, 35_000, 20);
        packets.drain(150..160);
        let (revolutions, summary) = split(&packets);
        assert_eq!((revolutions.len(), losses(&summary)), (3, Vec::new()));
        let gaps: Vec<f32> = revolutions.iter().map(|r| scan(r).hole_deg).collect();
        assert!((gaps[0] - 10.0).abs() < 0.25 && (gaps[1] - 14.0).abs() < 0.25, "{gaps:?}");
        assert!((scan(&revolutions[1]).coverage_deg - 359.8).abs() < 0.3);
    }

    #[test]
    fn revolutions_without_any_packet_are_counted() {
        let mut packets = packets(900, 35_000, 20);
        // 450 packets are three revolutions, so the azimuth after them looks as if none were missing.
        // The first part ends at 350 + 200 x 2.4 = 830 deg and has one complete revolution (360 to
        // 720). The gap ends at 1910 deg. It takes 250 deg from 720..1080, 110 deg from 1800..2160,
        // and both revolutions between. The log ends at 2510 deg.
        packets.drain(200..650);
        let (revolutions, summary) = split(&packets);
        assert_eq!(losses(&summary), [("missing_revolutions", 2), ("incomplete_revolutions", 2)]);
        assert_eq!((revolutions.len(), summary.n_partial, summary.n_missing_packets), (1, 2, 450));
    }

    #[test]
    fn a_new_recording_starts_a_new_revolution() {
        let mut both = packets(400, 35_000, 20);
        let mut later = packets(400, 12_000, 20);
        for packet in &mut later {
            packet.device_us =
                ((u64::from(packet.device_us) + 600_000_000) % u64::from(HOUR_US)) as u32;
            packet.end_ns += 600_000_000_000;
        }
        both.extend(later);
        let (revolutions, summary) = split(&both);
        // The second recording starts at 120 deg: 1200 firings, then exactly two revolutions.
        assert_eq!((revolutions.len(), summary.n_partial), (4, 3));
        assert_eq!(losses(&summary), [("packet_stream_interruptions", 1)]);
    }

    /// The device clock wraps every hour, so only the stamps show a pause of one hour.
    #[test]
    fn a_pause_of_an_hour_is_an_interruption() {
        let mut packets = packets(800, 35_000, 20);
        packets[400..].iter_mut().for_each(|packet| packet.end_ns += 3_600_000_000_000);
        let (revolutions, summary) = split(&packets);
        assert_eq!(losses(&summary), [("packet_stream_interruptions", 1)]);
        assert_eq!((revolutions.len(), summary.n_partial), (4, 4));
    }

    /// Azimuth and stamps continue, so no revolution is lost.
    #[test]
    fn a_jump_of_the_device_clock_alone_loses_nothing() {
        for jump_us in [-1_000_000i64, -200_000, 500_000, 1_800_000_000] {
            let mut jumping = packets(800, 35_000, 20);
            for packet in &mut jumping[400..] {
                let device_us = i64::from(packet.device_us) + jump_us;
                packet.device_us = device_us.rem_euclid(i64::from(HOUR_US)) as u32;
            }
            let (revolutions, summary) = split(&jumping);
            assert_eq!((revolutions.len(), summary.n_clock_jumps), (5, 1));
            assert_eq!(losses(&summary), []);
        }
        // If the stamps jump too, it is a pause.
        let mut paused = packets(800, 35_000, 20);
        for packet in &mut paused[400..] {
            packet.device_us = (packet.device_us + 600_000_000) % HOUR_US;
            packet.end_ns += 600_000_000_000;
        }
        let (revolutions, summary) = split(&paused);
        assert_eq!(revolutions.len(), 4);
        assert_eq!(losses(&summary), [("packet_stream_interruptions", 1)]);
    }

    /// Laser 31 fires 16 x 1.152 us after laser 15, at 31/40 of a step.
    #[test]
    fn another_laser_has_its_own_time_and_azimuth() {
        let mut splitter = RevolutionSplitter::new(&LidarOptions::default(), Laser::new(31));
        let mut revolutions = Vec::new();
        packets(400, 35_000, 20).iter().for_each(|packet| splitter.push(packet, &mut revolutions));
        splitter.finish(&mut revolutions);
        // 359.8 + 0.155 deg is the last firing before azimuth 0.
        assert_eq!(revolutions[0].firings[0].fine_azimuth, 31 * 20);
        assert_eq!(revolutions[0].stamp_ns, 1_000_000_000 + 50 * 46_080 + 31 * 1152);
    }

    #[test]
    fn a_stalled_sensor_does_not_make_an_endless_revolution() {
        let mut packets = packets(2400, 35_000, 20);
        for packet in &mut packets[200..2000] {
            packet.azimuth = [12_345; BLOCKS];
        }
        let (revolutions, summary) = split(&packets);
        assert!(revolutions.iter().all(|revolution| revolution.firings.len() <= MAX_FIRINGS));
        assert!(0 < summary.losses.count("stalled_revolutions"));
    }

    /// One count back: within a packet, at its border, and back across azimuth 0.
    #[test]
    fn encoder_jitter_does_not_end_a_revolution() {
        let clean = packets(400, 35_000, 20);
        // Block 50 is the first past azimuth 0: packet 4, block 2.
        for (packet, block) in [(100, 5), (100, 0), (4, 3)] {
            let mut jittery = clean.clone();
            let before = match block {
                0 => jittery[packet - 1].azimuth[BLOCKS - 1],
                _ => jittery[packet].azimuth[block - 1],
            };
            jittery[packet].azimuth[block] = (before + 35_999) % 36_000;
            let (revolutions, summary) = split(&jittery);
            let gaps: f32 = revolutions.iter().map(|revolution| scan(revolution).hole_deg).sum();
            let is_lossless = summary.losses.is_empty();
            let found = (revolutions.len(), summary.n_missing_packets, is_lossless, gaps);
            assert_eq!(found, (2, 0, true, 0.0), "packet {packet}, block {block}");
        }
    }

    #[test]
    fn the_stamps_replace_a_device_clock_that_stands_still() {
        let mut packets = packets(900, 35_000, 20);
        packets.iter_mut().for_each(|packet| packet.device_us = 7);
        let (revolutions, summary) = split(&packets[..400]);
        assert_eq!((revolutions.len(), summary.losses.is_empty()), (2, true));
        // All packets of a message can have the same stamp.
        let mut by_message = packets[..400].to_vec();
        for (k, packet) in by_message.iter_mut().enumerate() {
            packet.end_ns = 1_000_000_000 + (k as i64 / 181 + 1) * 181 * PACKET_PERIOD_NS;
        }
        let (revolutions, summary) = split(&by_message);
        assert_eq!((revolutions.len(), summary.n_missing_packets), (2, 0));
        // The stamps show that three revolutions are missing.
        packets.drain(200..650);
        let (revolutions, summary) = split(&packets);
        assert_eq!(revolutions.len(), 1, "{:?}", losses(&summary));
        assert_eq!(summary.losses.count("missing_revolutions"), 2);
    }

    /// A packet stream with random speed, jitter, gaps and duplicated azimuths.
    fn stream() -> impl Strategy<Value = (Vec<RingPacket>, usize)> {
        // Per packet: step within, step to the next packet, one disturbed block and its offset.
        let packet = (
            prop_oneof![9 => 1u32..60, 1 => 0u32..3000],
            prop_oneof![9 => 0u32..60, 1 => 0u32..36_000],
            0..BLOCKS,
            prop_oneof![5 => Just(0i32), 3 => -30i32..30, 1 => -36_000i32..36_000],
            prop_oneof![4 => Just(BLOCKS), 1 => Just(BLOCKS / 2)],
        );
        (0u32..36_000, prop::collection::vec(packet, 1..60), 0usize..32).prop_map(
            |(start, steps, laser)| {
                let mut azimuth = start;
                let mut packets = packets(steps.len(), 0, 0);
                for (packet, (step, to_next, block, offset, n)) in packets.iter_mut().zip(steps) {
                    packet.n_firings = n as u8;
                    for (k, of_block) in packet.azimuth[..n].iter_mut().enumerate() {
                        let disturbed = if k == block { offset } else { 0 };
                        let at = (azimuth + k as u32 * step) as i32 + disturbed;
                        *of_block = at.rem_euclid(36_000) as u16;
                    }
                    azimuth = (azimuth + (n as u32 - 1) * step + to_next) % 36_000;
                }
                (packets, laser)
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        /// For every packet that takes the fast path, both paths give the same revolution.
        #[test]
        fn a_packet_appended_at_once_equals_its_firings_appended_one_by_one(
            (packets, laser) in stream(),
            last_step in 0u32..60,
            n_firings_before in prop_oneof![4 => Just(0), 1 => MAX_FIRINGS - 20..MAX_FIRINGS],
        ) {
            let mut splitter = RevolutionSplitter::new(&LidarOptions::default(), Laser::new(laser));
            let firing = Firing { fine_azimuth: 0, distance: 0, slot: 0 };
            splitter.revolution.firings = vec![firing; n_firings_before];
            let mut revolutions = Vec::new();
            for packet in &packets {
                if splitter.is_within_revolution(packet, last_step) {
                    let mut slow = splitter.clone();
                    let n_complete = revolutions.len();
                    slow.append_firings(packet, last_step, packet.end_ns, &mut revolutions);
                    splitter.append_packet(packet, last_step);
                    prop_assert_eq!(revolutions.len(), n_complete);
                    prop_assert_eq!(&splitter.revolution, &slow.revolution);
                } else {
                    splitter.append_firings(packet, last_step, packet.end_ns, &mut revolutions);
                }
            }
        }
    }
}
