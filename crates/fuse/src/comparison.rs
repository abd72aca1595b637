//! Two measurements of the same turns, compared over a whole drive.
//!
//! The filter corrects small errors of its sensors. It cannot correct a gyroscope that measures
//! deg/s, or a wheel encoder that counts backward: it follows one of the two sensors and calls the
//! other one wheel slip. These errors are found by comparing the turns of both sensors before the
//! filter runs.

use dataset::Losses;

use crate::error::FuseError;
use crate::options::Options;
use crate::samples::{ImuSample, WheelSample};
use crate::steps::{Step, steps};

/// Lengths of the windows over which turns are compared \[s\]. Short windows resolve fast turns to
/// both sides, which cancel in a long window. Long windows resolve slow turns, which are below the
/// noise of the wheels in a short window. The length that resolves the turns best is used.
const WINDOW_SECS: [f64; 3] = [1.0, 3.0, 10.0];
/// Minimum number of windows. The mean rate is estimated from them too.
const MIN_WINDOWS: usize = 6;
/// Turns are resolved if their variance is this many times the variance of the noise. Then noise
/// changes the ratio of two standard deviations by at most sqrt(1 + 1/4) - 1 = 12 %.
const RESOLVED: f64 = 4.0;
/// A drive with slower turns than this is straight: root mean square rate \[rad/s\]. Gyroscopes of
/// robots at rest read up to 0.2 deg/s of vibration.
const STRAIGHT_RAD_S: f64 = 0.005;

/// How two sensors measured the turns of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurnComparison {
    /// Number of windows, and their length \[s\].
    pub n_windows: usize,
    /// \[s\]
    pub window_secs: f64,
    /// Sum of the turns of the windows, to both sides, measured by the reference \[rad\].
    pub reference_rad: f64,
    /// The same, measured by the sensor \[rad\].
    pub sensor_rad: f64,
    /// Turns of the sensor over turns of the reference: the ratio of their standard deviations,
    /// with the sign of their correlation. It is infinite if the reference does not turn.
    pub ratio: f64,
    /// Correlation of the two, -1 to 1; 0 if one of them does not turn.
    pub correlation: f64,
    /// Whether the reference turns by more than its noise.
    pub is_reference_resolved: bool,
    /// Whether the sensor turns by more than the noise of both.
    pub is_sensor_resolved: bool,
}

/// The turns of a drive, measured by wheels, gyroscope and measured headings.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TurnComparisons {
    /// The gyroscope compared with the difference of the wheels. `None` without enough samples of
    /// both at the same time.
    pub gyro_by_wheels: Option<TurnComparison>,
    /// The gyroscope compared with the sum of the wheels instead of their difference: the turn of
    /// the wheels if one of them counts backward.
    pub gyro_by_wheel_sum: Option<TurnComparison>,
    /// The measured headings compared with the gyroscope.
    pub heading_by_gyro: Option<TurnComparison>,
    /// The measured headings compared with the difference of the wheels.
    pub heading_by_wheels: Option<TurnComparison>,
    /// Largest minus smallest measured heading, unwrapped; `None` without headings \[rad\].
    pub heading_span_rad: Option<f64>,
}

/// Compares the turns measured by wheels, gyroscope and measured headings.
///
/// The mean rate of each source is subtracted first: the gyroscope has a bias. A robot that turns
/// all the time in one direction is compared without that if the rate is far above the bias.
pub fn compare_turns(
    options: &Options,
    wheels: &[WheelSample],
    imu: &[ImuSample],
) -> Result<TurnComparisons, FuseError> {
    options.check()?;
    let steps = steps(options, wheels, imu, None, &mut Losses::default())?;
    let with_gyro = |of: &dyn Fn(&Step) -> Option<Rates>| compare(options, &steps.steps, of);
    let gyro_noise =
        |step: &Step| step.motion.variance.turn_gyro_rad2 + step.motion.variance.turn_both_rad2;
    let wheel_noise =
        |step: &Step| step.motion.variance.turn_wheels_rad2 + step.motion.variance.turn_both_rad2;
    let heading = HeadingTurns::new(imu);
    let heading_noise = 2.0 * options.heading_noise_std * options.heading_noise_std;
    let wheels_rad = |step: &Step| step.motion.difference_m / options.track_m;
    let heading_of = |step: &Step, reference_rad: f64, noise: f64| {
        let from_ns = step.stamp_ns - (step.motion.dt_secs * 1e9).round() as i64;
        Some(Rates {
            reference: (reference_rad, noise),
            sensor: (heading.turn_rad(from_ns, step.stamp_ns)?, 0.0),
            window_noise: heading_noise,
        })
    };
    let gyro_of = |step: &Step, wheels_rad: f64| {
        Some(Rates {
            reference: (wheels_rad, wheel_noise(step)),
            sensor: (step.motion.turn_rad?, gyro_noise(step)),
            window_noise: 0.0,
        })
    };
    Ok(TurnComparisons {
        gyro_by_wheels: with_gyro(&|step| gyro_of(step, wheels_rad(step))),
        gyro_by_wheel_sum: with_gyro(&|step| {
            gyro_of(step, 2.0 * step.motion.distance_m / options.track_m)
        }),
        heading_by_gyro: with_gyro(&|step| {
            heading_of(step, step.motion.turn_rad?, gyro_noise(step))
        }),
        heading_by_wheels: with_gyro(&|step| heading_of(step, wheels_rad(step), wheel_noise(step))),
        heading_span_rad: heading.span_rad(),
    })
}

/// The turns of one step or window, each with its variance \[rad, rad^2\].
#[derive(Debug, Clone, Copy)]
struct Rates {
    reference: (f64, f64),
    sensor: (f64, f64),
    /// Variance of the sensor per window, whatever its length \[rad^2\].
    window_noise: f64,
}

/// A window: its length and its turns.
struct Window {
    secs: f64,
    rates: Rates,
}

fn compare(
    options: &Options,
    steps: &[Step],
    of: &dyn Fn(&Step) -> Option<Rates>,
) -> Option<TurnComparison> {
    let duration_secs: f64 = steps.iter().map(|step| step.motion.dt_secs).sum();
    let shortest = WINDOW_SECS[0].min(duration_secs / (MIN_WINDOWS + 1) as f64);
    let lengths = WINDOW_SECS.into_iter().skip(1).chain([shortest]);
    let compared = lengths.filter_map(|secs| {
        let windows = windows(steps, secs, of);
        (MIN_WINDOWS <= windows.len()).then(|| Sums::compare(options, &windows, secs))
    });
    compared.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, comparison)| comparison)
}

/// Combines consecutive steps to windows. A step without one of the turns ends a window, which is
/// dropped if it is shorter than half of `secs`.
fn windows(steps: &[Step], secs: f64, of: &dyn Fn(&Step) -> Option<Rates>) -> Vec<Window> {
    let mut windows: Vec<Window> = Vec::new();
    let mut is_open = false;
    for step in steps {
        let Some(rates) = of(step) else {
            is_open = false;
            continue;
        };
        let step_secs = step.motion.dt_secs;
        match windows.last_mut().filter(|_| is_open) {
            Some(window) => {
                window.secs += step_secs;
                let sum = |a: &mut (f64, f64), b: (f64, f64)| *a = (a.0 + b.0, a.1 + b.1);
                sum(&mut window.rates.reference, rates.reference);
                sum(&mut window.rates.sensor, rates.sensor);
            }
            None => windows.push(Window { secs: step_secs, rates }),
        }
        is_open = windows.last().is_some_and(|window| window.secs < secs);
    }
    windows.retain(|window| 0.5 * secs <= window.secs);
    windows
}

/// Weighted sums over windows. The weight of a rate is the length of its window.
struct Sums {
    reference: f64,
    sensor: f64,
    product: f64,
    reference_noise: f64,
    sensor_noise: f64,
}

impl Sums {
    /// Returns how well the turns are resolved, and the comparison.
    fn compare(options: &Options, windows: &[Window], secs: f64) -> (f64, TurnComparison) {
        let centered = Self::new(windows, true);
        let mut sums = Self::new(windows, false);
        // Without the mean, the bias of the gyroscope is noise too.
        let duration_secs: f64 = windows.iter().map(|window| window.secs).sum();
        let bias = options.gyro_bias_std * options.gyro_bias_std * duration_secs;
        sums.reference_noise += bias;
        sums.sensor_noise += bias;
        let best = if centered.resolution() < sums.resolution() { sums } else { centered };
        let straight = STRAIGHT_RAD_S * STRAIGHT_RAD_S * duration_secs;
        let product = best.reference.sqrt() * best.sensor.sqrt();
        let correlation = if 0.0 < product { best.product / product } else { 0.0 };
        let sum_of = |of: &dyn Fn(&Rates) -> f64| {
            windows.iter().fold(0.0, |sum, window| sum + of(&window.rates).abs())
        };
        let comparison = TurnComparison {
            n_windows: windows.len(),
            window_secs: secs,
            reference_rad: sum_of(&|rates| rates.reference.0),
            sensor_rad: sum_of(&|rates| rates.sensor.0),
            ratio: match best.reference {
                0.0 => f64::INFINITY,
                reference => (best.sensor / reference).sqrt().copysign(correlation),
            },
            correlation,
            is_reference_resolved: straight.max(RESOLVED * best.reference_noise) < best.reference,
            is_sensor_resolved: straight.max(RESOLVED * (best.reference_noise + best.sensor_noise))
                < best.sensor,
        };
        (best.resolution(), comparison)
    }

    fn new(windows: &[Window], is_centered: bool) -> Self {
        let secs = windows.iter().fold(0.0, |sum, window| sum + window.secs);
        let mean = |of: &dyn Fn(&Rates) -> f64| match is_centered {
            true => windows.iter().fold(0.0, |sum, window| sum + of(&window.rates)) / secs,
            false => 0.0,
        };
        let means = [mean(&|rates| rates.reference.0), mean(&|rates| rates.sensor.0)];
        let mut sums = Self {
            reference: 0.0,
            sensor: 0.0,
            product: 0.0,
            reference_noise: 0.0,
            sensor_noise: 0.0,
        };
        for Window { secs, rates } in windows {
            let reference = rates.reference.0 / secs - means[0];
            let sensor = rates.sensor.0 / secs - means[1];
            sums.reference += secs * reference * reference;
            sums.sensor += secs * sensor * sensor;
            sums.product += secs * reference * sensor;
            sums.reference_noise += rates.reference.1 / secs;
            sums.sensor_noise += (rates.sensor.1 + rates.window_noise) / secs;
        }
        sums
    }

    /// Variance of the turns over variance of their noise, of the source that turns more.
    fn resolution(&self) -> f64 {
        let noise = self.reference_noise + self.sensor_noise;
        match noise {
            0.0 => 0.0,
            noise => self.reference.max(self.sensor) / noise,
        }
    }
}

/// The measured headings, unwrapped.
struct HeadingTurns {
    /// Stamps and headings \[ns, rad\].
    headings: Vec<(i64, f64)>,
}

impl HeadingTurns {
    fn new(imu: &[ImuSample]) -> Self {
        let mut headings: Vec<(i64, f64)> = Vec::new();
        for sample in imu {
            let Some(heading) = sample.heading_rad.filter(|heading| heading.is_finite()) else {
                continue;
            };
            match headings.last() {
                Some((stamp_ns, _)) if sample.stamp_ns <= *stamp_ns => {}
                Some((_, last)) => {
                    let unwrapped = last + dataset::wrap_angle(heading - last);
                    headings.push((sample.stamp_ns, unwrapped));
                }
                None => headings.push((sample.stamp_ns, heading)),
            }
        }
        Self { headings }
    }

    /// The heading at a stamp, interpolated; `None` outside of the headings.
    fn at(&self, stamp_ns: i64) -> Option<f64> {
        let after = self.headings.partition_point(|(ns, _)| *ns < stamp_ns);
        let (after_ns, next) = self.headings.get(after)?;
        if *after_ns == stamp_ns {
            return Some(*next);
        }
        let (before_ns, last) = self.headings.get(after.checked_sub(1)?)?;
        let share = (stamp_ns - before_ns) as f64 / (after_ns - before_ns) as f64;
        Some(last + share * (next - last))
    }

    fn turn_rad(&self, from_ns: i64, to_ns: i64) -> Option<f64> {
        Some(self.at(to_ns)? - self.at(from_ns)?)
    }

    fn span_rad(&self) -> Option<f64> {
        let (_, first) = self.headings.first()?;
        let (least, most) = (self.headings.iter())
            .fold((*first, *first), |(least, most), (_, h)| (least.min(*h), most.max(*h)));
        Some(most - least)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options() -> Options {
        Options { track_m: 0.5, ..Options::default() }
    }

    /// 60 s at 1 m/s: wheels at 20 Hz, and an IMU at 50 Hz. The rates are functions of time.
    fn compare(
        wheels: impl Fn(f64) -> f64,
        gyro: impl Fn(f64) -> f64,
        heading: impl Fn(f64) -> Option<f64>,
    ) -> TurnComparisons {
        let stamp_ns = |t: f64| (t * 1e9).round() as i64;
        let wheels: Vec<WheelSample> = (0..=1200)
            .map(|k| f64::from(k) / 20.0)
            .map(|t| WheelSample::from_twist(stamp_ns(t), 1.0, wheels(t), 0.5))
            .collect();
        let imu: Vec<ImuSample> = (0..=3000)
            .map(|k| f64::from(k) / 50.0)
            .map(|t| ImuSample {
                stamp_ns: stamp_ns(t),
                yaw_rate_rad_s: gyro(t),
                heading_rad: heading(t),
            })
            .collect();
        compare_turns(&options(), &wheels, &imu).unwrap()
    }

    fn winding(t: f64) -> f64 {
        0.2 * libm::cos(0.4 * t)
    }

    /// A bias of 0.02 rad/s does not change the ratio.
    #[test]
    fn the_ratio_of_two_sensors_is_measured_in_spite_of_a_bias() {
        for factor in [1.0, -1.0, 57.3, 0.5] {
            let found = compare(winding, |t| factor * winding(t) + 0.02, |_| None);
            let found = found.gyro_by_wheels.unwrap();
            assert!((found.ratio / factor - 1.0).abs() < 0.02, "{factor}: {found:?}");
            assert!(0.99 < found.correlation * factor.signum(), "{found:?}");
            assert!(found.is_reference_resolved && found.is_sensor_resolved);
        }
    }

    #[test]
    fn a_circle_is_compared_by_its_mean_rate() {
        for factor in [1.0, -1.0] {
            let found = compare(|_| 0.5, |_| factor * 0.5, |_| None).gyro_by_wheels.unwrap();
            assert!((found.ratio - factor).abs() < 0.01, "{found:?}");
            assert!(found.is_reference_resolved);
        }
    }

    #[test]
    fn a_straight_drive_and_a_dead_sensor_are_not_resolved() {
        let noise = |t: f64| 2e-3 * libm::sin(1234.5 * t * t);
        let straight = compare(noise, |t| noise(t + 7.0), |_| None).gyro_by_wheels.unwrap();
        assert!(!straight.is_reference_resolved && !straight.is_sensor_resolved, "{straight:?}");
        let dead = compare(winding, |_| 0.0, |_| None).gyro_by_wheels.unwrap();
        assert!(dead.is_reference_resolved && dead.ratio == 0.0, "{dead:?}");
        let no_turns = compare(|_| 0.0, winding, |_| None).gyro_by_wheels.unwrap();
        assert!(no_turns.is_sensor_resolved && no_turns.ratio.is_infinite(), "{no_turns:?}");
    }

    /// The heading is the integral of the rate, 0.5 sin(0.4 t), and wraps at pi.
    #[test]
    fn headings_are_compared_with_the_gyroscope() {
        for factor in [1.0, -1.0, 0.0] {
            let heading =
                |t: f64| Some(dataset::wrap_angle(3.0 + factor * 0.5 * libm::sin(0.4 * t)));
            let found = compare(winding, winding, heading);
            let by_gyro = found.heading_by_gyro.unwrap();
            assert!((by_gyro.ratio - factor).abs() < 0.02, "{factor}: {by_gyro:?}");
            assert!((found.heading_span_rad.unwrap() - factor.abs()).abs() < 1e-3, "{found:?}");
        }
        assert_eq!(compare(winding, winding, |_| None).heading_span_rad, None);
    }

    /// If the left wheel counts backward, the sum of the wheels turns with the gyroscope.
    #[test]
    fn a_reversed_wheel_is_found_in_the_sum() {
        let stamp_ns = |k: i64| k * 50_000_000;
        let wheels: Vec<WheelSample> = (0..=1200)
            .map(|k| {
                let sample =
                    WheelSample::from_twist(stamp_ns(k), 1.0, winding(k as f64 / 20.0), 0.5);
                WheelSample { left_m_s: -sample.left_m_s, ..sample }
            })
            .collect();
        let imu: Vec<ImuSample> = (0..=1200)
            .map(|k| ImuSample {
                stamp_ns: stamp_ns(k),
                yaw_rate_rad_s: winding(k as f64 / 20.0),
                heading_rad: None,
            })
            .collect();
        let found = compare_turns(&options(), &wheels, &imu).unwrap();
        let sum = found.gyro_by_wheel_sum.unwrap();
        assert!((sum.ratio - 1.0).abs() < 0.02 && 0.99 < sum.correlation, "{sum:?}");
    }
}
