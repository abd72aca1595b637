//! Jumps: steps between poses that the robot cannot have driven, judged by its own speed.
//!
//! A step is a jump if it is longer than the robot drives in the same time at twice its own speed, by more than 1 m, and if the motion before and after does not explain it either: a vehicle
//! that accelerates has a speed between the two, and a pose that jumps does not.

use dataset::StampedPose;

/// A step of up to this length is never too fast for [`is_too_fast`], however short its time \[m\],
/// because positions are rounded and stamps are late.
const STEP_TOLERANCE_M: f64 = 0.1;

/// A step that exceeds the motion of the robot by less than this is not a jump \[m\]. Localisers
/// correct their estimate in steps of some decimetres, and pairs up to 1.5 m apart show the same place
/// by default (`label.positive_radius_m`).
pub(crate) const MIN_JUMP_M: f64 = 1.0;

/// A robot can be faster than its own speed by this factor. In real logs with steps of 1 m or more, the
/// fastest step is 1.8 times (NCLT) and 2.0 times (MIT CSAIL) as fast as the own speed, because a robot
/// that turns and stops a lot rarely drives at full speed, and because stamps are late. Their steps stay
/// 1 m below the limit.
const OWN_SPEED_FACTOR: f64 = 2.0;

/// A robot that really drives faster than `ingest.pose.max_speed_m_s` can exceed its own speed by this
/// factor.
const FAST_FACTOR: f64 = 1.5;

/// A change of the height is a jump only if it is larger than 95 % of the changes between two poses by
/// this factor. The height of a satellite receiver is noisy: with normal errors, 95 % of the changes are
/// within 2.8 standard deviations, and a change of four times that does not occur by chance.
const HEIGHT_NOISE_FACTOR: f64 = 4.0;

/// The velocity of a vehicle changes by at most this \[m/s^2\]: tyres on a dry road slip at about 1 g.
const MAX_ACCELERATION_M_S2: f64 = 10.0;

/// Speeds are measured over at least this time \[ns\], because the time between two stamps can be
/// much shorter than the time between the measurements.
const WINDOW_NS: i64 = 1_000_000_000;
/// Over a longer time, the way that the robot drove is not known \[ns\].
const MAX_WINDOW_NS: i64 = 10_000_000_000;
/// A shorter distance in one window is noise, not a motion \[m\].
const MOVING_M: f64 = 0.1;

/// The own speed leaves out the motion around this number of jumps. Otherwise a robot that stands still
/// and jumps would have the speed of its jump.
const N_JUMPS_LEFT_OUT: usize = 3;

/// A stamp is late by at most this time \[s\]. A late stamp makes the step before it longer in time and
/// the step after it shorter.
const MAX_LATE_S: f64 = 1.0;
/// A step that takes less than this share of the period follows a late stamp.
const SHORT_SHARE: f64 = 0.5;
/// Longer times between two poses count as this for the mean period \[s\], because they are pauses.
const MAX_PERIOD_S: f64 = 2.0;

/// Whether the step from one pose to the next is faster than a speed.
pub(crate) fn is_too_fast(a: &StampedPose, b: &StampedPose, max_speed_m_s: f64) -> bool {
    max_speed_m_s * secs(a, b) + STEP_TOLERANCE_M < a.pose.distance_m(&b.pose)
}

/// The time from one pose to another \[s\].
pub(crate) fn secs(a: &StampedPose, b: &StampedPose) -> f64 {
    b.stamp_ns.saturating_sub(a.stamp_ns) as f64 * 1e-9
}

/// The difference of the heights of two poses \[m\]; 0 if one of them is not known.
pub(crate) fn climb_m(a: &StampedPose, b: &StampedPose) -> f64 {
    a.z_m.zip(b.z_m).map_or(0.0, |(a, b)| b - a)
}

/// How a pose differs from the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Jump {
    /// Its position.
    Position,
    /// Its height alone.
    Height,
}

/// How fast the robot drives, from its poses.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct OwnSpeed {
    /// 95 % of the motion along the ground is slower, without the fastest, which may be jumps \[m/s\].
    pub(crate) speed_m_s: f64,
    /// 95 % of the vertical motion is slower \[m/s\].
    climb_m_s: f64,
    /// 95 % of the changes of the height from one pose to the next are smaller, without the largest,
    /// which may be jumps \[m\].
    height_step_m: f64,
    /// Mean time between two poses, without pauses \[s\].
    pub(crate) period_s: f64,
    /// `ingest.pose.max_speed_m_s`.
    max_speed_m_s: f64,
}

impl OwnSpeed {
    /// Measures the speed in runs of poses in order of time. Nothing is measured between two runs.
    pub(crate) fn of<'a>(
        runs: impl Iterator<Item = &'a [StampedPose]> + Clone,
        max_speed_m_s: f64,
    ) -> Self {
        let (mut speeds, mut climbs, mut periods) = (Vec::new(), Vec::new(), Vec::new());
        let mut height_steps = Vec::new();
        for poses in runs {
            height_steps.extend(poses.windows(2).map(|pair| climb_m(&pair[0], &pair[1]).abs()));
            periods.extend(poses.windows(2).map(|pair| secs(&pair[0], &pair[1])));
            let mut end = 0;
            for start in poses {
                let since = |p: &StampedPose| p.stamp_ns.saturating_sub(start.stamp_ns);
                end += poses[end..].iter().take_while(|p| since(p) < WINDOW_NS).count();
                let Some(last) = poses.get(end).filter(|p| since(p) <= MAX_WINDOW_NS) else {
                    continue;
                };
                let s = secs(start, last);
                let moved = [start.pose.distance_m(&last.pose), climb_m(start, last).abs()];
                for (moved_m, of) in moved.into_iter().zip([&mut speeds, &mut climbs]) {
                    if MOVING_M <= moved_m {
                        of.push(moved_m / s);
                    }
                }
            }
        }
        let clipped_s: f64 = periods.iter().map(|s: &f64| s.min(MAX_PERIOD_S)).sum();
        let period_s = clipped_s / periods.len().max(1) as f64;
        // Every window that contains a jump is fast.
        let n_per_jump = (WINDOW_NS as f64 * 1e-9 / period_s.max(1e-3)).ceil() as usize;
        let speed = |of: Vec<f64>| quantile(of, 0.95, N_JUMPS_LEFT_OUT * n_per_jump);
        Self {
            speed_m_s: speed(speeds),
            climb_m_s: speed(climbs),
            height_step_m: quantile(height_steps, 0.95, N_JUMPS_LEFT_OUT),
            period_s,
            max_speed_m_s,
        }
    }

    /// The jumps in a run of poses in order of time: the index of the pose after each jump, and what
    /// jumps.
    pub(crate) fn jumps(&self, poses: &[StampedPose]) -> Vec<(usize, Jump)> {
        let times_s = self.times_s(poses);
        let steps = (1..poses.len()).zip(times_s);
        steps.filter_map(|(k, s)| Some((k, self.jump(poses, k, s)?))).collect()
    }

    /// The time that each step can have taken, `(n_poses - 1,)` \[s\]. If stamps are late, this is more
    /// than the time between the stamps.
    fn times_s(&self, poses: &[StampedPose]) -> Vec<f64> {
        let between: Vec<f64> = poses.windows(2).map(|pair| secs(&pair[0], &pair[1])).collect();
        let late = |late_s: &mut f64, s: f64| {
            let before = *late_s;
            *late_s = match s < SHORT_SHARE * self.period_s {
                true => (before + s - self.period_s).max(0.0),
                false => (s - self.period_s).clamp(0.0, MAX_LATE_S),
            };
            Some(before)
        };
        // Late by the time of the steps before, or early by the time of the steps after.
        let before_s = between.iter().scan(0.0, |late_s, s| late(late_s, *s));
        let mut after_s: Vec<f64> =
            between.iter().rev().scan(0.0, |late_s, s| late(late_s, *s)).collect();
        after_s.reverse();
        between.iter().zip(before_s.zip(after_s)).map(|(s, (a, b))| s + a + b).collect()
    }

    /// Whether a robot can have driven from one pose to another, so that both can be in one frame.
    pub(crate) fn is_reachable(&self, a: &StampedPose, b: &StampedPose) -> bool {
        let limit_m = |speed_m_s: f64| FAST_FACTOR * speed_m_s * secs(a, b) + MIN_JUMP_M;
        a.pose.distance_m(&b.pose) <= limit_m(self.speed_m_s)
            && climb_m(a, b).abs() <= limit_m(self.climb_m_s)
    }

    /// Whether pose `k` of a run jumps, after a step of `s` seconds.
    fn jump(&self, poses: &[StampedPose], k: usize, s: f64) -> Option<Jump> {
        let (a, b) = (&poses[k - 1], &poses[k]);
        let is_beyond = |moved_m: f64, own_m_s: f64| self.limit_m(own_m_s, s) < moved_m;
        let is_restart = self.is_restart(a, b);
        let jumps = is_beyond(a.pose.distance_m(&b.pose), self.speed_m_s) || is_restart;
        let climbed_m = climb_m(a, b).abs();
        let climbs = is_beyond(climbed_m, self.climb_m_s)
            && HEIGHT_NOISE_FACTOR * self.height_step_m < climbed_m;
        if !jumps && !climbs {
            return None;
        }
        if !is_restart && is_steady(poses, k) {
            return None;
        }
        Some(if jumps { Jump::Position } else { Jump::Height })
    }

    /// The longest motion that is not a jump \[m\].
    fn limit_m(&self, own_m_s: f64, s: f64) -> f64 {
        let fastest_m_s =
            (OWN_SPEED_FACTOR * own_m_s).min(self.max_speed_m_s.max(FAST_FACTOR * own_m_s));
        fastest_m_s * s + MIN_JUMP_M
    }

    /// Whether odometry starts again: after a pause, a pose is exactly at the origin. The time of the
    /// pause does not matter then.
    fn is_restart(&self, a: &StampedPose, b: &StampedPose) -> bool {
        /// A pause is longer than this number of periods.
        const PAUSE: f64 = 3.0;
        let is_origin = b.pose.x_m == 0.0 && b.pose.y_m == 0.0 && b.pose.heading_rad == 0.0;
        is_origin && PAUSE * self.period_s < secs(a, b) && MIN_JUMP_M < a.pose.distance_m(&b.pose)
    }
}

/// Whether the motion before or after the step to pose `k`, or a motion between the two, explains the step
/// up to [`MIN_JUMP_M`].
fn is_steady(poses: &[StampedPose], k: usize) -> bool {
    let (a, b) = (&poses[k - 1], &poses[k]);
    let s = secs(a, b);
    let step = [b.pose.x_m - a.pose.x_m, b.pose.y_m - a.pose.y_m, climb_m(a, b)];
    let explains = |[x, y, z]: [f64; 3]| {
        let (dx, dy) = (step[0] - x, step[1] - y);
        (dx * dx + dy * dy).sqrt() <= MIN_JUMP_M && (step[2] - z).abs() <= MIN_JUMP_M
    };
    let [before, after] = [velocity(poses, k - 1, false), velocity(poses, k, true)]
        .map(|velocity| velocity.map(|v| v.map(|v| v * s)));
    // A vehicle that accelerates is faster than before, and slower than after.
    let is_between = |(before, after): ([f64; 3], [f64; 3])| {
        let (dx, dy) = (after[0] - before[0], after[1] - before[1]);
        let squared = dx * dx + dy * dy;
        // The two velocities are means over up to a window each: their times are half a window before
        // and half a window after the step.
        let between_s = s + WINDOW_NS as f64 * 1e-9;
        if squared == 0.0 || MAX_ACCELERATION_M_S2 * between_s * s < squared.sqrt() {
            return false;
        }
        let along = (step[0] - before[0]) * dx + (step[1] - before[1]) * dy;
        let share = (along / squared).clamp(0.0, 1.0);
        explains(std::array::from_fn(|i| before[i] + share * (after[i] - before[i])))
    };
    before.is_some_and(explains)
        || after.is_some_and(explains)
        || before.zip(after).is_some_and(is_between)
}

/// The mean velocity along x, y and z before pose `at`, or after it, over up to [`WINDOW_NS`] \[m/s\].
/// It is `None` without another pose or without time.
fn velocity(poses: &[StampedPose], at: usize, after: bool) -> Option<[f64; 3]> {
    let origin = &poses[at];
    let is_near = |p: &&StampedPose| p.stamp_ns.abs_diff(origin.stamp_ns) <= WINDOW_NS as u64;
    // The next pose counts even if it is further away in time.
    let other = match after {
        true => {
            let others = &poses[at + 1..];
            others.iter().take_while(is_near).last().or(others.first())
        }
        false => {
            let others = &poses[..at];
            others.iter().rev().take_while(is_near).last().or(others.last())
        }
    }?;
    let (a, b) = if after { (origin, other) } else { (other, origin) };
    let s = secs(a, b);
    let moved = [b.pose.x_m - a.pose.x_m, b.pose.y_m - a.pose.y_m, climb_m(a, b)];
    (0.0 < s).then(|| moved.map(|m| m / s))
}

/// The largest value that is not above this share of the values, and not one of the largest `n_out`; 0
/// without values.
fn quantile(mut values: Vec<f64>, share: f64, n_out: usize) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let at = (share * values.len().saturating_sub(1) as f64) as usize;
    let last = values.len().checked_sub(1 + n_out);
    last.and_then(|last| values.get(at.min(last))).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    /// Poses at `(s, x_m, z_m)`.
    fn poses(at: impl IntoIterator<Item = (f64, f64, f64)>) -> Vec<StampedPose> {
        let pose = |(s, x_m, z_m): (f64, f64, f64)| {
            let pose = Pose2 { x_m, y_m: 1.0, heading_rad: 0.0 };
            StampedPose { z_m: Some(z_m), ..StampedPose::new((s * 1e9) as i64, pose) }
        };
        at.into_iter().map(pose).collect()
    }

    /// Jumps of a robot on level ground with 15 m/s as the limit.
    fn jumps(at: impl IntoIterator<Item = (f64, f64)>) -> Vec<(usize, Jump)> {
        let poses = poses(at.into_iter().map(|(s, x)| (s, x, 0.0)));
        OwnSpeed::of([&poses[..]].into_iter(), 15.0).jumps(&poses)
    }

    /// A robot at this speed and period that is shifted once, in the middle of 200 poses.
    fn shifted(speed_m_s: f64, period_s: f64, shift_m: f64) -> bool {
        let found = jumps((0..200).map(|k| {
            let s = period_s * f64::from(k);
            (s, speed_m_s * s + if k < 100 { 0.0 } else { shift_m })
        }));
        assert!(found.is_empty() || found == [(100, Jump::Position)], "{found:?}");
        !found.is_empty()
    }

    /// 15 m/s for 50 ms is 0.75 m; with the tolerance, 0.85 m is the limit.
    #[test]
    fn steps_faster_than_a_speed_are_too_fast() {
        let step = |x_m| poses([(0.0, 0.0, 0.0), (0.05, x_m, 0.0)]);
        assert!(!is_too_fast(&step(0.84)[0], &step(0.84)[1], 15.0));
        assert!(is_too_fast(&step(0.86)[0], &step(0.86)[1], 15.0));
    }

    /// The limit is twice the speed of the robot, plus 1 m. A step is the shift plus one period of
    /// driving: at 2.5 m/s and 0.3 s, 1.5 m + 1 m against 0.75 m + the shift.
    #[test]
    fn a_jump_is_judged_by_the_speed_of_the_robot() {
        assert!(shifted(2.5, 0.3, 1.85) && !shifted(2.5, 0.3, 1.65));
        assert!(shifted(2.5, 0.3, -3.35) && !shifted(2.5, 0.3, -3.15));
        // A slow robot, and small corrections of a localiser at 10 Hz.
        assert!(shifted(0.2, 0.1, 1.1) && !shifted(0.2, 0.1, 0.9));
        // A vehicle at 30 m/s is faster than `max_speed_m_s`: 1.5 times its speed is the limit then.
        assert!(shifted(30.0, 1.0, 20.0) && !shifted(30.0, 1.0, 15.0));
        assert!(!shifted(30.0, 0.1, 0.0));
        // A robot that stands still.
        assert!(shifted(0.0, 0.1, 3.0) && !shifted(0.0, 0.1, 0.9));
    }

    /// The height of a satellite receiver, with errors of 0.3 m from pose to pose: their sum of 12
    /// uniform samples is nearly normal. A floor of 4 m is still a jump; without noise, 1.1 m is.
    #[test]
    fn noise_of_the_height_is_no_jump() {
        let mut random = dataset::SplitMix64::new(1);
        let mut height_jumps = |noise_m: f64, floor_m: f64| {
            let mut height_m = |k: i32| {
                let error = (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
                noise_m * error + if k < 1000 { 0.0 } else { floor_m }
            };
            let poses =
                poses((0..2000).map(|k| (0.1 * f64::from(k), 0.1 * f64::from(k), height_m(k))));
            OwnSpeed::of([&poses[..]].into_iter(), 15.0).jumps(&poses)
        };
        assert_eq!(height_jumps(0.3, 0.0), []);
        assert_eq!(height_jumps(0.3, 5.0), [(1000, Jump::Height)]);
        assert_eq!(height_jumps(0.0, 1.2), [(1000, Jump::Height)]);
    }

    /// 300 s at 0.3 m/s, then 12 s at 6 m/s with poses at 1 Hz: fast steps follow each other.
    #[test]
    fn a_short_fast_drive_is_no_jump() {
        let mut x_m = 0.0;
        let at: Vec<(f64, f64)> = (0..400)
            .map(|k| {
                x_m += if (300..312).contains(&k) { 6.0 } else { 0.3 };
                (f64::from(k), x_m)
            })
            .collect();
        assert_eq!(jumps(at), []);
    }

    /// A car that is parked for 30 min, and then speeds up to 15 m/s and brakes at 2.5 m/s^2, with poses at
    /// 1 Hz. Each step is 2.5 m longer than the step before, and the noise at rest makes its own speed low.
    /// A jump of 20 m while it accelerates is still found, and so is a pose that is 20 m off.
    #[test]
    fn acceleration_and_braking_are_no_jumps() {
        let x_m = |s: f64| match s - 1800.0 {
            s if s < 0.0 => 0.15 * s.rem_euclid(2.0),
            s if s < 6.0 => 1.25 * s * s,
            s if s < 12.0 => 45.0 + 15.0 * (s - 6.0),
            s if s < 18.0 => 180.0 - 1.25 * (18.0 - s) * (18.0 - s),
            _ => 180.0,
        };
        let off = |from: i32, to: i32| {
            let times = (0..1900).map(|k| (f64::from(k), k));
            jumps(
                times.map(|(s, k)| (s, x_m(s) + if (from..to).contains(&k) { 20.0 } else { 0.0 })),
            )
        };
        assert_eq!(off(0, 0), []);
        for to in [1804, 1900] {
            assert!(off(1803, to).contains(&(1803, Jump::Position)), "{:?}", off(1803, to));
        }
        assert!(off(1803, 1804).contains(&(1804, Jump::Position)));
        assert_eq!(off(1810, 1900), [(1810, Jump::Position)], "at constant speed");
    }

    /// The stamps of a recorder that writes the ten poses of a second at once, of a vehicle at 20 m/s. A
    /// real jump is still found.
    #[test]
    fn late_stamps_are_no_jumps() {
        let at = |jump_m: f64| {
            (0..300).map(move |k| {
                let x_m = 2.0 * f64::from(k) + if k < 155 { 0.0 } else { jump_m };
                (f64::from(k / 10) + 1e-4 * f64::from(k % 10), x_m)
            })
        };
        assert_eq!(jumps(at(0.0)), []);
        assert_eq!(jumps(at(90.0)), [(155, Jump::Position)]);
    }

    /// A robot drives up a ramp and stands in a lift, at 10 Hz. Then its height changes by 3 m at once.
    #[test]
    fn a_height_jumps_if_it_changes_faster_than_the_robot_climbs() {
        let height = |s: f64| match s {
            s if s < 20.0 => 0.1 * s,
            s if s < 40.0 => 2.0 + 1.5 * (s - 20.0),
            s if s < 60.0 => 32.0,
            _ => 35.0,
        };
        let at = |from: i32, to: i32| {
            poses((from..to).map(|k| 0.1 * f64::from(k)).map(|s| (s, s.min(20.0), height(s))))
        };
        let found = |poses: &[StampedPose]| OwnSpeed::of([poses].into_iter(), 15.0).jumps(poses);
        assert_eq!(found(&at(0, 600)), []);
        assert_eq!(found(&at(0, 800)), [(600, Jump::Height)]);
        assert_eq!(found(&at(500, 700)), [(100, Jump::Height)]);
    }

    /// After a pause of 60 s, in which a robot at 1 m/s could have driven 60 m, odometry starts again.
    #[test]
    fn odometry_that_starts_again_jumps_after_any_pause() {
        let at = |pause_s: f64, x_m: f64| {
            let before = (0..300).map(|k| (0.1 * f64::from(k), 0.1 * f64::from(k)));
            let after = (0..300)
                .map(move |k| 0.1 * f64::from(k))
                .map(move |s| (s + 30.0 + pause_s, x_m + s));
            poses(before.chain(after).map(|(s, x)| (s, x, 0.0)))
                .into_iter()
                .map(|p| StampedPose { pose: Pose2 { y_m: 0.0, ..p.pose }, ..p })
                .collect::<Vec<_>>()
        };
        let found =
            |poses: Vec<StampedPose>| OwnSpeed::of([&poses[..]].into_iter(), 15.0).jumps(&poses);
        assert_eq!(found(at(60.0, 0.0)), [(300, Jump::Position)]);
        assert_eq!(found(at(60.0, 7.0)), []);
    }
}
