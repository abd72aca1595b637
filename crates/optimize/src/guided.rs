//! Comparison of places that the optimized poses predict to be the same.

use std::collections::BTreeMap;

use dataset::Pose2;
use model::ClosureNoise;
use nalgebra::Matrix3;
use rayon::prelude::*;
use register::{
    AlignOptions, Fit, Preference, Prior, Window, align_roughly, closure_covariance, fit,
    fit_options, map_order, search,
};

use crate::places::{Place, Places};

/// Places up to this far apart are compared \[m\].
pub(crate) const REACH_M: f64 = 4.0;
/// The search covers this distance and angle on either side of the predicted pose.
const SEARCH_M: f64 = 0.6;
const SEARCH_STEP_M: f64 = 0.15;
const SEARCH_DEG: f64 = 6.0;
const SEARCH_STEP_DEG: f64 = 1.0;
/// Reduction of the score of the search per squared metre and squared radian from the prediction.
const PREFERENCE: f64 = 0.05;
/// More starts, relative to the prediction: x \[m\], y \[m\], heading \[rad\].
const MORE_STARTS: [[f64; 3]; 4] =
    [[0.35, 0.0, 0.06], [-0.35, 0.0, -0.06], [0.0, 0.35, -0.06], [0.0, -0.35, 0.06]];
/// The most iterations of an alignment.
const ITERATIONS: u32 = 20;
/// The most starts that may lead to a rival: one of six.
const MAX_RIVALS: usize = 1;
/// Another pose is a rival of the best one if its known overlap minus conflict is less by at most this. The value
/// is a guess.
const RIVAL: f64 = 0.1;
/// The least number of known points of a pair that the scans confirm.
const MIN_POINTS: usize = 60;
/// Two starts lead to the same pose if the results are closer than this.
const SAME_M: f64 = 0.1;
const SAME_DEG: f64 = 1.0;

/// A pair is not compared again for predictions closer than this.
const REUSE_M: f64 = 0.02;
const REUSE_DEG: f64 = 0.2;

/// Pairs that are compared at once. Their places are in memory.
const PAIRS_AT_ONCE: usize = 64;

/// Two places, and the relative pose that the optimized poses predict.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Prediction {
    /// Index of the earlier place.
    pub(crate) reference: usize,
    /// Index of the later place.
    pub(crate) query: usize,
    pub(crate) reference_from_query: Pose2,
    /// Whether the graph knows their relative position well enough to be wrong if the scans do not confirm it.
    pub(crate) is_certain: bool,
}

/// Two compared places.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Compared {
    pub(crate) reference: usize,
    pub(crate) query: usize,
    pub(crate) fit: Fit,
    /// Whether the scans of both places have enough points to confirm anything.
    has_points: bool,
    /// Whether the map is wrong if the scans do not confirm this pair: the prediction is certain, and the places have
    /// points.
    pub(crate) counts: bool,
    /// Distance and angle between the predicted and the found relative pose.
    pub(crate) moved_m: f64,
    pub(crate) turned_rad: f64,
    /// Whether no other pose fits about as well: few starts lead to one. False where the rest already decides
    /// against the pair: then they are not tried.
    pub(crate) is_agreed: bool,
}

impl Compared {
    fn new(prediction: &Prediction, fit: Fit, has_points: bool, is_agreed: bool) -> Self {
        let off = prediction.reference_from_query.inverse() * fit.a_from_b;
        Self {
            reference: prediction.reference,
            query: prediction.query,
            counts: prediction.is_certain && has_points,
            has_points,
            fit,
            moved_m: length(&off),
            turned_rad: off.heading_rad.abs(),
            is_agreed,
        }
    }

    /// Whether the scans confirm the predicted pose.
    ///
    /// The limits were set with two recorded drives and held on others. See the share test in
    /// `support.rs`.
    pub(crate) fn is_confirmed(&self) -> bool {
        self.is_agreed && self.is_plausible()
    }

    /// Whether the found pose is near the predicted one, and the scans fit.
    fn is_plausible(&self) -> bool {
        0.3 < self.fit.known_overlap
            && MIN_POINTS <= self.fit.n_known
            && self.fit.known_conflict() < 0.35
            && self.moved_m < 0.35
            && self.turned_rad < 3f64.to_radians()
            && self.fit.alignment.weakness.is_some_and(|weakness| 0.02 < weakness.ratio)
    }
}

/// Called with a query and the places near it. Keeps the references that the query is compared with.
pub(crate) type Retain<'a> = dyn Fn(usize, &mut Vec<usize>) + Sync + 'a;

/// The pairs of places, of those that `retain` keeps, that are at most [`REACH_M`] apart by `poses`. With a
/// limit, at most so many references per query, the nearest first, and at most one per piece of path.
pub(crate) fn predictions(
    path_m: &[f64],
    poses: &[Pose2],
    retain: &Retain<'_>,
    limit: Option<Limit>,
) -> Vec<Prediction> {
    let near_poses = NearPoses::new(poses, REACH_M);
    let of_query = |query: usize| {
        let distance_m = |k: usize| poses[k].distance_m(&poses[query]);
        let mut near: Vec<usize> =
            near_poses.around(&poses[query]).filter(|&k| distance_m(k) <= REACH_M).collect();
        retain(query, &mut near);
        let mut near: Vec<(f64, usize)> = near.into_iter().map(|k| (distance_m(k), k)).collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        if let Some(limit) = limit {
            let mut seen = Vec::new();
            near.retain(|&(_, k)| {
                let piece = (path_m[k] / limit.every_m).floor() as i64;
                let is_new = !seen.contains(&piece) && seen.len() < limit.most;
                if is_new {
                    seen.push(piece);
                }
                is_new
            });
        }
        near.into_iter()
            .map(|(_, reference)| Prediction {
                reference,
                query,
                reference_from_query: poses[reference].inverse() * poses[query],
                is_certain: true,
            })
            .collect::<Vec<_>>()
    };
    (0..poses.len()).into_par_iter().flat_map_iter(of_query).collect()
}

/// How many references a query is compared with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limit {
    pub(crate) most: usize,
    /// At most one reference per piece of path of this length \[m\].
    pub(crate) every_m: f64,
}

/// Comparisons of places, with what the last one of each pair found.
pub(crate) struct Comparisons<'a> {
    places: &'a Places<'a>,
    /// By reference and query: the predicted relative pose, and the result.
    last: BTreeMap<(usize, usize), (Pose2, Compared)>,
}

impl<'a> Comparisons<'a> {
    pub(crate) fn new(places: &'a Places<'a>) -> Self {
        Self { places, last: BTreeMap::new() }
    }

    /// Compares places around their predicted relative poses. The results have the order of the
    /// predictions. A pair whose prediction is nearly that of its last comparison is not compared again.
    pub(crate) fn compare(&mut self, predictions: &[Prediction]) -> Vec<Compared> {
        let known: Vec<Option<Compared>> = predictions.iter().map(|p| self.known(p)).collect();
        let is_new = |(p, known): (&Prediction, &Option<Compared>)| known.is_none().then_some(*p);
        let new: Vec<Prediction> = predictions.iter().zip(&known).filter_map(is_new).collect();
        let mut found = compare(self.places, &new).into_iter().zip(&new);
        known
            .into_iter()
            .filter_map(|known| {
                known.or_else(|| {
                    let (compared, prediction) = found.next()?;
                    let expected = prediction.reference_from_query;
                    self.last.insert(prediction.pair(), (expected, compared));
                    Some(compared)
                })
            })
            .collect()
    }

    /// The result of the last comparison, for a prediction that is nearly the same.
    fn known(&self, prediction: &Prediction) -> Option<Compared> {
        let (before, compared) = self.last.get(&prediction.pair())?;
        let expected = prediction.reference_from_query;
        let off = before.inverse() * expected;
        let is_same = length(&off) < REUSE_M && off.heading_rad.abs() < REUSE_DEG.to_radians();
        let again =
            Compared::new(prediction, compared.fit, compared.has_points, compared.is_agreed);
        (is_same && again.is_plausible() == compared.is_plausible()).then_some(again)
    }
}

impl Prediction {
    fn pair(&self) -> (usize, usize) {
        (self.reference, self.query)
    }
}

/// Compares places around their predicted relative poses. The results have the order of the
/// predictions.
pub(crate) fn compare(places: &Places<'_>, predictions: &[Prediction]) -> Vec<Compared> {
    // In this order, consecutive pairs have places in common, and places have scans in common.
    let order = map_order(predictions.iter().map(|p| places.pose(p.query)));
    let mut compared: Vec<(usize, Compared)> = Vec::with_capacity(predictions.len());
    for block in order.chunks(PAIRS_AT_ONCE) {
        let pair = |k: &usize| [predictions[*k].reference, predictions[*k].query];
        let near = places.get(&block.iter().flat_map(pair).collect());
        compared.par_extend(block.par_iter().map(|&k| {
            let p = &predictions[k];
            (k, compare_pair(&near[&p.reference], &near[&p.query], p))
        }));
    }
    compared.sort_unstable_by_key(|(k, _)| *k);
    compared.into_iter().map(|(_, compared)| compared).collect()
}

fn compare_pair(a: &Place, b: &Place, prediction: &Prediction) -> Compared {
    let expected = prediction.reference_from_query;
    let window = Window {
        centre: expected,
        half_width_m: SEARCH_M,
        step_m: SEARCH_STEP_M,
        half_turn_rad: SEARCH_DEG.to_radians(),
        step_rad: SEARCH_STEP_DEG.to_radians(),
    };
    let preference = Preference { pose: expected, per_m2: PREFERENCE, per_rad2: PREFERENCE };
    let found = search(&a.walls, &b.few_points, &window, &preference).pose;
    // The measurement aligns with all points.
    let end = |start: &Pose2| {
        let options = fit_options(0.5, ITERATIONS);
        align_roughly(b.node.sample(), a.node.target(), start, &Prior::none(*start), &options)
    };
    let measured = |end: &Pose2| fit(&a.node, &b.node, end, &last_options());
    let of_found = end(&found);
    // The search often finds the predicted pose itself.
    let of_expected = if found == expected { of_found } else { end(&expected) };
    let ends = [of_found, of_expected];
    let first = measured(&ends[0]);
    let second = is_elsewhere(&first.a_from_b, &ends[1]).then(|| measured(&ends[1]));
    let best = second.filter(|second| agreement(&first) < agreement(second)).unwrap_or(first);
    let has_points = [a, b].iter().all(|place| MIN_POINTS <= place.node.sample().len());
    let mut compared = Compared::new(prediction, best, has_points, false);
    if compared.is_plausible() {
        let leads_to_rival =
            |end: &Pose2| is_elsewhere(&best.a_from_b, end) && is_rival(&best, &measured(end));
        let more = MORE_STARTS.map(|[x, y, heading]| Pose2 {
            x_m: expected.x_m + x,
            y_m: expected.y_m + y,
            heading_rad: expected.heading_rad + heading,
        });
        // Lazily: the starts after one rival too many are not tried.
        let rivals = ends.into_iter().chain(more.iter().map(end)).filter(leads_to_rival);
        compared.is_agreed = rivals.take(MAX_RIVALS + 1).count() <= MAX_RIVALS;
    }
    compared
}

/// How well the scans fit.
fn agreement(fit: &Fit) -> f64 {
    fit.known_overlap - fit.known_conflict()
}

/// Whether another pose fits about as well as the best one.
fn is_rival(best: &Fit, other: &Fit) -> bool {
    is_elsewhere(&best.a_from_b, &other.a_from_b) && agreement(best) - RIVAL < agreement(other)
}

/// Whether two relative poses differ.
fn is_elsewhere(a: &Pose2, b: &Pose2) -> bool {
    let off = a.inverse() * *b;
    SAME_M <= length(&off) || SAME_DEG.to_radians() <= off.heading_rad.abs()
}

/// Distance of a relative pose \[m\].
fn length(pose: &Pose2) -> f64 {
    pose.distance_m(&Pose2::default())
}

/// Poses by square, for the search of near ones.
pub(crate) struct NearPoses {
    size_m: f64,
    by_square: BTreeMap<(i64, i64), Vec<usize>>,
}

impl NearPoses {
    /// Sorts poses into squares of a size, which is the reach of the search.
    pub(crate) fn new(poses: &[Pose2], size_m: f64) -> Self {
        Self::of_points(poses.iter().map(|pose| [pose.x_m, pose.y_m]), size_m)
    }

    /// The same for points.
    pub(crate) fn of_points(points: impl Iterator<Item = [f64; 2]>, size_m: f64) -> Self {
        let mut squares = Self { size_m, by_square: BTreeMap::new() };
        for (k, point) in points.enumerate() {
            squares.by_square.entry(squares.square(point)).or_default().push(k);
        }
        squares
    }

    fn square(&self, point: [f64; 2]) -> (i64, i64) {
        let [x, y] = point.map(|v| (v / self.size_m).floor() as i64);
        (x, y)
    }

    /// All poses within the size of a square, and some others.
    pub(crate) fn around(&self, pose: &Pose2) -> impl Iterator<Item = usize> + '_ {
        self.around_point([pose.x_m, pose.y_m])
    }

    /// All points within the size of a square, and some others.
    pub(crate) fn around_point(&self, point: [f64; 2]) -> impl Iterator<Item = usize> + '_ {
        let (x, y) = self.square(point);
        let around = (x - 1..=x + 1).flat_map(move |x| (y - 1..=y + 1).map(move |y| (x, y)));
        around.filter_map(|square| self.by_square.get(&square)).flatten().copied()
    }
}

/// Covariance of the relative pose of a comparison.
pub(crate) fn covariance(fit: &Fit, noise: &ClosureNoise) -> Matrix3<f64> {
    closure_covariance(&fit.alignment, &last_options(), noise)
}

/// The last alignment of a comparison, after which the fit is measured.
fn last_options() -> AlignOptions {
    fit_options(0.25, 8)
}

#[cfg(test)]
mod tests {
    use register::Alignment;

    use super::*;

    fn fit_at(x_m: f64, heading_deg: f64, known_overlap: f64, conflict: f64) -> Fit {
        let a_from_b = Pose2 { x_m, y_m: 0.0, heading_rad: heading_deg.to_radians() };
        let alignment = Alignment {
            target_from_source: a_from_b,
            information: Matrix3::identity(),
            weakness: None,
            prior_information: Matrix3::zeros(),
            n_partners: 100,
            rms_m: 0.01,
        };
        let known = 1.0;
        Fit {
            a_from_b,
            alignment,
            overlap: known_overlap,
            known_overlap,
            n_known: 100,
            known,
            conflict,
        }
    }

    /// The best pose has a known overlap of 0.85 and a conflict of 0.05: 0.8. Rivals have more than 0.7.
    #[test]
    fn only_a_pose_elsewhere_that_fits_about_as_well_is_a_rival() {
        let best = fit_at(1.0, 0.0, 0.85, 0.05);
        for (x_m, heading_deg, known_overlap, conflict, expected) in [
            // The same pose: 0.08 m and 0.8 deg away.
            (1.08, 0.8, 0.85, 0.05, false),
            (1.3, 0.0, 0.85, 0.05, true),
            (1.0, 2.0, 0.85, 0.05, true),
            (1.3, 0.0, 0.73, 0.01, true),
            // As much overlap, and more conflict.
            (1.3, 0.0, 0.85, 0.2, false),
            (1.3, 0.0, 0.6, 0.05, false),
        ] {
            let other = fit_at(x_m, heading_deg, known_overlap, conflict);
            assert_eq!(is_rival(&best, &other), expected, "{other:?}");
        }
    }
}
