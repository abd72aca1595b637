//! The weak learner of `gentle_line`: a weighted least-squares line through one feature. The paper
//! describes its Algorithm 2 with this weak learner.

use model::WeakLearner;

use crate::gentle::{Fit, WeakFit};

pub(crate) struct Line;

impl WeakFit for Line {
    /// slope = Sxy / Sxx and intercept = mean y - slope mean x, where Sxx and Sxy are about the
    /// weighted means. The line reduces the sum of squares by (mean y)^2 + Sxy^2 / Sxx.
    fn fit(feature: usize, column: &[f64], _rows: &[u32], y: &[f64], weights: &[f64]) -> Fit {
        let (mut mean_x, mut mean_y) = (0.0, 0.0);
        for ((x, y), w) in column.iter().zip(y).zip(weights) {
            mean_x += w * x;
            mean_y += w * y;
        }
        let (mut sxx, mut sxy) = (0.0, 0.0);
        for ((x, y), w) in column.iter().zip(y).zip(weights) {
            let dx = x - mean_x;
            sxx += w * dx * dx;
            sxy += w * dx * (y - mean_y);
        }
        // A feature that is constant wherever the weights are not 0 gets a horizontal line. By
        // rounding, a constant c has an Sxx of about (1e-16 c)^2.
        let is_constant = sxx <= 1e-24 * mean_x * mean_x;
        let slope = if is_constant { 0.0 } else { sxy / sxx };
        Fit {
            weak: WeakLearner::Line { feature, slope, intercept: mean_y - slope * mean_x },
            explained: mean_y * mean_y + slope * sxy,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::matrix::Matrix;
    use dataset::Label::{Negative, Positive};
    use model::WeakLearner;

    /// x = 0 (+), 1 (+), 2 (-), 3 (-), weights 1/4. mean x = 3/2, mean y = 0, Sxx = 5/4,
    /// Sxy = (-3/2 - 1/2 - 1/2 - 3/2) / 4 = -1: slope -4/5, intercept 6/5, residual 1 - 4/5 = 1/5.
    #[test]
    fn four_points_give_the_lines_worked_out_by_hand() {
        let data = Matrix::new(
            vec![vec![5.0; 4], vec![0.0, 1.0, 2.0, 3.0]],
            vec![Positive, Positive, Negative, Negative],
        );
        let rounds = crate::gentle::fit::<super::Line>(2, &data);
        let WeakLearner::Line { feature, slope, intercept } = rounds[0].weak else {
            panic!("expected a line")
        };
        assert_eq!(feature, 1);
        assert!((slope + 0.8).abs() < 1e-12 && (intercept - 1.2).abs() < 1e-12);
        assert!((rounds[0].weighted_error - 0.2).abs() < 1e-12);
        // The values are 1.2, 0.4, -0.4 and -1.2, so by symmetry round 2 has weights proportional to
        // exp(-1.2), exp(-0.4), exp(-0.4), exp(-1.2). With a = e^-1.2 / (2 (e^-1.2 + e^-0.4)) and
        // b = 1/2 - a: Sxx = 2 (9/4 a + 1/4 b), Sxy = -(3 a + b).
        let a = (-1.2f64).exp() / (2.0 * ((-1.2f64).exp() + (-0.4f64).exp()));
        let b = 0.5 - a;
        let expected = -(3.0 * a + b) / (4.5 * a + 0.5 * b);
        let WeakLearner::Line { slope, .. } = rounds[1].weak else { unreachable!() };
        assert!((slope - expected).abs() < 1e-12, "{slope} {expected}");
    }

    #[test]
    fn far_outliers_do_not_overflow() {
        let data = Matrix::new(
            vec![vec![0.0, 1.0, 2.0, 1e9], vec![0.0, 1.0, 0.0, 1.0]],
            vec![Positive, Negative, Positive, Positive],
        );
        let rounds = crate::gentle::fit::<super::Line>(50, &data);
        for round in rounds {
            assert!(round.weighted_error.is_finite());
            let WeakLearner::Line { slope, intercept, .. } = round.weak else { unreachable!() };
            assert!(slope.is_finite() && intercept.is_finite());
        }
    }
}
