//! The share test: a map is right if its scans confirm the places that it predicts to be the same.

use std::collections::HashSet;

use dataset::Pose2;
use model::ClosureNoise;

use crate::graph::Edge;
use crate::guided::{Compared, Comparisons, NearPoses, Prediction};
use crate::places::Places;
use crate::{Proposal, Round};

/// Two closures belong to the same group if both of their places are this close along the path \[m\].
pub(crate) const GROUP_M: f64 = 6.0;
/// A group with a smaller share of confirmed predictions is dropped.
const MIN_GROUP_SHARE: f64 = 0.4;
/// A map whose share of confirmed predictions is less, and not by chance, is not accepted. On recorded drives, right
/// maps had 0.94 and more, wrong ones up to 0.88.
const MIN_SHARE: f64 = 0.92;
/// The least number of confirmed predictions of a map.
pub(crate) const MIN_CONFIRMED: usize = 3;
/// Predictions of places that know less of each other than this say nothing about a group.
const MIN_KNOWN: f64 = 0.2;
/// The most rounds. Each one drops at least one group.
const MAX_ROUNDS: usize = 100;
/// The last rounds end when no pose moves by more than this \[m\].
const CONVERGED_M: f64 = 0.05;
const MAX_LAST_ROUNDS: usize = 4;

/// What the search for consistent closures needs.
pub(crate) struct Graph<'a> {
    pub(crate) places: &'a Places<'a>,
    /// Chooses the links that agree with each other and with what is trusted.
    pub(crate) choose: &'a dyn Fn(&[Link]) -> Chosen,
    /// The pairs of places that poses of the places predict to be the same. The poses are those that the links
    /// lead to.
    pub(crate) predict: &'a Predict<'a>,
}

/// Makes predictions from poses of the places and the links that led to them.
pub(crate) type Predict<'a> = dyn Fn(&[Pose2], &[Link]) -> Vec<Prediction> + 'a;

/// For each link whether it is kept, and the poses of the places.
pub(crate) type Chosen = (Vec<bool>, Vec<Pose2>);

/// A relative pose between two places.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Link {
    /// Index of the earlier place.
    pub(crate) reference: usize,
    /// Index of the later place.
    pub(crate) query: usize,
    pub(crate) reference_from_query: Pose2,
}

/// What became of the closures that were offered.
pub(crate) struct Outcome {
    /// The map, if the scans confirm it.
    pub(crate) confirmed: Option<Confirmed>,
    /// For each link offered: whether it was kept.
    pub(crate) kept: Vec<bool>,
    /// For each link offered: whether it was dropped with its group because the scans do not support
    /// it.
    pub(crate) unsupported: Vec<bool>,
    pub(crate) rounds: Vec<Round>,
}

/// A map that the scans confirm.
pub(crate) struct Confirmed {
    /// The poses of the places.
    pub(crate) poses: Vec<Pose2>,
    /// The pairs of places that the scans confirm to be the same.
    pub(crate) links: Vec<Link>,
}

impl Graph<'_> {
    fn compare_predictions(
        &self,
        comparisons: &mut Comparisons<'_>,
        poses: &[Pose2],
        links: &[Link],
    ) -> Vec<Compared> {
        comparisons.compare(&(self.predict)(poses, links))
    }

    /// Drops groups of links that the scans do not support, until the rest is supported or nothing is
    /// left. Links that are not `offered` take no part.
    pub(crate) fn supported(
        &self,
        comparisons: &mut Comparisons<'_>,
        links: &[Link],
        offered: &[bool],
    ) -> Outcome {
        let mut outcome = Outcome {
            confirmed: None,
            kept: vec![false; links.len()],
            unsupported: vec![false; links.len()],
            rounds: Vec::new(),
        };
        let mut active: Vec<usize> = (0..links.len()).filter(|&k| offered[k]).collect();
        for _ in 0..MAX_ROUNDS {
            let offered: Vec<Link> = active.iter().map(|&k| links[k]).collect();
            let (is_kept, poses) = (self.choose)(&offered);
            let kept: Vec<usize> =
                active.iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(&k, _)| k).collect();
            if kept.is_empty() {
                return outcome;
            }
            let kept_links: Vec<Link> = kept.iter().map(|&k| links[k]).collect();
            let compared = self.compare_predictions(comparisons, &poses, &kept_links);
            let (n_predicted, n_confirmed) = counted(&compared);
            outcome.rounds.push(Round {
                n_offered: offered.len(),
                n_kept: kept.len(),
                n_predicted,
                n_confirmed,
            });
            let groups = self.groups(&kept_links);
            let bad = self.unsupported_groups(&kept_links, &groups, &compared);
            if bad.is_empty() {
                kept.iter().for_each(|&k| outcome.kept[k] = true);
                outcome.confirmed =
                    self.settle(comparisons, &kept_links, poses, compared, &mut outcome.rounds);
                if outcome.confirmed.is_none() {
                    outcome.kept.fill(false);
                    kept.iter().for_each(|&k| outcome.unsupported[k] = true);
                }
                return outcome;
            }
            for (&k, group) in kept.iter().zip(&groups) {
                if bad.contains(group) {
                    outcome.unsupported[k] = true;
                }
            }
            active.retain(|&k| !outcome.unsupported[k]);
        }
        outcome
    }

    /// The group of each link: links whose places are close along the path, directly or through others.
    fn groups(&self, links: &[Link]) -> Vec<usize> {
        groups(&path_of_links(links, &self.places.path_m))
    }

    /// The groups to drop: of those with too small a share of confirmed predictions the worse half, or
    /// the worst one if the share of the whole map is too small.
    fn unsupported_groups(
        &self,
        links: &[Link],
        groups: &[usize],
        compared: &[Compared],
    ) -> Vec<usize> {
        let n_groups = groups.iter().max().map_or(0, |max| max + 1);
        let mut n_near = vec![0usize; n_groups];
        let mut n_near_confirmed = vec![0usize; n_groups];
        let path_m = |place: usize| self.places.path_m[place];
        let pairs_m = path_of_links(links, &self.places.path_m);
        let near = NearPoses::of_points(pairs_m.iter().copied(), GROUP_M);
        let says_something = |pair: &&Compared| pair.counts && MIN_KNOWN <= pair.fit.known;
        for pair in compared.iter().filter(says_something) {
            let pair_m = [pair.reference, pair.query].map(path_m);
            let around = near.around_point(pair_m).filter(|&k| is_close(&pair_m, &pairs_m[k]));
            let mut of_pair: Vec<usize> = around.map(|k| groups[k]).collect();
            of_pair.sort_unstable();
            of_pair.dedup();
            for group in of_pair {
                n_near[group] += 1;
                n_near_confirmed[group] += usize::from(pair.is_confirmed());
            }
        }
        let share = |group: usize| n_near_confirmed[group] as f64 / n_near[group].max(1) as f64;
        let mut bad: Vec<usize> = (0..n_groups).filter(|&g| share(g) < MIN_GROUP_SHARE).collect();
        bad.sort_by(|&a, &b| share(a).total_cmp(&share(b)).then(a.cmp(&b)));
        bad.truncate(bad.len().div_ceil(2));
        let (n_predicted, n_confirmed) = counted(compared);
        let is_poor = largest_share(n_confirmed, n_predicted) < MIN_SHARE;
        if bad.is_empty() && is_poor {
            let worst = (0..n_groups).min_by(|&a, &b| share(a).total_cmp(&share(b)));
            bad.extend(worst);
        }
        bad
    }

    /// Optimizes and compares until the poses stay. `None` if too few predictions are confirmed in the
    /// end.
    fn settle(
        &self,
        comparisons: &mut Comparisons<'_>,
        kept: &[Link],
        mut poses: Vec<Pose2>,
        mut compared: Vec<Compared>,
        rounds: &mut Vec<Round>,
    ) -> Option<Confirmed> {
        for _ in 0..MAX_LAST_ROUNDS {
            let mut links: Vec<Link> =
                compared.iter().filter(|pair| pair.is_confirmed()).map(Link::of).collect();
            let pair = |link: &Link| (link.reference, link.query);
            let pairs: HashSet<(usize, usize)> = links.iter().map(pair).collect();
            let is_compared = |link: &Link| pairs.contains(&pair(link));
            let rest: Vec<Link> = kept.iter().filter(|link| !is_compared(link)).copied().collect();
            links.extend(rest);
            let (is_kept, next) = (self.choose)(&links);
            let moved_m = poses.iter().zip(&next).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max);
            poses = next;
            let kept: Vec<Link> =
                links.iter().zip(&is_kept).filter(|(_, kept)| **kept).map(|(l, _)| *l).collect();
            compared = self.compare_predictions(comparisons, &poses, &kept);
            let (n_predicted, n_confirmed) = counted(&compared);
            rounds.push(Round {
                n_offered: links.len(),
                n_kept: kept.len(),
                n_predicted,
                n_confirmed,
            });
            if moved_m < CONVERGED_M {
                break;
            }
        }
        let (n_predicted, n_confirmed) = counted(&compared);
        compared.retain(Compared::is_confirmed);
        let is_enough =
            MIN_CONFIRMED <= n_confirmed && MIN_SHARE <= largest_share(n_confirmed, n_predicted);
        is_enough.then(|| Confirmed { poses, links: compared.iter().map(Link::of).collect() })
    }
}

/// The number of predictions that count, and of those of them that the scans confirm.
fn counted(compared: &[Compared]) -> (usize, usize) {
    let counted = || compared.iter().filter(|pair| pair.counts);
    (counted().count(), counted().filter(|pair| pair.is_confirmed()).count())
}

/// The 97.5 % quantile of the standard normal distribution.
const Z: f64 = 1.96;

/// The upper end of the 95 % confidence interval of a share (Wilson 1927, "Probable inference, the law of
/// succession, and statistical inference").
pub(crate) fn largest_share(n_confirmed: usize, n_pairs: usize) -> f64 {
    let n = n_pairs as f64;
    let share = n_confirmed as f64 / n;
    let half_width = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    (share + Z * Z / (2.0 * n) + half_width) / (1.0 + Z * Z / n)
}

/// The path length at both places of each link \[m\].
pub(crate) fn path_of_links(links: &[Link], path_m: &[f64]) -> Vec<[f64; 2]> {
    links.iter().map(|link| [path_m[link.reference], path_m[link.query]]).collect()
}

/// Whether two pairs of places are close along the path.
pub(crate) fn is_close(a: &[f64; 2], b: &[f64; 2]) -> bool {
    (a[0] - b[0]).abs() <= GROUP_M && (a[1] - b[1]).abs() <= GROUP_M
}

/// The group of each pair of places, from the path length of both: pairs that are close along the path,
/// directly or through others.
pub(crate) fn groups(pairs_m: &[[f64; 2]]) -> Vec<usize> {
    let near = NearPoses::of_points(pairs_m.iter().copied(), GROUP_M);
    let mut groups = vec![usize::MAX; pairs_m.len()];
    let mut n_groups = 0;
    for first in 0..pairs_m.len() {
        if groups[first] != usize::MAX {
            continue;
        }
        groups[first] = n_groups;
        let mut open = vec![first];
        while let Some(k) = open.pop() {
            for other in near.around_point(pairs_m[k]) {
                if groups[other] == usize::MAX && is_close(&pairs_m[k], &pairs_m[other]) {
                    groups[other] = n_groups;
                    open.push(other);
                }
            }
        }
        n_groups += 1;
    }
    groups
}

impl Link {
    /// The edge of a pose graph: whether links agree is judged with the consistency error of closures.
    pub(crate) fn edge(&self, noise: &ClosureNoise) -> Edge {
        let (std_m, std_rad) = (noise.consistency_std_m, noise.consistency_std_rad);
        Edge::independent(self.reference, self.query, self.reference_from_query, std_m, std_rad)
    }

    fn of(pair: &Compared) -> Self {
        let (reference, query) = (pair.reference, pair.query);
        Self { reference, query, reference_from_query: pair.fit.a_from_b }
    }

    /// A proposal as a link, where both of its scans are places.
    pub(crate) fn of_proposal(proposal: &Proposal, places: &Places<'_>) -> Option<Self> {
        Some(Self {
            reference: places.of_scan(proposal.reference)?,
            query: places.of_scan(proposal.query)?,
            reference_from_query: proposal.reference_from_query,
        })
    }
}
