//! Exact search of the most similar descriptors.

use rayon::prelude::*;

/// Rows of queries and of references that are compared at once. Their products fit into the cache.
const BLOCK: usize = 256;

/// Descriptors with each of their numbers scaled to mean 0 and standard deviation 1.
pub struct Descriptors {
    len: usize,
    /// Row-major values, `(n, len)`.
    values: Vec<f32>,
    /// Half of the squared length of each row.
    half_squares: Vec<f32>,
}

/// A similar descriptor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similar {
    /// Index of the descriptor.
    pub reference: usize,
    /// Half of the squared distance of the descriptors.
    pub half_square: f32,
}

impl Descriptors {
    /// Scales descriptors. A number that is the same everywhere becomes 0.
    pub fn new(rows: &[Vec<f32>]) -> Self {
        let len = rows.first().map_or(0, Vec::len);
        let n = rows.len().max(1) as f64;
        let mut values = vec![0.0; rows.len() * len];
        for column in 0..len {
            let of_column = || rows.iter().map(|row| f64::from(row[column]));
            let mean = of_column().sum::<f64>() / n;
            let std = libm::sqrt(of_column().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n);
            let scale = if std > 0.0 { 1.0 / std } else { 0.0 };
            for (row, value) in of_column().enumerate() {
                values[row * len + column] = ((value - mean) * scale) as f32;
            }
        }
        let half = |row: &[f32]| row.iter().map(|v| v * v).sum::<f32>() / 2.0;
        let half_squares = values.chunks_exact(len.max(1)).map(half).collect();
        Self { len, values, half_squares }
    }

    /// Number of descriptors.
    pub fn n(&self) -> usize {
        self.half_squares.len()
    }

    /// For each descriptor, the `k` most similar ones among those for which `may_match(query,
    /// reference)` is true, the most similar one first. Of equally similar ones, the one with the
    /// lower index counts.
    ///
    /// All pairs are compared, in blocks, as products of matrices. The result does not depend on the
    /// number of threads.
    pub fn most_similar(
        &self,
        k: usize,
        may_match: impl Fn(usize, usize) -> bool + Sync,
    ) -> Vec<Vec<Similar>> {
        let blocks: Vec<usize> = (0..self.n()).step_by(BLOCK).collect();
        let of_block = |&first: &usize| self.most_similar_of_block(first, k, &may_match);
        blocks.par_iter().map(of_block).flatten_iter().collect()
    }

    fn most_similar_of_block(
        &self,
        first: usize,
        k: usize,
        may_match: &(impl Fn(usize, usize) -> bool + Sync),
    ) -> Vec<Vec<Similar>> {
        let queries = first..(first + BLOCK).min(self.n());
        let mut similar: Vec<Vec<Similar>> = vec![Vec::new(); queries.len()];
        let mut products = vec![0.0f32; BLOCK * BLOCK];
        for other in (0..self.n()).step_by(BLOCK) {
            let references = other..(other + BLOCK).min(self.n());
            self.products(&queries, &references, &mut products);
            for (row, query) in queries.clone().enumerate() {
                for (column, reference) in references.clone().enumerate() {
                    let half_square = self.half_squares[query] + self.half_squares[reference]
                        - products[row * BLOCK + column];
                    let best = &mut similar[row];
                    let is_better = best.len() < k
                        || best.last().is_some_and(|last| half_square < last.half_square);
                    if 0 < k && is_better && may_match(query, reference) {
                        let at = best.partition_point(|s| s.half_square <= half_square);
                        best.insert(at, Similar { reference, half_square });
                        best.truncate(k);
                    }
                }
            }
        }
        similar
    }

    /// The products of two blocks of rows.
    fn products(
        &self,
        queries: &std::ops::Range<usize>,
        references: &std::ops::Range<usize>,
        products: &mut [f32],
    ) {
        let (m, n) = (queries.len(), references.len());
        let stride = self.len as isize;
        let a = &self.values[queries.start * self.len..queries.end * self.len];
        let b = &self.values[references.start * self.len..references.end * self.len];
        assert!(m <= BLOCK && n <= BLOCK && products.len() == BLOCK * BLOCK);
        // SAFETY: `a` has m rows and `b` has n rows of `len` values, and `products` has m rows of
        // `BLOCK` values, of which n are written.
        unsafe {
            matrixmultiply::sgemm(
                m,
                self.len,
                n,
                1.0,
                a.as_ptr(),
                stride,
                1,
                b.as_ptr(),
                1,
                stride,
                0.0,
                products.as_mut_ptr(),
                BLOCK as isize,
                1,
            );
        }
    }
}
