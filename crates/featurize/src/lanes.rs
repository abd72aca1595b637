//! Operations on columns that the compiler turns into vector instructions.
//!
//! A sum has [`LANES`] partial sums: value k is added to lane k modulo [`LANES`], and the lanes are
//! added in order at the end. The lanes do not wait for each other. The order of the additions is
//! fixed, and therefore the result has the same bits on every machine.

use std::array::from_fn;

/// Number of partial sums.
const LANES: usize = 8;

/// Computes `value` for each row of the columns and writes the results to `out`. The columns must
/// have equal lengths.
#[inline(always)]
pub(crate) fn fill<const M: usize>(
    out: &mut Vec<f64>,
    columns: [&[f64]; M],
    value: impl Fn([f64; M]) -> f64,
) {
    let n = columns[0].len();
    out.resize(n, 0.0);
    let out = &mut out[..n];
    // Slicing all columns to the same length here removes the bounds checks from the loop.
    let columns = columns.map(|column| &column[..n]);
    for (k, out) in out.iter_mut().enumerate() {
        *out = value(from_fn(|c| columns[c][k]));
    }
}

/// Computes the N `values` for each row of the columns and returns their N sums. The columns must
/// have equal lengths.
#[inline(always)]
pub(crate) fn sums<const M: usize, const N: usize>(
    columns: [&[f64]; M],
    values: impl Fn([f64; M]) -> [f64; N],
) -> [f64; N] {
    let n = columns[0].len();
    let columns = columns.map(|column| &column[..n]);
    let mut lanes = [[0.0; LANES]; N];
    let whole = n - n % LANES;
    for first in (0..whole).step_by(LANES) {
        let blocks: [&[f64]; M] = from_fn(|c| &columns[c][first..first + LANES]);
        for lane in 0..LANES {
            let values = values(from_fn(|c| blocks[c][lane]));
            for i in 0..N {
                lanes[i][lane] += values[i];
            }
        }
    }
    for (lane, k) in (whole..n).enumerate() {
        let values = values(from_fn(|c| columns[c][k]));
        for i in 0..N {
            lanes[i][lane] += values[i];
        }
    }
    lanes.map(|sums| sums.iter().sum())
}

/// Number of values for which `is_counted` is true.
#[inline(always)]
pub(crate) fn count(values: &[f64], is_counted: impl Fn(f64) -> bool) -> usize {
    values.iter().map(|&value| usize::from(is_counted(value))).sum()
}

/// The sum of squared deviations from the mean. `sum` is the sum of the values.
#[inline(always)]
pub(crate) fn deviations(values: &[f64], sum: f64) -> f64 {
    let mean = sum / values.len() as f64;
    let [squares] = sums([values], |[v]| [(v - mean) * (v - mean)]);
    squares
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::{prop_assert_eq, proptest};

    use super::*;

    /// One sum, one value at a time, in the order that the module promises.
    fn scalar_sum(values: impl Iterator<Item = f64>) -> f64 {
        let mut lanes = [0.0; LANES];
        for (k, value) in values.enumerate() {
            lanes[k % LANES] += value;
        }
        let mut sum = 0.0;
        for lane in lanes {
            sum += lane;
        }
        sum
    }

    proptest! {
        #[test]
        fn sums_have_the_bits_of_a_scalar_loop(rows in vec((-1e3..1e3f64, -1e-3..1e-3), 0..100)) {
            let (a, b): (Vec<f64>, Vec<f64>) = rows.iter().copied().unzip();
            let found = sums([&a, &b], |[a, b]| [a, a * b, a + b]);
            let expected = [
                scalar_sum(rows.iter().map(|(a, _)| *a)),
                scalar_sum(rows.iter().map(|(a, b)| a * b)),
                scalar_sum(rows.iter().map(|(a, b)| a + b)),
            ];
            prop_assert_eq!(found.map(f64::to_bits), expected.map(f64::to_bits));

            let mean = expected[0] / rows.len() as f64;
            let squares = scalar_sum(a.iter().map(|v| (v - mean) * (v - mean)));
            prop_assert_eq!(deviations(&a, expected[0]).to_bits(), squares.to_bits());
        }

        #[test]
        fn filled_columns_have_the_bits_of_a_scalar_loop(rows in vec((-1e3..1e3f64, 0.1..1e3f64), 0..100)) {
            let (a, b): (Vec<f64>, Vec<f64>) = rows.iter().copied().unzip();
            let mut found = vec![1.0; 7];
            fill(&mut found, [&a, &b], |[a, b]| (a / b).abs().sqrt());
            let expected: Vec<f64> = rows.iter().map(|(a, b)| (a / b).abs().sqrt()).collect();
            prop_assert_eq!(&found, &expected);
            let n_above = expected.iter().filter(|v| 1.0 < **v).count();
            prop_assert_eq!(count(&found, |v| 1.0 < v), n_above);
        }
    }

    #[test]
    fn each_row_counts_once_for_any_number_of_rows() {
        for n in 0..40usize {
            let column: Vec<f64> = (0..n).map(|k| k as f64).collect();
            let expected = (n * n.saturating_sub(1) / 2) as f64;
            assert_eq!(sums([&column, &column], |[a, b]| [a, b - a + 1.0]), [expected, n as f64]);
            let mut out = vec![7.0; 5];
            fill(&mut out, [&column, &column], |[a, b]| a * b);
            assert!(out.iter().enumerate().all(|(k, v)| *v as usize == k * k) && out.len() == n);
        }
        assert_eq!(count(&[1.0, 2.0, 3.0], |v| v < 2.5), 2);
        // 1, 2, 3 and 6 have the mean 3: 4 + 1 + 0 + 9.
        assert_eq!(deviations(&[1.0, 2.0, 3.0, 6.0], 12.0), 14.0);
    }
}
