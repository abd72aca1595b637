//! A campus, a robot and its sensor: MCAP logs of an HDL-32E drive with known truth.
//!
//! ```text
//!  seed ──► Plan (rooms, corridors) ──► Drive (a day's doors and clutter, people, a path) ──► Sensor ──► log.mcap
//! ```
//!
//! [`Campus::new`] builds one building and a [`Drive`] through it for each log; [`write_drive`]
//! writes a drive's log; [`Drive::pose_at`] and [`Drive::range_m`] tell the truth about it. The
//! same options and seed give the same bytes, on any number of threads.
//!
//! Frames: `map` is the building's, x and y along its walls; the robot's has x forward and y left,
//! and the sensor sits at its origin.

mod campus;
mod clutter;
mod drive;
mod log;
mod plan;
mod random;
mod sensor;
mod walls;

use serde::{Deserialize, Serialize};

pub use campus::Campus;
pub use drive::Drive;
pub use log::{PACKETS_TOPIC, POSE_PERIOD_NS, POSE_TOPIC, write_drive};
pub use walls::{Point, Segment};

/// What to simulate; the `[simulate]` section of a pipeline file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "SimulateOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Names of the logs, the stems of their files. Each is a drive on a day of its own through
    /// the same building: other doors open, other clutter, other people, another start; every
    /// other drive goes the other way around. Default: `["lap-1", "lap-2"]`.
    pub logs: Vec<String>,
    /// Way driven in each log \[m\]. Revisits begin after one block, at most 180 m; a lap through
    /// all corridors is about 980 m. Default: 400.
    pub length_m: f64,
    /// Speed of the robot, constant \[m/s\]. Default: 2.
    pub speed_m_s: f64,
    /// Turns of the sensor per second, 5 to 20 \[Hz\]. Default: 10.
    pub spin_hz: f64,
    /// Standard deviation of a range, normal \[m\]. Default: 0.015.
    pub range_noise_m: f64,
    /// Share of returns that are lost at random. Default: 0.005.
    pub dropout: f64,
    /// People that walk in the corridors. Default: 12.
    pub people: u32,
    /// Whether the sensor hangs upside down, rolled by 180 deg about its x axis: its azimuth then
    /// runs counter-clockwise seen from above. Default: false.
    pub upside_down: bool,
    /// Which lasers return anything. Default: `"three"`.
    pub lasers: Lasers,
    /// Encoding of the messages. Default: `"ros2"`.
    pub encoding: Encoding,
    /// Compression of the chunks. Default: `"zstd"`.
    pub compression: Compression,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            logs: vec!["lap-1".to_owned(), "lap-2".to_owned()],
            length_m: 400.0,
            speed_m_s: 2.0,
            spin_hz: 10.0,
            range_noise_m: 0.015,
            dropout: 0.005,
            people: 12,
            upside_down: false,
            lasers: Lasers::default(),
            encoding: Encoding::default(),
            compression: Compression::default(),
        }
    }
}

/// Which lasers of the HDL-32E return anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Lasers {
    /// The horizontal one, 15, and its neighbours in firing order, 14 and 16, which look down:
    /// what planar scans need, in a tenth of the bytes.
    #[default]
    Three,
    /// All 32.
    All,
}

/// How messages are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// ROS 2: CDR, schemas as `ros2msg`.
    #[default]
    Ros2,
    /// ROS 1, schemas as `ros1msg`.
    Ros1,
}

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Compression {
    /// Zstandard.
    #[default]
    Zstd,
    /// LZ4 frames.
    Lz4,
    /// Not at all.
    None,
}

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveSummary {
    /// Whole turns of the sensor.
    pub turns: u64,
    /// Data packets.
    pub packets: u64,
    /// Way driven \[m\].
    pub length_m: f64,
    /// Time driven \[s\].
    pub duration_s: f64,
}

/// Why there is nothing to simulate, or why it could not be written.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// The list of logs is empty.
    #[error("simulate.logs is empty, name at least one log")]
    NoLogs,
    /// A log's name does not do as the stem of a file.
    #[error(
        "simulate.logs has {name:?}, which is no file stem: use 1 to 100 letters, digits, '-', '_' and '.', beginning with a letter or digit"
    )]
    LogName {
        /// The name found.
        name: String,
    },
    /// Two logs would be one file, at least where file names ignore case.
    #[error("simulate.logs has {name:?} twice, give every log a name of its own")]
    RepeatedLog {
        /// The second of the two.
        name: String,
    },
    /// A number outside its limits, or not a number.
    #[error("simulate.{option} is {found}, expected {min} to {max}")]
    OutOfRange {
        /// The option's key.
        option: &'static str,
        /// Its value.
        found: f64,
        /// Smallest value allowed.
        min: f64,
        /// Largest value allowed.
        max: f64,
    },
    /// Not even one message of packets fits into the drive.
    #[error(
        "a drive of simulate.length_m = {length_m} at simulate.speed_m_s = {speed_m_s} is over before the sensor completes a turn, drive at least {needed_m:.3} m"
    )]
    TooShort {
        /// \[m\]
        length_m: f64,
        /// \[m/s\]
        speed_m_s: f64,
        /// Shortest drive at that speed \[m\].
        needed_m: f64,
    },
    /// The campus has no drive of that number.
    #[error("log number {log} does not exist, simulate.logs names {n_logs}")]
    NoSuchLog {
        /// Number asked for, from 0.
        log: usize,
        /// How many there are.
        n_logs: usize,
    },
    /// The log could not be written.
    #[error("the log could not be written")]
    Write(#[from] mcap::McapError),
}

impl Options {
    /// How long each drive takes \[s\].
    fn duration_s(&self) -> f64 {
        self.length_m / self.speed_m_s
    }

    /// Refuses values out of range and names that are no file stems.
    pub fn check(&self) -> Result<(), SimulateError> {
        if self.logs.is_empty() {
            return Err(SimulateError::NoLogs);
        }
        for (k, name) in self.logs.iter().enumerate() {
            if !is_file_stem(name) {
                return Err(SimulateError::LogName { name: name.clone() });
            }
            if self.logs[..k].iter().any(|other| other.eq_ignore_ascii_case(name)) {
                return Err(SimulateError::RepeatedLog { name: name.clone() });
            }
        }
        for (option, found, min, max) in [
            ("length_m", self.length_m, 0.1, 1e6),
            ("speed_m_s", self.speed_m_s, 0.01, 10.0),
            ("spin_hz", self.spin_hz, 5.0, 20.0),
            ("range_noise_m", self.range_noise_m, 0.0, 1.0),
            ("dropout", self.dropout, 0.0, 1.0),
            ("people", f64::from(self.people), 0.0, 1000.0),
        ] {
            if !(min <= found && found <= max) {
                return Err(SimulateError::OutOfRange { option, found, min, max });
            }
        }
        if log::n_messages(self) < 1 {
            let &Self { length_m, speed_m_s, .. } = self;
            let needed_m = log::shortest_s(self) * speed_m_s;
            return Err(SimulateError::TooShort { length_m, speed_m_s, needed_m });
        }
        Ok(())
    }
}

/// Whether every common file system takes the name, and no shell or glob reads it otherwise.
fn is_file_stem(name: &str) -> bool {
    name.len() <= 100
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
}
