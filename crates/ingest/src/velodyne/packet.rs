//! Decodes Velodyne packets and extracts the firings of one laser.

use std::collections::BTreeMap;

use dataset::{LossKind, Losses};
use messages::hdl32e::{self, BLOCK_PERIOD_NS, BLOCKS, Packet, ReturnMode};
use messages::{Source, read_velodyne};

use crate::stamp::Stamp;

/// The part of a packet that belongs to one laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RingPacket {
    /// Stamp of the packet: the end of its last firing \[ns\].
    pub(crate) end_ns: i64,
    /// Device clock \[us past the hour\].
    pub(crate) device_us: u32,
    /// Number of firings: 12, or 6 in dual-return mode.
    pub(crate) n_firings: u8,
    /// Product byte.
    pub(crate) product: u8,
    /// Azimuth of the block of each firing \[0.01 deg, clockwise\].
    pub(crate) azimuth: [u16; BLOCKS],
    /// Distance measured by the laser \[2 mm\], 0 for no return.
    pub(crate) distance: [u16; BLOCKS],
}

impl RingPacket {
    /// Extracts the firings of a laser, given by its index in firing order.
    pub(crate) fn new(end_ns: i64, packet: &Packet<'_>, laser: usize) -> Self {
        let mut ring = Self {
            end_ns,
            device_us: packet.device_time_us(),
            n_firings: BLOCKS as u8,
            product: packet.product(),
            azimuth: std::array::from_fn(|block| packet.azimuth(block)),
            distance: std::array::from_fn(|block| packet.distance(block, laser)),
        };
        if packet.return_mode() == Some(ReturnMode::Dual) {
            ring.keep_stronger_returns(packet, laser);
        }
        ring
    }

    /// Merges the two blocks of each firing in dual-return mode. The two blocks have the same
    /// azimuth, and their order varies. The stronger return is kept.
    fn keep_stronger_returns(&mut self, packet: &Packet<'_>, laser: usize) {
        self.n_firings = (BLOCKS / 2) as u8;
        for firing in 0..BLOCKS / 2 {
            let (first, second) = (2 * firing, 2 * firing + 1);
            let block = match packet.intensity(second, laser) < packet.intensity(first, laser) {
                true => first,
                false => second,
            };
            self.azimuth[firing] = packet.azimuth(first);
            self.distance[firing] = packet.distance(block, laser);
        }
    }

    /// Duration of the packet \[ns\].
    pub(crate) fn period_ns(&self) -> i64 {
        i64::from(self.n_firings) * BLOCK_PERIOD_NS
    }

    /// Whether this packet is a duplicate of another.
    pub(crate) fn repeats(&self, other: &Self) -> bool {
        // A sensor that does not spin and whose clock stands still sends equal packets.
        let is_spinning = self.azimuth[0] != self.azimuth[usize::from(self.n_firings) - 1];
        self.device_us == other.device_us && self.azimuth == other.azimuth && is_spinning
    }
}

/// The packets in one piece of a log.
#[derive(Debug, Default)]
pub(crate) struct Packets {
    pub(crate) packets: Vec<RingPacket>,
    /// Lasers with a return in the sampled packets, one bit each.
    pub(crate) lasers_with_returns: u32,
    /// Number of packets of other Velodyne models, by model name.
    pub(crate) foreign: BTreeMap<&'static str, u64>,
    pub(crate) losses: Losses,
}

/// One packet in this many is sampled for lasers with returns. The number of packets per revolution
/// is not a multiple of it, so the samples cover the whole circle.
const SAMPLING_INTERVAL: usize = 7;

/// Maximum duration of the packets of one message \[ns\]. A message is a revolution, 0.05 to 0.2 s.
const MAX_MESSAGE_NS: i64 = 1_000_000_000;

impl Packets {
    /// Adds the packets of one message. Packets that do not have the HDL-32E layout are counted as
    /// losses.
    ///
    /// With `log_ns`, the log time of the message, the stamps do not matter: the last packet has the
    /// log time. The other packets keep their time before it, if the stamps show it.
    pub(crate) fn add(
        &mut self,
        source: Source,
        data: &[u8],
        laser: usize,
        log_ns: Option<u64>,
    ) -> messages::Result<()> {
        let scan = read_velodyne(source, data)?;
        self.packets.reserve(scan.len());
        let last_ns = scan.packets().last().map_or(0, |(stamp_ns, _)| stamp_ns);
        for (stamp_ns, bytes) in scan.packets() {
            let end_ns = log_ns.map_or(stamp_ns, |log_ns| {
                let before_ns = last_ns.saturating_sub(stamp_ns);
                let is_known = (0..=MAX_MESSAGE_NS).contains(&before_ns);
                Stamp::Log.select(0, log_ns) - if is_known { before_ns } else { 0 }
            });
            match Packet::new(bytes) {
                Ok(packet) => {
                    if self.packets.len().is_multiple_of(SAMPLING_INTERVAL) {
                        self.lasers_with_returns |= packet.returns_of();
                    }
                    self.packets.push(RingPacket::new(end_ns, &packet, laser));
                }
                Err(_) => {
                    if let Some(model) = hdl32e::foreign_layout(bytes) {
                        *self.foreign.entry(model).or_default() += 1;
                    }
                    self.losses.add(LossKind::MalformedPackets, 1);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use messages::hdl32e::{HOUR_US, LASERS, PACKET_PERIOD_NS, PRODUCT_HDL32E, PacketBuilder};
    use messages::ros::{self, Encoding};
    use messages::{MessageType, Source};

    const LASER: usize = hdl32e::HORIZONTAL_LASER;

    /// Packets of a sensor that spins by `step` \[0.01 deg\] per block, starting at `azimuth`. Each
    /// firing measures 5 m. The clock wraps at the top of the hour after the third packet.
    pub(crate) fn packets(n: usize, azimuth: u32, step: u32) -> Vec<RingPacket> {
        (0..n)
            .map(|k| RingPacket {
                end_ns: 1_000_000_000 + (k as i64 + 1) * PACKET_PERIOD_NS,
                device_us: ((u64::from(HOUR_US) - 1500 + 553 * k as u64) % u64::from(HOUR_US))
                    as u32,
                n_firings: BLOCKS as u8,
                product: PRODUCT_HDL32E,
                azimuth: std::array::from_fn(|b| {
                    ((azimuth + step * (k * BLOCKS + b) as u32) % 36_000) as u16
                }),
                distance: [2500; BLOCKS],
            })
            .collect()
    }

    #[test]
    fn dual_return_mode_keeps_the_stronger_return_in_either_order() {
        let mut builder = PacketBuilder::new(std::array::from_fn(|k| 100 * (k as u16 / 2)), 0);
        builder.set_return_mode(ReturnMode::Dual);
        builder.set_return(0, LASER, 111, 50); // last, weaker
        builder.set_return(1, LASER, 222, 60); // strongest
        builder.set_return(2, LASER, 333, 90); // strongest first
        builder.set_return(3, LASER, 444, 60);
        builder.set_return(4, LASER, 555, 70); // one return, sent twice
        builder.set_return(5, LASER, 555, 70);
        let bytes = builder.finish();
        let ring = RingPacket::new(0, &Packet::new(&bytes).unwrap(), LASER);
        assert_eq!(ring.n_firings, 6);
        assert_eq!(ring.period_ns(), 276_480);
        assert_eq!(ring.azimuth[..6], [0, 100, 200, 300, 400, 500]);
        assert_eq!(ring.distance[..4], [222, 333, 555, 0]);
    }

    #[test]
    fn packets_of_another_layout_are_counted_and_their_model_is_named() {
        let mut good = PacketBuilder::new([5; BLOCKS], 0);
        good.set_return(3, 11, 500, 9);
        let good = good.finish();
        let mut bad = good;
        bad[0] = 0;
        // An HDL-64E alternates between its upper and its lower block of lasers.
        let mut hdl64e = good;
        (1..BLOCKS).step_by(2).for_each(|block| hdl64e[block * 100 + 1] = 0xDD);
        let message =
            ros::write_velodyne_scan(Encoding::Cdr, "v", 0, &[(1, good), (2, bad), (3, hdl64e)]);
        let source = Source { message_type: MessageType::VelodyneScan, encoding: Encoding::Cdr };
        for laser in 0..LASERS {
            let mut found = Packets::default();
            found.add(source, &message, laser, None).unwrap();
            assert_eq!(found.packets.len(), 1);
            assert_eq!(found.packets[0].distance[3], if laser == 11 { 500 } else { 0 });
            assert_eq!((found.losses.total(), found.losses.count("malformed_packets")), (2, 2));
            assert_eq!(found.foreign.into_iter().collect::<Vec<_>>(), [("HDL-64E", 1)]);
            assert_eq!(found.lasers_with_returns, 1 << 11);
        }
    }

    /// Three packets with stamps 2 ns and 1 ns before the last, or with the stamp 0.
    #[test]
    fn with_log_times_the_last_packet_has_the_log_time() {
        let packet = PacketBuilder::new([5; BLOCKS], 0).finish();
        let source = Source { message_type: MessageType::VelodyneScan, encoding: Encoding::Cdr };
        for (stamps, expected) in [([7, 8, 9], [98, 99, 100]), ([0, 0, 0], [100, 100, 100])] {
            let packets = stamps.map(|stamp_ns| (stamp_ns, packet));
            let message = ros::write_velodyne_scan(Encoding::Cdr, "v", 0, &packets);
            let mut found = Packets::default();
            found.add(source, &message, 0, Some(100)).unwrap();
            let end_ns: Vec<i64> = found.packets.iter().map(|packet| packet.end_ns).collect();
            assert_eq!(end_ns, expected);
        }
    }
}
