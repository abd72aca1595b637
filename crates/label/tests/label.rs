//! Labels with counts worked out by hand, the draw of pairs, and the folds.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

use common::{at, line};
use dataset::{Keyframe, Label, Pair, Pose2, ScanId};
use label::{
    ALIGNMENT_STD_M, Candidates, FoldOptions, Grouping, LabelError, Labelled, Measurement, Options,
    PoseGraph, Vertex, assign_folds, label, label_by_graph,
};

/// Three logs of one site, each with 5 by 5 positions 1 m apart. The first two logs overlap, the
/// third is farther away. Hundreds of pairs are within 1.5 m or more than 5 m apart, within a log and
/// across logs.
fn three_logs() -> Vec<Keyframe> {
    let mut keyframes = Vec::new();
    for (log, x_m) in [("a", 0.0), ("b", 2.5), ("c", 20.0)] {
        keyframes.extend((0..25).map(|k| Keyframe {
            site: "campus".into(),
            ..at(log, k, x_m + f64::from(k % 5), f64::from(k / 5))
        }));
    }
    keyframes
}

fn options(positive_radius_m: f64, negative_min_m: f64, pairs_per_class: usize) -> Options {
    let max_place_share = 1.0;
    let default = Options::default();
    Options { positive_radius_m, negative_min_m, pairs_per_class, max_place_share, ..default }
}

/// Checks the number of pairs that are positive, negative, ambiguous, too close along the path, and
/// without a common frame. `options` must not ask for more pairs than there are.
#[track_caller]
fn check(options: &Options, keyframes: &[Keyframe], counts: [u64; 5]) -> Vec<Pair> {
    let [positive, negative, ambiguous, short_travel_gap, without_common_frame] = counts;
    let Labelled { pairs, candidates: found, .. } = label(options, 7, keyframes).unwrap();
    let expected = Candidates {
        positive,
        negative,
        ambiguous,
        short_travel_gap,
        without_common_frame,
        ..Candidates::default()
    };
    assert_eq!(found, expected);
    let n = keyframes.len() as u64;
    assert_eq!(counts.iter().sum::<u64>(), n * (n - 1) / 2, "each pair is counted once");
    pairs
}

/// The pairs as labelled sets of two scans, without their order.
fn names(keyframes: &[Keyframe], pairs: &[Pair]) -> BTreeSet<(BTreeSet<ScanId>, Label)> {
    let id = |k: usize| keyframes[k].id.clone();
    pairs.iter().map(|p| ([id(p.query), id(p.reference)].into(), p.label)).collect()
}

#[test]
fn pairs_on_a_line_are_positive_negative_or_ambiguous() {
    // Positive: 0-1 and 60-61 at 1 m, 1-2.5 at exactly 1.5 m. Ambiguous: 0-2.5. Negative: 3 x 2.
    let keyframes = line(&[0.0, 1.0, 2.5, 60.0, 61.0]);
    let pairs = check(&options(1.5, 50.0, 3), &keyframes, [3, 6, 1, 0, 0]);
    let near: Vec<_> = pairs
        .iter()
        .filter(|p| p.label == Label::Positive)
        .map(|p| (p.query, p.reference, p.distance_m, p.travel_gap_m))
        .collect();
    assert_eq!(near, [(1, 0, 1.0, 100.0), (2, 1, 1.5, 100.0), (4, 3, 1.0, 100.0)]);
    assert!(pairs.iter().all(|p| p.heading_difference_rad == Some(0.0)));
}

#[test]
fn pairs_on_a_grid_are_counted_on_both_sides_of_each_limit() {
    // 3 by 3 positions 1 m apart: 12 pairs at 1 m, 8 at sqrt 2, 6 at 2 m, 8 at sqrt 5, 2 at sqrt 8.
    let grid: Vec<Keyframe> =
        (0..9).map(|k| at("a", k, f64::from(k % 3), f64::from(k / 3))).collect();
    check(&options(1.0, 2.0, 10), &grid, [12, 10, 14, 0, 0]);
    check(&options(1.5, 2.0, 10), &grid, [20, 10, 6, 0, 0]);
    check(&options(2.0, 2.0, 10), &grid, [26, 10, 0, 0, 0]);
    check(&options(1f64.next_up(), 2f64.next_down(), 10), &grid, [12, 16, 8, 0, 0]);
}

#[test]
fn the_positive_radius_is_inclusive_and_the_negative_limit_is_exclusive() {
    let far = 50f64.next_up();
    check(&options(1.5, 50.0, 1), &line(&[0.0, 1.5, far]), [1, 1, 1, 0, 0]);
    check(&options(1.5, 50.0, 1), &line(&[0.0, 50.0, far]), [1, 1, 1, 0, 0]);
    let beyond = 1.5f64.next_up();
    for (xs_m, missing) in [([0.0, beyond, 60.0], "positive"), ([0.0, 1.0, 50.0], "negative")] {
        let few = label(&options(1.5, 50.0, 1), 7, &line(&xs_m));
        let Err(LabelError::TooFew { n_positive, n_negative, .. }) = few else { panic!("{few:?}") };
        assert_eq!(
            (n_positive == 0, n_negative == 0),
            (missing == "positive", missing == "negative")
        );
    }
}

#[test]
fn headings_count_only_for_scans_of_less_than_a_full_circle() {
    // Three scans at one place with headings 45, 46 and 91 deg apart; a fourth scan is far away.
    let scans = |coverages_deg: [f32; 3]| {
        let mut keyframes = line(&[0.0, 0.0, 0.0, 60.0]);
        for (k, heading_deg) in [0.0, 45.0f64, -46.0].into_iter().enumerate() {
            keyframes[k].pose.heading_rad = heading_deg.to_radians();
            keyframes[k].coverage_deg = coverages_deg[k];
        }
        keyframes
    };
    let within = |positive_heading_deg| Options { positive_heading_deg, ..options(1.5, 50.0, 1) };
    check(&within(45.0), &scans([270.0; 3]), [1, 3, 2, 0, 0]);
    check(&within(90.0), &scans([270.0; 3]), [2, 3, 1, 0, 0]);
    check(&within(180.0), &scans([270.0; 3]), [3, 3, 0, 0, 0]);
    check(&within(45.0), &scans([355.0; 3]), [3, 3, 0, 0, 0]);
    check(&within(45.0), &scans([354.9; 3]), [1, 3, 2, 0, 0]);
    // Both scans must see the full circle: only the pair with headings 0 and -46 deg does.
    check(&within(45.0), &scans([360.0, 270.0, 360.0]), [2, 3, 1, 0, 0]);
}

#[test]
fn heading_differences_wrap_at_360_degrees() {
    let mut keyframes = line(&[0.0, 0.0, 60.0]);
    for (keyframe, heading_deg) in keyframes.iter_mut().zip([350.0f64, 10.0, 0.0]) {
        keyframe.pose.heading_rad = heading_deg.to_radians();
        keyframe.coverage_deg = 180.0;
    }
    let narrow = Options { positive_heading_deg: 20.5, ..options(1.5, 50.0, 1) };
    let pairs = check(&narrow, &keyframes, [1, 2, 0, 0, 0]);
    let difference_rad = pairs[0].heading_difference_rad.unwrap();
    assert!((difference_rad - PI / 9.0).abs() < 1e-12, "{difference_rad}");
}

#[test]
fn the_travel_gap_applies_within_a_log_and_not_across_logs() {
    // Drives to 1 m and 60 m, then is back at the start after 120 m of path.
    let mut keyframes = line(&[0.0, 1.0, 60.0, 0.0]);
    for (keyframe, travel_m) in keyframes.iter_mut().zip([0.0, 1.0, 60.0, 120.0]) {
        keyframe.travel_m = travel_m;
    }
    let gap = |min_travel_gap_m| Options { min_travel_gap_m, ..options(1.5, 50.0, 1) };
    check(&gap(0.0), &keyframes, [3, 3, 0, 0, 0]);
    check(&gap(1.0), &keyframes, [3, 3, 0, 0, 0]);
    check(&gap(5.0), &keyframes, [2, 3, 0, 1, 0]);
    check(&gap(119.0), &keyframes, [2, 3, 0, 1, 0]);
    check(&gap(119.5), &keyframes, [1, 3, 0, 2, 0]);

    // Another log of the site begins at the start: it is close to three scans.
    keyframes.push(Keyframe { site: "a".into(), ..at("b", 0, 0.0, 0.0) });
    let pairs = check(&Options { pairs_per_class: 4, ..gap(119.5) }, &keyframes, [4, 4, 0, 2, 0]);
    let across: Vec<_> = pairs.iter().filter(|p| p.query == 4).collect();
    assert_eq!(across.len(), 4);
    assert!(across.iter().all(|p| p.travel_gap_m == f64::INFINITY && p.distance_m.is_finite()));
}

#[test]
fn only_logs_of_one_site_give_pairs_with_a_common_frame() {
    // `a` passes 0 m and 60 m. `b`, of the same site, passes 0 m. `c`, of another site, too.
    let mut keyframes = line(&[0.0, 60.0]);
    keyframes.push(Keyframe { site: "a".into(), ..at("b", 0, 0.0, 0.0) });
    keyframes.push(at("c", 0, 0.0, 0.0));
    let pairs = check(&options(1.5, 50.0, 1), &keyframes, [1, 2, 0, 0, 3]);
    assert!(pairs.iter().all(|p| p.query != 3));

    let across = Options { cross_site_negatives: true, ..options(1.5, 50.0, 1) };
    check(&across, &keyframes, [1, 5, 0, 0, 0]);
    // All three negative pairs are drawn, each between `a` and `c`. Without a common frame there is
    // no heading difference.
    let keyframes =
        [at("a", 0, 0.0, 0.0), at("c", 0, 0.0, 0.0), at("c", 1, 0.5, 0.0), at("c", 2, 1.0, 0.0)];
    let pairs = check(&Options { pairs_per_class: 3, ..across }, &keyframes, [3, 3, 0, 0, 0]);
    for pair in &pairs {
        let is_across = pair.reference == 0;
        assert_eq!(pair.label == Label::Negative, is_across);
        assert_eq!(pair.distance_m == f64::INFINITY, is_across);
        assert_eq!(pair.travel_gap_m == f64::INFINITY, is_across);
        assert_eq!(pair.heading_difference_rad, (!is_across).then_some(0.0));
    }
}

#[test]
fn the_draw_has_the_requested_size_and_no_duplicate_pairs() {
    let keyframes = three_logs();
    for pairs_per_class in [1, 10, 200] {
        let pairs = label(&options(1.5, 5.0, pairs_per_class), 7, &keyframes).unwrap().pairs;
        for class in [Label::Positive, Label::Negative] {
            assert_eq!(pairs.iter().filter(|p| p.label == class).count(), pairs_per_class);
        }
        assert!(pairs.iter().all(|p| p.reference < p.query && p.query < keyframes.len()));
        let order = |p: &Pair| (p.query, p.reference);
        assert!(pairs.windows(2).all(|two| order(&two[0]) < order(&two[1])), "sorted and unique");
        for pair in &pairs {
            let (a, b) = (&keyframes[pair.query].pose, &keyframes[pair.reference].pose);
            assert_eq!(pair.distance_m, a.distance_m(b));
            assert_eq!(pair.label == Label::Positive, pair.distance_m <= 1.5);
            assert_eq!(pair.label == Label::Negative, 5.0 < pair.distance_m);
        }
    }
}

#[test]
fn the_error_for_too_few_pairs_states_the_counts_and_the_remedy() {
    let keyframes = line(&[0.0, 1.0, 2.5, 60.0, 61.0]);
    let check_message = |options: Options, parts: &[&str]| {
        let message = label(&options, 7, &keyframes).unwrap_err().to_string();
        assert!(message.starts_with(parts[0]), "{message}");
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    };
    check_message(
        options(1.5, 50.0, 4),
        &[
            "found 3 positive and 6 negative pairs among 5 keyframes, but `label.pairs_per_class` asks for 4 of each (not used: 1 ambiguous)",
            "raise `label.positive_radius_m`",
            "lower `label.min_travel_gap_m`",
            "`label.pairs_per_class = 3` works for both classes",
        ],
    );
    // Only the first and the last scan are more than 60 m apart.
    check_message(
        options(1.5, 60.0, 2),
        &[
            "found 3 positive and 1 negative pairs among 5 keyframes, but `label.pairs_per_class` asks for 2",
            "lower `label.negative_min_m`",
            "the same `site`",
            "set `label.cross_site_negatives`",
            "`label.pairs_per_class = 1` works for both classes",
        ],
    );
    let none = label(&Options::default(), 7, &[]);
    assert!(matches!(
        none,
        Err(LabelError::TooFew { n_positive: 0, n_negative: 0, n_keyframes: 0, .. })
    ));
}

#[test]
fn the_draw_depends_on_the_seed_and_not_on_the_number_of_threads() {
    let keyframes = three_logs();
    let draw = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| label(&options(1.5, 5.0, 50), seed, &keyframes).unwrap())
    };
    let expected = draw(1, 2436);
    for threads in [1, 2, 8] {
        assert!(draw(threads, 2436) == expected, "{threads} threads");
    }
    let Labelled { pairs: other, candidates, .. } = draw(1, 2437);
    assert_eq!(candidates, expected.candidates);
    for class in [Label::Positive, Label::Negative] {
        let of_class = |pairs: &[Pair]| {
            pairs.iter().filter(|p| p.label == class).map(|p| (p.query, p.reference)).collect()
        };
        let (a, b): (Vec<_>, Vec<_>) = (of_class(&expected.pairs), of_class(&other));
        assert!(a != b, "another seed draws another {class:?} set");
    }
}

#[test]
fn the_draw_does_not_depend_on_the_order_of_the_logs() {
    let options = options(1.5, 5.0, 50);
    let keyframes = three_logs();
    let Labelled { pairs, candidates, .. } = label(&options, 2436, &keyframes).unwrap();
    let logs: Vec<&[Keyframe]> = keyframes.chunks(25).collect();
    for order in [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        let listed: Vec<Keyframe> = order.iter().flat_map(|&k| logs[k].to_vec()).collect();
        let Labelled { pairs: others, candidates: counts, .. } =
            label(&options, 2436, &listed).unwrap();
        assert_eq!(counts, candidates);
        assert!(names(&listed, &others) == names(&keyframes, &pairs), "logs in order {order:?}");
    }
}

#[test]
fn every_set_of_pairs_is_equally_likely() {
    // Five scans close to each other: 10 positive pairs and 120 sets of three of them. One scan
    // far from these 5 and one of another site: 5 + 6 negative pairs and 165 sets of three.
    let mut keyframes = line(&[0.0, 0.1, 0.2, 0.3, 0.4, 60.0, 120.0]);
    keyframes[6].site = "elsewhere".into();
    keyframes[6].id.log = "b".into();
    let options = Options { cross_site_negatives: true, ..options(1.5, 50.0, 3) };
    let candidates = label(&options, 0, &keyframes).unwrap().candidates;
    assert_eq!((candidates.positive, candidates.negative), (10, 11));

    const SEEDS: u64 = 6000;
    let mut times: BTreeMap<(Label, Vec<(usize, usize)>), u32> = BTreeMap::new();
    for seed in 0..SEEDS {
        let pairs = label(&options, seed, &keyframes).unwrap().pairs;
        for class in [Label::Positive, Label::Negative] {
            let of_class = pairs.iter().filter(|p| p.label == class);
            let set = of_class.map(|p| (p.query, p.reference)).collect();
            *times.entry((class, set)).or_default() += 1;
        }
    }
    // Chi-square with n - 1 degrees of freedom has mean n - 1 and variance 2 (n - 1); four
    // standard deviations above the mean occur less often than 1 in 2000 times here.
    for (class, n_sets) in [(Label::Positive, 120.0), (Label::Negative, 165.0)] {
        let expected = SEEDS as f64 / n_sets;
        let seen: Vec<u32> =
            times.iter().filter(|((label, _), _)| *label == class).map(|(_, &n)| n).collect();
        assert_eq!(seen.len() as f64, n_sets, "every set is drawn by some seed");
        let chi_square: f64 =
            seen.iter().map(|&n| (f64::from(n) - expected).powi(2) / expected).sum();
        let limit = (n_sets - 1.0) + 4.0 * (2.0 * (n_sets - 1.0)).sqrt();
        assert!(chi_square < limit, "{class:?}: chi-square {chi_square}, limit {limit}");
    }
}

#[test]
fn an_option_out_of_range_is_reported_by_name() {
    let good = Options::default;
    assert_eq!(good().check(), Ok(()));
    let least = Options { positive_heading_deg: 0.0, ..options(0.0, 0.0, 1) };
    assert_eq!(least.check(), Ok(()));
    let check_error = |options: Options, name: &str| {
        let error = options.check().unwrap_err();
        assert!(error.to_string().starts_with(&format!("`label.{name}` is ")), "{error}");
        assert_eq!(label(&options, 7, &[]).unwrap_err().to_string(), error.to_string());
    };
    for value in [-0.1, f64::NAN, f64::INFINITY] {
        check_error(Options { positive_radius_m: value, ..good() }, "positive_radius_m");
        check_error(Options { positive_heading_deg: value, ..good() }, "positive_heading_deg");
        check_error(Options { negative_min_m: value, ..good() }, "negative_min_m");
        check_error(Options { min_travel_gap_m: value, ..good() }, "min_travel_gap_m");
    }
    check_error(Options { positive_heading_deg: 180.1, ..good() }, "positive_heading_deg");
    check_error(Options { negative_min_m: 1.4, ..good() }, "negative_min_m");
    check_error(Options { pairs_per_class: 0, ..good() }, "pairs_per_class");
}

fn fold_options(grouping: Grouping, n_folds: u32, seed: u64) -> FoldOptions {
    FoldOptions { grouping, n_folds, place_m: 2.0, place_margin_m: 0.0, seed }
}

/// The first `n_positive` positive and the first `n_negative` negative pairs of a draw.
fn some_pairs(keyframes: &[Keyframe], n_positive: usize, n_negative: usize) -> Vec<Pair> {
    let pairs = label(&options(1.5, 5.0, 50), 2436, keyframes).unwrap().pairs;
    let first = |class, n| pairs.iter().filter(move |p| p.label == class).take(n).copied();
    first(Label::Positive, n_positive).chain(first(Label::Negative, n_negative)).collect()
}

#[test]
fn each_class_is_spread_evenly_over_the_folds() {
    let keyframes = three_logs();
    for (n_folds, n_positive, n_negative) in [(2, 2, 3), (5, 23, 50), (7, 49, 8), (10, 50, 50)] {
        let pairs = some_pairs(&keyframes, n_positive, n_negative);
        let assigned =
            assign_folds(&fold_options(Grouping::Pair, n_folds, 7), &keyframes, &pairs).unwrap();
        assert!(assigned.folds.iter().all(|[a, b]| a == b), "a pair touches one fold");
        let assigned: Vec<u32> = assigned.folds.iter().map(|folds| folds[0]).collect();
        assert_eq!(assigned.len(), pairs.len(), "one fold for every pair");
        assert!(assigned.iter().all(|&fold| fold < n_folds));
        for (class, n) in [(Label::Positive, n_positive), (Label::Negative, n_negative)] {
            for fold in 0..n_folds {
                let here = |(p, f): &(&Pair, &u32)| p.label == class && **f == fold;
                let size = pairs.iter().zip(&assigned).filter(here).count();
                let even = n / n_folds as usize;
                assert!(size == even || size == even + 1, "{class:?}, fold {fold}: {size} of {n}");
            }
        }
    }
}

#[test]
fn folds_depend_on_the_seed_and_the_scans_but_not_on_the_order_of_pairs() {
    let keyframes = three_logs();
    let pairs = some_pairs(&keyframes, 50, 50);
    let assigned = |seed, keyframes: &[Keyframe], pairs: &[Pair]| {
        assign_folds(&fold_options(Grouping::Pair, 10, seed), keyframes, pairs).unwrap().folds
    };
    let expected = assigned(7, &keyframes, &pairs);
    assert_eq!(assigned(7, &keyframes, &pairs), expected);
    assert_ne!(assigned(8, &keyframes, &pairs), expected);

    // With the pairs reversed, each pair keeps its fold.
    let reversed: Vec<Pair> = pairs.iter().rev().copied().collect();
    assert!(assigned(7, &keyframes, &reversed).iter().eq(expected.iter().rev()));

    // With the keyframes reversed too, the query and the reference of every pair change places.
    let reversed_keyframes: Vec<Keyframe> = keyframes.iter().rev().cloned().collect();
    let last = keyframes.len() - 1;
    let exchange = |p: &Pair| Pair { query: last - p.reference, reference: last - p.query, ..*p };
    let exchanged: Vec<Pair> = pairs.iter().map(exchange).collect();
    assert_eq!(assigned(7, &reversed_keyframes, &exchanged), expected);
}

#[test]
fn too_few_folds_and_too_few_pairs_per_fold_are_errors() {
    let keyframes = three_logs();
    let error = |n_folds, n_positive, n_negative| {
        let pairs = some_pairs(&keyframes, n_positive, n_negative);
        assign_folds(&fold_options(Grouping::Pair, n_folds, 7), &keyframes, &pairs).unwrap_err()
    };
    for n_folds in [0, 1] {
        let error = error(n_folds, 20, 20).to_string();
        assert!(error.contains(&format!("folds` is {n_folds}, expected 2 or more")), "{error}");
    }
    let positive = LabelError::TooFewForFolds { folds: 5, class: "positive", found: 4 };
    assert_eq!(error(5, 4, 20), positive);
    let negative = LabelError::TooFewForFolds { folds: 5, class: "negative", found: 0 };
    assert_eq!(error(5, 5, 0), negative);
    let text = negative.to_string();
    assert!(text.contains("at least 5 pairs of each class, found 0 negative"), "{text}");
    assert!(text.contains("lower `evaluate.folds`"), "{text}");
}

/// For each grouping, all keyframes of a group (a scan, a block of ground, or a log) are in one
/// fold, and every pair touches the folds of its two keyframes.
#[test]
fn no_group_is_split_between_folds() {
    let keyframes = three_logs();
    let pairs = some_pairs(&keyframes, 50, 50);
    for (grouping, n_folds, n_groups) in
        [(Grouping::Scan, 10, 75), (Grouping::Place, 10, 21), (Grouping::Log, 3, 3)]
    {
        let assigned = assign_folds(&fold_options(grouping, 10, 7), &keyframes, &pairs).unwrap();
        assert_eq!(assigned.n_folds, n_folds, "there are three logs, so three folds");
        assert_eq!(assigned.keyframe_folds.len(), keyframes.len());
        let mut fold_of = BTreeMap::new();
        for (keyframe, &fold) in keyframes.iter().zip(&assigned.keyframe_folds) {
            let cell = |metres: f64| (metres / 2.0).floor().to_string();
            let name = match grouping {
                Grouping::Log => keyframe.id.log.to_string(),
                Grouping::Place => cell(keyframe.pose.x_m) + " " + &cell(keyframe.pose.y_m),
                _ => format!("{:?}", keyframe.id),
            };
            assert_eq!(*fold_of.entry(name).or_insert(fold), fold, "{grouping:?} in two folds");
        }
        // x from 0 to 6.5 m and from 20 to 24 m: cells 0 to 3 and 10 to 12. y from 0 to 4 m: cells
        // 0 to 2. Logs a and b cover 4 x 3 blocks, log c covers 3 x 3.
        assert_eq!(fold_of.len(), n_groups, "{grouping:?}");
        for fold in 0..n_folds {
            let n_keyframes = assigned.keyframe_folds.iter().filter(|&&f| f == fold).count();
            assert!(
                0 < n_keyframes && n_keyframes < 75 / 2,
                "{grouping:?}: {n_keyframes} keyframes in fold {fold}"
            );
        }
        for ((pair, folds), groups) in pairs.iter().zip(&assigned.folds).zip(&assigned.groups) {
            let of = |k: usize| assigned.keyframe_folds[k];
            assert_eq!(*folds, [of(pair.query), of(pair.reference)]);
            if folds[0] != folds[1] {
                assert_ne!(groups[0], groups[1], "a group is in one fold");
            }
        }
        assert_eq!(
            assign_folds(&fold_options(grouping, 10, 7), &keyframes, &pairs).unwrap(),
            assigned
        );
        if grouping != Grouping::Log {
            assert_ne!(
                assign_folds(&fold_options(grouping, 10, 8), &keyframes, &pairs).unwrap(),
                assigned
            );
        }
    }
}

#[test]
fn one_log_cannot_be_held_out() {
    let keyframes = line(&[0.0, 1.0, 60.0, 61.0]);
    let error = assign_folds(&fold_options(Grouping::Log, 10, 7), &keyframes, &[]).unwrap_err();
    let expected = LabelError::TooFewGroups { grouping: "log", groups: "logs", found: 1 };
    assert_eq!(error, expected);
    assert!(error.to_string().contains("leave `log` out of `evaluate.groupings`"), "{error}");
    let error = assign_folds(
        &FoldOptions { place_m: 0.0, ..fold_options(Grouping::Place, 2, 7) },
        &keyframes,
        &[],
    );
    assert!(error.unwrap_err().to_string().contains("`evaluate.place_m` is 0"));
}

/// Logs `a` and `b` are in one map, although their sites differ, and `c` of the site of `a` is in another one. The
/// pairs of `a` and `b` are labelled, with a distance; those with `c` are not.
#[test]
fn logs_of_one_map_share_a_frame_and_those_of_two_maps_do_not() {
    let in_map = |log: &str, site: &str, map, scan, x_m| Keyframe {
        site: site.into(),
        map: Some(map),
        frame: map,
        ..at(log, scan, x_m, 0.0)
    };
    let keyframes = [
        in_map("a", "north", 0, 0, 0.0),
        in_map("b", "south", 0, 0, 1.0),
        in_map("b", "south", 0, 1, 60.0),
        in_map("c", "north", 1, 0, 0.0),
        in_map("c", "north", 1, 1, 60.0),
    ];
    let Labelled { pairs, candidates, .. } = label(&options(1.5, 50.0, 1), 7, &keyframes).unwrap();
    // Positive: a0 b0. Negative: a0 b1, b0 b1, c0 c1.
    assert_eq!((candidates.positive, candidates.negative), (1, 3));
    assert_eq!((candidates.other_frame, candidates.without_common_frame), (2, 4));
    let positive = pairs.iter().find(|pair| pair.label == Label::Positive).unwrap();
    assert_eq!((positive.query, positive.reference, positive.distance_m), (1, 0, 1.0));
    assert_eq!(positive.heading_difference_rad, Some(0.0));
    // With `cross_site_negatives`, pairs of two maps are negative if their sites differ.
    let across = Options { cross_site_negatives: true, ..options(1.5, 50.0, 1) };
    let candidates = label(&across, 7, &keyframes).unwrap().candidates;
    assert_eq!((candidates.positive, candidates.negative), (1, 7));
}

/// Keyframes on a line, with a standard deviation of 0.2 m between neighbours. With a radius of 1.5 m, a distance of
/// 1.0 m is decided (1.0 + 2 * 0.2 < 1.5), and one of 1.2 m is not. Over two steps, the standard deviation
/// is 0.28 m: 5.4 m is not clearly beyond 5 m, and 5.7 m is.
#[test]
fn a_pair_that_the_poses_cannot_decide_has_no_label() {
    let keyframes: Vec<Keyframe> = line(&[0.0, 1.0, 5.4, 6.6, 11.1])
        .into_iter()
        .map(|keyframe| Keyframe { map: Some(0), ..keyframe })
        .collect();
    let measurements: Vec<Measurement> = (0..4)
        .map(|a| Measurement {
            a,
            b: a + 1,
            a_from_b: Pose2 {
                x_m: keyframes[a + 1].pose.x_m - keyframes[a].pose.x_m,
                ..Pose2::default()
            },
            covariance: [0.04, 0.0, 0.0, 0.0, 0.0, 0.0],
        })
        .collect();
    let graph = PoseGraph::new(&[Vertex::default(); 5], &measurements, (0..5).map(Some).collect());
    let Labelled { pairs, candidates, notes } =
        label_by_graph(&options(1.5, 5.0, 1), 7, &keyframes, &graph).unwrap();
    // 1.0 m; not 1.2 m.
    assert_eq!((candidates.positive, candidates.undecided_positive), (1, 1));
    // 5.6, 6.6, 10.1 and 11.1 m over 2 to 4 steps; 5.4 and 5.7 m over 2 steps; 4.4 and 4.5 m are ambiguous.
    let stds_m = |steps: f64| (0.04 * steps + 2.0 * ALIGNMENT_STD_M * ALIGNMENT_STD_M).sqrt();
    let is_decided = |metres: f64, steps: f64| 5.0 <= metres - 2.0 * stds_m(steps);
    assert!(!is_decided(5.4, 2.0) && is_decided(5.7, 2.0));
    let decided = [(5.4, 2.0), (6.6, 3.0), (11.1, 4.0), (5.6, 2.0), (10.1, 3.0), (5.7, 2.0)];
    let n_decided = decided.iter().filter(|&&(metres, steps)| is_decided(metres, steps)).count();
    assert_eq!(candidates.negative, n_decided as u64);
    assert_eq!(candidates.negative + candidates.undecided_negative, 6);
    assert!(0 < candidates.undecided_negative && 0 < n_decided);
    let positive = pairs.iter().find(|pair| pair.label == Label::Positive).unwrap();
    let std_m = positive.distance_std_m.unwrap();
    assert!((std_m - stds_m(1.0)).abs() < 1e-12, "{std_m}");
    assert!(notes.iter().any(|note| note.kind.code() == "undecided_pairs"), "{notes:?}");
}
