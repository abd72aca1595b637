//! Identifies the Velodyne model, and selects the laser that makes the scan.

use std::collections::BTreeMap;

use messages::hdl32e::{BLOCKS, ELEVATION_DEG, HORIZONTAL_LASER, LASERS};

use crate::error::BeamNotFound;
use crate::options::LidarOptions;
use crate::scan::cloud::MAX_ELEVATION_ERROR_DEG;
use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::packet::RingPacket;

/// Number of packets used to identify the model.
const PACKETS_TO_IDENTIFY: usize = 200;
/// If a topic has no HDL-32E packet, this many packets of another layout identify another model. A
/// few can be corrupt packets.
const MIN_FOREIGN_PACKETS: u64 = 3;

/// A sensor that is not an HDL-32E.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OtherSensor {
    pub(crate) name: &'static str,
    /// What identifies it, for messages.
    pub(crate) evidence: String,
}

/// Collects what identifies the model of a sensor.
#[derive(Debug, Default)]
pub(crate) struct ModelEvidence {
    first_packets: Vec<RingPacket>,
    /// Number of packets of other layouts, by model name.
    foreign: BTreeMap<&'static str, u64>,
}

impl ModelEvidence {
    pub(crate) fn add_packet(&mut self, packet: &RingPacket) {
        if self.first_packets.len() < PACKETS_TO_IDENTIFY {
            self.first_packets.push(*packet);
        }
    }

    pub(crate) fn add_foreign(&mut self, foreign: BTreeMap<&'static str, u64>) {
        for (model, n) in foreign {
            *self.foreign.entry(model).or_default() += n;
        }
    }

    /// The sensor that sent the packets, if it is not an HDL-32E.
    pub(crate) fn other_sensor(&self) -> Option<OtherSensor> {
        match self.foreign.iter().max_by_key(|(_, n)| **n) {
            Some((&name, &n)) if self.first_packets.is_empty() && MIN_FOREIGN_PACKETS <= n => {
                Some(OtherSensor { name, evidence: "by the flags of its blocks".to_owned() })
            }
            _ => other_sensor(&self.first_packets),
        }
    }

    /// Whether the device clock stands still while the sensor spins.
    pub(crate) fn has_still_clock(&self) -> bool {
        let [first, .., last] = self.first_packets.as_slice() else { return false };
        self.first_packets.len() == PACKETS_TO_IDENTIFY
            && self.first_packets.iter().all(|packet| packet.device_us == first.device_us)
            && first.azimuth != last.azimuth
    }
}

/// Models: name, product byte, and packet period in single-return mode \[us\].
///
/// In a VLP-16, Puck Hi-Res or VLP-32C, a firing sequence takes 55.296 us. A packet of the 16-laser
/// models contains 24 of them, a packet of the VLP-32C 12 (manuals 63-9243 and 63-9325, "Firing
/// timing").
const MODELS: [(&str, u8, f64); 5] = [
    (HDL32E, 0x21, 552.96),
    ("VLP-16", 0x22, 1327.104),
    ("Puck Hi-Res", 0x24, 1327.104),
    ("VLP-32C", 0x28, 663.552),
    ("VLS-128", 0xA1, 159.9),
];

/// The supported sensor.
pub(crate) const HDL32E: &str = "HDL-32E";

/// Maximum relative difference between the measured packet period and that of a model.
const PERIOD_TOLERANCE: f64 = 0.05;

/// Identifies the model from packet period and product byte. `None` for an HDL-32E.
///
/// The period decides, because the product byte of an early VLP-16 says HDL-32E. The period is
/// measured by the device clock, or by the stamps if the device clock stands still. If the packets
/// are too few or too irregular, the product byte decides. An unknown product byte is taken as an
/// HDL-32E, because old firmware sends none.
pub(crate) fn other_sensor(packets: &[RingPacket]) -> Option<OtherSensor> {
    let first = packets.first()?;
    let returns = BLOCKS as f64 / f64::from(first.n_firings);
    let period_us = match median(packets, device_gap_us) {
        0.0 => median(packets, |a, b| b.end_ns.saturating_sub(a.end_ns) as f64 / 1000.0),
        device => device,
    } * returns;
    let by_period = MODELS
        .iter()
        .find(|(_, _, model_us)| (period_us / model_us - 1.0).abs() < PERIOD_TOLERANCE);
    let (name, evidence) = match by_period {
        Some((name, _, _)) => (*name, format!("a packet every {period_us:.0} us")),
        None => {
            let (name, byte, _) = MODELS.iter().find(|(_, byte, _)| *byte == first.product)?;
            (*name, format!("product byte {byte:#04x}"))
        }
    };
    (name != HDL32E).then_some(OtherSensor { name, evidence })
}

/// Median gap between successive packets \[us\].
fn median(packets: &[RingPacket], gap_us: impl Fn(&RingPacket, &RingPacket) -> f64) -> f64 {
    let mut gaps: Vec<f64> = packets.windows(2).map(|pair| gap_us(&pair[0], &pair[1])).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
}

/// The laser of an HDL-32E that makes the scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Laser {
    /// Index in firing order, 0 to 31.
    pub(crate) index: usize,
    /// Elevation of the beam \[deg\].
    pub(crate) elevation_deg: f64,
}

impl Laser {
    pub(crate) const HORIZONTAL: Self = Self { index: HORIZONTAL_LASER, elevation_deg: 0.0 };

    pub(crate) fn new(index: usize) -> Self {
        match index {
            // The table contains a rounded value.
            HORIZONTAL_LASER => Self::HORIZONTAL,
            _ => Self { index, elevation_deg: ELEVATION_DEG[index] },
        }
    }

    /// The laser of a ring. Ring 0 is the lowest beam.
    pub(crate) fn of_ring(ring: usize) -> Self {
        let mut by_elevation: [usize; LASERS] = std::array::from_fn(|laser| laser);
        by_elevation.sort_by(|&a, &b| ELEVATION_DEG[a].total_cmp(&ELEVATION_DEG[b]));
        Self::new(by_elevation[ring])
    }

    /// The laser that the options select.
    pub(crate) fn choose(options: &LidarOptions) -> Result<Self, BeamNotFound> {
        let not_found = |requested: String| {
            let from_below =
                (0..LASERS).map(|ring| format!("{:.2}", Self::of_ring(ring).elevation_deg));
            let elevations = from_below.collect::<Vec<_>>().join(", ");
            BeamNotFound { requested, available: format!("rings 0 to 31 at {elevations} deg") }
        };
        match (options.laser, options.ring, options.elevation_deg) {
            (Some(laser), _, _) => Ok(Self::new(laser as usize)),
            (_, Some(ring), _) if ring as usize >= LASERS => Err(not_found(format!("ring {ring}"))),
            (_, Some(ring), _) => Ok(Self::of_ring(ring as usize)),
            (_, _, Some(deg)) => {
                let nearest = Self::nearest(deg);
                match (nearest.elevation_deg - deg).abs() <= MAX_ELEVATION_ERROR_DEG {
                    true => Ok(nearest),
                    false => Err(not_found(format!("beam at {deg} deg"))),
                }
            }
            _ => Ok(Self::HORIZONTAL),
        }
    }

    /// The laser with the nearest elevation.
    fn nearest(elevation_deg: f64) -> Self {
        let distance = |laser: &usize| (ELEVATION_DEG[*laser] - elevation_deg).abs();
        (0..LASERS)
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .map_or(Self::HORIZONTAL, Self::new)
    }
}

/// Formats a bit mask of lasers as "0-13, 17".
pub(crate) fn format_lasers(mask: u32) -> String {
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
    fn the_period_identifies_the_model_and_else_the_product_byte_does() {
        assert_eq!(other_sensor(&packets(553, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&packets(553, 0)), None, "old firmware");
        let wrong_byte = other_sensor(&packets(1327, PRODUCT_HDL32E)).unwrap();
        assert_eq!(wrong_byte.name, "VLP-16");
        assert_eq!(wrong_byte.evidence, "a packet every 1327 us");
        assert_eq!(other_sensor(&packets(0, 0x28)).unwrap().name, "VLP-32C");
        assert_eq!(other_sensor(&packets(0, PRODUCT_HDL32E)), None);
        assert_eq!(other_sensor(&[]), None);
    }

    #[test]
    fn masks_are_formatted_as_ranges() {
        assert_eq!(format_lasers(0b1011_0001), "0, 4-5, 7");
        assert_eq!(format_lasers(!0), "0-31");
        assert_eq!(format_lasers(0), "");
    }

    #[test]
    fn the_stamps_give_the_period_if_the_device_clock_stands_still() {
        let mut packets = packets(0, PRODUCT_HDL32E);
        for (k, packet) in packets.iter_mut().enumerate() {
            packet.end_ns = 1_000_000_000 + k as i64 * 1_327_104;
        }
        assert_eq!(other_sensor(&packets).unwrap().name, "VLP-16");
    }

    /// Rings 0, 16 and 23 are at -30.67, -9.33 and 0.00 deg (table in the manual).
    #[test]
    fn a_laser_is_selected_by_ring_or_elevation() {
        assert_eq!(Laser::of_ring(23), Laser::new(15));
        assert_eq!((Laser::of_ring(0).index, Laser::of_ring(31).index), (0, 31));
        assert_eq!(Laser::of_ring(16).index, 1);
        assert_eq!(Laser::nearest(0.3), Laser::new(15));
        assert_eq!(Laser::nearest(-90.0).index, 0);
        assert!((Laser::nearest(-9.0).elevation_deg + 28.0 / 3.0).abs() < 1e-9);
    }
}
