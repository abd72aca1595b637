//! `ingest`: the bytes of a log -> scans and poses.
//!
//! ```text
//! log.mcap ──log──► pieces ──chunk──► messages ──ring──► packets ──order──► turns ──► scans
//!                                              ├─cloud──────────────────────────────► scans
//!                                              ├─planar─────────────────────────────► scans
//!                                              └─motion─► trajectory
//! ```
//!
//! A log is memory-mapped and read piece by piece, some pieces at once, so that memory does not
//! grow with it. Topics that nobody asked for are not decoded, and chunks that hold none of the
//! topics asked for are not decompressed. A drive that was recorded as several files is read as one
//! log.
//!
//! The result depends on the logs' bytes and the options alone: pieces are decoded in parallel but
//! joined in the order of the file.

mod deskew;
mod drive;
mod error;
mod mcap;
mod options;
mod pose;
mod pose_options;
mod scan;
mod survey;
mod types;
mod velodyne;

use dataset::Scan;
use rayon::prelude::*;

pub use crate::mcap::log::{Channel, Contents, Log};
pub use error::IngestError;
pub use messages::MessageType;
pub use messages::hdl32e::HORIZONTAL_LASER;
pub use options::{Clock, LidarOptions, OptionError, Options};
pub use pose_options::{Frames, Origin, PlanarPose, PoseOptionError, PoseOptions};
pub use scan::assemble::Ingested;
pub use survey::gather::survey;
pub use survey::report::{
    ClockSurvey, CloudsSurvey, Content, PacketsSurvey, PosesSurvey, ScansSurvey, Survey,
    TopicSurvey, TransformSurvey,
};
pub use types::{FRAME_TYPES, IMU_TYPES, LIDAR_TYPES, POSE_TYPES, WHEEL_TYPES};

use crate::mcap::chunk::Buffer;
use drive::topic::{Drive, FilePiece, Topic};
use drive::window::{Part, forget, windows};
use pose::trajectory::PoseTopics;
use scan::assemble::Assembler;
use scan::beam::Beam;
use scan::decode::{Decoded, Reader};

/// Reads a drive, one log or several that were split from one: hands its scans to `take` in order,
/// a batch at a time, and returns the rest.
///
/// `progress` is told how many bytes of the files have been read.
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
    let mut dropped = drive.dropped();
    let of_pose: Vec<&Topic> = pose.iter().flat_map(PoseTopics::all).collect();
    let topics: Vec<&Topic> = [&lidar].into_iter().chain(of_pose.iter().copied()).collect();
    topics.iter().for_each(|topic| dropped.merge(topic.unfit.clone()));
    let windows = windows(&drive, &lidar, &of_pose);
    let reader = Reader { lidar: &lidar, of_pose: &of_pose, beam, options };
    let decode_window = |(part, window): &(Part, Vec<FilePiece<'_>>)| -> Vec<Decoded> {
        window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| reader.decode(piece, *part, buffer))
            .collect()
    };
    let mut assembler = Assembler::new(options, beam.laser, dropped);
    // The pieces of a window are decoded side by side, and joined in the order of the file while
    // the next window is being decoded.
    let mut decoded = windows.first().map(decode_window).unwrap_or_default();
    for (k, (_, window)) in windows.iter().enumerate() {
        let next = windows.get(k + 1);
        let (joined, next_decoded) = rayon::join(
            || assembler.join(std::mem::take(&mut decoded), &mut take),
            || next.map(decode_window).unwrap_or_default(),
        );
        joined?;
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
    assembler.expect_messages(drive.n_messages(&topics));
    assembler.finish(&drive.path(), lidar, pose.as_ref(), take)
}
