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

mod between;
mod chunk;
mod clock;
mod cloud;
mod decode;
mod deskew;
mod error;
mod fixes;
mod follow;
mod frames;
mod join;
mod log;
mod motion;
mod options;
mod order;
mod planar;
mod pose_options;
mod poses;
mod reckon;
mod record;
mod ring;
mod sensor;
mod straighten;
mod survey;
mod topic;
mod turn;
mod turns;

use dataset::{Dropped, Scan, Trajectory};
use rayon::prelude::*;

pub use error::IngestError;
pub use log::{Channel, Contents, Log};
pub use messages::MessageType;
pub use messages::hdl32e::HORIZONTAL_LASER;
pub use options::{Clock, LidarOptions, OptionError, Options};
pub use pose_options::{Frames, Origin, PlanarPose, PoseOptionError, PoseOptions};
pub use survey::{
    ClockSurvey, CloudsSurvey, Content, PacketsSurvey, PosesSurvey, ScansSurvey, Survey,
    TopicSurvey, TransformSurvey, survey,
};

use chunk::Buffer;
use decode::{Beam, Decoded, Part, Reader};
use join::Joiner;
use motion::PoseTopics;
use topic::{Drive, FilePiece, Topic};

/// What a drive gave besides its scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ingested {
    /// The poses, in order of time.
    pub trajectory: Trajectory,
    /// Whether they are in a map frame of this drive's own: where its wheels were first read, or
    /// where its first satellite fix was.
    pub is_own_frame: bool,
    /// Number of scans handed on.
    pub n_scans: usize,
    /// Turns at the two ends that lie only partly in the log; they are not counted as dropped,
    /// since every recording starts and ends somewhere in a turn.
    pub n_partial_turns: usize,
    /// What was in the log and could not be used.
    pub dropped: Dropped,
    /// What is to be known of the scans, though nothing was lost for it here.
    pub notes: Vec<String>,
}

/// The message types a scan can come from.
pub const LIDAR_TYPES: [MessageType; 6] = [
    MessageType::VelodyneScan,
    MessageType::VelodynePacket,
    MessageType::PointCloud2,
    MessageType::LaserScan,
    MessageType::FoxglovePointCloud,
    MessageType::FoxgloveLaserScan,
];
/// The message types a pose can come from.
pub const POSE_TYPES: [MessageType; 5] = [
    MessageType::PoseStamped,
    MessageType::PoseWithCovarianceStamped,
    MessageType::Odometry,
    MessageType::FoxglovePoseInFrame,
    MessageType::NavSatFix,
];
/// The message types that transforms between frames can come from.
pub const FRAME_TYPES: [MessageType; 2] = [MessageType::Tf, MessageType::FoxgloveFrameTransform];

/// The message types that the speeds of the wheels can come from.
pub const WHEEL_TYPES: [MessageType; 2] = [MessageType::JointState, MessageType::Odometry];
/// The message types that yaw rates can come from.
pub const IMU_TYPES: [MessageType; 1] = [MessageType::Imu];

/// Pieces decoded between two joins, for each thread.
const PIECES_PER_THREAD: usize = 8;

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
    let mut joiner = Joiner::new(options, beam.laser, dropped);
    // The pieces of a window are decoded side by side, and joined in the order of the file while
    // the next window is being decoded.
    let mut decoded = windows.first().map(decode_window).unwrap_or_default();
    for (k, (_, window)) in windows.iter().enumerate() {
        let next = windows.get(k + 1);
        let (joined, next_decoded) = rayon::join(
            || joiner.join(std::mem::take(&mut decoded), &mut take),
            || next.map(decode_window).unwrap_or_default(),
        );
        joined?;
        if let Some(other) = joiner.other_sensor() {
            return Err(IngestError::OtherSensor {
                path: drive.path(),
                topic: lidar.name,
                found: other.name,
                evidence: other.evidence,
            }
            .into());
        }
        if joiner.lacks_clock() {
            return Err(IngestError::StillClock { path: drive.path(), topic: lidar.name }.into());
        }
        decoded = next_decoded;
        forget(window, &progress);
    }
    joiner.expect_messages(drive.n_messages(&topics));
    joiner.finish(&drive.path(), lidar, pose.as_ref(), take)
}

/// The pieces to read, some at once, in order.
///
/// Scans wait for the poses around them, which most often lie beside them in the file. In a log that
/// was written topic by topic they do not: there what tells of the motion is read before the lidar.
fn windows<'a>(
    drive: &'a Drive<'_>,
    lidar: &Topic,
    of_pose: &[&Topic],
) -> Vec<(Part, Vec<FilePiece<'a>>)> {
    let n_at_once = PIECES_PER_THREAD * rayon::current_num_threads();
    let in_windows = |part, pieces: &[FilePiece<'a>]| -> Vec<_> {
        pieces.chunks(n_at_once).map(|window| (part, window.to_vec())).collect()
    };
    let of_motion = drive.pieces_with(of_pose);
    let n_shared = of_motion.iter().filter(|piece| lidar.may_be_in(piece)).count();
    if of_motion.len() < 2 * n_shared + 1 {
        let topics: Vec<&Topic> = [lidar].into_iter().chain(of_pose.iter().copied()).collect();
        return in_windows(Part::Both, &drive.pieces_with(&topics));
    }
    let mut windows = in_windows(Part::Motion, &of_motion);
    windows.extend(in_windows(Part::Lidar, &drive.pieces_with(&[lidar])));
    windows
}

/// Tells that pieces have been read: their pages need not stay in memory.
fn forget(pieces: &[FilePiece<'_>], progress: &impl Fn(u64)) {
    for of_file in pieces.chunk_by(|a, b| a.file == b.file) {
        if let Some(last) = of_file.last() {
            last.log.forget_up_to(last.piece.range.end);
            progress(last.end());
        }
    }
}
