//! Retrieval at natural prevalence: measures of a ranking of millions of pairs, few of them
//! positive.

use dataset::RetrievalPoint;
use rayon::prelude::*;

use crate::metrics::{Measures, ThresholdSweep};

/// Approximate number of points of a curve.
const MAX_POINTS: u64 = 2000;

/// The measures of a ranking, and its precision-recall curve.
#[derive(Debug, Clone, PartialEq)]
pub struct Ranked {
    /// `None` without positives.
    pub measures: Option<Measures>,
    /// Points in order of falling threshold: one for about every 1/2000 of the positives, and the
    /// threshold of the last positive. The counts of each point are exact.
    pub curve: Vec<RetrievalPoint>,
}

/// Measures how well confidences separate positives from negatives.
///
/// Sorts both slices. This needs no memory besides them.
///
/// ```
/// let ranked = evaluate::rank(&mut [0.9, 0.2], &mut [0.4, 0.1, 0.0]);
/// let measures = ranked.measures.unwrap();
/// assert_eq!(measures.recall_at_full_precision, 0.5);
/// assert_eq!(measures.average_precision, 0.5 + 0.5 * 2.0 / 3.0);
/// ```
pub fn rank(positives: &mut [f64], negatives: &mut [f64]) -> Ranked {
    // -0 and +0 are the same confidence.
    for values in [&mut *positives, &mut *negatives] {
        values.par_iter_mut().for_each(|value| *value += 0.0);
        values.par_sort_unstable_by(|a, b| b.total_cmp(a));
    }
    let n_positive = positives.len() as u64;
    let mut curve = Vec::new();
    let Some(mut sweep) = ThresholdSweep::new(positives.len() as f64, negatives.len() as f64)
    else {
        return Ranked { measures: None, curve };
    };
    let point_step = n_positive.div_ceil(MAX_POINTS);
    let (mut p, mut n, mut next) = (0, 0, 1);
    while let Some(threshold) = highest(positives.get(p), negatives.get(n)) {
        let (p_before, n_before) = (p, n);
        while positives.get(p).is_some_and(|v| threshold.total_cmp(v).is_eq()) {
            p += 1;
        }
        while negatives.get(n).is_some_and(|v| threshold.total_cmp(v).is_eq()) {
            n += 1;
        }
        sweep.step((p - p_before) as f64, (n - n_before) as f64);
        let (true_positive, false_positive) = (p as u64, n as u64);
        if p_before < p && (next <= true_positive || true_positive == n_positive) {
            curve.push(RetrievalPoint { threshold, true_positive, false_positive });
            next = (true_positive / point_step + 1) * point_step;
        }
    }
    Ranked { measures: Some(sweep.measures()), curve }
}

fn highest(a: Option<&f64>, b: Option<&f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if a.total_cmp(b).is_lt() { *b } else { *a }),
        (a, b) => a.or(b).copied(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Thresholds 3 (+), 2 (+ -), 1 (- -), 0 (+): AP = 1/3 (1 + 2/3 + 3/6).
    #[test]
    fn measures_with_ties_and_signed_zeros_match_values_computed_by_hand() {
        let found = rank(&mut [2.0, 3.0, 0.0], &mut [1.0, 2.0, 1.0]);
        let measures = found.measures.unwrap();
        assert!((measures.average_precision - (1.0 + 2.0 / 3.0 + 0.5) / 3.0).abs() < 1e-12);
        assert_eq!(measures.recall_at_full_precision, 1.0 / 3.0);
        // F1 = 2 tp / (n_called_positive + 3): 2/4, 4/6, 4/8, 6/9.
        assert!((measures.max_f1 - 2.0 / 3.0).abs() < 1e-12);
        let point = |threshold, true_positive, false_positive| RetrievalPoint {
            threshold,
            true_positive,
            false_positive,
        };
        assert_eq!(found.curve, [point(3.0, 1, 0), point(2.0, 2, 1), point(0.0, 3, 3)]);
        let tied = rank(&mut [0.0], &mut [-0.0]);
        assert_eq!(tied.measures.unwrap().recall_at_full_precision, 0.0);
        assert_eq!(rank(&mut [], &mut [1.0]), Ranked { measures: None, curve: Vec::new() });
    }

    /// 10,000 positives at 1 to 10,000, and a negative below every tenth positive. The curve has about
    /// 2000 points with exact counts. The measures use all pairs.
    #[test]
    fn a_long_curve_has_about_2000_points_with_exact_counts() {
        let mut positives: Vec<f64> = (1..=10_000).map(f64::from).collect();
        let mut negatives: Vec<f64> = (1..=1000).map(|k| f64::from(10 * k) - 0.5).collect();
        let found = rank(&mut positives, &mut negatives);
        assert!((2000..=2002).contains(&found.curve.len()), "{}", found.curve.len());
        for point in &found.curve {
            // At or above the threshold t: 10,001 - t positives, and the negatives 10 k - 0.5 > t.
            let t = point.threshold as u64;
            assert_eq!(point.true_positive, 10_001 - t);
            assert_eq!(point.false_positive, 1000 - t / 10);
        }
        assert_eq!(found.curve.last().map(|point| point.true_positive), Some(10_000));
        // Only the positive at 10,000 is above the first negative, at 9999.5.
        assert_eq!(found.measures.unwrap().recall_at_full_precision, 1e-4);
    }
}
