//! A drive: scans in the order of time with their poses.

use dataset::{Pose2, RangeLimits, Scan};
use model::OdometryNoise;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use crate::align::Weakness;
use crate::matcher::MatcherOptions;
use crate::points::Points;

/// How a drive is registered.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct RegisterOptions {
    /// A scan is registered when the robot has moved this far since the last one that was \[m\].
    pub spacing_m: f64,
    /// The same when it has turned by this angle \[deg\].
    pub turn_deg: f64,
    /// Returns farther than this are not used \[m\].
    pub max_range_m: f64,
    /// Scan matching.
    pub matcher: MatcherOptions,
}

impl Default for RegisterOptions {
    fn default() -> Self {
        Self {
            spacing_m: 0.2,
            turn_deg: 8.0,
            max_range_m: 25.0,
            matcher: MatcherOptions::default(),
        }
    }
}

/// A scan and where the odometry says the lidar is.
#[derive(Debug, Clone, Copy)]
pub struct OdometryScan<'a> {
    /// The scan.
    pub scan: &'a Scan,
    /// Pose of the lidar by odometry.
    pub odometry: Pose2,
    /// Covariance of the odometry since the start of the drive, if it is known: x, y, heading.
    pub covariance: Option<Matrix3<f64>>,
    /// Whether the scan is a keyframe. A keyframe is always registered.
    pub is_keyframe: bool,
}

/// A registered scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Registered {
    /// Index in the scans given to [`register_drive`].
    pub index: usize,
    /// Pose of the lidar, in the frame of the odometry of the first scan.
    pub pose: Pose2,
    /// Covariance of x, y and heading relative to the scans of the last metres. `None` for the first
    /// scan.
    pub covariance: Option<Matrix3<f64>>,
    /// Share of the points that are near a point of the last metres.
    pub near_share: f64,
    /// The direction in which the points determine the position worst.
    pub weakness: Option<Weakness>,
}

/// Registered scans in the order of time, as the later stages use them. All vectors have one entry
/// per scan.
#[derive(Debug, Clone)]
pub struct Drive<'a> {
    /// The scans.
    pub scans: Vec<&'a Scan>,
    /// Their points within the range limits, thinned, with normals.
    pub points: Vec<Points>,
    /// Pose of the lidar by odometry.
    pub odometry: Vec<Pose2>,
    /// Pose of the lidar by scan matching.
    pub poses: Vec<Pose2>,
    /// Path length by odometry \[m\].
    pub path_m: Vec<f64>,
    /// Whether the scan is a keyframe.
    pub is_keyframe: Vec<bool>,
}

impl<'a> Drive<'a> {
    /// Computes points and path. The path is the sum of the distances between consecutive scans.
    pub fn new(
        scans: Vec<&'a Scan>,
        odometry: Vec<Pose2>,
        poses: Vec<Pose2>,
        is_keyframe: Vec<bool>,
        limits: RangeLimits,
    ) -> Self {
        let _ = (scans, odometry, poses, is_keyframe, limits);
        todo!()
    }
}

/// Registers a drive: chooses scans, matches each with the scans of the last metres, then aligns all
/// of them together. `limits` are the range limits of the lidar.
pub fn register_drive(
    scans: &[OdometryScan<'_>],
    limits: RangeLimits,
    noise: &OdometryNoise,
    options: &RegisterOptions,
) -> Vec<Registered> {
    let _ = (scans, limits, noise, options);
    todo!()
}
