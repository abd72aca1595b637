//! Reads scans and poses from MCAP logs.
//!
//! ```text
//! log.mcap ──mcap──► messages ──velodyne──► revolutions ──┐
//!                         ├─────scan (clouds, planar)─────┼──deskew──► scans
//!                         └─────pose──► readings──────────┴──────────► trajectory
//! ```
//!
//! A log is memory-mapped and read piece by piece, several pieces in parallel, so the memory use
//! does not grow with the log. Only the topics in the options are decoded, and only chunks with these
//! topics are decompressed. A drive that was recorded as several files is read as one log.
//!
//! The result depends only on the bytes of the logs and the options. Pieces are decoded in parallel,
//! but assembled in file order.
//!
//! ```no_run
//! use std::path::Path;
//!
//! use ingest::{IngestError, LidarOptions, Log, Options, PoseOptions};
//!
//! let log = Log::open(Path::new("drive.mcap"))?;
//! let options = Options {
//!     lidar: LidarOptions { topic: "/velodyne_packets".to_owned(), ..LidarOptions::default() },
//!     pose: Some(PoseOptions::of_topic("/odom")),
//! };
//! let mut scans = Vec::new();
//! let take = |batch| {
//!     scans.extend(batch);
//!     Ok::<_, IngestError>(())
//! };
//! let ingested = ingest::ingest(&[&log], &options, take, |_n_bytes| ())?;
//! assert_eq!(scans.len(), ingested.n_scans);
//! # Ok::<(), IngestError>(())
//! ```

mod deskew;
mod drive;
mod error;
mod mcap;
mod observe;
mod options;
mod pose;
mod pose_options;
mod scan;
mod stamp;
mod survey;
mod types;
mod velodyne;
mod wheel_options;

use dataset::Scan;
use rayon::prelude::*;

pub use crate::mcap::log::{Channel, Contents, Log};
pub use drive::split::{DriveFiles, MetadataError, group_files};
pub use error::{IngestError, NoScansReason};
pub use messages::MessageType;
pub use messages::hdl32e::HORIZONTAL_LASER;
pub use options::{Clock, LidarOptions, Options};
pub use pose::frames::LookupError;
pub use pose::wheel_error::WheelError;
pub use pose_options::{Frames, Origin, PlanarPose, PoseOptionError, PoseOptions};
pub use scan::assemble::Ingested;
pub use stamp::Stamp;
pub use survey::gather::survey;
pub use survey::report::{
    ClockSurvey, CloudsSurvey, Content, FrameSurvey, JointsSurvey, PacketsSurvey, PosesSurvey,
    ScansSurvey, Survey, TopicSurvey, TransformSurvey,
};
pub use types::{FRAME_TYPES, IMU_TYPES, LIDAR_TYPES, POSE_TYPES, WHEEL_TYPES};
pub use wheel_options::{WheelSpeedUnit, WheelsTopic};

use crate::mcap::chunk::Buffer;
use drive::topic::{Drive, FilePiece, Topic};
use drive::window::{Part, forget, windows};
use pose::topics::PoseTopics;
use scan::assemble::Assembler;
use scan::beam::Beam;
use scan::decode::{Decoded, Reader};

/// Reads a drive from one log, or from several logs that it was split into. Passes its scans to
/// `take` in batches, in order, and returns the rest.
///
/// `progress` is called with the number of bytes read so far.
pub fn ingest<E: From<IngestError> + Send>(
    logs: &[&Log],
    options: &Options,
    mut take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    let drive = Drive::new(logs);
    let lidar = drive.topic(&options.lidar.topic, "ingest.lidar.topic", &LIDAR_TYPES)?;
    let pose = match &options.pose {
        Some(pose) => Some(PoseTopics::find(&drive, pose)?),
        None => None,
    };
    let beam = Beam::choose(&drive, &lidar, &options.lidar)?;
    let mut losses = drive.losses();
    let pose_topics: Vec<&Topic> = pose.iter().flat_map(PoseTopics::all).collect();
    let topics: Vec<&Topic> = [&lidar].into_iter().chain(pose_topics.iter().copied()).collect();
    topics.iter().for_each(|topic| losses.merge(topic.losses.clone()));
    let windows = windows(&drive, &lidar, &pose_topics);
    let reader = Reader { lidar: &lidar, pose_topics: &pose_topics, beam, options };
    let decode_window = |(part, window): &(Part, Vec<FilePiece<'_>>)| -> Vec<Decoded> {
        window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| reader.decode(piece, *part, buffer))
            .collect()
    };
    let mut assembler = Assembler::new(options, beam, losses);
    // The pieces of a window are decoded in parallel. They are assembled in file order while the
    // next window is decoded.
    let mut decoded = windows.first().map(decode_window).unwrap_or_default();
    for (k, (_, window)) in windows.iter().enumerate() {
        let next = windows.get(k + 1);
        let (added, next_decoded) = rayon::join(
            || assembler.add(std::mem::take(&mut decoded), &mut take),
            || next.map(decode_window).unwrap_or_default(),
        );
        added?;
        if let Some(other) = assembler.other_sensor() {
            return Err(IngestError::OtherSensor {
                path: drive.path(),
                topic: lidar.name,
                found: other.name,
                evidence: other.evidence,
            }
            .into());
        }
        if assembler.lacks_clock() {
            return Err(IngestError::StillClock { path: drive.path(), topic: lidar.name }.into());
        }
        decoded = next_decoded;
        forget(window, &progress);
    }
    assembler.check_message_count(drive.n_messages(&topics));
    assembler.finish(&drive.path(), &lidar, pose.as_ref(), take)
}
