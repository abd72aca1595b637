//! The numbers of the report as JSON.

use dataset::{Label, Losses, Note, Retrieval};
use serde_json::{Value, json};

use crate::detection::{DriveMeasures, SiteMeasures};
use crate::text::{PAPER_ERROR_BELOW, PAPER_ROUNDS};
use crate::{Evaluation, Input};

/// All numbers except the curves, which are in the tables.
pub fn json(name: &str, input: &Input<'_>, evaluation: &Evaluation) -> Value {
    let count = |label| input.pairs.iter().filter(|pair| pair.label == label).count();
    let mut logs: Vec<&str> = input.keyframes.iter().map(|k| &*k.id.log).collect();
    logs.dedup();
    let errors =
        evaluation.errors.iter().filter(|row| input.is_boosted(&row.learner) || row.rounds == 1);
    let grid = input.grid.iter().map(|cell| {
        json!({
            "learner": cell.learner,
            "grouping": cell.grouping,
            "positive_radius_m": cell.positive_radius_m,
            "negative_min_m": cell.negative_min_m,
            "min_travel_gap_m": cell.min_travel_gap_m,
            "error": cell.error.as_ref().ok(),
            "reason": cell.error.as_ref().err(),
        })
    });
    json!({
        "name": name,
        "logs": logs,
        "keyframes": input.keyframes.len(),
        "pairs": { "positive": count(Label::Positive), "negative": count(Label::Negative) },
        "spread": evaluation.spreads,
        "validated_on_unseen_ground": evaluation.is_validated_on_unseen_ground(),
        "resamples": input.resamples,
        "left_out": input.not_evaluated,
        "summary": evaluation.summaries,
        "errors": errors.map(|row| json!({
            "learner": row.learner,
            "grouping": row.grouping,
            "rounds": row.rounds,
            "error": row.confusion.error(),
            "precision": row.confusion.precision(),
            "recall": row.confusion.recall(),
        })).collect::<Vec<_>>(),
        "retrieval": input.retrieval.iter().map(retrieval).collect::<Vec<_>>(),
        "features": input.feature_usefulness.iter().map(|row| json!({
            "feature": row.name,
            "auc": row.auc,
            "stability": row.stability,
            "chosen": row.chosen,
        })).collect::<Vec<_>>(),
        "grid": grid.collect::<Vec<_>>(),
        "detection": evaluation.detection,
        "sites": evaluation.sites,
        "losses": input.losses,
        "notes": input.notes,
        "paper": { "learners": ["discrete", "gentle"], "rounds": PAPER_ROUNDS, "error_below": PAPER_ERROR_BELOW },
    })
}

/// The numbers of [`crate::closure_report`].
pub fn closure_json(
    name: &str,
    measures: &[DriveMeasures],
    sites: &[SiteMeasures],
    losses: &Losses,
    notes: &[Note],
) -> Value {
    json!({ "name": name, "detection": measures, "sites": sites, "losses": losses, "notes": notes })
}

fn retrieval(row: &Retrieval) -> Value {
    json!({
        "learner": row.learner,
        "grouping": row.grouping,
        "log": row.log,
        "ambiguous_as_negative": row.ambiguous_as_negative,
        "n_positive": row.n_positive,
        "n_negative": row.n_negative,
        "n_ambiguous": row.n_ambiguous,
        "n_unscored": row.n_unscored,
        "query_stride": row.query_stride,
        "average_precision": row.average_precision,
        "recall_at_full_precision": row.recall_at_full_precision,
        "detection_at_1_percent": row.detection_at_1_percent,
        "max_f1": row.max_f1,
    })
}
