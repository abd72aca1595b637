//! Labels that differ between two runs.

use std::collections::{BTreeSet, HashMap};

use dataset::{Label, MapPose, NEIGHBOUR_GAP_M, ScanId};
use serde::Serialize;

use super::input::{LabelledPair, MappedRun, PlaceRule};
use super::scans::{Counterpart, Matched};

/// The labelled pairs of two runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedLabels {
    /// Pairs in A.
    pub n_a: usize,
    /// Pairs in B.
    pub n_b: usize,
    /// Pairs in both, of the same two scans.
    pub n_common: usize,
    /// Pairs that are positive in A and negative in B.
    pub n_positive_to_negative: usize,
    /// Pairs that are negative in A and positive in B.
    pub n_negative_to_positive: usize,
    /// The pairs with other labels.
    pub flips: Vec<FlippedPair>,
}

/// A pair with other labels in two runs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FlippedPair {
    /// Log of the query.
    pub query_log: String,
    /// Number of the query in its log.
    pub query_scan: u32,
    /// Log of the reference.
    pub reference_log: String,
    /// Number of the reference in its log.
    pub reference_scan: u32,
    /// Label in A, 1 or -1.
    pub label_a: i8,
    /// Label in B, 1 or -1.
    pub label_b: i8,
}

/// Pairs of keyframes of both runs that are at the same place by the optimized poses, and at least
/// [`NEIGHBOUR_GAP_M`] of path apart.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedPlaces {
    /// Pairs that are at the same place in A.
    pub n_a: usize,
    /// Pairs that are at the same place in B.
    pub n_b: usize,
    /// Pairs that are at the same place in A only.
    pub n_only_a: usize,
    /// Pairs that are at the same place in B only.
    pub n_only_b: usize,
    /// Pairs at the same place in one run whose keyframes are in two maps in the other run. They are among
    /// those above.
    pub n_in_two_maps: usize,
    /// Of the other pairs at the same place in one run only, the largest distance in the other run \[m\];
    /// `null` if there are none.
    pub farthest_m: Option<f64>,
}

impl ComparedLabels {
    /// The number of pairs with other labels.
    pub fn n_flips(&self) -> usize {
        self.flips.len()
    }

    /// `None` if one of the runs has no table of pairs.
    pub(super) fn new(a: &MappedRun<'_>, b: &MappedRun<'_>, matched: &Matched<'_>) -> Option<Self> {
        let (pairs_a, pairs_b) = (a.pairs?, b.pairs?);
        let labels_b: HashMap<[&ScanId; 2], Label> =
            pairs_b.iter().map(|pair| (key(pair), pair.label)).collect();
        let mut n_common = 0;
        let mut flips = Vec::new();
        for pair in pairs_a {
            let is_other =
                pair.scans.iter().any(|id| matched.counterpart(id) == Counterpart::OtherScan);
            let Some(&label_b) = labels_b.get(&key(pair)).filter(|_| !is_other) else { continue };
            n_common += 1;
            if label_b != pair.label {
                let [query, reference] = &pair.scans;
                flips.push(FlippedPair {
                    query_log: query.log.to_string(),
                    query_scan: query.scan,
                    reference_log: reference.log.to_string(),
                    reference_scan: reference.scan,
                    label_a: pair.label.sign(),
                    label_b: label_b.sign(),
                });
            }
        }
        let from = |sign: i8| flips.iter().filter(|flip| flip.label_a == sign).count();
        Some(Self {
            n_a: pairs_a.len(),
            n_b: pairs_b.len(),
            n_common,
            n_positive_to_negative: from(1),
            n_negative_to_positive: from(-1),
            flips,
        })
    }
}

/// The two scans, whichever of them is the query.
fn key(pair: &LabelledPair) -> [&ScanId; 2] {
    let [query, reference] = &pair.scans;
    if reference <= query { [query, reference] } else { [reference, query] }
}

impl ComparedPlaces {
    pub(super) fn new(matched: &Matched<'_>, rule: &PlaceRule) -> Self {
        let (a, b): (Vec<&MapPose>, Vec<&MapPose>) = matched.common().unzip();
        let is_revisit = |[k, l]: [usize; 2]| {
            let is_same_segment = a[k].id.log == a[l].id.log && a[k].segment == a[l].segment;
            !is_same_segment || NEIGHBOUR_GAP_M <= (a[k].travel_m - a[l].travel_m).abs()
        };
        let [pairs_a, pairs_b] = [&a, &b].map(|poses| {
            let mut pairs = near_pairs(poses, rule);
            pairs.retain(|&pair| is_revisit(pair));
            pairs
        });
        let [only_a, only_b] =
            [pairs_a.difference(&pairs_b).count(), pairs_b.difference(&pairs_a).count()];
        let elsewhere = pairs_a.difference(&pairs_b).map(|pair| (pair, &b));
        let elsewhere = elsewhere.chain(pairs_b.difference(&pairs_a).map(|pair| (pair, &a)));
        let (mut n_in_two_maps, mut farthest_m) = (0, None);
        for (&[k, l], poses) in elsewhere {
            match poses[k].map == poses[l].map {
                true => {
                    let distance_m = poses[k].pose.distance_m(&poses[l].pose);
                    farthest_m = Some(f64::max(farthest_m.unwrap_or(0.0), distance_m));
                }
                false => n_in_two_maps += 1,
            }
        }
        Self {
            n_a: pairs_a.len(),
            n_b: pairs_b.len(),
            n_only_a: only_a,
            n_only_b: only_b,
            n_in_two_maps,
            farthest_m,
        }
    }

    /// The number of pairs that are at the same place in one run only.
    pub fn n_flips(&self) -> usize {
        self.n_only_a + self.n_only_b
    }
}

/// The pairs of poses at the same place, found in squares as wide as the radius.
fn near_pairs(poses: &[&MapPose], rule: &PlaceRule) -> BTreeSet<[usize; 2]> {
    let square = |metres: f64| libm::floor(metres / rule.positive_radius_m) as i64;
    let mut squares: HashMap<(u32, i64, i64), Vec<usize>> = HashMap::new();
    let mut pairs = BTreeSet::new();
    for (k, keyframe) in poses.iter().enumerate() {
        let (x, y) = (square(keyframe.pose.x_m), square(keyframe.pose.y_m));
        let around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let near = around.filter_map(|(x, y)| squares.get(&(keyframe.map, x, y))).flatten();
        pairs.extend(
            near.map(|&l| [k, l]).filter(|&[k, l]| is_same_place(poses[k], poses[l], rule)),
        );
        squares.entry((keyframe.map, x, y)).or_default().push(k);
    }
    pairs
}

fn is_same_place(a: &MapPose, b: &MapPose, rule: &PlaceRule) -> bool {
    a.pose.distance_m(&b.pose) <= rule.positive_radius_m
        && a.pose.heading_difference_rad(&b.pose) <= rule.positive_heading_deg.to_radians()
}
