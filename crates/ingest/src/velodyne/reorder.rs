//! Packets as they stand in the log -> packets in the order they were fired, each once.
//!
//! UDP keeps no order and some recorders write a datagram twice. The device clock tells both; the
//! stamps, which the host made, do not.

use std::collections::VecDeque;

use dataset::Dropped;

use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;
use crate::velodyne::packet_gap::PacketGap;

/// A packet can come so much later than those fired after it and still find its place \[us\]: two
/// messages of a turn each may have changed places, at 5 turns a second. Beyond, the device clock
/// was set back.
const LATE_US: f64 = 500e3;
/// Packets held back: about [`LATE_US`] of them, or half of that in dual-return mode, which has twice
/// as many.
const HELD: usize = 1024;
/// A late packet has its place where the neighbours leave it at least this share of a packet's
/// time.
const ROOM: f64 = 0.5;

/// Puts packets in order.
#[derive(Debug, Default)]
pub(crate) struct Reorderer {
    /// In order of firing.
    held: VecDeque<RingPacket>,
    /// The packet that was handed out last.
    emitted: Option<RingPacket>,
    /// Packets that came late and were put where they belong.
    pub(crate) n_late: u64,
    /// Packets that are of no use.
    pub(crate) dropped: Dropped,
}

impl Reorderer {
    /// Takes the next packet of the log; `emit` gets those whose turn it is.
    pub(crate) fn push(&mut self, packet: &RingPacket, mut emit: impl FnMut(&RingPacket)) {
        if packet.end_ns == 0 {
            self.dropped.add("packets without a stamp (0)", 1);
            return;
        }
        let gap_us = self.held.back().map_or(0.0, |newest| device_gap_us(newest, packet));
        // A packet that goes on where the newest ended is not late, whatever the clock says.
        let set_back = |newest: &RingPacket| PacketGap::new(newest, packet).clock_jumped();
        if gap_us < -LATE_US || gap_us < 0.0 && self.held.back().is_some_and(set_back) {
            self.flush(&mut emit);
        } else if gap_us < 0.0 {
            self.insert(packet);
            return;
        } else if self.held.back().is_some_and(|newest| packet.repeats(newest)) {
            self.dropped.add(REPEATED, 1);
            return;
        }
        // Late packets were put between them: there can be more than that.
        while HELD <= self.held.len()
            && let Some(oldest) = self.held.pop_front()
        {
            emit(&oldest);
            self.emitted = Some(oldest);
        }
        self.held.push_back(*packet);
    }

    /// Hands out what is held back.
    pub(crate) fn flush(&mut self, emit: &mut impl FnMut(&RingPacket)) {
        self.held.iter().for_each(emit);
        self.emitted = None;
        self.held.clear();
    }

    /// Puts a late packet before the first that was fired after it, if there is room for it.
    fn insert(&mut self, packet: &RingPacket) {
        let after = self.held.partition_point(|other| device_gap_us(other, packet) >= 0.0);
        let next = &self.held[after];
        let previous = match after {
            0 => self.emitted.as_ref(),
            after => self.held.get(after - 1),
        };
        if previous.is_some_and(|previous| packet.repeats(previous)) {
            self.dropped.add(REPEATED, 1);
            return;
        }
        let from_previous_us = previous.map_or(f64::INFINITY, |p| device_gap_us(p, packet));
        if from_previous_us < 0.0 {
            self.dropped.add("packets that came too late to be put in order", 1);
            return;
        }
        let room_us = ROOM * packet.period_ns() as f64 / 1000.0;
        let to_next_us = device_gap_us(packet, next);
        if from_previous_us < room_us || to_next_us < room_us {
            self.dropped.add("packets whose time another packet takes (device clock set back)", 1);
            return;
        }
        self.n_late += 1;
        let mut packet = *packet;
        // A host stamps what arrives: a late packet's stamp is late too.
        if next.end_ns <= packet.end_ns {
            packet.end_ns = next.end_ns - (to_next_us * 1000.0) as i64;
        }
        self.held.insert(after, packet);
    }
}

const REPEATED: &str = "packets that are there twice";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velodyne::packet::tests::packets;
    use messages::hdl32e::HOUR_US;

    /// Device times of what comes out \[us past the first\], and the reorderer.
    fn order(packets: &[RingPacket]) -> (Vec<f64>, Reorderer) {
        let mut reorderer = Reorderer::default();
        let mut out: Vec<RingPacket> = Vec::new();
        for packet in packets {
            reorderer.push(packet, |packet| out.push(*packet));
        }
        reorderer.flush(&mut |packet| out.push(*packet));
        assert!(out.windows(2).all(|pair| pair[0].end_ns < pair[1].end_ns));
        (out.iter().map(|packet| device_gap_us(&packets[0], packet)).collect(), reorderer)
    }

    fn reasons(reorderer: &Reorderer) -> Vec<(&str, u64)> {
        reorderer.dropped.iter().collect()
    }

    #[test]
    fn late_packets_find_their_place_across_the_top_of_the_hour() {
        let in_order = packets(700, 35_000, 20);
        let (times, _) = order(&in_order);
        // The clock wraps after the third packet: swap around there, and move one far back.
        let mut shuffled = in_order.clone();
        shuffled.swap(2, 3);
        let moved = shuffled.remove(100);
        shuffled.insert(400, moved);
        let (sorted, reorderer) = order(&shuffled);
        assert_eq!(sorted, times);
        assert_eq!((reorderer.n_late, reorderer.dropped.is_empty()), (2, true));
        // Whole messages that changed places.
        let mut swapped = in_order.clone();
        swapped[..400].rotate_left(200);
        let (sorted, reorderer) = order(&swapped);
        assert_eq!((sorted.len(), reorderer.n_late), (700, 200));
    }

    /// One packet in ten comes late, in a log of many times what is held back.
    #[test]
    fn late_packets_do_not_add_to_what_is_held_back() {
        let mut late = packets(20 * HELD, 35_000, 20);
        (HELD..late.len() - 1).step_by(10).for_each(|k| late.swap(k, k + 1));
        let mut reorderer = Reorderer::default();
        for packet in &late {
            reorderer.push(packet, |_| {});
            assert!(reorderer.held.len() <= HELD + 1);
        }
        assert!(900 < reorderer.n_late);
    }

    #[test]
    fn a_late_stamp_is_put_right_a_right_one_kept() {
        let in_order = packets(10, 35_000, 20);
        let mut late = in_order.clone();
        late.swap(4, 5);
        late[5].end_ns = late[4].end_ns + 1000; // stamped on arrival, behind the other
        let mut reorderer = Reorderer::default();
        late.iter().for_each(|packet| reorderer.push(packet, |_| {}));
        // A packet takes 552.96 us; the device clock says 553.
        assert_eq!(reorderer.held[4].end_ns, in_order[5].end_ns - 553_000);
        let mut swapped = in_order.clone();
        swapped.swap(4, 5);
        let mut reorderer = Reorderer::default();
        swapped.iter().for_each(|packet| reorderer.push(packet, |_| {}));
        assert!(reorderer.held.iter().eq(&in_order));
    }

    #[test]
    fn repeated_packets_are_counted_wherever_they_stand() {
        let mut twice = packets(100, 35_000, 20);
        twice.insert(51, twice[50]);
        twice.insert(90, twice[10]);
        let (times, reorderer) = order(&twice);
        assert_eq!(times.len(), 100);
        assert_eq!(reasons(&reorderer), [(REPEATED, 2)]);
    }

    /// Neither azimuth nor stamps know of it: no packet is late, and none is lost.
    #[test]
    fn a_clock_that_is_set_back_a_little_does_not_shuffle_packets() {
        let mut set_back = packets(400, 35_000, 20);
        for packet in &mut set_back[200..] {
            packet.device_us = (packet.device_us + HOUR_US - 100_000) % HOUR_US;
        }
        let (times, reorderer) = order(&set_back);
        assert_eq!((times.len(), reorderer.n_late), (400, 0), "{:?}", reasons(&reorderer));
    }
}
