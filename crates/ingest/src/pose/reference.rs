//! Absolute references of a drive: satellite fixes or poses of a topic, and the place of the point that they
//! measure on the robot.

use dataset::{Losses, Note, Pose2, StampedPose};
use messages::{MessageType, NavSatFix, read_frame_ids};
use nalgebra::Isometry3;

use crate::drive::topic::{Drive, FilePiece, Topic};
use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::log::Log;
use crate::options::{LidarOptions, Options};
use crate::pose::gnss;
use crate::pose::only::{of_topics, read_motion};
use crate::pose::readings::MotionReadings;
use crate::pose::recorded::planar;
use crate::pose_options::{Origin, PlanarPose, PoseOptions};
use crate::scan::beam::Beam;
use crate::scan::decode::Reader;
use crate::stamp::Stamp;
use crate::types::{FRAME_TYPES, LIDAR_TYPES, POSE_TYPES};

/// The topic of absolute references.
#[derive(Debug, Clone, PartialEq)]
pub struct ReferenceTopic {
    /// The name of the topic.
    pub topic: String,
    /// The frame whose messages are used, see [`PoseOptions::frame_id`].
    pub frame_id: Option<String>,
    /// The time of a message that is used.
    pub stamp: Stamp,
    /// The measured point on the robot, if the options name it.
    pub mount: Option<PlanarPose>,
}

/// A satellite fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    /// Time \[ns\].
    pub stamp_ns: i64,
    /// The position. An unknown altitude is NaN.
    pub position: Origin,
    /// Variance of east, covariance, and variance of north \[m^2\], if the message has them.
    pub covariance: Option<[f64; 3]>,
}

/// The references of a topic.
#[derive(Debug, Default)]
pub struct ReferenceMessages {
    /// Satellite fixes, in the order of time.
    pub fixes: Vec<Fix>,
    /// Poses of the robot, in the order of time. A topic has fixes or poses.
    pub poses: Vec<StampedPose>,
    /// The measured point in the frame of the lidar.
    pub lidar_from_point: Pose2,
    /// Whether the options or the transforms of the log give that point. Otherwise it is the origin of the
    /// robot.
    pub is_point_known: bool,
    /// Messages that cannot be used.
    pub losses: Losses,
    /// Remarks.
    pub notes: Vec<Note>,
}

/// The topics that the place of an antenna is looked up in.
const FRAME_TOPICS: [&str; 2] = ["/tf_static", "/tf"];
/// The pieces of a log that are searched for the frame of the lidar.
const N_FIRST_PIECES: usize = 3;

impl Fix {
    /// The position in a frame with x east and y north of an origin.
    pub fn east_north(&self, origin: &Origin) -> Pose2 {
        let [x_m, y_m] = gnss::east_north(origin, &self.position);
        Pose2 { x_m, y_m, heading_rad: 0.0 }
    }

    fn of_message(fix: &NavSatFix) -> Self {
        let [xx, xy, _, _, yy, ..] = fix.covariance;
        let is_known = xx.is_finite() && yy.is_finite() && xy.is_finite();
        let is_known = is_known && 0.0 < xx && 0.0 < yy && xy * xy < xx * yy;
        let position = Origin {
            latitude_deg: fix.latitude_deg,
            longitude_deg: fix.longitude_deg,
            altitude_m: fix.altitude_m,
        };
        let covariance = is_known.then_some([xx, xy, yy]);
        Self { stamp_ns: fix.stamp_ns, position, covariance }
    }
}

/// Reads the absolute references of a topic of a drive. The poses of the robot are not read.
///
/// The measured point on the robot is that of the options. Without them, a pose is that of the robot, and a fix is that
/// of the frame of its messages, whose place relative to the lidar is looked up in the transforms.
pub fn read_references(
    logs: &[&Log],
    lidar: &LidarOptions,
    reference: &ReferenceTopic,
) -> Result<ReferenceMessages, IngestError> {
    let read = read(logs, lidar, reference);
    logs.iter().try_for_each(|log| log.check_unchanged())?;
    read
}

fn read(
    logs: &[&Log],
    lidar_options: &LidarOptions,
    reference: &ReferenceTopic,
) -> Result<ReferenceMessages, IngestError> {
    let drive = Drive::new(logs);
    let topic = drive.topic(&reference.topic, "optimize.references.topic", &POSE_TYPES)?;
    let lidar = drive.topic(&lidar_options.topic, "ingest.lidar.topic", &LIDAR_TYPES)?;
    let lidar_frame = first_frame_id(&drive, &lidar);
    let is_looked_up = reference.mount.is_none()
        && topic.any(|source| source.message_type == MessageType::NavSatFix);
    // A log may have none of them.
    let frames: Vec<Topic> = FRAME_TOPICS
        .iter()
        .filter(|_| is_looked_up)
        .filter_map(|name| drive.topic(name, "ingest.pose.frames.topics", &FRAME_TYPES).ok())
        .collect();
    let options = Options {
        lidar: lidar_options.clone(),
        pose: Some(PoseOptions {
            frame_id: reference.frame_id.clone(),
            stamp: reference.stamp,
            ..PoseOptions::of_topic(&reference.topic)
        }),
    };
    let topics: Vec<&Topic> = [&topic].into_iter().chain(&frames).collect();
    let beam = Beam::choose(&drive, &lidar, lidar_options)?;
    let reader =
        Reader { drive: &drive, lidar: &lidar, pose_topics: &topics, beam, options: &options };
    let mut motion = MotionReadings::default();
    let losses = read_motion(&reader, &mut motion, |motion| {
        if let (Some(lidar), Some(point)) = (&lidar_frame, motion.frame_names.first()) {
            motion.transforms.prune(lidar, &point);
        }
        Ok::<_, IngestError>(())
    })?;
    let mut losses = of_topics(&losses, &[&topic]);
    losses.merge(topic.losses.clone());
    let base_from_lidar = lidar_options.mount.map_or(Pose2::default(), |mount| mount.pose());
    let in_transforms = || {
        let point = motion.frame_names.first()?;
        let found = motion.transforms.fixed(lidar_frame.as_deref()?, &point)?;
        Some(in_plane(&found, lidar_options.upside_down))
    };
    let lidar_from_point = match reference.mount {
        Some(mount) => Some(base_from_lidar.inverse() * mount.pose()),
        // A pose is that of the robot.
        None if motion.fixes.is_empty() => Some(base_from_lidar.inverse()),
        None => in_transforms(),
    };
    let mut fixes: Vec<Fix> = motion.fixes.iter().map(|(fix, _)| Fix::of_message(fix)).collect();
    fixes.sort_by_key(|fix| fix.stamp_ns);
    let mut poses = motion.poses;
    poses.sort_by_key(|pose| pose.stamp_ns);
    if fixes.is_empty() && poses.is_empty() {
        let (path, topic) = (drive.path(), topic.name);
        return Err(IngestError::NoPoses { path, topic, losses });
    }
    Ok(ReferenceMessages {
        fixes,
        poses,
        lidar_from_point: lidar_from_point.unwrap_or(base_from_lidar.inverse()),
        is_point_known: lidar_from_point.is_some(),
        losses,
        notes: topic.notes,
    })
}

/// A point in the frame of the scans. Those of a lidar that is mounted upside down are mirrored, so that y points
/// left.
fn in_plane(lidar_from_point: &Isometry3<f64>, upside_down: bool) -> Pose2 {
    let Pose2 { x_m, y_m, heading_rad } = planar(lidar_from_point);
    match upside_down {
        true => Pose2 { x_m, y_m: -y_m, heading_rad: -heading_rad },
        false => Pose2 { x_m, y_m, heading_rad },
    }
}

/// The frame of the first message of a topic that names one.
fn first_frame_id(drive: &Drive<'_>, topic: &Topic) -> Option<String> {
    let mut buffer = Buffer::default();
    let mut first: Option<String> = None;
    let pieces = drive.pieces_with(&[topic]);
    for FilePiece { file, log, piece, .. } in pieces.into_iter().take(N_FIRST_PIECES) {
        // Losses are counted when the scans are read.
        chunk::messages(log.bytes(), piece, &mut buffer, |header, data| {
            if first.is_none()
                && let Some(source) = topic.source(file, header.channel_id)
            {
                let ids = read_frame_ids(source, data).ok().flatten();
                first = ids.map(|ids| ids.frame_id.to_string()).filter(|name| !name.is_empty());
            }
        });
        if first.is_some() {
            break;
        }
    }
    first
}
