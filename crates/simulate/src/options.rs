//! What to simulate, and what makes no sense to ask for.

use serde::{Deserialize, Serialize};

use crate::SimulateError;
use crate::log::{message_s, shortest_s};

/// What to simulate; the `[simulate]` section of a pipeline file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "SimulateOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Names of the logs, the stems of their files. Each is a drive on a day of its own through
    /// the same place: other doors open, furniture moved, other cars, other people; every other
    /// drive goes the other way around. Default: `["lap-1", "lap-2"]`.
    pub logs: Vec<String>,
    /// Buildings. One is a building of 120 m x 80 m without a world around it; with more, these
    /// stand on a campus, and the drive goes in and out of each: a lap is about 230 m a building.
    /// All drives on a campus begin at its dock, the origin of the map frame. Default: 1.
    pub buildings: u32,
    /// A map instead: the YAML file of ROS `map_server`, relative to the pipeline file; its image
    /// must be a PGM. Walls stand where it is occupied, and the drive goes wherever there is room;
    /// from day to day furniture moves and doors are shut in what looks like a doorway.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Way driven in each log \[m\]. In one building revisits begin after one block, at most
    /// 180 m; a lap through all its corridors is about 980 m. Default: 400.
    pub length_m: f64,
    /// Mean speed of the robot, stops included \[m/s\]; it slows down in turns. Default: 2.
    pub speed_m_s: f64,
    /// Rocking of the balancing base, amplitude \[deg\]. It also leans into every acceleration; 0
    /// holds it level throughout. Default: 0.4.
    pub rocking_deg: f64,
    /// People that walk about. Default: 12.
    pub people: u32,

    /// Turns of the sensor per second, 5 to 20 \[Hz\]. Default: 10.
    pub spin_hz: f64,
    /// Standard deviation of a range, normal \[m\]. Default: 0.004, as measured on a real sensor.
    pub range_noise_m: f64,
    /// Share of returns that are lost at random, besides those that are lost on dark or slanted
    /// surfaces. Default: 0.005.
    pub dropout: f64,
    /// Share of the beams split by an edge that give a range between the two surfaces.
    /// Default: 0.5.
    pub mixed_pixels: f64,
    /// Share of packets that are lost at random. Default: 0.
    pub packet_loss: f64,
    /// Whether the sensor hangs upside down, rolled by 180 deg about its x axis: its azimuth then
    /// runs counter-clockwise seen from above. Default: false.
    pub upside_down: bool,
    /// Whether the sensor sends two returns of each firing, the last and the strongest, in twice
    /// as many packets. Default: false.
    pub dual_return: bool,
    /// Which lasers return anything. Default: `"three"`.
    pub lasers: Lasers,

    /// Encoding of the messages. Default: `"ros2"`.
    pub encoding: Encoding,
    /// Compression of the chunks. Default: `"zstd"`.
    pub compression: Compression,
    /// Files that each log is split into, one after the other in time: `NAME/NAME_0.mcap` and so
    /// on. Default: 1, `NAME.mcap`.
    pub files: u32,

    /// The wheels' encoders.
    pub wheels: WheelOptions,
    /// The inertial measurement unit.
    pub imu: ImuOptions,
}

/// The encoders of the two wheels; `[simulate.wheels]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct WheelOptions {
    /// Distance between the wheels \[m\]. Default: 0.5.
    pub track_m: f64,
    /// Standard deviation of the scale that both wheels share, drawn once a log. Default: 0.001.
    pub scale_error: f64,
    /// The same of half the difference between the two wheels' scales. Default: 0.0002.
    pub scale_difference: f64,
    /// Slip of each wheel: standard deviation after 1 m, growing with the root of the path
    /// \[m/sqrt(m)\]. Default: 0.003.
    pub slip: f64,
    /// Path of one count of an encoder \[m\]. Default: 0.0005.
    pub count_m: f64,
}

impl Default for WheelOptions {
    fn default() -> Self {
        Self {
            track_m: 0.5,
            scale_error: 0.001,
            scale_difference: 0.0002,
            slip: 0.003,
            count_m: 0.0005,
        }
    }
}

/// The inertial measurement unit; `[simulate.imu]`.
///
/// The defaults of the gyroscope are those of a fibre-optic one such as the North Campus robot
/// carried (KVH DSP-3000 data sheet: angle random walk 0.067 deg/sqrt(h), bias 20 deg/h).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ImuOptions {
    /// White noise of an angular velocity \[rad/s/sqrt(Hz)\]. Default: 2e-5.
    pub gyro_noise: f64,
    /// Standard deviation of the bias at the start \[rad/s\]. Default: 1e-4.
    pub gyro_bias: f64,
    /// Random walk of the bias \[rad/s/sqrt(s)\]. Default: 1e-7.
    pub gyro_bias_walk: f64,
    /// White noise of a specific force \[m/s^2/sqrt(Hz)\]. Default: 2e-3.
    pub acceleration_noise: f64,
}

impl Default for ImuOptions {
    fn default() -> Self {
        Self { gyro_noise: 2e-5, gyro_bias: 1e-4, gyro_bias_walk: 1e-7, acceleration_noise: 2e-3 }
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            logs: vec!["lap-1".to_owned(), "lap-2".to_owned()],
            buildings: 1,
            map: None,
            length_m: 400.0,
            speed_m_s: 2.0,
            rocking_deg: 0.4,
            people: 12,
            spin_hz: 10.0,
            range_noise_m: 0.004,
            dropout: 0.005,
            mixed_pixels: 0.5,
            packet_loss: 0.0,
            upside_down: false,
            dual_return: false,
            lasers: Lasers::default(),
            encoding: Encoding::default(),
            compression: Compression::default(),
            files: 1,
            wheels: WheelOptions::default(),
            imu: ImuOptions::default(),
        }
    }
}

/// Which lasers of the HDL-32E return anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Lasers {
    /// The horizontal one, 15, and its neighbours in firing order, 14 and 16, which look down:
    /// what planar scans need, in a sixth of the bytes.
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

impl Options {
    /// How long each drive takes \[s\].
    pub(crate) fn duration_s(&self) -> f64 {
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
        let Self { wheels, imu, .. } = self;
        for (option, found, min, max) in [
            ("buildings", f64::from(self.buildings), 1.0, 40.0),
            ("length_m", self.length_m, 0.1, 1e6),
            ("speed_m_s", self.speed_m_s, 0.01, 10.0),
            ("rocking_deg", self.rocking_deg, 0.0, 5.0),
            ("people", f64::from(self.people), 0.0, 1000.0),
            ("spin_hz", self.spin_hz, 5.0, 20.0),
            ("range_noise_m", self.range_noise_m, 0.0, 1.0),
            ("dropout", self.dropout, 0.0, 1.0),
            ("mixed_pixels", self.mixed_pixels, 0.0, 1.0),
            ("packet_loss", self.packet_loss, 0.0, 0.9),
            ("files", f64::from(self.files), 1.0, 1000.0),
            ("wheels.track_m", wheels.track_m, 0.05, 5.0),
            ("wheels.scale_error", wheels.scale_error, 0.0, 0.2),
            ("wheels.scale_difference", wheels.scale_difference, 0.0, 0.2),
            ("wheels.slip", wheels.slip, 0.0, 1.0),
            ("wheels.count_m", wheels.count_m, 1e-9, 0.1),
            ("imu.gyro_noise", imu.gyro_noise, 0.0, 1.0),
            ("imu.gyro_bias", imu.gyro_bias, 0.0, 1.0),
            ("imu.gyro_bias_walk", imu.gyro_bias_walk, 0.0, 1.0),
            ("imu.acceleration_noise", imu.acceleration_noise, 0.0, 1.0),
        ] {
            if !(min <= found && found <= max) {
                return Err(SimulateError::OutOfRange { option, found, min, max });
            }
        }
        if self.duration_s() < shortest_s(self) {
            let &Self { length_m, speed_m_s, .. } = self;
            let needed_m = shortest_s(self) * speed_m_s;
            return Err(SimulateError::TooShort { length_m, speed_m_s, needed_m });
        }
        // A file without a turn of the sensor would be no part of a drive.
        let most = (self.duration_s() / message_s(self) / 2.0).floor().max(1.0);
        if most < f64::from(self.files) {
            let (option, found) = ("files", f64::from(self.files));
            return Err(SimulateError::OutOfRange { option, found, min: 1.0, max: most });
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
