//! Reads the poses of a drive without its scans.

use dataset::{Losses, Pose2};
use rayon::prelude::*;

use crate::drive::topic::{Drive, Topic};
use crate::drive::window::{PIECES_PER_THREAD, Part};
use crate::error::IngestError;
use crate::mcap::chunk::Buffer;
use crate::mcap::log::Log;
use crate::options::Options;
use crate::pose::readings::MotionReadings;
use crate::pose::topics::PoseTopics;
use crate::pose::trajectory::{self, PoseSource};
use crate::scan::assemble::Ingested;
use crate::scan::beam::Beam;
use crate::scan::decode::{Decoded, Reader};
use crate::types::LIDAR_TYPES;

/// Reads the poses of a drive and none of its scans: poses besides those that [`ingest`](crate::ingest)
/// reads, such as ground truth. Like those, they are the poses of the lidar.
///
/// Losses and notes are those of the pose topics only. Without `options.pose`, the trajectory is empty. `proceed` is called
/// many times while the log is read. An error of it ends the reading.
pub fn read_poses<E: From<IngestError>>(
    logs: &[&Log],
    options: &Options,
    proceed: impl FnMut() -> Result<(), E>,
) -> Result<Ingested, E> {
    let read = read(logs, options, proceed);
    logs.iter().try_for_each(|log| log.check_unchanged())?;
    read
}

fn read<E: From<IngestError>>(
    logs: &[&Log],
    options: &Options,
    mut proceed: impl FnMut() -> Result<(), E>,
) -> Result<Ingested, E> {
    let Some(pose) = &options.pose else { return Ok(Ingested::default()) };
    let drive = Drive::new(logs);
    let topics = PoseTopics::find(&drive, pose)?;
    let pose_topics = topics.all();
    let lidar = drive.topic(&options.lidar.topic, "ingest.lidar.topic", &LIDAR_TYPES)?;
    let beam = Beam::choose(&drive, &lidar, &options.lidar)?;
    let reader = Reader { drive: &drive, lidar: &lidar, pose_topics: &pose_topics, beam, options };
    let mut motion = MotionReadings::default();
    if let PoseTopics::File(_, poses) = &topics {
        motion.poses = poses.clone();
    }
    let losses = read_motion(&reader, &mut motion, |motion| {
        motion.prune_transforms(pose);
        proceed()
    })?;
    let mut losses = of_topics(&losses, &pose_topics);
    let mut notes: Vec<_> = pose_topics.iter().flat_map(|topic| topic.notes.clone()).collect();
    let is_own_frame = pose.is_own_frame() || (motion.has_fixes() && pose.origin.is_none());
    let path = drive.path();
    let source = PoseSource {
        path: &path,
        topics: &topics,
        options: pose,
        base_from_lidar: options.lidar.mount.map_or(Pose2::default(), |mount| mount.pose()),
        upside_down: options.lidar.upside_down,
    };
    let trajectory = trajectory::trajectory(motion, &source, &mut losses, &mut notes)?;
    Ok(Ingested { trajectory, is_own_frame, losses, notes, ..Ingested::default() })
}

/// Adds all messages of the pose topics of a reader. After each piece of a file, `prune` removes what is not needed. An
/// error of it ends the reading.
pub(crate) fn read_motion<E>(
    reader: &Reader<'_>,
    motion: &mut MotionReadings,
    mut prune: impl FnMut(&mut MotionReadings) -> Result<(), E>,
) -> Result<Losses, E> {
    let mut losses = Losses::default();
    let pieces = reader.drive.pieces_with(reader.pose_topics);
    for window in pieces.chunks(PIECES_PER_THREAD * rayon::current_num_threads()) {
        let decoded: Vec<Decoded> = window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| reader.decode(piece, Part::Motion, buffer))
            .collect();
        for mut piece in decoded {
            motion.take_transforms(&mut piece.motion);
            motion.extend(piece.motion);
            prune(motion)?;
            losses.merge(piece.losses);
        }
    }
    Ok(losses)
}

/// The losses of messages on these topics.
pub(crate) fn of_topics(losses: &Losses, topics: &[&Topic]) -> Losses {
    let mut of_topics = Losses::default();
    for (loss, n) in losses.iter() {
        if topics.iter().any(|topic| loss.subject.topic.as_deref() == Some(&*topic.name)) {
            of_topics.add(loss.clone(), n);
        }
    }
    of_topics
}
