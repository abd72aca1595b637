//! `paper16` against plain loops over the formulas of docs/features.md, without vectors, lanes or
//! shortcuts.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use std::f64::consts::TAU;

use dataset::Scan;
use featurize::{PAPER16_NAMES, Paper16};
use proptest::collection::vec;
use proptest::prelude::{Just, Strategy, prop_oneof};
use proptest::{prop_assert, proptest};

/// The features of a scan, one return at a time.
fn reference(scan: &Scan, gate_m: f64) -> [f64; 16] {
    let points: Vec<[f64; 2]> = scan.points().collect();
    let n = points.len();
    let is_ring = 355.0 <= scan.coverage_deg;
    let m = if is_ring { n } else { n - 1 };
    let steps: Vec<([f64; 2], [f64; 2])> =
        (0..m).map(|i| (points[i], points[(i + 1) % n])).collect();
    let lengths: Vec<f64> = steps.iter().map(|(p, q)| distance(*p, *q)).collect();
    let angles: Vec<f64> =
        steps.iter().map(|(p, q)| cross(*p, *q).abs().atan2(dot(*p, *q))).collect();
    let ranges: Vec<f64> = points.iter().map(|p| distance(*p, [0.0; 2])).collect();
    let mean = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n as f64);
    let from_mean: Vec<f64> = points.iter().map(|p| distance(*p, mean)).collect();
    let (centre, radius) = kasa_circle(&points, mean);
    let is_close = |i: &usize| lengths[*i] <= gate_m;
    let n_breaks = (0..m).filter(|i| !is_close(i)).count();
    let groups = if is_ring { n_breaks.max(1) } else { n_breaks + 1 } as f64;
    let curvatures = curvatures(&points, is_ring, gate_m, stride(&angles));
    let curvature_mean = match curvatures.len() {
        0 => 0.0,
        n => curvatures.iter().sum::<f64>() / n as f64,
    };
    [
        distance(mean, [0.0; 2]),
        (0..m).filter(is_close).map(|i| 0.5 * cross(steps[i].0, steps[i].1).abs()).sum(),
        (0..m).filter(is_close).map(|i| lengths[i]).sum(),
        radius,
        points.iter().map(|p| (radius - distance(*p, centre)).powi(2)).sum(),
        curvature_mean,
        sample_std(&curvatures),
        lengths.iter().sum(),
        groups,
        n as f64 / groups,
        angles.iter().sum::<f64>() / m as f64,
        (from_mean.iter().map(|d| d * d).sum::<f64>() / (n as f64 - 1.0)).sqrt(),
        sample_std(&lengths),
        n as f64,
        sample_std(&from_mean),
        sample_std(&ranges),
    ]
}

/// max(1, round(1 deg / median angle)); `None` if the median is 0.
fn stride(angles: &[f64]) -> Option<usize> {
    let mut sorted = angles.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = 0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]);
    (0.0 < median).then(|| ((1f64.to_radians() / median).round() as usize).max(1))
}

/// Menger curvatures of the triples whose sides are all in (0, g].
fn curvatures(points: &[[f64; 2]], is_ring: bool, gate_m: f64, stride: Option<usize>) -> Vec<f64> {
    let Some(stride) = stride else { return Vec::new() };
    let n = points.len();
    let n_triples = if is_ring { n } else { n.saturating_sub(stride.saturating_mul(2)) };
    let step = if is_ring { stride % n } else { stride };
    let triple = |i: usize| [i, i + step, i + 2 * step].map(|k| points[k % n]);
    let triples = (0..n_triples).map(triple);
    let curvature = |[p, q, r]: [[f64; 2]; 3]| {
        let sides = [distance(p, q), distance(q, r), distance(p, r)];
        let is_counted = sides.iter().all(|side| 0.0 < *side && *side <= gate_m);
        let doubled_area = cross([q[0] - p[0], q[1] - p[1]], [r[0] - p[0], r[1] - p[1]]).abs();
        is_counted.then(|| 2.0 * doubled_area / sides.iter().product::<f64>())
    };
    triples.filter_map(curvature).collect()
}

/// Centre and radius of the circle that minimises the sum of (|p - c|^2 - R^2)^2.
fn kasa_circle(points: &[[f64; 2]], mean: [f64; 2]) -> ([f64; 2], f64) {
    let (mut suu, mut suv, mut svv, mut bu, mut bv) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for [x, y] in points {
        let (u, v) = (x - mean[0], y - mean[1]);
        suu += u * u;
        suv += u * v;
        svv += v * v;
        bu += u * (u * u + v * v) / 2.0;
        bv += v * (u * u + v * v) / 2.0;
    }
    let det = suu * svv - suv * suv;
    let (uc, vc) = ((bu * svv - bv * suv) / det, (bv * suu - bu * suv) / det);
    let radius = (uc * uc + vc * vc + (suu + svv) / points.len() as f64).sqrt();
    ([mean[0] + uc, mean[1] + vc], radius)
}

/// Sample standard deviation; 0 for fewer than 2 values.
fn sample_std(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if n < 2.0 {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
}

fn distance(p: [f64; 2], q: [f64; 2]) -> f64 {
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    (dx * dx + dy * dy).sqrt()
}

fn dot(p: [f64; 2], q: [f64; 2]) -> f64 {
    p[0] * q[0] + p[1] * q[1]
}

fn cross(p: [f64; 2], q: [f64; 2]) -> f64 {
    p[0] * q[1] - q[0] * p[1]
}

/// Whether the points are far from lying on one line. Near a line, rounding changes the circle.
fn is_well_conditioned(scan: &Scan) -> bool {
    let n = scan.len() as f64;
    let mean = scan.points().fold([0.0; 2], |sum, p| [sum[0] + p[0] / n, sum[1] + p[1] / n]);
    let (mut sxx, mut sxy, mut syy) = (0.0, 0.0, 0.0);
    for [x, y] in scan.points() {
        let (dx, dy) = (x - mean[0], y - mean[1]);
        sxx += dx * dx;
        sxy += dx * dy;
        syy += dy * dy;
    }
    1e-4 * (sxx + syy).powi(2) < sxx * syy - sxy * sxy
}

/// Scans of 3 to 400 returns: random points, and rings or arcs with noise, whose neighbours are a
/// fraction of a degree apart.
fn any_scan() -> impl Strategy<Value = Scan> {
    let metres = || prop_oneof![-70f32..70.0, -1f32..1.0];
    let n_returns = || prop_oneof![Just(3usize), 3..20usize, 3..400usize];
    let points = n_returns().prop_flat_map(move |n| vec((metres(), metres()), n));
    let arc = (n_returns(), 10f64..360.0).prop_flat_map(|(n, arc_deg)| {
        vec(3f64..8.0, n).prop_map(move |ranges| {
            let angle = |k: usize| k as f64 / n as f64 * arc_deg / 360.0 * TAU;
            let point =
                |(k, r): (usize, f64)| ((r * angle(k).cos()) as f32, (r * angle(k).sin()) as f32);
            ranges.into_iter().enumerate().map(point).collect::<Vec<_>>()
        })
    });
    let coverage_deg = prop_oneof![Just(360f32), Just(355.0), Just(354.9), 0f32..360.0];
    (prop_oneof![points, arc], coverage_deg).prop_map(|(points, coverage_deg)| {
        let (x_m, y_m) = points.into_iter().unzip();
        Scan { x_m, y_m, coverage_deg, ..Scan::default() }
    })
}

proptest! {
    #[test]
    fn features_equal_plain_loops_over_the_formulas(
        scan in any_scan(),
        gate_m in prop_oneof![Just(2.5), 0.1..10.0],
    ) {
        if !is_well_conditioned(&scan) {
            return Ok(());
        }
        let found = Paper16::new(gate_m).features(&scan).unwrap();
        let expected = reference(&scan, gate_m);
        let (n, radius) = (expected[13], expected[3]);
        for ((name, found), expected) in PAPER16_NAMES.iter().zip(found).zip(expected) {
            // Sums of differences lose digits to the size of what was subtracted.
            let unit = match *name {
                "circle_residual" => n * (radius + 100.0).powi(2),
                "curvature_mean" | "curvature_std" => expected.abs(),
                _ => expected.abs() + 100.0,
            };
            let tolerance = if name.starts_with("circle") { 1e-9 } else { 1e-12 };
            prop_assert!(
                (found - expected).abs() <= tolerance * unit + 1e-12,
                "{}: {}, expected {}", name, found, expected
            );
        }
    }
}
