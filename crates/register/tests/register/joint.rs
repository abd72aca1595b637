use dataset::{Pose2, RangeLimits, SplitMix64};
use model::Detector;
use register::{HeldScans, JointOptions, JointScans, align_jointly, pairs_along_path};

use crate::world::{World, gaussian, lap};

const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

/// Two laps, with errors of some centimetres of each pose, and one of 0.05 m between the laps. With all poses at once and
/// with few at once, what is left is the noise of the scans.
#[test]
fn stretches_of_a_drive_end_where_all_of_it_does() {
    let world = World::ring_corridor();
    let mut random = SplitMix64::new(3);
    let of_lap = lap();
    let truth: Vec<Pose2> = of_lap.iter().chain(&of_lap[1..]).copied().collect();
    let scans = truth.iter().map(|pose| world.scan(pose, 360, 0.01, &mut random));
    let source = HeldScans::new(scans.collect::<Vec<_>>(), LIMITS);
    let n = truth.len();
    let path_m: Vec<f64> = (0..n).map(|k| 0.2 * k as f64).collect();
    let mut pairs = pairs_along_path(&path_m);
    pairs.extend((of_lap.len()..n).map(|k| (k + 1 - of_lap.len(), k)));
    let moved = |(k, pose): (usize, &Pose2)| Pose2 {
        x_m: pose.x_m + 0.02 * gaussian(&mut random) + if k < of_lap.len() { 0.0 } else { 0.05 },
        y_m: pose.y_m + 0.02 * gaussian(&mut random),
        heading_rad: pose.heading_rad + 0.01 * gaussian(&mut random),
    };
    let mut start: Vec<Pose2> = truth.iter().enumerate().map(moved).collect();
    // It stays.
    start[0] = truth[0];
    let noise = vec![Some(Detector::starting_values().odometry); n];
    // Of one drive, the first scan stays. Then the laps are two drives, and the first one stays.
    let mut noise_of_two = noise.clone();
    noise_of_two[of_lap.len()] = None;
    let aligned = |n_held: usize, start: &[Pose2], max_at_once: usize| {
        let is_held: Vec<bool> = (0..n).map(|k| k < n_held).collect();
        let joint = JointScans {
            source: &source,
            odometry: &truth,
            path_m: &path_m,
            noise: if n_held == 1 { &noise } else { &noise_of_two },
            is_held: &is_held,
        };
        let options = JointOptions { iterations: 6, max_at_once, ..JointOptions::default() };
        align_jointly(&joint, start, &pairs, &options)
    };
    let worst_m = |a: &[Pose2], b: &[Pose2]| {
        a.iter().zip(b).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max)
    };
    assert!(0.1 < worst_m(&start, &truth));
    for max_at_once in [n, 150, 50] {
        let worst_m = worst_m(&aligned(1, &start, max_at_once), &truth);
        assert!(worst_m < 0.02, "{max_at_once} at once: {worst_m}");
    }
    start[..of_lap.len()].copy_from_slice(&of_lap);
    for max_at_once in [n, 150, 50] {
        let poses = aligned(of_lap.len(), &start, max_at_once);
        assert_eq!(poses[..of_lap.len()], of_lap);
        let worst_m = worst_m(&poses, &truth);
        assert!(worst_m < 0.02, "{max_at_once} at once: {worst_m}");
    }
}
