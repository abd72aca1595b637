//! The topics that poses are computed from.

use std::path::PathBuf;

use dataset::{Loss, Losses, StampedPose, Subject};

use crate::drive::topic::{Drive, Topic};
use crate::error::IngestError;
use crate::pose::file;
use crate::pose_options::PoseOptions;
use crate::types::{FRAME_TYPES, IMU_TYPES, POSE_TYPES, WHEEL_TYPES};

/// The topics that poses are computed from.
pub(crate) enum PoseTopics {
    /// A topic with poses.
    Poses(Topic),
    /// A file with poses. It takes the place of the topic in messages.
    File(Topic, Vec<StampedPose>),
    /// Topics with transforms, at least one.
    Frames(Vec<Topic>),
    /// Topics with wheel and IMU messages.
    Wheels { wheels: Topic, imu: Option<Topic> },
}

impl PoseTopics {
    /// Finds the topics of the options in a drive.
    pub(crate) fn find(drive: &Drive<'_>, options: &PoseOptions) -> Result<Self, IngestError> {
        if let Some(frames) = &options.frames {
            return Self::find_frames(drive, &frames.topics);
        }
        if let Some(file) = &options.file {
            return Self::read_file(drive, file, options);
        }
        let Some(wheels) = &options.wheels else {
            let topic = options.topic.as_deref().unwrap_or_default();
            return Ok(Self::Poses(drive.topic(topic, "ingest.pose.topic", &POSE_TYPES)?));
        };
        let imu = options.imu.as_ref();
        Ok(Self::Wheels {
            wheels: drive.topic(&wheels.topic, "ingest.pose.wheels", &WHEEL_TYPES)?,
            imu: imu.map(|imu| drive.topic(imu, "ingest.pose.imu", &IMU_TYPES)).transpose()?,
        })
    }

    fn read_file(
        drive: &Drive<'_>,
        file: &str,
        options: &PoseOptions,
    ) -> Result<Self, IngestError> {
        let mut losses = Losses::default();
        let path = PathBuf::from(file);
        let poses = file::read(&path, options.file_time_unit, &mut losses)
            .map_err(|source| IngestError::PoseFile { path: path.clone(), source })?;
        let mut topic = drive.no_channels(file);
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        for (loss, n) in losses.iter() {
            topic.losses.add(Loss::new(loss.kind.clone(), Subject::file(name.clone())), n);
        }
        Ok(Self::File(topic, poses))
    }

    /// One of the topics is enough: a log may have no static transforms.
    fn find_frames(drive: &Drive<'_>, names: &[String]) -> Result<Self, IngestError> {
        let mut topics = Vec::new();
        let mut missing = None;
        for name in names {
            match drive.topic(name, "ingest.pose.frames.topics", &FRAME_TYPES) {
                Ok(topic) => topics.push(topic),
                Err(error @ IngestError::NoTopic { .. }) => missing = missing.or(Some(error)),
                Err(error) => return Err(error),
            }
        }
        match missing {
            Some(error) if topics.is_empty() => Err(error),
            _ => Ok(Self::Frames(topics)),
        }
    }

    /// All topics.
    pub(crate) fn all(&self) -> Vec<&Topic> {
        match self {
            Self::Poses(topic) | Self::File(topic, _) => vec![topic],
            Self::Frames(topics) => topics.iter().collect(),
            Self::Wheels { wheels, imu } => [wheels].into_iter().chain(imu).collect(),
        }
    }

    /// The topic without which there are no poses.
    pub(crate) fn main(&self) -> &Topic {
        match self {
            Self::Poses(topic) | Self::File(topic, _) | Self::Wheels { wheels: topic, .. } => topic,
            Self::Frames(topics) => &topics[0],
        }
    }
}
