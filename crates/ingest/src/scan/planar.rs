//! A `LaserScan` message -> a scan.

use dataset::Scan;
use messages::{MessageError, Source, read_laser_scan};

use crate::deskew::motion::TimedScan;
use crate::options::LidarOptions;

/// A scan takes no longer than this \[ns\].
const MAX_SCAN_NS: f64 = 1e9;

/// Beam `i` points to `angle_min + i angle_increment`; a reading outside the message's own range
/// limits or the options' is no return (`sensor_msgs/LaserScan`, REP 117), nor is one at the
/// message's maximum, which older drivers give where nothing returned.
pub(crate) fn scan(
    source: Source,
    data: &[u8],
    options: &LidarOptions,
) -> messages::Result<TimedScan> {
    let message = read_laser_scan(source, data)?;
    if !message.angle_min.is_finite() || !message.angle_increment.is_finite() {
        return Err(MessageError::NotFinite { message: "LaserScan" });
    }
    // Compared as the message's own f32, so that a reading at a limit is within it.
    let limits = options.range_min_m as f32..=options.range_max_m as f32;
    let own_limits = message.range_min..message.range_max;
    let increment = message.angle_increment;
    let side = if options.upside_down { -1.0 } else { 1.0 };
    let mut scan = Scan {
        stamp_ns: message.stamp_ns,
        coverage_deg: (increment.abs() * message.ranges.len().saturating_sub(1) as f64).to_degrees()
            as f32,
        ..Scan::default()
    };
    // Beams of a scanner that tells no times, or none that can be, are taken as of one moment.
    let beam_ns = message.time_increment_s * 1e9;
    let is_timed = 0.0 < beam_ns && beam_ns * message.ranges.len() as f64 <= MAX_SCAN_NS;
    let mut times_ns = Vec::new();
    for (beam, &range) in message.ranges.iter().enumerate() {
        if own_limits.contains(&range) && limits.contains(&range) {
            let (sin, cos) = libm::sincos(message.angle_min + beam as f64 * increment);
            scan.x_m.push((f64::from(range) * cos) as f32);
            scan.y_m.push((f64::from(range) * sin * side) as f32);
            if is_timed {
                times_ns.push((beam as f64 * beam_ns).round() as i64);
            }
        }
    }
    Ok(TimedScan { scan, times_ns })
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::ros::{self, Encoding};
    use messages::{LaserScan, MessageType};
    use std::f32::consts::FRAC_PI_2;

    fn message(ranges: Vec<f32>) -> LaserScan {
        LaserScan {
            stamp_ns: 77,
            angle_min: f64::from(-FRAC_PI_2),
            angle_increment: f64::from(FRAC_PI_2),
            time_increment_s: 0.0,
            range_min: 0.05,
            range_max: 50.0,
            ranges,
        }
    }

    fn source(encoding: Encoding) -> Source {
        Source { message_type: MessageType::LaserScan, encoding }
    }

    #[test]
    fn three_beams_right_ahead_left_in_both_encodings() {
        let message = message(vec![1.0, 2.0, 3.0]);
        let options = LidarOptions::default();
        for encoding in [Encoding::Cdr, Encoding::Ros1] {
            let bytes = ros::write_laser_scan(encoding, "laser", &message);
            let scan = scan(source(encoding), &bytes, &options).unwrap().scan;
            assert_eq!(scan.stamp_ns, 77);
            assert_eq!(scan.coverage_deg, 180.0);
            let expected = [(0.0, -1.0), (2.0, 0.0), (0.0, 3.0)];
            for ((x, y), (ex, ey)) in scan.x_m.iter().zip(&scan.y_m).zip(expected) {
                assert!((x - ex).abs() < 1e-6 && (y - ey).abs() < 1e-6);
            }
        }
        let upside_down = LidarOptions { upside_down: true, ..LidarOptions::default() };
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &message);
        let scan = scan(source(Encoding::Cdr), &bytes, &upside_down).unwrap().scan;
        assert!((scan.y_m[0] - 1.0).abs() < 1e-6);
    }

    /// Beams 0 and 2 of 3 return, a quarter of a second apart each; times of minutes are none.
    #[test]
    fn beams_have_times_where_the_message_tells_them() {
        for (time_increment_s, expected) in
            [(0.25, vec![0, 500_000_000]), (0.0, vec![]), (60.0, vec![]), (f64::NAN, vec![])]
        {
            let timed = LaserScan { time_increment_s, ..message(vec![1.0, f32::NAN, 3.0]) };
            let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &timed);
            let scan = scan(source(Encoding::Cdr), &bytes, &LidarOptions::default()).unwrap();
            assert_eq!(scan.times_ns, expected);
        }
    }

    #[test]
    fn no_returns_in_every_spelling_are_left_out() {
        let ranges = vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 51.0, 50.0, 0.89, 0.9];
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &message(ranges));
        let scan = scan(source(Encoding::Cdr), &bytes, &LidarOptions::default()).unwrap().scan;
        assert_eq!(scan.len(), 1, "only 0.9 m is within both limits");
        assert_eq!(scan.coverage_deg, 630.0, "swept, returned or not");
    }
}
