//! The features of `paper16` for scans that are small enough to compute every number by hand.
//!
//! Notation as in docs/features.md: `n` returns, `m` steps, gate `g`, stride `s`.

#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may panic and prints its results"
)]

use std::f64::consts::{PI, SQRT_2};

use dataset::{Scan, Unusable};
use featurize::{FeatureSet, PAPER16_NAMES, Paper16, difference};
use proptest::collection::vec;
use proptest::prelude::{Strategy, any, prop_oneof};
use proptest::{prop_assert, prop_assert_eq, proptest};

const GATE_M: f64 = 2.5;
/// Tolerance for points that are exact in f32.
const TIGHT: f64 = 1e-12;
/// Tolerance for points on a circle. f32 rounds their coordinates by up to 6e-8 of their value.
const ROUNDED: f64 = 1e-6;
const RING_DEG: f32 = 360.0;
const OPEN_DEG: f32 = 180.0;

fn features(scan: &Scan) -> [f64; 16] {
    Paper16::new(GATE_M).features(scan).unwrap()
}

/// Asserts the values of the named features. The tolerance is relative, or absolute if 0 is expected.
#[track_caller]
fn check(gate_m: f64, scan: &Scan, tolerance: f64, expected: &[(&str, f64)]) {
    let features = Paper16::new(gate_m).features(scan).unwrap();
    for &(name, expected) in expected {
        let found = features[PAPER16_NAMES.iter().position(|&n| n == name).expect(name)];
        let unit = if expected == 0.0 { 1.0 } else { expected.abs() };
        let is_close = (found - expected).abs() <= tolerance * unit;
        assert!(is_close, "{name}: {found}, expected {expected}");
    }
}

fn scan(coverage_deg: f32, points: impl IntoIterator<Item = (f64, f64)>) -> Scan {
    let (x_m, y_m) = points.into_iter().map(|(x, y)| (x as f32, y as f32)).unzip();
    Scan { x_m, y_m, coverage_deg, ..Scan::default() }
}

fn map_points(scan: &Scan, map: impl Fn(f32, f32) -> (f32, f32)) -> Scan {
    let (x_m, y_m) = scan.x_m.iter().zip(&scan.y_m).map(|(&x, &y)| map(x, y)).unzip();
    Scan { x_m, y_m, ..scan.clone() }
}

/// The middles of the walls and the corners of a square room with sides of 2a, anticlockwise. The
/// sensor is at (x, y) from the centre of the room.
fn square_room(a: f64, (x, y): (f64, f64)) -> Scan {
    let around = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];
    let point = |(i, j)| (a * f64::from(i) - x, a * f64::from(j) - y);
    scan(RING_DEG, around.map(point))
}

/// A wall along y = -1, seen from left to right, then a wall along y = 3, seen from right to left. The
/// steps are 1 long, and sqrt(17) between the walls. From the last return to the first it is sqrt(17)
/// too.
fn corridor(coverage_deg: f32) -> Scan {
    let right_wall = [0.0, 1.0, 2.0, 3.0].map(|x| (x, -1.0));
    let left_wall = [4.0, 3.0, 2.0, 1.0].map(|x| (x, 3.0));
    scan(coverage_deg, right_wall.into_iter().chain(left_wall))
}

/// Returns on a circle around the sensor.
fn circle(coverage_deg: f32, radius_m: f64, bearings_deg: impl Iterator<Item = f64>) -> Scan {
    let bearings_rad = bearings_deg.map(f64::to_radians);
    scan(coverage_deg, bearings_rad.map(|b| (radius_m * b.cos(), radius_m * b.sin())))
}

/// A closed circle with n evenly spaced returns.
fn full_circle(radius_m: f64, n: u32) -> Scan {
    circle(RING_DEG, radius_m, (0..n).map(|k| 360.0 / f64::from(n) * f64::from(k)))
}

#[test]
fn features_of_a_square_room_seen_from_its_centre() {
    // Triples at the middle of a wall are on a line, with sides a, a, 2a and curvature 0. Triples at
    // a corner have sides a, a, sqrt(2) a and area a^2 / 2, hence curvature 4 A / (abc) =
    // sqrt(2) / a. The angles are 45 deg, hence s = 1.
    for (a, curvature_mean, curvature_std) in [
        (1.0, SQRT_2 / 2.0, (8.0 * 0.5 / 7.0f64).sqrt()), // all 8 are sqrt(2) / 2 from the mean
        (1.5, SQRT_2 / 1.5, 0.0),                         // 2a > g, so only the corners count
        (2.0, 0.0, 0.0),                                  // sqrt(2) a > g too
    ] {
        // The circle is centred by symmetry. R^2 = mean of r^2 = (4 a^2 + 4 * 2 a^2) / 8.
        let radius = 1.5f64.sqrt() * a;
        // There are 4 values a and 4 values sqrt(2) a. Each is (sqrt(2) - 1) a / 2 from their mean.
        let std = (SQRT_2 - 1.0) / 2.0 * a * (8.0 / 7.0f64).sqrt();
        let expected = [
            ("centroid", 0.0),
            ("close_area", 4.0 * a * a), // the area of the room: 8 triangles of a^2 / 2
            ("close_distance", 8.0 * a),
            ("circle_radius", radius),
            ("circle_residual", 4.0 * (radius - a).powi(2) + 4.0 * (radius - SQRT_2 * a).powi(2)),
            ("curvature_mean", curvature_mean),
            ("curvature_std", curvature_std),
            ("distance", 8.0 * a),
            ("groups", 1.0),
            ("mean_group_size", 8.0),
            ("mean_angular_difference", PI / 4.0), // 8 steps make a full circle
            ("mean_deviation", (12.0 / 7.0f64).sqrt() * a), // squares: 4 a^2 + 4 * 2 a^2
            ("regularity", 0.0),
            ("size", 8.0),
            ("std_of_mean", std),
            ("std_of_ranges", std),
        ];
        assert_eq!(expected.map(|(name, _)| name), PAPER16_NAMES);
        check(GATE_M, &square_room(a, (0.0, 0.0)), TIGHT, &expected);
    }
}

#[test]
fn features_of_a_square_room_seen_from_off_its_centre() {
    // a = 2, seen from (1, 1). The ranges are sqrt(2) three times, sqrt(10) four times and sqrt(18)
    // once. Their sum is 6 sqrt(2) + 4 sqrt(10), and the sum of their squares is 6 + 40 + 18 = 64.
    // The angles differ from each other, but their sum is still a full circle and s is still 1. The
    // area is the same from any place in the room. Nothing else depends on the place.
    let sum_of_ranges = 6.0 * SQRT_2 + 4.0 * 10f64.sqrt();
    let centred = features(&square_room(2.0, (0.0, 0.0)));
    let mut expected: Vec<_> = PAPER16_NAMES.into_iter().zip(centred).collect();
    expected[0].1 = SQRT_2;
    expected[15].1 = ((64.0 - sum_of_ranges.powi(2) / 8.0) / 7.0).sqrt();
    check(GATE_M, &square_room(2.0, (1.0, 1.0)), TIGHT, &expected);
}

#[test]
fn features_of_a_circle_seen_from_its_centre() {
    // 90 returns are 4 deg apart, s = 1; 720 are 0.5 deg apart, s = 2.
    let radius = 5.0;
    for size in [90, 720] {
        let (scan, n) = (full_circle(radius, size), f64::from(size));
        let chords = n * 2.0 * radius * (PI / n).sin();
        let expected = [
            ("centroid", 0.0),
            ("close_area", n / 2.0 * radius.powi(2) * (2.0 * PI / n).sin()),
            ("close_distance", chords),
            ("circle_radius", radius),
            ("circle_residual", 0.0),
            ("distance", chords),
            ("groups", 1.0),
            ("mean_group_size", n),
            ("mean_angular_difference", 2.0 * PI / n),
            ("mean_deviation", (n / (n - 1.0)).sqrt() * radius),
            ("regularity", 0.0),
            ("size", n),
            ("std_of_mean", 0.0),
            ("std_of_ranges", 0.0),
        ];
        check(GATE_M, &scan, ROUNDED, &expected);
        // The height of an arc of 2 deg is 4e-5 R. Rounding by 6e-8 R is about 1e-3 of that.
        let expected = [("curvature_mean", 1.0 / radius), ("curvature_std", 0.0)];
        check(GATE_M, &scan, 1e-3, &expected);
    }
}

#[test]
fn features_of_a_circle_seen_from_off_its_centre() {
    let centred = full_circle(5.0, 720);
    for (x, y) in [(3.0, 1.0), (-2.0, 4.0), (12.0, -9.0)] {
        let shifted = map_points(&centred, |px, py| (px + x, py + y));
        let centroid = f64::from(x).hypot(f64::from(y));
        check(GATE_M, &shifted, ROUNDED, &[("centroid", centroid), ("std_of_mean", 0.0)]);
        check(GATE_M, &shifted, ROUNDED, &[("circle_radius", 5.0), ("circle_residual", 0.0)]);
    }
}

#[test]
fn circles_are_fitted_to_unevenly_spaced_points() {
    // Three points define a circle. The diameter is the hypotenuse 5 of the right triangle.
    let triangle = scan(OPEN_DEG, [(1.0, 1.0), (5.0, 1.0), (1.0, 4.0)]);
    check(GATE_M, &triangle, TIGHT, &[("circle_radius", 2.5), ("circle_residual", 0.0)]);
    // Lattice points on the circle of radius 5 around (2, 1).
    let arc = scan(OPEN_DEG, [(7.0, 1.0), (6.0, 4.0), (5.0, 5.0), (2.0, 6.0), (-1.0, 5.0)]);
    check(GATE_M, &arc, TIGHT, &[("circle_radius", 5.0), ("circle_residual", 0.0)]);
    // Relative to the mean (0, 4) the points are (3, -1), (0, 2), (-3, -1), (0, 0). Kasa's method
    // fits u^2 + v^2 = 2 vc v + K: a regression of 10, 4, 10, 0 on -1, 2, -1, 0. The slope is
    // -12 / 6 = 2 vc and K = 24 / 4, hence vc = -1 and R^2 = K + vc^2 = 7. The distances to the
    // centre are 3, 3, 3, 1, and the residual is 3 (sqrt(7) - 3)^2 + (sqrt(7) - 1)^2.
    let roof = scan(OPEN_DEG, [(3.0, 3.0), (0.0, 6.0), (-3.0, 3.0), (0.0, 4.0)]);
    let residual = 56.0 - 20.0 * 7f64.sqrt();
    check(GATE_M, &roof, TIGHT, &[("circle_radius", 7f64.sqrt()), ("circle_residual", residual)]);
}

#[test]
fn features_of_a_corridor_in_an_open_scan() {
    // The mean is (2, 1). The two walls are point-symmetric about it, so the odd moments are 0 and
    // the circle is centred there. The distances to it are 2, 2, sqrt(5) four times, sqrt(8),
    // sqrt(8). Their sum is 4 (1 + sqrt(5) + sqrt(2)), and the sum of their squares is 44.
    let (gap, radius) = (17f64.sqrt(), 5.5f64.sqrt());
    let quarter_sum = 1.0 + 5f64.sqrt() + SQRT_2;
    let residual = 8.0 * 5.5 - 2.0 * radius * 4.0 * quarter_sum + 44.0;
    // The ranges are 1, sqrt(2), sqrt(5), sqrt(10), 5, sqrt(18), sqrt(13), sqrt(10). The sum of
    // their squares is 84.
    let sum_of_ranges = 6.0 + 4.0 * SQRT_2 + 5f64.sqrt() + 2.0 * 10f64.sqrt() + 13f64.sqrt();
    let expected = [
        ("centroid", 5f64.sqrt()),
        ("close_area", 6.0), // 3 triangles of base 1 and height 1, 3 of height 3
        ("close_distance", 6.0),
        ("circle_radius", radius), // sqrt(44 / 8)
        ("circle_residual", residual),
        ("curvature_mean", 0.0), // s = 1; triples within a wall are straight
        ("curvature_std", 0.0),
        ("distance", 6.0 + gap),
        ("groups", 2.0),
        ("mean_group_size", 4.0),
        // The bearing increases from -90 deg to that of (1, 3) in m = 7 steps.
        ("mean_angular_difference", (PI / 2.0 + 3f64.atan()) / 7.0),
        ("mean_deviation", (44.0 / 7.0f64).sqrt()),
        // Six steps of 1 and one of sqrt(17): the sum of squared deviations is (gap - 1)^2 6/7.
        ("regularity", (gap - 1.0) / 7f64.sqrt()),
        ("size", 8.0),
        ("std_of_mean", ((44.0 - 2.0 * quarter_sum.powi(2)) / 7.0).sqrt()),
        ("std_of_ranges", ((84.0 - sum_of_ranges.powi(2) / 8.0) / 7.0).sqrt()),
    ];
    assert_eq!(expected.map(|(name, _)| name), PAPER16_NAMES);
    check(GATE_M, &corridor(OPEN_DEG), TIGHT, &expected);
}

#[test]
fn the_closing_step_counts_only_in_a_ring() {
    // A room with sides of 4 and one corner missing. The steps, with the closing one, are 2 long,
    // and sqrt(8) across the missing corner. The closing step spans 45 deg and a triangle of area 2.
    let mut room = square_room(2.0, (0.0, 0.0));
    room.x_m.remove(1);
    room.y_m.remove(1);
    let gap = 8f64.sqrt();
    let closed = [
        ("close_area", 12.0),
        ("close_distance", 12.0),
        ("distance", 12.0 + gap),
        ("groups", 1.0), // a ring with one break is one group
        ("mean_angular_difference", 2.0 * PI / 7.0),
        ("regularity", (gap - 2.0) / 7f64.sqrt()),
    ];
    let open = [
        ("close_area", 10.0),
        ("close_distance", 10.0),
        ("distance", 10.0 + gap),
        ("groups", 2.0),
        ("mean_angular_difference", 7.0 * PI / 4.0 / 6.0),
        ("regularity", (gap - 2.0) / 6f64.sqrt()),
    ];
    for (coverage_deg, expected) in [(360.0, &closed), (355.0, &closed), (354.9, &open)] {
        room.coverage_deg = coverage_deg;
        check(GATE_M, &room, TIGHT, expected);
    }
}

#[test]
fn groups_are_counted_in_rings_and_open_scans() {
    // Number of breaks without and with the closing step: 0 and 0 in the room, 1 and 2 in the
    // corridor.
    let room = square_room(2.0, (0.0, 0.0));
    let open_room = Scan { coverage_deg: OPEN_DEG, ..room.clone() };
    let (ring, open) = (corridor(RING_DEG), corridor(OPEN_DEG));
    for (scan, groups) in [(room, 1.0), (open_room, 1.0), (ring, 2.0), (open, 2.0)] {
        check(GATE_M, &scan, TIGHT, &[("groups", groups), ("mean_group_size", 8.0 / groups)]);
    }
}

#[test]
fn a_step_as_long_as_the_gate_is_close() {
    let below = |gate_m: f64| gate_m * (1.0 - f64::EPSILON);
    let room = square_room(2.0, (0.0, 0.0));
    let close = [("close_area", 16.0), ("close_distance", 16.0), ("groups", 1.0)];
    let apart = [("close_area", 0.0), ("close_distance", 0.0), ("groups", 8.0)];
    check(2.0, &room, TIGHT, &close);
    check(below(2.0), &room, TIGHT, &apart);
    // The same holds for the longest side of a triple: 2a in the straight triples.
    let room = square_room(1.0, (0.0, 0.0));
    check(2.0, &room, TIGHT, &[("curvature_mean", SQRT_2 / 2.0)]);
    check(below(2.0), &room, TIGHT, &[("curvature_mean", SQRT_2)]);
}

#[test]
fn curvature_leaves_out_triples_with_a_side_of_zero_or_above_the_gate() {
    let corner = [(2.0, 0.0), (2.0, 1.0), (1.0, 1.0)];
    for (what, points, curvature_mean) in [
        ("one triple: sides 1, 1, sqrt(2), area 1/2", corner.to_vec(), SQRT_2),
        ("the same and a triple with a side of 4", [&corner[..], &[(1.0, 5.0)]].concat(), SQRT_2),
        ("a duplicate return", vec![corner[0], corner[1], corner[1], corner[2]], 0.0),
        ("there and back", vec![(2.0, 1.0), (2.0, 0.0), (2.0, 1.0), (5.0, 5.0)], 0.0),
        ("mostly the same return", [vec![corner[0]; 9], corner.to_vec()].concat(), 0.0),
        ("all sides above the gate", corner.map(|(x, y)| (3.0 * x, 3.0 * y)).to_vec(), 0.0),
    ] {
        println!("{what}");
        let expected = [("curvature_mean", curvature_mean), ("curvature_std", 0.0)];
        check(GATE_M, &scan(OPEN_DEG, points), TIGHT, &expected);
    }
    // The two middle angles, 0.01 / 60.5 and 0.01 / 60 - 0.01 / 60.5 rad, have the mean 0.005 / 60,
    // hence s = 209. In a ring of four returns this is one step. The triples are right triangles
    // with sides 0.01 and 0.5, and 4 A / (a b c) = 2 / c.
    let far_post = scan(RING_DEG, [(60.0, 0.0), (60.0, 0.01), (60.5, 0.01), (60.5, 0.0)]);
    check(GATE_M, &far_post, 1e-6, &[("curvature_mean", 2.0 / 0.5f64.hypot(0.01))]);
}

/// Asserts that the longest side of the triples on a circle around the sensor is the chord of
/// `span_deg`: the triples count if and only if the gate is longer than this chord.
#[track_caller]
fn check_triples_span(scan: &Scan, radius_m: f64, span_deg: f64) {
    let chord_m = 2.0 * radius_m * (span_deg / 2.0).to_radians().sin();
    check(chord_m * 1.0001, scan, 1e-3, &[("curvature_mean", 1.0 / radius_m)]);
    check(chord_m * 0.9999, scan, 0.0, &[("curvature_mean", 0.0), ("curvature_std", 0.0)]);
}

#[test]
fn the_stride_is_the_number_of_returns_in_one_degree() {
    // n returns are 360 deg / n apart, hence s = max(1, round(n / 360)). With points rounded to f32,
    // the exact halves 540 and 900 cannot be tested. The test uses the numbers next to them.
    for (n, stride) in [(90, 1), (360, 1), (539, 1), (541, 2), (720, 2), (899, 2), (901, 3)] {
        let span_deg = f64::from(2 * stride) * 360.0 / f64::from(n);
        check_triples_span(&full_circle(5.0, n), 5.0, span_deg);
    }
}

#[test]
fn the_median_of_an_even_number_of_angles_is_the_mean_of_the_middle_two() {
    // The angles 0.7, 0.3, 0.3, 0.7 deg have the median 0.5 deg, hence s = 2. There is one triple,
    // over the whole 2 deg. The lower middle angle would give s = 3, the upper one s = 1.
    let arc = circle(OPEN_DEG, 5.0, [0.0, 0.7, 1.0, 1.3, 2.0].into_iter());
    check_triples_span(&arc, 5.0, 2.0);
}

#[test]
fn scans_without_features_are_errors() {
    let line: Vec<_> = (0..50).map(|k| (0.1 * f64::from(k), 7.0 - 0.3 * f64::from(k))).collect();
    for (points, unusable) in [
        (vec![], Unusable::TooFewReturns),
        (vec![(1.0, 0.0), (0.0, 1.0)], Unusable::TooFewReturns),
        (vec![(1.0, 2.0); 3], Unusable::OneLine),
        (line, Unusable::OneLine),
    ] {
        let found = Paper16::new(GATE_M).features(&scan(RING_DEG, points));
        assert_eq!(found, Err(unusable));
    }
}

#[test]
fn the_difference_is_symmetric_and_zero_for_equal_scans() {
    assert_eq!(FeatureSet::Paper16.feature_names(), PAPER16_NAMES);
    let a = features(&square_room(1.0, (0.0, 0.0)));
    let b = features(&corridor(OPEN_DEG));
    let [mut ab, mut ba, mut aa] = [[f64::NAN; 16]; 3];
    difference(&a, &b, &mut ab);
    difference(&b, &a, &mut ba);
    difference(&a, &a, &mut aa);
    assert_eq!(ab, ba);
    assert_eq!(aa, [0.0; 16]);
    assert_eq!(ab[8..10], [1.0, 4.0]); // 1 group of 8 returns, 2 groups of 4
}

/// Random returns. Some are on a lattice, which gives equal points, lines, and points at the sensor.
fn any_scan() -> impl Strategy<Value = Scan> {
    let metres = || prop_oneof![-70.0..70.0, -1.0..1.0, (-2..3).prop_map(f64::from)];
    (vec((metres(), metres()), 0..60), prop_oneof![0f32..360.0, 350f32..360.0])
        .prop_map(|(points, coverage_deg)| scan(coverage_deg, points))
}

/// A ring whose coordinates are multiples of 5 / 1024 m. After a rotation by the angle of a 3-4-5
/// triangle, the coordinates are still exact.
fn exact_ring() -> impl Strategy<Value = Scan> {
    vec(200.0..1200.0, 12..200).prop_map(|ranges: Vec<f64>| {
        let n = ranges.len() as f64;
        let exact = |units: f64| units.round() * 5.0 / 1024.0;
        let point = |(k, range)| {
            let (sin, cos) = (2.0 * PI * k as f64 / n).sin_cos();
            (exact(range * cos), exact(range * sin))
        };
        scan(RING_DEG, ranges.into_iter().enumerate().map(point))
    })
}

proptest! {
    #[test]
    fn features_are_finite_and_non_negative_and_do_not_depend_on_earlier_scans(scans in vec(any_scan(), 1..8)) {
        let mut reused = Paper16::new(GATE_M);
        for scan in &scans {
            let features = reused.features(scan);
            prop_assert_eq!(features, Paper16::new(GATE_M).features(scan));
            for feature in features.into_iter().flatten() {
                prop_assert!(feature.is_finite() && 0.0 <= feature);
            }
        }
    }

    #[test]
    fn features_do_not_depend_on_rotation_mirroring_or_the_first_return(
        ring in exact_ring(),
        start in any::<proptest::sample::Index>(),
    ) {
        let rotated =
            map_points(&ring, |x, y| ((3.0 * x - 4.0 * y) / 5.0, (4.0 * x + 3.0 * y) / 5.0));
        let mirrored = map_points(&ring, |x, y| (x, -y));
        let mut restarted = ring.clone();
        restarted.x_m.rotate_left(start.index(ring.len()));
        restarted.y_m.rotate_left(start.index(ring.len()));

        let expected: Vec<_> = PAPER16_NAMES.into_iter().zip(features(&ring)).collect();
        for same in [rotated, mirrored, restarted] {
            check(GATE_M, &same, 1e-9, &expected);
        }
    }
}
