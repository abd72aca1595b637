//! `campus`: values computed by hand, invariances, and finite results.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use dataset::Scan;
use featurize::{CAMPUS_NAMES, Campus, FeatureSet, Featurizer, Options, PAPER16_NAMES, thinned};
use proptest::prelude::*;

fn features(scan: &Scan) -> [f64; CAMPUS_NAMES.len()] {
    Campus::new().features(scan).unwrap()
}

fn of(features: &[f64], name: &str) -> f64 {
    features[CAMPUS_NAMES.iter().position(|n| *n == name).unwrap()]
}

fn sum(features: &[f64], family: &str) -> f64 {
    let values = CAMPUS_NAMES.iter().zip(features);
    values.filter(|(name, _)| name.starts_with(family)).map(|(_, value)| value).sum()
}

/// A scan with the range `r(azimuth)` at `n` azimuths over `coverage_deg`, from `start_deg` on.
fn scan(n: usize, coverage_deg: f64, start_deg: f64, r: impl Fn(f64) -> f64) -> Scan {
    let mut scan = Scan { coverage_deg: coverage_deg as f32, ..Scan::default() };
    for k in 0..n {
        let azimuth = (start_deg + coverage_deg * k as f64 / n as f64).to_radians();
        scan.x_m.push((r(azimuth) * azimuth.cos()) as f32);
        scan.y_m.push((r(azimuth) * azimuth.sin()) as f32);
    }
    scan
}

/// The range to the walls of a rectangle around the sensor, with half sides a and b.
fn rectangle(a: f64, b: f64) -> impl Fn(f64) -> f64 {
    move |azimuth| (a / azimuth.cos().abs()).min(b / azimuth.sin().abs())
}

/// A circle of radius 4 m: all ranges are 4 m, all chords and quarters 8 m. There are no gaps and the
/// ranges do not vary.
#[test]
fn features_of_a_circle() {
    let f = features(&scan(2160, 360.0, 0.05, |_| 4.0));
    assert!((of(&f, "range_4m") - 1.0).abs() < 1e-5 && (sum(&f, "range_") - 1.0).abs() < 1e-12);
    for name in
        ["chord_p0", "chord_p50", "chord_p100", "quarter_p25", "main_longest", "axis_shorter"]
    {
        assert!((of(&f, name) - 8f64.ln()).abs() < 1e-6, "{name} {}", of(&f, name));
    }
    assert!(of(&f, "oddness_mean").abs() < 1e-6);
    assert!((of(&f, "spread_16m") - 0.01f64.ln()).abs() < 1e-4);
    assert!((of(&f, "step_0_01") - 1.0).abs() < 1e-12);
    assert_eq!((of(&f, "seen"), sum(&f, "gaps_")), (1.0, 0.0));
    // There is one run, the polygon with 360 sides. Its length, 360 x 8 sin(0.5 deg) = 25.1324 m, is
    // between 16 and 32 m.
    let metres = (of(&f, "runs_16m").exp() - 1.0) + (of(&f, "runs_32m").exp() - 1.0);
    assert!((metres - 2880.0 * 0.5f64.to_radians().sin()).abs() < 1e-3, "{metres}");
}

/// A corridor 2.3 m wide and 40 m long. Walls that face each other directly are 2.3 m apart. The
/// longest chord is 40 m along the corridor and 2.3 m across it. Towards the ends of the corridor, one
/// degree covers metres of wall, and its mean range is off the wall by some centimetres.
#[test]
fn a_corridor_has_its_width_and_length() {
    let f = features(&scan(2160, 360.0, 0.05, rectangle(20.0, 1.15)));
    let share = (of(&f, "facing_2_3m") / of(&f, "facing")).powi(2);
    assert!(0.75 < share && share <= 1.0, "{share}");
    let centres = [1.0, 1.4, 1.7, 2.0, 2.3, 2.7, 3.2, 4.0, 5.0, 7.0, 10.0];
    let first = CAMPUS_NAMES.iter().position(|n| *n == "across_1m").unwrap();
    let metres: f64 = centres.iter().zip(&f[first..]).map(|(m, share)| m * share).sum();
    // The end walls face each other too. They are 2.3 m long and 40 m apart, which counts in the last
    // bin, 15 m.
    let ends = of(&f, "across_15m");
    assert!((metres / (1.0 - ends) - 2.3).abs() < 0.05, "{metres} {ends}");
    assert!(0.02 < ends && ends < 0.06, "{ends}");
    assert!((of(&f, "main_longest") - 40f64.ln()).abs() < 0.01, "{}", of(&f, "main_longest").exp());
    assert!((of(&f, "cross_median") - 2.3f64.ln()).abs() < 0.01);
    assert!((sum(&f, "offset_") - 1.0).abs() < 1e-9 && (sum(&f, "across_") - 1.0).abs() < 1e-9);
    let flat = of(&f, "offset_0m") + of(&f, "offset_0_1m");
    // If the direction of a piece is off by a degree, the far end of its wall has an offset.
    assert!(0.75 < flat && flat < 1.0, "a wall has no offset to itself: {flat}");
}

/// A circle of radius 4 m with four openings to a circle of 6.5 m. There are eight gaps of 2.5 m, or
/// a little less where one degree covers both circles.
#[test]
fn gaps_are_counted_by_their_width() {
    let open = |azimuth: f64| azimuth.rem_euclid(std::f64::consts::FRAC_PI_2) < 0.3;
    let f = features(&scan(3600, 360.0, 0.05, |a| if open(a) { 6.5 } else { 4.0 }));
    let gaps = CAMPUS_NAMES.iter().zip(&f).filter(|(name, _)| name.starts_with("gaps_"));
    let counts: Vec<f64> = gaps.map(|(_, v)| v.exp() - 1.0).collect();
    assert!((counts.iter().sum::<f64>() - 8.0).abs() < 1e-9, "{counts:?}");
    assert!(6.0 < counts[3] && counts[2] < 2.0, "{counts:?}");
}

#[test]
fn features_do_not_change_with_half_of_the_returns() {
    for coverage_deg in [360.0, 180.0] {
        let full = scan(2160, coverage_deg, 0.05, rectangle(7.0, 2.0));
        let (f, g) = (features(&full), features(&thinned(&full)));
        for (name, (f, g)) in CAMPUS_NAMES.iter().zip(f.iter().zip(&g)) {
            assert!((f - g).abs() < 0.03, "{name} {f} {g}");
        }
    }
}

#[test]
fn open_scans_have_no_opposite_ranges_and_may_start_at_any_angle() {
    let room = rectangle(7.0, 2.0);
    let f = features(&scan(720, 180.0, -90.0, &room));
    assert_eq!((sum(&f, "chord_"), sum(&f, "oddness_"), sum(&f, "main_")), (0.0, 0.0, 0.0));
    // The same half of the room, seen by a scanner that is rotated by 100 deg. The scan crosses
    // 180 deg.
    let rotated = scan(720, 180.0, 10.0, |a| room(a - 100f64.to_radians()));
    for (name, (f, g)) in CAMPUS_NAMES.iter().zip(f.iter().zip(&features(&rotated))) {
        assert!((f - g).abs() < 1e-3, "{name} {f} {g}");
    }
}

/// The tables of docs/features.md list each feature of each set once, in order.
#[test]
fn the_documentation_lists_every_feature() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/features.md");
    let text = std::fs::read_to_string(path).unwrap();
    let (paper16, campus) = text.split_once("## `campus` v1").unwrap();
    // The names in one column of the tables: words in backticks.
    let names = |text: &str, column: usize| -> Vec<String> {
        let cells = text.lines().filter_map(|line| line.split('|').nth(column));
        cells
            .flat_map(str::split_whitespace)
            .filter_map(|word| word.strip_prefix('`')?.strip_suffix('`').map(str::to_owned))
            .collect()
    };
    assert_eq!(names(paper16, 2), PAPER16_NAMES);
    assert_eq!(names(campus, 1), CAMPUS_NAMES);
    assert_eq!(FeatureSet::Campus.feature_names(), CAMPUS_NAMES);
    assert_eq!((FeatureSet::Campus.name(), FeatureSet::Campus.version()), ("campus", 1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn features_are_finite_and_do_not_depend_on_earlier_scans(
        points in prop::collection::vec((-80f32..80.0, -80f32..80.0), 0..200),
        coverage_deg in prop_oneof![Just(360.0f32), 0f32..359.0],
    ) {
        let (x_m, y_m) = points.into_iter().unzip();
        let scan = Scan { x_m, y_m, coverage_deg, ..Scan::default() };
        let mut used = Campus::new();
        used.features(&self::scan(100, 270.0, 5.0, |a| 3.0 + a)).unwrap();
        let found = used.features(&scan);
        prop_assert_eq!(found, Campus::new().features(&scan));
        prop_assert_eq!(found.is_ok(), scan.check_usable().is_ok());
        if let Ok(features) = found {
            prop_assert!(features.iter().all(|f| f.is_finite()), "{:?}", features);
            let mut written = [0.0; CAMPUS_NAMES.len()];
            let options = Options { set: FeatureSet::Campus, ..Options::default() };
            Featurizer::new(&options).features(&scan, &mut written).unwrap();
            prop_assert_eq!(written, features);
        }
    }

    /// A ring rotated by whole degrees is the same ring.
    #[test]
    fn features_do_not_change_when_the_scanner_rotates(
        ranges in prop::collection::vec(0.9f64..60.0, 360),
        rotation_deg in 1usize..360,
    ) {
        let at = |rotation_deg: usize| scan(360, 360.0, 0.5, |a| {
            ranges[(a.to_degrees() as usize + 360 - rotation_deg) % 360]
        });
        let (f, g) = (features(&at(0)), features(&at(rotation_deg)));
        // Random ranges have no main direction, so the chords along it are not compared.
        let n = CAMPUS_NAMES.len() - 8;
        // Pieces of a ring are pairs of degrees: a rotation by an odd number gives other pairs.
        let is_even = rotation_deg % 2 == 0;
        for ((name, f), g) in CAMPUS_NAMES.iter().zip(&f).zip(&g).take(n) {
            let by_pieces = ["facing", "offset", "across", "perp"].iter().any(|p| name.starts_with(p));
            prop_assert!((f - g).abs() < 1e-4 || (by_pieces && !is_even), "{} {} {}", name, f, g);
        }
    }
}
