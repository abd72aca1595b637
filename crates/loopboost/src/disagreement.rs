//! Compares two pose topics of a log: do they agree about where the robot returns?

use dataset::{NoteKind, Pose2, Trajectory};

/// Spacing of the places that are compared \[m\]: the default of `subsample.spacing_m`.
const SPACING_M: f64 = 0.5;
/// Longest time between poses to interpolate \[ns\]: the default of `subsample.max_pose_gap_secs`.
const MAX_GAP_NS: i64 = 2_000_000_000;
/// Largest number of places. If there are more, they are thinned out: 2000 give 2 million pairs.
const MAX_PLACES: usize = 2000;
/// With fewer places there is nothing to compare.
const MIN_PLACES: usize = 20;
/// Two places this close are a revisit \[m\]: the default of `label.positive_radius_m`.
const REVISIT_M: f64 = 1.5;
/// A revisit by one topic that is farther apart than this by the other is a false positive \[m\]:
/// twice the radius of a positive pair.
const APART_M: f64 = 2.0 * REVISIT_M;
/// Least path between the two places of a revisit \[m\].
const MIN_TRAVEL_M: f64 = 10.0;
/// Fewer revisits are too few for a share.
const MIN_REVISITS: u64 = 10;
/// A larger share of contradicted revisits is a disagreement. It is about the error rate of the
/// classifiers: more wrong labels than that would decide what they learn.
const MAX_APART_SHARE: f64 = 0.1;
/// A larger ratio of the extents is a disagreement. Odometry that is scaled wrongly by that much puts
/// places 50 m apart 5 m off.
const MAX_EXTENT_RATIO: f64 = 1.1;

/// Whether two trajectories of one log disagree in their extent or in the places that the robot visits
/// twice. They can be in different frames: only distances are compared.
///
/// The extent is the root mean square distance of the places from their mean, which does not depend on
/// the orientation of the frames.
pub(crate) fn disagreement(used: &Trajectory, other: &Trajectory, name: &str) -> Option<NoteKind> {
    let places = common_places(used, other);
    if places.len() < MIN_PLACES {
        return None;
    }
    let (used_extent_m, other_extent_m) = (extent_m(&places, 0), extent_m(&places, 1));
    let ratio = used_extent_m.max(other_extent_m) / used_extent_m.min(other_extent_m);
    let of_used = revisits(&places, 0);
    let of_other = revisits(&places, 1);
    // `max` of NaN (0 / 0) and a number is the number.
    let is_far = MAX_EXTENT_RATIO < ratio;
    (is_far || of_used.are_contradicted() || of_other.are_contradicted()).then(|| {
        NoteKind::PoseTopicsDisagree {
            other: name.to_owned(),
            extent_m: used_extent_m,
            other_extent_m,
            n_revisits: of_used.n,
            n_apart: of_used.n_apart,
            other_n_revisits: of_other.n,
            other_n_apart: of_other.n_apart,
            apart_m: APART_M,
        }
    })
}

/// A place of the robot by both topics.
struct Place {
    /// Positions by the two topics.
    poses: [Pose2; 2],
    /// Path driven so far by the two topics \[m\].
    travel_m: [f64; 2],
}

/// Places along the first trajectory, [`SPACING_M`] apart, where both have a pose in one frame.
fn common_places(used: &Trajectory, other: &Trajectory) -> Vec<Place> {
    let mut places: Vec<Place> = Vec::new();
    let frame = used.poses().first().map(|pose| pose.frame);
    for pose in used.poses().iter().filter(|pose| Some(pose.frame) == frame) {
        let Ok(of_other) = other.pose_at(pose.stamp_ns, MAX_GAP_NS) else { continue };
        let poses = [pose.pose, of_other];
        let mut travel_m = [0.0; 2];
        if let Some(last) = places.last() {
            if last.poses[0].distance_m(&pose.pose) < SPACING_M {
                continue;
            }
            for k in 0..2 {
                travel_m[k] = last.travel_m[k] + last.poses[k].distance_m(&poses[k]);
            }
        }
        places.push(Place { poses, travel_m });
    }
    let every = places.len().div_ceil(MAX_PLACES).max(1);
    places.into_iter().step_by(every).collect()
}

fn extent_m(places: &[Place], of: usize) -> f64 {
    let n = places.len() as f64;
    let mean = |value: fn(&Pose2) -> f64| {
        places.iter().map(|place| value(&place.poses[of])).sum::<f64>() / n
    };
    let (x_m, y_m) = (mean(|pose| pose.x_m), mean(|pose| pose.y_m));
    let mean = Pose2 { x_m, y_m, heading_rad: 0.0 };
    let squares = places.iter().map(|place| place.poses[of].distance_m(&mean).powi(2));
    (squares.sum::<f64>() / n).sqrt()
}

/// Pairs of places that are a revisit by one topic.
struct Revisits {
    n: u64,
    /// Those that are far apart by the other topic.
    n_apart: u64,
}

impl Revisits {
    fn are_contradicted(&self) -> bool {
        MIN_REVISITS <= self.n && self.n as f64 * MAX_APART_SHARE < self.n_apart as f64
    }
}

fn revisits(places: &[Place], of: usize) -> Revisits {
    let mut revisits = Revisits { n: 0, n_apart: 0 };
    for (k, a) in places.iter().enumerate() {
        for b in &places[..k] {
            let is_revisit = a.poses[of].distance_m(&b.poses[of]) <= REVISIT_M
                && MIN_TRAVEL_M <= a.travel_m[of] - b.travel_m[of];
            if is_revisit {
                revisits.n += 1;
                let is_apart = APART_M < a.poses[1 - of].distance_m(&b.poses[1 - of]);
                revisits.n_apart += u64::from(is_apart);
            }
        }
    }
    revisits
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::StampedPose;

    /// Two laps of a square with sides of 20 m, a pose every half metre. `drift_m` is the distance
    /// between the first and the second lap, and `scale` multiplies all positions.
    fn laps(drift_m: f64, scale: f64) -> Trajectory {
        let at = |k: i64| {
            let along = (k % 160) as f64 * 0.5;
            let (x_m, y_m) = match along {
                s if s < 20.0 => (s, 0.0),
                s if s < 40.0 => (20.0, s - 20.0),
                s if s < 60.0 => (60.0 - s, 20.0),
                s => (0.0, 80.0 - s),
            };
            let y_m = y_m + drift_m * (k / 160) as f64;
            let pose = Pose2 { x_m: x_m * scale, y_m: y_m * scale, heading_rad: 0.0 };
            StampedPose::new(k * 500_000_000, pose)
        };
        Trajectory::new((0..320).map(at).collect()).0
    }

    #[test]
    fn trajectories_that_differ_by_a_rigid_motion_or_little_drift_agree() {
        assert_eq!(disagreement(&laps(0.0, 1.0), &laps(0.4, 1.0), "/odom"), None);
        assert_eq!(disagreement(&laps(0.0, 1.0), &laps(0.0, 1.05), "/odom"), None);
        let original = laps(0.0, 1.0);
        let moved = original.poses().iter().map(|pose| {
            let turned = Pose2 { x_m: 100.0, y_m: 0.0, heading_rad: 1.0 } * pose.pose;
            StampedPose { pose: turned, ..*pose }
        });
        let moved = Trajectory::new(moved.collect()).0;
        assert_eq!(disagreement(&laps(0.0, 1.0), &moved, "/odom"), None);
    }

    /// The second lap is 4 m off along y. On the two sides along x, all places that are visited twice
    /// are 4 m apart; on the sides along y they fall on other places of the first lap.
    #[test]
    fn a_drifted_second_lap_and_a_wrong_scale_disagree() {
        let Some(NoteKind::PoseTopicsDisagree { other, n_revisits, n_apart, .. }) =
            disagreement(&laps(0.0, 1.0), &laps(4.0, 1.0), "/odom")
        else {
            panic!("4 m of drift");
        };
        assert_eq!(other, "/odom");
        // Each place is a revisit with up to 7 places of the first lap (3 before and 3 after it), and
        // near the corners with some more.
        assert!(1000 < n_revisits && n_revisits <= 160 * 8, "{n_revisits}");
        assert!(n_revisits * 8 < n_apart * 10, "{n_apart} of {n_revisits}");
        assert!(disagreement(&laps(0.0, 1.0), &laps(0.0, 1.2), "/odom").is_some());
    }

    #[test]
    fn without_common_times_there_is_nothing_to_compare() {
        assert_eq!(disagreement(&laps(0.0, 1.0), &Trajectory::default(), "/odom"), None);
    }
}
