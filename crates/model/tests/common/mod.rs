//! A model for the tests.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use model::{
    Classifier, FeatureSpec, Learner, Measured, Model, Node, OperatingPoint, ScanSpec, Training,
    Tree, WeakLearner,
};
use semver::Version;
use serde_json::json;

fn rounds(learner: Learner) -> Vec<WeakLearner> {
    match learner {
        Learner::Discrete => vec![
            WeakLearner::Vote { feature: 1, threshold: 2.125, polarity: 1.0, alpha: 0.1 + 0.2 },
            WeakLearner::Vote { feature: 0, threshold: -0.5, polarity: -1.0, alpha: 1.0 / 3.0 },
        ],
        Learner::GentleLine => vec![WeakLearner::Line { feature: 2, slope: -0.7, intercept: 0.3 }],
        Learner::GentleStump => {
            vec![WeakLearner::Step { feature: 0, threshold: 4.5, below: 0.9, above: -0.6 }]
        }
        Learner::LogitTrees => {
            let split = |feature, threshold| Node { feature, threshold };
            let nodes = [split(2, 0.75), Node::PASS, split(1, 1e-3)];
            let deep = Tree::new(&nodes, &[0.5, 0.0, -0.25, -0.125]);
            let flat = Tree::new(&[split(0, 3.5)], &[0.1, -0.3]);
            [deep, flat].map(|tree| WeakLearner::Tree(tree.unwrap())).into()
        }
    }
}

pub fn model(learner: Learner) -> Model {
    Model {
        name: "campus".into(),
        version: Version::new(1, 0, 0),
        program_version: "0.1.0".into(),
        seed: u64::MAX,
        features: FeatureSpec {
            set: "paper16".into(),
            version: 1,
            gate_m: 2.5,
            names: ["centroid", "distance", "size"].map(str::to_owned).into(),
        },
        scans: ScanSpec {
            is_ring: true,
            coverage_min_deg: 359.7,
            coverage_max_deg: 360.1,
            range_min_m: 0.9,
            range_max_m: 70.25,
        },
        label_options: json!({"positive_radius_m": 1.5}),
        training: Training {
            n_positive: 1218,
            n_negative: 1219,
            digests: [("pairs".to_owned(), "00ff".to_owned())].into(),
            warnings: [("duplicate_packets".to_owned(), 3)].into(),
        },
        measured: vec![Measured {
            grouping: "pair".into(),
            folds: 10,
            rounds: 2,
            error: 0.015,
            precision: Some(0.9375),
            recall: 0.96,
        }],
        operating_points: vec![OperatingPoint {
            name: "recall at 100 % precision".into(),
            grouping: "pair".into(),
            threshold: 0.75,
            precision: 1.0,
            recall: 0.85,
            false_alarm: 0.0,
        }],
        detector: None,
        classifier: Classifier { learner, rounds: rounds(learner) },
    }
}

/// Whether two models have the same bits, except for the bits of a NaN.
pub fn is_same(one: &Model, other: &Model) -> bool {
    format!("{one:?}") == format!("{other:?}")
}
