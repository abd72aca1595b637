//! Samples -> steps: what the sensors say of the motion between two stamps.

use dataset::Dropped;

use crate::signal::{Signal, Stretch, gaps, in_order, seconds};
use crate::{FuseError, Gaps, ImuSample, Options, WheelSample};

/// No step is longer than this where IMU samples can divide it \[s\]: the speed is held constant
/// along an arc.
const MAX_STEP_SECS: f64 = 0.05;

/// Gyroscope and wheels are compared over this time \[s\]: long beside their samples, so that
/// the turn stands out of the noise, and short beside the walk of the bias.
const WINDOW_SECS: f64 = 1.0;

/// From the stamp before to this one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    /// End of the step \[ns\].
    pub(crate) stamp_ns: i64,
    pub(crate) motion: Motion,
    /// Heading measured at the end of the step, where one is used \[rad\].
    pub(crate) heading_rad: Option<f64>,
    /// The window that ends with the step, of [`Steps::windows`].
    pub(crate) window: Option<usize>,
    /// A pose is asked for at the end of the step.
    pub(crate) is_output: bool,
}

/// A motion as measured; motions one after the other add up.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    /// \[s\]
    pub(crate) dt: f64,
    /// Path of the middle between the wheels \[m\].
    pub(crate) distance_m: f64,
    /// Path of the right wheel less that of the left one \[m\].
    pub(crate) difference_m: f64,
    /// Integral of the yaw rate, bias included; none where the IMU has no samples \[rad\].
    pub(crate) turn_rad: Option<f64>,
    /// Variances of what is above.
    pub(crate) variance: Variance,
    /// Both wheels stand still.
    pub(crate) is_still: bool,
}

/// Variances of a motion. What the samples miss of the motion between them is an error that the
/// two sources share as far as both miss it.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Variance {
    /// Of the distance forward \[m^2\].
    pub(crate) along: f64,
    /// Of the distance sideways \[m^2\].
    pub(crate) aside: f64,
    /// Of the turn by the wheels alone \[rad^2\].
    pub(crate) turn_wheels: f64,
    /// Of the turn by the gyroscope alone; infinite where there is none \[rad^2\].
    pub(crate) turn_gyro: f64,
    /// Of the turn, missed by both \[rad^2\].
    pub(crate) turn_both: f64,
}

/// Everything that [`steps`] makes of the samples.
pub(crate) struct Steps {
    /// The first stamp; the steps start there.
    pub(crate) start_ns: i64,
    /// A pose is asked for at the first stamp.
    pub(crate) is_start_output: bool,
    /// The heading measured at the first stamp, where there is one \[rad\].
    pub(crate) start_heading_rad: Option<f64>,
    pub(crate) steps: Vec<Step>,
    /// Motions over which gyroscope and wheels are compared.
    pub(crate) windows: Vec<Motion>,
    pub(crate) n_wheel_samples: usize,
    pub(crate) n_imu_samples: usize,
    pub(crate) wheel_gaps: Gaps,
    pub(crate) imu_gaps: Gaps,
}

/// From stamp to stamp of the wheels, and of `outputs` where given.
pub(crate) fn steps(
    options: &Options,
    wheels: &[WheelSample],
    imu: &[ImuSample],
    outputs: Option<&[i64]>,
    dropped: &mut Dropped,
) -> Result<Steps, FuseError> {
    let wheels = in_order(wheels, "wheel", dropped);
    let imu = in_order(imu, "imu", dropped);
    let (start_ns, end_ns) = match &wheels[..] {
        [first, .., last] => (first.stamp_ns, last.stamp_ns),
        few => {
            let (found, dropped) = (few.len(), dropped.clone());
            return Err(FuseError::TooFewWheelSamples { found, dropped });
        }
    };
    let outputs = match outputs {
        None => wheels.iter().map(|sample| sample.stamp_ns).collect(),
        Some(stamps) => within(stamps, start_ns, end_ns, dropped),
    };
    let stamps = stamps_of_steps(&wheels, &imu, &outputs);
    let mut headings = Headings::new(&imu, options);
    let start_heading_rad = headings.at(start_ns);

    let mut wheel_signal = Signal::new(&wheels, options.response_secs);
    let mut gyro_signal = Signal::new(&imu, options.response_secs);
    let mut output = outputs.iter().copied().peekable();
    let is_start_output = output.next_if_eq(&start_ns).is_some();
    let steps = stamps.windows(2).map(|ends| {
        let (from_ns, to_ns) = (ends[0], ends[1]);
        let wheels = wheel_signal
            .integrate(from_ns, to_ns)
            .expect("steps lie between the first and the last wheel sample");
        let gyro = gyro_signal.integrate(from_ns, to_ns);
        Step {
            stamp_ns: to_ns,
            motion: Motion::new(options, seconds(from_ns, to_ns), &wheels, gyro.as_ref()),
            heading_rad: headings.at(to_ns),
            window: None,
            is_output: output.next_if_eq(&to_ns).is_some(),
        }
    });
    let mut steps: Vec<Step> = steps.collect();
    let windows = windows(&mut steps);
    Ok(Steps {
        start_ns,
        is_start_output,
        start_heading_rad,
        steps,
        windows,
        n_wheel_samples: wheels.len(),
        n_imu_samples: imu.len(),
        wheel_gaps: gaps(&wheels, start_ns, end_ns, options.max_gap_secs),
        imu_gaps: gaps(&imu, start_ns, end_ns, options.max_gap_secs),
    })
}

impl Motion {
    fn new(options: &Options, dt: f64, wheels: &Stretch<2>, gyro: Option<&Stretch<1>>) -> Self {
        let square = |value: f64| value * value;
        let [left, right] = wheels.integrals.map(|path_m| options.wheel_scale * path_m);
        let distance_m = 0.5 * (left + right);
        let is_still = wheels.largest <= options.still_m_per_s;

        // Both wheels alike, each by noise in time and slip along its path.
        let wheel = match is_still {
            true => 0.0,
            false => {
                square(options.wheel_noise_density) * dt
                    + square(options.wheel_slip) * 0.5 * (left.abs() + right.abs())
            }
        };
        let turn_missed = |missed: f64| square(options.yaw_acceleration_density) * missed;
        let both_missed = gyro.map_or(wheels.missed, |gyro| wheels.missed.min(gyro.missed));
        Self {
            dt,
            distance_m,
            difference_m: right - left,
            turn_rad: gyro.map(|gyro| gyro.integrals[0]),
            variance: Variance {
                along: 0.5 * wheel + square(options.acceleration_density) * wheels.missed,
                aside: square(options.side_slip) * distance_m.abs(),
                turn_wheels: 2.0 * wheel / square(options.track_m)
                    + turn_missed(wheels.missed - both_missed),
                turn_gyro: gyro.map_or(f64::INFINITY, |gyro| {
                    square(options.gyro_noise_density) * dt + turn_missed(gyro.missed - both_missed)
                }),
                turn_both: turn_missed(both_missed),
            },
            is_still,
        }
    }

    /// This motion and the next one, where they compare gyroscope and wheels under the same
    /// conditions.
    fn and(&self, next: &Self) -> Option<Self> {
        let turn_rad = self.turn_rad? + next.turn_rad?;
        (self.is_still == next.is_still).then_some(Self {
            dt: self.dt + next.dt,
            distance_m: self.distance_m + next.distance_m,
            difference_m: self.difference_m + next.difference_m,
            turn_rad: Some(turn_rad),
            variance: Variance {
                along: self.variance.along + next.variance.along,
                aside: self.variance.aside + next.variance.aside,
                turn_wheels: self.variance.turn_wheels + next.variance.turn_wheels,
                turn_gyro: self.variance.turn_gyro + next.variance.turn_gyro,
                turn_both: self.variance.turn_both + next.variance.turn_both,
            },
            is_still: self.is_still,
        })
    }
}

/// Joins steps to windows and tells each step that ends one.
fn windows(steps: &mut [Step]) -> Vec<Motion> {
    let mut windows: Vec<Motion> = Vec::new();
    // The last of the windows may still grow; it ends with the step before.
    let mut is_open = false;
    for k in 0..steps.len() {
        let motion = steps[k].motion;
        let grown = windows.last().filter(|_| is_open).and_then(|window| window.and(&motion));
        match (grown, windows.last_mut()) {
            (Some(grown), Some(window)) => {
                *window = grown;
                steps[k].window = steps[k - 1].window.take();
            }
            _ if motion.turn_rad.is_some() => {
                steps[k].window = Some(windows.len());
                windows.push(motion);
            }
            _ => {}
        }
        is_open = steps[k].window.is_some_and(|window| windows[window].dt < WINDOW_SECS);
    }
    windows
}

/// The stamps that can have a pose, ascending.
fn within(stamps: &[i64], start_ns: i64, end_ns: i64, dropped: &mut Dropped) -> Vec<i64> {
    let n = |is_out: &dyn Fn(i64) -> bool| stamps.iter().filter(|&&s| is_out(s)).count() as u64;
    dropped.add("stamps before the first wheel sample", n(&|s| s < start_ns));
    dropped.add("stamps after the last wheel sample", n(&|s| end_ns < s));
    let mut kept: Vec<i64> =
        stamps.iter().copied().filter(|s| (start_ns..=end_ns).contains(s)).collect();
    kept.sort_unstable();
    let before = kept.len();
    kept.dedup();
    dropped.add("stamps asked for twice", (before - kept.len()) as u64);
    kept
}

/// The stamps of the wheels and the outputs, and of so many IMU samples between that no step is
/// long.
fn stamps_of_steps(wheels: &[WheelSample], imu: &[ImuSample], outputs: &[i64]) -> Vec<i64> {
    let mut stamps: Vec<i64> = wheels.iter().map(|sample| sample.stamp_ns).collect();
    let end_ns = stamps[stamps.len() - 1];
    let mut after = 0;
    let mut last_ns = stamps[0];
    for sample in imu.iter().take_while(|sample| sample.stamp_ns < end_ns) {
        while wheels[after].stamp_ns <= sample.stamp_ns {
            last_ns = last_ns.max(wheels[after].stamp_ns);
            after += 1;
        }
        let next_ns = wheels[after].stamp_ns;
        if MAX_STEP_SECS < seconds(last_ns, next_ns)
            && MAX_STEP_SECS <= seconds(last_ns, sample.stamp_ns)
        {
            stamps.push(sample.stamp_ns);
            last_ns = sample.stamp_ns;
        }
    }
    stamps.extend_from_slice(outputs);
    stamps.sort_unstable();
    stamps.dedup();
    stamps
}

/// The measured headings, thinned.
struct Headings<'a> {
    samples: &'a [ImuSample],
    every_secs: f64,
    max_gap_secs: f64,
    last_ns: Option<i64>,
}

impl<'a> Headings<'a> {
    fn new(samples: &'a [ImuSample], options: &Options) -> Self {
        let (every_secs, max_gap_secs) = (options.heading_every_secs, options.max_gap_secs);
        Self { samples, every_secs, max_gap_secs, last_ns: None }
    }

    /// The heading at a stamp, along the shorter arc between the two samples around it; none where
    /// one of them has none, they are far apart or the last one used is near.
    fn at(&mut self, stamp_ns: i64) -> Option<f64> {
        if self.last_ns.is_some_and(|last| seconds(last, stamp_ns) < self.every_secs) {
            return None;
        }
        let n_before = self.samples.iter().take_while(|s| s.stamp_ns <= stamp_ns).count();
        self.samples = &self.samples[n_before.saturating_sub(1)..];
        let [before, after @ ..] = self.samples else { return None };
        let measured = |sample: &ImuSample| sample.heading_rad.filter(|h| h.is_finite());
        let heading = if before.stamp_ns == stamp_ns {
            measured(before)
        } else if let Some(after) = after.first()
            && before.stamp_ns < stamp_ns
            && seconds(before.stamp_ns, after.stamp_ns) <= self.max_gap_secs
            && let (Some(from), Some(to)) = (measured(before), measured(after))
        {
            let share =
                seconds(before.stamp_ns, stamp_ns) / seconds(before.stamp_ns, after.stamp_ns);
            Some(from + share * dataset::wrap_angle(to - from))
        } else {
            None
        };
        if heading.is_some() {
            self.last_ns = Some(stamp_ns);
        }
        heading
    }
}
