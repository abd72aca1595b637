//! Fuses one hour of an IMU at 100 Hz, with headings, and wheels at 50 Hz.
//!
//! `cargo bench -p fuse --bench hour`
//!
//! The benchmark also checks its results: the error at the end of the path agrees with its
//! covariance.

#![allow(clippy::unwrap_used, reason = "a benchmark panics if a value is missing")]

#[path = "../tests/support/mod.rs"]
mod support;

use dataset::Pose2;
use fuse::{InertialReading, Options, fuse, yaw_rates_rad_s};
use support::{Drive, Errors, Logged, drive, nees, winding_without_stops};

fn main() {
    divan::main();
}

fn hour(options: &Options) -> Logged {
    let hour = Drive {
        secs: 3600.0,
        wheel_hz: 50.0,
        imu_hz: 100.0,
        twist: winding_without_stops,
        has_heading: true,
    };
    drive(options, &hour, Errors { gyro_bias: 0.002, ..Errors::default() }, 1.0, 1)
}

#[divan::bench(args = [false, true], sample_count = 10, sample_size = 1)]
fn an_hour(bencher: divan::Bencher, smooth: bool) {
    let options = Options { track_m: 0.5, smooth, ..Options::default() };
    let logged = hour(&options);
    let run = || fuse(&options, &logged.wheels, &logged.imu, Some(Pose2::default()), None).unwrap();
    // Chi-square with 3 degrees of freedom: 0.1 % are above 16.3.
    let fused = run();
    assert!(nees(fused.poses.last().unwrap(), logged.truth.last().unwrap()) < 16.3);
    bencher.bench_local(run);
}

/// Computes the yaw rates of one hour from angular velocities and accelerations.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn level(bencher: divan::Bencher) {
    let logged = hour(&Options { track_m: 0.5, ..Options::default() });
    let reading = |sample: &fuse::ImuSample| InertialReading {
        stamp_ns: sample.stamp_ns,
        angular_velocity_rad_s: [0.0, 0.0, sample.yaw_rate_rad_s],
        acceleration_m_s2: Some([0.0, 0.0, 9.81]),
    };
    let readings: Vec<InertialReading> = logged.imu.iter().map(reading).collect();
    let run = || yaw_rates_rad_s(&readings, &logged.wheels);
    for (rate, sample) in run().iter().zip(&logged.imu) {
        assert!((rate - sample.yaw_rate_rad_s).abs() < 1e-9);
    }
    bencher.bench_local(run);
}
