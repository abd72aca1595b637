//! Experiments on two drives along one straight road, with features made in code.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use dataset::tables::FeatureTable;
use dataset::{Keyframe, Label, Pair, Pose2, RangeLimits, ScanId, SplitMix64};
use experiment::{
    CrossValidation, Data, ExperimentError, GridOptions, ModelContext, Options, Setup,
};
use label::{Grouping, LabelError};
use model::{FeatureSpec, Training};
use train::{Learner, Matrix};

/// Length of the road in keyframes, which are 1 m apart.
const N_KEYFRAMES: usize = 80;

/// Two drives in the same direction, the options, and everything that is computed from both.
struct Road {
    keyframes: Vec<Keyframe>,
    features: FeatureTable,
    pairs: Vec<Pair>,
    differences: Matrix,
    options: Options,
    train: train::Options,
    label: label::Options,
}

impl Road {
    fn new() -> Self {
        let label = label::Options {
            negative_min_m: 10.0,
            pairs_per_class: 60,
            ..label::Options::default()
        };
        let train = train::Options {
            learners: vec![Learner::Discrete, Learner::Knn],
            rounds: 5,
            ..train::Options::default()
        };
        let options = Options {
            folds: 4,
            groupings: vec![Grouping::Pair, Grouping::Place],
            place_m: 5.0,
            place_margin_m: 0.0,
            min_separation_m: 0.0,
            ..Options::default()
        };
        let keyframes: Vec<Keyframe> =
            ["a", "b"].iter().flat_map(|log| (0..N_KEYFRAMES).map(|k| keyframe(log, k))).collect();
        // The first feature is the position on the road with noise, the second is noise only.
        let mut random = SplitMix64::new(7);
        let values = keyframes
            .iter()
            .flat_map(|k| [k.pose.x_m + 4.0 * random.unit(), random.unit()])
            .collect();
        let features = FeatureTable {
            names: ["position", "noise"].map(str::to_owned).into(),
            ids: keyframes.iter().map(|k| k.id.clone()).collect(),
            values,
        };
        let pairs = label::label(&label, 7, &keyframes).unwrap().pairs;
        let differences = experiment::differences(&pairs, &features);
        Self { keyframes, features, pairs, differences, options, train, label }
    }

    fn setup(&self) -> Setup<'_> {
        Setup { options: &self.options, train: &self.train, label: &self.label, seed: 7 }
    }

    fn data(&self) -> Data<'_> {
        Data {
            keyframes: &self.keyframes,
            features: &self.features,
            pairs: &self.pairs,
            differences: &self.differences,
        }
    }

    fn cross_validate(&self) -> Result<CrossValidation, ExperimentError> {
        experiment::cross_validate(&self.setup(), &self.data())
    }
}

fn keyframe(log: &str, k: usize) -> Keyframe {
    Keyframe {
        id: ScanId { log: log.into(), scan: k as u32 },
        site: "road".into(),
        stamp_ns: k as i64 * 1_000_000_000,
        pose: Pose2 { x_m: k as f64, y_m: 0.0, heading_rad: 0.0 },
        covariance: None,
        z_m: None,
        segment: 0,
        frame: 0,
        map: None,
        travel_m: k as f64,
        coverage_deg: 360.0,
    }
}

#[test]
fn the_differences_are_those_of_the_pairs() {
    let road = Road::new();
    for (row, pair) in road.pairs.iter().enumerate() {
        for feature in 0..2 {
            let [a, b] = [pair.query, pair.reference].map(|k| road.features.row(k)[feature]);
            assert_eq!(road.differences.column(feature)[row], (a - b).abs());
        }
        assert_eq!(road.differences.labels()[row], pair.label);
    }
}

#[test]
fn every_learner_has_scores_for_every_grouping_and_pair() {
    let road = Road::new();
    let validation = road.cross_validate().unwrap();
    let scores = validation.scores();
    let names: Vec<_> = scores.iter().map(|s| (&*s.learner, &*s.grouping)).collect();
    let expected = [("discrete", "pair"), ("discrete", "place"), ("knn", "pair"), ("knn", "place")];
    assert_eq!(names, expected);
    for scores in &scores {
        assert_eq!((scores.n_rounds, scores.confidences.len()), (5, 5 * 120));
        let wrong = scores.after(5).zip(&road.pairs);
        let wrong = wrong.filter(|(c, p)| Label::from_confidence(*c, 0.0) != p.label).count();
        assert!(wrong < 12, "{wrong} of 120 pairs are wrong by {}", scores.learner);
    }
}

/// A pair between the two logs needs a classifier that was trained on neither, so no pairs are left.
#[test]
fn a_grouping_without_training_pairs_is_left_out_or_an_error() {
    let mut road = Road::new();
    road.options.groupings = vec![Grouping::Pair, Grouping::Log];
    let validation = road.cross_validate().unwrap();
    assert_eq!(validation.groupings.len(), 1);
    let reason = "grouping `log` cannot be evaluated with 2 logs: ";
    let not_evaluated = &validation.not_evaluated[0];
    assert_eq!(not_evaluated.grouping, Grouping::Log);
    assert!(not_evaluated.to_string().starts_with(reason), "{not_evaluated}");

    road.options.require_groupings = true;
    let error = road.cross_validate().unwrap_err();
    let is_expected = matches!(error, ExperimentError::Label(LabelError::TwoGroups { .. }));
    assert!(is_expected, "{error}");

    road.options.require_groupings = false;
    road.options.groupings = vec![Grouping::Log];
    let error = road.cross_validate().unwrap_err().to_string();
    assert!(error.starts_with(&format!("no grouping can be evaluated; {reason}")), "{error}");
}

/// Of 80 keyframes 1 m apart, 79 pairs are 1 m apart (positive) and 69 + 68 + ... + 1 pairs are 11 m
/// or more apart (negative). The others are ambiguous.
#[test]
fn retrieval_counts_all_pairs_of_each_log() {
    let mut road = Road::new();
    let validation = road.cross_validate().unwrap();
    let rows = experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap();
    // k-NN is not scored. There are two readings of ambiguous pairs for `a`, `b` and both together.
    let logs: Vec<_> = rows.iter().map(|row| row.log.as_deref()).collect();
    assert_eq!(logs, [Some("a"), Some("a"), Some("b"), Some("b"), None, None]);
    let n_negative = (69 * 70 / 2) as u64;
    let n_ambiguous = (80 * 79 / 2) as u64 - 79 - n_negative;
    for row in &rows {
        let n_logs = if row.log.is_some() { 1 } else { 2 };
        let expected = match row.ambiguous_as_negative {
            false => [79, n_negative, n_ambiguous],
            true => [79, n_negative + n_ambiguous, 0],
        };
        let found = [row.n_positive, row.n_negative, row.n_ambiguous];
        assert_eq!(found, expected.map(|n| n * n_logs), "{:?}", row.log);
        assert_eq!((&*row.learner, &*row.grouping, row.n_unscored), ("discrete", "place", 0));
    }

    // A minimum separation leaves out pairs with less path in between: no positives are left.
    road.options.min_separation_m = 11.0;
    let far = experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap();
    assert_eq!((far[0].n_positive, far[0].n_negative), (0, n_negative));
    assert_eq!(far[0].average_precision, None);

    // At most 100 of the 2 * 3160 pairs: every 64th keyframe is a query, keyframes 0 and 64.
    road.options.min_separation_m = 0.0;
    road.options.max_pairs = 100;
    let thinned = experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap();
    let n = thinned[0].n_positive + thinned[0].n_negative + thinned[0].n_ambiguous;
    assert_eq!((thinned[0].query_stride, n), (64, 64));

    road.options.retrieval = false;
    assert!(experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap().is_empty());
}

#[test]
fn retrieval_needs_a_grouping_that_holds_out_scans() {
    let mut road = Road::new();
    road.options.groupings = vec![Grouping::Pair];
    let validation = road.cross_validate().unwrap();
    assert!(experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap().is_empty());
}

/// The cell with the label rules of the run has the error of the cross-validation. A cell with too
/// few pairs has the reason.
#[test]
fn the_grid_gives_an_error_or_a_reason_for_every_cell() {
    let mut road = Road::new();
    road.options.grid = GridOptions {
        positive_radius_m: vec![1.5],
        negative_min_m: vec![10.0, 79.5],
        learners: vec![Learner::Discrete],
        ..GridOptions::default()
    };
    let cells = experiment::label_grid(&road.setup(), &road.keyframes, &road.features).unwrap();
    let validation = road.cross_validate().unwrap();
    let scores = &validation.groupings[1].learners[0].scores;
    let labels = road.differences.labels();
    let error = evaluate::Confusion::count(labels, scores.after(5), 0.0).error();
    assert_eq!(cells[0].error, Ok(error));
    assert_eq!(cells[1].error, Err("0 of 60 negative pairs".to_owned()));
}

#[test]
fn usefulness_counts_the_splits_of_the_fits_on_all_pairs() {
    let road = Road::new();
    let fitted = experiment::fit(&road.train, &road.differences).unwrap();
    let validation = road.cross_validate().unwrap();
    let rounds = experiment::boosting_rounds(&fitted, &validation, &road.features.names);
    assert!(rounds.iter().any(|round| round.held_out.is_some()));
    let useful = experiment::feature_usefulness(&road.data(), &[0.1, 0.9], &rounds);
    let [position, noise] = &useful[..] else { panic!("expected two features") };
    assert_eq!((&*position.name, position.stability), ("position", 0.1));
    assert_eq!((&*noise.name, noise.stability), ("noise", 0.9));
    assert!(position.auc > 0.99 && (0.3..0.7).contains(&noise.auc), "{useful:?}");
    assert_eq!(position.chosen + noise.chosen, fitted[0].rounds.len() as u64);
}

#[test]
fn baselines_have_no_model() {
    let road = Road::new();
    let fitted = experiment::fit(&road.train, &road.differences).unwrap();
    let validation = road.cross_validate().unwrap();
    let limits = [RangeLimits { min_m: 0.9, max_m: 70.0 }, RangeLimits { min_m: 0.5, max_m: 30.0 }];
    let context = ModelContext {
        name: "road".to_owned(),
        program_version: "0.1.0".to_owned(),
        seed: 7,
        scans: experiment::scan_spec(&road.keyframes, &limits),
        training: Training {
            n_positive: 60,
            n_negative: 60,
            digests: [].into(),
            warnings: [].into(),
        },
        label_options: serde_json::Value::Null,
        features: FeatureSpec {
            set: "made".to_owned(),
            version: 1,
            gate_m: 2.5,
            names: road.features.names.clone(),
        },
    };
    assert_eq!((context.scans.range_min_m, context.scans.range_max_m), (0.5, 70.0));
    assert!(context.scans.is_ring);
    let models = experiment::models(&context, &fitted, &validation, road.differences.labels());
    let [model] = &models[..] else { panic!("expected one model") };
    assert_eq!(model.name, "road-discrete");
    let measured: Vec<_> = model.measured.iter().map(|m| (&*m.grouping, m.rounds)).collect();
    assert_eq!(measured, [("pair", 5), ("place", 5)]);
    assert_eq!(model.classifier.rounds.len(), fitted[0].rounds.len());
}

/// With a margin, no classifier is trained on scans next to the squares that it is tested on. Every
/// square of this road is 5 m wide, so a margin of 1 m leaves out scans at each end of the training
/// squares.
#[test]
fn a_margin_around_test_ground_leaves_out_training_pairs() {
    let mut road = Road::new();
    road.options.groupings = vec![Grouping::Place];
    let n_training = |road: &Road| -> Vec<u32> {
        road.cross_validate().unwrap().groupings[0].learners[0].scores.n_training.clone()
    };
    let without = n_training(&road);
    road.options.place_margin_m = 1.0;
    let with = n_training(&road);
    assert!(with.iter().zip(&without).all(|(with, without)| with <= without));
    let mean = |n: &[u32]| f64::from(n.iter().sum::<u32>()) / n.len() as f64;
    assert!(mean(&with) < 0.9 * mean(&without), "{} of {}", mean(&with), mean(&without));
}

/// The limit on the number of pairs leaves out queries.
#[test]
fn few_matches_because_of_a_limit_on_pairs_are_reported() {
    let mut road = Road::new();
    let retrieval = |road: &Road| {
        let validation = road.cross_validate().unwrap();
        experiment::retrieval(&road.setup(), &road.data(), &validation).unwrap()
    };
    let rows = retrieval(&road);
    assert_eq!(experiment::few_matches(&road.data(), &rows), None, "all scans are queries");
    road.options.max_pairs = 100;
    let rows = retrieval(&road);
    let over_all = rows.iter().find(|row| row.log.is_none()).unwrap();
    let note = experiment::few_matches(&road.data(), &rows).unwrap();
    assert_eq!(note.severity(), dataset::Severity::Warning);
    let start = format!("retrieval has only {} matches, because one in ", over_all.n_positive);
    assert!(note.to_string().starts_with(&start), "{note}");
}
