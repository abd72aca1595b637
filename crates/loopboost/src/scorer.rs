//! Scores pairs of keyframes with the classifier of a model.

use std::collections::HashMap;

use anyhow::{Result, anyhow};
use dataset::tables::FeatureTable;
use dataset::{FULL_RING_DEG, Keyframe, Note, NoteKind, ScanId, Subject};
use model::Model;

use crate::partitions;
use crate::run::Run;

/// Scores pairs of keyframes.
pub(crate) struct Scorer<'a> {
    model: &'a Model,
    features: FeatureTable,
    /// The row of each keyframe in the features.
    rows: HashMap<ScanId, usize>,
    /// Logs whose scans are of another kind than those that the model was trained on.
    other_kind: Vec<String>,
    /// Remarks about these logs.
    pub(crate) notes: Vec<Note>,
}

impl<'a> Scorer<'a> {
    /// Reads the features of the keyframes.
    pub(crate) fn new(run: &Run, model: &'a Model) -> Result<Self> {
        let features = partitions::features(run)?;
        if features.names != model.features.names {
            return Err(anyhow!(
                "the tables in {} have the columns {}, but the model `{}` needs {}; run `loopboost detect` with --model again",
                run.path("features").display(),
                features.names.join(", "),
                model.name,
                model.features.names.join(", ")
            ));
        }
        let rows = features.ids.iter().cloned().zip(0..).collect();
        let keyframes = partitions::keyframes(run)?;
        let (mut other_kind, mut notes) = (Vec::new(), Vec::new());
        for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
            let is_other = |k: &&Keyframe| {
                model.scans.check(k.coverage_deg, FULL_RING_DEG <= k.coverage_deg).is_err()
            };
            let log = &of_log[0].id.log;
            notes.extend(check_ranges(run, model, log)?);
            let Some(other) = of_log.iter().find(is_other) else { continue };
            let kind = NoteKind::ClassifierNotUsed {
                model: model.name.clone(),
                trained_deg: f64::from(model.scans.coverage_min_deg),
                found_deg: f64::from(other.coverage_deg),
            };
            notes.push(Note::new(kind, Subject::log(&**log)));
            other_kind.push(log.to_string());
        }
        Ok(Self { model, features, rows, other_kind, notes })
    }

    /// Whether the scans of a log are of the kind that the model was trained on.
    pub(crate) fn can_score(&self, log: &str) -> bool {
        !self.other_kind.iter().any(|other| other == log)
    }

    /// Confidence of the classifier for two keyframes. `None` if one of them has no features.
    pub(crate) fn score(&self, a: &ScanId, b: &ScanId) -> Option<f64> {
        let row = |id| Some(self.features.row(*self.rows.get(id)?));
        let (a, b) = (row(a)?, row(b)?);
        let difference: Vec<f64> = a.iter().zip(b).map(|(a, b)| (a - b).abs()).collect();
        Some(self.model.classifier.confidence(&difference))
    }
}

/// A remark, if the scans of a log have other range limits than those that the model was trained on.
fn check_ranges(run: &Run, model: &Model, log: &str) -> Result<Option<Note>> {
    let lidar = run.config.for_log(log)?.lidar;
    Ok(other_ranges(model, lidar.range_min_m, lidar.range_max_m)
        .map(|kind| Note::new(kind, Subject::log(log))))
}

/// A remark, if these range limits are not those of the scans that the model was trained on. Features
/// depend on the limits.
pub(crate) fn other_ranges(model: &Model, min_m: f64, max_m: f64) -> Option<NoteKind> {
    let spec = &model.scans;
    let is_same =
        spec.range_min_m.total_cmp(&min_m).is_eq() && spec.range_max_m.total_cmp(&max_m).is_eq();
    let (trained_min_m, trained_max_m) = (spec.range_min_m, spec.range_max_m);
    (!is_same).then_some(NoteKind::OtherRanges { trained_min_m, trained_max_m, min_m, max_m })
}
