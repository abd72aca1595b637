//! A pose with its covariance, moved along and compared with the map.

use dataset::{Pose2, wrap_angle};
use model::Drift;
use nalgebra::{Matrix3, Vector3};

/// A pose in the map with the covariance of x, y and heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Estimate {
    pub(crate) pose: Pose2,
    pub(crate) covariance: Matrix3<f64>,
}

/// The derivative of `pose * step` with respect to `pose`.
fn derivative(pose: &Pose2, step: &Pose2) -> Matrix3<f64> {
    let (sin, cos) = libm::sincos(pose.heading_rad);
    let (x, y) = (cos * step.x_m - sin * step.y_m, sin * step.x_m + cos * step.y_m);
    Matrix3::new(1.0, 0.0, -y, 0.0, 1.0, x, 0.0, 0.0, 1.0)
}

impl Estimate {
    /// The estimate with its covariance given in the frame of a place that is turned by `heading_rad`.
    pub(crate) fn turned(pose: Pose2, covariance: &Matrix3<f64>, heading_rad: f64) -> Self {
        let (sin, cos) = libm::sincos(heading_rad);
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        Self { pose, covariance: turn * covariance * turn.transpose() }
    }

    /// The estimate after a step. Without error, a pose that is not moved keeps its covariance.
    pub(crate) fn moved(&self, step: &Pose2, drift: &Drift) -> Self {
        let derivative = derivative(&self.pose, step);
        let mut covariance = derivative * self.covariance * derivative.transpose();
        let path_m = step.distance_m(&Pose2::default());
        let std_m2 = drift.std_m_per_sqrt_m * drift.std_m_per_sqrt_m * path_m;
        let std_rad2 = drift.std_rad_per_sqrt_m * drift.std_rad_per_sqrt_m * path_m;
        covariance += Matrix3::from_diagonal(&Vector3::new(std_m2, std_m2, std_rad2));
        Self { pose: self.pose * *step, covariance }
    }

    /// The estimate with a further independent error of each coordinate and of the heading.
    pub(crate) fn uncertain(&self, std_m: f64, std_rad: f64) -> Self {
        let variances = Vector3::new(std_m, std_m, std_rad).map(|std| std * std);
        Self { pose: self.pose, covariance: self.covariance + Matrix3::from_diagonal(&variances) }
    }

    /// Standard deviation of the position along its worst direction \[m\].
    pub(crate) fn std_m(&self) -> f64 {
        let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|entry| self.covariance[entry]);
        libm::sqrt((xx + yy) / 2.0 + libm::hypot((xx - yy) / 2.0, xy))
    }

    /// Both estimates together, by covariance intersection with equal weights (Julier and Uhlmann 1997, "A
    /// non-divergent estimation algorithm in the presence of unknown correlations"). Alignments of scans
    /// that overlap are not independent, and this result is right for any correlation.
    pub(crate) fn joined(&self, other: &Self) -> Self {
        let information = |estimate: &Self| estimate.covariance.try_inverse();
        let Some((a, b)) = information(self).zip(information(other)) else { return *other };
        let Some(covariance) = ((a + b) * 0.5).try_inverse() else { return *other };
        let off = Vector3::new(
            other.pose.x_m - self.pose.x_m,
            other.pose.y_m - self.pose.y_m,
            wrap_angle(other.pose.heading_rad - self.pose.heading_rad),
        );
        let step = covariance * (b * 0.5 * off);
        let pose = Pose2 {
            x_m: self.pose.x_m + step[0],
            y_m: self.pose.y_m + step[1],
            heading_rad: wrap_angle(self.pose.heading_rad + step[2]),
        };
        Self { pose, covariance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_DRIFT: Drift = Drift { std_m_per_sqrt_m: 0.0, std_rad_per_sqrt_m: 0.0 };

    fn estimate(x_m: f64, variances: [f64; 3]) -> Estimate {
        let pose = Pose2 { x_m, ..Pose2::default() };
        Estimate { pose, covariance: Matrix3::from_diagonal(&Vector3::from(variances)) }
    }

    /// 2 m ahead, a heading error of variance 0.01 is one of 4 * 0.01 across.
    #[test]
    fn an_error_of_the_heading_becomes_one_of_the_position() {
        let step = Pose2 { x_m: 2.0, ..Pose2::default() };
        let moved = estimate(0.0, [0.1, 0.1, 0.01]).moved(&step, &NO_DRIFT);
        assert!((moved.covariance[(1, 1)] - 0.14).abs() < 1e-12, "{moved:?}");
        assert!((moved.covariance[(0, 0)] - 0.1).abs() < 1e-12, "{moved:?}");
        assert!((moved.covariance[(1, 2)] - 0.02).abs() < 1e-12, "{moved:?}");
    }

    /// Equal estimates know no more together. Variances 1 and 3: information (1 + 1/3) / 2 = 2/3, and the
    /// weights of the means are 3 to 1.
    #[test]
    fn two_estimates_are_joined_without_counting_twice() {
        let one = estimate(1.0, [1.0, 1.0, 1.0]);
        let same = one.joined(&one);
        assert!((same.covariance - one.covariance).abs().max() < 1e-12);
        let both = estimate(0.0, [1.0, 1.0, 1.0]).joined(&estimate(4.0, [3.0, 1.0, 1.0]));
        assert!((both.covariance[(0, 0)] - 1.5).abs() < 1e-12);
        assert!((both.pose.x_m - 1.0).abs() < 1e-12);
    }
}
