//! Learners fitted to all pairs, and what their rounds chose.

use dataset::{BoostingRound, HeldOut};
use rayon::prelude::*;
use train::{Learner, Matrix, Round};

use crate::{CrossValidation, ExperimentError};

/// A learner fitted to all pairs.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The learner.
    pub learner: Learner,
    /// Its rounds; empty for a baseline, which is evaluated but not saved.
    pub rounds: Vec<Round>,
}

/// Fits each learner of the options to all pairs.
pub fn fit(options: &train::Options, data: &Matrix) -> Result<Vec<Fitted>, ExperimentError> {
    let fit = |&learner: &Learner| {
        let Some(boosting) = learner.boosting() else {
            return Ok(Fitted { learner, rounds: Vec::new() });
        };
        let rounds = train::fit(boosting, options.rounds_of(learner), data)
            .map_err(|source| ExperimentError::Fit { learner: learner.name(), source })?;
        Ok(Fitted { learner, rounds })
    };
    // If several learners fail, report the first one in the options, not the first one in time.
    options.learners.par_iter().map(fit).collect::<Vec<_>>().into_iter().collect()
}

/// What each round chose: first the fit on all pairs, then the fits on folds, learner by learner.
pub fn boosting_rounds(
    fitted: &[Fitted],
    validation: &CrossValidation,
    feature_names: &[String],
) -> Vec<BoostingRound> {
    let mut rows = Vec::new();
    for (k, Fitted { learner, rounds }) in fitted.iter().enumerate() {
        rows.extend(rows_of(*learner, None, rounds, feature_names));
        for result in &validation.groupings {
            for fit in &result.learners[k].fits {
                let grouping = result.grouping.name().to_owned();
                let held_out = HeldOut { grouping, folds: fit.held_out };
                rows.extend(rows_of(*learner, Some(held_out), &fit.rounds, feature_names));
            }
        }
    }
    rows
}

/// A row for each split of each round of one fit.
fn rows_of(
    learner: Learner,
    held_out: Option<HeldOut>,
    rounds: &[Round],
    feature_names: &[String],
) -> impl Iterator<Item = BoostingRound> {
    let splits = (1..).zip(rounds).flat_map(|(number, round)| {
        round.weak.splits().map(move |split| (number, round.weighted_error, split))
    });
    splits.map(move |(round, weighted_error, split)| BoostingRound {
        learner: learner.name().to_owned(),
        held_out: held_out.clone(),
        round,
        node: split.node,
        feature: feature_names[split.feature].clone(),
        threshold: split.threshold,
        weighted_error,
    })
}
