//! Speed of the search of similar places, beside the product of matrices that it cannot do without.
//!
//! `cargo bench -p detect --bench retrieval`
//!
//! The places of a drive of 100,000 places: each is compared with all earlier ones.

use dataset::SplitMix64;
use detect::{DESCRIPTOR_LEN, Descriptors};
use divan::Bencher;
use rayon::prelude::*;

fn main() {
    divan::main();
}

const SIZES: [usize; 2] = [10_000, 100_000];

fn rows(n: usize) -> Vec<Vec<f32>> {
    let mut random = SplitMix64::new(1);
    (0..n).map(|_| (0..DESCRIPTOR_LEN).map(|_| random.unit() as f32).collect()).collect()
}

#[divan::bench(args = SIZES, sample_count = 1)]
fn search(bencher: Bencher<'_, '_>, n: usize) {
    let descriptors = Descriptors::new(&rows(n));
    let earlier: Vec<usize> = (0..n).map(|query| query.saturating_sub(12)).collect();
    bencher.bench_local(|| descriptors.most_similar(50, &earlier));
}

/// The products of all pairs of rows with an earlier row, in blocks, which are thrown away.
#[divan::bench(args = SIZES, sample_count = 1)]
fn product_only(bencher: Bencher<'_, '_>, n: usize) {
    const BLOCK: usize = 512;
    let values: Vec<f32> = rows(n).concat();
    let stride = DESCRIPTOR_LEN as isize;
    let product = |first: usize, other: usize, products: &mut [f32]| {
        let (m, k) = (BLOCK.min(n - first), BLOCK.min(n - other));
        assert!(BLOCK * BLOCK == products.len() && values.len() == n * DESCRIPTOR_LEN);
        // SAFETY: m rows from `first` and k rows from `other` are inside `values`, and m rows of `BLOCK`
        // products are inside `products`.
        unsafe {
            matrixmultiply::sgemm(
                m,
                DESCRIPTOR_LEN,
                k,
                1.0,
                values.as_ptr().add(first * DESCRIPTOR_LEN),
                stride,
                1,
                values.as_ptr().add(other * DESCRIPTOR_LEN),
                1,
                stride,
                0.0,
                products.as_mut_ptr(),
                BLOCK as isize,
                1,
            );
        }
        products[0]
    };
    bencher.bench_local(|| {
        let blocks: Vec<usize> = (0..n).step_by(BLOCK).collect();
        let of_block = |&first: &usize| -> f32 {
            let mut products = vec![0.0f32; BLOCK * BLOCK];
            (0..=first).step_by(BLOCK).map(|other| product(first, other, &mut products)).sum()
        };
        blocks.par_iter().rev().map(of_block).sum::<f32>()
    });
}
