//! Counts, rates and curves, from labels and confidences.
//!
//! A pair is called positive where its confidence is not less than the threshold. Pairs of equal
//! confidence are called alike: a curve has one point for each distinct confidence.

use dataset::Label;

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
