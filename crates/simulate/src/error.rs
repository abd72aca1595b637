//! Errors of the simulation.

use std::path::PathBuf;

use dataset::OutOfRange;

/// Why a drive could not be simulated or written.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// The list of logs is empty.
    #[error("`simulate.logs` is empty, expected at least one log name")]
    NoLogs,
    /// A log name is not a valid file stem.
    #[error(
        "`simulate.logs` contains {name:?}, which is not a valid file stem: use 1 to 100 letters, digits, '-', '_' and '.', starting with a letter or digit"
    )]
    LogName {
        /// The name found.
        name: String,
    },
    /// Two logs have the same name, ignoring case as some file systems do.
    #[error("`simulate.logs` contains {name:?} twice, expected a different name for each log")]
    RepeatedLog {
        /// The repeated name.
        name: String,
    },
    /// An option is outside its limits, or not a number.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// The drive is too short for one message of packets.
    #[error(
        "`simulate.length_m` is {length_m}, expected {needed_m:.3} or more: at `simulate.speed_m_s` = {speed_m_s} the drive ends before the lidar completes a revolution"
    )]
    TooShort {
        /// Length of the drive \[m\].
        length_m: f64,
        /// Mean speed \[m/s\].
        speed_m_s: f64,
        /// Length of the shortest possible drive at that speed \[m\].
        needed_m: f64,
    },
    /// A file of a map cannot be read.
    #[error("cannot read {path}", path = path.display())]
    ReadMap {
        /// The YAML file of the map, or its image.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// A file is not a valid map, or the map has no room for a robot.
    #[error("{path}: {reason}", path = path.display())]
    Map {
        /// The YAML file of the map, or its image.
        path: PathBuf,
        /// What was found, and what was expected.
        reason: String,
    },
    /// [`Campus::new`](crate::Campus::new) was called with options that name a map.
    #[error(
        "`simulate.map` is set: load the map with `Map::load` and call `Campus::on_map` instead of `Campus::new`"
    )]
    MapNotLoaded,
    /// The log number or the file number is out of range.
    #[error(
        "file {file} of log {log} does not exist: there are {n_logs} logs (`simulate.logs`) of {n_files} files each (`simulate.files`), numbered from 0"
    )]
    NoSuchLog {
        /// Requested log, from 0.
        log: usize,
        /// Number of logs.
        n_logs: usize,
        /// Requested file, from 0.
        file: u32,
        /// Number of files per log.
        n_files: u32,
    },
    /// The log could not be written.
    #[error("cannot write the log")]
    Write(#[from] mcap::McapError),
}
