//! Sums over columns in lanes: value k goes to lane k modulo [`LANES`], and the lanes are added in
//! their order. That order is fixed, so that the bits are the same everywhere, and additions need
//! not wait for one another.

/// Sums that run side by side.
const LANES: usize = 8;

/// The sums over k = 0 to n - 1 of N values each.
#[inline]
pub(crate) fn sums<const N: usize>(n: usize, values: impl Fn(usize) -> [f64; N]) -> [f64; N] {
    let mut lanes = [[0.0; LANES]; N];
    let mut k = 0;
    while k + LANES <= n {
        for lane in 0..LANES {
            let values = values(k + lane);
            for (sums, value) in lanes.iter_mut().zip(values) {
                sums[lane] += value;
            }
        }
        k += LANES;
    }
    for (lane, k) in (k..n).enumerate() {
        for (sums, value) in lanes.iter_mut().zip(values(k)) {
            sums[lane] += value;
        }
    }
    lanes.map(|sums| sums.iter().sum())
}

/// How many of the values are so.
#[inline]
pub(crate) fn count(values: &[f64], is_so: impl Fn(f64) -> bool) -> usize {
    values.iter().map(|&value| usize::from(is_so(value))).sum()
}

/// The sum of squared deviations from the mean.
pub(crate) fn deviations(values: &[f64]) -> f64 {
    let [sum] = sums(values.len(), |k| [values[k]]);
    let mean = sum / values.len() as f64;
    let [squares] = sums(values.len(), |k| [(values[k] - mean) * (values[k] - mean)]);
    squares
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_counts_once_whatever_the_number() {
        for n in 0..40usize {
            let expected = (n * n.saturating_sub(1) / 2) as f64;
            assert_eq!(sums(n, |k| [k as f64, 1.0]), [expected, n as f64]);
        }
        assert_eq!(count(&[1.0, 2.0, 3.0], |v| v < 2.5), 2);
        // 1, 2, 3, 6 about 3: 4 + 1 + 0 + 9.
        assert_eq!(deviations(&[1.0, 2.0, 3.0, 6.0]), 14.0);
    }
}
