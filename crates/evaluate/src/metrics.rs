//! Counts, rates and curves, computed from labels and confidences.
//!
//! A pair is classified as positive if its confidence is at least the threshold. Pairs of equal
//! confidence cannot be separated by a threshold: a curve has one point for each distinct
//! confidence.

use dataset::Label;
use serde::Serialize;

/// Numbers of correctly and wrongly classified pairs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confusion {
    /// Positives classified as positive.
    pub true_positive: usize,
    /// Negatives classified as positive.
    pub false_positive: usize,
    /// Negatives classified as negative.
    pub true_negative: usize,
    /// Positives classified as negative.
    pub false_negative: usize,
}

impl Confusion {
    /// Counts the pairs at a threshold.
    pub fn count(labels: &[Label], confidences: impl Iterator<Item = f64>, threshold: f64) -> Self {
        let mut counts = Self::default();
        for (label, confidence) in labels.iter().zip(confidences) {
            match (label, Label::from_confidence(confidence, threshold)) {
                (Label::Positive, Label::Positive) => counts.true_positive += 1,
                (Label::Negative, Label::Positive) => counts.false_positive += 1,
                (Label::Negative, Label::Negative) => counts.true_negative += 1,
                (Label::Positive, Label::Negative) => counts.false_negative += 1,
            }
        }
        counts
    }

    /// Share of misclassified pairs; NaN without pairs.
    pub fn error(&self) -> f64 {
        let wrong = self.false_positive + self.false_negative;
        wrong as f64 / (wrong + self.true_positive + self.true_negative) as f64
    }

    /// Share of positives among the pairs classified as positive; `None` without such pairs.
    pub fn precision(&self) -> Option<f64> {
        let n_called_positive = self.true_positive + self.false_positive;
        (n_called_positive > 0).then(|| self.true_positive as f64 / n_called_positive as f64)
    }

    /// Share of the positives that are classified as positive; NaN without positives.
    pub fn recall(&self) -> f64 {
        self.true_positive as f64 / (self.true_positive + self.false_negative) as f64
    }

    /// Share of the negatives that are classified as positive; NaN without negatives.
    pub fn false_alarm(&self) -> f64 {
        self.false_positive as f64 / (self.false_positive + self.true_negative) as f64
    }
}

/// A point of a precision-recall curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrPoint {
    /// Pairs with at least this confidence are classified as positive.
    pub threshold: f64,
    /// The counts at the threshold.
    pub confusion: Confusion,
}

/// The precision-recall curve, from the highest confidence to the lowest, with one point for each
/// distinct confidence.
///
/// ```
/// use dataset::Label::{Negative, Positive};
///
/// let curve = evaluate::precision_recall(&[Positive, Negative, Positive], &[0.9, 0.4, 0.2]);
/// assert_eq!(curve.len(), 3);
/// assert_eq!(curve[1].confusion.precision(), Some(0.5));
/// assert_eq!(curve[2].confusion.recall(), 1.0);
/// ```
pub fn precision_recall(labels: &[Label], confidences: &[f64]) -> Vec<PrPoint> {
    let mut order: Vec<usize> = (0..labels.len()).collect();
    order.sort_by(|&a, &b| confidences[b].total_cmp(&confidences[a]));
    let n_positive = labels.iter().filter(|&&label| label == Label::Positive).count();
    let mut counts = Confusion {
        false_negative: n_positive,
        true_negative: labels.len() - n_positive,
        ..Confusion::default()
    };
    let mut points = Vec::new();
    for (k, &row) in order.iter().enumerate() {
        match labels[row] {
            Label::Positive => {
                counts.true_positive += 1;
                counts.false_negative -= 1;
            }
            Label::Negative => {
                counts.false_positive += 1;
                counts.true_negative -= 1;
            }
        }
        let threshold = confidences[row];
        let is_tied =
            order.get(k + 1).is_some_and(|&next| confidences[next].total_cmp(&threshold).is_eq());
        if !is_tied {
            points.push(PrPoint { threshold, confusion: counts });
        }
    }
    points
}

/// The quality of a ranking of pairs by confidence, over all thresholds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measures {
    /// Average precision: the sum over the thresholds of the precision times the increase in recall
    /// since the next higher threshold, without interpolation, as in scikit-learn's
    /// `average_precision_score`.
    pub average_precision: f64,
    /// Greatest recall at which no negative is classified as positive. This is also the detection
    /// rate at 0 % false alarm. It is 0 if a negative has the highest confidence.
    pub recall_at_full_precision: f64,
    /// Greatest recall at which at most 1 % of the negatives are classified as positive.
    pub detection_at_1_percent: f64,
    /// Maximum over the thresholds of the harmonic mean of precision and recall.
    pub max_f1: f64,
}

/// False alarm rate allowed for [`Measures::detection_at_1_percent`].
pub(crate) const MAX_FALSE_ALARM: f64 = 0.01;

/// Computes [`Measures`] while the threshold falls from the highest confidence to the lowest.
///
/// Counts may be weights, for example the number of times that a bootstrap drew each pair.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ThresholdSweep {
    n_positive: f64,
    n_negative: f64,
    true_positive: f64,
    false_positive: f64,
    measures: Measures,
}

impl ThresholdSweep {
    /// Starts above all confidences; `None` without positives.
    pub(crate) fn new(n_positive: f64, n_negative: f64) -> Option<Self> {
        (0.0 < n_positive).then_some(Self {
            n_positive,
            n_negative,
            true_positive: 0.0,
            false_positive: 0.0,
            measures: Measures {
                average_precision: 0.0,
                recall_at_full_precision: 0.0,
                detection_at_1_percent: 0.0,
                max_f1: 0.0,
            },
        })
    }

    /// Lowers the threshold to the next distinct confidence, which this many positives and negatives
    /// have.
    #[inline]
    pub(crate) fn step(&mut self, positives: f64, negatives: f64) {
        self.true_positive += positives;
        self.false_positive += negatives;
        let n_called_positive = self.true_positive + self.false_positive;
        if n_called_positive <= 0.0 {
            return; // pairs with weight 0
        }
        let recall = self.true_positive / self.n_positive;
        let precision = self.true_positive / n_called_positive;
        let measures = &mut self.measures;
        measures.average_precision += positives / self.n_positive * precision;
        if self.false_positive <= 0.0 {
            measures.recall_at_full_precision = recall;
        }
        if self.false_positive <= 0.0 || self.false_positive / self.n_negative <= MAX_FALSE_ALARM {
            measures.detection_at_1_percent = recall;
        }
        // 2 P R / (P + R) with P = tp / n_called_positive and R = tp / n_positive.
        let f1 = 2.0 * self.true_positive / (n_called_positive + self.n_positive);
        measures.max_f1 = measures.max_f1.max(f1);
    }

    pub(crate) fn measures(&self) -> Measures {
        self.measures
    }
}

/// Labelled pairs in order of falling confidence. They are sorted once and measured with any
/// weights.
#[derive(Debug, Clone)]
pub(crate) struct Ranking {
    /// Indices of the pairs, `(n_pairs,)`.
    order: Vec<u32>,
    /// Whether the next pair in the order has another confidence, `(n_pairs,)`.
    is_last_of_tie: Vec<bool>,
    /// Whether each pair is positive, `(n_pairs,)`.
    is_positive: Vec<bool>,
    /// Whether each pair is misclassified at threshold 0, `(n_pairs,)`.
    is_wrong: Vec<bool>,
}

impl Ranking {
    pub(crate) fn new(labels: &[Label], confidences: &[f64]) -> Self {
        let mut order: Vec<u32> = (0..labels.len() as u32).collect();
        let of = |row: u32| confidences[row as usize];
        order.sort_by(|&a, &b| of(b).total_cmp(&of(a)));
        let differs = |k: usize| {
            order.get(k + 1).is_none_or(|&next| of(order[k]).total_cmp(&of(next)).is_ne())
        };
        let is_wrong = labels
            .iter()
            .zip(confidences)
            .map(|(&label, &confidence)| Label::from_confidence(confidence, 0.0) != label)
            .collect();
        Self {
            is_last_of_tie: (0..order.len()).map(differs).collect(),
            is_positive: labels.iter().map(|&label| label == Label::Positive).collect(),
            is_wrong,
            order,
        }
    }

    /// The share of misclassified pairs at threshold 0 and the measures of the ranking. Pair k counts
    /// `weights[k]` times. `None` if all positives have weight 0.
    pub(crate) fn measure(&self, weights: &[f64]) -> Option<(f64, Measures)> {
        let (mut n_positive, mut n_negative, mut wrong) = (0.0, 0.0, 0.0);
        for ((&weight, &is_positive), &is_wrong) in
            weights.iter().zip(&self.is_positive).zip(&self.is_wrong)
        {
            *(if is_positive { &mut n_positive } else { &mut n_negative }) += weight;
            wrong += if is_wrong { weight } else { 0.0 };
        }
        let mut sweep = ThresholdSweep::new(n_positive, n_negative)?;
        let (mut positives, mut negatives) = (0.0, 0.0);
        for (&row, &is_last) in self.order.iter().zip(&self.is_last_of_tie) {
            let weight = weights[row as usize];
            *(if self.is_positive[row as usize] { &mut positives } else { &mut negatives }) +=
                weight;
            if is_last {
                sweep.step(positives, negatives);
                (positives, negatives) = (0.0, 0.0);
            }
        }
        Some((wrong / (n_positive + n_negative), sweep.measures()))
    }
}

/// A threshold selected for a purpose.
#[derive(Debug, Clone, PartialEq)]
pub struct OperatingPoint {
    /// The purpose.
    pub name: &'static str,
    /// The threshold and the counts at it.
    pub point: PrPoint,
}

/// The operating points that exist for these pairs:
///
/// - `recall at 100 % precision`: the lowest threshold without false alarms;
/// - `detection at 1 % false alarm`: the lowest threshold at which at most 1 % of the negatives
///   are classified as positive.
pub fn operating_points(labels: &[Label], confidences: &[f64]) -> Vec<OperatingPoint> {
    let curve = precision_recall(labels, confidences);
    let last_with = |name, is_good: &dyn Fn(&Confusion) -> bool| {
        // False alarms increase along the curve: the good points come first.
        curve
            .iter()
            .take_while(|point| is_good(&point.confusion))
            .last()
            .filter(|point| point.confusion.true_positive > 0)
            .map(|point| OperatingPoint { name, point: *point })
    };
    [
        last_with("recall at 100 % precision", &|c| c.false_positive == 0),
        last_with("detection at 1 % false alarm", &|c| c.false_alarm() <= MAX_FALSE_ALARM),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    // The confidences with their labels: 3 +, 2 -, 2 +, 1 -, 0 +, -1 -.
    const LABELS: [Label; 6] = [Positive, Negative, Positive, Negative, Positive, Negative];
    const CONFIDENCES: [f64; 6] = [3.0, 2.0, 2.0, 1.0, 0.0, -1.0];

    #[test]
    fn counts_and_rates_at_threshold_0() {
        let counts = Confusion::count(&LABELS, CONFIDENCES.into_iter(), 0.0);
        let expected =
            Confusion { true_positive: 3, false_positive: 2, true_negative: 1, false_negative: 0 };
        assert_eq!(counts, expected);
        assert_eq!(counts.error(), 2.0 / 6.0);
        assert_eq!(counts.precision(), Some(3.0 / 5.0), "3 of 5 classified as positive");
        assert_eq!(counts.recall(), 1.0, "3 of 3 positives");
        assert_eq!(counts.false_alarm(), 2.0 / 3.0);
    }

    #[test]
    fn precision_is_none_if_no_pair_is_classified_as_positive() {
        let counts = Confusion::count(&LABELS, CONFIDENCES.into_iter(), 9.0);
        assert_eq!((counts.precision(), counts.recall(), counts.error()), (None, 0.0, 0.5));
    }

    #[test]
    fn a_curve_has_one_point_for_each_distinct_confidence() {
        let curve = precision_recall(&LABELS, &CONFIDENCES);
        let found: Vec<_> = curve
            .iter()
            .map(|p| (p.threshold, p.confusion.true_positive, p.confusion.false_positive))
            .collect();
        assert_eq!(found, [(3.0, 1, 0), (2.0, 2, 1), (1.0, 2, 2), (0.0, 3, 2), (-1.0, 3, 3)]);
        for point in &curve {
            let counted = Confusion::count(&LABELS, CONFIDENCES.into_iter(), point.threshold);
            assert_eq!(counted, point.confusion);
        }
    }

    fn measured(labels: &[Label], confidences: &[f64]) -> Measures {
        Ranking::new(labels, confidences).measure(&vec![1.0; labels.len()]).unwrap().1
    }

    #[track_caller]
    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-12, "{found}, expected {expected}");
    }

    /// At the thresholds 3, 2, 1, 0, -1, the numbers of pairs classified as positive are 1, 3, 4, 5,
    /// 6; of these, 1, 2, 2, 3, 3 are true positives. AP: 1/3 x 1 + 1/3 x 2/3 + 0 + 1/3 x 3/5 + 0.
    /// F1 = 2 tp / (n + 3): 2/4, 4/6, 4/7, 6/8, 6/9. The first negative is tied with a positive at
    /// confidence 2; the recall above them is 1/3.
    #[test]
    fn measures_with_a_tie_match_values_computed_by_hand() {
        let found = measured(&LABELS, &CONFIDENCES);
        close(found.average_precision, (1.0 + 2.0 / 3.0 + 3.0 / 5.0) / 3.0);
        close(found.recall_at_full_precision, 1.0 / 3.0);
        close(found.detection_at_1_percent, 1.0 / 3.0);
        close(found.max_f1, 3.0 / 4.0);
    }

    /// With one confidence there is one threshold. Precision 1/2, F1 2 x 3 / 9.
    #[test]
    fn pairs_of_equal_confidence_are_classified_together() {
        let found = measured(&LABELS, &[0.5; 6]);
        close(found.average_precision, 0.5);
        assert_eq!((found.recall_at_full_precision, found.detection_at_1_percent), (0.0, 0.0));
        close(found.max_f1, 2.0 / 3.0);
    }

    /// 200 negatives at 0, -1, -2, ...; 1 % of them are two. Positives at 1, -0.5, -1.5 and -9.
    #[test]
    fn detection_at_1_percent_allows_two_false_alarms_among_200_negatives() {
        let mut labels = vec![Positive; 4];
        labels.extend([Negative; 200]);
        let mut confidences = vec![1.0, -0.5, -1.5, -9.0];
        confidences.extend((0..200).map(|k| -f64::from(k)));
        let found = measured(&labels, &confidences);
        // Two negatives, 0 and -1, are above -1.5. The positive at -9 is tied with a negative.
        assert_eq!(found.recall_at_full_precision, 0.25);
        assert_eq!(found.detection_at_1_percent, 0.75);
        close(found.average_precision, 0.25 * (1.0 + 2.0 / 3.0 + 3.0 / 5.0 + 4.0 / 14.0));
        close(found.max_f1, 6.0 / 9.0);
    }

    /// The weights 0, 1, 2, 0, 1, 0 give the pairs 2 -, 2 +, 2 +, 0 +, with thresholds 2 and 0. AP:
    /// 2/3 x 2/3 + 1/3 x 3/4. At threshold 0 the negative is wrong.
    #[test]
    fn a_weighted_pair_counts_several_times() {
        let ranking = Ranking::new(&LABELS, &CONFIDENCES);
        let (error, found) = ranking.measure(&[0.0, 1.0, 2.0, 0.0, 1.0, 0.0]).unwrap();
        close(error, 1.0 / 4.0);
        close(found.average_precision, 4.0 / 9.0 + 1.0 / 4.0);
        assert_eq!(found.recall_at_full_precision, 0.0);
        close(found.max_f1, 6.0 / 7.0);
        assert_eq!(ranking.measure(&[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]), None, "no positive");
    }

    #[test]
    fn operating_points_match_values_found_by_hand() {
        let points = operating_points(&LABELS, &CONFIDENCES);
        assert_eq!(points.len(), 2);
        assert_eq!(points[0].point.threshold, 3.0);
        assert_eq!(points[0].point.confusion.recall(), 1.0 / 3.0);
        // 1 % of three negatives is less than one negative: the same point.
        assert_eq!(points[1].point.threshold, 3.0);

        // Of 100 negatives, one may be a false alarm.
        let mut labels = vec![Positive; 3];
        labels.extend([Negative; 100]);
        let mut confidences = vec![0.9, 0.7, 0.5];
        confidences.extend((0..100).map(|k| 0.8 - 0.1 * f64::from(k.min(5))));
        // In order: 0.9 +, 0.8 -, 0.7 + and -, ... At 0.7 there are two false alarms.
        let points = operating_points(&labels, &confidences);
        assert_eq!(points[0].point.threshold, 0.9);
        assert_eq!(points[1].point.threshold, 0.8);
        assert_eq!(points[1].point.confusion.false_positive, 1);
    }

    #[test]
    fn no_operating_point_exists_if_a_negative_has_the_highest_confidence() {
        assert!(operating_points(&[Negative, Positive], &[1.0, 0.0]).is_empty());
    }
}
