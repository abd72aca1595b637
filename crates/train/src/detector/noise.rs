//! Error of the odometry and drift of scan matching, from relative poses over some metres of path.
//!
//! The ground truth has errors, too. Those of two true poses do not depend on the path between them.
//! So the variance of the errors of scan matching over `d` metres is `n + c^2 d`, where `n` is the
//! variance of the truth: the nugget of a variogram (Cressie 1993, "Statistics for Spatial Data", 2.3).
//! The errors of the odometry contain the same `n`.

use dataset::{Pose2, wrap_angle};
use model::{DetectorPart, Drift, OdometryNoise};

use super::sample::covering_std;
use super::{KnownPose, LogEvidence, NotFitted};

/// Path lengths for the error of the odometry \[m\]. The stage `register` uses it over steps of
/// fractions of a metre, but sparse ground truth has a pose every metre only.
const ODOMETRY_PATHS_M: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// Path lengths for the drift of scan matching \[m\].
const DRIFT_PATHS_M: [f64; 5] = [0.5, 1.0, 2.5, 5.0, 10.0];
/// A path may differ from its nominal length by this share.
const PATH_TOLERANCE: f64 = 0.2;
/// Fewer pairs of poses do not give a scale: its 95 % quantile would be the second largest error.
const MIN_PAIRS: usize = 30;

/// Smallest drift. The values are guesses, half of those with which the prototype closed all loops of
/// the training logs: another building may have longer corridors.
const LEAST_DRIFT: Drift = Drift {
    std_m_per_sqrt_m: 0.015,
    // 0.2 deg.
    std_rad_per_sqrt_m: 0.003_490_658_503_988_659,
};

/// Fits the error of the odometry. Of several logs, the largest error over each path length counts.
///
/// The standard deviation over `d` metres is fitted to those of all path lengths by least squares, with
/// both terms 0 or more.
pub(super) fn fit_odometry(logs: &[LogEvidence]) -> Result<OdometryNoise, NotFitted> {
    let logs: Vec<&LogEvidence> = logs.iter().filter(|log| !log.odometry_has_covariance).collect();
    let scales = largest(logs.iter().map(|log| {
        let nugget = drift_of(&scales(&log.known, &DRIFT_PATHS_M, |known| known.matched));
        let mut scales = scales(&log.known, &ODOMETRY_PATHS_M, |known| known.odometry);
        for scale in scales.iter_mut().flatten() {
            let without = |std: f64, variance: f64| (std * std - variance).max(0.0).sqrt();
            let (m2, rad2) =
                nugget.map_or((0.0, 0.0), |nugget| (nugget.truth_m2, nugget.truth_rad2));
            (scale.std_m, scale.std_rad) = (without(scale.std_m, m2), without(scale.std_rad, rad2));
        }
        scales
    }));
    if scales.is_empty() {
        return Err(missing(DetectorPart::Odometry, &logs, &ODOMETRY_PATHS_M));
    }
    let fit = |root: bool, std: fn(&Scale) -> f64| {
        let at = |scale: &Scale| if root { scale.path_m.sqrt() } else { scale.path_m };
        let points: Vec<[f64; 3]> = scales.iter().map(|s| [at(s), std(s), 1.0]).collect();
        line(&points)
    };
    let (std_m, std_m_per_m) = fit(false, |scale| scale.std_m);
    let (std_rad, std_rad_per_sqrt_m) = fit(true, |scale| scale.std_rad);
    let least = OdometryNoise::LEAST;
    Ok(OdometryNoise {
        std_m_per_m: std_m_per_m.max(least.std_m_per_m),
        std_m: std_m.max(least.std_m),
        std_rad_per_sqrt_m: std_rad_per_sqrt_m.max(least.std_rad_per_sqrt_m),
        std_rad: std_rad.max(least.std_rad),
    })
}

/// Fits the drift of scan matching. Of several logs, the one with the largest drift counts.
pub(super) fn fit_drift(logs: &[LogEvidence]) -> Result<Drift, NotFitted> {
    let of_logs = logs
        .iter()
        .filter_map(|log| drift_of(&scales(&log.known, &DRIFT_PATHS_M, |known| known.matched)));
    let largest = of_logs.reduce(|a, b| LogDrift {
        m2_per_m: a.m2_per_m.max(b.m2_per_m),
        rad2_per_m: a.rad2_per_m.max(b.rad2_per_m),
        ..a
    });
    let Some(drift) = largest else {
        let logs: Vec<&LogEvidence> = logs.iter().collect();
        return Err(missing(DetectorPart::Drift, &logs, &DRIFT_PATHS_M));
    };
    Ok(Drift {
        std_m_per_sqrt_m: drift.m2_per_m.sqrt().max(LEAST_DRIFT.std_m_per_sqrt_m),
        std_rad_per_sqrt_m: drift.rad2_per_m.sqrt().max(LEAST_DRIFT.std_rad_per_sqrt_m),
    })
}

fn missing(part: DetectorPart, logs: &[&LogEvidence], paths_m: &[f64]) -> NotFitted {
    let n_known: usize = logs.iter().map(|log| log.known.len()).sum();
    let [first, .., last] = paths_m else { unreachable!("there are several path lengths") };
    let of = match part {
        DetectorPart::Odometry => "odometry without covariances",
        _ => "scan-matched poses",
    };
    NotFitted {
        part,
        found: format!("{n_known} poses with ground truth, in {} logs with {of}", logs.len()),
        expected: format!(
            "a log with {MIN_PAIRS} pairs of them over each of two path lengths from {first} to {last} m"
        ),
    }
}

/// Errors over one path length.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Scale {
    /// Mean path \[m\].
    path_m: f64,
    /// Standard deviation along and across.
    std_m: f64,
    /// Standard deviation of the heading.
    std_rad: f64,
}

/// The errors over each path length. `None` where a log has too few pairs.
fn scales<const N: usize>(
    known: &[KnownPose],
    paths_m: &[f64; N],
    pose: fn(&KnownPose) -> Pose2,
) -> [Option<Scale>; N] {
    paths_m.map(|path_m| {
        let pairs = pairs(known, path_m);
        if pairs.len() < MIN_PAIRS {
            return None;
        }
        let errors: Vec<[f64; 3]> = pairs
            .iter()
            .map(|&[a, b]| {
                let step =
                    |pose: fn(&KnownPose) -> Pose2| pose(&known[a]).inverse() * pose(&known[b]);
                let (step, truth) = (step(pose), step(|known| known.truth));
                let heading = wrap_angle(step.heading_rad - truth.heading_rad);
                [step.x_m - truth.x_m, step.y_m - truth.y_m, heading]
            })
            .collect();
        let std = |k: usize| covering_std(errors.iter().map(|error| error[k]));
        let paths = pairs.iter().map(|&[a, b]| known[b].path_m - known[a].path_m);
        Some(Scale {
            path_m: paths.sum::<f64>() / pairs.len() as f64,
            std_m: std(0).max(std(1)),
            std_rad: std(2),
        })
    })
}

/// For each pose, the pose of the same piece that is nearest to `path_m` later on the path.
fn pairs(known: &[KnownPose], path_m: f64) -> Vec<[usize; 2]> {
    let ahead = |a: usize| {
        let tolerance_m = PATH_TOLERANCE * path_m;
        let off = |b: &usize| (known[*b].path_m - known[a].path_m - path_m).abs();
        let nearest = (a + 1..known.len())
            .take_while(|&b| {
                known[b].piece == known[a].piece
                    && known[b].path_m - known[a].path_m <= path_m + tolerance_m
            })
            .min_by(|b, c| off(b).total_cmp(&off(c)))?;
        (off(&nearest) <= tolerance_m).then_some([a, nearest])
    };
    (0..known.len()).filter_map(ahead).collect()
}

/// The largest errors of all logs over each path length.
fn largest<const N: usize>(logs: impl Iterator<Item = [Option<Scale>; N]>) -> Vec<Scale> {
    let mut largest = [None::<Scale>; N];
    for scales in logs {
        // One path length does not show how errors grow.
        if scales.iter().flatten().count() < 2 {
            continue;
        }
        for (of_all, scale) in largest.iter_mut().zip(scales) {
            *of_all = match (*of_all, scale) {
                (Some(a), Some(b)) => Some(Scale {
                    path_m: a.path_m,
                    std_m: a.std_m.max(b.std_m),
                    std_rad: a.std_rad.max(b.std_rad),
                }),
                (a, b) => a.or(b),
            };
        }
    }
    largest.into_iter().flatten().collect()
}

/// Variances of a log: of the truth, and their growth per metre of path.
#[derive(Debug, Clone, Copy)]
struct LogDrift {
    truth_m2: f64,
    truth_rad2: f64,
    m2_per_m: f64,
    rad2_per_m: f64,
}

/// `None` if fewer than two path lengths have enough pairs.
fn drift_of(scales: &[Option<Scale>]) -> Option<LogDrift> {
    let scales: Vec<Scale> = scales.iter().copied().flatten().collect();
    if scales.len() < 2 {
        return None;
    }
    let fit = |std: fn(&Scale) -> f64| {
        let point = |scale: &Scale| {
            let variance = std(scale) * std(scale);
            // Relative errors count: those of a variance grow with it.
            [scale.path_m, variance, 1.0 / (variance * variance).max(f64::MIN_POSITIVE)]
        };
        line(&scales.iter().map(point).collect::<Vec<_>>())
    };
    let (truth_m2, m2_per_m) = fit(|scale| scale.std_m);
    let (truth_rad2, rad2_per_m) = fit(|scale| scale.std_rad);
    Some(LogDrift { truth_m2, truth_rad2, m2_per_m, rad2_per_m })
}

/// The line `y = a + b x` with `a` and `b` 0 or more that fits points (x, y, weight) best, by weighted
/// least squares. Returns `a` and `b`. All x are positive.
fn line(points: &[[f64; 3]]) -> (f64, f64) {
    // Weights relative to the largest one, so that their sums do not overflow.
    let largest = points.iter().fold(0.0f64, |largest, [_, _, w]| largest.max(*w));
    let sum = |f: fn(f64, f64) -> f64| points.iter().map(|[x, y, w]| w / largest * f(*x, *y)).sum();
    let [w, x, y, xx, xy]: [f64; 5] =
        [sum(|_, _| 1.0), sum(|x, _| x), sum(|_, y| y), sum(|x, _| x * x), sum(|x, y| x * y)];
    let determinant = w * xx - x * x;
    if 0.0 < determinant {
        let (a, b) = ((xx * y - x * xy) / determinant, (w * xy - x * y) / determinant);
        if 0.0 <= a && 0.0 <= b {
            return (a, b);
        }
        if b < 0.0 {
            return (y / w, 0.0);
        }
    }
    (0.0, xy / xx)
}

#[cfg(test)]
mod tests {
    use dataset::SplitMix64;

    use super::*;

    /// A normal random number: the sum of 12 uniform ones.
    fn normal(random: &mut SplitMix64) -> f64 {
        let uniform =
            |random: &mut SplitMix64| (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        (0..12).map(|_| uniform(random)).sum::<f64>() - 6.0
    }

    fn at(x_m: f64, y_m: f64, heading_rad: f64) -> Pose2 {
        Pose2 { x_m, y_m, heading_rad }
    }

    /// 2000 poses, 0.25 m apart, on a circle. `noise` gives the errors of a step of the odometry and of
    /// scan matching; `truth_m` and `truth_rad` are the errors of the ground truth.
    fn drive(
        seed: u64,
        noise: impl Fn(&mut SplitMix64) -> [Pose2; 2],
        [truth_m, truth_rad]: [f64; 2],
    ) -> LogEvidence {
        let mut random = SplitMix64::new(seed);
        let step = at(0.25, 0.0, 0.02);
        let [mut truth, mut odometry, mut matched] = [Pose2::default(); 3];
        let known = (0..2000).map(|k| {
            let [of_odometry, of_matching] = noise(&mut random);
            truth = truth * step;
            odometry = odometry * step * of_odometry;
            matched = matched * step * of_matching;
            let [x, y, h] = [truth_m, truth_m, truth_rad].map(|std| std * normal(&mut random));
            let path_m = 0.25 * f64::from(k);
            KnownPose { piece: 0, path_m, odometry, matched, truth: truth * at(x, y, h) }
        });
        LogEvidence {
            log: format!("log{seed}"),
            known: known.collect(),
            odometry_has_covariance: false,
            candidates: Vec::new(),
        }
    }

    fn random_pose(random: &mut SplitMix64, std_m: f64, std_rad: f64) -> Pose2 {
        at(std_m * normal(random), std_m * normal(random), std_rad * normal(random))
    }

    /// Scan matching: steps of 0.25 m with errors of 0.02 m and 0.002 rad, so sqrt(4) times as much per
    /// sqrt(m), 0.04 m and 0.004 rad. Turned headings move the position as well: over 10 m by about 0.004
    /// sqrt(10) x 10 / sqrt(3) = 0.073 m, compared with 0.04 sqrt(10) = 0.126 m, which makes 0.046 m per
    /// sqrt(m) of 0.04. Between two true poses, the truth has sqrt(2) times the error of one.
    #[test]
    fn drift_is_found_below_the_noise_of_the_truth() {
        let noise = |random: &mut SplitMix64| {
            [random_pose(random, 0.02, 0.01), random_pose(random, 0.02, 0.002)]
        };
        for truth in [[0.0, 0.0], [0.05, 0.01]] {
            let logs = [drive(1, noise, truth)];
            let drift = fit_drift(&logs).unwrap();
            assert!((0.036..0.055).contains(&drift.std_m_per_sqrt_m), "{drift:?}");
            assert!((0.003..0.0052).contains(&drift.std_rad_per_sqrt_m), "{drift:?}");
            let scales = scales(&logs[0].known, &DRIFT_PATHS_M, |known| known.matched);
            let found = drift_of(&scales).unwrap().truth_m2.sqrt();
            assert!((found - truth[0] * 2f64.sqrt()).abs() < 0.02, "{found}");
        }
    }

    /// The heading of the odometry turns by 0.05 rad too much per metre, and 0.1 m are 0.103 m. Over d
    /// metres, the position is off by 0.03 d, and by 0.05 d^2 / 2 to the side: up to 0.1 m over 2 m.
    #[test]
    fn odometry_that_turns_too_much_has_an_error_that_covers_it() {
        let noise =
            |random: &mut SplitMix64| [at(0.0075, 0.0, 0.0125), random_pose(random, 0.001, 0.0001)];
        let fitted = fit_odometry(&[drive(1, noise, [0.0, 0.0])]).unwrap();
        for d in [0.25, 0.5, 1.0, 2.0f64] {
            let std_rad = fitted.std_rad + fitted.std_rad_per_sqrt_m * d.sqrt();
            assert!((0.6 * 0.05 * d..0.05 * d + 0.035).contains(&std_rad), "{d} m: {std_rad}");
            let std_m = fitted.std_m + fitted.std_m_per_m * d;
            assert!((0.015 * d..0.05 * d + 0.02).contains(&std_m), "{d} m: {std_m}");
        }
    }

    #[test]
    fn the_noisiest_log_decides() {
        let quiet = |random: &mut SplitMix64| [random_pose(random, 0.01, 0.001); 2];
        let noisy = |random: &mut SplitMix64| [random_pose(random, 0.03, 0.004); 2];
        let [quiet, noisy] = [drive(1, quiet, [0.0; 2]), drive(2, noisy, [0.0; 2])];
        let both = [quiet.clone(), noisy.clone()];
        assert_eq!(fit_drift(&both), fit_drift(std::slice::from_ref(&noisy)));
        assert_eq!(fit_odometry(&both), fit_odometry(std::slice::from_ref(&noisy)));
        assert_ne!(fit_drift(&both), fit_drift(std::slice::from_ref(&quiet)));
    }

    /// 3 % of the true poses are 2 m off.
    #[test]
    fn outliers_of_the_truth_do_not_count() {
        let noise = |random: &mut SplitMix64| [random_pose(random, 0.02, 0.002); 2];
        let clean = drive(1, noise, [0.01, 0.001]);
        let mut spoiled = clean.clone();
        for known in spoiled.known.iter_mut().step_by(67) {
            known.truth.x_m += 2.0;
        }
        let [a, b] = [clean, spoiled].map(|log| fit_drift(&[log]).unwrap().std_m_per_sqrt_m);
        assert!((b / a - 1.0).abs() < 0.2, "{a} {b}");
    }

    #[test]
    fn odometry_with_covariances_is_not_fitted() {
        let noise = |random: &mut SplitMix64| [random_pose(random, 0.02, 0.002); 2];
        let fused = LogEvidence { odometry_has_covariance: true, ..drive(1, noise, [0.0; 2]) };
        let missing = fit_odometry(std::slice::from_ref(&fused)).unwrap_err();
        assert_eq!(missing.part, DetectorPart::Odometry);
        assert_eq!(
            missing.found,
            "0 poses with ground truth, in 0 logs with odometry without covariances"
        );
        assert!(fit_drift(&[fused]).is_ok());
    }

    #[test]
    fn poses_of_two_pieces_are_not_compared() {
        let noise = |_: &mut SplitMix64| [Pose2::default(); 2];
        let mut log = drive(1, noise, [0.0; 2]);
        for (k, known) in log.known.iter_mut().enumerate() {
            known.piece = k as u32 / 3;
        }
        // Pieces of 3 poses have pairs over 0.25 m and 0.5 m.
        assert_eq!(pairs(&log.known, 0.25).len(), 1333);
        assert_eq!(pairs(&log.known, 0.5).len(), 666);
        assert_eq!(pairs(&log.known, 1.0).len(), 0);
    }

    /// y = 1 + 2 x; y falls, so the slope is 0 and the constant the mean; the line through (1, 0) and
    /// (2, 2) starts below 0, so the slope is that through the origin: (1 x 0 + 2 x 2) / (1 + 4).
    #[test]
    fn lines_do_not_go_below_zero() {
        assert_eq!(line(&[[1.0, 3.0, 1.0], [2.0, 5.0, 1.0]]), (1.0, 2.0));
        assert_eq!(line(&[[1.0, 3.0, 1.0], [2.0, 1.0, 1.0]]), (2.0, 0.0));
        assert_eq!(line(&[[1.0, 0.0, 1.0], [2.0, 2.0, 1.0]]), (0.0, 0.8));
    }
}
