//! `fuse`: wheel encoders and a gyroscope -> poses with covariances, after the drive.
//!
//! ```text
//! wheels ─┐                        x, y, heading, and what is
//! imu ────┴─steps─► increments ──► filter ──► smoother ──► poses, covariances, report
//! ```
//!
//! Between two stamps of the wheels the robot moves along an arc. Its length is what the encoders
//! say, its turn the mean of what encoders and gyroscope say, weighted by their noise: nearly all
//! gyroscope in motion, all encoders at standstill. What the two say differently tells the
//! gyroscope's bias and the wheels' scales. An extended Kalman filter carries the state
//!
//! | state | unit | |
//! |---|---|---|
//! | x, y | m | of the middle between the wheels, in the frame of the first pose |
//! | heading | rad | counter-clockwise from x |
//! | gyroscope's bias | rad/s | measured less true yaw rate; a random walk |
//! | wheel scale | 1 | true over nominal path of both wheels, less 1; constant |
//! | wheel difference | 1 | right wheel's scale less the left one's, halved; constant |
//! | track | 1 | nominal over true track, less 1; constant |
//! | heading's offset | rad | measured less true heading; constant |
//! | heading's drift | rad | the same, coming and going; Gauss-Markov |
//! | heading's deviation | rad, rad | the same, by the cosine and sine of the heading; constant |
//!
//! (x forward and y left of the robot, REP 103). Filter and smoother follow Särkkä 2013, "Bayesian
//! filtering and smoothing", alg. 5.4 and 9.1. [`Options`] holds the noise of every sensor.
//!
//! What can be known: the gyroscope tells the ratio of wheel scale to track
//! ([`Options::track_std`] says who is to blame), a standstill its bias. Nothing here tells where
//! the log began: the first pose is certain by definition, and covariances are relative to it. A
//! robot that is carried with its wheels at rest is not seen to move.
//!
//! A source that is missing for a while is bridged by the other one; the variance of what both
//! miss grows with the third power of the gap. Everything is computed one after the other in f64
//! with the functions of `libm`: the same input gives the same bytes anywhere.

mod filter;
mod level;
mod options;
mod samples;
mod signal;
mod smoother;
mod steps;

use dataset::{Dropped, Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

pub use level::{Inertial, yaw_rates_rad_s};
pub use options::{OptionError, Options};
pub use samples::{ImuSample, WheelSample};

use smoother::{Estimate, Path};
use steps::Steps;

/// A pose and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedPose {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// In the frame of the first pose.
    pub pose: Pose2,
    /// Upper triangle of the covariance of x, y and heading, row by row: xx, xy, xh, yy, yh, hh
    /// \[m^2, m rad, rad^2\].
    pub covariance: [f64; 6],
}

/// The drive as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Fused {
    /// In order of time.
    pub poses: Vec<FusedPose>,
    /// What was used and found.
    pub report: Report,
}

/// What was used and found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// From the first to the last wheel sample \[s\].
    pub duration_secs: f64,
    /// Path by the calibrated wheels \[m\].
    pub distance_m: f64,
    /// Wheel samples used.
    pub n_wheel_samples: usize,
    /// IMU samples used.
    pub n_imu_samples: usize,
    /// Measured headings used; at most one every `heading_every_secs`.
    pub n_headings: u64,
    /// Of these, beyond the gate and therefore given less weight.
    pub n_heading_outliers: u64,
    /// Seconds in which gyroscope and wheels differ beyond the gate: slip.
    pub n_turn_outliers: u64,
    /// Mean over the drive; none without an IMU \[rad/s\].
    pub gyro_bias_mean_rad_s: Option<f64>,
    /// At the end; none without an IMU \[rad/s\].
    pub gyro_bias_last_rad_s: Option<f64>,
    /// Effective track \[m\].
    pub track_m: Calibrated,
    /// True over measured path of both wheels.
    pub wheel_scale: Calibrated,
    /// Right wheel's scale less the left one's, halved, over their mean.
    pub wheel_difference: Calibrated,
    /// Share of the time at which both wheels stand still, 0 to 1.
    pub still_share: f64,
    /// Stretches without wheel samples.
    pub wheel_gaps: Gaps,
    /// Stretches without IMU samples.
    pub imu_gaps: Gaps,
    /// What could not be used.
    pub dropped: Dropped,
}

/// A constant, calibrated on the drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibrated {
    /// Its value.
    pub value: f64,
    /// Its deviation.
    pub std: f64,
}

/// Stretches without samples, longer than `max_gap_secs`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Gaps {
    /// Stretches.
    pub n: usize,
    /// Their time \[s\].
    pub secs: f64,
}

/// Why there are no poses.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// An option out of range.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// There is no time between the first and the last wheel sample.
    #[error(
        "{found} usable wheel samples, expected 2 or more ({dropped}); check the topic of the wheels and that its stamps advance"
    )]
    TooFewWheelSamples {
        /// Samples that could be used.
        found: usize,
        /// Those that could not, by reason.
        dropped: Dropped,
    },
}

/// Fuses one drive.
///
/// The poses are at the stamps of the wheel samples, or at `stamps` where given. The first wheel
/// sample is at `start`; without one, at the origin with the first heading measured there, else
/// 0. No IMU samples at all leave plain wheel odometry.
///
/// Samples whose stamp does not come after the last one kept are dropped and counted.
pub fn fuse(
    options: &Options,
    wheels: &[WheelSample],
    imu: &[ImuSample],
    start: Option<Pose2>,
    stamps: Option<&[i64]>,
) -> Result<Fused, FuseError> {
    options.check()?;
    let mut dropped = Dropped::default();
    let steps = steps::steps(options, wheels, imu, stamps, &mut dropped)?;
    let start = start.unwrap_or_else(|| Pose2 {
        heading_rad: steps.start_heading_rad.unwrap_or(0.0),
        ..Pose2::default()
    });
    let path = smoother::estimate(options, &steps, start);
    let stamps = (std::iter::once((steps.start_ns, steps.is_start_output)))
        .chain(steps.steps.iter().map(|step| (step.stamp_ns, step.is_output)));
    let poses = (path.estimates.iter().zip(stamps))
        .filter(|(_, (_, is_output))| *is_output)
        .map(|(estimate, (stamp_ns, _))| fused_pose(stamp_ns, estimate))
        .collect();
    Ok(Fused { poses, report: report(options, &steps, &path, dropped) })
}

fn fused_pose(stamp_ns: i64, estimate: &Estimate) -> FusedPose {
    let [x_m, y_m, heading] = estimate.pose;
    let c = &estimate.covariance;
    FusedPose {
        stamp_ns,
        pose: Pose2 { x_m, y_m, heading_rad: wrap_angle(heading) },
        covariance: [c[(0, 0)], c[(0, 1)], c[(0, 2)], c[(1, 1)], c[(1, 2)], c[(2, 2)]],
    }
}

fn report(options: &Options, steps: &Steps, path: &Path, dropped: Dropped) -> Report {
    let steps_secs = |is_counted: &dyn Fn(bool) -> bool| -> f64 {
        steps
            .steps
            .iter()
            .filter(|step| is_counted(step.motion.is_still))
            // From 0, since the sum of nothing is -0.
            .fold(0.0, |secs, step| secs + step.motion.dt)
    };
    let duration_secs = steps_secs(&|_| true);
    let last = |state: usize| (path.last.mean[state], path.last.covariance[(state, state)].sqrt());
    let (scale, scale_std) = last(filter::WHEEL_SCALE);
    let (difference, difference_std) = last(filter::WHEEL_DIFFERENCE);
    let (track, track_std) = last(filter::TRACK);
    let true_path_m = |motion: &steps::Motion| {
        (1.0 + scale) * motion.distance_m + 0.5 * difference * motion.difference_m
    };
    let has_gyro = steps.steps.iter().any(|step| step.motion.turn_rad.is_some());
    let bias = |estimate: &Estimate| estimate.gyro_bias_rad_s;
    let bias_mean = path.estimates.iter().map(bias).sum::<f64>() / path.estimates.len() as f64;
    Report {
        duration_secs,
        distance_m: (steps.steps.iter()).map(|step| true_path_m(&step.motion).abs()).sum(),
        n_wheel_samples: steps.n_wheel_samples,
        n_imu_samples: steps.n_imu_samples,
        n_headings: path.n_headings,
        n_heading_outliers: path.n_heading_outliers,
        n_turn_outliers: path.n_turn_outliers,
        gyro_bias_mean_rad_s: has_gyro.then_some(bias_mean),
        gyro_bias_last_rad_s: path.estimates.last().filter(|_| has_gyro).map(bias),
        // d (track / (1 + k)) = -track / (1 + k)^2 dk
        track_m: Calibrated {
            value: options.track_m / (1.0 + track),
            std: options.track_m / ((1.0 + track) * (1.0 + track)) * track_std,
        },
        wheel_scale: Calibrated {
            value: options.wheel_scale * (1.0 + scale),
            std: options.wheel_scale * scale_std,
        },
        wheel_difference: Calibrated {
            value: options.wheel_scale * difference,
            std: options.wheel_scale * difference_std,
        },
        still_share: steps_secs(&|is_still| is_still) / duration_secs,
        wheel_gaps: steps.wheel_gaps,
        imu_gaps: steps.imu_gaps,
        dropped,
    }
}
