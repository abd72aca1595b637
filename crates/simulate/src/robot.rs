//! What the robot itself measures: its wheels' speeds, and its angular velocity and acceleration.

use dataset::{Pose2, wrap_angle};
use messages::{Imu, JointState};

use crate::campus::Campus;
use crate::drive::{Drive, GRAVITY_M_S2};
use crate::random::{Purpose, Random};
use crate::{ImuOptions, WheelOptions};

/// Names of the joints, left and right.
pub const WHEELS: [&str; 2] = ["left_wheel", "right_wheel"];
/// Time from one reading of the wheels to the next: 50 Hz \[ns\].
pub const WHEELS_PERIOD_NS: i64 = 20_000_000;
/// Time from one reading of the inertial measurement unit to the next: 100 Hz \[ns\].
pub const IMU_PERIOD_NS: i64 = 10_000_000;

/// All readings of the wheels and of the inertial measurement unit of log number `log`, as its
/// files hold them.
///
/// # Panics
/// If there is no such log.
pub fn readings(campus: &Campus, log: usize) -> (Vec<JointState>, Vec<Imu>) {
    let (options, seed, drive) = (campus.options(), campus.seed(), campus.drive(log));
    let mut wheels = Wheels::new(drive, &options.wheels, seed, log);
    let mut imu = ImuUnit::new(drive, &options.imu, seed, log);
    let stamps = |period_ns: i64| (drive.start_ns()..=drive.end_ns()).step_by(period_ns as usize);
    (
        stamps(WHEELS_PERIOD_NS).map(|stamp_ns| wheels.read(stamp_ns)).collect(),
        stamps(IMU_PERIOD_NS).map(|stamp_ns| imu.read(stamp_ns)).collect(),
    )
}

/// The two encoders.
pub(crate) struct Wheels<'a> {
    drive: &'a Drive,
    options: &'a WheelOptions,
    random: Random,
    /// True over measured path is 1 over this, for either wheel.
    scales: [f64; 2],
    /// Measured path \[m\].
    paths_m: [f64; 2],
    /// Path that was reported, in counts.
    counts: [i64; 2],
    /// Where the encoders alone would have the robot.
    pub(crate) odometry: Pose2,
    way_m: f64,
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
            way_m: drive.way_m(before_ns),
            heading_rad: drive.pose_at(before_ns).heading_rad,
            random,
        }
    }

    /// The next reading; one comes every [`WHEELS_PERIOD_NS`], the first at the drive's start.
    pub(crate) fn read(&mut self, stamp_ns: i64) -> JointState {
        let (way_m, heading_rad) =
            (self.drive.way_m(stamp_ns), self.drive.pose_at(stamp_ns).heading_rad);
        let forward_m = way_m - self.way_m;
        let turned_rad = wrap_angle(heading_rad - self.heading_rad);
        (self.way_m, self.heading_rad) = (way_m, heading_rad);
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

/// A pose after an arc, taken for the straight line in its middle direction.
fn moved(from: &Pose2, forward_m: f64, turn_rad: f64) -> Pose2 {
    let (sin, cos) = libm::sincos(from.heading_rad + 0.5 * turn_rad);
    Pose2 {
        x_m: from.x_m + forward_m * cos,
        y_m: from.y_m + forward_m * sin,
        heading_rad: wrap_angle(from.heading_rad + turn_rad),
    }
}

/// A gyroscope and an accelerometer about and along three axes, at the axle.
pub(crate) struct ImuUnit<'a> {
    drive: &'a Drive,
    options: &'a ImuOptions,
    random: Random,
    gyro_bias: [f64; 3],
}

impl<'a> ImuUnit<'a> {
    pub(crate) fn new(drive: &'a Drive, options: &'a ImuOptions, seed: u64, log: usize) -> Self {
        let mut random = Random::new(seed, Purpose::Imu, log, 0);
        let gyro_bias = [0; 3].map(|_| options.gyro_bias * random.normal());
        Self { drive, options, random, gyro_bias }
    }

    /// The next reading, a mean over [`IMU_PERIOD_NS`] around its stamp.
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
        // The base's x axis is (cos, 0, -sin) and its z axis (sin, 0, cos) of the level frame.
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
