//! Puts packets into firing order and removes duplicates.
//!
//! UDP does not preserve order, and some recorders write a datagram twice. The device clock shows
//! both. The stamps do not, because the host assigns them on arrival.

use std::collections::VecDeque;

use dataset::{LossKind, Losses};

use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;
use crate::velodyne::packet_gap::PacketGap;

/// A packet that is late by up to this time is put back in order \[us\]. It allows two messages of
/// one revolution each to be swapped, at 5 revolutions per second. A larger step back means that the
/// device clock was set back.
const MAX_LATE_US: f64 = 500e3;
/// Number of packets to hold back: about [`MAX_LATE_US`] of them, or half of that in dual-return
/// mode, which has twice as many packets.
const MAX_HELD: usize = 1024;
/// A late packet is inserted only where the time to each neighbour is at least this share of the
/// duration of a packet.
const MIN_ROOM: f64 = 0.5;

/// Puts packets into firing order.
#[derive(Debug, Default)]
pub(crate) struct Reorderer {
    /// Packets held back, in firing order.
    held: VecDeque<RingPacket>,
    /// The packet that was emitted last.
    emitted: Option<RingPacket>,
    /// Number of late packets that were put back in order.
    pub(crate) n_late: u64,
    /// Packets that were dropped.
    pub(crate) losses: Losses,
}

impl Reorderer {
    /// Takes the next packet of the log. Calls `emit` with each packet whose place is settled.
    pub(crate) fn push(&mut self, packet: &RingPacket, mut emit: impl FnMut(&RingPacket)) {
        if packet.end_ns == 0 {
            self.losses.add(LossKind::UnstampedPackets, 1);
            return;
        }
        let gap_us = self.held.back().map_or(0.0, |newest| device_gap_us(newest, packet));
        // A packet that continues the newest one is not late, even if the clock says so.
        let is_set_back = |newest: &RingPacket| PacketGap::new(newest, packet).clock_jumped();
        if gap_us < -MAX_LATE_US || gap_us < 0.0 && self.held.back().is_some_and(is_set_back) {
            self.flush(&mut emit);
        } else if gap_us < 0.0 {
            self.insert(packet);
            return;
        } else if self.held.back().is_some_and(|newest| packet.repeats(newest)) {
            self.losses.add(LossKind::DuplicatePackets, 1);
            return;
        }
        // Inserted late packets can make the queue longer than the limit.
        while MAX_HELD <= self.held.len()
            && let Some(oldest) = self.held.pop_front()
        {
            emit(&oldest);
            self.emitted = Some(oldest);
        }
        self.held.push_back(*packet);
    }

    /// Emits all packets that are held back.
    pub(crate) fn flush(&mut self, emit: &mut impl FnMut(&RingPacket)) {
        self.held.iter().for_each(emit);
        self.emitted = None;
        self.held.clear();
    }

    /// Inserts a late packet before the first packet that was fired after it, if there is room.
    fn insert(&mut self, packet: &RingPacket) {
        let after = self.held.partition_point(|other| device_gap_us(other, packet) >= 0.0);
        let next = &self.held[after];
        let previous = match after {
            0 => self.emitted.as_ref(),
            after => self.held.get(after - 1),
        };
        if previous.is_some_and(|previous| packet.repeats(previous)) {
            self.losses.add(LossKind::DuplicatePackets, 1);
            return;
        }
        let from_previous_us = previous.map_or(f64::INFINITY, |p| device_gap_us(p, packet));
        if from_previous_us < 0.0 {
            self.losses.add(LossKind::LatePackets, 1);
            return;
        }
        let min_room_us = MIN_ROOM * packet.period_ns() as f64 / 1000.0;
        let to_next_us = device_gap_us(packet, next);
        if from_previous_us < min_room_us || to_next_us < min_room_us {
            self.losses.add(LossKind::PacketsAtTakenTime, 1);
            return;
        }
        self.n_late += 1;
        let mut packet = *packet;
        // The host stamps packets on arrival, so the stamp of a late packet is late too.
        if next.end_ns <= packet.end_ns {
            packet.end_ns = next.end_ns - (to_next_us * 1000.0) as i64;
        }
        self.held.insert(after, packet);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::velodyne::packet::tests::packets;
    use messages::hdl32e::HOUR_US;

    /// Returns the device times of the emitted packets \[us since the first packet\], and the
    /// reorderer.
    fn reorder(packets: &[RingPacket]) -> (Vec<f64>, Reorderer) {
        let mut reorderer = Reorderer::default();
        let mut out: Vec<RingPacket> = Vec::new();
        for packet in packets {
            reorderer.push(packet, |packet| out.push(*packet));
        }
        reorderer.flush(&mut |packet| out.push(*packet));
        assert!(out.windows(2).all(|pair| pair[0].end_ns < pair[1].end_ns));
        (out.iter().map(|packet| device_gap_us(&packets[0], packet)).collect(), reorderer)
    }

    #[test]
    fn late_packets_are_put_back_in_order_across_the_top_of_the_hour() {
        let in_order = packets(700, 35_000, 20);
        let (times, _) = reorder(&in_order);
        // The clock wraps after the third packet. Swap two packets there, and move one by 300.
        let mut shuffled = in_order.clone();
        shuffled.swap(2, 3);
        let moved = shuffled.remove(100);
        shuffled.insert(400, moved);
        let (sorted, reorderer) = reorder(&shuffled);
        assert_eq!(sorted, times);
        assert_eq!((reorderer.n_late, reorderer.losses.is_empty()), (2, true));
        // Swap two whole messages.
        let mut swapped = in_order.clone();
        swapped[..400].rotate_left(200);
        let (sorted, reorderer) = reorder(&swapped);
        assert_eq!((sorted.len(), reorderer.n_late), (700, 200));
    }

    /// One packet in ten is late, in a log much longer than the queue.
    #[test]
    fn late_packets_do_not_make_the_queue_grow() {
        let mut late = packets(20 * MAX_HELD, 35_000, 20);
        (MAX_HELD..late.len() - 1).step_by(10).for_each(|k| late.swap(k, k + 1));
        let mut reorderer = Reorderer::default();
        for packet in &late {
            reorderer.push(packet, |_| {});
            assert!(reorderer.held.len() <= MAX_HELD + 1);
        }
        assert!(900 < reorderer.n_late);
    }

    #[test]
    fn the_stamp_of_a_late_packet_is_corrected_only_if_it_is_late_too() {
        let in_order = packets(10, 35_000, 20);
        let mut late = in_order.clone();
        late.swap(4, 5);
        late[5].end_ns = late[4].end_ns + 1000; // stamped on arrival, after the other packet
        let mut reorderer = Reorderer::default();
        late.iter().for_each(|packet| reorderer.push(packet, |_| {}));
        // A packet takes 552.96 us. The device clock rounds to 553.
        assert_eq!(reorderer.held[4].end_ns, in_order[5].end_ns - 553_000);
        let mut swapped = in_order.clone();
        swapped.swap(4, 5);
        let mut reorderer = Reorderer::default();
        swapped.iter().for_each(|packet| reorderer.push(packet, |_| {}));
        assert!(reorderer.held.iter().eq(&in_order));
    }

    #[test]
    fn duplicate_packets_are_dropped_next_to_and_far_from_the_original() {
        let mut twice = packets(100, 35_000, 20);
        twice.insert(51, twice[50]);
        twice.insert(90, twice[10]);
        let (times, reorderer) = reorder(&twice);
        assert_eq!(times.len(), 100);
        assert_eq!(reorderer.losses.to_string(), "2 duplicate packets");
    }

    /// Azimuth and stamps continue, so no packet is late and none is lost.
    #[test]
    fn a_device_clock_set_back_slightly_does_not_reorder_packets() {
        let mut set_back = packets(400, 35_000, 20);
        for packet in &mut set_back[200..] {
            packet.device_us = (packet.device_us + HOUR_US - 100_000) % HOUR_US;
        }
        let (times, reorderer) = reorder(&set_back);
        assert_eq!((times.len(), reorderer.n_late), (400, 0), "{}", reorderer.losses);
    }
}
