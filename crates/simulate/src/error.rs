//! Why there is nothing to simulate.

use std::path::PathBuf;

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
    /// A file that is no map, or a map that cannot be driven on.
    #[error("{path}: {reason}", path = path.display())]
    Map {
        /// The map's YAML file, or its image.
        path: PathBuf,
        /// What was expected, and what was found.
        reason: String,
    },
    /// The pipeline names a map that was not handed over, or the other way around.
    #[error("simulate.map is set, load it with Map::load and build the campus with Campus::on_map")]
    MapNotLoaded,
    /// The campus has no drive of that number, or its log no such file.
    #[error(
        "log number {log}, file number {file} does not exist: simulate.logs names {n_logs}, simulate.files is {n_files}"
    )]
    NoSuchLog {
        /// Number asked for, from 0.
        log: usize,
        /// How many there are.
        n_logs: usize,
        /// File asked for, from 0.
        file: u32,
        /// How many each log is split into.
        n_files: u32,
    },
    /// The log could not be written.
    #[error("the log could not be written")]
    Write(#[from] mcap::McapError),
}
