//! `train`: features and labels -> a classifier ([`fit`]), and the same on folds
//! ([`cross_validate`]).
//!
//! Every sum over pairs runs in one fixed order, so that results are the same to the bit for any
//! number of threads; what runs in parallel are features, folds and learners.

mod baseline;
mod cross_validate;
mod discrete;
mod feature_auc;
mod gentle;
mod gentle_line;
mod gentle_stump;
mod knn;
mod logit_trees;
mod matrix;
mod svm;

use model::{Classifier, WeakLearner};
use serde::{Deserialize, Serialize};

pub use cross_validate::{CrossValidated, FoldError, FoldFit, Folded, cross_validate, fit_without};
pub use feature_auc::feature_auc;
pub use matrix::Matrix;

/// The section `[train]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "TrainOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Which learners; each gives a model of its own.
    pub learners: Vec<Learner>,
    /// Boosting rounds T.
    pub rounds: u32,
    /// Boosting rounds of `logit_trees`, whose steps are short.
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
    /// Boosting rounds of a learner.
    pub fn rounds_of(&self, learner: Learner) -> u32 {
        if learner == Learner::LogitTrees { self.tree_rounds } else { self.rounds }
    }
}

/// What can be fitted to labelled pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Learner {
    /// Discrete AdaBoost over decision stumps (the paper's Algorithm 1).
    Discrete,
    /// Gentle AdaBoost over weighted least-squares lines (Algorithm 2 by the paper's words).
    GentleLine,
    /// Gentle AdaBoost over regression stumps (Friedman, Hastie and Tibshirani 2000).
    GentleStump,
    /// LogitBoost over small regression trees (Friedman, Hastie and Tibshirani 2000, Algorithm 3).
    LogitTrees,
    /// Baseline: 5 nearest neighbours. Evaluated, not saved.
    Knn,
    /// Baseline: a linear support vector machine. Evaluated, not saved.
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

    /// The boosting learner, whose classifier is saved; none for the baselines.
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

/// Why there is no classifier.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// One class only, or no pair at all.
    #[error(
        "training needs pairs of both classes, found {n_positive} positive and {n_negative} negative"
    )]
    OneClass {
        /// Positive pairs.
        n_positive: usize,
        /// Negative pairs.
        n_negative: usize,
    },
    /// No feature tells any pair from another.
    #[error("no feature differs between any two of the {n_pairs} pairs: nothing can be learned")]
    NothingToLearn {
        /// Pairs there are.
        n_pairs: usize,
    },
    /// A value that is no number.
    #[error("feature {feature} of pair {row} is {value}, expected a finite number")]
    NotFinite {
        /// Index of the feature.
        feature: usize,
        /// Index of the pair.
        row: usize,
        /// The value.
        value: f64,
    },
    /// No round asked for.
    #[error("`train.rounds` or `train.tree_rounds` is 0, expected 1 or more")]
    NoRounds,
}

/// One round as it was fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Round {
    /// The weak learner chosen.
    pub weak: WeakLearner,
    /// Its error under the round's weights: for `discrete` the weighted share of wrong labels,
    /// for the gentle learners the weighted mean of the squared residuals, for `logit_trees` the
    /// same as a share of the squares that there were.
    pub weighted_error: f64,
}

/// Fits a learner with up to `n_rounds` rounds; Discrete stops early where no stump is better
/// than chance.
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

/// Two errors closer than this are a tie, decided by the order of features and thresholds.
///
/// Errors that are equal on paper differ by rounding, which depends on the order of summation;
/// weights sum to 1, so that rounding stays below 1e-13 for a million pairs.
const TIE: f64 = 1e-12;
