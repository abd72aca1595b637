use dataset::{Pose2, RangeLimits, Scan, SplitMix64};
use model::Detector;
use register::{HeldScans, MatcherOptions, OdometryModel, OdometryStep, register_drive};

use crate::world::{World, gaussian, lap};

const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

/// Steps of 0.3 m with turns of up to 0.2 rad. The odometry is 5 % too short, counts 10 % too much of a
/// turn, and misses a turn of 2 deg per metre. In every tenth step the wheels slip.
fn steps(n: usize) -> Vec<OdometryStep> {
    let mut random = SplitMix64::new(5);
    (0..n)
        .map(|k| {
            let turn_rad = 0.2 * (2.0 * random.unit() - 1.0);
            let slip_m = if k % 10 == 0 { 0.2 } else { 0.0 };
            let odometry = Pose2 { x_m: 0.3, y_m: 0.0, heading_rad: turn_rad };
            let matched = Pose2 {
                x_m: 0.3 / 0.95 - slip_m + 0.002 * gaussian(&mut random),
                y_m: 0.002 * gaussian(&mut random),
                heading_rad: turn_rad / 1.1
                    + 0.3 * 2f64.to_radians()
                    + 0.001 * gaussian(&mut random),
            };
            OdometryStep { odometry, matched }
        })
        .collect()
}

#[test]
fn systematic_errors_are_found_despite_slipping_wheels() {
    let general = Detector::starting_values().odometry;
    let model = OdometryModel::fit(&steps(500), &general);
    assert!((model.scale - 1.0 / 0.95).abs() < 0.003, "{model:?}");
    assert!((model.turn_scale - 1.0 / 1.1).abs() < 0.01, "{model:?}");
    assert!((model.turn_rad_per_m.to_degrees() - 2.0).abs() < 0.1, "{model:?}");
    assert!(model.noise.std_m_per_m < 0.2 * general.std_m_per_m, "{model:?}");
    assert!(model.noise.std_rad_per_sqrt_m < 0.2 * general.std_rad_per_sqrt_m, "{model:?}");
}

#[test]
fn few_steps_correct_nothing() {
    let general = Detector::starting_values().odometry;
    let model = OdometryModel::fit(&steps(49), &general);
    assert_eq!(model, OdometryModel::unchanged(general));
}

/// A slip counts with the general error of odometry, other steps with that of the drive.
#[test]
fn a_slip_keeps_the_large_error() {
    let general = Detector::starting_values().odometry;
    let steps = steps(500);
    let model = OdometryModel::fit(&steps, &general);
    let along = |of: &dyn Fn(&OdometryStep) -> Pose2| {
        let mut poses = vec![Pose2::default()];
        steps.iter().for_each(|step| poses.push(poses[poses.len() - 1] * of(step)));
        poses
    };
    let corrected = along(&|step| model.corrected(&step.odometry));
    let matched = along(&|step| step.matched);
    let mut is_decided = vec![true; matched.len()];
    // The step that ends at scan 1 is a slip, and so is the one at scan 11.
    is_decided[11] = false;
    let noise = model.noise_of_steps(&corrected, &matched, &is_decided, &general);
    let expected = |k: usize| if k % 10 == 1 && k != 11 { general } else { model.noise };
    assert!((0..noise.len()).all(|k| noise[k] == expected(k)));
}

/// Pillars along the first 40 m of a corridor, then 45 m of bare walls. The odometry is 8 % too long: 5 m
/// at the end. What the pillars say about it holds along the bare walls, too.
#[test]
fn rooms_correct_the_odometry_in_corridors() {
    let mut world = World(vec![
        [[-30.0, -1.25], [60.0, -1.25]],
        [[-30.0, 1.25], [60.0, 1.25]],
        [[-30.0, -1.25], [-30.0, 1.25]],
    ]);
    for k in 0..13 {
        let x_m = -28.5 + 3.0 * f64::from(k);
        world.add_rectangle([x_m, -1.25], [x_m + 0.3, -0.9]);
        world.add_rectangle([x_m + 1.2, 0.9], [x_m + 1.6, 1.25]);
    }
    let at = |x_m: f64| Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 };
    let truth: Vec<Pose2> = (0..310).map(|k| at(-29.0 + 0.2 * f64::from(k))).collect();
    let mut random = SplitMix64::new(3);
    let scans: Vec<Scan> =
        truth.iter().map(|pose| world.scan(pose, 360, 0.01, &mut random)).collect();
    let odometry: Vec<Pose2> =
        truth.iter().map(|pose| at(-29.0 + 1.08 * (pose.x_m + 29.0))).collect();
    let noise = Detector::starting_values().odometry;
    let scans = HeldScans::new(scans, LIMITS);
    let registered = register_drive(&scans, &odometry, &noise, &MatcherOptions::default());
    let last = registered[registered.len() - 1];
    assert!(last.weakness.unwrap().ratio < 0.02, "{last:?}");
    let error_m = last.pose.distance_m(&truth[truth.len() - 1]);
    assert!(error_m < 0.7, "{error_m}");
}

/// From one scan to the next, the lidar is in a hall instead of a corridor, and the odometry goes on. This is a break.
/// A single scan of the hall is none, because the next scan is of the corridor again.
#[test]
fn scans_of_another_place_are_found() {
    let corridor = World::ring_corridor();
    let mut hall = World(Vec::new());
    hall.add_rectangle([-9.0, -7.5], [19.0, 16.0]);
    hall.add_rectangle([3.0, -6.0], [3.5, -5.5]);
    hall.add_rectangle([9.0, 3.0], [10.0, 5.0]);
    let truth = &lap()[..120];
    let breaks = |is_hall: &dyn Fn(usize) -> bool| {
        let mut random = SplitMix64::new(3);
        let scan = |(k, pose): (usize, &Pose2)| {
            let world = if is_hall(k) { &hall } else { &corridor };
            world.scan(pose, 360, 0.01, &mut random)
        };
        let scans: Vec<Scan> = truth.iter().enumerate().map(scan).collect();
        let noise = Detector::starting_values().odometry;
        let scans = HeldScans::new(scans, LIMITS);
        let registered = register_drive(&scans, truth, &noise, &MatcherOptions::default());
        (0..registered.len()).filter(|&k| registered[k].is_break).collect::<Vec<_>>()
    };
    assert_eq!(breaks(&|_| false), [0; 0]);
    assert_eq!(breaks(&|k| k == 60), [0; 0]);
    // Scans that agree with nothing: every second one is of the hall.
    assert_eq!(breaks(&|k| k % 2 == 0), [0; 0]);
    assert_eq!(breaks(&|k| 60 <= k), [60]);
}

/// Five laps with odometry whose heading drifts by chance. Long drives are matched in stretches of 512 scans. Where one
/// follows the other, the poses are as good as within a stretch, and the weakest direction is in the frame of the map.
#[test]
fn the_stretches_of_a_long_drive_follow_each_other() {
    let world = World::ring_corridor();
    let truth: Vec<Pose2> = (0..5).flat_map(|_| lap()[1..].to_vec()).collect();
    let mut random = SplitMix64::new(3);
    let scans: Vec<Scan> =
        truth.iter().map(|pose| world.scan(pose, 360, 0.01, &mut random)).collect();
    let mut odometry = vec![truth[0]];
    for pair in truth.windows(2) {
        let step = pair[0].inverse() * pair[1];
        let turn_rad = 0.1 * (random.unit() - 0.5);
        let measured = Pose2 { heading_rad: step.heading_rad + turn_rad, ..step };
        odometry.push(odometry[odometry.len() - 1] * measured);
    }
    let noise = Detector::starting_values().odometry;
    let registered = register_drive(
        &HeldScans::new(scans, LIMITS),
        &odometry,
        &noise,
        &MatcherOptions::default(),
    );
    let error = |poses: &dyn Fn(usize) -> Pose2, k: usize| {
        let between = |pose: &dyn Fn(usize) -> Pose2| pose(k - 3).inverse() * pose(k + 2);
        between(&|k| truth[k]).inverse() * between(poses)
    };
    for k in [256, 512, 768, 1024] {
        let found = error(&|k| registered[k].pose, k);
        let error_m = found.x_m.hypot(found.y_m);
        assert!(error_m < 0.02 && found.heading_rad.abs() < 0.005, "scan {k}: {found:?}");
        let by_odometry = odometry[k].distance_m(&truth[k]);
        assert!(1.0 < by_odometry, "scan {k}: {by_odometry} m");
    }
    // Along a side of the ring, the walls say less about the position along it.
    for (k, scan) in registered.iter().enumerate().skip(1) {
        let along = scan.weakness.unwrap().direction_rad - truth[k].heading_rad;
        let is_straight = truth[k - 1].heading_difference_rad(&truth[k]) < 1e-6;
        let is_middle = (20..40).contains(&(k % 240));
        if is_straight && is_middle {
            assert!(libm::sin(along).abs() < 0.2, "scan {k}: {along} rad");
        }
    }
}
