//! Why a log gives nothing.

use std::path::PathBuf;

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
    /// There is nothing in the file.
    #[error("{path} is empty: the recorder wrote nothing, or the copy failed")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file does not start as an MCAP file does.
    #[error(
        "{path} is no MCAP log: it starts with {found}, expected the magic bytes 89 4d 43 41 50 30 0d 0a; convert the recording to MCAP (`loopboost import`, `ros2 bag convert`, `mcap convert`)"
    )]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, hex.
        found: String,
    },
    /// No channel has the topic.
    #[error("{path} has no topic `{topic}`; {remedy}")]
    NoTopic {
        /// The log.
        path: PathBuf,
        /// The topic asked for.
        topic: String,
        /// What to do: the option to set, and to which topics.
        remedy: String,
    },
    /// The topic holds messages that the option cannot use.
    #[error("{path}: topic `{topic}` holds `{found}`, expected {expected}; {remedy}")]
    WrongType {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Schema and encoding found.
        found: String,
        /// The types that would do.
        expected: String,
        /// What to do: the option to set, and to which topics.
        remedy: String,
    },
    /// The pose topic is there but empty, or no message of it could be read.
    #[error(
        "{path}: topic `{topic}` holds no usable pose{detail}; take the poses from elsewhere (`ingest.pose.topic`, `frames` or `wheels`)"
    )]
    NoPoses {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was dropped, or nothing.
        detail: String,
    },
    /// No poses come of the transforms.
    #[error(
        "{path}: there are no poses of frame `{child}` in frame `{parent}`, since {why}; {found}: set `ingest.pose.frames` to two of them"
    )]
    NoFrames {
        /// The log.
        path: PathBuf,
        /// The frame of the map.
        parent: String,
        /// The frame that should move.
        child: String,
        /// What is missing.
        why: &'static str,
        /// The frames there are.
        found: String,
    },
    /// No poses come of the wheels.
    #[error("{path}: no poses can be made of topic `{topic}`")]
    Fuse {
        /// The log.
        path: PathBuf,
        /// The topic of the wheels.
        topic: String,
        /// Why.
        source: fuse::FuseError,
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
        "{path}: topic `{topic}` holds packets of a Velodyne {found} ({evidence}), expected a Velodyne HDL-32E, the only model that can be ingested from packets; name a topic with its point clouds or a planar scan, or take the log out of `ingest.logs`"
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
    /// The sensor has no such beam.
    #[error(
        "{path}: topic `{topic}` has {found}, asked for was {asked}; set one of `ingest.lidar.ring`, `ingest.lidar.elevation_deg` and (packets only) `ingest.lidar.laser` to a beam there is"
    )]
    NoBeam {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What the options ask for.
        asked: String,
        /// The beams there are.
        found: String,
    },
    /// The device clock is to give the time and does not go on.
    #[error(
        "{path}: the device clock in the packets of topic `{topic}` stands still, so that it can give no time; set `ingest.lidar.clock` to \"host\""
    )]
    StillClock {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
    },
    /// The laser that should make the scan returns nothing in the whole log.
    #[error(
        "{path}: laser {laser} (firing order; {elevation_deg:.2} deg) of topic `{topic}` has no return in any of {n_firings} firings: it is dead or masked; set `ingest.lidar.laser` to another (with returns: {alive})"
    )]
    DeadLaser {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The laser, in firing order.
        laser: usize,
        /// Its elevation \[deg\].
        elevation_deg: f64,
        /// How often it fired.
        n_firings: u64,
        /// Lasers that have returns.
        alive: String,
    },
}
