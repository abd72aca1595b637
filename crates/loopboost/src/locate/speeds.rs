//! The speed of a lidar during each scan, from the steps between scans.

use detect::ScanStep;
use ingest::{LidarSpeed, PoseOptions};

/// Over a longer time between two scans, the speed is not taken as constant \[ns\].
const LONGEST_NS: i64 = 250_000_000;
/// A robot does not turn faster than this \[rad/s\], and does not move faster than the default of
/// `ingest.pose.max_speed_m_s`. Otherwise, the stamps or the matching are wrong.
const MAX_RAD_S: f64 = 6.0;

/// The speed during each scan: that of the step to the next scan, or else of the step before. `steps` has for each scan
/// the step from the one before.
pub(super) fn speeds(steps: &[Option<ScanStep>]) -> Vec<Option<LidarSpeed>> {
    let of_steps: Vec<_> = steps.iter().map(|step| step.as_ref().and_then(speed)).collect();
    (0..of_steps.len())
        .map(|scan| of_steps.get(scan + 1).copied().flatten().or(of_steps[scan]))
        .collect()
}

fn speed(ScanStep { step, time_ns }: &ScanStep) -> Option<LidarSpeed> {
    if !(1..=LONGEST_NS).contains(time_ns) {
        return None;
    }
    let per_s = 1e9 / *time_ns as f64;
    let speed = LidarSpeed {
        x_m_s: step.x_m * per_s,
        y_m_s: step.y_m * per_s,
        heading_rad_s: step.heading_rad * per_s,
    };
    let max_m_s = PoseOptions::default().max_speed_m_s;
    let is_possible =
        libm::hypot(speed.x_m_s, speed.y_m_s) <= max_m_s && speed.heading_rad_s.abs() <= MAX_RAD_S;
    is_possible.then_some(speed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    const MS: i64 = 1_000_000;

    fn step(x_m: f64, time_ns: i64) -> Option<ScanStep> {
        Some(ScanStep { step: Pose2 { x_m, ..Pose2::default() }, time_ns })
    }

    #[test]
    fn a_scan_has_the_speed_of_the_step_after_it_or_before_it() {
        let x_m_s = |steps: &[Option<ScanStep>]| -> Vec<Option<f64>> {
            speeds(steps).iter().map(|speed| speed.map(|speed| speed.x_m_s.round())).collect()
        };
        let steps = [None, step(0.1, 100 * MS), step(0.2, 100 * MS)];
        assert_eq!(x_m_s(&steps), [Some(1.0), Some(2.0), Some(2.0)]);
        // The third scan does not continue the second one, or the time between them says nothing.
        for broken in [None, step(0.2, -100 * MS), step(0.2, 0), step(0.2, MS), step(0.2, 300 * MS)]
        {
            let steps = [None, step(0.1, 100 * MS), broken, step(0.3, 100 * MS)];
            assert_eq!(x_m_s(&steps), [Some(1.0), Some(1.0), Some(3.0), Some(3.0)], "{broken:?}");
        }
        let turn = Pose2 { heading_rad: 1.0, ..Pose2::default() };
        assert_eq!(speeds(&[None, Some(ScanStep { step: turn, time_ns: 100 * MS })]), [None, None]);
        assert_eq!(speeds(&[]), []);
        assert_eq!(speeds(&[None]), [None]);
    }
}
