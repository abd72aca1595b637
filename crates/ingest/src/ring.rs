//! `VelodyneScan` messages -> the firings of one laser, packet by packet.

use dataset::Dropped;
use messages::hdl32e::{BLOCK_PERIOD_NS, BLOCKS, HORIZONTAL_LASER, HOUR_US, Packet, ReturnMode};
use messages::ros::{Encoding, VelodyneScan};

/// The laser that makes the scan, in firing order.
pub(crate) const LASER: usize = HORIZONTAL_LASER;

/// What one packet tells of one laser.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct RingPacket {
    /// The packet's stamp: when its last firing ended \[ns\].
    pub(crate) end_ns: i64,
    /// Device clock, microseconds past the hour.
    pub(crate) device_us: u32,
    /// Firings in the packet: 12, or 6 in dual-return mode.
    pub(crate) n_firings: u8,
    /// The product byte.
    pub(crate) product: u8,
    /// Azimuth of each firing's block \[0.01 deg, clockwise\].
    pub(crate) azimuth: [u16; BLOCKS],
    /// Distance measured by the laser \[2 mm\], 0 for none.
    pub(crate) distance: [u16; BLOCKS],
}

impl RingPacket {
    pub(crate) fn new(end_ns: i64, packet: &Packet<'_>) -> Self {
        let mut ring = Self {
            end_ns,
            device_us: packet.device_time_us(),
            n_firings: BLOCKS as u8,
            product: packet.product(),
            azimuth: std::array::from_fn(|block| packet.azimuth(block)),
            distance: std::array::from_fn(|block| packet.distance(block, LASER)),
        };
        if packet.return_mode() == Some(ReturnMode::Dual) {
            ring.take_the_stronger_of_two(packet);
        }
        ring
    }

    /// In dual-return mode two blocks of one azimuth belong to one firing; the stronger return of
    /// the two makes the scan, whichever of them comes first.
    fn take_the_stronger_of_two(&mut self, packet: &Packet<'_>) {
        self.n_firings = (BLOCKS / 2) as u8;
        for firing in 0..BLOCKS / 2 {
            let (first, second) = (2 * firing, 2 * firing + 1);
            let block = match packet.intensity(second, LASER) < packet.intensity(first, LASER) {
                true => first,
                false => second,
            };
            self.azimuth[firing] = packet.azimuth(first);
            self.distance[firing] = packet.distance(block, LASER);
        }
    }

    /// Time that the packet's firings take \[ns\].
    pub(crate) fn period_ns(&self) -> i64 {
        i64::from(self.n_firings) * BLOCK_PERIOD_NS
    }
}

/// Adds the packets of one message; a packet that is none of an HDL-32E's is counted.
pub(crate) fn extract(
    encoding: Encoding,
    data: &[u8],
    packets: &mut Vec<RingPacket>,
    dropped: &mut Dropped,
) -> messages::Result<()> {
    let scan = VelodyneScan::read(encoding, data)?;
    packets.reserve(scan.len());
    for (end_ns, bytes) in scan.packets() {
        match Packet::new(bytes) {
            Ok(packet) => packets.push(RingPacket::new(end_ns, &packet)),
            Err(_) => dropped.add("packets without the layout of an HDL-32E data packet", 1),
        }
    }
    Ok(())
}

/// A sensor that is no HDL-32E.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OtherSensor {
    pub(crate) name: &'static str,
    pub(crate) evidence: String,
}

/// Velodyne models: name, product byte, and packet period in single-return mode \[us\]
/// (VLP-16, Puck Hi-Res and VLP-32C: one firing sequence takes 55.296 us; a packet of the 16-laser
/// models holds 24 of them, one of the VLP-32C 12. Manuals 63-9243 and 63-9325, "Firing timing").
const MODELS: [(&str, u8, f64); 5] = [
    ("Velodyne HDL-32E", 0x21, 552.96),
    ("Velodyne VLP-16", 0x22, 1327.104),
    ("Velodyne Puck Hi-Res", 0x24, 1327.104),
    ("Velodyne VLP-32C", 0x28, 663.552),
    ("Velodyne VLS-128", 0xA1, 159.9),
];

/// How far a measured packet period may lie from a model's.
const PERIOD_TOLERANCE: f64 = 0.05;

/// Tells from product byte and packet period whether packets are another model's.
///
/// The period decides: the product byte of an early VLP-16 says HDL-32E. A device clock that
/// stands still, or packets too few to tell, leave the product byte alone to speak; a byte that no
/// model has (old firmware sends none) is believed to be an HDL-32E's.
pub(crate) fn other_sensor(packets: &[RingPacket]) -> Option<OtherSensor> {
    let first = packets.first()?;
    let returns = BLOCKS as f64 / f64::from(first.n_firings);
    let mut gaps_us: Vec<f64> =
        packets.windows(2).map(|pair| device_gap_us(&pair[0], &pair[1])).collect();
    gaps_us.sort_by(f64::total_cmp);
    let measured_us = gaps_us.get(gaps_us.len() / 2).copied().unwrap_or(0.0) * returns;
    let model_of_period = MODELS
        .iter()
        .find(|(_, _, period_us)| (measured_us / period_us - 1.0).abs() < PERIOD_TOLERANCE);
    let (name, evidence) = match model_of_period {
        Some((name, _, _)) => (*name, format!("a packet every {measured_us:.0} us")),
        None => {
            let (name, byte, _) = MODELS.iter().find(|(_, byte, _)| *byte == first.product)?;
            (*name, format!("product byte {byte:#04x}"))
        }
    };
    (name != MODELS[0].0).then_some(OtherSensor { name, evidence })
}

/// Device time from one packet to another \[us\], negative where the other was earlier. The clock
/// starts again at the top of the hour: of the two ways around, the shorter.
pub(crate) fn device_gap_us(from: &RingPacket, to: &RingPacket) -> f64 {
    let hour = f64::from(HOUR_US);
    let gap = f64::from(to.device_us) - f64::from(from.device_us);
    if gap < -hour / 2.0 {
        gap + hour
    } else if hour / 2.0 < gap {
        gap - hour
    } else {
        gap
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{PRODUCT_HDL32E, PacketBuilder};

    fn packets(period_us: u32, product: u8) -> Vec<RingPacket> {
        let bytes = PacketBuilder::new([0; BLOCKS], 0).finish();
        let packet = RingPacket::new(0, &Packet::new(&bytes).unwrap());
        (0..10)
            .map(|k| {
                let mut packet = packet;
                packet.device_us = ((u64::from(HOUR_US) - 1000 + k * u64::from(period_us))
                    % u64::from(HOUR_US)) as u32;
                packet.product = product;
                packet
            })
            .collect()
    }

    #[test]
    fn the_period_tells_the_sensor_and_the_product_byte_only_where_it_does_not() {
        assert_eq!(other_sensor(&packets(553, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&packets(553, 0)), None, "old firmware");
        let lying = other_sensor(&packets(1327, PRODUCT_HDL32E)).unwrap();
        assert_eq!(lying.name, "Velodyne VLP-16");
        assert_eq!(lying.evidence, "a packet every 1327 us");
        assert_eq!(other_sensor(&packets(0, 0x28)).unwrap().name, "Velodyne VLP-32C");
        assert_eq!(other_sensor(&packets(0, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&[]), None);
    }

    #[test]
    fn the_stronger_of_two_returns_makes_the_scan_in_either_order() {
        let mut builder = PacketBuilder::new(std::array::from_fn(|k| 100 * (k as u16 / 2)), 0);
        builder.set_return_mode(ReturnMode::Dual);
        builder.set_return(0, LASER, 111, 50); // last, weaker
        builder.set_return(1, LASER, 222, 60); // strongest
        builder.set_return(2, LASER, 333, 90); // strongest first
        builder.set_return(3, LASER, 444, 60);
        builder.set_return(4, LASER, 555, 70); // one return, sent twice
        builder.set_return(5, LASER, 555, 70);
        let bytes = builder.finish();
        let ring = RingPacket::new(0, &Packet::new(&bytes).unwrap());
        assert_eq!(ring.n_firings, 6);
        assert_eq!(ring.period_ns(), 276_480);
        assert_eq!(ring.azimuth[..6], [0, 100, 200, 300, 400, 500]);
        assert_eq!(ring.distance[..4], [222, 333, 555, 0]);
    }

    #[test]
    fn packets_of_another_layout_are_counted() {
        let good = PacketBuilder::new([5; BLOCKS], 0).finish();
        let mut bad = good;
        bad[0] = 0;
        let message =
            messages::ros::write_velodyne_scan(Encoding::Cdr, "v", 0, &[(1, good), (2, bad)]);
        let (mut packets, mut dropped) = (Vec::new(), Dropped::default());
        extract(Encoding::Cdr, &message, &mut packets, &mut dropped).unwrap();
        assert_eq!(packets.len(), 1);
        assert_eq!(dropped.iter().map(|(_, n)| n).collect::<Vec<_>>(), [1]);
    }
}
