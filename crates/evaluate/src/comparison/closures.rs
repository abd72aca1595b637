//! Closures that only one of two runs accepts, and those that moved.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{JudgedClosure, Pose2, ScanId, quantile};
use serde::Serialize;

use super::input::{MappedRun, Tolerances};
use super::scans::{Counterpart, Matched};
use crate::detection::normalized_error;

/// The accepted closures of two runs. A closure is a pair of scans.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparedClosures {
    /// Closures that A accepts.
    pub n_a: usize,
    /// Closures that B accepts.
    pub n_b: usize,
    /// Closures that both accept.
    pub n_kept: usize,
    /// Closures that only A accepts, between logs of both runs.
    pub n_lost: usize,
    /// Closures that only B accepts, between logs of both runs.
    pub n_gained: usize,
    /// Accepted closures of A with a log that B does not have.
    pub n_with_logs_only_in_a: usize,
    /// Accepted closures of B with a log that A does not have.
    pub n_with_logs_only_in_b: usize,
    /// Kept closures that moved by more than the tolerance.
    pub n_moved: usize,
    /// Keyframes of both runs with an accepted closure in A.
    pub n_closed_keyframes_a: usize,
    /// Keyframes of both runs with an accepted closure in B.
    pub n_closed_keyframes_b: usize,
    /// Keyframes of both runs with an accepted closure in A only.
    pub n_closed_keyframes_only_a: usize,
    /// Keyframes of both runs with an accepted closure in B only.
    pub n_closed_keyframes_only_b: usize,
    /// Why B does not accept the lost closures.
    pub lost: Vec<ReasonCount>,
    /// Why A did not accept the gained closures.
    pub gained: Vec<ReasonCount>,
    /// How far the kept closures moved; `null` if there are none.
    pub kept: Option<Motion>,
    /// The lost, gained and moved closures, in this order.
    pub changes: Vec<ClosureChange>,
}

/// How many closures a run does not accept for a reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ReasonCount {
    /// The reason in `closures.parquet` of the run that does not accept it; `not_found` if the closure
    /// is not in that table, `no_keyframe` if one of its scans is not a keyframe there, and `other_scan`
    /// if a scan with that number has another stamp there.
    pub reason: String,
    /// Number of closures.
    pub n: usize,
}

/// How far the relative poses of closures differ between two runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Motion {
    /// Median shift \[m\].
    pub median_m: f64,
    /// Largest shift \[m\].
    pub max_m: f64,
    /// Median turn \[deg\].
    pub median_deg: f64,
    /// Largest turn \[deg\].
    pub max_deg: f64,
    /// Median of the Mahalanobis distance by the covariance of the closure in A \[standard deviations\];
    /// `null` if no covariance is positive definite.
    pub median_std: Option<f64>,
    /// Largest of these distances.
    pub max_std: Option<f64>,
}

/// What happened to a closure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum ChangeOfClosure {
    /// Only A accepts it.
    Lost,
    /// Only B accepts it.
    Gained,
    /// Both accept it, and its relative pose moved by more than the tolerance.
    Moved,
}

/// A lost, gained or moved closure.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ClosureChange {
    /// What happened.
    pub change: ChangeOfClosure,
    /// Log of the query.
    pub query_log: String,
    /// Number of the query in its log.
    pub query_scan: u32,
    /// Log of the reference.
    pub reference_log: String,
    /// Number of the reference in its log.
    pub reference_scan: u32,
    /// For a lost or gained closure, why the other run does not accept it. See [`ReasonCount::reason`].
    pub reason: Option<String>,
    /// For a moved closure, the shift \[m\].
    pub shift_m: Option<f64>,
    /// For a moved closure, the turn \[deg\].
    pub turn_deg: Option<f64>,
    /// For a moved closure, the Mahalanobis distance by the covariance of A \[standard deviations\].
    pub shift_std: Option<f64>,
}

/// The same two scans, whichever of them is the query.
type Key<'a> = [&'a ScanId; 2];

/// What a run says about a pair of scans.
#[derive(Clone, Copy)]
struct Found<'a> {
    accepted: Option<&'a JudgedClosure>,
    /// The one with the highest confidence.
    rejected: Option<&'a JudgedClosure>,
}

impl ComparedClosures {
    pub(super) fn new(
        a: &MappedRun<'_>,
        b: &MappedRun<'_>,
        matched: &Matched<'_>,
        tolerances: &Tolerances,
    ) -> Self {
        let (found_a, found_b) = (by_scans(a.closures), by_scans(b.closures));
        let lost = differing(&found_a, &found_b, matched, ChangeOfClosure::Lost);
        let gained = differing(&found_b, &found_a, matched, ChangeOfClosure::Gained);
        let kept = kept(&found_a, &found_b, matched);
        let moved = kept.iter().filter(|moved| moved.is_beyond(tolerances)).map(Moved::change);
        let moved: Vec<ClosureChange> = moved.collect();
        let count = |found: &BTreeMap<Key<'_>, Found<'_>>| {
            found.values().filter(|found| found.accepted.is_some()).count()
        };
        let [closed_a, closed_b] = [&found_a, &found_b].map(|found| closed(found, matched));
        Self {
            n_a: count(&found_a),
            n_b: count(&found_b),
            n_kept: kept.len(),
            n_lost: lost.changes.len(),
            n_gained: gained.changes.len(),
            n_with_logs_only_in_a: lost.n_other_logs,
            n_with_logs_only_in_b: gained.n_other_logs,
            n_moved: moved.len(),
            n_closed_keyframes_a: closed_a.len(),
            n_closed_keyframes_b: closed_b.len(),
            n_closed_keyframes_only_a: closed_a.difference(&closed_b).count(),
            n_closed_keyframes_only_b: closed_b.difference(&closed_a).count(),
            lost: reasons(&lost.changes),
            gained: reasons(&gained.changes),
            kept: motion(&kept),
            changes: [lost.changes, gained.changes, moved].concat(),
        }
    }
}

fn by_scans(closures: &[JudgedClosure]) -> BTreeMap<Key<'_>, Found<'_>> {
    let mut found: BTreeMap<Key<'_>, Found<'_>> = BTreeMap::new();
    for judged in closures {
        let (query, reference) = (&judged.closure.query, &judged.closure.reference);
        let key = if reference <= query { [query, reference] } else { [reference, query] };
        let of_pair = found.entry(key).or_insert(Found { accepted: None, rejected: None });
        let place =
            if judged.is_accepted() { &mut of_pair.accepted } else { &mut of_pair.rejected };
        if place.is_none_or(|best| best.closure.confidence < judged.closure.confidence) {
            *place = Some(judged);
        }
    }
    found
}

/// The closures that only one run accepts.
struct Differing {
    /// Those between logs of both runs.
    changes: Vec<ClosureChange>,
    /// Those with a log that the other run does not have.
    n_other_logs: usize,
}

fn differing<'a>(
    here: &BTreeMap<Key<'a>, Found<'a>>,
    there: &BTreeMap<Key<'a>, Found<'a>>,
    matched: &Matched<'_>,
    change: ChangeOfClosure,
) -> Differing {
    let mut found = Differing { changes: Vec::new(), n_other_logs: 0 };
    for (key, of_pair) in here {
        let Some(judged) = of_pair.accepted else { continue };
        let counterparts = key.map(|id| matched.counterpart(id));
        if counterparts.contains(&Counterpart::NoLog) {
            found.n_other_logs += 1;
            continue;
        }
        let reason = if counterparts.contains(&Counterpart::OtherScan) {
            "other_scan"
        } else if counterparts.contains(&Counterpart::NoKeyframe) {
            "no_keyframe"
        } else {
            match there.get(key) {
                Some(Found { accepted: Some(_), .. }) => continue,
                Some(Found { rejected: Some(rejected), .. }) => {
                    rejected.rejected.as_deref().unwrap_or("not_found")
                }
                _ => "not_found",
            }
        };
        let reason = Some(reason.to_owned());
        found.changes.push(ClosureChange { reason, ..named(change, judged) });
    }
    found
}

/// A change of a closure, without its reason and its motion.
fn named(change: ChangeOfClosure, judged: &JudgedClosure) -> ClosureChange {
    let (query, reference) = (&judged.closure.query, &judged.closure.reference);
    ClosureChange {
        change,
        query_log: query.log.to_string(),
        query_scan: query.scan,
        reference_log: reference.log.to_string(),
        reference_scan: reference.scan,
        reason: None,
        shift_m: None,
        turn_deg: None,
        shift_std: None,
    }
}

fn reasons(changes: &[ClosureChange]) -> Vec<ReasonCount> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for reason in changes.iter().filter_map(|change| change.reason.as_deref()) {
        *counts.entry(reason).or_default() += 1;
    }
    counts.into_iter().map(|(reason, n)| ReasonCount { reason: reason.to_owned(), n }).collect()
}

/// A closure that both runs accept.
struct Moved<'a> {
    a: &'a JudgedClosure,
    shift_m: f64,
    turn_deg: f64,
    shift_std: Option<f64>,
}

impl Moved<'_> {
    fn is_beyond(&self, tolerances: &Tolerances) -> bool {
        tolerances.max_shift_m < self.shift_m || tolerances.max_turn_deg < self.turn_deg
    }

    fn change(&self) -> ClosureChange {
        ClosureChange {
            shift_m: Some(self.shift_m),
            turn_deg: Some(self.turn_deg),
            shift_std: self.shift_std,
            ..named(ChangeOfClosure::Moved, self.a)
        }
    }
}

fn kept<'a>(
    found_a: &BTreeMap<Key<'a>, Found<'a>>,
    found_b: &BTreeMap<Key<'a>, Found<'a>>,
    matched: &Matched<'_>,
) -> Vec<Moved<'a>> {
    let of_pair = |(key, found): (&Key<'a>, &Found<'a>)| {
        let (a, b) = (found.accepted?, found_b.get(key)?.accepted?);
        let is_same = key.iter().all(|id| matched.counterpart(id) == Counterpart::Same);
        is_same.then(|| {
            let (before, now) = (&a.closure, &b.closure);
            let pose: Pose2 = match before.query == now.query {
                true => now.reference_from_query,
                false => now.reference_from_query.inverse(),
            };
            let squared = normalized_error(pose, before.reference_from_query, &before.covariance);
            let turn_rad = pose.heading_difference_rad(&before.reference_from_query);
            Moved {
                a,
                shift_m: pose.distance_m(&before.reference_from_query),
                turn_deg: turn_rad.to_degrees(),
                shift_std: squared.map(f64::sqrt),
            }
        })
    };
    found_a.iter().filter_map(of_pair).collect()
}

/// `None` without closures.
fn motion(kept: &[Moved<'_>]) -> Option<Motion> {
    let sorted = |of: &dyn Fn(&Moved<'_>) -> Option<f64>| {
        let mut values: Vec<f64> = kept.iter().filter_map(of).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let [m, deg, std] = [
        sorted(&|moved| Some(moved.shift_m)),
        sorted(&|moved| Some(moved.turn_deg)),
        sorted(&|moved| moved.shift_std),
    ];
    let median = |values: &[f64]| quantile(values, 0.5);
    Some(Motion {
        median_m: median(&m),
        max_m: *m.last()?,
        median_deg: median(&deg),
        max_deg: *deg.last()?,
        median_std: std.last().map(|_| median(&std)),
        max_std: std.last().copied(),
    })
}

/// The keyframes of both runs that an accepted closure joins with another one.
fn closed<'a>(found: &BTreeMap<Key<'a>, Found<'a>>, matched: &Matched<'_>) -> BTreeSet<&'a ScanId> {
    let accepted = found.iter().filter(|(_, found)| found.accepted.is_some());
    let ends = accepted.flat_map(|(key, _)| *key);
    ends.filter(|id| matched.counterpart(id) == Counterpart::Same).collect()
}
