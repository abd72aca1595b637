//! Speed of descriptors and of candidates, on one thread.
//!
//! `cargo bench -p detect --bench candidates`
//!
//! A drive of 200 m along a hall with columns, 1000 scans of 180 beams. The time of
//! `candidates_of_80_places` includes 80 descriptors, about 1300 correlations, and the alignment of up to
//! 3 poses for each of about 350 candidates.

mod hall;

use detect::{Describer, Places, find_candidates};
use divan::Bencher;
use model::Detector;

use hall::{drive, scans, single_thread};

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 3)]
fn places_80(bencher: Bencher<'_, '_>) {
    let (scans, pool) = (scans(), single_thread());
    let drive = drive(&scans);
    bencher.bench_local(|| pool.install(|| Places::new(&drive, &drive.poses, 2.5, 5.0)));
}

#[divan::bench]
fn descriptor(bencher: Bencher<'_, '_>) {
    let scans = scans();
    let drive = drive(&scans[..100]);
    let places = Places::new(&drive, &drive.poses, 2.5, 5.0);
    let submap = &places.submaps[3];
    let describer = Describer::new(submap.n_squares());
    bencher.bench_local(|| describer.describe(submap));
}

#[divan::bench(sample_count = 3)]
fn candidates_of_80_places(bencher: Bencher<'_, '_>) {
    let (scans, pool) = (scans(), single_thread());
    let drive = drive(&scans);
    let places = Places::new(&drive, &drive.poses, 2.5, 5.0);
    let detector = Detector::starting_values();
    bencher
        .bench_local(|| pool.install(|| find_candidates(&drive, &places, &detector, 30.0, None)));
}
