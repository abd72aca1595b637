//! A linear support vector machine over features normalised on the training fold:
//!
//! ```text
//! min over w of  1/2 |w|^2 + C sum of max(0, 1 - y_i w.x_i)^2      x_i with a 1 appended, C = 1
//! ```
//!
//! This is the default problem of LIBLINEAR: squared hinge loss, with the bias regularised like the
//! other weights (Fan et al. 2008, "LIBLINEAR: a library for large linear classification"). The
//! objective is strictly convex, so there is exactly one solution. With few features, a few Newton
//! steps reach it up to rounding (Keerthi and DeCoste 2005, "A modified finite Newton method for
//! fast solution of large scale linear SVMs").

use nalgebra::{DMatrix, DVector};

use crate::baseline::{normalised, scales};
use crate::matrix::Matrix;

/// Weight of the loss.
const C: f64 = 1.0;
/// Largest number of Newton steps. A few are enough; the limit guards against rounding problems.
const MAX_STEPS: usize = 100;
/// Stop when a step is shorter than this: it no longer changes the result noticeably.
const MIN_STEP: f64 = 1e-10;

/// The fitted machine.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Linear {
    /// The mean and the factor of each feature on the training rows.
    scales: Vec<(f64, f64)>,
    /// The weights; the bias is the last one.
    w: Vec<f64>,
}

impl Linear {
    pub(crate) fn fit(training: &Matrix) -> Self {
        let scales = scales(training);
        let y: Vec<f64> = training.labels().iter().map(|label| label.target()).collect();
        let w = fit(&normalised(training, &scales), &y, scales.len());
        Self { scales, w: w.iter().copied().collect() }
    }

    /// The confidence w.x of a pair with these feature differences.
    pub(crate) fn confidence(&self, difference: &[f64]) -> f64 {
        let products = self
            .scales
            .iter()
            .zip(&self.w)
            .zip(difference)
            .map(|((&(mean, factor), w), f)| (f - mean) * factor * w);
        products.sum::<f64>() + self.w[difference.len()]
    }
}

fn decision(w: &DVector<f64>, x: &[f64]) -> f64 {
    x.iter().zip(w.iter()).map(|(x, w)| x * w).sum::<f64>() + w[x.len()]
}

/// The weights, `(n_features + 1,)`; the bias is the last one.
fn fit(rows: &[f64], y: &[f64], n_features: usize) -> DVector<f64> {
    let n = n_features + 1;
    let mut w = DVector::zeros(n);
    let mut loss = objective(&w, rows, y, n_features);
    for _ in 0..MAX_STEPS {
        // Gradient w - 2 C sum (1 - y w.x) y x and Hessian 1 + 2 C sum x x'. Both sums run over the
        // rows inside the margin.
        let mut gradient = w.clone();
        let mut hessian = DMatrix::identity(n, n);
        for (x, &y) in rows.chunks(n_features).zip(y) {
            let slack = 1.0 - y * decision(&w, x);
            if slack > 0.0 {
                let x = DVector::from_iterator(n, x.iter().copied().chain([1.0]));
                gradient.axpy(-2.0 * C * slack * y, &x, 1.0);
                hessian.ger(2.0 * C, &x, &x, 1.0);
            }
        }
        // The Hessian is the identity plus squares, so it always has a Cholesky factor.
        let Some(factor) = hessian.cholesky() else { break };
        let step = factor.solve(&gradient);
        let mut share = 1.0;
        let (mut next, mut next_loss) = (w.clone(), f64::INFINITY);
        while next_loss > loss && share > 1e-12 {
            next = &w - share * &step;
            next_loss = objective(&next, rows, y, n_features);
            share *= 0.5;
        }
        if next_loss > loss {
            break;
        }
        (w, loss) = (next, next_loss);
        if step.norm() < MIN_STEP {
            break;
        }
    }
    w
}

fn objective(w: &DVector<f64>, rows: &[f64], y: &[f64], n_features: usize) -> f64 {
    let losses = rows.chunks(n_features).zip(y).map(|(x, y)| {
        let slack = (1.0 - y * decision(w, x)).max(0.0);
        slack * slack
    });
    0.5 * w.norm_squared() + C * losses.sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// x = 1 (+) and -1 (-). By symmetry the bias is 0, and 1/2 w^2 + 2 (1 - w)^2 is least where
    /// w = 4 (1 - w), at w = 4/5.
    #[test]
    fn two_points_give_the_weights_worked_out_by_hand() {
        let w = fit(&[1.0, -1.0], &[1.0, -1.0], 1);
        assert!((w[0] - 0.8).abs() < 1e-12 && w[1].abs() < 1e-12, "{w}");
    }

    /// Two points at x = 1 (+) and one at -1 (-). With u = 1 - w - b and v = 1 - w + b, the gradient
    /// is zero where w = 4 u + 2 v and b = 4 u - 2 v. That is w = 6 - 6 w - 2 b and
    /// b = 2 - 2 w - 6 b, or 7 w + 2 b = 6 and 2 w + 7 b = 2: w = 38/45 and b = 2/45.
    #[test]
    fn unequal_classes_give_the_weights_worked_out_by_hand() {
        let w = fit(&[1.0, 1.0, -1.0], &[1.0, 1.0, -1.0], 1);
        assert!((w[0] - 38.0 / 45.0).abs() < 1e-12 && (w[1] - 2.0 / 45.0).abs() < 1e-12, "{w}");
    }
}
