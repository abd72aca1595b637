//! A chain of transforms -> the poses of its last frame in its first frame.

use dataset::{NoteKind, StampedPose};
use nalgebra::Isometry3;

use crate::pose::clock::ClockPieces;
use crate::pose::jumps::MIN_JUMP_M;
use crate::pose::recorded::{RecordedTransform, planar, points_down};

/// The drift of odometry, as a share of the path. A transform that corrects it changes by this much
/// between two samples without a jump.
const DRIFT_SHARE: f64 = 0.1;

/// A transform of a chain.
pub(crate) struct ChainLink {
    /// Whether the chain goes from the child to the parent of the transform.
    pub(crate) is_inverted: bool,
    pub(crate) recorded: RecordedTransform,
}

/// The poses of a chain.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct ChainPoses {
    /// The poses, in order of time.
    pub(crate) poses: Vec<StampedPose>,
    /// Number of stamps without a pose, because another transform of the chain has not started, has
    /// ended, or is silent.
    pub(crate) n_unknown: u64,
    /// Intervals of time that occur twice because the clock stepped back \[ns\]. They have no poses.
    pub(crate) repeated_ns: Vec<(i64, i64)>,
    /// Number of stamps in these intervals.
    pub(crate) n_repeated: u64,
    /// The steps of the clock.
    pub(crate) clock_note: Option<NoteKind>,
    /// Number of poses whose z axis points down.
    pub(crate) n_down: usize,
}

/// Computes the poses of a chain at the stamps of one of its transforms, `most_frequent`.
pub(crate) fn poses(mut links: Vec<ChainLink>, most_frequent: usize) -> ChainPoses {
    let path = |k: &usize| links[*k].recorded.path_m_rad();
    let driving = (0..links.len()).max_by(|a, b| path(a).total_cmp(&path(b))).unwrap_or(0);
    let mut found = ChainPoses::default();
    found.leave_out_repeated_times(&mut links, driving, most_frequent);
    for link in &mut links {
        link.recorded = std::mem::take(&mut link.recorded).sorted();
    }
    let stamps_ns: Vec<i64> = links[most_frequent].recorded.stamps_ns().collect();
    let mut lookup = Lookup { corrections: vec![None; links.len()], links, driving };
    for stamp_ns in stamps_ns {
        match lookup.pose(stamp_ns) {
            Some(pose) => {
                found.n_down += usize::from(points_down(&pose));
                found.poses.push(stamped(stamp_ns, &pose));
            }
            None => found.n_unknown += 1,
        }
    }
    found
}

/// The product of the transforms of a chain, `parent_from_child`: `a_from_b * b_from_c * ...`. Each
/// transform has a flag whether it is inverted.
pub(crate) fn product(
    transforms: impl Iterator<Item = (bool, Option<Isometry3<f64>>)>,
) -> Option<Isometry3<f64>> {
    let mut transforms = transforms;
    transforms.try_fold(Isometry3::identity(), |parent_from_frame, (is_inverted, transform)| {
        let transform = transform?;
        let frame_from_next = if is_inverted { transform.inverse() } else { transform };
        Some(parent_from_frame * frame_from_next)
    })
}

/// The pose in the plane, with its height.
pub(crate) fn stamped(stamp_ns: i64, parent_from_child: &Isometry3<f64>) -> StampedPose {
    let z_m = Some(parent_from_child.translation.z);
    StampedPose { z_m, ..StampedPose::new(stamp_ns, planar(parent_from_child)) }
}

impl ChainPoses {
    /// Removes the samples at times that occur twice. Every transform is asked whether the clock stepped
    /// back, and the one with the most steps is right: a transform that hardly moves, or whose noise is
    /// larger than its motion, does not show a step.
    fn leave_out_repeated_times(
        &mut self,
        links: &mut [ChainLink],
        driving: usize,
        most_frequent: usize,
    ) {
        let mut most_steps = 0;
        let others = (0..links.len()).filter(|k| *k != driving);
        for k in std::iter::once(driving).chain(others) {
            let samples = links.get(k).map_or(&[][..], |link| link.recorded.samples());
            if samples.len() < 2 {
                continue;
            }
            let in_file: Vec<StampedPose> =
                samples.iter().map(|(stamp_ns, transform)| stamped(*stamp_ns, transform)).collect();
            let clock = ClockPieces::of(&in_file);
            if most_steps < clock.steps_ns.len() {
                most_steps = clock.steps_ns.len();
                self.repeated_ns = clock.repeated_ns(&in_file);
                self.clock_note = clock.note(&in_file);
            }
        }
        let is_repeated = |stamp_ns: i64| {
            let after = self.repeated_ns.partition_point(|(_, to_ns)| *to_ns < stamp_ns);
            self.repeated_ns.get(after).is_some_and(|(from_ns, _)| *from_ns <= stamp_ns)
        };
        for (k, link) in links.iter_mut().enumerate() {
            let n_removed = link.recorded.remove(is_repeated);
            if k == most_frequent {
                self.n_repeated = n_removed;
            }
        }
    }
}

/// Looks up the transforms of a chain.
struct Lookup {
    /// Sorted by time.
    links: Vec<ChainLink>,
    /// The link that moves most: the others are corrections or joints.
    driving: usize,
    /// For each link, the stamp of the last sample that was checked \[ns\], and whether the correction
    /// jumps after it.
    corrections: Vec<Option<(i64, bool)>>,
}

impl Lookup {
    /// The product of the transforms at a stamp, if all of them are known.
    fn pose(&mut self, stamp_ns: i64) -> Option<Isometry3<f64>> {
        let values: Vec<Option<Isometry3<f64>>> =
            (0..self.links.len()).map(|k| self.transform(k, stamp_ns)).collect();
        product(self.links.iter().map(|link| link.is_inverted).zip(values))
    }

    /// The transform of a link at a stamp. A correction that jumps is not interpolated: the last one
    /// before the jump is valid until the next sample.
    fn transform(&mut self, k: usize, stamp_ns: i64) -> Option<Isometry3<f64>> {
        let recorded = &self.links[k].recorded;
        if recorded.is_in_gap(stamp_ns) {
            return None;
        }
        if let Some([before, after]) = recorded.around(stamp_ns)
            && k != self.driving
            && stamp_ns < after.0
            && before.1 != after.1
        {
            let known = self.corrections[k].filter(|(checked_ns, _)| *checked_ns == before.0);
            let jumps =
                known.map_or_else(|| self.jumps(k, stamp_ns, before, after), |known| known.1);
            self.corrections[k] = Some((before.0, jumps));
            if jumps {
                return Some(before.1);
            }
        }
        self.links[k].recorded.at(stamp_ns)
    }

    /// Whether a change of one transform moves the pose at a stamp farther than odometry drifts
    /// between the two samples.
    fn jumps(
        &self,
        k: usize,
        stamp_ns: i64,
        (before_ns, before): (i64, Isometry3<f64>),
        (after_ns, after): (i64, Isometry3<f64>),
    ) -> bool {
        let position = |value: Isometry3<f64>, at_ns: i64| {
            let transforms = self.links.iter().enumerate().map(|(other, link)| {
                let transform = if other == k { Some(value) } else { link.recorded.at(at_ns) };
                (link.is_inverted, transform)
            });
            product(transforms).map(|pose| pose.translation.vector)
        };
        let (Some(from), Some(to)) = (position(before, stamp_ns), position(after, stamp_ns)) else {
            return false;
        };
        let driven_m = match (position(before, before_ns), position(before, after_ns)) {
            (Some(from), Some(to)) => (to - from).norm(),
            _ => 0.0,
        };
        MIN_JUMP_M + DRIFT_SHARE * driven_m < (to - from).norm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn at(x_m: f64) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::new(x_m, 0.0, 0.5), UnitQuaternion::identity())
    }

    fn link(samples: impl IntoIterator<Item = (f64, f64)>) -> ChainLink {
        let mut recorded = RecordedTransform::default();
        samples.into_iter().for_each(|(s, x_m)| recorded.push((s * 1e9) as i64, at(x_m)));
        ChainLink { is_inverted: false, recorded }
    }

    /// odom -> base: 2 m/s at 10 Hz for 20 s.
    fn odometry() -> ChainLink {
        link((0..=200).map(|k| (0.1 * f64::from(k), 0.2 * f64::from(k))))
    }

    fn positions(found: &ChainPoses) -> Vec<(f64, f64)> {
        found.poses.iter().map(|p| (1e-9 * p.stamp_ns as f64, p.pose.x_m)).collect()
    }

    /// map -> odom every second, with a correction of 3 m after 10 s: the poses jump there at once.
    #[test]
    fn a_correction_that_jumps_is_not_interpolated() {
        let correction = link((0..=20).map(|s| (f64::from(s), if s < 11 { 0.0 } else { 3.0 })));
        let found = poses(vec![correction, odometry()], 1);
        assert_eq!((found.poses.len(), found.n_unknown), (201, 0));
        for (s, x_m) in positions(&found) {
            let expected = 2.0 * s + if s < 11.0 { 0.0 } else { 3.0 };
            assert!((x_m - expected).abs() < 1e-9, "{x_m} at {s}");
        }
        assert!(found.poses.iter().all(|p| p.z_m == Some(1.0)));
    }

    /// map -> odom every 10 s corrects a drift of 5 %, which is 1 m in 20 m.
    #[test]
    fn a_correction_of_the_drift_is_interpolated() {
        let correction = link([(0.0, 0.0), (10.0, 1.0), (20.0, 2.0)]);
        let found = poses(vec![correction, odometry()], 1);
        for (s, x_m) in positions(&found) {
            assert!((x_m - 2.1 * s).abs() < 1e-9, "{x_m} at {s}");
        }
    }

    /// The odometry comes once per second, and the correction more often: the motion is interpolated.
    #[test]
    fn slow_odometry_is_interpolated() {
        let correction = link((0..=200).map(|k| (0.1 * f64::from(k), 0.0)));
        let odometry = link((0..=20).map(|s| (f64::from(s), 3.0 * f64::from(s))));
        let found = poses(vec![correction, odometry], 0);
        for (s, x_m) in positions(&found) {
            assert!((x_m - 3.0 * s).abs() < 1e-9, "{x_m} at {s}");
        }
    }

    /// The clock steps back by 5 s after 10 s: 5.0 to 9.9 s occur twice, in 50 samples each.
    #[test]
    fn times_that_occur_twice_have_no_poses() {
        let stamp = |k: i32| 0.1 * f64::from(if k < 100 { k } else { k - 50 });
        let odometry = link((0..200).map(|k| (stamp(k), 0.2 * f64::from(k))));
        let correction = link((0..20).map(|k| (stamp(10 * k), 0.0)));
        let found = poses(vec![correction, odometry], 1);
        assert_eq!(found.repeated_ns, [(5_000_000_000, 9_900_000_000)]);
        assert_eq!(found.n_repeated, 100);
        assert!(matches!(found.clock_note, Some(NoteKind::PoseClockStepsBack { n_steps: 1, .. })));
        assert!(
            found.poses.iter().all(|p| p.stamp_ns < 5_000_000_000 || 9_900_000_000 < p.stamp_ns)
        );
    }

    /// The clock steps back by 5 s, and map -> odom jitters by 1 m. Its path is longer than that of the
    /// odometry, and its noise is the same in any order of its samples.
    #[test]
    fn a_transform_that_jitters_does_not_hide_a_step_of_the_clock() {
        let stamp = |k: i32| 0.1 * f64::from(if k < 100 { k } else { k - 50 });
        let odometry = link((0..200).map(|k| (stamp(k), 0.2 * f64::from(k))));
        let jitter = link((0..200).map(|k| (stamp(k), f64::from(k % 2))));
        assert!(odometry.recorded.path_m_rad() < jitter.recorded.path_m_rad());
        let found = poses(vec![jitter, odometry], 1);
        assert_eq!(found.repeated_ns, [(5_000_000_000, 9_900_000_000)]);
        assert_eq!(found.n_repeated, 100);
    }
}
