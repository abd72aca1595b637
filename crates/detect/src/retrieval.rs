//! Exact search of the most similar descriptors.

use std::ops::Range;

use rayon::prelude::*;

/// Descriptors that are compared at once. Their products fit into the cache.
const QUERIES_PER_BLOCK: usize = 256;
const REFERENCES_PER_BLOCK: usize = 512;

/// Descriptors with each of their numbers scaled to mean 0 and standard deviation 1.
#[derive(Debug, Clone)]
pub struct Descriptors {
    len: usize,
    /// Row-major values, `(n, len)`.
    values: Vec<f32>,
    /// Half of the squared length of each row.
    half_squares: Vec<f32>,
    /// The longest row.
    longest: f64,
    /// Mean and scale of each number, `(len,)`.
    scaling: Vec<[f64; 2]>,
}

/// A similar descriptor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similar {
    /// Index of the descriptor.
    pub reference: usize,
    /// Squared Euclidean distance of the descriptors.
    pub distance_squared: f64,
}

impl Descriptors {
    /// Scales descriptors. A number that is the same everywhere becomes 0.
    ///
    /// # Panics
    /// If the rows have different lengths, or if a number is not finite.
    pub fn new(rows: &[Vec<f32>]) -> Self {
        let len = rows.first().map_or(0, Vec::len);
        assert!(rows.iter().all(|row| row.len() == len), "descriptors have the same length");
        assert!(rows.iter().flatten().all(|v| v.is_finite()), "descriptors are finite");
        let n = rows.len().max(1) as f64;
        let mut values = vec![0.0; rows.len() * len];
        let mut scaling = Vec::with_capacity(len);
        for column in 0..len {
            let of_column = || rows.iter().map(|row| f64::from(row[column]));
            let mean = of_column().sum::<f64>() / n;
            let std = libm::sqrt(of_column().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n);
            // Equal numbers can have a mean that differs from them by a rounding error.
            let is_constant = std <= 1e-9 * mean.abs();
            let scale = if is_constant { 0.0 } else { 1.0 / std };
            for (row, value) in of_column().enumerate() {
                values[row * len + column] = ((value - mean) * scale) as f32;
            }
            scaling.push([mean, scale]);
        }
        let square = |row: &[f32]| row.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>();
        let squares: Vec<f64> =
            (0..rows.len()).map(|k| square(&values[k * len..][..len])).collect();
        Self {
            len,
            values,
            half_squares: squares.iter().map(|&s| (s / 2.0) as f32).collect(),
            longest: libm::sqrt(squares.iter().copied().fold(0.0, f64::max)),
            scaling,
        }
    }

    /// Number of descriptors.
    pub fn n(&self) -> usize {
        self.half_squares.len()
    }

    /// For each descriptor `q`, the `k` most similar ones among the first `n_references[q]`, the most
    /// similar one first. Of equally similar ones, the one with the lower index comes first.
    ///
    /// The search is exact. A product of matrices in f32 excludes what cannot be among the `k`, with a
    /// bound on its rounding error. The distances of the others are computed in f64, in a fixed
    /// order. So the result depends neither on the number of threads nor on the processor.
    ///
    /// # Panics
    /// If `n_references` does not have one entry per descriptor, or if an entry is more than their number.
    pub fn most_similar(&self, k: usize, n_references: &[usize]) -> Vec<Vec<Similar>> {
        assert_eq!(n_references.len(), self.n(), "one number of references per descriptor");
        assert!(n_references.iter().all(|&n| n <= self.n()), "references are descriptors");
        let blocks: Vec<usize> = (0..self.n()).step_by(QUERIES_PER_BLOCK).collect();
        // The last blocks have the most references.
        let mut similar: Vec<Vec<Vec<Similar>>> = blocks
            .par_iter()
            .rev()
            .map(|&first| {
                let queries = first..(first + QUERIES_PER_BLOCK).min(self.n());
                self.most_similar_of_block(&queries, k, n_references)
            })
            .collect();
        similar.reverse();
        similar.into_iter().flatten().collect()
    }

    /// The `k` descriptors that are most similar to another one, which is scaled like these. The order is
    /// that of [`Descriptors::most_similar`]. The time is that of one pass over all descriptors.
    ///
    /// # Panics
    /// If the descriptor has another length.
    pub fn most_similar_to(&self, row: &[f32], k: usize) -> Vec<Similar> {
        assert!(self.n() == 0 || row.len() == self.len, "descriptors have the same length");
        let scaled = row.iter().zip(&self.scaling).map(|(&v, [mean, scale])| {
            let scaled = (f64::from(v) - mean) * scale;
            scaled as f32
        });
        let scaled: Vec<f32> = scaled.collect();
        let of_row = |reference: usize| Similar {
            reference,
            distance_squared: squared_distance(&scaled, self.row(reference)),
        };
        let mut similar: Vec<Similar> = (0..self.n()).map(of_row).collect();
        if k < similar.len() && 0 < k {
            similar.select_nth_unstable_by(k, nearer);
        }
        similar.truncate(k);
        similar.sort_unstable_by(nearer);
        similar
    }

    fn row(&self, k: usize) -> &[f32] {
        &self.values[k * self.len..][..self.len]
    }

    fn most_similar_of_block(
        &self,
        queries: &Range<usize>,
        k: usize,
        n_references: &[usize],
    ) -> Vec<Vec<Similar>> {
        let mut shortlists: Vec<Shortlist> =
            queries.clone().map(|q| Shortlist::new(k, self.error_bound(q))).collect();
        let n = queries.clone().map(|q| n_references[q]).max().unwrap_or(0);
        let mut products = vec![0.0f32; QUERIES_PER_BLOCK * REFERENCES_PER_BLOCK];
        for first in (0..if k == 0 { 0 } else { n }).step_by(REFERENCES_PER_BLOCK) {
            let references = first..(first + REFERENCES_PER_BLOCK).min(n);
            self.products(queries, &references, &mut products);
            let half_squares = &self.half_squares[references.clone()];
            for ((row, query), shortlist) in queries.clone().enumerate().zip(&mut shortlists) {
                let n = references.len().min(n_references[query].saturating_sub(first));
                let products = &products[row * REFERENCES_PER_BLOCK..][..n];
                shortlist.offer(first, products, &half_squares[..n]);
            }
        }
        let of_query = |(query, shortlist): (usize, Shortlist)| {
            let mut similar: Vec<Similar> = shortlist
                .finish()
                .map(|reference| Similar {
                    reference,
                    distance_squared: self.distance_squared(query, reference),
                })
                .collect();
            similar.sort_by(nearer);
            similar.truncate(k);
            similar
        };
        queries.clone().zip(shortlists).map(of_query).collect()
    }

    /// The squared distance of two descriptors, summed in the order of the numbers.
    fn distance_squared(&self, a: usize, b: usize) -> f64 {
        squared_distance(self.row(a), self.row(b))
    }

    /// How much `half_square - product` of a query can be wrong, for any reference.
    ///
    /// A sum of products of n pairs in f32, in any order, with or without fused operations, is wrong by at
    /// most g |a| |b| with g = n e / (1 - n e) and e = 2^-24 (Higham, "Accuracy and Stability of
    /// Numerical Algorithms", 2nd edition, section 3.1). The rounded half square and the difference add
    /// at most 3 e (|b|^2 / 2 + |a| |b|).
    fn error_bound(&self, query: usize) -> f32 {
        let e = f64::from(f32::EPSILON) / 2.0;
        let n_e = (self.len + 2) as f64 * e;
        let length = libm::sqrt(2.0 * f64::from(self.half_squares[query])) * (1.0 + 1e-6);
        let product = length * self.longest;
        let bound =
            n_e / (1.0 - n_e) * product + 3.0 * e * (self.longest * self.longest / 2.0 + product);
        (bound * (1.0 + 1e-6)) as f32
    }

    /// The products of two blocks of rows.
    fn products(&self, queries: &Range<usize>, references: &Range<usize>, products: &mut [f32]) {
        let (m, n) = (queries.len(), references.len());
        let stride = self.len as isize;
        let a = &self.values[queries.start * self.len..queries.end * self.len];
        let b = &self.values[references.start * self.len..references.end * self.len];
        assert!(m <= QUERIES_PER_BLOCK && n <= REFERENCES_PER_BLOCK);
        assert!(products.len() == QUERIES_PER_BLOCK * REFERENCES_PER_BLOCK);
        // SAFETY: `a` has m rows and `b` has n rows of `len` values, and `products` has
        // `QUERIES_PER_BLOCK` rows of `REFERENCES_PER_BLOCK` values. The first n values of the first m rows are written.
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
                REFERENCES_PER_BLOCK as isize,
                1,
            );
        }
    }
}

/// The order of similar descriptors.
fn nearer(a: &Similar, b: &Similar) -> std::cmp::Ordering {
    a.distance_squared.total_cmp(&b.distance_squared).then(a.reference.cmp(&b.reference))
}

/// The squared distance, summed in the order of the numbers.
fn squared_distance(a: &[f32], b: &[f32]) -> f64 {
    let square = |(a, b): (&f32, &f32)| {
        let difference = f64::from(*a) - f64::from(*b);
        difference * difference
    };
    a.iter().zip(b).map(square).sum()
}

/// The references that can be among the k most similar ones of a query.
struct Shortlist {
    k: usize,
    /// References with a larger value than this are left out.
    limit: f32,
    /// Twice the error bound: one value may be too large, another one too small.
    slack: f32,
    /// Half square of the reference minus product, and reference.
    entries: Vec<(f32, u32)>,
    /// The entries are sorted out when they are this many.
    capacity: usize,
}

/// Values that are compared with the limit at once.
const CHUNK: usize = 16;

impl Shortlist {
    fn new(k: usize, error_bound: f32) -> Self {
        let capacity = 4 * k + 16;
        let slack = 2.0 * error_bound;
        Self { k, limit: f32::INFINITY, slack, entries: Vec::new(), capacity }
    }

    fn offer(&mut self, first: usize, products: &[f32], half_squares: &[f32]) {
        for (chunk, (products, half_squares)) in
            products.chunks(CHUNK).zip(half_squares.chunks(CHUNK)).enumerate()
        {
            let mut n_near = 0u32;
            for (product, half_square) in products.iter().zip(half_squares) {
                n_near += u32::from(half_square - product <= self.limit);
            }
            if n_near == 0 {
                continue;
            }
            for (k, (product, half_square)) in products.iter().zip(half_squares).enumerate() {
                let value = half_square - product;
                if value <= self.limit {
                    self.entries.push((value, (first + chunk * CHUNK + k) as u32));
                }
            }
            if self.capacity <= self.entries.len() {
                self.sort_out();
            }
        }
    }

    /// Removes what cannot be among the k.
    fn sort_out(&mut self) {
        if self.entries.len() <= self.k {
            return;
        }
        let (_, kth, _) =
            self.entries.select_nth_unstable_by(self.k - 1, |a, b| a.0.total_cmp(&b.0));
        let sum = kth.0 + self.slack;
        // The sum is rounded too.
        self.limit = sum + f32::EPSILON * sum.abs();
        self.entries.retain(|entry| entry.0 <= self.limit);
        self.capacity = self.capacity.max(2 * self.entries.len());
    }

    fn finish(mut self) -> impl Iterator<Item = usize> {
        if 0 < self.k {
            self.sort_out();
        }
        self.entries.into_iter().map(|(_, reference)| reference as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::SplitMix64;

    /// All distances in f64, sorted by distance and index.
    fn exhaustive(
        descriptors: &Descriptors,
        k: usize,
        n_references: &[usize],
    ) -> Vec<Vec<Similar>> {
        (0..descriptors.n())
            .map(|query| {
                let mut similar: Vec<Similar> = (0..n_references[query])
                    .map(|reference| Similar {
                        reference,
                        distance_squared: descriptors.distance_squared(query, reference),
                    })
                    .collect();
                similar.sort_by(|a, b| {
                    let by_distance = a.distance_squared.total_cmp(&b.distance_squared);
                    by_distance.then(a.reference.cmp(&b.reference))
                });
                similar.truncate(k);
                similar
            })
            .collect()
    }

    fn random_rows(n: usize, len: usize) -> Vec<Vec<f32>> {
        let mut random = SplitMix64::new(11);
        (0..n).map(|_| (0..len).map(|_| random.unit() as f32).collect()).collect()
    }

    fn check(rows: &[Vec<f32>], k: usize, n_references: &[usize]) {
        let descriptors = Descriptors::new(rows);
        let found = descriptors.most_similar(k, n_references);
        assert_eq!(found, exhaustive(&descriptors, k, n_references));
    }

    #[test]
    fn the_search_equals_an_exhaustive_search() {
        let n = 1100usize;
        let earlier: Vec<usize> = (0..n).map(|q| q.saturating_sub(30)).collect();
        for k in [0, 1, 5, 50, 2000] {
            check(&random_rows(n, 40), k, &earlier);
        }
        check(&random_rows(n, 40), 3, &vec![n; n]);
        check(&random_rows(3, 1), 3, &[0, 1, 3]);
        check(&[], 3, &[]);
    }

    /// A row of the table as the other descriptor: the same distances.
    #[test]
    fn another_descriptor_is_scaled_like_those_of_the_table() {
        let rows = random_rows(50, 12);
        let descriptors = Descriptors::new(&rows);
        for k in [0, 1, 7, 60] {
            let expected = exhaustive(&descriptors, k, &[50; 50]);
            assert_eq!(descriptors.most_similar_to(&rows[3], k), expected[3]);
        }
        assert!(Descriptors::new(&[]).most_similar_to(&rows[3], 4).is_empty());
    }

    /// Every row is there three times, and a fourth time with a difference far below the rounding error of
    /// a product in f32.
    #[test]
    fn equal_distances_are_ordered_by_index_and_small_differences_count() {
        let mut rows = random_rows(300, 60);
        let first = rows.clone();
        rows.extend(first.clone());
        rows.extend(first.clone());
        rows.extend(first.into_iter().map(|mut row| {
            row[7] *= 1.0 + 4.0 * f32::EPSILON;
            row
        }));
        let n = rows.len();
        for k in [1, 2, 3, 7] {
            check(&rows, k, &vec![n; n]);
        }
        let found = Descriptors::new(&rows).most_similar(3, &vec![900; n]);
        let references: Vec<usize> = found[5].iter().map(|s| s.reference).collect();
        assert_eq!(references, [5, 305, 605]);
        // All rows are the same.
        check(&vec![vec![0.1; 8]; 700], 4, &vec![700; 700]);
    }

    /// Column 0 has mean 2 and standard deviation 1. Column 1 is constant.
    #[test]
    fn numbers_are_scaled_and_constant_numbers_become_0() {
        let descriptors =
            Descriptors::new(&[vec![1.0, 0.1], vec![3.0, 0.1], vec![3.0, 0.1], vec![1.0, 0.1]]);
        assert_eq!(descriptors.values, [-1.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0]);
        let found = descriptors.most_similar(2, &[0, 1, 2, 3]);
        let of_last = [
            Similar { reference: 0, distance_squared: 0.0 },
            Similar { reference: 1, distance_squared: 4.0 },
        ];
        assert_eq!(found[3], of_last);
    }
}
