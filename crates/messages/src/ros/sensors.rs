//! `sensor_msgs/Imu`, `sensor_msgs/JointState` and `sensor_msgs/NavSatFix`.

use serde::{Deserialize, Serialize};

use super::{Header, decode, encode, sequence};
use crate::wire::Decoded;
use crate::{Encoding, Imu, JointState, MessageType, NavSatFix, Result};

/// First element of the covariance of a value that is not measured (`sensor_msgs/Imu`).
const NOT_MEASURED: f64 = -1.0;

#[derive(Serialize, Deserialize)]
struct ImuWire {
    header: Header,
    orientation: [f64; 4],
    orientation_covariance: [f64; 9],
    angular_velocity: [f64; 3],
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: [f64; 3],
    linear_acceleration_covariance: [f64; 9],
}

#[derive(Serialize, Deserialize)]
struct JointStateWire {
    header: Header,
    #[serde(deserialize_with = "sequence")]
    name: Vec<String>,
    #[serde(deserialize_with = "sequence")]
    position: Vec<f64>,
    #[serde(deserialize_with = "sequence")]
    velocity: Vec<f64>,
    #[serde(deserialize_with = "sequence")]
    effort: Vec<f64>,
}

#[derive(Serialize, Deserialize)]
struct NavSatFixWire {
    header: Header,
    status: i8,
    service: u16,
    latitude_deg: f64,
    longitude_deg: f64,
    altitude_m: f64,
    covariance: [f64; 9],
    covariance_type: u8,
}

pub(crate) fn imu(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<Imu>> {
    let decoded = decode::<ImuWire>(MessageType::Imu, encoding, bytes)?;
    Ok(decoded.map(|wire| {
        let measures_orientation =
            wire.orientation_covariance[0] != NOT_MEASURED && wire.orientation != [0.0; 4];
        let measures_acceleration = wire.linear_acceleration_covariance[0] != NOT_MEASURED;
        Imu {
            stamp_ns: wire.header.stamp_ns(),
            orientation: measures_orientation.then_some(wire.orientation),
            angular_velocity: wire.angular_velocity,
            linear_acceleration: measures_acceleration.then_some(wire.linear_acceleration),
        }
    }))
}

/// Writes a `sensor_msgs/Imu` with unknown covariances.
pub fn write_imu(encoding: Encoding, frame_id: &str, imu: &Imu) -> Vec<u8> {
    let covariance = |measured: bool| {
        let mut covariance = [0.0; 9];
        covariance[0] = if measured { 0.0 } else { NOT_MEASURED };
        covariance
    };
    encode(
        encoding,
        &ImuWire {
            header: Header::new(imu.stamp_ns, frame_id),
            orientation: imu.orientation.unwrap_or_default(),
            orientation_covariance: covariance(imu.orientation.is_some()),
            angular_velocity: imu.angular_velocity,
            angular_velocity_covariance: covariance(true),
            linear_acceleration: imu.linear_acceleration.unwrap_or_default(),
            linear_acceleration_covariance: covariance(imu.linear_acceleration.is_some()),
        },
    )
}

pub(crate) fn joint_state(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<JointState>> {
    let decoded = decode::<JointStateWire>(MessageType::JointState, encoding, bytes)?;
    Ok(decoded.map(|wire| JointState {
        stamp_ns: wire.header.stamp_ns(),
        names: wire.name,
        positions: wire.position,
        velocities: wire.velocity,
    }))
}

/// Writes a `sensor_msgs/JointState` without efforts.
pub fn write_joint_state(encoding: Encoding, frame_id: &str, joints: &JointState) -> Vec<u8> {
    encode(
        encoding,
        &JointStateWire {
            header: Header::new(joints.stamp_ns, frame_id),
            name: joints.names.clone(),
            position: joints.positions.clone(),
            velocity: joints.velocities.clone(),
            effort: Vec::new(),
        },
    )
}

pub(crate) fn nav_sat_fix(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<NavSatFix>> {
    let decoded = decode::<NavSatFixWire>(MessageType::NavSatFix, encoding, bytes)?;
    Ok(decoded.map(|wire| NavSatFix {
        stamp_ns: wire.header.stamp_ns(),
        status: wire.status,
        latitude_deg: wire.latitude_deg,
        longitude_deg: wire.longitude_deg,
        altitude_m: wire.altitude_m,
        covariance: wire.covariance,
    }))
}

/// Writes a `sensor_msgs/NavSatFix` with the service GPS.
pub fn write_nav_sat_fix(encoding: Encoding, frame_id: &str, fix: &NavSatFix) -> Vec<u8> {
    /// `NavSatStatus::SERVICE_GPS`
    const GPS: u16 = 1;
    /// `NavSatFix::COVARIANCE_TYPE_UNKNOWN` and `COVARIANCE_TYPE_KNOWN`
    const UNKNOWN: u8 = 0;
    const KNOWN: u8 = 3;
    encode(
        encoding,
        &NavSatFixWire {
            header: Header::new(fix.stamp_ns, frame_id),
            status: fix.status,
            service: GPS,
            latitude_deg: fix.latitude_deg,
            longitude_deg: fix.longitude_deg,
            altitude_m: fix.altitude_m,
            covariance: fix.covariance,
            covariance_type: if fix.covariance == [0.0; 9] { UNKNOWN } else { KNOWN },
        },
    )
}
