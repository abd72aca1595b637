//! Cross-validation: each pair is scored by a classifier that was not trained on it.

use std::collections::BTreeSet;

use dataset::Label;
use model::Classifier;
use rayon::prelude::*;

use crate::{Learner, Matrix, Round, TrainError, classifier, fit, knn, svm};

/// Labelled pairs and their folds.
#[derive(Debug, Clone, Copy)]
pub struct Folded<'a> {
    /// The pairs.
    pub data: &'a Matrix,
    /// The folds of each pair's query and reference, `(n_pairs, 2)`. They can be the same fold.
    pub folds: &'a [[u32; 2]],
    /// Other folds that each pair must not be trained for, `(n_pairs,)`: those with ground within
    /// the margin around the pair's two scans.
    pub near_folds: &'a [Vec<u32>],
    /// A pseudo-random number for each pair, `(n_pairs,)`. It decides which pairs of the larger class
    /// are left out of a training set.
    pub keys: &'a [u64],
}

/// The result of a cross-validation.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossValidated {
    /// One fit for each two folds that a pair touches, ascending.
    pub fits: Vec<FoldFit>,
    /// The confidence of each pair after each round, `(n_pairs, n_rounds)`, by the classifier that
    /// held out the pair's folds. A learner that stopped early keeps its last confidence.
    pub confidences: Vec<f64>,
    /// Number of pairs that this classifier was trained on, `(n_pairs,)`.
    pub n_training: Vec<u32>,
}

/// A classifier fitted with two folds held out.
#[derive(Debug, Clone, PartialEq)]
pub struct FoldFit {
    /// The folds held out, ascending; the same fold twice if only one was held out.
    pub held_out: [u32; 2],
    /// Number of pairs that it was trained on.
    pub n_training: usize,
    /// The rounds; empty for a baseline.
    pub rounds: Vec<Round>,
    scorer: Scorer,
}

#[derive(Debug, Clone, PartialEq)]
enum Scorer {
    Boosted(Classifier),
    Linear(svm::Linear),
    /// k-NN keeps its training pairs.
    Neighbours(Matrix),
}

/// Why a learner cannot be fitted with folds held out.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum FoldError {
    /// The remaining pairs lack a class.
    #[error(
        "with {} held out, {n_positive} positive and {n_negative} negative pairs are left to train on, expected both classes; raise `label.pairs_per_class`, lower `evaluate.place_m` or `evaluate.place_margin_m`, add logs, or remove the grouping from `evaluate.groupings`",
        folds(.held_out)
    )]
    OneClass {
        /// The folds held out.
        held_out: [u32; 2],
        /// Number of positive pairs left.
        n_positive: usize,
        /// Number of negative pairs left.
        n_negative: usize,
    },
    /// The learner cannot be fitted to the remaining pairs.
    #[error("cannot train with {} held out", folds(.held_out))]
    Fit {
        /// The folds held out.
        held_out: [u32; 2],
        /// The cause.
        source: TrainError,
    },
}

fn folds([a, b]: &[u32; 2]) -> String {
    if a == b { format!("fold {a}") } else { format!("folds {a} and {b}") }
}

/// The rows that touch neither fold and are not near one, with equal numbers of both classes. Of the larger class, the
/// rows with the smallest keys are kept. Without this, Gentle AdaBoost would favour the larger class,
/// since its weights start equal.
fn training_rows(folded: &Folded<'_>, [a, b]: [u32; 2]) -> Result<Vec<usize>, FoldError> {
    let labels = folded.data.labels();
    let rows_of = |label: Label| -> Vec<usize> {
        (0..labels.len())
            .filter(|&row| {
                let (touched, near) = (&folded.folds[row], &folded.near_folds[row]);
                labels[row] == label
                    && [a, b].iter().all(|fold| !touched.contains(fold) && !near.contains(fold))
            })
            .collect()
    };
    let (mut positive, mut negative) = (rows_of(Label::Positive), rows_of(Label::Negative));
    let (n_positive, n_negative) = (positive.len(), negative.len());
    if n_positive == 0 || n_negative == 0 {
        return Err(FoldError::OneClass { held_out: [a, b], n_positive, n_negative });
    }
    for rows in [&mut positive, &mut negative] {
        rows.sort_unstable_by_key(|&row| (folded.keys[row], row));
        rows.truncate(n_positive.min(n_negative));
    }
    let mut rows = [positive, negative].concat();
    rows.sort_unstable();
    Ok(rows)
}

/// Fits a learner to the pairs that touch neither of two folds.
pub fn fit_without(
    learner: Learner,
    n_rounds: u32,
    folded: &Folded<'_>,
    held_out: [u32; 2],
) -> Result<FoldFit, FoldError> {
    let rows = training_rows(folded, held_out)?;
    let n_training = rows.len();
    let training = folded.data.select(&rows);
    let failed = |source| FoldError::Fit { held_out, source };
    if let Some(boosting) = learner.boosting() {
        let rounds = fit(boosting, n_rounds, &training).map_err(failed)?;
        let scorer = Scorer::Boosted(classifier(boosting, &rounds));
        return Ok(FoldFit { held_out, n_training, rounds, scorer });
    }
    training.check().map_err(failed)?;
    let scorer = match learner {
        Learner::Svm => Scorer::Linear(svm::Linear::fit(&training)),
        _ => Scorer::Neighbours(training),
    };
    Ok(FoldFit { held_out, n_training, rounds: Vec::new(), scorer })
}

impl FoldFit {
    /// The confidence of a pair with these feature differences, `(n_features,)`, after the last
    /// round. `None` for k-NN, which would compare the pair with every training pair.
    #[inline]
    pub fn confidence(&self, difference: &[f64]) -> Option<f64> {
        match &self.scorer {
            Scorer::Boosted(classifier) => Some(classifier.confidence(difference)),
            Scorer::Linear(linear) => Some(linear.confidence(difference)),
            Scorer::Neighbours(_) => None,
        }
    }

    /// The confidences of the given rows after each round, `(n_rows, n_rounds)`.
    fn staged(&self, data: &Matrix, rows: &[usize], n_rounds: usize) -> Vec<f64> {
        let mut staged = Vec::with_capacity(rows.len() * n_rounds);
        // A baseline has no rounds: its confidence is repeated for each of them.
        let mut repeat = |confidence: f64| staged.extend(std::iter::repeat_n(confidence, n_rounds));
        let difference =
            |row: usize| -> Vec<f64> { data.columns().iter().map(|column| column[row]).collect() };
        match &self.scorer {
            Scorer::Boosted(classifier) => {
                for &row in rows {
                    let end = staged.len() + n_rounds;
                    staged.extend(classifier.staged_confidences(&difference(row)));
                    let last = staged.last().copied().unwrap_or(0.0);
                    staged.resize(end, last);
                }
            }
            Scorer::Linear(linear) => {
                rows.iter().for_each(|&row| repeat(linear.confidence(&difference(row))));
            }
            Scorer::Neighbours(training) => {
                knn::confidences(training, &data.select(rows)).into_iter().for_each(repeat);
            }
        }
        staged
    }
}

/// Fits a learner for each two folds that a pair touches, with these folds held out, and scores
/// their pairs with it. Each pair is scored exactly once.
pub fn cross_validate(
    learner: Learner,
    n_rounds: u32,
    folded: &Folded<'_>,
) -> Result<CrossValidated, FoldError> {
    let n = n_rounds as usize;
    let ascending = |[a, b]: [u32; 2]| [a.min(b), a.max(b)];
    let touched: BTreeSet<[u32; 2]> = folded.folds.iter().copied().map(ascending).collect();
    let by_folds = touched
        .into_par_iter()
        .map(|held_out| {
            let fit = fit_without(learner, n_rounds, folded, held_out)?;
            let rows: Vec<usize> = (0..folded.folds.len())
                .filter(|&row| ascending(folded.folds[row]) == held_out)
                .collect();
            let staged = fit.staged(folded.data, &rows, n);
            Ok((fit, rows, staged))
        })
        .collect::<Vec<Result<_, FoldError>>>()
        // If several fits fail, report the first one in order of the folds, not the first one in time.
        .into_iter()
        .collect::<Result<Vec<_>, FoldError>>()?;
    let mut confidences = vec![0.0; folded.folds.len() * n];
    let mut n_training = vec![0; folded.folds.len()];
    let mut fits = Vec::with_capacity(by_folds.len());
    for (fit, rows, staged) in by_folds {
        for (row, staged) in rows.into_iter().zip(staged.chunks(n)) {
            confidences[row * n..][..n].copy_from_slice(staged);
            n_training[row] = fit.n_training as u32;
        }
        fits.push(fit);
    }
    Ok(CrossValidated { fits, confidences, n_training })
}

#[cfg(test)]
mod tests {
    use super::*;

    use dataset::Label::{Negative, Positive};

    /// No margin, for up to ten pairs.
    const NONE_NEAR: &[Vec<u32>] = &[const { Vec::new() }; 10];

    /// Pair 0 is an outlier in its own fold. The classifier that scores it is trained on the other
    /// fold only, where positives are below 5.
    #[test]
    fn a_pair_is_scored_by_a_classifier_that_was_not_trained_on_it() {
        let data = Matrix::new(
            vec![vec![9.0, 8.0, 1.0, 10.0]],
            vec![Positive, Negative, Positive, Negative],
        );
        let folds = [[0, 0], [0, 0], [1, 1], [1, 1]];
        let folded = Folded { data: &data, folds: &folds, near_folds: NONE_NEAR, keys: &[0; 4] };
        let result = cross_validate(Learner::Discrete, 2, &folded).unwrap();
        assert_eq!((result.confidences.len(), &*result.n_training), (8, &[2; 4][..]));
        // Fold 0 held out: threshold 5.5. 9 and 8 are above it, so both are negative.
        assert!(result.confidences[0] < 0.0 && result.confidences[2] < 0.0);
        // Fold 1 held out: threshold 8.5, positive above. 1 is negative, 10 is positive.
        assert!(result.confidences[4] < 0.0 && result.confidences[6] > 0.0);
        let held_out: Vec<_> = result.fits.iter().map(|fit| fit.held_out).collect();
        assert_eq!(held_out, [[0, 0], [1, 1]]);
    }

    /// A pair between folds 0 and 1 is scored by a classifier trained on fold 2 only, although there
    /// are pairs in fold 0, in fold 1, and between each of them and fold 2. The order of the pair's
    /// folds does not matter.
    #[test]
    fn a_pair_between_two_folds_is_scored_with_both_held_out() {
        let data = Matrix::new(
            vec![vec![3.0, 4.0, 1.0, 9.0, 2.0, 3.0, 2.0, 3.0, 1.0, 9.0]],
            [Positive, Negative]
                .repeat(2)
                .into_iter()
                .chain([Negative, Positive].repeat(2))
                .chain([Positive, Negative])
                .collect(),
        );
        let folds =
            [[0, 1], [1, 0], [2, 2], [2, 2], [0, 0], [0, 0], [1, 1], [1, 1], [0, 2], [2, 1]];
        let folded = Folded { data: &data, folds: &folds, near_folds: NONE_NEAR, keys: &[0; 10] };
        let fit = fit_without(Learner::Discrete, 1, &folded, [0, 1]).unwrap();
        // The threshold 5 is between 1 (+) and 9 (-). 3 and 4 are below it.
        assert_eq!(fit.rounds[0].weak.splits().next().unwrap().threshold, Some(5.0));
        let result = cross_validate(Learner::Discrete, 1, &folded).unwrap();
        assert_eq!(result.fits[1], fit);
        assert_eq!(result.confidences[0].to_bits(), fit.confidence(&[3.0]).unwrap().to_bits());
        assert!(result.confidences[0] > 0.0 && result.confidences[1] > 0.0);
        let held_out: Vec<_> = result.fits.iter().map(|fit| fit.held_out).collect();
        assert_eq!(held_out, [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]]);
    }

    /// Of the larger class, the pairs with the smallest keys are kept.
    #[test]
    fn training_pairs_have_equal_numbers_of_both_classes() {
        let data = Matrix::new(
            vec![vec![0.0; 6]],
            vec![Positive, Negative, Negative, Positive, Negative, Positive],
        );
        let folds = [[0, 0], [1, 1], [1, 2], [1, 1], [2, 2], [0, 2]];
        let folded =
            Folded { data: &data, folds: &folds, near_folds: NONE_NEAR, keys: &[1, 9, 3, 8, 5, 2] };
        assert_eq!(training_rows(&folded, [0, 0]), Ok(vec![2, 3]));
        assert_eq!(training_rows(&folded, [0, 2]), Ok(vec![1, 3]));
        // Pair 0 has a smaller key than pair 5.
        assert_eq!(training_rows(&folded, [1, 1]), Ok(vec![0, 4]));
        // Pair 4 is near fold 1 too: no negative pair is left.
        let near_folds: Vec<Vec<u32>> = (0..6).map(|k| [1].repeat((k == 4).into())).collect();
        let folded = Folded { near_folds: &near_folds, ..folded };
        let error = FoldError::OneClass { held_out: [1, 1], n_positive: 2, n_negative: 0 };
        assert_eq!(training_rows(&folded, [1, 1]), Err(error));
        assert_eq!(training_rows(&folded, [0, 0]), Ok(vec![2, 3]));
    }

    #[test]
    fn training_on_one_class_is_an_error() {
        let data = Matrix::new(vec![vec![1.0, 2.0, 3.0]], vec![Positive, Negative, Positive]);
        let folds = [[0, 0], [1, 1], [2, 2]];
        let folded = Folded { data: &data, folds: &folds, near_folds: NONE_NEAR, keys: &[0; 3] };
        let error = cross_validate(Learner::Discrete, 1, &folded).unwrap_err();
        assert_eq!(error, FoldError::OneClass { held_out: [1, 1], n_positive: 2, n_negative: 0 });
        let text = error.to_string();
        assert!(
            text.starts_with("with fold 1 held out, 2 positive and 0 negative pairs"),
            "{text}"
        );
    }
}
