//! A campus, a robot and its sensors: MCAP logs of an HDL-32E drive with known truth.
//!
//! ```text
//!  seed ─► Site (buildings, outdoors) ─► Drive (a day's world, people, a path) ─┬─► Sensor (packets)      ─┬─► log.mcap
//!                                                                               └─► Wheels, ImuUnit, truth ┘
//! ```
//!
//! [`Campus::new`] builds a place and a [`Drive`] through it for each log ([`Campus::on_map`] takes
//! the place from a [`Map`]); [`write_drive`] writes a
//! drive's log; [`Drive::motion_at`] and [`Drive::surfaces`] tell the truth about it. The same
//! options and seed give the same bytes, on any number of threads.
//!
//! Frames (REP 103 and 105): `map` is the place's; `base_link` lies between the robot's wheels on
//! the floor, x forward and y left, and pitches as the base balances; `velodyne` is
//! [`SENSOR_HEIGHT_M`] above it.

mod beam;
mod campus;
mod day;
mod drive;
mod error;
mod log;
mod map;
mod map_day;
mod options;
mod path;
mod people;
mod plan;
mod plane;
mod profile;
mod random;
mod robot;
mod route;
mod sensor;
mod site;
mod world;

pub use campus::Campus;
pub use drive::{Drive, Motion, SENSOR_HEIGHT_M};
pub use error::SimulateError;
pub use log::{
    DriveSummary, IMU_TOPIC, PACKETS_TOPIC, POSE_PERIOD_NS, POSE_TOPIC, TF_STATIC_TOPIC, TF_TOPIC,
    WHEELS_TOPIC, write_drive,
};
pub use map::Map;
pub use options::{Compression, Encoding, ImuOptions, Lasers, Options, WheelOptions};
pub use plane::{Point, Segment};
pub use robot::{IMU_PERIOD_NS, WHEELS, WHEELS_PERIOD_NS, readings};
pub use world::{Material, Surface};
