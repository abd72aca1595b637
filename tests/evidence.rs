//! The evaluation of a run: groupings, intervals, retrieval and other label rules.

use std::collections::{BTreeMap, BTreeSet};

use dataset::Keyframe;
use dataset::tables::{read_grid, read_pairs, read_retrieval, read_rounds, read_scores};

use crate::support::{self, Workplace};

const PIPELINE: &str = r#"
name = "drive"
seed = 7

[simulate]
logs = ["there", "back"]
length_m = 240.0
people = 3

[ingest]
site = "building"
pose.topic = "/ground_truth"

[label]
negative_min_m = 20.0
pairs_per_class = 150

[train]
learners = ["discrete", "gentle_stump", "knn", "svm"]
rounds = 10

[evaluate]
groupings = ["pair", "scan", "place"]
place_m = 8.0
resamples = 100

[evaluate.grid]
positive_radius_m = [1.0, 1.5]
negative_min_m = [20.0, 50.0]
min_travel_gap_m = [0.0, 500.0]
learners = ["discrete", "knn"]
"#;

/// Each scan, or block of ground, is in one fold. For the two folds of each pair, there is a fit
/// without them (the tests of `train` check that it did not use them).
#[test]
fn folds_do_not_split_scans_or_places_and_each_pair_is_scored_once() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    let out = |name: &str| workplace.path("out").join(name);
    let keyframes = support::keyframes(&out(""));
    let (pairs, _) = read_pairs(&out("pairs.parquet"), &keyframes).unwrap();
    let (scores, _) = read_scores(&out("scores.parquet"), &pairs).unwrap();
    let blocks: BTreeSet<_> = scores.iter().map(|s| (&*s.learner, &*s.grouping)).collect();
    assert_eq!((blocks.len(), scores.len()), (12, 12), "4 learners times 3 groupings, each once");
    let (rounds, _) = read_rounds(&out("rounds.parquet")).unwrap();
    let place = |k: &Keyframe| [k.pose.x_m, k.pose.y_m].map(|m| (m / 8.0).floor().to_string());
    for s in &scores {
        assert_eq!((s.folds.len(), s.confidences.len()), (300, 3000));
        assert!(s.confidences.iter().all(|c| c.is_finite()));
        let mut fold_of: BTreeMap<String, u32> = BTreeMap::new();
        for (pair, &[query, reference]) in pairs.iter().zip(&s.folds) {
            for (end, fold) in [(pair.query, query), (pair.reference, reference)] {
                let name = match &*s.grouping {
                    "pair" => format!("{} {}", pair.query, pair.reference),
                    "scan" => end.to_string(),
                    _ => place(&keyframes[end]).join(" "),
                };
                assert_eq!(*fold_of.entry(name).or_insert(fold), fold, "{}", s.grouping);
            }
        }
    }

    for s in scores.iter().filter(|s| s.learner == "discrete") {
        let touched: BTreeSet<[u32; 2]> =
            s.folds.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
        let fits = rounds.iter().filter(|r| r.learner == s.learner).filter_map(|r| {
            r.held_out.as_ref().filter(|l| l.grouping == s.grouping).map(|l| l.folds)
        });
        assert_eq!(fits.collect::<BTreeSet<_>>(), touched, "{}", s.grouping);
    }

    let report = String::from_utf8(workplace.files("out")["report.html"].clone()).unwrap();
    for part in
        ["by scan", "tested on ground not seen in training", "Retrieval at natural prevalence"]
    {
        assert!(report.contains(part), "{part}");
    }
}

/// The expected counts are computed from the keyframes alone.
#[test]
fn retrieval_counts_all_pairs_of_a_log_by_the_label_rules() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &["--set", "evaluate.min_separation_m=12.5"]).expect(0);
    let out = |name: &str| workplace.path("out").join(name);
    let keyframes = support::keyframes(&out(""));
    let (rows, _) = read_retrieval(&out("retrieval.parquet")).unwrap();
    // 3 learners (k-NN is too slow), 2 logs and both together, ambiguous pairs excluded or not.
    assert_eq!(rows.len(), 3 * 3 * 2);
    let mut of_all = [0; 3];
    for log in ["there", "back"] {
        let of_log: Vec<&Keyframe> = keyframes.iter().filter(|k| &*k.id.log == log).collect();
        let mut counts = [0; 3];
        for (k, a) in of_log.iter().enumerate() {
            for b in of_log[..k].iter().filter(|b| 12.5 <= a.travel_m - b.travel_m) {
                let distance_m = a.pose.distance_m(&b.pose);
                counts[if distance_m <= 1.5 {
                    0
                } else if distance_m <= 20.0 {
                    1
                } else {
                    2
                }] += 1;
            }
        }
        for row in rows.iter().filter(|r| r.log.as_deref() == Some(log)) {
            let found = [row.n_positive, row.n_ambiguous, row.n_negative];
            let [positive, ambiguous, negative] = counts;
            match row.ambiguous_as_negative {
                false => assert_eq!(found, counts),
                true => assert_eq!(found, [positive, 0, negative + ambiguous]),
            }
            assert_eq!((row.n_unscored, row.query_stride), (0, 1));
        }
        of_all = [0, 1, 2].map(|k| of_all[k] + counts[k]);
    }
    assert!(of_all.iter().all(|&n| n > 100), "{of_all:?}");
    for row in rows.iter().filter(|r| r.log.is_none() && !r.ambiguous_as_negative) {
        assert_eq!([row.n_positive, row.n_ambiguous, row.n_negative], of_all);
        assert_eq!(row.curve.last().map(|p| p.true_positive), Some(row.n_positive));
        // The average precision computed from the curve, which is complete for so few positives.
        let mut average_precision = 0.0;
        let mut before = 0;
        for point in &row.curve {
            let precision =
                point.true_positive as f64 / (point.true_positive + point.false_positive) as f64;
            average_precision +=
                (point.true_positive - before) as f64 / row.n_positive as f64 * precision;
            before = point.true_positive;
        }
        assert!(row.n_positive <= 2000, "{}", row.n_positive);
        assert!((average_precision - row.average_precision.unwrap()).abs() < 1e-12);
        let base = row.n_positive as f64 / (row.n_positive + row.n_negative) as f64;
        assert!(average_precision > 2.0 * base, "{average_precision} at {base}");
    }

    // With `max_pairs` there are fewer queries, which leave few matches; without retrieval there are
    // no rows.
    workplace
        .command("run", "out", &["--set", "evaluate.max_pairs=10000"])
        .expect(3)
        .says(&["warning[few_matches_scored]: retrieval has only"]);
    let (thinned, _) = read_retrieval(&out("retrieval.parquet")).unwrap();
    assert!(thinned[0].query_stride > 1 && thinned[0].n_positive < rows[0].n_positive);
    workplace.command("run", "out", &["--set", "evaluate.retrieval=false"]).expect(0);
    assert!(read_retrieval(&out("retrieval.parquet")).unwrap().0.is_empty());
}

/// The cell with the rules of the pipeline has the error of the pipeline. A cell with a travel gap
/// longer than the drive reports the missing pairs.
#[test]
fn the_grid_samples_pairs_by_other_rules() {
    let workplace = Workplace::new(PIPELINE);
    let finished = workplace.command("run", "out", &[]).expect(0);
    let out = |name: &str| workplace.path("out").join(name);
    let (cells, _) = read_grid(&out("grid.parquet")).unwrap();
    assert_eq!(cells.len(), 2 * 2 * 2 * 2);
    let own = cells
        .iter()
        .find(|c| c.learner == "discrete" && c.positive_radius_m > 1.2 && c.negative_min_m < 40.0);
    let own = own.unwrap().error.clone().unwrap();
    let line = format!("discrete by place: error {:.1} % after round 10", own * 100.0);
    assert!(finished.stdout.contains(&line), "{line}\n{}", finished.stdout);
    assert!(
        !finished.stdout.contains("after round 10, "),
        "the round is printed once:\n{}",
        finished.stdout
    );
    // Only pairs of two logs are revisits: there is no path between their scans.
    for cell in cells.iter().filter(|c| c.min_travel_gap_m > 0.0) {
        match &cell.error {
            Ok(error) => assert!((0.0..=1.0).contains(error)),
            Err(reason) => assert!(reason.contains("of 150 positive pairs"), "{reason}"),
        }
    }
    let more = ["--set", "label.pairs_per_class=2000", "--set", "evaluate.groupings=[\"pair\"]"];
    workplace.command("run", "out", &more).expect(0);
    let (cells, _) = read_grid(&out("grid.parquet")).unwrap();
    let reasons = cells.iter().filter_map(|c| c.error.as_ref().err());
    assert!(reasons.clone().any(|r| r.contains("of 2000 positive pairs")), "{cells:?}");
}

#[test]
fn the_evaluation_does_not_depend_on_the_number_of_threads() {
    let workplace = Workplace::new(PIPELINE);
    for (out, threads) in [("one", 1), ("eight", 8)] {
        workplace.command_with_threads("run", out, &[], threads).expect(0);
    }
    let (one, eight) = (workplace.files("one"), workplace.files("eight"));
    assert_eq!(one.keys().collect::<Vec<_>>(), eight.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(eight[name] == *bytes, "{name} differs");
    }
}

#[test]
fn json_output_contains_only_the_numbers() {
    let workplace = Workplace::new(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    let printed = workplace.command("evaluate", "out", &["--json"]).expect(0).stdout;
    let parsed: serde_json::Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(printed.as_bytes(), workplace.files("out")["evaluation/summary.json"]);
    assert_eq!(parsed["pairs"], serde_json::json!({ "positive": 150, "negative": 150 }));
    let summary = parsed["summary"].as_array().unwrap();
    assert_eq!(summary.len(), 12);
    for row in summary {
        let error = row["error"]["value"].as_f64().unwrap();
        let bound = |end: usize| row["error"]["interval"][end].as_f64().unwrap();
        assert!(bound(0) <= error && error <= bound(1), "{row}");
        assert!(bound(0) < bound(1), "{row}");
        let at_0 = row["recall_at_full_precision"]["value"].as_f64().unwrap();
        assert!(at_0 <= row["detection_at_1_percent"]["value"].as_f64().unwrap());
    }
}

#[test]
fn a_grouping_that_cannot_be_held_out_gives_an_error_with_the_remedy() {
    let workplace = Workplace::new(PIPELINE);
    let by_log = ["--set", "evaluate.groupings=[\"log\"]"];
    let one = ["--set", "simulate.logs=[\"there\"]"];
    workplace
        .command("run", "out", &[one, by_log].concat())
        .expect(2)
        .says(&["`evaluate.groupings` contains `log`", "add logs, or remove `log`"]);
    assert!(!workplace.path("out/logs").exists(), "the error comes before any stage runs");
    // With two logs, no training pairs remain if both are held out.
    let why = "grouping `log` cannot be evaluated with 2 logs";
    let none = workplace.command("run", "out", &by_log).expect(1);
    none.says(&["no grouping can be evaluated", why, "leave `log` out of `evaluate.groupings`"]);
    // With another grouping that can be evaluated, it is left out and reported, or it is an error.
    let both = ["--set", "evaluate.groupings=[\"pair\", \"log\"]"];
    let reported = "both must be held out, which leaves no pairs to train on";
    workplace
        .command("run", "out", &both)
        .expect(3)
        .says(&["grouping `log` not evaluated", reported]);
    let report = String::from_utf8(workplace.files("out")["report.html"].clone()).unwrap();
    assert!(report.contains(reported));
    let required = [both, ["--set", "evaluate.require_groupings=true"]].concat();
    workplace.command("run", "out", &required).expect(1).says(&[why]);
    workplace
        .command("run", "out", &["--set", "evaluate.place_m=0"])
        .expect(2)
        .says(&["`evaluate.place_m` is 0"]);
    workplace
        .command("run", "out", &["--set", "evaluate.grid.negative_min_m=[1.0]"])
        .expect(2)
        .says(&["`evaluate.grid.negative_min_m` is 1"]);
}
