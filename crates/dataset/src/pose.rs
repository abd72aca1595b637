use std::f64::consts::{PI, TAU};
use std::ops::Mul;

/// A pose in the plane.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose2 {
    /// Position along x \[m\].
    pub x_m: f64,
    /// Position along y \[m\].
    pub y_m: f64,
    /// Angle from the x axis, counter-clockwise \[rad\].
    pub heading_rad: f64,
}

impl Pose2 {
    /// Straight-line distance to another position \[m\].
    pub fn distance_m(&self, other: &Self) -> f64 {
        let (dx, dy) = (self.x_m - other.x_m, self.y_m - other.y_m);
        (dx * dx + dy * dy).sqrt()
    }

    /// Unsigned angle between two headings \[rad\], 0 to pi.
    pub fn heading_difference_rad(&self, other: &Self) -> f64 {
        wrap_angle(self.heading_rad - other.heading_rad).abs()
    }

    /// The pose at a share of the way to another one: 0 is this pose, 1 the other one. The position is
    /// interpolated linearly, the heading along the shorter arc.
    pub fn towards(&self, other: &Self, share: f64) -> Self {
        let turn_rad = wrap_angle(other.heading_rad - self.heading_rad);
        Self {
            x_m: self.x_m + share * (other.x_m - self.x_m),
            y_m: self.y_m + share * (other.y_m - self.y_m),
            heading_rad: wrap_angle(self.heading_rad + share * turn_rad),
        }
    }

    /// The inverse transform: `b_from_a` if `self` is `a_from_b`.
    pub fn inverse(&self) -> Self {
        let (sin, cos) = libm::sincos(self.heading_rad);
        Self {
            x_m: -cos * self.x_m - sin * self.y_m,
            y_m: sin * self.x_m - cos * self.y_m,
            heading_rad: wrap_angle(-self.heading_rad),
        }
    }
}

/// Composition of transforms: `a_from_b * b_from_c` is `a_from_c`.
impl Mul for Pose2 {
    type Output = Self;

    fn mul(self, next: Self) -> Self {
        let (sin, cos) = libm::sincos(self.heading_rad);
        Self {
            x_m: self.x_m + cos * next.x_m - sin * next.y_m,
            y_m: self.y_m + sin * next.x_m + cos * next.y_m,
            heading_rad: wrap_angle(self.heading_rad + next.heading_rad),
        }
    }
}

/// Wraps an angle into (-pi, pi].
pub fn wrap_angle(rad: f64) -> f64 {
    let wrapped = rad.rem_euclid(TAU);
    if wrapped <= PI { wrapped } else { wrapped - TAU }
}

/// A pose of the robot with its time stamp.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Time of the pose \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The pose in the map frame of the site.
    pub pose: Pose2,
    /// Covariance of x, y and heading, if it is known. The upper triangle is stored row by row:
    /// xx, xy, xh, yy, yh, hh \[m^2, m rad, rad^2\].
    pub covariance: Option<[f64; 6]>,
    /// Height, if the source of the poses measures it \[m\].
    pub z_m: Option<f64>,
    /// Number of the continuous piece of the trajectory, from 0. Nothing is interpolated between two
    /// segments, and no path is counted between them.
    pub segment: u32,
    /// Number of the coordinate frame within the log, from 0. Poses in different frames have no known
    /// relation.
    pub frame: u32,
}

impl StampedPose {
    /// A pose in the first segment and frame, without covariance and height.
    pub fn new(stamp_ns: i64, pose: Pose2) -> Self {
        Self { stamp_ns, pose, covariance: None, z_m: None, segment: 0, frame: 0 }
    }
}

/// Why there is no pose at a stamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum NoPose {
    /// The stamp is before the first pose.
    #[error("before the first pose")]
    BeforeFirst,
    /// The stamp is after the last pose.
    #[error("after the last pose")]
    AfterLast,
    /// The poses before and after the stamp are too far apart in time for interpolation.
    #[error("in a gap between poses")]
    Gap,
    /// The poses before and after the stamp are in different segments.
    #[error("between two segments of the trajectory")]
    BetweenSegments,
}

/// Poses with strictly ascending time stamps.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
    /// See [`Trajectory::frame_id`].
    frame_id: Option<String>,
}

impl Trajectory {
    /// Sorts the poses by stamp. If several poses have the same stamp, only the first one in
    /// `poses` is kept.
    ///
    /// Returns the trajectory and the number of duplicate poses that were removed.
    pub fn new(mut poses: Vec<StampedPose>) -> (Self, usize) {
        poses.sort_by_key(|p| p.stamp_ns); // stable
        let before = poses.len();
        poses.dedup_by_key(|p| p.stamp_ns);
        let n_duplicates = before - poses.len();
        (Self { poses, frame_id: None }, n_duplicates)
    }

    /// The same poses with the name of their frame.
    #[must_use]
    pub fn in_frame(self, frame_id: Option<String>) -> Self {
        Self { frame_id, ..self }
    }

    /// The name of the frame that the poses are in, such as `map` or `odom`, if the log contains it.
    pub fn frame_id(&self) -> Option<&str> {
        self.frame_id.as_deref()
    }

    /// The poses, with strictly ascending time stamps.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// The interpolated pose at a stamp, without covariance. See [`Trajectory::stamped_pose_at`].
    pub fn pose_at(&self, stamp_ns: i64, max_gap_ns: i64) -> Result<Pose2, NoPose> {
        self.stamped_pose_at(stamp_ns, max_gap_ns).map(|stamped| stamped.pose)
    }

    /// The interpolated pose at a stamp.
    ///
    /// If a pose has exactly this stamp, it is returned unchanged. Otherwise the result is
    /// interpolated between the poses before and after the stamp, which must be at most
    /// `max_gap_ns` apart and in the same segment. The position is interpolated linearly, the heading
    /// along the shorter arc.
    ///
    /// The covariance is interpolated linearly if both poses have one. The errors of neighbouring
    /// poses are strongly correlated: averaging two poses does not reduce the uncertainty.
    pub fn stamped_pose_at(&self, stamp_ns: i64, max_gap_ns: i64) -> Result<StampedPose, NoPose> {
        let after = self.poses.partition_point(|p| p.stamp_ns < stamp_ns);
        let Some(next) = self.poses.get(after) else {
            return Err(NoPose::AfterLast);
        };
        if next.stamp_ns == stamp_ns {
            return Ok(*next);
        }
        let Some(previous) = after.checked_sub(1).map(|k| &self.poses[k]) else {
            return Err(NoPose::BeforeFirst);
        };
        let gap_ns = next.stamp_ns.saturating_sub(previous.stamp_ns);
        if previous.segment != next.segment {
            return Err(NoPose::BetweenSegments);
        }
        if max_gap_ns < gap_ns {
            return Err(NoPose::Gap);
        }
        let share = (stamp_ns - previous.stamp_ns) as f64 / gap_ns as f64;
        let pose = previous.pose.towards(&next.pose, share);
        let covariance = match (previous.covariance, next.covariance) {
            (Some(a), Some(b)) => Some(std::array::from_fn(|k| a[k] + share * (b[k] - a[k]))),
            _ => None,
        };
        let z_m = previous.z_m.zip(next.z_m).map(|(a, b)| a + share * (b - a));
        Ok(StampedPose { stamp_ns, pose, covariance, z_m, ..*previous })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(stamp_ns: i64, x_m: f64, heading_deg: f64) -> StampedPose {
        let heading_rad = heading_deg.to_radians();
        StampedPose::new(stamp_ns, Pose2 { x_m, y_m: -x_m, heading_rad })
    }

    /// At (1, 2), rotated left by 90 deg; then 3 ahead and 1 to the left: (1 - 1, 2 + 3).
    #[test]
    fn poses_are_composed_and_inverted() {
        let a_from_b = Pose2 { x_m: 1.0, y_m: 2.0, heading_rad: PI / 2.0 };
        let b_from_c = Pose2 { x_m: 3.0, y_m: 1.0, heading_rad: PI };
        let a_from_c = a_from_b * b_from_c;
        assert!(a_from_c.x_m.abs() < 1e-15 && (a_from_c.y_m - 5.0).abs() < 1e-15);
        assert!((a_from_c.heading_rad + PI / 2.0).abs() < 1e-15);
        let back = a_from_c * a_from_c.inverse();
        assert!(back.distance_m(&Pose2::default()) < 1e-15 && back.heading_rad.abs() < 1e-15);
    }

    #[test]
    fn the_heading_is_interpolated_along_the_shorter_arc() {
        let (trajectory, duplicates) =
            Trajectory::new(vec![at(200, 2.0, -170.0), at(100, 1.0, 170.0), at(200, 9.0, 0.0)]);
        assert_eq!(duplicates, 1);
        let pose = trajectory.pose_at(150, 100).unwrap();
        assert_eq!((pose.x_m, pose.y_m), (1.5, -1.5));
        assert!((pose.heading_rad - PI).abs() < 1e-12);
        let pose = trajectory.pose_at(125, 100).unwrap();
        assert!((pose.heading_rad - 175f64.to_radians()).abs() < 1e-12);
    }

    /// A quarter of the way from 1 to 5 is 2. If one neighbour has no covariance, the result has
    /// none.
    #[test]
    fn covariances_are_interpolated_if_both_neighbours_have_one() {
        let with = |stamp_ns, entry: f64| StampedPose {
            covariance: Some([entry, 0.0, -entry, entry, 0.0, 1.0]),
            ..at(stamp_ns, 0.0, 0.0)
        };
        let (trajectory, _) =
            Trajectory::new(vec![with(100, 1.0), with(200, 5.0), at(300, 0.0, 0.0)]);
        let covariance = |stamp_ns| trajectory.stamped_pose_at(stamp_ns, 100).unwrap().covariance;
        assert_eq!(covariance(125), Some([2.0, 0.0, -2.0, 2.0, 0.0, 1.0]));
        assert_eq!(covariance(200), Some([5.0, 0.0, -5.0, 5.0, 0.0, 1.0]));
        assert_eq!((covariance(250), covariance(300)), (None, None));
    }

    #[test]
    fn there_is_no_pose_outside_the_trajectory_or_in_a_gap() {
        let (trajectory, _) = Trajectory::new(vec![at(100, 1.0, 0.0), at(200, 2.0, 0.0)]);
        assert_eq!(trajectory.pose_at(99, 100), Err(NoPose::BeforeFirst));
        assert_eq!(trajectory.pose_at(201, 100), Err(NoPose::AfterLast));
        assert_eq!(trajectory.pose_at(101, 99), Err(NoPose::Gap));
        assert!(trajectory.pose_at(200, 0).is_ok() && trajectory.pose_at(100, 0).is_ok());
        assert_eq!(Trajectory::default().pose_at(5, 5), Err(NoPose::AfterLast));
    }

    /// A quarter of the way from 3 to 7 is 4.
    #[test]
    fn the_height_is_interpolated_within_a_segment_and_nothing_between_two() {
        let with = |stamp_ns, z, segment| StampedPose { z_m: z, segment, ..at(stamp_ns, 1.0, 0.0) };
        let (trajectory, _) = Trajectory::new(vec![
            with(100, Some(3.0), 0),
            with(200, Some(7.0), 0),
            with(300, Some(9.0), 1),
            with(400, None, 1),
        ]);
        let found = |stamp_ns| trajectory.stamped_pose_at(stamp_ns, 100);
        assert_eq!(found(125).map(|p| (p.z_m, p.segment)), Ok((Some(4.0), 0)));
        assert_eq!(found(201), Err(NoPose::BetweenSegments));
        assert_eq!(found(300).map(|p| (p.z_m, p.segment)), Ok((Some(9.0), 1)));
        assert_eq!(found(350).map(|p| (p.z_m, p.segment)), Ok((None, 1)));
    }

    #[test]
    fn angles_are_wrapped_into_the_half_open_interval() {
        assert_eq!(wrap_angle(PI), PI);
        assert_eq!(wrap_angle(-PI), PI);
        assert!((wrap_angle(3.0 * PI + 0.25) - (0.25 - PI)).abs() < 1e-12);
        let a = Pose2 { heading_rad: 3.0, ..Pose2::default() };
        let b = Pose2 { heading_rad: -3.0, ..Pose2::default() };
        assert!((a.heading_difference_rad(&b) - (TAU - 6.0)).abs() < 1e-12);
    }
}
