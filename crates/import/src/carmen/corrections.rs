//! Finds out whether the poses of scans contradict the `ODOM` lines.
//!
//! In a raw log, the robot's pose of a scan is its odometry. It lies between the `ODOM` lines before
//! and after the scan, or on one of them. In a corrected log it does not.

use std::collections::VecDeque;

use super::line::PlanarPose;

/// `ODOM` lines that are kept for scans with an earlier time. The lines of two sensors are out of order
/// by less than a second, and odometry arrives at 50 Hz or less.
const MAX_KEPT: usize = 64;
/// Scans that wait for later `ODOM` lines. More than that means that the odometry stopped.
const MAX_WAITING: usize = 64;
/// A pose of a scan at the time of an `ODOM` line differs by no more than rounding \[m, rad\]. CARMEN
/// writes six decimals, other tools three.
const ROUNDING: f64 = 2e-3;
/// Additional tolerance where the pose is interpolated between two lines \[m, rad\].
const INTERPOLATION: f64 = 0.02;
/// The poses contradict the odometry if at least this share of the scans does. A single scan can also
/// have the pose of an odometry that was reset.
const MIN_SHARE: f64 = 0.01;

/// Compares the poses of scans with `ODOM` lines, which are added in the order of the log.
#[derive(Debug, Clone, Default)]
pub(super) struct Corrections {
    odometry: VecDeque<(i64, PlanarPose)>,
    waiting: VecDeque<(i64, PlanarPose)>,
    pub n_compared: u64,
    pub n_contradicted: u64,
    pub largest_m: f64,
}

impl Corrections {
    pub fn add_odometry(&mut self, stamp_ns: i64, pose: PlanarPose) {
        if MAX_KEPT <= self.odometry.len() {
            self.odometry.pop_front();
        }
        self.odometry.push_back((stamp_ns, pose));
        let waiting = std::mem::take(&mut self.waiting);
        waiting.into_iter().for_each(|(stamp_ns, pose)| self.add_scan(stamp_ns, pose));
    }

    pub fn add_scan(&mut self, stamp_ns: i64, robot: PlanarPose) {
        let before = self.odometry.iter().filter(|(ns, _)| *ns <= stamp_ns).max_by_key(|o| o.0);
        let after = self.odometry.iter().filter(|(ns, _)| stamp_ns <= *ns).min_by_key(|o| o.0);
        match (before, after) {
            (Some(&(before_ns, before)), Some(&(after_ns, after))) => {
                let contradiction_m = match after_ns - before_ns {
                    // Two lines may have one time.
                    0 => {
                        let at_stamp = self.odometry.iter().filter(|(ns, _)| *ns == stamp_ns);
                        let distances = at_stamp.map(|(_, odom)| beyond(robot, *odom, 0.0, 0.0));
                        distances.min_by(f64::total_cmp).unwrap_or(0.0)
                    }
                    gap_ns => {
                        let share = (stamp_ns - before_ns) as f64 / gap_ns as f64;
                        let turn = difference_rad(after.theta, before.theta);
                        let between = PlanarPose {
                            x: before.x + share * (after.x - before.x),
                            y: before.y + share * (after.y - before.y),
                            theta: before.theta + share * turn,
                        };
                        // The pose may be that of an earlier or later line: allow a step.
                        let step_m = distance_m(before, after) + INTERPOLATION;
                        beyond(robot, between, step_m, turn.abs() + INTERPOLATION)
                    }
                };
                self.n_compared += 1;
                self.n_contradicted += u64::from(0.0 < contradiction_m);
                self.largest_m = self.largest_m.max(contradiction_m);
            }
            (Some(_), None) => {
                self.waiting.push_back((stamp_ns, robot));
                if MAX_WAITING < self.waiting.len() {
                    self.waiting.pop_front();
                }
            }
            (None, _) => {}
        }
    }

    /// Whether the poses of the scans are not those of the odometry.
    pub fn are_there(&self) -> bool {
        0 < self.n_contradicted && MIN_SHARE * self.n_compared as f64 <= self.n_contradicted as f64
    }
}

/// The distance of two poses if it is beyond the tolerances, otherwise 0 \[m\].
fn beyond(a: PlanarPose, b: PlanarPose, tolerance_m: f64, tolerance_rad: f64) -> f64 {
    let distance_m = distance_m(a, b);
    let is_beyond = tolerance_m + ROUNDING < distance_m
        || tolerance_rad + ROUNDING < difference_rad(a.theta, b.theta).abs();
    // A difference of the heading alone counts too.
    if is_beyond { distance_m.max(f64::MIN_POSITIVE) } else { 0.0 }
}

fn distance_m(a: PlanarPose, b: PlanarPose) -> f64 {
    let (dx, dy) = (a.x - b.x, a.y - b.y);
    (dx * dx + dy * dy).sqrt()
}

fn difference_rad(a: f64, b: f64) -> f64 {
    dataset::wrap_angle(a - b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64) -> PlanarPose {
        PlanarPose { x, y: 0.0, theta: 0.0 }
    }

    /// Odometry at 10 Hz and 1 m/s, and a scan in each of 50 intervals with the pose `x_m(time)`.
    fn compared(x_m: impl Fn(f64) -> f64, at_share: f64) -> Corrections {
        let mut corrections = Corrections::default();
        for k in 0..50i64 {
            corrections.add_odometry(k * 100_000_000, pose(0.1 * k as f64));
            let secs = 0.1 * (k as f64 + at_share);
            corrections.add_scan((secs * 1e9).round() as i64, pose(x_m(secs)));
        }
        corrections
    }

    #[test]
    fn a_scan_with_its_odometry_does_not_contradict_it() {
        assert!(!compared(|secs| secs, 0.0).are_there());
        assert!(!compared(|secs| secs, 0.5).are_there());
        assert!(!compared(|secs| secs - 0.06, 0.6).are_there(), "the pose of the line before");
        assert_eq!(compared(|secs| secs, 0.5).n_compared, 49);
    }

    #[test]
    fn a_corrected_pose_contradicts_the_odometry() {
        let found = compared(|secs| secs + 0.15, 0.0);
        assert!(found.are_there());
        assert_eq!((found.n_contradicted, found.n_compared), (50, 50));
        assert!((found.largest_m - 0.15).abs() < 1e-9);
        assert!(compared(|secs| secs + 0.3, 0.5).are_there());
        let turned = |x| PlanarPose { theta: 0.1, ..pose(x) };
        let mut corrections = Corrections::default();
        corrections.add_odometry(0, pose(0.0));
        corrections.add_scan(0, turned(0.0));
        assert!(corrections.are_there(), "the heading alone is corrected");
    }
}
