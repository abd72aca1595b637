//! The data packet of the Velodyne HDL-32E.
//!
//! Source: HDL-32E User's Manual 63-9113 Rev. K, "Data Packet Format" and appendix "Firing
//! sequence timing". All fields are little endian.
//!
//! ```text
//! 12 blocks x 100 bytes:  flag 0xEEFF u16 | azimuth u16 [0.01 deg, clockwise] | 32 x (distance u16 [2 mm], intensity u8)
//! then 6 bytes:           time u32 [us past the hour] | return mode u8 | product u8
//! ```

use crate::{MessageError, Result};

/// Length of a data packet (UDP payload) \[bytes\].
pub const PACKET_BYTES: usize = 1206;
/// Number of blocks in a packet. A block is one firing of all lasers.
pub const BLOCKS: usize = 12;
/// Number of lasers in a block.
pub const LASERS: usize = 32;
/// The laser with the horizontal beam (0.00 deg), in firing order. Sorted by elevation it is ring 23.
pub const HORIZONTAL_LASER: usize = 15;
/// Length of a block \[bytes\].
const BLOCK_BYTES: usize = 100;
/// The first two bytes of every block.
pub const BLOCK_FLAG: u16 = 0xEEFF;
/// Length of a position packet, which the sensor sends to port 8308 (manual, "Position packet")
/// \[bytes\].
pub const POSITION_PACKET_BYTES: usize = 512;
/// One count of a distance \[m\].
pub const METRES_PER_COUNT: f64 = 0.002;
/// Counts of azimuth in a full revolution. One count is 0.01 deg.
pub const AZIMUTH_COUNTS: u16 = 36_000;
/// Time between two lasers of a block \[ns\].
pub const LASER_PERIOD_NS: i64 = 1_152;
/// Time between two blocks: 32 laser firings and 8 periods of recharge \[ns\].
pub const BLOCK_PERIOD_NS: i64 = 46_080;
/// Time between the start and the end of a packet \[ns\]. The stamp of a packet is its end.
pub const PACKET_PERIOD_NS: i64 = BLOCK_PERIOD_NS * BLOCKS as i64;
/// Laser periods in a block period. Laser `k` fires after the share `k / 40` of the azimuth step.
pub const PERIODS_PER_BLOCK: i64 = BLOCK_PERIOD_NS / LASER_PERIOD_NS;
/// Microseconds in an hour. The device clock wraps at this value.
pub const HOUR_US: u32 = 3_600_000_000;
/// Product byte of an HDL-32E. Early VLP-16 sensors send the same byte.
pub const PRODUCT_HDL32E: u8 = 0x21;

/// Elevation of each laser in firing order \[deg\]. The elevations are -30.67 to +10.67 in steps of
/// 4/3, and the lower half is interleaved with the upper half (manual, "Laser angles").
pub const ELEVATION_DEG: [f64; LASERS] = {
    let mut deg = [0.0; LASERS];
    let mut k = 0;
    while k < LASERS {
        let ring = if k % 2 == 0 { k / 2 } else { 16 + k / 2 };
        deg[k] = -92.0 / 3.0 + ring as f64 * 4.0 / 3.0;
        k += 1;
    }
    deg
};

/// The return-mode byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReturnMode {
    /// 0x37: the strongest return of each firing.
    Strongest,
    /// 0x38: the last return.
    Last,
    /// 0x39: blocks come in pairs with the same azimuth. The first block of a pair contains the last
    /// return, the second the strongest.
    Dual,
}

impl ReturnMode {
    /// The byte in the packet.
    pub fn byte(self) -> u8 {
        match self {
            Self::Strongest => 0x37,
            Self::Last => 0x38,
            Self::Dual => 0x39,
        }
    }

    fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            0x37 => Some(Self::Strongest),
            0x38 => Some(Self::Last),
            0x39 => Some(Self::Dual),
            _ => None,
        }
    }
}

/// One data packet, borrowed from the bytes of a message.
#[derive(Debug, Clone, Copy)]
pub struct Packet<'a> {
    bytes: &'a [u8; PACKET_BYTES],
}

impl<'a> Packet<'a> {
    /// Checks the length, the block flags and the azimuths. No later access can fail.
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let packet = Self {
            bytes: bytes
                .try_into()
                .map_err(|_| MessageError::PacketLength { found: bytes.len() })?,
        };
        for block in 0..BLOCKS {
            let found = packet.u16_at(block * BLOCK_BYTES);
            if found != BLOCK_FLAG {
                return Err(MessageError::BlockFlag { block, found });
            }
            let found = packet.azimuth(block);
            if AZIMUTH_COUNTS <= found {
                return Err(MessageError::Azimuth { block, found });
            }
        }
        Ok(packet)
    }

    /// Azimuth of the first firing of a block, clockwise \[0.01 deg\].
    #[inline]
    pub fn azimuth(&self, block: usize) -> u16 {
        self.u16_at(block * BLOCK_BYTES + 2)
    }

    /// Distance of one return \[2 mm\]; 0 means no return.
    #[inline]
    pub fn distance(&self, block: usize, laser: usize) -> u16 {
        self.u16_at(block * BLOCK_BYTES + 4 + laser * 3)
    }

    /// Intensity of one return, 0 to 255.
    #[inline]
    pub fn intensity(&self, block: usize, laser: usize) -> u8 {
        self.bytes[block * BLOCK_BYTES + 4 + laser * 3 + 2]
    }

    /// The lasers with a return in any block: bit `k` is laser `k`.
    pub fn returns_of(&self) -> u32 {
        // The bitwise OR of all blocks. The distance of a laser is 0 if it is 0 in every block.
        let mut any = [0u8; 3 * LASERS];
        for block in self.bytes.as_chunks::<BLOCK_BYTES>().0 {
            for (any, byte) in any.iter_mut().zip(&block[4..]) {
                *any |= byte;
            }
        }
        let (lasers, _) = any.as_chunks::<3>();
        let bits = lasers
            .iter()
            .enumerate()
            .map(|(laser, [low, high, _intensity])| u32::from(low | high != 0) << laser);
        bits.sum()
    }

    /// The device clock: time past the hour \[us\].
    #[inline]
    pub fn device_time_us(&self) -> u32 {
        let b = self.bytes;
        u32::from_le_bytes([b[1200], b[1201], b[1202], b[1203]])
    }

    /// The return mode; `None` if the byte is unknown (older firmware).
    pub fn return_mode(&self) -> Option<ReturnMode> {
        ReturnMode::from_byte(self.bytes[1204])
    }

    /// The product byte. It can be wrong (see [`PRODUCT_HDL32E`]).
    pub fn product(&self) -> u8 {
        self.bytes[1205]
    }

    #[inline]
    fn u16_at(&self, offset: usize) -> u16 {
        u16::from_le_bytes([self.bytes[offset], self.bytes[offset + 1]])
    }
}

/// The name of another Velodyne model, if a packet of 1206 bytes has the block flags of that model.
/// `None` for the layout of the HDL-32E, which the VLP-16 and the VLP-32C share, and for bytes that
/// are not a packet.
///
/// Sources: HDL-64E S3 User's Manual 63-HDL64ES3, appendix "Data packet format": the lasers 0 to 31
/// are in blocks with the flag 0xEEFF, the lasers 32 to 63 in blocks with 0xDDFF. VLS-128 User Manual,
/// chapter 9 "Sensor data": a firing of 128 lasers has four blocks. Their flags 0xEEFF, 0xDDFF, 0xCCFF
/// and 0xBBFF, and the empty blocks in dual-return mode, are taken from `tier4/nebula`,
/// `nebula_decoders_velodyne`.
pub fn foreign_layout(bytes: &[u8]) -> Option<&'static str> {
    let packet: &[u8; PACKET_BYTES] = bytes.try_into().ok()?;
    let mut model = None;
    for block in packet.as_chunks::<BLOCK_BYTES>().0 {
        match u16::from_le_bytes([block[0], block[1]]) {
            BLOCK_FLAG | 0 => {}
            0xDDFF => model = model.or(Some("HDL-64E")),
            0xCCFF | 0xBBFF => model = Some("VLS-128 (Alpha Prime)"),
            _ => return None,
        }
    }
    model
}

/// Whether the bytes have the length of a position packet. A position packet contains GPS time and the
/// gyroscopes of the sensor, but no distances. Drivers that record both ports mix them with data
/// packets.
pub fn is_position_packet(bytes: &[u8]) -> bool {
    bytes.len() == POSITION_PACKET_BYTES
}

/// Builds a packet. It starts without returns and in the strongest-return mode.
#[derive(Debug, Clone)]
pub struct PacketBuilder {
    bytes: [u8; PACKET_BYTES],
}

impl PacketBuilder {
    /// Starts a packet without returns. `azimuths` are the azimuths of the blocks \[0.01 deg\].
    pub fn new(azimuths: [u16; BLOCKS], device_time_us: u32) -> Self {
        let mut bytes = [0; PACKET_BYTES];
        for (block, azimuth) in azimuths.iter().enumerate() {
            bytes[block * BLOCK_BYTES..][..2].copy_from_slice(&BLOCK_FLAG.to_le_bytes());
            bytes[block * BLOCK_BYTES + 2..][..2].copy_from_slice(&azimuth.to_le_bytes());
        }
        bytes[1200..1204].copy_from_slice(&device_time_us.to_le_bytes());
        bytes[1204] = ReturnMode::Strongest.byte();
        bytes[1205] = PRODUCT_HDL32E;
        Self { bytes }
    }

    /// Sets the distance \[2 mm\] and the intensity of one return.
    pub fn set_return(&mut self, block: usize, laser: usize, distance: u16, intensity: u8) {
        let at = block * BLOCK_BYTES + 4 + laser * 3;
        self.bytes[at..at + 2].copy_from_slice(&distance.to_le_bytes());
        self.bytes[at + 2] = intensity;
    }

    /// Sets the return-mode byte.
    pub fn set_return_mode(&mut self, mode: ReturnMode) {
        self.bytes[1204] = mode.byte();
    }

    /// Sets the product byte.
    pub fn set_product(&mut self, product: u8) {
        self.bytes[1205] = product;
    }

    /// The bytes of the packet.
    pub fn finish(self) -> [u8; PACKET_BYTES] {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laser_15_is_horizontal_and_is_ring_23() {
        assert!(ELEVATION_DEG[HORIZONTAL_LASER].abs() < 1e-12);
        let below = ELEVATION_DEG.iter().filter(|&&deg| deg < -1e-9).count();
        assert_eq!(below, 23);
        // The first three lasers in the table of the manual: -30.67, -9.33, -29.33.
        assert!((ELEVATION_DEG[0] + 30.667).abs() < 1e-3);
        assert!((ELEVATION_DEG[1] + 9.333).abs() < 1e-3);
        assert!((ELEVATION_DEG[2] + 29.333).abs() < 1e-3);
    }

    #[test]
    fn a_packet_takes_552_960_ns() {
        assert_eq!(PACKET_PERIOD_NS, 552_960);
        assert_eq!(PERIODS_PER_BLOCK, 40);
    }

    #[test]
    fn a_packet_reads_as_written() {
        let azimuths = std::array::from_fn(|k| (35_990 + 17 * k as u16) % AZIMUTH_COUNTS);
        let mut builder = PacketBuilder::new(azimuths, 3_599_999_999);
        builder.set_return(11, 31, 0xABCD, 7);
        builder.set_return(0, 15, 500, 200);
        builder.set_return_mode(ReturnMode::Dual);
        builder.set_product(0x22);
        let bytes = builder.finish();
        let packet = Packet::new(&bytes).unwrap();
        assert_eq!(std::array::from_fn(|k| packet.azimuth(k)), azimuths);
        assert_eq!(packet.distance(11, 31), 0xABCD);
        assert_eq!(packet.intensity(11, 31), 7);
        assert_eq!(packet.distance(0, 15), 500);
        assert_eq!(packet.distance(0, 14), 0);
        assert_eq!(packet.device_time_us(), 3_599_999_999);
        assert_eq!(packet.return_mode(), Some(ReturnMode::Dual));
        assert_eq!(packet.product(), 0x22);
        let untouched = PacketBuilder::new(azimuths, 0).finish();
        assert_eq!(Packet::new(&untouched).unwrap().product(), PRODUCT_HDL32E);
    }

    #[test]
    fn returns_of_reports_lasers_with_a_return_in_any_block() {
        let mut builder = PacketBuilder::new([0; BLOCKS], 0);
        assert_eq!(Packet::new(&builder.clone().finish()).unwrap().returns_of(), 0);
        builder.set_return(0, 0, 1, 0);
        builder.set_return(11, 31, 0x0100, 0);
        builder.set_return(3, 15, 500, 9);
        builder.set_return(4, 15, 500, 9);
        builder.set_return(5, 7, 0, 255); // an intensity without a distance is not a return
        let bytes = builder.finish();
        assert_eq!(Packet::new(&bytes).unwrap().returns_of(), 1 << 31 | 1 << 15 | 1);
    }

    #[test]
    fn block_flags_identify_other_models() {
        let with_flags = |flags: &[u16]| {
            let mut bytes = PacketBuilder::new([0; BLOCKS], 0).finish();
            for (block, flag) in flags.iter().cycle().take(BLOCKS).enumerate() {
                bytes[block * BLOCK_BYTES..][..2].copy_from_slice(&flag.to_le_bytes());
            }
            foreign_layout(&bytes)
        };
        assert_eq!(with_flags(&[0xEEFF]), None);
        assert_eq!(with_flags(&[0xEEFF, 0xDDFF]), Some("HDL-64E"));
        let vls128 = Some("VLS-128 (Alpha Prime)");
        assert_eq!(with_flags(&[0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF]), vls128);
        assert_eq!(with_flags(&[0xBBFF, 0xDDFF, 0, 0]), vls128);
        assert_eq!(with_flags(&[0xEEFF, 0xDDFF, 0xAAFF]), None);
        assert_eq!(foreign_layout(&[0xFF; 512]), None);
        assert!(is_position_packet(&[0; 512]) && !is_position_packet(&[0; PACKET_BYTES]));
    }

    #[test]
    fn bytes_that_are_not_a_packet_are_errors() {
        let good = PacketBuilder::new([0; BLOCKS], 0).finish();
        assert_eq!(
            Packet::new(&good[..512]).unwrap_err(),
            MessageError::PacketLength { found: 512 }
        );
        let mut bad = good;
        bad[301] = 0xDD;
        assert_eq!(
            Packet::new(&bad).unwrap_err(),
            MessageError::BlockFlag { block: 3, found: 0xDDFF }
        );
        let mut bad = good;
        bad[102..104].copy_from_slice(&36_000u16.to_le_bytes());
        assert_eq!(
            Packet::new(&bad).unwrap_err(),
            MessageError::Azimuth { block: 1, found: 36_000 }
        );
    }
}
