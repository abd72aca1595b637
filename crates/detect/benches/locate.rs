//! The worst case of the time to locate a scan, on one thread, in a map of 80 places: 1 m of path, which are five
//! scans. Two of them at most are compared with the map, while a position is searched, and while it is followed.
//!
//! `cargo bench -p detect --bench locate`

mod hall;

use dataset::{LocatedState, Pose2, RangeLimits};
use detect::{Locator, LocatorMap, MapDrive};
use divan::Bencher;
use model::Detector;
use register::RegisterOptions;

use hall::{drive, scans, single_thread};

const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };
const STEP: Pose2 = Pose2 { x_m: 0.2, y_m: 0.0, heading_rad: 0.0 };
/// The locator begins this many scans before the first one that is measured: 60 m.
const N_BEFORE: usize = 300;

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn search_step(bencher: Bencher<'_, '_>) {
    time_of_a_scan(bencher, &no_position(), LocatedState::Searching);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn follow_step(bencher: Bencher<'_, '_>) {
    time_of_a_scan(bencher, &Detector::starting_values(), LocatedState::Located);
}

/// A detector that never trusts a pose, so that the search goes on.
fn no_position() -> Detector {
    let mut detector = Detector::starting_values();
    detector.verifier_without_classifier.intercept = -100.0;
    detector
}

fn time_of_a_scan(bencher: Bencher<'_, '_>, detector: &Detector, state: LocatedState) {
    let (scans, pool) = (scans(), single_thread());
    let drive = drive(&scans);
    let parts = [MapDrive { drive: &drive, poses: &drive.poses, map: 0 }];
    let map = LocatorMap::new(&parts, 2.5, 5.0);
    let mut locator = Locator::new(&map, detector, &RegisterOptions::default(), LIMITS);
    let mut add = |scan| locator.add(scan, Some(STEP));
    for scan in &scans[..N_BEFORE] {
        add(scan);
    }
    let mut states = Vec::new();
    let mut next = scans[N_BEFORE..].chunks_exact(5);
    bencher.bench_local(|| {
        pool.install(|| states.extend(next.next().into_iter().flatten().map(&mut add)));
    });
    assert!(!states.is_empty() && states.iter().all(|found| *found == state));
}
