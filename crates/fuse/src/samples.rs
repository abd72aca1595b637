/// Speeds of the two driven wheels along the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WheelSample {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// \[m/s\]
    pub left_m_per_s: f64,
    /// \[m/s\]
    pub right_m_per_s: f64,
}

/// What an IMU says about the heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// Counter-clockwise seen from above; [`yaw_rates_rad_s`](crate::yaw_rates_rad_s) levels an
    /// IMU that leans \[rad/s\].
    pub yaw_rate_rad_s: f64,
    /// Counter-clockwise from a fixed direction, of a compass, an attitude and heading reference
    /// or a fibre-optic gyroscope that integrates \[rad\].
    pub heading_rad: Option<f64>,
}

impl WheelSample {
    /// From the twist of an odometry message: the speed of the middle between the wheels \[m/s\]
    /// and the yaw rate \[rad/s\] that was computed with this track \[m\].
    pub fn from_twist(stamp_ns: i64, forward_m_per_s: f64, yaw_rate: f64, track_m: f64) -> Self {
        let half_difference = 0.5 * track_m * yaw_rate;
        Self {
            stamp_ns,
            left_m_per_s: forward_m_per_s - half_difference,
            right_m_per_s: forward_m_per_s + half_difference,
        }
    }

    /// From the positions of the wheels: stamp \[ns\], path of the left and of the right one
    /// \[m\]. Each mean speed has the stamp halfway between its two positions. Positions whose
    /// stamp does not advance give stamps that do not, which [`fuse`](crate::fuse) counts.
    pub fn from_positions(positions: &[(i64, f64, f64)]) -> Vec<Self> {
        let pairs = positions.iter().zip(positions.iter().skip(1));
        pairs
            .map(|(&(from_ns, left, right), &(to_ns, next_left, next_right))| {
                let dt_ns = to_ns.saturating_sub(from_ns);
                let dt = dt_ns as f64 * 1e-9;
                Self {
                    stamp_ns: from_ns.saturating_add(dt_ns / 2),
                    left_m_per_s: (next_left - left) / dt,
                    right_m_per_s: (next_right - right) / dt,
                }
            })
            .collect()
    }
}
