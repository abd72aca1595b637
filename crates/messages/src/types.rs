//! The data in messages, independent of the message type and encoding. Fields are named as in ROS.

/// A planar scan.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    /// When the first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle of the first beam, counter-clockwise from x \[rad\].
    pub angle_min: f64,
    /// Angle of the last beam as the message states it \[rad\]. By the other fields it is
    /// `angle_min + (n - 1) * angle_increment`, which is also written for `None`.
    pub angle_max: Option<f64>,
    /// Angle from one beam to the next \[rad\].
    pub angle_increment: f64,
    /// Time from one beam to the next \[s\]; 0 if unknown.
    pub time_increment_s: f64,
    /// Smallest range of a return \[m\]. Smaller readings are not returns.
    pub range_min: f32,
    /// Largest range of a return \[m\]. Larger readings are not returns.
    pub range_max: f32,
    /// One reading per beam \[m\]. NaN and infinite readings are not returns.
    pub ranges: Vec<f32>,
}

impl LaserScan {
    /// Angle of the last beam by the angle of the first and the increment \[rad\].
    pub fn last_angle(&self) -> f64 {
        self.angle_min + self.angle_increment * self.ranges.len().saturating_sub(1) as f64
    }
}

/// A pose with its stamp.
#[derive(Debug, Clone, PartialEq)]
pub struct StampedPose3 {
    /// Time of the pose \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Position \[m\].
    pub position: [f64; 3],
    /// Orientation quaternion (x, y, z, w).
    pub orientation: [f64; 4],
}

/// A pose and a velocity.
#[derive(Debug, Clone, PartialEq)]
pub struct Odometry {
    /// Pose of `child_frame_id` in `frame_id`.
    pub pose: StampedPose3,
    /// The frame of the pose.
    pub frame_id: String,
    /// The frame that moves. The velocities are in this frame.
    pub child_frame_id: String,
    /// Covariance of (x, y, z, rotation about x, y, z), (6, 6), row by row \[m, rad\].
    pub pose_covariance: [f64; 36],
    /// Linear velocity \[m/s\].
    pub linear_velocity: [f64; 3],
    /// Angular velocity \[rad/s\].
    pub angular_velocity: [f64; 3],
}

/// A reading of an inertial measurement unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Imu {
    /// Time of the measurement \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Orientation quaternion (x, y, z, w); `None` if the unit does not estimate it.
    pub orientation: Option<[f64; 4]>,
    /// Angular velocity about x, y, z \[rad/s\].
    pub angular_velocity: [f64; 3],
    /// Specific force along x, y, z \[m/s^2\]; `None` if the unit does not measure it.
    pub linear_acceleration: Option<[f64; 3]>,
}

/// Positions and velocities of joints. Wheels are joints too.
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// Time of the measurement \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Names of the joints, (n,).
    pub names: Vec<String>,
    /// Positions \[rad or m\], (n,), or empty if unknown.
    pub positions: Vec<f64>,
    /// Velocities \[rad/s or m/s\], (n,), or empty if unknown.
    pub velocities: Vec<f64>,
}

/// A fix from a satellite navigation receiver (WGS 84).
#[derive(Debug, Clone, PartialEq)]
pub struct NavSatFix {
    /// Time of the measurement \[ns since the epoch\].
    pub stamp_ns: i64,
    /// -1: no fix, 0: fix, 1: satellite-based augmentation, 2: ground-based augmentation.
    pub status: i8,
    /// Latitude, positive north \[deg\].
    pub latitude_deg: f64,
    /// Longitude, positive east \[deg\].
    pub longitude_deg: f64,
    /// Height above the ellipsoid \[m\]; NaN if unknown.
    pub altitude_m: f64,
    /// Covariance of (east, north, up), (3, 3), row by row \[m^2\]; zeros if unknown.
    pub covariance: [f64; 9],
}

/// The pose of one frame in another.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// Time of the transform \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The frame that the pose is in.
    pub parent: String,
    /// The frame whose pose it is.
    pub child: String,
    /// Origin of the child in the parent \[m\].
    pub translation: [f64; 3],
    /// Orientation of the child in the parent, a quaternion (x, y, z, w).
    pub rotation: [f64; 4],
}
