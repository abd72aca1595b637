//! The limits of the options of a simulation.

use std::fmt::Display;

use dataset::OutOfRange;

use crate::log::{message_s, shortest_s};
use crate::{Options, SimulateError};

impl Options {
    /// Returns an error for values out of range and for names that are not file stems.
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
                return Err(out_of_range(option, found, min, max));
            }
        }
        if self.duration_s() < shortest_s(self) {
            let &Self { length_m, speed_m_s, .. } = self;
            let needed_m = shortest_s(self) * speed_m_s;
            return Err(SimulateError::TooShort { length_m, speed_m_s, needed_m });
        }
        // Every file must contain at least two revolutions of the lidar.
        let most = (self.duration_s() / message_s(self) / 2.0).floor().max(1.0);
        if most < f64::from(self.files) {
            return Err(out_of_range("files", self.files, 1, most));
        }
        Ok(())
    }
}

/// The error for an option of `[simulate]` outside its limits.
fn out_of_range(
    option: &str,
    found: impl Display,
    min: impl Display,
    max: impl Display,
) -> SimulateError {
    OutOfRange::new(format!("simulate.{option}"), found, format!("{min} to {max}")).into()
}

/// Whether a name is valid on every common file system and has no special meaning in shells or
/// globs.
fn is_file_stem(name: &str) -> bool {
    name.len() <= 100
        && name.starts_with(|c: char| c.is_ascii_alphanumeric())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
}
