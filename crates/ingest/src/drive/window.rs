//! The pieces of a drive in reading order, grouped into windows that are decoded in parallel.

use crate::drive::topic::{Drive, FilePiece, Topic};

/// Pieces per window, for each thread.
pub(crate) const PIECES_PER_THREAD: usize = 8;

/// The messages of a piece to read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Part {
    Lidar,
    Motion,
    Both,
}

/// The pieces with messages of the topics, in windows that are decoded in parallel.
///
/// Scans wait for the poses around them. Usually these are nearby in the file. In a log that was
/// written topic by topic they are not, so the motion is read first there.
pub(crate) fn windows<'a>(
    drive: &'a Drive<'_>,
    lidar: &Topic,
    pose_topics: &[&Topic],
) -> Vec<(Part, Vec<FilePiece<'a>>)> {
    let n_per_window = PIECES_PER_THREAD * rayon::current_num_threads();
    let in_windows = |part, pieces: &[FilePiece<'a>]| -> Vec<_> {
        pieces.chunks(n_per_window).map(|window| (part, window.to_vec())).collect()
    };
    let with_motion = drive.pieces_with(pose_topics);
    let n_shared = with_motion.iter().filter(|piece| lidar.may_be_in(piece)).count();
    if with_motion.len() < 2 * n_shared + 1 {
        let topics: Vec<&Topic> = [lidar].into_iter().chain(pose_topics.iter().copied()).collect();
        return in_windows(Part::Both, &drive.pieces_with(&topics));
    }
    let mut windows = in_windows(Part::Motion, &with_motion);
    windows.extend(in_windows(Part::Lidar, &drive.pieces_with(&[lidar])));
    windows
}

/// Reports the progress after pieces have been read.
pub(crate) fn report_progress(pieces: &[FilePiece<'_>], progress: &impl Fn(u64)) {
    if let Some(last) = pieces.last() {
        progress(last.end());
    }
}
