//! The direction of gravity in the frame of an IMU.

/// Standard gravity \[m/s^2\].
const GRAVITY_M_S2: f64 = 9.80665;
/// Largest relative difference between a typical acceleration and standard gravity at which the
/// acceleration still counts as gravity.
const GRAVITY_TOLERANCE: f64 = 0.1;

/// Whether an acceleration of this norm \[m/s^2\] is gravity. Some drivers remove gravity from the
/// accelerations that they publish.
pub(crate) fn is_gravity(norm_m_s2: f64) -> bool {
    (norm_m_s2 / GRAVITY_M_S2 - 1.0).abs() < GRAVITY_TOLERANCE
}

/// Estimates the direction up in the IMU frame from the mean of all accelerations so far.
///
/// It is used while a log is being read. After the drive,
/// [`yaw_rates_rad_s`](crate::yaw_rates_rad_s) is more accurate.
///
/// ```
/// let mut gravity = fuse::GravityEstimate::default();
/// gravity.add([0.0, -9.8, 0.0]); // y points down
/// assert_eq!(gravity.up(), [0.0, -1.0, 0.0]);
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GravityEstimate {
    /// Sum of the accelerations \[m/s^2\].
    sum_m_s2: [f64; 3],
    n: u32,
}

impl GravityEstimate {
    /// Adds a measured acceleration (specific force) in the IMU frame \[m/s^2\].
    pub fn add(&mut self, acceleration_m_s2: [f64; 3]) {
        self.n += 1;
        self.sum_m_s2 = std::array::from_fn(|axis| self.sum_m_s2[axis] + acceleration_m_s2[axis]);
    }

    /// The direction up in the IMU frame, a unit vector: the direction of the mean acceleration. If
    /// the norm of the mean differs from gravity by more than 10 %, it is the z axis.
    pub fn up(&self) -> [f64; 3] {
        let mean = self.sum_m_s2.map(|v| v / f64::from(self.n.max(1)));
        let norm = mean.iter().map(|v| v * v).sum::<f64>().sqrt();
        match is_gravity(norm) {
            true => mean.map(|v| v / norm),
            false => [0.0, 0.0, 1.0],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rolled by 30 deg: sin 30 deg = 0.5. The two vibrations cancel in the mean.
    #[test]
    fn up_is_the_direction_of_the_mean_acceleration() {
        let (sin, cos) = (0.5, 0.75f64.sqrt());
        let mut gravity = GravityEstimate::default();
        for vibration in [3.0, -3.0] {
            gravity.add([vibration, GRAVITY_M_S2 * sin, GRAVITY_M_S2 * cos]);
        }
        for (found, expected) in gravity.up().iter().zip([0.0, sin, cos]) {
            assert!((found - expected).abs() < 1e-12, "{:?}", gravity.up());
        }
    }

    #[test]
    fn without_gravity_up_is_the_z_axis() {
        assert_eq!(GravityEstimate::default().up(), [0.0, 0.0, 1.0]);
        // Gravity removed by the driver, free fall, 12 % too large, invalid.
        for x in [0.1, 0.0, 1.12 * GRAVITY_M_S2, f64::NAN] {
            let mut gravity = GravityEstimate::default();
            gravity.add([x, 0.0, 0.0]);
            assert_eq!(gravity.up(), [0.0, 0.0, 1.0], "{x}");
        }
    }
}
