//! The errors agree with the covariances.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod support;

use dataset::Pose2;
use fuse::{FusedPose, Options, fuse};
use support::{Drive, Errors, Normal, drive, nees, winding};

const RUNS: u64 = 100;

/// 95 % interval of the mean over 100 runs of a chi-square variable with 3 degrees of freedom. For
/// the sum, with 300 degrees of freedom, 2.5 % are below 253.9 and 2.5 % above 349.9 (Bar-Shalom,
/// Li and Kirubarajan 2001, "Estimation with applications to tracking and navigation", sec. 5.4.2).
const BOUNDS: std::ops::RangeInclusive<f64> = 2.539..=3.499;

fn options() -> Options {
    Options {
        track_m: 0.5,
        track_std: 0.02,
        wheel_scale_std: 0.01,
        wheel_difference_std: 0.002,
        gyro_bias_std: 0.005,
        gyro_bias_walk: 0.0,
        gyro_noise_density: 2e-3,
        heading_deviation_std: 0.0,
        // The drive is smooth: sampling does not miss motion.
        acceleration_density: 0.0,
        yaw_acceleration_density: 0.0,
        gate: 5.0,
        ..Options::default()
    }
}

/// Mean NEES (normalized estimation error squared) at 15, 30, 50, 80 and 120 s over seeded runs.
/// Each run has its own bias, scales, track width and noise.
fn mean_nees(has_heading: bool, smooth: bool) -> Vec<f64> {
    let options = Options { smooth, ..options() };
    let winding = Drive { secs: 120.0, wheel_hz: 20.0, imu_hz: 40.0, twist: winding, has_heading };
    let at = [15.0, 30.0, 50.0, 80.0, 120.0].map(|secs: f64| (secs * winding.wheel_hz) as usize);
    let mut sums = vec![0.0; at.len()];
    for run in 0..RUNS {
        let mut random = Normal::new(1000 + run);
        let errors = Errors {
            gyro_bias: options.gyro_bias_std * random.next(),
            wheel_scale: options.wheel_scale_std * random.next(),
            wheel_difference: options.wheel_difference_std * random.next(),
            track: options.track_std * random.next(),
            heading_offset: 0.3,
        };
        let logged = drive(&options, &winding, errors, 1.0, 77 * run + 5);
        let start = Some(Pose2::default());
        let fused = fuse(&options, &logged.wheels, &logged.imu, start, None).unwrap();
        for (sum, &k) in sums.iter_mut().zip(&at) {
            *sum += nees(&fused.poses[k], &logged.truth[k]);
        }
    }
    sums.iter().map(|sum| sum / RUNS as f64).collect()
}

#[test]
fn errors_agree_with_the_covariances() {
    for (has_heading, smooth) in [(false, false), (false, true), (true, false), (true, true)] {
        let means = mean_nees(has_heading, smooth);
        assert!(
            means.iter().all(|mean| BOUNDS.contains(mean)),
            "heading {has_heading}, smooth {smooth}: {means:?}"
        );
    }
}

/// P_filter - P_smoother is positive semidefinite, up to rounding: its principal minors are not
/// negative.
#[test]
fn later_samples_never_increase_the_covariance() {
    let both = [false, true].map(|smooth| {
        let options = Options { smooth, ..options() };
        let winding =
            Drive { secs: 120.0, wheel_hz: 20.0, imu_hz: 40.0, twist: winding, has_heading: true };
        let errors = Errors { gyro_bias: 0.003, ..Errors::default() };
        let logged = drive(&options, &winding, errors, 1.0, 9);
        fuse(&options, &logged.wheels, &logged.imu, None, None).unwrap().poses
    });
    let [filtered, smoothed]: [Vec<FusedPose>; 2] = both;
    for (f, s) in filtered.iter().zip(&smoothed) {
        let [xx, xy, xh, yy, yh, hh] = std::array::from_fn(|k| f.covariance[k] - s.covariance[k]);
        let slack = 1e-9;
        let minor = xx * yy - xy * xy;
        let whole = minor * hh - xx * yh * yh - yy * xh * xh + 2.0 * xy * xh * yh;
        assert!(-slack <= xx.min(yy).min(hh), "{f:?} {s:?}");
        assert!(-slack <= minor && -slack <= whole, "{f:?} {s:?}");
    }
    assert_eq!(filtered.last(), smoothed.last());
}

#[test]
fn the_same_input_gives_the_same_bits() {
    let winding =
        Drive { secs: 120.0, wheel_hz: 20.0, imu_hz: 40.0, twist: winding, has_heading: true };
    let logged = drive(&options(), &winding, Errors::default(), 1.0, 9);
    let run = || fuse(&options(), &logged.wheels, &logged.imu, None, None).unwrap();
    assert_eq!(run(), run());
}
