//! The extended Kalman filter: estimates the state after each step from this and all earlier steps.

use nalgebra::{SMatrix, SVector};

use crate::options::Options;
use crate::steps::{Motion, Step};

/// Number of states: the pose, then the parameters.
pub(crate) const N: usize = POSE + PARAMETERS;
/// Number of pose states: x \[m\], y \[m\] and heading, not wrapped \[rad\].
pub(crate) const POSE: usize = 3;
/// Number of parameters. Each is a constant, a random walk or a Gauss-Markov process; the motion
/// does not change them.
const PARAMETERS: usize = 8;

pub(crate) const HEADING: usize = 2;
pub(crate) const GYRO_BIAS: usize = 3;
pub(crate) const WHEEL_SCALE: usize = 4;
pub(crate) const WHEEL_DIFFERENCE: usize = 5;
pub(crate) const TRACK: usize = 6;
const HEADING_OFFSET: usize = 7;
const HEADING_DRIFT: usize = 8;
const DEVIATION_COS: usize = 9;
const DEVIATION_SIN: usize = 10;

/// Prior standard deviation of the offset between the measured headings and the frame of the poses
/// \[rad\]: the offset is unknown.
const HEADING_OFFSET_STD_RAD: f64 = std::f64::consts::PI;

pub(crate) type Vector = SVector<f64, N>;
pub(crate) type Matrix = SMatrix<f64, N, N>;
/// Derivative of the pose with respect to the parameters.
pub(crate) type PoseByParameters = SMatrix<f64, POSE, PARAMETERS>;

/// Mean and covariance of the state.
#[derive(Debug, Clone, Copy)]
pub(crate) struct State {
    pub(crate) mean: Vector,
    pub(crate) covariance: Matrix,
}

/// The derivative F of the state after a step with respect to the state before:
///
/// ```text
/// F = | A  B |   A = | 1 0 -dy |    B: pose by parameters
///     | 0  D |       | 0 1  dx |    D: diagonal, 1 except for the heading drift
///                    | 0 0  1  |
/// ```
#[derive(Debug, Clone, Copy)]
pub(crate) struct Transition {
    pub(crate) dx_m: f64,
    pub(crate) dy_m: f64,
    pub(crate) by_parameters: PoseByParameters,
    /// Remaining share of the heading drift after the step.
    pub(crate) drift_left: f64,
}

/// A scalar measurement update: its derivative `h` with respect to the state, its innovation, the
/// variance of the innovation and the gain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Update {
    pub(crate) h: Vector,
    pub(crate) innovation: f64,
    pub(crate) variance: f64,
    pub(crate) gain: Vector,
    /// Whether the innovation was beyond the gate and the noise was raised.
    pub(crate) is_outlier: bool,
}

/// The operations of a step on the state, in this order.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Applied {
    pub(crate) turn: Option<Update>,
    pub(crate) transition: Transition,
    pub(crate) heading: Option<Update>,
}

/// The turn of the robot during a motion.
struct Turn {
    /// Measured by the wheels \[rad\].
    by_wheels_rad: f64,
    /// Measured by the gyroscope, without the bias; `None` without IMU samples \[rad\].
    by_gyro_rad: Option<f64>,
    /// Weight of the gyroscope in the mean, 0 to 1; 0 without IMU samples.
    gyro_weight: f64,
    /// Weighted mean of the two \[rad\].
    mean_rad: f64,
    /// Variance of the mean \[rad^2\].
    variance_rad2: f64,
}

impl State {
    /// The state at the first stamp. The pose is exact, because it defines the frame.
    pub(crate) fn start(options: &Options, pose: dataset::Pose2) -> Self {
        let mut std = Vector::zeros();
        std[GYRO_BIAS] = options.gyro_bias_std;
        std[WHEEL_SCALE] = options.wheel_scale_std;
        std[WHEEL_DIFFERENCE] = options.wheel_difference_std;
        std[TRACK] = options.track_std;
        std[HEADING_OFFSET] = HEADING_OFFSET_STD_RAD;
        std[HEADING_DRIFT] = options.heading_drift_std;
        std[DEVIATION_COS] = options.heading_deviation_std;
        std[DEVIATION_SIN] = options.heading_deviation_std;
        let mut mean = Vector::zeros();
        mean.fixed_rows_mut::<POSE>(0).copy_from_slice(&[pose.x_m, pose.y_m, pose.heading_rad]);
        Self { mean, covariance: Matrix::from_diagonal(&std.component_mul(&std)) }
    }

    /// Applies one step; `windows` is [`Steps`](crate::steps::Steps).
    pub(crate) fn step(&mut self, options: &Options, windows: &[Motion], step: &Step) -> Applied {
        let window = step.window.map(|window| &windows[window]);
        let turn = window.and_then(|window| self.measure_turn_difference(options, window));
        let transition = self.predict(options, &step.motion);
        let heading = step.heading_rad.map(|heading| self.measure_heading(options, heading));
        Applied { turn, transition, heading }
    }

    /// The turn measured by wheels and gyroscope.
    ///
    /// The true path of a wheel is its measured path times 1 + s - e (left) or 1 + s + e (right).
    /// The nominal track width over the true track width is 1 + k (differential drive: Borenstein
    /// and Feng 1996, see [`Options::wheel_difference_std`]):
    ///
    /// ```text
    /// turn = (right (1 + s + e) - left (1 + s - e)) (1 + k) / track
    ///      = ((1 + s) difference + 2 e distance) (1 + k) / track
    /// ```
    fn turn(&self, options: &Options, motion: &Motion) -> Turn {
        let [s, e, k] = [WHEEL_SCALE, WHEEL_DIFFERENCE, TRACK].map(|state| self.mean[state]);
        let turned_m = (1.0 + s) * motion.difference_m + 2.0 * e * motion.distance_m;
        let by_wheels_rad = turned_m * (1.0 + k) / options.track_m;
        let variance = &motion.variance;
        let Some(turn_rad) = motion.turn_rad else {
            return Turn {
                by_wheels_rad,
                by_gyro_rad: None,
                gyro_weight: 0.0,
                mean_rad: by_wheels_rad,
                variance_rad2: variance.turn_wheels_rad2 + variance.turn_both_rad2,
            };
        };
        let by_gyro_rad = turn_rad - self.mean[GYRO_BIAS] * motion.dt_secs;
        let gyro_weight =
            variance.turn_wheels_rad2 / (variance.turn_wheels_rad2 + variance.turn_gyro_rad2);
        Turn {
            by_wheels_rad,
            by_gyro_rad: Some(by_gyro_rad),
            gyro_weight,
            mean_rad: gyro_weight * by_gyro_rad + (1.0 - gyro_weight) * by_wheels_rad,
            variance_rad2: gyro_weight * variance.turn_gyro_rad2 + variance.turn_both_rad2,
        }
    }

    /// Compares the turns of gyroscope and wheels. They differ because of the gyroscope bias and
    /// the errors of the wheel parameters.
    ///
    /// Two measurements of one turn with independent errors a and b of the variances p and q have a
    /// difference that is uncorrelated with their mean, weighted by 1/p and 1/q:
    ///
    /// ```text
    /// cov((q a + p b) / (p + q), a - b) = (q p - p q) / (p + q) = 0
    /// ```
    ///
    /// Therefore this update can use the difference for the parameters, and
    /// [`predict`](Self::predict) can use the mean for the pose.
    ///
    /// The derivative is also evaluated at the mean. With the turn of the wheels alone, its error
    /// would correlate with the difference and bias the scale toward 0 (regression dilution; Fuller
    /// 1987, "Measurement error models", sec. 1.1). For the same reason the update is skipped if
    /// the samples are too sparse for the motion and both turns are mostly error.
    fn measure_turn_difference(&mut self, options: &Options, motion: &Motion) -> Option<Update> {
        let turn = self.turn(options, motion);
        let variance = &motion.variance;
        let noise = variance.turn_gyro_rad2 + variance.turn_wheels_rad2;
        let is_resolved = motion.is_still || variance.turn_both_rad2 < noise;
        let by_gyro = turn.by_gyro_rad.filter(|_| is_resolved)?;
        let mut h = Vector::zeros();
        h[GYRO_BIAS] = motion.dt_secs;
        h[WHEEL_SCALE] = turn.mean_rad / (1.0 + self.mean[WHEEL_SCALE]);
        h[WHEEL_DIFFERENCE] = self.turn_by_difference(options, motion);
        h[TRACK] = turn.mean_rad / (1.0 + self.mean[TRACK]);
        Some(self.update(options.gate, h, by_gyro - turn.by_wheels_rad, noise))
    }

    /// Derivative of the turn measured by the wheels with respect to the wheel difference \[rad\].
    fn turn_by_difference(&self, options: &Options, motion: &Motion) -> f64 {
        2.0 * motion.distance_m * (1.0 + self.mean[TRACK]) / options.track_m
    }

    /// Moves the pose along an arc and applies the process noise of the parameters (Thrun, Burgard
    /// and Fox 2005, "Probabilistic Robotics", ch. 5.3 and 7.4; here sinc gives the length of the
    /// chord):
    ///
    /// ```text
    /// x' = x + d sinc(t / 2) cos(heading + t / 2)      d: distance, t: turn
    /// y' = y + d sinc(t / 2) sin(heading + t / 2)
    /// heading' = heading + t
    /// ```
    fn predict(&mut self, options: &Options, motion: &Motion) -> Transition {
        let turn = self.turn(options, motion);
        let (scale, difference) = (self.mean[WHEEL_SCALE], self.mean[WHEEL_DIFFERENCE]);
        let distance = (1.0 + scale) * motion.distance_m + 0.5 * difference * motion.difference_m;

        let (sin, cos) = libm::sincos(self.mean[HEADING] + 0.5 * turn.mean_rad);
        let (sinc, sinc_slope) = sinc(0.5 * turn.mean_rad);
        let (dx_m, dy_m) = (distance * sinc * cos, distance * sinc * sin);
        let by_distance = SVector::<f64, POSE>::new(sinc * cos, sinc * sin, 0.0);
        let by_turn = SVector::<f64, POSE>::new(
            0.5 * distance * (sinc_slope * cos - sinc * sin),
            0.5 * distance * (sinc_slope * sin + sinc * cos),
            1.0,
        );
        let aside = SVector::<f64, POSE>::new(-sin, cos, 0.0);

        let mut distance_by = SMatrix::<f64, 1, PARAMETERS>::zeros();
        distance_by[WHEEL_SCALE - POSE] = motion.distance_m;
        distance_by[WHEEL_DIFFERENCE - POSE] = 0.5 * motion.difference_m;
        let wheels_weight = 1.0 - turn.gyro_weight;
        let mut turn_by = SMatrix::<f64, 1, PARAMETERS>::zeros();
        turn_by[WHEEL_SCALE - POSE] = wheels_weight * turn.mean_rad / (1.0 + scale);
        turn_by[WHEEL_DIFFERENCE - POSE] = wheels_weight * self.turn_by_difference(options, motion);
        turn_by[TRACK - POSE] = wheels_weight * turn.mean_rad / (1.0 + self.mean[TRACK]);
        turn_by[GYRO_BIAS - POSE] = -turn.gyro_weight * motion.dt_secs;
        let transition = Transition {
            dx_m,
            dy_m,
            by_parameters: by_distance * distance_by + by_turn * turn_by,
            drift_left: libm::exp(-motion.dt_secs / options.heading_drift_secs),
        };

        self.mean[0] += dx_m;
        self.mean[1] += dy_m;
        self.mean[HEADING] += turn.mean_rad;
        self.mean[HEADING_DRIFT] *= transition.drift_left;
        transition.apply(&mut self.covariance);
        let mut pose = self.covariance.fixed_view_mut::<POSE, POSE>(0, 0);
        pose += motion.variance.along_m2 * by_distance * by_distance.transpose()
            + motion.variance.aside_m2 * aside * aside.transpose()
            + turn.variance_rad2 * by_turn * by_turn.transpose();
        let walk = options.gyro_bias_walk;
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += walk * walk * motion.dt_secs;
        let std = options.heading_drift_std;
        self.covariance[(HEADING_DRIFT, HEADING_DRIFT)] +=
            std * std * (1.0 - transition.drift_left * transition.drift_left);
        transition
    }

    /// Updates the state with a measured heading. It is the heading in the frame of the poses plus
    /// an offset, a drift, and a deviation that depends on the heading: the coefficients B and C of
    /// the deviation of a compass (NGA, "Handbook of magnetic compass adjustment", Pub. 226).
    pub(crate) fn measure_heading(&mut self, options: &Options, heading_rad: f64) -> Update {
        let mean = &self.mean;
        let (sin, cos) = libm::sincos(mean[HEADING]);
        let expected = mean[HEADING]
            + mean[HEADING_OFFSET]
            + mean[HEADING_DRIFT]
            + mean[DEVIATION_COS] * cos
            + mean[DEVIATION_SIN] * sin;
        let mut h = Vector::zeros();
        h[HEADING] = 1.0 - mean[DEVIATION_COS] * sin + mean[DEVIATION_SIN] * cos;
        h[HEADING_OFFSET] = 1.0;
        h[HEADING_DRIFT] = 1.0;
        h[DEVIATION_COS] = cos;
        h[DEVIATION_SIN] = sin;
        let innovation = dataset::wrap_angle(heading_rad - expected);
        let noise = options.heading_noise_std * options.heading_noise_std;
        self.update(options.gate, h, innovation, noise)
    }

    /// Kalman update with a scalar (Särkkä 2013, "Bayesian filtering and smoothing", eq. 5.27). For
    /// an innovation beyond the gate, the noise is raised until the innovation is at the gate
    /// (Chang 2014, see [`Options::gate`]).
    fn update(&mut self, gate: f64, h: Vector, innovation: f64, noise: f64) -> Update {
        let p_h = self.covariance * h;
        let expected = h.dot(&p_h) + noise;
        let least_variance = innovation * innovation / (gate * gate);
        let is_outlier = expected < least_variance;
        let variance = if is_outlier { least_variance } else { expected };
        let gain = p_h / variance;
        self.mean += gain * innovation;
        // P - P h h' P / s, computed so that the result is exactly symmetric.
        self.covariance.syger(-1.0 / variance, &p_h, &p_h, 1.0);
        self.covariance.fill_upper_triangle_with_lower_triangle();
        Update { h, innovation, variance, gain, is_outlier }
    }
}

impl Transition {
    /// Computes P := F P F', block by block.
    fn apply(&self, covariance: &mut Matrix) {
        let a = self.pose_by_pose();
        let b = &self.by_parameters;
        let pose = covariance.fixed_view::<POSE, POSE>(0, 0).into_owned();
        let cross = covariance.fixed_view::<POSE, PARAMETERS>(0, POSE).into_owned();
        let parameters = covariance.fixed_view::<PARAMETERS, PARAMETERS>(POSE, POSE).into_owned();

        let moved = a * cross + b * parameters; // the cross block of F P, before the factor D
        let corner = (a * pose + b * cross.transpose()) * a.transpose() + moved * b.transpose();
        let corner = 0.5 * (corner + corner.transpose());
        covariance.fixed_view_mut::<POSE, POSE>(0, 0).copy_from(&corner);
        covariance.fixed_view_mut::<POSE, PARAMETERS>(0, POSE).copy_from(&moved);
        covariance.fixed_view_mut::<PARAMETERS, POSE>(POSE, 0).copy_from(&moved.transpose());
        covariance.row_mut(HEADING_DRIFT).scale_mut(self.drift_left);
        covariance.column_mut(HEADING_DRIFT).scale_mut(self.drift_left);
    }

    pub(crate) fn pose_by_pose(&self) -> SMatrix<f64, POSE, POSE> {
        SMatrix::<f64, POSE, POSE>::new(
            1.0, 0.0, -self.dy_m, //
            0.0, 1.0, self.dx_m, //
            0.0, 0.0, 1.0,
        )
    }

    /// The whole matrix F.
    #[cfg(test)]
    pub(crate) fn matrix(&self) -> Matrix {
        let mut f = Matrix::identity();
        f.fixed_view_mut::<POSE, POSE>(0, 0).copy_from(&self.pose_by_pose());
        f.fixed_view_mut::<POSE, PARAMETERS>(0, POSE).copy_from(&self.by_parameters);
        f[(HEADING_DRIFT, HEADING_DRIFT)] = self.drift_left;
        f
    }

    /// Computes F' v.
    pub(crate) fn pull_back(&self, v: &Vector) -> Vector {
        let pose = v.fixed_rows::<POSE>(0);
        let mut pulled = *v;
        pulled[HEADING] += self.dx_m * v[1] - self.dy_m * v[0];
        pulled[HEADING_DRIFT] *= self.drift_left;
        let mut parameters = pulled.fixed_rows_mut::<PARAMETERS>(POSE);
        parameters += self.by_parameters.transpose() * pose;
        pulled
    }

    /// Computes M := F' M F for a symmetric M, block by block.
    pub(crate) fn pull_back_matrix(&self, m: &mut Matrix) {
        let a = self.pose_by_pose();
        let b = &self.by_parameters;
        m.row_mut(HEADING_DRIFT).scale_mut(self.drift_left);
        m.column_mut(HEADING_DRIFT).scale_mut(self.drift_left);
        let pose = m.fixed_view::<POSE, POSE>(0, 0).into_owned();
        let cross = m.fixed_view::<POSE, PARAMETERS>(0, POSE).into_owned();

        let pose_b = pose * b;
        let b_cross = b.transpose() * cross;
        let pulled_cross = a.transpose() * (pose_b + cross);
        let corner = a.transpose() * pose * a;
        m.fixed_view_mut::<POSE, POSE>(0, 0).copy_from(&(0.5 * (corner + corner.transpose())));
        m.fixed_view_mut::<POSE, PARAMETERS>(0, POSE).copy_from(&pulled_cross);
        m.fixed_view_mut::<PARAMETERS, POSE>(POSE, 0).copy_from(&pulled_cross.transpose());
        let mut parameters = m.fixed_view_mut::<PARAMETERS, PARAMETERS>(POSE, POSE);
        parameters += b.transpose() * pose_b + b_cross + b_cross.transpose();
    }
}

/// sin(a) / a and its derivative. Below 1e-4 their series are used, with an error below 1e-17.
fn sinc(a: f64) -> (f64, f64) {
    if a.abs() < 1e-4 {
        return (1.0 - a * a / 6.0, -a / 3.0);
    }
    let (sin, cos) = libm::sincos(a);
    let sinc = sin / a;
    (sinc, (cos - sinc) / a)
}
