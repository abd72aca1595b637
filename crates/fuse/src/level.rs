//! The yaw rate of an IMU that leans: mounted tilted, on a base that pitches, on a slope.

use dataset::Dropped;
use nalgebra::Vector3;

use crate::WheelSample;
use crate::signal::{in_order, seconds};

/// Standard gravity \[m/s^2\].
const GRAVITY_M_S2: f64 = 9.80665;
/// How far the middle one of all accelerations may be from gravity to be that, relative.
const GRAVITY_TOLERANCE: f64 = 0.1;
/// The accelerations tell the direction up as their mean over about this long \[s\]; what is
/// faster the angular velocities tell. A guess between two evils: accelerations that the wheels do
/// not tell, and a bias not yet known, of which 1e-3 rad/s is 0.6 deg in 10 s.
const MEMORY_SECS: f64 = 10.0;
/// A change of speed is taken over this \[s\]: steps of 0.025 m/s, of encoders that count 0.5 mm at
/// 50 Hz, are 0.05 m/s^2 then, and robots take longer to stop.
const CHANGE_SECS: f64 = 0.5;
/// Rounds, there and back, that find bias and forward direction: the first one takes some of the
/// accelerations for a lean.
const ROUNDS: usize = 2;

/// What an IMU measures, in its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inertial {
    /// \[ns since the epoch\]
    pub stamp_ns: i64,
    /// \[rad/s\]
    pub angular_velocity: [f64; 3],
    /// Specific force, which at rest is the reaction to gravity and points up; none where the IMU
    /// has no accelerometer \[m/s^2\].
    pub acceleration: Option<[f64; 3]>,
}

/// Rate about the vertical of every reading \[rad/s\]: the projection of the angular velocity on
/// the direction up, for any mounting of the IMU.
///
/// The direction up is carried from reading to reading by the angular velocity and drawn to the
/// direction of the acceleration, which also tells the gyroscope's bias across it (Mahony, Hamel
/// and Pflimlin 2008, "Nonlinear complementary filters on the special orthogonal group", their
/// explicit filter with bias, eq. 32, of one direction). Of the acceleration is taken off first
/// what the wheels say: the change of speed forward and speed times yaw rate to the left. This runs
/// through the drive and back for the bias and for where forward is, and the direction used is the
/// mean of the last way back and one more way there, so that errors before and after cancel.
///
/// A balancing base needs all this: it leans into every acceleration by as much as hides the lean
/// from its accelerometer, and a direction up that is the same for the whole drive misses
/// 1 - cos(lean) of every turn.
///
/// Where the accelerations are not gravity, as of drivers that take it out, or there are none, up
/// is the z axis.
pub fn yaw_rates_rad_s(readings: &[Inertial], wheels: &[WheelSample]) -> Vec<f64> {
    if !has_gravity(readings) {
        return readings.iter().map(|reading| reading.angular_velocity[2]).collect();
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
    // The bias about the vertical is not for gravity to tell.
    let mean_up = ups.iter().sum::<Vector3<f64>>().try_normalize(f64::EPSILON).unwrap_or(level.up);
    let mut rates = Vec::with_capacity(n);
    for k in 0..n {
        if 0 < k {
            level.step(&readings[k - 1], &readings[k], &speeds[k]);
        }
        let up = (level.up + ups[k]).try_normalize(f64::EPSILON).unwrap_or(level.up);
        let across = level.bias - mean_up * level.bias.dot(&mean_up);
        rates.push((Vector3::from(readings[k].angular_velocity) - across).dot(&up));
    }
    rates
}

/// What is known at a reading, in the IMU's frame.
struct Level {
    /// Of length 1.
    up: Vector3<f64>,
    /// Of the gyroscope, across the direction up only \[rad/s\].
    bias: Vector3<f64>,
    /// Where forward is: along the two axes of [`level_axes`]. Its length is 1 where accelerations
    /// and wheels agree, and less where they do not.
    forward: [f64; 2],
}

impl Level {
    /// On to the next reading, or back to the one before: a direction that stands still turns
    /// against the IMU. One lost to a gap is taken from the acceleration.
    fn step(&mut self, from: &Inertial, to: &Inertial, speed: &Speed) {
        let dt = seconds(from.stamp_ns, to.stamp_ns);
        let mean = 0.5 * (rate(from) + rate(to)) - self.bias;
        self.up = turned(&self.up, &(-dt * mean));
        if let Some(measured) = self.measured_up(to, speed) {
            let gain = 1.0 - libm::exp(-dt.abs() / MEMORY_SECS);
            let drawn = self.up + gain * (measured - self.up);
            // Critically damped: the square of half the filter's own rate.
            let rate = 0.5 / MEMORY_SECS;
            self.bias += dt.clamp(-1.0, 1.0) * rate * rate * self.up.cross(&measured);
            self.up = drawn.try_normalize(f64::EPSILON).unwrap_or(measured);
        }
    }

    fn measured_up(&self, reading: &Inertial, speed: &Speed) -> Option<Vector3<f64>> {
        let [e, n] = level_axes(&self.up);
        let forward = self.forward[0] * e + self.forward[1] * n;
        let leftward = speed.m_s * (rate(reading) - self.bias).dot(&self.up);
        let driven = speed.change_m_s2 * forward + leftward * self.up.cross(&forward);
        (finite(reading.acceleration?)? - driven).try_normalize(f64::EPSILON)
    }
}

/// Speed of the middle between the wheels.
struct Speed {
    m_s: f64,
    change_m_s2: f64,
}

/// At the readings; changes are means over [`CHANGE_SECS`], which encoders resolve. Beyond the
/// wheels' samples the speed is that of the nearest one, without any 0.
fn speeds(readings: &[Inertial], wheels: &[WheelSample]) -> Vec<Speed> {
    let wheels = in_order(wheels, "wheel", &mut Dropped::default());
    let speed_at = |stamp_ns: i64| {
        let mean = |sample: &WheelSample| 0.5 * (sample.left_m_per_s + sample.right_m_per_s);
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
    let speed = |reading: &Inertial| {
        let (before, after) =
            (reading.stamp_ns.saturating_sub(half_ns), reading.stamp_ns.saturating_add(half_ns));
        let change = speed_at(after) - speed_at(before);
        Speed { m_s: speed_at(reading.stamp_ns), change_m_s2: change / CHANGE_SECS }
    };
    readings.iter().map(speed).collect()
}

/// Where forward is: the vector (along the two axes of [`level_axes`]) that, times the
/// accelerations that the wheels tell, comes nearest to the measured ones in the sense of least
/// squares: both taken for complex numbers, the sum of conjugate(wheels) x measured over that of
/// |wheels|^2. Accelerations that have nothing to do with the wheels give next to nothing.
fn forward(
    readings: &[Inertial],
    speeds: &[Speed],
    ups: &[Vector3<f64>],
    bias: &Vector3<f64>,
) -> [f64; 2] {
    let (mut sum, mut of) = ([0.0; 2], 0.0);
    for ((reading, speed), up) in readings.iter().zip(speeds).zip(ups) {
        let Some(acceleration) = reading.acceleration.and_then(finite) else { continue };
        let (change, leftward) = (speed.change_m_s2, speed.m_s * (rate(reading) - bias).dot(up));
        let [e, n] = level_axes(up).map(|axis| axis.dot(&acceleration));
        sum[0] += change * e + leftward * n;
        sum[1] += change * n - leftward * e;
        of += change * change + leftward * leftward;
    }
    if 0.0 < of { sum.map(|sum| sum / of) } else { [0.0; 2] }
}

/// Two level axes, the second to the left of the first: of the IMU's x axis, or of its y axis where
/// x is upright.
fn level_axes(up: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = if up.x * up.x < 0.7 { Vector3::x() } else { Vector3::y() };
    let level = (first - up * up.dot(&first)).normalize();
    [level, up.cross(&level)]
}

fn finite(vector: [f64; 3]) -> Option<Vector3<f64>> {
    vector.iter().all(|value| value.is_finite()).then(|| Vector3::from(vector))
}

fn rate(reading: &Inertial) -> Vector3<f64> {
    finite(reading.angular_velocity).unwrap_or_default()
}

/// Mean direction of the accelerations of the first seconds.
fn first_up(readings: &[Inertial]) -> Vector3<f64> {
    let is_early =
        |r: &&Inertial| seconds(readings[0].stamp_ns, r.stamp_ns).abs() <= 0.5 * MEMORY_SECS;
    let accelerations = readings.iter().filter(is_early).filter_map(|r| finite(r.acceleration?));
    let sum: Vector3<f64> = accelerations.sum();
    sum.try_normalize(f64::EPSILON).unwrap_or_else(Vector3::z)
}

/// Whether the middle one of all accelerations is as large as gravity.
fn has_gravity(readings: &[Inertial]) -> bool {
    let norms = readings.iter().filter_map(|r| r.acceleration).map(|a| Vector3::from(a).norm());
    let mut norms: Vec<f64> = norms.filter(|norm| norm.is_finite()).collect();
    if norms.is_empty() {
        return false;
    }
    let middle = norms.len() / 2;
    let (_, median, _) = norms.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / GRAVITY_M_S2 - 1.0).abs() < GRAVITY_TOLERANCE
}

/// A vector turned by a rotation vector \[rad\] (Rodrigues' formula).
fn turned(v: &Vector3<f64>, by: &Vector3<f64>) -> Vector3<f64> {
    let angle = by.norm();
    let Some(axis) = by.try_normalize(f64::MIN_POSITIVE) else { return *v };
    let (sin, cos) = libm::sincos(angle);
    v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    const HZ: usize = 100;

    /// Readings at 100 Hz of an IMU whose roll and pitch are functions of time, on a robot that
    /// turns at `yaw_rate` and drives at `speed` (both by time). By hand: an IMU pitched by p
    /// (about y, forward down), then seen from it rolled by r (about x), sees a level vector turned
    /// by -p about y, then by -r about x, and has the angular velocity of the yaw seen so, plus p'
    /// about y seen through the roll, plus r' about x.
    fn readings(
        secs: f64,
        roll: &dyn Fn(f64) -> f64,
        pitch: &dyn Fn(f64) -> f64,
        yaw_rate: &dyn Fn(f64) -> f64,
        speed: &dyn Fn(f64) -> f64,
        bias: [f64; 3],
    ) -> Vec<Inertial> {
        let seen = |v: [f64; 3], r: f64, p: f64| {
            let [x, y, z] = v;
            let (x, z) = (p.cos() * x - p.sin() * z, p.sin() * x + p.cos() * z);
            [x, r.cos() * y + r.sin() * z, r.cos() * z - r.sin() * y]
        };
        (0..(secs * HZ as f64) as usize)
            .map(|k| {
                let t = k as f64 / HZ as f64;
                let slope = |f: &dyn Fn(f64) -> f64| (f(t + 1e-4) - f(t - 1e-4)) / 2e-4;
                let (r, p) = (roll(t), pitch(t));
                let yaw = seen([0.0, 0.0, yaw_rate(t)], r, p);
                let pitching = seen([0.0, slope(pitch), 0.0], r, 0.0);
                let rolling = [slope(roll), 0.0, 0.0];
                Inertial {
                    stamp_ns: (k * 1_000_000_000 / HZ) as i64,
                    angular_velocity: std::array::from_fn(|k| {
                        yaw[k] + pitching[k] + rolling[k] + bias[k]
                    }),
                    acceleration: Some(seen(
                        [slope(speed), speed(t) * yaw_rate(t), GRAVITY_M_S2],
                        r,
                        p,
                    )),
                }
            })
            .collect()
    }

    /// Integral of the rates less the true ones \[rad\].
    fn error_rad(rates: &[f64], yaw_rate: &dyn Fn(f64) -> f64) -> f64 {
        let truth = |k: usize| yaw_rate(k as f64 / HZ as f64);
        rates.iter().enumerate().map(|(k, rate)| (rate - truth(k)) / HZ as f64).sum()
    }

    /// Rolled by 30 deg: up is (0, 1/2, sqrt(3)/2) in the IMU's frame, and 0.8 rad/s about it
    /// reads as 0.4 and 0.8 sqrt(3)/2.
    #[test]
    fn a_rolled_imu_by_hand() {
        let half_root = 0.75f64.sqrt();
        let reading = |stamp_ns| Inertial {
            stamp_ns,
            angular_velocity: [0.0, 0.4, 0.8 * half_root],
            acceleration: Some([0.0, 0.5 * GRAVITY_M_S2, half_root * GRAVITY_M_S2]),
        };
        for rate in yaw_rates_rad_s(&[reading(0), reading(10_000_000), reading(20_000_000)], &[]) {
            assert!((rate - 0.8).abs() < 1e-12, "{rate}");
        }
    }

    /// A base that speeds up and slows down at 0.6 m/s^2, leans by as much, turns while it leans,
    /// and has the biases of a cheap gyroscope; its IMU is mounted upright, upside down, rolled, and
    /// rolled with x backwards (which is rolled the other way with left and right exchanged).
    #[test]
    fn a_balancing_base_hides_its_lean_and_its_turns_are_found() {
        let speed = |t: f64| 0.8 - 0.75 * (0.8 * t).cos();
        let lean = |t: f64| (0.6 * (0.8 * t).sin() / GRAVITY_M_S2).atan();
        // To the left, half of the time, where it leans most: 2/pi of 0.8 rad/s, 153 rad.
        let yaw_rate = |t: f64| 0.8 * (0.8 * t).sin().max(0.0);
        let wheels: Vec<WheelSample> = (0..50 * 600)
            .map(|k| {
                let m_s = speed(f64::from(k) / 50.0);
                let stamp_ns = i64::from(k) * 20_000_000;
                WheelSample { stamp_ns, left_m_per_s: m_s, right_m_per_s: m_s }
            })
            .collect();
        for (roll, is_backwards) in [(0.0, false), (PI, false), (0.7, false), (0.7, true)] {
            let biases = [0.01, -0.015, 0.002];
            let mut readings = readings(600.0, &|_| roll, &lean, &yaw_rate, &speed, biases);
            let backwards = |[x, y, z]: [f64; 3]| [-x, -y, z];
            for reading in readings.iter_mut().filter(|_| is_backwards) {
                reading.angular_velocity = backwards(reading.angular_velocity);
                reading.acceleration = reading.acceleration.map(backwards);
            }
            // What is left of the bias is that about the vertical, which the filter calibrates.
            let biased_rad = 600.0 * (0.002 * roll.cos() - 0.015 * roll.sin());
            let error = |rates: &[f64]| error_rad(rates, &yaw_rate) - biased_rad;
            let found = error(&yaw_rates_rad_s(&readings, &wheels));
            let fixed: Vec<f64> = (readings.iter())
                .map(|reading| {
                    let [_, y, z] = reading.angular_velocity;
                    let y = if is_backwards { -y } else { y };
                    z * roll.cos() + y * roll.sin()
                })
                .collect();
            let fixed = error(&fixed);
            println!("roll {roll}: {found:.4} rad of 153, with a fixed direction {fixed:.4}");
            assert!(found.abs() < 0.02, "roll {roll}: {found} rad");
            // 1 - cos(lean) is 0.0019 sin^2, of turns that go with sin: 0.0019 * 2/3 * 153 = 0.19.
            assert!((fixed + 0.19).abs() < 0.01, "{fixed}");
        }
    }

    #[test]
    fn no_gravity_is_the_z_axis() {
        let reading = |acceleration| Inertial {
            stamp_ns: 0,
            angular_velocity: [1.0, 2.0, 3.0],
            acceleration,
        };
        assert!(yaw_rates_rad_s(&[], &[]).is_empty());
        for acceleration in [None, Some([0.1, 0.0, 0.0]), Some([0.0; 3]), Some([f64::NAN; 3])] {
            assert_eq!(yaw_rates_rad_s(&[reading(acceleration); 3], &[]), [3.0; 3]);
        }
    }

    /// A value that is not finite spoils its own reading and no other.
    #[test]
    fn a_broken_reading_stays_alone() {
        let mut some = readings(20.0, &|_| 0.3, &|_| 0.1, &|_| 0.5, &|_| 0.0, [0.0; 3]);
        some[700].angular_velocity[1] = f64::NAN;
        some[900].acceleration = Some([f64::INFINITY, 0.0, 1.0]);
        some[1000].acceleration = None;
        let rates = yaw_rates_rad_s(&some, &[]);
        assert_eq!(rates.iter().filter(|rate| rate.is_nan()).count(), 1);
        let far = rates.iter().filter(|rate| 1e-2 < (*rate - 0.5).abs()).count();
        assert_eq!(far, 0);
    }
}
