use serde::{Deserialize, Serialize};

/// What is known of the robot and its sensors before the first sample.
///
/// A `density` is the root of a power spectral density: white noise of density n, sampled every
/// dt, has the deviation n / sqrt(dt), and its integral over a time T the deviation n sqrt(T)
/// (IEEE Std 952-1997, annex C; for a gyroscope, *angle random walk*). The deviation of a random
/// walk of density n after T is n sqrt(T). A `std` is the deviation of a constant's prior; 0
/// holds it at its nominal value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "FuseOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Distance between the contact points of the left and the right wheel \[m\]; there is no
    /// default.
    #[serde(skip)]
    pub track_m: f64,
    /// Deviation of the track, relative. The gyroscope tells the ratio of wheel scale to track
    /// and no more, so that this and `wheel_scale_std` decide which of the two an error of that
    /// ratio goes to. 0 trusts the track as given: then the gyroscope calibrates the distance
    /// too. Wide or soft tyres that scrub in turns need 0.05 and more.
    pub track_std: f64,
    /// True over measured wheel speed.
    pub wheel_scale: f64,
    /// Deviation of `wheel_scale`; 2 % is the rolling radius of a tyre by load and pressure.
    pub wheel_scale_std: f64,
    /// Deviation of half the difference between the right wheel's scale and the left one's,
    /// which bends straight lines: Borenstein and Feng 1996, "Measurement and correction of
    /// systematic odometry errors in mobile robots", their E_d. At constant speed it cannot be
    /// told from the gyroscope's bias; leave it at 0 unless the robot often stands still.
    pub wheel_difference_std: f64,
    /// White noise of a wheel's speed \[m/s/sqrt(Hz)\]: 0.02 m/s at 50 Hz.
    pub wheel_noise_density: f64,
    /// Slip of a wheel along its path: deviation after 1 m, growing with the root of the path
    /// \[m/sqrt(m)\] (Chong and Kleeman 1997, "Accurate odometry and error modelling for a mobile
    /// robot").
    pub wheel_slip: f64,
    /// The same sideways, of the whole robot \[m/sqrt(m)\].
    pub side_slip: f64,
    /// A wheel no faster than this stands still; where both do, so does the heading \[m/s\].
    pub still_m_per_s: f64,
    /// White noise of the yaw rate \[rad/s/sqrt(Hz)\]: 0.01 deg/s/sqrt(Hz), the data sheet of a
    /// common MEMS sensor (InvenSense MPU-9250, PS-MPU-9250A-01, table 1).
    pub gyro_noise_density: f64,
    /// Deviation of the gyroscope's bias at the start \[rad/s\]: 1 deg/s. The MPU-9250 promises
    /// 5 deg/s, most drivers take off a bias measured at rest.
    pub gyro_bias_std: f64,
    /// Random walk of the bias \[rad/s/sqrt(s)\]: 2 deg/min after an hour.
    pub gyro_bias_walk: f64,
    /// White noise of a heading measurement \[rad\].
    pub heading_noise_std: f64,
    /// Deviation of the error of the measured heading that comes and goes with the place, such as
    /// the magnetic field of a building \[rad\]; a first-order Gauss-Markov process. Data sheets
    /// promise 2 deg in motion (LORD MicroStrain 3DM-GX3-25); indoors it is more.
    pub heading_drift_std: f64,
    /// How long that error lasts: its correlation falls to 1/e after this \[s\]. An hour or more
    /// for a fibre-optic gyroscope, whose heading wanders on its own.
    pub heading_drift_secs: f64,
    /// Deviation of the error of the measured heading that repeats with the heading \[rad\]: iron
    /// carried along. 0 for a heading that does not come from a magnetometer.
    pub heading_deviation_std: f64,
    /// Of the headings at most one in this time is used \[s\]: the filter within a heading sensor
    /// makes neighbours err alike.
    pub heading_every_secs: f64,
    /// White forward acceleration \[m/s^2/sqrt(Hz)\]: the speed between two samples is unknown by
    /// as much.
    pub acceleration_density: f64,
    /// White yaw acceleration \[rad/s^2/sqrt(Hz)\].
    pub yaw_acceleration_density: f64,
    /// Accelerations are white no faster than this \[s\]: what a robot does within less is
    /// smooth, so that samples nearer than this in time miss next to nothing.
    pub response_secs: f64,
    /// Innovations are allowed this many deviations; one beyond has its noise raised until it
    /// fits (Chang 2014, "Robust Kalman filtering based on Mahalanobis distance as outlier
    /// judging criterion").
    pub gate: f64,
    /// Samples of a source farther apart than this are reported as a gap \[s\].
    pub max_gap_secs: f64,
    /// Let later samples correct earlier poses (Rauch-Tung-Striebel); else what a robot would
    /// have known at the time.
    pub smooth: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            track_m: 0.0,
            track_std: 0.05,
            wheel_scale: 1.0,
            wheel_scale_std: 0.0,
            wheel_difference_std: 0.0,
            wheel_noise_density: 0.003,
            wheel_slip: 0.005,
            side_slip: 0.005,
            still_m_per_s: 0.001,
            gyro_noise_density: 2e-4,
            gyro_bias_std: 0.02,
            gyro_bias_walk: 1e-5,
            heading_noise_std: 0.03,
            heading_drift_std: 0.05,
            heading_drift_secs: 60.0,
            heading_deviation_std: 0.05,
            heading_every_secs: 1.0,
            acceleration_density: 0.5,
            yaw_acceleration_density: 0.3,
            response_secs: 0.1,
            gate: 3.0,
            max_gap_secs: 1.5,
            smooth: true,
        }
    }
}

/// An option out of range.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("`{key}` is {found}, expected {expected}")]
pub struct OptionError {
    /// The option.
    pub key: &'static str,
    /// Its value.
    pub found: f64,
    /// What it must be.
    pub expected: &'static str,
}

impl Options {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), OptionError> {
        let refuse = |key, found: f64, good: bool, expected| match good && found.is_finite() {
            true => Ok(()),
            false => Err(OptionError { key, found, expected }),
        };
        for (key, found) in [
            ("track_m", self.track_m),
            ("wheel_scale", self.wheel_scale),
            ("wheel_noise_density", self.wheel_noise_density),
            ("gyro_noise_density", self.gyro_noise_density),
            ("heading_noise_std", self.heading_noise_std),
            ("heading_drift_secs", self.heading_drift_secs),
            ("response_secs", self.response_secs),
            ("gate", self.gate),
            ("max_gap_secs", self.max_gap_secs),
        ] {
            refuse(key, found, 0.0 < found, "more than 0")?;
        }
        for (key, found) in [
            ("track_std", self.track_std),
            ("wheel_scale_std", self.wheel_scale_std),
            ("wheel_difference_std", self.wheel_difference_std),
        ] {
            refuse(key, found, (0.0..0.5).contains(&found), "0 or more and less than 0.5")?;
        }
        for (key, found) in [
            ("wheel_slip", self.wheel_slip),
            ("side_slip", self.side_slip),
            ("still_m_per_s", self.still_m_per_s),
            ("gyro_bias_std", self.gyro_bias_std),
            ("gyro_bias_walk", self.gyro_bias_walk),
            ("heading_drift_std", self.heading_drift_std),
            ("heading_deviation_std", self.heading_deviation_std),
            ("heading_every_secs", self.heading_every_secs),
            ("acceleration_density", self.acceleration_density),
            ("yaw_acceleration_density", self.yaw_acceleration_density),
        ] {
            refuse(key, found, 0.0 <= found, "0 or more")?;
        }
        Ok(())
    }
}
