//! Confidences of pairs by classifiers that were not trained on them.

use train::Learner;

use crate::retrieval::{Fits, strictest};
use crate::{CrossValidation, Data, ExperimentError, Setup};

/// The confidence of each pair of keyframes (indices in `data.keyframes`) by a classifier that held out
/// the folds of both, under the strictest grouping that was evaluated: `place`, then `log`, then `scan`.
///
/// `None` for a pair if too few pairs are left to train on, and for all pairs if no grouping but `pair`
/// was evaluated, because that one holds out no scans.
pub fn held_out_confidences(
    setup: &Setup<'_>,
    data: &Data<'_>,
    validation: &CrossValidation,
    learner: Learner,
    pairs: &[[usize; 2]],
) -> Result<Vec<Option<f64>>, ExperimentError> {
    let of_learner = strictest(validation).and_then(|result| {
        let found = result.learners.iter().find(|of_learner| of_learner.learner == learner);
        found.map(|of_learner| (result, of_learner))
    });
    let Some((result, of_learner)) = of_learner else { return Ok(vec![None; pairs.len()]) };
    let fits = Fits::new(setup, data, result, of_learner)?;
    let mut difference = vec![0.0; data.features.names.len()];
    let confidence = |pair: &[usize; 2]| {
        let [a, b] = pair.map(|k| data.features.row(k));
        featurize::difference(a, b, &mut difference);
        let [fold_a, fold_b] = pair.map(|k| result.folds.keyframe_folds[k]);
        fits.holding_out(fold_a, fold_b).and_then(|fit| fit.confidence(&difference))
    };
    Ok(pairs.iter().map(confidence).collect())
}
