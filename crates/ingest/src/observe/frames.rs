//! Counts the frames of the messages of a topic.

use std::collections::BTreeMap;

/// Number of messages in each frame, by frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct FrameCounts {
    counts: BTreeMap<String, u64>,
}

impl FrameCounts {
    /// Counts a message.
    pub(crate) fn add(&mut self, frame_id: &str) {
        match self.counts.get_mut(frame_id) {
            Some(n) => *n += 1,
            None => {
                self.counts.insert(frame_id.to_owned(), 1);
            }
        }
    }

    pub(crate) fn merge(&mut self, other: Self) {
        for (frame_id, n) in other.counts {
            *self.counts.entry(frame_id).or_default() += n;
        }
    }

    /// The frames, in order of their names.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.counts.keys().map(String::as_str)
    }

    /// Number of different frames.
    pub(crate) fn len(&self) -> usize {
        self.counts.len()
    }

    /// Number of messages in a frame.
    pub(crate) fn count(&self, frame_id: &str) -> u64 {
        self.counts.get(frame_id).copied().unwrap_or(0)
    }

    /// The counts without those of one frame.
    pub(crate) fn without(&self, frame_id: &str) -> Self {
        let mut counts = self.counts.clone();
        counts.remove(frame_id);
        Self { counts }
    }

    /// The frames with their numbers of messages, for a sentence.
    pub(crate) fn describe(&self) -> String {
        let plural = |n: u64| if n == 1 { "" } else { "s" };
        let each = self.counts.iter();
        let each = each.map(|(frame, n)| format!("`{frame}` ({n} message{})", plural(*n)));
        each.collect::<Vec<_>>().join(", ")
    }
}

/// The name of a frame without the leading slash that ROS 1 allows.
pub(crate) fn without_slash(frame_id: &str) -> &str {
    frame_id.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_counted_over_pieces() {
        let mut counts = FrameCounts::default();
        counts.add("rear");
        let mut other = FrameCounts::default();
        other.add("front");
        other.add("rear");
        counts.merge(other);
        assert_eq!(counts.describe(), "`front` (1 message), `rear` (2 messages)");
        assert_eq!((counts.len(), counts.count("rear"), counts.count("left")), (2, 2, 0));
    }
}
