//! The output of the readers: messages that are not encoded yet.

use dataset::Losses;
use messages::hdl32e::PACKET_BYTES;
use nalgebra::{Isometry3, UnitQuaternion};

use crate::error::ImportError;
use crate::options::Topic;

/// A message to write.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Record {
    pub topic: Topic,
    /// The time in the header \[ns since the epoch\].
    pub stamp_ns: i64,
    pub body: Body,
}

/// The content of a message. The axes follow REP 103: x forward, y left, z up.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Body {
    /// Packets and their stamps \[ns since the epoch\].
    Packets(Vec<(i64, [u8; PACKET_BYTES])>),
    Cloud(Vec<Point>),
    Imu(Imu),
    Wheels {
        /// \[m/s\]
        left: f64,
        /// \[m/s\]
        right: f64,
    },
    /// `map_from_base` \[m\].
    Pose(Isometry3<f64>),
    /// `odom_from_base` \[m\].
    Odometry(Isometry3<f64>, Twist),
    Fix(Fix),
    Scan(Scan),
}

/// One return of a cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Point {
    /// \[m\]
    pub position: [f32; 3],
    /// 0 to 255.
    pub intensity: f32,
    /// 0 is the lowest ring.
    pub ring: u16,
    /// The time since the stamp of the cloud \[s\].
    pub time: f32,
}

/// A measurement of an inertial sensor. `None` means unknown.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Imu {
    /// Rotation from the sensor to fixed axes.
    pub orientation: Option<UnitQuaternion<f64>>,
    /// \[rad/s\]
    pub angular_velocity: [f64; 3],
    /// \[m/s²\]
    pub linear_acceleration: Option<[f64; 3]>,
}

/// The velocity of the robot in its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Twist {
    /// \[m/s\]
    pub forward: f64,
    /// Counter-clockwise seen from above \[rad/s\].
    pub yaw_rate: f64,
}

/// A satellite fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fix {
    /// \[deg, north\]
    pub latitude: f64,
    /// \[deg, east\]
    pub longitude: f64,
    /// Height above the ellipsoid \[m\]. NaN means unknown.
    pub altitude: f64,
}

/// A planar scan.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scan {
    /// Angle of the first reading \[rad\].
    pub angle_min: f64,
    /// Angle from one reading to the next \[rad\].
    pub angle_increment: f64,
    /// A reading of this range or more is not a return \[m\].
    pub range_max: f32,
    /// \[m\]
    pub ranges: Vec<f32>,
}

/// A reader of one file, from start to end.
pub(crate) trait Source {
    /// The next record, or `None` at the end of the file.
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError>;
}

/// Whether a ROS message can contain the time. Its seconds are a signed 32-bit number, and ROS 1 does
/// not define negative seconds.
pub(crate) fn is_representable(stamp_ns: i64) -> bool {
    (0..i64::from(i32::MAX) * 1_000_000_000).contains(&stamp_ns)
}
