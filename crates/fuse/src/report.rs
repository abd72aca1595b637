use dataset::Losses;
use serde::{Deserialize, Serialize};

use crate::filter;
use crate::options::Options;
use crate::signal::Gaps;
use crate::smoother::{Estimate, Path};
use crate::steps::{Motion, Steps};

/// The samples that were used and the values that were calibrated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Time from the first to the last wheel sample \[s\].
    pub duration_secs: f64,
    /// Path length, measured by the calibrated wheels \[m\].
    pub distance_m: f64,
    /// Number of wheel samples used.
    pub n_wheel_samples: usize,
    /// Number of IMU samples used: those in the time range of the wheel samples.
    pub n_imu_samples: usize,
    /// Number of IMU samples outside of that range.
    pub n_imu_outside: usize,
    /// Time of the wheel samples before the first and after the last IMU sample; 0 without an IMU
    /// \[s\].
    pub wheels_alone_secs: f64,
    /// Number of measured headings used; at most one every `heading_every_secs`.
    pub n_headings: u64,
    /// Number of used headings that were beyond the gate and therefore got less weight.
    pub n_heading_outliers: u64,
    /// Number of one-second windows in which gyroscope and wheels differ by more than the gate
    /// allows, which indicates wheel slip.
    pub n_turn_outliers: u64,
    /// Number of these windows in which the robot moves. At standstill, the noise of a gyroscope that
    /// is larger than in the options has the same effect as slip.
    pub n_moving_outliers: u64,
    /// Mean gyroscope bias over the drive; `None` without an IMU \[rad/s\].
    pub gyro_bias_mean_rad_s: Option<f64>,
    /// Gyroscope bias at the end of the drive; `None` without an IMU \[rad/s\].
    pub gyro_bias_last_rad_s: Option<f64>,
    /// Effective track width \[m\].
    pub track_m: Calibrated,
    /// True path over measured path, for both wheels.
    pub wheel_scale: Calibrated,
    /// Half of (right wheel scale minus left wheel scale).
    pub wheel_difference: Calibrated,
    /// Share of the time in which both wheels stand still, 0 to 1.
    pub still_share: f64,
    /// Time spans without wheel samples.
    pub wheel_gaps: Gaps,
    /// Time spans without IMU samples.
    pub imu_gaps: Gaps,
    /// Samples and stamps that could not be used.
    pub losses: Losses,
}

/// A constant that was calibrated on the drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Calibrated {
    /// The calibrated value.
    pub value: f64,
    /// Its standard deviation.
    pub std: f64,
}

impl Report {
    /// Summarizes a fused drive.
    pub(crate) fn new(options: &Options, steps: &Steps, path: &Path, losses: Losses) -> Self {
        let steps_secs = |is_counted: &dyn Fn(bool) -> bool| -> f64 {
            steps
                .steps
                .iter()
                .filter(|step| is_counted(step.motion.is_still))
                // `fold` from 0.0, because `sum` of an empty iterator is -0.0.
                .fold(0.0, |secs, step| secs + step.motion.dt_secs)
        };
        let duration_secs = steps_secs(&|_| true);
        let last =
            |state: usize| (path.last.mean[state], path.last.covariance[(state, state)].sqrt());
        let (scale, scale_std) = last(filter::WHEEL_SCALE);
        let (difference, difference_std) = last(filter::WHEEL_DIFFERENCE);
        let (track, track_std) = last(filter::TRACK);
        let true_path_m = |motion: &Motion| {
            (1.0 + scale) * motion.distance_m + 0.5 * difference * motion.difference_m
        };
        let has_gyro = steps.steps.iter().any(|step| step.motion.turn_rad.is_some());
        let bias = |estimate: &Estimate| estimate.gyro_bias_rad_s;
        let bias_mean = path.estimates.iter().map(bias).sum::<f64>() / path.estimates.len() as f64;
        Self {
            duration_secs,
            distance_m: (steps.steps.iter()).map(|step| true_path_m(&step.motion).abs()).sum(),
            n_wheel_samples: steps.n_wheel_samples,
            n_imu_samples: steps.n_imu_samples,
            n_imu_outside: steps.n_imu_outside,
            wheels_alone_secs: steps.wheels_alone_secs,
            n_headings: path.n_headings,
            n_heading_outliers: path.n_heading_outliers,
            n_turn_outliers: path.n_turn_outliers,
            n_moving_outliers: path.n_moving_outliers,
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
            losses,
        }
    }
}
