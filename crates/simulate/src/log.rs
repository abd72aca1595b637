//! Writes a drive as an MCAP log.

use std::io::{Seek, Write};

use dataset::Pose2;
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use messages::{MessageType, StampedPose3, Transform, ros, schemas};
use rayon::prelude::*;

use crate::campus::Campus;
use crate::drive::{Drive, MARGIN_NS, Motion, SENSOR_HEIGHT_M};
use crate::random::{Purpose, Random};
use crate::robot::{IMU_PERIOD_NS, ImuSensor, WHEELS_PERIOD_NS, Wheels};
use crate::sensor::{Sensor, azimuth_step_counts, packet_period_ns, packets_per_message};
use crate::{Compression, Encoding, Options, SimulateError};

/// Topic of the lidar packets.
pub const PACKETS_TOPIC: &str = "/velodyne_packets";
/// Topic of the ground-truth poses.
pub const POSE_TOPIC: &str = "/ground_truth";
/// Topic of the inertial measurement unit (IMU).
pub const IMU_TOPIC: &str = "/imu/data";
/// Topic of the wheel speeds.
pub const WHEELS_TOPIC: &str = "/wheel_states";
/// Topic of the dynamic transforms.
pub const TF_TOPIC: &str = "/tf";
/// Topic of the static transforms.
pub const TF_STATIC_TOPIC: &str = "/tf_static";
const MAP_FRAME: &str = "map";
const ODOM_FRAME: &str = "odom";
const BASE_FRAME: &str = "base_link";
const IMU_FRAME: &str = "imu";
const SENSOR_FRAME: &str = "velodyne";
/// Period of the ground-truth poses: 20 Hz \[ns\].
pub const POSE_PERIOD_NS: i64 = 50_000_000;
/// Approximate uncompressed size of a chunk \[bytes\].
const CHUNK_BYTES: u64 = 1 << 20;
/// The default level of Zstandard. Higher levels gain little, because most of the bytes are noise.
const ZSTD_LEVEL: u32 = 3;
/// Number of messages made in parallel while the previous ones are written.
const WINDOW: u64 = 16;

/// Summary of a written file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveSummary {
    /// Number of whole revolutions of the lidar.
    pub revolutions: u64,
    /// Number of data packets.
    pub packets: u64,
    /// Distance driven \[m\].
    pub length_m: f64,
    /// Duration \[s\].
    pub duration_s: f64,
}

/// Profile and message encoding of an MCAP file.
#[derive(Clone, Copy)]
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

/// The topics of a log and their message types.
const TOPICS: [(&str, MessageType); 6] = [
    (PACKETS_TOPIC, MessageType::VelodyneScan),
    (POSE_TOPIC, MessageType::PoseStamped),
    (IMU_TOPIC, MessageType::Imu),
    (WHEELS_TOPIC, MessageType::JointState),
    (TF_TOPIC, MessageType::Tf),
    (TF_STATIC_TOPIC, MessageType::Tf),
];

/// An encoded message.
struct Encoded {
    topic: &'static str,
    stamp_ns: i64,
    bytes: Vec<u8>,
    n_packets: u64,
}

/// Writes one file of the drive of a log as MCAP. `log` is an index into [`Options::logs`], and `file`
/// is less than [`Options::files`].
///
/// [`PACKETS_TOPIC`] has one `VelodyneScan` per revolution. As with `velodyne_driver`, its header
/// stamp and its log time are the stamp of its last packet. The other topics start a little before
/// the packets and end a little after them: [`POSE_TOPIC`] at 20 Hz, [`IMU_TOPIC`] at 100 Hz,
/// [`WHEELS_TOPIC`] and [`TF_TOPIC`] at 50 Hz. Every file starts with [`TF_STATIC_TOPIC`]. The bytes
/// do not depend on the number of threads. Memory use does not grow with the number of messages.
pub fn write_drive<W: Write + Seek>(
    campus: &Campus,
    log: usize,
    file: u32,
    out: W,
) -> Result<DriveSummary, SimulateError> {
    let options = campus.options();
    if options.logs.len() <= log || options.files <= file {
        let n_logs = options.logs.len();
        return Err(SimulateError::NoSuchLog { log, n_logs, file, n_files: options.files });
    }
    let drive = campus.drive(log);
    let sensor = Sensor::new(options);
    let dialect = Dialect::of(options.encoding);
    let (first, end) = (first_message(options, file), first_message(options, file + 1));
    let range = TimeRange::of(drive, options, file);

    let mut writer = LogWriter::new(out, campus, log, file, dialect)?;
    let window = |from: u64| -> Vec<Encoded> {
        (from..end.min(from + WINDOW))
            .into_par_iter()
            .map(|message| {
                let mut noise = Random::new(campus.seed(), Purpose::Noise, log, message);
                let packets = sensor.packets(drive, message, &mut noise);
                // The stamp of the message if all of its packets are lost.
                let n = (message + 1) * packets_per_message(options);
                let stamp_ns = drive.first_firing_ns() + n as i64 * packet_period_ns(options);
                let stamp_ns = packets.last().map_or(stamp_ns, |(stamp_ns, _)| *stamp_ns);
                let bytes =
                    ros::write_velodyne_scan(dialect.wire, SENSOR_FRAME, stamp_ns, &packets);
                let n_packets = packets.len() as u64;
                Encoded { topic: PACKETS_TOPIC, stamp_ns, bytes, n_packets }
            })
            .collect()
    };
    let mut robot = robot_messages(campus, log, range, dialect).peekable();
    let mut packets = 0;
    let mut from = first;
    let mut ready = window(from);
    while !ready.is_empty() {
        from += WINDOW;
        let mut next = Vec::new();
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| next = window(from));
            for scan in &ready {
                while let Some(message) = robot.next_if(|m| m.stamp_ns <= scan.stamp_ns) {
                    writer.write(&message)?;
                }
                writer.write(scan)?;
                packets += scan.n_packets;
            }
            Ok::<(), SimulateError>(())
        })?;
        ready = next;
    }
    for message in robot {
        writer.write(&message)?;
    }
    writer.finish()?;

    let n_firings = (end - first) as f64 * message_s(options) / (BLOCK_NS as f64 * 1e-9);
    let turned_counts = n_firings.round() * azimuth_step_counts(options.spin_hz);
    let n_files = f64::from(options.files);
    Ok(DriveSummary {
        revolutions: (turned_counts / 36_000.0) as u64,
        packets,
        length_m: options.length_m / n_files,
        duration_s: options.duration_s() / n_files,
    })
}

const BLOCK_NS: i64 = messages::hdl32e::BLOCK_PERIOD_NS;

/// Number of whole messages in a drive.
pub(crate) fn n_messages(options: &Options) -> u64 {
    let spare_s = options.duration_s() - 2.0 * MARGIN_S;
    (spare_s / message_s(options)).max(0.0) as u64
}

/// The first message of a file. For `file` = [`Options::files`] it is the number of all messages.
fn first_message(options: &Options, file: u32) -> u64 {
    n_messages(options) * u64::from(file) / u64::from(options.files)
}

/// Duration of the shortest drive with one message \[s\].
pub(crate) fn shortest_s(options: &Options) -> f64 {
    message_s(options) + 2.0 * MARGIN_S
}

const MARGIN_S: f64 = MARGIN_NS as f64 * 1e-9;

/// Duration of the packets of a message \[s\].
pub(crate) fn message_s(options: &Options) -> f64 {
    packets_per_message(options) as f64 * packet_period_ns(options) as f64 * 1e-9
}

/// Time range of the messages of a file, except packets: `from_ns` is included, `to_ns` is not.
#[derive(Clone, Copy)]
struct TimeRange {
    from_ns: i64,
    to_ns: i64,
}

impl TimeRange {
    fn of(drive: &Drive, options: &Options, file: u32) -> Self {
        // The log time of a message is the end of its last packet.
        let border_ns = |file: u32| match file {
            0 => drive.start_ns(),
            n if n == options.files => drive.end_ns() + 1,
            n => {
                let n_packets = first_message(options, n) * packets_per_message(options);
                drive.first_firing_ns() + n_packets as i64 * packet_period_ns(options) + 1
            }
        };
        Self { from_ns: border_ns(file), to_ns: border_ns(file + 1) }
    }
}

/// All messages except packets, in order of time.
fn robot_messages<'a>(
    campus: &'a Campus,
    log: usize,
    TimeRange { from_ns, to_ns }: TimeRange,
    dialect: Dialect,
) -> impl Iterator<Item = Encoded> + 'a {
    let (options, seed, drive) = (campus.options(), campus.seed(), campus.drive(log));
    let mut wheels = Wheels::new(drive, &options.wheels, seed, log);
    let mut imu = ImuSensor::new(drive, &options.imu, seed, log);
    let wire = dialect.wire;
    let first = Encoded {
        topic: TF_STATIC_TOPIC,
        stamp_ns: from_ns,
        bytes: ros::write_tf(wire, &mounted_sensor(options, from_ns)),
        n_packets: 0,
    };
    // Sensor errors accumulate, so readings before the start of the file are simulated as well.
    let ticks = (drive.start_ns()..to_ns).step_by(IMU_PERIOD_NS as usize);
    let later = ticks.flat_map(move |stamp_ns| {
        let passed_ns = stamp_ns - drive.start_ns();
        let encoded = |topic, bytes| Encoded { topic, stamp_ns, bytes, n_packets: 0 };
        let mut messages = Vec::with_capacity(4);
        let reading = imu.read(stamp_ns);
        let is_in_file = from_ns <= stamp_ns;
        if is_in_file {
            messages.push(encoded(IMU_TOPIC, ros::write_imu(wire, IMU_FRAME, &reading)));
        }
        if passed_ns % WHEELS_PERIOD_NS == 0 {
            let reading = wheels.read(stamp_ns);
            if is_in_file {
                let motion = drive.motion_at(stamp_ns);
                let bytes = ros::write_joint_state(wire, BASE_FRAME, &reading);
                messages.push(encoded(WHEELS_TOPIC, bytes));
                let transforms = transforms(&motion, &wheels.odometry, stamp_ns);
                messages.push(encoded(TF_TOPIC, ros::write_tf(wire, &transforms)));
            }
        }
        if is_in_file && passed_ns % POSE_PERIOD_NS == 0 {
            let pose = true_pose(&drive.motion_at(stamp_ns), stamp_ns);
            messages.push(encoded(POSE_TOPIC, ros::write_pose_stamped(wire, MAP_FRAME, &pose)));
        }
        messages
    });
    std::iter::once(first).chain(later)
}

/// Quaternion (x, y, z, w) of a rotation about z, then about the rotated y.
fn orientation(heading_rad: f64, pitch_rad: f64) -> [f64; 4] {
    let (sin, cos) = libm::sincos(heading_rad / 2.0);
    let (pitch_sin, pitch_cos) = libm::sincos(pitch_rad / 2.0);
    [-sin * pitch_sin, cos * pitch_sin, sin * pitch_cos, cos * pitch_cos]
}

/// The ground-truth pose.
fn true_pose(motion: &Motion, stamp_ns: i64) -> StampedPose3 {
    StampedPose3 {
        stamp_ns,
        position: [motion.pose.x_m, motion.pose.y_m, 0.0],
        orientation: orientation(motion.pose.heading_rad, motion.pitch_rad),
    }
}

/// Static transform of the lidar on the base.
fn mounted_sensor(options: &Options, stamp_ns: i64) -> [Transform; 1] {
    // A sensor upside down is rolled by 180 deg about x.
    let rotation = if options.upside_down { [1.0, 0.0, 0.0, 0.0] } else { [0.0, 0.0, 0.0, 1.0] };
    [Transform {
        stamp_ns,
        parent: BASE_FRAME.to_owned(),
        child: SENSOR_FRAME.to_owned(),
        translation: [0.0, 0.0, SENSOR_HEIGHT_M],
        rotation,
    }]
}

/// The transforms map -> odom (drift of the wheel odometry) and odom -> base_link (pose by wheel
/// odometry, with the true pitch).
fn transforms(motion: &Motion, odom_from_base: &Pose2, stamp_ns: i64) -> [Transform; 2] {
    let heading_rad = motion.pose.heading_rad - odom_from_base.heading_rad;
    let (sin, cos) = libm::sincos(heading_rad);
    let Pose2 { x_m, y_m, .. } = *odom_from_base;
    let map_from_odom =
        [motion.pose.x_m - (cos * x_m - sin * y_m), motion.pose.y_m - (sin * x_m + cos * y_m), 0.0];
    let transform = |parent: &str, child: &str, translation, rotation| Transform {
        stamp_ns,
        parent: parent.to_owned(),
        child: child.to_owned(),
        translation,
        rotation,
    };
    let odom_rotation = orientation(odom_from_base.heading_rad, motion.pitch_rad);
    [
        transform(MAP_FRAME, ODOM_FRAME, map_from_odom, orientation(heading_rad, 0.0)),
        transform(ODOM_FRAME, BASE_FRAME, [x_m, y_m, 0.0], odom_rotation),
    ]
}

/// Writer of an MCAP file with all topics.
struct LogWriter<W: Write + Seek> {
    writer: Writer<W>,
    channels: Vec<Channel>,
}

struct Channel {
    topic: &'static str,
    id: u16,
    n_messages: u32,
}

impl<W: Write + Seek> LogWriter<W> {
    fn new(
        out: W,
        campus: &Campus,
        log: usize,
        file: u32,
        dialect: Dialect,
    ) -> Result<Self, SimulateError> {
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
            // With several threads Zstandard splits the input differently, which changes the bytes.
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            .create(out)?;

        let options = serde_json::to_string(campus.options()).expect("options are plain data");
        writer.write_metadata(&Metadata {
            name: "simulate".to_owned(),
            metadata: [
                ("seed", campus.seed().to_string()),
                ("log", campus.options().logs[log].clone()),
                ("file", file.to_string()),
                ("options", options),
            ]
            .map(|(key, value)| (key.to_owned(), value))
            .into(),
        })?;

        let mut channels = Vec::new();
        for (topic, message_type) in TOPICS {
            let schema = schemas::of(message_type, dialect.wire).expect("a ROS type has a schema");
            let schema = writer.add_schema(schema.name, schema.encoding, schema.text.as_bytes())?;
            let metadata = Default::default();
            let id = writer.add_channel(schema, topic, dialect.wire.name(), &metadata)?;
            channels.push(Channel { topic, id, n_messages: 0 });
        }
        Ok(Self { writer, channels })
    }

    fn write(&mut self, message: &Encoded) -> Result<(), SimulateError> {
        let channel = (self.channels.iter_mut())
            .find(|channel| channel.topic == message.topic)
            .expect("every topic has a channel");
        let time = message.stamp_ns as u64;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.n_messages,
            log_time: time,
            publish_time: time,
        };
        channel.n_messages += 1;
        self.writer.write_to_known_channel(&header, &message.bytes)?;
        Ok(())
    }

    fn finish(mut self) -> Result<(), SimulateError> {
        self.writer.finish()?;
        Ok(())
    }
}
