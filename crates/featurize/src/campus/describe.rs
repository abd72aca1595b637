//! Histograms and percentiles, and the feature vector that they are written to.

use dataset::value_at_rank;

/// The part of the feature vector that is not yet written.
pub(super) struct Out<'a> {
    rest: &'a mut [f64],
}

impl<'a> Out<'a> {
    pub(super) fn new(features: &'a mut [f64]) -> Self {
        Self { rest: features }
    }

    /// Whether all features are written.
    pub(super) fn is_full(&self) -> bool {
        self.rest.is_empty()
    }

    pub(super) fn push(&mut self, values: &[f64]) {
        let rest = std::mem::take(&mut self.rest);
        let (now, rest) = rest.split_at_mut(values.len());
        now.copy_from_slice(values);
        self.rest = rest;
    }
}

/// Splits a weight linearly between the two bin centres next to a value. A value outside the centres
/// goes to the first or last bin.
#[inline]
pub(super) fn add_soft<const N: usize>(
    histogram: &mut [f64; N],
    centres: &[f64; N],
    value: f64,
    weight: f64,
) {
    if value <= centres[0] {
        histogram[0] += weight;
    } else if centres[N - 1] <= value {
        histogram[N - 1] += weight;
    } else {
        let mut k = 0;
        while centres[k + 1] <= value {
            k += 1;
        }
        let share = (value - centres[k]) / (centres[k + 1] - centres[k]);
        histogram[k] += weight * (1.0 - share);
        histogram[k + 1] += weight * share;
    }
}

/// Divides by the sum. Where the sum is only rounding error, compared with `unit`, the shares stay
/// about 0.
pub(super) fn shares<const N: usize>(histogram: [f64; N], unit: f64) -> [f64; N] {
    let sum = (histogram.iter().sum::<f64>() / unit).max(1e-9) * unit;
    histogram.map(|h| h / sum)
}

/// Percentiles \[%\] of sorted values, interpolated linearly between neighbours.
pub(super) fn percentiles<const N: usize>(sorted: &[f64], percents: &[f64; N]) -> [f64; N] {
    // Not `dataset::quantile` of `percent / 100.0`: multiplying first rounds differently.
    percents.map(|percent| value_at_rank(sorted, (sorted.len() - 1) as f64 * percent / 100.0))
}

/// Natural logarithms, for bin centres.
pub(super) fn ln_all<const N: usize>(values: [f64; N]) -> [f64; N] {
    values.map(libm::log)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 3 is halfway between 2 and 4. 0 and 9 are outside the centres.
    #[test]
    fn a_weight_is_split_between_the_two_centres_next_to_the_value() {
        let mut histogram = [0.0; 3];
        for (value, weight) in [(3.0, 1.0), (0.0, 2.0), (9.0, 4.0), (2.0, 8.0), (1.75, 16.0)] {
            add_soft(&mut histogram, &[1.0, 2.0, 4.0], value, weight);
        }
        assert_eq!(histogram, [2.0 + 4.0, 0.5 + 8.0 + 12.0, 0.5 + 4.0]);
    }

    #[test]
    fn percentiles_are_interpolated_between_neighbours() {
        assert_eq!(percentiles(&[1.0, 2.0, 4.0], &[0.0, 25.0, 75.0, 100.0]), [1.0, 1.5, 3.0, 4.0]);
        assert_eq!(percentiles(&[7.0], &[0.0, 50.0, 100.0]), [7.0; 3]);
    }
}
