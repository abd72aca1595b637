//! What to take from a log.

use messages::hdl32e::LASERS;
use serde::{Deserialize, Serialize};

pub use crate::clock::Clock;

/// Where scans come from; the section `[ingest.lidar]`.
///
/// Of `laser`, `ring` and `elevation_deg` one may be given; without any it is the horizontal beam.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LidarOptions {
    /// Topic with packets (`VelodyneScan`, `VelodynePacket`), point clouds (`PointCloud2`,
    /// `foxglove.PointCloud`) or planar scans (`LaserScan`, `foxglove.LaserScan`); the schema tells
    /// which.
    pub topic: String,
    /// The laser that makes the scan, in firing order, 0 to 31; of packets only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laser: Option<u32>,
    /// The ring that makes the scan, 0 being the lowest beam; of packets and point clouds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ring: Option<u32>,
    /// The scan is made of the beam nearest to this elevation \[deg\], not more than 0.7 deg away.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<f64>,
    /// Returns nearer than this are left out \[m\].
    pub range_min_m: f64,
    /// Returns farther than this are left out \[m\].
    pub range_max_m: f64,
    /// The sensor hangs upside down: its scans are mirrored, so that y is left again.
    pub upside_down: bool,
    /// A turn of which a larger share of the packets is missing is dropped and counted.
    pub max_missing_share: f64,
    /// Where the time of a scan made of packets comes from.
    pub clock: Clock,
}

impl Default for LidarOptions {
    fn default() -> Self {
        Self {
            topic: "/velodyne_packets".to_owned(),
            laser: None,
            ring: None,
            elevation_deg: None,
            range_min_m: 0.9,
            range_max_m: 70.0,
            upside_down: false,
            max_missing_share: 0.25,
            clock: Clock::Host,
        }
    }
}

/// An option out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`ingest.lidar.{key}` is {found}, expected {expected}")]
pub struct OptionError {
    key: &'static str,
    found: f64,
    expected: &'static str,
}

impl LidarOptions {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionError> {
        let fail = |key, found, expected| Err(OptionError { key, found, expected });
        let (min, max, share) = (self.range_min_m, self.range_max_m, self.max_missing_share);
        if !(min.is_finite() && 0.0 <= min) {
            return fail("range_min_m", min, "0 or more");
        }
        if !(max.is_finite() && min < max) {
            return fail("range_max_m", max, "more than `ingest.lidar.range_min_m`");
        }
        if !(0.0..1.0).contains(&share) {
            return fail("max_missing_share", share, "0 or more and less than 1");
        }
        if let Some(laser) = self.laser
            && LASERS <= laser as usize
        {
            return fail("laser", f64::from(laser), "0 to 31, the lasers in firing order");
        }
        if let Some(deg) = self.elevation_deg
            && !(-90.0..=90.0).contains(&deg)
        {
            return fail("elevation_deg", deg, "-90 to 90");
        }
        let alternative = "no more than one of `laser`, `ring` and `elevation_deg`";
        match (self.laser, self.ring, self.elevation_deg) {
            (Some(laser), Some(_), _) | (Some(laser), _, Some(_)) => {
                fail("laser", f64::from(laser), alternative)
            }
            (_, Some(ring), Some(_)) => fail("ring", f64::from(ring), alternative),
            _ => Ok(()),
        }
    }
}

/// Where poses come from; the section `[ingest.pose]`: a `topic` that has them, or `wheels` and
/// `imu`, from which they are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PoseOptions {
    /// Topic with `PoseStamped`, `PoseWithCovarianceStamped`, `Odometry` or `foxglove.PoseInFrame`
    /// messages; the schema tells which.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub topic: Option<String>,
    /// Topic with the speeds of the wheels, `JointState` (names with `left` and `right` in them), or
    /// with `Odometry`, whose twist is taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheels: Option<String>,
    /// Topic with `Imu` messages.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub imu: Option<String>,
    /// Distance between the contact points of the left and the right wheel \[m\].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub track_m: Option<f64>,
    /// Radius of the wheels, where a `JointState` tells their angles \[m\]; without it positions are
    /// in m and velocities in m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wheel_radius_m: Option<f64>,
    /// Whether headings of the `Imu` messages' orientation are used, which need not be those of the
    /// map: their offset is estimated.
    pub use_heading: bool,
    /// Pose at the first reading of the wheels; without it the log has a map frame of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<Start>,
    /// What is known of the robot and its sensors.
    pub fuse: fuse::Options,
}

impl Default for PoseOptions {
    fn default() -> Self {
        Self {
            topic: None,
            wheels: None,
            imu: None,
            track_m: None,
            wheel_radius_m: None,
            use_heading: true,
            start: None,
            fuse: fuse::Options::default(),
        }
    }
}

/// Where a drive starts, in the site's map frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Start {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// Counter-clockwise from x \[deg\].
    pub heading_deg: f64,
}

impl PoseOptions {
    /// Poses of a topic that has them.
    pub fn of_topic(topic: impl Into<String>) -> Self {
        Self { topic: Some(topic.into()), ..Self::default() }
    }

    /// Whether the poses are in a map frame of the log's own: where its wheels were first read.
    pub fn is_own_frame(&self) -> bool {
        self.wheels.is_some() && self.start.is_none()
    }

    /// Refuses contradictions and values out of range.
    pub fn check(&self) -> Result<(), PoseOptionError> {
        let fail = |detail: String| Err(PoseOptionError { detail });
        match (&self.topic, &self.wheels, &self.imu) {
            (None, None, _) => {
                return fail("names neither `topic` nor `wheels`, expected one of them".to_owned());
            }
            (Some(_), Some(_), _) | (Some(_), _, Some(_)) => {
                return fail("names `topic` and `wheels` or `imu`, expected poses or what they are made from".to_owned());
            }
            (Some(_), None, None) => return Ok(()),
            (None, Some(_), _) => {}
        }
        if self.track_m.is_none() {
            return fail(
                "names `wheels` without `track_m`, the distance between the wheels in m".to_owned(),
            );
        }
        if let Some(radius_m) = self.wheel_radius_m
            && !(radius_m.is_finite() && 0.0 < radius_m)
        {
            return fail(format!("has `wheel_radius_m` {radius_m}, expected more than 0"));
        }
        if let Some(start) = self.start
            && ![start.x_m, start.y_m, start.heading_deg].iter().all(|v| v.is_finite())
        {
            return fail("has a `start` that is not finite".to_owned());
        }
        self.fuse_options().check().map_err(|e| PoseOptionError { detail: format!("has {e}") })
    }

    /// The options of the fusion, with the track.
    pub(crate) fn fuse_options(&self) -> fuse::Options {
        fuse::Options { track_m: self.track_m.unwrap_or_default(), ..self.fuse.clone() }
    }
}

/// Options that do not go together, or one out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`ingest.pose` {detail}")]
pub struct PoseOptionError {
    detail: String,
}

/// What to take from one log.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// The lidar.
    pub lidar: LidarOptions,
    /// The poses; none leaves the trajectory empty.
    pub pose: Option<PoseOptions>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_come_from_one_place() {
        let wheels = PoseOptions {
            wheels: Some("/wheels".to_owned()),
            track_m: Some(0.5),
            ..PoseOptions::default()
        };
        assert_eq!(PoseOptions::of_topic("/pose").check(), Ok(()));
        assert_eq!(wheels.check(), Ok(()));
        for (options, says) in [
            (PoseOptions::default(), "neither `topic` nor `wheels`"),
            (
                PoseOptions { topic: Some("/pose".to_owned()), ..wheels.clone() },
                "`topic` and `wheels`",
            ),
            (PoseOptions { track_m: None, ..wheels.clone() }, "without `track_m`"),
            (PoseOptions { track_m: Some(-1.0), ..wheels.clone() }, "track_m"),
        ] {
            let message = options.check().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    #[test]
    fn one_beam_is_named_in_one_way() {
        let options = |laser, ring, elevation_deg| {
            LidarOptions { laser, ring, elevation_deg, ..LidarOptions::default() }.check()
        };
        for (laser, ring, elevation_deg) in [
            (None, None, None),
            (Some(31), None, None),
            (None, Some(500), None),
            (None, None, Some(-9.3)),
        ] {
            assert_eq!(options(laser, ring, elevation_deg), Ok(()));
        }
        for (laser, ring, elevation_deg) in
            [(Some(1), Some(1), None), (Some(1), None, Some(1.0)), (None, Some(1), Some(1.0))]
        {
            assert!(
                options(laser, ring, elevation_deg)
                    .unwrap_err()
                    .to_string()
                    .contains("no more than one")
            );
        }
        let message = options(Some(32), None, None).unwrap_err().to_string();
        assert_eq!(
            message,
            "`ingest.lidar.laser` is 32, expected 0 to 31, the lasers in firing order"
        );
    }
}
