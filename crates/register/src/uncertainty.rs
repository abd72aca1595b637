//! The covariance of the relative pose of two places.

use model::ClosureNoise;
use nalgebra::{Matrix3, Vector3};

use crate::align::{AlignOptions, Alignment};

/// Below this ratio of the smallest to the largest information about the position, the points do not
/// determine one direction: a corridor. The value is a guess. Rooms have 0.2 and more.
const WEAK_RATIO: f64 = 0.1;
/// Standard deviation along a direction without any information \[m\]: a third of the half width of the
/// search by correlation, which is all that limits the position there.
const WEAK_STD_M: f64 = 1.0;
/// Standard deviation of the heading if the points say nothing about it \[rad\].
const UNKNOWN_STD_RAD: f64 = 0.5;

/// Covariance of x, y and heading of the relative pose of two places after an alignment, in the frame
/// of the target.
///
/// 1. The inverse of the information of the points, times the variance of their residuals, times
///    [`ClosureNoise::covariance_factor`]. Before the inverse, the information of a search is added, which
///    found the pose within 1 m and 0.5 rad, so that a direction without any information has a variance,
///    too.
/// 2. Plus the squares of the standard deviations of [`ClosureNoise`].
/// 3. If the ratio r of [`Alignment::weakness`] is below 0.1, the variance along the weak direction
///    grows by `(1 m)^2 (1 - r / 0.1)^2`. In a corridor, every position along it looks the same, and the
///    curvature of the residuals at one of them is too optimistic.
pub fn closure_covariance(
    alignment: &Alignment,
    options: &AlignOptions,
    noise: &ClosureNoise,
) -> Matrix3<f64> {
    let unknown =
        Vector3::new(WEAK_STD_M, WEAK_STD_M, UNKNOWN_STD_RAD).map(|std| 1.0 / (std * std));
    let information = alignment.scaled_information(options) + Matrix3::from_diagonal(&unknown);
    let from_points = information.cholesky().map(|factor| factor.inverse());
    let unknown = || Matrix3::from_diagonal(&unknown.map(|weight| 1.0 / weight));
    let mut covariance = from_points.map_or_else(unknown, |c| c * noise.covariance_factor);
    let least = Vector3::new(noise.std_m, noise.std_m, noise.std_rad).map(|std| std * std);
    covariance += Matrix3::from_diagonal(&least);
    if let Some(weakness) = alignment.weakness.filter(|w| w.ratio < WEAK_RATIO) {
        let (sin, cos) = libm::sincos(weakness.direction_rad);
        let along =
            Vector3::new(cos, sin, 0.0) * (WEAK_STD_M * (1.0 - weakness.ratio / WEAK_RATIO));
        covariance += along * along.transpose();
    }
    covariance
}
