//! Products of the columns of a panel of a block-sparse factor.

use std::ops::Range;

use nalgebra::Matrix3;

/// The most columns of a panel.
pub(crate) const MAX_PANEL: usize = 16;

/// Consecutive columns with the same rows below the last one. `starts` and `rows` as in
/// [`BlockSystem`](crate::BlockSystem).
pub(crate) fn panels(starts: &[usize], rows: &[u32]) -> Vec<Range<usize>> {
    let below = |k: usize| &rows[starts[k] + 1..starts[k + 1]];
    let mut panels: Vec<Range<usize>> = Vec::new();
    for k in 0..starts.len() - 1 {
        match panels.last_mut() {
            Some(panel)
                if panel.len() < MAX_PANEL && *below(k - 1) == rows[starts[k]..starts[k + 1]] =>
            {
                panel.end = k + 1;
            }
            _ => panels.push(k..k + 1),
        }
    }
    panels
}

/// The rows of a panel below its columns.
pub(crate) struct Panel<'a> {
    /// Their numbers, ascending.
    rows: &'a [u32],
    /// Their values, column by column, three per block.
    values: Vec<f64>,
}

/// Memory for [`Panel::subtract_products`]. It can be used again.
#[derive(Default)]
pub(crate) struct Scratch {
    values: Vec<f64>,
    /// The position of each row in the target.
    positions: Vec<usize>,
}

impl<'a> Panel<'a> {
    /// `columns` are the blocks of each column in the rows.
    pub(crate) fn new<'b>(
        rows: &'a [u32],
        columns: impl ExactSizeIterator<Item = &'b [Matrix3<f64>]>,
    ) -> Self {
        let mut values = vec![0.0; 9 * rows.len() * columns.len()];
        for (column, values) in columns.zip(values.chunks_exact_mut((9 * rows.len()).max(1))) {
            spread(column.iter(), values);
        }
        Self { rows, values }
    }

    /// Subtracts the products of the blocks in row `first` with those in this row and the rows below it from the column
    /// of that row, which has the blocks `target` in the rows `target_rows`.
    pub(crate) fn subtract_products(
        &self,
        first: usize,
        target: &mut [Matrix3<f64>],
        target_rows: &[u32],
        Scratch { values, positions }: &mut Scratch,
    ) {
        positions.clear();
        let mut at = 0;
        for row in &self.rows[first..] {
            // The rows of a column are also rows of the columns of these rows.
            while target_rows[at] != *row {
                at += 1;
            }
            positions.push(at);
        }
        values.clear();
        values.resize(9 * positions.len(), 0.0);
        spread(positions.iter().map(|&at| &target[at]), values);
        subtract(values, &self.values, 3 * self.rows.len());
        let n = 3 * positions.len();
        for (k, &at) in positions.iter().enumerate() {
            target[at] = Matrix3::from_fn(|row, column| values[column * n + 3 * k + row]);
        }
    }
}

/// Writes a column of blocks as three columns of numbers.
fn spread<'a>(blocks: impl ExactSizeIterator<Item = &'a Matrix3<f64>>, values: &mut [f64]) {
    let n = 3 * blocks.len();
    for (k, block) in blocks.enumerate() {
        for (column, numbers) in block.as_slice().chunks_exact(3).enumerate() {
            values[column * n + 3 * k..][..3].copy_from_slice(numbers);
        }
    }
}

/// Subtracts products, with wider registers if the processor has them. They do not change the result, because each
/// number is computed with the same operations.
fn subtract(target: &mut [f64], panel: &[f64], n_panel: usize) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2.
        return unsafe { subtract_avx2(target, panel, n_panel) };
    }
    subtract_all(target, panel, n_panel);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn subtract_avx2(target: &mut [f64], panel: &[f64], n_panel: usize) {
    subtract_all(target, panel, n_panel);
}

/// `target` has three columns, and `panel` has columns of `n_panel` numbers. The last numbers of a column have the rows of
/// `target`.
#[inline(always)]
fn subtract_all(target: &mut [f64], panel: &[f64], n_panel: usize) {
    let n = target.len() / 3;
    let (first, others) = target.split_at_mut(n);
    let (second, third) = others.split_at_mut(n);
    // Three columns at once: the target is read and written once for them.
    for block in panel.chunks_exact(3 * n_panel) {
        let [a, b, c] = [1, 2, 3].map(|k| &block[k * n_panel - n..k * n_panel]);
        for (row, target) in [&mut *first, second, third].into_iter().enumerate() {
            let [by_a, by_b, by_c] = [a[row], b[row], c[row]];
            let rows = target.iter_mut().zip(a).zip(b.iter().zip(c));
            for ((value, a), (b, c)) in rows {
                *value = *value - a * by_a - b * by_b - c * by_c;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    #[test]
    fn wider_registers_give_the_same_bits() {
        let mut random = SplitMix64::new(2);
        let mut numbers = |n: usize| -> Vec<f64> { (0..n).map(|_| random.unit() - 0.5).collect() };
        let panel = numbers(6 * 60);
        let mut target = numbers(3 * 51);
        let mut same = target.clone();
        subtract(&mut target, &panel, 60);
        subtract_all(&mut same, &panel, 60);
        assert_eq!(target, same);
    }

    #[test]
    fn panels_have_the_same_rows_below_their_last_column() {
        // Columns with rows 0 2 4, 1 2 4, 2 4, 3 4, 4.
        let rows = [0, 2, 4, 1, 2, 4, 2, 4, 3, 4, 4];
        assert_eq!(panels(&[0, 3, 6, 8, 10, 11], &rows), [0..1, 1..3, 3..5]);
    }
}
