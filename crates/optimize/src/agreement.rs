//! Which candidates agree with others near them.

use dataset::{Pose2, wrap_angle};
use model::Detector;
use rayon::prelude::*;

use crate::guided::NearPoses;
use crate::places::Places;
use crate::support::{GROUP_M, Link, is_close, path_of_links};

/// Of more links than this, only those that others near them agree with enter the pose graph. Each wrong link joins two
/// places at random, and with many of them the factor of its equations is no longer sparse: it needs memory that grows
/// with the square of the number of places, and time that grows with the third power.
const MAX_LINKS: usize = 20_000;
/// So many others must agree with a link. Along a path that the robot drives again, one place after the other has a right
/// link.
const MIN_AGREEING: usize = 2;
/// Squared error in standard deviations up to which two candidates agree: three of them in each of two directions,
/// roughly.
pub(crate) const AGREES_CHI2: f64 = 16.0;

/// Squared difference of two relative poses from two candidates, in standard deviations. Between them is a path of this
/// length, along which the poses drift.
pub(crate) fn chi2(expected: &Pose2, found: &Pose2, path_m: f64, detector: &Detector) -> f64 {
    let (noise, drift) = (&detector.closure, &detector.drift);
    let turn_variance = drift.std_rad_per_sqrt_m * drift.std_rad_per_sqrt_m * path_m;
    // A heading error that grows with the square root of the path, summed over the path.
    let variance_m2 = 2.0 * noise.consistency_std_m * noise.consistency_std_m
        + drift.std_m_per_sqrt_m * drift.std_m_per_sqrt_m * path_m
        + turn_variance * path_m * path_m / 3.0;
    let variance_rad2 = 2.0 * noise.consistency_std_rad * noise.consistency_std_rad + turn_variance;
    let distance_m = expected.distance_m(found);
    let turn_rad = wrap_angle(expected.heading_rad - found.heading_rad);
    distance_m * distance_m / variance_m2 + turn_rad * turn_rad / variance_rad2
}

/// Whether each link may enter the pose graph: all of them, or of more than [`MAX_LINKS`], those that others agree with.
pub(crate) fn admitted(links: &[Link], places: &Places<'_>, detector: &Detector) -> Vec<bool> {
    match links.len() <= MAX_LINKS {
        true => vec![true; links.len()],
        false => agreed(links, &places.path_m, &|place| places.pose(place), detector),
    }
}

/// Whether at least [`MIN_AGREEING`] other links, of other places close to those of a link, agree with it. `pose` gives
/// the pose of a place by scan matching.
fn agreed(
    links: &[Link],
    path_m: &[f64],
    pose: &(dyn Fn(usize) -> Pose2 + Sync),
    detector: &Detector,
) -> Vec<bool> {
    let pairs_m = path_of_links(links, path_m);
    let near = NearPoses::of_points(pairs_m.iter().copied(), GROUP_M);
    let between = |from: usize, to: usize| pose(from).inverse() * pose(to);
    let agrees = |link: &Link, other: &Link| {
        let expected = between(link.reference, other.reference)
            * (other.reference_from_query * between(other.query, link.query));
        let along_m = |a: usize, b: usize| (path_m[a] - path_m[b]).abs();
        let path_m = along_m(link.reference, other.reference) + along_m(link.query, other.query);
        chi2(&expected, &link.reference_from_query, path_m, detector) < AGREES_CHI2
    };
    let is_agreed = |(k, link): (usize, &Link)| {
        let others = near.around_point(pairs_m[k]).filter(|&other| {
            // Neighbours of the same place were compared with the same scans, and can share their error.
            links[other].reference != link.reference
                && links[other].query != link.query
                && is_close(&pairs_m[k], &pairs_m[other])
        });
        others.filter(|&other| agrees(link, &links[other])).take(MIN_AGREEING).count()
            == MIN_AGREEING
    };
    links.par_iter().enumerate().map(is_agreed).collect()
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    /// A drive around a square of 100 m, three times. Each place of the second and third round has a right link to the
    /// first one, with 0.1 m of noise, and three wrong ones. A single right link, far from the others, is not known
    /// to be right.
    #[test]
    fn wrong_links_are_not_agreed_with() {
        let detector = Detector::starting_values();
        let step_m = 2.5;
        let pose = |place: usize| {
            let along_m = place as f64 * step_m % 400.0;
            let (side, rest_m) = ((along_m / 100.0).floor(), along_m % 100.0);
            let start =
                Pose2 { heading_rad: side * std::f64::consts::FRAC_PI_2, ..Pose2::default() };
            let corner = [[0.0, 0.0], [100.0, 0.0], [100.0, 100.0], [0.0, 100.0]][side as usize];
            let at = start * Pose2 { x_m: rest_m, ..Pose2::default() };
            Pose2 { x_m: corner[0] + at.x_m, y_m: corner[1] + at.y_m, ..at }
        };
        let n = 480;
        let path_m: Vec<f64> = (0..n).map(|place| place as f64 * step_m).collect();
        let mut random = SplitMix64::new(5);
        let (mut links, mut is_right) = (Vec::new(), Vec::new());
        for query in 160..n {
            let right = pose(query - 160).inverse() * pose(query);
            let noisy = Pose2 { x_m: right.x_m + 0.1 * (2.0 * random.unit() - 1.0), ..right };
            links.push(Link { reference: query % 160, query, reference_from_query: noisy });
            is_right.push(true);
            for _ in 0..3 {
                let mut number = || 20.0 * (random.unit() - 0.5);
                let wrong = Pose2 { x_m: number(), y_m: number(), heading_rad: number() };
                let reference = random.below(query as u64 - 12);
                links.push(Link { reference, query, reference_from_query: wrong });
                is_right.push(false);
            }
        }
        assert_eq!(agreed(&links, &path_m, &pose, &detector), is_right);
        assert_eq!(agreed(&links[..1], &path_m, &pose, &detector), [false]);
    }
}
