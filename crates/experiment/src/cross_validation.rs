//! Cross-validation of all learners under all groupings.

use dataset::Scores;
use label::{FoldOptions, Folds, Grouping, assign_folds};
use rayon::prelude::*;
use train::{CrossValidated, FoldFit, Folded, Learner, Matrix};

use crate::{Data, ExperimentError, NotEvaluated, Setup};

/// The results of all groupings.
#[derive(Debug)]
pub struct CrossValidation {
    /// The groupings that could be evaluated, in the order of the options.
    pub groupings: Vec<GroupingResult>,
    /// The groupings that could not be evaluated, and why.
    pub not_evaluated: Vec<NotEvaluated>,
}

/// The results of one grouping.
#[derive(Debug)]
pub struct GroupingResult {
    /// The grouping.
    pub grouping: Grouping,
    /// How it assigns pairs to folds.
    pub folds: Folds,
    /// One result for each learner, in the order of `train.learners`.
    pub learners: Vec<LearnerResult>,
}

/// The results of one learner under one grouping.
#[derive(Debug)]
pub struct LearnerResult {
    /// The learner.
    pub learner: Learner,
    /// One fit for each pair of folds that a labelled pair touches.
    pub fits: Vec<FoldFit>,
    /// The confidence of each pair, by the fit that held out its folds.
    pub scores: Scores,
}

impl CrossValidation {
    /// The scores of all learners and groupings, learner by learner.
    pub fn scores(&self) -> Vec<Scores> {
        let n_learners = self.groupings.first().map_or(0, |result| result.learners.len());
        (0..n_learners).flat_map(|k| self.scores_of(k)).cloned().collect()
    }

    /// The scores of the `k`-th learner, grouping by grouping.
    pub(crate) fn scores_of(&self, k: usize) -> impl Iterator<Item = &Scores> {
        self.groupings.iter().map(move |result| &result.learners[k].scores)
    }
}

/// Cross-validates each learner under each grouping of the options.
///
/// A grouping that leaves too few pairs to train on is listed in `not_evaluated`. It is an error if
/// the options require all groupings, or if no grouping can be evaluated.
pub fn cross_validate(
    setup: &Setup<'_>,
    data: &Data<'_>,
) -> Result<CrossValidation, ExperimentError> {
    let mut groupings = Vec::new();
    let mut not_evaluated = Vec::new();
    for &grouping in &setup.options.groupings {
        match evaluate_grouping(setup, data, grouping) {
            Ok(result) => groupings.push(result),
            Err(error) if setup.options.require_groupings => return Err(error),
            Err(error) => not_evaluated.push(NotEvaluated { grouping, error }),
        }
    }
    if groupings.is_empty() {
        return Err(ExperimentError::NoGrouping(not_evaluated));
    }
    Ok(CrossValidation { groupings, not_evaluated })
}

/// Cross-validates all learners under one grouping.
fn evaluate_grouping(
    setup: &Setup<'_>,
    data: &Data<'_>,
    grouping: Grouping,
) -> Result<GroupingResult, ExperimentError> {
    let folds = assign_folds(&fold_options(setup, grouping), data.keyframes, data.pairs)?;
    let folded = folded(data.differences, &folds);
    let learners = setup
        .train
        .learners
        .par_iter()
        .map(|&learner| {
            let n_rounds = setup.train.rounds_of(learner);
            let CrossValidated { fits, confidences, n_training } =
                train::cross_validate(learner, n_rounds, &folded)?;
            let scores = Scores {
                learner: learner.name().to_owned(),
                grouping: grouping.name().to_owned(),
                n_rounds: n_rounds as usize,
                groups: folds.groups.clone(),
                folds: folds.folds.clone(),
                n_training,
                confidences,
            };
            Ok(LearnerResult { learner, fits, scores })
        })
        .collect::<Vec<_>>()
        // If several learners fail, report the first one in the options, not the first one in time.
        .into_iter()
        .collect::<Result<Vec<_>, _>>()
        .map_err(|source| ExperimentError::Fold { grouping, source })?;
    Ok(GroupingResult { grouping, folds, learners })
}

/// How a grouping assigns pairs to folds.
pub(crate) fn fold_options(setup: &Setup<'_>, grouping: Grouping) -> FoldOptions {
    FoldOptions {
        grouping,
        n_folds: setup.options.folds,
        place_m: setup.options.place_m,
        place_margin_m: setup.options.place_margin_m,
        seed: setup.seed,
    }
}

/// Pairs with their folds.
pub(crate) fn folded<'a>(differences: &'a Matrix, folds: &'a Folds) -> Folded<'a> {
    Folded {
        data: differences,
        folds: &folds.folds,
        near_folds: &folds.near_folds,
        keys: &folds.keys,
    }
}
