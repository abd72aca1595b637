//! `geometry_msgs/PoseStamped`, `geometry_msgs/PoseWithCovarianceStamped` and `nav_msgs/Odometry`.

use serde::{Deserialize, Serialize};

use super::{Covariance6, Header, decode, encode, flat_of, rows_of};
use crate::wire::Decoded;
use crate::{Encoding, MessageType, Odometry, Result, StampedPose3};

#[derive(Serialize, Deserialize)]
struct PoseWire {
    position: [f64; 3],
    orientation: [f64; 4],
}

impl PoseWire {
    fn new(pose: &StampedPose3) -> Self {
        Self { position: pose.position, orientation: pose.orientation }
    }

    fn stamped(&self, header: &Header) -> StampedPose3 {
        StampedPose3 {
            stamp_ns: header.stamp_ns(),
            position: self.position,
            orientation: self.orientation,
        }
    }
}

#[derive(Serialize, Deserialize)]
struct PoseStampedWire {
    header: Header,
    pose: PoseWire,
}

#[derive(Serialize, Deserialize)]
struct PoseWithCovarianceStampedWire {
    header: Header,
    pose: PoseWire,
    covariance: Covariance6,
}

#[derive(Serialize, Deserialize)]
struct OdometryWire {
    header: Header,
    child_frame_id: String,
    pose: PoseWire,
    pose_covariance: Covariance6,
    linear_velocity: [f64; 3],
    angular_velocity: [f64; 3],
    twist_covariance: Covariance6,
}

pub(crate) fn pose(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<StampedPose3>> {
    let decoded = decode::<PoseStampedWire>(MessageType::PoseStamped, encoding, bytes)?;
    Ok(decoded.map(|wire| wire.pose.stamped(&wire.header)))
}

pub(crate) fn pose_with_covariance(
    encoding: Encoding,
    bytes: &[u8],
) -> Result<Decoded<(StampedPose3, [f64; 36])>> {
    const TYPE: MessageType = MessageType::PoseWithCovarianceStamped;
    let decoded = decode::<PoseWithCovarianceStampedWire>(TYPE, encoding, bytes)?;
    Ok(decoded.map(|wire| (wire.pose.stamped(&wire.header), flat_of(&wire.covariance))))
}

pub(crate) fn odometry(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<Odometry>> {
    let decoded = decode::<OdometryWire>(MessageType::Odometry, encoding, bytes)?;
    Ok(decoded.map(|wire| Odometry {
        pose: wire.pose.stamped(&wire.header),
        frame_id: wire.header.frame_id,
        child_frame_id: wire.child_frame_id,
        pose_covariance: flat_of(&wire.pose_covariance),
        linear_velocity: wire.linear_velocity,
        angular_velocity: wire.angular_velocity,
    }))
}

/// Writes a `geometry_msgs/PoseStamped`.
pub fn write_pose_stamped(encoding: Encoding, frame_id: &str, pose: &StampedPose3) -> Vec<u8> {
    let header = Header::new(pose.stamp_ns, frame_id);
    encode(encoding, &PoseStampedWire { header, pose: PoseWire::new(pose) })
}

/// Writes a `geometry_msgs/PoseWithCovarianceStamped`. The covariance is that of (x, y, z, rotation
/// about x, y, z), (6, 6), row by row \[m, rad\].
pub fn write_pose_with_covariance_stamped(
    encoding: Encoding,
    frame_id: &str,
    pose: &StampedPose3,
    covariance: &[f64; 36],
) -> Vec<u8> {
    encode(
        encoding,
        &PoseWithCovarianceStampedWire {
            header: Header::new(pose.stamp_ns, frame_id),
            pose: PoseWire::new(pose),
            covariance: rows_of(covariance),
        },
    )
}

/// Writes a `nav_msgs/Odometry`. The covariance of the twist is set to zero.
pub fn write_odometry(encoding: Encoding, odometry: &Odometry) -> Vec<u8> {
    encode(
        encoding,
        &OdometryWire {
            header: Header::new(odometry.pose.stamp_ns, &odometry.frame_id),
            child_frame_id: odometry.child_frame_id.clone(),
            pose: PoseWire::new(&odometry.pose),
            pose_covariance: rows_of(&odometry.pose_covariance),
            linear_velocity: odometry.linear_velocity,
            angular_velocity: odometry.angular_velocity,
            twist_covariance: [[0.0; 6]; 6],
        },
    )
}
