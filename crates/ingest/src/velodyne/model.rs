//! Which Velodyne the packets are of, told by their period; which laser makes the scan.

use messages::hdl32e::{BLOCKS, ELEVATION_DEG, HORIZONTAL_LASER, LASERS};

use crate::options::LidarOptions;
use crate::scan::cloud::MAX_ELEVATION_ERROR_DEG;
use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;

/// Packets looked at to tell the sensor model.
pub(crate) const PACKETS_TO_IDENTIFY: usize = 200;

/// A sensor that is no HDL-32E.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OtherSensor {
    pub(crate) name: &'static str,
    pub(crate) evidence: String,
}

/// Models: name, product byte, and packet period in single-return mode \[us\]
/// (VLP-16, Puck Hi-Res and VLP-32C: one firing sequence takes 55.296 us; a packet of the 16-laser
/// models holds 24 of them, one of the VLP-32C 12. Manuals 63-9243 and 63-9325, "Firing timing").
const MODELS: [(&str, u8, f64); 5] = [
    (HDL32E, 0x21, 552.96),
    ("VLP-16", 0x22, 1327.104),
    ("Puck Hi-Res", 0x24, 1327.104),
    ("VLP-32C", 0x28, 663.552),
    ("VLS-128", 0xA1, 159.9),
];

/// The sensor whose packets are read.
pub(crate) const HDL32E: &str = "HDL-32E";

/// How far a measured packet period may lie from a model's.
const PERIOD_TOLERANCE: f64 = 0.05;

/// Tells from packet period and product byte which model packets are of.
///
/// The period decides: the product byte of an early VLP-16 says HDL-32E. It is measured by the
/// device clock, or where that stands still by the host's stamps. Packets too few or too irregular
/// to tell leave the product byte alone to speak; a byte that no model has (old firmware sends
/// none) is believed to be an HDL-32E's.
pub(crate) fn other_sensor(packets: &[RingPacket]) -> Option<OtherSensor> {
    let first = packets.first()?;
    let returns = BLOCKS as f64 / f64::from(first.n_firings);
    let period_us = match median(packets, device_gap_us) {
        0.0 => median(packets, |a, b| b.end_ns.saturating_sub(a.end_ns) as f64 / 1000.0),
        device => device,
    } * returns;
    let of_period = MODELS
        .iter()
        .find(|(_, _, model_us)| (period_us / model_us - 1.0).abs() < PERIOD_TOLERANCE);
    let (name, evidence) = match of_period {
        Some((name, _, _)) => (*name, format!("a packet every {period_us:.0} us")),
        None => {
            let (name, byte, _) = MODELS.iter().find(|(_, byte, _)| *byte == first.product)?;
            (*name, format!("product byte {byte:#04x}"))
        }
    };
    (name != HDL32E).then_some(OtherSensor { name, evidence })
}

fn median(packets: &[RingPacket], gap_us: impl Fn(&RingPacket, &RingPacket) -> f64) -> f64 {
    let mut gaps: Vec<f64> = packets.windows(2).map(|pair| gap_us(&pair[0], &pair[1])).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}

/// The laser of an HDL-32E whose beams make the scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Laser {
    /// In firing order, 0 to 31.
    pub(crate) index: usize,
    /// Elevation of the beam \[deg\].
    pub(crate) elevation_deg: f64,
}

impl Laser {
    pub(crate) const HORIZONTAL: Self = Self { index: HORIZONTAL_LASER, elevation_deg: 0.0 };

    pub(crate) fn new(index: usize) -> Self {
        match index {
            // The table's value is rounded.
            HORIZONTAL_LASER => Self::HORIZONTAL,
            _ => Self { index, elevation_deg: ELEVATION_DEG[index] },
        }
    }

    /// The laser of a ring: rings are counted from the lowest beam up.
    pub(crate) fn of_ring(ring: usize) -> Self {
        let mut by_elevation: [usize; LASERS] = std::array::from_fn(|laser| laser);
        by_elevation.sort_by(|&a, &b| ELEVATION_DEG[a].total_cmp(&ELEVATION_DEG[b]));
        Self::new(by_elevation[ring])
    }

    /// The laser that the options ask for; the error says what was asked for and what there is.
    pub(crate) fn choose(options: &LidarOptions) -> Result<Self, (String, String)> {
        let beams = || {
            let lowest_up =
                (0..LASERS).map(|ring| format!("{:.2}", Self::of_ring(ring).elevation_deg));
            format!("rings 0 to 31 at {} deg", lowest_up.collect::<Vec<_>>().join(", "))
        };
        match (options.laser, options.ring, options.elevation_deg) {
            (Some(laser), _, _) => Ok(Self::new(laser as usize)),
            (_, Some(ring), _) if ring as usize >= LASERS => Err((format!("ring {ring}"), beams())),
            (_, Some(ring), _) => Ok(Self::of_ring(ring as usize)),
            (_, _, Some(deg)) => {
                let nearest = Self::nearest(deg);
                match (nearest.elevation_deg - deg).abs() <= MAX_ELEVATION_ERROR_DEG {
                    true => Ok(nearest),
                    false => Err((format!("a beam at {deg} deg"), beams())),
                }
            }
            _ => Ok(Self::HORIZONTAL),
        }
    }

    /// The laser nearest to an elevation.
    fn nearest(elevation_deg: f64) -> Self {
        let distance = |laser: &usize| (ELEVATION_DEG[*laser] - elevation_deg).abs();
        (0..LASERS)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .map_or(Self::HORIZONTAL, Self::new)
    }
}

/// Lasers of a mask, one bit each, as "0-13, 17".
pub(crate) fn lasers(mask: u32) -> String {
    let is_set = |laser: usize| mask & (1 << laser) != 0;
    let set: Vec<usize> = (0..LASERS).filter(|&laser| is_set(laser)).collect();
    let runs = set.chunk_by(|a, b| a + 1 == *b).map(|run| match run {
        [first, .., last] => format!("{first}-{last}"),
        [one] => one.to_string(),
        [] => String::new(),
    });
    runs.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::hdl32e::{HOUR_US, PRODUCT_HDL32E};

    fn packets(period_us: u32, product: u8) -> Vec<RingPacket> {
        let mut packets = crate::velodyne::packet::tests::packets(10, 0, 20);
        for (k, packet) in packets.iter_mut().enumerate() {
            let past_hour = u64::from(HOUR_US) - 1000 + k as u64 * u64::from(period_us);
            packet.device_us = (past_hour % u64::from(HOUR_US)) as u32;
            packet.end_ns = 0;
            packet.product = product;
        }
        packets
    }

    #[test]
    fn the_period_tells_the_sensor_and_the_product_byte_only_where_it_does_not() {
        assert_eq!(other_sensor(&packets(553, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&packets(553, 0)), None, "old firmware");
        let lying = other_sensor(&packets(1327, PRODUCT_HDL32E)).unwrap();
        assert_eq!(lying.name, "VLP-16");
        assert_eq!(lying.evidence, "a packet every 1327 us");
        assert_eq!(other_sensor(&packets(0, 0x28)).unwrap().name, "VLP-32C");
        assert_eq!(other_sensor(&packets(0, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&[]), None);
    }

    #[test]
    fn masks_are_listed_as_runs() {
        assert_eq!(lasers(0b1011_0001), "0, 4-5, 7");
        assert_eq!(lasers(!0), "0-31");
        assert_eq!(lasers(0), "");
    }

    #[test]
    fn stamps_tell_the_period_where_the_device_clock_stands_still() {
        let mut packets = packets(0, PRODUCT_HDL32E);
        for (k, packet) in packets.iter_mut().enumerate() {
            packet.end_ns = 1_000_000_000 + k as i64 * 1_327_104;
        }
        assert_eq!(other_sensor(&packets).unwrap().name, "VLP-16");
    }

    /// Rings 0, 16 and 23 of the manual's table: -30.67, -9.33 and 0.00 deg.
    #[test]
    fn lasers_by_ring_and_by_elevation() {
        assert_eq!(Laser::of_ring(23), Laser::new(15));
        assert_eq!((Laser::of_ring(0).index, Laser::of_ring(31).index), (0, 31));
        assert_eq!(Laser::of_ring(16).index, 1);
        assert_eq!(Laser::nearest(0.3), Laser::new(15));
        assert_eq!(Laser::nearest(-90.0).index, 0);
        assert!((Laser::nearest(-9.0).elevation_deg + 28.0 / 3.0).abs() < 1e-9);
    }
}
