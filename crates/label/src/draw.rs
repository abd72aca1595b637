//! Uniform sampling without replacement, by rank.

use std::collections::{BTreeMap, BTreeSet};

use dataset::SplitMix64;

/// Draws the ranks of `wanted` candidates, or of fewer if there are not enough, with at most `cap` from
/// each place. `firsts` are the rank of the first candidate of each place and the number of candidates,
/// `(n_places + 1,)`.
///
/// The result is the same as that of this procedure: all candidates are visited in random order, each
/// one is taken unless its place has `cap` candidates already, and `wanted` are enough. The next candidate
/// in a random order is equally likely to be any one that was not visited. Those of a full place need
/// not be visited: a place is closed when one of its candidates had to be left out. Without such a
/// candidate, the limit makes no difference.
pub(crate) fn draw(
    random: &mut SplitMix64,
    wanted: usize,
    cap: usize,
    firsts: &[u64],
) -> BTreeSet<u64> {
    let available: u64 = firsts.windows(2).map(|ends| (ends[1] - ends[0]).min(cap as u64)).sum();
    let wanted = wanted.min(usize::try_from(available).unwrap_or(usize::MAX));
    let mut open = Open { closed: Vec::new(), n: firsts.last().copied().unwrap_or(0) };
    let mut n_of_place: BTreeMap<usize, usize> = BTreeMap::new();
    let mut drawn = BTreeSet::new();
    while drawn.len() < wanted {
        let rank = open.rank(random.below(open.n) as u64);
        if drawn.contains(&rank) {
            continue;
        }
        let place = place_of(firsts, rank);
        let n_taken = n_of_place.entry(place).or_default();
        if *n_taken < cap {
            *n_taken += 1;
            drawn.insert(rank);
        } else {
            open.close(firsts[place], firsts[place + 1]);
        }
    }
    drawn
}

/// The place of a candidate.
pub(crate) fn place_of(firsts: &[u64], rank: u64) -> usize {
    firsts.partition_point(|&first| first <= rank) - 1
}

/// The ranks that are not in a closed place.
struct Open {
    /// First rank and end of each closed place, in order.
    closed: Vec<(u64, u64)>,
    n: u64,
}

impl Open {
    /// The open rank with `k` open ranks before it.
    fn rank(&self, k: u64) -> u64 {
        let skip = |rank: u64, &(start, end): &(u64, u64)| match start <= rank {
            true => rank + (end - start),
            false => rank,
        };
        self.closed.iter().fold(k, skip)
    }

    fn close(&mut self, start: u64, end: u64) {
        let at = self.closed.partition_point(|closed| closed.0 < start);
        self.closed.insert(at, (start, end));
        self.n -= end - start;
    }
}

/// A pseudo-random number that depends only on the seed and the parts of a name.
pub(crate) fn name_hash(seed: u64, parts: &[&[u8]]) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    for part in parts {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part);
    }
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places with 4, 0, 1 and 3 candidates.
    const FIRSTS: [u64; 5] = [0, 4, 4, 5, 8];

    #[test]
    fn ranks_skip_closed_places() {
        let mut open = Open { closed: Vec::new(), n: 8 };
        open.close(4, 5);
        assert_eq!((0..open.n).map(|k| open.rank(k)).collect::<Vec<_>>(), [0, 1, 2, 3, 5, 6, 7]);
        open.close(0, 4);
        assert_eq!((0..open.n).map(|k| open.rank(k)).collect::<Vec<_>>(), [5, 6, 7]);
        assert_eq!([0, 3, 4, 5, 7].map(|rank| place_of(&FIRSTS, rank)), [0, 0, 2, 3, 3]);
    }

    /// The definition: candidates in random order, each taken unless its place is full.
    fn slow(random: &mut SplitMix64, wanted: usize, cap: usize) -> BTreeSet<u64> {
        let mut order: Vec<u64> = (0..8).collect();
        for at in (1..order.len()).rev() {
            order.swap(at, random.below(at as u64 + 1));
        }
        let (mut n_of_place, mut taken) = ([0; 4], BTreeSet::new());
        for rank in order {
            let n = &mut n_of_place[place_of(&FIRSTS, rank)];
            if taken.len() < wanted && *n < cap {
                *n += 1;
                taken.insert(rank);
            }
        }
        taken
    }

    /// Each set of ranks is drawn as often as by the definition. The difference of two counts has a variance
    /// of at most their sum, so the sum of all squared differences over the sums is about the number
    /// of sets, with a variance of twice that.
    #[test]
    fn the_draw_has_the_distribution_of_its_definition() {
        const TIMES: u32 = 20_000;
        for (wanted, cap) in [(1, 1), (3, 8), (3, 1), (4, 2), (5, 2), (5, 3), (8, 8)] {
            let mut times: BTreeMap<BTreeSet<u64>, [f64; 2]> = BTreeMap::new();
            let [mut ours, mut defined] = [1, 2].map(SplitMix64::new);
            for _ in 0..TIMES {
                times.entry(draw(&mut ours, wanted, cap, &FIRSTS)).or_default()[0] += 1.0;
                times.entry(slow(&mut defined, wanted, cap)).or_default()[1] += 1.0;
            }
            let n_sets = times.len() as f64;
            let chi_square: f64 = times.values().map(|[a, b]| (a - b).powi(2) / (a + b)).sum();
            let limit = n_sets + 4.0 * (2.0 * n_sets).sqrt();
            assert!(chi_square < limit, "{wanted} of {cap}: {chi_square}, limit {limit}");
        }
    }

    #[test]
    fn a_limit_that_no_place_exceeds_changes_nothing() {
        for seed in 0..200 {
            let of = |cap| draw(&mut SplitMix64::new(seed), 3, cap, &FIRSTS);
            let free = of(usize::MAX);
            let n_largest = (0..4)
                .map(|place| free.iter().filter(|&&rank| place_of(&FIRSTS, rank) == place).count())
                .max();
            for cap in 1..4 {
                assert_eq!(of(cap) == free, n_largest <= Some(cap), "seed {seed}, cap {cap}");
            }
        }
    }

    #[test]
    fn all_candidates_can_be_drawn_and_not_more() {
        let of = |wanted, cap| draw(&mut SplitMix64::new(3), wanted, cap, &FIRSTS).len();
        assert_eq!((of(8, 8), of(9, 9), of(9, 2), of(5, 2), of(0, 2)), (8, 8, 5, 5, 0));
        assert!(draw(&mut SplitMix64::new(3), 5, 2, &[0]).is_empty());
    }
}
