//! The pieces of a drive in the order in which they are read, some at once.

use crate::drive::topic::{Drive, FilePiece, Topic};

/// Pieces decoded between two joins, for each thread.
pub(crate) const PIECES_PER_THREAD: usize = 8;

/// What is read of a piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Part {
    Lidar,
    Motion,
    Both,
}

/// The pieces to read, some at once, in order.
///
/// Scans wait for the poses around them, which most often lie beside them in the file. In a log that
/// was written topic by topic they do not: there what tells of the motion is read before the lidar.
pub(crate) fn windows<'a>(
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
pub(crate) fn forget(pieces: &[FilePiece<'_>], progress: &impl Fn(u64)) {
    for of_file in pieces.chunk_by(|a, b| a.file == b.file) {
        if let Some(last) = of_file.last() {
            last.log.forget_up_to(last.piece.range.end);
            progress(last.end());
        }
    }
}
