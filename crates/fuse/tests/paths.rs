//! Paths with ends calculated by hand, and the values calibrated along them.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod support;

use std::f64::consts::{FRAC_PI_2, PI};

use dataset::Pose2;
use fuse::{FuseError, Fused, ImuSample, Options, WheelSample, fuse};
use support::{Drive, Errors, drive, stamp_ns, winding, winding_without_stops};

fn options() -> Options {
    Options { track_m: 0.5, ..Options::default() }
}

/// Wheels at 50 Hz and an IMU at 100 Hz with constant values.
fn constant(left: f64, right: f64, yaw_rate: f64, secs: u32) -> (Vec<WheelSample>, Vec<ImuSample>) {
    let wheels = (0..=50 * secs).map(|k| WheelSample {
        stamp_ns: stamp_ns(f64::from(k) / 50.0),
        left_m_s: left,
        right_m_s: right,
    });
    let imu = (0..=100 * secs).map(|k| ImuSample {
        stamp_ns: stamp_ns(f64::from(k) / 100.0),
        yaw_rate_rad_s: yaw_rate,
        heading_rad: None,
    });
    (wheels.collect(), imu.collect())
}

#[track_caller]
fn check_end(fused: &Fused, x_m: f64, y_m: f64, heading_rad: f64, tolerance: f64) {
    let end = fused.poses.last().unwrap().pose;
    let truth = Pose2 { x_m, y_m, heading_rad };
    assert!(end.distance_m(&truth) < tolerance, "{end:?}, expected {truth:?}");
    assert!(end.heading_difference_rad(&truth) < tolerance, "{end:?}, expected {truth:?}");
}

/// 1 m/s and pi/20 rad/s for 10 s: a quarter turn left on a circle of radius 20/pi, which ends at
/// (radius, radius). Half the track width is 0.25 m, so the wheel speeds are 1 -+ 0.25 pi/20 m/s.
#[test]
fn a_quarter_circle_and_a_straight_line_end_where_calculated() {
    let (rate, radius) = (PI / 20.0, 20.0 / PI);
    let (wheels, imu) = constant(1.0 - 0.25 * rate, 1.0 + 0.25 * rate, rate, 10);
    for imu in [&imu[..], &[]] {
        let fused = fuse(&options(), &wheels, imu, None, None).unwrap();
        check_end(&fused, radius, radius, FRAC_PI_2, 1e-9);
        assert_eq!((fused.poses.len(), fused.poses[0].pose), (501, Pose2::default()));
        assert!((fused.report.distance_m - 10.0).abs() < 1e-9);
        assert!((fused.report.duration_secs - 10.0).abs() < 1e-9);
        assert!(fused.report.losses.is_empty());
    }
    let (wheels, imu) = constant(2.0, 2.0, 0.0, 10);
    // From (1, 2) along y.
    let start = Pose2 { x_m: 1.0, y_m: 2.0, heading_rad: FRAC_PI_2 };
    let fused = fuse(&options(), &wheels, &imu, Some(start), None).unwrap();
    check_end(&fused, 1.0, 22.0, FRAC_PI_2, 1e-9);
    // The wheels measure 2 m/s, the true speed is 1.8 m/s: 18 m in 10 s.
    let scaled = Options { wheel_scale: 0.9, ..options() };
    let fused = fuse(&scaled, &wheels, &imu, None, None).unwrap();
    check_end(&fused, 18.0, 0.0, 0.0, 1e-9);
    assert_eq!(fused.report.wheel_scale.value, 0.9);
}

/// A turn on the spot with 1 rad/s for 3 s: the wheel speeds are -+0.25 m/s.
#[test]
fn a_turn_on_the_spot_changes_only_the_heading() {
    let (wheels, imu) = constant(-0.25, 0.25, 1.0, 3);
    let fused = fuse(&options(), &wheels, &imu, None, None).unwrap();
    check_end(&fused, 0.0, 0.0, 3.0, 1e-9);
}

#[test]
fn odometry_twists_and_wheel_positions_are_converted_to_speeds() {
    let sample = WheelSample::from_twist(7, 1.0, 0.2, 0.5);
    assert_eq!((sample.left_m_s, sample.right_m_s), (0.95, 1.05));
    // 0.1 m in 0.1 s, then 0.4 m in 0.2 s. The stamps are halfway.
    let positions = [(0, 0.0, 1.0), (100_000_000, 0.1, 1.0), (300_000_000, 0.5, 0.6)];
    let [first, second] = WheelSample::from_positions(&positions)[..] else { panic!("2") };
    assert_eq!((first.stamp_ns, second.stamp_ns), (50_000_000, 200_000_000));
    assert!((first.left_m_s - 1.0).abs() < 1e-12 && first.right_m_s == 0.0);
    assert!((second.left_m_s - 2.0).abs() < 1e-12);
    assert!((second.right_m_s + 2.0).abs() < 1e-12);
}

#[test]
fn the_gyroscope_bias_is_estimated_at_standstill_and_in_motion() {
    let errors = Errors { gyro_bias: 0.015, ..Errors::default() };
    let still_first =
        Drive { secs: 120.0, wheel_hz: 50.0, imu_hz: 100.0, twist: winding, has_heading: false };
    let logged = drive(&options(), &still_first, errors, 1.0, 1);
    let fused = fuse(&options(), &logged.wheels, &logged.imu, None, None).unwrap();
    let bias = fused.report.gyro_bias_mean_rad_s.unwrap();
    // 20 s at standstill: 2e-4 / sqrt(20) = 4.5e-5, and 1e-5 sqrt(60) = 8e-5 from the random walk.
    assert!((bias - 0.015).abs() < 3e-4, "{bias}");
    assert!((fused.report.still_share - 20.0 / 120.0).abs() < 1e-3);

    let never_still = Drive { twist: winding_without_stops, secs: 600.0, ..still_first };
    let logged = drive(&options(), &never_still, errors, 1.0, 2);
    let fused = fuse(&options(), &logged.wheels, &logged.imu, None, None).unwrap();
    let bias = fused.report.gyro_bias_mean_rad_s.unwrap();
    // The error of the turn measured by the wheels is a random walk of density
    // sqrt(2 (0.003^2 + 0.005^2 * 1.2)) / 0.5 = 0.0177 rad/sqrt(s): 0.0177 / sqrt(600) = 7e-4.
    assert!((bias - 0.015).abs() < 3.0 * 7e-4, "{bias}");
    assert_eq!(fused.report.still_share, 0.0);
}

#[test]
fn the_options_decide_whether_track_width_or_wheel_scale_is_calibrated() {
    let turning =
        Drive { secs: 600.0, wheel_hz: 50.0, imu_hz: 100.0, twist: winding, has_heading: false };
    // The true track width is 0.5 / 1.04 m.
    let errors = Errors { track: 0.04, ..Errors::default() };
    let logged = drive(&options(), &turning, errors, 1.0, 3);
    let report = fuse(&options(), &logged.wheels, &logged.imu, None, None).unwrap().report;
    let (track, truth) = (report.track_m, 0.5 / 1.04);
    assert!((track.value - truth).abs() < 3.0 * track.std && track.std < 0.002, "{track:?}");
    assert_eq!((report.wheel_scale.value, report.wheel_scale.std), (1.0, 0.0));

    // Wheels that are 3 % smaller, with an exact track width: the distance is calibrated too.
    let trusted = Options { track_std: 0.0, wheel_scale_std: 0.02, ..options() };
    let errors = Errors { wheel_scale: -0.03, ..Errors::default() };
    let logged = drive(&trusted, &turning, errors, 1.0, 4);
    let report = fuse(&trusted, &logged.wheels, &logged.imu, None, None).unwrap().report;
    let scale = report.wheel_scale;
    assert!((scale.value - 0.97).abs() < 3.0 * scale.std && scale.std < 0.005, "{scale:?}");
    let true_m: f64 = logged.truth.windows(2).map(|ends| ends[0].distance_m(&ends[1])).sum();
    assert!((report.distance_m / true_m - 1.0).abs() < 0.01);
}

/// Samples at 1 Hz do not resolve the motion, so the wheel parameters stay at their nominal values.
#[test]
fn sparse_samples_do_not_calibrate_the_wheels() {
    let sparse = Drive {
        secs: 600.0,
        wheel_hz: 1.0,
        imu_hz: 1.0,
        twist: winding_without_stops,
        has_heading: true,
    };
    let logged = drive(&options(), &sparse, Errors::default(), 1.0, 5);
    let report = fuse(&options(), &logged.wheels, &logged.imu, None, None).unwrap().report;
    // The gyroscope has little weight here, so the headings calibrate the wheels very slightly.
    assert!((report.track_m.value - 0.5).abs() < 1e-4, "{:?}", report.track_m);
    assert!((report.track_m.std - 0.05 * 0.5).abs() < 1e-4, "{:?}", report.track_m);
    assert_eq!(report.n_headings, 601);
}

#[test]
fn a_measured_heading_keeps_a_long_drive_straight() {
    let long = Drive {
        secs: 1800.0,
        wheel_hz: 10.0,
        imu_hz: 10.0,
        twist: winding_without_stops,
        has_heading: true,
    };
    let errors = Errors { gyro_bias: 0.004, heading_offset: 2.0, ..Errors::default() };
    let mut logged = drive(&options(), &long, errors, 1.0, 6);
    // The measured heading is wrong for 20 s.
    for sample in &mut logged.imu[5000..5200] {
        sample.heading_rad = Some(-1.0);
    }
    let start = Some(Pose2::default());
    let error = |imu: &[ImuSample]| {
        let fused = fuse(&options(), &logged.wheels, imu, start, None).unwrap();
        let last = logged.truth.last().unwrap();
        let end = fused.poses.last().unwrap().pose;
        (end.heading_difference_rad(last), fused.report)
    };
    let (with, report) = error(&logged.imu);
    // The heading drift with a correlation time of one minute averages out. Its value at the start
    // remains: 0.05 rad.
    assert!(with < 0.15, "{with} rad");
    assert_eq!(report.n_headings, 1801);
    assert!((15..60).contains(&report.n_heading_outliers), "{}", report.n_heading_outliers);
}

#[test]
fn invalid_stamps_and_values_are_counted() {
    let (mut wheels, mut imu) = constant(1.0, 1.0, 0.0, 2);
    wheels[10].stamp_ns = wheels[9].stamp_ns;
    wheels[20].stamp_ns -= 100_000_000;
    wheels[30].left_m_s = f64::NAN;
    imu[5].stamp_ns = imu[4].stamp_ns;
    let end_ns = stamp_ns(2.0);
    let stamps = [stamp_ns(1.5), stamp_ns(0.333), stamp_ns(-1.0), end_ns + 1, stamp_ns(1.5)];
    let fused = fuse(&options(), &wheels, &imu, None, Some(&stamps)).unwrap();
    assert_eq!(
        fused.report.losses.to_string(),
        "1 imu sample with a repeated stamp, 1 wheel sample with a repeated stamp, \
         1 wheel sample whose stamp steps back, 1 wheel sample with NaN or infinite values, \
         1 requested stamp before the first wheel sample, \
         1 requested stamp after the last wheel sample, 1 stamp requested twice"
    );
    let at: Vec<_> = fused.poses.iter().map(|p| (p.stamp_ns, p.pose.x_m)).collect();
    assert_eq!((at[0].0, at[1].0, at.len()), (stamp_ns(0.333), stamp_ns(1.5), 2));
    assert!((at[0].1 - 0.333).abs() < 1e-9 && (at[1].1 - 1.5).abs() < 1e-9);
}

#[test]
fn one_source_bridges_a_gap_of_the_other() {
    let rate = PI / 20.0;
    let (wheels, imu) = constant(1.0 - 0.25 * rate, 1.0 + 0.25 * rate, rate, 10);
    let without = |from: f64, to: f64| move |ns: i64| !(stamp_ns(from)..stamp_ns(to)).contains(&ns);
    let some_imu: Vec<_> = imu.iter().copied().filter(|s| without(2.0, 7.0)(s.stamp_ns)).collect();
    let late_imu: Vec<_> = imu.iter().copied().filter(|s| without(-1.0, 3.0)(s.stamp_ns)).collect();
    let some_wheels: Vec<_> =
        wheels.iter().copied().filter(|s| without(4.0, 8.0)(s.stamp_ns)).collect();
    let radius = 1.0 / rate;
    let whole = fuse(&options(), &wheels, &imu, None, None).unwrap();
    for (wheels, imu, wheel_gaps, imu_gaps) in [
        (&wheels, &some_imu, 0, 1),
        (&wheels, &late_imu, 0, 1),
        (&some_wheels, &imu, 1, 0),
        (&some_wheels, &some_imu, 1, 1),
    ] {
        let fused = fuse(&options(), wheels, imu, None, None).unwrap();
        check_end(&fused, radius, radius, FRAC_PI_2, 1e-6);
        assert_eq!((fused.report.wheel_gaps.n, fused.report.imu_gaps.n), (wheel_gaps, imu_gaps));
        let trace = |fused: &Fused| {
            let [xx, _, _, yy, _, hh] = fused.poses.last().unwrap().covariance;
            xx + yy + hh
        };
        assert!(trace(&whole) < trace(&fused), "a gap increases the covariance");
    }
}

#[test]
fn too_few_samples_and_options_out_of_range_are_errors() {
    let (wheels, imu) = constant(1.0, 1.0, 0.0, 1);
    let error = fuse(&options(), &wheels[..1], &imu, None, None).unwrap_err();
    assert!(matches!(error, FuseError::TooFewWheelSamples { found: 1, .. }), "{error}");
    assert_eq!(
        error.to_string(),
        "found 1 usable wheel samples, expected 2 or more; check the wheel topic and check that \
         its stamps increase"
    );
    let error = fuse(&Options::default(), &wheels, &imu, None, None).unwrap_err();
    assert_eq!(error.to_string(), "`track_m` is 0, expected more than 0");
    let wide = Options { track_std: 0.5, ..options() };
    let error = wide.check().unwrap_err();
    assert_eq!(error.to_string(), "`track_std` is 0.5, expected 0 or more and less than 0.5");
    let unknown = Options { gyro_noise_density: f64::NAN, ..options() };
    assert_eq!(unknown.check().unwrap_err().key, "gyro_noise_density");
}
