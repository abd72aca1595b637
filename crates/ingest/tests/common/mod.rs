//! Makes logs in memory with the `mcap` crate, and ingests them.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]
#![allow(dead_code, reason = "each test file uses only some of this")]

pub mod packets;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dataset::{Losses, Scan};
use ingest::{IngestError, Ingested, LidarOptions, Log, Options, PoseOptions};
use mcap::{Channel, Message, Schema, WriteOptions};
use messages::hdl32e::{BLOCKS, PACKET_PERIOD_NS, PacketBuilder};
use messages::{
    Encoding, LaserScan, MessageType, PointCloud, PointField, Scalar, StampedPose3, foxglove, ros,
};

/// One message of a log: topic, schema, encoding, data.
pub type Entry = (&'static str, &'static str, &'static str, Vec<u8>);

pub fn planar(k: i64, encoding: Encoding) -> Vec<u8> {
    let scan = LaserScan {
        stamp_ns: k * 100_000_000,
        angle_min: -1.5,
        angle_max: None,
        angle_increment: 0.5,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 50.0,
        ranges: (0..7).map(|beam| 1.0 + (k + beam) as f32).collect(),
    };
    ros::write_laser_scan(encoding, "laser", &scan)
}

pub fn pose(k: i64, encoding: Encoding) -> Vec<u8> {
    let pose = StampedPose3 {
        stamp_ns: k * 100_000_000,
        position: [k as f64, 0.0, 0.0],
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    ros::write_pose_stamped(encoding, "map", &pose)
}

/// Ten planar scans and ten poses.
pub fn planar_log() -> Vec<Entry> {
    (0..10)
        .flat_map(|k| {
            [
                ("/scan", "sensor_msgs/msg/LaserScan", "cdr", planar(k, Encoding::Cdr)),
                ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", pose(k, Encoding::Cdr)),
            ]
        })
        .collect()
}

/// 2.5 revolutions of an HDL-32E surrounded by a wall at 3 to 9 m, in messages of 100 packets.
pub fn packet_log(encoding: Encoding) -> Vec<Entry> {
    let step = 17;
    let packets: Vec<_> = (0..440i64)
        .map(|k| {
            let first_block = k as u32 * BLOCKS as u32;
            let azimuths =
                std::array::from_fn(|b| ((step * (first_block + b as u32)) % 36_000) as u16);
            let mut packet = PacketBuilder::new(azimuths, (k * 553) as u32);
            for (block, azimuth) in azimuths.iter().enumerate() {
                packet.set_return(block, 15, 1500 + azimuth / 12, 100);
                packet.set_return(block, 14, 999, 100);
            }
            ((k + 1) * PACKET_PERIOD_NS, packet.finish())
        })
        .collect();
    let schema = match encoding {
        Encoding::Ros1 => "velodyne_msgs/VelodyneScan",
        _ => "velodyne_msgs/msg/VelodyneScan",
    };
    let name = encoding.name();
    packets
        .chunks(100)
        .map(|chunk| {
            ("/packets", schema, name, ros::write_velodyne_scan(encoding, "velodyne", 0, chunk))
        })
        .collect()
}

/// Slightly more than three revolutions of an HDL-32E that spins by 15 deg per block: two packets per
/// revolution, in messages of two packets.
pub fn coarse_packet_log(encoding: Encoding) -> Vec<Entry> {
    let packets: Vec<_> = (0..8i64)
        .map(|k| {
            let first_block = k as u32 * BLOCKS as u32;
            let azimuths =
                std::array::from_fn(|b| ((1500 * (first_block + b as u32)) % 36_000) as u16);
            let mut packet = PacketBuilder::new(azimuths, (k * 553) as u32);
            for block in 0..BLOCKS {
                packet.set_return(block, 15, 1500 + (first_block + block as u32) as u16, 100);
            }
            ((k + 1) * PACKET_PERIOD_NS, packet.finish())
        })
        .collect();
    let message_type = MessageType::VelodyneScan;
    let schema = message_type.schema_name(encoding).unwrap();
    let name = encoding.name();
    let write = |packets| ros::write_velodyne_scan(encoding, "velodyne", 0, packets);
    packets.chunks(2).map(|packets| ("/packets", schema, name, write(packets))).collect()
}

/// Three clouds with two rings of six points each, and three poses.
pub fn cloud_log(encoding: Encoding) -> Vec<Entry> {
    let field = |name: &str, offset, kind| PointField { name: name.to_owned(), offset, kind };
    let cloud = |k: i64| {
        let points = (0..12u8).flat_map(|point| {
            let angle = f32::from(point / 2) * -0.9 - 0.1;
            let range = 3.0 + k as f32 + f32::from(point) / 8.0;
            let z = if point % 2 == 0 { 0.0 } else { 1.0 };
            let xyz = [range * angle.cos(), range * angle.sin(), z].map(f32::to_le_bytes);
            [xyz.concat(), vec![point % 2, 0]].concat()
        });
        PointCloud {
            stamp_ns: k * 100_000_000,
            width: 12,
            height: 1,
            point_step: 14,
            row_step: 168,
            big_endian: false,
            fields: vec![
                field("x", 0, Scalar::F32),
                field("y", 4, Scalar::F32),
                field("z", 8, Scalar::F32),
                field("ring", 12, Scalar::U16),
            ],
            data: points.collect::<Vec<_>>().into(),
        }
    };
    let is_ros = matches!(encoding, Encoding::Cdr | Encoding::Ros1);
    let (cloud_type, pose_type) = match is_ros {
        true => (MessageType::PointCloud2, MessageType::PoseStamped),
        false => (MessageType::FoxglovePointCloud, MessageType::FoxglovePoseInFrame),
    };
    let schema = |message_type: MessageType| message_type.schema_name(encoding).unwrap();
    let name = encoding.name();
    (0..3)
        .flat_map(|k| {
            let (cloud, pose) = match is_ros {
                true => (ros::write_point_cloud2(encoding, "lidar", &cloud(k)), pose(k, encoding)),
                false => (
                    foxglove::write_point_cloud(encoding, "lidar", &cloud(k)),
                    pose_in_frame(k, encoding),
                ),
            };
            [("/points", schema(cloud_type), name, cloud), ("/pose", schema(pose_type), name, pose)]
        })
        .collect()
}

/// Writes a `foxglove.PoseInFrame` message, for which the `messages` crate has no writer.
pub fn pose_in_frame(k: i64, encoding: Encoding) -> Vec<u8> {
    let nsec = k * 100_000_000;
    if encoding == Encoding::Json {
        let text = format!(
            r#"{{"timestamp":{{"sec":0,"nsec":{nsec}}},"frame_id":"map","pose":{{"position":{{"x":{k},"y":0,"z":0}},"orientation":{{"x":0,"y":0,"z":0,"w":1}}}}}}"#
        );
        return text.into_bytes();
    }
    // Field numbers of `foxglove.PoseInFrame`; wire types 0 varint, 1 eight bytes, 2 length-delimited.
    let part = |tag: u8, bytes: &[u8]| [&[tag << 3 | 2, bytes.len() as u8], bytes].concat();
    let number = |tag: u8, value: f64| [&[tag << 3 | 1], &value.to_le_bytes()[..]].concat();
    let mut time = vec![2 << 3];
    let mut rest = nsec as u64;
    while 0x7f < rest {
        time.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    time.push(rest as u8);
    let pose = [part(1, &number(1, k as f64)), part(2, &number(4, 1.0))].concat();
    [part(1, &time), part(2, b"map"), part(3, &pose)].concat()
}

/// Writes an MCAP file. An entry with an empty schema name gets a channel without schema.
pub fn write(entries: &[Entry], options: WriteOptions) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let mut channels: BTreeMap<(&str, &str), Arc<Channel<'_>>> = BTreeMap::new();
    for (k, (topic, schema, encoding, data)) in entries.iter().enumerate() {
        let id = channels.len() as u16 + 1;
        let channel = channels.entry((topic, schema)).or_insert_with(|| {
            let schema = (!schema.is_empty()).then(|| {
                // The text is left out, because only the name is used.
                Arc::new(Schema {
                    id,
                    name: (*schema).to_owned(),
                    encoding: "ros2msg".into(),
                    data: Cow::Borrowed(b""),
                })
            });
            Arc::new(Channel {
                id,
                topic: (*topic).to_owned(),
                schema,
                message_encoding: (*encoding).to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let message = Message {
            channel: channel.clone(),
            sequence: k as u32,
            log_time: k as u64,
            publish_time: k as u64,
            data: Cow::Borrowed(data),
        };
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

pub fn options(lidar: &str, pose: Option<&str>) -> Options {
    Options {
        lidar: LidarOptions { topic: lidar.to_owned(), ..LidarOptions::default() },
        pose: pose.map(PoseOptions::of_topic),
    }
}

pub fn small_chunks() -> WriteOptions {
    WriteOptions::new().chunk_size(Some(600))
}

pub fn ingest_bytes(bytes: &[u8], options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    ingest_logs(&[Log::from_bytes(Path::new("drive.mcap"), bytes.to_owned())?], options)
}

pub fn ingest_file(path: &Path, options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    ingest_files(&[path.to_owned()], options)
}

pub fn ingest_files(
    paths: &[PathBuf],
    options: &Options,
) -> Result<(Vec<Scan>, Ingested), IngestError> {
    ingest_logs(&paths.iter().map(|path| Log::open(path)).collect::<Result<Vec<_>, _>>()?, options)
}

pub fn ingest_logs(logs: &[Log], options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    let n_bytes: u64 = logs.iter().map(Log::n_bytes).sum();
    let mut scans = Vec::new();
    let ingested = ingest::ingest(
        &logs.iter().collect::<Vec<_>>(),
        options,
        |batch| {
            scans.extend(batch);
            Ok::<_, IngestError>(())
        },
        |position| assert!(position <= n_bytes),
    )?;
    assert_eq!(scans.len(), ingested.n_scans);
    Ok((scans, ingested))
}

/// Codes and counts of losses.
pub fn codes(losses: &Losses) -> Vec<(&'static str, u64)> {
    losses.iter().map(|(loss, n)| (loss.kind.code(), n)).collect()
}

pub fn error(entries: &[Entry], lidar: &str, pose: Option<&str>) -> String {
    ingest_bytes(&write(entries, small_chunks()), &options(lidar, pose)).unwrap_err().to_string()
}
