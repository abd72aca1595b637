use dataset::{Pose2, RangeLimits, SplitMix64};
use model::Detector;
use register::{HeldScans, MatcherOptions, Registered, register_drive};

use crate::matching::drifting;
use crate::world::{World, lap};

const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

/// Three laps with 720 scans, more than the 512 that are matched at a time. The poses across the
/// start of the second stretch are as good as elsewhere, and the same with one thread and with three.
#[test]
fn a_drive_has_no_seam_where_a_stretch_starts() {
    let lap = lap();
    let truth: Vec<Pose2> = lap.iter().cycle().take(720).copied().collect();
    let world = World::ring_corridor();
    let mut random = SplitMix64::new(3);
    let scans = truth.iter().map(|pose| world.scan(pose, 360, 0.01, &mut random));
    let scans = HeldScans::new(scans, LIMITS);
    let odometry = drifting(&truth, 1.03, 1.0);
    let register = |n_threads: usize| -> Vec<Registered> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        let noise = Detector::starting_values().odometry;
        pool.install(|| register_drive(&scans, &odometry, &noise, &MatcherOptions::default()))
    };
    let registered = register(1);
    let error_m = |from: usize, to: usize| {
        let expected = truth[from].inverse() * truth[to];
        (registered[from].pose.inverse() * registered[to].pose).distance_m(&expected)
    };
    let across: Vec<f64> = (503..512).map(|from| error_m(from, from + 9)).collect();
    let largest = across.iter().copied().fold(0.0, f64::max);
    assert!(largest < 0.03, "{across:?}");
    assert_eq!(registered, register(3), "with three threads");
}
