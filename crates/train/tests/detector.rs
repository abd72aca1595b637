//! A detector fitted to simulated candidates, whose best values are known.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use dataset::{Pose2, SplitMix64};
use model::{Detector, DetectorPart, Evidence};
use nalgebra::Matrix3;
use train::detector::{FoundCandidate, LogEvidence, alignment_covariance, closure_covariance, fit};

fn uniform(random: &mut SplitMix64) -> f64 {
    (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// A candidate with this evidence. A wrong one is 2 m off, a right one 1 cm.
fn candidate(query: u64, rank: u32, is_right: bool, evidence: Evidence) -> FoundCandidate {
    let off = if is_right { 0.01 } else { 2.0 };
    FoundCandidate {
        query,
        rank,
        reference_from_query: Pose2 { x_m: 1.0 + off, ..Pose2::default() },
        covariance: Matrix3::identity() * 1e-6,
        evidence,
        truth: Some(Pose2 { x_m: 1.0, ..Pose2::default() }),
    }
}

fn evidence(overlap: f64, known_overlap: f64, conflict: f64) -> Evidence {
    Evidence {
        overlap,
        known_overlap,
        n_known: 100,
        conflict,
        margin: 0.0,
        weakness: 0.5,
        classifier: None,
    }
}

/// Candidates that are right with the probability of a logistic function: -4 + 6 overlap - 10 conflict +
/// classifier. The known overlap says nothing.
fn log(seed: u64, n: u64) -> LogEvidence {
    let mut random = SplitMix64::new(seed);
    let candidates = (0..n).map(|k| {
        let [overlap, known_overlap, share] = [(); 3].map(|()| uniform(&mut random));
        let (conflict, classifier) = (0.3 * share, 4.0 * uniform(&mut random) - 2.0);
        let sum = -4.0 + 6.0 * overlap - 10.0 * conflict + classifier;
        let is_right = uniform(&mut random) < 1.0 / (1.0 + (-sum).exp());
        let evidence =
            Evidence { classifier: Some(classifier), ..evidence(overlap, known_overlap, conflict) };
        candidate(k / 5, (k % 5) as u32, is_right, evidence)
    });
    LogEvidence {
        log: format!("log{seed}"),
        known: Vec::new(),
        odometry_has_covariance: true,
        candidates: candidates.collect(),
    }
}

/// The penalty of 0.001 makes the weights a few percent smaller.
#[test]
fn the_verifier_of_simulated_candidates_is_found() {
    let fitted = fit(&[log(1, 20_000), log(2, 5_000)]).detector;
    let verifier = fitted.verifier;
    assert!((4.8..6.4).contains(&verifier.overlap), "{verifier:?}");
    assert!(verifier.known_overlap < 0.3, "{verifier:?}");
    assert!((-10.8..-7.5).contains(&verifier.conflict), "{verifier:?}");
    assert!((0.85..1.1).contains(&verifier.classifier), "{verifier:?}");
    assert!(verifier.margin.abs() < 1e-12, "the margin is constant: {verifier:?}");
    let without = fitted.verifier_without_classifier;
    assert!(without.classifier.abs() < 1e-12 && 3.0 < without.overlap, "{without:?}");
    let measured = fitted.measured.unwrap();
    assert!(measured.log_loss < measured.log_loss_without_classifier - 0.02, "{measured:?}");
    assert!(measured.log_loss_without_classifier < measured.log_loss_of_share, "{measured:?}");
    assert_eq!(measured.n_with_classifier, 25_000);
}

/// Of the right candidates of both logs, each log counting half, 1 % have a smaller confidence.
#[test]
fn the_smallest_confidence_keeps_99_percent_of_the_right_candidates() {
    let logs = [log(1, 4_000), log(2, 1_000)];
    let fitted = fit(&logs).detector;
    let kept_of = |log: &LogEvidence| {
        let right = |c: &&FoundCandidate| c.reference_from_query.x_m < 1.5;
        let confidences: Vec<f64> =
            log.candidates.iter().filter(right).map(|c| fitted.confidence(&c.evidence)).collect();
        let n_kept = confidences.iter().filter(|&&c| fitted.min_confidence <= c).count();
        n_kept as f64 / confidences.len() as f64
    };
    let kept = logs.each_ref().map(kept_of);
    // 0.05 is the smallest value that is allowed.
    let mean = 0.5 * (kept[0] + kept[1]);
    assert!(0.985 < mean || (fitted.min_confidence - 0.05).abs() < 1e-12, "{kept:?} {fitted:?}");
    assert!((0.05..=0.5).contains(&fitted.min_confidence));
}

#[test]
fn the_same_logs_give_the_same_bits() {
    let fitted = || fit(&[log(1, 2_000), log(2, 1_000)]);
    assert_eq!(format!("{:?}", fitted()), format!("{:?}", fitted()));
    assert_ne!(fitted(), fit(&[log(1, 2_000), log(3, 1_000)]));
}

fn of(candidates: Vec<FoundCandidate>) -> LogEvidence {
    LogEvidence { candidates, ..log(1, 0) }
}

/// Wrong candidates have a known overlap of up to 0.70 with conflicts of 0.05, and of up to 0.80 with
/// conflicts of 0.15. Right ones have 0.75 to 0.95 and conflicts of 0.02. A known overlap of 0.73 excludes
/// the first by more than 0.02, and a conflict of 0.12 the second. The next laxer limits, 0.72 and 0.13, are
/// exactly 0.02 away. Smaller known overlaps with conflicts of 0.02 keep all right candidates, too, but
/// accept a smaller range: 0.5 x 0.02 instead of 0.27 x 0.12.
#[test]
fn strong_limits_exclude_every_wrong_candidate() {
    let wrong = (0..60u64).map(|k| {
        let low = evidence(0.4, 0.70 - 0.005 * k as f64, 0.05);
        let high = evidence(0.4, 0.805 - 0.005 * k as f64, 0.15);
        candidate(k, 0, false, if k % 2 == 0 { low } else { high })
    });
    let right = (0..100u64)
        .map(|k| candidate(100 + k, 0, true, evidence(0.8, 0.75 + 0.002 * k as f64, 0.02)));
    let log = of(wrong.chain(right).collect());
    let strong = fit(std::slice::from_ref(&log)).detector.strong;
    assert!((strong.known_overlap - 0.73).abs() < 1e-9, "{strong:?}");
    assert!((strong.conflict - 0.12).abs() < 1e-9, "{strong:?}");
    let accepted = |c: &&FoundCandidate| strong.accept(&c.evidence);
    assert_eq!(log.candidates.iter().filter(accepted).count(), 100);
}

/// Two wrong candidates have the evidence of the best right ones. The limits tolerate them, because no
/// right candidate would reach other limits.
#[test]
fn strong_limits_stay_useful_if_some_wrong_candidates_have_the_best_evidence() {
    let wrong = (0..60u64).map(|k| {
        let is_perfect = k < 2;
        let found = if is_perfect { evidence(1.0, 1.0, 0.0) } else { evidence(0.3, 0.4, 0.1) };
        candidate(k, 0, false, found)
    });
    let right = (0..50u64).map(|k| candidate(100 + k, 0, true, evidence(0.8, 0.9, 0.02)));
    let log = of(wrong.chain(right).collect());
    let strong = fit(std::slice::from_ref(&log)).detector.strong;
    let n_right = log.candidates[60..].iter().filter(|c| strong.accept(&c.evidence)).count();
    assert_eq!(n_right, 50, "{strong:?}");
}

/// 90 of 100 places have their right candidate at rank 0, 9 at rank 5, and 1 at rank 9: 6 candidates find
/// 99 %, 5 find 90 %.
#[test]
fn enough_places_are_compared_to_find_the_right_ones() {
    let right = (0..100u64).map(|k| {
        let rank = match k {
            0..90 => 0,
            90..99 => 5,
            _ => 9,
        };
        candidate(k, rank, true, evidence(0.8, 0.9, 0.02))
    });
    let fitted = fit(&[of(right.collect())]);
    assert_eq!(fitted.detector.n_candidates, 6);
}

/// A log with `n` places. The last `n_late` find their right candidate at rank 8, the others at rank 0.
fn with_late_places(n: u64, n_late: u64) -> LogEvidence {
    let of_place =
        |k| candidate(k, if k < n - n_late { 0 } else { 8 }, true, evidence(0.8, 0.9, 0.02));
    of((0..n).map(of_place).collect())
}

/// One of 24 places of a short log is found late, which is within the standard error. 8 of 36 are not. Where a
/// log has a single place, which counts as much as all of the other log, the standard error says nothing.
#[test]
fn a_single_place_of_a_short_log_adds_no_candidates() {
    for (first, second, expected) in [
        (with_late_places(24, 1), with_late_places(36, 0), 3),
        (with_late_places(24, 1), with_late_places(36, 8), 9),
        (with_late_places(1, 0), with_late_places(24, 2), 9),
    ] {
        assert_eq!(fit(&[first, second]).detector.n_candidates, expected);
    }
}

/// Without wrong candidates, nothing is known about how much evidence they can have.
#[test]
fn without_wrong_candidates_the_decisions_keep_their_starting_values() {
    let right = (0..100).map(|k| candidate(k, 0, true, evidence(0.8, 0.9, 0.02)));
    let fitted = fit(&[of(right.collect())]);
    let start = Detector::starting_values();
    assert_eq!(fitted.detector.verifier, start.verifier);
    assert_eq!(fitted.detector.strong, start.strong);
    assert_eq!(fitted.detector.measured, None);
    let parts: Vec<DetectorPart> = fitted.not_fitted.iter().map(|missing| missing.part).collect();
    use DetectorPart::{Drift, Odometry, Strong, Verifier};
    assert_eq!(parts, [Odometry, Drift, Verifier, Strong]);
    assert_eq!(fitted.detector.not_fitted, parts);
    assert_eq!(fitted.not_fitted[2].found, "100 right and 0 wrong candidates");
    assert_eq!(fitted.not_fitted[2].expected, "25 or more of each");
}

/// 60 candidates are 0.7 m off: neither right nor wrong. The true pose of 40 is not known.
#[test]
fn candidates_in_doubt_are_left_out() {
    let found = (0..100).map(|k| {
        let mut found = candidate(k, 0, true, evidence(0.8, 0.9, 0.02));
        found.reference_from_query.x_m = 1.7;
        if k < 40 {
            found.truth = None;
        }
        found
    });
    let fitted = fit(&[of(found.collect())]);
    assert_eq!((fitted.detector.logs[0].n_right, fitted.detector.logs[0].n_wrong), (0, 0));
    assert_eq!(fitted.not_fitted.len(), 6);
}

#[test]
fn the_covariance_of_an_alignment_comes_back() {
    let mut detector = Detector::starting_values();
    detector.closure.covariance_factor = 3.0;
    let alignment = Matrix3::new(0.5, 0.125, 0.0, 0.125, 0.25, -0.0625, 0.0, -0.0625, 0.75);
    let of_candidate = closure_covariance(&alignment, &detector);
    // 3 x 0.5 + 0.12^2.
    assert!((of_candidate[(0, 0)] - 1.5144).abs() < 1e-12);
    assert!((alignment_covariance(&of_candidate, &detector) - alignment).norm() < 1e-12);
}
