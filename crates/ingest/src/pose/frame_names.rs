//! The frames of the poses of a topic: which publishers use it, and where the frame changes.

use std::collections::BTreeMap;

use dataset::StampedPose;
use messages::FrameIds;

/// If the frame changes more often than once in this number of messages on average, several publishers
/// use the topic at the same time.
const MIN_MESSAGES_PER_CHANGE: usize = 10;
/// A frame can change this often without a second publisher, in a log with few poses: to the frame of
/// the map and back, when a localiser starts and stops.
const FEW_CHANGES: usize = 2;

/// The frames of the messages of a topic, in the order in which they appear.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct FrameNames {
    frames: Vec<(FrameIds<'static>, u64)>,
    /// Number of messages of each frame that is not selected.
    not_selected: BTreeMap<String, u64>,
}

impl FrameNames {
    /// Adds a message and returns the number of its frame. It is `None` if `selected` names another
    /// frame.
    pub(crate) fn add(&mut self, ids: &FrameIds<'_>, selected: Option<&str>) -> Option<u32> {
        if !selected.is_none_or(|name| is_selected(ids, name)) {
            *self.not_selected.entry(describe(ids)).or_default() += 1;
            return None;
        }
        Some(self.count(ids, 1))
    }

    fn count(&mut self, ids: &FrameIds<'_>, n: u64) -> u32 {
        let at = match self.frames.iter().position(|(known, _)| known == ids) {
            Some(at) => at,
            None => {
                let [frame_id, child_frame_id] =
                    [&ids.frame_id, &ids.child_frame_id].map(|name| name.to_string().into());
                self.frames.push((FrameIds { frame_id, child_frame_id }, 0));
                self.frames.len() - 1
            }
        };
        self.frames[at].1 += n;
        u32::try_from(at).unwrap_or(u32::MAX)
    }

    /// Adds the messages of a later part of the log. Returns the numbers of its frames in this part.
    pub(crate) fn extend(&mut self, later: Self) -> Vec<u32> {
        for (name, n) in later.not_selected {
            *self.not_selected.entry(name).or_default() += n;
        }
        later.frames.iter().map(|(ids, n)| self.count(ids, *n)).collect()
    }

    /// The name of the first frame, if it has one.
    pub(crate) fn first(&self) -> Option<String> {
        let (ids, _) = self.frames.first()?;
        Some(ids.frame_id.to_string()).filter(|name| !name.is_empty())
    }

    /// Whether the messages come from one frame that `frame_id` can be compared with.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// Number of messages that are not in the selected frame.
    pub(crate) fn n_not_selected(&self) -> u64 {
        self.not_selected.values().sum()
    }

    /// All frames with the numbers of their messages, for people: `` `odom` (20 messages) ``.
    pub(crate) fn list(&self) -> String {
        let used = self.frames.iter().map(|(ids, n)| (describe(ids), *n));
        let others = self.not_selected.iter().map(|(name, n)| (name.clone(), *n));
        let listed: Vec<String> = used
            .chain(others)
            .map(|(name, n)| format!("{name} ({n} message{})", if n == 1 { "" } else { "s" }))
            .collect();
        listed.join(", ")
    }

    /// Whether several publishers use the topic at the same time: ordered by stamp, the frame of the
    /// poses changes back and forth.
    pub(crate) fn are_mixed(poses: &[StampedPose]) -> bool {
        let mut by_stamp: Vec<(i64, u32)> = poses.iter().map(|p| (p.stamp_ns, p.frame)).collect();
        by_stamp.sort_by_key(|(stamp_ns, _)| *stamp_ns);
        let n_changes = by_stamp.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
        FEW_CHANGES < n_changes && poses.len() < MIN_MESSAGES_PER_CHANGE * n_changes
    }
}

/// Whether the option selects the frame of the poses, or the frame whose pose it is.
fn is_selected(ids: &FrameIds<'_>, selected: &str) -> bool {
    let name = selected.trim_start_matches('/');
    name == ids.frame_id || (!name.is_empty() && name == ids.child_frame_id)
}

/// The frames for people: `` `odom` `` or `` `odom` of `base_link` ``.
fn describe(ids: &FrameIds<'_>) -> String {
    match &*ids.child_frame_id {
        "" => format!("`{}`", ids.frame_id),
        child => format!("`{child}` in `{}`", ids.frame_id),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    fn ids(frame_id: &'static str, child: &'static str) -> FrameIds<'static> {
        FrameIds { frame_id: frame_id.into(), child_frame_id: child.into() }
    }

    fn mixed(frames: impl Iterator<Item = (i64, u32)>) -> bool {
        let pose = |(stamp_ns, frame)| StampedPose {
            frame,
            ..StampedPose::new(stamp_ns, Pose2::default())
        };
        FrameNames::are_mixed(&frames.map(pose).collect::<Vec<_>>())
    }

    #[test]
    fn frames_are_numbered_selected_and_listed() {
        let mut first = FrameNames::default();
        assert_eq!(first.add(&ids("odom", "base"), None), Some(0));
        let mut later = FrameNames::default();
        assert_eq!(later.add(&ids("odom", "camera"), None), Some(0));
        assert_eq!(later.add(&ids("odom", "base"), None), Some(1));
        assert_eq!(first.extend(later), [1, 0]);
        assert_eq!(first.list(), "`base` in `odom` (2 messages), `camera` in `odom` (1 message)");
        assert_eq!((first.first().as_deref(), first.len()), (Some("odom"), 2));

        let mut selected = FrameNames::default();
        assert_eq!(selected.add(&ids("odom", "base"), Some("/base")), Some(0));
        assert_eq!(selected.add(&ids("map", ""), Some("odom")), None);
        assert_eq!(selected.add(&ids("odom", ""), Some("odom")), Some(1));
        assert_eq!(selected.n_not_selected(), 1);
    }

    /// Poses in another frame for some time are not two publishers. Two publishers alternate, whether
    /// their messages alternate in the file or are written one after the other.
    #[test]
    fn two_publishers_alternate_in_time() {
        assert!(!mixed((0..100).map(|t| (t, u32::from(t < 40)))));
        assert!(!mixed((0..100).map(|t| (t, u32::from((40..60).contains(&t))))));
        assert!(!mixed((0..4).map(|t| (t, u32::from(t == 1)))));
        assert!(mixed((0..100).map(|t| (t, (t % 2) as u32))));
        assert!(mixed((0..100).map(|t| (t, u32::from(t % 5 == 0)))));
        assert!(mixed((0..100).map(|t| (2 * t, 0)).chain((0..100).map(|t| (2 * t + 1, 1)))));
    }
}
