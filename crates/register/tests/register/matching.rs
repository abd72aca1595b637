use std::f64::consts::PI;

use dataset::{Pose2, RangeLimits, SplitMix64, wrap_angle};
use model::{Detector, OdometryNoise};
use nalgebra::Vector3;
use register::{
    AlignOptions, BlurredMap, Matched, MatcherOptions, Points, Preference, Prior, ScanMatcher,
    Target, Window, align, align_and_explain, align_roughly, search,
};

use crate::world::{World, lap};

/// A robot with bad wheels.
fn noise() -> OdometryNoise {
    Detector::starting_values().odometry
}

const LIMITS: RangeLimits = RangeLimits { min_m: 0.1, max_m: 25.0 };

/// Odometry of a drive: each step is scaled by `scale`, and the heading drifts by `bias_deg_per_m`.
pub fn drifting(truth: &[Pose2], scale: f64, bias_deg_per_m: f64) -> Vec<Pose2> {
    let mut odometry = vec![truth[0]];
    for pair in truth.windows(2) {
        let step = pair[0].inverse() * pair[1];
        let step_m = step.x_m.hypot(step.y_m);
        let measured = Pose2 {
            x_m: scale * step.x_m,
            y_m: scale * step.y_m,
            heading_rad: step.heading_rad + (bias_deg_per_m * step_m).to_radians(),
        };
        odometry.push(odometry[odometry.len() - 1] * measured);
    }
    odometry
}

fn matched(
    world: &World,
    truth: &[Pose2],
    odometry: &[Pose2],
    coverage_deg: u32,
    options: MatcherOptions,
    noise: OdometryNoise,
) -> Vec<Matched> {
    let mut random = SplitMix64::new(11);
    let mut matcher = ScanMatcher::new(options, noise);
    let steps = truth.iter().zip(odometry);
    steps
        .map(|(truth, odometry)| {
            let scan = world.scan(truth, coverage_deg, 0.01, &mut random);
            matcher.add(Points::from_scan(&scan, LIMITS), odometry)
        })
        .collect()
}

/// Median error of the relative pose over 10 m of path: position \[m\] and heading \[deg\].
fn error_over_10_m(truth: &[Pose2], estimated: &[Pose2]) -> (f64, f64) {
    let error = |from: usize, to: usize| {
        let [expected, found] = [truth, estimated].map(|poses| poses[from].inverse() * poses[to]);
        let error = expected.inverse() * found;
        (error.x_m.hypot(error.y_m), error.heading_rad.abs().to_degrees())
    };
    let errors: Vec<(f64, f64)> = (50..truth.len()).map(|to| error(to - 50, to)).collect();
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    (
        median(errors.iter().map(|error| error.0).collect()),
        median(errors.iter().map(|error| error.1).collect()),
    )
}

/// The odometry turns by 4 deg per metre too much and is 5 % too long: 40 deg and 3.6 m off after 10 m.
/// Both kinds of scanners correct it.
#[test]
fn odometry_that_drifts_by_degrees_per_metre_is_corrected() {
    let (world, truth) = (World::ring_corridor(), lap());
    let odometry = drifting(&truth, 1.05, 4.0);
    let (before_m, _) = error_over_10_m(&truth, &odometry);
    assert!(before_m > 3.0, "{before_m}");
    for coverage_deg in [180, 360] {
        let matched =
            matched(&world, &truth, &odometry, coverage_deg, MatcherOptions::default(), noise());
        let poses: Vec<Pose2> = matched.iter().map(|matched| matched.pose).collect();
        let (error_m, error_deg) = error_over_10_m(&truth, &poses);
        assert!(error_m < 0.03 && error_deg < 0.6, "{coverage_deg}: {error_m} m, {error_deg} deg");
    }
}

/// Half way along a side, the robot rolls back by 0.5 m while its wheels count 0.5 m forward. Only the
/// further starts find the pose, 1 m behind that of the odometry.
#[test]
fn a_robot_that_reverses_while_its_wheels_count_forward_is_found() {
    let world = World::ring_corridor();
    let step = |x_m: f64| Pose2 { x_m, y_m: -1.25, heading_rad: 0.0 };
    let mut truth: Vec<Pose2> = (0..=25).map(|k| step(0.2 * f64::from(k))).collect();
    let mut odometry = truth.clone();
    truth.push(step(4.5));
    odometry.push(step(5.5));
    let loose = OdometryNoise { std_m_per_m: 1.0, ..noise() };
    let error_m = |options: MatcherOptions| {
        let matched = matched(&world, &truth, &odometry, 360, options, loose);
        matched.last().unwrap().pose.distance_m(truth.last().unwrap())
    };
    let with = MatcherOptions::default();
    assert!(error_m(with) < 0.1, "{}", error_m(with));
    let without = MatcherOptions { enough_near_share: 0.0, ..with };
    assert!(error_m(without) > 0.5, "{}", error_m(without));
}

/// Two parallel walls without end: along them the pose is that of the odometry, with its standard
/// deviation of 0.15 * 0.2 m + 0.02 m. Across them the walls say more.
#[test]
fn in_a_bare_corridor_the_odometry_decides_along_the_axis() {
    let world = World(vec![[[-500.0, -1.0], [500.0, -1.0]], [[-500.0, 1.5], [500.0, 1.5]]]);
    let truth: Vec<Pose2> =
        (0..30).map(|k| Pose2 { x_m: 0.2 * f64::from(k), y_m: 0.0, heading_rad: 0.0 }).collect();
    let odometry: Vec<Pose2> = truth
        .iter()
        .map(|pose| Pose2 { x_m: 0.9 * pose.x_m, y_m: 0.01 * pose.x_m, ..*pose })
        .collect();
    let matched = matched(&world, &truth, &odometry, 360, MatcherOptions::default(), noise());
    for (matched, odometry) in matched.iter().zip(&odometry).skip(1) {
        let pose = matched.pose;
        // The noise of the returns moves the pose a little, because normals are estimated.
        assert!((pose.x_m - odometry.x_m).abs() < 0.05, "{pose:?} {odometry:?}");
        assert!(pose.y_m.abs() < 0.02 && pose.heading_rad.abs() < 0.01, "{pose:?}");
        let weakness = matched.weakness.unwrap();
        let off_axis = wrap_angle(2.0 * weakness.direction_rad).abs() / 2.0;
        assert!(weakness.ratio < 0.05 && off_axis < 0.1, "{weakness:?}");
        let covariance = matched.covariance.unwrap();
        let [along_m, across_m] = [0, 1].map(|k| covariance[(k, k)].sqrt());
        assert!((0.02..=0.05).contains(&along_m) && across_m < 0.01, "{along_m} {across_m}");
    }
}

/// In a room the points determine the position in all directions.
#[test]
fn a_room_has_no_weak_direction() {
    let mut room = World(Vec::new());
    room.add_rectangle([-3.0, -2.0], [3.0, 2.0]);
    let mut random = SplitMix64::new(5);
    let mut points =
        |pose: &Pose2| Points::from_scan(&room.scan(pose, 360, 0.01, &mut random), LIMITS);
    let options = AlignOptions::default();
    let target = Target::new(points(&Pose2::default()), options.first_gate_m);
    let truth = Pose2 { x_m: 0.4, y_m: -0.2, heading_rad: 0.2 };
    let (start, prior) = (Pose2::default(), Prior::none(Pose2::default()));
    let source = points(&truth);
    let explained = align_and_explain(&source, &target, &start, &prior, &options);
    let aligned = explained.alignment;
    let found = aligned.target_from_source;
    assert!(found.distance_m(&truth) < 0.01 && (found.heading_rad - 0.2).abs() < 0.005);
    assert!(explained.near_share > 0.95 && aligned.n_partners > 300, "{explained:?}");
    assert!(aligned.weakness.unwrap().ratio > 0.3, "{:?}", aligned.weakness);
    assert_eq!(align(&source, &target, &start, &prior, &options), aligned);
    let rough = align_roughly(&source, &target, &start, &prior, &options);
    assert!(rough != found && rough.distance_m(&found) < 0.02, "{rough:?}");
    assert!(rough.heading_difference_rad(&found) < 0.005, "{rough:?}");
}

/// The errors of 200 alignments with known noise, in a room, agree with the covariance: the mean of the
/// normalized squared error has 3 degrees of freedom. It may be smaller, since the default covariance
/// allows for returns that are not independent; here they are.
#[test]
fn covariances_are_not_too_small() {
    let mut room = World(Vec::new());
    room.add_rectangle([-3.0, -2.0], [3.5, 2.5]);
    let mut random = SplitMix64::new(9);
    let options = AlignOptions { points_per_measurement: 1.0, ..AlignOptions::default() };
    let truth = Pose2 { x_m: 0.05, y_m: -0.03, heading_rad: 0.02 };
    let mut sum = 0.0;
    for _ in 0..200 {
        let mut points = |pose: &Pose2, noise_m| {
            Points::from_scan(&room.scan(pose, 360, noise_m, &mut random), LIMITS)
        };
        let target = Target::new(points(&Pose2::default(), 0.0), options.first_gate_m);
        let source = points(&truth, options.noise_m);
        let start = Pose2::default();
        let aligned = align(&source, &target, &start, &Prior::none(start), &options);
        let found = aligned.target_from_source;
        let error = Vector3::new(
            found.x_m - truth.x_m,
            found.y_m - truth.y_m,
            found.heading_rad - truth.heading_rad,
        );
        let covariance = aligned.covariance(&options).unwrap();
        sum += (error.transpose() * covariance.try_inverse().unwrap() * error)[(0, 0)];
    }
    let mean = sum / 200.0;
    assert!((1.0..=3.6).contains(&mean), "{mean}");
}

/// Without a point in common, the pose stays at the prior, and nothing is near.
#[test]
fn without_partners_the_pose_is_that_of_the_prior() {
    let options = AlignOptions::default();
    let far = Points { positions_m: vec![[50.0, 50.0]; 9], normals: vec![Some([1.0, 0.0]); 9] };
    let target = Target::new(far, options.first_gate_m);
    let source = Points { positions_m: vec![[1.0, 0.0]; 9], normals: vec![None; 9] };
    let prior = Prior::independent(Pose2 { x_m: 1.0, y_m: 2.0, heading_rad: PI }, 0.1, 0.1, 0.1);
    let explained = align_and_explain(&source, &target, &Pose2::default(), &prior, &options);
    let aligned = explained.alignment;
    assert!(aligned.target_from_source.distance_m(&prior.pose) < 1e-3);
    assert_eq!((aligned.n_partners, explained.near_share), (0, 0.0));
    assert_eq!(aligned.weakness, None);
    let covariance = aligned.covariance(&options).unwrap();
    assert!((covariance[(0, 0)] - 0.01).abs() < 1e-9);
    let start = Pose2::default();
    let empty = align_and_explain(&Points::default(), &target, &start, &prior, &options);
    assert_eq!(empty.near_share, 0.0);
}

/// The search finds the best of all poses in the window, and the centre for points that nothing
/// distinguishes.
#[test]
fn the_search_finds_the_pose_with_the_most_points_on_walls() {
    let mut room = World(Vec::new());
    room.add_rectangle([-3.0, -2.0], [3.0, 2.0]);
    let mut random = SplitMix64::new(2);
    let truth = Pose2 { x_m: 0.3, y_m: -0.2, heading_rad: 6f64.to_radians() };
    let mut points =
        |pose: &Pose2| Points::from_scan(&room.scan(pose, 360, 0.0, &mut random), LIMITS);
    let map = BlurredMap::new(&points(&Pose2::default()), 0.05, 0.1);
    let window = Window {
        centre: Pose2::default(),
        half_width_m: 0.4,
        step_m: 0.1,
        half_turn_rad: 10f64.to_radians(),
        step_rad: 1f64.to_radians(),
    };
    let none = Preference { pose: Pose2::default(), per_m2: 0.0, per_rad2: 0.0 };
    let found = search(&map, &points(&truth), &window, &none);
    assert!(found.pose.distance_m(&truth) < 0.06, "{found:?}");
    assert!((found.pose.heading_rad - truth.heading_rad).abs() < 1.1f64.to_radians(), "{found:?}");
    assert!(found.score > 0.8, "{found:?}");
    let nothing = search(&map, &Points::default(), &window, &none);
    assert_eq!((nothing.pose, nothing.score), (Pose2::default(), 0.0));
    // A strong preference wins against the points.
    let strong = Preference { per_m2: 1e3, per_rad2: 1e3, ..none };
    assert_eq!(search(&map, &points(&truth), &window, &strong).pose, Pose2::default());
}
