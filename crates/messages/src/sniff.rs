//! Content sniffing: checks whether a message of a channel without a schema could be of a given type.

use crate::hdl32e::Packet;
use crate::wire::{Decoded, MAX_CDR_PADDING};
use crate::{Encoding, MessageType, Result, Source, read};

/// Largest plausible difference between 1 and the norm of a quaternion.
const MAX_NORM_ERROR: f64 = 1e-3;

/// Whether all of the bytes decode as one message of this type, and its values are plausible.
///
/// Up to 8 bytes of padding may follow a CDR message. These messages are plausible:
///
/// - Velodyne packets: at least one packet, all with the layout of an HDL-32E;
/// - a scan with finite angles and at least two beams;
/// - a cloud with at least one field;
/// - poses and transforms with finite numbers and unit quaternions;
/// - an IMU measurement with finite numbers;
/// - a joint state with names, and with no or one position and velocity per joint;
/// - a fix with a latitude of up to 90 deg and a longitude of up to 180 deg.
///
/// The JSON decoder ignores unknown fields. A scan or a cloud in JSON that contains a pose is
/// therefore also plausible as a `foxglove.PoseInFrame`.
pub fn is_plausible_message(source: Source, bytes: &[u8]) -> bool {
    let max_left = if source.encoding == Encoding::Cdr { MAX_CDR_PADDING } else { 0 };
    check_values(source, bytes).is_ok_and(|decoded| decoded.value && decoded.n_left <= max_left)
}

fn check_values(source: Source, bytes: &[u8]) -> Result<Decoded<bool>> {
    Ok(match source.message_type {
        MessageType::VelodyneScan | MessageType::VelodynePacket => read::velodyne(source, bytes)?
            .map(|scan| {
                !scan.is_empty() && scan.packets().all(|(_, packet)| Packet::new(packet).is_ok())
            }),
        MessageType::LaserScan | MessageType::FoxgloveLaserScan => read::laser_scan(source, bytes)?
            .map(|scan| {
                are_finite(&[scan.angle_min, scan.angle_increment]) && 2 <= scan.ranges.len()
            }),
        MessageType::PointCloud2 | MessageType::FoxglovePointCloud => {
            read::point_cloud(source, bytes)?.map(|cloud| !cloud.fields.is_empty())
        }
        MessageType::PoseStamped
        | MessageType::PoseWithCovarianceStamped
        | MessageType::Odometry
        | MessageType::FoxglovePoseInFrame => read::pose(source, bytes)?
            .map(|pose| are_finite(&pose.position) && is_unit(pose.orientation)),
        MessageType::Tf | MessageType::FoxgloveFrameTransform => read::transforms(source, bytes)?
            .map(|transforms| {
                let is_plausible = |t: &crate::Transform| {
                    !t.child.is_empty() && are_finite(&t.translation) && is_unit(t.rotation)
                };
                !transforms.is_empty() && transforms.iter().all(is_plausible)
            }),
        MessageType::NavSatFix => read::nav_sat_fix(source, bytes)?
            .map(|fix| fix.latitude_deg.abs() <= 90.0 && fix.longitude_deg.abs() <= 180.0),
        MessageType::Imu => read::imu(source, bytes)?.map(|imu| {
            are_finite(&imu.angular_velocity)
                && imu.orientation.is_none_or(is_unit)
                && imu.linear_acceleration.is_none_or(|values| are_finite(&values))
        }),
        MessageType::JointState => read::joint_state(source, bytes)?.map(|joints| {
            let fits = |values: &[f64]| values.is_empty() || values.len() == joints.names.len();
            !joints.names.is_empty() && fits(&joints.positions) && fits(&joints.velocities)
        }),
    })
}

fn are_finite(values: &[f64]) -> bool {
    values.iter().all(|value| value.is_finite())
}

fn is_unit(quaternion: [f64; 4]) -> bool {
    let norm = quaternion.iter().map(|value| value * value).sum::<f64>().sqrt();
    (norm - 1.0).abs() <= MAX_NORM_ERROR
}

#[cfg(test)]
mod tests;
