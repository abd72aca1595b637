//! What messages say, whichever family and encoding they come from.

/// A planar scan.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    /// When the first beam fired \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Angle of the first beam \[rad, counter-clockwise from x\].
    pub angle_min: f64,
    /// Angle from a beam to the next \[rad\].
    pub angle_increment: f64,
    /// Time from a beam to the next \[s\]; 0 where unknown.
    pub time_increment_s: f64,
    /// Readings nearer than this are no returns \[m\].
    pub range_min: f32,
    /// Readings farther than this are no returns \[m\].
    pub range_max: f32,
    /// One reading a beam \[m\]; NaN and infinities are no returns.
    pub ranges: Vec<f32>,
}

/// A pose with its time.
#[derive(Debug, Clone, PartialEq)]
pub struct StampedPose3 {
    /// When the pose was held \[ns since the epoch\].
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
    /// The frame that moves, and that the velocities are given in.
    pub child_frame_id: String,
    /// Covariance of (x, y, z, rotation about x, y, z), (6, 6) row by row \[m, rad\].
    pub pose_covariance: [f64; 36],
    /// Linear velocity \[m/s\].
    pub linear_velocity: [f64; 3],
    /// Angular velocity \[rad/s\].
    pub angular_velocity: [f64; 3],
}

/// A reading of an inertial measurement unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Imu {
    /// When it was measured \[ns since the epoch\].
    pub stamp_ns: i64,
    /// Orientation quaternion (x, y, z, w), none where the unit does not estimate it.
    pub orientation: Option<[f64; 4]>,
    /// Angular velocity about x, y, z \[rad/s\].
    pub angular_velocity: [f64; 3],
    /// Specific force along x, y, z \[m/s^2\], none where the unit does not measure it.
    pub linear_acceleration: Option<[f64; 3]>,
}

/// Positions and velocities of joints; wheels are joints too.
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// When it was measured \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The joints' names, (n,).
    pub names: Vec<String>,
    /// Positions \[rad or m\], (n,) or empty where unknown.
    pub positions: Vec<f64>,
    /// Velocities \[rad/s or m/s\], (n,) or empty where unknown.
    pub velocities: Vec<f64>,
}

/// A fix of a satellite navigation receiver (WGS 84).
#[derive(Debug, Clone, PartialEq)]
pub struct NavSatFix {
    /// When it was measured \[ns since the epoch\].
    pub stamp_ns: i64,
    /// -1 no fix, 0 fix, 1 with satellite-based and 2 with ground-based augmentation.
    pub status: i8,
    /// Latitude \[deg, north positive\].
    pub latitude_deg: f64,
    /// Longitude \[deg, east positive\].
    pub longitude_deg: f64,
    /// Height above the ellipsoid \[m\]; NaN where unknown.
    pub altitude_m: f64,
    /// Covariance of (east, north, up), (3, 3) row by row \[m^2\]; zeros where unknown.
    pub covariance: [f64; 9],
}

/// Where a frame is in another.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// When it held \[ns since the epoch\].
    pub stamp_ns: i64,
    /// The frame in which the child is placed.
    pub parent: String,
    /// The frame that is placed.
    pub child: String,
    /// The child's origin in the parent \[m\].
    pub translation: [f64; 3],
    /// The child's orientation in the parent, a quaternion (x, y, z, w).
    pub rotation: [f64; 4],
}
