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

/// The weights of covariance intersection that are tried.
const WEIGHTS: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];

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

    /// Both estimates together, by covariance intersection (Julier and Uhlmann 1997, "A non-divergent estimation
    /// algorithm in the presence of unknown correlations"). Alignments of scans that overlap are not
    /// independent, and this result is right for any correlation. Of five weights from 0 to 1, the one with the
    /// smallest standard deviation of the position counts; of equal ones, the largest.
    pub(crate) fn joined(&self, other: &Self) -> Self {
        let weighted = WEIGHTS.map(|weight| self.weighted(other, weight));
        let joined = weighted.into_iter().flatten();
        joined.min_by(|a, b| a.std_m().total_cmp(&b.std_m())).unwrap_or(*other)
    }

    /// The estimate with the sum of the two informations, the other one's with this weight.
    fn weighted(&self, other: &Self, weight: f64) -> Option<Self> {
        let a = self.covariance.try_inverse()? * (1.0 - weight);
        let b = other.covariance.try_inverse()? * weight;
        let covariance = (a + b).try_inverse()?;
        let off = Vector3::new(
            other.pose.x_m - self.pose.x_m,
            other.pose.y_m - self.pose.y_m,
            wrap_angle(other.pose.heading_rad - self.pose.heading_rad),
        );
        let step = covariance * (b * off);
        let pose = Pose2 {
            x_m: self.pose.x_m + step[0],
            y_m: self.pose.y_m + step[1],
            heading_rad: wrap_angle(self.pose.heading_rad + step[2]),
        };
        Some(Self { pose, covariance })
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

    /// Equal estimates know no more together. Of variances 1 and 3 along x, the smaller one remains.
    #[test]
    fn two_estimates_are_joined_without_counting_twice() {
        let one = estimate(1.0, [1.0, 1.0, 1.0]);
        let same = one.joined(&one);
        assert!((same.covariance - one.covariance).abs().max() < 1e-12);
        let both = estimate(0.0, [1.0, 1.0, 1.0]).joined(&estimate(4.0, [3.0, 1.0, 1.0]));
        assert!((both.std_m() - 1.0).abs() < 1e-12 && both.pose.x_m.abs() < 1e-12, "{both:?}");
    }

    /// One knows x, the other y. With equal weights, the informations are (1/0.01 + 1) / 2 along both.
    #[test]
    fn estimates_that_know_different_directions_complete_each_other() {
        let a = estimate(0.0, [0.01, 1.0, 1.0]);
        let both = a.joined(&estimate(1.0, [1.0, 0.01, 1.0]));
        let expected = 2.0 / (100.0 + 1.0);
        for axis in [(0, 0), (1, 1)] {
            assert!((both.covariance[axis] - expected).abs() < 1e-12, "{both:?}");
        }
        // 1 of 101 parts of the weight is that of the other one.
        assert!((both.pose.x_m - 1.0 / 101.0).abs() < 1e-12, "{both:?}");
    }

    /// Variances 4 and 1, turned by 45 deg.
    #[test]
    fn the_worst_direction_counts() {
        let turned = Matrix3::new(2.5, 1.5, 0.0, 1.5, 2.5, 0.0, 0.0, 0.0, 1.0);
        let estimate = Estimate { pose: Pose2::default(), covariance: turned };
        assert!((estimate.std_m() - 2.0).abs() < 1e-12);
        let more = estimate.uncertain(1.5, 0.1);
        assert!((more.std_m() - 2.5).abs() < 1e-12);
        assert!((more.covariance[(2, 2)] - 1.01).abs() < 1e-12);
    }
}
