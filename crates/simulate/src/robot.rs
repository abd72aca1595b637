//! Simulated wheel encoders and inertial measurement unit (IMU).

use dataset::{Pose2, wrap_angle};
use messages::{Imu, JointState};

use crate::campus::Campus;
use crate::drive::{Drive, GRAVITY_M_S2};
use crate::random::{Purpose, Random};
use crate::{ImuOptions, WheelOptions};

/// Joint names of the left and the right wheel.
pub const WHEELS: [&str; 2] = ["left_wheel", "right_wheel"];
/// Period of the wheel readings: 50 Hz \[ns\].
pub const WHEELS_PERIOD_NS: i64 = 20_000_000;
/// Period of the IMU readings: 100 Hz \[ns\].
pub const IMU_PERIOD_NS: i64 = 10_000_000;

/// All wheel and IMU readings of a log, as written to its files.
///
/// # Panics
/// If `log` is out of range.
pub fn readings(campus: &Campus, log: usize) -> (Vec<JointState>, Vec<Imu>) {
    let (options, seed, drive) = (campus.options(), campus.seed(), campus.drive(log));
    let mut wheels = Wheels::new(drive, &options.wheels, seed, log);
    let mut imu = ImuSensor::new(drive, &options.imu, seed, log);
    let stamps = |period_ns: i64| (drive.start_ns()..=drive.end_ns()).step_by(period_ns as usize);
    (
        stamps(WHEELS_PERIOD_NS).map(|stamp_ns| wheels.read(stamp_ns)).collect(),
        stamps(IMU_PERIOD_NS).map(|stamp_ns| imu.read(stamp_ns)).collect(),
    )
}

/// The two wheel encoders.
pub(crate) struct Wheels<'a> {
    drive: &'a Drive,
    options: &'a WheelOptions,
    random: Random,
    /// Measured over true distance, for each wheel.
    scales: [f64; 2],
    /// Measured distance \[m\].
    paths_m: [f64; 2],
    /// Distance reported so far, in counts.
    counts: [i64; 2],
    /// Pose estimated from the encoders alone.
    pub(crate) odometry: Pose2,
    travel_m: f64,
    heading_rad: f64,
}

impl<'a> Wheels<'a> {
    pub(crate) fn new(drive: &'a Drive, options: &'a WheelOptions, seed: u64, log: usize) -> Self {
        let mut random = Random::new(seed, Purpose::Wheels, log, 0);
        let scale = 1.0 + options.scale_error * random.normal();
        let difference = options.scale_difference * random.normal();
        let before_ns = drive.start_ns() - WHEELS_PERIOD_NS;
        Self {
            drive,
            options,
            scales: [scale - difference, scale + difference],
            paths_m: [0.0; 2],
            counts: [0; 2],
            odometry: Pose2::default(),
            travel_m: drive.travel_m(before_ns),
            heading_rad: drive.pose_at(before_ns).heading_rad,
            random,
        }
    }

    /// The next reading. Call it every [`WHEELS_PERIOD_NS`], first at the start of the drive.
    pub(crate) fn read(&mut self, stamp_ns: i64) -> JointState {
        let (travel_m, heading_rad) =
            (self.drive.travel_m(stamp_ns), self.drive.pose_at(stamp_ns).heading_rad);
        let forward_m = travel_m - self.travel_m;
        let turned_rad = wrap_angle(heading_rad - self.heading_rad);
        (self.travel_m, self.heading_rad) = (travel_m, heading_rad);
        let mut read_m = [0.0; 2];
        for (k, side) in [-0.5, 0.5].into_iter().enumerate() {
            let true_m = forward_m + side * self.options.track_m * turned_rad;
            let slip_m = self.options.slip * true_m.abs().sqrt() * self.random.normal();
            self.paths_m[k] += true_m * self.scales[k] + slip_m;
            let counts = (self.paths_m[k] / self.options.count_m).floor() as i64;
            read_m[k] = (counts - self.counts[k]) as f64 * self.options.count_m;
            self.counts[k] = counts;
        }
        let turn_rad = (read_m[1] - read_m[0]) / self.options.track_m;
        self.odometry = moved(&self.odometry, 0.5 * (read_m[0] + read_m[1]), turn_rad);
        let speed = |metres: f64| metres / (WHEELS_PERIOD_NS as f64 * 1e-9);
        JointState {
            stamp_ns,
            names: WHEELS.map(str::to_owned).to_vec(),
            positions: Vec::new(),
            velocities: read_m.map(speed).to_vec(),
        }
    }
}

/// The pose after an arc, approximated by a straight line in the mean direction.
fn moved(from: &Pose2, forward_m: f64, turn_rad: f64) -> Pose2 {
    let (sin, cos) = libm::sincos(from.heading_rad + 0.5 * turn_rad);
    Pose2 {
        x_m: from.x_m + forward_m * cos,
        y_m: from.y_m + forward_m * sin,
        heading_rad: wrap_angle(from.heading_rad + turn_rad),
    }
}

/// A three-axis gyroscope and accelerometer at the wheel axle.
pub(crate) struct ImuSensor<'a> {
    drive: &'a Drive,
    options: &'a ImuOptions,
    random: Random,
    gyro_bias: [f64; 3],
}

impl<'a> ImuSensor<'a> {
    pub(crate) fn new(drive: &'a Drive, options: &'a ImuOptions, seed: u64, log: usize) -> Self {
        let mut random = Random::new(seed, Purpose::Imu, log, 0);
        let gyro_bias = [0; 3].map(|_| options.gyro_bias * random.normal());
        Self { drive, options, random, gyro_bias }
    }

    /// The next reading: the mean over [`IMU_PERIOD_NS`] around its stamp.
    pub(crate) fn read(&mut self, stamp_ns: i64) -> Imu {
        let half_ns = IMU_PERIOD_NS / 2;
        let dt = IMU_PERIOD_NS as f64 * 1e-9;
        let (before, here, after) = (
            self.drive.motion_at(stamp_ns - half_ns),
            self.drive.motion_at(stamp_ns),
            self.drive.motion_at(stamp_ns + half_ns),
        );
        let yaw_rate = wrap_angle(after.pose.heading_rad - before.pose.heading_rad) / dt;
        let pitch_rate = (after.pitch_rad - before.pitch_rad) / dt;
        let acceleration = (after.speed_m_s - before.speed_m_s) / dt;
        let (sin, cos) = libm::sincos(here.pitch_rad);
        // In the level frame, the x axis of the base is (cos, 0, -sin) and its z axis (sin, 0, cos).
        let angular_velocity = [-sin * yaw_rate, pitch_rate, cos * yaw_rate];
        let force = [
            cos * acceleration - sin * GRAVITY_M_S2,
            here.speed_m_s * yaw_rate,
            sin * acceleration + cos * GRAVITY_M_S2,
        ];
        let noise = |density: f64| density / dt.sqrt();
        let (gyro, walk) =
            (noise(self.options.gyro_noise), self.options.gyro_bias_walk * dt.sqrt());
        let accelerometer = noise(self.options.acceleration_noise);
        for bias in &mut self.gyro_bias {
            *bias += walk * self.random.normal();
        }
        let mut noisy = |value: f64, deviation: f64| value + deviation * self.random.normal();
        Imu {
            stamp_ns,
            orientation: None,
            angular_velocity: std::array::from_fn(|k| {
                noisy(angular_velocity[k] + self.gyro_bias[k], gyro)
            }),
            linear_acceleration: Some(force.map(|value| noisy(value, accelerometer))),
        }
    }
}
