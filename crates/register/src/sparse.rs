//! Symmetric systems of equations with a block of 3 by 3 per pair of poses that have to do with each
//! other.

use std::collections::BTreeSet;
use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::panel::{Panel, Scratch, panels};

/// `A x = b` with a fixed structure, where A is symmetric and has a row of blocks per pose.
///
/// The Cholesky factor is computed block by block in a fixed order, so that the same system gives the
/// same bytes on every machine and for any number of threads. The poses are eliminated in the order of
/// a minimum degree (George and Liu 1989, "The evolution of the minimum degree ordering algorithm"),
/// which keeps the factor sparse.
///
/// Where consecutive columns have the same rows, a few of them are eliminated together, so that the rest of
/// the factor is read once for all of them (supernodes, Ng and Peyton 1993, "Block sparse Cholesky algorithms on
/// advanced uniprocessor computers"). The sums have the same order as without.
#[derive(Debug, Clone)]
pub struct BlockSystem {
    /// When a pose is eliminated.
    place: Vec<usize>,
    /// The blocks of column `k` of the factor are `starts[k]..starts[k + 1]`.
    starts: Vec<usize>,
    /// The row of each block. Ascending within a column, the diagonal first.
    rows: Vec<u32>,
    /// Columns that are eliminated together: below the last one, all have the same rows.
    panels: Vec<Range<usize>>,
    /// A, with zeros where only the factor has a block. After a solution in place, its factor L, with `A = L L^T`.
    blocks: Vec<Matrix3<f64>>,
    /// b, in the order of elimination.
    right: Vec<Vector3<f64>>,
}

impl BlockSystem {
    /// A system for `n_poses` poses. Only the blocks of these pairs, and those on the diagonal, are
    /// ever added to.
    pub fn new(n_poses: usize, pairs: impl Iterator<Item = (usize, usize)>) -> Self {
        let (place, columns) = eliminate(n_poses, pairs);
        let mut starts = vec![0];
        let mut rows = Vec::new();
        for (k, column) in columns.iter().enumerate() {
            rows.push(k as u32);
            let first = rows.len();
            rows.extend(column.iter().map(|&pose| place[pose as usize] as u32));
            rows[first..].sort_unstable();
            starts.push(rows.len());
        }
        let blocks = vec![Matrix3::zeros(); rows.len()];
        let panels = panels(&starts, &rows);
        Self { place, starts, rows, panels, blocks, right: vec![Vector3::zeros(); n_poses] }
    }

    /// Sets A and b to 0.
    pub fn clear(&mut self) {
        self.blocks.fill(Matrix3::zeros());
        self.right.fill(Vector3::zeros());
    }

    /// Adds `block` to the block (a, b), and its transpose to the block (b, a) if `a != b`.
    ///
    /// # Panics
    /// If the pair is not one of the pairs given to [`BlockSystem::new`].
    pub fn add(&mut self, a: usize, b: usize, block: &Matrix3<f64>) {
        let (row, column) = (self.place[a], self.place[b]);
        if column <= row {
            let k = self.position(row, column);
            self.blocks[k] += block;
        } else {
            let k = self.position(column, row);
            self.blocks[k] += block.transpose();
        }
    }

    fn position(&self, row: usize, column: usize) -> usize {
        let first = self.starts[column];
        match self.rows[first..self.starts[column + 1]].binary_search(&(row as u32)) {
            Ok(k) => first + k,
            Err(_) => panic!("the block is not part of the structure"),
        }
    }

    /// Adds to b.
    pub fn add_right(&mut self, pose: usize, part: &Vector3<f64>) {
        self.right[self.place[pose]] += part;
    }

    /// Puts the factor of A plus `damping` times its diagonal in the place of A. `None` if that is not positive
    /// definite.
    fn factor(&mut self, damping: f64) -> Option<()> {
        for k in 0..self.right.len() {
            for d in 0..3 {
                self.blocks[self.starts[k]][(d, d)] *= 1.0 + damping;
            }
        }
        let panels = std::mem::take(&mut self.panels);
        let factored = panels.iter().try_for_each(|panel| self.eliminate(panel));
        self.panels = panels;
        factored
    }

    /// Eliminates the columns of a panel.
    fn eliminate(&mut self, panel: &Range<usize>) -> Option<()> {
        let starts = &self.starts;
        let (done, rest) = self.blocks.split_at_mut(starts[panel.end]);
        let mut of_panel = &mut done[starts[panel.start]..];
        for k in panel.clone() {
            let n = starts[k + 1] - starts[k];
            let (column, mut others) = of_panel.split_at_mut(n);
            let diagonal = cholesky(&column[0])?;
            let inverse = lower_inverse(&diagonal);
            column[0] = diagonal;
            for block in &mut column[1..] {
                *block *= inverse.transpose();
            }
            // The next columns have the rows of this one from their own row on.
            for row in 1..panel.end - k {
                let (next, after) = others.split_at_mut(n - row);
                let other = column[row];
                for (target, block) in next.iter_mut().zip(&column[row..]) {
                    // With the operations of `Panel::subtract_products`.
                    for k in 0..3 {
                        *target -= block.column(k) * other.column(k).transpose();
                    }
                }
                others = after;
            }
            of_panel = &mut std::mem::take(&mut of_panel)[n..];
        }
        let below = &self.rows[starts[panel.end - 1] + 1..starts[panel.end]];
        let of_column = |k: usize| &done[starts[k + 1] - below.len()..starts[k + 1]];
        let of_panel = Panel::new(below, panel.clone().map(of_column));
        let targets = columns(rest, starts, panel.end, below);
        let subtract = |scratch: &mut Scratch, (first, target): (usize, &mut [Matrix3<f64>])| {
            let column = below[first] as usize;
            let rows = &self.rows[starts[column]..starts[column + 1]];
            of_panel.subtract_products(first, target, rows, scratch);
        };
        if MANY_PRODUCTS < panel.len() * below.len() * below.len() / 2 {
            let targets = targets.into_par_iter().enumerate();
            targets.for_each_init(Scratch::default, subtract);
        } else {
            let mut scratch = Scratch::default();
            targets.into_iter().enumerate().for_each(|target| subtract(&mut scratch, target));
        }
        Some(())
    }

    /// The solution x after adding `damping` times the diagonal of A, one vector per pose. `None` if that is not
    /// positive definite. A is lost: call [`BlockSystem::clear`] before adding to it again.
    pub fn solve_in_place(&mut self, damping: f64) -> Option<Vec<Vector3<f64>>> {
        self.factor(damping)?;
        let mut x = self.right.clone();
        for k in 0..x.len() {
            let entries = self.starts[k]..self.starts[k + 1];
            x[k] = lower_inverse(&self.blocks[entries.start]) * x[k];
            for entry in entries.start + 1..entries.end {
                let part = self.blocks[entry] * x[k];
                x[self.rows[entry] as usize] -= part;
            }
        }
        for k in (0..x.len()).rev() {
            let entries = self.starts[k]..self.starts[k + 1];
            let mut sum = x[k];
            for entry in entries.start + 1..entries.end {
                sum -= self.blocks[entry].transpose() * x[self.rows[entry] as usize];
            }
            x[k] = lower_inverse(&self.blocks[entries.start]).transpose() * sum;
        }
        Some(self.place.iter().map(|&k| x[k]).collect())
    }

    /// The blocks on the diagonal of the inverse of A, one per pose: the covariances if A is the
    /// information of the poses. `None` if A is not positive definite.
    ///
    /// Only the blocks of the inverse in the structure of the factor are computed (Takahashi, Fagan and
    /// Chen 1973, "Formation of a sparse bus impedance matrix and its application to short circuit
    /// study"), column by column from the last one, each in the place of the factor.
    pub fn into_inverse_diagonal(mut self) -> Option<Vec<Matrix3<f64>>> {
        self.factor(0.0)?;
        for k in (0..self.right.len()).rev() {
            let entries = self.starts[k]..self.starts[k + 1];
            let below = entries.start + 1..entries.end;
            let of_diagonal = lower_inverse(&self.blocks[entries.start]);
            let scaled: Vec<Matrix3<f64>> =
                below.clone().map(|entry| self.blocks[entry] * of_diagonal).collect();
            let mut diagonal = of_diagonal.transpose() * of_diagonal;
            let sum = |i: usize| {
                let mut sum = Matrix3::zeros();
                for (j, factor) in below.clone().zip(&scaled) {
                    let (row, column) = (self.rows[i] as usize, self.rows[j] as usize);
                    sum -= if column <= row {
                        self.blocks[self.position(row, column)] * factor
                    } else {
                        self.blocks[self.position(column, row)].transpose() * factor
                    };
                }
                sum
            };
            let column: Vec<Matrix3<f64>> = match MANY_PRODUCTS < below.len() * below.len() {
                true => below.clone().into_par_iter().map(sum).collect(),
                false => below.clone().map(sum).collect(),
            };
            for (of_row, sum) in scaled.iter().zip(&column) {
                diagonal -= of_row.transpose() * sum;
            }
            self.blocks[below].copy_from_slice(&column);
            self.blocks[entries.start] = (diagonal + diagonal.transpose()) * 0.5;
        }
        Some(self.place.iter().map(|&k| self.blocks[self.starts[k]]).collect())
    }
}

/// The products of a panel are computed by several threads if there are more than this.
const MANY_PRODUCTS: usize = 20_000;

/// The columns with some ascending numbers, from the blocks of all columns from `first` on.
fn columns<'a>(
    mut blocks: &'a mut [Matrix3<f64>],
    starts: &[usize],
    first: usize,
    numbers: &[u32],
) -> Vec<&'a mut [Matrix3<f64>]> {
    let mut at = starts[first];
    let mut columns = Vec::with_capacity(numbers.len());
    for &number in numbers {
        let (start, end) = (starts[number as usize], starts[number as usize + 1]);
        let (column, rest) = blocks.split_at_mut(end - at);
        columns.push(&mut column[start - at..]);
        (blocks, at) = (rest, end);
    }
    columns
}

/// The order of elimination with the smallest degree first, ties by index: the place of each pose, and
/// for each place the poses that its column has blocks with below the diagonal.
fn eliminate(
    n_poses: usize,
    pairs: impl Iterator<Item = (usize, usize)>,
) -> (Vec<usize>, Vec<Vec<u32>>) {
    let mut neighbours: Vec<Vec<u32>> = vec![Vec::new(); n_poses];
    for (a, b) in pairs.filter(|(a, b)| a != b) {
        neighbours[a].push(b as u32);
        neighbours[b].push(a as u32);
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    let mut queue: BTreeSet<(usize, usize)> =
        neighbours.iter().enumerate().map(|(pose, list)| (list.len(), pose)).collect();
    let mut place = vec![0; n_poses];
    let mut columns = Vec::with_capacity(n_poses);
    while let Some((_, pose)) = queue.pop_first() {
        place[pose] = columns.len();
        let column = std::mem::take(&mut neighbours[pose]);
        if column.len() == queue.len() {
            // The rest is connected with each other. It is eliminated in the order of the indices.
            for (k, &pose) in column.iter().enumerate() {
                place[pose as usize] = columns.len() + 1 + k;
            }
            let rest: Vec<Vec<u32>> = (0..=column.len()).map(|k| column[k..].to_vec()).collect();
            columns.extend(rest);
            break;
        }
        for &number in &column {
            let other = number as usize;
            queue.remove(&(neighbours[other].len(), other));
            neighbours[other] = joined(&neighbours[other], &column, [number, pose as u32]);
            queue.insert((neighbours[other].len(), other));
        }
        columns.push(column);
    }
    (place, columns)
}

/// The union of two ascending lists without two of the numbers.
fn joined(a: &[u32], b: &[u32], without: [u32; 2]) -> Vec<u32> {
    let mut all = Vec::with_capacity(a.len() + b.len());
    let (mut i, mut j) = (0, 0);
    while i < a.len() || j < b.len() {
        let next = match (a.get(i), b.get(j)) {
            (Some(&x), Some(&y)) => x.min(y),
            (Some(&x), None) => x,
            (None, Some(&y)) => y,
            (None, None) => break,
        };
        i += usize::from(a.get(i) == Some(&next));
        j += usize::from(b.get(j) == Some(&next));
        if !without.contains(&next) {
            all.push(next);
        }
    }
    all
}

/// The lower factor L of `a = L L^T`, from the lower triangle of `a`. `None` if `a` is not positive
/// definite.
fn cholesky(a: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let mut l = Matrix3::zeros();
    for column in 0..3 {
        let mut rest = a[(column, column)];
        for k in 0..column {
            rest -= l[(column, k)] * l[(column, k)];
        }
        // False for NaN.
        if !(0.0 < rest && rest.is_finite()) {
            return None;
        }
        let root = rest.sqrt();
        l[(column, column)] = root;
        for row in column + 1..3 {
            let mut rest = a[(row, column)];
            for k in 0..column {
                rest -= l[(row, k)] * l[(column, k)];
            }
            l[(row, column)] = rest / root;
        }
    }
    Some(l)
}

/// The inverse of a lower triangle.
fn lower_inverse(l: &Matrix3<f64>) -> Matrix3<f64> {
    let (a, b, c) = (1.0 / l[(0, 0)], 1.0 / l[(1, 1)], 1.0 / l[(2, 2)]);
    let ba = -l[(1, 0)] * a * b;
    let cb = -l[(2, 1)] * b * c;
    let ca = -(l[(2, 0)] * a + l[(2, 1)] * ba) * c;
    Matrix3::new(a, 0.0, 0.0, ba, b, 0.0, ca, cb, c)
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::panel::MAX_PANEL;

    /// Random positive definite systems, compared with nalgebra's dense solution and inverse.
    #[test]
    fn solutions_and_inverses_are_those_of_a_dense_solver() {
        let mut random = SplitMix64::new(7);
        for n in [1usize, 2, 5, 30] {
            let mut pairs: Vec<(usize, usize)> = (1..n).map(|k| (k - 1, k)).collect();
            for _ in 0..n {
                pairs.push((random.below(n as u64), random.below(n as u64)));
            }
            pairs.retain(|(a, b)| a != b);
            let mut system = BlockSystem::new(n, pairs.iter().copied());
            let mut dense = DMatrix::zeros(3 * n, 3 * n);
            let mut right = DVector::zeros(3 * n);
            let mut number = || random.unit() * 2.0 - 1.0;
            // Sums of J^T J are positive semi-definite, like those of a pose graph.
            for &(a, b) in &pairs {
                let [ja, jb]: [Matrix3<f64>; 2] = [0, 1].map(|_| Matrix3::from_fn(|_, _| number()));
                for (p, jp) in [(a, ja), (b, jb)] {
                    for (q, jq) in [(a, ja), (b, jb)] {
                        let block = jp.transpose() * jq;
                        let mut view = dense.fixed_view_mut::<3, 3>(3 * p, 3 * q);
                        view += block;
                    }
                }
                system.add(a, a, &(ja.transpose() * ja));
                system.add(b, b, &(jb.transpose() * jb));
                system.add(a, b, &(ja.transpose() * jb));
            }
            for pose in 0..n {
                system.add(pose, pose, &Matrix3::from_diagonal_element(0.1));
                let part = Vector3::from_fn(|_, _| number());
                system.add_right(pose, &part);
                for d in 0..3 {
                    dense[(3 * pose + d, 3 * pose + d)] += 0.1;
                    right[3 * pose + d] = part[d];
                }
            }
            let inverse = dense.clone().try_inverse().unwrap();
            let expected = &inverse * right;
            for (pose, x) in system.clone().solve_in_place(0.0).unwrap().iter().enumerate() {
                assert!((x - expected.fixed_rows::<3>(3 * pose)).norm() < 1e-9, "{n} {pose}");
            }
            let blocks = system.clone().into_inverse_diagonal().unwrap();
            for (pose, block) in blocks.iter().enumerate() {
                let expected = inverse.fixed_view::<3, 3>(3 * pose, 3 * pose);
                assert!((block - expected).norm() < 1e-9, "{n} {pose} {block} {expected}");
            }
            system.add(0, 0, &Matrix3::from_diagonal_element(-1e6));
            assert!(system.clone().solve_in_place(0.0).is_none(), "not positive definite");
            assert!(system.into_inverse_diagonal().is_none(), "not positive definite");
        }
    }

    /// A dense system of 80 poses behind a chain of 40. The factor has the bits of the columns eliminated one after the
    /// other.
    #[test]
    fn panels_give_the_bits_of_single_columns() {
        let mut random = SplitMix64::new(3);
        let chain = (1..40).map(|k| (k - 1, k));
        let dense = (40..120).flat_map(|a| (a + 1..120).map(move |b| (a, b)));
        let pairs: Vec<(usize, usize)> = chain.chain([(20, 60), (39, 40)]).chain(dense).collect();
        let mut system = BlockSystem::new(120, pairs.iter().copied());
        for &(a, b) in &pairs {
            system.add(a, b, &Matrix3::from_fn(|_, _| random.unit() - 0.5));
        }
        (0..120).for_each(|k| system.add(k, k, &Matrix3::from_diagonal_element(100.0)));
        assert!(system.panels.iter().any(|panel| panel.len() == MAX_PANEL));
        let n_products = |p: &Range<usize>| {
            p.len() * (system.starts[p.end] - system.starts[p.end - 1]).pow(2) / 2
        };
        assert!(system.panels.iter().any(|panel| MANY_PRODUCTS < n_products(panel)));
        let mut single = system.clone();
        single.panels = (0..120).map(|k| k..k + 1).collect();
        system.factor(0.0).unwrap();
        single.factor(0.0).unwrap();
        assert_eq!(system.blocks, single.blocks);
    }

    /// A dense system of 160 poses, whose columns are inverted by several threads.
    #[test]
    fn the_inverse_of_a_dense_system_does_not_depend_on_the_threads() {
        const N: usize = 160;
        const { assert!(MANY_PRODUCTS < (N - 1) * (N - 1)) };
        let mut random = SplitMix64::new(11);
        let pairs: Vec<(usize, usize)> =
            (0..N).flat_map(|a| (a + 1..N).map(move |b| (a, b))).collect();
        let mut system = BlockSystem::new(N, pairs.iter().copied());
        let mut dense = DMatrix::identity(3 * N, 3 * N) * 400.0;
        (0..N).for_each(|k| system.add(k, k, &Matrix3::from_diagonal_element(400.0)));
        for (a, b) in pairs {
            let block = Matrix3::from_fn(|_, _| random.unit() - 0.5);
            system.add(a, b, &block);
            dense.fixed_view_mut::<3, 3>(3 * a, 3 * b).copy_from(&block);
            dense.fixed_view_mut::<3, 3>(3 * b, 3 * a).copy_from(&block.transpose());
        }
        let with_threads = |n: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            pool.install(|| system.clone().into_inverse_diagonal().unwrap())
        };
        let blocks = with_threads(3);
        assert_eq!(blocks, with_threads(1));
        let inverse = dense.try_inverse().unwrap();
        for (k, block) in blocks.iter().enumerate() {
            assert!((block - inverse.fixed_view::<3, 3>(3 * k, 3 * k)).norm() < 1e-12, "{k}");
        }
    }

    /// A ring of poses with chords: the factor stays sparse.
    #[test]
    fn the_factor_of_a_drive_with_closures_is_sparse() {
        let n = 1000;
        let chain = (1..n).map(|k| (k - 1, k));
        let closures = (0..n / 2).step_by(50).map(|k| (k, k + n / 2));
        let system = BlockSystem::new(n, chain.chain(closures));
        assert!(system.rows.len() < 4 * n, "{} blocks", system.rows.len());
    }
}
