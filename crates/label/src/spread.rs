//! The spread of the drawn pairs over the ground: no place gets more than its share.

use std::collections::BTreeMap;

use dataset::{Keyframe, Label, Note, NoteKind, Squares};
use rayon::prelude::*;

use crate::Options;
use crate::draw::{CappedDraw, pair_key};
use crate::rules::{Kind, Rules};

/// The pairs that can be drawn.
pub(crate) struct Candidate<'a> {
    pub(crate) rules: &'a Rules<'a>,
    /// The part of each keyframe in the keys of its pairs, `(n_keyframes,)`.
    pub(crate) hashes: &'a [u64],
    pub(crate) squares: &'a Squares,
}

/// The drawn pairs of a class.
pub(crate) struct Spread {
    pub(crate) pairs: Vec<(usize, usize)>,
    /// How the limit changed the draw.
    pub(crate) note: Option<Note>,
}

/// A place with more than this share of the positives dominates the set, if the limit had to be
/// raised. A drive that closes one loop has its revisits at three or four places next to each other,
/// with up to 0.4 of them at one place, which is normal.
const DOMINANT: f64 = 0.5;

/// Limits the share of each place. `drawn` are the pairs of the class that are drawn without a
/// limit; if no place has too many of them, they are the result. The class must have enough
/// candidates.
pub(crate) fn limit(
    all: &Candidate<'_>,
    options: &Options,
    keyframes: &[Keyframe],
    label: Label,
    drawn: Vec<(usize, usize)>,
) -> Spread {
    let wanted = options.pairs_per_class;
    let cap = cap(options.max_place_share, wanted);
    let (place, n_without) = most(all.squares, &drawn);
    if n_without <= cap {
        return Spread { pairs: drawn, note: None };
    }
    let class = match label {
        Label::Positive => "positive",
        Label::Negative => "negative",
    };
    let limited = |cap: usize| -> Note {
        let (site, x_m, y_m) = centre(options, keyframes, all.squares, place);
        let kind = NoteKind::PlaceShareLimited {
            class: class.to_owned(),
            n_pairs: wanted as u64,
            n_limit: cap as u64,
            n_without: n_without as u64,
            place_m: options.place_m,
            site,
            x_m,
            y_m,
        };
        kind.into()
    };
    let pairs = all.draw(label, wanted, cap);
    if pairs.len() == wanted {
        return Spread { pairs, note: Some(limited(cap)) };
    }
    let counts = all.counts(label);
    let raised = least_cap(&counts, wanted);
    let pairs = all.draw(label, wanted, raised);
    let (place, n_largest) = most(all.squares, &pairs);
    let is_dominant = DOMINANT * (wanted as f64) < n_largest as f64;
    // Negatives are far apart: a small site has them only between its ends.
    if label == Label::Negative || !is_dominant {
        let note = (raised < n_without).then(|| limited(raised));
        return Spread { pairs, note };
    }
    let (site, x_m, y_m) = centre(options, keyframes, all.squares, place);
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
    Spread { pairs, note: Some(kind.into()) }
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

/// The place with the most pairs, and their number.
fn most(squares: &Squares, pairs: &[(usize, usize)]) -> (u32, usize) {
    let mut n_of_place: BTreeMap<u32, usize> = BTreeMap::new();
    for &(query, reference) in pairs {
        *n_of_place.entry(squares.of_pair(query, reference)).or_default() += 1;
    }
    let most = n_of_place.into_iter().max_by_key(|&(place, n)| (n, std::cmp::Reverse(place)));
    most.unwrap_or_default()
}

/// The site and the centre of a place \[m\].
fn centre(
    options: &Options,
    keyframes: &[Keyframe],
    squares: &Squares,
    place: u32,
) -> (String, f64, f64) {
    let found = squares.of_keyframes.iter().position(|&of| of == place);
    let Some(keyframe) = found.map(|k| &keyframes[k]) else { return (String::new(), 0.0, 0.0) };
    let middle = |metres: f64| ((metres / options.place_m).floor() + 0.5) * options.place_m;
    (keyframe.site.to_string(), middle(keyframe.pose.x_m), middle(keyframe.pose.y_m))
}

impl Candidate<'_> {
    /// Draws up to `wanted` pairs of a class, with at most `cap` from each place.
    fn draw(&self, label: Label, wanted: usize, cap: usize) -> Vec<(usize, usize)> {
        let start = || CappedDraw::new(wanted, cap, self.squares);
        (0..self.hashes.len())
            .into_par_iter()
            .fold(start, |mut draw, query| {
                for reference in self.references(label, query) {
                    let key = pair_key(self.hashes[query], self.hashes[reference]);
                    draw.offer((key, query, reference));
                }
                draw
            })
            .reduce(start, CappedDraw::union)
            .into_pairs()
    }

    /// Number of candidates of a class in each place, `(n_squares,)`.
    fn counts(&self, label: Label) -> Vec<u64> {
        let start = || vec![0; self.squares.sizes.len()];
        (0..self.hashes.len())
            .into_par_iter()
            .fold(start, |mut counts: Vec<u64>, query| {
                for reference in self.references(label, query) {
                    counts[self.squares.of_pair(query, reference) as usize] += 1;
                }
                counts
            })
            .reduce(start, |a, b| a.iter().zip(b).map(|(a, b)| a + b).collect())
    }

    /// The keyframes before this one that form a pair of a class with it.
    fn references(&self, label: Label, query: usize) -> impl Iterator<Item = usize> {
        (0..query).filter(move |&reference| {
            matches!(self.rules.kind(query, reference), Kind::Labelled(of) if of == label)
        })
    }
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
