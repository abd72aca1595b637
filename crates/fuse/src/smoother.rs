//! The smoother: corrects the states of the filter with all later measurements.
//!
//! The Rauch-Tung-Striebel estimate (Särkkä 2013, "Bayesian filtering and smoothing", th. 8.2 and
//! alg. 9.1), computed as the modified Bryson-Frazier recursion (Bierman 1973, "Fixed interval
//! smoothing with discrete measurements"; the same as Durbin and Koopman 2012, "Time series
//! analysis by state space methods", sec. 4.4). RTS inverts the predicted covariance at every step.
//! This recursion instead passes the gradient r and the information N of all later innovations
//! backward:
//!
//! ```text
//! smoothed mean       = m + P r          at every stamp, with m and P of the filter
//! smoothed covariance = P - P N P
//! through a step      r := F' r                        N := F' N F
//! through an update   r := r + h (y / s - k' r)        N := h h' / s + (1 - k h')' N (1 - k h')
//! ```
//!
//! Without an inverse, an exact start and constants without process noise are no problem. It is
//! also not necessary to store the matrix P of every step: the state of the filter is stored every
//! [`BLOCK`] steps, and the filter runs again in each block, from the last block to the first.

use nalgebra::SMatrix;

use crate::filter::{Applied, GYRO_BIAS, Matrix, POSE, State, Transition, Update, Vector};
use crate::options::Options;
use crate::steps::Steps;

/// Number of steps between two stored states of 1 kB. A block needs 1 MB.
const BLOCK: usize = 512;

/// The estimated pose and gyroscope bias at one stamp.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Estimate {
    /// x \[m\], y \[m\], heading, not wrapped \[rad\].
    pub(crate) pose: [f64; POSE],
    pub(crate) covariance: SMatrix<f64, POSE, POSE>,
    pub(crate) gyro_bias_rad_s: f64,
}

/// The estimates at the start and after each step, the last state, and counts of the updates.
pub(crate) struct Path {
    pub(crate) estimates: Vec<Estimate>,
    pub(crate) last: State,
    pub(crate) n_headings: u64,
    pub(crate) n_heading_outliers: u64,
    /// Windows of gyroscope and wheels that were beyond the gate, and those of them in motion.
    pub(crate) n_turn_outliers: u64,
    pub(crate) n_moving_outliers: u64,
}

impl Estimate {
    fn filtered(state: &State) -> Self {
        Self {
            pose: [state.mean[0], state.mean[1], state.mean[2]],
            covariance: state.covariance.fixed_view::<POSE, POSE>(0, 0).into_owned(),
            gyro_bias_rad_s: state.mean[GYRO_BIAS],
        }
    }

    fn smoothed(state: &State, later: &Later) -> Self {
        let p = state.covariance.fixed_rows::<POSE>(0);
        let pose = state.mean.fixed_rows::<POSE>(0) + p * later.gradient;
        let covariance =
            state.covariance.fixed_view::<POSE, POSE>(0, 0) - p * later.information * p.transpose();
        let bias_row = state.covariance.row(GYRO_BIAS);
        Self {
            pose: pose.into(),
            covariance: 0.5 * (covariance + covariance.transpose()),
            gyro_bias_rad_s: state.mean[GYRO_BIAS] + (bias_row * later.gradient)[0],
        }
    }
}

/// Runs the filter, and the smoother if the options ask for it.
pub(crate) fn estimate(options: &Options, steps: &Steps, start: dataset::Pose2) -> Path {
    let mut state = State::start(options, start);
    let (mut n_headings, mut n_heading_outliers) = (0, 0);
    let (mut n_turn_outliers, mut n_moving_outliers) = (0, 0);
    let mut count_heading = |update: Option<Update>| {
        n_headings += u64::from(update.is_some());
        n_heading_outliers += u64::from(update.is_some_and(|update| update.is_outlier));
    };
    count_heading(steps.start_heading_rad.map(|heading| state.measure_heading(options, heading)));
    let mut estimates = Vec::with_capacity(steps.steps.len() + 1);
    estimates.push(Estimate::filtered(&state));
    let mut kept = Vec::new();
    for (k, step) in steps.steps.iter().enumerate() {
        if k % BLOCK == 0 {
            kept.push(state);
        }
        let applied = state.step(options, &steps.windows, step);
        count_heading(applied.heading);
        let is_outlier = applied.turn.is_some_and(|update| update.is_outlier);
        n_turn_outliers += u64::from(is_outlier);
        n_moving_outliers += u64::from(is_outlier && !step.motion.is_still);
        estimates.push(Estimate::filtered(&state));
    }
    if options.smooth {
        smooth(options, steps, &kept, &mut estimates);
    }
    Path {
        estimates,
        last: state,
        n_headings,
        n_heading_outliers,
        n_turn_outliers,
        n_moving_outliers,
    }
}

/// Replaces the estimates of the filter by those of the smoother. The last estimate is the same in
/// both.
fn smooth(options: &Options, steps: &Steps, kept: &[State], estimates: &mut [Estimate]) {
    let mut later = Later { gradient: Vector::zeros(), information: Matrix::zeros() };
    let mut block: Vec<(State, Applied)> = Vec::with_capacity(BLOCK);
    for (k, start) in kept.iter().enumerate().rev() {
        let first = k * BLOCK;
        let mut state = *start;
        block.clear();
        for step in steps.steps[first..].iter().take(BLOCK) {
            // Store the state before the step and the operations of the step.
            let before = state;
            block.push((before, state.step(options, &steps.windows, step)));
        }
        for (at, (before, applied)) in block.iter().enumerate().rev() {
            later.through_update(applied.heading.as_ref());
            later.through_transition(&applied.transition);
            later.through_update(applied.turn.as_ref());
            estimates[first + at] = Estimate::smoothed(before, &later);
        }
    }
}

/// The gradient and the information of all later innovations.
struct Later {
    gradient: Vector,
    information: Matrix,
}

impl Later {
    fn through_transition(&mut self, transition: &Transition) {
        self.gradient = transition.pull_back(&self.gradient);
        transition.pull_back_matrix(&mut self.information);
    }

    fn through_update(&mut self, update: Option<&Update>) {
        let Some(Update { h, innovation, variance, gain, .. }) = update else { return };
        self.gradient += h * (innovation / variance - gain.dot(&self.gradient));
        // (1 - k h')' N (1 - k h') + h h' / s, with u = N k.
        let u = self.information * gain;
        let both = gain.dot(&u) + 1.0 / variance;
        self.information += h * (both * h - u).transpose() - u * h.transpose();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::{ImuSample, WheelSample};
    use crate::steps::steps;
    use dataset::{Losses, Pose2};

    fn options() -> Options {
        Options {
            track_m: 0.5,
            wheel_scale_std: 0.02,
            wheel_difference_std: 0.01,
            heading_every_secs: 0.3,
            ..Options::default()
        }
    }

    /// 60 s of a curved drive without noise, with a gyroscope bias and an error of the measured
    /// heading. It is longer than a block.
    fn curved_drive() -> Steps {
        let stamp_ns = |k: i64, hz: i64| 1_000_000_000 * k / hz;
        let wheels: Vec<_> = (0..1200)
            .map(|k| WheelSample {
                stamp_ns: stamp_ns(k, 20),
                left_m_s: 1.0 + 0.2 * libm::sin(0.05 * k as f64),
                right_m_s: 1.1 - 0.3 * libm::sin(0.02 * k as f64),
            })
            .collect();
        let imu: Vec<_> = (0..2400)
            .map(|k| ImuSample {
                stamp_ns: stamp_ns(k, 40),
                yaw_rate_rad_s: 0.21 - libm::sin(0.01 * k as f64),
                heading_rad: Some(dataset::wrap_angle(0.005 * k as f64)),
            })
            .collect();
        steps(&options(), &wheels, &imu, None, &mut Losses::default()).unwrap()
    }

    /// The recursion of the textbook, with the inverse (Särkkä 2013, alg. 9.1):
    /// G = P F' P-^-1, m_s = m + G (m_s+ - m-), P_s = P + G (P_s+ - P-) G'.
    #[test]
    fn the_smoother_gives_the_rauch_tung_striebel_estimate() {
        let (options, steps) = (options(), curved_drive());
        let path = estimate(&options, &steps, Pose2::default());
        assert!(2 * BLOCK < steps.steps.len());

        // Repeat each step in its three parts.
        let mut state = State::start(&options, Pose2::default());
        state.measure_heading(&options, steps.start_heading_rad.unwrap());
        let mut passed = Vec::new();
        for step in &steps.steps {
            let mut parts = state;
            let applied = state.step(&options, &steps.windows, step);
            if let Some(Update { innovation, variance, gain, .. }) = applied.turn {
                parts.mean += gain * innovation;
                parts.covariance -= gain * gain.transpose() * variance;
            }
            let mut predicted = state;
            if let Some(Update { innovation, variance, gain, .. }) = applied.heading {
                predicted.mean -= gain * innovation;
                predicted.covariance += gain * gain.transpose() * variance;
            }
            passed.push((parts, applied.transition.matrix(), predicted));
        }
        let mut smoothed = state;
        for (k, (filtered, f, predicted)) in passed.iter().enumerate().rev() {
            let inverse = predicted.covariance.try_inverse().unwrap();
            let g = filtered.covariance * f.transpose() * inverse;
            smoothed.mean = filtered.mean + g * (smoothed.mean - predicted.mean);
            smoothed.covariance = filtered.covariance
                + g * (smoothed.covariance - predicted.covariance) * g.transpose();
            let ours = &path.estimates[k];
            for row in 0..POSE {
                assert!((ours.pose[row] - smoothed.mean[row]).abs() < 1e-6, "step {k}, row {row}");
                for column in 0..POSE {
                    let theirs = smoothed.covariance[(row, column)];
                    assert!((ours.covariance[(row, column)] - theirs).abs() < 1e-6, "step {k}");
                }
            }
            assert!((ours.gyro_bias_rad_s - smoothed.mean[GYRO_BIAS]).abs() < 1e-7, "step {k}");
        }
    }

    /// Compares F with central differences of the step.
    #[test]
    fn the_transition_is_the_derivative_of_the_step() {
        let (options, steps) = (options(), curved_drive());
        let mut state = State::start(&options, Pose2 { x_m: 1.0, y_m: 2.0, heading_rad: 0.4 });
        // All parameters differ from 0. Without measurements only the prediction is tested.
        for (k, value) in [0.02, -0.03, 0.01, 0.04, 0.1, 0.2, 0.03, -0.02].into_iter().enumerate() {
            state.mean[POSE + k] = value;
        }
        let mut step = steps.steps[40];
        (step.window, step.heading_rad) = (None, None);
        step.motion.dt_secs = 0.5;
        step.motion.distance_m *= 10.0;
        // Equal weights of gyroscope and wheels.
        step.motion.variance.turn_gyro_rad2 = step.motion.variance.turn_wheels_rad2;
        let moved = |nudge: &Vector| {
            let mut state = state;
            state.mean += nudge;
            let applied = state.step(&options, &steps.windows, &step);
            (state.mean, applied.transition.matrix())
        };
        let f = moved(&Vector::zeros()).1;
        for column in 0..crate::filter::N {
            let mut nudge = Vector::zeros();
            nudge[column] = 1e-5;
            let slope = (moved(&nudge).0 - moved(&-nudge).0) / 2e-5;
            // The filter evaluates these derivatives at the mean turn, not at the turn of the
            // wheels.
            let is_at_mean_turn = matches!(column, 4 | 6);
            let tolerance = if is_at_mean_turn { 0.05 } else { 1e-8 };
            let error = (slope - f.column(column)).amax();
            assert!(error < tolerance, "column {column}: {error}");
        }
    }
}
