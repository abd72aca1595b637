//! Confidence intervals by resampling groups.
//!
//! Pairs that share a scan, or a place, are not independent; what is resampled is therefore the
//! group. A pair of two groups counts as often as the product of how often each was drawn: the
//! pigeonhole bootstrap (Owen 2007, "The pigeonhole bootstrap", Annals of Applied Statistics 1(2)).
//! A pair within one group counts as often as the group was drawn. Scores are not recomputed:
//! what is measured is the spread over pairs and places, not over fits.

use std::collections::BTreeMap;

use dataset::{Label, Scores};
use rayon::prelude::*;
use serde::Serialize;

use crate::metrics::Ranking;

/// Fewer groups than this say nothing about the spread between groups.
pub const MIN_GROUPS: usize = 5;

/// Share of the resamples within an interval.
const COVERED: f64 = 0.95;

/// A value and where 95 % of the resamples lie.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Measured on all pairs.
    pub value: f64,
    /// The 2.5 % and the 97.5 % quantile of the resamples; none where there are too few groups.
    pub interval: Option<[f64; 2]>,
}

/// What is measured of a learner under a grouping at the last round, with intervals.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Rounds T of a boosted learner.
    pub rounds: usize,
    /// Folds.
    pub folds: u32,
    /// Groups that the pairs are of; [`MIN_GROUPS`] give intervals.
    pub groups: usize,
    /// Share of wrong labels at threshold 0.
    pub error: Estimate,
    /// See [`crate::Measures`], as all below.
    pub average_precision: Estimate,
    /// Recall at 100 % precision: detection at 0 % false alarm.
    pub recall_at_full_precision: Estimate,
    /// Detection at 1 % false alarm.
    pub detection_at_1_percent: Estimate,
    /// Maximum F1.
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

/// Measures every learner under every grouping, with intervals from so many resamples.
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
    let mut of_grouping: BTreeMap<&str, (usize, Vec<Vec<f64>>)> = BTreeMap::new();
    for grouping in groupings {
        let Some(first) = scores.iter().find(|s| s.grouping == grouping) else { continue };
        let groups = Numbered::new(&first.groups);
        let n = if MIN_GROUPS <= groups.n { resamples } else { 0 };
        let weights = (0..n).into_par_iter().map(|k| groups.resample(seed, k)).collect();
        of_grouping.insert(grouping, (groups.n, weights));
    }
    scores
        .par_iter()
        .filter_map(|s| {
            let (n_groups, weights) = &of_grouping[&*s.grouping];
            summary(labels, s, *n_groups, weights)
        })
        .collect()
}

fn summary(
    labels: &[Label],
    scores: &Scores,
    n_groups: usize,
    weights: &[Vec<f64>],
) -> Option<Summary> {
    let confidences: Vec<f64> = scores.after(scores.n_rounds).collect();
    let ranking = Ranking::new(labels, &confidences);
    let values = |(error, m): (f64, crate::Measures)| {
        [error, m.average_precision, m.recall_at_full_precision, m.detection_at_1_percent, m.max_f1]
    };
    let of_all = values(ranking.measure(&vec![1.0; labels.len()])?);
    // A resample without positives measures nothing.
    let resampled: Vec<[f64; 5]> =
        weights.par_iter().filter_map(|w| ranking.measure(w)).map(values).collect();
    let estimate = |k: usize| Estimate {
        value: of_all[k],
        interval: interval(resampled.iter().map(|r| r[k]).collect()),
    };
    Some(Summary {
        learner: scores.learner.clone(),
        grouping: scores.grouping.clone(),
        rounds: scores.n_rounds,
        folds: scores.folds.iter().flatten().max().map_or(0, |fold| fold + 1),
        groups: n_groups,
        error: estimate(0),
        average_precision: estimate(1),
        recall_at_full_precision: estimate(2),
        detection_at_1_percent: estimate(3),
        max_f1: estimate(4),
    })
}

/// The quantiles that leave half of the rest on either side, interpolated linearly between order
/// statistics (Hyndman and Fan 1996, definition 7).
fn interval(mut values: Vec<f64>) -> Option<[f64; 2]> {
    let last = values.len().checked_sub(1)?;
    values.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let place = share * last as f64;
        let below = place.floor() as usize;
        let above = (below + 1).min(last);
        values[below] + (place - below as f64) * (values[above] - values[below])
    };
    let rest = (1.0 - COVERED) / 2.0;
    Some([quantile(rest), quantile(1.0 - rest)])
}

/// The groups of pairs, numbered from 0 without gaps.
struct Numbered {
    of_pairs: Vec<[usize; 2]>,
    n: usize,
}

impl Numbered {
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

    /// Draws as many groups as there are, with replacement; the weight of each pair, `(n_pairs,)`.
    fn resample(&self, seed: u64, resample: u32) -> Vec<f64> {
        let mut random = SplitMix64(seed ^ (u64::from(resample) << 32) ^ 0xB007_57A4);
        // The first outputs of near states differ little in some bits: one step apart.
        random.0 = random.next();
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

/// SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA
/// 2014).
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// 0 to n - 1; n is far below 2^64, so that the bias of the product is too.
    fn below(&mut self, n: u64) -> usize {
        ((u128::from(self.next()) * u128::from(n)) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    /// 0, 1, ..., 100: 2.5 % of the way from 0 to 100 is 2.5.
    #[test]
    fn quantiles_by_hand() {
        let values = (0..=100).rev().map(f64::from).collect();
        let [low, high] = interval(values).unwrap();
        assert!((low - 2.5).abs() < 1e-9 && (high - 97.5).abs() < 1e-9);
        assert_eq!(interval(vec![]), None);
        assert_eq!(interval(vec![3.0]), Some([3.0, 3.0]));
    }

    /// Reference outputs of SplitMix64 for the seed 1234567, from its author's C program as it is
    /// quoted in the tests of many implementations.
    #[test]
    fn the_generator_is_the_published_one() {
        let mut random = SplitMix64(1_234_567);
        assert_eq!(random.next(), 6_457_827_717_110_365_317);
        assert_eq!(random.next(), 3_203_168_211_198_807_973);
    }

    #[test]
    fn a_pair_weighs_the_product_of_its_groups() {
        let groups = Numbered::new(&[[7, 7], [9, 9], [40, 40], [7, 9], [9, 40], [40, 7]]);
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
            groups,
            confidences,
        }
    }

    /// Independent pairs, 1 in 4 wrong of 400: the error's standard deviation is
    /// sqrt(0.25 x 0.75 / 400) = 0.02165, the interval 0.25 -+ 1.96 x that. Groups of four alike
    /// pairs double it. 1000 resamples know a bound to about 0.002.
    #[test]
    fn intervals_are_as_wide_as_theory_says() {
        let labels: Vec<Label> =
            (0..400).map(|k| if k % 2 == 0 { Positive } else { Negative }).collect();
        let confidences = |wrong: &dyn Fn(u32) -> bool| -> Vec<f64> {
            let right = labels.iter().map(|l| l.target());
            right.zip(0..).map(|(y, k)| if wrong(k) { -y } else { y }).collect()
        };
        let alone = scores((0..400).map(|k| [k, k]).collect(), confidences(&|k| k % 8 < 2));
        let in_fours =
            scores((0..400).map(|k| [k / 4, k / 4]).collect(), confidences(&|k| k % 16 < 4));
        for (scores, n, deviation) in [(alone, 400, 0.021_65), (in_fours, 100, 0.0433)] {
            let found = &summaries(&labels, &[scores], 1000, 3)[0];
            assert_eq!((found.groups, found.error.value), (n, 0.25));
            let [low, high] = found.error.interval.unwrap();
            assert!((low - (0.25 - 1.96 * deviation)).abs() < 0.008, "{low}");
            assert!((high - (0.25 + 1.96 * deviation)).abs() < 0.008, "{high}");
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
