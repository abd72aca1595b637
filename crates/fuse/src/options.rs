use dataset::OutOfRange;
use serde::{Deserialize, Serialize};

/// Properties of the robot and its sensors that are known before the first sample.
///
/// A `density` is the square root of a power spectral density. White noise of density n, sampled
/// every dt, has the standard deviation n / sqrt(dt); its integral over a time T has the standard
/// deviation n sqrt(T) (IEEE Std 952-1997, annex C; for a gyroscope, *angle random walk*). A random
/// walk of density n has the standard deviation n sqrt(T) after the time T. A `std` is the prior
/// standard deviation of a constant; 0 fixes the constant at its nominal value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "FuseOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// Track width: distance between the contact points of the left and the right wheel \[m\].
    /// There is no default.
    #[serde(skip)]
    pub track_m: f64,
    /// Standard deviation of the track width, relative. The gyroscope observes only the ratio of
    /// wheel scale to track width; `track_std` and `wheel_scale_std` decide which of the two is
    /// corrected. With 0 the track width is exact, and the gyroscope calibrates the distance too.
    /// Wide or soft tires that scrub in turns need 0.05 or more.
    pub track_std: f64,
    /// True wheel speed over measured wheel speed.
    pub wheel_scale: f64,
    /// Standard deviation of `wheel_scale`. The rolling radius of a tire changes by about 2 % with
    /// load and pressure.
    pub wheel_scale_std: f64,
    /// Standard deviation of half the difference between the scales of the right and the left
    /// wheel. The difference bends straight paths (Borenstein and Feng 1996, "Measurement and
    /// correction of systematic odometry errors in mobile robots", their E_d). At constant speed it
    /// cannot be distinguished from the gyroscope bias; keep it at 0 unless the robot often stands
    /// still.
    pub wheel_difference_std: f64,
    /// White noise of a wheel speed \[m/s/sqrt(Hz)\]: 0.02 m/s at 50 Hz.
    pub wheel_noise_density: f64,
    /// Slip of a wheel along its path: standard deviation after 1 m, proportional to the square
    /// root of the path \[m/sqrt(m)\] (Chong and Kleeman 1997, "Accurate odometry and error
    /// modelling for a mobile robot").
    pub wheel_slip: f64,
    /// Sideways slip of the whole robot, as `wheel_slip` \[m/sqrt(m)\].
    pub side_slip: f64,
    /// A wheel at this speed or slower is at standstill \[m/s\]. If both wheels are at standstill,
    /// the heading does not change.
    pub still_m_per_s: f64,
    /// White noise of the yaw rate \[rad/s/sqrt(Hz)\]: 0.01 deg/s/sqrt(Hz), the data sheet value of
    /// a common MEMS sensor (InvenSense MPU-9250, PS-MPU-9250A-01, table 1).
    pub gyro_noise_density: f64,
    /// Standard deviation of the gyroscope bias at the start \[rad/s\]: 1 deg/s. The data sheet of
    /// the MPU-9250 specifies 5 deg/s, but most drivers subtract a bias measured at rest.
    pub gyro_bias_std: f64,
    /// Random walk of the gyroscope bias \[rad/s/sqrt(s)\]: 2 deg/min after one hour.
    pub gyro_bias_walk: f64,
    /// White noise of a measured heading \[rad\].
    pub heading_noise_std: f64,
    /// Standard deviation of the slowly varying error of the measured heading, for example from the
    /// magnetic field of a building \[rad\]. It is modeled as a first-order Gauss-Markov process.
    /// Data sheets specify 2 deg in motion (LORD MicroStrain 3DM-GX3-25); indoors it is larger.
    pub heading_drift_std: f64,
    /// Correlation time of this error: after this time its correlation is 1/e \[s\]. Use one hour
    /// or more for a fibre-optic gyroscope, whose heading drifts slowly.
    pub heading_drift_secs: f64,
    /// Standard deviation of the error of the measured heading that depends on the heading itself
    /// \[rad\], caused by iron on the robot. Set it to 0 if the heading does not come from a
    /// magnetometer.
    pub heading_deviation_std: f64,
    /// Minimum time between two headings that are used \[s\]. The filter inside a heading sensor
    /// correlates the errors of neighboring headings.
    pub heading_every_secs: f64,
    /// White forward acceleration \[m/s^2/sqrt(Hz)\]. It models the unknown speed between two
    /// samples.
    pub acceleration_density: f64,
    /// White yaw acceleration \[rad/s^2/sqrt(Hz)\].
    pub yaw_acceleration_density: f64,
    /// Response time of the robot \[s\]: within less time its motion is smooth. Samples closer
    /// together than this miss almost nothing of the motion.
    pub response_secs: f64,
    /// Largest innovation in standard deviations. For a larger innovation the measurement noise is
    /// raised until the innovation is at the limit (Chang 2014, "Robust Kalman filtering based on
    /// Mahalanobis distance as outlier judging criterion").
    pub gate: f64,
    /// A longer time without samples of a source is reported as a gap \[s\].
    pub max_gap_secs: f64,
    /// Whether later samples correct earlier poses (Rauch-Tung-Striebel smoother). If false, each
    /// pose depends only on earlier samples, as on the robot during the drive.
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

impl Options {
    /// Checks that every option is in its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let check =
            |key, found: f64, is_in_range: bool, expected| match is_in_range && found.is_finite() {
                true => Ok(()),
                false => Err(OutOfRange::new(key, found, expected)),
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
            check(key, found, 0.0 < found, "more than 0")?;
        }
        for (key, found) in [
            ("track_std", self.track_std),
            ("wheel_scale_std", self.wheel_scale_std),
            ("wheel_difference_std", self.wheel_difference_std),
        ] {
            check(key, found, (0.0..0.5).contains(&found), "0 or more and less than 0.5")?;
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
            check(key, found, 0.0 <= found, "0 or more")?;
        }
        Ok(())
    }
}
