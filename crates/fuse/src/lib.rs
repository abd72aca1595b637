//! `fuse`: wheel encoders and a gyroscope -> poses with covariances, computed after the drive.
//!
//! ```text
//! wheels ─┐
//! imu ────┴─steps─► increments ──filter──► states ──smoother──► poses, covariances, report
//! ```
//!
//! Between two wheel stamps the robot moves along an arc. The encoders give the length of the arc.
//! The turn is the mean of the encoders' turn and the gyroscope's turn, weighted by their noise:
//! mostly the gyroscope in motion, only the encoders at standstill. The difference between the two
//! turns calibrates the gyroscope bias and the wheel scales. An extended Kalman filter estimates
//! this state:
//!
//! | state | unit | |
//! |---|---|---|
//! | x, y | m | midpoint between the wheels, in the frame of the first pose |
//! | heading | rad | counter-clockwise from x |
//! | gyroscope bias | rad/s | measured minus true yaw rate; a random walk |
//! | wheel scale | 1 | true over nominal path of both wheels, minus 1; constant |
//! | wheel difference | 1 | half of (right wheel scale minus left wheel scale); constant |
//! | track | 1 | nominal over true track width, minus 1; constant |
//! | heading offset | rad | measured minus true heading; constant |
//! | heading drift | rad | slowly varying error of the measured heading; Gauss-Markov |
//! | heading deviation | rad, rad | error that depends on the heading (cosine, sine); constant |
//!
//! The robot's x axis points forward and its y axis points left (REP 103). Filter and smoother
//! follow Särkkä 2013, "Bayesian filtering and smoothing", alg. 5.4 and 9.1. [`Options`] contains
//! the noise of every sensor.
//!
//! Some quantities cannot be observed. The gyroscope observes only the ratio of wheel scale to
//! track width; [`Options::track_std`] decides which of the two is corrected. The gyroscope bias is
//! best observed at standstill. The absolute position is not observed: the first pose is exact by
//! definition, and all covariances are relative to it. If the robot is carried while its wheels are
//! at rest, the filter does not see the motion.
//!
//! If one source has no samples for a while, the other source bridges the gap. If both are missing,
//! the variance grows with the third power of the length of the gap. All computations are
//! sequential, in f64, with the functions of `libm`: the same input gives the same bytes on every
//! machine.
//!
//! [`DeadReckoning`] integrates wheels and yaw rates while a log is being read, without
//! covariances. [`GravityEstimate`] and [`yaw_rates_rad_s`] find the vertical in the IMU frame.
//!
//! ```
//! use fuse::{Options, WheelSample, fuse};
//!
//! // 1 m/s straight ahead for 2 s.
//! let wheels: Vec<WheelSample> = (0..=100)
//!     .map(|k| WheelSample { stamp_ns: k * 20_000_000, left_m_s: 1.0, right_m_s: 1.0 })
//!     .collect();
//! let options = Options { track_m: 0.5, ..Options::default() };
//! let fused = fuse(&options, &wheels, &[], None, None)?;
//! let last = fused.poses.last().unwrap();
//! assert!((last.pose.x_m - 2.0).abs() < 1e-9);
//! # Ok::<(), fuse::FuseError>(())
//! ```

mod comparison;
mod dead_reckoning;
mod error;
mod filter;
mod gravity;
mod leveling;
mod options;
mod report;
mod samples;
mod signal;
mod smoother;
mod steps;

use dataset::{Losses, Pose2, wrap_angle};

pub use comparison::{TurnComparison, TurnComparisons, compare_turns};
pub use dead_reckoning::DeadReckoning;
pub use error::FuseError;
pub use gravity::GravityEstimate;
pub use leveling::{InertialReading, yaw_rates_rad_s};
pub use options::Options;
pub use report::{Calibrated, Report};
pub use samples::{ImuSample, WheelSample};
pub use signal::Gaps;

use smoother::Estimate;

/// A pose and its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusedPose {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// In the frame of the first pose.
    pub pose: Pose2,
    /// Upper triangle of the covariance of x, y and heading, row by row: xx, xy, xh, yy, yh, hh
    /// \[m^2, m rad, rad^2\]. It is relative to the first pose.
    pub covariance: [f64; 6],
}

/// The result of fusing one drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Fused {
    /// In order of time.
    pub poses: Vec<FusedPose>,
    /// Samples used and values calibrated.
    pub report: Report,
}

/// Fuses one drive.
///
/// The result has one pose for each wheel sample, or one for each of `stamps` if given. The first
/// wheel sample has the pose `start`. If `start` is `None`, the drive starts at the origin, with
/// the heading measured there, or with heading 0 if none was measured. Without IMU samples, the
/// result is plain wheel odometry.
///
/// Samples whose stamp is not later than the previous kept sample are dropped and counted.
pub fn fuse(
    options: &Options,
    wheels: &[WheelSample],
    imu: &[ImuSample],
    start: Option<Pose2>,
    stamps: Option<&[i64]>,
) -> Result<Fused, FuseError> {
    options.check()?;
    let mut losses = Losses::default();
    let steps = steps::steps(options, wheels, imu, stamps, &mut losses)?;
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
    Ok(Fused { poses, report: Report::new(options, &steps, &path, losses) })
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
