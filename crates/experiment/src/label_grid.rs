//! The error under other label rules: each cell draws new pairs and cross-validates on them.

use dataset::tables::FeatureTable;
use dataset::{GridCell, Keyframe};
use evaluate::Confusion;
use label::{LabelError, assign_folds};
use rayon::prelude::*;
use train::FoldError;

use crate::cross_validation::{fold_options, folded};
use crate::{ExperimentError, Setup, differences};

/// The error of each learner of the grid under each combination of its label rules. A cell with too
/// few pairs has the reason instead.
pub fn label_grid(
    setup: &Setup<'_>,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<Vec<GridCell>, ExperimentError> {
    let grid = &setup.options.grid;
    let mut cells = Vec::new();
    for rules in grid.label_options(setup.label) {
        let errors = errors(setup, &rules, keyframes, features)?;
        for (learner, error) in grid.learners.iter().zip(errors) {
            cells.push(GridCell {
                learner: learner.name().to_owned(),
                grouping: grid.grouping.name().to_owned(),
                positive_radius_m: rules.positive_radius_m,
                negative_min_m: rules.negative_min_m,
                min_travel_gap_m: rules.min_travel_gap_m,
                error,
            });
        }
    }
    Ok(cells)
}

/// For each learner of the grid its error on pairs drawn by these rules, or why there is none.
fn errors(
    setup: &Setup<'_>,
    rules: &label::Options,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<Vec<Result<f64, String>>, ExperimentError> {
    let grid = &setup.options.grid;
    let no_error = |reason: String| Ok(vec![Err(reason); grid.learners.len()]);
    let pairs = match label::label(rules, setup.seed, keyframes) {
        Ok(labelled) => labelled.pairs,
        Err(LabelError::TooFew { n_positive, n_negative, wanted, .. }) => {
            let (found, class) = match n_positive < wanted as u64 {
                true => (n_positive, "positive"),
                false => (n_negative, "negative"),
            };
            return no_error(format!("{found} of {wanted} {class} pairs"));
        }
        Err(error) => return Err(error.into()),
    };
    let folds = match assign_folds(&fold_options(setup, grid.grouping), keyframes, &pairs) {
        Ok(folds) => folds,
        Err(LabelError::TooFewGroups { groups, found, .. }) => {
            return no_error(format!("{found} {groups}"));
        }
        Err(LabelError::TwoGroups { groups, .. }) => {
            return no_error(format!("2 {groups}"));
        }
        Err(error) => return Err(error.into()),
    };
    let data = differences(&pairs, features);
    let errors = grid.learners.par_iter().map(|&learner| {
        let n_rounds = setup.train.rounds_of(learner);
        match train::cross_validate(learner, n_rounds, &folded(&data, &folds)) {
            Ok(validated) => {
                let n = n_rounds as usize;
                let last = validated.confidences.iter().skip(n - 1).step_by(n).copied();
                Ok(Ok(Confusion::count(data.labels(), last, 0.0).error()))
            }
            Err(FoldError::OneClass { .. }) => Ok(Err("one class in a fold".to_owned())),
            Err(source) => Err(ExperimentError::Fold { grouping: grid.grouping, source }),
        }
    });
    errors.collect::<Vec<_>>().into_iter().collect()
}
