//! Speed of scan matching: an alignment, beside the search of the nearest points that it cannot do
//! without, and a whole keyframe of a drive.
//!
//! `cargo bench -p register --bench match`

use dataset::{Pose2, RangeLimits, Scan};
use divan::Bencher;
use model::Detector;
use register::{
    AlignOptions, MatcherOptions, Points, Prior, ScanMatcher, Target, align, near_share,
};

fn main() {
    divan::main();
}

/// A scan of 720 beams in a room of 12 m by 8 m, from (x, 0).
fn points(x_m: f64) -> Points {
    let mut scan = Scan { coverage_deg: 360.0, ..Scan::default() };
    for k in 0..720 {
        let (sin, cos) = (f64::from(k) * 0.5).to_radians().sin_cos();
        let to_x = if cos > 0.0 { (6.0 - x_m) / cos } else { (-6.0 - x_m) / cos };
        let to_y = if sin > 0.0 { 4.0 / sin } else { -4.0 / sin };
        let range_m = to_x.min(to_y);
        scan.x_m.push((range_m * cos) as f32);
        scan.y_m.push((range_m * sin) as f32);
    }
    Points::from_scan(&scan, RangeLimits { min_m: 0.1, max_m: 25.0 })
}

/// The nearest target point of every point, once: an alignment does this in each iteration.
#[divan::bench]
fn nearest_points_once(bencher: Bencher<'_, '_>) {
    let (target, source) = (Target::new(points(0.0), 0.5), points(0.2));
    bencher.bench_local(|| near_share(&source, &target, &Pose2::default(), 0.1));
}

/// Up to 15 iterations.
#[divan::bench]
fn alignment(bencher: Bencher<'_, '_>) {
    let (target, source) = (Target::new(points(0.0), 0.5), points(0.2));
    let (start, options) = (Pose2::default(), AlignOptions::default());
    bencher.bench_local(|| align(&source, &target, &start, &Prior::none(start), &options));
}

/// A keyframe against the last 8 m, every 0.2 m: target, search for a start, and alignment.
#[divan::bench]
fn keyframe_of_a_drive(bencher: Bencher<'_, '_>) {
    let mut matcher =
        ScanMatcher::new(MatcherOptions::default(), Detector::starting_values().odometry);
    let mut k = 0;
    bencher.bench_local(|| {
        // To and fro over 4 m.
        let step = f64::from(k % 40);
        let x_m = 0.2 * if step < 20.0 { step } else { 40.0 - step } - 2.0;
        k += 1;
        matcher.add(points(x_m), &Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 })
    });
}
