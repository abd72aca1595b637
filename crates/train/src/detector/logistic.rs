//! Logistic regression whose weights are 0 or more, by a projected Newton method (Bertsekas 1982,
//! "Projected Newton methods for optimization problems with simple constraints").

use nalgebra::{DMatrix, DVector};

/// Penalty: half of this times the sum of the squared weights, for features divided by their standard
/// deviation, is added to the mean log loss. It keeps the weights finite where the classes are separated.
/// scikit-learn's `C` is 1 / (n x penalty) for n rows of weight 1.
pub(super) const PENALTY: f64 = 1e-3;
/// The gradient of a solution is below this. The loss is of the order of 1.
const TOLERANCE: f64 = 1e-10;
/// Newton's method needs about 10 iterations.
const MAX_ITERATIONS: u32 = 200;

/// A row: features, whether it is positive, and its weight.
pub(super) struct Row<const N: usize> {
    pub(super) features: [f64; N],
    pub(super) is_positive: bool,
    pub(super) weight: f64,
}

/// Probability of a positive row: the logistic function of `intercept` plus the weighted features.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Logistic<const N: usize> {
    pub(super) intercept: f64,
    /// All 0 or more.
    pub(super) weights: [f64; N],
}

impl<const N: usize> Logistic<N> {
    /// The fit with the smallest mean log loss plus [`PENALTY`]. The intercept is not penalized, so there
    /// must be rows of both classes. A feature with one value for all rows has the weight 0.
    pub(super) fn fit(rows: &[Row<N>]) -> Self {
        let problem = Problem::new(rows);
        let scaled = problem.solve();
        let mut fitted = Self { intercept: scaled[0], weights: [0.0; N] };
        for k in 0..N {
            fitted.weights[k] = scaled[k + 1] * problem.inverse_std[k];
            fitted.intercept -= fitted.weights[k] * problem.mean[k];
        }
        fitted
    }

    fn logit(&self, features: &[f64; N]) -> f64 {
        let terms = self.weights.iter().zip(features).map(|(weight, feature)| weight * feature);
        self.intercept + terms.sum::<f64>()
    }

    /// The weighted mean of `-ln(p)`, where `p` is the probability of what each row is.
    pub(super) fn log_loss(&self, rows: &[Row<N>]) -> f64 {
        let total: f64 = rows.iter().map(|row| row.weight).sum();
        let losses = rows.iter().map(|row| {
            let logit = self.logit(&row.features);
            row.weight * softplus(if row.is_positive { -logit } else { logit })
        });
        losses.sum::<f64>() / total
    }
}

/// `ln(1 + exp(x))` without overflow.
fn softplus(x: f64) -> f64 {
    x.max(0.0) + libm::log1p(libm::exp(-x.abs()))
}

/// Rows with standardized features.
struct Problem<'a, const N: usize> {
    rows: &'a [Row<N>],
    total: f64,
    mean: [f64; N],
    /// 0 for a constant feature.
    inverse_std: [f64; N],
}

impl<'a, const N: usize> Problem<'a, N> {
    fn new(rows: &'a [Row<N>]) -> Self {
        let total: f64 = rows.iter().map(|row| row.weight).sum();
        let mean_of = |of: &dyn Fn(&Row<N>) -> f64| {
            rows.iter().map(|row| row.weight * of(row)).sum::<f64>() / total
        };
        let mean: [f64; N] = std::array::from_fn(|k| mean_of(&|row| row.features[k]));
        let inverse_std = std::array::from_fn(|k| {
            let variance = mean_of(&|row| (row.features[k] - mean[k]).powi(2));
            // Below this, the values differ by rounding only.
            let is_constant = variance <= 1e-18 * (1.0 + mean[k] * mean[k]);
            if is_constant { 0.0 } else { 1.0 / variance.sqrt() }
        });
        Self { rows, total, mean, inverse_std }
    }

    /// Intercept and scaled weights.
    fn solve(&self) -> DVector<f64> {
        let mut solution = DVector::zeros(N + 1);
        for _ in 0..MAX_ITERATIONS {
            let (value, gradient, hessian) = self.derivatives(&solution);
            let is_free = |k: usize| k == 0 || 0.0 < solution[k] || gradient[k] < 0.0;
            let free: Vec<usize> = (0..=N).filter(|&k| is_free(k)).collect();
            if free.iter().all(|&k| gradient[k].abs() < TOLERANCE) {
                break;
            }
            let reduced =
                DMatrix::from_fn(free.len(), free.len(), |a, b| hessian[(free[a], free[b])]);
            let Some(cholesky) = reduced.cholesky() else { break };
            let step = cholesky.solve(&DVector::from_fn(free.len(), |k, _| -gradient[free[k]]));
            let along = |share: f64| {
                let mut next = solution.clone();
                for (&k, step) in free.iter().zip(step.iter()) {
                    let moved = next[k] + share * step;
                    next[k] = if k == 0 { moved } else { moved.max(0.0) };
                }
                next
            };
            // Halve the step until the value falls by a part of what the gradient promises (Armijo).
            let falls = |next: &DVector<f64>| {
                self.value(next) <= value + 1e-4 * gradient.dot(&(next - &solution))
            };
            let Some(next) = (0..60).map(|k| along(0.5f64.powi(k))).find(falls) else { break };
            if next == solution {
                break;
            }
            solution = next;
        }
        solution
    }

    fn standardized(&self, row: &Row<N>) -> [f64; N] {
        std::array::from_fn(|k| (row.features[k] - self.mean[k]) * self.inverse_std[k])
    }

    fn value(&self, solution: &DVector<f64>) -> f64 {
        let losses = self.rows.iter().map(|row| {
            let features = self.standardized(row);
            let logit = solution[0] + (0..N).map(|k| solution[k + 1] * features[k]).sum::<f64>();
            row.weight * softplus(if row.is_positive { -logit } else { logit })
        });
        let penalty: f64 = solution.iter().skip(1).map(|weight| weight * weight).sum();
        losses.sum::<f64>() / self.total + 0.5 * PENALTY * penalty
    }

    /// Value, gradient and Hessian.
    fn derivatives(&self, solution: &DVector<f64>) -> (f64, DVector<f64>, DMatrix<f64>) {
        let mut gradient = DVector::zeros(N + 1);
        let mut hessian = DMatrix::zeros(N + 1, N + 1);
        for row in self.rows {
            let mut x = DVector::from_element(N + 1, 1.0);
            x.rows_mut(1, N).copy_from_slice(&self.standardized(row));
            let probability = 1.0 / (1.0 + libm::exp(-x.dot(solution)));
            let weight = row.weight / self.total;
            let error = probability - f64::from(u8::from(row.is_positive));
            gradient.axpy(weight * error, &x, 1.0);
            hessian.ger(weight * probability * (1.0 - probability), &x, &x, 1.0);
        }
        for k in 1..=N {
            gradient[k] += PENALTY * solution[k];
            hessian[(k, k)] += PENALTY;
        }
        // The intercept of separated classes has almost no curvature.
        hessian[(0, 0)] += 1e-12;
        (self.value(solution), gradient, hessian)
    }
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    fn uniform(random: &mut SplitMix64) -> f64 {
        (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Rows that are positive with the probability of a logistic function.
    fn rows(n: usize, seed: u64, intercept: f64, weights: [f64; 3]) -> Vec<Row<3>> {
        let mut random = SplitMix64::new(seed);
        let row = |_| {
            let features = [(); 3].map(|()| uniform(&mut random));
            let logit = Logistic { intercept, weights }.logit(&features);
            let is_positive = uniform(&mut random) < 1.0 / (1.0 + (-logit).exp());
            Row { features, is_positive, weight: 1.0 }
        };
        (0..n).map(row).collect()
    }

    /// 20,000 rows: the standard errors of the weights are about 0.1. The penalty makes them about 2 %
    /// smaller: 1e-3, compared with a curvature of about 0.1 x (1 - 0.1).
    #[test]
    fn the_weights_of_simulated_rows_are_found() {
        let fitted = Logistic::fit(&rows(20_000, 1, -3.0, [4.0, 2.0, 0.0]));
        assert!((fitted.weights[0] - 4.0).abs() < 0.35, "{fitted:?}");
        assert!((fitted.weights[1] - 2.0).abs() < 0.3, "{fitted:?}");
        assert!(fitted.weights[2] < 0.2, "{fitted:?}");
        assert!((fitted.intercept + 3.0).abs() < 0.3, "{fitted:?}");
    }

    /// The third feature speaks against a positive row, so its weight is 0, and the others are those of a
    /// fit without it.
    #[test]
    fn a_weight_of_the_wrong_sign_is_zero() {
        let rows = rows(2000, 2, -1.0, [3.0, 1.0, -2.0]);
        let fitted = Logistic::fit(&rows);
        assert_eq!(fitted.weights[2].to_bits(), 0f64.to_bits());
        let without = |row: &Row<3>| Row {
            features: [row.features[0], row.features[1]],
            is_positive: row.is_positive,
            weight: row.weight,
        };
        let smaller = Logistic::<2>::fit(&rows.iter().map(without).collect::<Vec<_>>());
        for k in 0..2 {
            assert!((fitted.weights[k] - smaller.weights[k]).abs() < 1e-7);
        }
    }

    /// At the optimum, the derivative of the penalized loss by each positive weight is 0, computed by
    /// differences.
    #[test]
    fn the_fit_is_a_minimum() {
        let rows = rows(300, 3, -2.0, [3.0, 2.0, 1.0]);
        let problem = Problem::new(&rows);
        let solution = problem.solve();
        for k in 0..4 {
            for step in [-1e-3, 1e-3] {
                let mut moved = solution.clone();
                moved[k] += step;
                assert!(problem.value(&solution) < problem.value(&moved), "{k} {step}");
            }
        }
    }

    /// A feature of 0 or 1 separates the classes. Standardized, it is -1 or 1, so the weight w minimizes
    /// ln(1 + exp(-w)) + 0.0005 w^2: w = 1000 / (1 + exp(w)), whose solution is 5.2310.
    #[test]
    fn separated_classes_have_finite_weights() {
        let row = |is_positive: bool| Row {
            features: [f64::from(u8::from(is_positive)), 7.0],
            is_positive,
            weight: 0.25,
        };
        let rows: Vec<Row<2>> = [true, false, true, false].map(row).into();
        let fitted = Logistic::fit(&rows);
        let scaled = fitted.weights[0] / 2.0;
        assert!((scaled - 1000.0 / (1.0 + scaled.exp())).abs() < 1e-4, "{scaled}");
        assert!((fitted.intercept + scaled).abs() < 1e-6, "the middle is at 0.5");
        assert_eq!(fitted.weights[1].to_bits(), 0f64.to_bits(), "a constant feature");
    }

    /// A row of weight 3 counts like three rows.
    #[test]
    fn weights_of_rows_count_like_copies() {
        let weighted: Vec<Row<3>> = rows(100, 4, -1.0, [2.0, 1.0, 1.0])
            .into_iter()
            .enumerate()
            .map(|(k, row)| Row { weight: if k % 2 == 0 { 3.0 } else { 1.0 }, ..row })
            .collect();
        let copies: Vec<Row<3>> = weighted
            .iter()
            .flat_map(|row| (0..row.weight as usize).map(|_| Row { weight: 1.0, ..*row }))
            .collect();
        let [a, b] = [&weighted, &copies].map(|rows| Logistic::fit(rows));
        assert!((a.intercept - b.intercept).abs() < 1e-8);
        assert!((a.log_loss(&weighted) - b.log_loss(&copies)).abs() < 1e-12);
    }
}
