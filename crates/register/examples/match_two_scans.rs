//! Matches two scans of a corner and prints the relative pose with its uncertainty.
//!
//! `cargo run -p register --example match_two_scans`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use dataset::{Pose2, RangeLimits, Scan};
use register::{AlignOptions, Explained, Points, Prior, Target, align_and_explain};

/// A scan over 180 deg of two walls that meet in a corner at (4, 3) of the map.
fn scan(map_from_lidar: &Pose2) -> Scan {
    let mut scan = Scan { coverage_deg: 180.0, ..Scan::default() };
    for degree in -90..90 {
        let bearing_rad = f64::from(degree).to_radians();
        let (sin, cos) = (map_from_lidar.heading_rad + bearing_rad).sin_cos();
        let to_x = if cos > 0.0 { (4.0 - map_from_lidar.x_m) / cos } else { f64::INFINITY };
        let to_y = if sin > 0.0 { (3.0 - map_from_lidar.y_m) / sin } else { f64::INFINITY };
        let range_m = to_x.min(to_y);
        if range_m < 20.0 {
            scan.x_m.push((range_m * bearing_rad.cos()) as f32);
            scan.y_m.push((range_m * bearing_rad.sin()) as f32);
        }
    }
    scan
}

fn main() {
    let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
    let options = AlignOptions::default();
    let first = Points::from_scan(&scan(&Pose2::default()), limits);
    let moved = Pose2 { x_m: 0.5, y_m: 0.2, heading_rad: 0.1 };
    let second = Points::from_scan(&scan(&moved), limits);

    // The odometry of the step: 0.1 m and 1 deg off, with its standard deviations.
    let odometry = Pose2 { x_m: 0.6, y_m: 0.2, heading_rad: 0.1 + 1f64.to_radians() };
    let prior = Prior::independent(odometry, 0.1, 0.1, 2f64.to_radians());
    let target = Target::new(first, options.first_gate_m);
    let Explained { alignment, near_share } =
        align_and_explain(&second, &target, &odometry, &prior, &options);

    let Pose2 { x_m, y_m, heading_rad } = alignment.target_from_source;
    println!("moved by {x_m:.3} m, {y_m:.3} m, {:.2} deg", heading_rad.to_degrees());
    println!("{:.0} % of the points are near the first scan", 100.0 * near_share);
    if let Some(covariance) = alignment.covariance(&options) {
        let [x_m, y_m, heading_rad] = [0, 1, 2].map(|k| covariance[(k, k)].sqrt());
        let heading_deg = heading_rad.to_degrees();
        println!("standard deviations {x_m:.4} m, {y_m:.4} m, {heading_deg:.3} deg");
    }
    if let Some(weakness) = alignment.weakness {
        println!("smallest over largest information about the position: {:.2}", weakness.ratio);
    }
}
