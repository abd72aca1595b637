//! The yaw rate of an IMU that is mounted tilted.

/// The direction up in the IMU's frame, of length 1: that of the mean acceleration, which at rest
/// is the reaction to gravity. Over a drive that ends as fast as it began, accelerations along
/// the way cancel. None where the mean is no direction.
pub fn up(accelerations_m_s2: &[[f64; 3]]) -> Option<[f64; 3]> {
    let mut sum = [0.0; 3];
    for acceleration in accelerations_m_s2.iter().filter(|a| a.iter().all(|v| v.is_finite())) {
        for (sum, value) in sum.iter_mut().zip(acceleration) {
            *sum += value;
        }
    }
    let norm = sum.iter().map(|v| v * v).sum::<f64>().sqrt();
    (0.0 < norm).then(|| sum.map(|v| v / norm))
}

/// Rate about the direction up \[rad/s\]: the projection of the angular velocity. It is exact for
/// a robot on level ground, whatever the IMU's mounting; on a slope of angle a, where up is the
/// normal of the ground, it is the rate in the plane that the wheels drive in.
pub fn yaw_rate_rad_s(angular_velocity_rad_s: [f64; 3], up: [f64; 3]) -> f64 {
    angular_velocity_rad_s.iter().zip(up).map(|(rate, up)| rate * up).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rolled by 30 deg: up is (0, 1/2, sqrt(3)/2) in the IMU's frame, and 0.8 rad/s about it
    /// reads as 0.4 and 0.8 sqrt(3)/2.
    #[test]
    fn a_rolled_imu_by_hand() {
        let half_root = 0.75f64.sqrt();
        let accelerations = [[0.3, 4.0, 8.0 * half_root], [-0.3, 6.0, 12.0 * half_root]];
        let up = up(&accelerations).unwrap();
        assert!((up[0]).abs() < 1e-15 && (up[1] - 0.5).abs() < 1e-15);
        assert!((yaw_rate_rad_s([0.0, 0.4, 0.8 * half_root], up) - 0.8).abs() < 1e-15);
    }

    #[test]
    fn no_acceleration_is_no_direction() {
        assert_eq!(up(&[]), None);
        assert_eq!(up(&[[0.0; 3], [f64::NAN; 3]]), None);
    }
}
