//! Logs made in memory with the `mcap` crate, and their scans.

#![allow(dead_code, reason = "each test file uses a part")]

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dataset::{Dropped, Scan};
use ingest::{IngestError, Ingested, LidarOptions, Log, Options, PoseOptions};
use mcap::{Channel, Message, Schema, WriteOptions};
use messages::hdl32e::{BLOCKS, PACKET_PERIOD_NS, PacketBuilder};
use messages::{Encoding, LaserScan, StampedPose3, ros};

/// One message of a log: topic, schema, encoding, data.
pub type Entry = (&'static str, &'static str, &'static str, Vec<u8>);

pub fn planar(k: i64, encoding: Encoding) -> Vec<u8> {
    let scan = LaserScan {
        stamp_ns: k * 100_000_000,
        angle_min: -1.5,
        angle_increment: 0.5,
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

/// 2.5 turns of an HDL-32E that sees a wall at 3 to 9 m all around, in messages of 100 packets.
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

/// Writes an MCAP file; an entry with an empty schema name gets a channel without schema.
pub fn write(entries: &[Entry], options: WriteOptions) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let mut channels: BTreeMap<(&str, &str), Arc<Channel<'_>>> = BTreeMap::new();
    for (k, (topic, schema, encoding, data)) in entries.iter().enumerate() {
        let id = channels.len() as u16 + 1;
        let channel = channels.entry((topic, schema)).or_insert_with(|| {
            let schema = (!schema.is_empty()).then(|| {
                // The text is left out: the name must do.
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
        pose: pose.map(|topic| PoseOptions { topic: topic.to_owned() }),
    }
}

pub fn small_chunks() -> WriteOptions {
    WriteOptions::new().chunk_size(Some(600))
}

pub fn ingest_bytes(bytes: &[u8], options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    std::fs::write(&path, bytes).unwrap();
    ingest_file(&path, options)
}

pub fn ingest_file(path: &Path, options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    ingest_files(&[path.to_owned()], options)
}

pub fn ingest_files(
    paths: &[PathBuf],
    options: &Options,
) -> Result<(Vec<Scan>, Ingested), IngestError> {
    let logs = paths.iter().map(|path| Log::open(path)).collect::<Result<Vec<_>, _>>()?;
    let n_bytes: usize = logs.iter().map(|log| log.bytes().len()).sum();
    let mut scans = Vec::new();
    let ingested = ingest::ingest(
        &logs.iter().collect::<Vec<_>>(),
        options,
        |batch| {
            scans.extend(batch);
            Ok::<_, IngestError>(())
        },
        |position| assert!(position <= n_bytes as u64),
    )?;
    assert_eq!(scans.len(), ingested.n_scans);
    Ok((scans, ingested))
}

pub fn reasons(dropped: &Dropped) -> Vec<(&str, u64)> {
    dropped.iter().collect()
}

pub fn error(entries: &[Entry], lidar: &str, pose: Option<&str>) -> String {
    ingest_bytes(&write(entries, small_chunks()), &options(lidar, pose)).unwrap_err().to_string()
}
