/// Speeds of the left and right driven wheels along the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelSample {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// \[m/s\]
    pub left_m_s: f64,
    /// \[m/s\]
    pub right_m_s: f64,
}

/// The yaw rate and the heading measured by an IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// Rate about the vertical, counter-clockwise seen from above \[rad/s\]. For an IMU that is not
    /// level, compute it with [`yaw_rates_rad_s`](crate::yaw_rates_rad_s).
    pub yaw_rate_rad_s: f64,
    /// Heading, counter-clockwise from a fixed direction \[rad\], measured by a compass, an
    /// attitude and heading reference system, or a fibre-optic gyroscope with an integrator.
    pub heading_rad: Option<f64>,
}

impl WheelSample {
    /// Computes the wheel speeds from the twist of an odometry message: the forward speed of the
    /// midpoint between the wheels, and the yaw rate that was computed with the track width
    /// `track_m`.
    pub fn from_twist(stamp_ns: i64, forward_m_s: f64, yaw_rate_rad_s: f64, track_m: f64) -> Self {
        let half_difference = 0.5 * track_m * yaw_rate_rad_s;
        Self {
            stamp_ns,
            left_m_s: forward_m_s - half_difference,
            right_m_s: forward_m_s + half_difference,
        }
    }

    /// Computes mean speeds from wheel positions. Each position is a stamp \[ns\], the path of the
    /// left wheel and the path of the right wheel \[m\]. The stamp of a speed is halfway between
    /// its two positions. If the stamps of the positions do not increase, the stamps of the speeds
    /// do not increase either; [`fuse`](crate::fuse) drops and counts such samples.
    pub fn from_positions(positions: &[(i64, f64, f64)]) -> Vec<Self> {
        let pairs = positions.iter().zip(positions.iter().skip(1));
        pairs
            .map(|(&(from_ns, left, right), &(to_ns, next_left, next_right))| {
                let dt_ns = to_ns.saturating_sub(from_ns);
                let dt = dt_ns as f64 * 1e-9;
                Self {
                    stamp_ns: from_ns.saturating_add(dt_ns / 2),
                    left_m_s: (next_left - left) / dt,
                    right_m_s: (next_right - right) / dt,
                }
            })
            .collect()
    }
}
