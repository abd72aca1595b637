//! Logs from the input of the fuzzer. A log is either the input itself, or a valid log with messages
//! that the input selects and patches. Checksums are always removed. Otherwise they would reject every
//! change before the code under test sees it.
//!
//! An input is `kind, options, rest`. If `kind` is even, the rest is the log. If it is odd, the rest is a
//! [`Recipe`].

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use arbitrary::{Arbitrary, Unstructured};
use ingest::{Clock, IngestError, LidarOptions, Log, Options, PoseOptions};
use mcap::records::op;
use mcap::{Channel, Compression, Message, Schema, WriteOptions};
use messages::{Encoding, MessageType, foxglove, ros};

use crate::samples;

/// Topic of the lidar.
pub const LIDAR: &str = "/lidar";
/// Topic of the poses.
pub const POSE: &str = "/pose";

/// The log and the options from an input.
pub fn from_input(input: &[u8]) -> Option<(Vec<u8>, Options)> {
    let (&[kind, choice], rest) = input.split_first_chunk()?;
    let mut bytes = match kind % 2 {
        0 => rest.to_vec(),
        _ => Recipe::arbitrary(&mut Unstructured::new(rest)).ok()?.log(),
    };
    zero_crcs(&mut bytes);
    Some((bytes, options(choice)))
}

fn options(choice: u8) -> Options {
    let mut lidar = LidarOptions { topic: LIDAR.to_owned(), ..LidarOptions::default() };
    lidar.clock = [Clock::Host, Clock::Device, Clock::Gps, Clock::Host][usize::from(choice % 4)];
    match choice / 4 % 4 {
        1 => lidar.laser = Some(31),
        2 => lidar.ring = Some(1),
        3 => lidar.elevation_deg = Some(-1.0),
        _ => {}
    }
    lidar.upside_down = choice & 16 != 0;
    let pose = (choice & 32 == 0).then(|| PoseOptions::of_topic(POSE));
    Options { lidar, pose }
}

/// Surveys and ingests a log. Scans and poses must be valid for any log.
pub fn read(bytes: Vec<u8>, options: &Options) {
    let Ok(log) = Log::from_bytes(Path::new("fuzz.mcap"), bytes) else { return };
    let n_bytes = log.n_bytes();
    let survey = ingest::survey(&[&log], |position| assert!(position <= n_bytes));
    assert_eq!(survey.n_bytes, n_bytes);
    let mut n_scans = 0;
    let take = |scans: Vec<dataset::Scan>| {
        n_scans += scans.len();
        for scan in &scans {
            assert_eq!(scan.x_m.len(), scan.y_m.len());
            assert!(scan.x_m.iter().chain(&scan.y_m).all(|v| v.is_finite()));
            assert!(!scan.coverage_deg.is_nan() && !scan.hole_deg.is_nan());
        }
        Ok::<_, IngestError>(())
    };
    if let Ok(ingested) = ingest::ingest(&[&log], options, take, |_| ()) {
        assert_eq!(n_scans, ingested.n_scans);
        let poses = ingested.trajectory.poses();
        assert!(poses.is_sorted_by_key(|pose| pose.stamp_ns));
    }
}

/// How to build a log.
#[derive(Debug, Arbitrary)]
struct Recipe {
    layout: u8,
    chunk_size: u16,
    entries: Vec<Entry>,
    patches: Vec<Patch>,
    cut: Option<u16>,
}

#[derive(Debug, Arbitrary)]
struct Entry {
    kind: u8,
    time: u16,
    /// Whether the channel has a schema.
    is_named: bool,
    patches: Vec<Patch>,
    /// Bytes to use instead of a message.
    raw: Option<Vec<u8>>,
}

/// Bytes that replace existing bytes.
#[derive(Debug, Arbitrary)]
struct Patch {
    at: u32,
    bytes: [u8; 8],
    n: u8,
}

impl Patch {
    fn apply(&self, to: &mut [u8]) {
        if !to.is_empty() {
            let at = self.at as usize % to.len();
            let bytes = &self.bytes[..usize::from(self.n % 9)];
            to[at..].iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        }
    }
}

const KINDS: [(MessageType, Encoding); 15] = [
    (MessageType::VelodyneScan, Encoding::Cdr),
    (MessageType::VelodyneScan, Encoding::Ros1),
    (MessageType::VelodynePacket, Encoding::Cdr),
    (MessageType::PointCloud2, Encoding::Cdr),
    (MessageType::PointCloud2, Encoding::Ros1),
    (MessageType::LaserScan, Encoding::Cdr),
    (MessageType::LaserScan, Encoding::Ros1),
    (MessageType::FoxgloveLaserScan, Encoding::Protobuf),
    (MessageType::FoxgloveLaserScan, Encoding::Json),
    (MessageType::FoxglovePointCloud, Encoding::Protobuf),
    (MessageType::FoxglovePointCloud, Encoding::Json),
    (MessageType::PoseStamped, Encoding::Cdr),
    (MessageType::PoseStamped, Encoding::Ros1),
    (MessageType::FoxglovePoseInFrame, Encoding::Protobuf),
    (MessageType::FoxglovePoseInFrame, Encoding::Json),
];
/// Number of packets in a message: most of a revolution.
const PACKETS: u32 = 25;
const MAX_ENTRIES: usize = 24;

fn message(message_type: MessageType, encoding: Encoding, time: u16) -> Vec<u8> {
    let stamp_ns = i64::from(time) * 13_824_000; // 25 packets
    match message_type {
        MessageType::VelodyneScan => {
            let first = u32::from(time) * PACKETS;
            let packets: Vec<_> = (first..first + PACKETS)
                .map(|k| (1 + i64::from(k) * 552_960, samples::packet(k)))
                .collect();
            ros::write_velodyne_scan(encoding, "velodyne", stamp_ns, &packets)
        }
        MessageType::VelodynePacket => {
            let packet = samples::packet(u32::from(time));
            ros::write_velodyne_packet(encoding, 1 + i64::from(time) * 552_960, &packet)
        }
        MessageType::PointCloud2 => {
            ros::write_point_cloud2(encoding, "lidar", &samples::cloud(stamp_ns))
        }
        MessageType::LaserScan => {
            ros::write_laser_scan(encoding, "lidar", &samples::laser_scan(stamp_ns))
        }
        MessageType::FoxgloveLaserScan => {
            foxglove::write_laser_scan(encoding, "lidar", &samples::laser_scan(stamp_ns))
        }
        MessageType::FoxglovePointCloud => {
            foxglove::write_point_cloud(encoding, "lidar", &samples::cloud(stamp_ns))
        }
        MessageType::FoxglovePoseInFrame => samples::pose_in_frame(encoding),
        _ => ros::write_pose_stamped(encoding, "map", &samples::pose(stamp_ns)),
    }
}

impl Recipe {
    fn log(&self) -> Vec<u8> {
        let entries = self.entries.iter().take(MAX_ENTRIES).map(|entry| {
            let (message_type, encoding) = KINDS[usize::from(entry.kind) % KINDS.len()];
            let mut data = match &entry.raw {
                Some(raw) => raw.clone(),
                None => message(message_type, encoding, entry.time),
            };
            entry.patches.iter().for_each(|patch| patch.apply(&mut data));
            (message_type, encoding, entry.is_named, data)
        });
        let mut bytes = write(entries, self.layout, self.chunk_size);
        self.patches.iter().for_each(|patch| patch.apply(&mut bytes[mcap::MAGIC.len()..]));
        if let Some(cut) = self.cut {
            bytes.truncate(mcap::MAGIC.len().max(usize::from(cut)));
        }
        bytes
    }
}

fn write(
    entries: impl Iterator<Item = (MessageType, Encoding, bool, Vec<u8>)>,
    layout: u8,
    chunk_size: u16,
) -> Vec<u8> {
    let compression = [None, Some(Compression::Zstd), Some(Compression::Lz4), None];
    let options = WriteOptions::new()
        .compression(compression[usize::from(layout % 4)])
        .use_chunks(layout % 4 != 3)
        .chunk_size(Some(64 + u64::from(chunk_size)))
        .emit_message_indexes(layout & 4 == 0)
        .emit_summary_records(layout & 8 == 0)
        .repeat_channels(layout & 16 == 0)
        .emit_chunk_indexes(layout & 32 == 0);
    let mut writer = options.create(Cursor::new(Vec::new())).expect("writing to memory");
    let mut channels = BTreeMap::new();
    for (k, (message_type, encoding, is_named, data)) in (0u32..).zip(entries) {
        let id = channels.len() as u16 + 1;
        let channel = channels.entry((message_type, encoding, is_named)).or_insert_with(|| {
            let is_pose =
                matches!(message_type, MessageType::PoseStamped | MessageType::FoxglovePoseInFrame);
            let name = message_type.schema_name(encoding).expect("the type exists in the encoding");
            Arc::new(Channel {
                id,
                topic: if is_pose { POSE } else { LIDAR }.to_owned(),
                schema: is_named.then(|| {
                    Arc::new(Schema {
                        id,
                        name: name.to_owned(),
                        encoding: "ros2msg".to_owned(),
                        data: Cow::Borrowed(b"x"),
                    })
                }),
                message_encoding: encoding.name().to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let message = Message {
            channel: channel.clone(),
            sequence: k,
            log_time: u64::from(k),
            publish_time: u64::from(k),
            data: Cow::Owned(data),
        };
        writer.write(&message).expect("writing to memory");
    }
    writer.finish().expect("writing to memory");
    writer.into_inner().into_inner()
}

/// Sets all checksums to 0, which means "no checksum".
fn zero_crcs(bytes: &mut [u8]) {
    let mut at = mcap::MAGIC.len();
    while let Some(header) = bytes.get(at..).and_then(|rest| rest.first_chunk::<9>()) {
        let (opcode, body) = (header[0], at + 9);
        let length = u64::from_le_bytes(std::array::from_fn(|k| header[1 + k]));
        let crc = match opcode {
            op::CHUNK => Some(body + 24),
            op::DATA_END => Some(body),
            op::FOOTER => Some(body + 16),
            _ => None,
        };
        if let Some(crc) = crc.and_then(|crc| bytes.get_mut(crc..crc + 4)) {
            crc.fill(0);
        }
        let Some(next) = usize::try_from(length).ok().and_then(|length| body.checked_add(length))
        else {
            return;
        };
        at = next;
    }
}

/// Seeds: logs with every kind of message in several layouts, and recipes.
pub fn seeds() -> Vec<(String, Vec<u8>)> {
    let mut seeds = Vec::new();
    for (k, (message_type, encoding)) in KINDS.into_iter().enumerate() {
        for layout in [0, 1, 2, 3, 8, 16 | 1, 4 | 2] {
            let n = if message_type == MessageType::VelodyneScan { 4 } else { 2 };
            let entries = (0..n)
                .map(|time| (message_type, encoding, true, message(message_type, encoding, time)));
            let pose = message(MessageType::PoseStamped, Encoding::Cdr, 1);
            let pose = (MessageType::PoseStamped, Encoding::Cdr, true, pose);
            let bytes = write(entries.chain([pose]), layout, 500);
            // Large inputs make the fuzzer slow.
            if bytes.len() < 12_000 {
                let name = format!("{message_type}-{encoding}-{layout}");
                seeds.push((name, [&[0, 0], bytes.as_slice()].concat()));
            }
        }
        // The bytes as `arbitrary` reads them: layout, chunk size, then entries (another entry follows,
        // kind, time, named, no patch, not raw).
        let mut recipe = vec![1, 0, k as u8 % 4, 0, 4];
        for time in 0..6 {
            recipe.extend([1, k as u8, time, 0, 1, 0, 0]);
        }
        recipe.extend([1, 11, 1, 0, 1, 0, 0, 0, 0, 0]);
        seeds.push((format!("recipe-{message_type}-{encoding}"), recipe));
    }
    seeds
}
