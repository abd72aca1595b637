//! How the labelled pairs are spread over the ground.

use std::collections::BTreeMap;

use dataset::{Label, Squares, common_frames};
use serde::Serialize;

use crate::Input;

/// The spread of the pairs of one class over places. A place is a square of ground,
/// `label.place_m` wide.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// `positive` or `negative`.
    pub class: &'static str,
    /// Number of pairs.
    pub n_pairs: usize,
    /// Number of places with pairs.
    pub n_places: usize,
    /// Number of places of equal numbers of pairs that would be as diverse: the inverse of the
    /// probability that two pairs are from the same place.
    pub effective_places: f64,
    /// Share of the pairs at the place with the most pairs, 0 to 1.
    pub largest_share: f64,
    /// Site of this place.
    pub site: String,
    /// Centre of this place \[m\].
    pub centre_m: [f64; 2],
    /// Share of the pairs whose scans follow each other along the path, 0 to 1. See
    /// [`dataset::Pair::is_neighbour`].
    pub neighbour_share: f64,
}

/// The spread of both classes; a class without pairs is left out.
pub(crate) fn spreads(input: &Input<'_>) -> Vec<Spread> {
    let frames = common_frames(input.keyframes);
    let squares =
        Squares::new(input.keyframes, &frames, input.place_m, input.max_height_difference_m);
    let classes = [("positive", Label::Positive), ("negative", Label::Negative)];
    classes.iter().filter_map(|&(class, label)| spread(input, &squares, class, label)).collect()
}

fn spread(
    input: &Input<'_>,
    squares: &Squares,
    class: &'static str,
    label: Label,
) -> Option<Spread> {
    let mut n_of_place: BTreeMap<u32, usize> = BTreeMap::new();
    let (mut n_pairs, mut n_neighbours) = (0, 0);
    for pair in input.pairs.iter().filter(|pair| pair.label == label) {
        n_pairs += 1;
        n_neighbours += usize::from(pair.is_neighbour());
        *n_of_place.entry(squares.of_pair(pair.query, pair.reference)).or_default() += 1;
    }
    let (&place, &n_largest) = n_of_place.iter().rev().max_by_key(|&(_, n)| n)?;
    let of_place = squares.of_keyframes.iter().position(|&of| of == place)?;
    let keyframe = &input.keyframes[of_place];
    let middle = |metres: f64| ((metres / input.place_m).floor() + 0.5) * input.place_m;
    let n = n_pairs as f64;
    Some(Spread {
        class,
        n_pairs,
        n_places: n_of_place.len(),
        effective_places: n * n / n_of_place.values().map(|&m| (m * m) as f64).sum::<f64>(),
        largest_share: n_largest as f64 / n,
        site: keyframe.site.to_string(),
        centre_m: [keyframe.pose.x_m, keyframe.pose.y_m].map(middle),
        neighbour_share: n_neighbours as f64 / n,
    })
}
