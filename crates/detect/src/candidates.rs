//! Candidates: pairs of places with a relative pose and evidence.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use dataset::Pose2;
use model::{Detector, Evidence};
use nalgebra::Matrix3;
use rayon::prelude::*;
use register::{AlignOptions, Drive, Fit, Node, Submap, closure_covariance, fit, fit_options};

use crate::correlation::{Peak, Query, Reference, Scores, UNIT};
use crate::descriptor::Describer;
use crate::places::Places;
use crate::retrieval::{Descriptors, Similar};

/// Two places that may be the same.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Index of the later keyframe in the drive.
    pub query: usize,
    /// Index of the earlier keyframe in the drive.
    pub reference: usize,
    /// Pose of the lidar at the query in the frame of the lidar at the reference.
    pub reference_from_query: Pose2,
    /// Covariance of x, y and heading of that pose, in the frame of the reference.
    pub covariance: Matrix3<f64>,
    /// What speaks for and against it.
    pub evidence: Evidence,
    /// Confidence that the pose is right, 0 to 1.
    pub confidence: f64,
    /// Rank of the reference among the places that correlate best with the query, from 0.
    pub rank: u32,
}

/// Confidence of the classifier for two keyframes of a drive (indices in the drive).
pub type Classify<'a> = &'a (dyn Fn(usize, usize) -> f64 + Sync);

/// Places whose candidates are aligned at once. Their nodes are in memory.
const QUERIES_AT_ONCE: usize = 32;
/// Relative poses of a pair of places that are aligned.
const N_POSES: usize = 3;
/// This many places are compared with each place by correlation, or `n_candidates` if that is more.
///
/// The number does not depend on `n_candidates`, so fewer candidates are the first of more. On intel-lab,
/// with 5 candidates per place, 5 places by descriptor alone find 162 of 202 revisits; 20, 30 and 50
/// compared by correlation find 186, 194 and 195.
pub(crate) const N_CORRELATED: usize = 50;
/// For each place compared by correlation, this many are ranked by the classifier.
const RANKED_PER_CORRELATED: usize = 2;
/// The first gate of the alignment \[m\]: two squares of the submaps.
const FIRST_GATE_M: f64 = 0.8;
/// The most iterations of the alignment.
const MAX_ITERATIONS: u32 = 20;

/// Finds candidates among the places of a drive: for each place, the most similar earlier places at
/// least `min_path_m` of path before it; for each of these, relative poses by correlation, aligned and
/// checked in both directions. At most one candidate per pair of places.
///
/// 1. The 50 places with the nearest descriptors are compared by correlation. With a classifier, twice as
///    many are ranked by it too, and those with the smallest sum of the two ranks are compared (Borda
///    count). So neither of the two needs a threshold or a scale.
/// 2. The `detector.n_candidates` places with the largest score plus margin are kept. The score is that of
///    the best pose, the margin ([`Evidence::margin`]) its difference from the second-best pose, both
///    divided by the number of walls of the submap that has fewer.
/// 3. The best pose and up to two others with at least half of its score are aligned. The one with the
///    largest overlap minus conflict counts, each over all points plus over the points in known space.
///
/// The candidates are in the order of the places, and of the ranks within a place. A pair without walls in
/// common gives no candidate.
pub fn find_candidates(
    drive: &Drive,
    places: &Places<'_>,
    detector: &Detector,
    min_path_m: f64,
    classify: Option<Classify<'_>>,
) -> Vec<Candidate> {
    let path_m: Vec<f64> = places.scans.iter().map(|&k| drive.path_m[k]).collect();
    let n_references: Vec<usize> =
        path_m.iter().map(|&q| path_m.partition_point(|&r| min_path_m <= q - r)).collect();
    candidates_among(places, &n_references, detector, classify)
}

/// Finds candidates between drives, in the same way: for each place of each drive from `first_drive` on, among
/// the places of all drives before its own. `drive` and `places` are [`Drive::joined`] and
/// [`Places::joined`].
pub fn find_candidates_between(
    drive: &Drive,
    places: &Places<'_>,
    detector: &Detector,
    first_drive: usize,
    classify: Option<Classify<'_>>,
) -> Vec<Candidate> {
    let n_earlier = |query: &usize| {
        let of_drive = drive.starts.partition_point(|start| start <= query) - 1;
        match first_drive <= of_drive {
            true => places.scans.partition_point(|&scan| scan < drive.starts[of_drive]),
            false => 0,
        }
    };
    let n_references: Vec<usize> = places.scans.iter().map(n_earlier).collect();
    candidates_among(places, &n_references, detector, classify)
}

/// For each place, candidates among the first `n_references` places.
fn candidates_among(
    places: &Places<'_>,
    n_references: &[usize],
    detector: &Detector,
    classify: Option<Classify<'_>>,
) -> Vec<Candidate> {
    let Some(first) = places.submaps.first() else { return Vec::new() };
    let describer = Describer::new(first.n_squares());
    let rows: Vec<Vec<f32>> =
        places.submaps.par_iter().map(|submap| describer.describe(submap)).collect();
    let similar = similar_places(places, &rows, n_references, detector, classify);
    let finder = Finder { places, detector, classify, options: options() };
    let queries: Vec<usize> = (0..places.submaps.len()).collect();
    let blocks = queries.chunks(QUERIES_AT_ONCE);
    blocks.flat_map(|queries| finder.candidates(queries, &similar)).collect()
}

/// For each place, the earlier places that it is compared with, the most similar one first.
fn similar_places(
    places: &Places<'_>,
    rows: &[Vec<f32>],
    n_references: &[usize],
    detector: &Detector,
    classify: Option<Classify<'_>>,
) -> Vec<Vec<usize>> {
    let n = N_CORRELATED.max(detector.n_candidates as usize);
    let n_ranked = if classify.is_some() { RANKED_PER_CORRELATED * n } else { n };
    let similar = Descriptors::new(rows).most_similar(n_ranked, n_references);
    let order = |(query, similar): (usize, Vec<_>)| {
        let by_descriptor: Vec<usize> = similar.into_iter().map(|s: Similar| s.reference).collect();
        let mut ranked = match classify {
            Some(classify) => {
                let confidence = |&r: &usize| classify(places.scans[query], places.scans[r]);
                let confidences: Vec<f64> = by_descriptor.iter().map(confidence).collect();
                let ranks = rank_sums(&confidences);
                ranks.into_iter().map(|k| by_descriptor[k]).collect()
            }
            None => by_descriptor,
        };
        ranked.truncate(n);
        ranked
    };
    similar.into_par_iter().enumerate().map(order).collect()
}

/// The order of the smallest sum of two ranks: the index, and the rank by falling confidence. Of equal
/// sums, the smaller index comes first.
fn rank_sums(confidences: &[f64]) -> Vec<usize> {
    let mut by_confidence: Vec<usize> = (0..confidences.len()).collect();
    by_confidence.sort_by(|&a, &b| confidences[b].total_cmp(&confidences[a]));
    let mut sums: Vec<usize> = (0..confidences.len()).collect();
    for (rank, &k) in by_confidence.iter().enumerate() {
        sums[k] += rank;
    }
    let mut order: Vec<usize> = (0..confidences.len()).collect();
    order.sort_by_key(|&k| (sums[k], k));
    order
}

struct Finder<'a> {
    places: &'a Places<'a>,
    detector: &'a Detector,
    classify: Option<Classify<'a>>,
    options: AlignOptions,
}

/// A pair of places compared by correlation.
pub(crate) struct Correlated {
    pub(crate) reference: usize,
    /// The best poses.
    pub(crate) peaks: Vec<Peak>,
    /// Best score per wall.
    score: f64,
    /// See [`Evidence::margin`].
    pub(crate) margin: f64,
}

/// How candidates are aligned.
pub(crate) fn options() -> AlignOptions {
    fit_options(FIRST_GATE_M, MAX_ITERATIONS)
}

/// Compares places with a query by correlation. The best one comes first; of equal ones, the first one. `submap_of`
/// gives the submap of a place.
pub(crate) fn correlate<'a>(
    submap_of: impl Fn(usize) -> &'a Submap,
    query: &Submap,
    references: &[usize],
) -> Vec<Correlated> {
    if references.is_empty() {
        return Vec::new();
    }
    let turned = Query::new(query);
    let one = |&reference: &usize| Correlated::new(submap_of(reference), reference, &turned);
    let mut correlated: Vec<Correlated> = references.iter().filter_map(one).collect();
    correlated.sort_by(|a, b| (b.score + b.margin).total_cmp(&(a.score + a.margin)));
    correlated
}

impl Correlated {
    /// `None` if no pose puts more walls onto walls than into free space.
    fn new(submap: &Submap, reference: usize, turned: &Query) -> Option<Self> {
        let map = Reference::new(submap);
        let peaks = Scores::new(&map, turned).peaks(N_POSES);
        let best = peaks.first().filter(|best| 0 < best.score)?.score;
        let second = peaks.get(1).map_or(0, |peak| peak.score);
        // Without a wall, there is no score above 0.
        let n_walls = map.n_walls().min(turned.n_walls()).max(1) as f64;
        let per_wall = |score: i32| f64::from(score) / f64::from(UNIT) / n_walls;
        Some(Self { reference, peaks, score: per_wall(best), margin: per_wall(best - second) })
    }

    /// The alignment of the best poses that fits best.
    pub(crate) fn fit(
        &self,
        reference: &Node,
        query: &Node,
        options: &AlignOptions,
    ) -> Option<Fit> {
        let best = self.peaks.first()?;
        let is_aligned = |peak: &&Peak| best.score <= 2 * peak.score;
        let starts = self.peaks.iter().filter(is_aligned);
        let fits = starts.map(|peak| fit(reference, query, &peak.pose, options));
        // Of equal fits, the one with the higher score.
        fits.reduce(|best, next| if value(&best) < value(&next) { next } else { best })
    }
}

/// The evidence of a fit. `margin` is 0 without a correlation.
pub(crate) fn evidence_of(fit: &Fit, margin: f64, classifier: Option<f64>) -> Evidence {
    Evidence {
        overlap: fit.overlap,
        known_overlap: fit.known_overlap,
        n_known: fit.n_known as u32,
        conflict: fit.known_conflict(),
        margin,
        weakness: fit.alignment.weakness.map_or(0.0, |weakness| weakness.ratio),
        classifier,
    }
}

impl Finder<'_> {
    /// The candidates of some places. `similar` are the places that each place is compared with.
    fn candidates(&self, queries: &[usize], similar: &[Vec<usize>]) -> Vec<Candidate> {
        let submaps = &self.places.submaps;
        let correlated = |&query: &usize| {
            let mut correlated =
                correlate(|place| &submaps[place], &submaps[query], &similar[query]);
            correlated.truncate(self.detector.n_candidates as usize);
            (0u32..).zip(correlated).map(move |(rank, pair)| (query, rank, pair))
        };
        let pairs: Vec<(usize, u32, Correlated)> =
            queries.par_iter().flat_map_iter(correlated).collect();
        let places: BTreeSet<usize> =
            pairs.iter().flat_map(|(query, _, pair)| [*query, pair.reference]).collect();
        let nodes = self.places.nodes(&places);
        let candidate = |(query, rank, pair): &(usize, u32, Correlated)| {
            self.candidate(&nodes, *query, pair, *rank)
        };
        pairs.par_iter().filter_map(candidate).collect()
    }

    fn candidate(
        &self,
        nodes: &BTreeMap<usize, Arc<Node>>,
        query: usize,
        correlated: &Correlated,
        rank: u32,
    ) -> Option<Candidate> {
        let fit = correlated.fit(&nodes[&correlated.reference], &nodes[&query], &self.options)?;
        let (query, reference) =
            (self.places.scans[query], self.places.scans[correlated.reference]);
        let classifier = self.classify.map(|classify| classify(query, reference));
        let evidence = evidence_of(&fit, correlated.margin, classifier);
        Some(Candidate {
            query,
            reference,
            reference_from_query: fit.a_from_b,
            covariance: closure_covariance(&fit.alignment, &self.options, &self.detector.closure),
            evidence,
            confidence: self.detector.confidence(&evidence),
            rank,
        })
    }
}

/// Overlap minus conflict, over all points plus over the points in known space. Two passes in opposite
/// directions with a view of 180 deg share a small part of their points, and only the second term shows
/// that this part agrees.
pub(crate) fn value(fit: &Fit) -> f64 {
    fit.overlap - fit.conflict + fit.known_overlap - fit.known_conflict()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ranks by confidence are 2, 0, 3 and 1, so the sums are 2, 1, 5 and 4.
    #[test]
    fn places_are_ordered_by_the_sum_of_two_ranks() {
        assert_eq!(rank_sums(&[0.4, 0.9, -0.5, 0.8]), [1, 0, 3, 2]);
        assert!(rank_sums(&[]).is_empty());
    }

    /// Of equal sums, the more similar place comes first. The sums are 1, 1 and 4.
    #[test]
    fn equal_sums_of_ranks_stay_in_the_order_of_the_descriptors() {
        assert_eq!(rank_sums(&[0.1, 0.2, 0.0]), [0, 1, 2]);
    }
}
