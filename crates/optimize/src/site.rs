//! Several drives of a site: which of them share a map, and their poses in it.
//!
//! Nothing is known of the poses of two drives relative to each other. A candidate between them gives such
//! a pose. Candidates of one place that looks like another give a wrong one, and they can agree with each
//! other. So two maps are joined in four steps, see [`Attachment`]:
//!
//! 1. Hypotheses: the relative poses of the maps that the most candidates agree with.
//! 2. For each, the share test (`support.rs`) over the places of the two maps that it predicts to be the
//!    same.
//! 3. One hypothesis must be confirmed, and no other one nearly as well.
//! 4. Keyframes of the two maps are compared. Their groups must be supported, too.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use dataset::Pose2;
use model::Detector;
use rayon::prelude::*;
use register::{Drive, places as places_along};

use crate::agreement::{AGREES_CHI2, chi2};
use crate::gnc::reject_false_closures;
use crate::graph::Edge;
use crate::guided::{Comparisons, Limit, predictions};
use crate::places::{Places, carry};
use crate::solve::{
    ComparedKeyframes, LOOP_GAP_M, PLACE_STEP_M, add_compared, align_all, compare_keyframes,
    graph_of, is_offered, mark_unsupported,
};
use crate::support::{Graph, Link, Outcome, is_close};
use crate::trusted::trusted;
use crate::{Closure, Proposal, Reason, Solution};

/// An attempt to join two maps.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Join {
    /// The drives of the map that stayed.
    pub to: Vec<usize>,
    /// The drives of the map that was to be joined with it.
    pub drives: Vec<usize>,
    /// What became of it.
    pub outcome: JoinOutcome,
}

/// What became of an attempt to join two maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JoinOutcome {
    /// They are one map.
    Joined {
        /// Pairs of places predicted to be the same.
        n_predicted: usize,
        /// Those that their scans confirm.
        n_confirmed: usize,
    },
    /// Too few candidates agree on a relative pose, or the scans do not confirm it.
    Unsupported {
        /// Pairs of places predicted to be the same by the best relative pose that was tested.
        n_predicted: usize,
        /// Those that their scans confirm.
        n_confirmed: usize,
    },
    /// The scans confirm two relative poses nearly as well.
    Ambiguous,
    /// Both are earlier maps, which stay where they are, or contain one. The places are confirmed to be the same by
    /// the relative pose alone; keyframes were not compared.
    BothKnown,
}

/// The drives of a site with their closures.
#[derive(Debug, Clone)]
pub struct Site {
    /// Closures, poses and graph over all scans of the joined drives. Poses of drives that share no map are
    /// in different frames.
    pub solution: Solution,
    /// The drives of each map. Every drive is in one.
    pub maps: Vec<Vec<usize>>,
    /// What was tried.
    pub joins: Vec<Join>,
}

/// Each place is compared with the nearest place of the other map.
const PLACE_LIMIT: Limit = Limit { most: 1, every_m: 2.5 };
/// The same for keyframes. Another day looks different in places, so there are more references than within a
/// drive.
const KEYFRAME_LIMIT: Limit = Limit { most: 5, every_m: 1.5 };
/// Path over which the drift of a map counts at most \[m\]. Closures within a map end it sooner.
const MAX_DRIFT_M: f64 = 100.0;
/// Number of hypotheses that are tested.
const N_HYPOTHESES: usize = 4;
/// The least number of places whose candidates agree on a hypothesis, and their least share of those of the
/// best hypothesis. Half as many confirmed pairs (`MAX_SECOND`) cannot be expected of fewer.
const MIN_QUERIES: usize = 4;
const MIN_QUERY_SHARE: f64 = 0.2;
/// Two hypotheses are the same if the places are closer than this by both.
const SAME_M: f64 = 2.0;
const SAME_DEG: f64 = 8.0;
/// The least number of pairs of places, 2.5 m of path apart, that the scans confirm.
const MIN_CONFIRMED: usize = 10;
/// The second-best hypothesis has at most this share of the confirmed pairs of the best one.
const MAX_SECOND: f64 = 0.5;
/// The most repetitions of the last step, without the candidates of unsupported groups.
const MAX_REPEATS: usize = 5;

/// What is known of the first drives of a site: they have maps already.
#[derive(Debug, Clone, Default)]
pub struct Known {
    /// The drives of each map. Their poses stay.
    pub maps: Vec<Vec<usize>>,
    /// Closures between them, with indices in the joined drives.
    pub closures: Vec<Proposal>,
}

/// Joins the drives of a site that share places.
///
/// `drive` are the drives one after the other ([`Drive::joined`]), and `solutions` what [`close_loops`]
/// found in each by itself, with indices within the drive. `proposals` are candidates between drives, with
/// indices in `drive`. `known` are the maps of the first drives.
///
/// [`close_loops`]: crate::close_loops
///
/// # Panics
/// If there is not one solution per drive.
pub fn join_drives(
    drive: &Drive,
    solutions: &[Solution],
    known: &Known,
    proposals: &[Proposal],
    detector: &Detector,
) -> Site {
    assert_eq!(solutions.len(), drive.starts.len(), "one solution per drive");
    let mut maps = SiteMaps::new(drive, solutions, known, proposals, detector);
    maps.join_all();
    maps.finish()
}

struct SiteMaps<'a> {
    drive: &'a Drive,
    solutions: &'a [Solution],
    known: &'a Known,
    proposals: &'a [Proposal],
    detector: &'a Detector,
    /// The drive of each scan.
    part_of: Vec<usize>,
    /// The first drive that is not known.
    first_new: usize,
    /// Poses of all scans, each in the frame of its map.
    poses: Vec<Pose2>,
    places: Places<'a>,
    maps: Vec<Vec<usize>>,
    joins: Vec<Join>,
    /// Why each proposal is not accepted.
    reasons: Vec<Reason>,
    /// Pairs of scans that closures join: reference and query.
    joined: Vec<[usize; 2]>,
    /// Keyframes that were compared between maps.
    compared: Vec<ComparedKeyframes>,
}

/// A relative pose of two maps after its test.
struct Attachment {
    /// The poses of all places, if the scans confirm them.
    poses: Option<Vec<Pose2>>,
    n_predicted: usize,
    n_confirmed: usize,
}

impl Attachment {
    /// The poses of all places, if enough pairs of them are confirmed.
    fn confirmed(&self) -> Option<&[Pose2]> {
        self.poses.as_deref().filter(|_| MIN_CONFIRMED <= self.n_confirmed)
    }
}

/// A relative pose of two maps.
struct Hypothesis {
    a_from_b: Pose2,
    /// The links that agree with it.
    agrees: Vec<bool>,
}

/// Two maps: the second one is to be joined with the first one.
struct Pair<'a> {
    a: &'a [usize],
    b: &'a [usize],
}

impl<'a> SiteMaps<'a> {
    fn new(
        drive: &'a Drive,
        solutions: &'a [Solution],
        known: &'a Known,
        proposals: &'a [Proposal],
        detector: &'a Detector,
    ) -> Self {
        let poses: Vec<Pose2> = solutions.iter().flat_map(|s| s.poses.iter().copied()).collect();
        let mut scans = places_along(drive, PLACE_STEP_M);
        scans.extend(proposals.iter().flat_map(|proposal| [proposal.query, proposal.reference]));
        scans.sort_unstable();
        scans.dedup();
        let mut joined: Vec<[usize; 2]> =
            known.closures.iter().map(|closure| [closure.reference, closure.query]).collect();
        for (solution, start) in solutions.iter().zip(&drive.starts) {
            let accepted = solution.closures.iter().filter(|closure| closure.rejected.is_none());
            joined.extend(accepted.map(|closure| {
                [closure.proposal.reference, closure.proposal.query].map(|scan| start + scan)
            }));
        }
        let reason = |proposal: &Proposal| match is_offered(proposal, detector) {
            true => Reason::Inconsistent,
            false => Reason::LowConfidence,
        };
        Self {
            drive,
            solutions,
            known,
            proposals,
            detector,
            part_of: (0..poses.len()).map(|scan| drive.part_of(scan)).collect(),
            first_new: known.maps.iter().flatten().max().map_or(0, |last| last + 1),
            places: Places::new(drive, &poses, scans),
            poses,
            maps: known.maps.clone(),
            joins: Vec::new(),
            reasons: proposals.iter().map(reason).collect(),
            joined,
            compared: Vec::new(),
        }
    }

    /// Joins each drive with all maps before it that it shares places with.
    fn join_all(&mut self) {
        for part in self.first_new..self.solutions.len() {
            let mut current = vec![part];
            let mut others = std::mem::take(&mut self.maps);
            // The map with the most candidates first.
            others.sort_by_cached_key(|map| {
                let pair = Pair { a: map, b: &current };
                (Reverse(self.links(&pair).len()), map[0])
            });
            for other in others {
                // A known map stays.
                let (a, b) = match self.is_known(&current) && !self.is_known(&other) {
                    true => (&current, &other),
                    false => (&other, &current),
                };
                let (a, b) = (a.clone(), b.clone());
                match self.join(&Pair { a: &a, b: &b }) {
                    true => {
                        current.extend(other);
                        current.sort_unstable();
                    }
                    false => self.maps.push(other),
                }
            }
            self.maps.push(current);
        }
        self.maps.sort();
    }

    /// Whether a map has known drives.
    fn is_known(&self, map: &[usize]) -> bool {
        map[0] < self.first_new
    }

    /// Joins two maps if the scans confirm a relative pose of them, unless both are known. Then the second one is moved.
    fn join(&mut self, pair: &Pair<'_>) -> bool {
        let links = self.links(pair);
        let (indices, links): (Vec<usize>, Vec<Link>) = links.into_iter().unzip();
        if links.is_empty() {
            return false;
        }
        let hypotheses = self.hypotheses(&links);
        let attachments: Vec<Attachment> =
            hypotheses.iter().map(|h| self.attach(pair, &links, h, &h.agrees)).collect();
        let outcome = match self.best(pair, &attachments) {
            Ok(_) if self.is_known(pair.a) && self.is_known(pair.b) => JoinOutcome::BothKnown,
            Ok(best) => {
                let first = attachments.into_iter().nth(best);
                self.settle(pair, &indices, &links, &hypotheses[best], first)
            }
            Err(outcome) => outcome,
        };
        if !matches!(outcome, JoinOutcome::Joined { .. } | JoinOutcome::BothKnown) {
            for &index in &indices {
                self.reasons[index] = Reason::Unsupported;
            }
        }
        self.joins.push(Join { to: pair.a.to_vec(), drives: pair.b.to_vec(), outcome });
        matches!(outcome, JoinOutcome::Joined { .. })
    }

    /// The offered proposals between two maps, with their indices. The reference is in the first map.
    fn links(&self, pair: &Pair<'_>) -> Vec<(usize, Link)> {
        let is_in = |map: &[usize], scan: usize| map.contains(&self.part_of[scan]);
        let link = |(index, proposal): (usize, &Proposal)| {
            let Proposal { query, reference, reference_from_query, .. } = *proposal;
            if !is_offered(proposal, self.detector) {
                return None;
            }
            let (reference, query, reference_from_query) =
                if is_in(pair.a, reference) && is_in(pair.b, query) {
                    (reference, query, reference_from_query)
                } else if is_in(pair.b, reference) && is_in(pair.a, query) {
                    (query, reference, reference_from_query.inverse())
                } else {
                    return None;
                };
            let (reference, query) = (self.places.of_scan(reference)?, self.places.of_scan(query)?);
            Some((index, Link { reference, query, reference_from_query }))
        };
        let mut links: Vec<(usize, Link)> =
            self.proposals.iter().enumerate().filter_map(link).collect();
        links.sort_by_key(|(index, link)| (link.query, *index));
        links
    }

    /// The relative poses that the most links agree with, each different from those before it.
    fn hypotheses(&self, links: &[Link]) -> Vec<Hypothesis> {
        let hypothesis = |link: &Link| {
            let [reference, query] = [link.reference, link.query].map(|p| self.pose_of(p));
            let a_from_b = reference * (link.reference_from_query * query.inverse());
            let agrees: Vec<bool> =
                links.iter().map(|other| self.agrees(&a_from_b, link, other)).collect();
            Hypothesis { a_from_b, agrees }
        };
        // The links are in the order of their queries.
        let n_queries = |hypothesis: &Hypothesis| {
            let agreeing = links.iter().zip(&hypothesis.agrees).filter(|(_, agrees)| **agrees);
            let mut queries: Vec<usize> = agreeing.map(|(link, _)| link.query).collect();
            queries.dedup();
            queries.len()
        };
        let mut counts: Vec<(usize, usize)> = links
            .par_iter()
            .enumerate()
            .map(|(k, link)| (n_queries(&hypothesis(link)), k))
            .filter(|&(n, _)| MIN_QUERIES <= n)
            .collect();
        counts.sort_by_key(|&(n, k)| (Reverse(n), k));
        let most = counts.first().map_or(0.0, |&(n, _)| n as f64);
        counts.retain(|&(n, _)| MIN_QUERY_SHARE * most <= n as f64);
        let mut chosen: Vec<Hypothesis> = Vec::new();
        for (_, k) in counts {
            let next = hypothesis(&links[k]);
            let at = self.pose_of(links[k].query);
            let is_same = |other: &Hypothesis| {
                let [next, other] = [next.a_from_b, other.a_from_b].map(|a_from_b| a_from_b * at);
                is_same_pose(&next, &other)
            };
            if !chosen.iter().any(is_same) {
                chosen.push(next);
            }
            if chosen.len() == N_HYPOTHESES {
                break;
            }
        }
        chosen
    }

    fn pose_of(&self, place: usize) -> Pose2 {
        self.poses[self.places.scans[place]]
    }

    /// Whether a link agrees with the relative pose of the maps that another link gives. The maps may have
    /// drifted between the two.
    fn agrees(&self, a_from_b: &Pose2, from: &Link, link: &Link) -> bool {
        let expected = self.pose_of(link.reference) * link.reference_from_query;
        let found = *a_from_b * self.pose_of(link.query);
        let path_m = |a: usize, b: usize| (self.places.path_m[a] - self.places.path_m[b]).abs();
        let path_m = (path_m(from.reference, link.reference) + path_m(from.query, link.query))
            .min(MAX_DRIFT_M);
        chi2(&expected, &found, path_m, self.detector) < AGREES_CHI2
    }

    /// Tests a hypothesis with those of the links that are offered. The first map stays, the second one
    /// can bend.
    fn attach(
        &self,
        pair: &Pair<'_>,
        links: &[Link],
        hypothesis: &Hypothesis,
        offered: &[bool],
    ) -> Attachment {
        let moved = self.places_of(pair.b);
        // Vertex 0 is the frame of the first map, the others are the places of the second one.
        let vertex_of = |place: usize| moved.partition_point(|&other| other < place) + 1;
        let scans: Vec<usize> = moved.iter().map(|&place| self.places.scans[place]).collect();
        let trusted = trusted(self.drive, &self.poses, &scans, &self.joined, self.detector);
        let mut start = vec![Pose2::default()];
        start.extend(moved.iter().map(|&place| hypothesis.a_from_b * self.pose_of(place)));
        let at_rest: Vec<Pose2> = (0..self.places.n()).map(|place| self.pose_of(place)).collect();
        let choose = |links: &[Link]| {
            let edge = |link: &Link| {
                let edge = link.edge(&self.detector.closure);
                let a_from_b = at_rest[link.reference] * edge.a_from_b;
                Edge { a: 0, b: vertex_of(link.query), a_from_b, ..edge }
            };
            let closures: Vec<Edge> = links.iter().map(edge).collect();
            let robust = reject_false_closures(&trusted, &closures, &start);
            let mut poses = at_rest.clone();
            for (&place, pose) in moved.iter().zip(&robust.poses[1..]) {
                poses[place] = *pose;
            }
            (robust.is_kept, poses)
        };
        let [in_a, in_b] = [pair.a, pair.b].map(|map| self.is_in(map));
        let scan = |place: usize| self.places.scans[place];
        let retain = |query: usize, near: &mut Vec<usize>| {
            near.retain(|&reference| in_a[scan(reference)] && in_b[scan(query)]);
        };
        let predict = |poses: &[Pose2], _: &[Link]| {
            predictions(&self.places.path_m, poses, &retain, Some(PLACE_LIMIT))
        };
        let graph = Graph { places: &self.places, choose: &choose, predict: &predict };
        let Outcome { confirmed, rounds, .. } =
            graph.supported(&mut Comparisons::new(&self.places), links, offered);
        let (n_predicted, n_confirmed) =
            rounds.last().map_or((0, 0), |last| (last.n_predicted, last.n_confirmed));
        Attachment { poses: confirmed.map(|map| map.poses), n_predicted, n_confirmed }
    }

    /// The hypothesis that the scans confirm, unless there are none or two.
    fn best(&self, pair: &Pair<'_>, attachments: &[Attachment]) -> Result<usize, JoinOutcome> {
        let n_confirmed = |k: usize| attachments[k].n_confirmed;
        let mut order: Vec<usize> = (0..attachments.len()).collect();
        // Those that the share test accepts first.
        order.sort_by_key(|&k| (attachments[k].poses.is_none(), Reverse(n_confirmed(k)), k));
        let best = order.first().copied();
        let Some((best, poses)) = best.and_then(|k| Some((k, attachments[k].confirmed()?))) else {
            let tested = best.map_or((0, 0), |k| (attachments[k].n_predicted, n_confirmed(k)));
            return Err(JoinOutcome::Unsupported { n_predicted: tested.0, n_confirmed: tested.1 });
        };
        // Different starts can lead to the same poses.
        let in_b = self.places_of(pair.b);
        let is_other = |k: &&usize| {
            attachments[**k].poses.as_ref().is_some_and(|other| {
                let is_same = |&&p: &&usize| is_same_pose(&poses[p], &other[p]);
                2 * in_b.iter().filter(is_same).count() < in_b.len()
            })
        };
        let second = order[1..].iter().find(is_other).map_or(0, |&k| n_confirmed(k));
        match (second as f64) <= MAX_SECOND * n_confirmed(best) as f64 {
            true => Ok(best),
            false => Err(JoinOutcome::Ambiguous),
        }
    }

    /// Moves the second map to the first one, and compares their keyframes. Candidates of groups that the
    /// scans do not support are left out, and the hypothesis is tested again.
    fn settle(
        &mut self,
        pair: &Pair<'_>,
        indices: &[usize],
        links: &[Link],
        hypothesis: &Hypothesis,
        first: Option<Attachment>,
    ) -> JoinOutcome {
        let mut offered = hypothesis.agrees.clone();
        let mut next = first;
        let (mut n_predicted, mut n_confirmed) = (0, 0);
        for _ in 0..MAX_REPEATS {
            let Some(found) = next else { break };
            (n_predicted, n_confirmed) = (found.n_predicted, found.n_confirmed);
            let Some(confirmed) = found.confirmed() else { break };
            let poses = self.aligned(pair, confirmed);
            let [in_a, in_b] = [pair.a, pair.b].map(|map| self.is_in(map));
            let between = |b: usize, near: &mut Vec<usize>| {
                near.retain(|&a| a < b && (in_a[a] && in_b[b] || in_b[a] && in_a[b]));
            };
            let mut compared = compare_keyframes(self.drive, &poses, &between, KEYFRAME_LIMIT);
            let unsupported = mark_unsupported(&self.drive.path_m, &mut compared);
            let mut n_dropped = 0;
            for (k, link) in links.iter().enumerate() {
                let pair_m = [link.reference, link.query].map(|p| self.places.path_m[p]);
                if offered[k] && unsupported.iter().any(|other| is_close(&pair_m, other)) {
                    offered[k] = false;
                    self.reasons[indices[k]] = Reason::Unsupported;
                    n_dropped += 1;
                }
            }
            if n_dropped == 0 {
                self.poses = poses;
                let agreeing = indices.iter().zip(&offered).filter(|(_, offered)| **offered);
                agreeing.for_each(|(&index, _)| self.reasons[index] = Reason::NotConfirmed);
                self.joined.extend(
                    compared
                        .iter()
                        .filter(|pair| pair.is_accepted())
                        .map(|p| [p.reference, p.query]),
                );
                self.compared.extend(compared);
                return JoinOutcome::Joined { n_predicted, n_confirmed };
            }
            next = Some(self.attach(pair, links, hypothesis, &offered));
        }
        JoinOutcome::Unsupported { n_predicted, n_confirmed }
    }

    /// Keeps the scans that have enough path after them to be aligned with `later` over closures.
    fn retain_earlier(&self, later: usize, near: &mut Vec<usize>) {
        let path_m = &self.drive.path_m;
        near.retain(|&earlier| LOOP_GAP_M <= path_m[later] - path_m[earlier]);
    }

    /// The places of a map.
    fn places_of(&self, map: &[usize]) -> Vec<usize> {
        let in_map = self.is_in(map);
        (0..self.places.n()).filter(|&place| in_map[self.places.scans[place]]).collect()
    }

    /// Whether each scan belongs to a map.
    fn is_in(&self, map: &[usize]) -> Vec<bool> {
        self.part_of.iter().map(|part| map.contains(part)).collect()
    }

    /// The poses after the second map was moved: the poses of its places carried to all its scans, then
    /// aligned with the scans of the first map.
    fn aligned(&self, pair: &Pair<'_>, of_places: &[Pose2]) -> Vec<Pose2> {
        let [in_a, in_b] = [pair.a, pair.b].map(|map| self.is_in(map));
        let (scans, after): (Vec<usize>, Vec<Pose2>) =
            self.places.scans.iter().zip(of_places).filter(|(scan, _)| in_b[**scan]).unzip();
        let carried = carry(self.drive, &self.poses, &scans, &after);
        let is_held: Vec<bool> = in_b.iter().map(|moves| !moves).collect();
        let is_in_map = |scan: usize| in_a[scan] || in_b[scan];
        let retain = |later: usize, near: &mut Vec<usize>| self.retain_earlier(later, near);
        align_all(self.drive, &carried, &is_in_map, &is_held, &retain, self.detector)
    }

    /// Aligns each new map of several drives as a whole.
    fn finish(mut self) -> Site {
        for map in self.maps.iter().filter(|map| 1 < map.len() && self.first_new <= map[0]) {
            let in_map = self.is_in(map);
            let first = in_map.iter().position(|in_map| *in_map);
            let is_held: Vec<bool> =
                in_map.iter().enumerate().map(|(k, in_map)| !in_map || Some(k) == first).collect();
            let is_in_map = |scan: usize| in_map[scan];
            let retain = |later: usize, near: &mut Vec<usize>| self.retain_earlier(later, near);
            self.poses =
                align_all(self.drive, &self.poses, &is_in_map, &is_held, &retain, self.detector);
        }
        let mut closures: BTreeMap<(usize, usize), Closure> = BTreeMap::new();
        for (solution, &start) in self.solutions.iter().zip(&self.drive.starts) {
            for Closure { proposal, rejected } in &solution.closures {
                let (query, reference) = (start + proposal.query, start + proposal.reference);
                let proposal = Proposal { query, reference, ..*proposal };
                closures.insert((query, reference), Closure { proposal, rejected: *rejected });
            }
        }
        for (proposal, &reason) in self.proposals.iter().zip(&self.reasons) {
            let closure = Closure { proposal: *proposal, rejected: Some(reason) };
            closures.insert((proposal.query, proposal.reference), closure);
        }
        add_compared(&mut closures, &self.compared, self.detector);
        let closures: Vec<Closure> = closures.into_values().collect();
        let accepted = closures.iter().filter(|closure| closure.rejected.is_none());
        let accepted: Vec<Proposal> =
            accepted.map(|closure| closure.proposal).chain(self.known.closures.clone()).collect();
        let (covariances, edges) = graph_of(self.drive, &self.poses, &accepted, self.detector);
        let rounds = self.solutions.iter().flat_map(|solution| solution.rounds.clone()).collect();
        let solution = Solution { closures, poses: self.poses, covariances, edges, rounds };
        Site { solution, maps: self.maps, joins: self.joins }
    }
}

/// Whether two poses are the same place in the same direction.
fn is_same_pose(a: &Pose2, b: &Pose2) -> bool {
    a.distance_m(b) < SAME_M && a.heading_difference_rad(b) < SAME_DEG.to_radians()
}
