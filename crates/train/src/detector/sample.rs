//! Quantiles of weighted values, and scales that outliers do not change.

/// Values with weights.
#[derive(Default)]
pub(super) struct Sample {
    values: Vec<(f64, f64)>,
}

impl FromIterator<(f64, f64)> for Sample {
    /// From pairs of value and weight.
    fn from_iter<I: IntoIterator<Item = (f64, f64)>>(values: I) -> Self {
        let mut values: Vec<(f64, f64)> = values.into_iter().collect();
        values.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        Self { values }
    }
}

impl Sample {
    /// The smallest value so that at least `share` of the weight lies at it or below. NaN if there are
    /// no values.
    pub(super) fn quantile(&self, share: f64) -> f64 {
        let total: f64 = self.values.iter().map(|(_, weight)| weight).sum();
        let mut below = 0.0;
        for &(value, weight) in &self.values {
            below += weight;
            // The sum of the weights has a rounding error.
            if share * total <= below * (1.0 + 1e-12) {
                return value;
            }
        }
        self.values.last().map_or(f64::NAN, |&(value, _)| value)
    }
}

/// Standard deviation of a normal distribution that covers these errors: the larger one of those with
/// the same 68.27 % and 95 % quantiles of the absolute value. For normal errors, both are the standard
/// deviation. For errors with many small and some large values, as wheels have them, the second is
/// larger. Up to 5 % outliers do not change it.
pub(super) fn covering_std(errors: impl Iterator<Item = f64>) -> f64 {
    let sample: Sample = errors.map(|error| (error.abs(), 1.0)).collect();
    // 68.27 % of a normal distribution are within 1, and 95 % within 1.95996 standard deviations.
    sample.quantile(0.6827).max(sample.quantile(0.95) / 1.959_963_985)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_count_weights() {
        let sample: Sample = [(3.0, 1.0), (1.0, 1.0), (2.0, 2.0)].into_iter().collect();
        // Weights at or below: 1 of 4 at 1, 3 of 4 at 2, 4 of 4 at 3.
        for (share, value) in
            [(0.0, 1.0), (0.25, 1.0), (0.26, 2.0), (0.75, 2.0), (0.76, 3.0), (1.0, 3.0)]
        {
            assert!((sample.quantile(share) - value).abs() < 1e-15, "{share}");
        }
        assert!(Sample::default().quantile(0.5).is_nan());
    }

    /// Of 100 errors, 94 are 0.1 and 6 are 1: the 95 % quantile is 1, so the scale is 1 / 1.96 = 0.51.
    /// With 4 of 100, it is 0.1.
    #[test]
    fn frequent_large_errors_count_and_rare_ones_do_not() {
        let errors = |n_large: usize| (0..100).map(move |k| if k < n_large { -1.0 } else { 0.1 });
        assert!((covering_std(errors(6)) - 0.510_213).abs() < 1e-5);
        assert!((covering_std(errors(4)) - 0.1).abs() < 1e-12);
    }
}
