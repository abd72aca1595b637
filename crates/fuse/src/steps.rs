//! Samples -> steps: the motion that the sensors measure between two stamps.

use dataset::{LossKind, Losses};

use crate::error::FuseError;
use crate::options::Options;
use crate::samples::{ImuSample, WheelSample};
use crate::signal::{Gaps, Integral, Signal, gaps, in_order, seconds};

/// Longest step \[s\]: longer steps are divided at IMU samples, because the speed is constant along
/// the arc of a step.
const MAX_STEP_SECS: f64 = 0.05;

/// Gyroscope and wheels are compared over windows of this length \[s\]. It is much longer than a
/// sample period, to average the noise, and much shorter than the time in which the bias changes.
const WINDOW_SECS: f64 = 1.0;

/// The motion from the previous stamp to this one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Step {
    /// End of the step \[ns\].
    pub(crate) stamp_ns: i64,
    pub(crate) motion: Motion,
    /// Heading measured at the end of the step, if one is used there \[rad\].
    pub(crate) heading_rad: Option<f64>,
    /// Index in [`Steps::windows`] of the window that ends with this step.
    pub(crate) window: Option<usize>,
    /// Whether the result has a pose at the end of the step.
    pub(crate) is_output: bool,
}

/// A measured motion. Consecutive motions can be added.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    /// \[s\]
    pub(crate) dt_secs: f64,
    /// Path of the midpoint between the wheels \[m\].
    pub(crate) distance_m: f64,
    /// Path of the right wheel minus path of the left wheel \[m\].
    pub(crate) difference_m: f64,
    /// Integral of the yaw rate, including the bias; `None` without IMU samples \[rad\].
    pub(crate) turn_rad: Option<f64>,
    /// Variances of the values above.
    pub(crate) variance: Variance,
    /// Whether both wheels stand still.
    pub(crate) is_still: bool,
}

/// Variances of a motion. Sampling misses part of the motion between two samples. The part that
/// both sources miss is an error that they share.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Variance {
    /// Of the forward distance \[m^2\].
    pub(crate) along_m2: f64,
    /// Of the sideways distance \[m^2\].
    pub(crate) aside_m2: f64,
    /// Of the turn measured by the wheels, without the shared part \[rad^2\].
    pub(crate) turn_wheels_rad2: f64,
    /// Of the turn measured by the gyroscope, without the shared part; infinite without a gyroscope
    /// \[rad^2\].
    pub(crate) turn_gyro_rad2: f64,
    /// Of the part of the turn that both sources miss \[rad^2\].
    pub(crate) turn_both_rad2: f64,
}

/// The result of [`steps`].
pub(crate) struct Steps {
    /// Stamp at which the first step starts.
    pub(crate) start_ns: i64,
    /// Whether the result has a pose at the first stamp.
    pub(crate) is_start_output: bool,
    /// Heading measured at the first stamp, if there is one \[rad\].
    pub(crate) start_heading_rad: Option<f64>,
    pub(crate) steps: Vec<Step>,
    /// Motions for which gyroscope and wheels are compared.
    pub(crate) windows: Vec<Motion>,
    pub(crate) n_wheel_samples: usize,
    /// IMU samples in the time range of the wheel samples.
    pub(crate) n_imu_samples: usize,
    /// IMU samples outside of it. They are not used.
    pub(crate) n_imu_outside: usize,
    /// Time of the wheel samples before the first and after the last IMU sample \[s\].
    pub(crate) wheels_alone_secs: f64,
    pub(crate) wheel_gaps: Gaps,
    pub(crate) imu_gaps: Gaps,
}

/// Computes the steps between consecutive wheel stamps and `outputs`, the stamps at which poses are
/// requested.
pub(crate) fn steps(
    options: &Options,
    wheels: &[WheelSample],
    imu: &[ImuSample],
    outputs: Option<&[i64]>,
    losses: &mut Losses,
) -> Result<Steps, FuseError> {
    let wheels = in_order(wheels, losses);
    let imu = in_order(imu, losses);
    let (start_ns, end_ns) = match &wheels[..] {
        [first, .., last] => (first.stamp_ns, last.stamp_ns),
        few => {
            let (found, losses) = (few.len(), losses.clone());
            return Err(FuseError::TooFewWheelSamples { found, losses });
        }
    };
    let outputs = match outputs {
        None => wheels.iter().map(|sample| sample.stamp_ns).collect(),
        Some(stamps) => within(stamps, start_ns, end_ns, losses),
    };
    let n_imu_outside = outside(&imu, start_ns, end_ns);
    if !imu.is_empty() && n_imu_outside == imu.len() {
        let imu_ns = (imu[0].stamp_ns, imu[imu.len() - 1].stamp_ns);
        let (n_imu, wheels_ns) = (imu.len(), (start_ns, end_ns));
        return Err(FuseError::NoCommonTime { n_imu, wheels_ns, imu_ns });
    }
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
            .expect("every step is between the first and the last wheel sample");
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
        n_imu_samples: imu.len() - n_imu_outside,
        n_imu_outside,
        wheels_alone_secs: match (imu.first(), imu.last()) {
            (Some(first), Some(last)) => {
                let before = seconds(start_ns, first.stamp_ns).max(0.0);
                before + seconds(last.stamp_ns, end_ns).max(0.0)
            }
            _ => 0.0,
        },
        wheel_gaps: gaps(&wheels, start_ns, end_ns, options.max_gap_secs),
        imu_gaps: gaps(&imu, start_ns, end_ns, options.max_gap_secs),
    })
}

impl Motion {
    fn new(
        options: &Options,
        dt_secs: f64,
        wheels: &Integral<2>,
        gyro: Option<&Integral<1>>,
    ) -> Self {
        let square = |value: f64| value * value;
        let [left, right] = wheels.values.map(|path_m| options.wheel_scale * path_m);
        let distance_m = 0.5 * (left + right);
        let is_still = wheels.largest <= options.still_m_per_s;

        // The variance of one wheel: noise that grows with time and slip that grows with the path.
        let wheel = match is_still {
            true => 0.0,
            false => {
                square(options.wheel_noise_density) * dt_secs
                    + square(options.wheel_slip) * 0.5 * (left.abs() + right.abs())
            }
        };
        let turn_missed = |missed: f64| square(options.yaw_acceleration_density) * missed;
        let both_missed =
            gyro.map_or(wheels.missed_s3, |gyro| wheels.missed_s3.min(gyro.missed_s3));
        Self {
            dt_secs,
            distance_m,
            difference_m: right - left,
            turn_rad: gyro.map(|gyro| gyro.values[0]),
            variance: Variance {
                along_m2: 0.5 * wheel + square(options.acceleration_density) * wheels.missed_s3,
                aside_m2: square(options.side_slip) * distance_m.abs(),
                turn_wheels_rad2: 2.0 * wheel / square(options.track_m)
                    + turn_missed(wheels.missed_s3 - both_missed),
                turn_gyro_rad2: gyro.map_or(f64::INFINITY, |gyro| {
                    square(options.gyro_noise_density) * dt_secs
                        + turn_missed(gyro.missed_s3 - both_missed)
                }),
                turn_both_rad2: turn_missed(both_missed),
            },
            is_still,
        }
    }

    /// The sum of this motion and the next one. It is `None` if one of them has no gyroscope turn,
    /// or if only one of them is at standstill.
    fn plus(&self, next: &Self) -> Option<Self> {
        let turn_rad = self.turn_rad? + next.turn_rad?;
        (self.is_still == next.is_still).then_some(Self {
            dt_secs: self.dt_secs + next.dt_secs,
            distance_m: self.distance_m + next.distance_m,
            difference_m: self.difference_m + next.difference_m,
            turn_rad: Some(turn_rad),
            variance: Variance {
                along_m2: self.variance.along_m2 + next.variance.along_m2,
                aside_m2: self.variance.aside_m2 + next.variance.aside_m2,
                turn_wheels_rad2: self.variance.turn_wheels_rad2 + next.variance.turn_wheels_rad2,
                turn_gyro_rad2: self.variance.turn_gyro_rad2 + next.variance.turn_gyro_rad2,
                turn_both_rad2: self.variance.turn_both_rad2 + next.variance.turn_both_rad2,
            },
            is_still: self.is_still,
        })
    }
}

/// Combines steps to windows and stores the index of each window in its last step.
fn windows(steps: &mut [Step]) -> Vec<Motion> {
    let mut windows: Vec<Motion> = Vec::new();
    // Whether the last window can still grow. It ends with the previous step.
    let mut is_open = false;
    for k in 0..steps.len() {
        let motion = steps[k].motion;
        let grown = windows.last().filter(|_| is_open).and_then(|window| window.plus(&motion));
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
        is_open = steps[k].window.is_some_and(|window| windows[window].dt_secs < WINDOW_SECS);
    }
    windows
}

/// Number of IMU samples that have no influence on the time from `start_ns` to `end_ns`. The last
/// sample before it and the first one after it have: the yaw rate is interpolated.
fn outside(imu: &[ImuSample], start_ns: i64, end_ns: i64) -> usize {
    let is_covered = |k: usize| {
        let next_ns = imu.get(k + 1).map_or(imu[k].stamp_ns, |next| next.stamp_ns);
        let last_ns = if 0 < k { imu[k - 1].stamp_ns } else { imu[k].stamp_ns };
        (imu[k].stamp_ns < start_ns && start_ns < next_ns)
            || (start_ns..=end_ns).contains(&imu[k].stamp_ns)
            || (end_ns < imu[k].stamp_ns && last_ns < end_ns)
    };
    (0..imu.len()).filter(|&k| !is_covered(k)).count()
}

/// The requested stamps within the wheel samples, in ascending order.
fn within(stamps: &[i64], start_ns: i64, end_ns: i64, losses: &mut Losses) -> Vec<i64> {
    let n = |is_out: &dyn Fn(i64) -> bool| stamps.iter().filter(|&&s| is_out(s)).count() as u64;
    losses.add(LossKind::StampsBeforeWheels, n(&|s| s < start_ns));
    losses.add(LossKind::StampsAfterWheels, n(&|s| end_ns < s));
    let mut kept: Vec<i64> =
        stamps.iter().copied().filter(|s| (start_ns..=end_ns).contains(s)).collect();
    kept.sort_unstable();
    let before = kept.len();
    kept.dedup();
    losses.add(LossKind::DuplicateRequestedStamps, (before - kept.len()) as u64);
    kept
}

/// The stamps of the wheel samples, of the outputs, and of enough IMU samples between them to keep
/// every step short.
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

/// The measured headings, at most one per `every_secs`.
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

    /// The heading at a stamp, interpolated along the shorter arc between the two samples around
    /// it. It is `None` if one of the two samples has no heading, if they are more than
    /// `max_gap_secs` apart, or if the last heading was used less than `every_secs` ago.
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
