//! ROS messages in both encodings that MCAP logs carry: ROS 2 (CDR, OMG formal/02-06-51 section
//! 15.3 with the four-byte encapsulation of DDSI-RTPS) and ROS 1 (packed little endian).
//!
//! `VelodyneScan` has a reader of its own that borrows its packets; the small messages go through
//! serde.

use cdr_encoding::{from_bytes, to_vec};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::hdl32e::PACKET_BYTES;
use crate::{MessageError, Result};

/// How a message's bytes are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// ROS 2: CDR, with encapsulation header.
    Cdr,
    /// ROS 1.
    Ros1,
}

impl Encoding {
    /// From the `message_encoding` of an MCAP channel.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "cdr" => Some(Self::Cdr),
            "ros1" => Some(Self::Ros1),
            _ => None,
        }
    }
}

/// The message types that a stage reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum MessageType {
    /// `velodyne_msgs/VelodyneScan`
    VelodyneScan,
    /// `sensor_msgs/LaserScan`
    LaserScan,
    /// `geometry_msgs/PoseStamped`
    PoseStamped,
    /// `nav_msgs/Odometry`
    Odometry,
}

impl MessageType {
    /// From a schema name in ROS 1 (`pkg/Type`) or ROS 2 (`pkg/msg/Type`) form.
    ///
    /// The name alone decides: schema texts in logs can be missing or partial.
    pub fn from_schema_name(name: &str) -> Option<Self> {
        let (package, rest) = name.split_once('/')?;
        match (package, rest.strip_prefix("msg/").unwrap_or(rest)) {
            ("velodyne_msgs", "VelodyneScan") => Some(Self::VelodyneScan),
            ("sensor_msgs", "LaserScan") => Some(Self::LaserScan),
            ("geometry_msgs", "PoseStamped") => Some(Self::PoseStamped),
            ("nav_msgs", "Odometry") => Some(Self::Odometry),
            _ => None,
        }
    }

    /// The bare type name.
    pub fn name(self) -> &'static str {
        match self {
            Self::VelodyneScan => "VelodyneScan",
            Self::LaserScan => "LaserScan",
            Self::PoseStamped => "PoseStamped",
            Self::Odometry => "Odometry",
        }
    }
}

/// A planar scan as `sensor_msgs/LaserScan` gives it.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    /// Header stamp: when the first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle of the first beam \[rad, counter-clockwise from x\].
    pub angle_min: f32,
    /// Angle from a beam to the next \[rad\].
    pub angle_increment: f32,
    /// Readings nearer than this are no returns \[m\].
    pub range_min: f32,
    /// Readings farther than this are no returns \[m\].
    pub range_max: f32,
    /// One reading a beam \[m\]; NaN and infinities are no returns.
    pub ranges: Vec<f32>,
}

/// A pose with its time, from `PoseStamped` or `Odometry`.
#[derive(Debug, Clone, PartialEq)]
pub struct StampedPose3 {
    /// Header stamp \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Position \[m\].
    pub position: [f64; 3],
    /// Orientation quaternion (x, y, z, w).
    pub orientation: [f64; 4],
}

// ---------------------------------------------------------------------------------------------
// The wire structs; `H` is the header, the only part that differs between ROS 1 and ROS 2.

/// The layout of `std_msgs/Header` in one encoding.
trait Header: Serialize + DeserializeOwned {
    fn new(stamp_ns: i64, frame_id: &str) -> Self;
    fn stamp_ns(&self) -> i64;
}

#[derive(Serialize, Deserialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

impl Time {
    fn from_ns(ns: i64) -> Self {
        Self {
            sec: ns.div_euclid(1_000_000_000) as i32,
            nanosec: ns.rem_euclid(1_000_000_000) as u32,
        }
    }

    fn ns(&self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }
}

#[derive(Serialize, Deserialize)]
struct Ros2Header {
    stamp: Time,
    frame_id: String,
}

impl Header for Ros2Header {
    fn new(stamp_ns: i64, frame_id: &str) -> Self {
        Self { stamp: Time::from_ns(stamp_ns), frame_id: frame_id.to_owned() }
    }
    fn stamp_ns(&self) -> i64 {
        self.stamp.ns()
    }
}

#[derive(Serialize, Deserialize)]
struct Ros1Header {
    seq: u32,
    stamp: Time,
    frame_id: String,
}

impl Header for Ros1Header {
    fn new(stamp_ns: i64, frame_id: &str) -> Self {
        Self { seq: 0, stamp: Time::from_ns(stamp_ns), frame_id: frame_id.to_owned() }
    }
    fn stamp_ns(&self) -> i64 {
        self.stamp.ns()
    }
}

#[derive(Serialize, Deserialize)]
struct PoseWire {
    position: [f64; 3],
    orientation: [f64; 4],
}

#[derive(Serialize, Deserialize)]
struct PoseStampedWire<H> {
    header: H,
    pose: PoseWire,
}

#[derive(Serialize, Deserialize)]
struct OdometryWire<H> {
    header: H,
    child_frame_id: String,
    pose: PoseWire,
    pose_covariance: [[f64; 6]; 6],
    twist: [f64; 6],
    twist_covariance: [[f64; 6]; 6],
}

#[derive(Serialize, Deserialize)]
struct LaserScanWire<H> {
    header: H,
    angle_min: f32,
    angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    range_min: f32,
    range_max: f32,
    ranges: Vec<f32>,
    intensities: Vec<f32>,
}

fn pose_of<H: Header>(header: &H, pose: &PoseWire) -> StampedPose3 {
    StampedPose3 {
        stamp_ns: header.stamp_ns(),
        position: pose.position,
        orientation: pose.orientation,
    }
}

fn laser_scan_of<H: Header>(wire: LaserScanWire<H>) -> LaserScan {
    LaserScan {
        stamp_ns: wire.header.stamp_ns(),
        angle_min: wire.angle_min,
        angle_increment: wire.angle_increment,
        range_min: wire.range_min,
        range_max: wire.range_max,
        ranges: wire.ranges,
    }
}

// ---------------------------------------------------------------------------------------------
// Reading

/// Reads a `geometry_msgs/PoseStamped`.
pub fn read_pose_stamped(encoding: Encoding, bytes: &[u8]) -> Result<StampedPose3> {
    const NAME: &str = "geometry_msgs/PoseStamped";
    match encoding {
        Encoding::Cdr => decode_cdr(NAME, bytes)
            .map(|m: PoseStampedWire<Ros2Header>| pose_of(&m.header, &m.pose)),
        Encoding::Ros1 => decode_ros1(NAME, bytes)
            .map(|m: PoseStampedWire<Ros1Header>| pose_of(&m.header, &m.pose)),
    }
}

/// Reads the pose of a `nav_msgs/Odometry`.
pub fn read_odometry(encoding: Encoding, bytes: &[u8]) -> Result<StampedPose3> {
    const NAME: &str = "nav_msgs/Odometry";
    match encoding {
        Encoding::Cdr => {
            decode_cdr(NAME, bytes).map(|m: OdometryWire<Ros2Header>| pose_of(&m.header, &m.pose))
        }
        Encoding::Ros1 => {
            decode_ros1(NAME, bytes).map(|m: OdometryWire<Ros1Header>| pose_of(&m.header, &m.pose))
        }
    }
}

/// Reads a `sensor_msgs/LaserScan`.
pub fn read_laser_scan(encoding: Encoding, bytes: &[u8]) -> Result<LaserScan> {
    const NAME: &str = "sensor_msgs/LaserScan";
    match encoding {
        Encoding::Cdr => decode_cdr(NAME, bytes).map(laser_scan_of::<Ros2Header>),
        Encoding::Ros1 => decode_ros1(NAME, bytes).map(laser_scan_of::<Ros1Header>),
    }
}

/// Byte order of a CDR body, from its encapsulation header.
fn cdr_is_big_endian(message: &'static str, bytes: &[u8]) -> Result<bool> {
    match bytes {
        [0, 0, _, _, ..] => Ok(true),
        [0, 1, _, _, ..] => Ok(false),
        [a, b, _, _, ..] => {
            Err(MessageError::Encapsulation { found: u16::from_be_bytes([*a, *b]) })
        }
        _ => Err(MessageError::TooShort { message, expected: 4, found: bytes.len() }),
    }
}

fn decode_cdr<T: DeserializeOwned>(message: &'static str, bytes: &[u8]) -> Result<T> {
    let body = bytes.get(4..).unwrap_or_default();
    let decoded = if cdr_is_big_endian(message, bytes)? {
        from_bytes::<T, byteorder::BigEndian>(body)
    } else {
        from_bytes::<T, byteorder::LittleEndian>(body)
    };
    decoded
        .map(|(value, _consumed)| value)
        .map_err(|e| MessageError::Malformed { message, detail: e.to_string() })
}

fn decode_ros1<T: DeserializeOwned>(message: &'static str, bytes: &[u8]) -> Result<T> {
    roslibrust_serde_rosmsg::from_slice_known_length(bytes, bytes.len() as u32)
        .map_err(|e| MessageError::Malformed { message, detail: e.to_string() })
}

/// The packets of one `velodyne_msgs/VelodyneScan`, borrowed.
#[derive(Debug, Clone, Copy)]
pub struct VelodyneScan<'a> {
    /// Header stamp \[ns since the epoch\].
    pub stamp_ns: i64,
    packets: &'a [u8],
    n_packets: usize,
    stride: usize,
    big_endian: bool,
}

impl<'a> VelodyneScan<'a> {
    /// Reads the header and checks that all packets are there.
    pub fn read(encoding: Encoding, bytes: &'a [u8]) -> Result<Self> {
        let (origin, big_endian) = match encoding {
            Encoding::Cdr => (4, cdr_is_big_endian(Self::NAME, bytes)?),
            Encoding::Ros1 => (0, false),
        };
        // CDR aligns a u32 to 4 bytes from the end of the encapsulation; ROS 1 aligns nothing.
        let align = |at: usize| match encoding {
            Encoding::Cdr => origin + (at - origin).next_multiple_of(4),
            Encoding::Ros1 => at,
        };
        let u32_at = |at: usize| {
            let raw = slice_at(bytes, at, 4)?;
            let raw = [raw[0], raw[1], raw[2], raw[3]];
            Ok(if big_endian { u32::from_be_bytes(raw) } else { u32::from_le_bytes(raw) })
        };
        let stamp_at = match encoding {
            Encoding::Cdr => origin,
            Encoding::Ros1 => origin + 4, // after `seq`
        };
        let stamp_ns = time_ns(u32_at(stamp_at)?, u32_at(stamp_at + 4)?);
        let frame_id_bytes = u32_at(stamp_at + 8)? as usize;
        let count_at = align((stamp_at + 12).saturating_add(frame_id_bytes));
        let n_packets = u32_at(count_at)? as usize;
        // A packet is a time and 1206 bytes; in CDR the next one starts 2 bytes later, aligned.
        let stride = match encoding {
            Encoding::Cdr => (8 + PACKET_BYTES).next_multiple_of(4),
            Encoding::Ros1 => 8 + PACKET_BYTES,
        };
        let length = match n_packets {
            0 => 0,
            n => (n - 1).saturating_mul(stride).saturating_add(8 + PACKET_BYTES),
        };
        let packets = slice_at(bytes, count_at + 4, length)?;
        Ok(Self { stamp_ns, packets, n_packets, stride, big_endian })
    }

    const NAME: &'static str = "velodyne_msgs/VelodyneScan";

    /// Number of packets.
    pub fn len(&self) -> usize {
        self.n_packets
    }

    /// Whether there is no packet.
    pub fn is_empty(&self) -> bool {
        self.n_packets == 0
    }

    /// Each packet's stamp \[ns since the epoch\] and its 1206 bytes, in order.
    pub fn packets(&self) -> impl ExactSizeIterator<Item = (i64, &'a [u8])> + use<'a> {
        let Self { packets, stride, big_endian, .. } = *self;
        (0..self.n_packets).map(move |k| {
            let packet = &packets[k * stride..][..8 + PACKET_BYTES];
            let word = |at: usize| {
                let raw = [packet[at], packet[at + 1], packet[at + 2], packet[at + 3]];
                if big_endian { u32::from_be_bytes(raw) } else { u32::from_le_bytes(raw) }
            };
            (time_ns(word(0), word(4)), &packet[8..])
        })
    }
}

fn slice_at(bytes: &[u8], at: usize, length: usize) -> Result<&[u8]> {
    let end = at.saturating_add(length);
    bytes.get(at..end).ok_or(MessageError::TooShort {
        message: VelodyneScan::NAME,
        expected: end,
        found: bytes.len(),
    })
}

/// Seconds are signed in ROS 2 and unsigned in ROS 1; they agree until 2038.
fn time_ns(sec: u32, nanosec: u32) -> i64 {
    i64::from(sec) * 1_000_000_000 + i64::from(nanosec)
}

// ---------------------------------------------------------------------------------------------
// Writing

/// Writes a `geometry_msgs/PoseStamped`.
pub fn write_pose_stamped(encoding: Encoding, frame_id: &str, pose: &StampedPose3) -> Vec<u8> {
    let wire_pose = PoseWire { position: pose.position, orientation: pose.orientation };
    match encoding {
        Encoding::Cdr => encode_cdr(&PoseStampedWire {
            header: Ros2Header::new(pose.stamp_ns, frame_id),
            pose: wire_pose,
        }),
        Encoding::Ros1 => encode_ros1(&PoseStampedWire {
            header: Ros1Header::new(pose.stamp_ns, frame_id),
            pose: wire_pose,
        }),
    }
}

/// Writes a `nav_msgs/Odometry` with zero twist and covariances.
pub fn write_odometry(
    encoding: Encoding,
    frame_id: &str,
    child_frame_id: &str,
    pose: &StampedPose3,
) -> Vec<u8> {
    fn wire<H: Header>(frame_id: &str, child: &str, pose: &StampedPose3) -> OdometryWire<H> {
        OdometryWire {
            header: H::new(pose.stamp_ns, frame_id),
            child_frame_id: child.to_owned(),
            pose: PoseWire { position: pose.position, orientation: pose.orientation },
            pose_covariance: [[0.0; 6]; 6],
            twist: [0.0; 6],
            twist_covariance: [[0.0; 6]; 6],
        }
    }
    match encoding {
        Encoding::Cdr => encode_cdr(&wire::<Ros2Header>(frame_id, child_frame_id, pose)),
        Encoding::Ros1 => encode_ros1(&wire::<Ros1Header>(frame_id, child_frame_id, pose)),
    }
}

/// Writes a `sensor_msgs/LaserScan` without intensities.
pub fn write_laser_scan(encoding: Encoding, frame_id: &str, scan: &LaserScan) -> Vec<u8> {
    fn wire<H: Header>(frame_id: &str, scan: &LaserScan) -> LaserScanWire<H> {
        let n_steps = scan.ranges.len().saturating_sub(1) as f32;
        LaserScanWire {
            header: H::new(scan.stamp_ns, frame_id),
            angle_min: scan.angle_min,
            angle_max: scan.angle_min + scan.angle_increment * n_steps,
            angle_increment: scan.angle_increment,
            time_increment: 0.0,
            scan_time: 0.0,
            range_min: scan.range_min,
            range_max: scan.range_max,
            ranges: scan.ranges.clone(),
            intensities: Vec::new(),
        }
    }
    match encoding {
        Encoding::Cdr => encode_cdr(&wire::<Ros2Header>(frame_id, scan)),
        Encoding::Ros1 => encode_ros1(&wire::<Ros1Header>(frame_id, scan)),
    }
}

/// Writes a `velodyne_msgs/VelodyneScan`; each packet comes with its stamp \[ns\].
pub fn write_velodyne_scan(
    encoding: Encoding,
    frame_id: &str,
    stamp_ns: i64,
    packets: &[(i64, [u8; PACKET_BYTES])],
) -> Vec<u8> {
    let mut out = Vec::with_capacity(64 + frame_id.len() + packets.len() * (PACKET_BYTES + 10));
    let time = |out: &mut Vec<u8>, ns: i64| {
        let time = Time::from_ns(ns);
        out.extend_from_slice(&time.sec.to_le_bytes());
        out.extend_from_slice(&time.nanosec.to_le_bytes());
    };
    let align = |out: &mut Vec<u8>| {
        if encoding == Encoding::Cdr {
            out.resize(out.len().next_multiple_of(4), 0);
        }
    };
    match encoding {
        Encoding::Cdr => out.extend_from_slice(&[0, 1, 0, 0]),
        Encoding::Ros1 => out.extend_from_slice(&0u32.to_le_bytes()), // seq
    }
    time(&mut out, stamp_ns);
    // A CDR string counts and carries its terminating zero, a ROS 1 string has none.
    let terminator: &[u8] = if encoding == Encoding::Cdr { &[0] } else { &[] };
    out.extend_from_slice(&((frame_id.len() + terminator.len()) as u32).to_le_bytes());
    out.extend_from_slice(frame_id.as_bytes());
    out.extend_from_slice(terminator);
    align(&mut out);
    out.extend_from_slice(&(packets.len() as u32).to_le_bytes());
    for (packet_stamp_ns, packet) in packets {
        align(&mut out);
        time(&mut out, *packet_stamp_ns);
        out.extend_from_slice(packet);
    }
    out
}

fn encode_cdr<T: Serialize>(value: &T) -> Vec<u8> {
    let mut out = vec![0, 1, 0, 0];
    out.extend(
        to_vec::<T, byteorder::LittleEndian>(value).expect("a plain struct serialises into memory"),
    );
    out
}

fn encode_ros1<T: Serialize>(value: &T) -> Vec<u8> {
    roslibrust_serde_rosmsg::to_vec_skip_length(value)
        .expect("a plain struct serialises into memory")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hdl32e::PacketBuilder;

    const BOTH: [Encoding; 2] = [Encoding::Cdr, Encoding::Ros1];

    #[test]
    fn schema_names_of_both_generations() {
        let t = MessageType::from_schema_name;
        assert_eq!(t("velodyne_msgs/msg/VelodyneScan"), Some(MessageType::VelodyneScan));
        assert_eq!(t("velodyne_msgs/VelodyneScan"), Some(MessageType::VelodyneScan));
        assert_eq!(t("nav_msgs/msg/Odometry"), Some(MessageType::Odometry));
        assert_eq!(t("nav_msgs/msg/Path"), None);
        assert_eq!(t("PoseStamped"), None);
    }

    #[test]
    fn a_pose_survives_both_encodings() {
        let pose = StampedPose3 {
            stamp_ns: 1_330_000_000_049_999_872,
            position: [1.5, -2.25, 0.125],
            orientation: [0.0, 0.0, 0.6, 0.8],
        };
        for encoding in BOTH {
            for frame_id in ["", "map", "odom_frame"] {
                let bytes = write_pose_stamped(encoding, frame_id, &pose);
                assert_eq!(read_pose_stamped(encoding, &bytes).unwrap(), pose);
                let bytes = write_odometry(encoding, frame_id, "base_link", &pose);
                assert_eq!(read_odometry(encoding, &bytes).unwrap(), pose);
            }
        }
    }

    /// Laid out by hand: encapsulation, sec, nanosec, string "map\0" (4 + 4), then f64 at a
    /// multiple of 8 from the end of the encapsulation.
    #[test]
    fn the_cdr_bytes_of_a_pose() {
        let pose = StampedPose3 {
            stamp_ns: 3_000_000_007,
            position: [1.0, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let bytes = write_pose_stamped(Encoding::Cdr, "map", &pose);
        assert_eq!(bytes.len(), 4 + 8 + 8 + 8 + 7 * 8 - 4 - 4);
        assert_eq!(
            &bytes[..20],
            [0, 1, 0, 0, 3, 0, 0, 0, 7, 0, 0, 0, 4, 0, 0, 0, b'm', b'a', b'p', 0]
        );
        assert_eq!(&bytes[20..28], 1.0f64.to_le_bytes());
    }

    #[test]
    fn a_laser_scan_survives_both_encodings() {
        let scan = LaserScan {
            stamp_ns: 5,
            angle_min: -1.5,
            angle_increment: 0.5,
            range_min: 0.1,
            range_max: 81.0,
            ranges: vec![1.0, f32::INFINITY, 81.83],
        };
        for encoding in BOTH {
            let bytes = write_laser_scan(encoding, "laser", &scan);
            assert_eq!(read_laser_scan(encoding, &bytes).unwrap(), scan);
        }
    }

    #[test]
    fn packets_survive_both_encodings_and_every_frame_name_length() {
        let packets: Vec<_> = (0..3u16)
            .map(|k| (1_000_000_000 + i64::from(k), PacketBuilder::new([k; 12], 7).finish()))
            .collect();
        for encoding in BOTH {
            for frame_id in ["", "a", "ab", "abc", "abcd", "velodyne"] {
                let bytes = write_velodyne_scan(encoding, frame_id, 9, &packets);
                let scan = VelodyneScan::read(encoding, &bytes).unwrap();
                assert_eq!((scan.stamp_ns, scan.len(), scan.is_empty()), (9, 3, false));
                for ((stamp, bytes), (expected_stamp, expected)) in scan.packets().zip(&packets) {
                    assert_eq!(stamp, *expected_stamp);
                    assert_eq!(bytes, expected);
                }
            }
        }
    }

    #[test]
    fn every_cut_of_a_message_is_an_error_or_an_equal_message() {
        let packets = [(5, PacketBuilder::new([9; 12], 7).finish())];
        for encoding in BOTH {
            let whole = write_velodyne_scan(encoding, "velodyne", 9, &packets);
            for cut in 0..whole.len() {
                assert!(VelodyneScan::read(encoding, &whole[..cut]).is_err(), "cut at {cut}");
            }
            let scan = LaserScan {
                stamp_ns: 5,
                angle_min: 0.0,
                angle_increment: 0.5,
                range_min: 0.1,
                range_max: 9.0,
                ranges: vec![1.0; 5],
            };
            let whole = write_laser_scan(encoding, "laser", &scan);
            for cut in 0..whole.len() {
                assert!(read_laser_scan(encoding, &whole[..cut]).is_err(), "cut at {cut}");
            }
        }
    }

    #[test]
    fn a_sequence_that_claims_more_than_there_is_fails_without_allocating_it() {
        let mut bytes = write_velodyne_scan(Encoding::Cdr, "velodyne", 9, &[]);
        let at = bytes.len() - 4;
        bytes[at..].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(matches!(
            VelodyneScan::read(Encoding::Cdr, &bytes),
            Err(MessageError::TooShort { .. })
        ));
    }

    #[test]
    fn another_encapsulation_is_named() {
        let mut bytes = write_velodyne_scan(Encoding::Cdr, "velodyne", 9, &[]);
        bytes[1] = 3;
        assert_eq!(
            VelodyneScan::read(Encoding::Cdr, &bytes).unwrap_err(),
            MessageError::Encapsulation { found: 3 }
        );
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_make_a_reader_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            for encoding in BOTH {
                let _ = read_pose_stamped(encoding, &bytes);
                let _ = read_odometry(encoding, &bytes);
                let _ = read_laser_scan(encoding, &bytes);
                if let Ok(scan) = VelodyneScan::read(encoding, &bytes) {
                    assert_eq!(scan.packets().count(), scan.len());
                }
            }
        }
    }
}
