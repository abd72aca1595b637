//! Errors of trajectories, as evo defines them.

use dataset::{Pose2, quantile, wrap_angle};
use serde::Serialize;

/// Path lengths over which the drift is measured \[m\].
pub const DRIFT_PATHS_M: [f64; 6] = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0];
/// A pair of poses counts for a path length if its path differs by at most this share of it. This is
/// evo's default.
const PATH_TOLERANCE: f64 = 0.1;

/// The result of [`align`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alignment {
    /// Transform from the frame of the estimate to the frame of the truth.
    pub truth_from_estimate: Pose2,
    /// Root mean square of the distances between true and aligned positions \[m\]: evo's absolute pose
    /// error (`evo_ape tum truth.tum estimate.tum --align`, translation part).
    pub rmse_m: f64,
}

/// Moves and turns the estimate so that the sum of the squared distances of the positions is least
/// (Umeyama 1991, in the plane and without scale). Both slices have one pose for each stamp. `None`
/// with fewer than 2 poses, or if all positions are equal.
///
/// For points in the plane, the best rotation has the angle
/// atan2(sum of cross products, sum of dot products) of the centred positions.
pub fn align(truth: &[Pose2], estimate: &[Pose2]) -> Option<Alignment> {
    assert_eq!(truth.len(), estimate.len(), "one estimate for each true pose");
    if truth.len() < 2 {
        return None;
    }
    let (a, b) = (centre(truth), centre(estimate));
    let (mut dot, mut cross) = (0.0, 0.0);
    for (t, e) in truth.iter().zip(estimate) {
        let (tx, ty, ex, ey) = (t.x_m - a[0], t.y_m - a[1], e.x_m - b[0], e.y_m - b[1]);
        dot += ex * tx + ey * ty;
        cross += ex * ty - ey * tx;
    }
    if dot == 0.0 && cross == 0.0 {
        return None;
    }
    let heading_rad = libm::atan2(cross, dot);
    let turn = Pose2 { heading_rad, ..Pose2::default() };
    let turned = turn * Pose2 { x_m: b[0], y_m: b[1], heading_rad: 0.0 };
    let truth_from_estimate = Pose2 { x_m: a[0] - turned.x_m, y_m: a[1] - turned.y_m, heading_rad };
    let squares = truth.iter().zip(estimate).map(|(t, e)| {
        let aligned = truth_from_estimate * *e;
        let (dx, dy) = (aligned.x_m - t.x_m, aligned.y_m - t.y_m);
        dx * dx + dy * dy
    });
    let rmse_m = (squares.sum::<f64>() / truth.len() as f64).sqrt();
    Some(Alignment { truth_from_estimate, rmse_m })
}

fn centre(poses: &[Pose2]) -> [f64; 2] {
    let n = poses.len() as f64;
    let sum = |of: fn(&Pose2) -> f64| poses.iter().map(of).sum::<f64>() / n;
    [sum(|p| p.x_m), sum(|p| p.y_m)]
}

/// The error of relative poses over a path length.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Drift {
    /// The path length \[m\].
    pub path_m: f64,
    /// Number of pairs of poses.
    pub n_pairs: usize,
    /// Root mean square of the error in position \[m\]: evo's relative pose error.
    pub rmse_m: f64,
    /// Median of the error in position \[m\].
    pub median_m: f64,
    /// Root mean square of the error in heading \[rad\].
    pub rmse_rad: f64,
    /// Median of the error in heading \[rad\].
    pub median_rad: f64,
}

/// The errors of relative poses over a path length, as `evo_rpe tum truth.tum estimate.tum --delta
/// PATH_M --delta_unit m --all_pairs --pairs_from_reference`: from each pose to the later pose whose
/// true path is nearest to `path_m`, if it differs by at most 10 %. `None` without such pairs.
pub fn relative_errors(truth: &[Pose2], estimate: &[Pose2], path_m: f64) -> Option<Drift> {
    assert_eq!(truth.len(), estimate.len(), "one estimate for each true pose");
    let (mut metres, mut angles) = (Vec::new(), Vec::new());
    for (a, b) in pairs_by_path(truth, path_m) {
        let true_step = truth[a].inverse() * truth[b];
        let step = estimate[a].inverse() * estimate[b];
        let error = true_step.inverse() * step;
        metres.push((error.x_m * error.x_m + error.y_m * error.y_m).sqrt());
        angles.push(wrap_angle(error.heading_rad).abs());
    }
    if metres.is_empty() {
        return None;
    }
    let n_pairs = metres.len();
    let rms = |errors: &[f64]| {
        (errors.iter().map(|error| error * error).sum::<f64>() / n_pairs as f64).sqrt()
    };
    let (rmse_m, rmse_rad) = (rms(&metres), rms(&angles));
    metres.sort_by(f64::total_cmp);
    angles.sort_by(f64::total_cmp);
    Some(Drift {
        path_m,
        n_pairs,
        rmse_m,
        median_m: quantile(&metres, 0.5),
        rmse_rad,
        median_rad: quantile(&angles, 0.5),
    })
}

/// For each pose, the first of the later poses whose path from it is nearest to `path_m`, if it is
/// within the tolerance (evo's `filter_pairs_by_path` with all pairs).
fn pairs_by_path(poses: &[Pose2], path_m: f64) -> Vec<(usize, usize)> {
    let mut path = vec![0.0; poses.len()];
    for k in 1..poses.len() {
        path[k] = path[k - 1] + poses[k].distance_m(&poses[k - 1]);
    }
    let tolerance_m = PATH_TOLERANCE * path_m;
    let mut pairs = Vec::new();
    for a in 0..poses.len().saturating_sub(1) {
        let later = &path[a + 1..];
        let difference = |k: usize| (later[k] - path[a] - path_m).abs();
        let after = later.partition_point(|p| p - path[a] < path_m);
        // A robot that stands still gives equal paths: the first of them counts.
        let before = after.checked_sub(1).map(|k| later.partition_point(|&p| p < later[k]));
        let ends = [before, (after < later.len()).then_some(after)];
        let nearest = ends
            .into_iter()
            .flatten()
            .min_by(|&a, &b| difference(a).total_cmp(&difference(b)).then(a.cmp(&b)));
        if let Some(b) = nearest.filter(|&b| difference(b) <= tolerance_m) {
            pairs.push((a, a + 1 + b));
        }
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
    }

    /// The estimate is the truth in another frame, except that one of four positions is 2 m off in a
    /// direction that the alignment cannot explain: a square whose corners alternate outwards and
    /// inwards by 0.1 m along the diagonal keeps centre and heading, and has 0.1 m error at each corner.
    #[test]
    fn the_absolute_error_does_not_depend_on_the_frame() {
        let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)];
        let truth = corners.map(|(x, y)| at(x, y, 0.0));
        let shift = 0.1 / 2f64.sqrt();
        let bent: Vec<Pose2> = corners
            .iter()
            .enumerate()
            .map(|(k, &(x, y))| {
                let outwards = if k % 2 == 0 { shift } else { -shift };
                at(x + outwards * x, y + outwards * y, 0.0)
            })
            .collect();
        let frame = at(30.0, -7.0, 123.0);
        let moved: Vec<Pose2> = bent.iter().map(|pose| frame * *pose).collect();
        let found = align(&truth, &moved).unwrap();
        assert!((found.rmse_m - 0.1).abs() < 1e-12, "{found:?}");
        let back = found.truth_from_estimate * frame;
        assert!(back.distance_m(&Pose2::default()) < 1e-12 && back.heading_rad.abs() < 1e-12);
    }

    #[test]
    fn equal_positions_cannot_be_aligned() {
        let still = [at(1.0, 2.0, 0.0); 3];
        assert_eq!(align(&still, &still), None);
        assert_eq!(align(&still[..1], &still[..1]), None);
        assert_eq!(align(&[], &[]), None);
    }

    /// The scale of the odometry is 1 % too large and it turns by 0.5 deg/m too much, on a straight
    /// path with a pose every 0.5 m. Over L metres, the error in heading is 0.5 L deg. Poses near the end
    /// pair with the last one if it is at least 0.9 L away: up to 10 % shorter than L.
    #[test]
    fn drift_by_construction() {
        let truth: Vec<Pose2> = (0..=200).map(|k| at(0.5 * f64::from(k), 0.0, 0.0)).collect();
        let scaled: Vec<Pose2> = truth.iter().map(|p| at(3.0 + 1.01 * p.x_m, 4.0, 0.0)).collect();
        for path_m in DRIFT_PATHS_M {
            let found = relative_errors(&truth, &scaled, path_m).unwrap();
            assert_eq!(found.n_pairs, 201 - (1.8 * path_m).ceil() as usize);
            assert!((0.0097..0.010_001).contains(&(found.rmse_m / path_m)), "{found:?}");
            assert!((found.median_m - 0.01 * path_m).abs() < 1e-9 && found.rmse_rad < 1e-12);
        }
        let mut turning = vec![Pose2::default()];
        for _ in 0..200 {
            let last = turning[turning.len() - 1];
            turning.push(last * at(0.5, 0.0, 0.25));
        }
        let found = relative_errors(&truth, &turning, 10.0).unwrap();
        assert!((found.median_rad.to_degrees() - 5.0).abs() < 1e-9, "{found:?}");
        assert!((found.rmse_rad.to_degrees() - 5.0).abs() < 0.05);
        assert_eq!(relative_errors(&truth, &turning, 1000.0), None);
        assert_eq!(relative_errors(&[], &[], 1.0), None);
    }

    /// Positions 0, 1, 1, 1, 2.05, 4: over 1 m, 0 pairs with the first of the three equal poses, and
    /// each of these pairs with 2.05. From 2.05, the next pose is 1.95 m away, which is too far.
    #[test]
    fn a_pair_is_the_first_of_equally_near_poses_within_the_tolerance() {
        let poses = [0.0, 1.0, 1.0, 1.0, 2.05, 4.0].map(|x| at(x, 0.0, 0.0));
        assert_eq!(pairs_by_path(&poses, 1.0), [(0, 1), (1, 4), (2, 4), (3, 4)]);
        // Over 2 m: 0 pairs with 2.05, and 2.05 with 4.
        assert_eq!(pairs_by_path(&poses, 2.0), [(0, 4), (4, 5)]);
    }
}
