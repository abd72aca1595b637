//! Firings -> turns, cut where the azimuth passes 0, across packets and messages.

use dataset::Dropped;
use messages::hdl32e::{AZIMUTH_COUNTS, BLOCK_PERIOD_NS, LASER_PERIOD_NS};

use crate::options::LidarOptions;
use crate::velodyne::clock::{HostClock, Stamper};
use crate::velodyne::model::Laser;
use crate::velodyne::packet::RingPacket;
use crate::velodyne::packet_gap::{Link, PacketGap, ordinary_step, own_step, step_within};
use crate::velodyne::revolution::{FINE_PER_COUNT, FINE_PER_REVOLUTION, Firing, Revolution};

/// Firings in a turn beyond which the sensor is taken to have stalled: 0.46 s, where the slowest
/// turn, at 5 Hz, takes 0.2 s.
const MAX_FIRINGS: usize = 10_000;
/// One packet in so many is compared with the host's clock.
const HOST_CLOCK_EVERY: u64 = 8;
/// A hole wider than this marks its scan \[deg\].
pub(crate) const MARKED_HOLE_DEG: f32 = 5.0;

/// Cuts the packets of a log, given in the order they were fired, into turns.
#[derive(Debug)]
pub(crate) struct RevolutionSplitter {
    laser: Laser,
    max_missing_share: f64,
    stamper: Stamper,
    host: HostClock,
    n_pushed: u64,
    /// The packet whose last step the next packet will tell.
    pending: Option<RingPacket>,
    /// When the pending packet was due to end, by the number of packets since the last stamp that
    /// was later than due \[ns\].
    due_ns: i64,
    revolution: Revolution,
    ends: Ends,
}

/// What is left when a log ends.
#[derive(Debug, Default)]
pub(crate) struct Ends {
    /// Turns that the log, or an interruption, starts or ends within.
    pub(crate) n_partial: usize,
    /// Packets that are missing between those there are.
    pub(crate) n_missing_packets: u64,
    /// Jumps of the device clock that azimuth and stamps do not share.
    pub(crate) n_clock_jumps: u64,
    /// Packets with the very stamp of the one before, of a device whose clock goes on.
    pub(crate) n_same_stamp: u64,
    /// Turns with holes, and what else was lost.
    pub(crate) dropped: Dropped,
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
            ends: Ends::default(),
        }
    }

    /// Adds the next packet; complete turns go to `turns`.
    pub(crate) fn push(&mut self, packet: &RingPacket, revolutions: &mut Vec<Revolution>) {
        // A few packets of a second tell how the clocks stand.
        self.n_pushed += 1;
        if self.n_pushed.is_multiple_of(HOST_CLOCK_EVERY) {
            self.host.push(packet);
        }
        let due_ns = self.due_ns.saturating_add(packet.period_ns());
        self.due_ns = due_ns.max(packet.end_ns);
        let Some(pending) = self.pending.replace(*packet) else { return };
        if let Some(step) = ordinary_step(&pending, packet) {
            self.ends.n_same_stamp += u64::from(pending.end_ns == packet.end_ns);
            self.add(&pending, step, revolutions);
            return;
        }
        let between = PacketGap::new(&pending, packet);
        self.ends.n_same_stamp += u64::from(between.stamps_us == 0.0 && between.device_us != 0.0);
        self.ends.n_clock_jumps += u64::from(between.clock_jumped());
        let late_us = (packet.end_ns - due_ns.min(packet.end_ns)) as f64 / 1000.0;
        match between.link(late_us) {
            Link::Next(step) => self.add(&pending, step, revolutions),
            Link::Hole { turned, n_packets } => {
                self.add(&pending, own_step(&pending), revolutions);
                self.skip(turned, revolutions);
                let n_firings = n_packets.saturating_mul(u64::from(pending.n_firings));
                self.revolution.skip_slots(n_firings);
                self.ends.n_missing_packets += n_packets;
            }
            Link::Interrupted => {
                self.add(&pending, own_step(&pending), revolutions);
                self.ends
                    .dropped
                    .add("interruptions of the packet stream (clock jump or pause)", 1);
                self.interrupt(revolutions);
                self.stamper.reset();
                self.host.reset();
                self.due_ns = packet.end_ns;
            }
        }
    }

    /// Steps of the stamps against the device clock: their number and the largest \[s\].
    pub(crate) fn stamp_steps(&self) -> (u64, f64) {
        (self.host.n_steps, self.host.largest_s)
    }

    /// Adds the last packet and ends the last turn.
    pub(crate) fn finish(&mut self, revolutions: &mut Vec<Revolution>) -> Ends {
        if let Some(pending) = self.pending.take() {
            self.add(&pending, own_step(&pending), revolutions);
        }
        self.interrupt(revolutions);
        std::mem::take(&mut self.ends)
    }

    /// Adds the firings of a packet whose last step is known.
    fn add(&mut self, packet: &RingPacket, last_step: u32, revolutions: &mut Vec<Revolution>) {
        let Some(end_ns) = self.stamper.end_ns(packet) else {
            let reason = "packets whose device clock is not on GPS time (more than 60 s from the stamps: set `ingest.lidar.clock` to \"host\" or \"device\")";
            self.ends.dropped.add(reason, 1);
            return;
        };
        let n = usize::from(packet.n_firings);
        let laser = self.laser.index;
        let first_ns = end_ns - packet.period_ns() + laser as i64 * LASER_PERIOD_NS;
        if self.is_within_revolution(packet, last_step) {
            let steps = (0..n).map(|k| match packet.azimuth[..n].get(k + 1) {
                Some(next) => u32::from(next - packet.azimuth[k]),
                None => last_step,
            });
            let first_slot = self.revolution.next_slot;
            self.revolution.firings.extend(steps.enumerate().map(|(k, step)| Firing {
                fine_azimuth: u32::from(packet.azimuth[k]) * FINE_PER_COUNT + laser as u32 * step,
                distance: packet.distance[k],
                slot: first_slot.saturating_add(k as u16),
            }));
            self.revolution.next_slot = first_slot.saturating_add(n as u16);
            let turned = u32::from(packet.azimuth[n - 1] - packet.azimuth[0]);
            self.revolution.swept += u64::from(turned + last_step);
            self.revolution.last_step = last_step;
            self.revolution.reached =
                self.revolution.firings.last().map_or(0, |last| last.fine_azimuth);
            return;
        }
        for k in 0..n {
            let azimuth = packet.azimuth[k];
            let step =
                if k + 1 < n { step_within(azimuth, packet.azimuth[k + 1]) } else { last_step };
            let fine = u32::from(azimuth) * FINE_PER_COUNT + laser as u32 * step;
            let fine_azimuth =
                if fine < FINE_PER_REVOLUTION { fine } else { fine - FINE_PER_REVOLUTION };
            if self.revolution.firings.is_empty() && !self.revolution.starts_at_cut {
                self.revolution.reached = fine_azimuth;
            }
            // Back by more than half a turn is on past 0; back by less, past 0 too, is jitter.
            if fine_azimuth + FINE_PER_REVOLUTION / 2 < self.revolution.reached {
                self.cut(revolutions);
            }
            if fine_azimuth < self.revolution.reached + FINE_PER_REVOLUTION / 2 {
                self.revolution.reached = self.revolution.reached.max(fine_azimuth);
            }
            if self.revolution.firings.is_empty() {
                self.revolution.stamp_ns = first_ns + k as i64 * BLOCK_PERIOD_NS;
                self.revolution.next_slot = 0;
                // The firing before the first of a log is due one step before it.
                self.revolution.starts_at_cut |= fine_azimuth < step * FINE_PER_COUNT;
            }
            if self.revolution.firings.len() == MAX_FIRINGS {
                self.ends.dropped.add("turns of more than 0.46 s (the sensor stalled)", 1);
                self.revolution = Revolution::default();
            }
            let slot = self.revolution.next_slot;
            self.revolution.firings.push(Firing {
                fine_azimuth,
                distance: packet.distance[k],
                slot,
            });
            self.revolution.next_slot = slot.saturating_add(1);
            self.revolution.swept += u64::from(step);
            self.revolution.last_step = step;
        }
    }

    /// Whether a packet goes on in a turn without a step back, the cut, or anything to look after:
    /// nearly all do.
    fn is_within_revolution(&self, packet: &RingPacket, last_step: u32) -> bool {
        let azimuth = &packet.azimuth[..usize::from(packet.n_firings)];
        let n_firings = self.revolution.firings.len();
        0 < n_firings
            && n_firings + azimuth.len() <= MAX_FIRINGS
            && azimuth.is_sorted()
            && self.revolution.reached <= u32::from(azimuth[0]) * FINE_PER_COUNT
            && u32::from(azimuth[azimuth.len() - 1]) + last_step < u32::from(AZIMUTH_COUNTS)
            // Wider than that it is a step over the cut, or no step at all.
            && u32::from(azimuth[azimuth.len() - 1] - azimuth[0]) < u32::from(AZIMUTH_COUNTS) / 2
            && u32::from(azimuth[0]) * FINE_PER_COUNT < self.revolution.reached + FINE_PER_REVOLUTION / 2
    }

    /// Passes over missing packets, which cover `turned`: what they cover is missing in the turn,
    /// or in the turns.
    fn skip(&mut self, turned: u64, revolutions: &mut Vec<Revolution>) {
        let whole_turn = u64::from(AZIMUTH_COUNTS);
        let at = u64::from(self.revolution.reached / FINE_PER_COUNT);
        // The last firing's own step is swept already.
        let missed = turned.saturating_sub(u64::from(self.revolution.last_step));
        let turns_passed = (at + turned) / whole_turn;
        let now_at = (at + turned) % whole_turn;
        if turns_passed == 0 {
            self.revolution.miss(missed);
        } else {
            self.revolution.miss(missed.min(whole_turn.saturating_sub(at)));
            self.cut(revolutions);
            self.revolution.miss(now_at);
        }
        self.revolution.reached = now_at as u32 * FINE_PER_COUNT;
        if turns_passed > 1 {
            self.ends.dropped.add("turns of which every packet is missing", turns_passed - 1);
        }
    }

    /// Ends the turn at a cut that was seen.
    fn cut(&mut self, revolutions: &mut Vec<Revolution>) {
        let revolution = std::mem::take(&mut self.revolution);
        self.revolution.firings.reserve(revolution.firings.len() + 8);
        self.revolution.starts_at_cut = true;
        if !revolution.starts_at_cut {
            self.ends.n_partial += 1;
        } else {
            self.keep(revolution, revolutions);
        }
    }

    /// Ends the turn where the stream of packets ends.
    fn interrupt(&mut self, revolutions: &mut Vec<Revolution>) {
        let revolution = std::mem::take(&mut self.revolution);
        let Some(last) = revolution.firings.last() else { return };
        let ends_at_cut =
            FINE_PER_REVOLUTION <= last.fine_azimuth + revolution.last_step * FINE_PER_COUNT;
        if revolution.starts_at_cut && ends_at_cut {
            self.keep(revolution, revolutions);
        } else {
            self.ends.n_partial += 1;
        }
    }

    fn keep(&mut self, revolution: Revolution, revolutions: &mut Vec<Revolution>) {
        if self.max_missing_share < revolution.missing_share() {
            let share = self.max_missing_share * 100.0;
            let reason = format!("turns of which more than {share} % are missing");
            self.ends.dropped.add(reason, 1);
        } else {
            revolutions.push(revolution);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{BLOCKS, HOUR_US, PACKET_PERIOD_NS};

    use crate::velodyne::packet::tests::packets;
    use crate::velodyne::revolution::ScanBuilder;

    fn cut(packets: &[RingPacket]) -> (Vec<Revolution>, Ends) {
        let mut splitter = RevolutionSplitter::new(&LidarOptions::default(), Laser::HORIZONTAL);
        let mut revolutions = Vec::new();
        for packet in packets {
            splitter.push(packet, &mut revolutions);
        }
        let ends = splitter.finish(&mut revolutions);
        (revolutions, ends)
    }

    fn reasons(ends: &Ends) -> Vec<(&str, u64)> {
        ends.dropped.iter().collect()
    }

    /// With steps of 0.2 deg laser 15 fires 0.075 deg after its block's azimuth. Blocks at 359.8,
    /// 0.0, 0.2 deg give 359.875, 0.075, 0.275 deg: a turn has 1800 firings and starts at 0.075.
    #[test]
    fn a_turn_starts_at_the_first_firing_past_zero() {
        let (revolutions, ends) = cut(&packets(400, 35_000, 20));
        // 4800 firings: 50 before the first cut (350.0 to 359.8 deg), two turns, the rest.
        assert_eq!((revolutions.len(), ends.n_partial), (2, 2));
        assert!(ends.dropped.is_empty());
        for (k, revolution) in revolutions.iter().enumerate() {
            assert_eq!(revolution.firings.len(), 1800);
            assert_eq!(revolution.firings[0].fine_azimuth, 15 * 20);
            assert_eq!(revolution.firings[1].fine_azimuth, 55 * 20);
            // Block 50 of the log, then 1800 blocks on; laser 15 fires 17.28 us into its block.
            let block = 50 + 1800 * k as i64;
            assert_eq!(revolution.stamp_ns, 1_000_000_000 + block * 46_080 + 17_280);
        }
        let scan = ScanBuilder::new(&LidarOptions::default(), Laser::HORIZONTAL)
            .scan(&revolutions[0], None);
        assert!((scan.coverage_deg - 359.8).abs() < 1e-4);
        assert!(scan.is_ring());
    }

    /// The step from 359.99 to 0.19 deg is 0.2 deg, not -359.8; of it 3/8 is 0.075.
    #[test]
    fn azimuth_is_interpolated_across_the_seam() {
        let (revolutions, _) = cut(&packets(400, 35_999, 20));
        // Blocks at 359.99 + 0.2 k: laser 15 of the first fires at 0.065 deg, so that the log
        // starts with a cut and its first turn is whole.
        assert_eq!(revolutions[0].firings[0].fine_azimuth, 65 * 4);
        assert_eq!(revolutions[0].stamp_ns, 1_000_000_000 + 17_280);
        assert_eq!(revolutions.len(), 2);
    }

    fn scan(revolution: &Revolution) -> dataset::Scan {
        ScanBuilder::new(&LidarOptions::default(), Laser::HORIZONTAL).scan(revolution, None)
    }

    /// Each packet is 2.4 deg; the firings at its two ends are 0.2 deg from their neighbours, so
    /// that three missing packets leave 36 firings out and a hole of 7.2 deg.
    #[test]
    fn a_hole_is_told_and_a_turn_with_too_much_missing_dropped() {
        let whole = packets(600, 35_000, 20);
        let mut holed = whole.clone();
        holed.drain(100..103);
        let (revolutions, ends) = cut(&holed);
        assert_eq!((revolutions.len(), reasons(&ends).len(), ends.n_missing_packets), (3, 0, 3));
        assert_eq!(revolutions[0].firings.len(), 1800 - 36);
        let scans: Vec<_> = revolutions.iter().map(scan).collect();
        assert!((scans[0].coverage_deg - 359.8).abs() < 1e-4, "a ring, whatever is missing");
        assert!((scans[0].hole_deg - 7.2).abs() < 1e-4, "{}", scans[0].hole_deg);
        assert_eq!((scans[1].hole_deg, scans[2].hole_deg), (0.0, 0.0));
        // Two holes: the wider one is told.
        let mut twice = holed.clone();
        twice.remove(50);
        let (revolutions, _) = cut(&twice);
        assert!((scan(&revolutions[0]).hole_deg - 7.2).abs() < 1e-4);
        // A quarter of a turn is 37.5 packets: 37 missing are within the limit, 38 are not.
        for (n, expected) in [(37, 3), (38, 2)] {
            let mut large = whole.clone();
            large.drain(30..30 + n);
            let (revolutions, ends) = cut(&large);
            assert_eq!((revolutions.len(), ends.n_missing_packets), (expected, n as u64));
        }
    }

    /// Azimuth 0 of the second turn lies at 370 deg from the log's start, in packet 154; packets
    /// 150 to 159 are 10 x 2.4 deg: of the 24 deg, 10 lie before the cut and 14 behind it.
    #[test]
    fn a_hole_across_the_cut_is_shared_between_two_turns() {
        let mut seam = packets(600, 35_000, 20);
        seam.drain(150..160);
        let (revolutions, ends) = cut(&seam);
        assert_eq!((revolutions.len(), reasons(&ends)), (3, Vec::new()));
        let holes: Vec<f32> =
            revolutions.iter().map(|revolution| scan(revolution).hole_deg).collect();
        assert!((holes[0] - 10.0).abs() < 0.25 && (holes[1] - 14.0).abs() < 0.25, "{holes:?}");
        assert!((scan(&revolutions[1]).coverage_deg - 359.8).abs() < 0.3);
    }

    #[test]
    fn turns_that_are_missing_altogether_are_counted() {
        let mut packets = packets(900, 35_000, 20);
        // 450 packets are three turns; after them the azimuth looks as if nothing were missing.
        // On paper: 350 + 200 x 2.4 = 830 deg, one whole turn (360 to 720); the hole reaches to
        // 1910 deg and takes 250 deg from 720..1080, 110 from 1800..2160, and all of the two turns
        // between; the log ends at 2510 deg.
        packets.drain(200..650);
        let (revolutions, ends) = cut(&packets);
        assert_eq!(
            reasons(&ends),
            [
                ("turns of which every packet is missing", 2),
                ("turns of which more than 25 % are missing", 2)
            ]
        );
        assert_eq!((revolutions.len(), ends.n_partial, ends.n_missing_packets), (1, 2, 450));
    }

    #[test]
    fn an_interruption_starts_anew() {
        let mut both = packets(400, 35_000, 20);
        let mut later = packets(400, 12_000, 20);
        for packet in &mut later {
            packet.device_us =
                ((u64::from(packet.device_us) + 600_000_000) % u64::from(HOUR_US)) as u32;
            packet.end_ns += 600_000_000_000;
        }
        both.extend(later);
        let (revolutions, ends) = cut(&both);
        // The second recording starts at 120 deg: 1200 firings, then two turns to the very end.
        assert_eq!((revolutions.len(), ends.n_partial), (4, 3));
        assert_eq!(
            reasons(&ends),
            [("interruptions of the packet stream (clock jump or pause)", 1)]
        );
    }

    /// The device clock counts to an hour: a pause of one hour shows in the stamps alone.
    #[test]
    fn a_pause_of_an_hour_is_an_interruption() {
        let mut packets = packets(800, 35_000, 20);
        packets[400..].iter_mut().for_each(|packet| packet.end_ns += 3_600_000_000_000);
        let (revolutions, ends) = cut(&packets);
        assert_eq!(ends.dropped.iter().count(), 1);
        assert_eq!((revolutions.len(), ends.n_partial), (4, 4));
    }

    /// Azimuth and stamps go on: no turn is lost for it.
    #[test]
    fn a_device_clock_that_jumps_alone_costs_nothing() {
        for jump_us in [-1_000_000i64, -200_000, 500_000, 1_800_000_000] {
            let mut jumping = packets(800, 35_000, 20);
            for packet in &mut jumping[400..] {
                let device_us = i64::from(packet.device_us) + jump_us;
                packet.device_us = device_us.rem_euclid(i64::from(HOUR_US)) as u32;
            }
            let (revolutions, ends) = cut(&jumping);
            assert_eq!((revolutions.len(), ends.n_clock_jumps, reasons(&ends)), (5, 1, vec![]));
        }
        // With the stamps it is a pause.
        let mut paused = packets(800, 35_000, 20);
        for packet in &mut paused[400..] {
            packet.device_us = (packet.device_us + 600_000_000) % HOUR_US;
            packet.end_ns += 600_000_000_000;
        }
        let (revolutions, ends) = cut(&paused);
        let expected = "interruptions of the packet stream (clock jump or pause)";
        assert_eq!((revolutions.len(), reasons(&ends)), (4, vec![(expected, 1)]));
    }

    /// Laser 31 fires 16 x 1.152 us after laser 15: that much later, and at 31/40 of a step.
    #[test]
    fn another_laser_has_its_own_time_and_azimuth() {
        let mut splitter = RevolutionSplitter::new(&LidarOptions::default(), Laser::new(31));
        let mut revolutions = Vec::new();
        packets(400, 35_000, 20).iter().for_each(|packet| splitter.push(packet, &mut revolutions));
        splitter.finish(&mut revolutions);
        // 359.8 + 0.155 deg is the last before the cut.
        assert_eq!(revolutions[0].firings[0].fine_azimuth, 31 * 20);
        assert_eq!(revolutions[0].stamp_ns, 1_000_000_000 + 50 * 46_080 + 31 * 1152);
    }

    #[test]
    fn a_stalled_sensor_gives_no_endless_turn() {
        let mut packets = packets(2400, 35_000, 20);
        for packet in &mut packets[200..2000] {
            packet.azimuth = [12_345; BLOCKS];
        }
        let (revolutions, ends) = cut(&packets);
        assert!(revolutions.iter().all(|revolution| revolution.firings.len() <= MAX_FIRINGS));
        assert!(ends.dropped.iter().any(|(reason, _)| reason.contains("stalled")));
    }

    /// One count back: within a packet, at its border, and back over azimuth 0.
    #[test]
    fn jitter_of_the_encoder_cuts_no_turn() {
        let clean = packets(400, 35_000, 20);
        // Block 50 is the first past azimuth 0: packet 4, block 2.
        for (packet, block) in [(100, 5), (100, 0), (4, 3)] {
            let mut jittery = clean.clone();
            let before = match block {
                0 => jittery[packet - 1].azimuth[BLOCKS - 1],
                _ => jittery[packet].azimuth[block - 1],
            };
            jittery[packet].azimuth[block] = (before + 35_999) % 36_000;
            let (revolutions, ends) = cut(&jittery);
            let holes: f32 = revolutions.iter().map(|revolution| scan(revolution).hole_deg).sum();
            let found = (revolutions.len(), ends.n_missing_packets, ends.dropped.is_empty(), holes);
            assert_eq!(found, (2, 0, true, 0.0), "packet {packet}, block {block}");
        }
    }

    #[test]
    fn a_device_clock_that_stands_still_is_done_without() {
        let mut packets = packets(900, 35_000, 20);
        packets.iter_mut().for_each(|packet| packet.device_us = 7);
        let (revolutions, ends) = cut(&packets[..400]);
        assert_eq!((revolutions.len(), ends.dropped.is_empty()), (2, true));
        // The stamps of a whole message may be the same.
        let mut by_message = packets[..400].to_vec();
        for (k, packet) in by_message.iter_mut().enumerate() {
            packet.end_ns = 1_000_000_000 + (k as i64 / 181 + 1) * 181 * PACKET_PERIOD_NS;
        }
        let (revolutions, ends) = cut(&by_message);
        assert_eq!((revolutions.len(), ends.n_missing_packets), (2, 0));
        // Three turns missing show in the stamps.
        packets.drain(200..650);
        let (revolutions, ends) = cut(&packets);
        assert_eq!(revolutions.len(), 1, "{:?}", reasons(&ends));
        assert!(ends.dropped.iter().any(|(reason, n)| reason.contains("every packet") && n == 2));
    }
}
