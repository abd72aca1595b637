//! The weak learner of `gentle_stump`: a regression stump. Its value on each side of a threshold is
//! the weighted mean of the labels there (Friedman, Hastie and Tibshirani 2000).

use model::WeakLearner;

use crate::TIE;
use crate::gentle::{Fit, WeakFit};
use crate::matrix::midpoint;

pub(crate) struct Stump;

impl WeakFit for Stump {
    /// A side with weight W and weighted label sum S has the mean S / W and reduces the sum of
    /// squares by S^2 / W. If splits are equally good, the lowest threshold is chosen.
    fn fit(feature: usize, column: &[f64], rows: &[u32], y: &[f64], weights: &[f64]) -> Fit {
        let (mut weight, mut sum) = (0.0, 0.0);
        for (w, y) in weights.iter().zip(y) {
            weight += w;
            sum += w * y;
        }
        // Without a split there is one mean for all pairs.
        let mean = sum / weight;
        let no_split = WeakLearner::Step { feature, threshold: 0.0, below: mean, above: mean };
        let mut best = Fit { weak: no_split, explained: sum * mean };
        let (mut weight_below, mut sum_below) = (0.0, 0.0);
        for pair in rows.windows(2) {
            let (row, next) = (pair[0] as usize, pair[1] as usize);
            weight_below += weights[row];
            sum_below += weights[row] * y[row];
            if column[row].total_cmp(&column[next]).is_eq() {
                continue;
            }
            let (weight_above, sum_above) = (weight - weight_below, sum - sum_below);
            if weight_below <= 0.0 || weight_above <= 0.0 {
                continue; // all weight is on one side, so the other side has no mean
            }
            let (below, above) = (sum_below / weight_below, sum_above / weight_above);
            let explained = sum_below * below + sum_above * above;
            if best.explained + TIE < explained
                && let Some(threshold) = midpoint(column[row], column[next])
            {
                // Labels are +-1. Rounding in the differences above must not exceed that range.
                let (below, above) = (below.clamp(-1.0, 1.0), above.clamp(-1.0, 1.0));
                best =
                    Fit { weak: WeakLearner::Step { feature, threshold, below, above }, explained };
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use crate::matrix::Matrix;
    use dataset::Label::{Negative, Positive};
    use model::WeakLearner;

    fn step(weak: WeakLearner) -> (usize, f64, f64, f64) {
        match weak {
            WeakLearner::Step { feature, threshold, below, above } => {
                (feature, threshold, below, above)
            }
            _ => panic!("expected a step"),
        }
    }

    /// x = 1 (+), 2 (-), 3 (+), 4 (-), 5 (-), weights 1/5.
    /// theta 1.5: below 1, above (-1 + 1 - 1 - 1) / 4 = -1/2: explains 1/5 + 4/5 / 4 = 2/5.
    /// theta 2.5: below 0, above -1/3: 1/15. theta 3.5: below 1/3, above -1: 1/15 + 2/5 = 7/15.
    /// theta 4.5: below 0, above -1: 1/5. So theta = 3.5, residual 8/15.
    /// Round 2: weights e^-1/3 for 1 and 3, e^1/3 for 2, e^-1 for 4 and 5.
    #[test]
    fn five_points_give_the_stumps_worked_out_by_hand() {
        let data = Matrix::new(
            vec![vec![1.0, 2.0, 3.0, 4.0, 5.0]],
            vec![Positive, Negative, Positive, Negative, Negative],
        );
        let rounds = crate::gentle::fit::<super::Stump>(2, &data);
        let (feature, threshold, below, above) = step(rounds[0].weak);
        assert_eq!((feature, threshold), (0, 3.5));
        assert!((below - 1.0 / 3.0).abs() < 1e-12 && (above + 1.0).abs() < 1e-12);
        assert!((rounds[0].weighted_error - 8.0 / 15.0).abs() < 1e-12);

        let (p, q, r) = ((-1.0f64 / 3.0).exp(), (1.0f64 / 3.0).exp(), (-1.0f64).exp());
        let total = 2.0 * p + q + 2.0 * r;
        // theta 1.5: below +1 of weight p; above (p - q - 2 r) of weight p + q + 2 r.
        let at_1_5 = (p + (p - q - 2.0 * r).powi(2) / (p + q + 2.0 * r)) / total;
        // theta 3.5: below (2 p - q) of weight 2 p + q; above -1 of weight 2 r.
        let at_3_5 = ((2.0 * p - q).powi(2) / (2.0 * p + q) + 2.0 * r) / total;
        assert!(at_1_5 > at_3_5);
        let (_, threshold, below, above) = step(rounds[1].weak);
        assert_eq!(threshold, 1.5);
        assert!((below - 1.0).abs() < 1e-12);
        assert!((above - (p - q - 2.0 * r) / (p + q + 2.0 * r)).abs() < 1e-12);
        assert!((rounds[1].weighted_error - (1.0 - at_1_5)).abs() < 1e-12);
    }

    #[test]
    fn constant_features_give_no_rounds() {
        let data = Matrix::new(vec![vec![3.0; 2]; 2], vec![Positive, Negative]);
        assert!(crate::gentle::fit::<super::Stump>(5, &data).is_empty());
    }
}
