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

/// An error of 0 is taken for this, which makes alpha = 23; the algorithm leaves it infinite.
const MIN_ERROR: f64 = 1e-10;

#[derive(Clone, Copy)]
struct Stump {
    error: f64,
    threshold: f64,
    polarity: f64,
}

pub(crate) fn fit(n_rounds: u32, data: &Matrix) -> Vec<Round> {
    let sorted = data.sorted_rows();
    let start = |label| 1.0 / (2.0 * data.count(label) as f64);
    let (positive, negative) = (start(Label::Positive), start(Label::Negative));
    let mut weights: Vec<f64> = data
        .labels()
        .iter()
        .map(|label| if *label == Label::Positive { positive } else { negative })
        .collect();
    let mut rounds = Vec::new();
    for _ in 0..n_rounds {
        let sum: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= sum);
        let stumps: Vec<Option<Stump>> = sorted
            .par_iter()
            .enumerate()
            .map(|(feature, rows)| best_stump(data.column(feature), rows, data.labels(), &weights))
            .collect();
        let Some((feature, stump)) = best(&stumps) else { break };
        if 0.5 <= stump.error {
            break;
        }
        let error = stump.error.max(MIN_ERROR);
        let beta = error / (1.0 - error);
        let weak = WeakLearner::Vote {
            feature,
            threshold: stump.threshold,
            polarity: stump.polarity,
            alpha: libm::log(1.0 / beta),
        };
        for ((w, &x), label) in weights.iter_mut().zip(data.column(feature)).zip(data.labels()) {
            if Label::from_confidence(weak.value_of(|_| x), 0.0) == *label {
                *w *= beta;
            }
        }
        rounds.push(Round { weak, weighted_error: stump.error });
    }
    rounds
}

/// The stump of the least error; of equal ones the first feature's.
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

/// Tries every midpoint between neighbouring values; of equal errors the lowest threshold stays,
/// and of the two polarities +1. None where all values are equal.
fn best_stump(column: &[f64], rows: &[u32], labels: &[Label], weights: &[f64]) -> Option<Stump> {
    let weight_of = |wanted: Label| {
        labels.iter().zip(weights).filter(|(l, _)| **l == wanted).map(|(_, w)| w).sum::<f64>()
    };
    let (all_positive, all_negative) = (weight_of(Label::Positive), weight_of(Label::Negative));
    let (mut positive_below, mut negative_below) = (0.0, 0.0);
    let mut best: Option<Stump> = None;
    for pair in rows.windows(2) {
        let (row, next) = (pair[0] as usize, pair[1] as usize);
        match labels[row] {
            Label::Positive => positive_below += weights[row],
            Label::Negative => negative_below += weights[row],
        }
        if column[row].total_cmp(&column[next]).is_eq() {
            continue;
        }
        // Polarity +1 says "positive below": wrong are negatives below and positives above.
        let below = negative_below + (all_positive - positive_below);
        let above = positive_below + (all_negative - negative_below);
        let (error, polarity) = if above < below - TIE { (above, -1.0) } else { (below, 1.0) };
        if best.is_none_or(|best| error < best.error - TIE)
            && let Some(threshold) = midpoint(column[row], column[next])
        {
            best = Some(Stump { error: error.max(0.0), threshold, polarity });
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
            _ => panic!("discrete gives votes"),
        }
    }

    /// On paper: x = 1 (+), 2 (-), 3 (+), 4 (-), each of weight 1/4.
    ///
    /// theta 1.5, p = +1: 3 is wrong, eps = 1/4. theta 2.5: 2 and 3 wrong, 1/2.
    /// theta 3.5, p = +1: 2 is wrong, 1/4. The lower threshold of the two stays: theta = 1.5,
    /// beta = 1/3, alpha = ln 3. The weights become 1/12, 1/12, 1/4, 1/12 of sum 1/2, that is
    /// 1/6, 1/6, 1/2, 1/6.
    /// Round 2: theta 1.5: 1/2. theta 2.5, p = -1 (positive above): 1 and 4 wrong, 1/3.
    /// theta 3.5, p = +1: 2 wrong, 1/6: chosen, beta = 1/5, alpha = ln 5.
    /// Together: 1: ln 3 + ln 5; 2: -ln 3 + ln 5 (wrong); 3 likewise (right);
    /// 4: -ln 3 - ln 5. Without the third round 2 stays wrong.
    #[test]
    fn four_points_that_alternate() {
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

    /// Unequal classes start with equal halves: 1/2 for the one positive, 1/6 for each negative.
    /// x = 1 (-), 2 (+), 3 (-), 4 (-). theta 1.5, p = +1: 1/6 + 1/2; p = -1 (positive above):
    /// 3 and 4 are wrong, 1/3. theta 2.5, p = +1: 1 wrong, 1/6. theta 3.5, p = +1: 1/3.
    #[test]
    fn one_positive_weighs_as_much_as_three_negatives() {
        let data = Matrix::new(
            vec![vec![1.0, 2.0, 3.0, 4.0]],
            vec![Negative, Positive, Negative, Negative],
        );
        let rounds = fit(1, &data);
        assert!((rounds[0].weighted_error - 1.0 / 6.0).abs() < 1e-15);
        assert_eq!(vote(&rounds[0]).1, 2.5);
    }

    /// Two features that split equally well: the first stays. Polarity -1 where positives are above.
    #[test]
    fn ties_go_to_the_first_feature_and_polarity_follows_the_data() {
        let column = vec![1.0, 2.0, 3.0, 4.0];
        let labels = vec![Negative, Negative, Positive, Positive];
        let data = Matrix::new(vec![vec![7.0; 4], column.clone(), column], labels);
        let rounds = fit(3, &data);
        let (feature, threshold, polarity, alpha) = vote(&rounds[0]);
        assert_eq!((feature, threshold, polarity), (1, 2.5, -1.0));
        // eps = 0 is taken for 1e-10.
        assert!((alpha - ((1.0 - 1e-10) / 1e-10f64).ln()).abs() < 1e-9);
        assert_eq!(rounds[0].weighted_error, 0.0);
        assert_eq!(vote(&rounds[1]).0, 1, "all right: the weights, and so the choice, stay");
    }

    /// Equal values of both classes: no stump is better than chance.
    #[test]
    fn it_stops_where_nothing_is_better_than_chance() {
        let labels = vec![Positive, Negative, Positive, Negative];
        assert!(fit(5, &Matrix::new(vec![vec![1.0, 1.0, 2.0, 2.0]], labels.clone())).is_empty());
        assert!(fit(5, &Matrix::new(vec![vec![1.0; 4]], labels)).is_empty(), "a constant");
    }

    /// Where alpha1 > alpha2, two rounds label as the first one does.
    #[test]
    fn two_rounds_label_as_one_where_the_first_vote_weighs_more() {
        // x = 1 to 8, + + + - - - - +. Round 1: theta 3.5, 8 is wrong, eps = 1/8, alpha = ln 7.
        // Round 2: 8 weighs 1/2, the others 1/14; theta 7.5, positive above, is wrong for 1, 2
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
