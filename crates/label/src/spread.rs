//! The spread of the drawn pairs over the ground: no place gets more than its share.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Keyframe, Label, Note, NoteKind, SplitMix64};

use crate::Options;
use crate::draw::{draw, name_hash, place_of};

/// The candidates of a class that pairs are drawn from.
pub(crate) struct Class<'a> {
    pub(crate) label: Label,
    /// The rank of the first candidate of each place, and the number of candidates, `(n_places + 1,)`.
    pub(crate) firsts: Vec<u64>,
    /// A keyframe of each place, `(n_places,)`.
    pub(crate) keyframes: Vec<&'a Keyframe>,
}

/// The drawn candidates of a class.
pub(crate) struct Spread {
    pub(crate) ranks: BTreeSet<u64>,
    /// How the limit changed the draw.
    pub(crate) note: Option<Note>,
}

/// A place with more than this share of the positives dominates the set, if the limit had to be
/// raised. A drive that closes one loop has its revisits at three or four places next to each other,
/// with up to 0.4 of them at one place, which is normal.
const DOMINANT: f64 = 0.5;

impl Class<'_> {
    /// Draws pairs with a limited share of each place. The class must have enough candidates.
    pub(crate) fn draw(&self, options: &Options, seed: u64) -> Spread {
        let wanted = options.pairs_per_class;
        let class = match self.label {
            Label::Positive => "positive",
            Label::Negative => "negative",
        };
        let ranks = |cap: usize| {
            let state = name_hash(seed, &[b"draw", class.as_bytes()]);
            draw(&mut SplitMix64::new(state), wanted, cap, &self.firsts)
        };
        let cap = cap(options.max_place_share, wanted);
        let free = ranks(wanted);
        let (place, n_without) = self.most(&free);
        if n_without <= cap {
            return Spread { ranks: free, note: None };
        }
        let counts: Vec<u64> = self.firsts.windows(2).map(|ends| ends[1] - ends[0]).collect();
        let limited = |cap: usize| {
            let (site, x_m, y_m) = self.centre(options, place);
            Note::from(NoteKind::PlaceShareLimited {
                class: class.to_owned(),
                n_pairs: wanted as u64,
                n_limit: cap as u64,
                n_without: n_without as u64,
                place_m: options.place_m,
                site,
                x_m,
                y_m,
            })
        };
        if wanted as u64 <= available(&counts, cap) {
            return Spread { ranks: ranks(cap), note: Some(limited(cap)) };
        }
        let raised = least_cap(&counts, wanted);
        let drawn = ranks(raised);
        let (place, n_largest) = self.most(&drawn);
        let is_dominant = DOMINANT * (wanted as f64) < n_largest as f64;
        // Negatives are far apart: a small site has them only between its ends.
        if self.label == Label::Negative || !is_dominant {
            let note = (raised < n_without).then(|| limited(raised));
            return Spread { ranks: drawn, note };
        }
        let (site, x_m, y_m) = self.centre(options, place);
        let kind = NoteKind::FewPlaces {
            class: class.to_owned(),
            n_pairs: wanted as u64,
            n_limit: cap as u64,
            n_largest: n_largest as u64,
            n_places: counts.iter().filter(|&&n| 0 < n).count() as u64,
            n_enough: largest_draw(&counts, options.max_place_share, wanted) as u64,
            place_m: options.place_m,
            site,
            x_m,
            y_m,
        };
        Spread { ranks: drawn, note: Some(kind.into()) }
    }

    /// The place with the most of these candidates, and their number.
    fn most(&self, ranks: &BTreeSet<u64>) -> (usize, usize) {
        let mut n_of_place: BTreeMap<usize, usize> = BTreeMap::new();
        for &rank in ranks {
            *n_of_place.entry(place_of(&self.firsts, rank)).or_default() += 1;
        }
        let most = n_of_place.into_iter().max_by_key(|&(place, n)| (n, std::cmp::Reverse(place)));
        most.unwrap_or_default()
    }

    /// The site and the centre of a place \[m\].
    fn centre(&self, options: &Options, place: usize) -> (String, f64, f64) {
        let Keyframe { site, pose, .. } = self.keyframes[place];
        let middle = |metres: f64| ((metres / options.place_m).floor() + 0.5) * options.place_m;
        (site.to_string(), middle(pose.x_m), middle(pose.y_m))
    }
}

/// The largest number of pairs from one place.
fn cap(max_place_share: f64, n_pairs: usize) -> usize {
    ((max_place_share * n_pairs as f64).ceil() as usize).max(1)
}

/// The least cap with which all places together have `wanted` pairs.
fn least_cap(counts: &[u64], wanted: usize) -> usize {
    let caps: Vec<usize> = (1..=wanted).collect();
    1 + caps.partition_point(|&cap| available(counts, cap) < wanted as u64)
}

/// The largest number of pairs, up to `wanted`, that can be drawn within the share of each place.
/// 0 if there is none.
fn largest_draw(counts: &[u64], max_place_share: f64, wanted: usize) -> usize {
    let is_possible = |n: &usize| *n as u64 <= available(counts, cap(max_place_share, *n));
    // A share of a few pairs is rounded up: too few pairs are not a useful suggestion.
    let least = (1.0 / max_place_share).ceil() as usize;
    (least..=wanted).rev().find(is_possible).unwrap_or(0)
}

fn available(counts: &[u64], cap: usize) -> u64 {
    counts.iter().map(|&n| n.min(cap as u64)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places with 100, 3 and 2 candidates. 8 pairs: 3 + 3 + 2. 10 pairs: 5 + 3 + 2.
    #[test]
    fn the_cap_is_raised_only_as_far_as_necessary() {
        assert_eq!(least_cap(&[100, 3, 2], 8), 3);
        assert_eq!(least_cap(&[100, 3, 2], 10), 5);
        assert_eq!(least_cap(&[100, 3, 2], 2), 1);
        assert_eq!(least_cap(&[100], 100), 100);
        assert_eq!((cap(0.1, 100), cap(0.1, 101), cap(0.1, 1), cap(1.0, 7)), (10, 11, 1, 7));
    }

    /// Half of 11 pairs, rounded up, is 6: 6 + 3 + 2 = 11, but 12 pairs would need 7. Of 9 pairs, 0.4
    /// is 4: 4 + 3 + 2 = 9, but 10 pairs would need 5. With a share of 0.1 no draw is possible.
    #[test]
    fn the_largest_possible_draw_is_suggested() {
        assert_eq!(largest_draw(&[100, 3, 2], 0.5, 50), 11);
        assert_eq!(largest_draw(&[100, 3, 2], 0.4, 50), 9);
        assert_eq!(largest_draw(&[100, 3, 2], 0.1, 50), 0);
        assert_eq!(largest_draw(&[100, 100], 1.0, 50), 50);
    }
}
