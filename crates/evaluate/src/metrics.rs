//! Counts, rates and curves, from labels and confidences.
//!
//! A pair is called positive where its confidence is not less than the threshold. Pairs of equal
//! confidence are called alike: a curve has one point for each distinct confidence.

use dataset::Label;
use serde::Serialize;

/// What was called what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confusion {
    /// Positives called positive.
    pub true_positive: usize,
    /// Negatives called positive.
    pub false_positive: usize,
    /// Negatives called negative.
    pub true_negative: usize,
    /// Positives called negative.
    pub false_negative: usize,
}

impl Confusion {
    /// Counts at a threshold.
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

    /// Share of the pairs given the wrong label; NaN without pairs.
    pub fn error(&self) -> f64 {
        let wrong = self.false_positive + self.false_negative;
        wrong as f64 / (wrong + self.true_positive + self.true_negative) as f64
    }

    /// Share of positives among the pairs called positive; none where no pair is called so.
    pub fn precision(&self) -> Option<f64> {
        let called = self.true_positive + self.false_positive;
        (called > 0).then(|| self.true_positive as f64 / called as f64)
    }

    /// Share of the positives that are called positive; NaN without positives.
    pub fn recall(&self) -> f64 {
        self.true_positive as f64 / (self.true_positive + self.false_negative) as f64
    }

    /// Share of the negatives that are called positive; NaN without negatives.
    pub fn false_alarm(&self) -> f64 {
        self.false_positive as f64 / (self.false_positive + self.true_negative) as f64
    }
}

/// A point of a precision-recall curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrPoint {
    /// Pairs whose confidence is not less than this are called positive.
    pub threshold: f64,
    /// What is called what there.
    pub confusion: Confusion,
}

/// The curve from the highest confidence to the lowest, a point for each distinct confidence.
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
        let tied =
            order.get(k + 1).is_some_and(|&next| confidences[next].total_cmp(&threshold).is_eq());
        if !tied {
            points.push(PrPoint { threshold, confusion: counts });
        }
    }
    points
}

/// What a ranking of pairs by confidence is worth, over all thresholds. Pairs of equal confidence
/// cross a threshold together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Measures {
    /// Average precision: the sum over thresholds of (recall here - recall at the next higher
    /// threshold) x precision here, without interpolation; scikit-learn's
    /// `average_precision_score`.
    pub average_precision: f64,
    /// Greatest recall at which no negative is called positive, 0 where the highest confidence is
    /// (also) a negative's. It is as well the detection at 0 % false alarm.
    pub recall_at_full_precision: f64,
    /// Greatest recall at which at most 1 % of the negatives are called positive.
    pub detection_at_1_percent: f64,
    /// Greatest harmonic mean of precision and recall.
    pub max_f1: f64,
}

/// False alarms that [`Measures::detection_at_1_percent`] allows, as a share of the negatives.
const FALSE_ALARM: f64 = 0.01;

/// Goes down the thresholds, from the highest confidence to the lowest.
///
/// Counts may be weights, such as how often a bootstrap drew each pair.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Walk {
    n_positive: f64,
    n_negative: f64,
    true_positive: f64,
    false_positive: f64,
    measures: Measures,
}

impl Walk {
    /// At a threshold above all confidences; none without positives, of which nothing can be said.
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

    /// To the next lower distinct confidence, which so many positives and negatives have.
    #[inline]
    pub(crate) fn step(&mut self, positives: f64, negatives: f64) {
        self.true_positive += positives;
        self.false_positive += negatives;
        let called = self.true_positive + self.false_positive;
        if called <= 0.0 {
            return; // pairs of no weight
        }
        let recall = self.true_positive / self.n_positive;
        let precision = self.true_positive / called;
        let measures = &mut self.measures;
        measures.average_precision += positives / self.n_positive * precision;
        if self.false_positive <= 0.0 {
            measures.recall_at_full_precision = recall;
        }
        if self.false_positive <= 0.0 || self.false_positive / self.n_negative <= FALSE_ALARM {
            measures.detection_at_1_percent = recall;
        }
        // 2 P R / (P + R) with P = tp / called and R = tp / n_positive.
        let f1 = 2.0 * self.true_positive / (called + self.n_positive);
        measures.max_f1 = measures.max_f1.max(f1);
    }

    pub(crate) fn measures(&self) -> Measures {
        self.measures
    }
}

/// Labelled pairs in order of falling confidence, sorted once and measured under any weights.
#[derive(Debug, Clone)]
pub(crate) struct Ranking {
    /// Rows, `(n_pairs,)`.
    order: Vec<u32>,
    /// Whether the next row in the order has another confidence, `(n_pairs,)`.
    is_last_of_tie: Vec<bool>,
    /// Whether each row is positive, `(n_pairs,)`.
    is_positive: Vec<bool>,
    /// Whether each row has the wrong label at threshold 0, `(n_pairs,)`.
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

    /// Share of wrong labels at threshold 0, and the measures of the ranking, where row k counts
    /// `weights[k]` times; none where no positive, or no pair, has a weight.
    pub(crate) fn measure(&self, weights: &[f64]) -> Option<(f64, Measures)> {
        let (mut n_positive, mut n_negative, mut wrong) = (0.0, 0.0, 0.0);
        for ((&weight, &is_positive), &is_wrong) in
            weights.iter().zip(&self.is_positive).zip(&self.is_wrong)
        {
            *(if is_positive { &mut n_positive } else { &mut n_negative }) += weight;
            wrong += if is_wrong { weight } else { 0.0 };
        }
        let mut walk = Walk::new(n_positive, n_negative)?;
        let (mut positives, mut negatives) = (0.0, 0.0);
        for (&row, &is_last) in self.order.iter().zip(&self.is_last_of_tie) {
            let weight = weights[row as usize];
            *(if self.is_positive[row as usize] { &mut positives } else { &mut negatives }) +=
                weight;
            if is_last {
                walk.step(positives, negatives);
                (positives, negatives) = (0.0, 0.0);
            }
        }
        Some((wrong / (n_positive + n_negative), walk.measures()))
    }
}

/// A threshold chosen for a purpose.
#[derive(Debug, Clone, PartialEq)]
pub struct OperatingPoint {
    /// The purpose.
    pub name: &'static str,
    /// The threshold and what is called what there.
    pub point: PrPoint,
}

/// The named operating points that exist on these pairs:
///
/// - `recall at 100 % precision`: the lowest threshold with no false alarm above it;
/// - `detection at 1 % false alarm`: the lowest threshold at which at most 1 % of the negatives
///   are called positive.
pub fn operating_points(labels: &[Label], confidences: &[f64]) -> Vec<OperatingPoint> {
    let curve = precision_recall(labels, confidences);
    let last_with = |name, good: &dyn Fn(&Confusion) -> bool| {
        // False alarms only grow along the curve, so that the good points come first.
        curve
            .iter()
            .take_while(|point| good(&point.confusion))
            .last()
            .filter(|point| point.confusion.true_positive > 0)
            .map(|point| OperatingPoint { name, point: *point })
    };
    [
        last_with("recall at 100 % precision", &|c| c.false_positive == 0),
        last_with("detection at 1 % false alarm", &|c| c.false_alarm() <= 0.01),
    ]
    .into_iter()
    .flatten()
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    /// Confidences 3 +, 2 -, 2 +, 1 -, 0 +, -1 -: worked out by hand.
    const LABELS: [Label; 6] = [Positive, Negative, Positive, Negative, Positive, Negative];
    const CONFIDENCES: [f64; 6] = [3.0, 2.0, 2.0, 1.0, 0.0, -1.0];

    #[test]
    fn at_threshold_0() {
        let counts = Confusion::count(&LABELS, CONFIDENCES.into_iter(), 0.0);
        let expected =
            Confusion { true_positive: 3, false_positive: 2, true_negative: 1, false_negative: 0 };
        assert_eq!(counts, expected);
        assert_eq!(counts.error(), 2.0 / 6.0);
        assert_eq!(counts.precision(), Some(3.0 / 5.0), "of the called ones");
        assert_eq!(counts.recall(), 1.0, "of the positives");
        assert_eq!(counts.false_alarm(), 2.0 / 3.0);
    }

    #[test]
    fn nothing_called_positive_has_no_precision() {
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

    /// Thresholds 3, 2, 1, 0, -1 call 1, 3, 4, 5, 6 pairs positive, 1, 2, 2, 3, 3 of them rightly.
    /// AP: 1/3 x 1 + 1/3 x 2/3 + 0 + 1/3 x 3/5 + 0. F1 = 2 tp / (called + 3): 2/4, 4/6, 4/7, 6/8,
    /// 6/9. Recall before the first negative, which shares the confidence 2 with a positive: 1/3.
    #[test]
    fn measures_by_hand_with_a_tie() {
        let found = measured(&LABELS, &CONFIDENCES);
        close(found.average_precision, (1.0 + 2.0 / 3.0 + 3.0 / 5.0) / 3.0);
        close(found.recall_at_full_precision, 1.0 / 3.0);
        close(found.detection_at_1_percent, 1.0 / 3.0);
        close(found.max_f1, 3.0 / 4.0);
    }

    /// All alike: one threshold, at which all are called positive. Precision 1/2, F1 2 x 3 / 9.
    #[test]
    fn pairs_of_one_confidence_cross_together() {
        let found = measured(&LABELS, &[0.5; 6]);
        close(found.average_precision, 0.5);
        assert_eq!((found.recall_at_full_precision, found.detection_at_1_percent), (0.0, 0.0));
        close(found.max_f1, 2.0 / 3.0);
    }

    /// 200 negatives at 0, -1, -2, ...: 1 % of them are two. Positives at 1, -0.5, -1.5 and -9.
    #[test]
    fn one_percent_of_false_alarms_may_pass() {
        let mut labels = vec![Positive; 4];
        labels.extend([Negative; 200]);
        let mut confidences = vec![1.0, -0.5, -1.5, -9.0];
        confidences.extend((0..200).map(|k| -f64::from(k)));
        let found = measured(&labels, &confidences);
        // Above -1.5 two negatives, 0 and -1; -9 is tied with the tenth.
        assert_eq!(found.recall_at_full_precision, 0.25);
        assert_eq!(found.detection_at_1_percent, 0.75);
        close(found.average_precision, 0.25 * (1.0 + 2.0 / 3.0 + 3.0 / 5.0 + 4.0 / 14.0));
        close(found.max_f1, 6.0 / 9.0);
    }

    /// Weights 0, 1, 2, 0, 1, 0 are the pairs 2 - , 2 +, 2 +, 0 +: thresholds 2 and 0. AP: 2/3 x 2/3 +
    /// 1/3 x 3/4. Wrong at threshold 0 is the negative.
    #[test]
    fn a_pair_counts_as_often_as_its_weight_says() {
        let ranking = Ranking::new(&LABELS, &CONFIDENCES);
        let (error, found) = ranking.measure(&[0.0, 1.0, 2.0, 0.0, 1.0, 0.0]).unwrap();
        close(error, 1.0 / 4.0);
        close(found.average_precision, 4.0 / 9.0 + 1.0 / 4.0);
        assert_eq!(found.recall_at_full_precision, 0.0);
        close(found.max_f1, 6.0 / 7.0);
        assert_eq!(ranking.measure(&[0.0, 1.0, 0.0, 1.0, 0.0, 0.0]), None, "no positive");
    }

    #[test]
    fn operating_points_by_hand() {
        let points = operating_points(&LABELS, &CONFIDENCES);
        assert_eq!(points.len(), 2);
        assert_eq!(points[0].point.threshold, 3.0);
        assert_eq!(points[0].point.confusion.recall(), 1.0 / 3.0);
        // 1 % of three negatives is less than one: the same point.
        assert_eq!(points[1].point.threshold, 3.0);

        // 100 negatives at 0.5 and below: one may pass.
        let mut labels = vec![Positive; 3];
        labels.extend([Negative; 100]);
        let mut confidences = vec![0.9, 0.7, 0.5];
        confidences.extend((0..100).map(|k| 0.8 - 0.1 * f64::from(k.min(5))));
        // Sorted: 0.9 +, 0.8 -, 0.7 + and -, ...: at 0.7 two negatives have passed.
        let points = operating_points(&labels, &confidences);
        assert_eq!(points[0].point.threshold, 0.9);
        assert_eq!(points[1].point.threshold, 0.8);
        assert_eq!(points[1].point.confusion.false_positive, 1);
    }

    #[test]
    fn where_the_best_is_a_false_alarm_there_is_no_point() {
        assert!(operating_points(&[Negative, Positive], &[1.0, 0.0]).is_empty());
    }
}
