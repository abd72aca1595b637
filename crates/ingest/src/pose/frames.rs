//! Transforms between frames -> poses of one frame in another.
//!
//! Transforms make a graph, frames its nodes; the way from the parent to the child is the shortest
//! one, each transform taken forwards or backwards. A transform of a topic named `..._static`, and
//! one that is told once only, holds for all time; others are interpolated between the stamps they
//! are told for, and never beyond.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use dataset::{LossKind, Note, NoteKind, Pose2, StampedPose};
use messages::Transform;

use crate::pose::message::{unit_quaternion, yaw_rad};

/// Where a frame is in another: rotated, then moved.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rigid {
    /// \[m\]
    translation: [f64; 3],
    /// A unit quaternion (x, y, z, w).
    rotation: [f64; 4],
}

/// Parent and child.
type Edge = (String, String);

/// What is told of one transform.
#[derive(Debug, Clone, Default, PartialEq)]
struct Recorded {
    /// In the order of the log.
    samples: Vec<(i64, Rigid)>,
    is_static: bool,
    /// How far it has moved so far: metres, and radians as if they were metres.
    path: f64,
}

/// The transforms of a log.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct TransformHistory {
    told: BTreeMap<Edge, Recorded>,
    /// Whether it has been cut down to the transforms that are needed.
    is_cut: bool,
    /// Frames on the way that are told in another frame too: child, parent taken, other parent.
    forks: BTreeSet<(String, String, String)>,
}

/// The transforms from the parent to the child, each with whether it is taken backwards.
type Chain = Vec<(Edge, bool)>;

impl TransformHistory {
    /// Adds a transform.
    pub(crate) fn add(&mut self, transform: &Transform, is_static: bool) -> Result<(), LossKind> {
        let rotation = unit_quaternion(transform.rotation)?;
        if !transform.translation.iter().all(|v| v.is_finite()) {
            return Err(LossKind::NonFiniteMessages);
        }
        let edge = (name(&transform.parent).to_owned(), name(&transform.child).to_owned());
        let told = self.told.entry(edge).or_default();
        told.is_static |= is_static;
        let rigid = Rigid { translation: transform.translation, rotation };
        told.push(vec![(transform.stamp_ns, rigid)]);
        Ok(())
    }

    /// Adds what is told later in the log.
    pub(crate) fn extend(&mut self, later: Self) {
        for (edge, told) in later.told {
            if self.is_cut && !self.told.contains_key(&edge) {
                self.note_fork(&edge);
                continue;
            }
            let all = self.told.entry(edge).or_default();
            all.is_static |= told.is_static;
            all.push(told.samples);
        }
    }

    /// Remembers a transform that leads to a frame on the way from another parent.
    fn note_fork(&mut self, (parent, child): &Edge) {
        let taken = self.told.keys().filter(|(_, other)| other == child);
        let forks = taken.map(|(taken, _)| (child.clone(), taken.clone(), parent.clone()));
        let forks: Vec<_> = forks.collect();
        self.forks.extend(forks);
    }

    /// A note for each frame of the chain that has two parents.
    pub(crate) fn forks(&self) -> impl Iterator<Item = Note> {
        self.forks.iter().map(|(child, used, other)| {
            let (child, used, other) = (child.clone(), used.clone(), other.clone());
            NoteKind::TwoParentFrames { child, used, other }.into()
        })
    }

    /// Forgets, once there is a way between the frames, all that is not on it: memory holds the
    /// transforms that are needed, however many there are.
    pub(crate) fn cut_down(&mut self, parent: &str, child: &str) {
        if let (false, Some(way)) = (self.is_cut, self.way(parent, child)) {
            let mut others: Vec<Edge> = self.told.keys().cloned().collect();
            others.retain(|edge| way.iter().all(|(of_way, _)| of_way != edge));
            self.told.retain(|edge, _| way.iter().any(|(other, _)| other == edge));
            others.iter().for_each(|edge| self.note_fork(edge));
            self.is_cut = true;
        }
    }

    /// The names of the frames, in order.
    pub(crate) fn names(&self) -> Vec<&str> {
        let mut names: Vec<&str> =
            self.told.keys().flat_map(|(parent, child)| [&**parent, &**child]).collect();
        names.sort_unstable();
        names.dedup();
        names
    }

    /// The shortest way, of several the first by name.
    fn way(&self, parent: &str, child: &str) -> Option<Chain> {
        let (start, goal) = (name(parent), name(child));
        let mut reached_by: BTreeMap<&str, Option<(&Edge, bool)>> = BTreeMap::from([(start, None)]);
        let mut queue = VecDeque::from([start]);
        while let Some(frame) = queue.pop_front() {
            for edge in self.told.keys() {
                let next = match edge {
                    (from, to) if from == frame => (&**to, false),
                    (to, from) if from == frame => (&**to, true),
                    _ => continue,
                };
                if !reached_by.contains_key(next.0) {
                    reached_by.insert(next.0, Some((edge, next.1)));
                    queue.push_back(next.0);
                }
            }
        }
        let mut way = Chain::new();
        let mut frame = goal;
        while let Some((edge, is_backwards)) = *reached_by.get(frame)? {
            way.push((edge.clone(), is_backwards));
            frame = if is_backwards { &edge.1 } else { &edge.0 };
        }
        way.reverse();
        Some(way)
    }

    /// The transform on a way that is told most often: none where all hold for all time.
    fn fastest(&self, way: &Chain) -> Option<usize> {
        let n_samples = |k: usize| self.told.get(&way[k].0).map_or(0, |told| told.samples.len());
        let moving = (0..way.len()).filter(|&k| 1 < n_samples(k));
        moving.max_by_key(|&k| (n_samples(k), std::cmp::Reverse(k)))
    }

    /// Poses of the child in the parent, at the stamps of the transform between them that is told
    /// most often, and how many stamps another transform does not reach, or has a gap around.
    ///
    /// A child whose z axis points down is refused unless that is meant.
    pub(crate) fn poses(
        &self,
        parent: &str,
        child: &str,
        upside_down: bool,
    ) -> Result<(Vec<StampedPose>, u64), LookupError> {
        let way = self.way(parent, child).ok_or(LookupError::Unconnected)?;
        let fastest = self.fastest(&way).ok_or(LookupError::Still)?;
        let sorted: Vec<Vec<(i64, Rigid)>> = way
            .iter()
            .map(|(edge, _)| {
                let mut samples = self.told[edge].samples.clone();
                samples.sort_by_key(|(stamp_ns, _)| *stamp_ns);
                samples
            })
            .collect();
        let (mut n_beyond, mut n_down) = (0, 0);
        let mut poses = Vec::with_capacity(sorted[fastest].len());
        for &(stamp_ns, _) in &sorted[fastest] {
            let rigids = sorted.iter().map(|samples| match is_in_gap(samples, stamp_ns) {
                true => None,
                false => at(samples, stamp_ns),
            });
            match chain(&way, rigids) {
                Some(rigid) => {
                    n_down += usize::from(rigid.points_down());
                    poses.push(StampedPose::new(stamp_ns, rigid.planar()));
                }
                None => n_beyond += 1,
            }
        }
        if !upside_down && poses.len() < 2 * n_down {
            return Err(LookupError::UpsideDown);
        }
        Ok((poses, n_beyond))
    }

    /// How the child moves, told while the log is being read: its poses after a stamp, up to where all
    /// transforms that are told steadily have come, in the frame before the transform that has moved
    /// most. What lies before that one, as a correction of the map does, does not move the child.
    pub(crate) fn motion(&self, parent: &str, child: &str, after_ns: i64) -> Vec<StampedPose> {
        let Some(mut way) = self.way(parent, child) else { return Vec::new() };
        let path = |k: &usize| self.told[&way[*k].0].path;
        // Of those that have moved as far, the one that is nearest to the child.
        let moving = (0..way.len()).max_by(|a, b| path(a).total_cmp(&path(b)));
        way.drain(..moving.unwrap_or(0));
        let Some(fastest) = self.fastest(&way) else { return Vec::new() };
        let told: Vec<&Recorded> = way.iter().map(|(edge, _)| &self.told[edge]).collect();
        let newest =
            told.iter().filter(|told| is_steady(&told.samples)).map(|told| told.newest_ns());
        let Some(until_ns) = newest.min() else { return Vec::new() };
        let stamps = told[fastest].samples.iter().rev().map(|(stamp_ns, _)| *stamp_ns);
        let mut poses: Vec<StampedPose> = stamps
            .take_while(|&stamp_ns| after_ns < stamp_ns)
            .filter(|&stamp_ns| stamp_ns <= until_ns)
            .filter_map(|stamp_ns| {
                let rigids = told.iter().map(|told| told.around(stamp_ns));
                Some(StampedPose::new(stamp_ns, chain(&way, rigids)?.planar()))
            })
            .collect();
        poses.reverse();
        poses
    }
}

/// Transforms told at least so often, on average, are told steadily \[ns\].
const STEADY_NS: i64 = 1_000_000_000;

/// Samples of a transform that is told steadily, so far apart, are a gap \[ns\].
const GAP_NS: i64 = 2_000_000_000;

fn is_steady(samples: &[(i64, Rigid)]) -> bool {
    let n = samples.len() as i64;
    let [(first_ns, _), .., (last_ns, _)] = samples else { return false };
    last_ns.saturating_sub(*first_ns) / (n - 1) <= STEADY_NS
}

/// Whether a transform that is told steadily, its samples in order of time, was silent around a
/// stamp.
fn is_in_gap(samples: &[(i64, Rigid)], stamp_ns: i64) -> bool {
    let after = samples.partition_point(|(ns, _)| *ns < stamp_ns);
    match (after.checked_sub(1).and_then(|k| samples.get(k)), samples.get(after)) {
        (Some((before_ns, _)), Some((after_ns, _))) => {
            *after_ns != stamp_ns
                && GAP_NS < after_ns.saturating_sub(*before_ns)
                && is_steady(samples)
        }
        _ => false,
    }
}

impl Recorded {
    /// Adds what is told next; of what holds for all time the last one told does.
    fn push(&mut self, next: Vec<(i64, Rigid)>) {
        for (stamp_ns, rigid) in next {
            if self.is_static {
                self.samples.clear();
            } else if let Some((_, last)) = self.samples.last() {
                self.path += last.step_to(&rigid);
            }
            self.samples.push((stamp_ns, rigid));
        }
    }

    fn newest_ns(&self) -> i64 {
        self.samples.last().map_or(i64::MIN, |(stamp_ns, _)| *stamp_ns)
    }

    /// The transform at a stamp, or, where it is not told steadily, the last one before.
    fn around(&self, stamp_ns: i64) -> Option<Rigid> {
        if is_steady(&self.samples) {
            return at(&self.samples, stamp_ns);
        }
        let after = self.samples.partition_point(|(ns, _)| *ns <= stamp_ns);
        self.samples.get(after.saturating_sub(1)).map(|(_, rigid)| *rigid)
    }
}

/// The transform along a way, of those it is made of.
fn chain(way: &Chain, rigids: impl Iterator<Item = Option<Rigid>>) -> Option<Rigid> {
    way.iter().zip(rigids).try_fold(Rigid::IDENTITY, |all, ((_, is_backwards), rigid)| {
        let rigid = rigid?;
        Some(all.then(&if *is_backwards { rigid.inverse() } else { rigid }))
    })
}

/// Why there are no poses of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LookupError {
    /// No transforms lead from one to the other.
    Unconnected,
    /// All that lead there hold for all time.
    Still,
    /// The z axis of the child points down.
    UpsideDown,
}

/// Without the slash that ROS 1 allowed in front.
fn name(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// The transform at a stamp, of samples in order of time, not none; none before and after them.
fn at(samples: &[(i64, Rigid)], stamp_ns: i64) -> Option<Rigid> {
    if let [(_, always)] = samples {
        return Some(*always);
    }
    let after = samples.partition_point(|(ns, _)| *ns < stamp_ns);
    let (after_ns, next) = samples.get(after)?;
    if *after_ns == stamp_ns {
        return Some(*next);
    }
    let (before_ns, previous) = samples.get(after.checked_sub(1)?)?;
    let share = (stamp_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
    // Samples out of order have no stamp between them.
    (0.0..=1.0).contains(&share).then(|| previous.towards(next, share))
}

impl Rigid {
    const IDENTITY: Self = Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };

    /// With `self` as `a_from_b` and the other as `b_from_c`: `a_from_c`.
    fn then(&self, next: &Self) -> Self {
        let moved = rotate(self.rotation, next.translation);
        Self {
            translation: std::array::from_fn(|k| self.translation[k] + moved[k]),
            rotation: product(self.rotation, next.rotation),
        }
    }

    fn inverse(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        let rotation = [-x, -y, -z, w];
        Self { translation: rotate(rotation, self.translation).map(|v| -v), rotation }
    }

    /// How far another is: metres, and radians as if they were metres. The rotation by twice the
    /// chord between the quaternions, as for small angles.
    fn step_to(&self, other: &Self) -> f64 {
        let apart = |sign: f64, a: &[f64], b: &[f64]| -> f64 {
            a.iter().zip(b).map(|(a, b)| (a - sign * b).powi(2)).sum::<f64>().sqrt()
        };
        let (a, b) = (&self.rotation, &other.rotation);
        apart(1.0, &self.translation, &other.translation)
            + 2.0 * apart(1.0, a, b).min(apart(-1.0, a, b))
    }

    /// Part of the way to another: the translation linear, the rotation along the shorter arc, the
    /// quaternion's chord normalised, which at half of 0.1 rad is exact and elsewhere within
    /// 1e-5 rad of a steady turn.
    fn towards(&self, other: &Self, share: f64) -> Self {
        let dot: f64 = self.rotation.iter().zip(other.rotation).map(|(a, b)| a * b).sum();
        let side = if dot < 0.0 { -share } else { share };
        let sum: [f64; 4] =
            std::array::from_fn(|k| (1.0 - share) * self.rotation[k] + side * other.rotation[k]);
        let norm = sum.iter().map(|v| v * v).sum::<f64>().sqrt();
        let (a, b) = (&self.translation, &other.translation);
        Self {
            translation: std::array::from_fn(|k| a[k] + share * (b[k] - a[k])),
            rotation: sum.map(|v| v / norm),
        }
    }

    /// Whether its z axis is below the horizon: entry (3, 3) of the rotation matrix.
    fn points_down(&self) -> bool {
        let [x, y, _, _] = self.rotation;
        1.0 - 2.0 * (x * x + y * y) < 0.0
    }

    fn planar(&self) -> Pose2 {
        let [x_m, y_m, _] = self.translation;
        Pose2 { x_m, y_m, heading_rad: yaw_rad(self.rotation) }
    }
}

/// The Hamilton product: the second rotation, then the first.
fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// q v q*
fn rotate(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
    let [x, y, z, w] = q;
    let [px, py, pz, _] = product(product(q, [v[0], v[1], v[2], 0.0]), [-x, -y, -z, w]);
    [px, py, pz]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// Rolled about x, then turned about z, by halves of angles.
    fn rotation(yaw_rad: f64, roll_rad: f64) -> [f64; 4] {
        let ((sy, cy), (sr, cr)) = ((yaw_rad / 2.0).sin_cos(), (roll_rad / 2.0).sin_cos());
        product([0.0, 0.0, sy, cy], [sr, 0.0, 0.0, cr])
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

    /// map -> odom moved by (10, 0) and turned by 90 deg; odom -> base at (2 + t, 0), heading 0.1 t;
    /// base -> mast, base -> lidar 1 m ahead and hanging upside down.
    fn graph() -> TransformHistory {
        let mut graph = TransformHistory::default();
        let mut add = |names, stamp_ns, translation, rotation, is_static| {
            graph.add(&transform(names, stamp_ns, translation, rotation), is_static).unwrap();
        };
        for stamp_ns in [0, 100] {
            add(("map", "odom"), stamp_ns, [10.0, 0.0, 0.0], rotation(FRAC_PI_2, 0.0), false);
        }
        for t in [-10i32, 0, 10, 20, 110] {
            let x = 2.0 + f64::from(t);
            let turned = rotation(0.1 * f64::from(t), 0.0);
            add(("odom", "/base"), i64::from(t), [x, 0.0, 0.0], turned, false);
        }
        add(("base", "lidar"), 0, [1.0, 0.0, 0.5], rotation(0.0, PI), true);
        add(("base", "mast"), 0, [0.0, 0.0, 1.0], rotation(0.0, 0.0), true);
        graph
    }

    /// At t = 10 base is at (12, 0) in odom, heading 1 rad: in the map at (10, 12), heading 1 + 90
    /// deg; the lidar 1 m ahead of it, whatever it is rolled by.
    #[test]
    fn transforms_are_chained_interpolated_and_never_beyond() {
        let (poses, n_beyond) = graph().poses("map", "lidar", true).unwrap();
        assert_eq!(poses.iter().map(|p| p.stamp_ns).collect::<Vec<_>>(), [0, 10, 20]);
        assert_eq!(n_beyond, 2, "-10 and 110 are beyond map -> odom");
        let at_10 = poses[1].pose;
        let heading = 1.0 + FRAC_PI_2;
        assert!((at_10.heading_rad - heading).abs() < 1e-12);
        assert!((at_10.x_m - (10.0 + heading.cos())).abs() < 1e-12);
        assert!((at_10.y_m - (12.0 + heading.sin())).abs() < 1e-12);
        // Backwards: where the map is for the lidar; there again it is the identity.
        let (back, _) = graph().poses("/lidar", "map", true).unwrap();
        let back = back[1].pose;
        // Seen from a lidar upside down, left is right.
        let (sin, cos) = heading.sin_cos();
        let (dx, dy) = (-10.0 - cos, -12.0 - sin);
        let (ahead, left) = (dx * cos + dy * sin, -dx * sin + dy * cos);
        assert!((back.x_m - ahead).abs() < 1e-12 && (back.y_m + left).abs() < 1e-12, "{back:?}");
        assert!((Pose2 { heading_rad: heading, ..back }).heading_difference_rad(&back) < 1e-12);
    }

    #[test]
    fn halfway_between_two_transforms() {
        let samples = [
            (0, Rigid { translation: [0.0, 2.0, 0.0], rotation: rotation(3.0, 0.0) }),
            (10, Rigid { translation: [4.0, 0.0, 0.0], rotation: rotation(-3.0, 0.0) }),
        ];
        let half = at(&samples, 5).unwrap().planar();
        assert_eq!((half.x_m, half.y_m), (2.0, 1.0));
        assert!((half.heading_rad.abs() - PI).abs() < 1e-12, "over the seam: {half:?}");
        assert_eq!((at(&samples, -1), at(&samples, 11)), (None, None));
        // A quarter of 0.1 rad: the chord is 1.2e-6 rad off.
        let turned = Rigid { rotation: rotation(0.1, 0.0), ..Rigid::IDENTITY };
        let quarter = Rigid::IDENTITY.towards(&turned, 0.25).planar().heading_rad;
        assert!((quarter - 0.025).abs() < 1e-5 && quarter != 0.025);
    }

    /// Read in two parts and cut down to what leads to the lidar, it is the same.
    #[test]
    fn a_log_in_parts_cut_down_is_the_same() {
        let mut whole = graph();
        let later = whole.clone();
        whole.extend(later);
        let (n_before, _) = (whole.told.len(), whole.cut_down("map", "lidar"));
        assert_eq!((n_before, whole.told.len()), (4, 3));
        let mut parts = graph();
        parts.cut_down("map", "lidar");
        parts.extend(graph());
        assert_eq!(parts, whole);
        let (poses, _) = whole.poses("map", "lidar", true).unwrap();
        let (expected, _) = graph().poses("map", "lidar", true).unwrap();
        assert_eq!(poses.iter().step_by(2).copied().collect::<Vec<_>>(), expected);
    }

    /// odom -> base moves most: how the map is corrected does not count.
    #[test]
    fn motion_is_told_up_to_where_all_transforms_have_come() {
        let motion = graph().motion("map", "lidar", i64::MIN);
        assert_eq!(motion.iter().map(|p| p.stamp_ns).collect::<Vec<_>>(), [-10, 0, 10, 20, 110]);
        let (in_odom, _) = graph().poses("odom", "lidar", true).unwrap();
        assert_eq!(motion, in_odom);
        assert_eq!(graph().motion("map", "lidar", 0), in_odom[2..]);
        assert_eq!(graph().motion("map", "wheel", 0), vec![]);
        // A fixed joint that is told more often than the robot moves, and a jump of the map.
        let mut told = graph();
        for t in 0..40 {
            let names = ("lidar", "optical");
            told.add(&transform(names, t, [0.0; 3], rotation(0.0, 0.0)), false).unwrap();
        }
        told.add(&transform(("map", "odom"), 50, [9.0, 5.0, 0.0], rotation(0.1, 0.0)), false)
            .unwrap();
        let motion = told.motion("map", "optical", i64::MIN);
        assert_eq!(motion.len(), 40);
        assert_eq!(motion[10].stamp_ns, 10);
        assert!(motion[10].pose.distance_m(&in_odom[2].pose) < 1e-12);
    }

    /// map -> odom is told at 10 Hz, but not from 1 to 4 s; what odom -> base says then is no pose.
    #[test]
    fn a_transform_that_falls_silent_leaves_a_gap() {
        let mut graph = TransformHistory::default();
        let mut add = |names, ms: i64, x_m| {
            let told = transform(names, ms * 1_000_000, [x_m, 0.0, 0.0], rotation(0.0, 0.0));
            graph.add(&told, false).unwrap();
        };
        for ms in (0..=5000).step_by(20) {
            add(("odom", "base"), ms, 1e-3 * ms as f64);
        }
        for ms in (0..=1000).step_by(100).chain((4000..=5000).step_by(100)) {
            add(("map", "odom"), ms, 0.0);
        }
        let (poses, n_beyond) = graph.poses("map", "base", false).unwrap();
        assert_eq!((poses.len(), n_beyond), (2 * 51, 149));
    }

    #[test]
    fn two_parents_and_a_lidar_upside_down_are_told() {
        assert_eq!(graph().poses("map", "lidar", false), Err(LookupError::UpsideDown));
        let mut forked = graph();
        let other = transform(("gps", "base"), 0, [50.0, 0.0, 0.0], rotation(0.0, 0.0));
        forked.cut_down("map", "lidar");
        assert_eq!(forked.forks().count(), 0);
        let mut later = TransformHistory::default();
        later.add(&other, false).unwrap();
        forked.extend(later);
        let [used, other] = ["odom", "gps"].map(str::to_owned);
        let note = NoteKind::TwoParentFrames { child: "base".to_owned(), used, other };
        assert_eq!(forked.forks().collect::<Vec<_>>(), [note.into()]);
    }

    #[test]
    fn without_a_way_or_motion_there_are_no_poses() {
        assert_eq!(graph().poses("map", "wheel", true), Err(LookupError::Unconnected));
        assert_eq!(graph().poses("mast", "lidar", true), Err(LookupError::Still));
        assert_eq!(graph().names(), ["base", "lidar", "map", "mast", "odom"]);
        let mut graph = graph();
        let bad = transform(("a", "b"), 0, [0.0; 3], [0.0; 4]);
        assert_eq!(graph.add(&bad, false), Err(LossKind::QuaternionNotNormalized));
        let bad = transform(("a", "b"), 0, [f64::NAN; 3], [0.0, 0.0, 0.0, 1.0]);
        assert_eq!(graph.add(&bad, false), Err(LossKind::NonFiniteMessages));
    }
}
