//! Pairs on several floors, in several frames, at one place and in copies of a log.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::f64::consts::PI;

use common::{at, line};
use dataset::{Keyframe, Label, Pair};
use label::{FoldOptions, Grouping, LabelError, Options, assign_folds, label};

/// Without a limit on the share of a place.
fn options(positive_radius_m: f64, negative_min_m: f64, pairs_per_class: usize) -> Options {
    let max_place_share = 1.0;
    let default = Options::default();
    Options { positive_radius_m, negative_min_m, pairs_per_class, max_place_share, ..default }
}

#[test]
fn pairs_on_two_floors_are_neither_positive_nor_negative() {
    // Two scans on each of two floors 4 m apart, and one far away on each floor.
    let on = |scan, x_m, z_m| Keyframe { z_m: Some(z_m), ..at("a", scan, x_m, 0.0) };
    let keyframes = [
        on(0, 0.0, 0.0),
        on(1, 1.0, 0.1),
        on(2, 0.0, 4.0),
        on(3, 1.0, 4.1),
        on(4, 60.0, 0.0),
        on(5, 60.0, 4.0),
    ];
    let options = options(1.5, 50.0, 2);
    let found = label(&options, 7, &keyframes).unwrap();
    // 0-1 and 2-3. Of the pairs between floors, 0-2, 0-3, 1-2, 1-3 and 4-5 are close in the plane.
    assert_eq!((found.candidates.positive, found.candidates.other_height), (2, 5));
    assert_eq!(found.candidates.negative, 8, "the plane decides: 4 x 2");
    let positive: Vec<_> = found
        .pairs
        .iter()
        .filter(|p| p.label == Label::Positive)
        .map(|p| (p.query, p.reference))
        .collect();
    assert_eq!(positive, [(1, 0), (3, 2)]);
    // The limit is inclusive.
    for (limit_m, other_height) in [(4.1, 0), (4.1f64.next_down(), 1), (3.9f64.next_down(), 5)] {
        let limited = Options { max_height_difference_m: limit_m, ..options.clone() };
        let found = label(&limited, 7, &keyframes).unwrap();
        assert_eq!(found.candidates.other_height, other_height, "{limit_m} m");
    }
    // Without a height, the plane decides.
    let mut flat = keyframes.to_vec();
    flat.iter_mut().take(2).for_each(|k| k.z_m = None);
    assert_eq!(label(&options, 7, &flat).unwrap().candidates.other_height, 1, "only 4-5");
}

/// Codes of the notes about a drive of several laps around a ring of 100 scans 1 m apart. `z_m` is
/// the height at a lap and a scan.
fn notes_of_laps(n_laps: u32, z_m: impl Fn(u32, u32) -> f64) -> Vec<&'static str> {
    let laps = (0..n_laps).flat_map(|lap| (0..100).map(move |scan| (lap, scan)));
    let keyframes: Vec<Keyframe> = laps
        .map(|(lap, scan)| {
            let angle = 2.0 * PI * f64::from(scan) / 100.0;
            let radius_m = 100.0 / (2.0 * PI);
            let number = 100 * lap + scan;
            Keyframe {
                z_m: Some(z_m(lap, scan)),
                travel_m: f64::from(number),
                ..at("a", number, radius_m * angle.cos(), radius_m * angle.sin())
            }
        })
        .collect();
    let found = label(&options(1.5, 30.0, 50), 7, &keyframes).unwrap();
    found.notes.iter().map(dataset::Note::code).collect()
}

#[test]
fn heights_that_drift_are_told_apart_from_floors() {
    // A hill of 10 m that is driven three times, with up to 0.5 m of drift per lap: nothing is left
    // out, and there is nothing to report.
    let hill = |scan: u32| 5.0 * (2.0 * PI * f64::from(scan) / 100.0).sin();
    assert_eq!(notes_of_laps(3, |lap, scan| hill(scan) + 0.5 * f64::from(lap)), [""; 0]);
    // Two laps on each of two floors 4 m apart.
    let floors = notes_of_laps(4, |lap, _| 4.0 * f64::from(lap / 2));
    assert_eq!(floors, ["pairs_at_other_height"]);
    // A drift of 3 m per lap leaves out all revisits.
    assert_eq!(notes_of_laps(2, |lap, _| 3.0 * f64::from(lap)), ["heights_in_doubt"]);
    // With 1 m per lap, laps up to two apart are revisits: there is no gap at 2.5 m.
    assert_eq!(notes_of_laps(6, |lap, _| f64::from(lap)), ["heights_in_doubt"]);
}

#[test]
fn frames_of_a_log_are_compared_with_themselves_only() {
    let in_frame =
        |log, scan, x_m, frame| Keyframe { site: "s".into(), frame, ..at(log, scan, x_m, 0.0) };
    // Log `a` has two frames, and pairs at 0 m and 60 m in each. Log `b` has one.
    let keyframes = [
        in_frame("a", 0, 0.0, 0),
        in_frame("a", 1, 1.0, 0),
        in_frame("a", 2, 60.0, 0),
        in_frame("a", 3, 0.0, 1),
        in_frame("a", 4, 1.0, 1),
        in_frame("b", 10, 0.0, 0),
        in_frame("b", 11, 60.0, 0),
    ];
    let options = Options { cross_site_negatives: true, ..options(1.5, 50.0, 2) };
    let found = label(&options, 7, &keyframes).unwrap();
    let of = found.candidates;
    assert_eq!((of.positive, of.negative, of.ambiguous), (2, 3, 0), "0-1 and 3-4; 0-2, 1-2 and b");
    // 3 x 2 within `a`, 5 x 2 between the logs.
    assert_eq!(of.other_frame, 16);
    let codes: Vec<_> = found.notes.iter().map(dataset::Note::code).collect();
    assert_eq!(codes, ["pairs_between_frames"]);
}

/// A line of 300 scans 0.5 m apart, then 100 scans to and fro between 0 m and 1 m.
fn shuttle() -> Vec<Keyframe> {
    let line = (0..300).map(|k| at("a", k, 0.5 * f64::from(k), 0.0));
    let spot = (0..100).map(|k| at("a", 300 + k, f64::from(k % 3) / 2.0, 0.0));
    line.chain(spot).collect()
}

#[test]
fn one_place_gets_at_most_its_share_of_the_pairs() {
    let keyframes = shuttle();
    let n_at_spot = |pairs: &[Pair], class| {
        let at_spot = |k: usize| keyframes[k].pose.x_m < 5.0;
        let of_class = pairs.iter().filter(|p| p.label == class);
        of_class.filter(|p| at_spot(p.query) || at_spot(p.reference)).count()
    };
    let limited = |max_place_share| Options { max_place_share, ..options(1.5, 50.0, 100) };
    let without = label(&limited(1.0), 7, &keyframes).unwrap();
    assert_eq!(without.notes, []);
    // The 100 scans of the spot give 100 x 99 / 2 = 4950 positive pairs, and about 500 with the
    // line. The line itself gives 3 per scan, about 900.
    assert!(70 < n_at_spot(&without.pairs, Label::Positive));
    let with = label(&limited(0.1), 7, &keyframes).unwrap();
    assert_eq!(n_at_spot(&with.pairs, Label::Positive), 10);
    assert_eq!(n_at_spot(&with.pairs, Label::Negative), 10);
    assert_eq!(with.candidates, without.candidates);
    let codes: Vec<_> = with.notes.iter().map(dataset::Note::code).collect();
    assert_eq!(codes, ["place_share_limited"; 2]);
    let text = with.notes[0].to_string();
    assert!(text.contains("at most 10 of 100 positive pairs"), "{text}");
    assert!(text.contains("the place at (2.5, 2.5) m of site `a`"), "{text}");
    assert_eq!(with.pairs.len(), 200);

    // The same on any number of threads.
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| label(&limited(0.1), 7, &keyframes).unwrap())
    };
    assert!(on(1) == with && on(8) == with);
    assert!(label(&limited(0.1), 8, &keyframes).unwrap().pairs != with.pairs, "another seed");
}

#[test]
fn a_limit_that_leaves_too_few_pairs_is_raised_with_a_warning() {
    // With 100 scans of path in between, only the scans of the spot revisit the line, and one scan at
    // the far end.
    let mut keyframes = shuttle();
    keyframes.push(at("a", 5000, 149.5, 0.0));
    let options = Options {
        min_travel_gap_m: 100.0 * 100.0,
        max_place_share: 0.1,
        ..options(1.5, 50.0, 100)
    };
    let found = label(&options, 7, &keyframes).unwrap();
    assert_eq!(found.pairs.iter().filter(|p| p.label == Label::Positive).count(), 100);
    let note = &found.notes[0];
    assert_eq!((note.code(), note.severity()), ("few_places", dataset::Severity::Warning));
    let text = note.to_string();
    // Four pairs are at the far end: 148, 148.5, 149 and 149.5 m with 149.5 m.
    assert!(text.starts_with("96 of 100 positive pairs are from one place 5 m wide"), "{text}");
    assert!(text.contains("expected at most 10"), "{text}");
}

#[test]
fn a_copy_of_a_log_with_other_bytes_is_reported() {
    // Log `a` and log `b` have scans 1 m apart at the same stamps, at other places.
    let of = |log: &'static str, y_m| {
        (0..25).map(move |k| Keyframe { site: "s".into(), ..at(log, k, f64::from(k), y_m) })
    };
    let mut keyframes: Vec<Keyframe> = of("a", 0.0).chain(of("b", 1.0)).collect();
    // Log `d` is the first half of log `b`, and one scan of its own.
    let copied: Vec<Keyframe> = keyframes[25..37].to_vec();
    keyframes.extend(copied.into_iter().map(|mut k| {
        k.id.log = "d".into();
        k
    }));
    keyframes.push(Keyframe { site: "s".into(), ..at("d", 20, 7.0, 7.0) });
    let found = label(&options(1.5, 5.0, 50), 7, &keyframes).unwrap();
    let texts: Vec<String> = found.notes.iter().map(ToString::to_string).collect();
    assert_eq!(texts.len(), 1, "{texts:?}");
    let start =
        "12 keyframes have the same stamps and poses as in log `b` (92 % of the shorter log)";
    assert!(texts[0].starts_with(start) && texts[0].ends_with("(log `d`)"), "{}", texts[0]);
}

#[test]
fn the_error_for_too_few_pairs_checks_both_classes_at_once() {
    // Positive: 1 m twice. Negative: 52.5 m and 51.5 m.
    let keyframes = line(&[0.0, 1.0, 2.0, 52.5]);
    let error = label(&options(1.0, 51.0, 10), 7, &keyframes).unwrap_err();
    let LabelError::TooFew { n_positive, n_negative, .. } = &error else { panic!("{error}") };
    assert_eq!((*n_positive, *n_negative), (2, 2));
    let text = error.to_string();
    for part in [
        "found 2 positive and 2 negative pairs",
        "for more positive pairs, raise `label.positive_radius_m`",
        "for more negative pairs, lower `label.negative_min_m`",
        "`label.pairs_per_class = 2` works for both classes",
    ] {
        assert!(text.contains(part), "{text}");
    }
    let works = Options { pairs_per_class: 2, ..options(1.0, 51.0, 10) };
    assert!(label(&works, 7, &keyframes).is_ok());
}

fn folds(options: &FoldOptions, keyframes: &[Keyframe], ends: &[(usize, usize)]) -> label::Folds {
    assign_folds(options, keyframes, &pairs(ends)).unwrap()
}

fn pairs(ends: &[(usize, usize)]) -> Vec<Pair> {
    let pair = |&(query, reference): &(usize, usize)| Pair {
        query,
        reference,
        label: Label::Positive,
        distance_m: 1.0,
        distance_std_m: None,
        heading_difference_rad: None,
        travel_gap_m: 100.0,
    };
    ends.iter().map(pair).collect()
}

/// Blocks 20 m wide and a margin of 3 m. Scans at 1, 10, 17.1 and 19 m are in the first block, 24 m
/// is in the second, 41 m in the third. From the second block, 17.1 m is 2.9 m away, and 24 m is
/// 4 m from the first one.
#[test]
fn scans_within_the_margin_of_a_block_are_near_its_fold() {
    let keyframes = line(&[1.0, 10.0, 17.1, 19.0, 24.0, 41.0]);
    let options = |place_margin_m| FoldOptions {
        grouping: Grouping::Place,
        n_folds: 10,
        place_m: 20.0,
        place_margin_m,
        seed: 7,
    };
    let ends = [(1, 0), (2, 1), (3, 2), (4, 3), (5, 4), (5, 0)];
    let found = folds(&options(3.0), &keyframes, &ends);
    assert_eq!(found.n_folds, 3);
    let [first, second, third] = [0, 4, 5].map(|k| found.keyframe_folds[k]);
    let expected: [&[u32]; 6] = [&[], &[second], &[second], &[], &[], &[second]];
    // 41 m is 1 m from the second block. The pairs (4, 3) and (5, 4) touch it themselves.
    assert_eq!(found.near_folds, expected);
    let found = folds(&options(4.5), &keyframes, &ends);
    // 24 m is also near the first block; 41 m too far from the first.
    assert_eq!(found.near_folds[4], [first]);
    assert!(!found.near_folds[3].contains(&first) && !found.near_folds[0].contains(&third));
    assert!(folds(&options(0.0), &keyframes, &ends).near_folds.iter().all(Vec::is_empty));
    // Another site has other ground.
    let mut apart = keyframes.clone();
    apart[4].site = "elsewhere".into();
    apart[4].id.log = "b".into();
    let found = folds(&options(3.0), &apart, &[(2, 1), (3, 2)]);
    assert_eq!(found.near_folds, [[0; 0], [0; 0]]);
}

/// Two logs of one site, with a pair within each and one between them. With a third log, or without
/// the pair between them, the grouping works.
#[test]
fn two_logs_with_pairs_between_them_cannot_be_held_out() {
    let mut keyframes: Vec<Keyframe> =
        [("a", 0), ("a", 1), ("b", 0), ("b", 1)].map(|(log, k)| at(log, k, 0.0, 0.0)).into();
    let options = FoldOptions {
        grouping: Grouping::Log,
        n_folds: 10,
        place_m: 20.0,
        place_margin_m: 3.0,
        seed: 7,
    };
    let ends = [(1, 0), (3, 2), (2, 1)];
    let error = assign_folds(&options, &keyframes, &pairs(&ends)).unwrap_err();
    let expected = LabelError::TwoGroups { grouping: "log", groups: "logs", n_between: 1 };
    assert_eq!(error, expected);
    let text = error.to_string();
    assert!(
        text.contains("to test the pairs between the two (1), both must be held out"),
        "{text}"
    );
    assert!(text.contains("add a third"), "{text}");
    assert_eq!(folds(&options, &keyframes, &ends[..2]).n_folds, 2);
    keyframes.push(at("c", 0, 0.0, 0.0));
    assert_eq!(folds(&options, &keyframes, &ends).n_folds, 3);
}
