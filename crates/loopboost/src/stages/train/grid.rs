//! The error under other label rules: pairs are drawn anew for each cell and cross-validated.

use anyhow::Result;
use dataset::tables::FeatureTable;
use dataset::{GridCell, Keyframe};
use evaluate::Confusion;
use label::LabelError;
use rayon::prelude::*;
use train::FoldError;

use super::{Options, fold_options, folded, matrix};

/// The cells of `[evaluate.grid]`; a cell with too few candidates says so.
pub(super) fn grid(
    options: &Options<'_>,
    seed: u64,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<Vec<GridCell>> {
    let grid = &options.evaluate.grid;
    let mut cells = Vec::new();
    for rules in grid.cells(options.label) {
        let errors = errors(options, &rules, seed, keyframes, features)?;
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

/// For each learner of the grid, its error on pairs drawn by these rules.
fn errors(
    options: &Options<'_>,
    rules: &label::Options,
    seed: u64,
    keyframes: &[Keyframe],
    features: &FeatureTable,
) -> Result<Vec<Result<f64, String>>> {
    let grid = &options.evaluate.grid;
    let none = |reason: String| Ok(vec![Err(reason); grid.learners.len()]);
    let pairs = match label::label(rules, seed, keyframes) {
        Ok((pairs, _)) => pairs,
        Err(LabelError::TooFew { class, found, wanted, .. }) => {
            return none(format!("{found} of {wanted} {class} pairs"));
        }
        Err(error) => return Err(error.into()),
    };
    let fold_options = fold_options(options.evaluate, grid.grouping, seed);
    let folds = match label::assign_folds(&fold_options, keyframes, &pairs) {
        Ok(folds) => folds,
        Err(LabelError::TooFewGroups { groups, found, .. }) => {
            return none(format!("{found} {groups}"));
        }
        Err(error) => return Err(error.into()),
    };
    let data = matrix(&pairs, features);
    let errors = grid.learners.par_iter().map(|&learner| {
        let n_rounds = options.train.rounds_of(learner);
        match train::cross_validate(learner, n_rounds, &folded(&data, &folds)) {
            Ok(validated) => {
                let n = n_rounds as usize;
                let last = validated.confidences.iter().skip(n - 1).step_by(n).copied();
                Ok(Ok(Confusion::count(data.labels(), last, 0.0).error()))
            }
            Err(FoldError::OneClass { .. }) => Ok(Err("one class in a fold".to_owned())),
            Err(error) => Err(error.into()),
        }
    });
    errors.collect::<Vec<_>>().into_iter().collect()
}
