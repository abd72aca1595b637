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
    let (consistency_std_m, consistency_std_rad) = consistency(logs);
    Ok(ClosureNoise {
        consistency_std_m,
        consistency_std_rad,
        std_m: within(noise.std_m * scale.sqrt(), STD_M),
        std_rad: within(noise.std_rad * scale.sqrt(), STD_RAD),
        covariance_factor: within(noise.covariance_factor * scale, FACTOR),
    })
}

/// Range of the tolerance for the choice of consistent closures \[m\], \[rad\]. Below 0.05 m and 0.5 deg, the
/// odometry between two closures decides more than the closures; above 0.15 m and 2.5 deg, wrong closures
/// of a neighbouring door or pillar would agree with right ones.
const CONSISTENCY_STD_M: [f64; 2] = [0.05, 0.15];
const CONSISTENCY_STD_RAD: [f64; 2] = [0.008_726_646_259_971_648, 0.043_633_231_299_858_24];
/// Square roots of the 99 % quantiles of the chi-square distribution with 2 and with 1 degrees of
/// freedom: 9.2103 and 6.6349.
const CHI_2_99: f64 = 3.034_854;
const CHI_1_99: f64 = 2.575_829;

/// Standard deviations with which a chi-square test at 99 % keeps 99 % of the right candidates of each
/// log, though their errors are not normal: the 99 % quantiles of the errors over those of chi. Of
/// several logs, the largest counts.
fn consistency(logs: &[Vec<Judged<'_>>]) -> (f64, f64) {
    let of_logs = |error: &dyn Fn(&Judged<'_>) -> f64, [least, most]: [f64; 2]| {
        let quantile = |log: &Vec<Judged<'_>>| {
            let errors: Sample =
                log.iter().filter(|c| is_used(c)).map(|c| (error(c), 1.0)).collect();
            errors.quantile(0.99)
        };
        // `max` ignores the NaN of a log without right candidates.
        logs.iter().map(quantile).fold(least, f64::max).min(most)
    };
    let position = |c: &Judged<'_>| libm::hypot(c.error[0], c.error[1]) / CHI_2_99;
    let heading = |c: &Judged<'_>| c.error[2].abs() / CHI_1_99;
    (of_logs(&position, CONSISTENCY_STD_M), of_logs(&heading, CONSISTENCY_STD_RAD))
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

/// The search starts here. The values are those of a good alignment in a room.
const START: ClosureNoise = ClosureNoise {
    std_m: 0.03,
    std_rad: 0.01,
    covariance_factor: 1.0,
    consistency_std_m: CONSISTENCY_STD_M[0],
    consistency_std_rad: CONSISTENCY_STD_RAD[0],
};

/// The noise with the largest likelihood: a compass search over the logarithms of the three numbers.
fn most_likely(errors: &[Error]) -> ClosureNoise {
    let ranges = [FACTOR, STD_M, STD_RAD];
    let noise = |at: &[f64; 3]| {
        let [covariance_factor, std_m, std_rad] = at.map(libm::exp);
        ClosureNoise { std_m, std_rad, covariance_factor, ..START }
    };
    let loss = |at: &[f64; 3]| {
        let noise = noise(at);
        errors.iter().map(|error| error.weight * error.loss(&noise)).sum::<f64>()
    };
    let mut at = [START.covariance_factor, START.std_m, START.std_rad].map(libm::log);
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

#[cfg(test)]
mod tests {
    use dataset::{Pose2, SplitMix64};
    use model::Evidence;

    use super::*;
    use crate::detector::{FoundCandidate, LogEvidence, judge};

    fn normal(random: &mut SplitMix64) -> f64 {
        let uniform =
            |random: &mut SplitMix64| (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        (0..12).map(|_| uniform(random)).sum::<f64>() - 6.0
    }

    /// Candidates whose covariance by the alignment has standard deviations from 1 to 10 mm and a tenth of
    /// that in rad. The errors have `factor` times that covariance plus constant variances. One in
    /// `outliers` is 0.3 m off.
    fn log(seed: u64, factor: f64, [std_m, std_rad]: [f64; 2], outliers: usize) -> LogEvidence {
        let mut random = SplitMix64::new(seed);
        let candidates = (0..3000usize).map(|k| {
            let of_alignment = 0.001 * (1 + k % 10) as f64;
            let [m2, rad2] = [of_alignment, 0.1 * of_alignment].map(|std| std * std);
            let [x, y] =
                [(); 2].map(|()| (factor * m2 + std_m * std_m).sqrt() * normal(&mut random));
            let heading_rad = (factor * rad2 + std_rad * std_rad).sqrt() * normal(&mut random);
            let off = if k % outliers == 7 { 0.3 } else { 0.0 };
            FoundCandidate {
                query: k as u64,
                rank: 0,
                reference_from_query: Pose2 { x_m: 1.0 + x + off, y_m: y, heading_rad },
                covariance: Matrix3::from_diagonal(&Vector3::new(m2, m2, rad2)),
                evidence: Evidence {
                    overlap: 0.9,
                    known_overlap: 0.9,
                    n_known: 100,
                    conflict: 0.0,
                    margin: 0.5,
                    weakness: 0.5,
                    classifier: None,
                },
                truth: Some(Pose2 { x_m: 1.0, ..Pose2::default() }),
            }
        });
        LogEvidence {
            log: format!("log{seed}"),
            known: Vec::new(),
            odometry_has_covariance: true,
            candidates: candidates.collect(),
        }
    }

    fn fitted(log: &LogEvidence) -> ClosureNoise {
        fit(&[judge(log)]).unwrap()
    }

    /// The errors of the position have variances of 16 x (1 to 10 mm)^2 + (20 mm)^2: both parts matter.
    #[test]
    fn the_factor_and_the_constant_variances_are_found() {
        let found = fitted(&log(1, 16.0, [0.02, 0.004], usize::MAX));
        assert!((found.covariance_factor / 16.0 - 1.0).abs() < 0.15, "{found:?}");
        assert!((found.std_m / 0.02 - 1.0).abs() < 0.15, "{found:?}");
        assert!((found.std_rad / 0.004 - 1.0).abs() < 0.15, "{found:?}");
    }

    /// With 3 % outliers of 0.3 m, the mean normalized error would be larger by about 0.03 x 0.3^2 / 0.04^2
    /// = 1.7 of 3. The fit keeps the covariances of the others: their mean stays near 3.
    #[test]
    fn outliers_do_not_widen_the_covariances() {
        let spoiled = fitted(&log(1, 4.0, [0.03, 0.004], 33));
        let clean = log(1, 4.0, [0.03, 0.004], usize::MAX);
        let judged = judge(&clean);
        let mean = judged.iter().map(|c| Error::new(c, 1.0).normalized(&spoiled)).sum::<f64>()
            / judged.len() as f64;
        assert!((2.5..3.2).contains(&mean), "{mean} {spoiled:?}");
    }

    /// 2 % of the errors are 0.3 m, so the 99 % quantile is about 0.3: 0.3 / 3.035 = 0.099. Without them it
    /// is that of a normal distribution with 0.03 m, below the smallest tolerance.
    #[test]
    fn the_tolerance_keeps_right_candidates_with_large_errors() {
        let with = fitted(&log(1, 1.0, [0.03, 0.004], 50));
        assert!((with.consistency_std_m / 0.099 - 1.0).abs() < 0.15, "{with:?}");
        let without = fitted(&log(1, 1.0, [0.03, 0.004], usize::MAX));
        assert!((without.consistency_std_m - 0.05).abs() < 1e-12, "{without:?}");
        assert!(with.std_m < 0.04, "{with:?}");
    }

    #[test]
    fn few_right_candidates_are_not_enough() {
        let mut log = log(1, 1.0, [0.03, 0.004], usize::MAX);
        log.candidates.truncate(24);
        let missing = fit(&[judge(&log)]).unwrap_err();
        assert_eq!(missing.found, "24 right candidates outside corridors");
    }
}
