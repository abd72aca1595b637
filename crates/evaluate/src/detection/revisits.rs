//! Which keyframes come back to a place, and which of them each stage closes.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;

use serde::Serialize;

use super::closures::{Judged, Verdict};
use super::input::{Drive, KeyframePoses};
use super::truth::TruePose;

/// A keyframe is a revisit if an earlier keyframe is at most this far away \[m\].
pub const REVISIT_M: f64 = 3.0;
/// The path between a revisit and the earlier keyframe is at least this long \[m\].
pub const REVISIT_PATH_M: f64 = 30.0;
/// `detect` compares places a few metres apart, not every keyframe. For the losses of a stage, a
/// keyframe counts as reached if the stage reached one with at most this path in between \[m\]: half of
/// the step between places, and half a metre for the spacing of keyframes.
pub const NEAR_PATH_M: f64 = 1.75;

/// A keyframe that comes back to a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Revisit {
    /// Index of the keyframe.
    pub keyframe: usize,
    /// Whether the robot was there only with a heading more than 90 deg apart.
    pub is_opposite: bool,
    /// Whether there is a candidate with an earlier keyframe of this place, here or at most
    /// [`NEAR_PATH_M`] away.
    pub is_retrieved: bool,
    /// Whether one of these candidates has the right pose.
    pub is_proposed: bool,
    /// Whether one of the candidates with the right pose is an accepted closure.
    pub is_kept: bool,
    /// Whether a right closure is accepted here or at most [`NEAR_PATH_M`] away.
    pub is_closed_nearby: bool,
    /// Whether a right closure of this keyframe is accepted.
    pub is_closed: bool,
}

/// Numbers of revisits that each stage reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct RevisitCounts {
    /// The revisits.
    pub n: usize,
    /// See [`Revisit::is_retrieved`].
    pub n_retrieved: usize,
    /// See [`Revisit::is_proposed`].
    pub n_proposed: usize,
    /// See [`Revisit::is_kept`].
    pub n_kept: usize,
    /// See [`Revisit::is_closed_nearby`].
    pub n_closed_nearby: usize,
    /// See [`Revisit::is_closed`].
    pub n_closed: usize,
}

impl RevisitCounts {
    fn new<'a>(revisits: impl Iterator<Item = &'a Revisit>) -> Self {
        let mut counts = Self::default();
        for revisit in revisits {
            counts.n += 1;
            counts.n_retrieved += usize::from(revisit.is_retrieved);
            counts.n_proposed += usize::from(revisit.is_proposed);
            counts.n_kept += usize::from(revisit.is_kept);
            counts.n_closed_nearby += usize::from(revisit.is_closed_nearby);
            counts.n_closed += usize::from(revisit.is_closed);
        }
        counts
    }

    /// The share of the revisits that are closed; `None` without revisits.
    pub fn recall(&self) -> Option<f64> {
        (0 < self.n).then(|| self.n_closed as f64 / self.n as f64)
    }
}

/// The revisits of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Revisits {
    /// All of them.
    pub all: RevisitCounts,
    /// Those with an earlier visit in the same direction.
    pub same_direction: RevisitCounts,
    /// The others: see [`Revisit::is_opposite`].
    pub opposite_direction: RevisitCounts,
}

impl Revisits {
    pub(crate) fn new(revisits: &[Revisit]) -> Self {
        Self {
            all: RevisitCounts::new(revisits.iter()),
            same_direction: RevisitCounts::new(revisits.iter().filter(|r| !r.is_opposite)),
            opposite_direction: RevisitCounts::new(revisits.iter().filter(|r| r.is_opposite)),
        }
    }
}

/// Finds the revisits of a drive, by the true poses of its keyframes, and what the stages made of
/// them. `candidates` and `closures` are those of the drive, compared with the truth.
///
/// A right closure also joins keyframes that are at most [`REVISIT_M`] apart.
pub fn revisits(
    drive: &Drive<'_>,
    truth: &[Option<TruePose>],
    candidates: &[Option<Judged>],
    closures: &[Option<Judged>],
) -> Vec<Revisit> {
    let is_revisit = |j: &Judged| j.distance_m <= REVISIT_M;
    let is_right = |j: &Judged| is_revisit(j) && j.verdict == Verdict::Right;
    let n = drive.keyframes.len();
    let (mut closed, mut accepted) = (vec![false; n], BTreeSet::new());
    for (closure, judged) in drive.closures.iter().zip(closures) {
        if closure.rejected.is_none() {
            accepted.insert((closure.query, closure.reference));
            closed[closure.query] |= judged.as_ref().is_some_and(is_right);
        }
    }
    let (mut retrieved, mut proposed, mut kept) = (vec![false; n], vec![false; n], vec![false; n]);
    for (candidate, judged) in drive.candidates.iter().zip(candidates) {
        let Some(judged) = judged else { continue };
        let query = candidate.query;
        retrieved[query] |= is_revisit(judged);
        proposed[query] |= is_right(judged);
        kept[query] |= is_right(judged) && accepted.contains(&(query, candidate.reference));
    }
    let near = |reached: &[bool], k: usize| is_reached_near(drive.keyframes, reached, k);
    places_visited_before(drive.keyframes, truth)
        .into_iter()
        .map(|(k, is_opposite)| Revisit {
            keyframe: k,
            is_opposite,
            is_retrieved: near(&retrieved, k),
            is_proposed: near(&proposed, k),
            is_kept: near(&kept, k),
            is_closed_nearby: near(&closed, k),
            is_closed: closed[k],
        })
        .collect()
}

/// Whether a keyframe with at most [`NEAR_PATH_M`] of path in between is reached.
fn is_reached_near(keyframes: &[KeyframePoses], reached: &[bool], k: usize) -> bool {
    let path_m = |j: &usize| keyframes[*j].path_m;
    let here_m = keyframes[k].path_m;
    let before = (0..=k).rev().take_while(|j| here_m - path_m(j) <= NEAR_PATH_M);
    let after = (k + 1..keyframes.len()).take_while(|j| path_m(j) - here_m <= NEAR_PATH_M);
    before.chain(after).any(|j| reached[j])
}

/// The keyframes with an earlier one within [`REVISIT_M`] and at least [`REVISIT_PATH_M`] of path before,
/// and whether all of these earlier ones have a heading more than 90 deg apart.
fn places_visited_before(
    keyframes: &[KeyframePoses],
    truth: &[Option<TruePose>],
) -> Vec<(usize, bool)> {
    let cell = |metres: f64| libm::floor(metres / REVISIT_M) as i64;
    let mut cells: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    let mut found = Vec::new();
    for (k, query) in truth.iter().enumerate() {
        let Some(query) = query.map(|t| t.pose) else { continue };
        let (column, row) = (cell(query.x_m), cell(query.y_m));
        let around =
            (column - 1..=column + 1).flat_map(|c| (row - 1..=row + 1).map(move |r| (c, r)));
        let (mut is_revisit, mut is_opposite) = (false, true);
        for &j in around.filter_map(|key| cells.get(&key)).flatten() {
            let Some(reference) = truth[j].map(|t| t.pose) else { continue };
            let is_long_ago = REVISIT_PATH_M <= keyframes[k].path_m - keyframes[j].path_m;
            if is_long_ago && query.distance_m(&reference) <= REVISIT_M {
                is_revisit = true;
                is_opposite &= FRAC_PI_2 < query.heading_difference_rad(&reference);
            }
        }
        if is_revisit {
            found.push((k, is_opposite));
        }
        cells.entry((column, row)).or_default().push(k);
    }
    found
}

#[cfg(test)]
mod tests {
    use dataset::Pose2;

    use super::*;
    use crate::detection::input::{Evidence, FoundCandidate, FoundClosure};

    fn at(x_m: f64, y_m: f64, heading_deg: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad: heading_deg.to_radians() }
    }

    /// A keyframe every metre: 40 m east along y = 0, then back west along y = 2, 80 keyframes in all.
    fn out_and_back() -> (Vec<KeyframePoses>, Vec<Option<TruePose>>) {
        let poses: Vec<Pose2> = (0..40)
            .map(|k| at(f64::from(k), 0.0, 0.0))
            .chain((0..40).map(|k| at(39.0 - f64::from(k), 2.0, 180.0)))
            .collect();
        let keyframe = |k: usize, pose: Pose2| KeyframePoses {
            scan: k as u32,
            stamp_ns: k as i64,
            path_m: k as f64,
            odometry: pose,
            scan_matched: pose,
            optimized: pose,
            covariance: None,
        };
        let keyframes = poses.iter().enumerate().map(|(k, pose)| keyframe(k, *pose)).collect();
        let truth = poses.iter().map(|&pose| Some(TruePose { pose, is_measured: true })).collect();
        (keyframes, truth)
    }

    fn drive<'a>(
        keyframes: &'a [KeyframePoses],
        candidates: &'a [FoundCandidate],
        closures: &'a [FoundClosure<'a>],
    ) -> Drive<'a> {
        Drive {
            log: "a",
            segment: 0,
            map: Some(0),
            keyframes,
            scans: &[],
            candidates,
            closures,
            truth: None,
            base_from_lidar: Pose2::default(),
        }
    }

    /// Keyframe 40 + k is at (39 - k, 2). Within 3 m of it are the keyframes from 37 - k to 41 - k, which
    /// differ by at most 2.23 m in x. The first of them is 2 k + 3 m of path before. This is 30 m or
    /// more from k = 14 on: keyframes 54 to 79 are revisits, all in the opposite direction.
    #[test]
    fn revisits_need_a_path_and_a_short_distance() {
        let (keyframes, truth) = out_and_back();
        let found = places_visited_before(&keyframes, &truth);
        assert_eq!(found, (54..80).map(|k| (k, true)).collect::<Vec<_>>());
        // Without the truth of the first 10 keyframes, those at x < 7.8 have no earlier keyframe.
        let mut partial = truth;
        partial[..10].fill(None);
        let found = places_visited_before(&keyframes, &partial);
        assert_eq!(found.last(), Some(&(71, true)));
    }

    /// A place is visited in both directions: a revisit of it is in the same direction.
    #[test]
    fn a_revisit_is_opposite_if_all_earlier_visits_are() {
        let (mut keyframes, mut truth) = out_and_back();
        let again = KeyframePoses { path_m: 120.0, scan: 80, stamp_ns: 80, ..keyframes[0] };
        keyframes.push(again);
        truth.push(truth[5]);
        assert_eq!(places_visited_before(&keyframes, &truth).last(), Some(&(80, false)));
    }

    /// Keyframe 60 is at (19, 2) and faces west, keyframe 19 is at (19, 0) and faces east: in the frame of
    /// 19, the query is at (0, 2), turned by 180 deg.
    #[test]
    fn losses_of_each_stage() {
        let (keyframes, truth) = out_and_back();
        let candidate = |query: usize, reference: usize, pose| FoundCandidate {
            query,
            reference,
            reference_from_query: pose,
            confidence: 0.5,
        };
        let closure = |query: usize, reference: usize, pose, rejected| FoundClosure {
            query,
            reference,
            reference_from_query: pose,
            covariance: [0.0; 6],
            confidence: 0.5,
            rejected,
            evidence: Evidence::default(),
        };
        let right = at(0.0, 2.0, 180.0);
        let wrong = at(0.0, 2.0, 0.0);
        // 60 has a right candidate that is accepted, 65 a right one that is rejected, 70 a wrong one,
        // and 75 one of another place. 78 is closed without a candidate.
        let candidates = [
            candidate(60, 19, right),
            candidate(65, 14, right),
            candidate(70, 9, wrong),
            candidate(75, 30, right),
        ];
        let closures = [
            closure(60, 19, right, None),
            closure(65, 14, right, Some("inconsistent")),
            closure(70, 9, wrong, None),
            closure(78, 1, right, None),
        ];
        let drive = drive(&keyframes, &candidates, &closures);
        let judge =
            |of: &dyn Fn(usize) -> (usize, usize, Pose2), n: usize| -> Vec<Option<Judged>> {
                let judged = (0..n).map(of).map(|(q, r, pose)| Judged::of(&truth, (q, r), pose));
                judged.collect()
            };
        let of_candidate = |k: usize| {
            (candidates[k].query, candidates[k].reference, candidates[k].reference_from_query)
        };
        let of_closure =
            |k: usize| (closures[k].query, closures[k].reference, closures[k].reference_from_query);
        let found = revisits(
            &drive,
            &truth,
            &judge(&of_candidate, candidates.len()),
            &judge(&of_closure, closures.len()),
        );
        let which = |is: fn(&Revisit) -> bool| -> Vec<usize> {
            found.iter().filter(|r| is(r)).map(|r| r.keyframe).collect()
        };
        assert_eq!(which(|r| r.is_retrieved), [59, 60, 61, 64, 65, 66, 69, 70, 71]);
        assert_eq!(which(|r| r.is_proposed), [59, 60, 61, 64, 65, 66]);
        assert_eq!(which(|r| r.is_kept), [59, 60, 61]);
        assert_eq!(which(|r| r.is_closed_nearby), [59, 60, 61, 77, 78, 79]);
        assert_eq!(which(|r| r.is_closed), [60, 78]);
        let counts = Revisits::new(&found);
        assert_eq!(counts.all, counts.opposite_direction);
        assert_eq!((counts.all.n, counts.all.n_closed, counts.same_direction.n), (26, 2, 0));
        assert!((counts.all.recall().unwrap() - 2.0 / 26.0).abs() < 1e-12);
        assert_eq!(counts.same_direction.recall(), None);
    }
}
