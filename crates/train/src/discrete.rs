//! Discrete AdaBoost over decision stumps: the paper's Algorithm 1 (after Viola and Jones 2001,
//! "Rapid object detection using a boosted cascade of simple features", Table 1).
//!
//! ```text
//! w_i = 1 / (2 Np) for positive, 1 / (2 Nn) for negative pairs
//! for t = 1..T:
//!     w_i /= sum of w
//!     (f, theta, p) = argmin of eps = sum of w_i over h(x_i) != y_i,
//!                     h(x) = +1 if p x_f < p theta else -1
//!     beta = eps / (1 - eps);  w_i *= beta where h(x_i) = y_i;  alpha = ln(1 / beta)
//! confidence(x) = sum of alpha_t h_t(x)
//! ```

use dataset::Label;
use model::WeakLearner;
use rayon::prelude::*;

use crate::matrix::{Matrix, midpoint};
use crate::{Round, TIE};

/// Smallest error: an error of 0 is replaced by this value, which gives alpha = 23. The algorithm in
/// the paper would give an infinite alpha.
const MIN_ERROR: f64 = 1e-10;

#[derive(Clone, Copy)]
struct Stump {
    error: f64,
    threshold: f64,
    polarity: f64,
}

pub(crate) fn fit(n_rounds: u32, data: &Matrix) -> Vec<Round> {
    let start = |label| 1.0 / (2.0 * data.count(label) as f64);
    let (positive, negative) = (start(Label::Positive), start(Label::Negative));
    let mut weights: Vec<f64> = data
        .labels()
        .iter()
        .map(|label| if *label == Label::Positive { positive } else { -negative })
        .collect();
    let sorted = data.sorted_rows();
    let mut features: Vec<Feature> =
        sorted.par_iter().zip(data.columns()).map(|(r, c)| Feature::new(r, c, &weights)).collect();
    drop(sorted);
    let mut right = vec![0u64; data.n_rows().div_ceil(64)];
    let mut beta = 1.0;
    let mut rounds = Vec::new();
    for _ in 0..n_rounds {
        let sum: f64 = weights.iter().map(|w| w.abs()).sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        let all = |is_positive: bool| -> f64 {
            weights.iter().filter(|w| w.is_sign_positive() == is_positive).map(|w| w.abs()).sum()
        };
        let totals = (all(true), all(false));
        let stumps: Vec<Option<Stump>> = features
            .par_iter_mut()
            .zip(data.columns())
            .map(|(feature, column)| {
                feature.reweigh(&right, beta, sum);
                feature.best_stump(column, totals)
            })
            .collect();
        let Some((feature, stump)) = best(&stumps) else { break };
        if 0.5 <= stump.error {
            break;
        }
        let error = stump.error.max(MIN_ERROR);
        beta = error / (1.0 - error);
        let weak = WeakLearner::Vote {
            feature,
            threshold: stump.threshold,
            polarity: stump.polarity,
            alpha: libm::log(1.0 / beta),
        };
        right.fill(0);
        let rows = weights.iter_mut().zip(data.column(feature)).zip(data.labels());
        for (row, ((w, &x), label)) in rows.enumerate() {
            if Label::from_confidence(weak.value_of(|_| x), 0.0) == *label {
                *w *= beta;
                right[row / 64] |= 1 << (row % 64);
            }
        }
        rounds.push(Round { weak, weighted_error: stump.error });
    }
    rounds
}

/// The pairs in ascending order of one feature, with a copy of the weights in that order. A search
/// then reads memory in order; per pair it looks up one bit only.
struct Feature {
    /// The row of each pair. [`LAST`] is set if the next pair has another value.
    rows: Vec<u32>,
    /// The weight of each pair, negative for negative pairs. The bits are those of the weights by
    /// row.
    weights: Vec<f64>,
}

/// Marks the last of several equal values.
const LAST: u32 = 1 << 31;

impl Feature {
    fn new(sorted: &[u32], column: &[f64], weights: &[f64]) -> Self {
        assert!(sorted.len() < LAST as usize, "a row number has 31 bits");
        let mut rows = sorted.to_vec();
        for (k, pair) in sorted.windows(2).enumerate() {
            if !column[pair[0] as usize].total_cmp(&column[pair[1] as usize]).is_eq() {
                rows[k] |= LAST;
            }
        }
        Self { rows, weights: sorted.iter().map(|&row| weights[row as usize]).collect() }
    }

    /// Updates the weights in the same steps as the weights by row: multiplied by beta if the last
    /// stump was right, then divided by the sum.
    fn reweigh(&mut self, right: &[u64], beta: f64, sum: f64) {
        let factors = [1.0, beta];
        for (w, row) in self.weights.iter_mut().zip(&self.rows) {
            let row = row & !LAST;
            let is_right = right[row as usize / 64] >> (row % 64) & 1;
            *w = *w * factors[is_right as usize] / sum;
        }
    }

    /// Tries every midpoint between neighbouring values. If errors are equal, the lowest threshold
    /// is chosen, then polarity +1. `None` if all values are equal.
    ///
    /// Let S be the sum of the signed weights below a threshold. A stump that calls pairs below it
    /// positive is wrong for negatives below and positives above: its error is (all positives) - S.
    /// The opposite stump has the error (all negatives) + S.
    fn best_stump(&self, column: &[f64], totals: (f64, f64)) -> Option<Stump> {
        let (all_positive, all_negative) = totals;
        let mut sum_below = 0.0;
        let mut best: Option<Stump> = None;
        let mut to_beat = f64::INFINITY;
        for (k, (&w, &row)) in self.weights.iter().zip(&self.rows).enumerate() {
            sum_below += w;
            let (below, above) = (all_positive - sum_below, all_negative + sum_below);
            if row & LAST == 0 || to_beat <= below.min(above) {
                continue;
            }
            let (error, polarity) = if above < below - TIE { (above, -1.0) } else { (below, 1.0) };
            let value = |row: u32| column[(row & !LAST) as usize];
            if error < to_beat
                && let Some(threshold) = midpoint(value(row), value(self.rows[k + 1]))
            {
                to_beat = error - TIE;
                best = Some(Stump { error: error.max(0.0), threshold, polarity });
            }
        }
        best
    }
}

/// The stump with the least error; if errors are equal, that of the first feature.
fn best(stumps: &[Option<Stump>]) -> Option<(usize, Stump)> {
    let mut best: Option<(usize, Stump)> = None;
    for (feature, stump) in stumps.iter().enumerate() {
        if let Some(stump) = stump
            && best.is_none_or(|(_, best)| stump.error < best.error - TIE)
        {
            best = Some((feature, *stump));
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    fn vote(round: &Round) -> (usize, f64, f64, f64) {
        match round.weak {
            WeakLearner::Vote { feature, threshold, polarity, alpha } => {
                (feature, threshold, polarity, alpha)
            }
            _ => panic!("expected a vote"),
        }
    }

    /// x = 1 (+), 2 (-), 3 (+), 4 (-), each with weight 1/4.
    ///
    /// Round 1. theta 1.5, p = +1: 3 is wrong, eps = 1/4. theta 2.5: 2 and 3 are wrong, 1/2.
    /// theta 3.5, p = +1: 2 is wrong, 1/4. The lower of the two thresholds is chosen: theta = 1.5,
    /// beta = 1/3, alpha = ln 3. The weights become 1/12, 1/12, 1/4, 1/12. Their sum is 1/2, so
    /// they are normalised to 1/6, 1/6, 1/2, 1/6.
    /// Round 2. theta 1.5: 1/2. theta 2.5, p = -1 (positive above): 1 and 4 are wrong, 1/3.
    /// theta 3.5, p = +1: 2 is wrong, 1/6. This one is chosen: beta = 1/5, alpha = ln 5.
    /// The confidences: 1: ln 3 + ln 5; 2: -ln 3 + ln 5 (wrong); 3: the same (right);
    /// 4: -ln 3 - ln 5. A third round would be needed for 2.
    #[test]
    fn four_alternating_points_give_the_rounds_worked_out_by_hand() {
        let data = Matrix::new(
            vec![vec![1.0, 2.0, 3.0, 4.0]],
            vec![Positive, Negative, Positive, Negative],
        );
        let rounds = fit(2, &data);
        let (feature, threshold, polarity, alpha) = vote(&rounds[0]);
        assert_eq!((feature, threshold, polarity), (0, 1.5, 1.0));
        assert!((alpha - 3f64.ln()).abs() < 1e-12);
        assert!((rounds[0].weighted_error - 0.25).abs() < 1e-15);
        let (feature, threshold, polarity, alpha) = vote(&rounds[1]);
        assert_eq!((feature, threshold, polarity), (0, 3.5, 1.0));
        assert!((alpha - 5f64.ln()).abs() < 1e-12);
        assert!((rounds[1].weighted_error - 1.0 / 6.0).abs() < 1e-15);
        let classifier = crate::classifier(model::Learner::Discrete, &rounds);
        let confidences: Vec<f64> =
            [1.0, 2.0, 3.0, 4.0].map(|x| classifier.confidence(&[x])).into();
        let (ln3, ln5) = (3f64.ln(), 5f64.ln());
        for (found, expected) in
            confidences.iter().zip([ln3 + ln5, ln5 - ln3, ln5 - ln3, -ln3 - ln5])
        {
            assert!((found - expected).abs() < 1e-12);
        }
    }

    /// Each class starts with half of the weight: 1/2 for the one positive, 1/6 for each negative.
    /// x = 1 (-), 2 (+), 3 (-), 4 (-). theta 1.5, p = +1: 1/6 + 1/2; p = -1 (positive above):
    /// 3 and 4 are wrong, 1/3. theta 2.5, p = +1: 1 is wrong, 1/6. theta 3.5, p = +1: 1/3.
    #[test]
    fn one_positive_has_the_weight_of_three_negatives() {
        let data = Matrix::new(
            vec![vec![1.0, 2.0, 3.0, 4.0]],
            vec![Negative, Positive, Negative, Negative],
        );
        let rounds = fit(1, &data);
        assert!((rounds[0].weighted_error - 1.0 / 6.0).abs() < 1e-15);
        assert_eq!(vote(&rounds[0]).1, 2.5);
    }

    /// Two features split equally well: the first one is chosen. The polarity is -1 because the
    /// positives are above.
    #[test]
    fn a_tie_goes_to_the_first_feature_and_the_polarity_follows_the_data() {
        let column = vec![1.0, 2.0, 3.0, 4.0];
        let labels = vec![Negative, Negative, Positive, Positive];
        let data = Matrix::new(vec![vec![7.0; 4], column.clone(), column], labels);
        let rounds = fit(3, &data);
        let (feature, threshold, polarity, alpha) = vote(&rounds[0]);
        assert_eq!((feature, threshold, polarity), (1, 2.5, -1.0));
        // An eps of 0 is replaced by 1e-10.
        assert!((alpha - ((1.0 - 1e-10) / 1e-10f64).ln()).abs() < 1e-9);
        assert_eq!(rounds[0].weighted_error, 0.0);
        assert_eq!(
            vote(&rounds[1]).0,
            1,
            "no pair is wrong, so the weights and the choice stay the same"
        );
    }

    /// Both classes have the same values, so no stump is better than chance.
    #[test]
    fn training_stops_when_no_stump_is_better_than_chance() {
        let labels = vec![Positive, Negative, Positive, Negative];
        assert!(fit(5, &Matrix::new(vec![vec![1.0, 1.0, 2.0, 2.0]], labels.clone())).is_empty());
        assert!(fit(5, &Matrix::new(vec![vec![1.0; 4]], labels)).is_empty(), "a constant");
    }

    /// If alpha1 > alpha2, two rounds give the same labels as the first one.
    #[test]
    fn two_rounds_give_the_labels_of_the_first_if_its_alpha_is_larger() {
        // x = 1 to 8, + + + - - - - +. Round 1: theta 3.5, 8 is wrong, eps = 1/8, alpha = ln 7.
        // Round 2: 8 has weight 1/2, the others 1/14. theta 7.5, positive above, is wrong for 1, 2
        // and 3: eps = 3/14, alpha = ln(11/3).
        let labels = [[Positive; 3].as_slice(), &[Negative; 4], &[Positive]].concat();
        let columns = vec![(1..=8).map(f64::from).collect()];
        let data = Matrix::new(columns, labels);
        let rounds = fit(2, &data);
        assert!((vote(&rounds[0]).3 - 7f64.ln()).abs() < 1e-12);
        assert!((vote(&rounds[1]).3 - (11f64 / 3.0).ln()).abs() < 1e-12);
        assert_eq!(vote(&rounds[1]).1, 7.5);
        let classifier = crate::classifier(model::Learner::Discrete, &rounds);
        for row in 0..8 {
            let difference = [data.column(0)[row]];
            let staged: Vec<f64> = classifier.staged_confidences(&difference).collect();
            assert_eq!(
                Label::from_confidence(staged[0], 0.0),
                Label::from_confidence(staged[1], 0.0)
            );
        }
    }
}
