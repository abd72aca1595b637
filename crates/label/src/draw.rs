//! Uniform sampling without replacement with a bottom-k sketch.

use std::collections::BinaryHeap;

use dataset::{Keyframe, SplitMix64};

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

    pub(crate) fn into_pairs(self) -> impl Iterator<Item = (usize, usize)> {
        self.smallest.into_iter().map(|(_, query, reference)| (query, reference))
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
