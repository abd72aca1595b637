//! The verifier: confidence from evidence.

use model::{Detector, DetectorPart, Evidence, Verifier, VerifierMeasures};

use super::logistic::{Logistic, Row};
use super::sample::Sample;
use super::{Judged, NotFitted};

/// Fewer right or wrong candidates do not determine five weights: a rule of thumb for logistic
/// regression is 10 rows of the rarer class per weight (Peduzzi et al. 1996); the penalty and the fixed
/// signs make half of it enough.
const MIN_OF_EACH: usize = 25;
/// Share of the right candidates that the smallest confidence keeps.
const KEPT: f64 = 0.99;
/// The smallest confidence is at least this, and at most one half. Below, the optimization would have to
/// choose among mostly wrong candidates; above, right candidates of another building would be lost.
const LEAST_CONFIDENCE: f64 = 0.05;
const MOST_CONFIDENCE: f64 = 0.5;

/// Fitted verifiers.
pub(super) struct Verifiers {
    pub(super) verifier: Verifier,
    pub(super) without_classifier: Verifier,
    pub(super) measures: VerifierMeasures,
}

/// Fits both verifiers to the candidates of all logs. The one with the classifier is fitted to those
/// that have its confidence. If none has, both are the same.
pub(super) fn fit(logs: &[Vec<Judged<'_>>]) -> Result<Verifiers, NotFitted> {
    let all: Vec<&Judged<'_>> = logs.iter().flatten().collect();
    let is_classified = |c: &&&Judged<'_>| c.found.evidence.classifier.is_some();
    let classified: Vec<&Judged<'_>> = all.iter().filter(is_classified).copied().collect();
    check_counts(&all)?;
    let without_classifier = verifier(Logistic::fit(&rows(&all, without)));
    if check_counts(&classified).is_err() {
        let measures = VerifierMeasures {
            log_loss: log_loss(&without_classifier, &all),
            log_loss_without_classifier: log_loss(&without_classifier, &all),
            log_loss_of_share: log_loss_of_share(&all),
            n_with_classifier: classified.len() as u32,
        };
        return Ok(Verifiers { verifier: without_classifier, without_classifier, measures });
    }
    let with = verifier(Logistic::fit(&rows(&classified, with_classifier)));
    // Compared on the same candidates.
    let alone = verifier(Logistic::fit(&rows(&classified, without)));
    let measures = VerifierMeasures {
        log_loss: log_loss(&with, &classified),
        log_loss_without_classifier: log_loss(&alone, &classified),
        log_loss_of_share: log_loss_of_share(&classified),
        n_with_classifier: classified.len() as u32,
    };
    Ok(Verifiers { verifier: with, without_classifier, measures })
}

/// The largest threshold that keeps 99 % of the right candidates, within limits.
pub(super) fn min_confidence(logs: &[Vec<Judged<'_>>], detector: &Detector) -> f64 {
    let right = logs.iter().flatten().filter(|c| c.is_right);
    let confidences: Sample =
        right.map(|c| (detector.confidence(&c.found.evidence), c.weight)).collect();
    confidences.quantile(1.0 - KEPT).clamp(LEAST_CONFIDENCE, MOST_CONFIDENCE)
}

fn check_counts(candidates: &[&Judged<'_>]) -> Result<(), NotFitted> {
    let n_right = candidates.iter().filter(|c| c.is_right).count();
    let n_wrong = candidates.len() - n_right;
    if MIN_OF_EACH <= n_right.min(n_wrong) {
        return Ok(());
    }
    Err(NotFitted {
        part: DetectorPart::Verifier,
        found: format!("{n_right} right and {n_wrong} wrong candidates"),
        expected: format!("{MIN_OF_EACH} or more of each"),
    })
}

/// Features that speak for a closure. What speaks against it has the opposite sign, so that all weights
/// are 0 or more.
fn without(evidence: &Evidence) -> [f64; 4] {
    [evidence.overlap, evidence.known_overlap, -evidence.conflict, evidence.margin]
}

fn with_classifier(evidence: &Evidence) -> [f64; 5] {
    let [overlap, known_overlap, conflict, margin] = without(evidence);
    [overlap, known_overlap, conflict, margin, evidence.classifier.unwrap_or(0.0)]
}

fn rows<const N: usize>(
    candidates: &[&Judged<'_>],
    features: fn(&Evidence) -> [f64; N],
) -> Vec<Row<N>> {
    let row = |c: &&Judged<'_>| Row {
        features: features(&c.found.evidence),
        is_positive: c.is_right,
        weight: c.weight,
    };
    candidates.iter().map(row).collect()
}

fn verifier<const N: usize>(fitted: Logistic<N>) -> Verifier {
    let weight = |k: usize| fitted.weights.get(k).copied().unwrap_or(0.0);
    Verifier {
        intercept: fitted.intercept,
        overlap: weight(0),
        known_overlap: weight(1),
        conflict: -weight(2),
        margin: weight(3),
        classifier: weight(4),
    }
}

fn log_loss(verifier: &Verifier, candidates: &[&Judged<'_>]) -> f64 {
    let Verifier { intercept, overlap, known_overlap, conflict, margin, classifier } = *verifier;
    let weights = [overlap, known_overlap, -conflict, margin, classifier];
    Logistic { intercept, weights }.log_loss(&rows(candidates, with_classifier))
}

fn log_loss_of_share(candidates: &[&Judged<'_>]) -> f64 {
    let sum = |of: &dyn Fn(&Judged<'_>) -> bool| {
        candidates.iter().filter(|c| of(c)).map(|c| c.weight).sum::<f64>()
    };
    let (right, wrong) = (sum(&|c| c.is_right), sum(&|c| !c.is_right));
    Logistic { intercept: libm::log(right / wrong), weights: [] }
        .log_loss(&rows(candidates, |_| []))
}
