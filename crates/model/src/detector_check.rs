//! Checks the values of a detector.

use std::collections::BTreeSet;

use crate::{DETECTOR_VERSION, Detector, Verifier};

/// Largest number of compared places. A larger number is a typing error.
const MAX_CANDIDATES: u32 = 1000;

/// Largest standard deviation of a position \[m\], and per metre or per sqrt(m). The values of real
/// robots are below 1.
const MAX_STD_M: f64 = 10.0;

/// Largest standard deviation of a heading \[rad\], and per sqrt(m). Half a turn: the heading is
/// unknown.
const MAX_STD_RAD: f64 = std::f64::consts::PI;

/// Largest factor of a covariance.
const MAX_FACTOR: f64 = 1e6;

/// Checks every value. The error contains the name of the value, the value, and what was expected.
pub(crate) fn check_detector(detector: &Detector) -> Result<(), String> {
    let Detector { odometry, drift, closure, strong, .. } = detector;
    if detector.version != DETECTOR_VERSION {
        let found = detector.version;
        return Err(format!("detector.version: {found}, expected {DETECTOR_VERSION}"));
    }
    // Without a constant part, a step of length 0 would have no error at all.
    for (name, std, max) in [
        ("odometry.std_m", odometry.std_m, MAX_STD_M),
        ("odometry.std_rad", odometry.std_rad, MAX_STD_RAD),
        ("drift.std_m_per_sqrt_m", drift.std_m_per_sqrt_m, MAX_STD_M),
        ("drift.std_rad_per_sqrt_m", drift.std_rad_per_sqrt_m, MAX_STD_RAD),
        ("closure.std_m", closure.std_m, MAX_STD_M),
        ("closure.std_rad", closure.std_rad, MAX_STD_RAD),
        ("closure.consistency_std_m", closure.consistency_std_m, MAX_STD_M),
        ("closure.consistency_std_rad", closure.consistency_std_rad, MAX_STD_RAD),
        ("closure.covariance_factor", closure.covariance_factor, MAX_FACTOR),
    ] {
        if !(0.0 < std && std <= max) {
            return Err(format!("detector.{name}: {std}, expected more than 0 and up to {max}"));
        }
    }
    for (name, value, max) in [
        ("odometry.std_m_per_m", odometry.std_m_per_m, MAX_STD_M),
        ("odometry.std_rad_per_sqrt_m", odometry.std_rad_per_sqrt_m, MAX_STD_RAD),
        ("min_confidence", detector.min_confidence, 1.0),
        ("strong.known_overlap", strong.known_overlap, 1.0),
        ("strong.conflict", strong.conflict, 1.0),
    ] {
        if !(0.0..=max).contains(&value) {
            return Err(format!("detector.{name}: {value}, expected 0 to {max}"));
        }
    }
    if !(1..=MAX_CANDIDATES).contains(&detector.n_candidates) {
        let found = detector.n_candidates;
        return Err(format!("detector.n_candidates: {found}, expected 1 to {MAX_CANDIDATES}"));
    }
    check_verifier("verifier", &detector.verifier)?;
    check_verifier("verifier_without_classifier", &detector.verifier_without_classifier)?;
    let without = detector.verifier_without_classifier.classifier;
    if 0.0 < without {
        return Err(format!(
            "detector.verifier_without_classifier.classifier: {without}, expected 0"
        ));
    }
    check_origin(detector)
}

/// More of what speaks for a closure must not lower its confidence.
fn check_verifier(name: &str, verifier: &Verifier) -> Result<(), String> {
    let Verifier { intercept, overlap, known_overlap, conflict, margin, classifier } = *verifier;
    if !intercept.is_finite() {
        return Err(format!("detector.{name}.intercept: {intercept}, expected a finite number"));
    }
    for (field, weight) in [
        ("overlap", overlap),
        ("known_overlap", known_overlap),
        ("margin", margin),
        ("classifier", classifier),
    ] {
        if !(0.0 <= weight && weight.is_finite()) {
            return Err(format!("detector.{name}.{field}: {weight}, expected 0 or more"));
        }
    }
    if !(conflict <= 0.0 && conflict.is_finite()) {
        return Err(format!("detector.{name}.conflict: {conflict}, expected 0 or less"));
    }
    Ok(())
}

/// Checks the measures, the parts without a fit, and the logs.
fn check_origin(detector: &Detector) -> Result<(), String> {
    if let Some(measured) = &detector.measured {
        for (name, loss) in [
            ("log_loss", measured.log_loss),
            ("log_loss_without_classifier", measured.log_loss_without_classifier),
            ("log_loss_of_share", measured.log_loss_of_share),
        ] {
            if !(0.0 <= loss && loss.is_finite()) {
                return Err(format!("detector.measured.{name}: {loss}, expected 0 or more"));
            }
        }
    }
    if !detector.not_fitted.is_sorted_by(|a, b| a < b) {
        let names: Vec<&str> = detector.not_fitted.iter().map(|part| part.name()).collect();
        return Err(format!(
            "detector.not_fitted: {}, expected each part once and in the order of the format",
            names.join(", ")
        ));
    }
    let mut names = BTreeSet::new();
    for (k, log) in detector.logs.iter().enumerate() {
        if log.log.is_empty() {
            return Err(format!("detector.logs[{k}].log: empty, expected the name of a log"));
        }
        if !names.insert(&*log.log) {
            return Err(format!("detector.logs[{k}].log: `{}` is a duplicate", log.log));
        }
    }
    Ok(())
}
