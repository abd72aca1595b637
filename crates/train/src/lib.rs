//! `train`: features and labels -> a classifier ([`fit`]), also on folds ([`cross_validate`]).
//!
//! The results have the same bits for any number of threads: features, folds and learners run in
//! parallel, but every sum over pairs has one fixed order.
//!
//! ```
//! use dataset::Label::{Negative, Positive};
//! use train::Matrix;
//!
//! // One feature. The two positive pairs differ less in it than the two negative pairs.
//! let differences = vec![vec![0.1, 0.3, 2.0, 3.0]];
//! let data = Matrix::new(differences, vec![Positive, Positive, Negative, Negative]);
//!
//! let learner = model::Learner::Discrete;
//! let rounds = train::fit(learner, 10, &data)?;
//! let classifier = train::classifier(learner, &rounds);
//! assert!(0.0 < classifier.confidence(&[0.2]) && classifier.confidence(&[2.5]) < 0.0);
//! # Ok::<(), train::TrainError>(())
//! ```

mod baseline;
mod cross_validate;
pub mod detector;
mod discrete;
mod gentle;
mod gentle_line;
mod gentle_stump;
mod knn;
mod logit_trees;
mod matrix;
mod svm;

use std::collections::BTreeSet;

use dataset::OutOfRange;
use model::{Classifier, WeakLearner};
use serde::{Deserialize, Serialize};

pub use cross_validate::{CrossValidated, FoldError, FoldFit, Folded, cross_validate, fit_without};
pub use matrix::Matrix;

/// Largest number of boosting rounds. A larger number is a typing error and would exhaust the memory.
const MAX_ROUNDS: u32 = 100_000;

/// The section `[train]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "TrainOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The learners. Each one is trained and evaluated, and gives its own model. If the list is empty, no
    /// pairs are labelled and nothing is trained: the run only finds loop closures, with the starting values
    /// of the detector.
    pub learners: Vec<Learner>,
    /// Number of boosting rounds T.
    pub rounds: u32,
    /// Number of boosting rounds of `logit_trees`, which takes shorter steps.
    pub tree_rounds: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            learners: vec![Learner::Discrete, Learner::GentleLine, Learner::GentleStump],
            rounds: 50,
            tree_rounds: 200,
        }
    }
}

impl Options {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        for (key, rounds) in [("rounds", self.rounds), ("tree_rounds", self.tree_rounds)] {
            if !(1..=MAX_ROUNDS).contains(&rounds) {
                let expected = format!("1 to {MAX_ROUNDS}");
                return Err(OutOfRange::new(format!("train.{key}"), rounds, expected));
            }
        }
        let names: Vec<&str> = self.learners.iter().map(|learner| learner.name()).collect();
        if names.iter().collect::<BTreeSet<_>>().len() < names.len() {
            let list = format!("[{}]", names.join(", "));
            return Err(OutOfRange::new("train.learners", list, "each learner once"));
        }
        Ok(())
    }

    /// The number of boosting rounds of a learner.
    pub fn rounds_of(&self, learner: Learner) -> u32 {
        if learner == Learner::LogitTrees { self.tree_rounds } else { self.rounds }
    }
}

/// A method that learns a classifier from labelled pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Learner {
    /// Discrete AdaBoost over decision stumps (the paper's Algorithm 1).
    Discrete,
    /// Gentle AdaBoost over weighted least-squares lines (the paper's Algorithm 2).
    GentleLine,
    /// Gentle AdaBoost over regression stumps (Friedman, Hastie and Tibshirani 2000).
    GentleStump,
    /// LogitBoost over small regression trees (Friedman, Hastie and Tibshirani 2000, Algorithm 3).
    LogitTrees,
    /// Baseline: 5 nearest neighbours. It is evaluated but not saved.
    Knn,
    /// Baseline: a linear support vector machine. It is evaluated but not saved.
    Svm,
}

impl Learner {
    /// The name in options and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Knn => "knn",
            Self::Svm => "svm",
            _ => self.boosting().map_or("", model::Learner::name),
        }
    }

    /// The boosting learner, whose classifier can be saved; `None` for a baseline.
    pub fn boosting(self) -> Option<model::Learner> {
        match self {
            Self::Discrete => Some(model::Learner::Discrete),
            Self::GentleLine => Some(model::Learner::GentleLine),
            Self::GentleStump => Some(model::Learner::GentleStump),
            Self::LogitTrees => Some(model::Learner::LogitTrees),
            Self::Knn | Self::Svm => None,
        }
    }
}

/// Why a learner cannot be fitted.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// A class has no pairs.
    #[error(
        "training needs pairs of both classes, found {n_positive} positive and {n_negative} negative pairs"
    )]
    OneClass {
        /// Number of positive pairs.
        n_positive: usize,
        /// Number of negative pairs.
        n_negative: usize,
    },
    /// No feature distinguishes any two pairs.
    #[error("every feature has one value for all {n_pairs} pairs, so nothing can be learned")]
    NothingToLearn {
        /// Number of pairs.
        n_pairs: usize,
    },
    /// A value is not a finite number.
    #[error("feature {feature} of pair {row} is {value}, expected a finite number")]
    NotFinite {
        /// Index of the feature.
        feature: usize,
        /// Index of the pair.
        row: usize,
        /// The value.
        value: f64,
    },
    /// The number of rounds is 0.
    #[error("`train.rounds` or `train.tree_rounds` is 0, expected 1 or more")]
    NoRounds,
}

/// One fitted round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// The weak learner that was chosen.
    pub weak: WeakLearner,
    /// Its error under the weights of the round. For `discrete`, the weighted share of wrong labels.
    /// For the gentle learners, the weighted mean of the squared residuals. For `logit_trees`, the
    /// sum of the squared residuals as a share of the sum of squares before the round.
    pub weighted_error: f64,
}

/// Fits a learner with up to `n_rounds` rounds. `discrete` stops early if no stump is better than
/// chance.
pub fn fit(
    learner: model::Learner,
    n_rounds: u32,
    data: &Matrix,
) -> Result<Vec<Round>, TrainError> {
    if n_rounds == 0 {
        return Err(TrainError::NoRounds);
    }
    data.check()?;
    let rounds = match learner {
        model::Learner::Discrete => discrete::fit(n_rounds, data),
        model::Learner::GentleLine => gentle::fit::<gentle_line::Line>(n_rounds, data),
        model::Learner::GentleStump => gentle::fit::<gentle_stump::Stump>(n_rounds, data),
        model::Learner::LogitTrees => logit_trees::fit(n_rounds, data),
    };
    if rounds.is_empty() {
        return Err(TrainError::NothingToLearn { n_pairs: data.n_rows() });
    }
    Ok(rounds)
}

/// The classifier of fitted rounds.
pub fn classifier(learner: model::Learner, rounds: &[Round]) -> Classifier {
    Classifier { learner, rounds: rounds.iter().map(|round| round.weak).collect() }
}

/// Two errors that differ by less than this are a tie. The order of features and thresholds decides.
///
/// Errors that are equal on paper differ by rounding, which depends on the order of summation. The
/// weights sum to 1, so the rounding stays below 1e-13 for a million pairs.
const TIE: f64 = 1e-12;
