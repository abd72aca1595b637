//! The options of ingestion.

use dataset::OutOfRange;
use messages::hdl32e::LASERS;
use serde::{Deserialize, Serialize};

use crate::pose_options::{PlanarPose, PoseOptions};
use crate::stamp::Stamp;
pub use crate::velodyne::clock::Clock;

/// Where scans come from: the section `[ingest.lidar]`.
///
/// At most one of `laser`, `ring` and `elevation_deg` can be set. The default is the horizontal beam.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct LidarOptions {
    /// Topic with packets (`VelodyneScan`, `VelodynePacket`), point clouds (`PointCloud2`,
    /// `foxglove.PointCloud`) or planar scans (`LaserScan`, `foxglove.LaserScan`). The schema of the
    /// topic selects the decoder.
    pub topic: String,
    /// The frame (`header.frame_id`) whose messages are used, if several sensors publish on the topic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_id: Option<String>,
    /// The time of a message that is used: `header`, the stamp in its header, or `log`, the time at
    /// which it was recorded. Use `log` if the stamps are 0 or wrong. With `log`, the last return of a
    /// message has the log time.
    pub stamp: Stamp,
    /// The laser that makes the scan, in firing order, 0 to 31. For packets only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laser: Option<u32>,
    /// The ring that makes the scan. Ring 0 is the lowest beam. For packets and point clouds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ring: Option<u32>,
    /// The beam with the nearest elevation makes the scan \[deg\]. It must be within 0.7 deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elevation_deg: Option<f64>,
    /// Returns nearer than this are left out \[m\].
    pub range_min_m: f64,
    /// Returns farther than this are left out \[m\].
    pub range_max_m: f64,
    /// Whether the sensor is mounted upside down. Its scans are mirrored, so that y points left.
    pub upside_down: bool,
    /// Pose of the lidar on the robot. Without it, the logged poses are taken as poses of the lidar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount: Option<PlanarPose>,
    /// Whether to deskew scans: move each return to where it would be seen from at the stamp of the
    /// scan. This needs poses, or wheels and IMU, at least every 0.25 s.
    pub deskew: bool,
    /// Revolutions with a larger share of missing packets are dropped.
    pub max_missing_share: f64,
    /// The clock that gives the time of a scan from packets.
    pub clock: Clock,
}

impl Default for LidarOptions {
    fn default() -> Self {
        Self {
            topic: "/velodyne_packets".to_owned(),
            frame_id: None,
            stamp: Stamp::Header,
            laser: None,
            ring: None,
            elevation_deg: None,
            range_min_m: 0.9,
            range_max_m: 70.0,
            upside_down: false,
            mount: None,
            deskew: true,
            max_missing_share: 0.25,
            clock: Clock::Host,
        }
    }
}

impl LidarOptions {
    /// Checks that every option is in its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let fail = |key: &str, found, expected| {
            Err(OutOfRange::new(format!("ingest.lidar.{key}"), found, expected))
        };
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
            return fail("laser", f64::from(laser), "0 to 31 (index in firing order)");
        }
        if let Some(deg) = self.elevation_deg
            && !(-90.0..=90.0).contains(&deg)
        {
            return fail("elevation_deg", deg, "-90 to 90");
        }
        if let Some((key, found)) = self.mount.and_then(|mount| mount.not_finite()) {
            return fail(&format!("mount.{key}"), found, "a finite number");
        }
        let expected = "at most one of `laser`, `ring` and `elevation_deg`";
        match (self.laser, self.ring, self.elevation_deg) {
            (Some(laser), Some(_), _) | (Some(laser), _, Some(_)) => {
                fail("laser", f64::from(laser), expected)
            }
            (_, Some(ring), Some(_)) => fail("ring", f64::from(ring), expected),
            _ => Ok(()),
        }
    }
}

/// The options for one log.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Where scans come from.
    pub lidar: LidarOptions,
    /// Where poses come from. Without it, the trajectory is empty.
    pub pose: Option<PoseOptions>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_most_one_option_selects_the_beam() {
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
                    .contains("at most one of")
            );
        }
        let message = options(Some(32), None, None).unwrap_err().to_string();
        assert_eq!(message, "`ingest.lidar.laser` is 32, expected 0 to 31 (index in firing order)");
    }
}
