//! Draws among more keyframes than one task counts: all candidates, any number of threads, any order of
//! the logs.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::collections::BTreeSet;

use common::at;
use dataset::{Keyframe, Label, Pair, ScanId, SplitMix64};
use label::{Labelled, Options, label};

/// Four logs of two sites. Each drives around in a square 30 m wide, and half of its scans are at one
/// corner.
fn drives(n_of_log: u32) -> Vec<Keyframe> {
    let mut random = SplitMix64::new(5);
    let mut keyframes = Vec::new();
    for (log, site) in [("c", "north"), ("a", "south"), ("d", "north"), ("b", "south")] {
        keyframes.extend((0..n_of_log).map(|scan| {
            let width_m = if scan % 2 == 0 { 30.0 } else { 3.0 };
            let [x_m, y_m] = [(); 2].map(|()| width_m * random.unit());
            Keyframe { site: site.into(), ..at(log, scan, x_m, y_m) }
        }));
    }
    keyframes
}

fn options(pairs_per_class: usize, max_place_share: f64) -> Options {
    let (negative_min_m, cross_site_negatives) = (20.0, true);
    let default = Options::default();
    Options { negative_min_m, cross_site_negatives, pairs_per_class, max_place_share, ..default }
}

/// The pairs as labelled sets of two scans, without their order.
fn names(keyframes: &[Keyframe], pairs: &[Pair]) -> BTreeSet<(BTreeSet<ScanId>, Label)> {
    let id = |k: usize| keyframes[k].id.clone();
    pairs.iter().map(|p| ([id(p.query), id(p.reference)].into(), p.label)).collect()
}

#[test]
fn all_candidates_of_a_class_can_be_drawn() {
    let keyframes = drives(150);
    let mut expected = [BTreeSet::new(), BTreeSet::new()];
    for query in 0..keyframes.len() {
        for reference in 0..query {
            let (a, b) = (&keyframes[query], &keyframes[reference]);
            let distance_m = a.pose.distance_m(&b.pose);
            if a.site == b.site && distance_m <= 1.5 {
                expected[0].insert((query, reference));
            } else if a.site != b.site || 20.0 < distance_m {
                expected[1].insert((query, reference));
            }
        }
    }
    let [positive, negative] = &expected;
    assert!(positive.len() < negative.len());
    let Labelled { pairs, candidates, .. } =
        label(&options(positive.len(), 1.0), 7, &keyframes).unwrap();
    assert_eq!(candidates.positive, positive.len() as u64);
    assert_eq!(candidates.negative, negative.len() as u64);
    for (class, all) in [(Label::Positive, positive), (Label::Negative, negative)] {
        let drawn = pairs.iter().filter(|pair| pair.label == class);
        let drawn: BTreeSet<_> = drawn.map(|pair| (pair.query, pair.reference)).collect();
        assert_eq!(drawn.len(), positive.len());
        assert!(drawn.is_subset(all), "{class:?}");
    }
}

#[test]
fn the_draw_depends_neither_on_the_threads_nor_on_the_order_of_the_logs() {
    let keyframes = drives(700);
    for max_place_share in [1.0, 0.05] {
        let options = options(300, max_place_share);
        let on = |threads: usize, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| label(&options, seed, &keyframes).unwrap())
        };
        let expected = on(1, 2436);
        assert!(on(2, 2436) == expected && on(8, 2436) == expected);
        let other = on(2, 2437);
        assert_eq!(other.candidates, expected.candidates);
        assert_ne!(names(&keyframes, &other.pairs), names(&keyframes, &expected.pairs));
        let logs: Vec<&[Keyframe]> = keyframes.chunks(700).collect();
        for order in [[3, 2, 1, 0], [1, 3, 0, 2]] {
            let listed: Vec<Keyframe> = order.iter().flat_map(|&k| logs[k].to_vec()).collect();
            let found = label(&options, 2436, &listed).unwrap();
            assert_eq!(found.candidates, expected.candidates);
            assert_eq!(names(&listed, &found.pairs), names(&keyframes, &expected.pairs));
            assert_eq!(found.notes, expected.notes);
        }
        let n_limited =
            expected.notes.iter().filter(|note| note.code() == "place_share_limited").count();
        assert_eq!(0 < n_limited, max_place_share < 1.0, "{:?}", expected.notes);
    }
}

/// Pairs are drawn from all over: of 20 parts of the candidates, by the row of their query, each gets its
/// part of the draws. Chi-square with 19 degrees of freedom has the mean 19 and the variance 38.
#[test]
fn each_keyframe_is_drawn_as_often_as_it_has_candidates() {
    let keyframes = drives(150);
    let all = label(&options(1, 1.0), 7, &keyframes).unwrap().candidates;
    let mut n_candidates = [[0.0; 20]; 2];
    let mut n_drawn = [[0.0; 20]; 2];
    let part = |query: usize| query * 20 / keyframes.len();
    for query in 0..keyframes.len() {
        for reference in 0..query {
            let (a, b) = (&keyframes[query], &keyframes[reference]);
            let distance_m = a.pose.distance_m(&b.pose);
            if a.site == b.site && distance_m <= 1.5 {
                n_candidates[0][part(query)] += 1.0;
            } else if a.site != b.site || 20.0 < distance_m {
                n_candidates[1][part(query)] += 1.0;
            }
        }
    }
    for seed in 0..200 {
        for pair in label(&options(100, 1.0), seed, &keyframes).unwrap().pairs {
            n_drawn[usize::from(pair.label == Label::Negative)][part(pair.query)] += 1.0;
        }
    }
    for (class, n_all) in [all.positive, all.negative].into_iter().enumerate() {
        let chi_square: f64 = (0..20)
            .map(|part| {
                let expected = 200.0 * 100.0 * n_candidates[class][part] / n_all as f64;
                (n_drawn[class][part] - expected).powi(2) / expected.max(1e-9)
            })
            .sum();
        let limit = 19.0 + 4.0 * 38f64.sqrt();
        assert!(chi_square < limit, "class {class}: chi-square {chi_square}, limit {limit}");
    }
}
