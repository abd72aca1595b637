//! The options of a simulation.

use serde::{Deserialize, Serialize};

/// Options of the simulation: the `[simulate]` section of a pipeline file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "SimulateOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Names of the logs, used as file stems. Each log is one drive through the same site on a
    /// different day: doors, furniture, parked cars and people change. Every second drive goes in
    /// the opposite direction. Default: `["lap-1", "lap-2"]`.
    pub logs: Vec<String>,
    /// Number of buildings. With 1, the site is a single building of 120 m x 80 m without
    /// surroundings. With more, the site is a campus, and the drive enters and leaves each
    /// building; a lap is about 230 m per building. All drives on a campus start at its dock, the
    /// origin of the map frame. Default: 1.
    pub buildings: u32,
    /// Occupancy grid map to use as the site instead of generated buildings: the path of a ROS
    /// `map_server` YAML file, relative to the pipeline file. Its image must be a PGM. Occupied
    /// pixels are walls, and the robot drives through the free space. From day to day furniture
    /// moves, and doors in detected doorways open and close.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map: Option<String>,
    /// Distance driven in each log \[m\]. In a single building, revisits start after one block (at
    /// most 180 m), and a lap through all corridors is about 980 m. Default: 400.
    pub length_m: f64,
    /// Mean speed of the robot, including stops \[m/s\]. The robot slows down in turns. Default: 2.
    pub speed_m_s: f64,
    /// Amplitude of the pitch oscillation of the self-balancing base \[deg\]. The base also pitches
    /// when it accelerates. 0 keeps it level at all times. Default: 0.4.
    pub rocking_deg: f64,
    /// Number of people walking around. Default: 12.
    pub people: u32,

    /// Revolutions of the lidar per second, 5 to 20 \[Hz\]. Default: 10.
    pub spin_hz: f64,
    /// Standard deviation of the range noise \[m\]. Default: 0.004, as measured on a real sensor.
    pub range_noise_m: f64,
    /// Fraction of returns lost at random, in addition to returns lost on dark surfaces or at
    /// grazing angles. Default: 0.005.
    pub dropout: f64,
    /// Fraction of the beams split by an edge that measure a range between the two surfaces.
    /// Default: 0.5.
    pub mixed_pixels: f64,
    /// Fraction of packets lost at random. Default: 0.
    pub packet_loss: f64,
    /// Whether the lidar is mounted upside down (rolled by 180 deg about its x axis). Its azimuth
    /// then increases counter-clockwise, seen from above. Default: false.
    pub upside_down: bool,
    /// Whether the lidar sends two returns per firing, the last and the strongest, in twice as many
    /// packets. Default: false.
    pub dual_return: bool,
    /// Which lasers are simulated. Default: `"three"`.
    pub lasers: Lasers,

    /// Message encoding. Default: `"ros2"`.
    pub encoding: Encoding,
    /// Chunk compression. Default: `"zstd"`.
    pub compression: Compression,
    /// Number of files that each log is split into, in order of time: `NAME/NAME_0.mcap`,
    /// `NAME/NAME_1.mcap`, ... With 1, the log is `NAME.mcap`. Default: 1.
    pub files: u32,

    /// Wheel encoders.
    pub wheels: WheelOptions,
    /// Inertial measurement unit (IMU).
    pub imu: ImuOptions,
}

/// Wheel encoders: the `[simulate.wheels]` section.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct WheelOptions {
    /// Distance between the wheels \[m\]. Default: 0.5.
    pub track_m: f64,
    /// Standard deviation of the scale error common to both wheels, drawn once per log.
    /// Default: 0.001.
    pub scale_error: f64,
    /// Standard deviation of half the difference between the scales of the two wheels, drawn once
    /// per log. Default: 0.0002.
    pub scale_difference: f64,
    /// Slip of each wheel: standard deviation after 1 m, growing with the square root of the
    /// distance \[m/sqrt(m)\]. Default: 0.003.
    pub slip: f64,
    /// Distance per encoder count \[m\]. Default: 0.0005.
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

/// Inertial measurement unit (IMU): the `[simulate.imu]` section.
///
/// The gyroscope defaults are those of a fibre-optic gyroscope, as on the North Campus robot (KVH
/// DSP-3000 data sheet: angle random walk 0.067 deg/sqrt(h), bias 20 deg/h).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ImuOptions {
    /// White noise of the angular velocity \[rad/s/sqrt(Hz)\]. Default: 2e-5.
    pub gyro_noise: f64,
    /// Standard deviation of the initial gyroscope bias \[rad/s\]. Default: 1e-4.
    pub gyro_bias: f64,
    /// Random walk of the gyroscope bias \[rad/s/sqrt(s)\]. Default: 1e-7.
    pub gyro_bias_walk: f64,
    /// White noise of the specific force \[m/s^2/sqrt(Hz)\]. Default: 2e-3.
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

/// Which lasers of the HDL-32E are simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Lasers {
    /// Lasers 14, 15 and 16 (firing order). Laser 15 is horizontal; the other two look down. This
    /// is enough for planar scans, in a sixth of the bytes.
    #[default]
    Three,
    /// All 32 lasers.
    All,
}

/// How messages are encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// ROS 2: CDR messages with `ros2msg` schemas.
    #[default]
    Ros2,
    /// ROS 1: ROS 1 messages with `ros1msg` schemas.
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
    /// LZ4.
    Lz4,
    /// No compression.
    None,
}

impl Options {
    /// Duration of each drive \[s\].
    pub(crate) fn duration_s(&self) -> f64 {
        self.length_m / self.speed_m_s
    }
}
