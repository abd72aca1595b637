//! Pose messages -> stamped poses in the plane.

use dataset::{Pose2, StampedPose};
use messages::{Source, read_pose};

/// A quaternion whose norm is farther from 1 than this is no orientation.
const MAX_NORM_ERROR: f64 = 0.01;

/// Reads one pose; the error says what is wrong with the message ("that ...").
pub(crate) fn stamped_pose(source: Source, data: &[u8]) -> Result<StampedPose, String> {
    let pose = read_pose(source, data).map_err(|error| {
        format!("that do not decode as {} ({})", source.message_type.name(), error.kind())
    })?;
    if !pose.position.iter().all(|v| v.is_finite()) {
        return Err("with a value that is not finite".to_owned());
    }
    let planar = Pose2 {
        x_m: pose.position[0],
        y_m: pose.position[1],
        heading_rad: yaw_rad(unit_quaternion(pose.orientation)?),
    };
    Ok(StampedPose::new(pose.stamp_ns, planar))
}

/// A quaternion of length 1, of one that is nearly so; the error says what it is ("with ...").
pub(crate) fn unit_quaternion(q: [f64; 4]) -> Result<[f64; 4], String> {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !norm.is_finite() {
        return Err("with a value that is not finite".to_owned());
    }
    if (norm - 1.0).abs() > MAX_NORM_ERROR {
        return Err("whose quaternion is not of length 1".to_owned());
    }
    Ok(q.map(|v| v / norm))
}

/// Heading of a unit quaternion (x, y, z, w): the angle about z of the rotation sequence
/// z-y'-x'' (REP 103; Diebel 2006, "Representing Attitude", eq. 290).
pub(crate) fn yaw_rad([x, y, z, w]: [f64; 4]) -> f64 {
    libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use messages::ros::{write_odometry, write_pose_stamped};
    use messages::{Encoding, MessageType, Odometry, StampedPose3};

    fn read(orientation: [f64; 4], x: f64) -> Result<StampedPose, String> {
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
    fn heading_of_a_turn_about_z_also_when_pitched() {
        let half = 0.5f64.sqrt();
        let pose = read([0.0, 0.0, half, half], 1.0).unwrap(); // 90 deg about z
        assert_eq!((pose.stamp_ns, pose.pose.x_m, pose.pose.y_m), (9, 1.0, 2.0));
        assert!((pose.pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        let pose = read([0.0, 0.0, -0.6, 0.8], 1.0).unwrap(); // -2 asin(0.6)
        assert!((pose.pose.heading_rad + 2.0 * 0.6f64.asin()).abs() < 1e-12);
        // 90 deg about z, then pitched by 20 deg about its own y: q = qz * qy.
        let (s, c) = 10f64.to_radians().sin_cos();
        let pose = read([-half * s, half * s, half * c, half * c], 1.0).unwrap();
        assert!((pose.pose.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }

    #[test]
    fn what_is_no_pose_says_why() {
        assert!(read([0.0; 4], 1.0).unwrap_err().contains("not of length 1"));
        assert!(read([0.0, 0.0, 0.0, 1.0], f64::NAN).unwrap_err().contains("not finite"));
        let source = Source { message_type: MessageType::Odometry, encoding: Encoding::Cdr };
        assert!(stamped_pose(source, &[0, 1, 0, 0]).unwrap_err().contains("decode as Odometry"));
    }
}
