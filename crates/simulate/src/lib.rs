//! Simulates drives of a robot with an HDL-32E lidar through a campus, and writes them as MCAP logs
//! with ground truth.
//!
//! ```text
//!  seed ─► Site (buildings, outdoors) ─► Drive (world of the day, people, path) ─┬─► Sensor (packets)              ─┬─► log.mcap
//!                                                                                └─► Wheels, ImuSensor, ground truth ┘
//! ```
//!
//! [`Campus::new`] builds a site and one [`Drive`] per log. [`Campus::on_map`] uses an occupancy
//! grid [`Map`] as the site instead. [`write_drive`] writes the log of a drive. [`Drive::motion_at`]
//! and [`Drive::surfaces`] return its ground truth. The same options and seed give the same bytes,
//! on any number of threads.
//!
//! ```
//! use std::io::Cursor;
//!
//! use simulate::{Campus, Options, write_drive};
//!
//! let options = Options { length_m: 4.0, ..Options::default() };
//! let campus = Campus::new(&options, 2436)?;
//! let mut log = Cursor::new(Vec::new());
//! let summary = write_drive(&campus, 0, 0, &mut log)?;
//! assert_eq!(summary.duration_s, 2.0); // 4 m at 2 m/s
//! assert!(log.into_inner().starts_with(b"\x89MCAP"));
//!
//! let drive = campus.drive(0);
//! let start = drive.pose_at(drive.start_ns());
//! let end = drive.pose_at(drive.end_ns());
//! assert!(3.0 < start.distance_m(&end)); // the path sways a little
//! # Ok::<(), simulate::SimulateError>(())
//! ```
//!
//! Frames follow REP 103 and REP 105. `map` is fixed to the site. `base_link` lies on the floor,
//! midway between the wheels, with x forward and y left; it pitches as the base balances.
//! `velodyne` is [`SENSOR_HEIGHT_M`] above `base_link`.

mod beam;
mod campus;
mod day;
mod drive;
mod error;
mod limits;
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
