//! `ingest`: the bytes of a log -> scans and poses.
//!
//! ```text
//! log.mcap ──log──► pieces ──chunk──► messages ──ring──► firings of one laser ──turns──► scans
//!                                              ├─planar─► scans
//!                                              └─poses──► trajectory
//! ```
//!
//! The log is memory-mapped and read piece by piece, some pieces at once, so that memory does not
//! grow with the log. Topics that nobody asked for are not decoded, and chunks that hold none of
//! the topics asked for are not decompressed.
//!
//! The result depends on the log's bytes and the options alone: pieces are decoded in parallel
//! but joined in the order of the file.

mod chunk;
mod log;
mod planar;
mod poses;
mod ring;
mod turns;

use std::path::PathBuf;

use dataset::{Dropped, Scan, StampedPose, Trajectory};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use log::{Channel, Contents, Log};
pub use messages::ros::MessageType;

use chunk::Buffer;
use log::{Piece, Topic};
use ring::RingPacket;
use turns::{ScanMaker, TurnCutter};

/// Where scans come from; the section `[ingest.lidar]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LidarOptions {
    /// Topic with `VelodyneScan` or `LaserScan` messages; the schema tells which.
    pub topic: String,
    /// Returns nearer than this are left out \[m\].
    pub range_min_m: f64,
    /// Returns farther than this are left out \[m\].
    pub range_max_m: f64,
    /// The sensor hangs upside down: its scans are mirrored, so that y is left again.
    pub upside_down: bool,
    /// A turn that misses more than this for want of packets is dropped and counted \[deg\].
    pub max_hole_deg: f64,
}

impl Default for LidarOptions {
    fn default() -> Self {
        Self {
            topic: "/velodyne_packets".to_owned(),
            range_min_m: 0.9,
            range_max_m: 70.0,
            upside_down: false,
            max_hole_deg: 5.0,
        }
    }
}

/// An option out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`ingest.lidar.{key}` is {found}, expected {expected}")]
pub struct OptionError {
    key: &'static str,
    found: f64,
    expected: &'static str,
}

impl LidarOptions {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionError> {
        let fail = |key, found, expected| Err(OptionError { key, found, expected });
        let (min, max, hole) = (self.range_min_m, self.range_max_m, self.max_hole_deg);
        if !(min.is_finite() && 0.0 <= min) {
            return fail("range_min_m", min, "0 or more");
        }
        if !(max.is_finite() && min < max) {
            return fail("range_max_m", max, "more than `ingest.lidar.range_min_m`");
        }
        if !(0.0..360.0).contains(&hole) {
            return fail("max_hole_deg", hole, "0 or more and less than 360");
        }
        Ok(())
    }
}

/// Where poses come from; the section `[ingest.pose]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PoseOptions {
    /// Topic with `PoseStamped` or `Odometry` messages; the schema tells which.
    pub topic: String,
}

/// What to take from one log.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The lidar.
    pub lidar: LidarOptions,
    /// The poses; none leaves the trajectory empty.
    pub pose: Option<PoseOptions>,
}

/// What a log gave besides its scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ingested {
    /// The poses, in order of time.
    pub trajectory: Trajectory,
    /// Number of scans handed on.
    pub n_scans: usize,
    /// Turns at the log's two ends that lie only partly in the log; they are not counted as
    /// dropped, since every recording starts and ends somewhere in a turn.
    pub n_partial_turns: usize,
    /// What was in the log and could not be used.
    pub dropped: Dropped,
}

/// Why a log gives nothing.
#[derive(Debug, thiserror::Error)]
pub enum IngestError {
    /// The system refused to open or map the file.
    #[error("cannot read {path}")]
    Open {
        /// The log.
        path: PathBuf,
        /// The system's word.
        source: std::io::Error,
    },
    /// The file does not start as an MCAP file does.
    #[error(
        "{path} is no MCAP log: it starts with {found}, expected the magic bytes 89 4d 43 41 50 30 0d 0a; convert the recording to MCAP (`ros2 bag convert`, `mcap convert`)"
    )]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, hex.
        found: String,
    },
    /// No channel has the topic.
    #[error("{path} has no topic `{topic}`; set `{key}` to one of: {topics}")]
    NoTopic {
        /// The log.
        path: PathBuf,
        /// The topic asked for.
        topic: String,
        /// The option that names it.
        key: &'static str,
        /// Topics of the log that would do, or else all of them, with their types.
        topics: String,
    },
    /// The topic holds messages that the option cannot use.
    #[error(
        "{path}: topic `{topic}` holds `{found}`, expected {expected}; set `{key}` to a topic of such a type: {topics}"
    )]
    WrongType {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The option that names it.
        key: &'static str,
        /// Schema and encoding found.
        found: String,
        /// The types that would do.
        expected: &'static str,
        /// Topics of the log that would do.
        topics: String,
    },
    /// The pose topic is there but empty, or no message of it could be read.
    #[error(
        "{path}: topic `{topic}` holds no usable pose{detail}; set `ingest.pose.topic` to a topic that has poses"
    )]
    NoPoses {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was dropped, or nothing.
        detail: String,
    },
    /// Not one scan came out.
    #[error(
        "{path}: topic `{topic}` gives no scan{detail}; set `ingest.lidar.topic` to another topic, or take the log out of `ingest.logs`"
    )]
    NoScans {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was dropped, or nothing.
        detail: String,
    },
    /// The packets are of another sensor.
    #[error(
        "{path}: topic `{topic}` holds packets of a {found} ({evidence}), expected a Velodyne HDL-32E, the only model that can be ingested from packets; take the log out of `ingest.logs`, or name a LaserScan topic"
    )]
    OtherSensor {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The sensor, by name.
        found: &'static str,
        /// What tells so.
        evidence: String,
    },
}

/// The message types a scan can come from.
pub const LIDAR_TYPES: [MessageType; 2] = [MessageType::VelodyneScan, MessageType::LaserScan];
/// The message types a pose can come from.
pub const POSE_TYPES: [MessageType; 2] = [MessageType::PoseStamped, MessageType::Odometry];

/// Pieces decoded between two joins, for each thread.
const PIECES_PER_THREAD: usize = 8;

/// Reads one log: hands its scans to `take` in order, a batch at a time, and returns the rest.
///
/// `progress` is told how many bytes of the file have been read.
pub fn ingest<E: From<IngestError> + Send>(
    log: &Log,
    options: &Options,
    mut take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    let contents = log.contents();
    let lidar = contents.topic(log, &options.lidar.topic, "ingest.lidar.topic", &LIDAR_TYPES)?;
    let pose = match &options.pose {
        Some(pose) => Some(contents.topic(log, &pose.topic, "ingest.pose.topic", &POSE_TYPES)?),
        None => None,
    };
    let mut dropped = contents.dropped.clone();
    dropped.merge(lidar.unfit.clone());
    dropped.merge(pose.as_ref().map(|pose| pose.unfit.clone()).unwrap_or_default());
    let pieces: Vec<&Piece> = contents.pieces_with(&lidar, pose.as_ref());
    let windows: Vec<&[&Piece]> =
        pieces.chunks(PIECES_PER_THREAD * rayon::current_num_threads()).collect();
    let decode_window = |window: &[&Piece]| -> Vec<Decoded> {
        window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| {
                decode(log, piece, &lidar, pose.as_ref(), &options.lidar, buffer)
            })
            .collect()
    };
    let mut joiner = Joiner {
        cutter: TurnCutter::new(options.lidar.max_hole_deg),
        maker: ScanMaker::new(&options.lidar),
        poses: Vec::new(),
        dropped,
        n_scans: 0,
    };
    // The pieces of a window are decoded side by side, and joined in the order of the file while
    // the next window is being decoded.
    let mut decoded = windows.first().map(|window| decode_window(window)).unwrap_or_default();
    for (k, window) in windows.iter().enumerate() {
        let next = windows.get(k + 1);
        let (joined, next_decoded) = rayon::join(
            || joiner.join(std::mem::take(&mut decoded), &mut take),
            || next.map(|window| decode_window(window)).unwrap_or_default(),
        );
        joined?;
        if let Some(other) = joiner.cutter.other_sensor() {
            return Err(IngestError::OtherSensor {
                path: log.path().to_owned(),
                topic: lidar.name.clone(),
                found: other.name,
                evidence: other.evidence,
            }
            .into());
        }
        decoded = next_decoded;
        let end = window.last().map_or(0, |piece| piece.end());
        log.forget_up_to(end);
        progress(end as u64);
    }
    let Joiner { cutter, maker, poses, mut dropped, mut n_scans } = joiner;
    let mut turns = Vec::new();
    let ends = cutter.finish(&mut turns);
    n_scans += turns.len();
    take(turns.par_iter().map(|turn| maker.scan(turn)).collect())?;
    dropped.merge(ends.dropped);

    let detail = |dropped: &Dropped| match dropped.is_empty() {
        true => String::new(),
        false => format!(" (dropped: {dropped})"),
    };
    if n_scans == 0 {
        let detail = match dropped.is_empty() && ends.n_partial > 0 {
            true => {
                ": its packets span less than one turn between two cuts at azimuth 0".to_owned()
            }
            false => detail(&dropped),
        };
        return Err(IngestError::NoScans {
            path: log.path().to_owned(),
            topic: lidar.name,
            detail,
        }
        .into());
    }
    let (trajectory, n_duplicates) = Trajectory::new(poses);
    dropped.add("poses with the stamp of another pose", n_duplicates as u64);
    if let (Some(pose), true) = (pose, trajectory.poses().is_empty()) {
        return Err(IngestError::NoPoses {
            path: log.path().to_owned(),
            topic: pose.name,
            detail: detail(&dropped),
        }
        .into());
    }
    Ok(Ingested { trajectory, n_scans, n_partial_turns: ends.n_partial, dropped })
}

/// Puts together what the pieces hold, in the order of the file.
struct Joiner {
    cutter: TurnCutter,
    maker: ScanMaker,
    poses: Vec<StampedPose>,
    dropped: Dropped,
    n_scans: usize,
}

impl Joiner {
    fn join<E>(
        &mut self,
        decoded: Vec<Decoded>,
        take: &mut impl FnMut(Vec<Scan>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut turns = Vec::new();
        let mut scans = Vec::new();
        for piece in decoded {
            for packet in &piece.packets {
                self.cutter.push(packet, &mut turns);
            }
            scans.extend(piece.scans);
            self.poses.extend(piece.poses);
            self.dropped.merge(piece.dropped);
        }
        scans.par_extend(turns.par_iter().map(|turn| self.maker.scan(turn)));
        self.n_scans += scans.len();
        take(scans)
    }
}

/// What one piece of the log holds.
#[derive(Default)]
struct Decoded {
    packets: Vec<RingPacket>,
    scans: Vec<Scan>,
    poses: Vec<StampedPose>,
    dropped: Dropped,
}

fn decode(
    log: &Log,
    piece: &Piece,
    lidar: &Topic,
    pose: Option<&Topic>,
    options: &LidarOptions,
    buffer: &mut Buffer,
) -> Decoded {
    let mut decoded = Decoded::default();
    let lost = chunk::messages(log.bytes(), piece, buffer, |channel, data| {
        if let Some(source) = lidar.source(channel) {
            let result = match source.message_type {
                MessageType::VelodyneScan => {
                    ring::extract(source.encoding, data, &mut decoded.packets, &mut decoded.dropped)
                }
                _ => planar::scan(source.encoding, data, options)
                    .map(|scan| decoded.scans.push(scan)),
            };
            if let Err(error) = result {
                let (topic, kind) = (&lidar.name, source.message_type.name());
                let reason =
                    format!("messages of {topic} that do not decode as {kind} ({})", error.kind());
                decoded.dropped.add(reason, 1);
            }
        }
        if let Some((topic, source)) = pose.and_then(|t| Some((t, t.source(channel)?))) {
            match poses::stamped_pose(source, data) {
                Ok(stamped) => decoded.poses.push(stamped),
                Err(reason) => {
                    decoded.dropped.add(format!("messages of {} {reason}", topic.name), 1);
                }
            }
        }
    });
    decoded.dropped.merge(lost);
    decoded
}
