//! How many places each place is compared with.

use std::collections::BTreeMap;

use model::DetectorPart;

use super::{Judged, NotFitted};

/// Fewer places with a right candidate do not give a recall to within 10 %.
const MIN_PLACES: usize = 25;
/// Share of the recall of all ranks that is enough. More candidates cost time and add wrong ones.
const ENOUGH: f64 = 0.98;
/// At least this number: a place of another building may look more like others.
const LEAST: u32 = 3;

/// The smallest number of compared places with nearly the recall of the largest number in the data: of
/// the places with a right candidate, those with one among the first `n`. It cannot exceed the number
/// that `detect` compared.
pub(super) fn fit(logs: &[Vec<Judged<'_>>]) -> Result<u32, NotFitted> {
    // The first rank of each place, and the weight of its log.
    let mut first_ranks: Vec<(u32, f64)> = Vec::new();
    for log in logs {
        let mut of_log: BTreeMap<u64, u32> = BTreeMap::new();
        for candidate in log.iter().filter(|c| c.is_right) {
            let rank = of_log.entry(candidate.found.query).or_insert(u32::MAX);
            *rank = candidate.found.rank.min(*rank);
        }
        let weight = 1.0 / of_log.len().max(1) as f64;
        first_ranks.extend(of_log.values().map(|&rank| (rank, weight)));
    }
    if first_ranks.len() < MIN_PLACES {
        return Err(NotFitted {
            part: DetectorPart::NCandidates,
            found: format!("{} places with a right candidate", first_ranks.len()),
            expected: format!("{MIN_PLACES} or more"),
        });
    }
    let recall = |n: u32| {
        let found = first_ranks.iter().filter(|(rank, _)| *rank < n);
        found.map(|(_, weight)| weight).sum::<f64>()
    };
    let most = first_ranks.iter().map(|(rank, _)| rank + 1).max().unwrap_or(LEAST);
    // The recall of `most` is that of all, so the range contains a number that is enough.
    let enough = (LEAST..most).find(|&n| ENOUGH * recall(most) <= recall(n));
    Ok(enough.unwrap_or(most.max(LEAST)))
}
