//! What the readers hand on: one message, not yet encoded.

use dataset::Dropped;
use messages::hdl32e::PACKET_BYTES;

use crate::ImportError;
use crate::options::Topic;

/// A message to be written.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Record {
    pub topic: Topic,
    /// Time in the header \[ns since the epoch\].
    pub stamp_ns: i64,
    pub body: Body,
}

/// Axes as REP 103 has them: x forward, y left, z up.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Body {
    /// Packets with their stamps \[ns since the epoch\].
    Packets(Vec<(i64, [u8; PACKET_BYTES])>),
    Cloud(Vec<Point>),
    Imu(Imu),
    Wheels {
        /// \[m/s\]
        left: f64,
        /// \[m/s\]
        right: f64,
    },
    Pose(Pose),
    Odometry(Pose, Twist),
    Fix(Fix),
    Scan(Scan),
}

/// One return.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// \[m\]
    pub position: [f32; 3],
    /// 0 to 255.
    pub intensity: f32,
    /// 0 is the lowest.
    pub ring: u16,
    /// Since the cloud's stamp \[s\].
    pub time: f32,
}

/// What an inertial sensor measured; none is unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Imu {
    /// Quaternion (x, y, z, w).
    pub orientation: Option<[f64; 4]>,
    /// \[rad/s\]
    pub angular_velocity: [f64; 3],
    /// \[m/s²\]
    pub linear_acceleration: Option<[f64; 3]>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pose {
    /// \[m\]
    pub position: [f64; 3],
    /// Quaternion (x, y, z, w).
    pub orientation: [f64; 4],
}

/// Speeds in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Twist {
    /// \[m/s\]
    pub forward: f64,
    /// \[rad/s\]
    pub turn: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fix {
    /// \[deg, north\]
    pub latitude: f64,
    /// \[deg, east\]
    pub longitude: f64,
    /// Above the ellipsoid \[m\]; NaN where it is not known.
    pub altitude: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scan {
    /// \[rad\]
    pub angle_min: f64,
    /// \[rad\]
    pub angle_increment: f64,
    /// \[m\]
    pub range_max: f32,
    /// \[m\]
    pub ranges: Vec<f32>,
}

/// What a reader counts beside its records.
#[derive(Debug, Default)]
pub(crate) struct Losses {
    /// What could not be used.
    pub dropped: Dropped,
    /// What is worth knowing and no loss.
    pub remarks: Dropped,
}

/// One file, read from top to bottom.
pub(crate) trait Source {
    /// The next record, none at the end.
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError>;
}

/// Whether a ROS message can hold the time: its seconds are a signed 32-bit number, of which the
/// negative ones mean nothing in ROS 1.
pub(crate) fn representable(stamp_ns: i64) -> bool {
    (0..i64::from(i32::MAX) * 1_000_000_000).contains(&stamp_ns)
}
