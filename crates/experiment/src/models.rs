//! The model that is saved for a fitted learner.

use dataset::{FULL_RING_DEG, Keyframe, Label, RangeLimits, Scores};
use evaluate::{Confusion, operating_points};
use model::{FeatureSpec, Measured, Model, OperatingPoint, ScanSpec, Training};

use crate::{CrossValidation, Fitted};

/// What all models of a run share.
#[derive(Debug, Clone)]
pub struct ModelContext {
    /// The run's name. A model is named after it and its learner.
    pub name: String,
    /// The version of the program.
    pub program_version: String,
    /// The run's seed.
    pub seed: u64,
    /// The scans that the models are trained on.
    pub scans: ScanSpec,
    /// The number of training pairs and the digests of their tables and logs.
    pub training: Training,
    /// The options of `label`, as JSON.
    pub label_options: serde_json::Value,
    /// The features of the models.
    pub features: FeatureSpec,
}

/// One model for each learner that can be saved, with the errors and the operating points that
/// cross-validation measured. Baselines have no model.
///
/// The version is that of a first model; `model::save` replaces it by the next free one.
pub fn models(
    context: &ModelContext,
    fitted: &[Fitted],
    validation: &CrossValidation,
    labels: &[Label],
) -> Vec<Model> {
    let saved = fitted.iter().enumerate().filter_map(|(k, fitted)| {
        let boosting = fitted.learner.boosting()?;
        let scores = || validation.scores_of(k);
        Some(Model {
            name: format!("{}-{}", context.name, fitted.learner.name()),
            version: semver::Version::new(1, 0, 0),
            program_version: context.program_version.clone(),
            seed: context.seed,
            features: context.features.clone(),
            scans: context.scans,
            label_options: context.label_options.clone(),
            training: context.training.clone(),
            measured: scores().map(|scores| measured(scores, labels)).collect(),
            operating_points: scores().flat_map(|scores| points(scores, labels)).collect(),
            detector: None,
            classifier: train::classifier(boosting, &fitted.rounds),
        })
    });
    saved.collect()
}

/// The errors after the last round, at threshold 0.
fn measured(scores: &Scores, labels: &[Label]) -> Measured {
    let counts = Confusion::count(labels, scores.after(scores.n_rounds), 0.0);
    Measured {
        grouping: scores.grouping.clone(),
        folds: scores.folds.iter().flatten().max().map_or(0, |fold| fold + 1),
        rounds: scores.n_rounds as u32,
        error: counts.error(),
        precision: counts.precision(),
        recall: counts.recall(),
    }
}

/// The named thresholds after the last round.
fn points(scores: &Scores, labels: &[Label]) -> Vec<OperatingPoint> {
    let confidences: Vec<f64> = scores.after(scores.n_rounds).collect();
    let points = operating_points(labels, &confidences).into_iter().map(|point| {
        let counts = point.point.confusion;
        OperatingPoint {
            name: point.name.to_owned(),
            grouping: scores.grouping.clone(),
            threshold: point.point.threshold,
            precision: counts.precision().unwrap_or(0.0),
            recall: counts.recall(),
            false_alarm: counts.false_alarm(),
        }
    });
    points.collect()
}

/// The scans that a model is trained on: the angles swept by the keyframes, and the widest range
/// limits of the logs.
pub fn scan_spec(keyframes: &[Keyframe], limits: &[RangeLimits]) -> ScanSpec {
    let coverage = keyframes.iter().map(|k| k.coverage_deg);
    let (min, max) = coverage.fold((f32::INFINITY, 0f32), |(a, b), c| (a.min(c), b.max(c)));
    ScanSpec {
        is_ring: FULL_RING_DEG <= min,
        coverage_min_deg: min,
        coverage_max_deg: max,
        range_min_m: limits.iter().map(|l| l.min_m).fold(f64::INFINITY, f64::min),
        range_max_m: limits.iter().map(|l| l.max_m).fold(0.0, f64::max),
    }
}
