//! Pose messages -> stamped poses in the plane.

use dataset::{LossKind, Pose2, StampedPose};
use messages::{MessageError, Source, read_pose_and_covariance};

/// Largest accepted difference between the norm of a quaternion and 1.
const MAX_NORM_ERROR: f64 = 0.01;

/// Coordinates are smaller than this \[m\]. The circumference of the earth is 4e7 m, so no coordinate
/// of a map, a map projection or an earth-centered frame is larger. Programs that fail write values such
/// as 1e300.
pub(crate) const MAX_COORDINATE_M: f64 = 1e8;

/// A larger variance of a position or a heading means that it is not known \[m^2 or rad^2\].
const MAX_VARIANCE: f64 = 1e12;

/// Checks that a position is finite and possible.
pub(crate) fn check_position(position: &[f64; 3]) -> Result<(), LossKind> {
    if !position.iter().all(|v| v.is_finite()) {
        return Err(LossKind::NonFiniteMessages);
    }
    match position.iter().all(|v| v.abs() < MAX_COORDINATE_M) {
        true => Ok(()),
        false => Err(LossKind::ImpossiblePositions { max_m: MAX_COORDINATE_M as u64 }),
    }
}

/// Speeds, turn rates and accelerations are smaller than this, in any unit \[m/s, rad/s, m/s^2\]. A
/// gyroscope measures up to 4000 deg/s, an accelerometer up to 1e4 m/s^2.
const MAX_RATE: f64 = 1e6;
/// Positions of wheels are smaller than this \[rad or m\], after any distance.
const MAX_WHEEL_POSITION: f64 = 1e9;

/// Checks that the readings of wheels or an IMU are possible. Values that are not finite are counted
/// where the readings are used.
pub(crate) fn check_rates<'a>(rates: impl IntoIterator<Item = &'a f64>) -> Result<(), LossKind> {
    check_readings(rates, MAX_RATE)
}

/// Checks that the positions of wheels are possible.
pub(crate) fn check_wheel_positions(positions: &[f64]) -> Result<(), LossKind> {
    check_readings(positions, MAX_WHEEL_POSITION)
}

fn check_readings<'a>(values: impl IntoIterator<Item = &'a f64>, max: f64) -> Result<(), LossKind> {
    let is_possible = |v: &f64| !v.is_finite() || v.abs() < max;
    match values.into_iter().all(is_possible) {
        true => Ok(()),
        false => Err(LossKind::ImpossibleReadings { max: max as u64 }),
    }
}

/// Reads one pose message. The error is the kind of loss that the message is counted as.
pub(crate) fn stamped_pose(source: Source, data: &[u8]) -> Result<StampedPose, LossKind> {
    let (pose, covariance) =
        read_pose_and_covariance(source, data).map_err(|error| undecodable(source, &error))?;
    check_position(&pose.position)?;
    let planar = Pose2 {
        x_m: pose.position[0],
        y_m: pose.position[1],
        heading_rad: yaw_rad(unit_quaternion(pose.orientation)?),
    };
    let covariance = covariance.as_ref().and_then(planar_covariance);
    let z_m = Some(pose.position[2]);
    Ok(StampedPose { covariance, z_m, ..StampedPose::new(pose.stamp_ns, planar) })
}

/// The loss of a message that could not be decoded.
pub(crate) fn undecodable(source: Source, error: &MessageError) -> LossKind {
    match error {
        MessageError::NoField { field, found } => {
            LossKind::CloudsWithoutField { field: field.clone(), fields: found.join(", ") }
        }
        MessageError::Compressed => {
            LossKind::CompressedMessages { message_type: source.message_type.name().to_owned() }
        }
        error => LossKind::UndecodableMessages {
            message_type: source.message_type.name().to_owned(),
            fault: error.code().to_owned(),
        },
    }
}

/// The covariance of x, y and heading (xx, xy, xh, yy, yh, hh), selected from the (6, 6) covariance
/// of (x, y, z, rotation about x, y, z), row by row. It is `None` if the covariance is not known,
/// which messages express by zeros, a negative variance or a very large one.
pub(crate) fn planar_covariance(full: &[f64; 36]) -> Option<[f64; 6]> {
    let planar = [full[0], full[1], full[5], full[7], full[11], full[35]];
    let is_known = planar.iter().all(|v| v.abs() < MAX_VARIANCE)
        && [planar[0], planar[3], planar[5]].iter().all(|variance| 0.0 < *variance);
    is_known.then_some(planar)
}

/// Normalizes a quaternion whose norm is already close to 1.
pub(crate) fn unit_quaternion(q: [f64; 4]) -> Result<[f64; 4], LossKind> {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !norm.is_finite() {
        return Err(LossKind::NonFiniteMessages);
    }
    if (norm - 1.0).abs() > MAX_NORM_ERROR {
        return Err(LossKind::QuaternionNotNormalized);
    }
    Ok(q.map(|v| v / norm))
}

/// Heading of a unit quaternion (x, y, z, w): the angle about z of the rotation sequence z-y'-x''
/// (REP 103; Diebel 2006, "Representing Attitude", eq. 290).
pub(crate) fn yaw_rad([x, y, z, w]: [f64; 4]) -> f64 {
    libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::ros::{write_odometry, write_pose_stamped, write_pose_with_covariance_stamped};
    use messages::{Encoding, MessageType, Odometry, StampedPose3};

    /// Reads a pose from a `PoseStamped` and from an `Odometry` message.
    fn read(orientation: [f64; 4], x: f64) -> Result<StampedPose, LossKind> {
        let pose = StampedPose3 { stamp_ns: 9, position: [x, 2.0, 3.0], orientation };
        let source = |message_type| Source { message_type, encoding: Encoding::Cdr };
        let bytes = write_pose_stamped(Encoding::Cdr, "map", &pose);
        let stamped = stamped_pose(source(MessageType::PoseStamped), &bytes);
        let odometry = Odometry {
            pose,
            frame_id: "odom".to_owned(),
            child_frame_id: "base".to_owned(),
            pose_covariance: [0.0; 36],
            linear_velocity: [1.0, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        };
        let bytes = write_odometry(Encoding::Cdr, &odometry);
        assert_eq!(stamped_pose(source(MessageType::Odometry), &bytes), stamped);
        stamped
    }

    #[test]
    fn the_heading_is_the_angle_about_z_even_when_pitched() {
        let half = 0.5f64.sqrt();
        let pose = read([0.0, 0.0, half, half], 1.0).unwrap(); // 90 deg about z
        assert_eq!((pose.stamp_ns, pose.pose.x_m, pose.pose.y_m), (9, 1.0, 2.0));
        assert_eq!(pose.z_m, Some(3.0));
        assert!((pose.pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let pose = read([0.0, 0.0, -0.6, 0.8], 1.0).unwrap(); // -2 asin(0.6)
        assert!((pose.pose.heading_rad + 2.0 * 0.6f64.asin()).abs() < 1e-12);
        // 90 deg about z, then pitched by 20 deg about its own y: q = qz * qy.
        let (s, c) = 10f64.to_radians().sin_cos();
        let pose = read([-half * s, half * s, half * c, half * c], 1.0).unwrap();
        assert!((pose.pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    /// Entry (i, j) is 10 i + j. Rows 0, 1 and 5 are x, y and the rotation about z.
    #[test]
    fn the_planar_covariance_is_read_if_it_is_known() {
        let mut covariance = [0.0; 36];
        for (k, entry) in covariance.iter_mut().enumerate() {
            *entry = (10 * (k / 6) + k % 6) as f64;
        }
        let read = |covariance: &[f64; 36]| {
            let pose = StampedPose3 {
                stamp_ns: 9,
                position: [1.0, 2.0, 3.0],
                orientation: [0.0, 0.0, 0.0, 1.0],
            };
            let bytes = write_pose_with_covariance_stamped(Encoding::Cdr, "map", &pose, covariance);
            let message_type = MessageType::PoseWithCovarianceStamped;
            let source = Source { message_type, encoding: Encoding::Cdr };
            stamped_pose(source, &bytes).unwrap().covariance
        };
        assert_eq!(read(&covariance), None, "the variance of x is 0");
        covariance[0] = 0.5;
        assert_eq!(read(&covariance), Some([0.5, 1.0, 5.0, 11.0, 15.0, 55.0]));
        covariance[35] = f64::NAN;
        assert_eq!(read(&covariance), None);
    }

    #[test]
    fn impossible_readings_are_refused() {
        assert_eq!(check_rates(&[0.0, -70.0, 9e5, f64::NAN]), Ok(()));
        let impossible = LossKind::ImpossibleReadings { max: 1_000_000 };
        assert_eq!(check_rates(&[0.0, -1e300]), Err(impossible));
        assert_eq!(check_wheel_positions(&[1e8]), Ok(()));
        assert!(check_wheel_positions(&[1e300]).is_err());
    }

    #[test]
    fn invalid_messages_are_refused() {
        assert_eq!(read([0.0; 4], 1.0), Err(LossKind::QuaternionNotNormalized));
        assert_eq!(read([0.0, 0.0, 0.0, 1.0], f64::NAN), Err(LossKind::NonFiniteMessages));
        for x in [1e300, -1e9] {
            let impossible = LossKind::ImpossiblePositions { max_m: 100_000_000 };
            assert_eq!(read([0.0, 0.0, 0.0, 1.0], x), Err(impossible));
        }
        let source = Source { message_type: MessageType::Odometry, encoding: Encoding::Cdr };
        let error = stamped_pose(source, &[0, 1, 0, 0]).unwrap_err();
        assert!(
            matches!(&error, LossKind::UndecodableMessages { message_type, .. } if message_type == "Odometry"),
            "{error:?}"
        );
    }
}
