//! Reads a scan from a `LaserScan` message.

use dataset::Scan;
use messages::{LaserScan, MessageError, Source, read_laser_scan};

use crate::deskew::timed_scan::TimedScan;
use crate::options::LidarOptions;
use crate::scan::planar_faults::{PlanarReadings, angle_fault, turn_fault};

/// A scan from a message, or why there is none.
pub(crate) enum FromPlanar {
    /// The scan.
    Scan(TimedScan),
    /// The angles of the message contradict each other. Contains the contradiction.
    Contradictory(String),
}

/// Reads a scan, and counts its readings in `readings`.
///
/// Beam `i` points to `angle_min + i angle_increment`. A reading outside the range limits of the
/// message or of the options is not a return (`sensor_msgs/LaserScan`, REP 117). A reading exactly at
/// the maximum of the message is not a return either, because older drivers report it for no return.
/// A maximum of 0 or less is not set (some drivers leave it at 0). In this case, only the options
/// limit the range.
pub(crate) fn scan(
    source: Source,
    data: &[u8],
    options: &LidarOptions,
    readings: &mut PlanarReadings,
) -> messages::Result<FromPlanar> {
    let message = read_laser_scan(source, data)?;
    if !message.angle_min.is_finite() || !message.angle_increment.is_finite() {
        return Err(MessageError::NotFinite { message: "LaserScan" });
    }
    if let Some(fault) = angle_fault(&message) {
        return Ok(FromPlanar::Contradictory(fault));
    }
    readings.n_scans += 1;
    // Compare as f32, the type of the readings, so a reading exactly at a limit of the options is kept.
    let limits = options.range_min_m as f32..=options.range_max_m as f32;
    let own_limits = readings.own_limits(&message);
    let increment = message.angle_increment;
    let side = if options.upside_down { -1.0 } else { 1.0 };
    let mut scan = Scan {
        stamp_ns: message.stamp_ns,
        coverage_deg: (increment.abs() * message.ranges.len().saturating_sub(1) as f64).to_degrees()
            as f32,
        ..Scan::default()
    };
    let beam_ns = beam_ns(&message, readings);
    let mut times_ns = Vec::new();
    for (beam, &range) in message.ranges.iter().enumerate() {
        let is_own = own_limits.contains(&range);
        let is_return = is_own && limits.contains(&range);
        readings.add(range, is_own, is_return);
        if is_return {
            let (sin, cos) = libm::sincos(message.angle_min + beam as f64 * increment);
            scan.x_m.push((f64::from(range) * cos) as f32);
            scan.y_m.push((f64::from(range) * sin * side) as f32);
            if let Some(beam_ns) = beam_ns {
                times_ns.push((beam as f64 * beam_ns).round() as i64);
            }
        }
    }
    Ok(FromPlanar::Scan(TimedScan { scan, times_ns }))
}

/// Time from one beam to the next \[ns\]. `None` if the message does not contain it (0 or NaN), or if it
/// is impossible, which is counted. All beams then have the time of the scan.
fn beam_ns(message: &LaserScan, readings: &mut PlanarReadings) -> Option<f64> {
    let increment_s = message.time_increment_s;
    if increment_s == 0.0 || increment_s.is_nan() || message.ranges.len() < 2 {
        return None;
    }
    if let Some(fault) = turn_fault(message) {
        readings.add_time_fault(fault);
        return None;
    }
    readings.add_duration(increment_s * (message.ranges.len() - 1) as f64);
    Some(increment_s * 1e9)
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
            angle_max: None,
            angle_increment: f64::from(FRAC_PI_2),
            time_increment_s: 0.0,
            range_min: 0.05,
            range_max: 50.0,
            ranges,
        }
    }

    fn read(encoding: Encoding, bytes: &[u8], options: &LidarOptions) -> TimedScan {
        let mut readings = PlanarReadings::default();
        match scan(source(encoding), bytes, options, &mut readings).unwrap() {
            FromPlanar::Scan(scan) => scan,
            FromPlanar::Contradictory(fault) => panic!("{fault}"),
        }
    }

    fn source(encoding: Encoding) -> Source {
        Source { message_type: MessageType::LaserScan, encoding }
    }

    #[test]
    fn both_encodings_give_the_same_three_beams() {
        let message = message(vec![1.0, 2.0, 3.0]);
        let options = LidarOptions::default();
        for encoding in [Encoding::Cdr, Encoding::Ros1] {
            let bytes = ros::write_laser_scan(encoding, "laser", &message);
            let scan = read(encoding, &bytes, &options).scan;
            assert_eq!(scan.stamp_ns, 77);
            assert_eq!(scan.coverage_deg, 180.0);
            let expected = [(0.0, -1.0), (2.0, 0.0), (0.0, 3.0)];
            for ((x, y), (ex, ey)) in scan.x_m.iter().zip(&scan.y_m).zip(expected) {
                assert!((x - ex).abs() < 1e-6 && (y - ey).abs() < 1e-6);
            }
        }
        let upside_down = LidarOptions { upside_down: true, ..LidarOptions::default() };
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &message);
        let scan = read(Encoding::Cdr, &bytes, &upside_down).scan;
        assert!((scan.y_m[0] - 1.0).abs() < 1e-6);
    }

    /// Beams 0 and 2 of 3 have returns. The beams are 0.25 s apart. An increment of 60 s is impossible.
    #[test]
    fn returns_have_times_if_the_message_has_them() {
        for (time_increment_s, expected) in
            [(0.25, vec![0, 500_000_000]), (0.0, vec![]), (60.0, vec![]), (f64::NAN, vec![])]
        {
            let timed = LaserScan { time_increment_s, ..message(vec![1.0, f32::NAN, 3.0]) };
            let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &timed);
            let scan = read(Encoding::Cdr, &bytes, &LidarOptions::default());
            assert_eq!(scan.times_ns, expected);
        }
    }

    #[test]
    fn all_representations_of_no_return_are_left_out() {
        let ranges = vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, 51.0, 50.0, 0.89, 0.9];
        let message = LaserScan { angle_increment: 0.5, ..message(ranges) };
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &message);
        let scan = read(Encoding::Cdr, &bytes, &LidarOptions::default()).scan;
        assert_eq!(scan.len(), 1, "only 0.9 m is within both limits");
        let coverage_deg = 3.5f32.to_degrees();
        assert!((scan.coverage_deg - coverage_deg).abs() < 1e-3, "the coverage counts all beams");
    }

    #[test]
    fn contradictory_angles_give_no_scan() {
        let clockwise =
            LaserScan { angle_max: Some(1.5), angle_increment: -0.5, ..message(vec![1.0; 7]) };
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &clockwise);
        let mut readings = PlanarReadings::default();
        let found = scan(source(Encoding::Cdr), &bytes, &LidarOptions::default(), &mut readings);
        assert!(matches!(found, Ok(FromPlanar::Contradictory(_))));
        assert_eq!(readings, PlanarReadings::default(), "its readings do not count");
    }
}
