//! What is observed of one topic: stamps, log times and frames.

use messages::{Source, read_frame_ids, read_stamp_ns};

use crate::observe::frames::{FrameCounts, without_slash};
use crate::observe::stamps::StampObserver;

/// A message with a log time from this on has a stamp of 0 only if it was never stamped \[ns\]. Logs of
/// simulations can start at 0.
const FIRST_REAL_LOG_NS: u64 = 1_000_000_000;

/// What one piece of a log shows of a topic.
#[derive(Debug, Default)]
pub(crate) struct TopicPiece {
    /// Stamp and log time of each message \[ns\].
    pub(crate) stamps: Vec<(i64, u64)>,
    pub(crate) frames: FrameCounts,
    /// Number of messages with the stamp 0.
    pub(crate) n_unstamped: u64,
}

/// What the pieces so far show of a topic.
#[derive(Debug, Default)]
pub(crate) struct TopicObserver {
    pub(crate) stamps: StampObserver,
    pub(crate) frames: FrameCounts,
    pub(crate) n_unstamped: u64,
}

/// The header of a message.
pub(crate) struct SeenHeader {
    /// Whether the message is in the frame that is wanted.
    pub(crate) is_wanted: bool,
    /// Whether the stamp is 0 although the log time shows that the clock did not start at 0.
    pub(crate) is_unstamped: bool,
}

impl TopicPiece {
    /// Adds a message. `None` for transforms, which have no header, and for messages whose header
    /// cannot be read. If one frame is `wanted`, the stamps of other frames are left out. A stamp of 0 is
    /// a time if the clock `starts_at_zero`.
    pub(crate) fn add(
        &mut self,
        source: Source,
        log_ns: u64,
        data: &[u8],
        wanted: Option<&str>,
        starts_at_zero: bool,
    ) -> Option<SeenHeader> {
        let stamp_ns = read_stamp_ns(source, data).ok().flatten()?;
        let mut is_wanted = wanted.is_none();
        if let Some(ids) = read_frame_ids(source, data).ok()? {
            self.frames.add(&ids.frame_id);
            is_wanted |= wanted.is_some_and(|wanted| without_slash(wanted) == ids.frame_id);
        }
        if !is_wanted {
            return Some(SeenHeader { is_wanted, is_unstamped: false });
        }
        let is_unstamped = stamp_ns == 0 && FIRST_REAL_LOG_NS <= log_ns && !starts_at_zero;
        match is_unstamped {
            true => self.n_unstamped += 1,
            false => self.stamps.push((stamp_ns, log_ns)),
        }
        Some(SeenHeader { is_wanted, is_unstamped })
    }
}

impl TopicObserver {
    /// Adds what the next piece shows.
    pub(crate) fn add(&mut self, piece: TopicPiece) {
        for (stamp_ns, log_ns) in piece.stamps {
            self.stamps.add(stamp_ns, log_ns);
        }
        self.frames.merge(piece.frames);
        self.n_unstamped += piece.n_unstamped;
    }
}
