//! Uniform sampling without replacement with a bottom-k sketch.

use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use dataset::{Keyframe, SplitMix64, Squares};

/// A pseudo-random key, then the pair it belongs to. Equal keys are ordered by the pair.
type Keyed = (u64, usize, usize);

/// The `k` smallest keys offered so far. The result does not depend on the order of the offers.
pub(crate) struct Draw {
    k: usize,
    smallest: BinaryHeap<Keyed>,
}

impl Draw {
    pub(crate) fn new(k: usize) -> Self {
        Self { k, smallest: BinaryHeap::new() }
    }

    #[inline]
    pub(crate) fn offer(&mut self, keyed: Keyed) {
        if self.smallest.len() < self.k {
            self.smallest.push(keyed);
        } else if let Some(mut largest) = self.smallest.peek_mut()
            && keyed < *largest
        {
            *largest = keyed;
        }
    }

    pub(crate) fn union(mut self, other: Self) -> Self {
        for keyed in other.smallest {
            self.offer(keyed);
        }
        self
    }

    pub(crate) fn into_pairs(self) -> Vec<(usize, usize)> {
        self.smallest.into_iter().map(|(_, query, reference)| (query, reference)).collect()
    }
}

/// The pairs with the smallest keys, but at most `cap` from one place: the pairs that are taken when
/// all pairs are visited in order of their keys, each pair is taken unless its place is full, and
/// `k` pairs are enough.
///
/// These pairs are the lightest basis of a partition matroid, truncated to rank `k`. A pair that is
/// not in the basis of a subset is not in the basis of the whole set (Oxley, "Matroid Theory", 2nd
/// edition, section 1.8). Pairs can therefore be offered in any order, and draws of subsets united.
pub(crate) struct CappedDraw<'a> {
    k: usize,
    cap: usize,
    squares: &'a Squares,
    smallest: BTreeSet<Keyed>,
    by_place: BTreeMap<u32, BTreeSet<Keyed>>,
}

impl<'a> CappedDraw<'a> {
    pub(crate) fn new(k: usize, cap: usize, squares: &'a Squares) -> Self {
        let (smallest, by_place) = (BTreeSet::new(), BTreeMap::new());
        Self { k, cap, squares, smallest, by_place }
    }

    pub(crate) fn offer(&mut self, keyed: Keyed) {
        let is_full = self.k <= self.smallest.len();
        if is_full && self.smallest.last().is_none_or(|largest| *largest < keyed) {
            return;
        }
        let of_place = self.by_place.entry(self.squares.of_pair(keyed.1, keyed.2)).or_default();
        if self.cap <= of_place.len() {
            match of_place.last().copied() {
                Some(largest) if keyed < largest => {
                    of_place.remove(&largest);
                    self.smallest.remove(&largest);
                }
                _ => return,
            }
        }
        of_place.insert(keyed);
        self.smallest.insert(keyed);
        if self.k < self.smallest.len()
            && let Some(largest) = self.smallest.pop_last()
            && let Some(of_place) =
                self.by_place.get_mut(&self.squares.of_pair(largest.1, largest.2))
        {
            of_place.remove(&largest);
        }
    }

    pub(crate) fn union(mut self, other: Self) -> Self {
        for keyed in other.smallest {
            self.offer(keyed);
        }
        self
    }

    pub(crate) fn into_pairs(self) -> Vec<(usize, usize)> {
        self.smallest.into_iter().map(|(_, query, reference)| (query, reference)).collect()
    }
}

/// A keyframe's contribution to the keys of its pairs. It depends only on the seed and on the
/// scan's log and number.
pub(crate) fn keyframe_hash(seed: u64, keyframe: &Keyframe) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(&keyframe.id.scan.to_le_bytes());
    hasher.update(keyframe.id.log.as_bytes());
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
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

/// The key of a pair, the first output of [`SplitMix64`] for the sum of both hashes. Exchanging `a`
/// and `b` gives the same key.
#[inline]
pub(crate) fn pair_key(a: u64, b: u64) -> u64 {
    SplitMix64::new(a.wrapping_add(b)).next_u64()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition: pairs in order of their keys, each taken unless its place is full.
    fn slow(pairs: &[Keyed], k: usize, cap: usize, squares: &Squares) -> Vec<(usize, usize)> {
        let mut sorted = pairs.to_vec();
        sorted.sort_unstable();
        let mut n_of_place: BTreeMap<u32, usize> = BTreeMap::new();
        let mut taken = Vec::new();
        for (_, query, reference) in sorted {
            let n = n_of_place.entry(squares.of_pair(query, reference)).or_default();
            if taken.len() < k && *n < cap {
                *n += 1;
                taken.push((query, reference));
            }
        }
        taken
    }

    #[test]
    fn the_capped_draw_takes_pairs_in_order_of_their_keys_until_their_place_is_full() {
        let mut random = SplitMix64::new(9);
        for round in 0..300 {
            let n = 2 + random.below(20);
            // Half of the keyframes are in square 0.
            let of_keyframes: Vec<u32> =
                (0..n).map(|_| random.below(8).saturating_sub(4) as u32).collect();
            let mut sizes = vec![0; 4];
            of_keyframes.iter().for_each(|&square| sizes[square as usize] += 1);
            let squares = Squares { of_keyframes, sizes };
            let mut pairs: Vec<Keyed> = (0..n)
                .flat_map(|query| (0..query).map(move |reference| (query, reference)))
                .map(|(query, reference)| (random.next_u64() % 50, query, reference))
                .collect();
            let (k, cap) = (1 + random.below(30), 1 + random.below(12));
            let expected = slow(&pairs, k, cap, &squares);
            // In any order, and in parts.
            for at in (1..pairs.len()).rev() {
                pairs.swap(at, random.below(at as u64 + 1));
            }
            let draw = |pairs: &[Keyed]| {
                let mut draw = CappedDraw::new(k, cap, &squares);
                pairs.iter().for_each(|&keyed| draw.offer(keyed));
                draw
            };
            let (some, others) = pairs.split_at(pairs.len() / 3);
            assert_eq!(draw(&pairs).into_pairs(), expected, "round {round}");
            assert_eq!(draw(some).union(draw(others)).into_pairs(), expected, "round {round}");
        }
    }
}
