//! `foxglove.LaserScan`.

use prost::Message;
use serde::{Deserialize, Serialize};

use super::{Pose, Timestamp, decode, encode, stamp_ns, text};
use crate::wire::Decoded;
use crate::{Encoding, LaserScan, MessageType, Result};

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct LaserScanWire {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
    #[prost(double, tag = "4")]
    #[serde(with = "text::number")]
    start_angle: f64,
    #[prost(double, tag = "5")]
    #[serde(with = "text::number")]
    end_angle: f64,
    #[prost(double, repeated, tag = "6")]
    #[serde(with = "text::numbers")]
    ranges: Vec<f64>,
    #[prost(double, repeated, tag = "7")]
    #[serde(with = "text::numbers")]
    intensities: Vec<f64>,
}

/// Reads a `foxglove.LaserScan`. The message contains the angles of the first and the last beam, but
/// neither the times of the beams nor range limits. Its pose, the origin of the scan in its frame, is
/// ignored: a scan is in the frame of the lidar.
pub(crate) fn laser_scan(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<LaserScan>> {
    const TYPE: MessageType = MessageType::FoxgloveLaserScan;
    let Decoded { value: wire, n_left } = decode::<LaserScanWire>(TYPE, encoding, bytes)?;
    let angle_increment = match wire.ranges.len() {
        0 | 1 => 0.0,
        n_beams => (wire.end_angle - wire.start_angle) / (n_beams - 1) as f64,
    };
    let scan = LaserScan {
        stamp_ns: stamp_ns(TYPE, wire.timestamp)?,
        angle_min: wire.start_angle,
        angle_max: Some(wire.end_angle),
        angle_increment,
        time_increment_s: 0.0,
        range_min: 0.0,
        range_max: f32::INFINITY,
        ranges: wire.ranges.iter().map(|&range| range as f32).collect(),
    };
    Ok(Decoded { value: scan, n_left })
}

/// Writes a `foxglove.LaserScan` without intensities, at the origin of its frame. The message type has
/// no range limits, so readings outside the limits of the scan become NaN.
///
/// # Panics
/// Panics if the encoding is not protobuf or JSON.
pub fn write_laser_scan(encoding: Encoding, frame_id: &str, scan: &LaserScan) -> Vec<u8> {
    let limits = scan.range_min..=scan.range_max;
    let range = |&range: &f32| if limits.contains(&range) { f64::from(range) } else { f64::NAN };
    encode(
        encoding,
        &LaserScanWire {
            timestamp: Some(Timestamp::new(scan.stamp_ns)),
            frame_id: frame_id.to_owned(),
            pose: Some(Pose::identity()),
            start_angle: scan.angle_min,
            end_angle: scan.angle_max.unwrap_or(scan.last_angle()),
            ranges: scan.ranges.iter().map(range).collect(),
            intensities: Vec::new(),
        },
    )
}
