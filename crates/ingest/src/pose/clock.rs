//! Poses in the order of the file -> pieces in which the clock does not step back.
//!
//! Stamps can step back for two reasons. A message can be late: the recorder received it, or a tool wrote
//! it, after newer ones. Sorting by stamp puts it back in its place. Or the clock of the computer was
//! set back (NTP, a restarted simulation). Then two parts of the drive have the same times, and sorting
//! would mix them. The positions show which it is: the order in which the path is shorter is right.

use std::ops::Range;

use dataset::{NoteKind, StampedPose};

/// Poses that go back by up to this time are taken as late \[ns\]. If the clock stepped back by less, a
/// robot at 2 m/s is off by up to 0.2 m.
const LATE_NS: i64 = 100_000_000;
/// If sorting by stamp makes the path longer by this factor, the clock stepped back. If the clock steps
/// back by two periods or more, the sorted path zigzags and is at least twice as long. A late pose makes
/// the path in the order of the file longer.
const LONGER: f64 = 1.25;
/// Between two parts without common times, a smaller difference of the distances is not evidence \[m\].
const MIN_DIFFERENCE_M: f64 = 1.0;
/// A clock is not set back more often than this in a drive, by less than [`IRREGULAR_NS`]. More steps
/// are irregular stamps: the odometry of the Intel lab log has 164, of up to 0.9 s, in 45 minutes.
const MAX_STEPS: usize = 8;
/// See [`MAX_STEPS`] \[ns\].
const IRREGULAR_NS: i64 = 2_000_000_000;
/// Largest number of poses on each side of a step back that are compared. They are spread over the whole
/// common time, because the robot may stand still in a part of it, which shows nothing.
const MAX_COMPARED: usize = 500;
/// Poses after a step back that are looked at for their common time with those before: 16 min at 200 Hz.
/// With every step found it becomes less, down to [`MAX_COMPARED`]. This bounds the time that a log with
/// many steps takes.
const MAX_LOOKED_AT: usize = 200_000;

/// The pieces of poses in the order of the file.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct ClockPieces {
    /// The pieces, in the order of the file. The clock steps back between two pieces.
    pub(crate) pieces: Vec<Range<usize>>,
    /// Number of poses within the pieces that are earlier than the pose before.
    pub(crate) n_late: u64,
    /// The time by which the clock steps back after each piece but the last \[ns\].
    pub(crate) steps_ns: Vec<i64>,
}

impl ClockPieces {
    /// Finds the pieces.
    pub(crate) fn of(poses: &[StampedPose]) -> Self {
        let mut found = Self::default();
        let Some(first) = poses.first() else { return found };
        let (mut start, mut newest_ns, mut at) = (0, first.stamp_ns, 1);
        while let Some(pose) = poses.get(at) {
            if newest_ns <= pose.stamp_ns {
                newest_ns = pose.stamp_ns;
                at += 1;
                continue;
            }
            let back = poses[at..].iter().take_while(|p| p.stamp_ns < newest_ns);
            let back_ns = newest_ns.saturating_sub(pose.stamp_ns);
            let n_looked_at = (MAX_LOOKED_AT / (1 + found.steps_ns.len())).max(MAX_COMPARED);
            let looked_at = &poses[at..at + back.clone().take(n_looked_at).count()];
            if LATE_NS < back_ns && is_clock_step(&poses[start..at], looked_at) {
                found.pieces.push(start..at);
                found.steps_ns.push(back_ns);
                (start, newest_ns) = (at, pose.stamp_ns);
                at += 1;
            } else {
                let end = at + back.count();
                let with_previous = &poses[at - 1..end];
                let is_back = |pair: &&[StampedPose]| pair[1].stamp_ns < pair[0].stamp_ns;
                found.n_late += with_previous.windows(2).filter(is_back).count() as u64;
                at = end;
            }
        }
        found.pieces.push(start..poses.len());
        if MAX_STEPS < found.steps_ns.len() && found.steps_ns.iter().all(|&ns| ns < IRREGULAR_NS) {
            return Self::irregular(poses);
        }
        found
    }

    /// One piece, in which every pose that is earlier than the pose before is late.
    fn irregular(poses: &[StampedPose]) -> Self {
        let n_late = poses.windows(2).filter(|pair| pair[1].stamp_ns < pair[0].stamp_ns).count();
        let pieces = std::iter::once(0..poses.len()).collect();
        Self { pieces, n_late: n_late as u64, steps_ns: Vec::new() }
    }

    /// A note with the number of steps and the largest one, if there are any.
    pub(crate) fn note(&self, poses: &[StampedPose]) -> Option<NoteKind> {
        let largest_ns = self.steps_ns.iter().max()?;
        let first = poses.get(self.pieces.get(1)?.start)?;
        Some(NoteKind::PoseClockStepsBack {
            n_steps: self.steps_ns.len() as u64,
            largest_s: *largest_ns as f64 * 1e-9,
            stamp_ns: first.stamp_ns,
        })
    }

    /// The intervals of time that more than one piece covers, from the first to the last stamp of each,
    /// in order of time \[ns\]. They do not overlap.
    pub(crate) fn repeated_ns(&self, poses: &[StampedPose]) -> Vec<(i64, i64)> {
        let mut covered: Vec<(i64, i64)> = (self.pieces.iter())
            .filter_map(|piece| {
                let stamps = || poses[piece.clone()].iter().map(|p| p.stamp_ns);
                Some((stamps().min()?, stamps().max()?))
            })
            .collect();
        covered.sort_unstable();
        let mut repeated: Vec<(i64, i64)> = Vec::new();
        let mut newest_ns = i64::MIN;
        for (first_ns, last_ns) in covered {
            if first_ns <= newest_ns {
                let (from_ns, to_ns) = (first_ns, last_ns.min(newest_ns));
                match repeated.last_mut() {
                    Some((_, end_ns)) if from_ns <= *end_ns => *end_ns = to_ns.max(*end_ns),
                    _ => repeated.push((from_ns, to_ns)),
                }
            }
            newest_ns = newest_ns.max(last_ns);
        }
        repeated
    }
}

/// Whether the clock stepped back between two parts of the file. The poses in `back` are earlier than
/// the newest one in `before`.
fn is_clock_step(before: &[StampedPose], back: &[StampedPose]) -> bool {
    let stamps = || back.iter().map(|p| p.stamp_ns);
    let (Some(first_ns), Some(last_ns)) = (stamps().min(), stamps().max()) else { return false };
    let newest = back.iter().max_by_key(|p| p.stamp_ns);
    let [Some(oldest), Some(last), Some(next), Some(newest)] =
        [before.first(), before.last(), back.first(), newest]
    else {
        return false;
    };
    if last_ns < oldest.stamp_ns {
        // No common times: the parts belong together where the robot is at the same place.
        let in_file_m = last.pose.distance_m(&next.pose);
        return in_file_m + MIN_DIFFERENCE_M < newest.pose.distance_m(&oldest.pose);
    }
    // The poses before are in order of time, except for late ones, so this is nearly exact.
    let common = &before[before.partition_point(|p| p.stamp_ns < first_ns)..];
    let common = &common[..common.partition_point(|p| p.stamp_ns <= last_ns)];
    let [common, back] = [common, back].map(thinned);
    let in_file_m = path_m(&common) + path_m(&back);
    let mut by_stamp = [common, back].concat();
    by_stamp.sort_by_key(|p| p.stamp_ns);
    LONGER * in_file_m < path_m(&by_stamp)
}

/// Up to [`MAX_COMPARED`] of the poses, spread evenly.
fn thinned(poses: &[StampedPose]) -> Vec<StampedPose> {
    poses.iter().step_by(poses.len().div_ceil(MAX_COMPARED).max(1)).copied().collect()
}

fn path_m(poses: &[StampedPose]) -> f64 {
    poses.windows(2).map(|pair| pair[0].pose.distance_m(&pair[1].pose)).sum()
}

#[cfg(test)]
#[allow(clippy::single_range_in_vec_init, reason = "one piece is a list with one range")]
mod tests {
    use super::*;
    use dataset::Pose2;

    /// A robot that drives 2 m/s along x. `(stamp, time since the start)` in tenths of a second.
    fn poses(times: impl IntoIterator<Item = (i64, i64)>) -> Vec<StampedPose> {
        let pose = |(stamp, at): (i64, i64)| {
            let pose = Pose2 { x_m: 0.2 * at as f64, y_m: 0.0, heading_rad: 0.0 };
            StampedPose::new(stamp * 100_000_000, pose)
        };
        times.into_iter().map(pose).collect()
    }

    /// Pieces, late poses, and the repeated times in tenths of a second.
    fn check(poses: &[StampedPose], pieces: &[Range<usize>], n_late: u64, repeated: &[(i64, i64)]) {
        let found = ClockPieces::of(poses);
        assert_eq!(found.pieces, pieces);
        assert_eq!(found.n_late, n_late);
        assert_eq!(found.steps_ns.len() + 1, pieces.len());
        let tenths = |(a, b): (i64, i64)| (a / 100_000_000, b / 100_000_000);
        assert_eq!(found.repeated_ns(poses).into_iter().map(tenths).collect::<Vec<_>>(), repeated);
    }

    /// The clock steps back by 3 s after 10 s: 7.0 to 9.9 s occur twice.
    #[test]
    fn a_clock_that_steps_back_starts_a_piece() {
        let times = (0..200).map(|at| (if at < 100 { at } else { at - 30 }, at));
        check(&poses(times), &[0..100, 100..200], 0, &[(70, 99)]);
        // A step of 0.4 s.
        let times = (0..200).map(|at| (if at < 100 { at } else { at - 4 }, at));
        check(&poses(times), &[0..100, 100..200], 0, &[(96, 99)]);
        // A simulation that starts again twice, after 10 s and after 5 s.
        let times = (0..200).map(|at| (if at < 150 { at % 100 } else { at - 150 }, at));
        check(&poses(times), &[0..100, 100..150, 150..200], 0, &[(0, 49)]);
    }

    /// The clock is 1 h ahead for 2 s: no time occurs twice.
    #[test]
    fn a_clock_that_is_set_at_the_start_repeats_no_time() {
        let times = (0..100).map(|at| (if at < 20 { 36_000 + at } else { at }, at));
        check(&poses(times), &[0..20, 20..100], 0, &[]);
    }

    #[test]
    fn late_poses_are_no_step() {
        // One pose is 2 s late; ten poses are 3 s late; two poses change places.
        let mut order: Vec<i64> = (0..100).collect();
        let one = order.remove(20);
        order.insert(40, one);
        check(&poses(order.iter().map(|&t| (t, t))), &[0..100], 1, &[]);
        let mut order: Vec<i64> = (0..50).chain(60..100).collect();
        order.splice(80..80, 50..60);
        check(&poses(order.iter().map(|&t| (t, t))), &[0..100], 1, &[]);
        // Two threads of a recorder that write every other pose, one of them 2 s late.
        let order = (0..100).flat_map(|t| [2 * t, (2 * t - 19).max(1)]);
        check(&poses(order.map(|t| (t, t))), &[0..200], 99, &[]);
        // The second file of a drive starts with a copy of the last 2 s of the first.
        let order = (0..100).chain(80..150);
        check(&poses(order.map(|t| (t, t))), &[0..170], 1, &[]);
        // The second half of the drive is first in the file.
        let order = (50..100).chain(0..50);
        check(&poses(order.map(|t| (t, t))), &[0..100], 1, &[]);
        // A robot that stands still.
        let times = (0..100).map(|at| (if at < 50 { at } else { at - 20 }, 0));
        check(&poses(times), &[0..100], 1, &[]);
    }

    /// A clock that steps back by 0.5 s and forward again, every 10 s: with 8 steps it was set, with
    /// 9 its stamps are irregular. With steps of 3 s it is a simulation that starts again.
    #[test]
    fn many_small_steps_back_are_irregular_stamps() {
        let times = |n_steps: i64, step: i64| {
            let stamp = move |at: i64| at - step * ((at - 1) / 100);
            (0..100 * (n_steps + 1)).map(move |at| (stamp(at), at))
        };
        for (n_steps, step, n_pieces) in [(8, 5, 9), (9, 5, 1), (12, 30, 13)] {
            let found = ClockPieces::of(&poses(times(n_steps, step)));
            assert_eq!(found.pieces.len(), n_pieces, "{n_steps} {step}");
            let n_late = if n_pieces == 1 { n_steps as u64 } else { 0 };
            assert_eq!(found.n_late, n_late, "{n_steps} {step}");
        }
    }

    /// The robot stands for 250 s. Meanwhile, the clock steps back by 150 s, 100 s before the robot drives
    /// away. These 100 s have more poses than are compared.
    #[test]
    fn a_clock_that_steps_back_while_the_robot_stands_starts_a_piece() {
        let place = |at: i64| if at < 3000 { at.min(500) } else { at - 2500 };
        let times = (0..6000).map(|at| (if at < 2000 { at } else { at - 1500 }, place(at)));
        check(&poses(times), &[0..2000, 2000..6000], 0, &[(500, 1999)]);
    }

    /// 2000 poses are late by 250 s, and 3000 poses occur twice: more than are compared.
    #[test]
    fn many_late_poses_are_no_step() {
        let order = (0..1000).chain(3000..5500).chain(1000..3000).chain(5500..6000);
        check(&poses(order.map(|t| (t, t))), &[0..6000], 1, &[]);
        let order = (0..5000).chain(2000..7000);
        check(&poses(order.map(|t| (t, t))), &[0..10_000], 1, &[]);
    }

    /// Stamps that only go down are late, not one piece each.
    #[test]
    fn stamps_in_reverse_order_are_one_piece() {
        check(&poses((0..100).rev().map(|t| (10 * t, t))), &[0..100], 99, &[]);
        assert_eq!(ClockPieces::of(&[]), ClockPieces::default());
    }
}
