//! From proposals to accepted closures and poses.

use std::collections::BTreeMap;

use dataset::Pose2;
use model::{Detector, Evidence};
use nalgebra::Matrix3;
use register::{Drive, JointOptions, pairs_along_path, places as places_along};

use crate::agreement::admitted;
use crate::certainty::Certainty;
use crate::gnc::reject_false_closures;
use crate::graph::{Edge, covariances};
use crate::guided::{
    Compared, Comparisons, Limit, NearPoses, Retain, compare, covariance, predictions,
};
use crate::places::{Places, carry, chain};
use crate::support::{Graph, Link, groups, is_close, largest_share, path_of_links};
use crate::{Closure, Proposal, Reason, Solution};

/// Proposals with more overlap are offered to the pose graph, whatever their confidence. What is right on
/// one site has little confidence on another one, and the share test decides in the end.
const LENIENT_OVERLAP: f64 = 0.25;
/// Whether a proposal enters the pose graph.
pub(crate) fn is_offered(proposal: &Proposal, detector: &Detector) -> bool {
    detector.min_confidence <= proposal.confidence || LENIENT_OVERLAP < proposal.evidence.overlap
}

/// Path between two places of the pose graph \[m\].
pub(crate) const PLACE_STEP_M: f64 = 2.5;
/// Each keyframe is compared with at most so many references, one per piece of path.
const KEYFRAME_LIMIT: Limit = Limit { most: 3, every_m: 1.5 };

/// Chooses the closures of a drive and optimizes its poses. Without an accepted closure, the poses are
/// those of the drive.
///
/// 1. Proposals with enough confidence enter a pose graph of places along the drive. Graduated
///    non-convexity keeps those that agree with each other and with the odometry. Of very many, only those that
///    others near them agree with enter the graph.
/// 2. Every pair of places that the optimized poses predict to be the same is compared. Groups of
///    closures whose predictions the scans do not confirm are dropped, and the first step is repeated
///    (the share test).
/// 3. All scans are aligned jointly, also over the closures.
/// 4. Every keyframe is compared with the earlier keyframes near it. The confirmed pairs are the
///    accepted closures. Where the scans confirm too few pairs of a group, the candidates there
///    are dropped, and all is repeated from the first step: right closures elsewhere in the
///    drive do not make up for it. The stretches of the group are then not joined in another way.
pub fn close_loops(
    drive: &Drive,
    proposals: &[Proposal],
    detector: &Detector,
    min_path_m: f64,
) -> Solution {
    let places = places_of(drive, proposals);
    let (offered, links): (Vec<usize>, Vec<Link>) = proposals
        .iter()
        .enumerate()
        .filter(|(_, proposal)| is_offered(proposal, detector))
        .filter_map(|(k, proposal)| Some((k, Link::of_proposal(proposal, &places)?)))
        .unzip();
    let mut reasons: Vec<Option<Reason>> = vec![Some(Reason::LowConfidence); proposals.len()];
    offered.iter().for_each(|&k| reasons[k] = Some(Reason::Inconsistent));
    if links.is_empty() {
        return unclosed(drive, proposals, &reasons, detector, Vec::new());
    }
    let odometry = chain(drive, &drive.poses, &places.scans, &detector.drift);
    let start: Vec<Pose2> = places.scans.iter().map(|&scan| drive.poses[scan]).collect();
    let path_m = &places.path_m;
    let certainty = |links: &[Link]| Certainty::new(&path_of_links(links, path_m), &detector.drift);
    let earlier = |query: usize, near: &mut Vec<usize>| {
        near.retain(|&k| min_path_m <= path_m[query] - path_m[k]);
    };
    let graph = Graph {
        places: &places,
        choose: &|links| {
            let closures: Vec<Edge> = links.iter().map(|l| l.edge(&detector.closure)).collect();
            let robust = reject_false_closures(&odometry, &closures, &start);
            (robust.is_kept, robust.poses)
        },
        predict: &|poses, links| {
            let mut predicted = predictions(path_m, poses, &earlier, None);
            certainty(links).mark(path_m, &mut predicted);
            predicted
        },
    };
    let mut comparisons = Comparisons::new(&places);
    let mut is_offered = admitted(&links, &places, detector);
    let mut rounds = Vec::new();
    loop {
        let outcome = graph.supported(&mut comparisons, &links, &is_offered);
        rounds.extend(outcome.rounds);
        for (position, &k) in offered.iter().enumerate() {
            if outcome.kept[position] {
                reasons[k] = None;
            } else if outcome.unsupported[position] {
                reasons[k] = Some(Reason::Unsupported);
            } else if is_offered[position] {
                reasons[k] = Some(Reason::Inconsistent);
            }
        }
        let Some(confirmed) = outcome.confirmed else {
            return unclosed(drive, proposals, &reasons, detector, rounds);
        };
        let poses = carry(drive, &drive.poses, &places.scans, &confirmed.poses);
        let certainty = certainty(&confirmed.links);
        let (poses, mut compared) =
            align_and_compare(drive, &poses, &certainty, detector, min_path_m);
        let unsupported = mark_unsupported(&drive.path_m, &mut compared);
        let mut n_dropped = 0;
        for (position, link) in links.iter().enumerate() {
            let pair_m = [link.reference, link.query].map(|place| places.path_m[place]);
            if is_offered[position] && unsupported.iter().any(|other| is_close(&pair_m, other)) {
                is_offered[position] = false;
                reasons[offered[position]] = Some(Reason::Unsupported);
                n_dropped += 1;
            }
        }
        if n_dropped == 0 {
            return closed(drive, proposals, &reasons, detector, poses, &compared, rounds);
        }
    }
}

/// The places along a drive, and those of proposals.
fn places_of<'a>(drive: &'a Drive, proposals: &[Proposal]) -> Places<'a> {
    let mut scans = places_along(drive, PLACE_STEP_M);
    scans.extend(proposals.iter().flat_map(|proposal| [proposal.query, proposal.reference]));
    scans.sort_unstable();
    scans.dedup();
    Places::new(drive, &drive.poses, scans)
}

/// Aligns all scans of a drive, and compares its keyframes.
fn align_and_compare(
    drive: &Drive,
    poses: &[Pose2],
    certainty: &Certainty,
    detector: &Detector,
    min_path_m: f64,
) -> (Vec<Pose2>, Vec<ComparedKeyframes>) {
    let certain = |min_path_m: f64| {
        move |query: usize, near: &mut Vec<usize>| {
            near.retain(|&k| min_path_m <= drive.path_m[query] - drive.path_m[k]);
            certainty.retain(&drive.path_m, query, near);
        }
    };
    let is_held: Vec<bool> = (0..poses.len()).map(|scan| scan == 0).collect();
    let poses = align_all(drive, poses, &|_| true, &is_held, &certain(LOOP_GAP_M), detector);
    let compared = compare_keyframes(drive, &poses, &certain(min_path_m), KEYFRAME_LIMIT);
    (poses, compared)
}

/// A group of keyframes whose share of confirmed pairs is less, and not by chance, is not accepted, unless
/// its confirmed pairs fit well. On recorded drives, right groups of more than 60 pairs had 0.6 and more,
/// one of them 0.40. Two wrong ones had 0.27 and 0.46.
const MIN_KEYFRAME_SHARE: f64 = 0.6;
/// The confirmed pairs of a group fit well from this median overlap of known points on. Right groups of
/// more than 60 pairs had 0.56 and more; wrong ones less.
const WELL_KNOWN_OVERLAP: f64 = 0.55;
/// A group with this many confirmed pairs or more is not accepted if their median overlap of known points is less than
/// this. Right groups of 10 pairs and more had 0.52 and more. A wrong one of 98 pairs, 1.8 m off in a building that looks
/// like itself, had 79 confirmed pairs and 0.41.
const MIN_KNOWN_OVERLAP: f64 = 0.46;
const MANY_PAIRS: usize = 10;
/// Marks the pairs of keyframes in groups with too few confirmed pairs. Returns the path length at both
/// keyframes of each pair in these groups, except groups without any confirmed pair.
pub(crate) fn mark_unsupported(
    path_m: &[f64],
    compared: &mut [ComparedKeyframes],
) -> Vec<[f64; 2]> {
    let pairs_m: Vec<[f64; 2]> =
        compared.iter().map(|pair| [path_m[pair.reference], path_m[pair.query]]).collect();
    let groups = groups(&pairs_m);
    let n_groups = groups.iter().max().map_or(0, |max| max + 1);
    let mut n_pairs = vec![0usize; n_groups];
    // Of the confirmed pairs.
    let mut known_overlaps = vec![Vec::new(); n_groups];
    for (pair, &group) in compared.iter().zip(&groups) {
        n_pairs[group] += 1;
        if pair.compared.is_confirmed() {
            known_overlaps[group].push(pair.compared.fit.known_overlap);
        }
    }
    let is_supported: Vec<bool> = known_overlaps
        .iter_mut()
        .zip(&n_pairs)
        .map(|(overlaps, &n_pairs)| is_group_supported(overlaps, n_pairs))
        .collect();
    let mut unsupported_m = Vec::new();
    for ((pair, &group), pair_m) in compared.iter_mut().zip(&groups).zip(pairs_m) {
        pair.is_supported = is_supported[group];
        if !pair.is_supported && !known_overlaps[group].is_empty() {
            unsupported_m.push(pair_m);
        }
    }
    unsupported_m
}

/// Whether the scans confirm enough of the pairs of a group, by the overlaps of known points of those that they confirm.
fn is_group_supported(known_overlaps: &mut [f64], n_pairs: usize) -> bool {
    let (n_confirmed, overlap) = (known_overlaps.len(), median(known_overlaps));
    let fits_badly = MANY_PAIRS <= n_confirmed && overlap < MIN_KNOWN_OVERLAP;
    let are_enough = MIN_KEYFRAME_SHARE <= largest_share(n_confirmed, n_pairs);
    WELL_KNOWN_OVERLAP <= overlap || (are_enough && !fits_badly)
}

/// The upper median; 0 of nothing.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// A pair of keyframes, after the comparison.
pub(crate) struct ComparedKeyframes {
    pub(crate) reference: usize,
    pub(crate) query: usize,
    pub(crate) compared: Compared,
    /// Whether the scans confirm enough of the pairs around this one.
    pub(crate) is_supported: bool,
}

impl ComparedKeyframes {
    pub(crate) fn is_accepted(&self) -> bool {
        self.is_supported && self.compared.is_confirmed()
    }
}

/// Compares each keyframe with the keyframes near it, of those that `retain` keeps.
/// The submaps have the optimized poses, which are less bent than those of scan matching.
pub(crate) fn compare_keyframes(
    drive: &Drive,
    poses: &[Pose2],
    retain: &Retain<'_>,
    limit: Limit,
) -> Vec<ComparedKeyframes> {
    let keyframes: Vec<usize> = (0..drive.n_scans()).filter(|&k| drive.is_keyframe[k]).collect();
    let keyframe_poses: Vec<Pose2> = keyframes.iter().map(|&k| poses[k]).collect();
    let path_m: Vec<f64> = keyframes.iter().map(|&k| drive.path_m[k]).collect();
    let retain_keyframes = |query: usize, near: &mut Vec<usize>| {
        near.iter_mut().for_each(|k| *k = keyframes[*k]);
        retain(keyframes[query], near);
        near.iter_mut().for_each(|scan| *scan = keyframes.partition_point(|k| k < scan));
    };
    let predicted = predictions(&path_m, &keyframe_poses, &retain_keyframes, Some(limit));
    let places = Places::new(drive, poses, keyframes);
    compare(&places, &predicted)
        .into_iter()
        .map(|compared| ComparedKeyframes {
            reference: places.scans[compared.reference],
            query: places.scans[compared.query],
            compared,
            is_supported: true,
        })
        .collect()
}

/// Iterations of the joint alignment with closures.
const JOINT_ITERATIONS: u32 = 6;
/// Scans up to this far apart are aligned over closures \[m\].
const LOOP_REACH_M: f64 = 3.0;
/// They have at least this much path between them \[m\].
pub(crate) const LOOP_GAP_M: f64 = 5.0;
/// The most earlier scans per scan, one per metre of path.
const LOOP_PARTNERS: usize = 6;

/// Aligns all scans of a map jointly, along the path and over the closures: the earlier scans near a scan that
/// `retain` keeps. Those that are held stay.
pub(crate) fn align_all(
    drive: &Drive,
    poses: &[Pose2],
    is_in_map: &dyn Fn(usize) -> bool,
    is_held: &[bool],
    retain: &Retain<'_>,
    detector: &Detector,
) -> Vec<Pose2> {
    let mut pairs = pairs_along_path(&drive.path_m);
    pairs.retain(|&(earlier, _)| is_in_map(earlier));
    pairs.extend(pairs_over_closures(drive, poses, is_in_map, retain));
    pairs.retain(|&(earlier, later)| !(is_held[earlier] && is_held[later]));
    let options = JointOptions { iterations: JOINT_ITERATIONS, ..JointOptions::default() };
    drive.align_jointly(poses, &pairs, is_held, &detector.odometry, &options)
}

/// Pairs of scans of a map that are close by the poses but not along the path.
fn pairs_over_closures(
    drive: &Drive,
    poses: &[Pose2],
    is_in_map: &dyn Fn(usize) -> bool,
    retain: &Retain<'_>,
) -> Vec<(usize, usize)> {
    let near_poses = NearPoses::new(poses, LOOP_REACH_M);
    let mut pairs = Vec::new();
    for later in (0..poses.len()).filter(|&scan| is_in_map(scan)) {
        let mut near: Vec<usize> = near_poses
            .around(&poses[later])
            .filter(|&k| is_in_map(k) && poses[k].distance_m(&poses[later]) <= LOOP_REACH_M)
            .collect();
        retain(later, &mut near);
        let mut near: Vec<(f64, usize)> = near
            .into_iter()
            .map(|k| {
                let turn_rad = poses[k].heading_difference_rad(&poses[later]);
                (poses[k].distance_m(&poses[later]) + turn_rad, k)
            })
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut metres: Vec<i64> = Vec::new();
        for (_, earlier) in near {
            let metre = drive.path_m[earlier].floor() as i64;
            if !metres.contains(&metre) {
                metres.push(metre);
                pairs.push((earlier, later));
            }
            if metres.len() == LOOP_PARTNERS {
                break;
            }
        }
    }
    pairs
}

/// A drive without accepted closures.
fn unclosed(
    drive: &Drive,
    proposals: &[Proposal],
    reasons: &[Option<Reason>],
    detector: &Detector,
    rounds: Vec<crate::Round>,
) -> Solution {
    // A closure that the graph kept, in a map that its scans do not confirm.
    let closures = proposals.iter().zip(reasons).map(|(&proposal, &reason)| Closure {
        proposal,
        rejected: Some(reason.unwrap_or(Reason::Unsupported)),
    });
    let (covariances, edges) = graph_of(drive, &drive.poses, &[], detector);
    Solution {
        closures: closures.collect(),
        poses: drive.poses.clone(),
        covariances,
        edges,
        rounds,
    }
}

/// A drive with accepted closures.
fn closed(
    drive: &Drive,
    proposals: &[Proposal],
    reasons: &[Option<Reason>],
    detector: &Detector,
    poses: Vec<Pose2>,
    compared: &[ComparedKeyframes],
    rounds: Vec<crate::Round>,
) -> Solution {
    let mut closures: BTreeMap<(usize, usize), Closure> = proposals
        .iter()
        .zip(reasons)
        .map(|(&proposal, &reason)| {
            let rejected = Some(reason.unwrap_or(Reason::NotConfirmed));
            ((proposal.query, proposal.reference), Closure { proposal, rejected })
        })
        .collect();
    add_compared(&mut closures, compared, detector);
    let closures: Vec<Closure> = closures.into_values().collect();
    let accepted: Vec<Proposal> =
        closures.iter().filter(|c| c.rejected.is_none()).map(|c| c.proposal).collect();
    let (covariances, edges) = graph_of(drive, &poses, &accepted, detector);
    Solution { closures, poses, covariances, edges, rounds }
}

/// Adds compared keyframes. They take the place of what was known of the same pair before.
pub(crate) fn add_compared(
    closures: &mut BTreeMap<(usize, usize), Closure>,
    compared: &[ComparedKeyframes],
    detector: &Detector,
) {
    for pair in compared {
        let fit = &pair.compared.fit;
        let before = closures.get(&(pair.query, pair.reference)).map(|c| c.proposal.evidence);
        let evidence = Evidence {
            overlap: fit.overlap,
            known_overlap: fit.known_overlap,
            n_known: fit.n_known as u32,
            conflict: fit.known_conflict(),
            margin: before.map_or(0.0, |evidence| evidence.margin),
            weakness: fit.alignment.weakness.map_or(0.0, |weakness| weakness.ratio),
            classifier: before.and_then(|evidence| evidence.classifier),
        };
        let rejected = match (pair.compared.is_confirmed(), pair.is_supported) {
            (false, _) => Some(Reason::NotConfirmed),
            (true, false) => Some(Reason::Unsupported),
            (true, true) => None,
        };
        let proposal = Proposal {
            query: pair.query,
            reference: pair.reference,
            reference_from_query: fit.a_from_b,
            covariance: covariance(fit, &detector.closure),
            confidence: detector.confidence(&evidence),
            evidence,
        };
        closures.insert((pair.query, pair.reference), Closure { proposal, rejected });
    }
}

/// The pose graph over all scans with the accepted closures, and the covariances of the poses.
pub(crate) fn graph_of(
    drive: &Drive,
    poses: &[Pose2],
    accepted: &[Proposal],
    detector: &Detector,
) -> (Vec<Matrix3<f64>>, Vec<Edge>) {
    let scans: Vec<usize> = (0..drive.n_scans()).collect();
    let mut edges = chain(drive, &drive.poses, &scans, &detector.drift);
    edges.extend(accepted.iter().filter_map(|closure| {
        Some(Edge {
            a: closure.reference,
            b: closure.query,
            a_from_b: closure.reference_from_query,
            information: closure.covariance.cholesky()?.inverse(),
        })
    }));
    let unknown = || vec![Matrix3::zeros(); poses.len()];
    (covariances(&edges, poses).unwrap_or_else(unknown), edges)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bounds from the formula with z = 1.96, computed apart from this program.
    #[test]
    fn few_pairs_leave_the_share_open() {
        for (n_confirmed, n_pairs, expected) in
            [(1, 2, 0.9055), (8, 17, 0.6904), (54, 198, 0.3386), (0, 10, 0.2775)]
        {
            let found = largest_share(n_confirmed, n_pairs);
            assert!((found - expected).abs() < 5e-4, "{n_confirmed} of {n_pairs}: {found}");
        }
        assert!((largest_share(10, 10) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn groups_need_many_confirmed_pairs_that_fit() {
        for (n_confirmed, n_pairs, overlap, expected) in [
            (79, 98, 0.47, true),
            // They fit badly.
            (79, 98, 0.45, false),
            (10, 10, 0.45, false),
            // Few pairs say little about that.
            (9, 9, 0.35, true),
            // Too few, and not by chance, unless they fit well.
            (54, 198, 0.54, false),
            (54, 198, 0.56, true),
            (8, 17, 0.5, true),
            (0, 10, 0.0, false),
        ] {
            let mut overlaps = vec![overlap; n_confirmed];
            let found = is_group_supported(&mut overlaps, n_pairs);
            assert_eq!(found, expected, "{n_confirmed} of {n_pairs} with {overlap}");
        }
    }
}
