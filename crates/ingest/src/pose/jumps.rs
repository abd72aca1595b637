//! Jumps: steps between poses that are too fast for the robot.

use dataset::{NoteKind, StampedPose, Trajectory};

/// A step of up to this length is never a jump, however short its time \[m\], because positions are
/// rounded and stamps are late.
const STEP_TOLERANCE_M: f64 = 0.1;

/// Whether the step from one pose to the next is faster than the robot.
pub(crate) fn is_jump(a: &StampedPose, b: &StampedPose, max_speed_m_s: f64) -> bool {
    let secs = b.stamp_ns.saturating_sub(a.stamp_ns) as f64 * 1e-9;
    max_speed_m_s * secs + STEP_TOLERANCE_M < a.pose.distance_m(&b.pose)
}

/// A note with the number of jumps and the largest jump, if there are any.
pub(crate) fn jumps(trajectory: &Trajectory, max_speed_m_s: f64) -> Option<NoteKind> {
    let pairs = trajectory.poses().windows(2);
    let jumps: Vec<_> = pairs.filter(|p| is_jump(&p[0], &p[1], max_speed_m_s)).collect();
    let distance_m = |p: &[StampedPose]| p[0].pose.distance_m(&p[1].pose);
    let largest = jumps.iter().rev().max_by(|a, b| distance_m(a).total_cmp(&distance_m(b)))?;
    Some(NoteKind::PoseJumps {
        n_jumps: jumps.len() as u64,
        max_speed_m_s,
        largest_m: distance_m(largest),
        largest_s: largest[1].stamp_ns.saturating_sub(largest[0].stamp_ns) as f64 * 1e-9,
        stamp_ns: largest[0].stamp_ns,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    /// 15 m/s for 50 ms is 0.75 m; with the tolerance, 0.85 m is the limit.
    #[test]
    fn steps_faster_than_the_robot_are_jumps() {
        let pose = |ms: i64, x_m| {
            StampedPose::new(ms * 1_000_000, Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 })
        };
        assert!(!is_jump(&pose(0, 0.0), &pose(50, 0.84), 15.0));
        assert!(is_jump(&pose(0, 0.0), &pose(50, 0.86), 15.0));
        let poses = vec![pose(0, 0.0), pose(50, 0.86), pose(100, 0.9), pose(150, 3.0)];
        let note = jumps(&Trajectory::new(poses).0, 15.0);
        let Some(NoteKind::PoseJumps { n_jumps, largest_m, stamp_ns, .. }) = note else {
            panic!("{note:?}");
        };
        assert_eq!((n_jumps, stamp_ns), (2, 100_000_000));
        assert!((largest_m - 2.1).abs() < 1e-12);
    }
}
