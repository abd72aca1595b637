//! Gentle AdaBoost: the paper's Algorithm 2 (Friedman, Hastie and Tibshirani 2000, "Additive
//! logistic regression: a statistical view of boosting", Algorithm 4).
//!
//! ```text
//! w_i = 1 / N
//! for t = 1..T:
//!     f_t = weighted least-squares fit of y to one feature, the feature with the least residual
//!     w_i *= exp(-y_i f_t(x_i));  w_i /= sum of w
//! confidence(x) = sum of f_t(x)
//! ```

use model::WeakLearner;
use rayon::prelude::*;

use crate::matrix::Matrix;
use crate::{Round, TIE};

/// Fits a weak learner to one feature by least squares.
pub(crate) trait WeakFit {
    /// Fits `y` to `column` under weights that sum to 1. `rows` are in ascending order of the
    /// column.
    fn fit(feature: usize, column: &[f64], rows: &[u32], y: &[f64], weights: &[f64]) -> Fit;
}

#[derive(Clone, Copy)]
pub(crate) struct Fit {
    pub(crate) weak: WeakLearner,
    /// By how much the fit reduces the weighted sum of squares of `y` about 0.
    pub(crate) explained: f64,
}

pub(crate) fn fit<W: WeakFit>(n_rounds: u32, data: &Matrix) -> Vec<Round> {
    let sorted = data.sorted_rows();
    let is_constant = |rows: &Vec<u32>, column: &[f64]| match (rows.first(), rows.last()) {
        (Some(&a), Some(&b)) => column[a as usize].total_cmp(&column[b as usize]).is_eq(),
        _ => true,
    };
    if sorted.iter().zip(data.columns()).all(|(rows, column)| is_constant(rows, column)) {
        return Vec::new();
    }
    let y: Vec<f64> = data.labels().iter().map(|label| label.target()).collect();
    // The weight w_i is proportional to exp(-y_i F(x_i)). Subtracting the least margin keeps the
    // exponentials from overflowing, even for lines with very large values.
    let mut margins = vec![0.0; y.len()];
    let mut weights = vec![0.0; y.len()];
    let mut rounds = Vec::with_capacity(n_rounds as usize);
    for _ in 0..n_rounds {
        let least = margins.iter().copied().fold(f64::INFINITY, f64::min);
        for (w, margin) in weights.iter_mut().zip(&margins) {
            *w = libm::exp(least - margin);
        }
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        let fits: Vec<Fit> = sorted
            .par_iter()
            .enumerate()
            .map(|(feature, rows)| W::fit(feature, data.column(feature), rows, &y, &weights))
            .collect();
        let mut best = fits[0];
        for fit in &fits[1..] {
            if best.explained + TIE < fit.explained {
                best = *fit;
            }
        }
        for (row, (margin, y)) in margins.iter_mut().zip(&y).enumerate() {
            *margin += y * best.weak.value_of(|feature| data.column(feature)[row]);
        }
        // The weighted sum of squares of y = +-1 about 0 is 1.
        rounds.push(Round { weak: best.weak, weighted_error: (1.0 - best.explained).max(0.0) });
    }
    rounds
}
