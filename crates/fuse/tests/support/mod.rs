//! Simulated robots with known paths and known noise, for tests and the benchmark.

#![allow(dead_code, reason = "each test binary uses only a part of it")]

use dataset::{Pose2, SplitMix64};
use fuse::{FusedPose, ImuSample, Options, WheelSample};

/// Normally distributed numbers (Box and Muller 1958).
pub struct Normal(SplitMix64);

impl Normal {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    /// The next number, with mean 0 and standard deviation 1.
    pub fn next(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.0.unit())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.0.unit())
    }
}

/// The speeds of a drive and the rates of the samples.
pub struct Drive {
    pub secs: f64,
    pub wheel_hz: f64,
    pub imu_hz: f64,
    /// Function of time \[s\] that gives forward speed \[m/s\] and yaw rate \[rad/s\].
    pub twist: fn(f64) -> (f64, f64),
    pub has_heading: bool,
}

/// Constant errors of the sensors.
#[derive(Debug, Clone, Copy, Default)]
pub struct Errors {
    pub gyro_bias: f64,
    pub wheel_scale: f64,
    pub wheel_difference: f64,
    pub track: f64,
    pub heading_offset: f64,
}

pub struct Logged {
    pub wheels: Vec<WheelSample>,
    pub imu: Vec<ImuSample>,
    /// At the wheel samples.
    pub truth: Vec<Pose2>,
}

pub fn stamp_ns(secs: f64) -> i64 {
    1_700_000_000_000_000_000 + (secs * 1e9).round() as i64
}

/// Simulates a drive with the noise given in the options, multiplied by `noise`. With 0 only the
/// constant errors remain.
pub fn drive(options: &Options, drive: &Drive, errors: Errors, noise: f64, seed: u64) -> Logged {
    let mut random = Normal::new(seed);
    let mut normal = |std: f64| if noise > 0.0 { noise * std * random.next() } else { 0.0 };
    let track_m = options.track_m / (1.0 + errors.track);
    // The true path consists of many small arcs with sideways slip.
    let n_wheels = (drive.secs * drive.wheel_hz).round() as usize + 1;
    let per_wheel = 20;
    let dt = 1.0 / (drive.wheel_hz * per_wheel as f64);
    let mut pose = Pose2::default();
    let mut truth = vec![pose];
    let mut headings = vec![0.0];
    for k in 0..(n_wheels - 1) * per_wheel {
        let (v, w) = (drive.twist)((k as f64 + 0.5) * dt);
        let aside = normal(options.side_slip * (v.abs() * dt).sqrt());
        let (sin, cos) = libm::sincos(pose.heading_rad + 0.5 * w * dt);
        pose.x_m += v * dt * cos - aside * sin;
        pose.y_m += v * dt * sin + aside * cos;
        pose.heading_rad += w * dt;
        headings.push(pose.heading_rad);
        if (k + 1) % per_wheel == 0 {
            truth.push(pose);
        }
    }
    let wheels = (0..n_wheels).map(|k| {
        let secs = k as f64 / drive.wheel_hz;
        let (v, w) = (drive.twist)(secs);
        let is_still = v == 0.0 && w == 0.0;
        let mut measured = |speed: f64, scale: f64| {
            let density = options.wheel_noise_density.hypot(options.wheel_slip * v.abs().sqrt());
            let noise = if is_still { 0.0 } else { normal(density * drive.wheel_hz.sqrt()) };
            (speed + noise) / scale
        };
        let half = 0.5 * track_m * w;
        let (scale, difference) = (1.0 + errors.wheel_scale, errors.wheel_difference);
        WheelSample {
            stamp_ns: stamp_ns(secs),
            left_m_s: measured(v - half, scale - difference),
            right_m_s: measured(v + half, scale + difference),
        }
    });
    let wheels = wheels.collect();
    let mut drift = normal(options.heading_drift_std);
    let keep = libm::exp(-1.0 / (drive.imu_hz * options.heading_drift_secs));
    let imu = (0..=(drive.secs * drive.imu_hz).round() as usize).map(|k| {
        let secs = k as f64 / drive.imu_hz;
        let (_, w) = (drive.twist)(secs);
        let white = normal(options.gyro_noise_density * drive.imu_hz.sqrt());
        let true_heading = headings[((secs / dt).round() as usize).min(headings.len() - 1)];
        let heading =
            true_heading + errors.heading_offset + drift + normal(options.heading_noise_std);
        drift = keep * drift + normal(options.heading_drift_std * (1.0 - keep * keep).sqrt());
        ImuSample {
            stamp_ns: stamp_ns(secs),
            yaw_rate_rad_s: w + errors.gyro_bias + white,
            heading_rad: drive.has_heading.then(|| dataset::wrap_angle(heading)),
        }
    });
    Logged { imu: imu.collect(), wheels, truth }
}

/// A drive with curves and straight parts. It is at standstill for the first 10 s and from 60 s to
/// 70 s.
pub fn winding(t: f64) -> (f64, f64) {
    // 0 at standstill, 1 in motion, with a smooth change over 2 s.
    let ramp = |since: f64| {
        let share = (since / 2.0).clamp(0.0, 1.0);
        share * share * (3.0 - 2.0 * share)
    };
    let share = ramp(t - 10.0).min(ramp(60.0 - t).max(ramp(t - 70.0)));
    let (v, w) = winding_without_stops(t);
    (share * v, share * w)
}

/// The same drive without stops.
pub fn winding_without_stops(t: f64) -> (f64, f64) {
    (1.2 + 0.4 * libm::sin(0.2 * t), 0.5 * libm::sin(0.31 * t))
}

/// Normalized estimation error squared: e' P^-1 e.
pub fn nees(fused: &FusedPose, truth: &Pose2) -> f64 {
    let e = [
        fused.pose.x_m - truth.x_m,
        fused.pose.y_m - truth.y_m,
        dataset::wrap_angle(fused.pose.heading_rad - truth.heading_rad),
    ];
    let [xx, xy, xh, yy, yh, hh] = fused.covariance;
    // Cholesky factorization of the 3x3 matrix, then forward substitution.
    let a = xx.sqrt();
    let (b, c) = (xy / a, xh / a);
    let d = (yy - b * b).sqrt();
    let f = (yh - b * c) / d;
    let g = (hh - c * c - f * f).sqrt();
    let u = e[0] / a;
    let v = (e[1] - b * u) / d;
    let w = (e[2] - c * u - f * v) / g;
    u * u + v * v + w * w
}
