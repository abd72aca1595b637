//! Transforms between frames -> poses of one frame in another.
//!
//! The frames and transforms form a graph. The chain from the parent frame to the child frame is
//! the shortest path in this graph; each transform can be used in both directions. A transform is
//! valid at all times if it comes from a topic named `..._static`, or if the log contains it only
//! once. All other transforms are interpolated between their samples and never extrapolated.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use dataset::{Loss, LossKind, Losses, NoteKind, StampedPose, Subject};
use messages::Transform;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::pose::chain::{self, ChainLink, ChainPoses, product, stamped};
use crate::pose::message::{check_position, unit_quaternion};
use crate::pose::recorded::RecordedTransform;

/// A transform that moves no more than this in a log is fixed: it is repeated with rounding errors. Metres plus
/// radians.
const MAX_FIXED_M_RAD: f64 = 1e-3;

/// Parent frame and child frame of a transform.
type Edge = (String, String);

/// A transform of a chain.
#[derive(Debug, Clone, PartialEq)]
struct Link {
    edge: Edge,
    /// Whether the chain goes from the child to the parent of this transform.
    is_inverted: bool,
}

/// The transforms of a log.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TransformHistory {
    recorded: BTreeMap<Edge, RecordedTransform>,
    /// Transforms that cannot be used, without the quaternions.
    losses: Losses,
    /// For each transform whose quaternions are not of length 1: their number and the first one.
    without_rotation: BTreeMap<Edge, (u64, String)>,
    /// Whether only the transforms of the chain are kept.
    is_pruned: bool,
    /// Frames of the chain that have a second parent: child, parent in the chain, other parent.
    second_parents: BTreeSet<(String, String, String)>,
}

/// The reason why there are no poses of a frame in another frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LookupError {
    /// No chain of transforms connects the frames.
    #[error("no chain of transforms connects the two frames")]
    NotConnected,
    /// All transforms of the chain are static.
    #[error("all transforms between the two frames are static")]
    Static,
    /// The z axis of the child frame points down.
    #[error(
        "the z axis of the child frame points down; if the lidar is mounted upside down, set `ingest.lidar.upside_down = true`, otherwise use the frame of the robot as `child`"
    )]
    UpsideDown,
}

impl TransformHistory {
    /// Adds a transform, or counts it if it cannot be used.
    pub(crate) fn add(&mut self, transform: &Transform, is_static: bool) {
        let edge =
            (frame_name(&transform.parent).to_owned(), frame_name(&transform.child).to_owned());
        let [x, y, z, w] = match check(transform) {
            Ok(rotation) => rotation,
            Err(LossKind::TransformWithoutRotation { quaternion }) => {
                self.without_rotation.entry(edge).or_insert((0, quaternion)).0 += 1;
                return;
            }
            Err(kind) => {
                self.losses.add(Loss::new(kind, Subject::transform(&edge.0, &edge.1)), 1);
                return;
            }
        };
        let parent_from_child = Isometry3::from_parts(
            Translation3::from(transform.translation),
            UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
        );
        let recorded = self.recorded.entry(edge).or_default();
        if is_static {
            recorded.set_static();
        }
        recorded.push(transform.stamp_ns, parent_from_child);
    }

    /// The transforms that cannot be used.
    pub(crate) fn losses(&self) -> Losses {
        let mut losses = self.losses.clone();
        for ((parent, child), (n, quaternion)) in &self.without_rotation {
            let kind = LossKind::TransformWithoutRotation { quaternion: quaternion.clone() };
            losses.add(Loss::new(kind, Subject::transform(parent, child)), *n);
        }
        losses
    }

    /// Adds the transforms of a later part of the log.
    pub(crate) fn extend(&mut self, later: Self) {
        self.losses.merge(later.losses);
        for (edge, (n, quaternion)) in later.without_rotation {
            self.without_rotation.entry(edge).or_insert((0, quaternion)).0 += n;
        }
        for (edge, recorded) in later.recorded {
            if self.is_pruned && !self.recorded.contains_key(&edge) {
                self.record_second_parent(&edge);
                continue;
            }
            self.recorded.entry(edge).or_default().extend(recorded);
        }
    }

    /// Records a transform outside the chain if its child is the child of a transform in the chain.
    fn record_second_parent(&mut self, (parent, child): &Edge) {
        let used = self.recorded.keys().filter(|(_, other)| other == child);
        let second: Vec<_> =
            used.map(|(used, _)| (child.clone(), used.clone(), parent.clone())).collect();
        self.second_parents.extend(second);
    }

    /// A note for each frame of the chain that has a second parent.
    pub(crate) fn notes(&self) -> impl Iterator<Item = NoteKind> {
        self.second_parents.iter().cloned().map(|(child, used, other)| NoteKind::TwoParentFrames {
            child,
            used,
            other,
        })
    }

    /// Removes all transforms that are not in the chain between two frames, once there is a chain.
    /// This limits the memory to the transforms that are needed.
    pub(crate) fn prune(&mut self, parent: &str, child: &str) {
        if self.is_pruned {
            return;
        }
        let Some(chain) = self.chain(parent, child) else { return };
        let is_in_chain = |edge: &Edge| chain.iter().any(|link| link.edge == *edge);
        let others: Vec<Edge> =
            self.recorded.keys().filter(|edge| !is_in_chain(edge)).cloned().collect();
        self.recorded.retain(|edge, _| is_in_chain(edge));
        others.iter().for_each(|edge| self.record_second_parent(edge));
        self.is_pruned = true;
    }

    /// The names of all frames, sorted.
    pub(crate) fn frame_names(&self) -> Vec<&str> {
        let edges = self.recorded.keys();
        let names: BTreeSet<&str> =
            edges.flat_map(|(parent, child)| [parent.as_str(), child.as_str()]).collect();
        names.into_iter().collect()
    }

    /// The shortest chain of transforms from one frame to another. If several have the same length,
    /// the first by name is used.
    fn chain(&self, parent: &str, child: &str) -> Option<Vec<Link>> {
        let (start, goal) = (frame_name(parent), frame_name(child));
        let mut reached_by: BTreeMap<&str, Option<(&Edge, bool)>> = BTreeMap::from([(start, None)]);
        let mut queue = VecDeque::from([start]);
        while let Some(frame) = queue.pop_front() {
            for edge in self.recorded.keys() {
                let (next, is_inverted) = match edge {
                    (from, to) if from == frame => (to.as_str(), false),
                    (to, from) if from == frame => (to.as_str(), true),
                    _ => continue,
                };
                if !reached_by.contains_key(next) {
                    reached_by.insert(next, Some((edge, is_inverted)));
                    queue.push_back(next);
                }
            }
        }
        let mut chain = Vec::new();
        let mut frame = goal;
        while let Some((edge, is_inverted)) = *reached_by.get(frame)? {
            chain.push(Link { edge: edge.clone(), is_inverted });
            frame = if is_inverted { &edge.1 } else { &edge.0 };
        }
        chain.reverse();
        Some(chain)
    }

    /// The position in the chain of the transform with the most samples; `None` if every transform
    /// of the chain has only one sample.
    fn most_frequent(&self, chain: &[Link]) -> Option<usize> {
        let n_samples =
            |k: usize| self.recorded.get(&chain[k].edge).map_or(0, RecordedTransform::n_samples);
        let moving = (0..chain.len()).filter(|&k| 1 < n_samples(k));
        moving.max_by_key(|&k| (n_samples(k), std::cmp::Reverse(k)))
    }

    /// The pose of the child frame in the parent frame, if it stays: no transform of the chain moves.
    pub(crate) fn fixed(&self, parent: &str, child: &str) -> Option<Isometry3<f64>> {
        let chain = self.chain(parent, child)?;
        product(chain.iter().map(|link| {
            let recorded = self.recorded.get(&link.edge);
            let fixed = recorded.filter(|recorded| recorded.path_m_rad() <= MAX_FIXED_M_RAD);
            let last = fixed.and_then(|fixed| fixed.samples().last());
            (link.is_inverted, last.map(|(_, transform)| *transform))
        }))
    }

    /// The poses of the child frame in the parent frame, at the stamps of the transform with the most
    /// samples. This takes the samples out of the history.
    ///
    /// If the z axis of the child frame points down, it is an error unless `upside_down` is set.
    pub(crate) fn poses(
        &mut self,
        parent: &str,
        child: &str,
        upside_down: bool,
    ) -> Result<ChainPoses, LookupError> {
        let chain = self.chain(parent, child).ok_or(LookupError::NotConnected)?;
        let most_frequent = self.most_frequent(&chain).ok_or(LookupError::Static)?;
        let links = chain.iter().map(|link| ChainLink {
            is_inverted: link.is_inverted,
            recorded: self.recorded.get_mut(&link.edge).map(std::mem::take).unwrap_or_default(),
        });
        let found = chain::poses(links.collect(), most_frequent);
        match upside_down {
            false if found.poses.len() < 2 * found.n_down => Err(LookupError::UpsideDown),
            _ => Ok(found),
        }
    }

    /// The motion of the child frame while the log is being read: its poses after a stamp, up to
    /// the newest stamp that all regular transforms have reached.
    ///
    /// The poses are in the parent frame of the transform that has moved most. Transforms before it
    /// in the chain, for example corrections of the map, are left out, because they do not describe
    /// a motion of the child frame.
    pub(crate) fn motion(&self, parent: &str, child: &str, after_ns: i64) -> Vec<StampedPose> {
        let Some(mut chain) = self.chain(parent, child) else { return Vec::new() };
        let path = |k: &usize| self.recorded[&chain[*k].edge].path_m_rad();
        // If several have moved by the same amount, the one closest to the child frame is used.
        let moving = (0..chain.len()).max_by(|a, b| path(a).total_cmp(&path(b)));
        chain.drain(..moving.unwrap_or(0));
        let Some(most_frequent) = self.most_frequent(&chain) else { return Vec::new() };
        let recorded: Vec<&RecordedTransform> =
            chain.iter().map(|link| &self.recorded[&link.edge]).collect();
        let newest = recorded.iter().filter_map(|recorded| recorded.newest_regular_ns());
        let Some(until_ns) = newest.min() else { return Vec::new() };
        let mut poses: Vec<StampedPose> = (recorded[most_frequent].stamps_ns().rev())
            .take_while(|&stamp_ns| after_ns < stamp_ns)
            .filter(|&stamp_ns| stamp_ns <= until_ns)
            .filter_map(|stamp_ns| {
                let transforms = chain
                    .iter()
                    .zip(&recorded)
                    .map(|(link, recorded)| (link.is_inverted, recorded.at_or_last(stamp_ns)));
                Some(stamped(stamp_ns, &product(transforms)?))
            })
            .collect();
        poses.reverse();
        poses
    }
}

/// The rotation of a transform as a unit quaternion (x, y, z, w), if the transform can be used.
fn check(transform: &Transform) -> Result<[f64; 4], LossKind> {
    check_position(&transform.translation)?;
    unit_quaternion(transform.rotation).map_err(|kind| match kind {
        LossKind::QuaternionNotNormalized => LossKind::TransformWithoutRotation {
            quaternion: transform.rotation.map(|v| v.to_string()).join(", "),
        },
        other => other,
    })
}

/// The name of a frame without the leading slash that ROS 1 allows.
fn frame_name(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;
    use nalgebra::Vector3;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// Quaternion (x, y, z, w) of a roll about x, followed by a yaw about z.
    fn rotation(yaw_rad: f64, roll_rad: f64) -> [f64; 4] {
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll_rad);
        (yaw * roll).coords.into()
    }

    fn transform(
        (parent, child): (&str, &str),
        stamp_ns: i64,
        translation: [f64; 3],
        rotation: [f64; 4],
    ) -> Transform {
        let (parent, child) = (parent.to_owned(), child.to_owned());
        Transform { stamp_ns, parent, child, translation, rotation }
    }

    /// map -> odom at (10, 0) with heading 90 deg; odom -> base at (2 + t, 0) with heading 0.1 t;
    /// base -> mast; base -> lidar 1 m ahead and upside down.
    fn history() -> TransformHistory {
        let mut history = TransformHistory::default();
        let mut add = |names, stamp_ns, translation, rotation, is_static| {
            history.add(&transform(names, stamp_ns, translation, rotation), is_static);
        };
        for stamp_ns in [0, 100] {
            add(("map", "odom"), stamp_ns, [10.0, 0.0, 0.0], rotation(FRAC_PI_2, 0.0), false);
        }
        for t in [-10i32, 0, 10, 20, 110] {
            let x = 2.0 + f64::from(t);
            let heading = rotation(0.1 * f64::from(t), 0.0);
            add(("odom", "/base"), i64::from(t), [x, 0.0, 0.0], heading, false);
        }
        add(("base", "lidar"), 0, [1.0, 0.0, 0.5], rotation(0.0, PI), true);
        add(("base", "mast"), 0, [0.0, 0.0, 1.0], rotation(0.0, 0.0), true);
        history
    }

    /// At t = 10 the base is at (12, 0) in odom with heading 1 rad, so it is at (10, 12) in the map
    /// with heading 1 rad + 90 deg. The lidar is 1 m ahead; its roll does not matter.
    #[test]
    fn transforms_are_chained_and_not_extrapolated() {
        let ChainPoses { poses, n_unknown, .. } = history().poses("map", "lidar", true).unwrap();
        assert_eq!(poses.iter().map(|p| p.stamp_ns).collect::<Vec<_>>(), [0, 10, 20]);
        assert_eq!(n_unknown, 2, "map -> odom has no samples around -10 and 110");
        let at_10 = poses[1].pose;
        let heading = 1.0 + FRAC_PI_2;
        assert!((at_10.heading_rad - heading).abs() < 1e-12);
        assert!((at_10.x_m - (10.0 + heading.cos())).abs() < 1e-12);
        assert!((at_10.y_m - (12.0 + heading.sin())).abs() < 1e-12);
    }

    /// The chain above in the other direction: the map in the frame of the lidar. The lidar is
    /// upside down, so left and right are exchanged.
    #[test]
    fn transforms_are_inverted_when_the_chain_goes_from_child_to_parent() {
        let poses = history().poses("/lidar", "map", true).unwrap().poses;
        let map = poses[1].pose;
        let heading = 1.0 + FRAC_PI_2;
        let (sin, cos) = heading.sin_cos();
        let (dx, dy) = (-10.0 - cos, -12.0 - sin);
        let (ahead, left) = (dx * cos + dy * sin, -dx * sin + dy * cos);
        assert!((map.x_m - ahead).abs() < 1e-12 && (map.y_m + left).abs() < 1e-12, "{map:?}");
        assert!((Pose2 { heading_rad: heading, ..map }).heading_difference_rad(&map) < 1e-12);
    }

    #[test]
    fn a_log_read_in_parts_and_pruned_gives_the_same_history() {
        let mut whole = history();
        let later = whole.clone();
        whole.extend(later);
        let (n_before, _) = (whole.recorded.len(), whole.prune("map", "lidar"));
        assert_eq!((n_before, whole.recorded.len()), (4, 3));
        let mut parts = history();
        parts.prune("map", "lidar");
        parts.extend(history());
        assert_eq!(parts, whole);
        let poses = whole.poses("map", "lidar", true).unwrap().poses;
        let expected = history().poses("map", "lidar", true).unwrap().poses;
        assert_eq!(poses.iter().step_by(2).copied().collect::<Vec<_>>(), expected);
    }

    /// odom -> base moves most, so corrections of the map do not count.
    #[test]
    fn motion_is_in_the_frame_of_the_transform_that_moves_most() {
        let motion = history().motion("map", "lidar", i64::MIN);
        assert_eq!(motion.iter().map(|p| p.stamp_ns).collect::<Vec<_>>(), [-10, 0, 10, 20, 110]);
        let in_odom = history().poses("odom", "lidar", true).unwrap().poses;
        assert_eq!(motion, in_odom);
        assert_eq!(history().motion("map", "lidar", 0), in_odom[2..]);
        assert_eq!(history().motion("map", "wheel", 0), vec![]);
        // A fixed joint with more samples than odom -> base, and a jump of the map.
        let mut extended = history();
        for t in 0..40 {
            let names = ("lidar", "optical");
            extended.add(&transform(names, t, [0.0; 3], rotation(0.0, 0.0)), false);
        }
        let jump = transform(("map", "odom"), 50, [9.0, 5.0, 0.0], rotation(0.1, 0.0));
        extended.add(&jump, false);
        let motion = extended.motion("map", "optical", i64::MIN);
        assert_eq!(motion.len(), 40);
        assert_eq!(motion[10].stamp_ns, 10);
        assert!(motion[10].pose.distance_m(&in_odom[2].pose) < 1e-12);
    }

    /// map -> odom has samples at 10 Hz, but none from 1 to 4 s. There are no poses in the gap.
    #[test]
    fn a_gap_in_one_transform_gives_no_poses() {
        let mut history = TransformHistory::default();
        let mut add = |names, ms: i64, x_m| {
            let transform = transform(names, ms * 1_000_000, [x_m, 0.0, 0.0], rotation(0.0, 0.0));
            history.add(&transform, false);
        };
        for ms in (0..=5000).step_by(20) {
            add(("odom", "base"), ms, 1e-3 * ms as f64);
        }
        for ms in (0..=1000).step_by(100).chain((4000..=5000).step_by(100)) {
            add(("map", "odom"), ms, 0.0);
        }
        let ChainPoses { poses, n_unknown, .. } = history.poses("map", "base", false).unwrap();
        assert_eq!((poses.len(), n_unknown), (2 * 51, 149));
    }

    #[test]
    fn a_frame_with_two_parents_is_noted() {
        let mut pruned = history();
        let other = transform(("gps", "base"), 0, [50.0, 0.0, 0.0], rotation(0.0, 0.0));
        pruned.prune("map", "lidar");
        assert_eq!(pruned.notes().count(), 0);
        let mut later = TransformHistory::default();
        later.add(&other, false);
        pruned.extend(later);
        let [child, used, other] = ["base", "odom", "gps"].map(str::to_owned);
        let notes: Vec<_> = pruned.notes().collect();
        assert_eq!(notes, [NoteKind::TwoParentFrames { child, used, other }]);
    }

    #[test]
    fn frames_without_a_moving_chain_or_upside_down_are_errors() {
        let poses = |parent, child, upside_down| history().poses(parent, child, upside_down);
        assert_eq!(poses("map", "wheel", true), Err(LookupError::NotConnected));
        assert_eq!(poses("mast", "lidar", true), Err(LookupError::Static));
        assert_eq!(poses("map", "lidar", false), Err(LookupError::UpsideDown));
        assert_eq!(history().frame_names(), ["base", "lidar", "map", "mast", "odom"]);
    }

    /// Other transforms of the same frames and of the same message are used.
    #[test]
    fn invalid_transforms_are_counted_by_frames_and_name_their_quaternion() {
        let mut history = history();
        let before = history.clone();
        let identity = [0.0, 0.0, 0.0, 1.0];
        for (names, translation, rotation) in [
            (("base", "/imu"), [0.0; 3], [0.0; 4]),
            (("base", "imu"), [0.0; 3], [0.0, 0.0, 0.0, 0.5]),
            (("odom", "base"), [f64::NAN, 0.0, 0.0], identity),
            (("odom", "base"), [0.0, 1e300, 0.0], identity),
        ] {
            history.add(&transform(names, 0, translation, rotation), false);
        }
        assert_eq!(history.recorded, before.recorded);
        let mut parts = before;
        parts.extend(history);
        let losses: Vec<String> = parts.losses().iter().map(|(loss, n)| loss.sentence(n)).collect();
        assert_eq!(
            losses,
            [
                "1 message with NaN or infinite values (transform `odom -> base`)",
                "1 message with a position farther than 100000000 m from the origin (transform `odom -> base`)",
                "2 transforms whose quaternion (x, y, z, w) is not of length 1: (0, 0, 0, 0) (transform `base -> imu`)",
            ]
        );
    }
}
