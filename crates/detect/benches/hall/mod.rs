//! A drive of 200 m along a hall with columns, 1000 scans of 180 beams.

use dataset::{Pose2, RangeLimits, Scan};
use register::Drive;

/// A scan at x along a hall whose walls are at y = -3 and y = 3, with a column every few metres.
fn scan(x_m: f64) -> Scan {
    let mut scan = Scan { coverage_deg: 180.0, ..Scan::default() };
    for k in 0..180 {
        let (sin, cos) = (f64::from(k) - 90.0).to_radians().sin_cos();
        let to_wall = 3.0 / sin.abs().max(1e-9);
        // Columns of 0.6 m in irregular distances along both walls. No part of the hall repeats.
        let to_column = (0..90u32).filter_map(|column| {
            let along = 2.3 * f64::from(column) + f64::from(column * column % 97) * 0.0125 - x_m;
            let across = if column % 3 == 0 { 2.5 } else { -2.5 };
            let off = (along * sin - across * cos).abs();
            let range = along * cos + across * sin;
            (off < 0.3 && 0.0 < range).then_some(range - 0.3)
        });
        let range_m = to_column.fold(to_wall, f64::min);
        if range_m < 20.0 {
            scan.x_m.push((range_m * cos) as f32);
            scan.y_m.push((range_m * sin) as f32);
        }
    }
    scan
}

pub(crate) fn scans() -> Vec<Scan> {
    (0..1000).map(|k| scan(0.2 * f64::from(k))).collect()
}

pub(crate) fn drive(scans: &[Scan]) -> Drive {
    let limits = RangeLimits { min_m: 0.1, max_m: 25.0 };
    let path_m: Vec<f64> = (0..scans.len()).map(|k| 0.2 * k as f64).collect();
    let poses: Vec<Pose2> = path_m.iter().map(|&x_m| Pose2 { x_m, ..Pose2::default() }).collect();
    let all = vec![true; scans.len()];
    let odometry = poses.clone();
    let mut drive = Drive::of_scans(
        scans.iter().collect(),
        odometry.clone(),
        odometry,
        all.clone(),
        all,
        limits,
    );
    drive.path_m = path_m;
    drive
}

pub(crate) fn single_thread() -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread can be started")
}
