use rayon::prelude::*;

use crate::{Learner, Matrix, Round, TrainError, classifier, fit, knn, svm};

/// What training on all folds but one, for each fold, gives.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossValidated {
    /// The rounds fitted without each fold, `(n_folds,)` of up to `n_rounds`; none for a baseline.
    pub rounds: Vec<Vec<Round>>,
    /// Confidence of each pair after each round, by the classifier that did not see it,
    /// `(n_pairs, n_rounds)`; a learner that stopped early keeps its last confidence.
    pub confidences: Vec<f64>,
}

/// A pair's row and its confidence after each round.
type Scored = (usize, Vec<f64>);

/// Fits a learner once without each fold and scores that fold's pairs with it.
///
/// `folds` has the fold of each pair, 0 to `n_folds - 1`.
pub fn cross_validate(
    learner: Learner,
    n_rounds: u32,
    data: &Matrix,
    folds: &[u32],
    n_folds: u32,
) -> Result<CrossValidated, TrainError> {
    let n_rounds_usize = n_rounds as usize;
    let rows_where = |keep: &dyn Fn(u32) -> bool| -> Vec<usize> {
        (0..folds.len()).filter(|&row| keep(folds[row])).collect()
    };
    let by_fold: Vec<(Vec<Round>, Vec<Scored>)> = (0..n_folds)
        .into_par_iter()
        .map(|fold| {
            let training = data.select(&rows_where(&|f| f != fold));
            let rows = rows_where(&|f| f == fold);
            let Some(boosting) = learner.boosting() else {
                training.check()?;
                let test = data.select(&rows);
                let confidences = match learner {
                    Learner::Svm => svm::confidences(&training, &test),
                    _ => knn::confidences(&training, &test),
                };
                // A baseline has no rounds: its confidence is the same after each.
                let staged = confidences.into_iter().map(|c| vec![c; n_rounds_usize]);
                return Ok((Vec::new(), rows.into_iter().zip(staged).collect()));
            };
            let rounds = fit(boosting, n_rounds, &training)?;
            let classifier = classifier(boosting, &rounds);
            let scored = rows
                .into_iter()
                .map(|row| {
                    let difference: Vec<f64> =
                        data.columns().iter().map(|column| column[row]).collect();
                    let mut staged: Vec<f64> = classifier.staged_confidences(&difference).collect();
                    let last = staged.last().copied().unwrap_or(0.0);
                    staged.resize(n_rounds_usize, last);
                    (row, staged)
                })
                .collect();
            Ok((rounds, scored))
        })
        .collect::<Vec<Result<_, TrainError>>>()
        // Of several errors the first fold's, whichever came first in time.
        .into_iter()
        .collect::<Result<_, TrainError>>()?;
    let mut confidences = vec![0.0; folds.len() * n_rounds_usize];
    let mut rounds = Vec::with_capacity(by_fold.len());
    for (fold_rounds, scored) in by_fold {
        for (row, staged) in scored {
            confidences[row * n_rounds_usize..][..n_rounds_usize].copy_from_slice(&staged);
        }
        rounds.push(fold_rounds);
    }
    Ok(CrossValidated { rounds, confidences })
}

#[cfg(test)]
mod tests {
    use super::*;

    use dataset::Label::{Negative, Positive};

    /// Pair 0 is an outlier of its own fold: the classifier that scores it learned from the other
    /// fold alone, where positives lie below 5.
    #[test]
    fn a_pair_is_scored_by_a_classifier_that_did_not_see_it() {
        let data = Matrix::new(
            vec![vec![9.0, 8.0, 1.0, 10.0]],
            vec![Positive, Negative, Positive, Negative],
        );
        let result = cross_validate(Learner::Discrete, 2, &data, &[0, 0, 1, 1], 2).unwrap();
        assert_eq!(result.confidences.len(), 8);
        // Without fold 0: threshold 5.5, 9 and 8 lie above: negative, both.
        assert!(result.confidences[0] < 0.0 && result.confidences[2] < 0.0);
        // Without fold 1: threshold 8.5, positive above: 1 is negative, 10 positive.
        assert!(result.confidences[4] < 0.0 && result.confidences[6] > 0.0);
        assert_eq!(result.rounds.len(), 2);
    }

    #[test]
    fn a_fold_that_leaves_one_class_is_an_error() {
        let data = Matrix::new(vec![vec![1.0, 2.0]], vec![Positive, Negative]);
        let error = cross_validate(Learner::Discrete, 1, &data, &[0, 1], 2).unwrap_err();
        assert_eq!(error, TrainError::OneClass { n_positive: 0, n_negative: 1 });
    }
}
