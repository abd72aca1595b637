//! What to take from a log.

use messages::hdl32e::LASERS;
use serde::{Deserialize, Serialize};

use crate::pose_options::{PlanarPose, PoseOptions};
pub use crate::velodyne::clock::Clock;

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
    /// Where the lidar is on the robot, whose pose it is that is logged; without it the logged poses
    /// are the lidar's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount: Option<PlanarPose>,
    /// Each return is moved to where it would have been seen from at the scan's stamp, where the
    /// robot's motion is known often enough: poses, or wheels and IMU, at least every 0.25 s.
    pub deskew: bool,
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
            mount: None,
            deskew: true,
            max_missing_share: 0.25,
            clock: Clock::Host,
        }
    }
}

/// An option out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`ingest.lidar.{key}` is {found}, expected {expected}")]
pub struct OptionError {
    key: String,
    found: f64,
    expected: &'static str,
}

impl LidarOptions {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionError> {
        let fail =
            |key: &str, found, expected| Err(OptionError { key: key.to_owned(), found, expected });
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
        if let Some((key, found)) = self.mount.and_then(|mount| mount.not_finite()) {
            return fail(&format!("mount.{key}"), found, "a finite number");
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
