//! k nearest neighbours with k = 5. The distance is Euclidean, over features normalised on the
//! training fold.
//!
//! The confidence is the mean of the neighbours' labels, -1 to 1. Every pair is compared with every
//! training pair, so this learner suits thousands of pairs, not millions.

use crate::baseline::{normalised, scales};
use crate::matrix::Matrix;

/// Number of neighbours (the paper's k). It is odd, so the vote cannot be a tie.
const K: usize = 5;

/// The confidences of the test rows, `(n_test,)`.
pub(crate) fn confidences(training: &Matrix, test: &Matrix) -> Vec<f64> {
    let n_features = training.columns().len();
    let scales = scales(training);
    let (training_rows, test_rows) = (normalised(training, &scales), normalised(test, &scales));
    let k = K.min(training.n_rows());
    test_rows
        .chunks(n_features)
        .map(|x| {
            let mut neighbours: Vec<(f64, usize)> = training_rows
                .chunks(n_features)
                .map(|y| x.iter().zip(y).map(|(a, b)| (a - b) * (a - b)).sum())
                .zip(0..)
                .collect();
            // If two distances are equal, the earlier row counts as nearer.
            neighbours
                .select_nth_unstable_by(k - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let votes: f64 =
                neighbours[..k].iter().map(|&(_, row)| training.labels()[row].target()).sum();
            votes / k as f64
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Label::{Negative, Positive};

    /// Positives at 0 to 3 and negatives at 10 to 13; the second feature is constant. The five
    /// nearest to 2 are the four positives and the negative at 10. The five nearest to 11 are the
    /// four negatives and the positive at 3.
    #[test]
    fn the_five_nearest_vote() {
        let x: Vec<f64> = [0, 1, 2, 3, 10, 11, 12, 13].map(f64::from).into();
        let labels = [[Positive; 4], [Negative; 4]].concat();
        let training = Matrix::new(vec![x, vec![7.0; 8]], labels);
        let test = Matrix::new(vec![vec![2.0, 11.0], vec![7.0, 99.0]], vec![Positive, Negative]);
        assert_eq!(confidences(&training, &test), [0.6, -0.6]);
    }
}
