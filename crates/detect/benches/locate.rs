//! The worst case of the time for one scan, on one thread: a scan that ends a step of the search, in a
//! map of 80 places that all look alike, and one that ends a step of following.
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
/// A step of the odometry that is longer than the path between two steps of the search.
const STEP: Pose2 = Pose2 { x_m: 1.0, y_m: 0.0, heading_rad: 0.0 };

fn main() {
    divan::main();
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn search_step(bencher: Bencher<'_, '_>) {
    time_of_a_scan(bencher, Detector { n_candidates: 8, ..no_position() }, LocatedState::Searching);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn follow_step(bencher: Bencher<'_, '_>) {
    time_of_a_scan(bencher, Detector::starting_values(), LocatedState::Located);
}

/// A detector that never trusts a pose, so that the search goes on.
fn no_position() -> Detector {
    let mut detector = Detector::starting_values();
    detector.verifier_without_classifier.intercept = -100.0;
    detector
}

fn time_of_a_scan(bencher: Bencher<'_, '_>, detector: Detector, state: LocatedState) {
    let (scans, pool) = (scans(), single_thread());
    let drive = drive(&scans);
    let parts = [MapDrive { drive: &drive, poses: &drive.poses, map: 0 }];
    let map = LocatorMap::new(&parts, 2.5, 5.0);
    let mut locator = Locator::new(&map, &detector, &RegisterOptions::default(), LIMITS);
    // Scans 1 m apart. The locator begins 30 m before the first one that is measured.
    let mut next = scans.iter().step_by(5);
    for scan in next.by_ref().take(30) {
        locator.add(scan, Some(STEP));
    }
    assert_eq!(locator.state(), state);
    let mut next = next.cycle();
    bencher.bench_local(|| pool.install(|| next.next().map(|scan| locator.add(scan, Some(STEP)))));
}
