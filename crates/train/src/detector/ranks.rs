//! How many places each place is compared with.

use std::collections::BTreeMap;

use model::DetectorPart;

use super::{Judged, NotFitted};

/// Fewer places with a right candidate do not give a recall to within 10 %.
const MIN_PLACES: usize = 25;
/// This share of the places is enough, or less by one standard error. More candidates cost time and add wrong ones.
const ENOUGH: f64 = 0.98;
/// At least this number: a place of another building may look more like others.
const LEAST: u32 = 3;

/// The smallest number of compared places with nearly the recall of the largest number in the data: of
/// the places with a right candidate, those with one among the first `n`. It cannot exceed the number
/// that `detect` compared.
///
/// Nearly means that the share is not less than [`ENOUGH`] by more than its standard error, like the one-standard-error
/// rule of Breiman, Friedman, Olshen and Stone 1984, "Classification and Regression Trees", section 3.4.3. A short drive
/// has some dozen places, and a single one of them would otherwise add several candidates everywhere. Where the
/// weights make a few places decide, there is no such tolerance.
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
    let most = first_ranks.iter().map(|(rank, _)| rank + 1).max().unwrap_or(LEAST);
    let is_enough = |&n: &u32| {
        let Share { share, standard_error, n_equal } = share_before(n, &first_ranks);
        let tolerance = if MIN_PLACES as f64 <= n_equal { standard_error } else { 0.0 };
        ENOUGH <= share + tolerance
    };
    Ok((LEAST..most).find(is_enough).unwrap_or(most.max(LEAST)))
}

/// A weighted share.
struct Share {
    share: f64,
    /// Its standard error, if the places are independent.
    standard_error: f64,
    /// Number of places of equal weight with the same standard error (Kish 1965, "Survey Sampling").
    n_equal: f64,
}

/// The share of the ranks before `n`.
fn share_before(n: u32, ranks: &[(u32, f64)]) -> Share {
    let total: f64 = ranks.iter().map(|(_, weight)| weight).sum();
    let before = ranks.iter().filter(|(rank, _)| *rank < n);
    let share = before.map(|(_, weight)| weight).sum::<f64>() / total;
    let squares: f64 = ranks.iter().map(|(_, weight)| weight * weight).sum();
    let n_equal = total * total / squares;
    Share { share, standard_error: (share * (1.0 - share) / n_equal).max(0.0).sqrt(), n_equal }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: 24 places of a log, one of them found late, and 36 of another log, all found first.
    #[test]
    fn shares_have_the_standard_error_of_weighted_places() {
        let mut ranks = vec![(0, 1.0 / 24.0); 23];
        ranks.push((8, 1.0 / 24.0));
        ranks.extend(vec![(0, 1.0 / 36.0); 36]);
        let found = share_before(3, &ranks);
        assert!((found.share - (1.0 - 1.0 / 48.0)).abs() < 1e-12);
        // sqrt((1/24 + 1/36) * 47/48 * 1/48) / 2
        assert!((found.standard_error - 0.018_819).abs() < 1e-6, "{}", found.standard_error);
        // 4 / (1/24 + 1/36)
        assert!((found.n_equal - 57.6).abs() < 1e-9, "{}", found.n_equal);
        let all = share_before(9, &ranks);
        assert!((all.share - 1.0).abs() < 1e-12 && all.standard_error < 1e-6);
    }
}
