//! Whether covariances have the size of the errors.

use dataset::{Pose2, quantile, wrap_angle};
use serde::Serialize;

/// 97.5 % quantile of the normal distribution.
const NORMAL_97_5: f64 = 1.959_963_985;
/// Median of the chi-square distribution with 3 degrees of freedom.
const CHI_SQUARE_3_MEDIAN: f64 = 2.365_973_884;

/// Normalized errors of poses: for right covariances, each is chi-square distributed with 3 degrees of
/// freedom, and their mean is 3.
///
/// The bounds assume that the errors are independent. Closures between the same two stretches of road
/// share scans, and poses of a trajectory share their past. Then the mean scatters more than the bounds
/// say.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// Number of poses.
    pub n: usize,
    /// Poses without a usable covariance, which are not among them.
    pub n_without_covariance: usize,
    /// Mean of the normalized squared errors e^T C^-1 e (NEES). 3 is right; more means that the
    /// covariances are too small.
    pub mean: f64,
    /// Lower 95 % bound of the mean for right covariances.
    pub low: f64,
    /// Upper 95 % bound of the mean for right covariances.
    pub high: f64,
    /// Factor on the covariances that makes the mean right: the mean divided by 3.
    pub factor: f64,
    /// Factor on the covariances that makes the median right. A few large errors do not change it.
    pub median_factor: f64,
}

impl Calibration {
    /// `None` if no pose has a usable covariance. An entry is `None` where a pose has none.
    pub(crate) fn new(normalized: impl Iterator<Item = Option<f64>>) -> Option<Self> {
        let (mut values, mut n_without_covariance) = (Vec::new(), 0);
        for value in normalized {
            match value {
                Some(value) => values.push(value),
                None => n_without_covariance += 1,
            }
        }
        if values.is_empty() {
            return None;
        }
        values.sort_by(f64::total_cmp);
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        Some(Self {
            n: values.len(),
            n_without_covariance,
            mean,
            low: chi_square_quantile(3.0 * n, -NORMAL_97_5) / n,
            high: chi_square_quantile(3.0 * n, NORMAL_97_5) / n,
            factor: mean / 3.0,
            median_factor: quantile(&values, 0.5) / CHI_SQUARE_3_MEDIAN,
        })
    }

    /// Whether the mean is within its 95 % bounds.
    pub fn is_within_bounds(&self) -> bool {
        self.low <= self.mean && self.mean <= self.high
    }
}

/// A quantile of the chi-square distribution, by the approximation of Wilson and Hilferty (1931): the
/// cube root of chi-square / k is nearly normal, with mean 1 - 2 / (9 k) and variance 2 / (9 k).
///
/// `normal` is the quantile of the normal distribution for the same probability, such as 1.96 for
/// 97.5 %. The error is below 0.04 from 3 degrees of freedom, and below 0.02 from 30.
///
/// ```
/// // From a table: 10 degrees of freedom, 97.5 %: 20.483.
/// assert!((evaluate::detection::chi_square_quantile(10.0, 1.96) - 20.483).abs() < 0.04);
/// ```
pub fn chi_square_quantile(degrees_of_freedom: f64, normal: f64) -> f64 {
    let k = degrees_of_freedom;
    let root = 1.0 - 2.0 / (9.0 * k) + normal * (2.0 / (9.0 * k)).sqrt();
    k * root.max(0.0).powi(3)
}

/// The normalized squared error e^T C^-1 e of a pose with covariance C, where e is the difference of x,
/// y and heading. `None` if the covariance is not positive definite.
pub fn normalized_error(estimate: Pose2, truth: Pose2, covariance: &[f64; 6]) -> Option<f64> {
    let error = [
        estimate.x_m - truth.x_m,
        estimate.y_m - truth.y_m,
        wrap_angle(estimate.heading_rad - truth.heading_rad),
    ];
    let [xx, xy, xh, yy, yh, hh] = *covariance;
    // Cholesky: C = L L^T, and the sum of the squares of L^-1 e.
    let l_xx = positive_root(xx)?;
    let (l_yx, l_hx) = (xy / l_xx, xh / l_xx);
    let l_yy = positive_root(yy - l_yx * l_yx)?;
    let l_hy = (yh - l_hx * l_yx) / l_yy;
    let l_hh = positive_root(hh - l_hx * l_hx - l_hy * l_hy)?;
    let x = error[0] / l_xx;
    let y = (error[1] - l_yx * x) / l_yy;
    let h = (error[2] - l_hx * x - l_hy * y) / l_hh;
    Some(x * x + y * y + h * h)
}

fn positive_root(square: f64) -> Option<f64> {
    (0.0 < square && square.is_finite()).then(|| square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of a table of the chi-square distribution: degrees of freedom, 2.5 %, 97.5 %.
    #[test]
    fn quantiles_agree_with_a_table() {
        for (k, low, high, most) in [
            (3.0, 0.2158, 9.3484, 0.04),
            (10.0, 3.2470, 20.4832, 0.03),
            (30.0, 16.7908, 46.9792, 0.02),
            (100.0, 74.2219, 129.5612, 0.01),
        ] {
            let found = [-NORMAL_97_5, NORMAL_97_5].map(|z| chi_square_quantile(k, z));
            assert!((found[0] - low).abs() < most, "{k}: {} {low}", found[0]);
            assert!((found[1] - high).abs() < most, "{k}: {} {high}", found[1]);
        }
        // The median with 3 degrees of freedom.
        assert!((chi_square_quantile(3.0, 0.0) - CHI_SQUARE_3_MEDIAN).abs() < 0.02);
    }

    /// With C = diag(4, 9, 0.25), the error (2, -3, 1) gives 1 + 1 + 4. With the correlated C below, the
    /// inverse of [[2, 1], [1, 1]] is [[1, -1], [-1, 2]]: the error (3, 1) gives 9 - 6 + 2 = 5.
    #[test]
    fn normalized_errors_computed_by_hand() {
        let truth = Pose2 { x_m: 1.0, y_m: 1.0, heading_rad: 3.0 };
        let pose = |x: f64, y: f64, h: f64| Pose2 {
            x_m: 1.0 + x,
            y_m: 1.0 + y,
            heading_rad: wrap_angle(3.0 + h),
        };
        let found = normalized_error(pose(2.0, -3.0, 1.0), truth, &[4.0, 0.0, 0.0, 9.0, 0.0, 0.25]);
        assert!((found.unwrap() - 6.0).abs() < 1e-12);
        let correlated = [2.0, 1.0, 0.0, 1.0, 0.0, 1.0];
        let found = normalized_error(pose(3.0, 1.0, 0.0), truth, &correlated);
        assert!((found.unwrap() - 5.0).abs() < 1e-12);
        assert_eq!(normalized_error(truth, truth, &[1.0, 2.0, 0.0, 1.0, 0.0, 1.0]), None);
        assert_eq!(normalized_error(truth, truth, &[0.0; 6]), None);
    }

    /// Errors twice as large as the covariances say have normalized errors 4 times as large.
    #[test]
    fn the_factor_is_by_how_much_covariances_are_too_small() {
        // The quantiles of chi-square with 3 degrees of freedom stand for a right sample.
        let sample: Vec<f64> = (1..200)
            .map(|k| {
                let z = f64::from(k) / 200.0;
                // Inverse of the logistic approximation of the normal distribution function.
                chi_square_quantile(3.0, (z / (1.0 - z)).ln() / 1.702)
            })
            .collect();
        let right = Calibration::new(sample.iter().copied().map(Some)).unwrap();
        assert!(right.is_within_bounds(), "{right:?}");
        assert!((right.factor - 1.0).abs() < 0.1 && (right.median_factor - 1.0).abs() < 0.02);
        let values = sample.iter().map(|value| Some(4.0 * value)).chain([None]);
        let small = Calibration::new(values).unwrap();
        assert_eq!((small.n, small.n_without_covariance), (199, 1));
        assert!((small.factor / right.factor - 4.0).abs() < 1e-9 && !small.is_within_bounds());
        assert_eq!(Calibration::new([None].into_iter()), None);
    }
}
