//! `evaluation/*.parquet`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int8Array, StringArray, UInt32Array, UInt64Array};
use dataset::tables::{Provenance, Result, batch, floats, strings, write_table};
use dataset::{BoostingRound, FeatureUsefulness};

use crate::detection::write_detection;
use crate::{Confusion, ErrorRow, Evaluation, Input, Mistake, PrCurve, Summary};

/// Writes `summary`, `errors`, `precision_recall`, `selection`, `features` and `mistakes` to a folder
/// and returns their paths. If loop closures were searched, the files of [`write_detection`] follow.
///
/// | table | a row is | columns |
/// |---|---|---|
/// | `summary` | a measure of a learner after the last round | `learner`, `grouping`, `rounds`, `folds`, `groups`, `measure` (`error`, `average_precision`, `recall_at_full_precision`, `detection_at_1_percent`, `max_f1`), `value`, `low` and `high` (the 95 % interval; null with too few groups, and where a bootstrap cannot estimate it) |
/// | `errors` | a learner after T rounds | `learner`, `grouping`, `rounds`, `error`, `precision` (null if no pair is classified as positive), `recall`, and the four counts |
/// | `precision_recall` | a threshold | `learner`, `grouping`, `rounds`, `threshold`, `precision`, `recall`, `false_alarm` |
/// | `selection` | a round of a fit | `learner`, `grouping`, `fold`, `other_fold` (null if trained on all pairs), `round`, `feature`, `threshold`, `weighted_error`, `error` (cross-validated, after this round; only if trained on all pairs) |
/// | `features` | a feature | `feature`, `auc` (of the feature alone), `stability` (how much the feature changes when every other return of a scan is removed: median, relative to its interquartile range), `chosen` (number of splits of all models that use it) |
/// | `mistakes` | a misclassified pair, the most confident first | `learner`, `grouping`, the scans of the pair, `label`, `confidence`, `distance_m` |
pub fn write_tables(
    folder: &Path,
    provenance: &Provenance,
    input: &Input<'_>,
    evaluation: &Evaluation,
) -> Result<Vec<PathBuf>> {
    let tables = [
        summary(&evaluation.summaries),
        errors(&evaluation.errors),
        precision_recall(&evaluation.precision_recall),
        selection(input.rounds, &evaluation.errors),
        features(input.feature_usefulness),
        mistakes(input, &evaluation.mistakes),
    ];
    let mut written = Vec::new();
    for table in tables {
        let path = folder.join(format!("{}.parquet", table.name));
        let batch = batch(table.columns, table.nullable);
        write_table(&path, table.name, provenance, &batch)?;
        written.push(path);
    }
    if !input.detection.is_empty() {
        let (drives, measures) = (input.detection, &evaluation.detection);
        written.extend(write_detection(folder, provenance, drives, measures)?);
    }
    Ok(written)
}

struct Table {
    name: &'static str,
    columns: Vec<(&'static str, ArrayRef)>,
    /// Names of the columns that may contain null.
    nullable: &'static [&'static str],
}

fn numbers(values: impl Iterator<Item = u32>) -> ArrayRef {
    Arc::new(UInt32Array::from_iter_values(values))
}

fn counts(values: impl Iterator<Item = usize>) -> ArrayRef {
    Arc::new(UInt64Array::from_iter_values(values.map(|n| n as u64)))
}

fn optional_floats(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    Arc::new(values.collect::<Float64Array>())
}

fn summary(summaries: &[Summary]) -> Table {
    let rows = || {
        let with_measures = |s| Summary::measures(s).map(|(name, estimate)| (s, name, estimate));
        summaries.iter().flat_map(with_measures)
    };
    let bound = |end: usize| {
        optional_floats(rows().map(|(_, _, estimate)| estimate.interval.map(|bounds| bounds[end])))
    };
    Table {
        name: "summary",
        columns: vec![
            ("learner", strings(rows().map(|(s, _, _)| &*s.learner))),
            ("grouping", strings(rows().map(|(s, _, _)| &*s.grouping))),
            ("rounds", numbers(rows().map(|(s, _, _)| s.rounds as u32))),
            ("folds", numbers(rows().map(|(s, _, _)| s.folds))),
            ("groups", numbers(rows().map(|(s, _, _)| s.groups as u32))),
            ("measure", strings(rows().map(|(_, name, _)| name))),
            ("value", floats(rows().map(|(_, _, estimate)| estimate.value))),
            ("low", bound(0)),
            ("high", bound(1)),
        ],
        nullable: &["low", "high"],
    }
}

fn errors(rows: &[ErrorRow]) -> Table {
    let count = |of: fn(&Confusion) -> usize| counts(rows.iter().map(|r| of(&r.confusion)));
    Table {
        name: "errors",
        columns: vec![
            ("learner", strings(rows.iter().map(|r| &*r.learner))),
            ("grouping", strings(rows.iter().map(|r| &*r.grouping))),
            ("rounds", numbers(rows.iter().map(|r| r.rounds as u32))),
            ("error", floats(rows.iter().map(|r| r.confusion.error()))),
            ("precision", optional_floats(rows.iter().map(|r| r.confusion.precision()))),
            ("recall", floats(rows.iter().map(|r| r.confusion.recall()))),
            ("true_positive", count(|c| c.true_positive)),
            ("false_positive", count(|c| c.false_positive)),
            ("true_negative", count(|c| c.true_negative)),
            ("false_negative", count(|c| c.false_negative)),
        ],
        nullable: &["precision"],
    }
}

fn precision_recall(curves: &[PrCurve]) -> Table {
    let rows = || curves.iter().flat_map(|c| c.points.iter().map(move |p| (c, p)));
    Table {
        name: "precision_recall",
        columns: vec![
            ("learner", strings(rows().map(|(c, _)| &*c.learner))),
            ("grouping", strings(rows().map(|(c, _)| &*c.grouping))),
            ("rounds", numbers(rows().map(|(c, _)| c.rounds as u32))),
            ("threshold", floats(rows().map(|(_, p)| p.threshold))),
            // At every point, at least one pair is classified as positive.
            ("precision", floats(rows().map(|(_, p)| p.confusion.precision().unwrap_or(0.0)))),
            ("recall", floats(rows().map(|(_, p)| p.confusion.recall()))),
            ("false_alarm", floats(rows().map(|(_, p)| p.confusion.false_alarm()))),
        ],
        nullable: &[],
    }
}

fn selection(rows: &[BoostingRound], errors: &[ErrorRow]) -> Table {
    let fold = |end: usize| -> ArrayRef {
        let folds = rows.iter().map(|r| r.held_out.as_ref().map(|l| l.folds[end]));
        Arc::new(folds.collect::<UInt32Array>())
    };
    let groupings = rows.iter().map(|r| r.held_out.as_ref().map(|l| &*l.grouping));
    let error_after = |r: &BoostingRound| {
        let is_of_all_pairs = r.held_out.is_none();
        let mut rows = errors.iter();
        let row = rows
            .find(|e| is_of_all_pairs && e.learner == r.learner && e.rounds == r.round as usize);
        row.map(|e| e.confusion.error())
    };
    Table {
        name: "selection",
        columns: vec![
            ("learner", strings(rows.iter().map(|r| &*r.learner))),
            ("grouping", Arc::new(groupings.collect::<StringArray>())),
            ("fold", fold(0)),
            ("other_fold", fold(1)),
            ("round", numbers(rows.iter().map(|r| r.round))),
            ("feature", strings(rows.iter().map(|r| &*r.feature))),
            ("threshold", optional_floats(rows.iter().map(|r| r.threshold))),
            ("weighted_error", floats(rows.iter().map(|r| r.weighted_error))),
            ("error", optional_floats(rows.iter().map(error_after))),
        ],
        nullable: &["grouping", "fold", "other_fold", "threshold", "error"],
    }
}

fn features(rows: &[FeatureUsefulness]) -> Table {
    Table {
        name: "features",
        columns: vec![
            ("feature", strings(rows.iter().map(|r| &*r.name))),
            ("auc", floats(rows.iter().map(|r| r.auc))),
            ("stability", floats(rows.iter().map(|r| r.stability))),
            ("chosen", Arc::new(UInt64Array::from_iter_values(rows.iter().map(|r| r.chosen)))),
        ],
        nullable: &[],
    }
}

fn mistakes(input: &Input<'_>, rows: &[Mistake]) -> Table {
    let pair = |m: &Mistake| &input.pairs[m.pair];
    let query = |m: &Mistake| &input.keyframes[pair(m).query].id;
    let reference = |m: &Mistake| &input.keyframes[pair(m).reference].id;
    let labels = rows.iter().map(|m| pair(m).label.sign());
    Table {
        name: "mistakes",
        columns: vec![
            ("learner", strings(rows.iter().map(|m| &*m.learner))),
            ("grouping", strings(rows.iter().map(|m| &*m.grouping))),
            ("query_log", strings(rows.iter().map(|m| &*query(m).log))),
            ("query_scan", numbers(rows.iter().map(|m| query(m).scan))),
            ("reference_log", strings(rows.iter().map(|m| &*reference(m).log))),
            ("reference_scan", numbers(rows.iter().map(|m| reference(m).scan))),
            ("label", Arc::new(Int8Array::from_iter_values(labels))),
            ("confidence", floats(rows.iter().map(|m| m.confidence))),
            ("distance_m", floats(rows.iter().map(|m| pair(m).distance_m))),
        ],
        nullable: &[],
    }
}
