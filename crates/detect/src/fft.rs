//! Two-dimensional Fourier transforms of real images.

use std::sync::Arc;

use realfft::num_complex::Complex32;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// Transforms of real images of `n` by `n` pixels. The transform has `n` rows of `n / 2 + 1` values.
pub(crate) struct Fft2 {
    n: usize,
    rows: Arc<dyn RealToComplex<f32>>,
    rows_back: Arc<dyn ComplexToReal<f32>>,
    columns: Arc<dyn Fft<f32>>,
    columns_back: Arc<dyn Fft<f32>>,
}

/// Memory for transforms, so that they need not allocate.
#[derive(Default)]
pub(crate) struct Scratch {
    row: Vec<f32>,
    /// The spectrum by columns, `(n / 2 + 1, n)`.
    by_column: Vec<Complex32>,
    complex: Vec<Complex32>,
}

impl Fft2 {
    pub(crate) fn new(n: usize) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        Self {
            n,
            rows: real.plan_fft_forward(n),
            rows_back: real.plan_fft_inverse(n),
            columns: complex.plan_fft_forward(n),
            columns_back: complex.plan_fft_inverse(n),
        }
    }

    /// Number of values of a transform.
    pub(crate) fn n_values(&self) -> usize {
        self.n * (self.n / 2 + 1)
    }

    fn width(&self) -> usize {
        self.n / 2 + 1
    }

    /// Transforms an image. The result is stored by column, `(n / 2 + 1, n)`: products of two
    /// transforms do not depend on the order.
    pub(crate) fn forward(&self, image: &[f32], scratch: &mut Scratch) -> Vec<Complex32> {
        let (n, width) = (self.n, self.width());
        let mut by_column = vec![Complex32::default(); self.n_values()];
        scratch.row.resize(n, 0.0);
        scratch.complex.resize(width.max(n), Complex32::default());
        for (k, row) in image.chunks_exact(n).enumerate() {
            scratch.row.copy_from_slice(row);
            // The lengths are those of the plan.
            let _ = self.rows.process(&mut scratch.row, &mut scratch.complex[..width]);
            for (column, value) in scratch.complex[..width].iter().enumerate() {
                by_column[column * n + k] = *value;
            }
        }
        by_column.chunks_exact_mut(n).for_each(|column| self.columns.process(column));
        by_column
    }

    /// The image of a transform, times `n * n`. The transform is overwritten.
    pub(crate) fn inverse(
        &self,
        by_column: &mut [Complex32],
        image: &mut [f32],
        scratch: &mut Scratch,
    ) {
        let (n, width) = (self.n, self.width());
        by_column.chunks_exact_mut(n).for_each(|column| self.columns_back.process(column));
        scratch.complex.resize(width.max(n), Complex32::default());
        for (k, row) in image.chunks_exact_mut(n).enumerate() {
            for (column, value) in scratch.complex[..width].iter_mut().enumerate() {
                *value = by_column[column * n + k];
            }
            // Rounding leaves small imaginary parts in the first and the last value.
            scratch.complex[0].im = 0.0;
            scratch.complex[width - 1].im = 0.0;
            let _ = self.rows_back.process(&mut scratch.complex[..width], row);
        }
    }
}
