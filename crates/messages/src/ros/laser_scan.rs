//! `sensor_msgs/LaserScan`.

use serde::{Deserialize, Serialize};

use super::{Header, decode, encode, sequence};
use crate::wire::Decoded;
use crate::{Encoding, LaserScan, MessageType, Result};

#[derive(Serialize, Deserialize)]
struct LaserScanWire {
    header: Header,
    angle_min: f32,
    angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    range_min: f32,
    range_max: f32,
    #[serde(deserialize_with = "sequence")]
    ranges: Vec<f32>,
    #[serde(deserialize_with = "sequence")]
    intensities: Vec<f32>,
}

pub(crate) fn laser_scan(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<LaserScan>> {
    let decoded = decode::<LaserScanWire>(MessageType::LaserScan, encoding, bytes)?;
    Ok(decoded.map(|wire| LaserScan {
        stamp_ns: wire.header.stamp_ns(),
        angle_min: f64::from(wire.angle_min),
        angle_max: Some(f64::from(wire.angle_max)),
        angle_increment: f64::from(wire.angle_increment),
        time_increment_s: f64::from(wire.time_increment),
        range_min: wire.range_min,
        range_max: wire.range_max,
        ranges: wire.ranges,
    }))
}

/// Writes a `sensor_msgs/LaserScan` without intensities. Angles and times are rounded to `f32`.
pub fn write_laser_scan(encoding: Encoding, frame_id: &str, scan: &LaserScan) -> Vec<u8> {
    encode(
        encoding,
        &LaserScanWire {
            header: Header::new(scan.stamp_ns, frame_id),
            angle_min: scan.angle_min as f32,
            angle_max: scan.angle_max.unwrap_or(scan.last_angle()) as f32,
            angle_increment: scan.angle_increment as f32,
            time_increment: scan.time_increment_s as f32,
            scan_time: 0.0,
            range_min: scan.range_min,
            range_max: scan.range_max,
            ranges: scan.ranges.clone(),
            intensities: Vec::new(),
        },
    )
}
