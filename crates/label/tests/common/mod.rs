//! Keyframes at given positions.

use dataset::{Keyframe, Pose2, ScanId};

/// A full-circle scan at (x, y), heading along x. The log is its own site. The path is 100 m per
/// scan.
pub fn at(log: &str, scan: u32, x_m: f64, y_m: f64) -> Keyframe {
    Keyframe {
        id: ScanId { log: log.into(), scan },
        site: log.into(),
        stamp_ns: i64::from(scan),
        pose: Pose2 { x_m, y_m, heading_rad: 0.0 },
        covariance: None,
        z_m: None,
        segment: 0,
        frame: 0,
        map: None,
        travel_m: 100.0 * f64::from(scan),
        coverage_deg: 360.0,
    }
}

/// Full-circle scans of one log along x.
#[allow(dead_code, reason = "not every test file needs a line")]
pub fn line(xs_m: &[f64]) -> Vec<Keyframe> {
    xs_m.iter().zip(0..).map(|(&x_m, scan)| at("a", scan, x_m, 0.0)).collect()
}
