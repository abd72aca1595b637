//! Packets of a made-up HDL-32E.

use messages::hdl32e::{BLOCKS, LASERS, PACKET_BYTES, PacketBuilder};
use messages::{Encoding, ros};

use super::Entry;

// A sensor that spins by 0.2 deg per firing: 1800 firings or 150 packets per revolution. It starts at
// azimuth 0, so the first revolution is complete.
pub const STEP: u32 = 20;
pub const PACKETS_PER_REVOLUTION: usize = 150;
/// The top of an hour \[ns since the epoch\].
pub const START_NS: i64 = 400_000 * 3_600_000_000_000;

/// Stamp \[ns\] and bytes of a packet.
pub type Stamped = (i64, [u8; PACKET_BYTES]);

/// A stream of packets with the distance \[2 mm\] as a function of firing and laser.
pub fn stream(n: usize, distance: impl Fn(usize, usize) -> u16) -> Vec<Stamped> {
    let packet = |k: usize| {
        let azimuths = std::array::from_fn(|b| ((STEP * (k * BLOCKS + b) as u32) % 36_000) as u16);
        let mut packet = PacketBuilder::new(azimuths, device_us(k));
        for block in 0..BLOCKS {
            for laser in 0..LASERS {
                packet.set_return(block, laser, distance(k * BLOCKS + block, laser), 100);
            }
        }
        ((START_NS + (k as i64 + 1) * 552_960), packet.finish())
    };
    (0..n).map(packet).collect()
}

/// Device clock of a sensor on GPS time: the start of the packet, past the hour \[us\].
pub fn device_us(k: usize) -> u32 {
    (k * 55_296 / 100) as u32
}

pub fn set_device_us(packet: &mut Stamped, us: u32) {
    packet.1[1200..1204].copy_from_slice(&us.to_le_bytes());
}

/// Every laser measures 10 m in all directions.
pub fn around(n: usize) -> Vec<Stamped> {
    stream(n, |_, _| 5000)
}

pub fn packets_log(packets: &[Stamped]) -> Vec<Entry> {
    let message = |chunk| ros::write_velodyne_scan(Encoding::Cdr, "velodyne", 0, chunk);
    packets
        .chunks(40)
        .map(|chunk| ("/packets", "velodyne_msgs/msg/VelodyneScan", "cdr", message(chunk)))
        .collect()
}
