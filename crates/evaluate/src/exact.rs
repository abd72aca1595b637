//! Intervals for perfect results.
//!
//! If none of n independent groups has an error, the share of groups with errors is below
//! 1 - 0.025^(1/n) with a confidence of 97.5 %: the upper end of the exact 95 % interval (Clopper and
//! Pearson 1934, "The use of confidence or fiducial limits illustrated in the case of the binomial",
//! Biometrika 26(4)). All pairs of a group with an error count as wrong.
//!
//! Groups of different sizes contain less information than the same number of equal groups. Therefore
//! n is the effective number of groups, (sum of sizes)^2 / (sum of squared sizes) (Kish 1965, "Survey
//! Sampling", section 11.7). A pair of two groups counts half for each.

use dataset::Label;

/// Share of the possible values inside an interval.
pub(crate) const COVERED: f64 = 0.95;

/// The pairs that were classified without an error.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Effective number of groups of all pairs.
    n_groups: f64,
    /// Effective number of groups of the positives.
    n_groups_of_positives: f64,
    /// Share of positives among the pairs.
    prevalence: f64,
}

impl Sample {
    /// The groups of the two ends of each pair are `(n_pairs, 2)`.
    pub(crate) fn new(labels: &[Label], groups: &[[usize; 2]]) -> Self {
        let is_positive = |label: Label| label == Label::Positive;
        let n_positive = labels.iter().filter(|&&label| is_positive(label)).count();
        Self {
            n_groups: effective_groups(labels, groups, |_| true),
            n_groups_of_positives: effective_groups(labels, groups, is_positive),
            prevalence: n_positive as f64 / labels.len() as f64,
        }
    }

    /// Interval of the share of misclassified pairs, if there is none.
    pub(crate) fn error(&self) -> [f64; 2] {
        [0.0, largest_share(self.n_groups)]
    }

    /// Interval of the recall, if no positive is missed.
    pub(crate) fn recall(&self) -> [f64; 2] {
        [1.0 - largest_share(self.n_groups_of_positives), 1.0]
    }

    /// Interval of the maximum F1 of a perfect ranking. In the worst case, all errors are missed
    /// positives: with a share m of them, F1 = 2 (1 - m) / (2 (1 - m) + m).
    pub(crate) fn max_f1(&self) -> [f64; 2] {
        let missed = self.errors_per_positive().min(1.0);
        [(2.0 - 2.0 * missed) / (2.0 - missed), 1.0]
    }

    /// Interval of the average precision of a perfect ranking. In the worst case, the errors are
    /// negatives above all positives. With c of them per positive, the precision at recall r is
    /// r / (r + c), and its integral from 0 to 1 is 1 - c ln(1 + 1/c).
    pub(crate) fn average_precision(&self) -> [f64; 2] {
        let c = self.errors_per_positive();
        [1.0 - c * libm::log1p(1.0 / c), 1.0]
    }

    fn errors_per_positive(&self) -> f64 {
        largest_share(self.n_groups) / self.prevalence
    }
}

/// The upper end of the exact interval for the share of groups with errors, if none of n has one.
fn largest_share(n_groups: f64) -> f64 {
    let tail = (1.0 - COVERED) / 2.0;
    1.0 - libm::pow(tail, 1.0 / n_groups)
}

/// The effective number of groups of the pairs with some label.
fn effective_groups(labels: &[Label], groups: &[[usize; 2]], is_used: fn(Label) -> bool) -> f64 {
    let n_groups = groups.iter().flatten().max().map_or(0, |&last| last + 1);
    let mut sizes = vec![0.0; n_groups];
    let used = labels.iter().zip(groups).filter(|(label, _)| is_used(**label));
    for &group in used.flat_map(|(_, ends)| ends) {
        sizes[group] += 0.5;
    }
    let sum: f64 = sizes.iter().sum();
    let of_squares: f64 = sizes.iter().map(|size| size * size).sum();
    sum * sum / of_squares
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    #[track_caller]
    fn close(found: [f64; 2], expected: [f64; 2]) {
        let is_close = found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 5e-4);
        assert!(is_close, "{found:?}, expected {expected:?}");
    }

    /// 0 of 10: scipy.stats.binomtest(0, 10).proportion_ci() is [0, 0.3085]; 0 of 100: [0, 0.0362].
    #[test]
    fn without_errors_the_interval_is_that_of_clopper_and_pearson() {
        for (n, high) in [(10, 0.3085), (100, 0.0362)] {
            let labels: Vec<Label> =
                (0..n).map(|k| if k < n / 2 { Positive } else { Negative }).collect();
            let groups: Vec<[usize; 2]> = (0..n).map(|k| [k, k]).collect();
            let sample = Sample::new(&labels, &groups);
            close(sample.error(), [0.0, high]);
            // Half of the pairs are positive: 1 - 0.025^(1/5) = 0.5218, 1 - 0.025^(1/50) = 0.0711.
            close(sample.recall(), [if n == 10 { 0.4782 } else { 0.9289 }, 1.0]);
            // Two errors per positive and error: for n = 100, m = 0.0724.
            if n == 100 {
                close(sample.max_f1(), [(2.0 - 0.1448) / (2.0 - 0.0724), 1.0]);
                // 1 - 0.0724 ln(1 + 13.812) = 1 - 0.0724 x 2.6954
                close(sample.average_precision(), [0.8048, 1.0]);
            }
        }
    }

    /// Ten groups. One has 91 of the 100 pairs: 100^2 / (91^2 + 9) = 1.206 groups. Pairs of
    /// two groups count half for each: three pairs around a triangle are three groups.
    #[test]
    fn groups_of_different_sizes_count_as_fewer_groups() {
        let labels = [Positive; 100];
        let groups: Vec<[usize; 2]> = (0..100).map(|k: usize| [k.saturating_sub(90); 2]).collect();
        let n = effective_groups(&labels, &groups, |_| true);
        assert!((n - 10_000.0 / 8290.0).abs() < 1e-9, "{n}");
        let triangle = [[0, 1], [1, 2], [2, 0]];
        assert_eq!(effective_groups(&labels[..3], &triangle, |_| true), 3.0);
    }
}
