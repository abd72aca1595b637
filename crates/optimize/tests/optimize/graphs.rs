use dataset::{Pose2, SplitMix64, wrap_angle};
use optimize::{Edge, covariances, optimize, reject_false_closures};

use crate::world::gaussian;

const STD_M: f64 = 0.03;
const STD_RAD: f64 = 0.005;

fn pose(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
    Pose2 { x_m, y_m, heading_rad }
}

fn noisy(pose: &Pose2, [std_m, std_rad]: [f64; 2], random: &mut SplitMix64) -> Pose2 {
    let mut error = |std: f64| std * gaussian(random);
    *pose * Pose2 { x_m: error(std_m), y_m: error(std_m), heading_rad: error(std_rad) }
}

/// `n` poses along a square of 40 m, several laps of it.
fn laps(n: usize) -> Vec<Pose2> {
    let mut poses = vec![Pose2::default()];
    for k in 1..n {
        let turn = if k % 20 == 0 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
        poses.push(poses[k - 1] * pose(2.0, 0.0, turn));
    }
    poses
}

/// Odometry edges with noise, and the poses they add up to.
fn odometry(truth: &[Pose2], random: &mut SplitMix64) -> (Vec<Edge>, Vec<Pose2>) {
    let mut start = vec![truth[0]];
    let mut edges = Vec::new();
    for k in 1..truth.len() {
        let step = noisy(&(truth[k - 1].inverse() * truth[k]), [STD_M, STD_RAD], random);
        edges.push(Edge::independent(k - 1, k, step, STD_M, STD_RAD));
        start.push(start[k - 1] * step);
    }
    (edges, start)
}

fn right_closure(truth: &[Pose2], a: usize, b: usize, random: &mut SplitMix64) -> Edge {
    let measured = noisy(&(truth[a].inverse() * truth[b]), [0.05, 0.01], random);
    Edge::independent(a, b, measured, 0.05, 0.01)
}

/// A wrong relative pose: two places that look alike, at any heading.
fn wrong_closure(n: usize, random: &mut SplitMix64) -> Edge {
    let b = 40 + random.below(n as u64 - 40);
    let a = random.below(b as u64 - 30);
    let mut within = |half: f64| half * (2.0 * random.unit() - 1.0);
    let measured = pose(within(2.0), within(2.0), within(3.0));
    Edge::independent(a, b, measured, 0.05, 0.01)
}

fn worst_m(a: &[Pose2], b: &[Pose2]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.distance_m(b)).fold(0.0, f64::max)
}

#[test]
fn exact_measurements_give_the_exact_poses() {
    let truth = laps(90);
    let edge =
        |a: usize, b: usize| Edge::independent(a, b, truth[a].inverse() * truth[b], 0.1, 0.02);
    let mut edges: Vec<Edge> = (1..90).map(|k| edge(k - 1, k)).collect();
    edges.push(edge(3, 83));
    let mut start = truth.clone();
    for (k, pose) in start.iter_mut().enumerate().skip(1) {
        pose.x_m += 0.02 * k as f64;
        pose.heading_rad = wrap_angle(pose.heading_rad + 0.004 * k as f64);
    }
    let found = optimize(&edges, &start);
    assert!(worst_m(&found, &truth) < 1e-6, "{}", worst_m(&found, &truth));
    assert!(edges.iter().all(|edge| edge.chi2(&found) < 1e-9));
}

/// Along a straight line, the variances of the steps add up, and the heading turns the rest of the line.
#[test]
fn covariances_of_a_chain_are_the_sums_of_its_steps() {
    let n = 11;
    let poses: Vec<Pose2> = (0..n).map(|k| pose(k as f64, 0.0, 0.0)).collect();
    let edges: Vec<Edge> =
        (1..n).map(|k| Edge::independent(k - 1, k, pose(1.0, 0.0, 0.0), STD_M, STD_RAD)).collect();
    let found = covariances(&edges, &poses).unwrap();
    for (k, covariance) in found.iter().enumerate() {
        let k = k as f64;
        let near = |found: f64, expected: f64| (found - expected).abs() < 1e-5;
        assert!(near(covariance[(0, 0)], k * STD_M * STD_M), "{covariance}");
        assert!(near(covariance[(2, 2)], k * STD_RAD * STD_RAD), "{covariance}");
        // Step j turns the k - j steps after it, each of 1 m.
        let squares: f64 = (1..=k as usize).map(|j| (k - j as f64).powi(2)).sum();
        let expected = k * STD_M * STD_M + squares * STD_RAD * STD_RAD;
        assert!(near(covariance[(1, 1)], expected), "{covariance} {expected}");
    }
}

/// Four wrong closures per right one.
#[test]
fn of_80_percent_wrong_closures_none_is_kept() {
    for seed in 0..5 {
        let mut random = SplitMix64::new(seed);
        let truth = laps(240);
        let (edges, start) = odometry(&truth, &mut random);
        let mut closures: Vec<Edge> =
            (0..40).map(|k| right_closure(&truth, 4 * k, 4 * k + 80, &mut random)).collect();
        closures.extend((0..160).map(|_| wrong_closure(240, &mut random)));
        let found = reject_false_closures(&edges, &closures, &start);
        let n_right = found.is_kept[..40].iter().filter(|kept| **kept).count();
        let is_wrong = |edge: &Edge| 100.0 < edge.chi2(&truth);
        let n_wrong = closures
            .iter()
            .zip(&found.is_kept)
            .filter(|(edge, kept)| **kept && is_wrong(edge))
            .count();
        assert!(38 <= n_right && n_wrong == 0, "seed {seed}: {n_right} right, {n_wrong} wrong");
        // The poses are those of the right closures alone.
        let right: Vec<Edge> = edges.iter().chain(&closures[..40]).copied().collect();
        let expected = optimize(&right, &start);
        let off_m = worst_m(&found.poses, &expected);
        assert!(off_m < 0.2, "seed {seed}: {off_m} m");
    }
}

/// If nothing is kept, the poses are those of the odometry, whatever happened on the way.
#[test]
fn wrong_closures_alone_leave_the_odometry_as_it_is() {
    let mut random = SplitMix64::new(3);
    let truth = laps(200);
    let (edges, start) = odometry(&truth, &mut random);
    let closures: Vec<Edge> = (0..3).map(|_| wrong_closure(200, &mut random)).collect();
    let found = reject_false_closures(&edges, &closures, &start);
    assert_eq!(found.is_kept, [false; 3]);
    assert!(worst_m(&found.poses, &start) < 1e-6);
}
