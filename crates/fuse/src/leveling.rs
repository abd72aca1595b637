//! The yaw rate of an IMU that is not level: mounted tilted, on a base that pitches, on a slope.

use dataset::Losses;
use nalgebra::Vector3;

use crate::gravity::is_gravity;
use crate::samples::WheelSample;
use crate::signal::{in_order, seconds};

/// Time constant \[s\] of the direction up: slower changes come from the accelerations, faster
/// changes from the angular velocities. The value is a compromise (a guess). A short time follows
/// accelerations that the wheels do not measure. A long time follows a gyroscope bias that is not
/// yet known: 1e-3 rad/s is 0.6 deg in 10 s.
const MEMORY_SECS: f64 = 10.0;
/// Changes of speed are computed over this time \[s\]. Encoders that count 0.5 mm at 50 Hz have
/// speed steps of 0.025 m/s, which are 0.05 m/s^2 over this time. Robots need longer to stop.
const CHANGE_SECS: f64 = 0.5;
/// Number of rounds, forward and backward, that estimate the bias and the forward direction. In
/// the first round some accelerations are still mistaken for tilt.
const ROUNDS: usize = 2;

/// The measurements of an IMU in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InertialReading {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// \[rad/s\]
    pub angular_velocity_rad_s: [f64; 3],
    /// Specific force \[m/s^2\]. At rest it is the reaction to gravity and points up. `None` if the
    /// IMU has no accelerometer.
    pub acceleration_m_s2: Option<[f64; 3]>,
}

/// Computes the rate about the vertical for every reading \[rad/s\]: the projection of the angular
/// velocity on the direction up. The IMU can be mounted in any orientation.
///
/// The angular velocity rotates the direction up from reading to reading, and the measured
/// acceleration pulls it back to the vertical. The same correction estimates the horizontal part of
/// the gyroscope bias (Mahony, Hamel and Pflimlin 2008, "Nonlinear complementary filters on the
/// special orthogonal group", their explicit filter with bias, eq. 32, for one direction). Before
/// that, the acceleration that the wheels measure is subtracted: the change of speed forward, and
/// speed times yaw rate to the left. The filter runs forward and backward through the drive to
/// estimate the bias and the forward direction. The final direction up is the mean of the last
/// backward pass and one more forward pass, so errors of the two passes cancel.
///
/// A balancing base needs this correction. It leans into every acceleration, by an angle that hides
/// the lean from its accelerometer. A constant direction up would lose 1 - cos(lean) of every turn.
///
/// If the accelerations do not contain gravity (some drivers remove it), or if there are none, the
/// direction up is the z axis.
pub fn yaw_rates_rad_s(readings: &[InertialReading], wheels: &[WheelSample]) -> Vec<f64> {
    if !has_gravity(readings) {
        return readings.iter().map(|reading| reading.angular_velocity_rad_s[2]).collect();
    }
    let speeds = speeds(readings, wheels);
    let n = readings.len();
    let mut level = Level { up: first_up(readings), bias: Vector3::zeros(), forward: [0.0; 2] };
    let mut ups = vec![level.up; n];
    for _ in 0..ROUNDS {
        for k in 1..n {
            level.step(&readings[k - 1], &readings[k], &speeds[k]);
            ups[k] = level.up;
        }
        level.forward = forward(readings, &speeds, &ups, &level.bias);
        for k in (1..n).rev() {
            level.step(&readings[k], &readings[k - 1], &speeds[k - 1]);
            ups[k - 1] = level.up;
        }
        level.forward = forward(readings, &speeds, &ups, &level.bias);
    }
    // Gravity does not observe the bias about the vertical.
    let mean_up = ups.iter().sum::<Vector3<f64>>().try_normalize(f64::EPSILON).unwrap_or(level.up);
    let mut rates = Vec::with_capacity(n);
    for k in 0..n {
        if 0 < k {
            level.step(&readings[k - 1], &readings[k], &speeds[k]);
        }
        let up = (level.up + ups[k]).try_normalize(f64::EPSILON).unwrap_or(level.up);
        let across = level.bias - mean_up * level.bias.dot(&mean_up);
        rates.push((Vector3::from(readings[k].angular_velocity_rad_s) - across).dot(&up));
    }
    rates
}

/// The state of the leveling filter at a reading, in the IMU frame.
struct Level {
    /// Unit vector.
    up: Vector3<f64>,
    /// Gyroscope bias, only its part perpendicular to the direction up \[rad/s\].
    bias: Vector3<f64>,
    /// Forward direction, along the two axes of [`level_axes`]. Its length is 1 if accelerations
    /// and wheels agree, and less if they do not.
    forward: [f64; 2],
}

impl Level {
    /// Moves the state to the next or the previous reading. The vertical is fixed in the world, so
    /// in the IMU frame it rotates against the angular velocity. After a gap the direction up comes
    /// from the acceleration.
    fn step(&mut self, from: &InertialReading, to: &InertialReading, speed: &Speed) {
        let dt = seconds(from.stamp_ns, to.stamp_ns);
        let mean = 0.5 * (rate(from) + rate(to)) - self.bias;
        self.up = rotated(&self.up, &(-dt * mean));
        if let Some(measured) = self.measured_up(to, speed) {
            let gain = 1.0 - libm::exp(-dt.abs() / MEMORY_SECS);
            let pulled = self.up + gain * (measured - self.up);
            // Critically damped: the gain is the square of half the rate of the filter.
            let rate = 0.5 / MEMORY_SECS;
            self.bias += dt.clamp(-1.0, 1.0) * rate * rate * self.up.cross(&measured);
            self.up = pulled.try_normalize(f64::EPSILON).unwrap_or(measured);
        }
    }

    fn measured_up(&self, reading: &InertialReading, speed: &Speed) -> Option<Vector3<f64>> {
        let [e, n] = level_axes(&self.up);
        let forward = self.forward[0] * e + self.forward[1] * n;
        let leftward = speed.m_s * (rate(reading) - self.bias).dot(&self.up);
        let driven = speed.change_m_s2 * forward + leftward * self.up.cross(&forward);
        (finite(reading.acceleration_m_s2?)? - driven).try_normalize(f64::EPSILON)
    }
}

/// Speed of the midpoint between the wheels.
struct Speed {
    m_s: f64,
    change_m_s2: f64,
}

/// The speeds at the readings. Changes are means over [`CHANGE_SECS`], which encoders can resolve.
/// Before the first and after the last wheel sample the speed is that sample's speed; without wheel
/// samples it is 0.
fn speeds(readings: &[InertialReading], wheels: &[WheelSample]) -> Vec<Speed> {
    let wheels = in_order(wheels, &mut Losses::default());
    let speed_at = |stamp_ns: i64| {
        let mean = |sample: &WheelSample| 0.5 * (sample.left_m_s + sample.right_m_s);
        let after = wheels.partition_point(|sample| sample.stamp_ns <= stamp_ns);
        match (after.checked_sub(1).map(|k| &wheels[k]), wheels.get(after)) {
            (Some(a), Some(b)) => {
                let share = seconds(a.stamp_ns, stamp_ns) / seconds(a.stamp_ns, b.stamp_ns);
                mean(a) + share * (mean(b) - mean(a))
            }
            (one, other) => one.or(other).map_or(0.0, mean),
        }
    };
    let half_ns = (0.5 * CHANGE_SECS * 1e9) as i64;
    let speed = |reading: &InertialReading| {
        let (before, after) =
            (reading.stamp_ns.saturating_sub(half_ns), reading.stamp_ns.saturating_add(half_ns));
        let change = speed_at(after) - speed_at(before);
        Speed { m_s: speed_at(reading.stamp_ns), change_m_s2: change / CHANGE_SECS }
    };
    readings.iter().map(speed).collect()
}

/// The forward direction along the two axes of [`level_axes`]: the factor between the accelerations
/// computed from the wheels and the measured accelerations, by least squares. With both as complex
/// numbers it is sum(conjugate(wheels) measured) / sum(|wheels|^2). If the measured accelerations
/// are not correlated with the wheels, its length is close to 0.
fn forward(
    readings: &[InertialReading],
    speeds: &[Speed],
    ups: &[Vector3<f64>],
    bias: &Vector3<f64>,
) -> [f64; 2] {
    let (mut sum, mut sum_of_squares) = ([0.0; 2], 0.0);
    for ((reading, speed), up) in readings.iter().zip(speeds).zip(ups) {
        let Some(acceleration) = reading.acceleration_m_s2.and_then(finite) else { continue };
        let (change, leftward) = (speed.change_m_s2, speed.m_s * (rate(reading) - bias).dot(up));
        let [e, n] = level_axes(up).map(|axis| axis.dot(&acceleration));
        sum[0] += change * e + leftward * n;
        sum[1] += change * n - leftward * e;
        sum_of_squares += change * change + leftward * leftward;
    }
    if 0.0 < sum_of_squares { sum.map(|sum| sum / sum_of_squares) } else { [0.0; 2] }
}

/// Two horizontal axes in the IMU frame. The first is the horizontal part of the IMU's x axis, or
/// of its y axis if x is close to vertical. The second is to the left of the first.
fn level_axes(up: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = if up.x * up.x < 0.7 { Vector3::x() } else { Vector3::y() };
    let level = (first - up * up.dot(&first)).normalize();
    [level, up.cross(&level)]
}

fn finite(vector: [f64; 3]) -> Option<Vector3<f64>> {
    vector.iter().all(|value| value.is_finite()).then(|| Vector3::from(vector))
}

fn rate(reading: &InertialReading) -> Vector3<f64> {
    finite(reading.angular_velocity_rad_s).unwrap_or_default()
}

/// Mean direction of the accelerations in the first seconds.
fn first_up(readings: &[InertialReading]) -> Vector3<f64> {
    let is_early =
        |r: &&InertialReading| seconds(readings[0].stamp_ns, r.stamp_ns).abs() <= 0.5 * MEMORY_SECS;
    let accelerations =
        readings.iter().filter(is_early).filter_map(|r| finite(r.acceleration_m_s2?));
    let sum: Vector3<f64> = accelerations.sum();
    sum.try_normalize(f64::EPSILON).unwrap_or_else(Vector3::z)
}

/// Whether the median norm of all accelerations is that of gravity.
fn has_gravity(readings: &[InertialReading]) -> bool {
    let norms =
        readings.iter().filter_map(|r| r.acceleration_m_s2).map(|a| Vector3::from(a).norm());
    let mut norms: Vec<f64> = norms.filter(|norm| norm.is_finite()).collect();
    if norms.is_empty() {
        return false;
    }
    let middle = norms.len() / 2;
    let (_, median, _) = norms.select_nth_unstable_by(middle, f64::total_cmp);
    is_gravity(*median)
}

/// Rotates a vector by a rotation vector \[rad\] (Rodrigues' formula).
fn rotated(v: &Vector3<f64>, by: &Vector3<f64>) -> Vector3<f64> {
    let angle = by.norm();
    let Some(axis) = by.try_normalize(f64::MIN_POSITIVE) else { return *v };
    let (sin, cos) = libm::sincos(angle);
    v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Standard gravity.
    const GRAVITY_M_S2: f64 = 9.80665;
    const HZ: usize = 100;

    /// Readings at 100 Hz of an IMU on a robot; roll, pitch, yaw rate and speed are functions of
    /// time. The IMU is pitched by p (about y, forward down), then rolled by r (about its own x).
    /// In its frame a horizontal vector is rotated by -p about y, then by -r about x. Its angular
    /// velocity is the yaw rate in that frame, plus p' about y in the rolled frame, plus r' about
    /// x.
    fn readings(
        secs: f64,
        roll: &dyn Fn(f64) -> f64,
        pitch: &dyn Fn(f64) -> f64,
        yaw_rate: &dyn Fn(f64) -> f64,
        speed: &dyn Fn(f64) -> f64,
        bias: [f64; 3],
    ) -> Vec<InertialReading> {
        let in_imu_frame = |v: [f64; 3], r: f64, p: f64| {
            let [x, y, z] = v;
            let (x, z) = (p.cos() * x - p.sin() * z, p.sin() * x + p.cos() * z);
            [x, r.cos() * y + r.sin() * z, r.cos() * z - r.sin() * y]
        };
        (0..(secs * HZ as f64) as usize)
            .map(|k| {
                let t = k as f64 / HZ as f64;
                let slope = |f: &dyn Fn(f64) -> f64| (f(t + 1e-4) - f(t - 1e-4)) / 2e-4;
                let (r, p) = (roll(t), pitch(t));
                let yaw = in_imu_frame([0.0, 0.0, yaw_rate(t)], r, p);
                let pitching = in_imu_frame([0.0, slope(pitch), 0.0], r, 0.0);
                let rolling = [slope(roll), 0.0, 0.0];
                InertialReading {
                    stamp_ns: (k * 1_000_000_000 / HZ) as i64,
                    angular_velocity_rad_s: std::array::from_fn(|k| {
                        yaw[k] + pitching[k] + rolling[k] + bias[k]
                    }),
                    acceleration_m_s2: Some(in_imu_frame(
                        [slope(speed), speed(t) * yaw_rate(t), GRAVITY_M_S2],
                        r,
                        p,
                    )),
                }
            })
            .collect()
    }

    /// Integral of the difference to the true rates \[rad\].
    fn error_rad(rates: &[f64], yaw_rate: &dyn Fn(f64) -> f64) -> f64 {
        let truth = |k: usize| yaw_rate(k as f64 / HZ as f64);
        rates.iter().enumerate().map(|(k, rate)| (rate - truth(k)) / HZ as f64).sum()
    }

    /// Rolled by 30 deg: up is (0, 1/2, sqrt(3)/2) in the IMU frame. A yaw rate of 0.8 rad/s gives
    /// the angular velocity (0, 0.4, 0.8 sqrt(3)/2).
    #[test]
    fn the_yaw_rate_of_a_rolled_imu_is_projected_on_the_vertical() {
        let half_root = 0.75f64.sqrt();
        let reading = |stamp_ns| InertialReading {
            stamp_ns,
            angular_velocity_rad_s: [0.0, 0.4, 0.8 * half_root],
            acceleration_m_s2: Some([0.0, 0.5 * GRAVITY_M_S2, half_root * GRAVITY_M_S2]),
        };
        for rate in yaw_rates_rad_s(&[reading(0), reading(10_000_000), reading(20_000_000)], &[]) {
            assert!((rate - 0.8).abs() < 1e-12, "{rate}");
        }
    }

    /// A balancing base accelerates and brakes with 0.6 m/s^2, leans accordingly, and turns while
    /// it leans. Its gyroscope has large biases. The IMU is mounted upright, upside down, rolled,
    /// and rolled with x pointing backward.
    #[test]
    fn the_turns_of_a_balancing_base_are_measured_although_it_leans() {
        let speed = |t: f64| 0.8 - 0.75 * (0.8 * t).cos();
        let lean = |t: f64| (0.6 * (0.8 * t).sin() / GRAVITY_M_S2).atan();
        // Turns left half of the time, most where it leans most: 600 s * 0.8 rad/s / pi = 153 rad.
        let yaw_rate = |t: f64| 0.8 * (0.8 * t).sin().max(0.0);
        let wheels: Vec<WheelSample> = (0..50 * 600)
            .map(|k| {
                let m_s = speed(f64::from(k) / 50.0);
                let stamp_ns = i64::from(k) * 20_000_000;
                WheelSample { stamp_ns, left_m_s: m_s, right_m_s: m_s }
            })
            .collect();
        for (roll, is_backwards) in [(0.0, false), (PI, false), (0.7, false), (0.7, true)] {
            let biases = [0.01, -0.015, 0.002];
            let mut readings = readings(600.0, &|_| roll, &lean, &yaw_rate, &speed, biases);
            let backwards = |[x, y, z]: [f64; 3]| [-x, -y, z];
            for reading in readings.iter_mut().filter(|_| is_backwards) {
                reading.angular_velocity_rad_s = backwards(reading.angular_velocity_rad_s);
                reading.acceleration_m_s2 = reading.acceleration_m_s2.map(backwards);
            }
            // The bias about the vertical remains; the Kalman filter calibrates it.
            let biased_rad = 600.0 * (0.002 * roll.cos() - 0.015 * roll.sin());
            let error = |rates: &[f64]| error_rad(rates, &yaw_rate) - biased_rad;
            let found = error(&yaw_rates_rad_s(&readings, &wheels));
            let fixed: Vec<f64> = (readings.iter())
                .map(|reading| {
                    let [_, y, z] = reading.angular_velocity_rad_s;
                    let y = if is_backwards { -y } else { y };
                    z * roll.cos() + y * roll.sin()
                })
                .collect();
            let fixed = error(&fixed);
            println!(
                "roll {roll}: error {found:.4} rad of 153 rad, with a fixed vertical {fixed:.4} rad"
            );
            assert!(found.abs() < 0.02, "roll {roll}: {found} rad");
            // 1 - cos(lean) is 0.0019 sin^2. Weighted with the yaw rate, which is proportional to
            // sin: 0.0019 * 2/3 * 153 rad = 0.19 rad.
            assert!((fixed + 0.19).abs() < 0.01, "{fixed}");
        }
    }

    #[test]
    fn without_gravity_the_yaw_rate_is_the_rate_about_z() {
        let reading = |acceleration_m_s2| InertialReading {
            stamp_ns: 0,
            angular_velocity_rad_s: [1.0, 2.0, 3.0],
            acceleration_m_s2,
        };
        assert!(yaw_rates_rad_s(&[], &[]).is_empty());
        for acceleration in [None, Some([0.1, 0.0, 0.0]), Some([0.0; 3]), Some([f64::NAN; 3])] {
            assert_eq!(yaw_rates_rad_s(&[reading(acceleration); 3], &[]), [3.0; 3]);
        }
    }

    #[test]
    fn a_value_that_is_not_finite_affects_only_its_own_reading() {
        let mut some = readings(20.0, &|_| 0.3, &|_| 0.1, &|_| 0.5, &|_| 0.0, [0.0; 3]);
        some[700].angular_velocity_rad_s[1] = f64::NAN;
        some[900].acceleration_m_s2 = Some([f64::INFINITY, 0.0, 1.0]);
        some[1000].acceleration_m_s2 = None;
        let rates = yaw_rates_rad_s(&some, &[]);
        assert_eq!(rates.iter().filter(|rate| rate.is_nan()).count(), 1);
        let far = rates.iter().filter(|rate| 1e-2 < (*rate - 0.5).abs()).count();
        assert_eq!(far, 0);
    }
}
