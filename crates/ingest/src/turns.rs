//! Firings -> turns, cut where the azimuth passes 0, across packets and messages -> scans.

use std::f64::consts::TAU;

use dataset::{Dropped, RangeLimits, Scan};
use messages::hdl32e::{
    AZIMUTH_COUNTS, BLOCK_PERIOD_NS, LASER_PERIOD_NS, METRES_PER_COUNT, PERIODS_PER_BLOCK,
};

use crate::LidarOptions;
use crate::ring::{self, LASER, OtherSensor, RingPacket, device_gap_us};

/// Azimuth is counted in 1/40 of 0.01 deg, in which the azimuth of every laser of a block is a
/// whole number: laser `k` fires `k / 40` of a block period after the block's azimuth was read.
const FINE_PER_COUNT: u32 = PERIODS_PER_BLOCK as u32;
/// Fine counts in a turn.
const FINE_TURN: u32 = AZIMUTH_COUNTS as u32 * FINE_PER_COUNT;
/// Packets looked at to tell the sensor model.
const PACKETS_TO_IDENTIFY: usize = 200;
/// A step over more than this many ordinary ones means that packets are missing.
const MAX_STEPS: f64 = 2.5;
/// Time between two packets beyond which the recording is taken to have been interrupted \[us\].
const INTERRUPTED_US: f64 = 2e6;
/// A packet that was fired up to so long before the one ahead of it came late on the network;
/// beyond, the device clock was set back \[us\].
const LATE_US: f64 = 20e3;
/// Firings in a turn beyond which the sensor is taken to have stalled: 0.46 s, where the slowest
/// turn, at 5 Hz, takes 0.2 s.
const MAX_FIRINGS: usize = 10_000;

/// One firing of the laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Firing {
    /// \[1/40 of 0.01 deg, clockwise\], below a full turn.
    fine_azimuth: u32,
    /// \[2 mm\], 0 for no return.
    distance: u16,
}

/// The firings between two passes of azimuth 0.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Turn {
    /// When the first firing of the laser happened \[ns\].
    stamp_ns: i64,
    firings: Vec<Firing>,
    /// Sum of the steps from each firing to where the next is due \[0.01 deg\].
    swept: u64,
    /// Azimuth passed without a packet \[0.01 deg\], up to the next firing there is.
    missed: u64,
    /// The step of the last firing.
    last_step: u32,
    /// Whether the turn's start was seen: the firing before it lies in another turn, or is due
    /// before azimuth 0.
    starts_at_cut: bool,
}

impl Turn {
    /// Angle from the first firing to the last \[deg\], what was missed between included: a turn of
    /// which packets are missing is a full circle all the same.
    fn coverage_deg(&self) -> f32 {
        (self.swept + self.missed).saturating_sub(u64::from(self.last_step)) as f32 / 100.0
    }
}

/// Cuts the packets of a log, given in order, into turns.
#[derive(Debug)]
pub(crate) struct TurnCutter {
    max_hole: u64,
    /// The packet whose last step the next packet will tell.
    pending: Option<RingPacket>,
    turn: Turn,
    first_packets: Vec<RingPacket>,
    other_sensor: Option<OtherSensor>,
    ends: Ends,
}

/// What is left when a log ends.
#[derive(Debug, Default)]
pub(crate) struct Ends {
    /// Turns that the log, or an interruption, starts or ends within.
    pub(crate) n_partial: usize,
    /// Turns with holes, and what else was lost.
    pub(crate) dropped: Dropped,
}

/// How two successive packets lie to each other.
enum Link {
    /// The second is the first once more.
    Repeated,
    /// The second was fired before the first.
    OutOfOrder,
    /// The second follows the first; the step between them \[0.01 deg\].
    Next(u32),
    /// Packets are missing; the sensor turned on by so much meanwhile \[0.01 deg\].
    Hole(u64),
    /// The second belongs to another recording, or the clock jumped.
    Interrupted,
}

impl TurnCutter {
    pub(crate) fn new(max_hole_deg: f64) -> Self {
        Self {
            max_hole: (max_hole_deg * 100.0).max(0.0) as u64,
            pending: None,
            turn: Turn::default(),
            first_packets: Vec::new(),
            other_sensor: None,
            ends: Ends::default(),
        }
    }

    /// The sensor the packets are of, if it is no HDL-32E.
    pub(crate) fn other_sensor(&mut self) -> Option<OtherSensor> {
        if self.first_packets.len() < PACKETS_TO_IDENTIFY {
            self.other_sensor = ring::other_sensor(&self.first_packets);
        }
        self.other_sensor.clone()
    }

    /// Adds the next packet; complete turns go to `turns`.
    pub(crate) fn push(&mut self, packet: &RingPacket, turns: &mut Vec<Turn>) {
        if self.first_packets.len() < PACKETS_TO_IDENTIFY {
            self.first_packets.push(*packet);
            if self.first_packets.len() == PACKETS_TO_IDENTIFY {
                self.other_sensor = ring::other_sensor(&self.first_packets);
            }
        }
        if packet.end_ns == 0 {
            self.ends.dropped.add("packets without a stamp (0)", 1);
            return;
        }
        let Some(pending) = self.pending else {
            self.pending = Some(*packet);
            return;
        };
        match link(&pending, packet) {
            Link::Repeated => {
                self.ends.dropped.add("packets that are there twice", 1);
                return;
            }
            Link::OutOfOrder => {
                self.ends.dropped.add("packets out of order", 1);
                return;
            }
            Link::Next(step) => self.add(&pending, step, turns),
            Link::Hole(turned) => {
                let step = own_step(&pending);
                self.add(&pending, step, turns);
                self.skip(turned, turns);
            }
            Link::Interrupted => {
                self.add(&pending, own_step(&pending), turns);
                self.ends
                    .dropped
                    .add("interruptions of the packet stream (clock jump or pause)", 1);
                self.interrupt(turns);
            }
        }
        self.pending = Some(*packet);
    }

    /// Adds the last packet and ends the last turn.
    pub(crate) fn finish(mut self, turns: &mut Vec<Turn>) -> Ends {
        if let Some(pending) = self.pending.take() {
            self.add(&pending, own_step(&pending), turns);
        }
        self.interrupt(turns);
        self.ends
    }

    /// Adds the firings of a packet whose last step is known.
    fn add(&mut self, packet: &RingPacket, last_step: u32, turns: &mut Vec<Turn>) {
        let n = usize::from(packet.n_firings);
        let first_ns = packet.end_ns - packet.period_ns() + LASER as i64 * LASER_PERIOD_NS;
        for k in 0..n {
            let azimuth = packet.azimuth[k];
            let step =
                if k + 1 < n { step_within(azimuth, packet.azimuth[k + 1]) } else { last_step };
            let fine = u32::from(azimuth) * FINE_PER_COUNT + LASER as u32 * step;
            let fine_azimuth = if fine < FINE_TURN { fine } else { fine - FINE_TURN };
            // Back by more than half a turn is on past 0; back by less is jitter.
            let passed_zero = self
                .turn
                .firings
                .last()
                .is_some_and(|last| fine_azimuth + FINE_TURN / 2 < last.fine_azimuth);
            if passed_zero {
                self.cut(turns);
            }
            if self.turn.firings.is_empty() {
                self.turn.stamp_ns = first_ns + k as i64 * BLOCK_PERIOD_NS;
                // The firing before the first of a log is due one step before it.
                self.turn.starts_at_cut |= fine_azimuth < step * FINE_PER_COUNT;
            }
            if self.turn.firings.len() == MAX_FIRINGS {
                self.ends.dropped.add("turns of more than 0.46 s (the sensor stalled)", 1);
                self.turn = Turn::default();
            }
            self.turn.firings.push(Firing { fine_azimuth, distance: packet.distance[k] });
            self.turn.swept += u64::from(step);
            self.turn.last_step = step;
        }
    }

    /// Passes over missing packets, which cover `turned`: what they cover is missing in the turn,
    /// or in the turns.
    fn skip(&mut self, turned: u64, turns: &mut Vec<Turn>) {
        let whole_turn = u64::from(AZIMUTH_COUNTS);
        let at = self.turn.firings.last().map_or(0, |last| last.fine_azimuth / FINE_PER_COUNT);
        let at = u64::from(at);
        // The last firing's own step is swept already.
        let missed = turned.saturating_sub(u64::from(self.turn.last_step));
        let turns_passed = (at + turned) / whole_turn;
        if turns_passed == 0 {
            self.turn.missed += missed;
            return;
        }
        self.turn.missed += missed.min(whole_turn.saturating_sub(at));
        self.cut(turns);
        self.turn.missed = (at + turned) % whole_turn;
        if turns_passed > 1 {
            self.ends.dropped.add("turns of which every packet is missing", turns_passed - 1);
        }
    }

    /// Ends the turn at a cut that was seen.
    fn cut(&mut self, turns: &mut Vec<Turn>) {
        let turn = std::mem::take(&mut self.turn);
        self.turn.firings.reserve(turn.firings.len() + 8);
        self.turn.starts_at_cut = true;
        if !turn.starts_at_cut {
            self.ends.n_partial += 1;
        } else {
            self.keep(turn, turns);
        }
    }

    /// Ends the turn where the stream of packets ends.
    fn interrupt(&mut self, turns: &mut Vec<Turn>) {
        let turn = std::mem::take(&mut self.turn);
        let Some(last) = turn.firings.last() else { return };
        let ends_at_cut = FINE_TURN <= last.fine_azimuth + turn.last_step * FINE_PER_COUNT;
        if turn.starts_at_cut && ends_at_cut {
            self.keep(turn, turns);
        } else {
            self.ends.n_partial += 1;
        }
    }

    fn keep(&mut self, turn: Turn, turns: &mut Vec<Turn>) {
        // A firing or two at the cut are no hole.
        let slack = 2 * u64::from(turn.last_step).min(100);
        let missing = u64::from(AZIMUTH_COUNTS).saturating_sub(turn.swept + slack);
        if self.max_hole < missing {
            let reason = format!(
                "turns with a hole of more than {} deg (packets missing)",
                self.max_hole as f64 / 100.0
            );
            self.ends.dropped.add(reason, 1);
        } else {
            turns.push(turn);
        }
    }
}

/// Azimuth from one block to the next \[0.01 deg\], clockwise.
fn step(from: u16, to: u16) -> u32 {
    let (from, to) = (u32::from(from), u32::from(to));
    if from <= to { to - from } else { to + u32::from(AZIMUTH_COUNTS) - from }
}

/// The step within a packet; a sensor turns one way, so that a step back is encoder jitter.
fn step_within(from: u16, to: u16) -> u32 {
    match step(from, to) {
        back if u32::from(AZIMUTH_COUNTS) / 2 < back => 0,
        ahead => ahead,
    }
}

/// The last step of a packet as its step before tells it.
fn own_step(packet: &RingPacket) -> u32 {
    let n = usize::from(packet.n_firings);
    step_within(packet.azimuth[n - 2], packet.azimuth[n - 1])
}

fn link(earlier: &RingPacket, later: &RingPacket) -> Link {
    let n = usize::from(earlier.n_firings);
    let between = step(earlier.azimuth[n - 1], later.azimuth[0]);
    let mean_step = f64::from(step(earlier.azimuth[0], earlier.azimuth[n - 1])) / (n - 1) as f64;
    let period_us = earlier.period_ns() as f64 / 1000.0;
    let device_us = device_gap_us(earlier, later);
    let stamps_us = later.end_ns.saturating_sub(earlier.end_ns) as f64 / 1000.0;
    if device_us == 0.0 && earlier.azimuth == later.azimuth && mean_step > 0.0 {
        return Link::Repeated;
    }
    if device_us < 0.0 {
        return if -LATE_US < device_us { Link::OutOfOrder } else { Link::Interrupted };
    }
    // The device clock is the finer one; where it stands still the stamps must do. Where the two
    // disagree, one of them has jumped, or a whole number of hours has passed.
    let gap_us = if device_us == 0.0 { stamps_us } else { device_us };
    let disagree = device_us != 0.0 && INTERRUPTED_US < (stamps_us - device_us).abs();
    if INTERRUPTED_US < gap_us || disagree {
        return Link::Interrupted;
    }
    // Stamps of packets that the host read in one go are of one moment: not late is on time.
    let on_time = gap_us < if device_us == 0.0 { 0.02e6 } else { 1.5 * period_us };
    if on_time && f64::from(between) <= MAX_STEPS * mean_step.max(1.0) {
        return Link::Next(between);
    }
    // The time that passed tells how many whole turns the azimuths hide.
    let block_us = BLOCK_PERIOD_NS as f64 / 1000.0;
    let steps = (gap_us - period_us) / block_us + 1.0;
    let expected = steps.max(0.0) * mean_step;
    let hidden_turns =
        ((expected - f64::from(between)) / f64::from(AZIMUTH_COUNTS)).round().max(0.0) as u64;
    Link::Hole(u64::from(between) + hidden_turns * u64::from(AZIMUTH_COUNTS))
}

/// Turns -> scans.
pub(crate) struct ScanMaker {
    limits: RangeLimits,
    /// Sign of y for an azimuth that is clockwise from above.
    side: f64,
    /// Cosine and sine of each whole count of azimuth.
    directions: Vec<[f64; 2]>,
}

impl ScanMaker {
    pub(crate) fn new(options: &LidarOptions) -> Self {
        let directions = (0..AZIMUTH_COUNTS)
            .map(|count| {
                let (sin, cos) = libm::sincos(f64::from(count) * TAU / f64::from(AZIMUTH_COUNTS));
                [cos, sin]
            })
            .collect();
        Self {
            limits: RangeLimits { min_m: options.range_min_m, max_m: options.range_max_m },
            side: if options.upside_down { 1.0 } else { -1.0 },
            directions,
        }
    }

    /// x forward, y left (REP 103); azimuth 0 is forward and azimuth grows clockwise:
    /// x = r cos a, y = -r sin a. Upside down, rolled about x, azimuth grows counter-clockwise.
    pub(crate) fn scan(&self, turn: &Turn) -> Scan {
        let n_returns = turn.firings.iter().filter(|firing| firing.distance != 0).count();
        let mut scan = Scan {
            stamp_ns: turn.stamp_ns,
            x_m: Vec::with_capacity(n_returns),
            y_m: Vec::with_capacity(n_returns),
            coverage_deg: turn.coverage_deg(),
        };
        for firing in &turn.firings {
            let range_m = f64::from(firing.distance) * METRES_PER_COUNT;
            if firing.distance != 0 && self.limits.contains(range_m) {
                let [cos, sin] = self.direction(firing.fine_azimuth);
                scan.x_m.push((range_m * cos) as f32);
                scan.y_m.push((self.side * range_m * sin) as f32);
            }
        }
        scan
    }

    /// Cosine and sine of an azimuth: those of the whole count, turned on by the rest d, which is
    /// less than 1.8e-4 rad, so that cos d = 1 - d^2/2 and sin d = d - d^3/6 are exact in f64.
    #[inline]
    fn direction(&self, fine_azimuth: u32) -> [f64; 2] {
        let [cos, sin] = self.directions[(fine_azimuth / FINE_PER_COUNT) as usize];
        let d = f64::from(fine_azimuth % FINE_PER_COUNT) * (TAU / f64::from(FINE_TURN));
        let (cos_d, sin_d) = (1.0 - 0.5 * d * d, d - d * d * d / 6.0);
        [cos * cos_d - sin * sin_d, sin * cos_d + cos * sin_d]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{BLOCKS, HOUR_US, PACKET_PERIOD_NS};

    /// Packets of a sensor that turns by `step` \[0.01 deg\] a block, starting at `azimuth`; each
    /// firing measures 5 m.
    fn packets(n: usize, azimuth: u32, step: u32) -> Vec<RingPacket> {
        (0..n)
            .map(|k| RingPacket {
                end_ns: 1_000_000_000 + (k as i64 + 1) * PACKET_PERIOD_NS,
                // The clock wraps at the top of the hour after the third packet.
                device_us: ((u64::from(HOUR_US) - 1500 + 553 * k as u64) % u64::from(HOUR_US))
                    as u32,
                n_firings: BLOCKS as u8,
                product: 0x21,
                azimuth: std::array::from_fn(|b| {
                    ((azimuth + step * (k * BLOCKS + b) as u32) % 36_000) as u16
                }),
                distance: [2500; BLOCKS],
            })
            .collect()
    }

    fn cut(packets: &[RingPacket]) -> (Vec<Turn>, Ends) {
        let mut cutter = TurnCutter::new(5.0);
        let mut turns = Vec::new();
        for packet in packets {
            cutter.push(packet, &mut turns);
        }
        let ends = cutter.finish(&mut turns);
        (turns, ends)
    }

    fn reasons(ends: &Ends) -> Vec<(&str, u64)> {
        ends.dropped.iter().collect()
    }

    /// With steps of 0.2 deg laser 15 fires 0.075 deg after its block's azimuth. Blocks at 359.8,
    /// 0.0, 0.2 deg give 359.875, 0.075, 0.275 deg: a turn has 1800 firings and starts at 0.075.
    #[test]
    fn a_turn_starts_at_the_first_firing_past_zero() {
        let (turns, ends) = cut(&packets(400, 35_000, 20));
        // 4800 firings: 50 before the first cut (350.0 to 359.8 deg), two turns, the rest.
        assert_eq!((turns.len(), ends.n_partial), (2, 2));
        assert!(ends.dropped.is_empty());
        for (k, turn) in turns.iter().enumerate() {
            assert_eq!(turn.firings.len(), 1800);
            assert_eq!(turn.firings[0].fine_azimuth, 15 * 20);
            assert_eq!(turn.firings[1].fine_azimuth, 55 * 20);
            // Block 50 of the log, then 1800 blocks on; laser 15 fires 17.28 us into its block.
            let block = 50 + 1800 * k as i64;
            assert_eq!(turn.stamp_ns, 1_000_000_000 + block * 46_080 + 17_280);
        }
        let scan = ScanMaker::new(&LidarOptions::default()).scan(&turns[0]);
        assert!((scan.coverage_deg - 359.8).abs() < 1e-4);
        assert!(scan.is_ring());
    }

    /// The step from 359.99 to 0.19 deg is 0.2 deg, not -359.8; of it 3/8 is 0.075.
    #[test]
    fn azimuth_is_interpolated_across_the_seam() {
        let (turns, _) = cut(&packets(400, 35_999, 20));
        // Blocks at 359.99 + 0.2 k: laser 15 of the first fires at 0.065 deg, so that the log
        // starts with a cut and its first turn is whole.
        assert_eq!(turns[0].firings[0].fine_azimuth, 65 * 4);
        assert_eq!(turns[0].stamp_ns, 1_000_000_000 + 17_280);
        assert_eq!(turns.len(), 2);
    }

    #[test]
    fn a_small_hole_is_kept_and_told_a_large_one_dropped() {
        let whole = packets(600, 35_000, 20);
        // Each packet is 2.4 deg. Two of them missing: 4.8 deg.
        let mut small = whole.clone();
        small.drain(100..102);
        let (turns, ends) = cut(&small);
        assert_eq!((turns.len(), reasons(&ends).len()), (3, 0));
        let scan = ScanMaker::new(&LidarOptions::default()).scan(&turns[0]);
        assert!((scan.coverage_deg - 359.8).abs() < 1e-4, "a ring, whatever is missing");
        assert_eq!(turns[0].firings.len(), 1776);
        // Three missing: 7.2 deg, that turn is dropped.
        let mut large = whole.clone();
        large.drain(100..103);
        let (turns, ends) = cut(&large);
        assert_eq!(turns.len(), 2);
        assert_eq!(reasons(&ends), [("turns with a hole of more than 5 deg (packets missing)", 1)]);
        // The cut itself may lie in the hole: both turns lose.
        let mut seam = whole.clone();
        seam.drain(150..160);
        let (turns, ends) = cut(&seam);
        assert_eq!(turns.len(), 1, "{:?}", reasons(&ends));
        assert_eq!(reasons(&ends), [("turns with a hole of more than 5 deg (packets missing)", 2)]);
    }

    #[test]
    fn turns_that_are_missing_altogether_are_counted() {
        let mut packets = packets(900, 35_000, 20);
        // 450 packets are three turns; after them the azimuth looks as if nothing were missing.
        // On paper: 350 + 200 x 2.4 = 830 deg, one whole turn (360 to 720); the hole reaches to
        // 1910 deg and takes from 720..1080 and 1800..2160 and all of the two turns between; the
        // log ends at 2510 deg.
        packets.drain(200..650);
        let (turns, ends) = cut(&packets);
        assert_eq!(
            reasons(&ends),
            [
                ("turns of which every packet is missing", 2),
                ("turns with a hole of more than 5 deg (packets missing)", 2)
            ]
        );
        assert_eq!((turns.len(), ends.n_partial), (1, 2));
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
        let (turns, ends) = cut(&both);
        // The second recording starts at 120 deg: 1200 firings, then two turns to the very end.
        assert_eq!((turns.len(), ends.n_partial), (4, 3));
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
        let (turns, ends) = cut(&packets);
        assert_eq!(ends.dropped.iter().count(), 1);
        assert_eq!((turns.len(), ends.n_partial), (4, 4));
    }

    #[test]
    fn repeated_and_swapped_packets_cost_no_turn() {
        let mut twice = packets(400, 35_000, 20);
        twice.insert(100, twice[99]);
        let (turns, ends) = cut(&twice);
        assert_eq!((turns.len(), reasons(&ends)), (2, vec![("packets that are there twice", 1)]));
        let mut swapped = packets(400, 35_000, 20);
        swapped.swap(100, 101);
        let (turns, ends) = cut(&swapped);
        assert_eq!((turns.len(), reasons(&ends)), (2, vec![("packets out of order", 1)]));
        // A clock that was set back by a second is no second's worth of late packets.
        let mut set_back = packets(800, 35_000, 20);
        for packet in &mut set_back[400..] {
            let device_us = u64::from(packet.device_us) + u64::from(HOUR_US) - 1_000_000;
            packet.device_us = (device_us % u64::from(HOUR_US)) as u32;
        }
        let (turns, ends) = cut(&set_back);
        let expected = "interruptions of the packet stream (clock jump or pause)";
        assert_eq!((turns.len(), reasons(&ends)), (4, vec![(expected, 1)]));
    }

    #[test]
    fn a_stalled_sensor_gives_no_endless_turn() {
        let mut packets = packets(2400, 35_000, 20);
        for packet in &mut packets[200..2000] {
            packet.azimuth = [12_345; BLOCKS];
        }
        let (turns, ends) = cut(&packets);
        assert!(turns.iter().all(|turn| turn.firings.len() <= MAX_FIRINGS));
        assert!(ends.dropped.iter().any(|(reason, _)| reason.contains("stalled")));
    }

    #[test]
    fn packets_without_stamps_are_counted() {
        let mut packets = packets(400, 35_000, 20);
        packets.iter_mut().for_each(|packet| packet.end_ns = 0);
        let (turns, ends) = cut(&packets);
        assert_eq!((turns.len(), reasons(&ends)), (0, vec![("packets without a stamp (0)", 400)]));
    }

    #[test]
    fn jitter_of_the_encoder_cuts_no_turn() {
        let mut packets = packets(400, 35_000, 20);
        packets[100].azimuth[5] = packets[100].azimuth[4] - 1;
        let (turns, ends) = cut(&packets);
        assert_eq!((turns.len(), ends.dropped.is_empty()), (2, true));
    }

    #[test]
    fn a_device_clock_that_stands_still_is_done_without() {
        let mut packets = packets(900, 35_000, 20);
        packets.iter_mut().for_each(|packet| packet.device_us = 7);
        let (turns, ends) = cut(&packets[..400]);
        assert_eq!((turns.len(), ends.dropped.is_empty()), (2, true));
        // Three turns missing show in the stamps.
        packets.drain(200..650);
        let (turns, ends) = cut(&packets);
        assert_eq!(turns.len(), 1, "{:?}", reasons(&ends));
        assert!(ends.dropped.iter().any(|(reason, n)| reason.contains("every packet") && n == 2));
    }

    /// 5 m at azimuth 90 deg, clockwise: to the right, y = -5; upside down to the left.
    #[test]
    fn azimuth_is_clockwise_and_mirrored_upside_down() {
        let firing = |deg: u32, distance| Firing { fine_azimuth: deg * 4000, distance };
        let turn = Turn {
            firings: vec![
                firing(0, 2500),
                firing(90, 2500),
                firing(91, 0),
                firing(180, 449),
                firing(181, 450),
            ],
            ..Turn::default()
        };
        for (upside_down, y) in [(false, -5.0), (true, 5.0)] {
            let scan = ScanMaker::new(&LidarOptions { upside_down, ..LidarOptions::default() })
                .scan(&turn);
            assert_eq!(scan.len(), 3, "no return and 0.898 m are left out, 0.9 m is kept");
            assert_eq!((scan.x_m[0], scan.y_m[0].abs()), (5.0, 0.0));
            assert!(scan.x_m[1].abs() < 1e-6 && (scan.y_m[1] - y).abs() < 1e-6);
        }
    }

    #[test]
    fn directions_are_exact_between_the_counts() {
        let maker = ScanMaker::new(&LidarOptions::default());
        for fine in (0..FINE_TURN).step_by(997) {
            let angle = f64::from(fine) * TAU / f64::from(FINE_TURN);
            let [cos, sin] = maker.direction(fine);
            // The angle itself is rounded to 9e-16.
            assert!((cos - angle.cos()).abs() < 2e-15 && (sin - angle.sin()).abs() < 2e-15);
        }
    }
}
