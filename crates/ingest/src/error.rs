//! Errors that stop the ingestion of a log.

use std::fmt;
use std::path::PathBuf;

use dataset::Losses;

use crate::pose::file::PoseFileError;
use crate::pose::frames::LookupError;
use crate::pose::wheel_error::WheelError;

/// Why a log cannot be ingested.
#[derive(Debug, thiserror::Error)]
pub enum IngestError {
    /// The file cannot be opened or read.
    #[error("cannot read {path}")]
    Open {
        /// The log.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// Another program wrote to the file while it was read.
    #[error(
        "{path} was changed while it was read: {change}; wait until the recorder or the copy has finished, then run the command again"
    )]
    Changed {
        /// The log.
        path: PathBuf,
        /// What changed.
        change: String,
    },
    /// The file defines a channel twice, with different topics or types.
    #[error(
        "{path} defines channel {channel} twice, as {definitions}: its messages cannot be assigned to a topic; check the file with `mcap doctor`, and join recordings with `mcap merge`, which gives each channel its own id"
    )]
    RedefinedChannel {
        /// The log.
        path: PathBuf,
        /// The id of the channel.
        channel: u16,
        /// Topic and type of both definitions.
        definitions: String,
    },
    /// The file is empty.
    #[error("{path} is empty: the recorder wrote nothing, or the copy failed")]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The file does not start with the magic bytes of MCAP.
    #[error("{path} is not an MCAP file: it {found}; {remedy}")]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// What the file is or contains, as the end of a sentence.
        found: String,
        /// What to do.
        remedy: String,
    },
    /// No channel has the topic.
    #[error("{path} has no topic `{topic}`; {remedy}")]
    NoTopic {
        /// The log.
        path: PathBuf,
        /// The topic in the options.
        topic: String,
        /// What to do: the option to set, and the topics to choose from.
        remedy: String,
    },
    /// The messages of the topic have an unsuitable type.
    #[error("{path}: topic `{topic}` contains `{found}`, expected {expected}; {remedy}")]
    WrongType {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Schema and encoding found.
        found: String,
        /// The suitable types.
        expected: String,
        /// What to do: the option to set, and the topics to choose from.
        remedy: String,
    },
    /// The pose topic has no messages, or none that can be used.
    #[error(
        "{path}: topic `{topic}` has no usable pose{}; use another source of poses (`ingest.pose.topic`, `frames` or `wheels`)",
        in_parentheses(losses)
    )]
    NoPoses {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was dropped.
        losses: Losses,
    },
    /// The trajectory file cannot be used.
    #[error("{path}")]
    PoseFile {
        /// The trajectory file.
        path: PathBuf,
        /// Why.
        source: PoseFileError,
    },
    /// The poses of a topic come from several publishers.
    #[error(
        "{path}: several publishers use topic `{topic}` at the same time: {frames}; set `ingest.pose.frame_id` to the frame of one of them"
    )]
    SeveralPoseFrames {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The frames with the numbers of their messages.
        frames: String,
    },
    /// No pose of the topic is in the selected frame.
    #[error(
        "{path}: topic `{topic}` has no pose in frame `{selected}`, it has {frames}; set `ingest.pose.frame_id` to one of these frames"
    )]
    NoPoseFrame {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The frame in the options.
        selected: String,
        /// The frames with the numbers of their messages.
        frames: String,
    },
    /// The poses cannot be the path of one robot.
    #[error(
        "{path}: the poses of topic `{topic}` are not the path of one robot: {n_contradictory} of {n_poses} jump away from the poses before; check whether two publishers use the topic and whether the stamps of the poses are right, or use another source of poses"
    )]
    ContradictoryPoses {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Number of poses that jump.
        n_contradictory: usize,
        /// Number of poses.
        n_poses: usize,
    },
    /// The transforms do not give poses.
    #[error(
        "{path}: no poses of frame `{child}` in frame `{parent}`; the transforms contain {found}{}; set `ingest.pose.frames` to two connected frames",
        in_parentheses(losses)
    )]
    NoFrames {
        /// The log.
        path: PathBuf,
        /// The frame of the map.
        parent: String,
        /// The frame that should move.
        child: String,
        /// The frames in the log.
        found: String,
        /// The transforms that were dropped.
        losses: Losses,
        /// What is wrong.
        source: LookupError,
    },
    /// The wheel samples do not give poses.
    #[error("{path}: cannot fuse poses from topic `{topic}`")]
    Fuse {
        /// The log.
        path: PathBuf,
        /// The topic of the wheels.
        topic: String,
        /// Why.
        source: fuse::FuseError,
    },
    /// Wheels and IMU contradict each other or the options.
    #[error("{path}: no poses from topic `{topic}`")]
    Wheels {
        /// The log.
        path: PathBuf,
        /// The topic of the wheels.
        topic: String,
        /// Why.
        source: WheelError,
    },
    /// The lidar topic gives no scan.
    #[error(
        "{path}: topic `{topic}` gives no scan{reason}{}; correct the driver, set `ingest.lidar.topic` to another topic, or remove the log from `ingest.logs`",
        if *is_mixed { "; its packets seem to come from more than one sensor" } else { "" }
    )]
    NoScans {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Why there is none.
        reason: NoScansReason,
        /// Whether the packets seem to come from more than one sensor.
        is_mixed: bool,
    },
    /// All stamps are 0, or all are equal.
    #[error(
        "{path}: all {n_messages} messages of topic `{topic}` have the stamp {stamp_ns} ns in their header, so their times are not known; set `{option} = \"log\"` to use log times"
    )]
    NoStamps {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Number of messages.
        n_messages: u64,
        /// The stamp \[ns\].
        stamp_ns: i64,
        /// The option that selects log times.
        option: &'static str,
    },
    /// Several sensors publish on the topic.
    #[error(
        "{path}: topic `{topic}` has messages of several frames: {frames}; set `{option}` to one of them"
    )]
    SeveralFrames {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The frames, with their numbers of messages.
        frames: String,
        /// The option that selects a frame.
        option: &'static str,
    },
    /// No message has the selected frame.
    #[error(
        "{path}: topic `{topic}` has no message of the frame `{requested}`, it has {frames}; set `{option}` to one of these frames"
    )]
    FrameNotOnTopic {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The frame in the options.
        requested: String,
        /// The frames, with their numbers of messages.
        frames: String,
        /// The option that selects a frame.
        option: &'static str,
    },
    /// The packets come from several sensors that cannot be distinguished.
    #[error(
        "{path}: topic `{topic}` has packets of two sensors in one frame ({evidence}); record each sensor on its own topic, or set a different frame_id in each driver"
    )]
    SeveralSensors {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The device clocks.
        evidence: String,
    },
    /// The readings of the lidar give no return, or are not in metres.
    #[error(
        "{path}: topic `{topic}` gives no usable ranges: {evidence}; correct the driver or the limits, or set `ingest.lidar.topic` to another topic"
    )]
    NoReturns {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What was found.
        evidence: String,
    },
    /// The clouds are not in the frame of the sensor.
    #[error(
        "{path}: the clouds of topic `{topic}` are in the frame `{frame_id}`, not in the frame of the lidar: {evidence}; record the clouds as the driver makes them, before they are transformed, or set `ingest.lidar.topic` to such a topic"
    )]
    NotInSensorFrame {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The frame in the header.
        frame_id: String,
        /// What was found.
        evidence: String,
    },
    /// The packets come from another Velodyne model.
    #[error(
        "{path}: topic `{topic}` contains packets of a Velodyne {found} ({evidence}), expected a Velodyne HDL-32E, the only supported model; set `ingest.lidar.topic` to a topic with point clouds or planar scans, or remove the log from `ingest.logs`"
    )]
    OtherSensor {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The model, by name.
        found: &'static str,
        /// What identifies the model.
        evidence: String,
    },
    /// The lidar does not have the selected beam.
    #[error(
        "{path}: topic `{topic}` has no {requested}, it has {available}; set one of `ingest.lidar.ring`, `ingest.lidar.elevation_deg` and (packets only) `ingest.lidar.laser` to an existing beam"
    )]
    NoBeam {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// The beam in the options.
        requested: String,
        /// The beams that exist.
        available: String,
    },
    /// The options use the device clock, but it does not advance.
    #[error(
        "{path}: the device clock in the packets of topic `{topic}` does not advance; set `ingest.lidar.clock` to \"host\""
    )]
    StillClock {
        /// The log.
        path: PathBuf,
        /// The topic.
        topic: String,
    },
    /// The selected laser has no return in the whole log.
    #[error(
        "{path}: laser {laser} (in firing order, {elevation_deg:.2} deg) of topic `{topic}` has no return in {n_firings} firings: it is dead or masked; set `ingest.lidar.laser` to a laser with returns ({alive})"
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
        /// Number of its firings.
        n_firings: u64,
        /// The lasers with returns.
        alive: String,
    },
}

impl IngestError {
    /// A stable name of the error, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Open { .. } => "cannot_open",
            Self::Changed { .. } => "changed_while_read",
            Self::RedefinedChannel { .. } => "redefined_channel",
            Self::Empty { .. } => "empty_file",
            Self::NotMcap { .. } => "not_mcap",
            Self::NoTopic { .. } => "no_topic",
            Self::WrongType { .. } => "wrong_type",
            Self::NoPoses { .. } => "no_poses",
            Self::PoseFile { .. } => "pose_file",
            Self::NoFrames { .. } => "no_frames",
            Self::SeveralPoseFrames { .. } => "several_pose_frames",
            Self::NoPoseFrame { .. } => "no_pose_frame",
            Self::ContradictoryPoses { .. } => "contradictory_poses",
            Self::Fuse { .. } => "cannot_fuse",
            Self::Wheels { source, .. } => source.code(),
            Self::NoScans { .. } => "no_scans",
            Self::NoStamps { .. } => "no_stamps",
            Self::SeveralFrames { .. } => "several_frames",
            Self::FrameNotOnTopic { .. } => "frame_not_on_topic",
            Self::SeveralSensors { .. } => "two_sensors",
            Self::NoReturns { .. } => "no_returns",
            Self::NotInSensorFrame { .. } => "not_in_sensor_frame",
            Self::OtherSensor { .. } => "other_sensor",
            Self::NoBeam { .. } => "no_beam",
            Self::StillClock { .. } => "still_clock",
            Self::DeadLaser { .. } => "dead_laser",
        }
    }
}

/// Why a lidar topic gives no scan.
#[derive(Debug, Clone, PartialEq)]
pub enum NoScansReason {
    /// The packets do not cover a complete revolution.
    LessThanOneRevolution,
    /// Everything was dropped, or there are no messages.
    Losses(Losses),
}

/// The end of a sentence, with the losses in parentheses.
impl fmt::Display for NoScansReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LessThanOneRevolution => {
                f.write_str(": its packets do not cover a complete revolution from azimuth 0 to 0")
            }
            Self::Losses(losses) => f.write_str(&in_parentheses(losses)),
        }
    }
}

/// The lidar does not have the beam that the options select.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BeamNotFound {
    /// The beam in the options.
    pub(crate) requested: String,
    /// The beams that exist.
    pub(crate) available: String,
}

/// What was dropped, for the end of a sentence.
fn in_parentheses(losses: &Losses) -> String {
    match losses.is_empty() {
        true => String::new(),
        false => format!(" (dropped: {losses})"),
    }
}
