//! Error of the relative pose of a closure.

use model::{ClosureNoise, DetectorPart};
use nalgebra::{Matrix3, Vector3};

use super::sample::Sample;
use super::{Judged, NotFitted};

/// Fewer errors do not determine three numbers.
const MIN_RIGHT: usize = 25;
/// Degrees of freedom of the t distribution. With 4, an error of 5 standard deviations counts about a
/// third of what it would count for a normal distribution (Lange, Little and Taylor 1989).
const T_DEGREES: f64 = 4.0;
/// Median of the chi-square distribution with 3 degrees of freedom.
const CHI_SQUARE_3_MEDIAN: f64 = 2.365_973_884_375_338;
/// Range of the factor of the covariance.
const FACTOR: [f64; 2] = [0.1, 1000.0];
/// Range of the smallest standard deviations \[m\], \[rad\]. The lower ends are a tenth of a square of the
/// grid that normals come from, and 0.05 deg; the upper ones are half of what counts as right.
const STD_M: [f64; 2] = [0.008, 0.25];
const STD_RAD: [f64; 2] = [0.000_872_664_625_997_164_8, 0.04];

/// Fits the covariance of the alignment times a factor, plus a constant, to the errors of right
/// candidates.
///
/// The three numbers maximize the likelihood of a multivariate t distribution, which few large errors
/// hardly change. Then all variances are scaled so that the median of the normalized squared errors is
/// that of a chi-square distribution with 3 degrees of freedom. For normal errors, their mean is then 3.
///
/// Candidates in corridors do not count: their covariance has a part that no alignment measures.
pub(super) fn fit(logs: &[Vec<Judged<'_>>]) -> Result<ClosureNoise, NotFitted> {
    let n_of_log = |log: &[Judged<'_>]| log.iter().filter(|c| is_used(c)).count() as f64;
    let errors: Vec<Error> = logs
        .iter()
        .flat_map(|log| {
            let weight = 1.0 / n_of_log(log).max(1.0);
            log.iter().filter(|c| is_used(c)).map(move |c| Error::new(c, weight))
        })
        .collect();
    if errors.len() < MIN_RIGHT {
        return Err(NotFitted {
            part: DetectorPart::Closure,
            found: format!("{} right candidates outside corridors", errors.len()),
            expected: format!("{MIN_RIGHT} or more"),
        });
    }
    let noise = most_likely(&errors);
    let normalized: Sample =
        errors.iter().map(|error| (error.normalized(&noise), error.weight)).collect();
    let scale = normalized.quantile(0.5) / CHI_SQUARE_3_MEDIAN;
    let within = |value: f64, [least, most]: [f64; 2]| value.clamp(least, most);
    Ok(ClosureNoise {
        std_m: within(noise.std_m * scale.sqrt(), STD_M),
        std_rad: within(noise.std_rad * scale.sqrt(), STD_RAD),
        covariance_factor: within(noise.covariance_factor * scale, FACTOR),
    })
}

fn is_used(candidate: &Judged<'_>) -> bool {
    candidate.is_right && !candidate.is_degenerate()
}

struct Error {
    error: Vector3<f64>,
    covariance: Matrix3<f64>,
    weight: f64,
}

impl Error {
    fn new(candidate: &Judged<'_>, weight: f64) -> Self {
        let covariance = candidate.found.covariance;
        Self { error: Vector3::from(candidate.error), covariance, weight }
    }

    fn total(&self, noise: &ClosureNoise) -> Matrix3<f64> {
        let constant = Vector3::new(noise.std_m, noise.std_m, noise.std_rad).map(|std| std * std);
        self.covariance * noise.covariance_factor + Matrix3::from_diagonal(&constant)
    }

    /// e^T C^-1 e. Infinite if the covariance is not positive definite.
    fn normalized(&self, noise: &ClosureNoise) -> f64 {
        let cholesky = self.total(noise).cholesky();
        cholesky.map_or(f64::INFINITY, |c| self.error.dot(&c.solve(&self.error)))
    }

    /// Negative log likelihood of the t distribution, without constants.
    fn loss(&self, noise: &ClosureNoise) -> f64 {
        let Some(cholesky) = self.total(noise).cholesky() else { return f64::INFINITY };
        let normalized = self.error.dot(&cholesky.solve(&self.error));
        let log_determinant: f64 =
            cholesky.l_dirty().diagonal().iter().map(|v| 2.0 * libm::log(*v)).sum();
        0.5 * log_determinant + 0.5 * (T_DEGREES + 3.0) * libm::log1p(normalized / T_DEGREES)
    }
}

/// The noise with the largest likelihood: a compass search over the logarithms of the three numbers.
fn most_likely(errors: &[Error]) -> ClosureNoise {
    let ranges = [FACTOR, STD_M, STD_RAD];
    let noise = |at: &[f64; 3]| {
        let [covariance_factor, std_m, std_rad] = at.map(libm::exp);
        ClosureNoise { std_m, std_rad, covariance_factor }
    };
    let loss = |at: &[f64; 3]| {
        let noise = noise(at);
        errors.iter().map(|error| error.weight * error.loss(&noise)).sum::<f64>()
    };
    let mut at = [1.0, 0.03, 0.01].map(libm::log);
    let mut best = loss(&at);
    let mut step = 1.0;
    while 1e-3 < step {
        let mut moved = false;
        for k in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut next = at;
                let [least, most] = ranges[k].map(libm::log);
                next[k] = (next[k] + sign * step).clamp(least, most);
                let value = loss(&next);
                if value < best {
                    (at, best, moved) = (next, value, true);
                }
            }
        }
        if !moved {
            step *= 0.5;
        }
    }
    noise(&at)
}
