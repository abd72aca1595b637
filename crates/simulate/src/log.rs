//! A drive as an MCAP log.

use std::io::{Seek, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use messages::hdl32e::PACKET_PERIOD_NS;
use messages::{MessageType, StampedPose3, ros, schemas};
use rayon::prelude::*;

use crate::campus::Campus;
use crate::drive::{Drive, MARGIN_NS};
use crate::random::{Purpose, Random};
use crate::sensor::{Sensor, azimuth_step_counts, packets_per_message};
use crate::{Compression, DriveSummary, Encoding, Options, SimulateError};

/// Topic of the sensor's packets.
pub const PACKETS_TOPIC: &str = "/velodyne_packets";
/// Topic of the true poses.
pub const POSE_TOPIC: &str = "/ground_truth";
const SENSOR_FRAME: &str = "velodyne";
const MAP_FRAME: &str = "map";
/// Time from one true pose to the next: 20 Hz \[ns\].
pub const POSE_PERIOD_NS: i64 = 50_000_000;
/// Uncompressed size of a chunk, about \[bytes\].
const CHUNK_BYTES: u64 = 1 << 20;
/// Zstandard's own default; higher levels gain little, the bytes are noise for the most part.
const ZSTD_LEVEL: u32 = 3;
/// Messages made at a time, on all threads, while the ones before are written.
const WINDOW: u64 = 16;

/// How one encoding is named in an MCAP file.
struct Dialect {
    profile: &'static str,
    wire: messages::Encoding,
}

impl Dialect {
    fn of(encoding: Encoding) -> Self {
        match encoding {
            Encoding::Ros2 => Self { profile: "ros2", wire: messages::Encoding::Cdr },
            Encoding::Ros1 => Self { profile: "ros1", wire: messages::Encoding::Ros1 },
        }
    }
}

/// An encoded message and its time.
struct Encoded {
    stamp_ns: i64,
    bytes: Vec<u8>,
}

/// Writes the drive of log number `log` (an index into [`Options::logs`]) as MCAP.
///
/// [`PACKETS_TOPIC`] carries a `VelodyneScan` per turn's worth of packets, stamped and logged with
/// the stamp of its last packet as `velodyne_driver` does; [`POSE_TOPIC`] a `PoseStamped` at 20 Hz
/// from before the first firing until after the last. The bytes depend on the campus and the log's
/// number alone, not on the number of threads; memory does not grow with the number of messages.
pub fn write_drive<W: Write + Seek>(
    campus: &Campus,
    log: usize,
    out: W,
) -> Result<DriveSummary, SimulateError> {
    let options = campus.options();
    if options.logs.len() <= log {
        return Err(SimulateError::NoSuchLog { log, n_logs: options.logs.len() });
    }
    let drive = campus.drive(log);
    let sensor = Sensor::new(options);
    let dialect = Dialect::of(options.encoding);
    let n_messages = n_messages(options);

    let mut writer = LogWriter::new(out, campus, log, &dialect)?;
    let window = |from: u64| -> Vec<Encoded> {
        (from..n_messages.min(from + WINDOW))
            .into_par_iter()
            .map(|message| {
                let mut noise = Random::new(campus.seed(), Purpose::Noise, log, message);
                let packets = sensor.packets(drive, message, &mut noise);
                let stamp_ns = packets.last().map_or(0, |(stamp_ns, _)| *stamp_ns);
                let bytes =
                    ros::write_velodyne_scan(dialect.wire, SENSOR_FRAME, stamp_ns, &packets);
                Encoded { stamp_ns, bytes }
            })
            .collect()
    };
    let mut poses = poses(drive, &dialect).peekable();
    let mut from = 0;
    let mut ready = window(from);
    while !ready.is_empty() {
        from += WINDOW;
        let mut next = Vec::new();
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| next = window(from));
            for scan in &ready {
                while let Some(pose) = poses.next_if(|pose| pose.stamp_ns <= scan.stamp_ns) {
                    writer.write_pose(&pose)?;
                }
                writer.write_scan(scan)?;
            }
            Ok::<(), SimulateError>(())
        })?;
        ready = next;
    }
    for pose in poses {
        writer.write_pose(&pose)?;
    }
    writer.finish()?;

    let n_packets = n_messages * packets_per_message(options.spin_hz);
    let turned_counts = (n_packets * 12) as f64 * azimuth_step_counts(options.spin_hz);
    Ok(DriveSummary {
        turns: (turned_counts / 36_000.0) as u64,
        packets: n_packets,
        length_m: options.length_m,
        duration_s: options.duration_s(),
    })
}

/// How many whole messages fit into a drive.
pub(crate) fn n_messages(options: &Options) -> u64 {
    let spare_s = options.duration_s() - 2.0 * MARGIN_S;
    (spare_s / message_s(options)).max(0.0) as u64
}

/// The shortest drive that a message fits into \[s\].
pub(crate) fn shortest_s(options: &Options) -> f64 {
    message_s(options) + 2.0 * MARGIN_S
}

const MARGIN_S: f64 = MARGIN_NS as f64 * 1e-9;

/// Time that a message's packets take \[s\].
fn message_s(options: &Options) -> f64 {
    packets_per_message(options.spin_hz) as f64 * PACKET_PERIOD_NS as f64 * 1e-9
}

/// The true poses, from the drive's start to its end.
fn poses<'a>(drive: &'a Drive, dialect: &'a Dialect) -> impl Iterator<Item = Encoded> + 'a {
    (drive.start_ns()..=drive.end_ns()).step_by(POSE_PERIOD_NS as usize).map(|stamp_ns| {
        let pose = drive.pose_at(stamp_ns);
        let (sin, cos) = libm::sincos(pose.heading_rad / 2.0);
        let pose = StampedPose3 {
            stamp_ns,
            position: [pose.x_m, pose.y_m, 0.0],
            orientation: [0.0, 0.0, sin, cos],
        };
        Encoded { stamp_ns, bytes: ros::write_pose_stamped(dialect.wire, MAP_FRAME, &pose) }
    })
}

/// An MCAP file with the two topics.
struct LogWriter<W: Write + Seek> {
    writer: Writer<W>,
    packets: Channel,
    poses: Channel,
}

struct Channel {
    id: u16,
    n_messages: u32,
}

impl<W: Write + Seek> LogWriter<W> {
    fn new(out: W, campus: &Campus, log: usize, dialect: &Dialect) -> Result<Self, SimulateError> {
        let (compression, level) = match campus.options().compression {
            Compression::Zstd => (Some(mcap::Compression::Zstd), ZSTD_LEVEL),
            Compression::Lz4 => (Some(mcap::Compression::Lz4), 0),
            Compression::None => (None, 0),
        };
        let mut writer = WriteOptions::new()
            .profile(dialect.profile)
            .library("loopboost simulate")
            .compression(compression)
            .compression_level(level)
            // With threads of its own Zstandard cuts the input, and gives other bytes.
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .create(out)?;

        let options = serde_json::to_string(campus.options()).expect("options are plain data");
        writer.write_metadata(&Metadata {
            name: "simulate".to_owned(),
            metadata: [
                ("seed", campus.seed().to_string()),
                ("log", campus.options().logs[log].clone()),
                ("options", options),
            ]
            .map(|(key, value)| (key.to_owned(), value))
            .into(),
        })?;

        let mut channel = |topic, message_type| {
            let schema = schemas::of(message_type, dialect.wire).expect("a ROS type has a schema");
            let schema = writer.add_schema(schema.name, schema.encoding, schema.text.as_bytes())?;
            let metadata = Default::default();
            let id = writer.add_channel(schema, topic, dialect.wire.name(), &metadata)?;
            Ok::<_, SimulateError>(Channel { id, n_messages: 0 })
        };
        let packets = channel(PACKETS_TOPIC, MessageType::VelodyneScan)?;
        let poses = channel(POSE_TOPIC, MessageType::PoseStamped)?;
        Ok(Self { writer, packets, poses })
    }

    fn write_scan(&mut self, message: &Encoded) -> Result<(), SimulateError> {
        write(&mut self.writer, &mut self.packets, message)
    }

    fn write_pose(&mut self, message: &Encoded) -> Result<(), SimulateError> {
        write(&mut self.writer, &mut self.poses, message)
    }

    fn finish(mut self) -> Result<(), SimulateError> {
        self.writer.finish()?;
        Ok(())
    }
}

fn write<W: Write + Seek>(
    writer: &mut Writer<W>,
    channel: &mut Channel,
    message: &Encoded,
) -> Result<(), SimulateError> {
    let time = message.stamp_ns as u64;
    let header = MessageHeader {
        channel_id: channel.id,
        sequence: channel.n_messages,
        log_time: time,
        publish_time: time,
    };
    channel.n_messages += 1;
    writer.write_to_known_channel(&header, &message.bytes)?;
    Ok(())
}
