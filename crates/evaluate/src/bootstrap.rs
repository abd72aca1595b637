//! Confidence intervals by resampling groups.
//!
//! Pairs that share a scan or a place are not independent. The bootstrap therefore resamples groups
//! instead of pairs. The weight of a pair of two groups is the product of the numbers of times that
//! the groups were drawn: the pigeonhole bootstrap (Owen 2007, "The pigeonhole bootstrap", Annals
//! of Applied Statistics 1(2)). The weight of a pair within one group is the number of times that
//! the group was drawn. Classifiers are not trained again: the intervals cover the variation over
//! pairs and places, not over training runs.
//!
//! A bootstrap cannot estimate everything. Without a single error, every resample is perfect too,
//! and the interval would have no width: [`exact`](crate::exact) gives the interval instead. The
//! recall without false alarms depends on one pair, the negative with the highest confidence. The
//! bootstrap of such an extreme value is wrong for any number of pairs (Bickel and Freedman 1981,
//! "Some asymptotic theory for the bootstrap", Annals of Statistics 9(6), section 6), so it has no
//! interval.

use std::collections::BTreeMap;

use dataset::{Label, Scores, SplitMix64, quantile};
use rayon::prelude::*;
use serde::Serialize;

use crate::exact::{self, COVERED};
use crate::metrics::{MAX_FALSE_ALARM, Measures, Ranking};

/// Least number of groups for an interval. Fewer do not show the variation between groups.
pub const MIN_GROUPS: usize = 5;

/// Least number of false alarms that 1 % of the negatives must allow for an interval of the
/// detection rate. With fewer, the threshold is almost an extreme value. (The same number of
/// expected events is commonly required for the normal approximation of a binomial.)
const MIN_ALLOWED_ALARMS: f64 = 5.0;

/// A value and its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Value on all pairs.
    pub value: f64,
    /// The 2.5 % and 97.5 % quantiles of the resamples, or the exact interval if the value is
    /// perfect. `None` with fewer than [`MIN_GROUPS`] groups, and where a bootstrap cannot estimate
    /// the interval.
    pub interval: Option<[f64; 2]>,
}

/// The measures of a learner under a grouping after the last round, with intervals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The learner's name.
    pub learner: String,
    /// Unit that is never split between folds: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// Number of boosting rounds T.
    pub rounds: usize,
    /// Number of folds.
    pub folds: u32,
    /// Number of groups among the pairs.
    pub groups: usize,
    /// Share of misclassified pairs at threshold 0.
    pub error: Estimate,
    /// See [`Measures::average_precision`].
    pub average_precision: Estimate,
    /// See [`Measures::recall_at_full_precision`].
    pub recall_at_full_precision: Estimate,
    /// See [`Measures::detection_at_1_percent`].
    pub detection_at_1_percent: Estimate,
    /// See [`Measures::max_f1`].
    pub max_f1: Estimate,
}

impl Summary {
    /// Names and values of all measures.
    pub fn measures(&self) -> [(&'static str, Estimate); 5] {
        [
            ("error", self.error),
            ("average_precision", self.average_precision),
            ("recall_at_full_precision", self.recall_at_full_precision),
            ("detection_at_1_percent", self.detection_at_1_percent),
            ("max_f1", self.max_f1),
        ]
    }
}

/// The measures of every learner under every grouping, with intervals from `resamples` resamples.
pub(crate) fn summaries(
    labels: &[Label],
    scores: &[Scores],
    resamples: u32,
    seed: u64,
) -> Vec<Summary> {
    let mut groupings: Vec<&str> = Vec::new();
    for s in scores {
        if !groupings.contains(&&*s.grouping) {
            groupings.push(&s.grouping);
        }
    }
    let mut of_grouping: BTreeMap<&str, (Groups, Vec<Vec<f64>>)> = BTreeMap::new();
    for grouping in groupings {
        let Some(first) = scores.iter().find(|s| s.grouping == grouping) else { continue };
        let groups = Groups::new(&first.groups);
        let n = if MIN_GROUPS <= groups.n { resamples } else { 0 };
        let weights = (0..n).into_par_iter().map(|k| groups.resample(seed, k)).collect();
        of_grouping.insert(grouping, (groups, weights));
    }
    scores
        .par_iter()
        .filter_map(|s| {
            let (groups, weights) = &of_grouping[&*s.grouping];
            summary(labels, s, groups, weights)
        })
        .collect()
}

fn summary(
    labels: &[Label],
    scores: &Scores,
    groups: &Groups,
    weights: &[Vec<f64>],
) -> Option<Summary> {
    let confidences: Vec<f64> = scores.after(scores.n_rounds).collect();
    let ranking = Ranking::new(labels, &confidences);
    let values = |(error, m): (f64, Measures)| {
        [error, m.average_precision, m.recall_at_full_precision, m.detection_at_1_percent, m.max_f1]
    };
    let of_all = values(ranking.measure(&vec![1.0; labels.len()])?);
    // A resample without positives has no measures.
    let resampled: Vec<[f64; 5]> =
        weights.par_iter().filter_map(|w| ranking.measure(w)).map(values).collect();
    let sample = (!weights.is_empty()).then(|| exact::Sample::new(labels, &groups.of_pairs));
    let n_negative = labels.iter().filter(|&&label| label == Label::Negative).count();
    let has_threshold = MIN_ALLOWED_ALARMS <= MAX_FALSE_ALARM * n_negative as f64;
    let estimate = |k: usize, perfect: Option<fn(&exact::Sample) -> [f64; 2]>| {
        let value = of_all[k];
        let is_perfect = value == if k == 0 { 0.0 } else { 1.0 };
        let interval = match (perfect, &sample) {
            (None, _) | (_, None) => None,
            (Some(exact), Some(sample)) if is_perfect => Some(exact(sample)),
            _ => interval(resampled.iter().map(|r| r[k]).collect()),
        };
        Estimate { value, interval }
    };
    Some(Summary {
        learner: scores.learner.clone(),
        grouping: scores.grouping.clone(),
        rounds: scores.n_rounds,
        folds: scores.folds.iter().flatten().max().map_or(0, |fold| fold + 1),
        groups: groups.n,
        error: estimate(0, Some(exact::Sample::error)),
        average_precision: estimate(1, Some(exact::Sample::average_precision)),
        recall_at_full_precision: estimate(2, None),
        detection_at_1_percent: estimate(3, has_threshold.then_some(exact::Sample::recall)),
        max_f1: estimate(4, Some(exact::Sample::max_f1)),
    })
}

/// The central interval that contains [`COVERED`] of the values. `None` without values, and if all
/// values are equal: an interval without width would claim certainty.
fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    if values.first() == values.last() {
        return None;
    }
    let tail = (1.0 - COVERED) / 2.0;
    Some([quantile(&values, tail), quantile(&values, 1.0 - tail)])
}

/// The groups of the pairs, numbered from 0 without gaps.
struct Groups {
    /// The groups of the two ends of each pair, `(n_pairs, 2)`.
    of_pairs: Vec<[usize; 2]>,
    /// Number of groups.
    n: usize,
}

impl Groups {
    fn new(groups: &[[u32; 2]]) -> Self {
        let mut numbers: BTreeMap<u32, usize> = groups.iter().flatten().map(|&g| (g, 0)).collect();
        for (number, place) in numbers.values_mut().enumerate() {
            *place = number;
        }
        Self {
            of_pairs: groups.iter().map(|pair| pair.map(|group| numbers[&group])).collect(),
            n: numbers.len(),
        }
    }

    /// Draws `n` groups with replacement. Returns the weight of each pair, `(n_pairs,)`.
    fn resample(&self, seed: u64, resample: u32) -> Vec<f64> {
        let mut random = SplitMix64::new(seed ^ (u64::from(resample) << 32) ^ 0xB007_57A4);
        // Neighbouring resamples have similar states. One step makes them unrelated.
        random = SplitMix64::new(random.next_u64());
        let mut drawn = vec![0.0; self.n];
        for _ in 0..self.n {
            drawn[random.below(self.n as u64)] += 1.0;
        }
        self.of_pairs
            .iter()
            .map(|&[a, b]| if a == b { drawn[a] } else { drawn[a] * drawn[b] })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    /// For the values 0, 1, ..., 100, the 2.5 % quantile is 2.5.
    #[test]
    fn an_interval_covers_the_central_95_percent() {
        let values = (0..=100).rev().map(f64::from).collect();
        let [low, high] = interval(values).unwrap();
        assert!((low - 2.5).abs() < 1e-9 && (high - 97.5).abs() < 1e-9);
        assert_eq!(interval(vec![]), None);
        assert_eq!(interval(vec![3.0]), None);
        assert_eq!(interval(vec![3.0; 50]), None);
    }

    #[test]
    fn the_weight_of_a_pair_is_the_product_of_the_draws_of_its_groups() {
        let groups = Groups::new(&[[7, 7], [9, 9], [40, 40], [7, 9], [9, 40], [40, 7]]);
        assert_eq!(groups.n, 3);
        for k in 0..20 {
            let w = groups.resample(5, k);
            assert_eq!(w[0] + w[1] + w[2], 3.0, "three draws");
            assert_eq!((w[3], w[4], w[5]), (w[0] * w[1], w[1] * w[2], w[2] * w[0]));
            assert_eq!(groups.resample(5, k), w);
        }
        assert!((0..20).any(|k| groups.resample(5, k) != groups.resample(6, k)));
        assert!((1..20).any(|k| groups.resample(5, k) != groups.resample(5, 0)));
    }

    fn scores(groups: Vec<[u32; 2]>, confidences: Vec<f64>) -> Scores {
        Scores {
            learner: "discrete".to_owned(),
            grouping: "scan".to_owned(),
            n_rounds: 1,
            folds: groups.clone(),
            n_training: vec![0; groups.len()],
            groups,
            confidences,
        }
    }

    /// 400 independent pairs, a quarter of them wrong: the standard deviation of the error is
    /// sqrt(0.25 x 0.75 / 400) = 0.02165, and the interval is 0.25 +- 1.96 times that. In groups of
    /// four identical pairs, the standard deviation doubles. 1000 resamples determine a bound to
    /// about 0.002.
    #[test]
    fn intervals_have_the_width_that_theory_predicts() {
        let labels: Vec<Label> =
            (0..400).map(|k| if k % 2 == 0 { Positive } else { Negative }).collect();
        let confidences = |wrong: &dyn Fn(u32) -> bool| -> Vec<f64> {
            let correct = labels.iter().map(|l| l.target());
            correct.zip(0..).map(|(y, k)| if wrong(k) { -y } else { y }).collect()
        };
        let independent = scores((0..400).map(|k| [k, k]).collect(), confidences(&|k| k % 8 < 2));
        let in_fours =
            scores((0..400).map(|k| [k / 4, k / 4]).collect(), confidences(&|k| k % 16 < 4));
        for (scores, n, deviation) in [(independent, 400, 0.021_65), (in_fours, 100, 0.0433)] {
            let found = &summaries(&labels, &[scores], 1000, 3)[0];
            assert_eq!((found.groups, found.error.value), (n, 0.25));
            let [low, high] = found.error.interval.unwrap();
            assert!((low - (0.25 - 1.96 * deviation)).abs() < 0.008, "{low}");
            assert!((high - (0.25 + 1.96 * deviation)).abs() < 0.008, "{high}");
        }
    }

    /// 40 pairs in 20 groups of two, all correct: no resample has an error. 1 - 0.025^(1/20) = 0.1684.
    /// 1 % of 20 negatives is less than one, so the detection rate has no interval.
    #[test]
    fn without_errors_the_intervals_have_a_width() {
        let labels: Vec<Label> =
            (0..40).map(|k| if k % 2 == 0 { Positive } else { Negative }).collect();
        let correct: Vec<f64> = labels.iter().map(|label| label.target()).collect();
        let scores = scores((0..40).map(|k| [k / 2; 2]).collect(), correct);
        let found = &summaries(&labels, std::slice::from_ref(&scores), 200, 3)[0];
        let [low, high] = found.error.interval.unwrap();
        assert!(low == 0.0 && (high - 0.1684).abs() < 1e-4, "{high}");
        for estimate in [found.average_precision, found.max_f1] {
            let [low, high] = estimate.interval.unwrap();
            assert!(estimate.value == 1.0 && high == 1.0 && 0.2 < low && low < 0.9, "{low}");
        }
        assert_eq!(found.recall_at_full_precision, Estimate { value: 1.0, interval: None });
        assert_eq!(found.detection_at_1_percent, Estimate { value: 1.0, interval: None });
        // Without resamples there are no intervals.
        assert_eq!(summaries(&labels, &[scores], 0, 3)[0].error.interval, None);
    }

    /// 500 negatives: 1 % are five. With errors, only the extreme value has no interval.
    #[test]
    fn an_extreme_value_has_no_bootstrap_interval() {
        let labels: Vec<Label> =
            (0..1000).map(|k| if k % 2 == 0 { Positive } else { Negative }).collect();
        let mut random = SplitMix64::new(4);
        let confidences = labels.iter().map(|label| label.target() + 4.0 * random.unit() - 2.0);
        let scores = scores((0..1000).map(|k| [k; 2]).collect(), confidences.collect());
        let found = &summaries(&labels, &[scores], 100, 3)[0];
        assert_eq!(found.recall_at_full_precision.interval, None);
        for (name, estimate) in found.measures() {
            let has_width = estimate.interval.is_some_and(|[low, high]| low < high);
            assert_eq!(has_width, name != "recall_at_full_precision", "{name}");
        }
    }

    #[test]
    fn fewer_than_five_groups_give_no_interval() {
        let groups = vec![[0, 1], [2, 3], [0, 3]];
        let found = summaries(
            &[Positive, Negative, Positive],
            &[scores(groups, vec![1.0, -1.0, 2.0])],
            9,
            1,
        );
        assert_eq!((found[0].groups, found[0].error.interval), (4, None));
        assert_eq!(found[0].average_precision.value, 1.0);
    }
}
