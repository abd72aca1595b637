//! Reads scans and poses from MCAP logs.
//!
//! ```text
//! log.mcap ──mcap──► messages ──velodyne──► revolutions ──┐
//!                         ├─────scan (clouds, planar)─────┼──deskew──► scans
//!                         └─────pose──► readings──────────┴──────────► trajectory
//! ```
//!
//! A log is read piece by piece, several pieces in parallel, so the memory use does not grow with the
//! log. Only the topics in the options are decoded, and only chunks with these topics are decompressed. A
//! drive that was recorded as several files is read as one log.
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
mod time_unit;
mod types;
mod velodyne;
mod wheel_options;

use dataset::Scan;
use rayon::prelude::*;

pub use crate::mcap::bytes::FileState;
pub use crate::mcap::definitions::Channel;
pub use crate::mcap::log::{Contents, Log};
pub use deskew::motion::LidarSpeed;
pub use drive::split::{DriveFiles, MetadataError, group_files};
pub use error::{IngestError, NoScansReason};
pub use messages::MessageType;
pub use messages::hdl32e::HORIZONTAL_LASER;
pub use options::{Clock, LidarOptions, Options};
pub use pose::file::PoseFileError;
pub use pose::frames::LookupError;
pub use pose::only::read_poses;
pub use pose::reference::{Fix, ReferenceMessages, ReferenceTopic, read_references};
pub use pose::wheel_error::WheelError;
pub use pose_options::{Frames, Jumps, Origin, PlanarPose, PoseOptionError, PoseOptions};
pub use scan::assemble::Ingested;
pub use stamp::Stamp;
pub use survey::gather::survey;
pub use survey::report::{
    ClockSurvey, CloudsSurvey, Content, FrameSurvey, JointsSurvey, PacketsSurvey, PosesSurvey,
    ScansSurvey, StampSurvey, Survey, TopicSurvey, TransformSurvey,
};
pub use time_unit::TimeUnit;
pub use types::{FRAME_TYPES, IMU_TYPES, LIDAR_TYPES, POSE_TYPES, WHEEL_TYPES};
pub use wheel_options::{WheelSpeedUnit, WheelsTopic};

use crate::mcap::chunk::Buffer;
use drive::structure::StructureCheck;
use drive::topic::{Drive, FilePiece, Topic};
use drive::window::{Part, report_progress, windows};
use pose::topics::PoseTopics;
use scan::assemble::Assembler;
use scan::beam::Beam;
use scan::decode::{Decoded, Reader};

/// Reads a drive from one log, or from several logs that it was split into. Passes its scans to
/// `take` in batches, in order, and returns the rest.
///
/// `progress` is called with the number of bytes read so far.
///
/// A log that another program writes meanwhile is an error.
pub fn ingest<E: From<IngestError> + Send>(
    logs: &[&Log],
    options: &Options,
    take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    read_unchanged(logs, options, None, take, progress)
}

/// Reads the scans of a log as [`ingest`] does, but without its poses, and deskews them by these speeds of the lidar, for
/// example from scan matching. There is one speed for each scan that `ingest` passes on with the same options, in
/// the same order. A scan without one is not deskewed. The trajectory is empty.
pub fn ingest_with_speeds<E: From<IngestError> + Send>(
    logs: &[&Log],
    options: &Options,
    speeds: &[Option<LidarSpeed>],
    take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    let options = Options { pose: None, ..options.clone() };
    read_unchanged(logs, &options, Some(speeds), take, progress)
}

fn read_unchanged<E: From<IngestError> + Send>(
    logs: &[&Log],
    options: &Options,
    speeds: Option<&[Option<LidarSpeed>]>,
    take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    let ingested = read(logs, options, speeds, take, progress);
    // A change is the cause of any other error.
    logs.iter().try_for_each(|log| log.check_unchanged())?;
    ingested
}

fn read<E: From<IngestError> + Send>(
    logs: &[&Log],
    options: &Options,
    speeds: Option<&[Option<LidarSpeed>]>,
    mut take: impl FnMut(Vec<Scan>) -> Result<(), E> + Send,
    progress: impl Fn(u64),
) -> Result<Ingested, E> {
    let drive = Drive::new(logs);
    let mut structure = StructureCheck::new(&drive);
    let names = topic_names(options);
    structure.check_topics(&names)?;
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
    let reader = Reader { drive: &drive, lidar: &lidar, pose_topics: &pose_topics, beam, options };
    let decode_window = |(part, window): &(Part, Vec<FilePiece<'_>>)| -> Vec<Decoded> {
        window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| reader.decode(piece, *part, buffer))
            .collect()
    };
    let mut assembler = Assembler::new(options, beam, losses);
    if let Some(PoseTopics::File(_, poses)) = &pose {
        assembler.add_poses(poses.clone());
    }
    if let Some(speeds) = speeds {
        assembler.deskew_by(speeds);
    }
    let mut scan_stamps = None;
    let mut take = |scans: Vec<Scan>| {
        scan_stamps = with_stamps(scan_stamps, &scans);
        take(scans)
    };
    // The pieces of a window are decoded in parallel. They are assembled in file order while the
    // next window is decoded.
    let mut decoded = windows.first().map(decode_window).unwrap_or_default();
    for (k, (_, window)) in windows.iter().enumerate() {
        let next = windows.get(k + 1);
        let shown = decoded.iter_mut().map(|piece| std::mem::take(&mut piece.structure));
        shown.for_each(|piece| structure.add(&drive, piece));
        structure.check_topics(&names)?;
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
        report_progress(window, &progress);
    }
    assembler.check_message_count(drive.n_messages(&topics));
    structure.check_topics(&names)?;
    assembler.add_losses(structure.losses());
    let ingested = assembler.finish(&drive.path(), &lidar, pose.as_ref(), &mut take)?;
    if let (Some(PoseTopics::File(topic, _)), Some(options)) = (&pose, &options.pose) {
        check_overlap(&topic.name, &ingested, scan_stamps, options)?;
    }
    Ok(ingested)
}

/// Checks that the poses of a file and the scans have times in common.
fn check_overlap(
    file: &str,
    ingested: &Ingested,
    scan_stamps: Option<(i64, i64)>,
    options: &PoseOptions,
) -> Result<(), IngestError> {
    let poses = ingested.trajectory.poses();
    let pose_stamps = poses.first().zip(poses.last()).map(|(a, b)| (a.stamp_ns, b.stamp_ns));
    pose::file::check_overlap(pose_stamps, scan_stamps, options.file_time_unit)
        .map_err(|source| IngestError::PoseFile { path: file.into(), source })
}

/// The first and the last stamp of scans, with those of more scans \[ns\].
fn with_stamps(stamps: Option<(i64, i64)>, scans: &[Scan]) -> Option<(i64, i64)> {
    let all = scans.iter().map(|scan| (scan.stamp_ns, scan.stamp_ns)).chain(stamps);
    all.reduce(|(first, last), (from, to)| (first.min(from), last.max(to)))
}

/// The topics that the options name.
fn topic_names(options: &Options) -> Vec<&str> {
    let pose = options.pose.iter().flat_map(|pose| {
        let wheels = pose.wheels.iter().map(|wheels| &wheels.topic);
        let single = pose.topic.iter().chain(&pose.imu).chain(wheels);
        single.chain(pose.frames.iter().flat_map(|frames| &frames.topics))
    });
    [&options.lidar.topic].into_iter().chain(pose).map(String::as_str).collect()
}
